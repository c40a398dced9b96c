"""The table of appearance quantities.

The page of a material, the catalogue's page, ``catalogue.csv``, ``catalogue.nc`` and ``docs/quantities.md`` are rendered from this
table. To add a quantity, register it here: :attr:`AppearanceQuantity.compute` computes it from the BSDF in the appearance stage.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import xarray as xr

from brdfpipe.appearance import applicability, luminous, transmission
from brdfpipe.appearance.applicability import ISO_WINDOW, gloss_units, reflectance_haze_by_window
from brdfpipe.appearance.gloss_basis import basis_note
from brdfpipe.appearance.origin import Datasets, is_measured
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import BrdfpipeError


@dataclass(frozen=True)
class Applicability:
    """When a quantity applies; shared by quantities that apply together."""

    name: str
    """The catalogue keeps the reasons as ``no_<name>``."""
    words: str
    """For the documentation."""
    exclusion: Callable[[Datasets], str]
    """Why the quantity does not apply to a material; empty where it applies."""
    blank: bool = False
    """Whether the catalogue shows an empty cell, and not a dash, where the quantity does not apply."""


GLOSS = Applicability(
    "gloss", "a surface finish was measured or assumed; paints: with a clear coat", applicability.gloss_exclusion
)
HAZE = Applicability(
    "haze", "nonmetallic surfaces of more than 70 gloss units at 60°", applicability.haze_exclusion, blank=True
)
REFLECTANCE_HAZE = Applicability(
    "reflectance_haze", f"as gloss; window {ISO_WINDOW}", applicability.reflectance_haze_exclusion
)
FLOP = Applicability(
    "flop", "surfaces that darken away from the mirror direction", applicability.flop_exclusion, blank=True
)


@dataclass(frozen=True)
class AppearanceQuantity:
    """A number that describes how a material appears, and how it is written."""

    name: str
    """Column of ``catalogue.csv`` and variable of ``catalogue.nc``."""
    label: str
    """Heading on the catalogue's page, and of the tile on the page of the material."""
    symbol: str
    unit: str
    """``GU`` (gloss units), ``um``, or ``1``."""
    decimals: int
    definition: str
    standard: str = ""
    read: Callable[[Datasets], float] | None = None
    """The value [unit] from the datasets of a material, NaN where not known; by default the variable ``name`` of the appearance."""
    compute: Callable[[xr.Dataset], float | None] | None = None
    """The value [unit] from a BSDF, stored in the appearance dataset; None where the quantity does not exist."""
    applicability: Applicability | None = None
    tile: str = ""
    """Title of the tile, where it is not the label. Quantities with the same title share one tile."""
    hint: Callable[[Datasets], str] | str = ""
    """Small print below the value of the tile."""
    percent: bool = False
    """Whether the tile shows a share in percent."""
    significant: int = 0
    """Significant digits of the tile, for values that span decades; 0: as many decimals as in the catalogue."""
    on_page: bool = True
    in_catalogue: bool = True
    """Whether the catalogue's page shows the quantity; its CSV and netCDF files contain all quantities."""

    @property
    def tile_title(self) -> str:
        return self.tile or self.label

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

    def hint_words(self, datasets: Datasets) -> str:
        return self.hint if isinstance(self.hint, str) else self.hint(datasets)


_TABLE: dict[str, AppearanceQuantity] = {}


def register(quantity: AppearanceQuantity) -> AppearanceQuantity:
    """Add a quantity at the end of the table.

    Raises
    ------
    BrdfpipeError : the table already has a quantity of that name.
    """
    if quantity.name in _TABLE:
        raise BrdfpipeError(f"appearance quantity {quantity.name!r} is registered twice; choose another name")
    _TABLE[quantity.name] = quantity
    return quantity


def unregister(name: str) -> None:
    """Remove a quantity from the table."""
    del _TABLE[name]


def quantities() -> tuple[AppearanceQuantity, ...]:
    """All quantities, in the order of the catalogue's columns."""
    return tuple(_TABLE.values())


def applicabilities() -> tuple[Applicability, ...]:
    """The distinct applicabilities of all quantities."""
    return tuple(dict.fromkeys(quantity.applicability for quantity in quantities() if quantity.applicability))


def computed(bsdf: xr.Dataset) -> dict[str, xr.DataArray]:
    """Quantities that are computed from a BSDF, as variables of the appearance dataset."""
    values = {quantity: quantity.compute(bsdf) for quantity in quantities() if quantity.compute}
    return {
        quantity.name: xr.DataArray(
            value, attrs={"units": stored_unit(quantity), "long_name": quantity.definition}, name=quantity.name
        )
        for quantity, value in values.items()
        if value is not None
    }


def stored_unit(quantity: AppearanceQuantity) -> str:
    """The unit in files; gloss units are dimensionless."""
    return "1" if quantity.unit == "GU" else quantity.unit


def primary_lab(appearance: xr.Dataset | None) -> tuple[str, tuple[float, float, float]] | None:
    """The geometry that the appearance lists first, and its L*a*b*."""
    if appearance is None or "lab" not in appearance or appearance["lab"].size == 0:
        return None
    lightness, a, b = appearance["lab"].values[0].tolist()
    geometry = str(appearance["geometry"].values[0]) if "geometry" in appearance.coords else "1"
    return geometry, (lightness, a, b)


def viewing_conditions(appearance: xr.Dataset | None) -> str:
    """Illuminant and observer of the colours, ``D65/10°``."""
    return (
        ""
        if appearance is None
        else f"{appearance.attrs.get('illuminant', '')}/{appearance.attrs.get('observer', '')}°"
    )


def docs_table() -> str:
    """The table as Markdown: ``docs/quantities.md``."""
    header = ("Column", "Quantity", "Symbol", "Unit", "Decimals", "Definition", "After", "Applies to", "Shown on")
    rows = [header, ("---",) * len(header), *(_docs_row(quantity) for quantity in quantities())]
    lines = "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|").replace("*", "\\*") for cell in row) + " |" for row in rows
    )
    return f"{_DOCS_HEAD}\n{lines}\n"


_DOCS_HEAD = """\
# Appearance quantities

Columns of `catalogue.csv` and variables of `catalogue.nc`. A cell is empty, and a variable NaN, where the quantity is not known or
does not apply; `no_gloss`, `no_haze`, … of `catalogue.nc` state why. "-style": computed after the standard; conformance is not claimed.

`make keys` writes this file from `src/brdfpipe/appearance/quantities.py`.
"""


def _docs_row(quantity: AppearanceQuantity) -> tuple[str, ...]:
    places = [("page of the material", quantity.on_page), ("catalogue", quantity.in_catalogue)]
    return (
        f"`{quantity.name}`",
        quantity.label,
        quantity.symbol,
        {"um": "µm"}.get(quantity.unit, quantity.unit),
        str(quantity.decimals),
        quantity.definition,
        quantity.standard,
        quantity.applicability.words if quantity.applicability else "",
        ", ".join(place for place, shown in places if shown),
    )


# --- the quantities


def _gloss(angle: float) -> AppearanceQuantity:
    return AppearanceQuantity(
        f"gloss_{angle:g}",
        f"Gloss {angle:g}°",
        f"G{angle:g}",
        "GU",
        1,
        f"gloss units at {angle:g} degree, D523-style",
        "ASTM D523, ISO 2813",
        read=lambda datasets: gloss_units(datasets.get("appearance")).get(angle, math.nan),
        applicability=GLOSS,
        hint=lambda datasets: f"D523-style{basis_note(datasets.get('appearance'), angle)}",
    )


def _lab(k: int, name: str, words: str) -> AppearanceQuantity:
    return AppearanceQuantity(
        name,
        f"{name}*",
        f"{name}*",
        "1",
        1,
        f"{words} at the first geometry of the appearance",
        "CIE 015",
        read=lambda datasets: lab[1][k] if (lab := primary_lab(datasets.get("appearance"))) else math.nan,
        tile="L* a* b*",
        hint=_lab_hint,
    )


def _lab_hint(datasets: Datasets) -> str:
    appearance = datasets.get("appearance")
    lab = primary_lab(appearance)
    return f"{lab[0]}, {viewing_conditions(appearance)}" if lab else ""


def _transmission_haze(bsdf: xr.Dataset) -> float | None:
    return transmission.transmission_haze(bsdf) if representation(bsdf).transmits else None


def _luminous_transmittance(bsdf: xr.Dataset) -> float | None:
    return transmission.luminous_transmittance(bsdf) if representation(bsdf).transmits else None


def _scalar(stages: tuple[str, ...], name: str) -> Callable[[Datasets], float]:
    """Reads a scalar from the first stage that has it."""

    def read(datasets: Datasets) -> float:
        dataset = next((datasets[stage] for stage in stages if stage in datasets), xr.Dataset())
        return float(dataset[name]) if name in dataset else math.nan

    return read


def _prediction_note(datasets: Datasets) -> Iterator[str]:
    """Marks what belongs to the prediction that a measured material is compared with."""
    if is_measured(datasets):
        yield "of the prediction"


def _rms_height(datasets: Datasets) -> float:
    surface = datasets.get("surface", xr.Dataset())
    return next((float(surface[name]) for name in ("Sq", "Rq") if name in surface), math.nan)


def _rms_height_hint(datasets: Datasets) -> str:
    symbol = "Sq" if "Sq" in datasets["surface"] else "Rq"
    return ", ".join([*_prediction_note(datasets), symbol])


def _slope_hint(datasets: Datasets) -> str:
    slope = math.degrees(math.atan(_slope_rms(datasets)))
    return ", ".join([*_prediction_note(datasets), f"all azimuths, {slope:.2g}°"])


def _anisotropy_hint(datasets: Datasets) -> str:
    facets = datasets.get("facets", datasets.get("bsdf", xr.Dataset()))
    lay = float(facets["lay"]) if "lay" in facets and "slope_along" in facets.dims else math.nan
    # An axis has an azimuth from 0 to 180 degree.
    lay_words = [f"lay {round(lay % 180, 1) % 180:g}°"] if math.isfinite(lay) else []
    return ", ".join([*_prediction_note(datasets), *lay_words])


_slope_rms = _scalar(("facets", "bsdf"), "slope_rms")

for _quantity in (
    *(_gloss(angle) for angle in (20.0, 60.0, 85.0)),
    AppearanceQuantity(
        "haze",
        "Haze D4039",
        "G60 − G20",
        "GU",
        1,
        "gloss at 60 degree minus gloss at 20 degree, D4039-style",
        "ASTM D4039",
        applicability=HAZE,
        hint=lambda datasets: f"D4039-style{basis_note(datasets.get('appearance'), *applicability.HAZE_ANGLES)}",
    ),
    AppearanceQuantity(
        "reflectance_haze",
        "Haze ISO 13803",
        "H",
        "GU",
        1,
        "light beside the mirror image of a source, black glass being 100, ISO 13803-style",
        "ISO 13803, ASTM E430 B",
        read=lambda datasets: reflectance_haze_by_window(datasets.get("appearance")).get(ISO_WINDOW, math.nan),
        applicability=REFLECTANCE_HAZE,
        hint="ISO 13803-style",
    ),
    _lab(0, "L", "CIE 1976 lightness L*"),
    _lab(1, "a", "CIE 1976 a*"),
    _lab(2, "b", "CIE 1976 b*"),
    AppearanceQuantity(
        "flop_index",
        "Flop index",
        "FI",
        "1",
        1,
        "flop index of the lightness at 15, 45 and 110 degree from the mirror direction",
        "Alman 1987, geometries of ASTM E2194",
        applicability=FLOP,
        hint="L* at 15°, 45° and 110°",
    ),
    AppearanceQuantity(
        "luminous_reflectance",
        "Reflectance",
        "ρ",
        "1",
        3,
        "total reflectance at 8 degree, weighted with V(λ) and D65",
        "CIE 130",
        read=luminous.luminous_reflectance,
        tile="Total reflectance",
        hint="V(λ), D65",
        percent=True,
    ),
    AppearanceQuantity(
        "luminous_transmittance",
        "Transmittance",
        "τ",
        "1",
        3,
        "total transmittance at normal incidence, weighted with V(λ) and D65",
        "CIE 130",
        read=luminous.luminous_transmittance,
        compute=_luminous_transmittance,
        hint="at 0°, V(λ), D65",
        percent=True,
    ),
    AppearanceQuantity(
        "transmission_haze",
        "Haze D1003",
        "H",
        "1",
        3,
        "share of the transmitted light scattered by more than 2.5 degree, D1003-style",
        "ASTM D1003",
        compute=_transmission_haze,
        hint="D1003-style",
        percent=True,
    ),
    AppearanceQuantity(
        "rms_height",
        "rms height",
        "Sq, Rq",
        "um",
        3,
        "root mean square height of the levelled surface: Sq of a map, Rq of a line",
        "ISO 25178-2, ISO 21920-2",
        read=_rms_height,
        hint=_rms_height_hint,
        significant=3,
    ),
    AppearanceQuantity(
        "slope_rms",
        "rms slope",
        "",
        "1",
        3,
        "root mean square slope of the facets",
        read=_slope_rms,
        hint=_slope_hint,
        significant=3,
    ),
    AppearanceQuantity(
        "anisotropy",
        "Anisotropy",
        "",
        "1",
        2,
        "larger over smaller principal slope rms",
        read=_scalar(("facets", "bsdf"), "anisotropy"),
        hint=_anisotropy_hint,
        significant=3,
    ),
):
    register(_quantity)
