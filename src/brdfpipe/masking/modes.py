"""Modes of the model by name; light to import, because every check of a material reads them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

SMITH_MASKINGS = ("height-correlated", "separable")
"""Smith's maskings: reciprocal, and energy is conserved where light passes the surface too."""

PHYSICAL_MASKINGS = (*SMITH_MASKINGS, "measured")
"""Maskings that are reciprocal and conserve the energy of reflected light; ``measured`` is traced on the height map."""

MASKINGS_WITHOUT_LAY = ("measured", "liu")
"""Maskings that are defined for a surface without a lay alone."""

LARGEST_COMPARED = 75.0
"""Largest angle of incidence at which the light of the facets chooses the masking [degree]."""

MASKING_ADVISED = "masking_advised"
"""Attribute of a BSDF from heights: the masking that the light of their facets speaks for, where it was compared."""

SMITH_ERROR = "smith_error_in_peak"
"""Attribute of a BSDF from heights: the largest error of the light of their facets in the peak after Smith, up to 75 degree."""

MULTIPLE_SCATTERING_ADVISED = "multiple_scattering_advised"
"""Attribute of a BSDF of facets: the mode that ``multiple_scattering: auto`` means; the history says why."""

MODES = {
    "masking": ("auto", *PHYSICAL_MASKINGS, "blinn", "liu", "crf", "none"),
    "diffuse": ("coupled", "crf", "none"),
    "multiple_scattering": ("auto", "none", "compensated", "directional", "measured"),
}
"""Accepted modes by key of ``model``; the first one is the default.

Masking ``auto`` is ``measured`` where heights were measured and Smith's masking does not describe them, else Smith's height-correlated one.
Multiple scattering ``auto`` is ``none`` where little light is reflected more than once, and where :func:`allows_several_reflections` says
no; else ``measured`` on a height map, and ``directional`` without one, unless there is a lay.
"""

OPTICS = ("auto", "facets", "wave", "composite")
"""Accepted values of ``model.optics``; the first one is the default."""

WAVE_OPTICS = tuple(name for name in OPTICS if name != "facets")
"""Those that need a roughness spectrum."""

HALOS = ("ssa1", "ghs", "rayleigh-rice")
"""Accepted values of ``model.halo``, theories of light scattered by waves; the first one is the default."""

TRUTHS = ("check", "none", "use")
"""Accepted values of ``model.truth``; the first one is the default."""

MODEL_DEFAULTS = {key: names[0] for key, names in MODES.items()}
"""Modes that apply where neither the key nor a recipe is given."""

MASKINGS_OF_MULTIPLE_SCATTERING = {
    "none": MODES["masking"],
    "compensated": ("auto", *PHYSICAL_MASKINGS),
    **dict.fromkeys(("directional", "measured"), ("auto", "height-correlated", "measured")),
    "auto": MODES["masking"],
}
"""Masking modes with which each mode of ``multiple_scattering`` is defined."""


RECIPES = {"crf": {"masking": "crf", "diffuse": "crf", "multiple_scattering": "none"}}
"""Modes of one source, by its name."""


def allows_several_reflections(masking: str, diffuse: str) -> bool:
    """Whether ``multiple_scattering: auto`` may add light: not to the masking or diffuse part of a source, nor to separable masking."""
    return masking in MASKINGS_OF_MULTIPLE_SCATTERING["directional"] and diffuse != "crf"


def optics_of(model: Mapping[str, Any]) -> str:
    """The optics of the keys of ``model``: as given, else ``facets`` with the modes of a source that knows no waves, else the default."""
    if (given := model.get("optics")) is not None:
        return str(given)
    masking = model.get("masking") or MODEL_DEFAULTS["masking"]
    of_source = (
        model.get("recipe") is not None or model.get("diffuse") == "crf" or masking not in ("auto", *PHYSICAL_MASKINGS)
    )
    return "facets" if of_source else OPTICS[0]
