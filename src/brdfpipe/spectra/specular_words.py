"""What titles, cells and header lines of a spectrum file say of the specular component: included (``sci``) or excluded (``sce``)."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from functools import lru_cache
from typing import NamedTuple

_COMPONENT = r"(?:sp|spec|specul\w*|especul\w*|spekul\w*|gloss|glanz(?:anteil\w*|komponente\w*|es)?|brillan\w*|spiegel(?:ung|nd\w*|anteil)?)"
_SPECULAR = r"(?:sp|spec|specul\w*|especul\w*|spekul\w*)"
_ARTICLE = r"(?:the|a|any|of|die|den|der|das|des|la|le|el|il|de|du|del|della|compon\w*|kompon\w*|compos\w*)"
_LINK = rf"(?:{_ARTICLE}|comp|anteil|refl|reflec\w*|reflex\w*|light|licht|is|was|are|ist|war|wird|wurde|r)"
_UNIT = r"(?:%|percent|prozent|r|\d+)"
_IN = r"(?:inc|incl(?!usion)\w*|inkl(?!usion)\w*|eingeschl\w*|compris(?:es?)?)"
_OUT = r"(?:exc|excl(?!usion)\w*|exkl(?!usion)\w*|esclu\w*|ausgeschl\w*|(?<=sp )ex|(?<=spec )ex|(?<=specular )ex|ex(?! \d))"
"""`Example 3` is no label: `ex` before a number is one only after `specular` and its abbreviations."""
_REMOVED = r"(?:removed|subtracted|entfernt|abgezogen|supprime\w*)"
_WITH, _WITHOUT = r"(?:with|mit|avec|con)", r"(?:without|w o|ohne|sans|sin|senza|hors)"
_NONE = r"(?:no|kein\w*)"
_NOT = r"(?:not|nicht|non|pas)"
_TRAP = r"(?:glanzfalle|(?:gloss|specular|light|glanz) trap)"
_PORT = rf"(?:{_TRAP}|(?:gloss|specular) port)"
_OPEN, _CLOSED = r"(?:open|offen|geoffnet|ouverte?)", r"(?:closed|plugged|geschlossen|fermee?)"


def _says(word: str, other: str, preposition: str, letter: str, trap: str, port: str) -> re.Pattern[str]:
    """Pattern of one kind of words in normalised text: adjective and noun, the opposite ones, preposition, letter of abbreviations, preposition
    of a gloss trap, and state of a trap or port."""
    syllable = {"i": r"in(?:c|cl\w*)?", "e": r"ex(?:c|cl\w*)?"}[letter]
    codes = rf"r?sc{letter}|r?(?:sp|spec|specular){syllable}(?! (?:coat|speed))|rs{syllable}"
    # `Specular incl./excl.` is of both kinds.
    near = rf"{_COMPONENT} (?:{_LINK} )*(?:{other} )?{word}|{word} (?:{other} )?(?:{_LINK} )*{_COMPONENT}"
    specular = rf"(?:{_ARTICLE} )*{_SPECULAR}(?! (?:trap|port))"
    before = rf"{preposition} (?:{specular}|(?:{_ARTICLE} )*{_COMPONENT}(?= {_LINK}\b|(?: {_UNIT})*$))"
    states = rf"{trap} (?:a |the )?{_TRAP}(?! {_REMOVED})|{_PORT} (?:{_LINK} )*{port}|{port} {_PORT}"
    if letter == "e":
        # Gloss is also removed from a sample, and a sample may have none.
        states += rf"|{_SPECULAR} (?:{_LINK} )*{_REMOVED}|{_REMOVED} (?:{_LINK} )*{_SPECULAR}(?! (?:trap|port))"
        states += rf"|{_NONE} (?:{specular}|{_COMPONENT}(?= {_LINK}\b))"
    return re.compile(rf"(?<![^\s])(?:{codes}|{near}|{before}|{states})(?![^\s])")


_INCLUSION, _EXCLUSION = rf"(?:{_IN}|in[ck]lusion)", rf"(?:{_OUT}|ex[ck]lusion)"
_INCLUDED = _says(_INCLUSION, _EXCLUSION, _WITH, "i", rf"(?:{_WITHOUT}|{_NONE})", _CLOSED)
_EXCLUDED = _says(_EXCLUSION, _INCLUSION, _WITHOUT, "e", _WITH, _OPEN)
_DIRECTIONS = {
    letter: re.compile(
        rf"(?<![^\W_])(?:d{letter}\s?[:/]\s?8|d{letter}8(?!\s?nm)|8\s?°?\s?[:/]\s?d[:/]?{letter}|d\s?[:/]?\s?8\s?°?\s?[:/_-]?\s?{letter})(?![^\W_]|\.\w)"
    )
    for letter in "ie"
}
_BARE = re.compile(
    rf"(?:(?:{_LINK}|{_UNIT}|measured|mean) )*(?P<word>{_IN}|{_OUT})(?: (?:{_LINK}|{_UNIT}|measured|mean))*"
)
_STEM = r"(?:sp|spec|specul\w*|especul\w*|spekul\w*|gloss|glanz(?!grad|wert|mess|einheit|stufe|lack|folie|papier)\w*|brillan\w*|spiegel(?:ung|nd\w*|anteil))"
"""Words of the component in titles and in what is not understood."""
_ABOUT_COMPONENT = re.compile(rf"(?<!\S)(?:sc[ie]|sp(?:in|ex)|{_STEM}|mode|modus|viewing|geometr(?:y|ie))(?!\S)")
_ASKS = re.compile(rf"(?:{_LINK} )*(?:{_SPECULAR}|glanz(?:anteil|komponente)?|gloss)(?: {_LINK})*")
_OF_SPECULAR = re.compile(rf"{_SPECULAR}(?: {_LINK})*")
_YES, _NO = re.compile(r"yes|y|ja|oui|si|true|on"), re.compile(r"no|n|nein|non|false|off|none")
_LETTERS = {"i": "sci", "in": "sci", "e": "sce", "ex": "sce"}
_OTHER = {"sci": "sce", "sce": "sci"}
_DIGITS = {"1": True, "x": True, "0": False}
_OPPOSITES = {
    "yes no", "y n", "ja nein", "j n", "oui non", "si no", "on off", "an aus", "ein aus", "true false", "with without", "mit ohne", "avec sans",
    "in out", "i e", "open closed", "offen geschlossen", "offen zu", "auf zu", "ouvert ferme", "1 0",
}  # fmt: skip
_NEGATION = rf"(?:(?:not|no|nicht|non)(?! (?:\d|measured|gemessen|known|mesure\w*|applicable))|nein|none|off|aus|out|{_WITHOUT}|{_NONE}(?! \d)|{_REMOVED}|in[ck]lusion|ex[ck]lusion|{_OPEN}|{_CLOSED})"
_UNCLEAR = re.compile(
    rf"(?<!\S)(?:{_COMPONENT}(?: [^\s,]+){{0,6}} (?:{_IN}|{_OUT})|(?:{_IN}|{_OUT})(?: [^\s,]+){{0,6}} {_COMPONENT}"
    rf"|(?:{_STEM}|{_PORT}) (?:{_LINK} )*{_NEGATION}|{_NEGATION} (?:{_LINK} )*{_STEM})(?!\S)"
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
    # A colour difference, as `dE8` or `dE: 8`, is no direction.
    plain, lower = _normalised(words), re.sub(r"(?<![^\W_])dE(?=8|\s|:\s)", "", _unaccented(words)).lower()
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
    if re.fullmatch(_PORT, asked):
        # An open trap or port lets the component out.
        answer = True if word == "in" else False if word == "out" else _answer(asked, word, cell)
        is_trap = re.fullmatch(_TRAP, asked) and answer is not None
        return geometry(cell) or (("sce" if answer else "sci") if is_trap else geometry(f"{title} {cell}"))
    if not _ABOUT_COMPONENT.search(asked):
        return of_title(cell) if not asked else geometry(cell)
    # A bare title, as `Specular: yes`, asks whether the component is included.
    affirmed = "sci" if _ASKS.fullmatch(asked) else geometry(title)
    if found := _LETTERS.get(word) or of_title(cell):
        return found
    answer = _answer(asked, word, cell.strip())
    if affirmed and answer is not None:
        return affirmed if answer else _OTHER[affirmed]
    # A title and a cell may be one phrase, as `Component: specular removed`; a title alone says nothing of a cell.
    return _preposition(word) or (geometry(f"{title} {cell}") if word and geometry(title) is None else None)


def of_line(line: str) -> str | None:
    """``sci`` or ``sce`` as a header line says, in free words or as ``title: cell``; None if it does not."""
    title, mark, cell = _sides(line)
    return (of_cell(title, cell) if mark else None) or geometry(line)


def is_unclear(words: str) -> bool:
    """Whether words seem to say if the specular component is included, and are not understood."""
    return of_title(words) is None and bool(_UNCLEAR.search(_normalised(words)))


def is_unclear_line(line: str) -> bool:
    """:func:`is_unclear` of a header line, which may also be the bare word ``Excluded``: of what, it does not say."""
    # `Including` and `exclusive` are words of sentences that continue.
    is_bare = of_title(line) is not None and not re.search(r"(?i)clu(?:ding|sive)", line)
    return of_line(line) is None and (is_bare or is_unclear(line))


def are_opposite(cell: str, other: str) -> bool:
    """Whether two cells below one title are opposite words, such as ``on`` and ``off`` or ``+`` and ``-``."""
    words = _normalised(cell), _normalised(other)
    return {cell.strip(), other.strip()} == {"+", "-"} or any(
        " ".join(pair) in _OPPOSITES for pair in (words, words[::-1])
    )


def says_both(words: str) -> bool:
    """Whether words name both kinds of measurement."""
    plain = _normalised(words)
    return bool(_INCLUDED.search(plain) and _EXCLUDED.search(plain))


def spoken(lines: Iterable[str]) -> tuple[str, ...]:
    """The lines that say, or seem to say, whether the specular component is included."""
    return tuple(line for line in lines if of_line(line) or is_unclear_line(line))


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
    if re.fullmatch(rf"{_YES.pattern}|{_WITH}|{_NO.pattern}|{_WITHOUT}", word):
        return re.fullmatch(rf"{_YES.pattern}|{_WITH}", word) is not None
    if _OF_SPECULAR.fullmatch(asked) and cell in ("+", "-"):
        return cell == "+"
    # Below `Gloss` a digit is a gloss, below `Spec` the number of a specification.
    return None if re.fullmatch("(?!.*clusion)(?:gloss|glanz|spec(?!ul)).*", asked) else _DIGITS.get(word)


def _unaccented(words: str) -> str:
    return "".join(sign for sign in unicodedata.normalize("NFKD", words) if not unicodedata.combining(sign))


@lru_cache(maxsize=4096)
def _normalised(words: str) -> str:
    """Words in lower case with single blanks: without accents, dots and brackets, with ``SpecularExcluded`` and ``SCE1`` split, commas kept."""
    text = _unaccented(words)
    text = re.sub(r"(?<=[a-z])\((e?s?)\)", r"\1", text)
    text = re.sub(r"(?i)(?<![^\W_])s\.\s?c\.\s?([ie])(?![^\W_])\.?", r" SC\1 ", text)
    text = re.sub(r"\bSci\.|(?i:\bsci-?\s?fi\b)", "", text)  # of the name of a journal; of a colour
    text = re.sub(r"(?<![^\W_])[Ss]pin(?![^\W_])", " ", text)  # unlike SPIN and SpIn, a word
    text = re.sub(
        r"(?i)(?<![^\W_])([om])\.\s*(?=glanz|spek|spieg)",
        lambda sign: {"o": "ohne ", "m": "mit "}[sign[1].lower()],
        text,
    )
    text = re.sub(r"(?i)(?<=glanz)(?=(?:ein|aus)schluss)", " ", text)
    text = re.sub(r"(?<![A-Za-z])(R?SC[EI])(?=[a-z]{3})", r"\1 ", text)
    # SciPy is no label.
    text = re.sub(r"(?<!\bSci)(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", text).lower()
    # `in` is a preposition, unless nothing, a number or a unit in brackets follows.
    text = re.sub(rf"(?<![^\W_])({_COMPONENT}[\s._-]*)in\.?\s*$", r"\1incl", text)
    text = re.sub(rf"(?<![^\W_])({_SPECULAR}[\s._-]*)in(?=\.?\s*(?:[\[\](),;/|]|\d+\s*$))", r"\1incl", text)
    text = re.sub(r"[,;|\t]", " , ", text)
    text = re.sub(r"(?<=[a-z])(?=\d)|(?<=\d)(?=[a-z])", " ", re.sub(r"[^a-z0-9%,]+", " ", text)).strip()
    # The light of the UV is another component.
    text = re.sub(rf"(?<!\S)uv (?:{_IN}|{_OUT})(?!\S)", ",", text)
    text = re.sub(r"(?<!\S)(ein|aus)schluss\w*", lambda noun: {"ein": "inclusion", "aus": "exclusion"}[noun[1]], text)
    text = re.sub(rf"(?<!\S){_NOT} {_IN}(?!\S)", "excluded", text)
    text = re.sub(rf"(?<!\S){_NOT} (?:{_OUT}|{_REMOVED})(?!\S)", "included", text)
    # Without inclusion of the component, it is excluded.
    opposite = (
        rf"(?<!\S)(?:{_WITHOUT}|{_NONE}) ((?:{_ARTICLE} )*(?:{_COMPONENT} )?(?:{_LINK} )*)(in|ex)[ck]lusion(?!\S)"
    )
    return re.sub(opposite, lambda noun: f"{noun[1]}{'exclusion' if noun[2] == 'in' else 'inclusion'}", text)
