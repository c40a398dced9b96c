"""Where a quantity does not apply to a material, and what its model leaves out, each with the reason and the remedy.

Every ``…_exclusion`` returns a sentence, or an empty text where the quantity applies.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.colours import BLACK
from brdfpipe.appearance.haze import WINDOWS
from brdfpipe.appearance.origin import (
    Datasets,
    gloss_readings,
    has_finish,
    has_no_diffuse_base,
    is_metal,
    route,
)

HAZE_ANGLES = (20.0, 60.0)
"""Gloss geometries of ASTM D4039 [degree]."""

HIGH_GLOSS = 70.0
"""Gloss units at 60° above which ASTM D4039 applies."""

ISO_WINDOW = WINDOWS[0].title
"""Window of the reflectance haze after ISO 13803."""


def gloss_units(appearance: xr.Dataset | None) -> dict[float, float]:
    """Gloss units by geometry [degree], of those that were computed."""
    if appearance is None or "gloss" not in appearance:
        return {}
    angles, values = appearance["gloss_angle"].values.tolist(), appearance["gloss"].values.tolist()
    return {angle: value for angle, value in zip(angles, values, strict=True) if math.isfinite(value)}


def reflectance_haze_by_window(appearance: xr.Dataset | None) -> dict[str, float]:
    """Reflectance haze [gloss units] by the title of its window."""
    if appearance is None or not {"reflectance_haze", "haze_window"} <= set(appearance.variables):
        return {}
    windows = map(str, appearance["haze_window"].values)
    return dict(zip(windows, appearance["reflectance_haze"].values.tolist(), strict=True))


_NO_FINISH = (
    "No surface finish was measured or assumed. The BRDF is perfectly diffuse, and its {quantity} is not that of the material. "
    "Set `surface` in material.yaml to model it."
)


def gloss_exclusion(datasets: Datasets) -> str:
    """Gloss needs a surface finish, and a paint needs its clear coat."""
    if not has_finish(datasets):
        return _NO_FINISH.format(quantity="gloss")
    # The appearance stage states this of a paint without a modelled clear coat.
    return str(datasets["appearance"].attrs.get("no_gloss", "")) if "appearance" in datasets else ""


def haze_exclusion(datasets: Datasets) -> str:
    """ASTM D4039 needs gloss at 20° and 60°, a nonmetallic surface and high gloss."""
    gloss = gloss_units(datasets.get("appearance"))
    if reason := gloss_exclusion(datasets):
        return reason
    if not set(HAZE_ANGLES) <= set(gloss):
        return "D4039 needs gloss at 20° and at 60°. Add both to `gloss_angles`."
    if is_metal(datasets.get("bsdf")):
        return "D4039 is for nonmetallic surfaces. This surface is a metal."
    if not gloss[60.0] > HIGH_GLOSS:
        return f"D4039 is for more than {HIGH_GLOSS:g} gloss units at 60°. This surface has {gloss[60.0]:.1f}."
    return ""


def reflectance_haze_exclusion(datasets: Datasets) -> str:
    """ISO 13803 needs gloss to apply, and its window among those computed."""
    if reason := gloss_exclusion(datasets):
        return reason
    windows = reflectance_haze_by_window(datasets.get("appearance"))
    if windows and ISO_WINDOW not in windows:
        return f"The window of ISO 13803 ({ISO_WINDOW}) was not computed. Add it to `appearance.haze`."
    return ""


def flop_exclusion(datasets: Datasets) -> str:
    """The flop index is for effect paints; it needs a surface that darkens away from the mirror direction, and one not black at 45°.

    A BRDF that was measured, or comes from a file, may be that of an effect paint.
    """
    if has_finish(datasets) and route(datasets) == "predicted" and "bsdf" in datasets:
        return (
            "The flop index is for paints with effect pigments: of others it tells how glossy they are. A paint with effect pigments has "
            "`multiangle` in material.yaml."
        )
    if not has_finish(datasets):
        return _NO_FINISH.format(quantity="flop index")
    appearance = datasets.get("appearance", xr.Dataset())
    if "flop_index" not in appearance or math.isfinite(float(appearance["flop_index"])):
        return ""
    lightness = appearance["lab"].isel(component=0).to_series().to_dict() if "geometry" in appearance.coords else {}
    near, middle, far = (lightness.get(f"45as{angle}", math.nan) for angle in (15, 45, 110))
    if far > near:
        return f"The flop index is for surfaces that darken away from the mirror direction. L* is {near:.1f} at 15° and {far:.1f} at 110°."
    return f"The flop index is not defined for black: L* is {middle:.2g} at 45°." if middle < BLACK else ""


# --- limits of the model


def limits(datasets: Datasets) -> list[str]:
    """Sentences: what was not measured, modelled, checked or computed, and which key of material.yaml changes it."""
    return [*_finish_limits(datasets), *_spectrum_limits(datasets), *_missing_stages(datasets)]


def _finish_limits(datasets: Datasets) -> Iterator[str]:
    warned = any(vocabulary.warnings(datasets[stage]) for stage in ("predicted", "bsdf") if stage in datasets)
    if not has_finish(datasets):
        if not warned:  # the stage that assumes a perfect diffuser warns of it
            yield (
                "Gloss and haze are not modelled. No surface finish was measured or assumed. The BRDF is perfectly diffuse. "
                "Set `surface` in material.yaml to model gloss and haze."
            )
    elif (readings := gloss_readings(datasets)) and route(datasets) == "predicted":
        yield (
            f"The surface finish is known by its gloss alone ({readings}). The angular figures are those of the mean of all slope densities from Beckmann's "
            "to GGX with this gloss, and their uncertainties cover these. A lay, waviness and light that is scattered as waves are not known."
        )
    elif "facets" in datasets and "surface" not in datasets and route(datasets) == "predicted":
        method = str(datasets["facets"].attrs.get("method", "")).strip()
        yield (
            f"The surface finish is assumed{f' ({method})' if method else ''}, not measured. Gloss, haze and the angular "
            "figures follow from the assumption. Set `surface: file` in material.yaml to use a measurement."
        )


def _spectrum_limits(datasets: Datasets) -> Iterator[str]:
    if route(datasets) == "imported":
        yield from _colour_limits_of_file(datasets["bsdf"])
        return
    needs_spectrum = route(datasets) != "measured" and not has_no_diffuse_base(datasets.get("bsdf"))
    if needs_spectrum and not {"spectrum", "multiangle"} & set(datasets):
        yield (
            "Colour and diffuse reflection are not modelled. No spectrum is known. The BRDF contains only the light that the facets "
            "mirror. Set `spectrum` in material.yaml to model the rest."
        )


def _colour_limits_of_file(bsdf: xr.Dataset) -> Iterator[str]:
    if "wavelength" not in bsdf.coords:
        yield "The file has no colour: its values hold at all wavelengths, and the colours are those of a grey."
    elif "spectrum_of_rgb" in bsdf:
        yield (
            f"The file has colours, no spectra. They are exact under {bsdf.attrs['illuminant']} for the {bsdf.attrs['observer']}° observer. "
            "Under other lights and for the other observer they follow from smooth spectra of these colours; of colours outside sRGB these are paler."
        )


def _missing_stages(datasets: Datasets) -> Iterator[str]:
    if "bsdf" not in datasets:
        yield "No BRDF was built."
    elif "checks" not in datasets:
        yield "The BRDF was not checked for reciprocity and energy."
    if "appearance" not in datasets:
        yield "Gloss, haze and colour were not computed."
