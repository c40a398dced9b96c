"""Samples as comma-separated values: read back by this package, on grids and in scattered directions."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import samples
from damaged_files import garbled

from brdfpipe import optics, vocabulary
from brdfpipe.bsdf.input_uncertainty import uncertainty
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import error_of, fresh_pairs
from brdfpipe.errors import InputError
from brdfpipe.exchange.reading import format_of, read
from brdfpipe.exchange.registry import ExchangeError, write

FEW = {"incidences": 6, "views": 100}
NAMES = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,bsdf_per_sr"


@pytest.fixture(scope="module")
def grey():
    return samples.beckmann_bsdf(0.3).assign_attrs(material="grey", digest="abc")


@pytest.fixture(scope="module")
def file(grey, tmp_path_factory):
    path = tmp_path_factory.mktemp("samples") / "grey.samples.csv"
    write(grey, path)
    return path


def test_rows_are_values_of_the_model_in_the_columns_that_the_first_line_names(grey, file):
    frame = pd.read_csv(file)
    assert ",".join(frame.columns) == NAMES
    chosen = frame.sample(300, random_state=1).to_numpy()
    # Angles and values have six digits.
    assert chosen[:, 4] == pytest.approx(grey.bsdf.nonspectral().bsdf.evaluate(*chosen[:, :4].T).values, rel=1e-5)
    assert frame["theta_i_deg"].nunique() == 18
    assert format_of(file).name == "samples"


def test_the_file_read_back_errs_by_what_its_record_says(grey, file):
    record, model = json.loads(Path(f"{file}.json").read_text()), grey.bsdf.nonspectral()
    back = read(file)
    found = error_of(model, representation(back).evaluate, fresh_pairs(model, 11, incidences=24))
    assert found.percentile_95 <= 1.4 * record["error"]["percentile_95"] + 1e-3
    assert found.albedo <= 1.4 * record["error"]["albedo"] + 1e-3
    # Six hundred samples of an incidence, of which half lie in a lobe of 0.3, are about 0.05 rad apart.
    assert record["error"]["percentile_95"] < 0.05
    assert "interpolated onto a grid" in back.attrs["history"]


def test_cells_are_flagged_as_interpolated_or_extrapolated(file):
    quality = read(file)["brdf_quality"]
    near = quality.sel(theta_s=slice(0, 10)).values
    assert (near[1:-1] == vocabulary.quality("interpolated")).mean() > 0.9
    # The direction opposite to the mirror direction is below the surface.
    assert (quality.isel(theta_s=-1) == vocabulary.quality("extrapolated")).all()


def test_spectra_and_uncertainties_have_columns(tmp_path):
    bsdf = samples.beckmann_bsdf(0.3, n=1.5, reflectance=np.linspace(0.05, 0.6, samples.WAVELENGTH.size))
    changes = uncertainty(bsdf, index=optics.refractive_index(1.5, uncertainty=0.05))
    known = bsdf.merge(changes, combine_attrs="override")
    write(known, tmp_path / "u.samples.csv", spectral=True, **FEW)
    frame = pd.read_csv(tmp_path / "u.samples.csv")
    assert frame.columns[-3:].tolist() == ["wavelength_nm", "bsdf_per_sr", "bsdf_u_per_sr"]
    back = read(tmp_path / "u.samples.csv")
    assert back["wavelength"].values == pytest.approx(samples.WAVELENGTH)
    at = 34.0, 0.0, 34.0, 180.0
    # The mirror direction is a sample.
    assert back.bsdf.evaluate(*at).values == pytest.approx(known.bsdf.evaluate(*at).values, rel=1e-3)
    found = back["brdf_u"].sel(theta_i=34, theta_s=0).isel(phi_s=0)
    assert found.values == pytest.approx(known.bsdf.uncertainty(*at).values, rel=1e-2)
    assert not {"spectrum", "uncertainty"} & set(json.loads((tmp_path / "u.samples.csv.json").read_text())["left_out"])


def test_a_lay_has_incidences_all_around(tmp_path):
    brushed = samples.brushed_bsdf(0.4, 0.25, 25.0)
    write(brushed, tmp_path / "b.samples.csv", **FEW)
    model, back = brushed.bsdf.nonspectral(), read(tmp_path / "b.samples.csv")
    at = [(34, phi, 34, phi + 180) for phi in (30.0, 75.0, 120.0, 165.0)]
    found, wanted = ([float(bsdf.bsdf.evaluate(*angles)) for angles in at] for bsdf in (back, model))
    assert found == pytest.approx(wanted, rel=1e-3)


def by_hand(tmp_path: Path, rows: str, names: str = NAMES) -> Path:
    (tmp_path / "x.csv").write_text(f"{names}\n{rows}")
    return tmp_path / "x.csv"


GRID = "".join(
    f"{theta_i},0,{theta_o},{phi_o},{1 + theta_o}\n"
    for theta_i in (0, 40, 80)
    for theta_o in (0, 45, 80)
    for phi_o in (0, 90, 180)
)


def test_samples_on_a_grid_become_that_grid(tmp_path):
    back = read(by_hand(tmp_path, GRID))
    assert back["theta_o"].values.tolist() == [0, 45, 80]
    assert (back["brdf_quality"] == 0).all()
    assert float(back.bsdf.evaluate(20, 0, 45, 270)) == pytest.approx(46)


def test_columns_may_be_in_any_order_and_azimuths_beyond_a_turn(tmp_path):
    frame = pd.read_csv(by_hand(tmp_path, GRID))
    frame["phi_o_deg"] -= 360
    frame[frame.columns[::-1]].to_csv(tmp_path / "y.csv", index=False)
    assert read(tmp_path / "y.csv", "samples")["brdf"].values == pytest.approx(read(tmp_path / "x.csv")["brdf"].values)


@pytest.mark.parametrize(
    ("names", "rows", "message"),
    [
        (NAMES.replace("phi_o_deg", "phi_o"), GRID, "line 1.*column is missing.*phi_o_deg"),
        (f"{NAMES},colour", GRID.replace("\n", ",1\n"), "line 1.*unknown column.*colour"),
        (NAMES, "", "no rows"),
        (NAMES, GRID.replace("0,0,45,90,46", "0,0,45,90,x"), "line 6.*bsdf_per_sr is out of range.*x"),
        (NAMES, GRID.replace("0,0,45,90,46", "0,0,145,90,46"), "line 6.*theta_o_deg is out of range.*0 to 90"),
        (NAMES, GRID.replace("0,0,45,90,46", "0,0,45,90"), "line 6.*bsdf_per_sr is out of range"),
        (NAMES, GRID.replace("0,0,45,90,46", "0,0,45,90,46,1"), "comma-separated"),
        (f"{NAMES},wavelength_nm", GRID.replace("\n", ",500\n") + "0,0,0,0,1,600\n", "lacks some of the wavelengths"),
        (f"{NAMES},bsdf_u_per_sr", GRID.replace("\n", ",-1\n"), "line 2.*bsdf_u_per_sr.*0 or more"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_with_its_line(tmp_path, names, rows, message):
    with pytest.raises(InputError, match=message):
        read(by_hand(tmp_path, rows, names), "samples")


def scattered(tmp_path: Path, count: int, change=lambda angles: None) -> Path:
    angles = np.random.default_rng(4).uniform(1, 80, (4, count))
    angles[0], angles[1] = np.repeat([10, 60], count // 2), 0
    change(angles)
    return by_hand(tmp_path, "".join(f"{','.join(map(str, row))},1\n" for row in angles.T))


def test_a_constant_in_scattered_directions_is_that_constant(tmp_path):
    back = read(scattered(tmp_path, 200))
    assert back["brdf"].values == pytest.approx(1.0)


def test_scattered_samples_need_several_directions_of_each_incidence(tmp_path):
    with pytest.raises(InputError, match=r"too few samples.*7"):
        read(scattered(tmp_path, 14))


def test_scattered_incidences_are_refused(tmp_path):
    def scatter(angles):
        angles[:2] = np.random.default_rng(1).uniform(1, 80, angles[:2].shape)

    with pytest.raises(InputError, match="incidences are no grid"):
        read(scattered(tmp_path, 100, scatter))


def test_samples_on_one_line_are_refused(tmp_path):
    def line(angles):
        angles[2], angles[3] = np.linspace(1, 80, angles.shape[1]), np.tile([0.0, 180.0], 20)

    with pytest.raises(InputError, match="one line"):
        read(scattered(tmp_path, 40, line))


@pytest.mark.parametrize(("option", "value"), [("incidences", 1), ("views", 10)])
def test_options_out_of_range_are_refused(grey, tmp_path, option, value):
    with pytest.raises(ExchangeError, match=option):
        write(grey, tmp_path / "a.samples.csv", **{option: value})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("count", [30, pytest.param(300, marks=pytest.mark.slow)])
def test_garbled_files_are_read_or_refused_and_never_crash(tmp_path, count):
    # A file that ends early between two rows is a whole one of fewer samples.
    content, refused = by_hand(tmp_path, GRID * 3).read_bytes(), 0
    for damaged in garbled(content * 2, count):
        (tmp_path / "y.csv").write_bytes(damaged)
        try:
            assert np.isfinite(read(tmp_path / "y.csv", "samples")["brdf"].values).all()
        except InputError:
            refused += 1
    assert refused > count / 8
