from __future__ import annotations

import pytest
import xarray as xr
from samples import spectrum

from brdfpipe import vocabulary
from brdfpipe.appearance.multiple_scattering import multiple_scattering
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.facets import analytic, flat


def test_the_loss_of_the_plain_model_is_the_light_that_more_facets_reflect() -> None:
    rough = analytic("beckmann", 0.5)
    for k in (0.0, 4.0):
        index = xr.Dataset(
            {"n": ("wavelength", [1.5, 1.5]), "k": ("wavelength", [k, k])}, {"wavelength": [400.0, 700.0]}
        )
        index = vocabulary.label(index.assign_attrs(source="test"), "index")
        plain, diffuse, given = (
            multiple_scattering(microfacet.build(rough, index=index, multiple_scattering=mode))
            for mode in ("none", "compensated", "directional")
        )
        assert plain is not None
        assert diffuse is not None
        assert given is not None
        assert (plain.mode, diffuse.mode, given.mode) == ("none", "compensated", "directional")
        assert plain.mirrors == pytest.approx(diffuse.mirrors, abs=2e-5)  # the tabulated mean and the quick one
        assert plain.share == pytest.approx(given.share, rel=0.05)  # two and three reflections, by 4096 paths
        # Facets that light meets near grazing after others reflect most, if they are not metal.
        assert (plain.share > 2 * diffuse.share) == (k == 0)


def test_directional_light_of_perfect_mirrors_is_all_that_a_single_reflection_leaves() -> None:
    rough = analytic("beckmann", 0.5)
    plain = multiple_scattering(microfacet.build(rough, index=1.5, multiple_scattering="none"))
    given = multiple_scattering(microfacet.build(rough, index=1.5, multiple_scattering="directional"))
    assert plain is not None
    assert given is not None
    assert given.mode == "directional"
    assert given.mirrors == pytest.approx(plain.mirrors, abs=2e-5)


def test_a_bsdf_without_facets_has_no_multiple_scattering() -> None:
    assert multiple_scattering(lambertian(spectrum(0.3))) is None
    assert multiple_scattering(microfacet.build(flat(), index=1.5)) is None
