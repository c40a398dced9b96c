"""Why the datasets of a material changed: a raw file, a key, the software or the code."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from brdfpipe.errors import abbreviated
from brdfpipe.releases.provenance import Provenance
from brdfpipe.store import canonical_json

_LONGEST = 60
"""Characters of a value that a cause quotes."""


@dataclass(frozen=True)
class Cause:
    """One reason for a change, at the stage where it enters."""

    kind: Literal["input", "key", "software", "code", "model"]
    """A raw file, a key of a description or the configuration, the version of a library, brdfpipe's own code, or the stages themselves."""
    stage: str
    text: str


def causes(old: Mapping[str, Provenance], new: Mapping[str, Provenance]) -> list[Cause]:
    """The reasons for the changes between two releases of a material.

    Parameters
    ----------
    old, new : stage → origin of its dataset

    Returns
    -------
    One cause for each changed raw file and key, at each stage that has it. A stage that changed although its inputs and parameters
    did not has changed by its code, or by the libraries whose versions differ. A stage whose inputs are results that changed is a
    consequence, and not listed.
    """
    found: list[Cause] = []
    for stage in sorted(old.keys() & new.keys()):
        if old[stage].digest != new[stage].digest:
            found += _of_stage(stage, old, new)
    if not found and old.keys() != new.keys():
        changes = [f"{word} {abbreviated(sorted(names), 5)}" for word, names in _renamed(old, new) if names]
        found.append(Cause("model", "", f"stages: {'; '.join(changes)}"))
    return found


def _of_stage(stage: str, old: Mapping[str, Provenance], new: Mapping[str, Provenance]) -> Iterator[Cause]:
    before, after = old[stage], new[stage]
    changed = [name for name in before.inputs if after.inputs.get(name, before.inputs[name]) != before.inputs[name]]
    results = {item.digest for item in (*old.values(), *new.values())}
    raw = [name for name in changed if not {before.inputs[name], after.inputs[name]} & results]
    for name in raw:
        yield Cause("input", stage, f"{name}: another file")
    keys = list(_differences(before.parameters, after.parameters))
    for key, was, now in keys:
        yield Cause("key", stage, f"{key}: {was} → {now}")
    if changed or keys or before.inputs.keys() != after.inputs.keys():
        return
    versions = [
        f"{name} {before.software.get(name, 'absent')} → {version}"
        for name, version in after.software.items()
        if before.software.get(name) != version
    ]
    if versions:
        yield Cause("software", stage, ", ".join(versions))
    else:
        yield Cause("code", stage, "the code of the stage, or of a library of the same version")


def _differences(old: Any, new: Any, key: str = "") -> Iterator[tuple[str, str, str]]:
    """Key path, old and new value of all that differs between two plain structures."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for name in sorted(old.keys() | new.keys()):
            yield from _differences(old.get(name), new.get(name), f"{key}.{name}" if key else name)
    elif old != new:
        yield key, _quoted(old), _quoted(new)


def _quoted(value: Any) -> str:
    text = "not set" if value is None else canonical_json(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def _renamed(old: Mapping[str, Provenance], new: Mapping[str, Provenance]) -> Iterator[tuple[str, set[str]]]:
    yield "without", set(old) - set(new)
    yield "with", set(new) - set(old)
