"""What the model of a material leaves out, and which input would add it."""

from __future__ import annotations

from collections.abc import Iterator

from brdfpipe import vocabulary
from brdfpipe.appearance.origin import Datasets, has_finish, has_no_diffuse_base, route


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
    elif "facets" in datasets and "surface" not in datasets and route(datasets) == "predicted":
        method = str(datasets["facets"].attrs.get("method", "")).strip()
        yield (
            f"The surface finish is assumed{f' ({method})' if method else ''}, not measured. Gloss, haze and the angular "
            "figures follow from the assumption. Set `surface: file` in material.yaml to use a measurement."
        )


def _spectrum_limits(datasets: Datasets) -> Iterator[str]:
    needs_spectrum = route(datasets) != "measured" and not has_no_diffuse_base(datasets.get("bsdf"))
    if needs_spectrum and not {"spectrum", "multiangle"} & set(datasets):
        yield (
            "Colour and diffuse reflection are not modelled. No spectrum is known. The BRDF contains only the light that the facets "
            "mirror. Set `spectrum` in material.yaml to model the rest."
        )


def _missing_stages(datasets: Datasets) -> Iterator[str]:
    if "bsdf" not in datasets:
        yield "No BRDF was built."
    elif "checks" not in datasets:
        yield "The BRDF was not checked for reciprocity and energy."
    if "appearance" not in datasets:
        yield "Gloss, haze and colour were not computed."
