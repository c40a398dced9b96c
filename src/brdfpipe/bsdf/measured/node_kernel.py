"""Compiled values of a measured BSDF at many pairs of directions on one core.

Gives what :func:`brdfpipe.bsdf.measured.node_interpolation.path_values` gives for a logarithm in P-splines. Three things save time: of the
functions of a basis, few are not 0 at a direction; ϑ, and with it the splines, is the same for both directions of light; and φ is needed as
cosine and sine alone. All compiled functions are in this module, because the compiler's cache of a function does not see changes in other
modules.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdfpipe.bsdf.measured.basis import FINE, GRAZING, GRAZING_WIDTH, PSpline
from brdfpipe.compilation import compiled
from brdfpipe.geometry import Array

if TYPE_CHECKING:
    from brdfpipe.bsdf.measured.node_interpolation import Side

ERROR_SCALE = 3.0  # of asinh(ϑ/scale), in which the error of a direction of light is interpolated [degree]
_LEAST_COSINE = math.cos(math.radians(89.999999))  # of an incidence, as of the abscissa


class Nodes(NamedTuple):
    """The nodes of a side as arrays; angles in radians."""

    about_half: bool
    """Whether ϑ and φ are about the half vector, not about the mirror direction"""
    cosine: Array
    """(node,) of the incidence"""
    sine: Array
    """(node,)"""
    horizon: Array
    """(node,) cosine of the largest polar angle of a cell"""
    abscissa: Array
    """(node,) −ln cos of the incidence"""
    coefficient: Array
    """(node, spline of a harmonic, wavelength), also of the splines that a harmonic leaves out: theirs are 0"""
    grazing: Array
    """(node, scale of a harmonic, wavelength)"""
    grazing_order: NDArray[np.int64]
    """(grazing harmonic,) k of cos kφ, then of sin kφ"""
    grazing_wave: NDArray[np.int64]
    """(grazing harmonic,) the same harmonic among all"""
    grazing_width: float
    """ϑ beyond which these harmonics have their full size"""
    limits: Array
    """(node, wavelength, 2) least and largest logarithm"""
    scale: float
    """Scale [degree] of t = asinh(ϑ/scale)"""
    knots: Array
    """Of the harmonics with all knots"""
    coarse_knots: Array
    """Of the harmonics with every second knot"""
    order: NDArray[np.int64]
    """(harmonic,) k of cos kφ, then of sin kφ"""
    sines: int
    """First harmonic that is a sine"""
    fine: NDArray[np.int64]
    """(harmonic,) 1 with all knots, 0 with every second"""
    first: NDArray[np.int64]
    """(harmonic,) its first spline among the coefficients"""
    grazing_scale: Array
    """(scale,) in cos θ_o"""
    error_theta: Array
    """Incidences of the next; empty where the two directions of light are not averaged"""
    error_t: Array
    """asinh(ϑ/scale) of the next"""
    error_cosine: Array
    """cos φ of the next"""
    error: Array
    """Uncertainty of the logarithm of the BSDF in one direction of light (incidence, ϑ, φ)"""

    @classmethod
    def of(cls, side: Side, basis: PSpline, margin: float) -> Nodes:
        """Of a side with logarithms in P-splines; they exceed the values at cells by ``margin`` at most."""
        parts = basis.of_all_splines(np.moveaxis(side.coefficient, -1, 0))
        sizes = np.array([len(part) for part in parts])
        cosine = np.cos(np.radians(side.incidence))
        error = side.path_error or (np.zeros(0), np.zeros(0), np.zeros(0), np.zeros((0, 0, 0)))
        return cls(
            side.about == "half",
            cosine,
            np.sin(np.radians(side.incidence)),
            np.cos(np.radians(side.horizon)),
            np.ascontiguousarray(side.abscissa),
            np.ascontiguousarray(np.moveaxis(np.concatenate(parts), 0, 1)),
            np.ascontiguousarray(
                np.swapaxes(side.coefficient, 1, 2)[:, -len(GRAZING) * basis.grazing_orders.size :]
            ),
            basis.grazing_orders,
            np.concatenate([np.arange(basis.grazing_harmonics + 1), basis.harmonics + basis.grazing_orders[basis.grazing_harmonics + 1 :]]),
            math.radians(GRAZING_WIDTH),
            np.stack([side.lowest - margin, side.highest + margin], axis=-1),
            basis.scale,
            basis.knots(True),
            basis.knots(False),
            basis.orders,
            basis.harmonics + 1,
            np.isin(basis.orders, FINE).astype(np.int64),
            np.cumsum(sizes) - sizes,
            np.array(GRAZING),
            *error,
        )


def values(nodes: Nodes, theta_i: Array, theta_o: Array, phi: Array) -> Array:
    """BSDF (directions, wavelength) in sr⁻¹ of pairs of directions [degree], φ from the azimuth of incidence."""
    result = np.zeros((theta_i.size, nodes.coefficient.shape[2]))
    _values(nodes, np.radians(theta_i), np.radians(theta_o), np.radians(phi), result)
    return result


@compiled
def _values(nodes: Nodes, theta_i: Array, theta_o: Array, phi: Array, result: Array) -> None:
    # Arrays are named once: each use of a field in a loop would count its references.
    about_half, sines, scale = nodes.about_half, nodes.sines, nodes.scale
    cosines, horizons, abscissa = nodes.cosine, nodes.horizon, nodes.abscissa
    node_sines, order, fine, first = nodes.sine, nodes.order, nodes.fine, nodes.first
    knots, coarse_knots, coefficient = nodes.knots, nodes.coarse_knots, nodes.coefficient
    grazing, grazing_scale, fitted = nodes.grazing, nodes.grazing_scale, nodes.limits
    grazing_order, grazing_wave = nodes.grazing_order, nodes.grazing_wave
    error_theta, error_t, error_cosine, error = nodes.error_theta, nodes.error_t, nodes.error_cosine, nodes.error
    # Of a direction, and of a node at its horizon.
    starts, splines, wave = np.empty((2, 2), dtype=np.int64), np.empty((2, 2, 4)), np.empty((2, order.size))
    rise = np.empty(2)
    limits = np.empty((result.shape[1], 2))
    last, averaged = abscissa.size - 1, error_theta.size > 0
    for j in range(result.shape[0]):
        limits[:] = 0.0
        t_i, t_o = math.tan(theta_i[j] / 2), math.tan(theta_o[j] / 2)
        over_i, over_o = 2 / (1 + t_i * t_i), 2 / (1 + t_o * t_o)
        sin_i, sin_o, cos_i, cos_o = t_i * over_i, t_o * over_o, over_i - 1, over_o - 1
        difference = (t_i - t_o) * (1 - t_i * t_o) * (over_i * over_o / 2)
        cos_phi, sin_phi = math.cos(phi[j] / 2), math.sin(phi[j] / 2)
        theta, along, across = _lobe(about_half, sin_i, cos_i, sin_o, cos_o, difference, cos_phi, sin_phi)
        t = math.asinh(math.degrees(theta) / scale)
        _set_splines(coarse_knots, t, 0, 0, starts, splines)
        _set_splines(knots, t, 0, 1, starts, splines)
        rise[0] = _rise(theta, nodes.grazing_width)
        sin_half, cos_half = math.sin(theta / 2), math.cos(theta / 2)
        weight, back_along, back_across = 1.0, along, across
        if averaged:
            _, back_along, back_across = _lobe(about_half, sin_o, cos_o, sin_i, cos_i, -difference, cos_phi, -sin_phi)
            t = math.asinh(math.degrees(theta) / ERROR_SCALE)
            forward = _interpolated(theta_i[j], t, along, error_theta, error_t, error_cosine, error) ** 2
            backward = _interpolated(theta_o[j], t, back_along, error_theta, error_t, error_cosine, error) ** 2
            weight = backward / (forward + backward)
        for direction in range(2 if averaged else 1):
            if direction == 1:
                cos_i, cos_o, weight = cos_o, cos_i, 1 - weight
                along, across = back_along, back_across
            _set_waves(sines, along, across, 0, wave)
            x = -math.log(max(cos_i, _LEAST_COSINE))
            after = int(np.searchsorted(abscissa, x, side="right"))
            even_after = odd_after = 1.0
            if 0 < after <= last:
                below, above = abscissa[after - 1], abscissa[after]
                even_after = (x - below) / (above - below)
                odd_after = (math.sqrt(x) - math.sqrt(below)) / (math.sqrt(above) - math.sqrt(below))
            for node in range(max(after - 1, 0), min(after, last) + 1):
                even, odd = even_after * weight, odd_after * weight
                if node < after <= last:
                    even, odd = weight - even, weight - odd
                if even <= 0 and odd <= 0:
                    continue
                sin_node, cos_node, horizon = node_sines[node], cosines[node], horizons[node]
                x_o, y_o, z_o = _outgoing(about_half, sin_node, cos_node, sin_half, cos_half, along, across)
                at = 0
                if z_o < horizon:
                    at = 1  # the node at its horizon, in the same azimuth
                    sine, turn = math.sqrt(1 - horizon * horizon), math.atan2(y_o, x_o) / 2
                    own, own_along, own_across = _lobe(
                        about_half, sin_node, cos_node, sine, horizon, sin_node - sine, math.cos(turn), math.sin(turn)
                    )
                    rise[1] = _rise(own, nodes.grazing_width)
                    t = math.asinh(math.degrees(own) / scale)
                    _set_splines(coarse_knots, t, 1, 0, starts, splines)
                    _set_splines(knots, t, 1, 1, starts, splines)
                    _set_waves(sines, own_along, own_across, 1, wave)
                for harmonic in range(order.size):
                    share = wave[at, harmonic] * (odd if order[harmonic] % 2 else even)
                    start = first[harmonic] + starts[at, fine[harmonic]]
                    for w in range(result.shape[1]):
                        own = 0.0
                        for n in range(4):
                            own += splines[at, fine[harmonic], n] * coefficient[node, start + n, w]
                        result[j, w] += share * own
                for n in range(grazing_scale.size):
                    decay = math.exp(-max(cos_o, horizon, 0.0) / grazing_scale[n])
                    for harmonic in range(grazing_order.size):
                        k = grazing_order[harmonic]
                        share = decay * wave[at, grazing_wave[harmonic]] * rise[at] ** k * (odd if k % 2 else even)
                        for w in range(result.shape[1]):
                            result[j, w] += share * grazing[node, harmonic * grazing_scale.size + n, w]
                for w in range(result.shape[1]):
                    limits[w, 0] += even * fitted[node, w, 0]
                    limits[w, 1] += even * fitted[node, w, 1]
        for w in range(result.shape[1]):
            result[j, w] = math.exp(min(max(result[j, w], limits[w, 0]), limits[w, 1]))


@compiled
def _rise(theta: float, width: float) -> float:
    """Of the harmonics of the functions of cos θ_o."""
    return theta / math.sqrt(theta * theta + width * width)


@compiled
def _set_waves(sines: int, cosine: float, sine: float, at: int, wave: Array) -> None:
    """cos kφ and sin kφ of each harmonic."""
    even, odd = 1.0, 0.0
    for harmonic in range(sines):
        wave[at, harmonic] = even
        if harmonic and sines - 1 + harmonic < wave.shape[1]:
            wave[at, sines - 1 + harmonic] = odd
        even, odd = even * cosine - odd * sine, odd * cosine + even * sine


@compiled
def _set_splines(knots: Array, t: float, at: int, fine: int, starts: NDArray[np.int64], splines: Array) -> None:
    """Values of the four cubic B-splines that are not 0 at a place within the knots (de Boor), and the first of them."""
    t = min(t, knots[-1])
    last = min(int(np.searchsorted(knots, t, side="right")), knots.size - 4) - 1
    starts[at, fine] = last - 3
    splines[at, fine, 0] = 1.0
    for degree in range(1, 4):
        carried = 0.0
        for n in range(degree):
            above, below = knots[last + 1 + n], knots[last + 1 + n - degree]
            share = splines[at, fine, n] / (above - below)
            splines[at, fine, n] = carried + share * (above - t)
            carried = share * (t - below)
        splines[at, fine, degree] = carried


@compiled
def _interpolated(
    theta: float, t: float, cosine: float, thetas: Array, ts: Array, cosines: Array, given: Array
) -> float:
    """Linear interpolation over three coordinates, constant beyond the ends."""
    i, x = _place(theta, thetas)
    j, y = _place(t, ts)
    k, z = _place(cosine, cosines)
    total = 0.0
    for m in range(2):
        for n in range(2):
            own = (1 - z) * given[i + m, j + n, k] + z * given[i + m, j + n, k + 1]
            total += (x if m else 1 - x) * (y if n else 1 - y) * own
    return total


@compiled
def _place(x: float, places: Array) -> tuple[int, float]:
    """The interval of some places that x is in, or the nearest one, and where in it from 0 to 1."""
    before = min(max(int(np.searchsorted(places, x, side="right")) - 1, 0), places.size - 2)
    share = (x - places[before]) / (places[before + 1] - places[before])
    return before, min(max(share, 0.0), 1.0)


@compiled
def _lobe(
    about_half: bool,
    sin_i: float,
    cos_i: float,
    sin_o: float,
    cos_o: float,
    difference: float,
    cos_half: float,
    sin_half: float,
) -> tuple[float, float, float]:
    """ϑ [rad], cos φ and sin φ of an outgoing direction, as :func:`brdfpipe.bsdf.measured.coordinates.angles`.

    ``difference`` is sin θ_i − sin θ_o, which cancels near the mirror direction; ``cos_half`` and ``sin_half`` are of half the azimuth.
    """
    tangential = difference * difference + 4 * sin_i * sin_o * cos_half * cos_half
    normal = cos_i + cos_o
    if about_half:
        # Along the mean azimuth of the two directions, and across it.
        mean, turned = (sin_i + sin_o) * cos_half, -difference * sin_half
        theta = 2 * math.atan2(math.sqrt(tangential), normal)
        along, across = mean * cos_half - turned * sin_half, mean * sin_half + turned * cos_half
    else:
        # |o − m|² of the mirror direction m.
        chord = tangential + (cos_o - cos_i) ** 2
        theta = 2 * math.asin(min(math.sqrt(chord) / 2, 1.0))
        x = -difference * (cos_half * cos_half - sin_half * sin_half) + 2 * sin_i * cos_half * cos_half
        along, across = x * cos_i + (cos_o - cos_i) * sin_i, 2 * sin_o * sin_half * cos_half
    length = math.sqrt(along * along + across * across)
    return (theta, along / length, across / length) if length > 0 else (theta, 1.0, 0.0)


@compiled
def _outgoing(
    about_half: bool, sin_i: float, cos_i: float, sin_half: float, cos_half: float, along: float, across: float
) -> tuple[float, float, float]:
    """Outgoing direction (x, y, z) about an incidence: inverse of :func:`_lobe`, with the sine and cosine of ϑ/2."""
    if about_half:
        twice = 2 * (sin_i * sin_half * along + cos_i * cos_half)
        return twice * sin_half * along - sin_i, twice * sin_half * across, twice * cos_half - cos_i
    sine, ahead = 2 * sin_half * cos_half, cos_half * cos_half - sin_half * sin_half
    return sine * along * cos_i - ahead * sin_i, sine * across, sine * along * sin_i + ahead * cos_i
