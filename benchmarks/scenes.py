"""What each scene costs: build the examples from nothing for every shipped scene; write the table of docs/scenes.md.

``python benchmarks/scenes.py`` takes some minutes on one core.
"""

from __future__ import annotations

import json
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from brdfpipe.catalogue.catalogue import load
from brdfpipe.descriptions.rendering import with_section
from brdfpipe.scenes.scene import shipped_scenes

PROJECT = Path(__file__).resolve().parents[1]
PAGE = PROJECT / "docs" / "scenes.md"
RECORD = PROJECT / "benchmarks" / "results" / "scenes.json"
NOT_RESULTS = ("logs", ".snakemake", "failures", ".build.lock")
MOST = "metrology-full"
"""The scene that the others are compared with."""


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        costs = {name: cost(name, Path(folder) / name) for name in shipped_scenes()}
    machine = f"{platform.machine()}, Python {platform.python_version()}"
    RECORD.write_text(json.dumps({"machine": machine, "cores": 1, "scenes": costs}, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(with_costs(PAGE.read_text(encoding="utf-8"), costs), encoding="utf-8")


def cost(scene: str, results: Path) -> dict[str, float]:
    """Jobs, processor time [s] of the jobs, wall time of the build [s] and bytes of the results; and of a build without camera rigs.

    The emulated rigs measure a material that another example predicts: built with them, it counts as a cost of every scene.
    """
    plain = [material.name for material in load(PROJECT / "examples").materials if not material.has("rig")]
    alone = built(scene, results.with_name(f"{results.name}-without-rigs"), plain)
    return built(scene, results, []) | {"cpu_without_rig_s": alone["cpu_s"], "bytes_without_rig": alone["bytes"]}


def built(scene: str, results: Path, materials: list[str]) -> dict[str, float]:
    """The same of a build of some examples, of all without any; the catalogue's own job is not counted."""
    examples = PROJECT / "examples"
    started = time.perf_counter()
    command = [
        sys.executable,
        "-m",
        "brdfpipe.cli",
        "build",
        examples,
        *materials,
        "--results",
        results,
        "--scene",
        scene,
        "--cores",
        "1",
    ]
    subprocess.run(command, check=True, capture_output=True)
    wall = time.perf_counter() - started
    records = [
        json.loads(path.read_text(encoding="utf-8"))
        for path in (results / "logs").rglob("*.json")
        if path.stem != "build"
    ]
    files = [
        path
        for path in results.rglob("*")
        if path.is_file()
        and path.relative_to(results).parts[0] not in NOT_RESULTS
        and (not materials or set(materials) & set(path.relative_to(results).parts))
    ]
    own = [record for record in records if not materials or record["material"] in materials]
    return {
        "jobs": len(records),
        "cpu_s": round(sum(record["cpu_s"] for record in own), 1),
        "wall_s": round(wall, 1),
        "bytes": sum(path.stat().st_size for path in files),
    }


def with_costs(page: str, costs: dict[str, dict[str, float]]) -> str:
    """The page with its table of costs renewed."""
    rows = [
        "| Scene | Jobs | Processor time | without rigs | Bytes | without rigs | `metrology-full` takes, without rigs |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, one in costs.items():
        times = costs[MOST]["cpu_without_rig_s"] / one["cpu_without_rig_s"]
        rows.append(
            f"| `{name}` | {one['jobs']:g} | {one['cpu_s']:.1f} s | {one['cpu_without_rig_s']:.1f} s | {one['bytes'] / 1e6:.1f} MB | "
            f"{one['bytes_without_rig'] / 1e6:.1f} MB | {times:.1f} × |"
        )
    return with_section(page, "costs", "\n".join(rows))


if __name__ == "__main__":
    main()
