"""What titles, cells and header lines of a spectrum file say of the specular component: included (``sci``) or excluded (``sce``)."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from functools import lru_cache
from typing import NamedTuple

_COMPONENT = r"(?:sp|spec|specul\w*|especul\w*|spekul\w*|gloss|glanz(?:anteil|komponente)?|brillan\w*|spiegel(?:ung|nd\w*|anteil)?)"
_SPECULAR = r"(?:sp|spec|specul\w*|especul\w*|spekul\w*)"
_LINK = r"(?:comp|compon\w*|kompon\w*|compos\w*|anteil|refl|reflec\w*|reflex\w*|light|licht|is|was|are|of|ist|war|wird|wurde|the|r)"
_UNIT = r"(?:%|percent|prozent|r|\d+)"
_IN = r"(?:inc|incl(?!usion)\w*|inkl(?!usion)\w*|eingeschl\w*)"
_OUT = r"(?:exc|excl(?!usion)\w*|exkl(?!usion)\w*|esclu\w*|ausgeschl\w*|(?<=sp )ex|(?<=spec )ex|(?<=specular )ex|ex(?! \d))"
"""`Example 3` is no label: `ex` before a number is one only after `specular` and its abbreviations."""
_WITH, _WITHOUT = r"(?:with|mit|avec|con)", r"(?:without|w o|ohne|sans|sin|senza)"
_TRAP = r"(?:glanzfalle|(?:gloss|specular|light|glanz) trap)"


def _says(word: str, preposition: str, letter: str, trap: str) -> re.Pattern[str]:
    """Pattern of one kind of words in normalised text: adjective, preposition, letter of abbreviations, and preposition of a gloss trap."""
    syllable = {"i": r"in(?:c|cl\w*)?", "e": r"ex(?:c|cl\w*)?"}[letter]
    codes = rf"r?sc{letter}|r?(?:sp|spec|specular){syllable}(?! (?:coat|speed))|rs{syllable}"
    near = rf"{_COMPONENT} (?:{_LINK} )*{word}|{word} (?:{_LINK} )*{_COMPONENT}"
    before = rf"{preposition} (?:the )?(?:{_SPECULAR}(?! (?:trap|port))|{_COMPONENT}(?= {_LINK}\b|(?: {_UNIT})*$))"
    return re.compile(rf"(?<![^\s])(?:{codes}|{near}|{before}|{trap} (?:a |the )?{_TRAP})(?![^\s])")


_INCLUDED, _EXCLUDED = _says(_IN, _WITH, "i", _WITHOUT), _says(_OUT, _WITHOUT, "e", _WITH)
_DIRECTIONS = {
    letter: re.compile(
        rf"(?<![^\W_])(?:d{letter}\s?[:/]\s?8|d{letter}8(?!\s?nm)|8\s?°?\s?[:/]\s?d[:/]?{letter}|d\s?[:/]?\s?8\s?°?\s?[:/_-]?\s?{letter})(?![^\W_]|\.\w)"
    )
    for letter in "ie"
}
_BARE = re.compile(
    rf"(?:(?:{_LINK}|{_UNIT}|measured|mean) )*(?P<word>{_IN}|{_OUT})(?: (?:{_LINK}|{_UNIT}|measured|mean))*"
)
_ABOUT_COMPONENT = re.compile(
    r"(?<!\S)(?:sc[ie]|sp(?:in|ex)|specular|spec|especular|speculaire|spekular|glanz|gloss|mode|modus|viewing|geometr(?:y|ie))(?!\S)"
)
_ASKS = re.compile(rf"(?:{_SPECULAR}|glanz(?:anteil|komponente)?|gloss)(?: {_LINK})*")
_OF_SPECULAR = re.compile(rf"{_SPECULAR}(?: {_LINK})*")
_YES, _NO = re.compile(r"yes|y|ja|oui|si|true|on"), re.compile(r"no|n|nein|non|false|off|none")
_LETTERS = {"i": "sci", "in": "sci", "e": "sce", "ex": "sce"}
_DIGITS = {"1": True, "x": True, "0": False}
_UNCLEAR = re.compile(
    rf"(?<!\S)(?:{_COMPONENT}(?: [^\s,]+){{0,6}} (?:{_IN}|{_OUT})|(?:{_IN}|{_OUT})(?: [^\s,]+){{0,6}} {_COMPONENT})(?!\S)"
)


class KnownGeometry(NamedTuple):
    """Whether the specular component is included, as far as it is known before a file is read."""

    name: str | None = None
    """``sci`` or ``sce``; None if it is not known"""
    is_fallback: bool = False
    """Whether it counts only where the file states none"""

    def contradicts(self, stated: str | None) -> bool:
        """Whether a file that states this is refused."""
        return None not in (self.name, stated) and stated != self.name and not self.is_fallback


NOT_KNOWN = KnownGeometry()


def geometry(words: str) -> str | None:
    """``sci`` or ``sce``, as words anywhere in a file say; None if they do not, or say both."""
    plain, lower = _normalised(words), _unaccented(words).lower()
    included = bool(_INCLUDED.search(plain) or _DIRECTIONS["i"].search(lower))
    excluded = bool(_EXCLUDED.search(plain) or _DIRECTIONS["e"].search(lower))
    return None if included == excluded else "sci" if included else "sce"


def of_title(title: str) -> str | None:
    """:func:`geometry` of the title of a column or the name of a sample, which may be the bare word ``Excluded``."""
    bare = _BARE.fullmatch(_normalised(title))
    if bare and bare["word"] != "ex":
        return "sce" if re.fullmatch(_OUT, bare["word"]) else "sci"
    return of_line(title)


def of_cell(title: str, cell: str) -> str | None:
    """``sci`` or ``sce`` as a cell says, such as ``SCE``, ``E`` below the title ``SCI/SCE`` or ``no`` below ``Specular``; None if it does not.

    Parameters
    ----------
    title, cell : of a column and of one of its cells; of a row and of one of its cells; or the two sides of a line ``title: cell``
    """
    asked, word = _normalised(title), _normalised(cell)
    if not (_ABOUT_COMPONENT.search(asked) or re.fullmatch(_TRAP, asked)):
        return of_title(cell) if not asked else geometry(cell)
    found = _LETTERS.get(word) or of_title(cell) or _preposition(word)
    if found:
        return found
    # A bare title, as `Specular: yes`, asks whether the component is included; a gloss trap excludes it.
    affirmed = "sci" if _ASKS.fullmatch(asked) else "sce" if re.fullmatch(_TRAP, asked) else geometry(title)
    answer = _answer(asked, word, cell.strip())
    if affirmed is None or answer is None:
        return None
    return affirmed if answer else {"sci": "sce", "sce": "sci"}[affirmed]


def of_line(line: str) -> str | None:
    """``sci`` or ``sce`` as a header line says, in free words or as ``title: cell``; None if it does not."""
    title, mark, cell = _sides(line)
    return (of_cell(title, cell) if mark else None) or geometry(line)


def is_unclear(words: str) -> bool:
    """Whether words seem to say if the specular component is included, and are not understood."""
    return of_title(words) is None and bool(_UNCLEAR.search(_normalised(words)))


def says_both(words: str) -> bool:
    """Whether words name both kinds of measurement."""
    plain = _normalised(words)
    return bool(_INCLUDED.search(plain) and _EXCLUDED.search(plain))


def spoken(lines: Iterable[str]) -> tuple[str, ...]:
    """The lines that say, or seem to say, whether the specular component is included."""
    return tuple(line for line in lines if of_line(line) or is_unclear(line))


def doubt(words: str) -> str:
    """A doubt about words that were not understood, without a full stop."""
    return (
        f"{words[:60]!r} may say whether the specular component is included, and was not understood. Compare `spectrum.geometry` with it, "
        "and write SCI or SCE in its place"
    )


def _sides(line: str) -> tuple[str, str, str]:
    """Title, mark and cell of a header line ``title: cell``; the marks of empty cells at its end are left out."""
    match = re.match(r"\s*([^:=,;\t]{1,60}?)\s*([:=,;\t])\s*(.*?)[\s,;]*$", line)
    return (match[1], match[2], match[3]) if match else ("", "", "")


def _preposition(word: str) -> str | None:
    if re.fullmatch(_WITH, word):
        return "sci"
    return "sce" if re.fullmatch(_WITHOUT, word) else None


def _answer(asked: str, word: str, cell: str) -> bool | None:
    """Whether a cell affirms its title; None if it does neither."""
    if _YES.fullmatch(word) or _NO.fullmatch(word):
        return _YES.fullmatch(word) is not None
    if _OF_SPECULAR.fullmatch(asked) and cell in ("+", "-"):
        return cell == "+"
    # Below `Gloss` a digit is a gloss, below `Spec` the number of a specification.
    return None if re.match("gloss|glanz|spec(?!ul)", asked) else _DIGITS.get(word)


def _unaccented(words: str) -> str:
    return "".join(sign for sign in unicodedata.normalize("NFKD", words) if not unicodedata.combining(sign))


@lru_cache(maxsize=4096)
def _normalised(words: str) -> str:
    """Words in lower case with single blanks: without accents, dots and brackets, with ``SpecularExcluded`` and ``SCE1`` split, commas kept."""
    text = _unaccented(words)
    text = re.sub(r"(?<=[a-z])\((e?s?)\)", r"\1", text)
    text = re.sub(r"(?i)(?<![^\W_])s\.\s?c\.\s?([ie])(?![^\W_])\.?", r" SC\1 ", text)
    text = re.sub(r"\bSci\.", "", text)  # of the name of a journal
    text = re.sub(r"(?<![A-Za-z])(R?SC[EI])(?=[a-z]{3})", r"\1 ", text)
    # SciPy is no label.
    text = re.sub(r"(?<!\bSci)(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", text).lower()
    # `in` is a preposition, unless nothing, a number or a unit in brackets follows.
    text = re.sub(rf"(?<![^\W_])({_COMPONENT}[\s._-]*)in\.?\s*$", r"\1incl", text)
    text = re.sub(rf"(?<![^\W_])({_SPECULAR}[\s._-]*)in(?=\.?\s*(?:[\[\](),;/|]|\d+\s*$))", r"\1incl", text)
    text = re.sub(r"[,;|]", " , ", text)
    text = re.sub(r"(?<=[a-z])(?=\d)|(?<=\d)(?=[a-z])", " ", re.sub(r"[^a-z0-9%,]+", " ", text)).strip()
    # The light of the UV is another component.
    text = re.sub(rf"(?<!\S)uv (?:{_IN}|{_OUT})(?!\S)", ",", text)
    text = re.sub(rf"(?<!\S)(?:not|nicht|non|pas) {_IN}(?!\S)", "excluded", text)
    return re.sub(rf"(?<!\S)(?:not|nicht|non|pas) {_OUT}(?!\S)", "included", text)
