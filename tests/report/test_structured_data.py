"""What the pages say to machines is valid, agrees with the page, and cannot leave its element."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
import xarray as xr
from catalogue_rows import Datasets, row

from brdfpipe.appearance.quantities import quantity
from brdfpipe.report import catalogue_page, combine, material_page, summarise

ATTACK = '</script><script>alert(1)</script><!-- & \u2028 \u202e "'


def linked_data(html: str) -> Any:
    """The content of the one element, as a browser delimits it."""
    (content,) = re.findall(r'<script type="application/ld\+json">(.*?)</script', html, re.S | re.I)
    return json.loads(content)


def test_a_page_describes_its_material_with_values_in_the_digits_of_the_table(full: Datasets) -> None:
    name = str(full["bsdf"].attrs["material"])
    astm = {
        "kind": "export",
        "format": "astm",
        "side": "reflection",
        "files": f'{{"{name}.astm": "0"}}',
        "records": "{}",
    }
    exported = full | {"export_astm": xr.Dataset(attrs=astm)}
    data = linked_data(material_page(exported, description="A black panel"))
    of_table = summarise(full)
    assert (data["@context"], data["@type"]) == ("https://schema.org", "Dataset")
    assert (data["name"], data["description"]) == (str(of_table["material"].values[0]), "A black panel")
    values = {one["name"]: (one["value"], one.get("unitText")) for one in data["variableMeasured"]}
    assert values["gloss_60"] == (
        pytest.approx(of_table["gloss_60"].item(), abs=0.5 * 10 ** -quantity("gloss_60").decimals),
        "GU",
    )
    assert f"exports/{data['name']}.astm" in [file["contentUrl"] for file in data["distribution"]]


@pytest.mark.parametrize("text", [ATTACK, "</SCRIPT >", "\\u003c/script>", "\x9b", "ünï \U0001f600"])
def test_text_of_users_stays_text(full: Datasets, text: str) -> None:
    html = material_page(full, description=text)
    assert linked_data(html)["description"] == text
    assert html.count("<script") == 3  # with the data of the viewer and its script
    page = catalogue_page(combine([row(full, "black", text)]), {}, scene={"name": text, "purpose": text})
    assert linked_data(page)["description"] == text
    assert page.count("<script") == 3  # and the page's own, which sorts, with its data


def test_the_catalogue_names_its_files(full: Datasets) -> None:
    data = linked_data(catalogue_page(combine([row(full, "a"), row(full, "b")]), {}))
    assert [file["contentUrl"] for file in data["distribution"]] == ["catalogue.csv", "catalogue.nc"]
