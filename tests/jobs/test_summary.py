"""The summary of a build names the reason of every verdict of fail."""

import json
from pathlib import Path

import pytest
import xarray as xr

from brdfpipe.jobs.summary import failed_checks

CHECKS = {
    "energy": {"verdict": "pass", "text": "below 1"},
    "reciprocity": {"verdict": "fail", "text": "differs by 3 %"},
}
TABLE = {"table": {"verdict": "fail", "text": "differs from the BSDF by 40 %"}}


@pytest.mark.parametrize(
    ("verdicts", "expected"),
    [
        ({"checks": CHECKS}, "reciprocity: differs by 3 %"),
        ({"table": TABLE}, "table: differs from the BSDF by 40 %"),
        ({"checks": CHECKS, "table": TABLE}, "reciprocity: differs by 3 %; table: differs from the BSDF by 40 %"),
        ({}, ""),
    ],
)
def test_a_material_fails_by_its_checks_or_by_its_table(
    verdicts: dict[str, dict[str, object]], expected: str, tmp_path: Path
) -> None:
    (tmp_path / "m").mkdir()
    for stage, entries in verdicts.items():
        xr.Dataset(attrs={"verdicts": json.dumps(entries)}).to_netcdf(tmp_path / "m" / f"{stage}.nc")
    assert failed_checks(tmp_path, "m") == expected
