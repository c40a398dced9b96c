"""The figures of a refractive index: what is known, what is extrapolated, and what stands for all wavelengths."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import samples
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from brdfpipe import facets, optics, vocabulary
from brdfpipe.bsdf import microfacet, slab
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.optics.dispersion import STORED_SPAN
from brdfpipe.report import material_page
from brdfpipe.report.plots import dispersion

_ATTACK = '"><script>alert(1)</script><img src=x onerror=alert(2)>'
_LEFT, _WIDE = 0.0, 450.0
"""Of the inner drawing, figure units"""


def table(wavelength, n, k=None, **attrs) -> xr.Dataset:
    """An index by numbers."""
    n = np.broadcast_to(np.asarray(n, dtype=float), np.shape(wavelength))
    k = np.broadcast_to(np.asarray(0.0 if k is None else k, dtype=float), np.shape(wavelength))
    values = {"n": ("wavelength", n), "k": ("wavelength", k)}
    attrs = {"source": "a table", "dispersion": "table", **attrs}
    return vocabulary.label(xr.Dataset(values, {"wavelength": np.asarray(wavelength, dtype=float)}, attrs), "index")


def curves(svg: str) -> dict[str, np.ndarray]:
    """Class of each curve → its wavelengths [nm], from the drawing."""
    wavelengths = {}
    for style, data in re.findall(r'<path class="(l [^"]*)" d="([^"]*)"', svg):
        x = np.array([float(pair.split()[0]) for pair in re.findall(r"[ML]([-0-9.]+ [-0-9.]+)", data)])
        wavelengths[style] = STORED_SPAN[0] + (x - _LEFT) / _WIDE * (STORED_SPAN[1] - STORED_SPAN[0])
    return wavelengths


def test_the_extrapolated_part_is_dashed_and_meets_the_fitted_one_where_that_begins() -> None:
    (figure,) = dispersion.dispersion(optics.refractive_index("PC"))
    drawn = curves(figure.svg)
    # A tenth of a unit of the drawing is 0.1 nm.
    assert [drawn["l c3 d"].min(), drawn["l c3 d"].max()] == pytest.approx([360.0, 436.8], abs=0.2)
    assert [drawn["l c0"].min(), drawn["l c0"].max()] == pytest.approx([436.8, 830.0], abs=0.2)
    assert drawn["l ref o"] == pytest.approx([436.8, 436.8], abs=0.2)
    assert "fitted from 436.8 nm and extrapolated to 360 nm" in figure.note
    assert "Sultanova" in figure.note


def test_a_formula_valid_at_all_wavelengths_has_no_dashes_and_no_end() -> None:
    (figure,) = dispersion.dispersion(optics.refractive_index("N-BK7"))
    assert list(curves(figure.svg)) == ["l c0"]
    assert "A formula, taken from 360 to 830 nm" in figure.note


def test_a_table_ends_where_it_ends() -> None:
    (figure,) = dispersion.dispersion(table([400, 550, 700], [1.57, 1.55, 1.54]))
    drawn = curves(figure.svg)
    assert [drawn["l c0"].min(), drawn["l c0"].max()] == pytest.approx([400, 700], abs=0.2)
    assert figure.svg.count('"l ref o"') == 2
    assert [entry[2] for entry in figure.legend] == ["end of validity", "n"]


def test_a_table_far_beyond_the_visible_is_drawn_within_the_stored_range() -> None:
    (figure,) = dispersion.dispersion(table([200, 300, 500, 900, 2500], [2.6, 1.9, 1.55, 1.52, 1.40]))
    assert [curves(figure.svg)["l c0"].min(), curves(figure.svg)["l c0"].max()] == pytest.approx(STORED_SPAN, abs=0.2)
    assert "taken from 200 to 2500 nm" in figure.note
    assert "2.6" not in re.findall(r"<text[^>]*>([^<]*)</text>", figure.svg)


def test_an_extinction_table_that_starts_late_leaves_nothing_extrapolated(tmp_path: Path) -> None:
    """Wavelengths that n has and k has not are no wavelengths of the index."""
    page = tmp_path / "x.yml"
    rows = "".join(f"      {um:.2f} 0.02\n" for um in np.arange(0.40, 0.75, 0.05))
    page.write_text(
        "DATA:\n  - type: formula 2\n    wavelength_range: 0.38 1.0\n    coefficients: 0 1.2 0.012\n"
        f"  - type: tabulated k\n    data: |\n{rows}"
    )
    index = optics.refractive_index(page)
    assert "extrapolated" not in index.attrs.get("history", "")
    for figure in dispersion.dispersion(index):
        assert "l c3 d" not in curves(figure.svg)
        assert curves(figure.svg)["l c0"].min() == pytest.approx(400, abs=0.2)


@pytest.mark.parametrize(
    ("index", "words"),
    [
        (
            optics.refractive_index("ABS"),
            "n = 1.55 and k = 0 at all wavelengths. Source: ABS: patent US 9,395,299 (CRF)",
        ),
        (optics.refractive_index({"n": 2.9, "k": 3.1}), "n = 2.9 and k = 3.1 at all wavelengths."),
        (table([400, 700], 1.5), "n = 1.5 and k = 0 at all wavelengths."),
    ],
)
def test_a_constant_index_is_a_note(index: xr.Dataset, words: str) -> None:
    (figure,) = dispersion.dispersion(index)
    assert figure.svg == ""
    assert words in figure.note
    assert "lines F, d and C" not in material_page({"index": index})


BODIES = {
    "rough": lambda: samples.beckmann_bsdf(0.1, n="PC"),
    "polished": lambda: microfacet.build(facets.flat(), index="N-BK7", spectrum=samples.spectrum(0.3)),
    "metal": lambda: microfacet.build(
        facets.analytic("ggx", 0.1),
        index=table([360, 500, 600, 830], [0.5, 0.9, 1.3, 2.7], [4.3, 6.1, 7.2, 8.2]),
        multiple_scattering="none",
    ),
    "slab": lambda: slab.build(facets.flat(), facets.flat(), index="PMMA", internal_transmittance=0.9),
}


@pytest.mark.cases(2)
@pytest.mark.parametrize("body", BODIES)
def test_the_mean_index_is_that_of_the_nonspectral_model(body: str) -> None:
    bsdf = BODIES[body]()
    reduced = nonspectral(bsdf)
    neutral = dispersion._mean_index(bsdf)
    assert neutral is not None
    assert neutral.n == pytest.approx(float(reduced["n"]), rel=1e-12)
    assert neutral.k == pytest.approx(float(reduced["k"]) if "k" in reduced else 0.0, rel=1e-12)


def test_the_mean_index_is_on_the_curve_and_in_the_note() -> None:
    index = optics.refractive_index("PC")
    bsdf = samples.beckmann_bsdf(0.1, n="PC")
    (figure,) = dispersion.dispersion(index, bsdf)
    points = re.search(r'class="p c2" d="M([0-9.]+) ([0-9.]+)h0"', figure.svg)
    assert points is not None
    wavelength = STORED_SPAN[0] + float(points[1]) / _WIDE * (STORED_SPAN[1] - STORED_SPAN[0])
    mean = float(nonspectral(bsdf)["n"])
    # 0.05 of a unit of the drawing are 0.05 nm, over which n changes by 1e-5.
    assert float(np.interp(wavelength, index["wavelength"], index["n"])) == pytest.approx(mean, abs=2e-5)
    assert f"n = {mean:.4f}" in figure.note
    assert ("points", "c2", "n of colour-neutral models") in figure.legend


@pytest.mark.parametrize("n", [1.55, None])
def test_a_brdf_with_a_constant_index_has_no_mean_index(n: float | None) -> None:
    bsdf = None if n is None else samples.beckmann_bsdf(0.1, n=n)
    (figure,) = dispersion.dispersion(optics.refractive_index("PC"), bsdf)
    assert "colour-neutral" not in f"{figure.legend}{figure.note}"


@pytest.mark.parametrize(
    ("k", "label"),
    [
        ([1e-6, 2e-6, 3e-6], "k, 10⁻⁶"),
        ([4.0, 6.0, 8.0], "k"),
        ([1e-7, 1e-4, 1e-2], "k (log)"),
        ([0.0, 0.0, 2e-5], "k, 10⁻⁵"),
    ],
)
def test_the_unit_of_the_axis_of_k_follows_its_values(k: list[float], label: str) -> None:
    _, figure = dispersion.dispersion(table([400, 550, 700], [1.57, 1.55, 1.54], k))
    texts = re.findall(r"<text[^>]*>([^<]*)</text>", figure.svg)
    assert label in texts
    assert max(map(len, texts)) < 20
    assert not re.search(r"nan|inf\b", figure.svg)


def test_k_alone_may_depend_on_wavelength() -> None:
    first, second = dispersion.dispersion(table([400, 550, 700], 1.5, [0.1, 0.2, 0.3]))
    assert not re.search(r"nan|inf\b", first.svg + second.svg)


def test_a_source_never_becomes_markup_nor_ends_the_page() -> None:
    index = table([400, 550, 700], [1.57, 1.55, 1.54], source=_ATTACK)
    for shown in (index, index.assign(n=index["n"] * 0 + 1.5)):
        html = material_page({"index": shown})
        assert re.findall("<script[^>]*>", html) == ['<script type="application/ld+json">', "<script>"]
        assert "onerror=alert(2)&gt;" in html


def test_equal_indices_give_equal_figures() -> None:
    bsdf = samples.beckmann_bsdf(0.1, n="PC")
    assert dispersion.dispersion(optics.refractive_index("PC"), bsdf) == dispersion.dispersion(
        optics.refractive_index("PC").copy(deep=True), bsdf.copy(deep=True)
    )


@given(
    st.lists(st.floats(1.0, 3.0), min_size=2, max_size=12),
    st.floats(0.0, 1.0),
    st.floats(360.0, 830.0),
)
def test_a_crossing_is_on_the_curve(values: list[float], share: float, about: float) -> None:
    curve = np.array(values)
    wavelength = np.linspace(360.0, 830.0, curve.size)
    value = float(curve.min() + share * np.ptp(curve))
    crossing = dispersion._crossing(wavelength, curve, value, about)
    assert 360.0 <= crossing <= 830.0
    # Steps of the curve times the rounding of wavelengths of some hundred nm.
    assert float(np.interp(crossing, wavelength, curve)) == pytest.approx(value, abs=1e-11)
