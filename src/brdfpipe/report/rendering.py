"""Rendering of the pages from their templates, and which datasets of a material they show."""

from __future__ import annotations

import json
import re
from base64 import b64encode
from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr
from markupsafe import Markup, escape

from brdfpipe.appearance.verdicts import ACCEPTED
from brdfpipe.errors import printable
from brdfpipe.report.cards import WORDS, rows

if TYPE_CHECKING:
    from jinja2 import Environment

TEMPLATES = Path(__file__).parent / "templates"

_VERDICT_SYMBOLS = {"pass": "✓", "warn": "!", "fail": "✕", ACCEPTED: "✓"}

OTHER_SECTIONS = frozenset({"reduced", "primary", "smoothed", "calibration", "comparison"})
"""Kinds of dataset that the sections of the rig and of the comparison show."""


def render(template: str, **context: Any) -> str:
    """A page from its template; every value that is not :class:`Markup` is escaped, and no character of any is hidden."""
    return printable(_environment().get_template(template).render(**context))


def as_json(data: object) -> Markup:
    """JSON in which no character can end the element of the page that holds it."""
    text = json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))


def with_code(text: object) -> Markup:
    """Escaped text with its ``backticked`` parts as code."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {"code": with_code, "rows": rows}
    environment.globals["mark"] = _VERDICT_SYMBOLS
    environment.globals["words"] = WORDS
    environment.globals["style"] = Markup((TEMPLATES / "style.css").read_text("utf-8"))
    environment.globals["viewer_style"] = Markup((TEMPLATES / "uPlot.css").read_text("utf-8"))
    return environment


@cache
def script(*names: str) -> tuple[Markup, str]:
    """A script of the page, from files of the templates with their licences, and the hash by which the page's policy allows it."""
    text = "\n".join(_with_licence(TEMPLATES / name) for name in names)
    return Markup(text), b64encode(sha256(text.encode()).digest()).decode()


def _with_licence(file: Path) -> str:
    """A script below the licence of its library, which every copy has to carry."""
    licence = file.with_suffix(".LICENSE")
    notice = f"/*!\n{licence.read_text('utf-8')}*/\n" if licence.is_file() else ""
    return notice + file.read_text("utf-8")


def own_stages(datasets: Mapping[str, xr.Dataset]) -> dict[str, xr.Dataset]:
    """The datasets of a material, without those from the frames of a rig to its measured BSDF, and without the comparison."""
    return {stage: dataset for stage, dataset in datasets.items() if dataset.attrs.get("kind") not in OTHER_SECTIONS}


def material_name(datasets: Mapping[str, xr.Dataset]) -> str:
    """The name of the material in the attributes of its datasets."""
    return next((str(item.attrs["material"]) for item in datasets.values() if "material" in item.attrs), "unnamed")
