"""Verdicts of a material, and warnings that its description accepts."""

from __future__ import annotations

import json

import pytest
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.verdicts import overall, verdicts

REASON = "the strip was cut by hand"


def datasets(check: str = "pass", *warnings: str) -> dict[str, xr.Dataset]:
    """A measured material with the verdict of one check, and warnings of one stage."""
    entry = {"verdict": check, "text": "the residual is 0.03"}
    stage = xr.Dataset(attrs={"kind": "primary"})
    for text in warnings:
        stage = vocabulary.add_warning(stage, text)
    bsdf = xr.Dataset(attrs={"route": "measured"})
    return {"primary": stage, "bsdf": bsdf, "checks": xr.Dataset(attrs={"verdicts": json.dumps({"energy": entry})})}


def accept(*texts: str) -> list[dict[str, str]]:
    return [{"warning": text, "reason": REASON} for text in texts]


def test_an_accepted_warning_leaves_the_verdict_pass_and_keeps_its_text() -> None:
    given = datasets("pass", "The file may be truncated.")
    assert overall(given)[0] == "warn"
    assert overall(given, accept("MAY BE truncated")) == ("pass", [])
    (entry,) = [entry for entry in verdicts(given, accept("may be truncated")) if entry.of == "stage"]
    assert (entry.verdict, entry.text) == ("accepted", f"The file may be truncated (accepted: {REASON})")


def test_a_new_warning_beside_an_accepted_one_stands_out() -> None:
    verdict, (entry,) = overall(datasets("pass", "may be truncated", "slopes are noisy"), accept("may be truncated"))
    assert (verdict, entry.text) == ("warn", "slopes are noisy")


@pytest.mark.parametrize(("check", "expected"), [("warn", "pass"), ("fail", "fail")])
def test_a_check_that_warns_can_be_accepted_and_one_that_fails_cannot(check: str, expected: str) -> None:
    assert overall(datasets(check), accept("the residual is"))[0] == expected


def test_an_acceptance_without_a_warning_is_a_warning() -> None:
    verdict, (entry,) = overall(datasets("pass"), accept("may be truncated"))
    assert verdict == "warn"
    assert "'may be truncated' is accepted and no warning has this text" in entry.text


def test_nothing_checked_has_no_verdict() -> None:
    assert overall({"bsdf": xr.Dataset(attrs={"route": "measured"})}) == ("", [])
