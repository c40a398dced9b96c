"""Which of several samples of a file is read: by number, by name, by the cells that tell samples of one name apart, and by the specular component."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from brdfpipe.errors import InputError, abbreviated
from brdfpipe.spectra import specular_words
from brdfpipe.spectra.formats.base import Sample
from brdfpipe.spectra.specular_words import KnownGeometry

_MOST_NAMES = 10
"""Names of samples that a message lists."""


def chosen(path: Path, samples: Sequence[Sample], sample: int | str | None, geometry: KnownGeometry) -> int:
    """Position of a sample, counted from 0.

    Parameters
    ----------
    samples : of the file
    sample : its number, from 1; its name; or its name with one or more of the cells that tell it apart, as in ``Red, SCE``
    geometry : if known, of several samples of the name, the one with this label is meant

    Raises
    ------
    InputError : no such sample, several of the name, or one that is labelled with the other specular component.
    """
    if not samples:
        raise InputError(path, "no reflectance spectrum in the file", key="spectrum.file")
    place = _place(path, samples, sample, geometry.name)
    own = stated_geometry(samples[place])
    if own is not None and geometry.contradicts(own):
        fitting = [
            names
            for other, names in zip(samples, _names(samples), strict=True)
            if stated_geometry(other) == geometry.name
        ]
        raise InputError(
            path,
            f"the sample is labelled {own.upper()}, and the description says {str(geometry.name).upper()}",
            where=f"sample {place + 1}",
            found=repr(_names(samples)[place])[:80],
            accepted=f"`geometry: {own}`"
            + (f", or a sample of {abbreviated(fitting, _MOST_NAMES)}" if fitting else ""),
            key="spectrum.sample" if fitting else "spectrum.geometry",
        )
    return place


def stated_geometry(sample: Sample) -> str | None:
    """``sci`` or ``sce`` as the cells of a sample or its name say; None if they do not, or contradict each other."""
    found = _labelled(sample)
    return found.pop() if len(found) == 1 else None


def unclear_label(sample: Sample) -> str:
    """The name or label of a sample that may state the specular component and is not understood, or labels that contradict each other; empty
    if there is none."""
    found = _labelled(sample)
    if len(found) == 1:
        return ""
    texts = [
        sample.name,
        *(f"{title}: {cell}" if title else cell for title, cell in sample.labels if cell != sample.name),
    ]
    if found:
        return ", ".join(text for text in texts if specular_words.of_title(text))
    return next((text for text in texts if specular_words.is_unclear(text) or specular_words.says_both(text)), "")


def unclear_opposite(place: int, samples: Sequence[Sample]) -> str:
    """``title: cell`` of a sample that is labelled with no specular component, where another one of its name has the opposite word below the
    title; empty if there is none."""
    own = samples[place]
    if _labelled(own):
        return ""
    alike = [other for other in samples if other.name.strip().casefold() == own.name.strip().casefold()]
    opposite = (
        f"{title}: {cell}"
        for title, cell in own.labels
        if not re.search(r"(?i)\buv\b", title)  # light of another kind
        and any(specular_words.are_opposite(cell, word) for other in alike for of, word in other.labels if of == title)
    )
    return next(opposite, "")


def _labelled(sample: Sample) -> set[str]:
    """What the name and the cells of a sample say of the specular component."""
    found = {specular_words.of_cell(title, cell) for title, cell in sample.labels}
    return {kind for kind in (*found, specular_words.of_title(sample.name)) if kind}


def _place(path: Path, samples: Sequence[Sample], sample: int | str | None, geometry: str | None) -> int:
    if isinstance(sample, int) and not isinstance(sample, bool) and 1 <= sample <= len(samples):
        return sample - 1
    matches = [*range(len(samples))] if sample is None else []
    if isinstance(sample, str):
        matches = [i for i, known in enumerate(samples) if _is_meant(known, sample)]
    if len(matches) > 1 and geometry is not None:
        matches = [i for i in matches if stated_geometry(samples[i]) == geometry] or matches
    if len(matches) == 1:
        return matches[0]
    names = _names(samples)
    shown = abbreviated([names[i] for i in matches or range(len(names))], _MOST_NAMES)
    numbers = f"1 to {len(samples)}" if len(samples) > 1 else "1"
    problem, accepted = "unknown sample; the file has one", f"1 or {shown}, or no key"
    if len(samples) > 1:
        problem, accepted = f"the file has {len(samples)} samples; choose one", f"{numbers}, or one of {shown}"
    raise InputError(
        path,
        "ambiguous sample name" if matches and sample is not None else problem,
        found=None if sample is None else repr(sample)[:60],
        accepted=accepted,
        key="spectrum.sample",
    )


def _is_meant(sample: Sample, words: str) -> bool:
    """Whether words are the name of a sample, or its name and some of its cells, separated by commas."""
    if words.strip().casefold() == sample.name.strip().casefold():
        return True
    name, *cells = (part.strip().casefold() for part in words.split(","))
    return name == sample.name.strip().casefold() and {*cells} <= {cell.strip().casefold() for _, cell in sample.labels}


def _names(samples: Sequence[Sample]) -> list[str]:
    """Names for messages: those of several samples with the cells that differ between them."""
    alike: dict[str, list[Sample]] = {}
    for sample in samples:
        alike.setdefault(sample.name.strip().casefold(), []).append(sample)
    return [", ".join([sample.name, *_telling(sample, alike[sample.name.strip().casefold()])]) for sample in samples]


def _telling(sample: Sample, others: Sequence[Sample]) -> list[str]:
    """Cells of a sample that are not the same for all of the others."""
    return [
        cell for title, cell in sample.labels if any((title, cell) not in other.labels for other in others) and cell
    ]
