"""Changes of a clear sheet by its inputs: closed forms, sheets built anew, and the scatter between scans."""

import numpy as np
import pytest
import random_surfaces
import xarray as xr
from samples import beckmann

from brdfpipe import appearance, facets, optics, psd, vocabulary
from brdfpipe.bsdf import slab
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.slab import input_uncertainty, tabulation
from brdfpipe.bsdf.slab.input_uncertainty import uncertainty
from brdfpipe.bsdf.slab.wave_face import WaveSurface
from brdfpipe.bsdf.source_changes import SourceChanges
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.optics import interior

INSIDE, N_U, INSIDE_U, STEEPER = 0.8, 0.005, 0.01, 1.02


def uncertain_facets() -> xr.Dataset:
    """A Gaussian finish whose slopes are uncertain by a common factor."""
    given = beckmann(0.2)
    slope = given["slope"].values
    steeper = RadialDensity(slope, given["slope_density"].values)((slope / STEEPER) ** 2) / STEEPER**2
    change = RadialDensity(slope, np.maximum(steeper, 1e-300)).normalised().density - given["slope_density"].values
    fields = {"slope_density_change": (("uncertain_change", "slope"), change[None])}
    named = given.assign(fields).assign_coords(uncertainty_source=("uncertain_change", ["facets"]))
    return vocabulary.label(named, "facets")


def with_changes(bsdf: xr.Dataset, **inputs: xr.Dataset) -> xr.Dataset:
    """A sheet with the changes by its inputs."""
    changes = vocabulary.validate(uncertainty(bsdf, **inputs), "uncertainty")
    return vocabulary.validate(bsdf.merge(changes, combine_attrs="override"), "bsdf")


def body(index: float = 1.5, inside: float = INSIDE) -> dict[str, xr.Dataset]:
    """Index and internal transmittance, both uncertain."""
    described = {"thickness": 2.0, "internal_transmittance": inside, "transmittance_uncertainty": INSIDE_U}
    return {"index": optics.refractive_index(index, uncertainty=N_U), "interior": interior.ingest(described)}


def test_a_plate_is_uncertain_as_the_derivatives_of_its_closed_form():
    flat = facets.flat()
    plate = with_changes(slab.build(flat, flat, index=1.5, internal_transmittance=INSIDE), facets=flat, **body())

    def shares(n, inside):
        # Along the normal: F = ((n - 1)/(n + 1))^2.
        f = ((n - 1) / (n + 1)) ** 2
        reflected = f + (1 - f) ** 2 * inside**2 * f / (1 - (f * inside) ** 2)
        return np.array([reflected, (1 - f) ** 2 * inside / (1 - (f * inside) ** 2)])

    changes = SourceChanges(plate)
    normal = np.zeros(1), np.zeros(1), None
    given = np.array([changes.given.albedo(*normal), changes.given.transmittance(*normal)])[:, 0, 0]
    assert changes.sources == ("index", "transmittance")
    derivatives = [
        shares(1.5 + 1e-4, INSIDE) - shares(1.5 - 1e-4, INSIDE),
        shares(1.5, INSIDE + 1e-4) - shares(1.5, INSIDE - 1e-4),
    ]
    for changed, derivative, u in zip(changes.changed, derivatives, (N_U, INSIDE_U), strict=True):
        found = np.array([changed.albedo(*normal), changed.transmittance(*normal)])[:, 0, 0] - given
        # To first order: the curvature over one standard uncertainty is what remains.
        np.testing.assert_allclose(np.abs(found), np.abs(derivative) / 2e-4 * u, rtol=0.01)


@pytest.mark.parametrize(
    ("back", "all_nodes"),
    [(None, False), *(pytest.param("flat", each, marks=pytest.mark.slow) for each in (False, True))],
)
def test_the_inputs_change_a_sheet_as_if_it_was_built_with_them(back, all_nodes, monkeypatch):
    if all_nodes:
        monkeypatch.setattr(tabulation.Resolution, "coarser", lambda resolution: resolution)
    given, steeper = uncertain_facets(), facets.scaled(beckmann(0.2), STEEPER)
    flat = None if back is None else facets.flat()

    def built(face: xr.Dataset, **changed: float) -> xr.Dataset:
        return slab.build(face, flat or face, **({"index": 1.5, "internal_transmittance": INSIDE} | changed))

    sheet = built(given)
    found = with_changes(sheet, facets=given, back_facets=flat, **body())
    changes = SourceChanges(found)
    assert changes.sources == ("facets", "index", "transmittance")
    rebuilt = [built(steeper), built(given, index=1.5 + N_U), built(given, internal_transmittance=INSIDE - INSIDE_U)]
    theta_o = np.array([10.0, 30.0, 45.0, 60.0, 100.0, 135.0, 150.0, 175.0])
    incidence = np.array([0.0, 30.0, 70.0, 110.0, 175.0]), np.zeros(5), None
    for theta_i in (10.0, 45.0, 150.0):
        at = np.full(8, theta_i), np.zeros(8), theta_o, np.full(8, 180.0), None
        for change, wanted in zip(changes.of_brdf(*at), rebuilt, strict=True):
            difference = representation(wanted).evaluate(*at) - changes.given.evaluate(*at)
            # On the flank of a lobe, the interpolation errors of the two tables differ too.
            assert np.abs(change - difference).max() < 0.15 * np.abs(difference).max()
    for changed, wanted in zip(changes.changed, rebuilt, strict=True):
        shares = ("albedo", "transmittance")
        before = np.array([getattr(changes.given, share)(*incidence) for share in shares])
        found_change = np.array([getattr(changed, share)(*incidence) for share in shares]) - before
        wanted_change = np.array([getattr(representation(wanted), share)(*incidence) for share in shares]) - before
        largest = np.abs(wanted_change).max(axis=(1, 2), keepdims=True)
        if back == "flat" and not all_nodes:
            # Steeper facets change the albedo by a sixteenth of what they change the transmittance, and fewer nodes err in both alike.
            largest = largest.max()
        assert (np.abs(found_change - wanted_change) < 1e-6 + 0.025 * largest).all()


def test_gloss_haze_and_transmittance_of_a_sheet_are_uncertain_by_source():
    coloured = body()
    wavelength = xr.DataArray([450.0, 550.0, 650.0], dims="wavelength")
    inside = xr.DataArray([0.6, 0.8, 0.9], coords={"wavelength": wavelength}, dims="wavelength")
    given = uncertain_facets()
    sheet = slab.build(given, facets.flat(), index=1.5, internal_transmittance=inside)
    found = with_changes(sheet, facets=given, back_facets=facets.flat(), **coloured)
    seen = appearance.compute_appearance(found, haze=())
    by_source = {str(source): seen.sel(source=source) for source in seen["source"].values}
    # The body has the colour of its transmittance; a rough surface has no gloss of its own colour.
    assert float(by_source["transmittance"]["luminous_transmittance_u_source"]) == pytest.approx(
        0.93 * INSIDE_U, rel=0.05
    )
    assert float(by_source["facets"]["transmission_haze_u_source"]) > float(
        by_source["index"]["transmission_haze_u_source"]
    )
    assert float(by_source["facets"]["gloss_u_source"].sel(gloss_angle=60)) > 0
    total = float(np.sqrt(np.square(seen["transmission_haze_u_source"]).sum()))
    assert float(seen["transmission_haze_u"]) == pytest.approx(total)


def test_the_mean_over_wavelength_of_a_sheet_with_waves_keeps_its_changes_by_the_index():
    spectrum, relief = psd.analytic("gaussian", sigma=0.01, length=1.0), beckmann(0.02)
    wavelengths = np.array([500.0, 600.0])
    sheet = slab.build(
        relief, facets.flat(), index=1.5, internal_transmittance=INSIDE, front_psd=spectrum, wavelength=wavelengths
    )
    found = with_changes(sheet, facets=relief, psd=spectrum, back_facets=facets.flat(), **body())
    mean = nonspectral(found)
    normal = np.zeros(1), np.zeros(1), None
    by_source = dict(zip(SourceChanges(mean).sources, SourceChanges(mean).of_albedo(*normal), strict=True))
    spectral = dict(zip(SourceChanges(found).sources, SourceChanges(found).of_albedo(*normal), strict=True))
    for source in ("index", "transmittance"):
        assert by_source[source][0, 0] == pytest.approx(spectral[source][0, 1], rel=0.02)

    def reflected(n: float) -> float:
        # A smooth plate reflects as much along the normal: light that waves scatter is little and stays on its side.
        f = ((n - 1) / (n + 1)) ** 2
        return f + (1 - f) ** 2 * INSIDE**2 * f / (1 - (f * INSIDE) ** 2)

    change = reflected(1.5 + N_U) - reflected(1.5)
    assert by_source["index"][0, 0] == pytest.approx(change, rel=0.02)
    coherent = SourceChanges(mean)
    mirrored = [one.specular(*normal)[0][0, 0] for one in (coherent.given, coherent.changed[0])]
    assert mirrored[1] - mirrored[0] == pytest.approx(change * np.exp(-0.05), rel=0.06)


@pytest.mark.parametrize(
    ("sigma", "length", "slope", "representation_of"),
    [pytest.param(0.01, 1.0, 0.02, "wave", marks=pytest.mark.slow), (3.0, 10.0, 0.4, "microfacet")],
)
def test_a_denser_body_reflects_outside_as_if_its_face_was_built_with_it(sigma, length, slope, representation_of):
    spectrum, finish = psd.analytic("gaussian", sigma=sigma, length=length), beckmann(slope)
    given, rebuilt = (
        WaveSurface.of(finish, spectrum, optics.refractive_index(index), np.array([550.0]), "auto")
        for index in (1.5, 1.5 + N_U)
    )
    assert given.outside.attrs["representation"] == representation_of
    denser = input_uncertainty._of_denser_body(given, N_U)
    before, found, wanted = (
        one.reflection.albedo(np.array([0.0, 45.0, 70.0, 80.0, 85.0]), np.zeros(5), None)
        for one in (given, denser, rebuilt)
    )
    # Halos lose by masking as much as they did; to first order in the index.
    np.testing.assert_allclose(found - before, wanted - before, rtol=0.01)


def test_faces_of_assumed_finish_and_numbers_alone_are_exact():
    finish = beckmann(0.2)
    sheet = slab.build(finish, finish, index=1.5)
    described = interior.ingest({"thickness": 1.0})
    found = uncertainty(sheet, facets=finish, index=optics.refractive_index(1.5), interior=described)
    assert found.attrs["uncertainty_not_stated"] == "facets, index, transmittance, model"
    assert not found.data_vars


@pytest.fixture(scope="module")
def sheet_with_a_plateau() -> xr.Dataset:
    """A sheet of two faces from one scan, whose spectrum has a plateau of 50 nm that nobody stated as noise."""
    finish = beckmann(0.02)
    unresolved = psd.analytic("gaussian", sigma=1.0, length=100.0).assign(unresolved_sigma=0.05)
    sheet = slab.build(finish, finish, index=1.5, internal_transmittance=INSIDE)
    return with_changes(sheet, facets=finish, psd=unresolved, index=optics.refractive_index(1.5))


def test_roughness_that_may_hide_in_a_plateau_counts_in_the_light_straight_through(sheet_with_a_plateau):
    changes = SourceChanges(sheet_with_a_plateau)
    assert changes.sources == ("model",)
    # g = (2πσ(n − 1)/λ)² of each face along the normal.
    passed = np.exp(-2 * (2 * np.pi * 0.05 * 0.5 / 0.55) ** 2)
    straight = np.zeros(1), np.zeros(1), np.array([180.0]), np.zeros(1), None
    (changed,), given = changes.changed, changes.given
    assert changed.evaluate(*straight) == pytest.approx(passed * given.evaluate(*straight), rel=1e-9)
    # The other side too, and light that was scattered wide is as it was.
    behind = np.array([180.0]), np.zeros(1), np.zeros(1), np.zeros(1), None
    assert changed.evaluate(*behind) == pytest.approx(passed * given.evaluate(*behind), rel=1e-9)
    wide = np.zeros(1), np.zeros(1), np.array([140.0]), np.zeros(1), None
    assert changed.evaluate(*wide) == pytest.approx(given.evaluate(*wide), rel=1e-9)
    before, after = (appearance.transmission_haze(sheet_with_a_plateau, one) for one in (given, changed))
    # What leaves the lobe is haze; a part of the lobe is beyond 2.5° already.
    assert after - before == pytest.approx((1 - before) * (1 - passed), rel=1e-6)


def test_roughness_that_may_hide_in_a_plateau_counts_in_reflection_of_both_faces(sheet_with_a_plateau):
    error = sheet_with_a_plateau["relative_error"].sel(error_theta=0.0)
    wave_number, f = 2 * np.pi / 0.55, 0.04
    outer, through, inner = (1 - np.exp(-((wave_number * 0.05 * change) ** 2)) for change in (2.0, np.sqrt(0.5), 3.0))
    of_back = 1 - (1 - through) * (1 - inner)
    back = (1 - f) ** 2 * INSIDE**2
    assert float(error.sel(region="peak")) == pytest.approx((outer + back * of_back) / (1 + back), rel=1e-9)
    assert not error.sel(region="rest").any()
    mirror = np.array([[10.0], [0.0], [10.0], [180.0]])
    changes = SourceChanges(sheet_with_a_plateau)
    at_10 = float(sheet_with_a_plateau["relative_error"].sel(region="peak").interp(error_theta=10.0))
    assert changes.changed[0].evaluate(*mirror, None) == pytest.approx(
        (1 + at_10) * changes.given.evaluate(*mirror, None), rel=1e-9
    )


def test_light_from_behind_is_uncertain_by_the_roughness_of_the_face_that_it_meets_first():
    flat = facets.flat()
    sheet = slab.build(beckmann(0.02), flat, index=1.5, internal_transmittance=INSIDE)
    unresolved = psd.analytic("gaussian", sigma=1.0, length=100.0).assign(unresolved_sigma=0.05)
    inputs = {"facets": beckmann(0.02), "psd": unresolved, "back_facets": flat, "index": optics.refractive_index(1.5)}
    error = with_changes(sheet, **inputs)["relative_error"].sel(region="peak")
    outer, through, f = 1 - np.exp(-((4 * np.pi * 0.05 / 0.55) ** 2)), 2 * (np.pi * 0.05 / 0.55) ** 2, 0.04
    inside = 1 - np.exp(-((4 * np.pi * 0.05 * 1.5 / 0.55) ** 2))
    once = (1 - f) ** 2 * INSIDE**2
    assert float(error.sel(error_theta=0.0)) == pytest.approx(
        (outer + once * -np.expm1(-through)) / (1 + once), rel=1e-9
    )
    assert float(error.sel(error_theta=180.0)) == pytest.approx(once * inside / (1 + once), rel=1e-9)
    mirror = np.array([[180.0], [0.0], [180.0], [0.0]])
    changes = SourceChanges(with_changes(sheet, **inputs))
    specular = np.array([180.0]), np.zeros(1), None
    assert changes.changed[0].specular(*specular)[0] == pytest.approx(
        (1 + float(error.sel(error_theta=180.0))) * changes.given.specular(*specular)[0], rel=1e-9
    )
    assert changes.changed[0].evaluate(*mirror, None) == pytest.approx(
        (1 + float(error.sel(error_theta=180.0))) * changes.given.evaluate(*mirror, None), rel=1e-9
    )


# --- scans

SCANS, STATED = 30, 6
"""Scans whose haze is compared, and those of which the uncertainty is computed."""


def scan(seed: int, sigma: float, length: float, size: int) -> xr.Dataset:
    """A scan of one Gaussian surface."""
    height = random_surfaces.heights(random_surfaces.gaussian(sigma, length), (size, size), (0.5, 0.5), seed)
    axis = 0.5 * np.arange(float(size))
    attributes = {"pitch_x": 0.5, "pitch_y": 0.5, "levelling": "plane", "band": "0.5 um pitch"}
    return vocabulary.label(xr.Dataset({"height": (("y", "x"), height)}, {"y": axis, "x": axis}, attributes), "surface")


def haze_and_uncertainty(surface: xr.Dataset, with_waves: bool, stated: bool) -> tuple[float, float]:
    """Haze of a sheet with a scanned front and a smooth back, and its standard uncertainty from the scan, NaN unless ``stated``."""
    relief, spectrum = facets.estimate(surface, noise=0.0), psd.estimate(surface, noise=0.0) if with_waves else None
    index, flat = optics.refractive_index(1.5), facets.flat()
    waves = {"front_psd": spectrum, "wavelength": [550.0]} if with_waves else {}
    sheet = slab.build(relief, flat, index=index, internal_transmittance=0.9, **waves)
    if not stated:
        return appearance.transmission_haze(sheet, SourceChanges(nonspectral(sheet)).given), np.nan
    inputs = {"psd": spectrum} if with_waves else {}
    changes = SourceChanges(nonspectral(with_changes(sheet, facets=relief, back_facets=flat, index=index, **inputs)))
    given, *changed = (appearance.transmission_haze(sheet, one) for one in (changes.given, *changes.changed))
    return given, float(np.sqrt(np.square(np.array(changed) - given).sum()))


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "with_waves", "size"), [(0.25, False, 128), (0.06, True, 256)])
def test_the_haze_of_sheets_scatters_between_scans_as_stated(sigma, with_waves, size):
    # Scans of 16 and 32 correlation lengths, as wide as the facets and the spectrum need.
    each = SCANS // STATED
    found = [haze_and_uncertainty(scan(n, sigma, 4.0, size), with_waves, n % each == 0) for n in range(SCANS)]
    haze, u = np.transpose(found)
    ratio = np.sqrt(np.nanmean(u**2)) / haze.std(ddof=1)
    # As of opaque maps, stated over scatter is to be 0.8 to 1.3; wider by two standard deviations of the scatter of so many.
    sampling = 1 + 2 / np.sqrt(2 * (SCANS - 1))
    assert 0.8 / sampling < ratio < 1.3 * sampling, ratio
