"""From smoothed incidences to a BSDF for all directions: representation ``rig``, evaluated by :mod:`brdfpipe.bsdf.measured.evaluation`.

Incidences that were not measured, such as normal incidence and those beyond the last, are extrapolated from those that were.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.measured import basis as bases
from brdfpipe.bsdf.measured.basis import RESOLUTION, TOWARDS_GRAZING, Basis
from brdfpipe.bsdf.measured.coordinates import cell_angles, outgoing
from brdfpipe.bsdf.measured.evaluation import REPRESENTATION, evaluate, lobe_slope, uncertainty
from brdfpipe.bsdf.measured.node_interpolation import interpolation_abscissa
from brdfpipe.bsdf.measured.reciprocity import with_contradictions
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import around_mirror
from brdfpipe.specular_directions import cos_view

NORMAL = ("even-quadratic", "linear")
"""How normal incidence is extrapolated from the first two incidences; ``linear``, 2 η₁₀ − η₂₀, is as printed."""

_AVERAGED_WAVELENGTHS = 5  # over which the error of one direction of light is averaged
_ERROR_ANGLES = np.array([0.0, 0.7, 1.5, 2.5, 4, 6, 9, 12, 16, 22, 30, 40, 55, 75, 100, 130, 180])
_ERROR_AZIMUTHS = np.array([0.0, 45.0, 90.0, 135.0, 180.0])
"""Angles from the mirror direction, and azimuths about it, at which that error is known [degree]."""
_NEAR_NODE = 0.7  # distance from an incidence at which it is known too [degree]
_LEAST_ERROR = 1e-6
_HIDDEN_RADIUS = 1.0  # distance [degree] of the first cell from the mirror direction above which the entrance hides it
_FILLED_ANGLES = 6  # angles in the hidden region at which the extrapolation counts as measured
_EXTRAPOLATION_U = 0.02  # relative standard uncertainty of the extrapolation to normal incidence itself
_TREND_STEPS = (4.0, 3.0, 2.0, 1.0, 0.5, 0.25, 0.0)
"""How far the trend is continued beyond the last incidence, in steps between the last two: the first value that conserves energy."""
_GRAZING = 85.0  # largest incidence to which the trend is continued [degree]
_LOWEST = 89.5  # largest θ_o at which the error of one direction of light is taken [degree]
_ENTRANCE_ERROR = "path"  # the uncertainty component that is common to an incidence and independent between incidences
_LAY_WARNING = (
    "The BSDF was smoothed as that of a surface with a lay. It is valid only in the plane of incidence that was measured; for the "
    "rotated sample it repeats that plane. Measure the rotated sample as a separate material."
)


class _Nodes(NamedTuple):
    """Incidences of one side, measured or completed; the first axis counts nodes."""

    incidence: Array
    coefficient: Array  # (node, wavelength, term)
    factor: Array  # (node, wavelength, term, term)
    common: Array  # (node, wavelength, term, component)
    lowest: Array  # (node, wavelength)
    highest: Array
    horizon: Array  # (node,)
    quality: NDArray[np.int8]  # (node, wavelength)
    cells: NDArray[np.bool_]  # (node, cell) measured at any wavelength


def complete(
    smoothed: xr.Dataset,
    transmitted: xr.Dataset | None = None,
    *,
    normal: str = "even-quadratic",
    reciprocity: bool = True,
) -> xr.Dataset:
    """A BSDF for all directions, from the smoothed incidences of a rig.

    Normal incidence without an entrance is extrapolated from the first two, even in σ and averaged over φ:
    (σ₂² η₁ − σ₁² η₂)/(σ₂² − σ₁²), with η the fitted quantity; a fitted logarithm keeps the BSDF positive. Beyond the last incidence the BSDF is
    constant about the mirror direction, as printed (Voloboy et al. 2005, Keldysh Institute preprint), unless reciprocity gives a better value.
    A fitted logarithm first continues its trend between the last two incidences: in x = −ln cos σ the lobe of facets rises nearly
    straight, with 1/cos² σ and Fresnel's reflectance, and the printed rule halves it within five degrees.

    Parameters
    ----------
    smoothed : kind ``smoothed``, of reflection
    transmitted : kind ``smoothed``, of transmission, with the same wavelengths and cells
    normal : one of :data:`NORMAL`; ignored where normal incidence was measured
    reciprocity : whether f(i → o) and f(o → i) are averaged, weighted by the uncertainty at their incidence; ignored for a surface that is not
        isotropic, because the reversed path is one of the rotated sample

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``rig``

    Raises
    ------
    VocabularyError : not such datasets, or not of one rig and plan; a wavelength without a measurement at any incidence.
    """
    if normal not in NORMAL:
        raise VocabularyError(f"unknown completion of normal incidence {normal!r}; accepted: {', '.join(NORMAL)}")
    sides = [_checked(smoothed, "reflection")]
    if transmitted is not None:
        sides.append(_checked(transmitted, "transmission"))
        _check_same_grid(smoothed, transmitted)
    isotropic = is_isotropic(smoothed)
    attrs = {name: smoothed.attrs[name] for name in ("link", "about", "basis")} | {
        "representation": REPRESENTATION,
        "reciprocity": "averaged" if reciprocity and isotropic else "none",
        "transmission": "none" if transmitted is None else "slab",
        "isotropic": "true" if isotropic else "false",
    }
    attrs |= _measurement(smoothed, transmitted)
    if transmitted is not None:
        attrs["transmitted_basis"] = transmitted.attrs["basis"]
    entrances = np.unique(np.concatenate([side["incidence"].values for side in sides]))
    sides = [_split_entrance_error(side, entrances) for side in sides]
    measured = [_nodes(side, normal) for side in sides]
    # Without a logarithm no trend is continued.
    for steps in _TREND_STEPS if smoothed.attrs["link"] == "log" else _TREND_STEPS[-1:]:
        nodes = [_with_trend(own, side, steps) for own, side in zip(measured, sides, strict=True)]
        bsdf = vocabulary.label(_dataset(sides, nodes).assign_attrs(attrs), "bsdf")
        if steps == _TREND_STEPS[-1] or not _violates_energy(bsdf):
            break
    bsdf = vocabulary.add_warning(bsdf, *(text for side in sides for text in vocabulary.warnings(side)))
    bsdf = _with_history(bsdf, sides, nodes, normal)
    bsdf = with_contradictions(bsdf) if isotropic else vocabulary.add_warning(bsdf, _LAY_WARNING)
    if bsdf.attrs["reciprocity"] == "averaged":
        bsdf = _with_incidence_error(bsdf)
    return vocabulary.validate(bsdf, "bsdf")


def _measurement(*sides: xr.Dataset | None) -> dict[str, str]:
    """Day, rig and calibration of the sides, each named once."""
    stated = {
        name: dict.fromkeys(str(side.attrs[name]) for side in sides if side is not None and name in side.attrs)
        for name in vocabulary.MEASUREMENT
    }
    return {name: ", ".join(values) for name, values in stated.items() if values}


def is_isotropic(dataset: xr.Dataset) -> bool:
    """Whether smoothed data, or a BSDF completed from them, are of a surface that may be rotated in its plane."""
    stated = dataset.attrs.get("isotropic")
    return bases.from_json(dataset.attrs["basis"]).symmetric if stated is None else stated == "true"


# --- checks of the input


def _checked(smoothed: xr.Dataset, side: str) -> xr.Dataset:
    vocabulary.validate(smoothed, "smoothed")
    if smoothed.attrs["side"] != side:
        raise VocabularyError(f"expected smoothed data of {side}, found {smoothed.attrs['side']!r}")
    fitted = smoothed["coefficient"].notnull().all("term")
    missing = smoothed["wavelength"].values[~fitted.any("incidence").values]
    if missing.size:
        raise VocabularyError(
            f"nothing was measured at {', '.join(f'{wavelength:g}' for wavelength in missing)} nm at any incidence; leave these wavelengths out"
        )
    return smoothed.isel(incidence=fitted.any("wavelength").values)


def _check_same_grid(smoothed: xr.Dataset, transmitted: xr.Dataset) -> None:
    for name in ("wavelength", "theta_s", "phi_s"):
        if not np.array_equal(smoothed[name].values, transmitted[name].values):
            raise VocabularyError(f"reflection and transmission differ in {name!r}; complete data of one rig and plan")
    if smoothed.attrs["link"] != transmitted.attrs["link"]:
        raise VocabularyError("reflection and transmission were smoothed in different modes; smooth both in one")


def _split_entrance_error(side: xr.Dataset, entrances: Array) -> xr.Dataset:
    """A side with one component for the error of each entrance, so that errors of different entrances are independent."""
    if _ENTRANCE_ERROR not in side.get("component", ()):
        return side
    common = side["coefficient_common"]
    error = common.sel(component=_ENTRANCE_ERROR, drop=True)
    parts = [common.isel(component=side["component"].values != _ENTRANCE_ERROR)]
    for entrance in entrances:
        own = error.where(error["incidence"] == entrance, 0.0)
        parts.append(own.assign_coords(component=f"{_ENTRANCE_ERROR} {entrance:g}"))
    split = xr.concat(parts, "component").transpose(*common.dims)
    return side.drop_dims("component").assign(coefficient_common=split)


# --- nodes


def _nodes(smoothed: xr.Dataset, normal: str) -> _Nodes:
    """The measured incidences, with missing spectra interpolated and normal incidence first."""
    used = np.isfinite(smoothed["residual"].values)
    coefficient, factor = smoothed["coefficient"].values, smoothed["coefficient_factor"].values
    known = np.isfinite(coefficient).all(axis=-1)
    padding = max(coefficient.shape[2] - factor.shape[3], 0)
    common = np.zeros((*coefficient.shape, 0))
    if "coefficient_common" in smoothed:
        common = np.moveaxis(smoothed["coefficient_common"].values, 0, -1)
    nodes = _Nodes(
        smoothed["incidence"].values,
        coefficient.copy(),
        np.pad(factor, [(0, 0), (0, 0), (0, 0), (0, padding)]),
        common.copy(),
        *_limits(smoothed, used),
        np.where(known, vocabulary.quality("measured"), vocabulary.quality("completed")).astype(np.int8),
        used.any(axis=1),
    )
    basis = bases.from_json(smoothed.attrs["basis"])
    abscissa = interpolation_abscissa(nodes.incidence)
    for node, wavelength in np.argwhere(~known):
        sources = np.flatnonzero(known[:, wavelength])
        even, odd = (
            np.array([np.interp(x[node], x[sources], hat) for hat in np.eye(sources.size)])[:, None]
            for x in (abscissa, np.sqrt(abscissa))
        )
        _combine(nodes, (node, wavelength), sources, np.where(basis.harmonic % 2 == 0, even, odd))
    if nodes.incidence[0] > 0:
        return _with_normal(nodes, basis, normal, is_isotropic(smoothed))
    radius = _hidden_radius(smoothed)
    if radius > _HIDDEN_RADIUS and nodes.incidence.size > 1:
        others = _with_normal(_Nodes._make(part[1:] for part in nodes), basis, normal, is_isotropic(smoothed))
        _fill_hidden_region(nodes, others, basis, radius, logarithmic=smoothed.attrs["link"] == "log")
    return nodes


def _hidden_radius(smoothed: xr.Dataset) -> float:
    """Distance of the first cell from the mirror direction at the first incidence [degree]."""
    used = smoothed["residual"][0].notnull().any("wavelength").values
    return float(smoothed["theta_s"].values[used].min())


def _limits(smoothed: xr.Dataset, used: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """Smallest and largest fitted value at the cells (incidence, wavelength), and the largest θ_o of a cell (incidence,)."""
    theta, phi = smoothed["theta_s"].values, smoothed["phi_s"].values
    basis = bases.from_json(smoothed.attrs["basis"])
    shape = used.shape[:2]
    lowest, highest, horizon = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape[0])
    for at, incidence in enumerate(smoothed["incidence"].values):
        cosine = cos_view(incidence, theta, phi)
        rows = basis.rows(*cell_angles(smoothed.attrs["about"], incidence, theta, phi), cosine)
        fitted = smoothed["coefficient"].values[at] @ rows.T
        some = used[at].any(axis=1)
        lowest[at, some] = np.where(used[at], fitted, np.inf).min(axis=1)[some]
        highest[at, some] = np.where(used[at], fitted, -np.inf).max(axis=1)[some]
        horizon[at] = np.degrees(np.arccos(np.clip(cosine[used[at].any(axis=0)].min(), 0.0, 1.0)))
    return lowest, highest, horizon


def _with_normal(nodes: _Nodes, basis: Basis, normal: str, isotropic: bool) -> _Nodes:
    """The nodes with normal incidence first, extrapolated from the first two, or copied from the only one."""
    extended = _Nodes._make(np.concatenate([part[:1], part]) for part in nodes)
    extended.incidence[0], extended.quality[0], extended.cells[0] = 0.0, vocabulary.quality("completed"), False
    sources = np.arange(1, min(extended.incidence.size, 3))
    power = extended.incidence[sources] ** (2 if normal == "even-quadratic" else 1)
    weight = np.ones(1) if sources.size == 1 else np.array([power[1], -power[0]]) / (power[1] - power[0])
    # With a lay, terms that are even under a rotation by 180 degree remain.
    remaining = basis.harmonic == 0 if isotropic else basis.harmonic % 2 == 0
    for wavelength in range(extended.coefficient.shape[1]):
        _combine(extended, (0, wavelength), sources, weight[:, None] * remaining)
    return extended


def _with_trend(nodes: _Nodes, smoothed: xr.Dataset, steps: float) -> _Nodes:
    """The nodes with one more incidence: the trend of the logarithm between the last two, continued by a number of their steps."""
    if smoothed.sizes["incidence"] < 2 or steps == 0:
        return nodes
    harmonic = bases.from_json(smoothed.attrs["basis"]).harmonic
    first, last = interpolation_abscissa(nodes.incidence[-2:])
    end = min(last + steps * (last - first), max(interpolation_abscissa(_GRAZING), last))
    steps = (end - last) / (last - first)
    extended = _Nodes._make(np.concatenate([part, part[-1:]]) for part in nodes)
    extended.incidence[-1] = np.degrees(np.arccos(np.exp(-end)))
    extended.quality[-1], extended.cells[-1] = vocabulary.quality("completed"), False
    odd_steps = (np.sqrt(end) - np.sqrt(last)) / (np.sqrt(last) - np.sqrt(first))
    term_steps = np.where(harmonic % 2 == 0, steps, odd_steps)
    sources = np.arange(nodes.incidence.size - 2, nodes.incidence.size)
    for wavelength in range(extended.coefficient.shape[1]):
        _combine(extended, (sources[-1] + 1, wavelength), sources, np.stack([-term_steps, 1 + term_steps]))
    extended.highest[-1] += steps * np.maximum(nodes.highest[-1] - nodes.highest[-2], 0.0)
    extended.lowest[-1] += steps * np.minimum(nodes.lowest[-1] - nodes.lowest[-2], 0.0)
    return extended


def _violates_energy(bsdf: xr.Dataset) -> bool:
    """Whether the reflectance exceeds 1 at the last, extrapolated incidence."""
    end = bsdf["incidence"].values[bsdf["transmitted"].values == 0][-1:]
    rule = around_mirror(float(end[0]), lobe_slope(bsdf))
    one, other = (evaluate(bsdf, end, np.zeros(1), rule.theta, side * rule.phi, None) for side in (1, -1))
    return bool((rule.weight @ (one + other) / 2 > 1).any())


def _fill_hidden_region(nodes: _Nodes, others: _Nodes, basis: Basis, radius: float, *, logarithmic: bool) -> None:
    """Fill the mirror direction, which the entrance hides at normal incidence, from ``others`` extrapolated from the next two incidences.

    Their extrapolation counts as measured at a few angles within the hidden region, with its covariance and a tolerance: one step of a
    square-root Kalman filter.
    """
    theta = np.linspace(0.0, 0.8 * radius, _FILLED_ANGLES)
    rows = basis.rows(theta, np.zeros_like(theta), np.cos(np.radians(theta)))
    for wavelength in range(nodes.coefficient.shape[1]):
        expected = rows @ others.coefficient[0, wavelength]
        tolerance = _EXTRAPOLATION_U * (1.0 if logarithmic else np.abs(expected)) * np.eye(theta.size)
        noise = np.concatenate([rows @ others.factor[0, wavelength], tolerance], axis=1)
        factor = nodes.factor[0, wavelength]
        before = np.block([[noise, rows @ factor], [np.zeros((factor.shape[0], noise.shape[1])), factor]])
        after = np.asarray(np.linalg.qr(before.T, mode="r")).T
        gain = np.linalg.solve(after[:_FILLED_ANGLES, :_FILLED_ANGLES].T, after[_FILLED_ANGLES:, :_FILLED_ANGLES].T).T
        nodes.coefficient[0, wavelength] += gain @ (expected - rows @ nodes.coefficient[0, wavelength])
        nodes.common[0, wavelength] += gain @ (rows @ (others.common[0, wavelength] - nodes.common[0, wavelength]))
        updated = after[_FILLED_ANGLES:, _FILLED_ANGLES:]
        factor[:] = 0.0
        factor[:, : updated.shape[1]] = updated
        highest = (rows @ nodes.coefficient[0, wavelength]).max()
        nodes.highest[0, wavelength] = max(nodes.highest[0, wavelength], highest)


def _combine(nodes: _Nodes, to: tuple[int, int], sources: NDArray[np.int64], weight: Array) -> None:
    """Set a node at one wavelength to a weighted sum of others, with its covariance; ``weight`` is (sources, term or 1)."""
    at = (sources, to[1])
    nodes.coefficient[to] = (weight * nodes.coefficient[at]).sum(axis=0)
    nodes.common[to] = (weight[..., None] * nodes.common[at]).sum(axis=0)
    stacked = np.concatenate(list(weight[..., None] * nodes.factor[at]), axis=1)
    triangle = np.asarray(np.linalg.qr(stacked.T, mode="r"))
    nodes.factor[to] = 0.0
    nodes.factor[to][:, : triangle.shape[0]] = triangle.T
    nodes.lowest[to], nodes.highest[to] = nodes.lowest[at].min(), nodes.highest[at].max()


# --- the dataset


def _dataset(sides: list[xr.Dataset], nodes: list[_Nodes]) -> xr.Dataset:
    terms = max(side.coefficient.shape[2] for side in nodes)
    names = [list(side["component"].values) if "component" in side.coords else [] for side in sides]
    if names[-1] != names[0]:
        raise VocabularyError("reflection and transmission differ in their uncertainty components; reduce both alike")

    def joined(field: str, *axes: int) -> Array:
        """A field of all nodes, padded to the same number of terms along some axes."""
        parts = [getattr(side, field) for side in nodes]
        widths = [[(0, (terms - size) * (axis in axes)) for axis, size in enumerate(part.shape)] for part in parts]
        return np.concatenate([np.pad(part, width) for part, width in zip(parts, widths, strict=True)])

    spectrum = ("node", "wavelength")
    quality = np.where(joined("cells"), vocabulary.quality("measured"), vocabulary.quality("extrapolated"))
    bsdf = xr.Dataset(
        {
            "coefficient": ((*spectrum, "term"), joined("coefficient", 2)),
            "coefficient_factor": ((*spectrum, "term", "factor"), joined("factor", 2, 3).astype(np.float32)),
            "lowest": (spectrum, joined("lowest")),
            "highest": (spectrum, joined("highest")),
            "coefficient_quality": (spectrum, joined("quality")),
            "incidence": ("node", joined("incidence")),
            "transmitted": (
                "node",
                np.repeat(np.arange(len(nodes), dtype=np.int8), [len(side.incidence) for side in nodes]),
            ),
            "horizon": ("node", joined("horizon")),
            "cell_quality": (("node", "cell"), quality.astype(np.int8)),
        },
        coords={name: sides[0][name].variable for name in ("wavelength", "theta_s", "phi_s")},
    )
    bsdf = bsdf.assign_coords(solid_angle=("cell", bases.solid_angles(bsdf["theta_s"].values, bsdf["phi_s"].values)))
    if names[0]:
        common = np.moveaxis(joined("common", 2), -1, 0)
        bsdf["coefficient_common"] = (("component", *spectrum, "term"), common)
        bsdf = bsdf.assign_coords(component=names[0])
    return bsdf


def _with_history(bsdf: xr.Dataset, sides: list[xr.Dataset], nodes: list[_Nodes], normal: str) -> xr.Dataset:
    sentences = [line for side in sides for line in side.attrs["history"].splitlines()]
    for side, own in zip(sides, nodes, strict=True):
        measured, word, radius = side["incidence"].values, side.attrs["side"], _hidden_radius(side)
        if measured[0] == 0 and measured.size > 1 and radius > _HIDDEN_RADIUS:
            sentences.append(
                f"{word} at normal incidence within {radius:.1f} degree of the mirror direction completed from {measured[1]:g} degree on"
            )
        if measured[0] > 0:
            first = " and ".join(f"{angle:g}" for angle in measured[:2])
            sentences.append(
                f"{word} at normal incidence completed from {first} degree ({normal}, averaged over azimuth)"
            )
        end = own.incidence[-1]
        trend = f" trend continued to {end:.0f} degree, then" if end > measured[-1] else ""
        sentences.append(f"{word} beyond {measured[-1]:g} degree completed:{trend} constant about the mirror direction")
        if filled := int((own.quality[np.isin(own.incidence, measured)] == vocabulary.quality("completed")).sum()):
            sentences.append(f"{filled} missing spectra of {word} interpolated from the neighbouring incidences")
    if bsdf.attrs["reciprocity"] == "averaged":
        sentences.append(
            "reflection averaged over both directions of light, weighted by the uncertainty at their incidence"
        )
    return vocabulary.add_history(bsdf, *sentences)


def _with_incidence_error(bsdf: xr.Dataset) -> xr.Dataset:
    """Add the uncertainty of the logarithm in one direction of light, rms over a few wavelengths, without errors common to all incidences."""
    reflected = bsdf.isel(node=np.flatnonzero(bsdf["transmitted"].values == 0))
    one_way = bsdf.assign_attrs(reciprocity="none", transmission="none")
    if "coefficient_common" in bsdf:
        own = [
            name
            for name in bsdf["component"].values
            if str(name).startswith((_ENTRANCE_ERROR, RESOLUTION, TOWARDS_GRAZING))
        ]
        one_way = one_way.sel(component=own) if own else one_way.drop_dims("component")
    node = reflected["incidence"].values
    near = (node[:, None] + np.array([-_NEAR_NODE, 0.0, _NEAR_NODE])).ravel()
    theta = np.unique(np.concatenate([np.arange(0.0, 90.0, 5.0), near[(near > 0) & (near < 89.0)], [89.9]]))
    theta_i, angle, azimuth = np.meshgrid(theta, _ERROR_ANGLES, _ERROR_AZIMUTHS, indexing="ij")
    theta_o, phi_o = outgoing(bsdf.attrs["about"], theta_i.ravel(), angle.ravel(), azimuth.ravel())
    indices = np.linspace(0, bsdf.sizes["wavelength"] - 1, _AVERAGED_WAVELENGTHS).round().astype(int)
    few = bsdf["wavelength"].values[np.unique(indices)]
    # Directions below the horizon are needed only to interpolate up to it.
    at = theta_i.ravel(), np.zeros(theta_o.size), np.minimum(theta_o, _LOWEST), phi_o, few
    relative = uncertainty(one_way, *at) / np.maximum(evaluate(one_way, *at), 1e-30)
    error = np.sqrt((np.log1p(relative) ** 2).mean(axis=-1)).reshape(theta_i.shape)
    dims = ("theta_i", "error_angle", "error_azimuth")
    coords = dict(zip(dims, (theta, _ERROR_ANGLES, _ERROR_AZIMUTHS), strict=True))
    return vocabulary.label(
        bsdf.assign_coords(coords).assign(incidence_error=(dims, np.maximum(error, _LEAST_ERROR))), "bsdf"
    )
