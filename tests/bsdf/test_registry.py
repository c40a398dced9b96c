"""A dataset is prepared once, and never evaluated by what was prepared for another one."""

from __future__ import annotations

import gc
import pickle
import weakref

import numpy as np
import pytest
import samples
import synthetic
import xarray as xr

import brdfpipe
from brdfpipe import facets, psd, store, vocabulary
from brdfpipe.bsdf import kirchhoff, microfacet, registry, slab, traced, wave
from brdfpipe.bsdf.checks import check
from brdfpipe.bsdf.microfacet.model import Model
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import REPRESENTATIONS, representation
from brdfpipe.bsdf.representations.slab import SlabModel
from brdfpipe.bsdf.source_changes import SourceChanges
from brdfpipe.errors import VocabularyError

_ERROR = xr.DataArray(
    np.full((2, 3), 0.1), dims=("error_theta", "region"), coords={"error_theta": [0.0, 60.0]}, name="relative_error"
)
_SMALL_HEIGHTS = np.random.default_rng(1).normal(0.0, 0.02, (64, 64))

AT = (30.0, 0.0, [10.0, 30.0, 50.0], 180.0)


def counted(monkeypatch, prepared, name):
    """The list to which every call of a class method is added."""
    calls, original = [], getattr(prepared, name).__func__

    def counting(cls, *arguments):
        calls.append(arguments)
        return original(cls, *arguments)

    monkeypatch.setattr(prepared, name, classmethod(counting))
    return calls


@pytest.mark.parametrize(
    ("make", "prepared", "name"),
    [
        (samples.beckmann_bsdf, Model, "of"),
        (lambda: microfacet.build(facets.flat(), index=1.5, spectrum=samples.spectrum()), Model, "of"),
        (lambda: slab.build(facets.flat(), facets.flat(), index=1.5), SlabModel, "of"),
    ],
    ids=["microfacet", "smooth", "slab"],
)
def test_repeated_evaluations_prepare_a_dataset_once(monkeypatch, make, prepared, name):
    bsdf = make()
    calls = counted(monkeypatch, prepared, name)
    first = bsdf.bsdf.evaluate(*AT)
    for _ in range(5):
        assert bsdf.bsdf.evaluate(*AT).identical(first)
        bsdf.bsdf.albedo(45.0)
    assert len(calls) == 1


def test_a_table_builds_its_interpolators_once(monkeypatch):
    from scipy import interpolate

    table = samples.beckmann_bsdf(0.3, reflectance=None).bsdf.tabulate(
        {"theta_i": [0.0, 45.0, 80.0], "theta_o": [0.0, 45.0, 90.0], "phi_o": [0.0, 90.0, 180.0]}
    )
    made, original = [], interpolate.RegularGridInterpolator
    monkeypatch.setattr(interpolate, "RegularGridInterpolator", lambda *given: made.append(None) or original(*given))
    for _ in range(3):
        table.copy().bsdf.evaluate(*AT)
    per_dataset = len(made) // 3
    made.clear()
    for _ in range(3):
        table.bsdf.evaluate(*AT)
    assert len(made) == per_dataset


def test_each_set_of_wavelengths_is_prepared_once(monkeypatch):
    bsdf = samples.beckmann_bsdf()
    calls = counted(monkeypatch, Model, "of")
    for _ in range(3):
        for wavelength in (None, [450.0, 550.0], [550.0]):
            bsdf.bsdf.evaluate(*AT, wavelength)
    assert len(calls) == 3


def test_a_changed_variable_or_attribute_is_noticed():
    bsdf = samples.beckmann_bsdf(reflectance=0.3)
    before = bsdf.bsdf.evaluate(*AT)
    bsdf["diffuse"] = bsdf["diffuse"] * 0
    assert (bsdf.bsdf.evaluate(*AT) < before).all()
    instance = representation(bsdf)
    bsdf.attrs["masking"] = "separable"
    assert representation(bsdf) is not instance
    assert not bsdf.bsdf.evaluate(*AT).identical(before)


def test_an_unknown_representation_is_refused_with_the_accepted_ones(tmp_path):
    # `vocabulary.validate` accepts it: a stage that passes a BSDF on does not import its representation.
    bsdf = vocabulary.validate(samples.beckmann_bsdf().assign_attrs(representation="magic"), "bsdf")
    store.save_dataset(bsdf, tmp_path / "bsdf.nc", stage="bsdf", material="magic")
    message = "unknown representation 'magic' of a BSDF; accepted: coated, flake, kirchhoff, lambert_gauss, rig, microfacet, slab, smooth, table, traced"
    for use in (
        lambda: brdfpipe.open_dataset(tmp_path / "bsdf.nc"),
        lambda: bsdf.bsdf.evaluate(*AT),
        lambda: nonspectral(bsdf, np.ones(samples.WAVELENGTH.size)),
        lambda: check(bsdf),
    ):
        with pytest.raises(VocabularyError, match=message):
            use()


def test_copies_are_prepared_anew():
    bsdf = samples.beckmann_bsdf(reflectance=0.3)
    brighter = bsdf.assign(diffuse=bsdf["diffuse"] * 2)
    assert representation(bsdf) is representation(bsdf)
    assert representation(bsdf.copy()) is not representation(bsdf)
    assert (brighter.bsdf.evaluate(*AT) > bsdf.bsdf.evaluate(*AT)).all()


@pytest.mark.parametrize(
    "make",
    [
        samples.beckmann_bsdf,
        lambda: wave.build(psd.analytic("gaussian", sigma=0.03, length=5.0), index=1.5, spectrum=samples.spectrum()),
        lambda: traced.build(samples.gaussian_surface(64), index=1.5, rays=2000),
        lambda: kirchhoff.build(samples.surface(_SMALL_HEIGHTS, (0.5, 0.5)), index=1.5, wavelength=[550.0]),
    ],
    ids=["microfacet", "wave", "traced", "kirchhoff"],
)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_prepared_representation_is_deleted_with_its_dataset(make):
    # A worker prepares tens of megabytes for each material, and cyclic garbage may wait for many of them.
    # The accessor `.bsdf` is cached by xarray in the dataset to which it refers, so it is not used here.
    bsdf = make().assign(relative_error=_ERROR)
    mean = nonspectral(bsdf)
    changes = [SourceChanges.of(one) for one in (bsdf, mean)]
    assert [one.of_brdf(*map(np.asarray, AT), None).any() for one in changes] == [True, True]
    key, prepared = id(bsdf), [weakref.ref(representation(one)) for one in (bsdf, mean)]
    assert key in registry._CACHE
    gc.collect()
    gc.disable()
    try:
        del bsdf, mean, changes
        assert [one() for one in prepared] == [None, None]
    finally:
        gc.enable()
    assert key not in registry._CACHE


def test_an_entry_of_another_dataset_under_the_same_id_is_not_used():
    first, second = samples.beckmann_bsdf(reflectance=0.2), samples.beckmann_bsdf(reflectance=0.6)
    representation(first)
    # As if the second dataset had taken the place of the first one in memory.
    registry._CACHE[id(second)] = registry._CACHE[id(first)]
    assert representation(second) is not representation(first)


def test_an_evaluated_dataset_can_be_pickled():
    bsdf = samples.beckmann_bsdf()
    before = bsdf.bsdf.evaluate(*AT)
    size = len(pickle.dumps(bsdf.copy()))
    again = pickle.loads(pickle.dumps(bsdf))
    assert again.bsdf.evaluate(*AT).identical(before)
    assert len(pickle.dumps(bsdf)) < 3 * size


def test_each_representation_registers_its_kind():
    assert {name: kind.kind for name, kind in REPRESENTATIONS.items()} == vocabulary.REPRESENTATIONS
    assert all(name == kind.name for name, kind in REPRESENTATIONS.items())


def test_a_representation_needs_no_more_than_its_values(monkeypatch):
    bsdf = synthetic.register(monkeypatch, lambda w_i, w_o: np.full(w_i.shape[:-1], 0.5 / np.pi))
    assert float(bsdf.bsdf.albedo(30.0)) == pytest.approx(0.5, rel=1e-6)
    assert float(bsdf.bsdf.transmittance(30.0)) == 0.0
    assert bsdf.bsdf.mueller(30.0, 0.0, 20.0, 180.0).values[..., 0, 0] == pytest.approx(0.5 / np.pi)
    drawn = bsdf.bsdf.sample(100, 1, 30.0)
    assert float(drawn["weight"].mean()) == pytest.approx(0.5, abs=4 * np.sqrt(float(drawn["weight_variance"]) / 100))
    assert bsdf.bsdf.check().attrs["kind"] == "checks"
    evaluator = representation(bsdf)
    assert evaluator.lobe_slope is None
    assert [evaluator.states_quality, evaluator.states_uncertainty, evaluator.transmits] == [False, False, False]
    assert evaluator.without_diffuse() is None
