from __future__ import annotations

import base64
import io
import json
import re
from collections.abc import Iterable, Mapping
from html.parser import HTMLParser
from itertools import combinations
from xml.etree import ElementTree

import numpy as np
import pytest
import samples
import xarray as xr
from PIL import Image

from brdfpipe import flakes, optics, vocabulary
from brdfpipe.appearance import compute_appearance
from brdfpipe.appearance.quantities import quantity
from brdfpipe.appearance.verdicts import overall, stage_warnings, verdicts
from brdfpipe.bsdf import flake, microfacet
from brdfpipe.exchange.registry import FORMATS, Format
from brdfpipe.facets import analytic, flat
from brdfpipe.report import material_page
from brdfpipe.report.catalogue.rows import summarise
from brdfpipe.report.plots import bsdf_cuts, directional_maps
from brdfpipe.spectra import recover

Datasets = dict[str, xr.Dataset]

_VOID = {"meta", "img", "input", "br", "link"}
_ATTACK = '"><script>alert(1)</script><img src=x onerror=alert(2)>'

SCRIPTS = 3
"""Two elements of data, for machines and for the viewer, and the script of the viewer, the only one that the policy of the page lets run."""


@pytest.fixture(scope="module")
def full_page(full: Datasets) -> str:
    return material_page(full)


@pytest.fixture
def without_bsdf_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves out the figures that take long and depend on the BSDF alone."""
    monkeypatch.setattr(bsdf_cuts, "cuts", lambda bsdf: [])
    monkeypatch.setattr(directional_maps, "directional_maps", lambda bsdf: [])
    monkeypatch.setattr(directional_maps, "polarisation", lambda bsdf: None)


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


def test_the_page_of_a_full_material_nests_and_shows_every_section(full: Datasets) -> None:
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


def test_every_figure_is_well_formed_and_described(full_page: str) -> None:
    figures = _figures(full_page)
    assert len(figures) == 12
    assert all(figure.attrib["role"] == "img" and figure.attrib["aria-label"] for figure in figures)


def test_no_figure_contains_nan(full_page: str) -> None:
    for figure in _figures(full_page):
        for element in figure.iter():
            assert not re.search(r"nan|inf\b", element.get("d", "") + element.get("x", "") + element.get("y", ""))


def test_the_page_requests_nothing_from_elsewhere(full_page: str) -> None:
    html = full_page
    page = _Page(html)
    # The catalogue and the exported files are links to what lies beside the page; following one is up to the reader.
    beside = re.compile(r"\.\./index\.html|exports/[^/:]+")
    assert all(
        address.startswith(("data:image/png;base64,", "#")) or beside.fullmatch(address) for address in page.addresses
    )
    assert page.tags.count("script") == SCRIPTS
    assert not {"link", "iframe", "object", "embed", "base", "form"} & set(page.tags)
    assert "default-src 'none'" in html
    assert not re.search(r"@import|url\(", html)


@pytest.mark.usefixtures("without_bsdf_figures")
@pytest.mark.parametrize("place", ["name", "description", "warning", "history", "verdict", "geometry", "parameter"])
def test_text_of_users_never_becomes_markup(full: Datasets, place: str) -> None:
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
    assert page.tags.count("script") == SCRIPTS
    assert not {"img", "u"} & set(page.tags)
    assert not page.handlers


def test_equal_datasets_give_equal_bytes(full: Datasets) -> None:
    assert material_page(full, description="x") == material_page(
        {k: d.copy(deep=True) for k, d in full.items()}, description="x"
    )


@pytest.mark.usefixtures("without_bsdf_figures")
def test_stages_are_shown_in_the_order_given(full: Datasets) -> None:
    for datasets in (full, dict(reversed(full.items()))):
        shown = re.findall(r"<h3>([^<]+)</h3>\n\s*<dl>", material_page(datasets))
        assert shown == [stage.replace("_", " ") for stage in datasets]


def test_the_page_is_small(full_page: str) -> None:
    assert len(full_page.encode()) < 400_000


def test_any_dataset_may_be_absent(full: Datasets) -> None:
    for absent in [*combinations(full, 1), tuple(full), tuple(full)[1:]]:
        _Page(material_page({stage: dataset for stage, dataset in full.items() if stage not in absent}))


@pytest.mark.usefixtures("without_bsdf_figures")
def test_any_two_datasets_may_be_absent(full: Datasets) -> None:
    for absent in combinations(full, 2):
        _Page(material_page({stage: dataset for stage, dataset in full.items() if stage not in absent}))


@pytest.mark.usefixtures("without_bsdf_figures")
def test_every_exported_file_is_listed_with_its_error_and_every_refused_one_with_its_reason(
    full: Datasets, monkeypatch: pytest.MonkeyPatch
) -> None:
    toy = Format("rays that <toys> read", {"reflection": {"write": (".toy", ".toy.csv")}}, name="toy")
    monkeypatch.setitem(FORMATS, "toy", toy)
    error = {"percentile_95": 0.0123, "albedo": 0.001}
    left_out = {
        "polarisation": "of unpolarised light",
        "gamut": "negative values",
        "reciprocity": "the mean of both orders",
    }
    record = {"error": error, "left_out": left_out}
    astm_export = _export("astm", FORMATS["astm"].suffixes("reflection"), record)
    refused = _export("gltf", [], {}).assign_attrs(warnings='["export gltf not written: the surface has a <lay>"]')
    exports = {
        "export_astm": astm_export,
        "export_toy": _export("toy", [".toy", ".toy.csv"], {}),
        "export_gltf": refused,
    }
    html = material_page(full | exports)
    assert "1.23% at the 95th percentile" in html
    assert (
        html.count("export gltf not written: the surface has a &lt;lay&gt;") == 2
    )  # in the table and among the warnings
    rows = re.findall(r'<th scope="row">(abs-grain\.[^<]*)</th><td>reflection</td><td class="words">([^<]*)</td>', html)
    astm = ", ".join(f"abs-grain{suffix}" for suffix in FORMATS["astm"].suffixes("reflection"))
    assert rows == [
        (astm, FORMATS["astm"].description),
        ("abs-grain.toy, abs-grain.toy.csv", "rays that &lt;toys&gt; read"),
        ("abs-grain.lambert_gauss.csv", "parameters of the Lambert + Gauss fit"),
    ]
    assert "Mueller matrices; colours outside sRGB; differences between both orders of the directions" in html
    assert "Exported files" not in material_page({"spectrum": full["spectrum"]})


def _export(format: str, suffixes: Iterable[str], record: Mapping[str, object]) -> xr.Dataset:
    files = {f"abs-grain{suffix}": "0" for suffix in suffixes}
    records = dict.fromkeys(list(files)[:1], record)
    attributes = {"format": format, "side": "reflection", "files": json.dumps(files), "records": json.dumps(records)}
    return xr.Dataset(attrs={"kind": "export", "material": "abs-grain", **attributes})


@pytest.mark.usefixtures("without_bsdf_figures")
def test_the_page_links_to_its_datasets_and_exported_files(full: Datasets) -> None:
    files = {"export_toy": "../a/export_toy.nc", "surface": "../a/surface.nc", "bsdf": '../"><b>/bsdf.nc'}
    page = material_page(full | {"export_toy": _export("toy", [".toy"], {})}, files=files)
    links = re.findall(r'<a href="([^"#]*)">', page[page.index('id="downloads"') :])
    assert links[:2] == ["../%22%3E%3Cb%3E/bsdf.nc", "../a/surface.nc"]
    assert links[2:] == ["exports/abs-grain.toy", "exports/abs-grain.lambert_gauss.csv"]
    assert 'href="#downloads"' in page
    assert "downloads" not in re.sub("<style>.*?</style>", "", material_page({"index": full["index"]}), flags=re.S)


def test_the_limits_of_a_material_known_only_by_its_colour_name_the_finish(full: Datasets) -> None:
    text = _Page(material_page({stage: full[stage] for stage in ("spectrum", "appearance")})).text
    assert "Gloss and haze are not modelled" in text
    assert "The BRDF is perfectly diffuse." in text


@pytest.mark.usefixtures("without_bsdf_figures")
def test_an_assumed_finish_is_called_assumed(full: Datasets) -> None:
    text = _Page(material_page({stage: full[stage] for stage in full if stage != "surface"})).text
    assert "assumed (analytic beckmann, a = 0.2)" in text


def test_a_key_that_nothing_uses_is_among_the_limits(full: Datasets, without_bsdf_figures: None) -> None:
    page = material_page(full, unused={"index": "the BRDF is that of `multiangle`"})
    assert "<code>index</code> of material.yaml is not used: the BRDF is that of <code>multiangle</code>." in page


def test_a_full_material_has_no_limits(full_page: str) -> None:
    assert 'id="limits"' not in full_page


@pytest.mark.usefixtures("without_bsdf_figures")
def test_warnings_name_their_stage_and_appear_once(full: Datasets) -> None:
    repeated = {**full, "bsdf": vocabulary.add_warning(full["bsdf"], *vocabulary.warnings(full["spectrum"]))}
    assert [(stage, text[:9]) for stage, text in stage_warnings(repeated)] == [("spectrum", "R is high")]
    assert "1 warning" in _Page(material_page(repeated)).text


def test_a_line_profile_is_drawn_as_a_line(full: Datasets, line: xr.Dataset) -> None:
    html = material_page({**full, "surface": line})
    assert "Levelled line profile" in html
    assert "Rdq" in html
    assert len(_figures(html)) == 12


def test_missing_heights_are_in_the_legend(full_page: str) -> None:
    # 20 by 30 of 96 by 128 heights
    assert "missing heights (4.9 %)" in _Page(full_page).text


@pytest.mark.usefixtures("without_bsdf_figures")
def test_a_complete_map_mentions_no_missing_heights(full: Datasets) -> None:
    complete = full["surface"].assign(height=full["surface"]["height"].fillna(0.0))
    assert "missing heights" not in material_page({**full, "surface": complete})


def test_an_extrapolated_tail_is_marked(full: Datasets) -> None:
    assert "extrapolated" in _Page(material_page({"facets": full["facets"]})).text
    assert (
        "extrapolated" not in _Page(material_page({"facets": full["facets"].drop_vars("slope_density_quality")})).text
    )


def test_digests_are_shown_short_with_the_whole_as_tooltip(full: Datasets, full_page: str) -> None:
    html, digest = full_page, full["bsdf"].attrs["digest"]
    assert f'<code title="{digest}">{digest[:16]}</code>' in html


def _tiles(html: str) -> dict[str, str]:
    """Name and value of every key number, the unit included."""
    tiles = re.findall(r"<dt>(.*?)</dt><dd><span class=\"value\">(.*?)</span>", html)
    return {name: re.sub("<[^>]*>", "", value) for name, value in tiles}


def _with_gloss(datasets: Datasets, **gloss: float) -> Datasets:
    """The material with other gloss units: g20=…, g60=…, g85=…"""
    angles = [float(name[1:]) for name in gloss]
    appearance = datasets["appearance"].drop_dims("gloss_angle").assign_coords(gloss_angle=angles)
    haze = gloss.get("g60", np.nan) - gloss.get("g20", np.nan)
    return {**datasets, "appearance": appearance.assign(gloss=("gloss_angle", list(gloss.values())), haze=haze)}


@pytest.mark.usefixtures("without_bsdf_figures")
def test_haze_of_a_high_gloss_film_is_shown_by_its_standard(full: Datasets) -> None:
    html = material_page(_with_gloss(full, g20=80.0, g60=92.0))
    assert _tiles(html)["Haze D4039"] == "12.0 GU"
    assert '<th scope="row">Haze D4039</th><td>12.0</td>' in html


@pytest.mark.usefixtures("without_bsdf_figures")
@pytest.mark.parametrize("g60", [30.0, 70.0])
def test_at_lower_gloss_the_difference_is_not_called_haze(full: Datasets, g60: float) -> None:
    html = material_page(_with_gloss(full, g20=10.0, g60=g60))
    assert "Haze D4039" not in _tiles(html)
    assert "D4039" not in html
    assert '<th scope="row">G60 − G20</th>' in html


@pytest.mark.usefixtures("without_bsdf_figures")
@pytest.mark.parametrize("gloss", [{"g85": 49.0}, {"g60": 90.0}, {"g20": 80.0, "g85": 49.0}])
def test_without_both_angles_there_is_no_haze(full: Datasets, gloss: dict[str, float]) -> None:
    html = material_page(_with_gloss(full, **gloss))
    names = [name for name in _tiles(html) if name.startswith(("Gloss", "Haze"))]
    assert names == [f"Gloss {name[1:]}°" for name in gloss]
    assert "G60 − G20" not in html
    assert '<th scope="row">haze' not in html.lower()


@pytest.mark.usefixtures("without_bsdf_figures")
def test_a_metal_has_no_haze_by_a_standard_for_nonmetallic_surfaces(full: Datasets) -> None:
    metal = microfacet.build(
        full["facets"], index=optics.refractive_index({"n": 2.9, "k": 3.1}), multiple_scattering="none"
    )
    html = material_page({**_with_gloss(full, g20=1100.0, g60=200.0), "bsdf": metal})
    assert "Haze D4039" not in _tiles(html)
    assert "D4039" not in html
    assert '<th scope="row">G60 − G20</th><td>−900.0</td>' in html


@pytest.mark.usefixtures("without_bsdf_figures")
@pytest.mark.parametrize(
    ("options", "remedy"),
    [
        ({}, "Set <code>multiangle.model: flake-physical</code>"),
        ({"model": "flake-physical", "clear_coat": "none"}, "Set <code>multiangle.clear_coat: smooth</code>"),
    ],
)
def test_the_page_of_flakes_without_a_gloss_lobe_states_the_remedy(options: dict[str, str], remedy: str) -> None:
    colours = {"45:-30": [33.90, -7.58, -36.61], "45:0": [12.29, 1.19, -25.77], "45:65": [3.07, 2.09, -13.24]}
    listed = [{"geometry": name, "lab": lab} for name, lab in colours.items()]
    measured = flakes.ingest({"colours": listed, "illuminant": "D65", "observer": 10})
    bsdf = flake.build(measured, **options).assign_attrs(route="flake")
    html = material_page({"multiangle": measured, "flake": bsdf, "bsdf": bsdf, "appearance": compute_appearance(bsdf)})
    assert not [name for name in _tiles(html) if name.startswith(("Gloss", "Haze"))]
    assert '<th scope="row">Gloss 20°, Gloss 60°, Gloss 85°</th><td>not modelled</td>' in html
    table = re.search(r"<h3>Gloss</h3>.*?<p class=\"note\">(.*?)</p>", html, re.S)
    assert table is not None
    assert "has no gloss lobe" in table[1]
    assert remedy in table[1]
    assert "Haze (" not in html


def test_a_stage_with_a_warning_is_a_verdict_but_no_check(full_page: str) -> None:
    html = full_page
    badges = re.search(r'<ul class="badges".*?</ul>', html, re.S)
    checks = re.search(r'<ul class="verdicts">.*?</ul>', html, re.S)
    assert badges is not None
    assert checks is not None
    assert '<b aria-hidden="true">!</b> spectrum' in badges[0]
    assert "spectrum" not in checks[0]


def test_a_material_without_a_finish_has_no_gloss_tile_but_a_remark(full: Datasets) -> None:
    html = material_page({stage: full[stage] for stage in ("spectrum", "appearance")})
    assert not [name for name in _tiles(html) if name.startswith(("Gloss", "Haze"))]
    assert '<th scope="row">Gloss 20°, Gloss 60°, Gloss 85°</th><td>not modelled</td>' in html


@pytest.mark.usefixtures("without_bsdf_figures")
def test_the_spectrum_of_a_specular_excluded_measurement_is_labelled(full: Datasets) -> None:
    excluded = full["spectrum"].assign_attrs(geometry="sce")
    bsdf = microfacet.build(full["facets"], index=full["index"], spectrum=excluded, multiple_scattering="none")
    text = _Page(material_page({**full, "spectrum": excluded, "bsdf": bsdf})).text
    assert "measured, specular excluded" in text
    assert "total reflectance" in text


@pytest.mark.usefixtures("without_bsdf_figures")
def test_the_tile_of_total_reflectance_is_under_d65_whatever_the_illuminant_of_lab(full: Datasets) -> None:
    appearance = full["appearance"].assign(luminous_reflectance=0.171).assign_attrs(illuminant="A", observer=2)
    html = material_page({**full, "appearance": appearance})
    assert re.search(r"<dt>Total reflectance</dt><dd>.*?17\.1<small> %</small>.*?V\(λ\), D65", html)
    assert re.search(r"<dt>L\* a\* b\*</dt><dd>.*?8:total, A/2°", html)


def test_a_value_stays_on_one_line_with_its_unit(full_page: str) -> None:
    html = full_page
    assert ".facts dt,.value{white-space:pre}" in html
    assert _tiles(html)["L* a* b*"] == "45.2  41.0  27.2"


@pytest.mark.usefixtures("without_bsdf_figures")
def test_the_verdict_of_the_table_joins_those_of_the_checks(full: Datasets) -> None:
    table = xr.Dataset(attrs={"verdicts": json.dumps({"table": {"verdict": "fail", "text": "too coarse at 85°"}})})
    entries = verdicts({**full, "table": table})
    assert [(entry.name, entry.verdict) for entry in entries] == [
        ("reciprocity", "pass"),
        ("energy", "warn"),
        ("table", "fail"),
        ("spectrum", "warn"),
    ]
    assert "too coarse at 85°" in _Page(material_page({**full, "table": table})).text
    assert "too coarse at 85°" in _Page(material_page({"table": table})).text
    assert verdicts({"table": xr.Dataset()}) == []


@pytest.mark.usefixtures("without_bsdf_figures")
def test_a_remark_names_the_incidences_of_a_poor_fit(full: Datasets, full_page: str) -> None:
    poor = full["lambert_gauss"].assign(fit_residual=("theta_i", [0.1, 0.25, 0.6]))
    text = _Page(material_page({**full, "lambert_gauss": poor})).text
    assert "Residual above 20 % at 30°, 60°: the lobe is not a Gaussian there" in text
    assert "not a Gaussian" not in full_page  # its worst residual is 20 % exactly


@pytest.mark.usefixtures("without_bsdf_figures")
def test_facets_with_a_lay_are_shown_with_their_lay(full: Datasets) -> None:
    brushed = analytic("beckmann", a_x=0.2, a_y=0.5, azimuth=30.0)
    html = material_page({**full, "facets": brushed})
    assert _tiles(html)["Anisotropy"] == "2.50"
    assert "Rms slope 0.141 along the lay, 0.354 across it." in html
    for figure in _figures(html):
        ElementTree.tostring(figure)
    assert "nan" not in "".join(re.findall(r' d="([^"]*)"', html))


@pytest.mark.usefixtures("without_bsdf_figures")
def test_the_page_of_facets_with_a_lay_is_small(full: Datasets) -> None:
    assert len(material_page({**full, "facets": analytic("ggx", a_x=0.05, a_y=0.2)}).encode()) < 400_000


@pytest.mark.usefixtures("without_bsdf_figures")
def test_the_error_of_the_prediction_is_shown_where_a_reference_holds(full: Datasets, full_page: str) -> None:
    text = _Page(material_page({**full, "model_error": _model_error()})).text
    assert "Prediction against reference solutions" in text
    assert "20° 75.00 –" in text
    assert "75° 0.700 ± 0.010 0.610" in text
    assert "−1.50 ± 0.10" in text
    assert "75° 30 Traced rays −10.0 % ± 1.0 % 1.0 % ± 1.0 % –" in text.replace("\u202f", " ")
    assert "0° 5.0e+2" not in text  # no reference holds there
    assert "500 Traced" not in text
    assert "Diffraction: the map is too coarse." in text
    assert "reference solutions" not in _Page(full_page).text


@pytest.mark.usefixtures("without_bsdf_figures")
def test_the_verdict_and_its_reason_are_at_the_top_as_in_the_catalogue(full: Datasets) -> None:
    page, row = _Page(material_page(full)).text, summarise(full)
    verdict, reason = (str(row[name].values[0]) for name in ("verdict", "verdict_text"))
    assert f"! {verdict} for {reason.replace('`', '')}"[:30] in page.replace(" : ", ": ")
    assert page.index(f"! {verdict} for") < page.index("Gloss 60°")


@pytest.mark.usefixtures("without_bsdf_figures")
def test_a_reason_of_the_verdict_is_worded_once_and_linked_at_the_top(full: Datasets) -> None:
    noisy = vocabulary.add_warning(full["facets"], "the slopes hold more noise than surface")
    known = {name: full[name] for name in full if name != "checks"} | {"facets": noisy, "model_error": _model_error()}
    html = material_page(known)
    reasons = overall(known)[1]
    assert {entry.of for entry in reasons} == {"condition", "stage"}
    top = html[: html.index('class="badges"')]
    for entry in reasons:
        anchor = {"condition": "validity", "stage": "warnings"}[entry.of]
        assert f'<a href="#{anchor}"><b>{entry.name}</b></a>' in top
        assert _Page(html).text.count(entry.text.split(". ")[0].replace("`", "")) == 1


@pytest.mark.usefixtures("without_bsdf_figures")
def test_an_uncertainty_larger_than_its_quantity_is_no_number(full: Datasets) -> None:
    appearance = full["appearance"]
    u = xr.full_like(appearance["gloss"], 2e6).assign_attrs(
        long_name="standard uncertainty, from tolerances and the BSDF"
    )
    text = _Page(material_page({**full, "appearance": appearance.assign(gloss_u=u)})).text
    assert "± not known GU" in text
    assert "2000000" not in text


@pytest.mark.usefixtures("without_bsdf_figures")
def test_without_a_measured_surface_the_page_says_that_trust_is_not_known(full: Datasets) -> None:
    assumed = {stage: full[stage] for stage in ("spectrum", "index", "bsdf")} | {"facets": analytic("ggx", 0.2)}
    assumed["bsdf"] = microfacet.build(assumed["facets"], index=1.5, multiple_scattering="none")
    assert "Nothing of the surface was measured" in _Page(material_page(assumed)).text


def _model_error() -> xr.Dataset:
    light = np.array([[[[0.5, 0.5, 0.5], [-0.1, 0.01, np.nan]]], [[[np.nan] * 3] * 2]])
    by_region, by_gloss = ("reference", "plane", "theta_i", "region"), ("reference", "plane", "gloss_angle")
    fields = {
        "light": (by_region[1:], np.full((1, 2, 3), 0.02)),
        "reference_light": (by_region, np.full((2, 1, 2, 3), 0.02)),
        "light_error": (by_region, light),
        "light_error_u": (by_region, np.where(np.isnan(light), np.nan, 0.01)),
        "valid": (("reference", "theta_i"), [[0, 1], [0, 0]]),
        "gloss": (by_gloss[1:], [[75.0]]),
        "reference_gloss": (by_gloss, [[[76.0]], [[76.5]]]),
        "gloss_error": (by_gloss, [[[-1.0]], [[-1.5]]]),
        "gloss_error_u": (by_gloss, [[[0.1]], [[0.1]]]),
        "gloss_valid": (("reference", "gloss_angle"), [[0], [1]]),
        "phase_variance": ("theta_i", [500.0, 30.0]),
        "g2_raycast": ("theta_i", [1.0, 0.7]),
        "g2_raycast_u": ("theta_i", [0.0, 0.01]),
        "g2_height_correlated": ("theta_i", [1.0, 0.61]),
    }
    coords = {
        "reference": ["traced", "kirchhoff"],
        "plane": ["mean over azimuth"],
        "theta_i": [0.0, 75.0],
        "region": ["peak", "shoulder", "rest"],
        "gloss_angle": [20.0],
    }
    attrs = {"rays": 1, "seed": 0, "refusals": '{"kirchhoff": "the map is too coarse"}', "advice": ""}
    return vocabulary.validate(vocabulary.label(xr.Dataset(fields, coords, attrs), "model_error"), "model_error")


# --- what a BSDF may be


def _metal() -> xr.Dataset:
    values = {"n": ("wavelength", [1.0, 1.0]), "k": ("wavelength", [7.0, 7.0])}
    index = xr.Dataset(values, {"wavelength": [400.0, 700.0]}, {"source": "test"})
    return vocabulary.label(index, "index")


def _page_of(facets: xr.Dataset, **options: object) -> tuple[str, str]:
    """The page of a finish and its BSDF: markup, and text."""
    with samples.coarse_albedo_tables():
        datasets = {"facets": facets, "bsdf": microfacet.build(facets, **options)}
    if isinstance(options.get("spectrum"), xr.Dataset):
        datasets["spectrum"] = options["spectrum"]
    html = material_page(datasets)
    for figure in _figures(html):
        ElementTree.tostring(figure)
    assert "nan" not in "".join(re.findall(r' d="([^"]*)"', html))
    assert len(html.encode()) < 400_000
    return html, _Page(html).text


def test_a_flat_surface_has_notes_instead_of_empty_figures(full: Datasets) -> None:
    _, text = _page_of(flat(), index=1.5, spectrum=full["spectrum"])
    assert "The surface is perfectly flat: all facets are level, and none masks another." in text
    assert "light mirrored into one direction by a perfectly smooth surface" in text
    assert "of the mirrored ray is polarised" in text
    assert "Slope density" not in text


def test_a_flat_transparent_surface_has_notes_and_shares() -> None:
    html, text = _page_of(flat(), index=1.5, transparent=True)
    assert "Reflection and transmission" in text
    assert "Light in one single direction has no BTDF; there is nothing to draw." in text
    assert _tiles(html)["Transmittance"] == "96.0 %"


@pytest.mark.usefixtures("without_bsdf_figures")
def test_a_transparent_surface_needs_no_spectrum() -> None:
    _, text = _page_of(analytic("ggx", 0.2), index=1.5, transparent=True)
    assert "Colour and diffuse reflection are not modelled" not in text
    assert "Balance of the light" in text


@pytest.mark.usefixtures("without_bsdf_figures")
def test_a_plastic_needs_a_spectrum_but_a_metal_does_not() -> None:
    rough = analytic("beckmann", 0.2)
    assert "Colour and diffuse reflection are not modelled" not in _page_of(rough, index=_metal())[1]
    assert "Colour and diffuse reflection are not modelled" in _page_of(rough, index=1.5)[1]


def test_a_brushed_surface_is_shown_along_its_lay_and_across(full: Datasets) -> None:
    brushed = analytic("beckmann", a_x=0.05, a_y=0.3, azimuth=30.0)
    _, text = _page_of(brushed, index=1.5, spectrum=full["spectrum"], multiple_scattering="none")
    for words in ("BRDF along the lay", "BRDF across the lay", "45° incidence along the lay", "total, across the lay"):
        assert words in text


@pytest.mark.usefixtures("without_bsdf_figures")
def test_a_large_loss_is_a_remark_and_a_small_one_a_note() -> None:
    advice = "Set <code>model.multiple_scattering: auto</code> to add it"
    rough = analytic("ggx", 0.6)
    loses, _ = _page_of(rough, index=_metal(), multiple_scattering="none")
    assert re.search(rf'<p class="remark">The model loses [\d.]+\u202f% of the light[^<]*{advice}', loses)
    hardly, _ = _page_of(rough, index=1.5, multiple_scattering="none")
    assert re.search(rf'<p class="note">The model loses [\d.]+\u202f% of the light[^<]*{advice}', hardly)


@pytest.mark.usefixtures("without_bsdf_figures")
def test_the_default_adds_what_a_rough_surface_would_lose_and_says_so_where_it_is_little() -> None:
    added, _ = _page_of(analytic("ggx", 0.6), index=1.5)
    assert re.search(r'<p class="note">Light that leaves after two or more reflections, [\d.]+\u202f%', added)
    little, _ = _page_of(analytic("beckmann", 0.06), index=1.5)
    assert "The default does not add it; the history of the BSDF says why" in little
    separable, _ = _page_of(analytic("ggx", 0.6), index=1.5, masking="separable")
    assert "Set <code>model.masking: height-correlated</code> to add it" in separable
    for html in (added, little, separable):
        assert "Set <code>model.multiple_scattering" not in html


def test_a_note_states_the_compensated_light() -> None:
    html, text = _page_of(analytic("ggx", 0.6), index=_metal(), multiple_scattering="compensated")
    assert "is compensated by a diffuse part" in text
    assert "by one facet alone" in text
    assert "The model loses" not in html


def test_the_model_table_names_a_recipe_and_its_violation_of_energy_conservation(full: Datasets) -> None:
    _, text = _page_of(analytic("beckmann", 0.4), index=1.5, spectrum=full["spectrum"], recipe="crf")
    assert "Masking crf follows its source and need not conserve energy" in text
    assert "Recipe crf" in text
    assert "on more light leaves than arrives" in text


@pytest.mark.usefixtures("without_bsdf_figures")
def test_a_model_s_choices_never_become_markup(full: Datasets) -> None:
    html = material_page({"bsdf": full["bsdf"].assign_attrs(recipe=_ATTACK, diffuse_mode=f"`{_ATTACK}`")})
    assert "img" not in _Page(html).tags
    assert html.count("<script") == SCRIPTS


def pictured(side: int = 16) -> xr.Dataset:
    """A preview in the light of the scene and in two others, of smooth colours that differ."""
    row, column = np.mgrid[:side, : 3 * side] / (3 * side)
    pixels = np.stack([40 + 100 * row, 60 + 90 * column, 200 - 80 * row], axis=-1)
    pictures = np.stack([pixels, pixels + 20, 255 - pixels]).astype(np.uint8)
    attrs = {"illuminant": "D65", "light": "studio", "white_level": 0.75, "material": "steel"}
    picture = xr.Dataset(
        {
            "picture": (("row", "column", "channel"), pictures[0]),
            "picture_in": (("lighting", "row", "column", "channel"), pictures[1:]),
        },
        {
            "channel": list("RGB"),
            "light_of": ("lighting", ["spot", "tubes"]),
            "illuminant_of": ("lighting", ["A", "FL11"]),
        },
        attrs,
    )
    return vocabulary.label(picture, "preview")


def test_the_pictures_of_a_material_are_near_the_top_of_its_page_in_every_light() -> None:
    preview = pictured()
    page = material_page({"preview": preview})
    assert page.index('id="preview">Preview</h2>') < page.index("Limits")
    assert re.findall(r'<label for="light-\d">([^<]+)</label>', page) == [
        "Soft boxes, D65",
        "Spot lamp, A",
        "Rows of tubes, FL11",
    ]
    assert page.count('type="radio"') == 3
    assert page.count(" checked>") == 1
    shown = [
        np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))
        for data in re.findall(r'src="data:image/jpeg;base64,([^"]+)"', page)
    ]
    stored = [preview["picture"].values, *preview["picture_in"].values]
    expected = [subject for picture in stored for subject in np.split(picture, 3, axis=1)]
    assert len(shown) == len(expected) == 9
    for one, other in zip(shown, expected, strict=True):
        assert one.astype(int) == pytest.approx(other.astype(int), abs=4)
    for subject in ("Sphere", "Flat panel", "Moulded part"):
        assert page.count(f'alt="{subject} in the light of') == 3


def test_a_picture_of_an_earlier_version_has_two_subjects_and_one_light() -> None:
    preview = pictured().drop_vars(["picture_in", "light_of", "illuminant_of"]).isel(column=slice(0, 32))
    page = material_page({"preview": preview})
    assert page.count("data:image/jpeg") == 2
    assert "moulded part in the light" not in page.lower()


def test_a_page_without_a_picture_does_not_mention_it():
    assert ">Preview<" not in material_page({})


@pytest.mark.usefixtures("without_bsdf_figures")
def test_gloss_has_its_uncertainty_and_the_haze_of_windows(full: Datasets) -> None:
    gloss = full["appearance"]["gloss"]
    with_uncertainty = full["appearance"].assign(
        gloss_u=("gloss_angle", np.full(gloss.size, 0.25)), reflectance_haze=("haze_window", [1.5])
    )
    html = material_page(
        {**full, "appearance": with_uncertainty.assign_coords(haze_window=["20° ± 1.9°, 1.8° × 3.6°"])}
    )
    assert html.count("<td>± 0.25</td>") == gloss.size
    assert '<th scope="row">Haze ISO 13803, 20° ± 1.9°, 1.8° × 3.6°</th><td>1.5</td>' in html


PATENT = {"45as15": [33.90, -7.58, -36.61], "45as45": [12.29, 1.19, -25.77], "45as110": [3.07, 2.09, -13.24]}


def _paint_page(**options: object) -> str:
    listed = [{"geometry": name, "lab": lab} for name, lab in PATENT.items()]
    measured = flakes.ingest({"colours": listed, "illuminant": "D65", "observer": 10})
    bsdf = flake.build(measured, **options).assign_attrs(route="flake")
    seen = compute_appearance(bsdf, geometries=["MA-T6"])
    return material_page({"multiangle": measured, "flake": bsdf, "bsdf": bsdf, "appearance": seen})


@pytest.mark.usefixtures("without_bsdf_figures")
def test_a_colour_beyond_the_measured_angles_is_marked_and_explained() -> None:
    html = _paint_page()
    rows = {match[1]: match[2] for match in re.finditer(r'<th scope="row">([^<]*)</th>(<td>.*?)</tr>', html, re.S)}
    assert rows["45as-15"].count("<td>extrapolated</td>") == 1
    assert "extrapolated, beyond the measured angles" in html
    assert "± 0.5° of the directions of light and of view" in html
    assert re.search(r"Flop index [\d.]+ ± [\d.]+\.", html)


@pytest.mark.usefixtures("without_bsdf_figures")
@pytest.mark.parametrize(
    ("coat", "words"),
    [
        (0.02, "slope of the clear coat is given (0.02), not measured"),
        ("smooth", "clear coat is assumed smooth, not measured"),
    ],
)
def test_the_note_on_gloss_states_that_the_clear_coat_is_assumed(coat: float | str, words: str) -> None:
    assert words in _Page(_paint_page(model="flake-physical", clear_coat=coat)).text
    assert words not in _Page(_paint_page()).text


@pytest.mark.usefixtures("without_bsdf_figures")
def test_the_haze_of_windows_and_of_d4039_has_its_tolerances() -> None:
    html = _paint_page(model="flake-physical", clear_coat=0.02)
    assert re.search(r'<th scope="row">Haze D4039</th><td>[\d.]+</td><td>± [\d.]+</td>', html)
    assert re.search(r'<th scope="row">Haze ISO 13803, [^<]*</th><td>[\d.]+</td><td>± [\d.]+</td>', html)


def test_a_recovered_spectrum_has_its_residual_and_its_metamerism(full_page: str) -> None:
    recovered = recover([40, 20, 10], illuminant="D65", observer=10)
    text = _Page(material_page({"spectrum": recovered})).text
    assert "ΔE*ab to the given colour" in text
    for light in ("A", "FL2", "LED-B3"):
        apart = f"{recovered.attrs[f'metamerism_{light}']:.2f}"
        assert re.search(rf"ΔE00 to basis4 under {light}\s*{apart}", text)
    alone = _Page(material_page({"spectrum": recover([70, -55, -45], illuminant="D65", observer=10)})).text
    assert "No other exact method reaches this colour" in alone
    assert "ΔE*ab to the given colour" not in _Page(full_page).text


def _with_basis(full: Datasets, *flags: str) -> xr.Dataset:
    values = [vocabulary.quality(flag) for flag in flags]
    return full["appearance"].assign(gloss_quality=("gloss_angle", np.array(values, dtype=np.int8)))


@pytest.mark.usefixtures("without_bsdf_figures")
def test_gloss_states_its_basis(full: Datasets) -> None:
    flagged = _with_basis(full, "interpolated", "measured", "completed")
    html = material_page({**full, "appearance": flagged})
    rows = dict(re.findall(r'<th scope="row">Gloss ((?:20|60|85)°)</th><td>[\d.]+</td><td>(\w+)</td>', html))
    assert rows == {"20°": "interpolated", "60°": "measured", "85°": "completed"}
    assert re.search(r'<th scope="row">G60 − G20</th><td>[\d.]+</td><td>interpolated</td>', html)
    assert html.count("D523-style (completed)</span>") == 1
    assert html.count("D523-style</span>") == 2


@pytest.mark.usefixtures("without_bsdf_figures")
def test_a_haze_of_a_gloss_that_was_not_measured_was_not_either(full: Datasets) -> None:
    glossy = _with_basis(full, "extrapolated", "measured", "measured")
    glossy = glossy.assign(gloss=("gloss_angle", [70.0, 90.0, 95.0]), haze=20.0)
    assert "D4039-style (extrapolated)</span>" in material_page({**full, "appearance": glossy})


def test_gloss_of_a_model_has_no_basis(full_page: str) -> None:
    html = full_page
    assert '<th scope="col">Basis</th>' not in html
    assert "D523-style</span>" in html


@pytest.mark.usefixtures("without_bsdf_figures")
@pytest.mark.parametrize(
    ("title", "column"),
    [("from tolerances", "Tolerances, k = 1"), ("from tolerances and the BSDF", "Uncertainty, k = 1")],
)
def test_the_uncertainty_of_gloss_states_whether_that_of_the_bsdf_is_included(
    full: Datasets, title: str, column: str
) -> None:
    u = xr.Variable("gloss_angle", np.full(3, 0.25), {"long_name": f"standard uncertainty of gloss, {title}"})
    html = material_page({**full, "appearance": full["appearance"].assign(gloss_u=u)})
    assert f'<th scope="col">{column}</th>' in html


def _measured_page(full: Datasets, on_rig: xr.Dataset) -> str:
    return material_page({**full, "bsdf": on_rig, "predicted": full["bsdf"]})


def test_inputs_of_a_prediction_are_no_measured_results(full: Datasets, on_rig: xr.Dataset) -> None:
    html = _measured_page(full, on_rig)
    headings = re.findall(r"<h2>([^<]*)</h2>", html)
    for title in ("Spectrum and index", "Surface", "Facets"):
        assert f"{title} of the prediction" in headings
        assert title not in headings
    assert headings.index("Checks") < headings.index("Spectrum and index of the prediction")
    colour, after = headings.index("Colour"), html.split("<h2>Colour</h2>")[1].split("<h2>")[0]
    assert colour < headings.index("Checks")
    assert "<figcaption>Spectrum</figcaption>" not in after
    assert "nothing above rests on it" in html


def test_headline_facts_of_a_prediction_are_marked(full: Datasets, full_page: str, on_rig: xr.Dataset) -> None:
    facts = dict(
        re.findall(r"<dt>([^<]*)</dt><dd>.*?<span class=\"hint\">([^<]*)</span>", _measured_page(full, on_rig))
    )
    assert facts["rms slope"].startswith("of the prediction, all azimuths")
    assert facts["rms height"] == "of the prediction, Sq"
    plain = dict(re.findall(r"<dt>([^<]*)</dt><dd>.*?<span class=\"hint\">([^<]*)</span>", full_page))
    assert plain["rms height"] == "Sq"
    assert "of the prediction" not in full_page


def test_a_warning_of_a_prediction_is_marked(full: Datasets, on_rig: xr.Dataset) -> None:
    measured = {**full, "bsdf": on_rig, "predicted": full["bsdf"]}
    assert "spectrum (of the prediction)" in {entry.name for entry in verdicts(measured)}
    assert "spectrum" in {entry.name for entry in verdicts(full)}


def test_the_page_says_why_there_is_no_flop_index(full: Datasets) -> None:
    page = material_page(full)
    assert quantity("flop_index").exclusion(full)
    assert "No flop index. The flop index is for paints with effect pigments" in page
