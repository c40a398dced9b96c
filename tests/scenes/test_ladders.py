"""Ladders of the model, and the candidates that differ for a material."""

import pytest

from brdfpipe.scenes.ladders import FULLEST, LADDERS, Candidate, structures


def test_the_last_rung_of_every_ladder_leaves_nothing_out_and_every_other_says_what():
    for ladder in LADDERS.values():
        assert ladder[-1].leaves_out == ""
        assert all(rung.leaves_out for rung in ladder[:-1])
    assert FULLEST.rungs == {name: ladder[-1].name for name, ladder in LADDERS.items()}
    assert FULLEST.leaves_out == ()


def test_a_material_with_everything_has_candidates_from_lambert_to_the_fullest():
    found = structures(surface=True, heights=True, spectrum_known=True, lay=True, waves=True)
    assert found[0].distribution == "lambert"
    assert FULLEST in found
    assert len(set(found)) == len(found)


@pytest.mark.parametrize("missing", ["heights", "waves", "lay"])
def test_a_rung_that_a_material_cannot_have_is_no_candidate(missing):
    known = dict.fromkeys(("surface", "heights", "spectrum_known", "lay", "waves"), True) | {missing: False}
    found = structures(**known)
    assert FULLEST in found
    if missing == "heights":
        assert {one.masking for one in found if one.distribution == "counted" and one.optics != "wave"} == {"auto"}
    if missing == "waves":
        assert {one.optics for one in found if one.distribution == "counted"} == {"auto"}
    if missing == "lay":
        assert "isotropic" not in {one.distribution for one in found}


def test_a_candidate_is_named_by_what_it_leaves_out():
    assert str(FULLEST) == "fullest"
    assert str(Candidate(optics="facets", multiple_scattering="none")) == "optics facets, multiple scattering none"
    assert len(Candidate(optics="facets", multiple_scattering="none").leaves_out) == 2
    assert Candidate("lambert", "facets", "height-correlated", "none").leaves_out == (
        "all gloss: the total reflectance is diffuse",
    )
