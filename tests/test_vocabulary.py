"""The vocabulary refuses what its table of kinds does not promise, and names what is wrong."""

from __future__ import annotations

import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import VocabularyError


def test_a_sound_dataset_passes_unchanged():
    spectrum = samples.spectrum()
    assert vocabulary.validate(spectrum, "spectrum") is spectrum


def test_a_missing_variable_is_named():
    with pytest.raises(VocabularyError, match="needs the variable 'total_reflectance'"):
        vocabulary.validate(samples.spectrum().drop_vars("total_reflectance"), "spectrum")


def test_the_file_at_fault_is_named():
    with pytest.raises(VocabularyError, match=r"^grain\.nc: "):
        vocabulary.validate(samples.spectrum().drop_vars("total_reflectance"), "spectrum", "grain.nc")


def test_another_kind_is_refused():
    with pytest.raises(VocabularyError, match="expected a dataset of kind 'facets', found kind 'spectrum'"):
        vocabulary.validate(samples.spectrum(), "facets")


def test_an_unknown_kind_lists_the_known_ones():
    with pytest.raises(VocabularyError, match=r"accepted: .*surface, facets"):
        vocabulary.validate(samples.spectrum(), "spectra")


def test_wrong_units_are_refused():
    spectrum = samples.spectrum()
    spectrum["wavelength"].attrs["units"] = "um"
    with pytest.raises(VocabularyError, match="'wavelength' is in 'um', expected 'nm'"):
        vocabulary.validate(spectrum, "spectrum")


@pytest.mark.parametrize("bad", [-0.1, np.inf])
def test_values_out_of_range_are_refused(bad):
    spectrum = samples.spectrum()
    spectrum["total_reflectance"][3] = bad
    with pytest.raises(VocabularyError, match="'total_reflectance' spans"):
        vocabulary.validate(spectrum, "spectrum")


def test_missing_values_are_refused_where_the_name_does_not_allow_them():
    spectrum = samples.spectrum()
    spectrum["total_reflectance"][3] = np.nan
    with pytest.raises(VocabularyError, match="has 1 missing values"):
        vocabulary.validate(spectrum, "spectrum")


def test_missing_heights_are_allowed():
    height = np.zeros((4, 4))
    height[1, 2] = np.nan
    vocabulary.validate(samples.surface(height), "surface")


def test_wrong_dimensions_are_refused():
    bad = samples.spectrum().rename(wavelength="theta")
    bad["theta"].attrs["units"] = "degree"
    with pytest.raises(VocabularyError, match="'total_reflectance' has dimensions"):
        vocabulary.validate(bad, "spectrum")


def test_a_coordinate_that_does_not_increase_is_refused():
    with pytest.raises(VocabularyError, match="must increase strictly"):
        vocabulary.validate(samples.spectrum().isel(wavelength=slice(None, None, -1)), "spectrum")


def test_an_unknown_representation_is_refused():
    bsdf = samples.beckmann_bsdf().assign_attrs(representation="magic")
    with pytest.raises(VocabularyError, match="unknown representation 'magic'"):
        representation(bsdf)
    with pytest.raises(VocabularyError, match="unknown representation 'magic'"):
        _ = bsdf.bsdf


def test_uncertainties_take_the_units_of_their_quantity():
    dataset = vocabulary.label(samples.spectrum().assign(total_reflectance_u=0.01), "spectrum")
    assert dataset["total_reflectance_u"].attrs["units"] == "1"
    assert dataset["total_reflectance_u"].attrs["long_name"].startswith("standard uncertainty of")


def test_quality_flags_say_what_they_mean():
    dataset = vocabulary.label(xr.Dataset({"slope_density_quality": ("slope", np.zeros(3, np.int8))}), "facets")
    meanings = dataset["slope_density_quality"].attrs["flag_meanings"].split()
    assert meanings[vocabulary.quality("extrapolated")] == "extrapolated"


def test_warnings_and_history_accumulate_without_touching_the_original():
    first = samples.spectrum()
    second = vocabulary.add_warning(vocabulary.add_warning(first, "a"), "b")
    assert vocabulary.warnings(second) == ["a", "b"]
    assert vocabulary.warnings(first) == []
    assert vocabulary.add_history(vocabulary.add_history(first, "x"), "y").attrs["history"] == "x\ny"
