"""The keys of a scene: what a BRDF is for, and what of it is needed."""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from brdfpipe.descriptions.keys import WHOLE, Choice, Items, Keys, OneOf, key
from brdfpipe.errors import InputError
from brdfpipe.exchange.registry import WRITTEN
from brdfpipe.scenes.domain_keys import DomainKeys
from brdfpipe.scenes.glare_keys import GlareKeys
from brdfpipe.scenes.results import RESULTS

BANDS = ("photopic", "rgb")
POLARISATIONS = ("unpolarised", "mueller")

METRIC_UNITS = {"glare": "relative", "colour": "ΔE00", "gloss": "GU", "rendering": "ΔE_ITP"}
"""Unit in words by metric, of those of :data:`brdfpipe.scenes.metrics.METRICS`, which is slow to import."""

METRICS_OF_DOMAINS = ("glare", "colour")
"""Metrics that compare BRDFs in the domain of the scene. The standard fixes the directions of gloss, and pictures have those of the preview."""

CHEAPEST = "cheapest"
MODELS = (CHEAPEST, "fullest")

AS_MATERIAL = "material"
"""The scene exports the formats that each material names."""

_SPECTRAL = ("bsdf", "colour", "preview", "table")


def _list_or_word(value: Any) -> int:
    return 0 if isinstance(value, list) else 1


Wavelengths = Annotated[
    list[Annotated[float, Field(ge=100, le=20_000, description="a wavelength")]],
    Field(min_length=1),
    Items(rising=True),
]
Formats = Annotated[list[Annotated[str, OneOf(WRITTEN)]], Items()]


class Budget(Keys):
    """What one material may cost. A build says which materials exceed it."""

    at_least_one = ("seconds", "bytes")
    none_given = "the budget is empty"

    seconds: float = key("time of all jobs of a material", unit="s", gt=0, example=10)
    bytes: Annotated[int, WHOLE] = key(
        "size of all results of a material, shared ones included", gt=0, example=5_000_000
    )


class SceneKeys(Keys):
    """A scene: what the BRDF of a material is for. A build computes only what the scene asks for."""

    purpose: str = key("one line for the reader", required=True, min_length=1, max_length=200)
    domain: DomainKeys = key(
        "the pairs of directions that the scene needs {geometries, cones, ranges, hemisphere, side}; "
        "gloss, haze and colours are computed at those of their geometries that are in it",
        required=True,
    )
    bands: Annotated[Wavelengths | Annotated[str, OneOf(BANDS)], Choice(_list_or_word)] = key(
        "what the scene needs of the spectrum: photopic (weighted with V(λ)·D65), rgb, or a list of wavelengths",
        unit="nm",
        default="photopic",
    )
    polarisation: Annotated[str, OneOf(POLARISATIONS)] = key(
        "unpolarised, or mueller: the scene evaluates Mueller matrices of the BRDF", default="unpolarised"
    )
    results: Annotated[list[Annotated[str, OneOf(tuple(RESULTS))]], Items()] = key(
        "what is computed; everything that these need follows", required=True
    )
    exports: Annotated[Formats | Annotated[str, OneOf((AS_MATERIAL,))], Choice(_list_or_word)] = key(
        "files for other programs: a list of formats, or material: those that each material names", default=[]
    )
    glare: GlareKeys = key(
        "for `veiling_glare`: windscreen, light and driver {windscreen, sun, sky, line_of_sight, distance, material_azimuth}",
        details="See [veiling glare](veiling-glare.md).",
    )
    viewing_distance: float = key(
        "for `texture`: distance from which the material is seen; the pixel of its texture is then the coarsest with the contrast that an eye sees there",
        unit="m",
        default_words="the pixel that the material names",
        gt=0,
        le=1000,
        example=0.7,
        details="See [levels of detail](texture.md#levels-of-detail).",
    )
    metric: Annotated[str, OneOf(tuple(METRIC_UNITS))] = key(
        f"the error that matters: {', '.join(f'{name} ({unit})' for name, unit in METRIC_UNITS.items())}", required=True
    )
    tolerance: float = key("the error that is accepted, in the unit of the metric", required=True, gt=0)
    model: Annotated[str, OneOf(MODELS)] = key(
        "the model of surfaces: cheapest, the cheapest whose error, expected from other materials, the scene accepts; or fullest",
        default=CHEAPEST,
        details="`uncertainty`, `model_error` and `comparison` are of the fullest model; keys of `model` in material.yaml decide themselves.",
    )
    budget: Budget = key("what one material may cost {seconds, bytes}")

    @model_validator(mode="after")
    def _check_results(self) -> Self:
        """Refuse a scene that asks for nothing, and needs that none of its results meets."""
        if not self.results and not self.exports:
            accepted = f"some of {', '.join(RESULTS)}; or `exports`"
            raise InputError("", "the scene asks for nothing", where="results", found="[]", accepted=accepted)
        if self.glare is not None and "veiling_glare" not in self.results:
            accepted = "`veiling_glare` in `results`; or no `glare`"
            raise InputError("", "no result of the scene has this geometry", where="glare", accepted=accepted)
        if self.viewing_distance is not None and "texture" not in self.results:
            accepted = "`texture` in `results`; or no `viewing_distance`"
            raise InputError("", "no result of the scene depends on it", where="viewing_distance", accepted=accepted)
        if self.bands not in BANDS[:1] and not set(_SPECTRAL) & set(self.results):
            found = self.bands if isinstance(self.bands, str) else f"{len(self.bands)} wavelengths"
            accepted = f"photopic; or one of {', '.join(_SPECTRAL)} in `results`"
            raise InputError(
                "", "no result of the scene has these bands", where="bands", found=found, accepted=accepted
            )
        if self.bands == "rgb" and "table" in self.results:
            accepted = "photopic or a list of wavelengths; or no `table` in `results`"
            raise InputError("", "the table has no such bands", where="bands", found="rgb", accepted=accepted)
        if self.polarisation == "mueller" and "bsdf" not in self.results:
            accepted = "unpolarised; or `bsdf` in `results`, which evaluates Mueller matrices"
            raise InputError(
                "", "no result of the scene is polarised", where="polarisation", found="mueller", accepted=accepted
            )
        return self
