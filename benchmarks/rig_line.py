"""Measure a transaction with a device: our own time beside that of a bare write and read on the same pseudo-terminal.

``python benchmarks/rig_line.py`` writes ``benchmarks/results/rig_line.json``. A process of its own answers ``?NM`` at once, as no
device does, so that what is left is the line's own time. One requirement is judged: a transaction, with its echo checked and its
reply parsed, takes at most 1 ms more than the bare bytes, at the median.
"""

from __future__ import annotations

import json
import os
import platform
import select
import statistics
import subprocess
import sys
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from brdfpipe.rig.acquisition.devices.acton import Monochromator
from brdfpipe.rig.acquisition.devices.connection import open_monochromator
from brdfpipe.rig.acquisition.devices.serial_line import SerialLine
from brdfpipe.rig.description import SerialSettings

PROJECT = Path(__file__).resolve().parents[1]
LIMIT_MS = 1.0
QUESTION, ANSWER = b"?NM\r", b"?NM 546.100 nm  ok\r\n"

Record = dict[str, Any]


@click.command()
@click.option("--transactions", default=4000, show_default=True, help="Of each kind.")
@click.option("--rounds", default=8, show_default=True, help="The kinds take turns so many times.")
@click.option("--out", type=click.Path(path_type=Path), default=PROJECT / "benchmarks" / "results" / "rig_line.json")
@click.option("--answer", type=int, default=None, hidden=True)
def main(transactions: int, rounds: int, out: Path, answer: int | None) -> None:
    """Time a transaction on a pseudo-terminal."""
    if answer is not None:
        answer_all(answer)
        return
    summary = measure(transactions // rounds, rounds)
    print(as_text(summary))
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    if not summary["met"]:
        sys.exit("a requirement is not met")


def measure(count: int, rounds: int) -> Record:
    """Bare bytes, one transaction of the line, and one question of the driver, in turns on one pseudo-terminal."""
    near, far = os.openpty()
    tty.setraw(far)
    device = subprocess.Popen([sys.executable, __file__, "--answer", str(near)], pass_fds=[near])
    os.close(near)
    settings = SerialSettings("acton", os.ttyname(far), 9600)
    times: dict[str, list[float]] = {"bare": [], "line": [], "driver": []}
    try:
        bare_exchange(far)  # the other process is up
        for _ in range(rounds):
            times["bare"] += timed(lambda: bare_exchange(far), count)
            line = SerialLine(settings, Monochromator.dialect)
            times["line"] += timed(lambda line=line: line.transact("?NM", 1.0), count)
            line.close()
            driver = open_monochromator(settings)
            driver.identify()
            times["driver"] += timed(driver.wavelength, count)
            driver.close()
    finally:
        device.terminate()
        device.wait()
        os.close(far)
    return summarised(times)


def timed(action: Callable[[], Any], count: int) -> list[float]:
    """Wall time of each of several runs [ms]."""
    times = []
    for _ in range(count):
        begin = time.perf_counter()
        action()
        times.append(1000 * (time.perf_counter() - begin))
    return times


def bare_exchange(far: int) -> None:
    """The bytes of one transaction, and nothing else."""
    os.write(far, QUESTION)
    received = b""
    while not received.endswith(b"\r\n"):
        select.select([far], [], [])
        received += os.read(far, 4096)


def answer_all(near: int) -> None:
    """The device: answers at once, for ever."""
    answers = {QUESTION: ANSWER, b"MODEL\r": b"MODEL SP-2-300i  ok\r\n", b"SERIAL\r": b"SERIAL 2330123  ok\r\n"}
    received = b""
    while True:
        received += os.read(near, 4096)
        while b"\r" in received:
            command, _, received = received.partition(b"\r")
            os.write(near, answers.get(command + b"\r", command + b" ok\r\n"))


def summarised(times: dict[str, list[float]]) -> Record:
    """The numbers of the table, and the requirement."""
    middle = {kind: statistics.median(spent) for kind, spent in times.items()}
    # Beyond the ninth tenth it is the system that has other things to do.
    late = {kind: statistics.quantiles(spent, n=10)[8] for kind, spent in times.items()}
    return {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "transactions": {kind: len(spent) for kind, spent in times.items()},
        "median_ms": {kind: round(value, 4) for kind, value in middle.items()},
        "p90_ms": {kind: round(value, 4) for kind, value in late.items()},
        "overhead_ms": {kind: round(middle[kind] - middle["bare"], 4) for kind in ("line", "driver")},
        "ratio": {kind: round(middle[kind] / middle["bare"], 2) for kind in ("line", "driver")},
        "met": middle["driver"] - middle["bare"] <= LIMIT_MS,
    }


def as_text(summary: Record) -> str:
    """The table a person reads."""
    lines = [f"{'':8}{'median ms':>11}{'90 % ms':>9}{'more ms':>9}{'ratio':>7}"]
    for kind, middle in summary["median_ms"].items():
        row = f"{kind:8}{middle:11.4f}{summary['p90_ms'][kind]:9.4f}"
        if kind != "bare":
            row += f"{summary['overhead_ms'][kind]:9.4f}{summary['ratio'][kind]:7.2f}"
        lines.append(row)
    met = "met" if summary["met"] else "NOT met"
    lines.append(f"a question of the driver takes at most {LIMIT_MS:g} ms more than its bare bytes: {met}")
    return "\n".join([*lines, summary["machine"]])


if __name__ == "__main__":
    main()
