"""The keys of ``catalogue.yaml``: what the materials of a catalogue inherit where they do not say it themselves."""

from collections.abc import Mapping
from typing import Annotated

from brdfpipe.catalogue.material_keys import (
    Colour,
    Geometry,
    IndexName,
    IndexNumber,
    IndexPair,
    MeasuredSpectrum,
    Observer,
    Scale,
)
from brdfpipe.descriptions.keys import Choice, Items, Keys, OneOf, key
from brdfpipe.exchange.registry import WRITTEN

_PLAIN_INDEX = Annotated[
    IndexPair | IndexNumber | IndexName,
    Choice(
        lambda index: (
            0 if isinstance(index, dict) else 2 if isinstance(index, str) and any(map(str.isalpha, index)) else 1
        )
    ),
]


class SurfaceDefaults(Keys):
    """How the scans of all materials are levelled and filtered."""

    form: Annotated[str, OneOf(("plane", "polynomial-2", "cylinder", "none"))] = key("as `surface.form` of a scan")
    lambda_s: float = key("as `surface.lambda_s` of a scan", unit="µm", gt=0, le=1_000_000)
    lambda_c: float = key("as `surface.lambda_c` of a scan", unit="µm", gt=0, le=1_000_000)
    outliers: Annotated[str, OneOf(("report", "remove"))] = key("as `surface.outliers` of a scan")
    isotropic: bool = key("as `surface.isotropic` of a scan")


class SpectrumDefaults(Keys):
    """How the spectra and colours of all materials were measured."""

    geometry: Geometry = key("as `spectrum.geometry`")
    incidence: float = key("as `spectrum.incidence`", unit="degree", ge=0, lt=90)
    specular_trap: float = key("as `spectrum.specular_trap`, where the geometry is sce", unit="degree", gt=0, le=90)
    scale: Scale = key("as `spectrum.scale`, of files")
    illuminant: str = key("as `spectrum.illuminant`, of colours")
    observer: Observer = key("as `spectrum.observer`, of colours")
    reflectance_uncertainty: float = key("as `spectrum.reflectance_uncertainty`", ge=0, le=0.5)


class CatalogueDefaults(Keys):
    """What the materials of a catalogue inherit."""

    requires = {"index_uncertainty": "index"}  # noqa: RUF012

    index: _PLAIN_INDEX = key(
        "as `index`, of materials with `surface`: a number, the name of a plastic or {n, k}; a file belongs to a material"
    )
    index_uncertainty: float = key(
        "standard uncertainty of that index; a material with an index of its own does not inherit it", ge=0, le=1
    )
    surface: SurfaceDefaults = key("of scans {form, lambda_s, lambda_c, outliers, isotropic}")
    spectrum: SpectrumDefaults = key("of spectra and colours {geometry, scale, illuminant, observer, …}")
    exports: Annotated[list[Annotated[str, OneOf(WRITTEN)]], Items()] = key("as `exports` of a material")
    scene: str = key("as `scene` of a material", min_length=1, max_length=255)


_OF_FORMS: Mapping[str, type[Keys]] = {"file": MeasuredSpectrum, "lab": Colour}
"""Key by which a form of ``spectrum`` is recognised → its keys."""


def accepted_by_spectrum(form: str) -> frozenset[str]:
    """The defaults that a form of ``spectrum`` has, ``file`` or ``lab``."""
    return frozenset(SpectrumDefaults.declared_keys()) & frozenset(_OF_FORMS[form].declared_keys())
