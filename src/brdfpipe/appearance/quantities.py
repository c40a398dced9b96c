"""The table of appearance quantities.

The page of a material, the catalogue's page, ``catalogue.csv``, ``catalogue.nc`` and ``docs/quantities.md`` are rendered from this
table. To add a quantity, register it here: :attr:`AppearanceQuantity.compute` computes it from the BSDF in the appearance stage.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import xarray as xr

from brdfpipe.appearance import applicability, transmission
from brdfpipe.appearance.applicability import HAZE_ANGLES, ISO_WINDOW, gloss_units, reflectance_haze_by_window
from brdfpipe.appearance.gloss_basis import basis_note
from brdfpipe.appearance.origin import Datasets, is_measured
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import BrdfpipeError
from brdfpipe.spectra.colorimetry import reflectance_to_xyz
from brdfpipe.vocabulary import QUANTITIES


@dataclass(frozen=True)
class Applicability:
    """When a quantity applies; shared by quantities that apply together."""

    name: str
    """The catalogue stores the reasons as ``no_<name>``."""
    words: str
    """For the documentation."""
    exclusion: Callable[[Datasets], str]
    """Why the quantity does not apply to a material; empty where it applies."""
    blank: bool = False
    """Whether the catalogue shows an empty cell, and not a dash, where the quantity does not apply."""


@dataclass(frozen=True)
class AppearanceQuantity:
    """A number that describes how a material appears, and how it is written."""

    name: str
    """Column of ``catalogue.csv`` and variable of ``catalogue.nc``."""
    label: str
    """Heading on the catalogue's page, and of the tile on the page of the material."""
    symbol: str
    unit: str
    """``GU`` (gloss units), ``um``, ``cd m-2``, ``degree`` or ``1``."""
    decimals: int
    definition: str = ""
    """By default the long name of the variable ``name`` in the vocabulary."""
    standard: str = ""
    read: Callable[[Datasets], float] | None = None
    """The value [unit] from the datasets of a material, NaN where not known; by default the variable ``name`` of the appearance."""
    compute: Callable[[xr.Dataset], float | None] | None = None
    """The value [unit] from a BSDF, stored in the appearance dataset; None where the quantity does not exist."""
    u: Callable[[Datasets], float] | None = None
    """The standard uncertainty [unit] with that of the BSDF, NaN where that is not known; None for a quantity without one."""
    applicability: Applicability | None = None
    tile: str = ""
    """Title of the tile, where it is not the label. Quantities with the same title share one tile."""
    hint: Callable[[Datasets], str] | str = ""
    """Small print below the value of the tile."""
    percent: bool = False
    """Whether the tile shows a share in percent."""
    significant: int = 0
    """Significant digits of the tile, for values that span decades; 0: as many decimals as in the catalogue."""
    listed: bool = True
    """Whether pages show it; all files do."""
    appended: bool = False
    """Whether its column stands at the end of ``catalogue.csv``, behind the older ones, which keep their places."""
    on_request: bool = False
    """Whether it is computed only where a scene asks for it, and is a column of the catalogue only there."""

    def __post_init__(self) -> None:
        if not self.definition:
            object.__setattr__(self, "definition", QUANTITIES[self.name].long_name)

    @property
    def stored_unit(self) -> str:
        """The unit in files; gloss units are dimensionless."""
        return "1" if self.unit == "GU" else self.unit

    def exclusion(self, datasets: Datasets) -> str:
        """Why the quantity does not apply; empty where it applies."""
        return self.applicability.exclusion(datasets) if self.applicability else ""

    def value(self, datasets: Datasets) -> float:
        """The value [unit] of a material; NaN where it is not known or does not apply."""
        if self.exclusion(datasets):
            return math.nan
        if self.read is not None:
            return self.read(datasets)
        appearance = datasets.get("appearance", xr.Dataset())
        return float(appearance[self.name]) if self.name in appearance else math.nan

    @property
    def u_name(self) -> str:
        """Column of the uncertainty; empty for a quantity without one."""
        return f"{self.name}_u" if self.u else ""

    @property
    def u_definition(self) -> str:
        return f"standard uncertainty of: {self.definition}; from the inputs of the BRDF, its model and the instrument"

    def uncertainty(self, datasets: Datasets) -> float:
        """The standard uncertainty [unit] of a material; NaN where that of the BSDF is not known, or the quantity does not apply."""
        return math.nan if self.u is None or self.exclusion(datasets) else self.u(datasets)


_TABLE: dict[str, AppearanceQuantity] = {}


def register(quantity: AppearanceQuantity) -> AppearanceQuantity:
    """Add a quantity at the end of the table. Raises BrdfpipeError: the table already has a quantity of that name."""
    if quantity.name in _TABLE:
        raise BrdfpipeError(f"appearance quantity {quantity.name!r} is registered twice; choose another name")
    _TABLE[quantity.name] = quantity
    return quantity


def quantities() -> tuple[AppearanceQuantity, ...]:
    """The quantities of every material, in the order of the catalogue's columns."""
    return tuple(quantity for quantity in _TABLE.values() if not quantity.on_request)


def quantities_on_request() -> tuple[AppearanceQuantity, ...]:
    """The quantities that are computed only where they are asked for."""
    return tuple(quantity for quantity in _TABLE.values() if quantity.on_request)


def values(datasets: Datasets) -> dict[AppearanceQuantity, float]:
    """The value [unit] of every quantity of a material, those on request last; NaN where it is not known or does not apply."""
    return {quantity: quantity.value(datasets) for quantity in (*quantities(), *quantities_on_request())}


def quantity(name: str) -> AppearanceQuantity:
    return _TABLE[name]


def applicabilities() -> tuple[Applicability, ...]:
    """The distinct applicabilities of all quantities."""
    return tuple(dict.fromkeys(quantity.applicability for quantity in quantities() if quantity.applicability))


def computed(bsdf: xr.Dataset) -> dict[str, xr.DataArray]:
    """Quantities that are computed from a BSDF, as variables of the appearance dataset."""
    return {
        quantity.name: xr.DataArray(value, attrs={"units": quantity.stored_unit, "long_name": quantity.definition})
        for quantity in quantities()
        if quantity.compute and (value := quantity.compute(bsdf)) is not None
    }


def primary_lab(appearance: xr.Dataset | None) -> tuple[str, tuple[float, float, float]] | None:
    """The geometry that the appearance lists first, and its L*a*b*."""
    if appearance is None or "lab" not in appearance or appearance["lab"].size == 0:
        return None
    lightness, a, b = appearance["lab"].values[0].tolist()
    geometry = str(appearance["geometry"].values[0]) if "geometry" in appearance.coords else "1"
    return geometry, (lightness, a, b)


def viewing_conditions(appearance: xr.Dataset | None) -> str:
    """Illuminant and observer of the colours, ``D65/10°``."""
    if appearance is None:
        return ""
    return f"{appearance.attrs.get('illuminant', '')}/{appearance.attrs.get('observer', '')}°"


_DOCS_HEAD = """\
# Appearance quantities

Columns of `catalogue.csv` and variables of `catalogue.nc`, all of them on the page of the material and on that of the catalogue. A cell
is empty, and a variable NaN, where the quantity is not known or does not apply; `no_gloss`, `no_haze`, … of `catalogue.nc` state why.
"-style": computed after the standard; conformance is not claimed.
`_u` is the standard uncertainty, from the inputs of the BRDF, its model and the instrument; empty where that of the BRDF is not known.

`make keys` writes this file from `src/brdfpipe/appearance/quantities.py`.

| Column | Quantity | Symbol | Unit | Decimals | Definition | After | Applies to |
| --- | --- | --- | --- | --- | --- | --- | --- |
"""


def docs_table() -> str:
    """The table as Markdown: ``docs/quantities.md``."""
    lines = []
    for q in (*quantities(), *quantities_on_request()):
        scope = q.applicability.words if q.applicability else "scenes that ask for it" * q.on_request
        unit = {"um": "µm", "cd m-2": "cd/m²", "degree": "°"}.get(q.unit, q.unit)
        names = f"`{q.name}`, `{q.u_name}`" if q.u else f"`{q.name}`"
        cells = (names, q.label, q.symbol, unit, str(q.decimals), q.definition, q.standard, scope)
        lines.append("| " + " | ".join(cell.replace("|", "\\|").replace("*", "\\*") for cell in cells) + " |\n")
    return _DOCS_HEAD + "".join(lines)


# --- readers and hints


def _lab_hint(datasets: Datasets) -> str:
    lab = primary_lab(datasets.get("appearance"))
    return f"{lab[0]}, {viewing_conditions(datasets.get('appearance'))}" if lab else ""


def _luminous_reflectance(datasets: Datasets) -> float:
    """Total reflectance at 8° [1], of the appearance stage, else of the BSDF or the spectrum; NaN where it is not known."""
    if "appearance" in datasets and "luminous_reflectance" in datasets["appearance"]:
        return float(datasets["appearance"]["luminous_reflectance"])
    # The BSDF first: a spectrum measured with the specular component excluded is not the total.
    stages = ("bsdf",) if is_measured(datasets) else ("bsdf", "spectrum")
    source = next((datasets[s] for s in stages if s in datasets and "total_reflectance" in datasets[s]), None)
    if source is None or source.attrs.get("geometry") == "sce":
        return math.nan
    reflectance = source["total_reflectance"]
    if "wavelength" not in reflectance.dims:
        return float(reflectance)
    # V(λ) is the y function of the 2° observer, whichever observer the colours are for.
    return float(reflectance_to_xyz(reflectance["wavelength"].values, reflectance.values, "D65", 2)[1]) / 100


def _luminous_transmittance(datasets: Datasets) -> float:
    """Total transmittance at normal incidence [1]; NaN where nothing is transmitted."""
    if "appearance" in datasets:
        return float(datasets["appearance"].get("luminous_transmittance", math.nan))
    value = _if_transmitting(transmission.luminous_transmittance)(datasets["bsdf"]) if "bsdf" in datasets else None
    return math.nan if value is None else value


def _uncertainty(name: str, **at: Any) -> Callable[[Datasets], float]:
    """Reads the uncertainty of a variable of the appearance that includes that of the BSDF; ``at`` selects by coordinate, or by number."""

    def read(datasets: Datasets) -> float:
        appearance = datasets.get("appearance", xr.Dataset())
        # xarray would look for a similar name before it says that there is none.
        variable = appearance.variables.get(f"{name}_u")
        if variable is None or "BSDF" not in str(variable.attrs.get("long_name", "")):
            return math.nan
        u = appearance[f"{name}_u"]
        for dimension, label in at.items():
            if isinstance(label, int):
                u = u.isel({dimension: label})
            elif label in u[dimension].values:
                u = u.sel({dimension: label})
            else:
                return math.nan
        return float(u)

    return read


def _if_transmitting(compute: Callable[[xr.Dataset], float]) -> Callable[[xr.Dataset], float | None]:
    return lambda bsdf: compute(bsdf) if representation(bsdf).transmits else None


def _scalar(*stages: str, names: tuple[str, ...]) -> Callable[[Datasets], float]:
    """Reads the first scalar of these names from the first stage that the material has."""

    def read(datasets: Datasets) -> float:
        dataset = next((datasets[stage] for stage in stages if stage in datasets), xr.Dataset())
        return next((float(dataset[name]) for name in names if name in dataset), math.nan)

    return read


_rms_height = _scalar("surface", names=("Sq", "Rq"))
_slope_rms = _scalar("facets", "bsdf", names=("slope_rms",))


def _of_inputs(words: Callable[[Datasets], str]) -> Callable[[Datasets], str]:
    """A hint on an input of a prediction, which is marked where the BRDF was measured."""
    return lambda datasets: ", ".join(filter(None, ("of the prediction" * is_measured(datasets), words(datasets))))


def _slope_words(datasets: Datasets) -> str:
    slope = _slope_rms(datasets)
    return f"all azimuths, {math.degrees(math.atan(slope)):.2g}°" if slope else "perfectly flat"


def _lay_axis(datasets: Datasets) -> float | None:
    """Azimuth of the lay [degree], that of an axis, from 0 to 180; None where there is none."""
    facets = datasets.get("facets", datasets.get("bsdf", xr.Dataset()))
    lay = float(facets["lay"]) if "lay" in facets and "slope_along" in facets.dims else math.nan
    return round(lay % 180, 1) % 180 if math.isfinite(lay) else None


def _lay_words(datasets: Datasets) -> str:
    lay = _lay_axis(datasets)
    return "" if lay is None else f"lay {lay:g}°"


def _known(value: float | None) -> float:
    return math.nan if value is None else value


def _veil_words(datasets: Datasets) -> str:
    parts = (f"{part} {float(datasets['appearance'][f'veiling_luminance_{part}']):.3g}" for part in ("sun", "sky"))
    return ", ".join(parts)


# --- the quantities

_COMPONENTS = {"L": "lightness L*", "a": "a*", "b": "b*"}

_GLOSS = Applicability(
    "gloss", "a surface finish was measured or assumed; paints: with a clear coat", applicability.gloss_exclusion
)
_HAZE = Applicability(
    "haze", "nonmetallic surfaces of more than 70 gloss units at 60°", applicability.haze_exclusion, blank=True
)
_REFLECTANCE_HAZE = Applicability(
    "reflectance_haze", f"as gloss; window {ISO_WINDOW}", applicability.reflectance_haze_exclusion
)
_FLOP = Applicability(
    "flop",
    "paints with effect pigments, measured BRDFs and tables, that darken away from the mirror direction",
    applicability.flop_exclusion,
    blank=True,
)


_READINGS = Applicability(
    "readings",
    "materials with `measured`",
    lambda datasets: (
        "" if "readings" in datasets else "No reading of an instrument is given. Set `measured` in material.yaml."
    ),
    blank=True,
)


_LAY = Applicability(
    "lay",
    "surfaces with a lay",
    lambda datasets: "" if _lay_axis(datasets) is not None else "The surface has no lay, or none is known.",
    blank=True,
)


def _pitch(datasets: Datasets) -> float:
    """Distance between neighbouring heights along x [um]; NaN without a scan."""
    return float(datasets["surface"].attrs["pitch_x"]) if "surface" in datasets else math.nan


def _colour_at(geometry: str, k: int) -> Callable[[Datasets], float]:
    """L*, a* or b* at a geometry of the appearance; NaN where it was not computed."""

    def read(datasets: Datasets) -> float:
        appearance = datasets.get("appearance", xr.Dataset())
        if "lab" not in appearance or geometry not in appearance["lab"].coords.get("geometry", []):
            return math.nan
        return float(appearance["lab"].sel(geometry=geometry)[k])

    return read


def _colour_without_specular(k: int) -> Callable[[Datasets], float]:
    return lambda datasets: float(datasets.get("appearance", xr.Dataset()).get("lab_sce", [math.nan] * 3)[k])


def _furthest_z(datasets: Datasets) -> float:
    """z of the reading that is furthest from its prediction; NaN where none is predicted."""
    known = [z for z in datasets["readings"]["z"].values.tolist() if math.isfinite(z)]
    return max(known, key=abs, default=math.nan)


def _gloss_hint(standard: str, *angles: float) -> Callable[[Datasets], str]:
    return lambda datasets: f"{standard}-style{basis_note(datasets.get('appearance'), *angles)}"


def _haze_hint(datasets: Datasets) -> str:
    """Below 0 the difference tells the index: Fresnel's reflectance over that of the black glass grows more at 20° than at 60°."""
    words = _gloss_hint("D4039", *HAZE_ANGLES)(datasets)
    negative = quantity("haze").value(datasets) < 0
    return f"{words}; below 0 it is no haze: the index is above the standard's 1.567" if negative else words


def _gloss(angle: float) -> Callable[[Datasets], float]:
    return lambda datasets: gloss_units(datasets.get("appearance")).get(angle, math.nan)


def _reflectance_haze(datasets: Datasets) -> float:
    return reflectance_haze_by_window(datasets.get("appearance")).get(ISO_WINDOW, math.nan)


def _lab(k: int) -> Callable[[Datasets], float]:
    return lambda datasets: lab[1][k] if (lab := primary_lab(datasets.get("appearance"))) else math.nan


# fmt: off
for _quantity in (
    *(
        AppearanceQuantity(
            f"gloss_{angle:g}", f"Gloss {angle:g}°", f"G{angle:g}", "GU", 1,
            f"gloss units at {angle:g} degree, D523-style", "ASTM D523, ISO 2813",
            read=_gloss(angle), u=_uncertainty("gloss", gloss_angle=angle), applicability=_GLOSS, hint=_gloss_hint("D523", angle),
        )
        for angle in (20.0, 60.0, 85.0)
    ),
    AppearanceQuantity(
        "haze", "Haze D4039", "G60 − G20", "GU", 1, standard="ASTM D4039", u=_uncertainty("haze"),
        applicability=_HAZE, hint=_haze_hint,
    ),
    AppearanceQuantity(
        "reflectance_haze", "Haze ISO 13803", "H", "GU", 1, standard="ISO 13803, ASTM E430 B",
        read=_reflectance_haze, u=_uncertainty("reflectance_haze", haze_window=ISO_WINDOW), applicability=_REFLECTANCE_HAZE, hint="ISO 13803-style",
    ),
    *(
        AppearanceQuantity(
            name, f"{name}*", f"{name}*", "1", 1, f"CIE 1976 {words} at the first geometry of the appearance", "CIE 015",
            read=_lab(k), u=_uncertainty("lab", geometry=0, component=k), tile="L* a* b*", hint=_lab_hint,
        )
        for k, (name, words) in enumerate(_COMPONENTS.items())
    ),
    AppearanceQuantity(
        "flop_index", "Flop index", "FI", "1", 1,
        "flop index of the lightness at 15, 45 and 110 degree from the mirror direction",
        "Alman 1987, geometries of ASTM E2194", u=_uncertainty("flop_index"), applicability=_FLOP, hint="L* at 15°, 45° and 110°",
    ),
    AppearanceQuantity(
        "luminous_reflectance", "Reflectance", "ρ", "1", 3, standard="CIE 130",
        read=_luminous_reflectance, u=_uncertainty("luminous_reflectance"), tile="Total reflectance", hint="V(λ), D65", percent=True,
    ),
    AppearanceQuantity(
        "luminous_transmittance", "Transmittance", "τ", "1", 3, standard="CIE 130", read=_luminous_transmittance,
        compute=_if_transmitting(transmission.luminous_transmittance), u=_uncertainty("luminous_transmittance"),
        hint="at 0°, V(λ), D65", percent=True,
    ),
    AppearanceQuantity(
        "transmission_haze", "Haze D1003", "H", "1", 3,
        "share of the transmitted light scattered by more than 2.5 degree, D1003-style", "ASTM D1003",
        compute=_if_transmitting(transmission.transmission_haze), u=_uncertainty("transmission_haze"), hint="D1003-style",
        percent=True,
    ),
    AppearanceQuantity(
        "rms_height", "rms height", "Sq, Rq", "um", 3,
        "root mean square height of the levelled surface: Sq of a map, Rq of a line", "ISO 25178-2, ISO 21920-2",
        read=_rms_height, hint=_of_inputs(lambda datasets: "Sq" if "Sq" in datasets["surface"] else "Rq"), significant=3,
    ),
    AppearanceQuantity(
        "slope_rms", "rms slope", "", "1", 3, "root mean square slope of the facets", read=_slope_rms,
        hint=_of_inputs(_slope_words),
        significant=3,
    ),
    AppearanceQuantity(
        "anisotropy", "Anisotropy", "", "1", 2, read=_scalar("facets", "bsdf", names=("anisotropy",)),
        hint=_of_inputs(_lay_words), significant=3,
    ),
    AppearanceQuantity(
        "reading_z", "Readings, z", "z", "1", 1,
        "of the reading of an instrument that is furthest from its prediction: the difference over the standard uncertainty of both",
        read=_furthest_z, applicability=_READINGS, hint="read less predicted, over u", appended=True,
    ),
    *(
        AppearanceQuantity(
            f"{name}_sce", f"{name}* SCE", f"{name}*", "1", 1,
            f"CIE 1976 {words} of the reflectance at 8 degree without the light that a gloss trap of 5 degree half angle takes", "CIE 015",
            read=_colour_without_specular(k), tile="L* a* b* without the specular", hint="8°, SCE", appended=True,
        )
        for k, (name, words) in enumerate(_COMPONENTS.items())
    ),
    *(
        AppearanceQuantity(
            f"{name}_45_0", f"{name}* 45:0", f"{name}*", "1", 1, f"CIE 1976 {words} at 45:0", "CIE 015",
            read=_colour_at("45:0", k), u=_uncertainty("lab", geometry="45:0", component=k), tile="L* a* b* at 45:0", appended=True,
        )
        for k, (name, words) in enumerate(_COMPONENTS.items())
    ),
    AppearanceQuantity(
        "Sq", "Sq", "Sq", "um", 3, "root mean square height of the levelled map; empty for a line, whose Rq is the rms height", "ISO 25178-2",
        read=_scalar("surface", names=("Sq",)), significant=3, listed=False, appended=True,
    ),
    AppearanceQuantity(
        "pitch", "Pitch", "", "um", 3, "distance between neighbouring heights of the scan, along x", read=_pitch,
        significant=3, listed=False, appended=True,
    ),
    AppearanceQuantity(
        "missing_share", "Missing", "", "1", 4, "share of the heights of the scan that are missing",
        read=_scalar("surface", names=("missing_fraction",)), percent=True, listed=False, appended=True,
    ),
    AppearanceQuantity(
        "lay_azimuth", "Lay", "", "degree", 1, "azimuth of the lay, from 0 to 180 counter-clockwise from x",
        read=lambda datasets: _known(_lay_axis(datasets)), applicability=_LAY, listed=False, appended=True,
    ),
    AppearanceQuantity(
        "veiling_luminance", "Veiling luminance", "L", "cd m-2", 0,
        "luminance of the dashboard's image in the windscreen, of sun and sky; `_sun` and `_sky`: their parts",
        hint=_veil_words, significant=3, on_request=True,
    ),
):
    register(_quantity)
# fmt: on
