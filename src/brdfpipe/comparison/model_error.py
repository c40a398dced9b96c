"""How far a predicted BSDF is from reference solutions on the height map that it was predicted from."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.appearance.diffracted_gloss import diffracted_gloss_u
from brdfpipe.appearance.gloss_meter import gloss
from brdfpipe.appearance.validity import ERROR_LIMITS, GLOSS_LIMITS, LARGEST_JUDGED, REFERENCES, certain_error
from brdfpipe.bsdf import kirchhoff, traced
from brdfpipe.bsdf.change_variables import MODEL_INCIDENCES, MODEL_REGIONS
from brdfpipe.bsdf.kirchhoff import light_warnings
from brdfpipe.bsdf.nonspectral import nonspectral, normalised_response
from brdfpipe.bsdf.reference_solution import GEOMETRIC, WAVELENGTH, facet_smoothness, holds, phase_variance
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.kirchhoff import Kirchhoff
from brdfpipe.comparison.lobe_bins import LobeBins, gloss_by_bin
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array
from brdfpipe.masking import ray_casting
from brdfpipe.masking.modes import (
    MASKING_ADVISED,
    MASKINGS_OF_MULTIPLE_SCATTERING,
    MULTIPLE_SCATTERING_ADVISED,
    SMITH_ERROR,
    SMITH_MASKINGS,
)
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.references.height_mesh import NOISE_LIMIT, HeightMapError, HeightMesh
from brdfpipe.references.tracer import SlopeBins, trace

GLOSS_ANGLES = (20, 60, 85)
MEAN = "mean over azimuth"
"""Name of the plane of incidence of a surface without a lay."""
RAYS = 800_000
"""Rays of all incidences together: a second, and 1 % in a region that holds a tenth of the light of an incidence."""
MASKING_LIMIT, MASKING_SIGNIFICANT = 0.05, 3.0
"""Difference of G2 above which the result warns, and the standard uncertainties that it must exceed."""
BIN_ERROR, GLOSS_BIN_ERROR = 0.004, 0.01
"""Relative error by the bins, of light and of gloss, and by the two triangles of a cell that are traced of the four that are counted."""
MOST_HEIGHTS = 2048
"""Heights along each axis in the middle of the map of which diffraction is computed."""
_LEAST_RETURNED = 0.95
"""Share of the light along the normal that diffraction on a map must return."""

_LINES = 256


def model_error(
    surface: xr.Dataset | Sequence[xr.Dataset],
    predicted: xr.Dataset,
    facets: xr.Dataset | None = None,
    *,
    rays: int = RAYS,
    seed: int = 0,
) -> xr.Dataset:
    """Compare the light of a predicted BSDF with that of traced rays and of Kirchhoff's diffraction on its own height map.

    Parameters
    ----------
    surface : kind ``surface``, levelled, a map or a line; or all scans of the facets. Rays meet all maps, diffraction and masking are of the first
    predicted : kind ``bsdf``, of an opaque body, predicted from these scans and from a refractive index
    facets : kind ``facets``, of these scans; says how much of their slopes is noise
    rays : of all incidences and scans together
    seed : of the positions of the rays

    Returns
    -------
    Dataset of kind ``model_error``: ``light_error(reference, plane, theta_i, region)``, predicted over reference light less 1;
    ``gloss_error(reference, plane, gloss_angle)``, predicted less reference gloss; both with ``_u`` and what they are made of.
    ``valid(reference, theta_i)`` and ``gloss_valid`` say where a reference holds; ``plane`` names the planes of incidence: along and across
    the lay of a surface that has one, else the mean over azimuth. ``g2_raycast(theta_i)`` is the masking of the mirror direction by rays cast
    along lines of heights, ``g2_height_correlated`` Smith's. NaN where a reference does not hold or refuses the map, as the attribute
    ``refusals`` (JSON) says; the attribute ``advice`` says what to change

    Raises
    ------
    VocabularyError : a dataset of the wrong kind, or a BSDF that transmits or has no refractive index.

    Notes
    -----
    The diffuse part is left out, and the BSDF is averaged over V(λ)·D65. Regions are those of the predicted BRDF: above 0.3 of its peak, above
    0.03, and the rest. Rays are counted in bins of the half vector's slope, and the model is integrated over the same bins.
    :func:`brdfpipe.bsdf.reference_solution.holds` says where references hold. Diffraction is computed if rays do not hold at some incidence, as
    the mean over azimuth. Of a line profile, masking alone is compared.

    The uncertainty of traced light is the noise of the rays on this map, and :data:`BIN_ERROR`; that of diffracted light the scatter between
    blocks of the map, and that of its gloss also the scatter by speckle between maps: they are of the surface, and the prediction shares the map.
    """
    scans = [surface] if isinstance(surface, xr.Dataset) else list(surface)
    surface = vocabulary.validate(scans[0], "surface")
    vocabulary.validate(predicted, "bsdf")
    index = _index(predicted)
    bare = representation(predicted).without_diffuse()
    model = nonspectral(predicted if bare is None else bare)
    meshes, refusal = _meshes(scans, 0.0 if facets is None else float(facets.get("noise_sigma", 0.0)))
    refusals = {"traced": refusal} if refusal else {}
    variance = phase_variance(surface, MODEL_INCIDENCES)
    slope = meshes[0].typical_slope if meshes else np.inf
    held = np.stack(holds(variance, slope, MODEL_INCIDENCES, facet_smoothness(surface, MODEL_INCIDENCES)))
    held[0] &= not refusal
    diffraction = None
    if (held[1] & ~held[0]).any():
        try:
            diffraction = _diffraction(_middle(surface), index)
        except HeightMapError as error:
            refusals["kirchhoff"] = str(error)
    held[1] &= diffraction is not None
    planes = _planes(model, diffraction is not None)
    bins = SlopeBins.of(slope if 0 < slope < np.inf else 0.1)
    predictions = [
        [_Prediction.of(model, bins, float(theta_i), phi_i) for theta_i in MODEL_INCIDENCES]
        for phi_i in planes.values()
    ]
    rays_each = -(-rays // (MODEL_INCIDENCES.size * len(planes)))

    def reference(name: str, row: int, prediction: _Prediction) -> _Light:
        if name == "traced" and held[0, row]:
            return _traced_light(meshes, model, index, prediction, rays_each, seed)
        if name == "kirchhoff" and held[1, row] and diffraction is not None:
            return _diffracted_light(diffraction, prediction)
        return _UNKNOWN

    lights = [
        [[reference(name, row, one) for row, one in enumerate(plane)] for plane in predictions] for name in REFERENCES
    ]
    result = _dataset(model, planes, predictions, lights, held).merge(_masking(surface))
    result["phase_variance"] = "theta_i", variance
    result.attrs = {"rays": rays, "seed": seed, "refusals": json.dumps(refusals, ensure_ascii=False)}
    result.attrs["advice"] = _advice(result, predicted)
    texts = _warnings(result, predicted)
    if diffraction is not None and held[1].any():
        texts += [f"diffraction on the map: {text}" for text in light_warnings(diffraction)]
    return vocabulary.label(vocabulary.add_warning(result, *texts), "model_error")


def _diffraction(surface: xr.Dataset, index: xr.Dataset) -> xr.Dataset:
    """Diffraction on the map.

    Raises
    ------
    HeightMapError : as :func:`brdfpipe.bsdf.kirchhoff.build`; or light is missing along the normal: it is diffracted further than the pitch of the map
        samples.
    """
    result = nonspectral(kirchhoff.build(surface, index=index, wavelength=[WAVELENGTH]))
    along_normal = np.zeros(1)
    smooth = float(fresnel(1.0, float(index["n"][0]), float(index["k"][0])).mean)
    share = float(representation(result).albedo(along_normal, along_normal, None)[0, 0]) / smooth
    if share < _LEAST_RETURNED:
        raise HeightMapError(
            f"diffraction on the map returns {share:.0%} of the light at normal incidence: the rest goes further than its pitch "
            "samples; measure with a finer pitch"
        )
    return result


def _dataset(
    model: xr.Dataset,
    planes: dict[str, float | None],
    predictions: list[list[_Prediction]],
    lights: list[list[list[_Light]]],
    held: NDArray[np.bool_],
) -> xr.Dataset:
    """Light and gloss of the model and of the references (reference, plane, incidence), and the differences."""
    of_glossmeters = [int(np.flatnonzero(angle == MODEL_INCIDENCES)[0]) for angle in GLOSS_ANGLES]
    by_region, by_gloss = ("reference", "plane", "theta_i", "region"), ("reference", "plane", "gloss_angle")

    def field(name: str) -> Array:
        return np.array([[[getattr(one, name) for one in plane] for plane in reference] for reference in lights])

    light = np.array([[one.light for one in plane] for plane in predictions])
    units = np.stack([gloss(model, GLOSS_ANGLES, azimuth=azimuth).values for azimuth in planes.values()])
    reference_gloss, gloss_u = (field(name)[..., of_glossmeters] for name in ("gloss", "gloss_u"))
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(field("light") > 0, light / field("light"), np.nan)
    return xr.Dataset(
        {
            "light": (by_region[1:], light),
            "reference_light": (by_region, field("light")),
            "light_error": (by_region, ratio - 1),
            "light_error_u": (by_region, ratio * field("relative_u")),
            "valid": (("reference", "theta_i"), (held & np.isfinite(ratio).any(axis=(1, 3))).astype(np.int8)),
            "gloss": (by_gloss[1:], units),
            "reference_gloss": (by_gloss, reference_gloss),
            "gloss_error": (by_gloss, units - reference_gloss),
            "gloss_error_u": (by_gloss, gloss_u),
            "gloss_valid": (
                ("reference", "gloss_angle"),
                (held[:, of_glossmeters] & np.isfinite(reference_gloss).any(axis=1)).astype(np.int8),
            ),
        },
        coords={
            "reference": list(REFERENCES),
            "plane": list(planes),
            "theta_i": MODEL_INCIDENCES,
            "region": list(MODEL_REGIONS),
            "gloss_angle": np.array(GLOSS_ANGLES, dtype=float),
        },
    )


def _middle(surface: xr.Dataset) -> xr.Dataset:
    """The middle of a large map."""
    sizes = {dim: surface.sizes[dim] for dim in surface["height"].dims}
    return surface.isel(
        {
            dim: slice((size - MOST_HEIGHTS) // 2, (size + MOST_HEIGHTS) // 2)
            for dim, size in sizes.items()
            if size > MOST_HEIGHTS
        }
    )


# --- what is compared


def _meshes(scans: Sequence[xr.Dataset], noise: float) -> tuple[list[HeightMesh], str]:
    """The maps that are traced, and why they cannot be; ``noise`` is the rms of white height noise [um]."""
    try:
        meshes = [HeightMesh.of(scan) for scan in scans]
    except HeightMapError as error:
        return [], str(error)
    noise_share = meshes[0].noise_share(noise)
    if noise_share > NOISE_LIMIT:
        return meshes, (
            f"{noise_share:.0%} of the mean square slope is noise, which the prediction leaves out and rays would meet; average scans of the same "
            "place, or smooth the heights (`surface.lambda_s`)"
        )
    return meshes, next(filter(None, map(traced.quantisation, meshes)), "")


def _index(predicted: xr.Dataset) -> xr.Dataset:
    """One refractive index for all wavelengths, with the weights of the mean over wavelength."""
    model = representation(predicted)
    if model.transmits or "n" not in predicted:
        raise VocabularyError(
            f"a BSDF of representation {model.name!r} has no reference solution; accepted: an opaque body with a refractive index"
        )
    response = normalised_response(predicted)
    mean = None if response is None else model.mean_index(response)
    n, k = mean or (float(predicted[name].values.flat[0]) for name in ("n", "k"))
    fields = {name: ("wavelength", np.full(2, value)) for name, value in (("n", n), ("k", k))}
    dataset = xr.Dataset(fields, {"wavelength": [360.0, 830.0]}, {"source": "mean over wavelength"})
    return vocabulary.label(dataset, "index")


def _planes(model: xr.Dataset, diffraction: bool) -> dict[str, float | None]:
    """Azimuth of incidence [degree] by name of the plane; None for the mean over azimuth."""
    lay = representation(model).lay
    if lay is None:
        return {MEAN: None}
    # Diffraction is known as the mean over azimuth alone.
    return {"along the lay": lay, "across the lay": lay + 90} | ({MEAN: None} if diffraction else {})


class _Prediction(NamedTuple):
    """The model in the bins of one plane and incidence."""

    lobe: LobeBins
    scattered: Array
    """Light in every bin"""
    mirrored: float
    """Coherent light"""
    region: NDArray[np.intp]
    """Region of every bin: the first whose limit is exceeded"""

    @classmethod
    def of(cls, model: xr.Dataset, bins: SlopeBins, theta_i: float, phi_i: float | None) -> _Prediction:
        one, lobe = representation(model), LobeBins.of(bins, theta_i, phi_i)
        scattered, solid_angle = lobe.total(lobe.brdf(one)), lobe.total(np.ones_like(lobe.theta))
        brdf = scattered / np.where(solid_angle > 0, solid_angle, np.inf)
        mirrored = float(one.specular(np.array([theta_i]), np.array([phi_i or 0.0]), None)[0].mean())
        limits = np.array(list(MODEL_REGIONS.values()))
        return cls(lobe, scattered, mirrored, np.argmax(brdf[:, None] >= limits * brdf.max(), axis=1))

    def by_region(self, by_bin: Array) -> Array:
        """Sum of values of every bin over each region."""
        return np.bincount(self.region, by_bin, minlength=len(MODEL_REGIONS)).astype(float)

    @property
    def light(self) -> Array:
        """By region; coherent light belongs to the peak."""
        return self.by_region(self.scattered) + self.mirrored * (np.arange(len(MODEL_REGIONS)) == 0)


class _Light(NamedTuple):
    """Light of a reference by region, with its relative standard uncertainty, and gloss with its standard uncertainty (NaN: no gloss angle)."""

    light: Array
    relative_u: Array
    gloss: float = np.nan
    gloss_u: float = np.nan


_UNKNOWN = _Light(*np.full((2, len(MODEL_REGIONS)), np.nan))


def _traced_light(
    meshes: list[HeightMesh], model: xr.Dataset, index: xr.Dataset, prediction: _Prediction, rays: int, seed: int
) -> _Light:
    lobe = prediction.lobe
    n, k = (float(index[name][0]) for name in ("n", "k"))
    facets = np.array([np.count_nonzero(mesh.present) for mesh in meshes])
    power, variance = np.zeros((2, lobe.bins.number))
    # As many rays for each facet of every map.
    for number, (mesh, share) in enumerate(zip(meshes, facets / facets.sum(), strict=True)):
        found = trace(
            mesh,
            lobe.theta_i,
            lobe.phi_i,
            index=complex(n, k),
            bins=lobe.bins,
            rays=int(np.ceil(rays * share)),
            seed=seed + number,
        )
        power += share * found.power.mean(axis=1).sum(axis=0).ravel()
        variance += (share * found.ray_noise.ravel()) ** 2
    light = prediction.by_region(power)
    # A region that no ray met has the light of less than one of them.
    relative_u = np.sqrt(prediction.by_region(variance)) / np.maximum(light, 1e-300)
    relative_u = np.where(light > 0, np.hypot(relative_u, BIN_ERROR), 1.0)
    if lobe.theta_i not in GLOSS_ANGLES:
        return _Light(light, relative_u)
    by_bin = gloss_by_bin(model, lobe.bins, lobe.theta_i, lobe.phi_i)
    # Gloss units of the light of a bin, from the model's own.
    units = by_bin / np.where(prediction.scattered > 0, prediction.scattered, np.inf)
    value = float(units @ power)
    return _Light(light, relative_u, value, float(np.hypot(np.sqrt(units**2 @ variance), GLOSS_BIN_ERROR * value)))


def _diffracted_light(reference: xr.Dataset, prediction: _Prediction) -> _Light:
    one, lobe = representation(reference), prediction.lobe
    if lobe.phi_i is not None or not isinstance(one, Kirchhoff):
        return _UNKNOWN
    light = _by_region(one, prediction)
    changes = np.array([_by_region(changed, prediction) for changed in one.changed]) - light
    relative_u = np.hypot(np.sqrt(np.square(changes).sum(axis=0)) / np.maximum(light, 1e-300), BIN_ERROR)
    if lobe.theta_i not in GLOSS_ANGLES:
        return _Light(light, relative_u)
    value = float(gloss(reference, [lobe.theta_i])[0])
    return _Light(light, relative_u, value, diffracted_gloss_u(reference, lobe.theta_i, value))


def _by_region(one: Kirchhoff, prediction: _Prediction) -> Array:
    """Light of diffraction by region; coherent light belongs to the peak."""
    coherent = float(one.specular(np.array([prediction.lobe.theta_i]), np.zeros(1), None)[0].mean())
    scattered = prediction.lobe.total(prediction.lobe.brdf(one))
    return prediction.by_region(scattered) + coherent * (np.arange(len(MODEL_REGIONS)) == 0)


def _masking(surface: xr.Dataset) -> xr.Dataset:
    """G2 of the mirror direction by rays cast along lines of heights and Smith's of their slopes, means over the axes; NaN without lines."""
    names = {"g2": "g2_raycast", "g2_u": "g2_raycast_u", "g2_height_correlated": "g2_height_correlated"}
    axes = (0.0,) if surface["height"].ndim == 1 else (0.0, 90.0)
    try:
        cast = [
            ray_casting.bistatic(surface, MODEL_INCIDENCES, axis, MODEL_INCIDENCES, axis + 180, lines=_LINES)
            for axis in axes
        ]
    except ray_casting.RaycastError:
        return xr.Dataset({name: ("theta_i", np.full(MODEL_INCIDENCES.size, np.nan)) for name in names.values()})
    values = {new: np.stack([one[old].values for one in cast]) for old, new in names.items()}
    means = {name: one.mean(axis=0) for name, one in values.items()}
    means["g2_raycast_u"] = np.sqrt(np.mean(values["g2_raycast_u"] ** 2, axis=0) / len(axes))
    return xr.Dataset({name: ("theta_i", one) for name, one in means.items()})


# --- what it says


def _advice(result: xr.Dataset, predicted: xr.Dataset) -> str:
    """The key of the description that is most likely to help."""
    modes, lay = predicted.attrs, MEAN not in result["plane"].values
    reference = "" if lay or not result["valid"].any() else "`model.truth: use` for the reference solution itself"
    if "masking" not in modes:
        key = ""
    elif float(result["phase_variance"].sel(theta_i=60)) < GEOMETRIC and modes.get("optics", "facets") != "auto":
        key = "`model.optics: auto`"
    elif not lay and (_hidden_otherwise(result, predicted) is not None or _from_masking(result, predicted)):
        key = "`model.masking: measured`"
    elif modes["masking"] in MASKINGS_OF_MULTIPLE_SCATTERING["directional"] and modes["multiple_scattering"] not in (
        "measured",
        modes.get(MULTIPLE_SCATTERING_ADVISED),
    ):
        key = "`model.multiple_scattering: measured`"
    else:
        key = ""
    choices = " or ".join(part for part in (key, reference) if part)
    return f"set {choices}" if choices else "compare with a measurement"


def _from_masking(result: xr.Dataset, predicted: xr.Dataset) -> bool:
    """Whether Smith's masking explains most of the largest error of the light in the peak, by the light of the facets of these heights."""
    if predicted.attrs.get("masking") not in SMITH_MASKINGS:
        return False
    peak = _judged_peak(result.sel(reference="traced"))
    at = _largest(peak["light_error"], peak["light_error_u"], peak["valid"], ERROR_LIMITS[0])
    return bool(at) and float(predicted.attrs.get(SMITH_ERROR, 0.0)) / float(peak["light_error"][at]) > 0.5


def _judged_peak(one: xr.Dataset) -> xr.Dataset:
    """A reference in the peak at the angles of incidence that are judged."""
    return one.sel(region="peak", theta_i=MODEL_INCIDENCES[MODEL_INCIDENCES <= LARGEST_JUDGED])


def _hidden_otherwise(result: xr.Dataset, predicted: xr.Dataset) -> int | None:
    """Row of the largest difference of G2 where masking is Smith's, unless the light of the facets of these heights speaks for it."""
    compared = predicted.attrs.get(MASKING_ADVISED)
    if predicted.attrs.get("masking") not in SMITH_MASKINGS or (compared is not None and compared != "measured"):
        return None
    return _masking_difference(result)


def _masking_difference(result: xr.Dataset) -> int | None:
    """Row of the largest difference of G2, if beyond the limit and its noise up to the largest angle that is judged."""
    difference = np.abs(result["g2_raycast"].values - result["g2_height_correlated"].values)
    # Without independent groups of lines the uncertainty is unknown, and counts as 0.
    noise = MASKING_SIGNIFICANT * np.nan_to_num(result["g2_raycast_u"].values)
    wrong = (difference > np.maximum(noise, MASKING_LIMIT)) & (MODEL_INCIDENCES <= LARGEST_JUDGED)
    return int(np.argmax(np.where(wrong, difference, 0))) if wrong.any() else None


def _warnings(result: xr.Dataset, predicted: xr.Dataset) -> list[str]:
    """Significant errors beyond the limits, of references that hold, and what to do."""
    warnings = []
    for name, words in (("traced", "rays traced over the map"), ("kirchhoff", "diffraction on the map")):
        one = result.sel(reference=name)
        peak = _judged_peak(one)
        if at := _largest(peak["light_error"], peak["light_error_u"], peak["valid"], ERROR_LIMITS[0]):
            error, uncertainty = (float(peak[name][at]) for name in ("light_error", "light_error_u"))
            warnings.append(
                f"the predicted light in the peak is {_signed(error, uncertainty, '.1%')} off {words} at "
                f"{float(peak['theta_i'][at['theta_i']]):.0f}°{_plane_words(result, at)}; {result.attrs['advice']}"
            )
        if at := _largest(one["gloss_error"], one["gloss_error_u"], one["gloss_valid"], GLOSS_LIMITS[0]):
            error, uncertainty = (float(one[name][at]) for name in ("gloss_error", "gloss_error_u"))
            warnings.append(
                f"the predicted gloss is {_signed(error, uncertainty, '.1f')} gloss units off {words} at "
                f"{float(one['gloss_angle'][at['gloss_angle']]):.0f}°{_plane_words(result, at)}; {result.attrs['advice']}"
            )
    row = _hidden_otherwise(result, predicted)
    if row is not None:
        cast, smith = (float(result[name][row]) for name in ("g2_raycast", "g2_height_correlated"))
        warnings.append(
            f"Smith's G2 of the mirror direction is {smith:.2f} at {MODEL_INCIDENCES[row]:.0f}°, and rays cast over the heights give {cast:.2f} ± "
            f"{np.nan_to_num(float(result['g2_raycast_u'][row])):.2f} (k = 1): what hides a facet depends on more than slopes, and the reflection "
            f"predicted with Smith is off by about {smith / cast - 1:+.0%} there"
            + ("" if MEAN not in result["plane"].values else "; set `model.masking: measured`")
        )
    if not result["valid"].any() and "line profile" not in result.attrs["refusals"]:
        reasons = " ".join(f"{name}: {text}." for name, text in json.loads(result.attrs["refusals"]).items())
        warnings.append(
            "no reference solution holds at any angle of incidence, so the error of the model is not known; compare with a measurement. "
            f"{reasons}".strip()
        )
    return warnings


def _signed(error: float, uncertainty: float, format: str) -> str:
    """An error and its standard uncertainty."""
    return f"{error:+{format}} ± {uncertainty:{format}} (k = 1)".replace("-", "\N{MINUS SIGN}")


def _largest(error: xr.DataArray, uncertainty: xr.DataArray, valid: xr.DataArray, limit: float) -> dict[str, int]:
    """Position of the most significant error, if it certainly exceeds a limit; empty where none does."""
    certain = certain_error(error, uncertainty).where(valid > 0, 0.0)
    if not float(certain.max()) > limit:
        return {}
    at = np.unravel_index(int(np.nanargmax(certain.values)), certain.shape)
    return {str(dim): int(position) for dim, position in zip(certain.dims, at, strict=True)}


def _plane_words(result: xr.Dataset, at: dict[str, int]) -> str:
    plane = str(result["plane"].values[at["plane"]])
    return "" if plane == MEAN else f" {plane}"
