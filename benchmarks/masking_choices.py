"""What the masking of the patent and of Liu costs in accuracy and saves in time, against rays on the map."""

from __future__ import annotations

import numpy as np
import xarray as xr
from choice_table import Choice, Metric, Option, largest, rms, timed
from surface_choices import INDEX, MAPS, SIZE, evaluation_time, samples, warm_up

from brdfpipe.bsdf import traced
from brdfpipe.bsdf.microfacet.builder import build as build_facets
from brdfpipe.bsdf.registry import representation
from brdfpipe.comparison.lobe_bins import LobeBins
from brdfpipe.comparison.model_error import BIN_ERROR
from brdfpipe.facets.estimation import estimate
from brdfpipe.geometry import Array
from brdfpipe.masking.visibility_choice import choose
from brdfpipe.references.height_mesh import HeightMesh
from brdfpipe.references.tracer import SlopeBins, trace

REFERENCE_RAYS = 10**6
"""Rays of each incidence of the reference."""
RAYS = 10**5
"""Rays of each incidence of the BSDF that is traced."""

_MASKINGS = {
    "none": "masking",
    "blinn": "slopes other than the facet's own",
    "crf": "masking of the incident light",
    "liu": "all but one neighbouring facet",
    "separable": "that high facets are seen from both directions",
    "height-correlated": "what slopes do not show: valleys, ridges",
    "measured": "",
}
_TRACED = "BSDF of 10⁵ rays an incidence"
_INCIDENCES = (30.0, 60.0, 75.0)


def masking() -> Choice:
    """The patent's and Liu's masking beside Smith's and those of the map."""
    warm_up()
    names = [*_MASKINGS, _TRACED]
    peak: dict[str, list[list[float]]] = {name: [] for name in names}
    whole: dict[str, list[float]] = {name: [] for name in names}
    seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
    sizes: dict[str, list[float]] = {name: [] for name in names}
    reciprocity: dict[str, float] = {}
    noises: list[float] = []
    for height in MAPS.values():
        surface = samples.surface(height)
        facets, mesh = estimate(surface), HeightMesh.of(surface)
        bins = SlopeBins.of(mesh.typical_slope)
        lobes = [LobeBins.of(bins, theta_i, None) for theta_i in _INCIDENCES]
        traces = [trace(mesh, theta_i, index=INDEX, bins=bins, rays=REFERENCE_RAYS, seed=1) for theta_i in _INCIDENCES]
        references = [traced_light.power[0].mean(axis=0).ravel() for traced_light in traces]
        regions = [_peak(lobe, _masked(surface, facets, "height-correlated")) for lobe in lobes]
        for traced_light, reference, region in zip(traces, references, regions, strict=True):
            noise = np.sqrt(np.sum(traced_light.ray_noise.ravel()[region] ** 2)) / reference[region].sum()
            noises.append(float(np.hypot(noise, BIN_ERROR)))
        for name in names:
            bsdf, build = timed(lambda name=name, surface=surface, facets=facets: _masked(surface, facets, name))
            lights = [lobe.total(lobe.brdf(representation(bsdf))) for lobe in lobes]
            both = list(zip(lights, references, strict=True))
            peak[name].append(
                [light[at].sum() / ray[at].sum() - 1 for (light, ray), at in zip(both, regions, strict=True)]
            )
            whole[name].append(both[-1][0].sum() / both[-1][1].sum() - 1)
            seconds[name].append((build, evaluation_time(bsdf)))
            sizes[name].append(bsdf.nbytes)
            reciprocity[name] = max(reciprocity.get(name, 0.0), _asymmetry(bsdf))
    options = []
    for name in names:
        by_map = np.array(peak[name])
        errors = {f"peak at {angle:g}°": rms(by_map[:, at]) for at, angle in enumerate(_INCIDENCES[:-1])}
        errors |= {f"75°: {kind}": abs(error) for kind, error in zip(MAPS, by_map[:, -1], strict=True)}
        errors["all light at 75°"] = rms(whole[name])
        errors["reciprocity"] = reciprocity[name]
        build, evaluation = np.mean(seconds[name], axis=0)
        times = {"build": float(build), "10⁶ directions": float(evaluation)}
        options.append(
            Option(_title(name), _MASKINGS.get(name, "noise of its rays"), errors, times, np.mean(sizes[name]))
        )
    metrics = {name: Metric("%", 1e-12 if name == "reciprocity" else 0.01) for name in options[0].errors}
    return Choice(
        "Masking",
        f"Light reflected once (n = {INDEX:g}) by maps of {SIZE}² heights ({', '.join(MAPS)}), against {REFERENCE_RAYS / 1e6:g} million other rays an "
        f"incidence, whose standard uncertainty in the peak, noise and bins, is up to {max(noises):.1%}. Peak: light where the BRDF after Smith is above 0.3 of its largest value; at 30 and 60° rms over the maps, at 75° of each map. "
        "Reciprocity: the largest |f(30°→75°)/f(75°→30°) − 1|. `crf` and `liu` are the sources' own; none of the first four has a compiled kernel.",
        metrics,
        "height-correlated (Smith)",
        options,
        sources=["crf (patent)", "liu (2015)"],
        ours="measured on the map",
        judged_by="all light at 75°",
    )


def _title(masking: str) -> str:
    titles = {"crf": "crf (patent)", "liu": "liu (2015)", "height-correlated": "height-correlated (Smith)"}
    return titles.get(masking, "measured on the map" if masking == "measured" else masking)


def _masked(surface: xr.Dataset, facets: xr.Dataset, masking: str) -> xr.Dataset:
    """Light reflected once with a masking, or of traced rays; without a diffuse part."""
    if masking == _TRACED:
        bsdf = traced.build(surface, index=INDEX, rays=RAYS, seed=7)
        single = representation(bsdf).single_reflection()
        assert single is not None
        return single
    visibility = choose(surface, facets, masking="measured") if masking == "measured" else None
    return build_facets(facets, index=INDEX, masking=masking, multiple_scattering="none", visibility=visibility)


def _peak(lobe: LobeBins, bsdf: xr.Dataset) -> Array:
    """Bins of the peak of the BRDF."""
    light, solid_angle = lobe.total(lobe.brdf(representation(bsdf))), lobe.total(np.ones_like(lobe.theta))
    brdf = light / np.where(solid_angle > 0, solid_angle, np.inf)
    return brdf > 0.3 * brdf.max()


def _asymmetry(bsdf: xr.Dataset) -> float:
    """Largest |f(i → o) / f(o → i) − 1| of a few azimuths."""
    phi, low, high = np.array([120.0, 150.0, 180.0]), np.full(3, 30.0), np.full(3, 75.0)
    evaluate = representation(bsdf).evaluate
    there, back = evaluate(low, 0 * phi, high, phi, None), evaluate(high, phi, low, 0 * phi, None)
    return largest((there / back - 1).ravel())
