"""The keys of ``release.yaml``: what a published catalogue says of itself, the mandatory fields of DataCite 4.5 and some more."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from brdfpipe.descriptions.keys import Keys, key

URL = r"^https?://[^\s<>\"]+$"


class Creator(Keys):
    """A person or an organisation."""

    name: str = key("as it is cited: `Family, Given`, or an organisation", required=True, min_length=1, max_length=255)
    orcid: str = key("its ORCID", pattern=r"^https://orcid\.org/\d{4}-\d{4}-\d{4}-\d{3}[\dX]$")
    affiliation: str = key("its institution", min_length=1, max_length=255)


class Release(Keys):
    """A published state of a catalogue."""

    title: str = key("title of the release", required=True, min_length=1, max_length=500)
    description: str = key("what it holds, in a few sentences", required=True, min_length=1, max_length=5000)
    creators: list[Creator] = key("who made it {name, orcid, affiliation}", required=True, min_length=1, max_length=100)
    publisher: str = key("who publishes it", required=True, min_length=1, max_length=255)
    date: str = key('date of publication in quotes, as "2026-01-31"', required=True, pattern=r"^\d{4}-\d{2}-\d{2}$")
    license: str = key("address of the licence", required=True, pattern=URL)
    version: str = key("version of the release", min_length=1, max_length=64)
    identifier: str = key("persistent address, as https://doi.org/…", pattern=URL)
    keywords: Annotated[list[Annotated[str, Field(min_length=1, max_length=100)]], Field(max_length=50)] = key(
        "words to be found by"
    )
