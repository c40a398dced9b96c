"""What the titles and header lines of a spectrum file say: scale, uncertainty and incidence."""

from __future__ import annotations

import re
from collections.abc import Sequence

from brdfpipe.errors import InputError

_PERCENT_WORD = r"(?:%|percent|prozent|pour\s?cent|per\s?cento)"
# A number before the sign is a condition (45 %RH, 5 % of gloss), unless it is the white of the scale.
_PERCENT = re.compile(
    rf"(?:\b100\s?{_PERCENT_WORD}|(?<!\d)(?<!\d\s){_PERCENT_WORD})(?!\s?(?:r\.?\s?h\b|rel|hum|feucht))", re.IGNORECASE
)
_FRACTION = re.compile(r"fraction|anteil|\b0\s?(?:-|–|to|\.\.)\s?1\b", re.IGNORECASE)
_UNITY = re.compile(r"[\[(]\s?[1-]\s?[\])]")
_ABOUT_VALUES = re.compile(r"refl|remission|rückstr|y\s?units|scale|%\s?R\b|\bR\s?[\[(%]", re.IGNORECASE)
_NO_REFLECTANCE = re.compile(r"transmi|absorb|extinction|\bk/s\b|%\s?T\b|\bT\s?[\[(%]", re.IGNORECASE)
_UNCERTAINTY_WORD = (
    r"(?:u|u\d\d|unc|uncert|uncertainty|std|std\.?[\s_]?dev\.?|stdev|st\.?\s?dev\.?|sd|sigma|σ|err|error|var|variance"
    r"|standard[\s_-]?(?:dev|deviation|unc|uncertainty|error)\.?|(?:expanded|rel|relative)[\s_.]+(?:u|unc|uncertainty|std)"
    r"|standardabweichung|(?:mess)?unsicherheit|écart[\s-]type|incertitude)[²2]?"
)
_UNCERTAINTY = re.compile(
    rf"\s*(?:\d(?:[.,]\d+)?\s?)?{_UNCERTAINTY_WORD}(?![^\W_]).*|.*(?<=[\s_]){_UNCERTAINTY_WORD}\s*(?:[\[(,].*)?",
    re.IGNORECASE,
)
"""Titles that begin or end with a whole word for an uncertainty: u_R, R_std, Standardabweichung; not uncoated."""
_BARE_STANDARD = re.compile(r"\s*std\s*", re.IGNORECASE)
_BATCH = re.compile(r"bat|batch|trl|trial|smp|spl|sample|probe", re.IGNORECASE)
_COVERAGE = re.compile(
    r"\bk\s?=\s?(\d+(?:[.,]\d+)?)|(?<![\d.,])(\d(?:[.,]\d+)?)\s?(?:σ|sigma\b|sd\b|std\b)", re.IGNORECASE
)
_SQUARED = re.compile(r"²|\^\s?2|\bvar(?:iance)?\b|(?:std|sd|sigma|σ)2\b", re.IGNORECASE)
_RELATIVE = re.compile(r"(?<![^\W_])rel(?:ative?)?(?![^\W_])|relativ|%\s?(?:of|von)\b|/\s?R\b|\bcv\b", re.IGNORECASE)
_EXPANDED = re.compile(r"\s*(?:U\d*|.*_U)(?![^\W_])|.*(?i:expanded|erweitert|\b9\d(?:\.\d+)?\s?%)")
_LIGHT_FROM = re.compile(r"\blight from (\d+(?:\.\d+)?) degree")


def scale(file: str, title: str, header: Sequence[str]) -> str | None:
    """``fraction`` or ``percent``, as the title of the values or the header says; None if neither does.

    Raises InputError: the values are another quantity, such as a transmittance.
    """
    for text in [title, *(line for line in header if _ABOUT_VALUES.search(line))]:
        if _NO_REFLECTANCE.search(text) and not re.search("refl", text, re.IGNORECASE):
            found = repr(text[:60])
            raise InputError(file, "not a reflectance", found=found, accepted="reflectance", key="spectrum.column")
        percent, fraction = bool(_PERCENT.search(text)), bool(_FRACTION.search(text))
        if percent != fraction:
            return "percent" if percent else "fraction"
    return None


def is_uncertainty(title: str, titles: Sequence[str]) -> bool:
    """Whether the title of a column names an uncertainty."""
    if _BARE_STANDARD.fullmatch(title) and any(_BATCH.fullmatch(other.strip()) for other in titles):
        return False  # beside a batch, STD is the standard of the comparison
    return _UNCERTAINTY.fullmatch(title) is not None


def coverage_factor(title: str) -> float:
    """Coverage factor k that the title of an uncertainty states; 1 by default."""
    match = _COVERAGE.search(title)
    return float((match[1] or match[2]).replace(",", ".")) if match else 1.0


def uncertainty_scale(title: str) -> str | None:
    """``fraction`` or ``percent``, as the title of an uncertainty says; None if it does not."""
    if _PERCENT.search(title):
        return "percent"
    return "fraction" if _FRACTION.search(title) or _UNITY.search(title) else None


def unusable_uncertainty(title: str, value_title: str) -> str:
    """Why a title excludes absolute standard uncertainties; empty if it does not."""
    if _SQUARED.search(title):
        return "it is squared, a variance"
    if _RELATIVE.search(title):
        return "it is relative to the reflectance"
    if _PERCENT.search(title) and not _PERCENT.search(value_title):
        return "it is in percent but the title of the reflectance is not, so it may be relative"
    if _EXPANDED.match(title) and not _COVERAGE.search(title):
        return "it is expanded, and the title does not state the coverage factor k"
    return "its coverage factor is 0" if coverage_factor(title) <= 0 else ""


def incidence(words: str) -> float | None:
    """Angle of incidence [degree]; None if not stated."""
    match = _LIGHT_FROM.search(words)
    return float(match[1]) if match and float(match[1]) < 90 else None
