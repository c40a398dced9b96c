"""Choices of the microfacet model, and the light that it loses or compensates."""

from __future__ import annotations

import xarray as xr

from brdfpipe.appearance.multiple_scattering import MultipleScattering, multiple_scattering
from brdfpipe.bsdf.registry import representation
from brdfpipe.report.cards import Table
from brdfpipe.report.formatting import percent
from brdfpipe.report.plots.bsdf_sections import REFERENCE_WAVELENGTH

LOSS_LIMIT = 0.01
"""Share of the light lost to multiple scattering above which the page advises to compensate it."""

_NEGLIGIBLE_LOSS = 1e-4
_ENERGY_CONSERVING = ("height-correlated", "separable")
_TITLES = {
    "recipe": "Recipe",
    "masking": "Masking",
    "diffuse_mode": "Diffuse part",
    "multiple_scattering": "Multiple scattering",
    "transmission": "Transmission",
}


def model_table(bsdf: xr.Dataset) -> Table:
    """Choices of the model, with a note on multiple scattering."""
    rows = [(title, str(bsdf.attrs[name])) for name, title in _TITLES.items() if name in bsdf.attrs]
    several = None if representation(bsdf).transmits else multiple_scattering(bsdf, REFERENCE_WAVELENGTH)
    if several is None:  # the balance of the light covers what transmits
        return Table("Model", ("Choice", "Value"), rows)
    masking = str(bsdf.attrs["masking"])
    if masking not in _ENERGY_CONSERVING:
        return Table("Model", ("Choice", "Value"), rows, _masking_note(several, masking))
    rows.append(
        (f"Light reflected more than once, {'compensated' if several.compensated else 'lost'}", percent(several.share))
    )
    return Table("Model", ("Choice", "Value"), rows, *_note_and_remark(several))


def _masking_note(several: MultipleScattering, masking: str) -> str:
    return (
        f"Masking `{masking}` follows its source and need not conserve energy. Facets that are perfect mirrors would reflect "
        f"{percent(1 - several.mirrors)} of the light, mean over the hemisphere. `model.masking: height-correlated` never reflects more "
        "than arrives. The checks state where this model does."
    )


def _note_and_remark(several: MultipleScattering) -> tuple[str, str]:
    """A note, and a remark where the loss is large."""
    mean = f"mean over the hemisphere; for facets that are perfect mirrors {percent(max(several.mirrors, 0.0))}"
    if several.compensated:
        return (
            f"Light that leaves after two or more reflections, {percent(several.share)} ({mean}), is compensated by a diffuse part.",
            "",
        )
    loss = f"The model loses {percent(several.share)} of the light to multiple scattering ({mean})"
    if several.share < _NEGLIGIBLE_LOSS:
        return f"{loss}: negligible.", ""
    advice = f"{loss}. Set `model.multiple_scattering: compensated` to compensate it."
    return ("", advice) if several.share >= LOSS_LIMIT else (advice, "")
