"""Polarised files for Mitsuba: the layout, the frames of Stokes parameters, and the matrices that Mitsuba evaluates."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import samples
import xarray as xr
from damaged_files import check_garbled_files

from brdfpipe import facets, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import error_of, fresh_pairs
from brdfpipe.errors import InputError
from brdfpipe.exchange import pbsdf, tensor_file
from brdfpipe.exchange.reading import read
from brdfpipe.exchange.registry import ExchangeError, write
from brdfpipe.geometry import unit_vector


@pytest.fixture(scope="module")
def metal():
    """Rough metal, whose circular polarisation depends on the linear one."""
    index = xr.Dataset(
        {"n": ("wavelength", [1.2, 1.2]), "k": ("wavelength", [4.0, 4.0])},
        coords={"wavelength": [360.0, 780.0]},
        attrs={"source": "a number", "dispersion": "constant"},
    )
    with samples.coarse_albedo_tables():
        return microfacet.build(
            facets.analytic("beckmann", 0.4),
            index=vocabulary.label(index, "index"),
            diffuse="none",
            multiple_scattering="none",
        )


@pytest.fixture(scope="module")
def file(metal, tmp_path_factory):
    path = tmp_path_factory.mktemp("pbsdf") / "metal.pbsdf"
    write(metal, path)
    return path


def test_fields_are_those_that_the_plugin_reads(file):
    fields = tensor_file.read(file)
    count = [pbsdf.AXES[name].size for name in ("phi_d", "theta_d", "theta_h")]
    assert fields["M"].shape == (*count, 5, 4, 4)
    assert fields["wvls"].tolist() == [450, 500, 550, 600, 650]
    assert fields["wvls"].dtype == np.uint16
    assert all(fields[name].shape == (1, pbsdf.AXES[name].size) for name in pbsdf.AXES)
    assert fields["phi_d"][0, [0, -1]] == pytest.approx([-np.pi, np.pi])
    record = json.loads(Path(f"{file}.json").read_text())
    assert "polarisation" not in record["left_out"]
    assert record["error"]["percentile_95"] < 0.05


def test_in_the_plane_of_incidence_the_matrix_is_that_of_s_and_p(metal, file):
    fields = tensor_file.read(file)
    # φ_d of 0: both directions lie in the plane of the normal, so the first axis is s.
    row, column, turn = 12, 15, 18
    theta_h, theta_d = pbsdf.AXES["theta_h"][row], pbsdf.AXES["theta_d"][column]
    expected = metal.bsdf.mueller(theta_h + theta_d, 0.0, theta_d - theta_h, 180.0, 550.0).values.reshape(4, 4)
    assert fields["M"][turn, column, row, 2] == pytest.approx(expected, abs=1e-5 * expected[0, 0])


def test_facets_polarise_alike_at_every_azimuth_about_the_half_vector(file):
    matrices = tensor_file.read(file)["M"][:, 15, 6, 2]
    shape = matrices / matrices[:, :1, :1]
    # In the frame of the facet Fresnel's matrix depends on θ_d alone.
    assert shape == pytest.approx(np.broadcast_to(shape[:1], shape.shape), abs=1e-4)


def test_a_lay_is_refused(tmp_path):
    with pytest.raises(ExchangeError, match="lay"):
        write(samples.brushed_bsdf(0.4, 0.2), tmp_path / "x.pbsdf")


def test_two_turns_of_the_frame_are_one():
    one, other = np.array([0.3]), np.array([-1.1])
    assert pbsdf.rotator(one) @ pbsdf.rotator(other) == pytest.approx(pbsdf.rotator(one + other))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["metal", "grey"])
def test_mitsuba_evaluates_the_matrices(metal, tmp_path, kind):
    mitsuba = pytest.importorskip("mitsuba", reason="Mitsuba is not there: make peers")
    before = mitsuba.variant()
    mitsuba.set_variant("scalar_spectral_polarized")
    bsdf = metal if kind == "metal" else samples.beckmann_bsdf(0.3)
    write(bsdf, tmp_path / "x.pbsdf")
    plugin = mitsuba.load_dict({"type": "measured_polarized", "filename": str(tmp_path / "x.pbsdf")})
    context, surface = mitsuba.BSDFContext(), mitsuba.SurfaceInteraction3f()
    surface.wavelengths = [450.0, 500.0, 550.0, 650.0]

    def vector(values):
        return mitsuba.Vector3f(*(float(one) for one in values))

    def turn(travel, azimuth):
        """From Mitsuba's own frame of Stokes parameters to the s direction."""
        return -pbsdf.turn_of(
            np.array(mitsuba.mueller.stokes_basis(vector(travel)))[None], travel[None], np.array([azimuth])
        )[0]

    for at in (
        (50.0, 20.0, 60.0, 190.0),
        (40.0, 0.0, 30.0, 120.0),
        (60.0, 30.0, 55.0, 210.0),
        (20.0, 10.0, 35.0, 260.0),
    ):
        theta_i, phi_i, theta_o, phi_o = at
        # Light arrives from the direction that the plugin calls wo, and leaves towards wi.
        incident, outgoing = (
            unit_vector(np.array(theta_i), np.array(phi_i)),
            unit_vector(np.array(theta_o), np.array(phi_o)),
        )
        surface.wi = vector(outgoing)
        value = plugin.eval(context, surface, vector(incident))
        matrix = np.array([[np.array(value[i, j]).ravel()[2] for j in range(4)] for i in range(4)])
        matrix = matrix / np.cos(np.radians(theta_i))
        found = pbsdf.rotator(turn(outgoing, phi_o)) @ matrix @ pbsdf.rotator(-turn(-incident, phi_i + 180))
        expected = bsdf.bsdf.mueller(*at, 550.0).values.reshape(4, 4)
        # Linear interpolation between the nodes, as the record states of the intensity.
        assert found == pytest.approx(expected, abs=0.03 * expected[0, 0])
    if before is not None:
        mitsuba.set_variant(before)


def test_read_back_is_the_brdf_of_unpolarised_light(metal, file):
    back = read(file)
    assert back["wavelength"].values.tolist() == [450, 500, 550, 600, 650]
    stated = json.loads(Path(f"{file}.json").read_text())["error"]
    found = error_of(metal.bsdf.nonspectral(), representation(back.bsdf.nonspectral()).evaluate, fresh_pairs(metal, 31))
    assert found.percentile_95 <= 1.6 * stated["percentile_95"] + 2e-3
    assert "unpolarised light alone" in back.attrs["history"]


def _changed(**fields):
    """Changes of the fields of a small file."""
    return lambda given: {**given, **{name: change(given[name]) for name, change in fields.items()}}


def _small():
    """A grey diffuser on few nodes."""
    matrices = np.zeros((5, 3, 4, 2, 4, 4), dtype=np.float32)
    matrices[..., 0, 0] = 0.1
    return {
        "phi_d": np.radians(np.linspace(-180, 180, 5))[None].astype(np.float32),
        "theta_d": np.radians([0.0, 45, 89])[None].astype(np.float32),
        "theta_h": np.radians([0.0, 10, 40, 89])[None].astype(np.float32),
        "wvls": np.array([500, 600], dtype=np.uint16),
        "M": matrices,
    }


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda given: {name: array for name, array in given.items() if name != "M"}, "lacks fields"),
        (_changed(M=lambda m: m[:-1]), "do not fit"),
        (_changed(wvls=lambda w: w[::-1]), "do not increase"),
        (_changed(phi_d=lambda phi: phi / 2), "not a circle"),
        (_changed(phi_d=lambda phi: phi + np.float32(0.1)), "no azimuth phi_d is 0"),
        (_changed(theta_h=lambda theta: theta[:, ::-1]), "theta_h do not increase"),
        (_changed(M=lambda m: m * np.float32(np.nan)), "no cell has a value"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_with_what_was_found(tmp_path, change, message):
    tensor_file.write(tmp_path / "x.pbsdf", _small())
    assert float(read(tmp_path / "x.pbsdf").bsdf.nonspectral().bsdf.evaluate(30, 0, 40, 100)) == pytest.approx(0.1)
    tensor_file.write(tmp_path / "x.pbsdf", change(_small()))
    with pytest.raises(InputError, match=message):
        read(tmp_path / "x.pbsdf")


@pytest.mark.parametrize("count", [40, pytest.param(300, marks=pytest.mark.slow)])
def test_garbled_files_are_read_or_refused_and_never_crash(tmp_path, count):
    tensor_file.write(tmp_path / "small.pbsdf", _small())
    check_garbled_files((tmp_path / "small.pbsdf").read_bytes(), tmp_path / "x.pbsdf", "pbsdf", count)
