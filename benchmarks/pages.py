"""Measured tables in pages of the documentation."""

from __future__ import annotations

import re


def renewed(page: str, name: str, content: str) -> str:
    """A page whose section between ``<!-- NAME -->`` and ``<!-- end -->`` is replaced.

    Raises ValueError: no such section.
    """
    pattern = re.compile(rf"(<!-- {re.escape(name)} -->\n).*?(<!-- end -->)", re.DOTALL)
    if not pattern.search(page):
        raise ValueError(f"the page has no section <!-- {name} -->")
    return pattern.sub(lambda match: f"{match[1]}{content}\n{match[2]}", page)
