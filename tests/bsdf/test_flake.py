"""The representation ``flake``: paints with effect pigments."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from brdfpipe import flakes, optics, store, vocabulary
from brdfpipe.bsdf import flake, sphere_cubature
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import InputError
from brdfpipe.flakes.forms import curve
from brdfpipe.flakes.refraction import refract
from brdfpipe.geometry import unit_vector
from brdfpipe.spectra import colorimetry

LAB = {"45:-30": (33.90, -7.58, -36.61), "45:0": (12.29, 1.19, -25.77), "45:65": (3.07, 2.09, -13.24)}
TEN = ("45as15", "45as20", "45as25", "45as35", "45as45", "45as60", "45as75", "45as95", "45as110", "15as45")
WAVELENGTH = np.arange(400.0, 701.0, 20.0)
MODELS = ({}, {"model": "flake-physical"}, {"model": "flake-physical", "clear_coat": 0.02})


def colours(labs=LAB, **viewing) -> xr.Dataset:
    listed = [{"geometry": name, "lab": list(lab)} for name, lab in labs.items()]
    return flakes.ingest({"colours": listed, "illuminant": "D65", "observer": 10, **viewing})


def directions(multiangle):
    return [multiangle[name].values for name in ("theta_i", "phi_i", "theta_o", "phi_o")]


def truth(theta_f):
    """A synthetic paint, (..., wavelength): brighter and narrower in the blue."""
    turn = (WAVELENGTH - 400) / 300
    amplitude, decay, constant = 0.6 - 0.4 * turn, 4.5 + 2 * turn, 0.02 + 0.03 * turn
    return curve(theta_f, amplitude[None], decay[None], constant, 1)


def spectra(noise=0.0, seed=0, names=TEN) -> xr.Dataset:
    random = np.random.default_rng(seed)
    listed = []
    for name in names:
        values = truth(float(flakes.flake_angle(*flakes.directions(name), 1.5)))
        values = values * (1 + noise * random.standard_normal(values.shape))
        listed.append({"geometry": name, "reflectance": values.tolist()})
    return flakes.ingest({"colours": listed, "wavelength": WAVELENGTH.tolist(), "scale": "fraction"})


def lab_of(bsdf, at, illuminant="D65", observer=10):
    factor = np.pi * bsdf.bsdf.evaluate(*at).values
    xyz = colorimetry.reflectance_to_xyz(bsdf["wavelength"].values, factor, illuminant, observer)
    return colorimetry.xyz_to_lab(xyz, colorimetry.weights(illuminant, observer).white)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("illuminant", "observer"), [("D65", 10), ("A", 2)])
def test_the_measured_colours_return_exactly(model, illuminant, observer):
    multiangle = colours(illuminant=illuminant, observer=observer)
    bsdf = flake.build(multiangle, index=1.524, **model)
    lab = lab_of(bsdf, directions(multiangle), illuminant, observer)
    # The recovery stops at 1e-11 of Y = 1, and Y is 0.003 where it is darkest.
    assert lab == pytest.approx(np.array(list(LAB.values())), abs=1e-5)
    assert bsdf["delta_e_00"].values == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("model", MODELS)
def test_between_the_measured_geometries_the_spectrum_has_the_fitted_colour(model):
    bsdf = flake.build(colours(), index=1.524, **model)
    at = (45.0, 0.0, np.linspace(0, 85, 40), np.linspace(0, 180, 40))
    at = tuple(np.broadcast_arrays(*at))
    white = colorimetry.weights("D65", 10).white
    fitted = colorimetry.xyz_to_lab(representation(bsdf).tristimulus(*at, "D65", 10), white)
    # Chromaticity is interpolated by a spline on 160 nodes; Y is exact.
    assert colorimetry.delta_e_00(fitted, lab_of(bsdf, at)).max() < 1e-4


@pytest.mark.parametrize("slope", [None, 1e-3, 0.02, 0.04])
@pytest.mark.parametrize("decay", [0.05, 3.0, 40.0])
def test_cells_about_the_mirror_direction_are_as_narrow_as_the_narrowest_lobe(slope, decay, monkeypatch):
    """Cells graded to 0.001° give the same albedo; a lobe that the cells miss would be absent from both value and error."""
    coat = {} if slope is None else {"model": "flake-physical", "clear_coat": slope}
    bsdf = flake.build(spectra(), index=1.5, **coat)
    bsdf = bsdf.assign(flake_decay=xr.full_like(bsdf["flake_decay"], decay))
    model = representation(bsdf)
    at = np.array([0.0, 8.0, 60.0, 85.0]), np.zeros(4), np.array([450.0])
    coarse = model.integrate(*at)
    monkeypatch.setattr(type(model), "halvings", sphere_cubature.HALVINGS)
    assert model.integrate(*at).value == pytest.approx(coarse.value, rel=2 * model.accuracy)


def test_the_patents_form_is_the_reflectance_factor_over_pi():
    bsdf = flake.build(colours(), index=1.524)
    theta_f = float(flakes.flake_angle(30, 20, 50, 90, 1.524))
    a, b, c = (float(bsdf[f"flake_{name}"].sel(channel="Y").squeeze()) for name in ("amplitude", "decay", "constant"))
    y = representation(bsdf).tristimulus(*(np.array([v]) for v in (30.0, 20.0, 50.0, 90.0)), "D65", 10)[0, 1]
    assert y == pytest.approx(a * np.exp(-theta_f / b) + c)


def passed_by_fields(theta_i, phi_i, theta_o, phi_o, index):
    """Share of natural light that enters a coat, is mirrored by a perfect flake and leaves, by its electric fields."""
    outside = unit_vector([theta_i, theta_o], [phi_i, phi_o])
    inside = refract(outside, index)
    flake_normal = inside.sum(axis=0) / np.linalg.norm(inside.sum(axis=0))
    fresnels = [optics.fresnel(np.cos(np.radians(theta)), index) for theta in (theta_i, theta_o)]
    (s_in, p_in), (s_out, p_out) = (
        (axis := np.cross(ray, [0, 0, 1]) / np.linalg.norm(np.cross(ray, [0, 0, 1])), np.cross(ray, axis))
        for ray in (-inside[0], inside[1])
    )
    power = 0.0
    for field in (np.sqrt(1 - fresnels[0].s) * s_in, np.sqrt(1 - fresnels[0].p) * p_in):
        mirrored = 2 * (field @ flake_normal) * flake_normal - field
        power += ((1 - fresnels[1].s) * (mirrored @ s_out) ** 2 + (1 - fresnels[1].p) * (mirrored @ p_out) ** 2) / 2
    return float(power)


@pytest.mark.parametrize(
    "at", [(10.0, 0.0, 50.0, 120.0), (70.0, 0.0, 5.0, 33.0), (75.0, 10.0, 80.0, 190.0), (80.0, 0.0, 75.0, 80.0)]
)
def test_the_physical_form_carries_the_transmission_of_s_and_p_and_the_jacobian(at):
    index = 1.524
    bsdf = flake.build(colours(), index=index, model="flake-physical")
    theta_f = flakes.flake_angle(*at, index)
    rho = curve(theta_f, *(bsdf[f"flake_{name}"].values for name in ("amplitude", "decay", "constant")), 1)
    cosines = [np.sqrt(1 - (np.sin(np.radians(theta)) / index) ** 2) for theta in (at[0], at[2])]
    at_normal = (1 - float(optics.fresnel(1.0, index).mean)) ** 2
    expected = rho * passed_by_fields(*at, index) / np.prod(cosines) / at_normal
    found = representation(bsdf).tristimulus(*(np.array([v]) for v in at), "D65", 10)[0]
    assert found == pytest.approx(expected, rel=1e-9)


def test_the_coat_lets_the_light_of_both_planes_pass_alike_in_both_directions():
    bsdf = flake.build(colours(), index=1.524, model="flake-physical")
    generator = np.random.default_rng(5)
    theta_i, theta_o = generator.uniform(0, 89, (2, 200))
    phi = generator.uniform(0, 360, 200)
    there, back = (
        bsdf.bsdf.evaluate(theta_i, 0, theta_o, phi).values,
        bsdf.bsdf.evaluate(theta_o, phi, theta_i, 0).values,
    )
    assert there == pytest.approx(back, rel=1e-12)


@pytest.mark.cases(1)
@pytest.mark.parametrize("model", MODELS)
def test_every_model_is_sound(model):
    verdicts = flake.build(colours(), index=1.524, **model).bsdf.check().attrs["verdicts"]
    assert "warn" not in verdicts
    assert "fail" not in verdicts


@pytest.mark.parametrize("model", MODELS)
def test_the_brdf_is_0_at_and_below_the_horizon(model):
    bsdf = flake.build(colours(), index=1.524, **model)
    assert (bsdf.bsdf.evaluate([90, 30, 100, 30], 0, [30, 90, 30, 120], 0).values == 0).all()
    assert np.isfinite(bsdf.bsdf.evaluate([89.9999, 30], 0, [89.9999, 89.9999], [0, 180]).values).all()


def test_a_smooth_clear_coat_mirrors_as_fresnel_says():
    bsdf = flake.build(colours(), index=1.524, model="flake-physical")
    mirrored, passed = bsdf.bsdf.specular([0, 60])
    assert mirrored.values[:, 0] == pytest.approx(optics.fresnel([1.0, 0.5], 1.524).mean)
    assert (passed.values == 0).all()


def test_a_rough_clear_coat_reflects_as_much_as_a_smooth_one():
    rough, smooth = (flake.build(colours(), index=1.524, **model) for model in (MODELS[2], MODELS[1]))
    # At 2 % slope masking is negligible.
    assert rough.bsdf.albedo([0, 45]).values == pytest.approx(smooth.bsdf.albedo([0, 45]).values, rel=1e-3)


def test_the_gloss_of_a_rough_coat_is_subtracted_from_the_measured_colours():
    bsdf = flake.build(colours(), index=1.524, model="flake-physical", clear_coat=0.05)
    lower = flake.build(colours(), index=1.524, model="flake-physical")
    assert (bsdf["flake_amplitude"].values < lower["flake_amplitude"].values).all()
    assert lab_of(bsdf, directions(colours())) == pytest.approx(np.array(list(LAB.values())), abs=1e-5)


def test_a_coat_with_more_gloss_than_the_colours_is_refused():
    with pytest.raises(InputError, match="gloss of the clear coat alone is more than a measured colour"):
        flake.build(colours(), index=1.524, model="flake-physical", clear_coat=0.3)


def test_a_synthetic_paint_is_recovered_within_3_percent():
    bsdf = flake.build(spectra(noise=0.02, seed=1), index=1.5)
    known = bsdf["theta_f_measured"].values
    theta_f = np.linspace(known.min(), known.max(), 60)
    fitted = curve(theta_f, *(bsdf[f"flake_{name}"].values for name in ("amplitude", "decay", "constant")), 1)
    assert np.median(np.abs(fitted / truth(theta_f) - 1)) < 0.03
    assert np.isfinite(bsdf["leave_one_out"].values).all()
    assert np.nanmedian(np.abs(bsdf["leave_one_out_misfit"].values)) < 0.06


def noisy(path, true, random) -> xr.Dataset:
    """A file of the reflectance of a paint at ten geometries, with random errors of the stated uncertainties."""
    at = np.array([flakes.directions(name) for name in TEN]).T
    factor = np.pi * true.bsdf.evaluate(*at).values
    u = 0.005 * factor + 0.0005
    measured = factor + u * random.standard_normal(factor.shape)
    nm = true["wavelength"].values
    titles = ["geometry", *(f"R{band:g}" for band in nm), *(f"u_{band:g}" for band in nm)]
    rows = [
        [name, *map(repr, [*row, *doubt])] for name, row, doubt in zip(TEN, measured.tolist(), u.tolist(), strict=True)
    ]
    path.write_text("\n".join(",".join(row) for row in [titles, *rows]) + "\n", encoding="ascii")
    return flakes.ingest({"file": path.name, "scale": "fraction"}, path)


@pytest.mark.cases(1)
@pytest.mark.parametrize("model", ["flake", "flake-physical"])
def test_errors_of_fitted_parameters_agree_with_their_uncertainties(tmp_path, model):
    true = flake.build(spectra(), model=model).drop_vars("flake_covariance")
    bsdf = flake.build(noisy(tmp_path / "a.csv", true, np.random.default_rng(11)), model=model)
    vocabulary.validate(bsdf, "bsdf")
    names = ("flake_amplitude", "flake_decay", "flake_constant")
    pulls = np.stack([((bsdf[name] - true[name]) / bsdf[f"{name}_u"]).values.ravel() for name in names])
    # 48 pulls know their spread to 10 % and, of three parameters that hang together, their mean to 0.2.
    assert pulls.std() == pytest.approx(1.0, abs=0.3)
    assert pulls.mean(axis=1) == pytest.approx(0.0, abs=0.75)
    # 16 of 7 degrees of freedom know their mean to 0.13.
    assert bsdf["reduced_chi_squared"].values.mean() == pytest.approx(1.0, abs=0.4)
    assert not any("uncertainties" in text for text in vocabulary.warnings(bsdf))


def test_a_form_that_does_not_hold_within_the_uncertainties_is_warned_about(tmp_path):
    multiangle = noisy(tmp_path / "a.csv", flake.build(spectra()), np.random.default_rng(3))
    bsdf = flake.build(multiangle, form="gaussian")
    assert bsdf["reduced_chi_squared"].max() > 5
    assert any("by more than their uncertainties (reduced χ² up to" in text for text in vocabulary.warnings(bsdf))


FIVE = {"45as15": 120.0, "45as25": 103.9, "45as45": 62.0, "45as75": 33.0, "45as110": 24.0}
"""L* of a paint that falls slowly at first: no sum of exponentials does."""


def five(path, u):
    rows = "\n".join(f"{name},{lightness},-1,-3,{u},{u},{u}" for name, lightness in FIVE.items())
    path.write_text(f"geometry,L,a,b,u_L,u_a,u_b\n{rows}\n", encoding="ascii")
    return flakes.ingest({"file": path.name, "illuminant": "D65", "observer": 10}, path)


def misses(bsdf):
    return [text for text in vocabulary.warnings(bsdf) if "standard uncertainties" in text]


def test_an_outlier_is_warned_about_without_degrees_of_freedom(tmp_path):
    multiangle = five(tmp_path / "a.csv", 0.3)
    bsdf = flake.build(multiangle, form="double-exponential")
    assert "reduced_chi_squared" not in bsdf
    pulls = np.abs(bsdf["misfit"].values * multiangle["tristimulus"].values / multiangle["tristimulus_u"].values)
    geometry, channel = np.unravel_index(pulls.argmax(), pulls.shape)
    (warning,) = misses(bsdf)
    assert f"misses {int((pulls > 3).sum())} of 15 values" in warning
    assert f"{'XYZ'[channel]} at {list(FIVE)[geometry]} by {pulls.max():.3g}:" in warning
    assert "`multiangle.form` (exponential, gaussian)" in warning
    assert misses(flake.build(five(tmp_path / "a.csv", 5.0), form="double-exponential")) == []


@pytest.mark.slow
@pytest.mark.parametrize(("paints", "warned"), [(2, 1), pytest.param(8, 2, marks=pytest.mark.slow)])
def test_hundreds_of_values_within_their_uncertainties_are_not_warned_about(tmp_path, paints, warned):
    warnings = [
        misses(flake.build(noisy(tmp_path / "a.csv", flake.build(spectra()), np.random.default_rng(seed))))
        for seed in range(paints)
    ]
    # One in twenty is, by chance.
    assert sum(map(bool, warnings)) <= warned


def test_three_colours_of_known_uncertainty_have_parameters_of_known_uncertainty(tmp_path):
    path = tmp_path / "a.csv"
    rows = "\n".join(f"{name},{lab[0]},{lab[1]},{lab[2]},0.1,0.1,0.1" for name, lab in LAB.items())
    path.write_text(f"geometry,L,a,b,u_L,u_a,u_b\n{rows}\n", encoding="ascii")
    bsdf = flake.build(flakes.ingest({"file": "a.csv", "illuminant": "D65", "observer": 10}, path), index=1.524)
    assert bsdf["flake_decay"].values == pytest.approx(flake.build(colours(), index=1.524)["flake_decay"].values)
    assert np.isfinite(bsdf["flake_decay_u"].values).all()
    assert "flake_decay_u" not in flake.build(colours(), index=1.524)
    assert "reduced_chi_squared" not in bsdf


def test_spectra_without_noise_return_at_any_geometry_and_wavelength():
    bsdf = flake.build(spectra(), index=1.5)
    theta_f = flakes.flake_angle(20.0, 0.0, 60.0, 140.0, 1.5)
    reflectance_factor = np.pi * bsdf.bsdf.evaluate(20, 0, 60, 140).values
    assert reflectance_factor == pytest.approx(truth(theta_f), rel=1e-8)
    between = np.pi * bsdf.bsdf.evaluate(20, 0, 60, 140, wavelength=[410.0, 700.0]).values
    assert between == pytest.approx([truth(theta_f)[:2].mean(), truth(theta_f)[-1]], rel=1e-8)


@pytest.mark.parametrize("multiangle", [colours(), spectra()], ids=["colours", "spectra"])
def test_the_mean_over_wavelength_is_the_mean_of_the_model(multiangle):
    bsdf = flake.build(multiangle, index=1.5, model="flake-physical")
    weight = np.linspace(1, 3, bsdf.sizes["wavelength"])
    mean = nonspectral(bsdf, weight)
    vocabulary.validate(mean, "bsdf")
    at = ([0.0, 30.0, 70.0], 0, [10.0, 40.0, 60.0], [0.0, 180.0, 90.0])
    expected = bsdf.bsdf.evaluate(*at).values @ (weight / weight.sum())
    assert mean.bsdf.evaluate(*at).values == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("multiangle", [colours(), spectra()], ids=["colours", "spectra"])
def test_a_flake_bsdf_is_stored_and_read_back(multiangle, tmp_path):
    bsdf = flake.build(multiangle, index=1.5)
    path = tmp_path / "flake.nc"
    store.save_dataset(bsdf, path, stage="flake", material="m", inputs={"multiangle": multiangle}, parameters={})
    again = store.open_dataset(path, "bsdf")
    at = (30, 0, 50, 170)
    assert (again.bsdf.evaluate(*at).values == bsdf.bsdf.evaluate(*at).values).all()


def test_flake_angles_that_were_not_measured_are_flagged():
    bsdf = flake.build(colours(), index=1.524)
    at = directions(colours())
    assert (representation(bsdf).quality(*at) == vocabulary.quality("measured")).all()
    flags = representation(bsdf).quality(
        np.full(3, 45.0), np.zeros(3), np.array([40.0, 10.0, 85.0]), np.array([180.0, 180.0, 0.0])
    )
    assert flags.tolist() == [vocabulary.quality(name) for name in ("extrapolated", "interpolated", "extrapolated")]
    assert "flake angles below 4.25 and above 32.1 degree" in vocabulary.warnings(bsdf)[0]


def test_a_silver_brighter_than_white_keeps_its_colours():
    labs = {"45as15": (140.0, -1.0, 2.0), "45as45": (65.0, -0.5, 0.5), "45as110": (35.0, 0.0, -1.0)}
    multiangle = colours(labs)
    bsdf = flake.build(multiangle)
    assert lab_of(bsdf, directions(multiangle)) == pytest.approx(np.array(list(labs.values())), abs=1e-5)


def test_a_green_with_a_black_flop_keeps_its_colours():
    labs = {"45as15": (60.0, -55.0, 30.0), "45as45": (20.0, -30.0, 12.0), "45as110": (1.3, -1.5, 0.5)}
    multiangle = colours(labs)
    bsdf = flake.build(multiangle)
    assert lab_of(bsdf, directions(multiangle)) == pytest.approx(np.array(list(labs.values())), abs=1e-4)


def test_a_black_paint_is_black():
    bsdf = flake.build(colours(dict.fromkeys(LAB, (0.0, 0.0, 0.0))))
    assert (bsdf.bsdf.evaluate(30, 0, [10, 80], 180).values == 0).all()


def test_an_impossible_colour_is_replaced_by_that_of_the_nearest_flake_angle():
    # X and Z fall far more slowly than Y, so that the fit leaves the spectral locus far from the gloss.
    xyz = [[30.0, 27.5, 30.0], [12.0, 2.68, 20.0], [8.0, 0.323, 16.0]]
    listed = [{"geometry": name, "xyz": colour} for name, colour in zip(LAB, xyz, strict=True)]
    bsdf = flake.build(flakes.ingest({"colours": listed, "illuminant": "D65", "observer": 10}))
    assert any("no reflectance has the fitted colour" in text for text in vocabulary.warnings(bsdf))
    assert (bsdf.bsdf.evaluate(45, 0, [0, 65, 80], 0).values > 0).all()


def test_geometries_of_equal_flake_angles_are_too_few():
    labs = {"45:-30": (30, 0, 0), "30:-45": (30, 0, 0), "45:0": (10, 0, 0)}
    with pytest.raises(InputError, match="2 in 3 geometries"):
        flake.build(colours(labs))


@pytest.mark.parametrize(
    ("options", "pattern"),
    [
        ({"index": 1.0}, "invalid refractive index"),
        ({"index": True}, "invalid refractive index"),
        ({"model": "silver"}, "unknown model.*flake, flake-physical"),
        ({"form": "cauchy"}, "unknown form"),
        ({"form": "double-exponential"}, "at least 5"),
        ({"clear_coat": "smooth"}, "would violate energy conservation"),
        ({"model": "flake-physical", "clear_coat": "matt"}, "unknown clear coat"),
        ({"model": "flake-physical", "clear_coat": 2.0}, "0.0001 to 1"),
    ],
)
def test_impossible_options_are_refused(options, pattern):
    with pytest.raises(InputError, match=pattern):
        flake.build(colours(), **options)


def test_a_paint_given_as_spectra_has_no_tristimulus_of_its_own():
    at = [np.array([v]) for v in (45.0, 0.0, 0.0, 0.0)]
    assert representation(flake.build(spectra())).tristimulus(*at, "D65", 10) is None
    assert representation(flake.build(colours())).tristimulus(*at, "A", 10) is None


def test_a_table_of_a_flake_bsdf_is_exact_at_its_nodes():
    bsdf = flake.build(colours(), index=1.524)
    table = bsdf.bsdf.tabulate({"theta_i": [0, 45], "theta_o": [0, 30, 60], "phi_o": [0, 90, 180, 270, 360]})
    assert table.bsdf.evaluate(45, 0, 30, 180).values == pytest.approx(bsdf.bsdf.evaluate(45, 0, 30, 180).values)
