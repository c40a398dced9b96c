"""What is said in and beside files: measurement, uncertainty, limits and shares of single directions."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rig_primary
import samples
import xarray as xr

from brdfpipe import exchange
from brdfpipe.bsdf.measured.completion import complete
from brdfpipe.bsdf.measured.smoothing import smooth
from brdfpipe.bsdf.table_error import Limits, TableError
from brdfpipe.exchange import records
from brdfpipe.exchange.registry import FORMATS
from brdfpipe.exchange.stated_uncertainty import uncertainty_in_words

MEASUREMENT = {"day": "2026-11-02", "rig": "bench-1", "calibrated": "2026-10-30", "certificate": "PTB-17"}
COARSE: dict[str, Any] = {"tolerance": 0.5, "albedo_tolerance": 0.5, "largest": 20_000}


@pytest.fixture(scope="module")
def measured():
    """What a rig measured of a lobe, with the day of its run and the certificate of its calibration."""
    primary = rig_primary.measured(rig_primary.lobe("metallic, lobe of 14 degree"), (0.0, 40.0), (550.0,)).assign_attrs(
        MEASUREMENT
    )
    return complete(smooth(primary), reciprocity=False).assign_attrs(material="paint")


def test_what_a_rig_measured_keeps_its_day_rig_and_calibration(measured) -> None:
    assert {name: measured.attrs[name] for name in MEASUREMENT} == MEASUREMENT


def test_days_of_both_sides_are_named_that_of_reflection_first() -> None:
    day = records.day_of({"measurement": {"day": "2026-11-02, 2026-11-03"}}, "unknown")
    assert day == "2026-11-02"
    assert records.day_of({}, "unknown") == "unknown"


@pytest.mark.parametrize("name", ["integra", "openmaterial", "rgl"])
def test_a_file_of_a_measurement_states_day_certificate_and_uncertainty(measured, tmp_path: Path, name: str) -> None:
    declared = FORMATS[name]
    declared.write(measured, tmp_path / "paint", **(COARSE if declared.takes == "grid" else {}))
    suffix = declared.suffixes("reflection")[0]
    text = (tmp_path / f"paint{suffix}").read_bytes().decode("utf-8", "replace")
    assert (
        "measured on 2026-11-02, by the rig bench-1, calibrated on 2026-10-30, by an etalon with the certificate PTB-17"
        in text
    )
    record = json.loads((tmp_path / f"paint{suffix}.json").read_text())
    assert record["measurement"] == MEASUREMENT
    assert "from the measurement" in record["uncertainty"][0]
    if name not in ("rgl",):  # whose description is one short line
        assert record["uncertainty"][0] in text


def test_fields_of_formats_for_the_day_and_the_instrument_are_filled(measured, tmp_path: Path) -> None:
    for suffix in ("astm", "bird.json"):
        exchange.write(measured, tmp_path / f"a.{suffix}", **COARSE)
    assert "\nMEAS_DATE 2026-11-02\n" in (tmp_path / "a.astm").read_text()
    metadata = json.loads((tmp_path / "a.bird.json").read_text())["metadata"]
    assert metadata["timestamp"] == "2026-11-02T00:00:00Z"
    assert metadata["instrumentation"] == "bench-1"
    assert metadata["adhoc_section"]["measurement"] == MEASUREMENT


def test_the_stated_uncertainty_is_that_of_the_bsdf(measured) -> None:
    stated, over_directions = uncertainty_in_words(measured, "reflection")
    luminous = measured.bsdf.nonspectral()
    relative = float(luminous.bsdf.uncertainty(45, 0, 45, 180) / luminous.bsdf.evaluate(45, 0, 45, 180))
    assert f" 45:{relative:.4f} " in stated
    assert "nine tenths" in over_directions
    assert uncertainty_in_words(samples.beckmann_bsdf(0.3), "reflection") == []


@dataclass(frozen=True)
class Written:
    """A table of a BSDF with an error of 20 %."""

    bsdf: xr.Dataset
    error = TableError(0.2, 0.1, 0.3, 3000)
    reading = "interpolated linearly"
    limits = Limits(0.01, 0.001)
    size = 1000
    content: records.Content = "luminous"


@pytest.mark.parametrize(
    ("name", "with_lay", "advised"), [("integra", True, True), ("rgl", True, False), ("integra", False, False)]
)
def test_a_lay_that_exceeds_its_tolerance_is_sent_to_the_format_that_errs_least(
    name: str, with_lay: bool, advised: bool
) -> None:
    bsdf = samples.brushed_bsdf(0.4, 0.2) if with_lay else samples.beckmann_bsdf(0.1)
    record = records.record(Written(bsdf), replace(FORMATS[name], name=""))
    (text,) = records.errors_in_words(record)
    assert ("`rgl`, whose nodes follow the lobe, errs less with a lay" in text) == advised
    assert "MORE than the tolerance of 0.01" in text
    assert "`brdfpipe convert --largest` allows more values" in text


@pytest.mark.parametrize(("share", "stated"), [(3e-6, False), (1e-4, True)])
def test_a_share_as_small_as_rounding_is_no_mirrored_part(share: float, stated: bool) -> None:
    class OfOneDirection:
        def specular(self, theta_i: Any, phi_i: Any, wavelength: Any) -> tuple[np.ndarray, np.ndarray]:
            return np.full((5, 1), share), np.zeros((5, 1))

    assert bool(records.specular_shares(OfOneDirection())) == stated  # type: ignore[arg-type]
