"""The locked requirements are those of pyproject.toml: every declared library is in its lock, in an accepted version, with hashes."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROJECT = Path(__file__).parents[1]
DECLARED = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))
EXTRAS = DECLARED["project"]["optional-dependencies"]
GROUPS = DECLARED["dependency-groups"]

LOCKS = {
    "requirements.lock": GROUPS["build"],
    "requirements-dev.lock": GROUPS["build"] + GROUPS["dev"],
    "requirements-instruments.lock": EXTRAS["instruments"] + EXTRAS["excel"] + EXTRAS["plot"],
    "requirements-peers.lock": GROUPS["peers"],
    "requirements-cluster.lock": EXTRAS["cluster"],
    "requirements-docs.lock": GROUPS["docs"],
}
"""Lock → what it holds beside the dependencies of the package, as `make lock` resolves them."""


def locked(name: str) -> dict[str, str]:
    """Distribution → version of a lock."""
    text = (PROJECT / name).read_text(encoding="utf-8")
    return {
        canonicalize_name(one): version for one, version in re.findall(r"^([\w.-]+)==([^\s;\\]+)", text, re.MULTILINE)
    }


def test_every_lock_is_listed() -> None:
    assert {path.name for path in PROJECT.glob("requirements*.lock")} == set(LOCKS)


@pytest.mark.parametrize("name", LOCKS)
def test_a_lock_holds_what_is_declared(name: str) -> None:
    versions = locked(name)
    for text in [*DECLARED["project"]["dependencies"], *LOCKS[name]]:
        requirement = Requirement(text)
        version = versions.get(canonicalize_name(requirement.name))
        assert version is not None, f"{text} is not in {name}: make lock"
        assert requirement.specifier.contains(version), f"{text}, and {name} has {version}: make lock"


def test_the_locks_agree_with_each_other() -> None:
    development = locked("requirements-dev.lock")
    for name in LOCKS:
        versions = locked(name)
        assert {one: versions[one] for one in versions.keys() & development} == {
            one: development[one] for one in versions.keys() & development
        }, f"{name}: make lock"


@pytest.mark.parametrize("name", LOCKS)
def test_a_lock_names_hashes_and_no_registry(name: str) -> None:
    text = (PROJECT / name).read_text(encoding="utf-8")
    assert "://" not in text
    entries = re.split(r"^(?=[\w.-]+==)", text, flags=re.MULTILINE)[1:]
    assert all("--hash=sha256:" in entry for entry in entries)
