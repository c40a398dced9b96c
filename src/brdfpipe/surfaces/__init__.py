"""Surfaces: what a profilometer measured, levelled, checked and summed up.

``read_surface`` reads one file of a known format, ``level`` takes the form away, ``low_pass`` and ``high_pass`` filter,
``parameters`` gives the ISO 25178-2 and ISO 21920-2 numbers, ``ingest`` is the stage of the workflow: read, check, level and
filter as a material file says.
"""

from __future__ import annotations

from brdfpipe.surfaces.filtering import high_pass, low_pass
from brdfpipe.surfaces.levelling import level
from brdfpipe.surfaces.parameters import parameters
from brdfpipe.surfaces.reading import ingest, read_surface
from brdfpipe.surfaces.x3p import write_x3p

__all__ = ["high_pass", "ingest", "level", "low_pass", "parameters", "read_surface", "write_x3p"]
