"""Rendering of the pages from their templates."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup, escape

if TYPE_CHECKING:
    from jinja2 import Environment

TEMPLATES = Path(__file__).parent / "templates"

_MARKS = {"pass": "✓", "warn": "!", "fail": "✕"}


def render(template: str, **context: Any) -> str:
    """A page from its template; every value that is not :class:`Markup` is escaped."""
    return _environment().get_template(template).render(**context)


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
    environment.filters["code"] = with_code
    environment.globals["mark"] = _MARKS
    environment.globals["style"] = Markup((TEMPLATES / "style.css").read_text("utf-8"))
    return environment
