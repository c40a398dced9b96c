from __future__ import annotations

import re
from html.parser import HTMLParser
from itertools import combinations
from xml.etree import ElementTree

import numpy as np
import pytest
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.report import material_page
from brdfpipe.report.material import luminous_reflectance, stage_warnings

Datasets = dict[str, xr.Dataset]

_VOID = {"meta", "img", "input", "br", "link"}
_ATTACK = '"><script>alert(1)</script><img src=x onerror=alert(2)>'


class _Page(HTMLParser):
    """Collects tags, addresses and text, and refuses tags that do not nest."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.handlers: list[str] = []
        self.words: list[str] = []
        self._open: list[str] = []
        self.feed(html)
        self.close()
        assert not self._open, self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "action", "srcset", "data", "poster"):
                self.addresses.append(value or "")
            if name.startswith("on"):
                self.handlers.append(name)
        if tag not in _VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in _VOID:
            self._open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


def _figures(html: str) -> list[ElementTree.Element]:
    return [
        ElementTree.fromstring(svg)
        for svg in re.findall(r'<svg class="fig".*?</svg>(?=\s*(?:<p|</figure))', html, re.S)
    ]


def test_the_page_of_a_full_material_nests_and_shows_every_chapter(full: Datasets) -> None:
    page = _Page(material_page(full, description="Grained panel"))
    for words in (
        "abs-grain",
        "Grained panel",
        "Predicted from surface + spectrum",
        "Slope density",
        "Lambert + Gauss fit",
        "Provenance",
    ):
        assert words in page.text


def test_every_figure_is_well_formed_and_says_what_it_shows(full: Datasets) -> None:
    figures = _figures(material_page(full))
    assert len(figures) == 8
    assert all(figure.attrib["role"] == "img" and figure.attrib["aria-label"] for figure in figures)


def test_no_figure_holds_an_undefined_number(full: Datasets) -> None:
    for figure in _figures(material_page(full)):
        for element in figure.iter():
            assert not re.search(r"nan|inf\b", element.get("d", "") + element.get("x", "") + element.get("y", ""))


def test_the_page_asks_nothing_of_anybody_else(full: Datasets) -> None:
    html = material_page(full)
    page = _Page(html)
    assert all(address.startswith("data:image/png;base64,") or address == "../index.html" for address in page.addresses)
    assert not {"script", "link", "iframe", "object", "embed", "base", "form"} & set(page.tags)
    assert "default-src 'none'" in html
    assert not re.search(r"@import|url\(", html)


@pytest.mark.parametrize("place", ["name", "description", "warning", "history", "verdict", "geometry", "parameter"])
def test_what_users_wrote_never_becomes_markup(full: Datasets, place: str) -> None:
    datasets, description = dict(full), ""
    if place == "name":
        datasets = {stage: dataset.assign_attrs(material=_ATTACK) for stage, dataset in full.items()}
    elif place == "description":
        description = _ATTACK
    elif place == "warning":
        datasets["bsdf"] = vocabulary.add_warning(full["bsdf"], f"`{_ATTACK}`")
    elif place == "history":
        datasets["surface"] = vocabulary.add_history(full["surface"], _ATTACK)
    elif place == "verdict":
        datasets["checks"] = full["checks"].assign_attrs(verdicts='{"x<b>": {"verdict": "<i>", "text": "<u>"}}')
    elif place == "geometry":
        datasets["appearance"] = full["appearance"].assign_coords(geometry=[_ATTACK, "b"])
    else:
        datasets["surface"] = full["surface"].assign_attrs(parameters='{"<u>": "<i>"}', band=_ATTACK)
    page = _Page(material_page(datasets, description=description))
    assert not {"script", "img", "u"} & set(page.tags)
    assert not page.handlers


def test_equal_datasets_give_equal_bytes(full: Datasets) -> None:
    assert material_page(full, description="x") == material_page(
        {k: d.copy(deep=True) for k, d in full.items()}, description="x"
    )


def test_the_order_in_which_datasets_are_given_does_not_matter(full: Datasets) -> None:
    assert material_page(full) == material_page(dict(reversed(full.items())))


def test_the_page_is_light(full: Datasets) -> None:
    assert len(material_page(full).encode()) < 400_000


def test_any_dataset_may_be_absent(full: Datasets) -> None:
    for absent in [*combinations(full, 1), *combinations(full, 2), tuple(full), tuple(full)[1:]]:
        _Page(material_page({stage: dataset for stage, dataset in full.items() if stage not in absent}))


def test_a_material_known_by_its_colour_alone_says_that_its_finish_is_not_modelled(full: Datasets) -> None:
    text = _Page(material_page({stage: full[stage] for stage in ("spectrum", "appearance")})).text
    assert "Gloss and haze are not modelled" in text
    assert "ideally matt" in text
    assert "as if matt" in text


def test_an_assumed_finish_is_called_assumed(full: Datasets) -> None:
    text = _Page(material_page({stage: full[stage] for stage in full if stage != "surface"})).text
    assert "assumed (analytic beckmann, a = 0.2)" in text


def test_a_full_material_has_no_limits_to_tell(full: Datasets) -> None:
    assert 'id="limits"' not in material_page(full)


def test_warnings_name_their_stage_and_appear_once(full: Datasets) -> None:
    repeated = {**full, "bsdf": vocabulary.add_warning(full["bsdf"], *vocabulary.warnings(full["spectrum"]))}
    assert [(stage, text[:9]) for stage, text in stage_warnings(repeated)] == [("spectrum", "R is high")]
    assert "1 warning" in _Page(material_page(repeated)).text


def test_a_line_profile_is_drawn_as_a_line(full: Datasets, line: xr.Dataset) -> None:
    html = material_page({**full, "surface": line})
    assert "Levelled line profile" in html
    assert "Rdq" in html
    assert len(_figures(html)) == 8


def test_missing_heights_are_in_the_legend(full: Datasets) -> None:
    # 20 by 30 of 96 by 128 heights
    assert "missing heights (4.9 %)" in _Page(material_page(full)).text


def test_a_complete_map_mentions_no_missing_heights(full: Datasets) -> None:
    complete = full["surface"].assign(height=full["surface"]["height"].fillna(0.0))
    assert "missing heights" not in material_page({**full, "surface": complete})


def test_an_extrapolated_tail_is_marked(full: Datasets) -> None:
    assert "extrapolated" in _Page(material_page({"facets": full["facets"]})).text
    assert (
        "extrapolated" not in _Page(material_page({"facets": full["facets"].drop_vars("slope_density_quality")})).text
    )


def test_the_luminous_reflectance_of_a_constant_spectrum_is_that_constant(full: Datasets) -> None:
    grey = full["spectrum"].assign(total_reflectance=xr.full_like(full["spectrum"]["total_reflectance"], 0.25))
    # Y = 100 for the perfect diffuser by definition of the weights: only rounding remains.
    assert luminous_reflectance({"spectrum": grey}) == pytest.approx(0.25, rel=1e-12)


def test_the_luminous_reflectance_is_nan_without_a_spectrum(full: Datasets) -> None:
    assert np.isnan(luminous_reflectance({"facets": full["facets"]}))


def test_digests_are_shown_short_and_kept_whole(full: Datasets) -> None:
    html, digest = material_page(full), full["bsdf"].attrs["digest"]
    assert f'<code title="{digest}">{digest[:16]}</code>' in html
