"""The page of a large catalogue in a browser: filters, order, comparison, keyboard and paper, by the values that it shows."""

from __future__ import annotations

import html
import re
import statistics
from base64 import b64decode
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import samples
import xarray as xr
from browser_pages import console_and_requests, opened_page
from catalogue_rows import FAILURES, Datasets
from catalogue_rows import row as _row

from brdfpipe.appearance.preview import png, preview
from brdfpipe.report import catalogue_page, combine
from brdfpipe.report.catalogue import cuts
from brdfpipe.spectra.colorimetry import delta_e_00

NUMBER = 10_000
HOSTILE = '"><script>alert(1)</script><img src=x onerror=alert(2)>'
HOSTILE_DESCRIPTION = "</noscript><script>document.title = 'broken'</script>&lt;b&gt;</script>"

SET = """
const [id, value] = arguments, field = document.getElementById(id), before = performance.now();
field.value = value;
field.dispatchEvent(new Event("input", { bubbles: true }));
document.getElementById("materials").offsetHeight; // the layout is part of the answer
return performance.now() - before;
"""
NAMES = "return [...document.querySelectorAll('#materials tbody th > a, #materials tbody th > span')].map((one) => one.textContent)"


def _large(full: Datasets) -> xr.Dataset:
    """Rows of every route, with colours, gloss and a lay at random; the names of some would break a careless page."""
    bsdf = samples.beckmann_bsdf(0.1, n=1.5)
    kinds = [{**full, "preview": preview(bsdf), "bsdf": bsdf}]
    kinds.append({**full, "bsdf": full["bsdf"].assign_attrs(route="measured")})
    rows = [_row(datasets, f"kind-{k}", "Grained panel, black") for k, datasets in enumerate(kinds)]
    rows.append(_row({"index": full["index"]}, "kind-x"))
    random, kind = np.random.default_rng(1), np.arange(NUMBER) % len(rows)
    catalogue = combine(rows).isel(material=kind).assign_coords(material=[f"material-{k}" for k in range(NUMBER)])
    known = kind < 2
    for name, low, high in (("L", 5, 95), ("a", -40, 40), ("b", -40, 40), ("gloss_60", 0, 100), ("anisotropy", 1, 3)):
        values = np.where(known, random.uniform(low, high, NUMBER).round(1), np.nan)
        catalogue[name] = ("material", values, catalogue[name].attrs)
    names = catalogue["material"].values.astype(object)
    names[[4, 7]] = HOSTILE, "café 'ü' & <b>"
    words = catalogue["description"].values.astype(object)
    words[4] = HOSTILE_DESCRIPTION
    catalogue["description"] = ("material", words.astype(str), catalogue["description"].attrs)
    return catalogue.assign_coords(material=names.astype(str))


@pytest.fixture(scope="module")
def large(full: Datasets) -> xr.Dataset:
    return _large(full)


@pytest.fixture(scope="module")
def page(large: xr.Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    (folder / "index.html").write_text(catalogue_page(large, FAILURES), encoding="utf-8")
    return folder / "index.html"


@pytest.fixture
def opened(browser: Any, page: Path) -> Any:
    opened_page(browser, page)
    return browser


def _count(browser: Any) -> int:
    return int(browser.find_element("id", "count").text.split()[0])


def test_the_packed_cuts_are_those_of_the_bsdf() -> None:
    bsdf = samples.beckmann_bsdf(0.02, n=1.5)
    cut = cuts.lobe_cut(bsdf)
    at = int(np.flatnonzero(cuts.OFFSETS == 0)[0])
    for k, incidence in enumerate(cuts.INCIDENCES):
        assert cut[k, at] == pytest.approx(bsdf.bsdf.evaluate(incidence, 0, incidence, 180, 550).item(), rel=1e-6)
    assert np.isnan(cut[2, -1])  # 155 degree from the normal
    raw = np.frombuffer(b64decode(cuts.packed(cut)), "<u2").reshape(cut.shape)
    low, high = cuts.scale()["decades"]  # type: ignore[misc]
    shown = np.where(raw > 0, 10 ** (low + (raw - 1.0) / 65534 * (high - low)), np.nan)
    assert np.allclose(shown, cut, rtol=1e-3, equal_nan=True)
    assert np.isnan(cuts.lobe_cut(None)).all()


def test_no_text_of_a_user_ends_the_table_that_scripts_read(large: xr.Dataset) -> None:
    page = catalogue_page(large.isel(material=slice(0, 12)), FAILURES)
    (table,) = re.findall(r'<noscript id="plain-table">(.*?)</noscript>', page, re.S)
    assert table.count("<tr>") == 13
    assert html.escape(HOSTILE, quote=False).replace('"', "&#34;") in table


@pytest.mark.slow
def test_ten_thousand_materials_open_without_a_message_or_a_request(opened: Any, large: xr.Dataset) -> None:
    assert _count(opened) == NUMBER
    assert opened.title == "BRDF catalogue"
    assert opened.execute_script("return document.querySelectorAll('#materials tr').length") < 100
    heights = "return [...document.querySelectorAll('#materials tbody tr:not(.space)')].map((row) => row.offsetHeight)"
    assert set(opened.execute_script(heights)) == {72}  # what the script counts with
    assert opened.execute_script("return document.querySelectorAll('#materials b.script, [onerror]').length") == 0
    opened.execute_script(SET, "words", "onerror=alert")
    assert opened.execute_script(NAMES) == [HOSTILE]
    opened.execute_script(SET, "words", "café 'ü' & <b>")
    assert opened.execute_script(NAMES) == ["café 'ü' & <b>"]
    messages, requests = console_and_requests(opened)
    assert messages == []
    assert [one for one in requests if not one.startswith(("file:", "data:"))] == []


@pytest.mark.slow
def test_a_filter_of_ten_thousand_materials_answers_within_a_fifth_of_a_second(opened: Any) -> None:
    changes = [
        ("words", "panel 7"),
        ("verdict", "warn"),
        ("route", "measured"),
        ("gloss-low", "50"),
        ("gloss-high", "60"),
    ]
    changes += [("anisotropy", "1.5"), ("colour", "48 34 22"), ("difference", "10")]
    changes += [(name, "") for name, _ in reversed(changes)]
    times = [opened.execute_script(SET, *change) for _ in range(3) for change in changes]
    assert statistics.median(times) < 200


@pytest.mark.slow
def test_filters_keep_exactly_the_materials_that_match(opened: Any, large: xr.Dataset) -> None:
    gloss, lay = (large[name].values for name in ("gloss_60", "anisotropy"))
    measured, warned = large["route"].values == "measured", large["verdict"].values == "warn"
    for field, value, kept in [
        ("gloss-low", "50", gloss >= 50),
        ("gloss-high", "60", gloss <= 60),
        ("anisotropy", "1.5", lay.round(2) >= 1.5),
        ("route", "measured", measured),
        ("verdict", "warn", warned),
    ]:
        opened.execute_script(SET, field, value)
        assert _count(opened) == kept.sum() > 0
        opened.execute_script(SET, field, "")
    opened.execute_script(SET, "words", "MATERIAL-12 grained")
    searched = [name for name in large["material"].values if "material-12" in name]
    described = [name for name in searched if "Grained" in str(large["description"].sel(material=name).values)]
    assert _count(opened) == len(described) > 10
    assert opened.find_element("css selector", "#failed li").is_displayed() is False
    opened.find_element("css selector", "#filter button[type=reset]").click()
    assert _count(opened) == NUMBER


@pytest.mark.slow
def test_the_nearest_colour_is_that_of_the_colour_difference(opened: Any, large: xr.Dataset) -> None:
    lab = np.stack([large[name].values for name in "Lab"], axis=-1)
    for typed, wanted in [("48 34 22", [48, 34, 22]), ("0 0 0", [0, 0, 0]), ("60, -20, −30.5", [60, -20, -30.5])]:
        difference = np.asarray(delta_e_00(lab, np.array(wanted, float)))
        order = [k for k in np.argsort(difference, kind="stable") if np.isfinite(difference[k])]
        opened.execute_script(SET, "colour", typed)
        assert opened.execute_script(NAMES)[0] == large["material"].values[order[0]]
        shown = [float(one.text.split()[-1]) for one in opened.find_elements("css selector", ".difference")[:10]]
        assert shown == pytest.approx(difference[order[:10]], abs=0.0051)
        opened.execute_script(SET, "difference", "8")
        assert _count(opened) == np.count_nonzero(difference <= 8)
        opened.execute_script(SET, "difference", "")
    opened.execute_script(SET, "colour", "beige")
    assert "colour is not read" in opened.find_element("id", "count").text


@pytest.mark.slow
def test_rows_come_with_scrolling_and_sorting_in_the_right_order(opened: Any, large: xr.Dataset) -> None:
    column = opened.find_element("xpath", "//th[button='Gloss 60°']/button")
    column.click()
    column.click()
    gloss = large["gloss_60"].values
    best = large["material"].values[np.nanargmax(gloss)]
    names = opened.execute_script(NAMES)
    assert float(large["gloss_60"].sel(material=names[0])) == np.nanmax(gloss)
    assert best in names
    assert opened.find_element("css selector", "#materials [aria-sort=descending]").text.startswith("Gloss 60°")
    middle = """
    const done = arguments[arguments.length - 1], frame = document.querySelector(".interactive");
    frame.scrollTop = 5000 * 72;
    requestAnimationFrame(() => requestAnimationFrame(() => {
      const top = frame.getBoundingClientRect().top + 120;
      const row = [...document.querySelectorAll("#materials tbody tr:not(.space)")].find((one) => one.getBoundingClientRect().top > top);
      done([row.getAttribute("aria-rowindex"), row.cells[0].querySelector("a, th > span").textContent, document.querySelectorAll("#materials tr").length]);
    }));
    """
    index, name, rows = opened.execute_async_script(middle)
    assert 5000 < int(index) < 5006
    order = sorted(range(NUMBER), key=lambda k: -np.nan_to_num(gloss[k], nan=-1.0))
    assert float(large["gloss_60"].sel(material=name)) == gloss[order[int(index) - 2]]
    assert rows < 100


@pytest.mark.slow
def test_materials_side_by_side_by_the_keyboard_alone(opened: Any, large: xr.Dataset, full: Datasets) -> None:
    from selenium.webdriver.common.keys import Keys

    for name in ("material-0", "material-1", "material-3", "material-6", "material-9"):
        opened.execute_script(SET, "words", f"{name} ")
        box = opened.find_element("css selector", f"input[aria-label='Compare {name}']")
        if name == "material-9":
            assert not box.is_enabled()  # four are the most
        else:
            box.send_keys(Keys.SPACE)
            assert opened.switch_to.active_element.get_attribute("aria-label") == f"Compare {name}"
    assert opened.find_element("id", "comparison-title").text == "Comparison of 4 materials"
    cells = [
        [cell.text for cell in row.find_elements("css selector", "th, td")]
        for row in opened.find_elements("css selector", "#figures-compared tr")
    ]
    table = {line[0]: line[1:] for line in cells}
    assert table["Quantity"] == ["material-0", "material-1", "material-3", "material-6"]
    lab = [[float(large[name].sel(material=one)) for name in "Lab"] for one in table["Quantity"]]
    true = [float(delta_e_00(np.array(lab[1]), np.array(lab[k]))) for k in (0, 2, 3)]
    shown = table["ΔE00 from material-1"]
    assert [float(shown[k]) for k in (0, 2, 3)] == pytest.approx(true, abs=0.0051)
    gloss = [f"{float(large['gloss_60'].sel(material=one)):.1f}" for one in table["Quantity"]]
    assert [one.split(" ")[0] for one in table["Gloss 60°"]] == gloss
    assert opened.find_element("css selector", "#overlay canvas").size["width"] > 200
    saved = opened.execute_script(
        "let href; HTMLAnchorElement.prototype.click = function () { href = this.href; }; document.getElementById('save-cuts').click(); return decodeURIComponent(href)"
    )
    values = [line.split(",") for line in saved.splitlines()[2:]]
    true_cut = large["brdf_cut"].sel(material=table["Quantity"][0]).values[1]
    stated = np.array([float(line[1]) if line[1] else np.nan for line in values])
    assert np.allclose(stated, true_cut, rtol=1e-3, equal_nan=True)
    # The address brings the comparison back.
    address = opened.current_url
    opened.get("about:blank")
    opened.get(address)
    assert opened.find_element("id", "comparison-title").text == "Comparison of 4 materials"
    opened.find_element("css selector", "#pictures figure button:last-of-type").click()
    assert opened.find_element("id", "comparison-title").text == "Comparison of 3 materials"


def _small(full: Datasets, folder: Path) -> Path:
    bsdf = samples.beckmann_bsdf(0.1, n=1.5)
    picture = preview(bsdf)
    for name in "ab":
        (folder / name).mkdir()
        (folder / name / "preview.png").write_bytes(png(picture))
    rows = [_row({**full, "preview": picture, "bsdf": bsdf}, name) for name in "ab"]
    (folder / "index.html").write_text(catalogue_page(combine(rows), FAILURES), encoding="utf-8")
    return folder / "index.html"


@pytest.mark.slow
def test_pictures_of_a_comparison_come_from_the_folders_of_the_materials(
    browser: Any, full: Datasets, tmp_path: Path
) -> None:
    page = _small(full, tmp_path)
    opened_page(browser, page)
    browser.get(f"{page.as_uri()}#compare=a&compare=b")
    browser.refresh()
    script = """
    const done = arguments[0], wait = () => { const all = [...document.querySelectorAll("#pictures img")];
      all.length === 2 && all.every((one) => one.complete && one.naturalWidth > 200) ? done(all.map((one) => one.naturalWidth)) : setTimeout(wait, 50); };
    wait();
    """
    assert len(browser.execute_async_script(script)) == 2
    messages, requests = console_and_requests(browser)
    assert messages == []
    assert [one for one in requests if not one.startswith(("file:", "data:"))] == []


@pytest.mark.slow
def test_paper_has_every_row_that_is_shown(opened: Any) -> None:
    opened.execute_script(SET, "words", "material-1")
    shown = _count(opened)
    assert shown > 300
    rows = "return document.querySelectorAll('#materials tbody tr:not(.space)').length"
    assert opened.execute_script(rows) < 100
    assert opened.execute_script(f"dispatchEvent(new Event('beforeprint')); {rows}") == shown
    opened.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        last = "return [...document.querySelectorAll('#materials tbody tr')].at(-1).getBoundingClientRect().bottom"
        assert opened.execute_script(last) > 10 * shown
    finally:
        opened.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
    assert opened.execute_script(f"dispatchEvent(new Event('afterprint')); {rows}") < 100


@pytest.mark.slow
def test_without_scripts_the_table_stays(browser: Any, page: Path) -> None:
    browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        browser.get("about:blank")
        browser.get(page.as_uri())
        assert len(browser.find_elements("css selector", "#materials tbody tr")) == NUMBER
    finally:
        browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})
