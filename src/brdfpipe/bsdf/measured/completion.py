"""From smoothed incidences to a BSDF that can be asked anywhere: representation ``rig``, evaluated by :mod:`brdfpipe.bsdf.measured`.

Incidences that were not measured are told from those that were. Normal incidence, where it has no entrance, is the extrapolation of the
first two, even in σ and averaged over φ: (σ₂² η₁ − σ₁² η₂)/(σ₂² − σ₁²), which from 10 and 20 degree is (4 η₁ − η₂)/3. It is taken of
what was fitted, so of the logarithm where that was, which keeps it positive. Beyond the last incidence the BSDF stays as it is
about the mirror direction, as printed, unless reciprocity tells better; where the logarithm was fitted, it goes on for a while as it went
between the last two: in x = −ln cos σ the lobe of facets rises nearly straight, with 1/cos² σ and Fresnel's reflectance, and the
printed rule halves it within five degrees.

References
----------
Voloboy et al. 2005 (Keldysh Institute preprint).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.measured import basis as bases
from brdfpipe.bsdf.measured.basis import Basis
from brdfpipe.bsdf.measured.coordinates import of_cells
from brdfpipe.bsdf.measured.evaluation import evaluate, place_of, uncertainty
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array
from brdfpipe.specular_directions import cos_view

NORMAL = ("even-quadratic", "linear")
"""How normal incidence is told from the first two incidences; ``linear``, 2 η₁₀ − η₂₀, is as printed."""

_SPREAD = 64
"""Directions over which the error of one incidence is averaged."""
_FEW = 5
"""Wavelengths over which it is."""
_HOLE = 1.0
"""How far from the mirror direction the first cell lies, where the entrance hides it [degree]."""
_POINTS = 6
"""Angles in the hole at which it is told."""
_TOLERANCE = 0.02
"""Relative standard uncertainty of the extrapolation to normal incidence, besides that of what it is made from."""
_STEPS = (4.0, 3.0, 2.0, 1.0, 0.5, 0.25, 0.0)
"""How far beyond the last incidence its trend is followed, over the step to it from the last but one: the first that keeps the energy."""
_GRAZING = 85.0
"""But no farther than this [degree]."""
_CONTRADICTING = 2.0
"""Disagreement of light there and back, over its uncertainty, that is no chance."""
_HIGHEST = 80.0
"""Largest θ_o of these [degree]."""
_OF_ENTRANCE = "path"
"""The component of uncertainty that is one error for all an entrance lights, and another one of every entrance."""


class _Nodes(NamedTuple):
    """Incidences of one side, measured or completed; the first axis counts them."""

    incidence: Array
    coefficient: Array
    """(node, wavelength, term)"""
    factor: Array
    """(node, wavelength, term, term)"""
    common: Array
    """(node, wavelength, term, component)"""
    lowest: Array
    """(node, wavelength)"""
    highest: Array
    horizon: Array
    """(node,)"""
    quality: NDArray[np.int8]
    """(node, wavelength)"""
    cells: NDArray[np.bool_]
    """(node, cell) measured at any wavelength."""


def complete(
    smoothed: xr.Dataset,
    transmitted: xr.Dataset | None = None,
    *,
    normal: str = "even-quadratic",
    reciprocity: bool = True,
) -> xr.Dataset:
    """A BSDF for all directions from the smoothed incidences of a rig.

    Parameters
    ----------
    smoothed : kind ``smoothed``, of reflection
    transmitted : kind ``smoothed``, of transmission, with the same wavelengths and cells
    normal : one of :data:`NORMAL`; without meaning where normal incidence was measured
    reciprocity : whether f(i → o) is averaged with f(o → i), each weighted by how well its incidence is known; not of a surface that
        was smoothed without symmetry, for there the way back is that of the sample turned

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``rig``. See :func:`brdfpipe.bsdf.measured.quality` for where a value comes from.

    Raises
    ------
    VocabularyError : no such datasets, or they do not belong together; a wavelength that was measured at no incidence.
    """
    if normal not in NORMAL:
        raise VocabularyError(f"unknown completion of normal incidence {normal!r}; known: {', '.join(NORMAL)}")
    sides = [_checked(smoothed, "reflection")]
    if transmitted is not None:
        sides.append(_checked(transmitted, "transmission"))
        _belong_together(smoothed, transmitted)
    symmetric = bases.from_json(smoothed.attrs["basis"]).symmetric
    attrs = {name: smoothed.attrs[name] for name in ("link", "about", "basis")} | {
        "representation": "rig",
        # Of a surface with a lay light that goes back tells of the sample turned.
        "reciprocity": "averaged" if reciprocity and symmetric else "none",
        "transmission": "none" if transmitted is None else "slab",
    }
    if transmitted is not None:
        attrs["transmitted_basis"] = transmitted.attrs["basis"]
    sides = _by_entrance(sides)
    nodes = [_nodes(side, normal) for side in sides]
    # Without a logarithm there is no trend to shorten.
    for steps in _STEPS if smoothed.attrs["link"] == "log" else _STEPS[-1:]:
        told = [_with_trend(each, side, steps) for each, side in zip(nodes, sides, strict=True)]
        bsdf = vocabulary.label(_dataset(sides, told).assign_attrs(attrs), "bsdf")
        if steps == _STEPS[-1] or not _too_bright(bsdf):
            break
    bsdf = vocabulary.add_warning(bsdf, *(each for side in sides for each in vocabulary.warnings(side)))
    bsdf = _with_history(bsdf, sides, told, normal)
    bsdf = _with_lay(bsdf) if not symmetric else _with_contradictions(bsdf)
    if bsdf.attrs["reciprocity"] == "averaged":
        bsdf = _with_incidence_error(bsdf)
    return vocabulary.validate(bsdf, "bsdf")


def contradictions(bsdf: xr.Dataset) -> xr.DataArray:
    """How far light between two incidences and back disagree before they are averaged, over the uncertainty of the difference.

    Parameters
    ----------
    bsdf : representation ``rig``

    Returns
    -------
    ``(incidence, incidence_2)``, rms over azimuth and wavelength [1]; the measured incidences of reflection, missing on the diagonal
    """
    pairs = reciprocity(bsdf.assign_attrs(reciprocity="none"))
    z = (pairs["there"] - pairs["back"]) / xr.DataArray(np.hypot(pairs["there_u"], pairs["back_u"]))
    rms = np.sqrt((z**2).mean([dim for dim in z.dims if dim != "pair"]).values)
    incidence = np.union1d(pairs["incidence"], pairs["incidence_2"])
    first, second = (np.searchsorted(incidence, pairs[name]) for name in ("incidence", "incidence_2"))
    table = np.full((incidence.size, incidence.size), np.nan)
    table[first, second] = table[second, first] = rms
    return xr.DataArray(
        table, {"incidence": incidence, "incidence_2": incidence}, ("incidence", "incidence_2"), "contradiction"
    )


def reciprocity(bsdf: xr.Dataset, azimuths: int = 13) -> xr.Dataset:
    """What light tells that goes from one measured incidence to another and back, before and after both are averaged.

    Parameters
    ----------
    bsdf : representation ``rig``
    azimuths : directions between two incidences, evenly from φ = 0 to 180 degree

    Returns
    -------
    Dataset of (pair, phi_o, wavelength), a pair for every two measured incidences ``incidence`` and ``incidence_2`` that differ:
        ``there`` f(σ₁ → σ₂) and ``back`` f(σ₂ → σ₁) each as its own incidence tells it, ``both`` as the BSDF tells it [sr-1], and
        their standard uncertainties. Before, the residual is there − back; after, both − there and both − back say how
        far each had to move
    """
    vocabulary.validate(bsdf, "bsdf")
    one_way = bsdf.assign_attrs(reciprocity="none")
    spectral = str(bsdf["coefficient"].dims[1])
    known = (bsdf["coefficient_quality"] == vocabulary.quality("measured")).any(spectral)
    incidence = bsdf["incidence"].values[known.values & (bsdf["transmitted"].values == 0)]
    first, second = (incidence[index] for index in np.triu_indices(incidence.size, 1))
    phi = np.linspace(0.0, 180.0, azimuths)
    there = first[:, None], np.zeros(1), second[:, None], phi
    back = second[:, None], np.zeros(1), first[:, None], -phi

    dims = ("pair", "phi_o", spectral)
    fields = {}
    for name, dataset, angles in (("there", one_way, there), ("back", one_way, back), ("both", bsdf, there)):
        plain = [np.broadcast_to(angle, (first.size, azimuths)).astype(float) for angle in angles]
        words = {"there": "from the first incidence to the second", "back": "from the second incidence to the first"}
        for suffix, function in (("", evaluate), ("_u", uncertainty)):
            long_name = ("standard uncertainty of: " if suffix else "") + f"BRDF {words.get(name, 'of both ways')}"
            values = function(dataset, plain[0], plain[1], plain[2], plain[3], None)
            fields[name + suffix] = (dims, values, {"units": "sr-1", "long_name": long_name})
    degree = {"units": "degree", "long_name": "angle of incidence"}
    coords = {"incidence": ("pair", first, degree), "incidence_2": ("pair", second, degree), "phi_o": phi}
    if spectral in bsdf.coords:
        coords[spectral] = bsdf[spectral]
    return vocabulary.label(xr.Dataset(fields, coords), "reciprocity")


# --- what is read


def _checked(smoothed: xr.Dataset, side: str) -> xr.Dataset:
    vocabulary.validate(smoothed, "smoothed")
    if smoothed.attrs["side"] != side:
        raise VocabularyError(f"expected smoothed data of {side}, found {smoothed.attrs['side']!r}")
    measured_ = smoothed["coefficient"].notnull().all("term")
    missing = smoothed["wavelength"].values[~measured_.any("incidence").values]
    if missing.size:
        raise VocabularyError(
            f"nothing was measured at {', '.join(f'{each:g}' for each in missing)} nm at any incidence; leave these wavelengths out"
        )
    return smoothed.isel(incidence=measured_.any("wavelength").values)


def _belong_together(smoothed: xr.Dataset, transmitted: xr.Dataset) -> None:
    for name in ("wavelength", "theta_s", "phi_s"):
        if not np.array_equal(smoothed[name].values, transmitted[name].values):
            raise VocabularyError(
                f"reflection and transmission differ in {name!r}; complete data of one rig and one plan"
            )
    if smoothed.attrs["link"] != transmitted.attrs["link"]:
        raise VocabularyError("reflection and transmission were smoothed in different modes; smooth both in one")


def _by_entrance(sides: list[xr.Dataset]) -> list[xr.Dataset]:
    """Sides in which errors of entrances are a component each, which adds up with itself alone."""
    entrances = np.unique(np.concatenate([side["incidence"].values for side in sides]))
    found = []
    for side in sides:
        if _OF_ENTRANCE in side.get("component", ()):
            common = side["coefficient_common"]
            own = common.sel(component=_OF_ENTRANCE, drop=True)
            apart = [
                own.where(own["incidence"] == each, 0.0).assign_coords(component=f"{_OF_ENTRANCE} {each:g}")
                for each in entrances
            ]
            others = common.isel(component=side["component"].values != _OF_ENTRANCE)
            whole = xr.concat([others, *apart], "component").transpose(*common.dims)
            side = side.drop_dims("component").assign(coefficient_common=whole)
        found.append(side)
    return found


# --- nodes


def _nodes(smoothed: xr.Dataset, normal: str) -> _Nodes:
    """The measured incidences, spectra that are missing filled from the others, and normal incidence first."""
    used = np.isfinite(smoothed["residual"].values)
    coefficient, factor = smoothed["coefficient"].values, smoothed["coefficient_factor"].values
    told = np.isfinite(coefficient).all(axis=-1)
    room = max(coefficient.shape[2] - factor.shape[3], 0)
    common = np.zeros((*coefficient.shape, 0))
    if "coefficient_common" in smoothed:
        common = np.moveaxis(smoothed["coefficient_common"].values, 0, -1)
    nodes = _Nodes(
        smoothed["incidence"].values,
        coefficient.copy(),
        np.pad(factor, [(0, 0), (0, 0), (0, 0), (0, room)]),
        common.copy(),
        *_limits(smoothed, used),
        np.where(told, vocabulary.quality("measured"), vocabulary.quality("completed")).astype(np.int8),
        used.any(axis=1),
    )
    basis = bases.from_json(smoothed.attrs["basis"])
    place = place_of(nodes.incidence)
    for at, wavelength in np.argwhere(~told):
        known = np.flatnonzero(told[:, wavelength])
        even, odd = (
            np.array([np.interp(x[at], x[known], hat) for hat in np.eye(known.size)])[:, None]
            for x in (place, np.sqrt(place))
        )
        _combine(nodes, (at, wavelength), known, np.where(basis.harmonic % 2 == 0, even, odd))
    if nodes.incidence[0] > 0:
        return _with_normal(nodes, basis, normal)
    if _hole(smoothed) > _HOLE and nodes.incidence.size > 1:
        _fill_hole(nodes, basis, normal, _hole(smoothed), logarithmic=smoothed.attrs["link"] == "log")
    return nodes


def _hole(smoothed: xr.Dataset) -> float:
    """How far from the mirror direction the first cell lies at the first incidence [degree]."""
    used = smoothed["residual"][0].notnull().any("wavelength").values
    return float(smoothed["theta_s"].values[used].min())


def _limits(smoothed: xr.Dataset, used: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """Smallest and largest of what was fitted at the cells (incidence, wavelength), and the largest θ_o of a cell (incidence,)."""
    theta, phi = smoothed["theta_s"].values, smoothed["phi_s"].values
    basis = bases.from_json(smoothed.attrs["basis"])
    shape = used.shape[:2]
    lowest, highest, horizon = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape[0])
    for at, incidence in enumerate(smoothed["incidence"].values):
        cosine = cos_view(incidence, theta, phi)
        rows = basis.rows(*of_cells(smoothed.attrs["about"], incidence, theta, phi), cosine)
        fitted = smoothed["coefficient"].values[at] @ rows.T
        some = used[at].any(axis=1)
        lowest[at, some] = np.where(used[at], fitted, np.inf).min(axis=1)[some]
        highest[at, some] = np.where(used[at], fitted, -np.inf).max(axis=1)[some]
        horizon[at] = np.degrees(np.arccos(np.clip(cosine[used[at].any(axis=0)].min(), 0.0, 1.0)))
    return lowest, highest, horizon


def _with_normal(nodes: _Nodes, basis: Basis, normal: str) -> _Nodes:
    """Normal incidence put before the others, told from the first two, or from the only one."""
    grown = _Nodes._make(np.concatenate([part[:1], part]) for part in nodes)
    grown.incidence[0], grown.quality[0], grown.cells[0] = 0.0, vocabulary.quality("completed"), False
    sources = np.arange(1, min(grown.incidence.size, 3))
    power = grown.incidence[sources] ** (2 if normal == "even-quadratic" else 1)
    shares = np.ones(1) if sources.size == 1 else np.array([power[1], -power[0]]) / (power[1] - power[0])
    for wavelength in range(grown.coefficient.shape[1]):
        # A surface with a lay keeps what turned by 180 degree is the same.
        kept = basis.harmonic == 0 if basis.symmetric else basis.harmonic % 2 == 0
        _combine(grown, (0, wavelength), sources, shares[:, None] * kept)
    return grown


def _with_trend(nodes: _Nodes, smoothed: xr.Dataset, steps: float) -> _Nodes:
    """An incidence put behind the others, told from the last two measured: the logarithm goes on as it went, for so many of their steps."""
    if smoothed.sizes["incidence"] < 2 or steps == 0:
        return nodes
    harmonic = bases.from_json(smoothed.attrs["basis"]).harmonic
    first, last = place_of(nodes.incidence[-2:])
    end = min(last + steps * (last - first), max(place_of(_GRAZING), last))
    steps = (end - last) / (last - first)
    grown = _Nodes._make(np.concatenate([part, part[-1:]]) for part in nodes)
    grown.incidence[-1] = np.degrees(np.arccos(np.exp(-end)))
    grown.quality[-1], grown.cells[-1] = vocabulary.quality("completed"), False
    odd = (np.sqrt(end) - np.sqrt(last)) / (np.sqrt(last) - np.sqrt(first))
    farther = np.where(harmonic % 2 == 0, steps, odd)
    sources = np.arange(nodes.incidence.size - 2, nodes.incidence.size)
    for wavelength in range(grown.coefficient.shape[1]):
        _combine(grown, (sources[-1] + 1, wavelength), sources, np.stack([-farther, 1 + farther]))
    grown.highest[-1] += steps * np.maximum(nodes.highest[-1] - nodes.highest[-2], 0.0)
    grown.lowest[-1] += steps * np.minimum(nodes.lowest[-1] - nodes.lowest[-2], 0.0)
    return grown


def _too_bright(bsdf: xr.Dataset) -> bool:
    """Whether more light leaves than arrives at the last incidence, which was not measured."""
    end = float(bsdf["incidence"].values[bsdf["transmitted"].values == 0][-1])
    return bool((bsdf.bsdf.albedo(end) > 1).any())


def _fill_hole(nodes: _Nodes, basis: Basis, normal: str, hole: float, *, logarithmic: bool) -> None:
    """What the entrance itself hides at normal incidence, the mirror direction, told from the next two incidences.

    Their extrapolation counts as measured at a few angles within the hole, with its covariance and a tolerance: one step of a
    Kalman filter, in the form that keeps a factor of the covariance.
    """
    others = _with_normal(_Nodes._make(part[1:] for part in nodes), basis, normal)
    theta = np.linspace(0.0, 0.8 * hole, _POINTS)
    rows = basis.rows(theta, np.zeros_like(theta), np.cos(np.radians(theta)))
    for wavelength in range(nodes.coefficient.shape[1]):
        told = rows @ others.coefficient[0, wavelength]
        tolerance = _TOLERANCE * (1.0 if logarithmic else np.abs(told)) * np.eye(theta.size)
        noise = np.concatenate([rows @ others.factor[0, wavelength], tolerance], axis=1)
        factor = nodes.factor[0, wavelength]
        before = np.block([[noise, rows @ factor], [np.zeros((factor.shape[0], noise.shape[1])), factor]])
        after = np.asarray(np.linalg.qr(before.T, mode="r")).T
        innovation = told - rows @ nodes.coefficient[0, wavelength]
        nodes.coefficient[0, wavelength] += after[_POINTS:, :_POINTS] @ np.linalg.solve(
            after[:_POINTS, :_POINTS], innovation
        )
        kept = after[_POINTS:, _POINTS:]
        factor[:] = 0.0
        factor[:, : kept.shape[1]] = kept
        highest = (rows @ nodes.coefficient[0, wavelength]).max()
        nodes.highest[0, wavelength] = max(nodes.highest[0, wavelength], highest)


def _combine(nodes: _Nodes, to: tuple[int, int], sources: NDArray[np.int64], weight: Array) -> None:
    """Put a weighted sum of nodes in place at one wavelength, weights (sources, term or 1), with the covariance it has."""
    at = (sources, to[1])
    nodes.coefficient[to] = (weight * nodes.coefficient[at]).sum(axis=0)
    nodes.common[to] = (weight[..., None] * nodes.common[at]).sum(axis=0)
    stacked = np.concatenate(list(weight[..., None] * nodes.factor[at]), axis=1)
    triangle = np.asarray(np.linalg.qr(stacked.T, mode="r"))
    nodes.factor[to] = 0.0
    nodes.factor[to][:, : triangle.shape[0]] = triangle.T
    nodes.lowest[to], nodes.highest[to] = nodes.lowest[at].min(), nodes.highest[at].max()


# --- the dataset


def _dataset(sides: list[xr.Dataset], told: list[_Nodes]) -> xr.Dataset:
    terms = max(nodes.coefficient.shape[2] for nodes in told)
    names = [list(side["component"].values) if "component" in side.coords else [] for side in sides]
    if any(each != names[0] for each in names):
        raise VocabularyError(
            "reflection and transmission differ in their components of uncertainty; reduce both alike"
        )

    def joined(field: str, *axes: int) -> Array:
        parts = [getattr(nodes, field) for nodes in told]
        padded = [
            np.pad(part, [(0, terms - size if axis in axes else 0) for axis, size in enumerate(part.shape)])
            for part in parts
        ]
        return np.concatenate(padded)

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
            "transmitted": ("node", np.repeat(np.arange(len(told), dtype=np.int8), [len(n.incidence) for n in told])),
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


def _with_history(bsdf: xr.Dataset, sides: list[xr.Dataset], told: list[_Nodes], normal: str) -> xr.Dataset:
    sentences = [line for side in sides for line in side.attrs["history"].splitlines()]
    for side, nodes in zip(sides, told, strict=True):
        measured_ = side["incidence"].values
        word = side.attrs["side"]
        if measured_[0] == 0 and measured_.size > 1 and _hole(side) > _HOLE:
            hidden = f"{word} at normal incidence within {_hole(side):.1f} degree of the mirror direction"
            sentences.append(f"{hidden} completed from {measured_[1]:g} degree on")
        if measured_[0] > 0:
            first = " and ".join(f"{each:g}" for each in measured_[:2])
            sentences.append(
                f"{word} at normal incidence completed from {first} degree ({normal}, averaged over azimuth)"
            )
        end = nodes.incidence[-1]
        trend = f" by its trend up to {end:.0f} degree, then" if end > measured_[-1] else ""
        there = f"{word} beyond {measured_[-1]:g} degree completed{trend} as it is there about the mirror direction"
        sentences.append(there)
        filled = int((nodes.quality[np.isin(nodes.incidence, measured_)] == vocabulary.quality("completed")).sum())
        if filled:
            sentences.append(f"{filled} spectra of {word} without a value filled from the incidences next to them")
    if bsdf.attrs["reciprocity"] == "averaged":
        sentences.append("reflection there and back averaged, weighted by how well its incidence is known")
    return vocabulary.add_history(bsdf, *sentences)


def _with_lay(bsdf: xr.Dataset) -> xr.Dataset:
    return vocabulary.add_warning(
        bsdf,
        "the BSDF was smoothed without symmetry, as that of a surface with a lay: it is known for light in the plane of incidence that was "
        "measured alone, and what it says of the sample turned is what it says of that plane; measure the sample turned as a material of its own",
    )


def _with_contradictions(bsdf: xr.Dataset) -> xr.Dataset:
    """A BSDF whose incidences are as uncertain as they contradict each other.

    An incidence that is off contradicts all others, one that is right only that: so the middle one of an incidence's contradictions counts.
    """
    known = bsdf["transmitted"].values == 0
    found = contradictions(bsdf)
    if not found.size:
        return bsdf
    middle = np.nanquantile(found.values, 0.5, axis=1, method="lower")
    by = dict(zip(found["incidence"].values, middle, strict=True))
    bsdf = bsdf.assign_attrs(contradiction=float(found.max()))
    factor = np.array([by.get(incidence, max(by.values())) for incidence in bsdf["incidence"].values])
    factor = np.where(known & (factor > _CONTRADICTING), factor, 1.0)
    doubtful = {incidence: each for incidence, each in by.items() if each > _CONTRADICTING}
    if not doubtful:
        return bsdf
    per_node = xr.DataArray(factor, dims="node")
    names = [name for name in ("coefficient_factor", "coefficient_common") if name in bsdf]
    grown = {name: (bsdf[name] * per_node).transpose(*bsdf[name].dims).astype(bsdf[name].dtype) for name in names}
    listed = ", ".join(f"{incidence:g}° ({each:.1f} times)" for incidence, each in doubtful.items())
    return vocabulary.add_warning(
        bsdf.assign(grown),
        f"light from one incidence to another and back disagrees by more than its uncertainty at {listed}: a picture of another incidence, a "
        "sample that moved, is uneven or has a lay, or an entrance whose path was not calibrated; the uncertainties there were enlarged as many "
        "times. Measure these incidences again",
    )


def _with_incidence_error(bsdf: xr.Dataset) -> xr.Dataset:
    """Add how well the BSDF is known from an incidence: its relative uncertainty, rms over directions and a few wavelengths."""
    own = bsdf["incidence"].values[bsdf["transmitted"].values == 0]
    theta = np.union1d(np.append(np.arange(0.0, 90.0, 2.5), 89.9), own)
    sequence = np.arange(1, _SPREAD + 1)[:, None] * np.array([0.7548776662466927, 0.5698402909980532]) % 1
    theta_o = np.degrees(np.arcsin(np.sqrt(sequence[:, 0]) * np.sin(np.radians(_HIGHEST))))
    theta_i, phi_i, theta_o, phi_o = np.broadcast_arrays(theta[:, None], 0.0, theta_o, 360 * sequence[:, 1])
    few = bsdf["wavelength"].values[np.unique(np.linspace(0, bsdf.sizes["wavelength"] - 1, _FEW).round().astype(int))]
    value = evaluate(bsdf, theta_i, phi_i, theta_o, phi_o, few)
    u = uncertainty(bsdf, theta_i, phi_i, theta_o, phi_o, few)
    relative = np.minimum(u / np.maximum(value, 1e-30), 1.0)
    error = np.sqrt((relative**2).mean(axis=(1, 2)))
    return vocabulary.label(
        bsdf.assign_coords(theta_i=theta).assign(incidence_error=("theta_i", np.maximum(error, 1e-6))), "bsdf"
    )
