"""The warning where a surface is too smooth for facets."""

from __future__ import annotations

import pytest

from brdfpipe import facets, psd, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.microfacet import phase_variance


@pytest.mark.parametrize(
    ("sigma", "named"),
    [
        (0.0001, []),
        (0.013, ["0.078 at 20°", "0.022 at 60°"]),
        (0.2, ["18 at 20°", "5.2 at 60°", "0.16 at 85°"]),
        (1.0, ["4 at 85°"]),
        (5.0, []),
    ],
)
def test_facets_warn_where_the_phase_variance_is_between_mirror_and_geometrical_optics(sigma, named):
    bsdf = microfacet.build(facets.analytic("beckmann", a=0.1), index=1.5)
    found = vocabulary.warnings(phase_variance.with_warning(bsdf, psd.analytic("gaussian", sigma=sigma, length=5.0)))
    assert len(found) == bool(named)
    for text in found:
        assert "model.optics" in text
        assert text.count("°") == len(named)
        for words in named:
            assert words in text
