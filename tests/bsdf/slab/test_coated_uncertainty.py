"""What uncertain inputs make of a coated body: beside the model built anew with the changed input."""

from __future__ import annotations

import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import facets, optics, vocabulary
from brdfpipe.appearance import compute_appearance
from brdfpipe.bsdf.change_variables import NOT_STATED
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.slab import coated
from brdfpipe.bsdf.slab.coated_uncertainty import uncertainty
from brdfpipe.bsdf.source_changes import SourceChanges
from brdfpipe.optics import interior

AT = np.array([30.0, 30.0, 60.0]), np.zeros(3), np.array([30.0, 0.0, 62.0]), np.array([180.0, 0.0, 180.0])
GREEN = np.array([550.0])
INDEX_U, INSIDE_U, SPECTRUM_U = 0.02, 0.02, 0.003


def spectrum(more: float = 0.0) -> xr.Dataset:
    given = samples.spectrum(0.3 + more)
    u = xr.full_like(given["total_reflectance"], SPECTRUM_U).drop_attrs()
    return vocabulary.label(given.assign(total_reflectance_u=u), "spectrum")


def body(inside: float) -> xr.Dataset:
    return interior.ingest({"thickness": 0.1, "internal_transmittance": inside, "transmittance_uncertainty": INSIDE_U})


def built(coat: xr.Dataset, *, n: float = 1.5, inside: float = 0.9, more: float = 0.0) -> xr.Dataset:
    return coated.build(
        coat,
        facets.analytic("beckmann", 0.2),
        coat_index=n,
        index=1.7,
        spectrum=spectrum(more),
        internal_transmittance=inside,
    )


def with_changes(bsdf: xr.Dataset, coat: xr.Dataset) -> xr.Dataset:
    changes = uncertainty(
        bsdf,
        facets=coat,
        base_facets=facets.analytic("beckmann", 0.2),
        index=optics.refractive_index(1.5, uncertainty=INDEX_U),
        base_index=optics.refractive_index(1.7),
        interior=body(0.9),
        spectrum=spectrum(),
    )
    return bsdf.merge(changes, combine_attrs="override").assign_attrs({NOT_STATED: changes.attrs[NOT_STATED]})


def scanned_facets() -> xr.Dataset:
    return facets.estimate([samples.gaussian_surface(128, correlation=4)], isotropic=True)


@pytest.fixture(scope="module")
def coat() -> xr.Dataset:
    return facets.analytic("beckmann", 0.15)


@pytest.fixture(scope="module")
def uncertain(coat: xr.Dataset) -> xr.Dataset:
    return with_changes(built(coat), coat)


@pytest.mark.parametrize(
    ("source", "changed", "sign"),
    [
        ("index", {"n": 1.5 + INDEX_U}, 1),
        ("transmittance", {"inside": 0.9 - INSIDE_U}, 1),
        ("spectrum", {"more": SPECTRUM_U}, 1),
    ],
)
def test_a_change_is_that_of_the_model_built_anew(
    coat: xr.Dataset, uncertain: xr.Dataset, source: str, changed: dict, sign: int
) -> None:
    changes = SourceChanges(uncertain)
    found = changes.of_brdf(*AT, GREEN)[list(changes.sources).index(source), :, 0]
    before, after = (
        one.bsdf.evaluate(*AT[:1], 0.0, *AT[2:], GREEN).values[:, 0] for one in (built(coat), built(coat, **changed))
    )
    # Fewer nodes of the same model: their error cancels in the difference, to a part of it.
    assert found == pytest.approx(sign * (after - before), rel=0.02, abs=2e-6)


def test_the_total_reflectance_stays_that_of_the_spectrum(uncertain: xr.Dataset) -> None:
    changes = SourceChanges(uncertain)
    of_total = dict(zip(changes.sources, changes.of_albedo(np.array([8.0]), np.zeros(1), GREEN)[:, 0, 0], strict=True))
    assert of_total["spectrum"] == pytest.approx(SPECTRUM_U, rel=1e-3)
    for source in ("index", "transmittance"):
        assert abs(of_total[source]) < 2e-5  # of coarse nodes


def test_the_mean_over_wavelength_changes_as_each_wavelength_does(uncertain: xr.Dataset) -> None:
    """Of a coated body that is the same at all wavelengths."""
    spectral = SourceChanges(uncertain).of_brdf(*AT, GREEN)[..., 0]
    mean = SourceChanges(nonspectral(uncertain)).of_brdf(*AT, None)[..., 0]
    assert mean == pytest.approx(spectral, rel=1e-3, abs=1e-7)


def test_facets_of_a_scan_and_the_inputs_that_state_nothing_are_named(coat: xr.Dataset) -> None:
    relief = scanned_facets()
    made = with_changes(built(relief), relief)
    assert "facets" in made["uncertainty_source"].values
    assert made.attrs[NOT_STATED] == "base facets, base index, model"
    computed = compute_appearance(made, gloss_angles=[60], parts=["gloss"])
    assert float(computed["gloss_u_source"].sel(source="facets")[0]) > 0
    exact = uncertainty(
        built(coat),
        facets=coat,
        base_facets=facets.analytic("beckmann", 0.2),
        index=optics.refractive_index(1.5),
        base_index=optics.refractive_index(1.7),
        interior=interior.ingest({"thickness": 0.1}),
        spectrum=samples.spectrum(0.3),
    )
    assert exact.attrs[NOT_STATED] == "facets, base facets, index, base index, transmittance, spectrum, model"


def test_a_relief_with_a_lay_that_both_faces_have_is_no_input_of_its_own(coat: xr.Dataset) -> None:
    with_lay = facets.analytic("beckmann", a_x=0.1, a_y=0.2)
    changes = uncertainty(
        built(coat),
        facets=with_lay,
        base_facets=with_lay,
        index=optics.refractive_index(1.5),
        base_index=optics.refractive_index(1.7),
        interior=interior.ingest({"thickness": 0.1}),
        spectrum=samples.spectrum(0.3),
    )
    assert changes.attrs[NOT_STATED] == "facets, index, base index, transmittance, spectrum, model"


def test_an_opaque_coat_without_uncertainty_of_its_transmittance_has_no_change_by_it(coat: xr.Dataset) -> None:
    index = {"coat_index": 1.5, "index": 1.7}
    opaque = {"thickness": 0.1, "internal_transmittance": 0, "transmittance_uncertainty": 0}
    changes = uncertainty(
        coated.build(coat, coat, **index, spectrum=samples.spectrum(0.3), internal_transmittance=0.0),
        facets=coat,
        base_facets=coat,
        index=optics.refractive_index(1.5),
        base_index=optics.refractive_index(1.7),
        interior=interior.ingest(opaque),
        spectrum=samples.spectrum(0.3),
    )
    assert changes["uncertainty_source"].values.tolist() == ["transmittance"]
    for name in changes.data_vars:
        assert not np.any(changes[name].values), name
