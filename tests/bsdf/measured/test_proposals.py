"""What to measure next: where interpolation errs, and which incidences contradict the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import rig_accuracy as accuracy
import rig_primary
import samples
import xarray as xr
from click.testing import CliRunner

from brdfpipe.bsdf import lambert_gauss
from brdfpipe.bsdf.measured.completion import complete
from brdfpipe.bsdf.measured.proposals import Proposals, propose
from brdfpipe.bsdf.measured.smoothing import smooth
from brdfpipe.cli.main import main
from brdfpipe.rig.reduction.calibration import calibrate
from brdfpipe.rig.reduction.primary import apply_profile
from brdfpipe.rig.templates import start
from brdfpipe.store import save_dataset

ENTRANCES = (0.0, 10.0, 20.0, 30.0, 45.0, 60.0)
EDGE = 592.0


def edge(wavelength: np.ndarray) -> np.ndarray:
    """The reflectance of a red paint."""
    return 0.05 + 0.75 / (1 + np.exp((EDGE - wavelength) / 6))


def matt_primary(incidences: tuple[float, ...], wavelengths: tuple[float, ...], reflectance) -> xr.Dataset:
    """A measurement with 1 % noise of a matt surface."""
    truth = rig_primary.of_model(samples.beckmann_bsdf(0.3, n=1.5).bsdf.nonspectral())
    primary = rig_primary.measured(truth, incidences, wavelengths, noise=0.01)
    share = xr.DataArray(reflectance(np.array(wavelengths)), {"wavelength": primary["wavelength"]}, "wavelength")
    names = [name for name in primary.data_vars if str(name).startswith("brdf") and primary[name].dtype.kind == "f"]
    return primary.assign(
        {
            name: (primary[name] * share).transpose(*primary[name].dims).assign_attrs(primary[name].attrs)
            for name in names
        }
    )


def proposed(primary: xr.Dataset, **options: int) -> Proposals:
    return propose(primary, complete(smooth(primary)), ENTRANCES, **options)


def test_the_wavelengths_of_an_edge_are_proposed_and_no_others():
    found = proposed(matt_primary((10.0, 30.0), (450.0, 500.0, 550.0, 600.0, 650.0, 700.0), edge))
    assert 475.0 not in {item.at for item in found.wavelengths}
    assert found.wavelengths[0].at == 575.0
    assert found.wavelengths[0].error > 0.1
    grey = proposed(matt_primary((10.0, 30.0), (450.0, 500.0, 550.0, 600.0), lambda wavelength: 0 * wavelength + 0.5))
    assert grey.wavelengths == ()


def test_incidences_far_from_the_measured_ones_come_first():
    found = proposed(matt_primary((10.0, 20.0), (500.0, 550.0), lambda wavelength: 0 * wavelength + 0.5))
    assert found.incidences[0].at == 60.0
    assert {item.at for item in found.incidences} <= {0.0, 30.0, 45.0, 60.0}
    assert list(found.incidences) == sorted(found.incidences, key=lambda item: -item.error)


def test_an_incidence_that_contradicts_the_others_is_measured_again():
    primary = matt_primary((10.0, 20.0, 30.0, 45.0), (500.0, 550.0), lambda wavelength: 0 * wavelength + 0.5)
    assert proposed(primary).again == ()
    wrong = xr.where(primary["incidence"] == 30.0, 1.5, 1.0)
    primary["brdf"] = (primary["brdf"] * wrong).transpose(*primary["brdf"].dims).assign_attrs(primary["brdf"].attrs)
    found = proposed(primary)
    assert found.again[0].at == 30.0


def test_the_command_prints_what_to_add_to_the_plan(tmp_path):
    plan = start(tmp_path / "bench", 60)
    results = tmp_path / "results"
    results.mkdir()
    primary = matt_primary((10.0, 20.0), (450.0, 500.0, 550.0, 600.0, 650.0), edge)
    save_dataset(primary, results / "primary-reflection.nc", stage="primary", material="red")
    refused = CliRunner().invoke(main, ["rig", "next", str(results), str(plan)])
    assert refused.exit_code == 2
    assert "no measured.nc" in refused.output
    save_dataset(complete(smooth(primary)), results / "measured.nc", stage="measured", material="red")
    done = CliRunner().invoke(main, ["rig", "next", str(results), str(plan)])
    assert done.exit_code == 0, done.output
    assert "incidence 60°: uncertain by" in done.output
    assert "wavelength 575 nm: linear interpolation errs by about" in done.output


def interpolation_error(wavelengths: tuple[float, ...]) -> tuple[float, tuple[float, ...]]:
    """Largest error between wavelengths of an emulated measurement of a red paint, relative to its maximum, and what is proposed next."""
    plan = accuracy.plan_of(wavelengths, (10.0, 45.0), 40)
    truth = lambert_gauss.lambertian(samples.spectrum(edge(samples.WAVELENGTH)))
    etalon, sample = accuracy.two_days(plan, truth, seed=2)
    profile = calibrate(accuracy.reduced(plan, etalon, "etalon"), accuracy.certificate())
    primary = apply_profile(accuracy.reduced(replace(plan, runs=("target", "sample")), sample, "sample"), profile)
    spectrum = np.pi * np.nanmedian(primary["brdf"].values, axis=(0, 2))
    between = np.arange(500.0, 700.1, 1.0)
    error = np.abs(np.interp(between, wavelengths, spectrum) - edge(between)).max() / edge(between).max()
    found = propose(primary, complete(smooth(primary)), ENTRANCES, most=2)
    return float(error), tuple(item.at for item in found.wavelengths)


@pytest.mark.slow
def test_proposed_wavelengths_reach_the_accuracy_of_more_even_ones():
    """21 even ones are as good as 12 proposed ones; here they are compared with 18, which are worse."""
    chosen = (500.0, 540.0, 580.0, 620.0, 660.0, 700.0)
    error, further = interpolation_error(chosen)
    while len(chosen) < 12:
        chosen = tuple(sorted({*chosen, *further}))
        error, further = interpolation_error(chosen)
    even, _ = interpolation_error(tuple(np.linspace(500.0, 700.0, 18).round(1).tolist()))
    assert error < 0.045 < even
