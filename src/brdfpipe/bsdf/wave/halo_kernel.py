"""Compiled light of many directions on one core: the halo of :mod:`brdfpipe.bsdf.wave.halo`, and that of :mod:`brdfpipe.bsdf.wave.two_scale`.

All compiled functions of the halo are in this module, because the compiler's cache of a function does not see changes in other modules.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdfpipe.compilation import compiled
from brdfpipe.geometry import Array, HalfVector

_TINY = 1e-300
_EDGE = 2  # nodes by which a spline is continued as its mirror image

Weights = tuple[float, float, float, float]
"""Of the four nodes about a place, for a cubic spline."""


class HaloTable(NamedTuple):
    """A cubic spline through ln(K/g) over phase variance, frequency and azimuth, all evenly spaced."""

    coefficients: Array
    """(phase variance, frequency, azimuth), continued at the ends of the first two; with one azimuth for a surface without a lay"""
    phase_matters: bool
    """False for the limit g → 0"""

    @classmethod
    def of(cls, spline: Array, phase_matters: bool) -> HaloTable:
        """Of the coefficients of a spline, (phase variance, frequency) or with an azimuth as third axis."""
        volume = spline[..., None] if spline.ndim == 2 else spline
        padded = np.pad(volume, [(_EDGE, _EDGE), (_EDGE, _EDGE), (0, 0)], mode="reflect")
        return cls(np.ascontiguousarray(padded), phase_matters)


class OrderTable(NamedTuple):
    """The tables of one halo side by side, as the light of all orders is summed from them."""

    coefficients: Array
    """(phase variance, frequency, azimuth, table) of ln(K/g), and of the logarithm of the share of first order if it is known; as of :class:`HaloTable`"""
    spectrum: Array
    """(frequency, azimuth) of the limit g → 0 of ln(K/g)"""
    sigma: float
    """Rms height [um]"""
    first_phase: float
    """ln g of the first node"""
    phase_step: float
    scale: float
    """f0 [um-1]"""
    frequency_step: float

    @classmethod
    def of(
        cls, splines: Sequence[Array], sigma: float, phase: tuple[float, float], frequency: tuple[float, float]
    ) -> OrderTable:
        """Of the coefficients of one spline or two, the first node and step of ln g, and f0 and step of the frequencies."""
        tables = np.stack([HaloTable.of(spline, True).coefficients for spline in splines], axis=-1)
        first, second = 1 / 6, 2 / 3
        before, at, after = tables[_EDGE - 1 : _EDGE + 2, ..., 0]
        return cls(tables, (before + after) * first + at * second, sigma, *phase, *frequency)


class Pairs(NamedTuple):
    """Pairs of directions, (directions,) each."""

    slope: Array
    """Of the facet that mirrors one direction into the other, stretched as the frequencies of the halo are [1]"""
    facet_slope: Array
    """The same, not stretched"""
    azimuth: Array
    """Place of the stretched slope among the azimuths of the halo's table; 0 without a lay"""
    cosines: Array
    """cos θ_i + cos θ_o"""
    product: Array
    """cos θ_i cos θ_o"""
    tilted: Array
    """What reflects as tilted facets, over what reflects as the mean plane does"""
    mirrors: Array
    """BRDF of the facets as perfect mirrors [sr-1]"""


class Lobe(NamedTuple):
    """Directions of an integral over the light of one incidence."""

    pairs: Pairs
    weight: Array
    """cos θ_o dω_o (directions,) [sr]"""
    node: NDArray[np.int64]
    """(directions, corners) of the closure's table, between which a direction lies"""
    share: Array
    """(directions, corners) of the direction that belongs to each node"""


class Closure(NamedTuple):
    """What closes the energy of the halo."""

    factor: Array
    """Of either direction [1], (nodes, wavelength)"""
    corners: tuple[tuple[NDArray[np.int64], Array], ...]
    """Nodes about the incidences and about the exits, and their shares of them, (directions, corners) each"""


class Body(NamedTuple):
    """What a body does to the light of pairs of directions, (directions, wavelength) each."""

    facet_share: Array
    """Share of the light that is reflected as by facets"""
    polarisation: Array
    """Polarisation factor of waves; of size 0 where nothing reflects as waves"""
    reflectance: Array
    """Fresnel's reflectance of the facet that mirrors one direction into the other"""
    further: Array
    """BRDF of what the facets reflect more than once [sr-1]; of size 0 without any"""


class Sums(NamedTuple):
    """Integrals over a lobe."""

    first_order: Array
    """(wavelength,) of the halo of a perfect mirror, of first order without its loss to higher ones"""
    mirror: Array
    """(nodes, wavelength) of the halo of a perfect mirror before it is matched, by nodes of the outgoing direction"""
    halo: Array
    """The same of the body, where it does not reflect as facets"""
    facets: Array
    """(wavelength,) of the light that is reflected as by facets, with the finer roughness upon them"""


class Passage(NamedTuple):
    """Numbers of :func:`brdfpipe.bsdf.wave.two_scale.facet_share_at`."""

    sigma: float
    """Rms height of the relief that is one of facets [um]"""
    phases: tuple[float, float]
    """Phase variances between which it is one of facets for more and more light"""
    steep_share: float
    """Share of the light for which it is that earlier, for its slope"""
    steep_phases: tuple[float, float]


_NOTHING = np.empty((0, 0))
NO_TABLE = OrderTable(np.empty((0, 0, 0, 1)), _NOTHING, 0.0, 0.0, 1.0, 1.0, 1.0)


def lobe_sums(
    lobe: Lobe,
    halo: OrderTable,
    fine: OrderTable,
    wavelength: Array,
    nodes: int,
    body: Body | None,
    *,
    closes: bool,
    generalised: bool,
) -> Sums:
    """Integrals of the halo and of the facets of a surface over a lobe.

    Parameters
    ----------
    lobe : its directions
    halo : with the share of first order
    fine : of the roughness upon the facets; :data:`NO_TABLE` without any
    wavelength : (wavelength,) nm
    nodes : of the closure
    body : None for perfect mirrors alone
    closes : whether the sums of perfect mirrors are wanted
    generalised : whether the halo is that of generalised Harvey-Shack theory, not of small slopes
    """
    um, few = wavelength * 1e-3, wavelength.size
    pairs, around = lobe.pairs, (lobe.weight[:, None] * lobe.share, lobe.node)
    sums = Sums(np.zeros(few), np.zeros((nodes, few)), np.zeros((nodes, few)), np.zeros(few))
    has_waves = body is not None and body.polarisation.size > 0
    light = _NOTHING
    if closes or has_waves:
        light = _light_by_order(pairs, halo, um, None if closes else body, generalised, with_limit=closes)
    if closes:
        geometry = (
            lobe.weight * (4 * np.pi * halo.sigma) ** 2 * (pairs.cosines**2 / 4 if generalised else pairs.product)
        )
        sums.first_order[:] = np.einsum("j,jw->w", geometry, light[2]) / um**4
        _add_to_nodes(*around, light[0] + light[1], sums.mirror)
    if body is not None:
        if has_waves:
            _reflect_halo(light[0], light[1], body)
            _add_to_nodes(*around, light[0], sums.halo)
        sums.facets[:] = np.einsum("j,jw->w", lobe.weight, _facet_light(pairs, fine, um, body))
    return sums


def surface_light(
    pairs: Pairs,
    halo: OrderTable,
    fine: OrderTable,
    wavelength: Array,
    body: Body,
    closure: Closure | None,
    *,
    generalised: bool,
) -> Array:
    """BRDF of a surface without diffuse light [sr-1], (directions, wavelength); the arguments are those of :func:`lobe_sums`.

    ``halo`` may be :data:`NO_TABLE`, and ``closure`` None for 1.
    """
    um = wavelength * 1e-3
    result = _facet_light(pairs, fine, um, body)
    if halo.coefficients.size and body.polarisation.size:
        low, high = _light_by_order(pairs, halo, um, body, generalised)
        _reflect_halo(low, high, body)
        if closure is not None:
            for corners in closure.corners:
                _close(closure.factor, *corners, low)
        result += low
    return result


def facet_share(passage: Passage, cosines: Array, wavelength: Array) -> Array:
    """Share of the light that is reflected as by facets, (directions, wavelength), of γ_i + γ_o (directions,) at wavelengths [nm]."""
    result = np.empty((cosines.size, wavelength.size))
    log_phase = 2 * np.log(2e3 * np.pi * passage.sigma / wavelength)
    steps = [np.log(limits) for limits in (passage.phases, passage.steep_phases)]
    by_phase, by_slope = ((float(low), float(1 / (high - low))) for low, high in steps)
    _facet_share(2 * np.log(cosines), log_phase, by_phase, by_slope, passage.steep_share, result)
    return result


@compiled
def _facet_share(
    log_cosines: Array,
    log_phase: Array,
    by_phase: tuple[float, float],
    by_slope: tuple[float, float],
    steep_share: float,
    result: Array,
) -> None:
    for j in range(result.shape[0]):
        for w in range(result.shape[1]):
            log = log_cosines[j] + log_phase[w]
            waves = 1 - _rising_step((log - by_phase[0]) * by_phase[1])
            if steep_share > 0:
                waves *= 1 - steep_share * _rising_step((log - by_slope[0]) * by_slope[1])
            result[j, w] = 1 - waves


@compiled
def _rising_step(x: float) -> float:
    x = x if x > 0 else 0.0
    x = x if x < 1 else 1.0
    return x * x * (3 - 2 * x)


def _read(table: OrderTable, slope: Array, pairs: Pairs, um: Array, left_out: Array, values: int) -> Array:
    """K/g [um2], the share of first order and the limit of K/g, (values, directions, wavelength); of the first ``values`` alone.

    ``left_out`` (directions, wavelength) is 1 where nobody needs them; of size 0 for nowhere.
    """
    # Logarithms and exponentials of whole arrays take a fraction of the time of single ones.
    along = np.empty((slope.size, um.size))
    _along(slope, pairs.cosines, um, table.scale, along)
    np.log(along, out=along)
    result = np.empty((values, *along.shape))
    log_phase = 2 * np.log(2 * np.pi * table.sigma / um) - table.first_phase
    _read_logarithms(table, along, 2 * np.log(pairs.cosines), log_phase, pairs.azimuth, left_out, result)
    return np.exp(result, out=result)


def _light_by_order(
    pairs: Pairs, halo: OrderTable, um: Array, body: Body | None, generalised: bool, *, with_limit: bool = False
) -> Array:
    """What a halo reflects as waves and as tilted facets [sr-1], and perhaps the limit of K/g [um2], (2 or 3, directions, wavelength).

    Of a halo with the share of first order. Where the surface of a ``body`` is one of facets, it is any finite number.
    """
    assert halo.coefficients.shape[-1] == 2
    light = _read(halo, pairs.slope, pairs, um, _NOTHING if body is None else body.facet_share, 3 if with_limit else 2)
    _mix_orders(pairs, um, halo.sigma, generalised, light[0], light[1])
    return light


def _facet_light(pairs: Pairs, fine: OrderTable, um: Array, body: Body) -> Array:
    """What a surface reflects as facets, with finer roughness upon them, for their share [sr-1], (directions, wavelength)."""
    if not body.facet_share.any():
        return np.zeros_like(body.facet_share)
    light, of_fine, undimmed = np.empty_like(body.facet_share), _NOTHING, _NOTHING
    if fine.coefficients.size:
        of_fine = _read(fine, pairs.facet_slope, pairs, um, 1 - body.facet_share, 1)[0]
        undimmed = np.exp(-((2 * np.pi * fine.sigma / um * pairs.cosines[:, None]) ** 2))
    _reflect_facets(pairs, of_fine, undimmed, fine.sigma, um, body, light)
    return light


class Place(NamedTuple):
    """Places of directions in tables, in steps from the first node."""

    phase: Array
    """(directions, wavelength) of ln g; below 0 is the first node"""
    frequency: Array
    """(directions, wavelength) of asinh(f/f0)"""
    azimuth: Array
    """(directions,) of the azimuth, for a surface with a lay"""


def transform_ratio(table: HaloTable, place: Place) -> Array:
    """K/g [um2], (directions, wavelength), at places of the table."""
    result = np.empty_like(place.frequency)
    _splines(table.coefficients, table.phase_matters, place, result)
    return np.exp(result, out=result)


@compiled
def _splines(coefficients: Array, phase_matters: bool, place: Place, result: Array) -> None:
    rows, columns, azimuths = coefficients.shape
    last_row, last_column = rows - 2 * _EDGE - 1, columns - 2 * _EDGE - 1
    for j in range(result.shape[0]):
        for w in range(result.shape[1]):
            row = place.phase[j, w]
            row = row if phase_matters and row > 0 else 0.0
            row, at = _mirrored(row, last_row), _mirrored(place.frequency[j, w], last_column)
            if azimuths == 1:
                result[j, w] = _on_surface(coefficients, row, at)
            else:
                result[j, w] = _in_volume(coefficients, row, at, place.azimuth[j])


def polarisation_factor(pair: HalfVector, azimuth: Array, n: Array, k: Array) -> Array:
    """Q of unpolarised light, (directions, wavelength), as :func:`~brdfpipe.bsdf.wave.halo.amplitudes`."""
    result = np.empty((azimuth.size, n.size))
    cos_i, sin_i, cos_o, sin_o, turned, real, imaginary = (
        np.ascontiguousarray(values, dtype=float) for values in (*pair[2:], azimuth, n, k)
    )
    _polarisation_factor(cos_i, sin_i, cos_o, sin_o, turned, real, imaginary, bool(imaginary.any()), result)
    return result


@compiled
def _root(square: float, imaginary: float) -> tuple[float, float]:
    """√(x + iy) of y >= 0, with real and imaginary part >= 0."""
    longer = math.sqrt((math.sqrt(square * square + imaginary * imaginary) + abs(square)) * 0.5)
    shorter = imaginary / (2 * longer + _TINY)
    return (longer, shorter) if square >= 0 else (shorter, longer)


@compiled
def _polarisation_factor(
    cosines_i: Array,
    sines_i: Array,
    cosines_o: Array,
    sines_o: Array,
    azimuth: Array,
    n: Array,
    k: Array,
    absorbs: bool,
    result: Array,
) -> None:
    """Squares of amplitudes have a common factor |ε − 1|² and the squares of the sums in their denominators."""
    contrast, imaginary = (n - 1) * (n + 1) - k * k, 2 * n * k
    power = contrast * contrast + imaginary * imaginary
    size = n.size
    root_i, root_i_imaginary, root_i_squared = np.zeros(size), np.zeros(size), np.zeros(size)
    of_s, of_p, before = np.empty(size), np.empty(size), -1.0
    for j in range(azimuth.size):
        turned = (180 - azimuth[j]) * (math.pi / 180)
        cos, sin = math.cos(turned), math.sin(turned)
        cos_squared, sin_squared = cos * cos, sin * sin
        cos_i, cos_o, sines = cosines_i[j], cosines_o[j], sines_i[j] * sines_o[j]
        if cos_i != before:
            before = cos_i
            for w in range(size):
                square = contrast[w] + cos_i * cos_i
                if absorbs:
                    root_i[w], root_i_imaginary[w] = _root(square, imaginary[w])
                else:
                    root_i[w] = math.sqrt(square if square > 0 else 0.0)
                root_i_squared[w] = root_i[w] * root_i[w] + root_i_imaginary[w] * root_i_imaginary[w]
                of_s[w], of_p[w] = _denominators(cos_i, contrast[w], imaginary[w], root_i[w], root_i_imaginary[w])
        if absorbs:
            for w in range(size):
                root, root_imaginary = _root(contrast[w] + cos_o * cos_o, imaginary[w])
                s_o, p_o = _denominators(cos_o, contrast[w], imaginary[w], root, root_imaginary)
                real = (root_i[w] * root - root_i_imaginary[w] * root_imaginary) * cos - (contrast[w] + 1) * sines
                aside = (root_i[w] * root_imaginary + root_i_imaginary[w] * root) * cos - imaginary[w] * sines
                into_s = cos_squared * s_o + sin_squared * ((root * root + root_imaginary * root_imaginary) * p_o)
                into_p = sin_squared * (root_i_squared[w] * s_o) + (real * real + aside * aside) * p_o
                result[j, w] = power[w] * (of_s[w] * into_s + of_p[w] * into_p) * 0.5
        else:
            for w in range(size):
                square = contrast[w] + cos_o * cos_o
                root = math.sqrt(square if square > 0 else 0.0)
                s_o, p_o = _denominators(cos_o, contrast[w], 0.0, root, 0.0)
                real = root_i[w] * root * cos - (contrast[w] + 1) * sines
                into_s = cos_squared * s_o + sin_squared * (root * root * p_o)
                into_p = sin_squared * (root_i_squared[w] * s_o) + real * real * p_o
                result[j, w] = power[w] * (of_s[w] * into_s + of_p[w] * into_p) * 0.5


@compiled
def _denominators(
    cosine: float, contrast: float, imaginary: float, root: float, root_imaginary: float
) -> tuple[float, float]:
    """1/|cos θ + √(ε − sin²θ)|² and 1/|ε cos θ + √(ε − sin²θ)|²."""
    into_s, ahead, aside = cosine + root, (contrast + 1) * cosine + root, imaginary * cosine + root_imaginary
    into_s = into_s * into_s + root_imaginary * root_imaginary
    return 1 / (into_s + _TINY), 1 / (ahead * ahead + aside * aside + _TINY)


@compiled
def _mirrored(place: float, last: int) -> float:
    """A fractional index between the first node and the last, as if the table went on as its mirror image."""
    if place <= last:
        return place
    place = place % (2 * last) if place < math.inf else 0.0
    return place if place <= last else 2 * last - place


@compiled
def _basis(x: float) -> Weights:
    """The uniform cubic B-splines about a position between its two middle ones, 0 <= x <= 1."""
    y = 1 - x
    first, second, last = y * y * y * (1 / 6), 2 / 3 - x * x * (1 - x * 0.5), x * x * x * (1 / 6)
    return first, second, 1 - (first + second + last), last


@compiled
def _on_surface(c: Array, row: float, column: float) -> float:
    i, j = np.uintp(np.int64(row)), np.uintp(np.int64(column))
    a, b = _basis(row - i), _basis(column - j)
    i, j, zero = i + np.uintp(_EDGE - 1), j + np.uintp(_EDGE - 1), np.uintp(0)
    value = 0.0
    for m in range(4):
        p = i + np.uintp(m)
        near = b[0] * c[p, j, zero] + b[1] * c[p, j + np.uintp(1), zero]
        value += a[m] * (near + (b[2] * c[p, j + np.uintp(2), zero] + b[3] * c[p, j + np.uintp(3), zero]))
    return value


@compiled
def _in_volume(c: Array, row: float, column: float, azimuth: float) -> float:
    i, j, k = np.uintp(np.int64(row)), np.uintp(np.int64(column)), np.uintp(np.int64(azimuth))
    a, b, d = _basis(row - i), _basis(column - j), _basis(azimuth - k)
    i, j, k = i + np.uintp(_EDGE - 1), j + np.uintp(_EDGE - 1), k - np.uintp(1)
    value = 0.0
    for m in range(4):
        p = i + np.uintp(m)
        for n in range(4):
            q = j + np.uintp(n)
            near = d[0] * c[p, q, k] + d[1] * c[p, q, k + np.uintp(1)]
            value += a[m] * b[n] * (near + (d[2] * c[p, q, k + np.uintp(2)] + d[3] * c[p, q, k + np.uintp(3)]))
    return value


# --- light of all orders


@compiled
def _along(slope: Array, cosines: Array, um: Array, scale: float, result: Array) -> None:
    """e to the asinh(f/f0), of frequencies over their scale."""
    inverse = 1 / (um * scale)
    for j in range(slope.size):
        bragg = slope[j] * cosines[j]
        for w in range(um.size):
            f = bragg * inverse[w]
            result[j, w] = f + math.sqrt(f * f + 1)


@compiled
def _read_logarithms(
    table: OrderTable,
    along: Array,
    log_cosines: Array,
    log_phase: Array,
    azimuth: Array,
    left_out: Array,
    result: Array,
) -> None:
    """Logarithms of one to three values: of the transform, of the share of first order, of the limit."""
    rows, columns, azimuths, tables = table.coefficients.shape
    last_row, last_column = rows - 2 * _EDGE - 1, columns - 2 * _EDGE - 1
    steps_a_phase, steps_a_frequency = 1 / table.phase_step, 1 / table.frequency_step
    flat, limits = table.coefficients.reshape(table.coefficients.size), table.spectrum.reshape(table.spectrum.size)
    few, leaves_out, one, two = along.shape[1], left_out.size > 0, np.uintp(1), np.uintp(2)
    width, step = np.uintp(tables * columns * azimuths), np.uintp(tables * azimuths)
    first, weights = np.empty(few, np.int64), np.empty((8, few))
    for j in range(along.shape[0]):
        if leaves_out and left_out[j].min() == 1:
            result[:, j] = 0.0
            continue
        # The weights of all wavelengths before any node is read: the compiler computes several at once.
        for w in range(few):
            row = (log_phase[w] + log_cosines[j]) * steps_a_phase
            row = _mirrored(row if row > 0 else 0.0, last_row)
            column = _mirrored(along[j, w] * steps_a_frequency, last_column)
            m, n = np.floor(row), np.floor(column)
            weights[0, w], weights[1, w], weights[2, w], weights[3, w] = _basis(row - m)
            weights[4, w], weights[5, w], weights[6, w], weights[7, w] = _basis(column - n)
            first[w] = np.int64((m + (_EDGE - 1)) * columns + (n + (_EDGE - 1)))
        k = np.int64(azimuth[j])
        around = _basis(azimuth[j] - k)
        for w in range(few):
            transform = order = 0.0
            if leaves_out and left_out[j, w] == 1:
                pass
            elif azimuths == 1:
                at, b = step * np.uintp(first[w]), (weights[4, w], weights[5, w], weights[6, w], weights[7, w])
                for x in range(4):
                    transform += weights[x, w] * _between_four(flat, at, step, b)
                    if tables == 2:
                        order += weights[x, w] * _between_four(flat, at + one, step, b)
                    at += width
            else:
                start = step * np.uintp(first[w]) + two * np.uintp(k - 1)
                for x in range(4):
                    at = start
                    for y in range(4):
                        part = weights[x, w] * weights[4 + y, w]
                        transform += part * _between_four(flat, at, two, around)
                        order += part * _between_four(flat, at + one, two, around)
                        at += step
                    start += width
            result[0, j, w] = transform
            if tables == 2:
                result[1, j, w] = order
        for w in range(few if result.shape[0] == 3 else 0):
            column, limit = first[w] % columns, 0.0
            for y in range(4):
                if azimuths == 1:
                    limit += weights[4 + y, w] * limits[np.uintp(column + y)]
                else:
                    start = np.uintp((column + y) * azimuths + k - 1)
                    limit += weights[4 + y, w] * _between_four(limits, start, one, around)
            result[2, j, w] = limit


@compiled
def _between_four(c: Array, first: np.uintp, step: np.uintp, b: Weights) -> float:
    near = b[0] * c[first] + b[1] * c[first + step]
    return near + (b[2] * c[first + np.uintp(2) * step] + b[3] * c[first + np.uintp(3) * step])


@compiled
def _mix_orders(pairs: Pairs, um: Array, sigma: float, generalised: bool, transform: Array, first_order: Array) -> None:
    """Both ways in which a halo reflects, in place of K/g and of the share of first order; their amplitudes add."""
    inverse = 1 / (um * um)
    fourth = inverse * inverse
    for j in range(transform.shape[0]):
        q = pairs.cosines[j]
        root, phase = math.sqrt(pairs.tilted[j]), (2 * math.pi * sigma * q) ** 2
        of_waves = 1.0 if generalised else 2 * math.sqrt(pairs.product[j]) / q
        for w in range(um.size):
            first = first_order[j, w]
            first = first if first < 1 else 1.0
            a, b = first * of_waves, (1 - first) * root
            scale = (a + b) * transform[j, w] * (phase * fourth[w])
            transform[j, w], first_order[j, w] = a * scale, b * scale


@compiled
def _reflect_halo(low: Array, high: Array, body: Body) -> None:
    """The light of a halo where the surface is not one of facets, in place of what it reflects as waves."""
    for j in range(low.shape[0]):
        for w in range(low.shape[1]):
            waves = 1 - body.facet_share[j, w]
            low[j, w] = waves * (low[j, w] * body.polarisation[j, w] + high[j, w] * body.reflectance[j, w])


@compiled
def _reflect_facets(
    pairs: Pairs, of_fine: Array, undimmed: Array, sigma: float, um: Array, body: Body, light: Array
) -> None:
    """The light of facets for their share; ``of_fine`` is K/g of the finer roughness upon them, of size 0 without any."""
    has_fine, has_further = of_fine.size > 0, body.further.size > 0
    inverse = 1 / (um * um)
    for j in range(light.shape[0]):
        mirrors = pairs.mirrors[j]
        for w in range(um.size):
            light[j, w] = mirrors * body.reflectance[j, w]
        if has_further:
            for w in range(um.size):
                light[j, w] += body.further[j, w]
        if has_fine:
            geometry = (4 * math.pi * sigma) ** 2 * pairs.product[j]
            phase = (2 * math.pi * sigma * pairs.cosines[j]) ** 2 * pairs.tilted[j]
            for w in range(um.size):
                ratio = of_fine[j, w] * inverse[w]
                once = geometry * inverse[w] * ratio * body.polarisation[j, w]
                spread = (1 - undimmed[j, w]) * (phase * inverse[w] * ratio) * body.reflectance[j, w]
                light[j, w] = undimmed[j, w] * (light[j, w] + once) + spread
        for w in range(um.size):
            light[j, w] *= body.facet_share[j, w]


@compiled
def _close(factor: Array, node: NDArray[np.int64], share: Array, light: Array) -> None:
    """Multiply by a factor that is known at nodes."""
    at = np.empty(light.shape[1])
    for j in range(light.shape[0]):
        at[:] = 0.0
        for corner in range(node.shape[1]):
            row, part = node[j, corner], share[j, corner]
            for w in range(at.size):
                at[w] += part * factor[row, w]
        for w in range(at.size):
            light[j, w] *= at[w]


@compiled
def _add_to_nodes(share: Array, node: NDArray[np.int64], light: Array, sums: Array) -> None:
    for j in range(light.shape[0]):
        for corner in range(node.shape[1]):
            row, part = node[j, corner], share[j, corner]
            for w in range(light.shape[1]):
                sums[row, w] += part * light[j, w]
