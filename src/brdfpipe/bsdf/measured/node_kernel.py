"""Compiled values of a measured BSDF, and their uncertainties, at many pairs of directions on one core.

Gives what :func:`brdfpipe.bsdf.measured.node_interpolation.path_values`, and the functions of
:mod:`brdfpipe.bsdf.measured.evaluation_error`, give for a logarithm in P-splines. Three things save time: of the
functions of a basis, few are not 0 at a direction; ϑ, and with it the splines, is the same for both directions of light; and φ is needed as
cosine and sine alone. All compiled functions are in this module, because the compiler's cache of a function does not see changes in other
modules.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from brdfpipe.bsdf.measured.node_arrays import Covariances, ErrorLimits, Nodes
from brdfpipe.compilation import compiled
from brdfpipe.geometry import Array

ERROR_SCALE = 3.0  # of asinh(ϑ/scale), in which the error of a direction of light is interpolated [degree]
_STRAIGHT, _OTHER = 4, 5  # rows of the functions of a direction itself, and of another node
_LEAST_COSINE = math.cos(math.radians(89.999999))  # of an incidence, as of the abscissa


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
    grazing_first, grazing_scale, fitted = nodes.grazing_first, nodes.grazing_scale, nodes.limits
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
                        place = grazing_first + harmonic * grazing_scale.size + n
                        for w in range(result.shape[1]):
                            result[j, w] += share * coefficient[node, place, w]
                for w in range(result.shape[1]):
                    limits[w, 0] += even * fitted[node, w, 0]
                    limits[w, 1] += even * fitted[node, w, 1]
        for w in range(result.shape[1]):
            result[j, w] = math.exp(min(max(result[j, w], limits[w, 0]), limits[w, 1]))


def uncertainties(
    nodes: Nodes, covariances: Covariances, theta_i: Array, theta_o: Array, phi: Array, limits: ErrorLimits
) -> Array:
    """Standard uncertainty (directions, wavelength) in sr⁻¹ of :func:`values`."""
    result = np.zeros((theta_i.size, nodes.coefficient.shape[2]))
    _uncertainties(nodes, covariances, limits, np.radians(theta_i), np.radians(theta_o), np.radians(phi), result)
    return result


@compiled
def _uncertainties(
    nodes: Nodes,
    covariances: Covariances,
    given: ErrorLimits,
    theta_i: Array,
    theta_o: Array,
    phi: Array,
    result: Array,
) -> None:
    about_half, sines, scale = nodes.about_half, nodes.sines, nodes.scale
    cosines, horizons, abscissa, node_sines = nodes.cosine, nodes.horizon, nodes.abscissa, nodes.sine
    coefficient, fitted = nodes.coefficient, nodes.limits
    error_theta, error_t, error_cosine, error = nodes.error_theta, nodes.error_t, nodes.error_cosine, nodes.error
    order, fine, first, knots, coarse_knots = nodes.order, nodes.fine, nodes.first, nodes.knots, nodes.coarse_knots
    covariance, common, measured, odd = (
        covariances.covariance,
        covariances.common,
        covariances.measured,
        covariances.odd,
    )
    grazing = nodes.grazing_scale, nodes.grazing_order, nodes.grazing_wave, nodes.grazing_first, nodes.grazing_width
    wavelengths, count, last = result.shape[1], odd.size, abscissa.size - 1
    averaged = error_theta.size > 0
    ways = 2 if averaged else 1
    starts, splines, wave = np.empty((2, 2), dtype=np.int64), np.empty((2, 2, 4)), np.empty((2, order.size))
    rise = np.empty(2)
    # Functions that are not 0: of both directions of light and the nodes beside each, of the direction itself, and of another node.
    places, sizes = np.empty((6, count), dtype=np.int64), np.empty((6, count))
    owner, clamped = np.empty(4, dtype=np.int64), np.empty(4, dtype=np.bool_)
    log, below, between = np.empty((2, wavelengths)), np.empty((2, wavelengths)), np.empty((2, wavelengths))
    low, high, ceiling = np.empty((2, wavelengths)), np.empty((2, wavelengths)), np.empty(wavelengths)
    near, near_x = np.empty((measured.size, wavelengths)), abscissa[measured]
    share, expected, cos_in = np.empty(2), np.zeros(2), np.empty(2)
    for j in range(result.shape[0]):
        log[:], below[:], between[:], low[:], high[:], ceiling[:] = 0.0, 0.0, 0.0, 0.0, 0.0, -np.inf
        t_i, t_o = math.tan(theta_i[j] / 2), math.tan(theta_o[j] / 2)
        over_i, over_o = 2 / (1 + t_i * t_i), 2 / (1 + t_o * t_o)
        sin_i, sin_o, cos_i, cos_o = t_i * over_i, t_o * over_o, over_i - 1, over_o - 1
        difference = (t_i - t_o) * (1 - t_i * t_o) * (over_i * over_o / 2)
        cos_phi, sin_phi = math.cos(phi[j] / 2), math.sin(phi[j] / 2)
        theta, along, across = _lobe(about_half, sin_i, cos_i, sin_o, cos_o, difference, cos_phi, sin_phi)
        t = math.asinh(math.degrees(theta) / scale)
        _set_splines(coarse_knots, t, 0, 0, starts, splines)
        _set_splines(knots, t, 0, 1, starts, splines)
        rise[0] = _rise(theta, grazing[4])
        sin_half, cos_half = math.sin(theta / 2), math.cos(theta / 2)
        back_along, back_across = along, across
        share[0], cos_in[0], cos_in[1] = 1.0, cos_i, cos_o
        if averaged:
            _, back_along, back_across = _lobe(about_half, sin_o, cos_o, sin_i, cos_i, -difference, cos_phi, -sin_phi)
            t = math.asinh(math.degrees(theta) / ERROR_SCALE)
            expected[0] = _interpolated(theta_i[j], t, along, error_theta, error_t, error_cosine, error) ** 2
            expected[1] = _interpolated(theta_o[j], t, back_along, error_theta, error_t, error_cosine, error) ** 2
            share[0] = expected[1] / (expected[0] + expected[1])
            share[1] = 1 - share[0]
        lists = 0
        for way in range(ways):
            cos_out = cos_in[1 - way]
            if way == 1:
                along, across = back_along, back_across
            _set_waves(sines, along, across, 0, wave)
            _fill_functions(fine, first, grazing, starts, splines, wave, rise, 0, cos_out, places, sizes, _STRAIGHT)
            x = -math.log(max(cos_in[way], _LEAST_COSINE))
            after = int(np.searchsorted(abscissa, x, side="right"))
            even_after = odd_after = 1.0
            if 0 < after <= last:
                left, right = abscissa[after - 1], abscissa[after]
                even_after = (x - left) / (right - left)
                odd_after = (math.sqrt(x) - math.sqrt(left)) / (math.sqrt(right) - math.sqrt(left))
            for node in range(max(after - 1, 0), min(after, last) + 1):
                own_even, own_odd = even_after, odd_after
                if node < after <= last:
                    own_even, own_odd = 1 - own_even, 1 - own_odd
                if own_even <= 0 and own_odd <= 0:
                    continue
                row, horizon = _STRAIGHT, horizons[node]
                to = _outgoing(about_half, node_sines[node], cosines[node], sin_half, cos_half, along, across)
                if to[2] < horizon or cos_out < horizon:
                    row = _OTHER
                    _set_functions(
                        about_half, sines, scale, node_sines[node], cosines[node], horizon, to, cos_out,
                        knots, coarse_knots, fine, first, grazing, starts, splines, wave, rise, places, sizes,
                    )  # fmt: skip
                if to[2] < horizon and own_even > 0:
                    lost = max(horizon - cos_out, 0.0)
                    lost = given.horizon_error * lost / (lost + cos_out + given.horizon_rise)
                    for w in range(wavelengths):
                        change = 0.0
                        for n in range(count):
                            change += sizes[_STRAIGHT, n] * coefficient[node, places[_STRAIGHT, n], w]
                            change -= sizes[row, n] * coefficient[node, places[row, n], w]
                        below[way, w] += own_even * math.sqrt(change * change + lost * lost)
                for w in range(wavelengths):
                    own = 0.0
                    for n in range(count):
                        own += (own_odd if odd[n] else own_even) * sizes[row, n] * coefficient[node, places[row, n], w]
                    log[way, w] += own
                    low[way, w] += own_even * fitted[node, w, 0]
                    high[way, w] += own_even * fitted[node, w, 1]
                    ceiling[w] = max(ceiling[w], fitted[node, w, 1])
                for n in range(count):
                    places[lists, n] = places[row, n]
                    sizes[lists, n] = sizes[row, n] * share[way] * (own_odd if odd[n] else own_even)
                owner[lists], clamped[lists] = node, to[2] < horizon
                lists += 1
            # The next term of Newton's formula, from the logarithms of the measured nodes near the incidence.
            nearest = min(max(int(np.searchsorted(near_x, x, side="right")) - 1, 0), max(measured.size - 2, 0))
            beyond, beyond_measured = max(x - abscissa[last], 0.0), max(x - near_x[-1], 0.0)
            if measured.size < 2:
                angle = math.degrees(theta_o[j] if way else theta_i[j])
                known = math.degrees(math.acos(cosines[measured[0]]))
                between[way] = abs(angle - known) / given.error_range
                continue
            product = abs((x - near_x[nearest]) * (x - near_x[nearest + 1]))
            if product == 0 and beyond == 0:
                continue
            start, end = max(nearest - 1, 0), min(nearest + 2, measured.size - 1)
            if beyond_measured > 0 or beyond > 0:
                start, end = max(min(start, measured.size - 4), 0), measured.size - 1
            for m in range(start, end + 1):
                node = measured[m]
                row, horizon = _STRAIGHT, horizons[node]
                to = _outgoing(about_half, node_sines[node], cosines[node], sin_half, cos_half, along, across)
                if to[2] < horizon or cos_out < horizon:
                    row = _OTHER
                    _set_functions(
                        about_half, sines, scale, node_sines[node], cosines[node], horizon, to, cos_out,
                        knots, coarse_knots, fine, first, grazing, starts, splines, wave, rise, places, sizes,
                    )  # fmt: skip
                for w in range(wavelengths):
                    own = 0.0
                    for n in range(count):
                        own += sizes[row, n] * coefficient[node, places[row, n], w]
                    near[m, w] = own
            for w in range(wavelengths):
                between[way, w] = _remainder(near, w, near_x, x, nearest, product, beyond, beyond_measured)
        for w in range(wavelengths):
            variance = _variance(covariance, common, w, order.size, lists, owner, clamped, places, sizes)
            spread, total, least, largest = 0.0, 0.0, 0.0, 0.0
            for way in range(ways):
                spread += share[way] * math.sqrt(below[way, w] ** 2 + between[way, w] ** 2)
                total += share[way] * log[way, w]
                least += share[way] * low[way, w]
                largest += share[way] * high[way, w]
            if averaged:
                forward = min(max(log[0, w], low[0, w]), high[0, w])
                backward = min(max(log[1, w], low[1, w]), high[1, w])
                excess = max((forward - backward) ** 2 - expected[0] - expected[1], 0.0)
                spread = math.sqrt(spread * spread + share[0] * share[1] * excess)
            spread = min(spread, given.largest)
            value = math.exp(min(max(total, least), largest))
            above = min(value * math.expm1(spread), max(math.exp(ceiling[w]) - value, 0.0))
            above = max(above, -value * math.expm1(-spread))
            noise = value * math.expm1(min(math.sqrt(max(variance, 0.0)), given.largest))
            result[j, w] = math.sqrt(noise * noise + above * above)


@compiled
def _remainder(
    log: Array, w: int, places: Array, x: float, first: int, product: float, beyond: float, beyond_measured: float
) -> float:
    """Next term of Newton's formula from the logarithms at some places, with the interval ``first`` that ``x`` is in or next to."""
    size = places.size
    if size == 2:
        bend = abs(log[1, w] - log[0, w]) / (places[1] - places[0]) ** 2
    else:
        before, behind = max(first - 1, 0), min(first, size - 3)
        bend = max(abs(_bend(log, w, places, before)), abs(_bend(log, w, places, behind)))
    error = product * bend
    if size > 3 and beyond_measured > 0:
        change = abs(_bend(log, w, places, size - 3) - _bend(log, w, places, size - 4)) / (places[-1] - places[-4])
        error += beyond_measured * (x - places[-3]) * (x - places[-2]) * change
    if beyond > 0:
        error += beyond * abs(log[-1, w] - log[-2, w]) / (places[-1] - places[-2])
    return error


@compiled
def _bend(log: Array, w: int, places: Array, at: int) -> float:
    """Divided difference of three places from ``at`` on."""
    before = (log[at + 1, w] - log[at, w]) / (places[at + 1] - places[at])
    behind = (log[at + 2, w] - log[at + 1, w]) / (places[at + 2] - places[at + 1])
    return (behind - before) / (places[at + 2] - places[at])


@compiled
def _variance(
    covariance: Array,
    common: Array,
    w: int,
    harmonics: int,
    lists: int,
    owner: NDArray[np.int64],
    clamped: NDArray[np.bool_],
    places: NDArray[np.int64],
    sizes: Array,
) -> float:
    """Variance of the sum of some lists of functions, each of one node; the four splines of a harmonic are neighbours."""
    count = places.shape[1]
    # The same functions at one node: errors add before they are squared.
    for one in range(lists):
        for other in range(one + 1, lists):
            if owner[other] == owner[one] >= 0 and not (clamped[one] or clamped[other]):
                for n in range(count):
                    sizes[one, n] += sizes[other, n]
                    sizes[other, n] = 0.0
                owner[other] = -1
    total = 0.0
    for one in range(lists):
        node = owner[one]
        if node < 0:
            continue
        for a in range(count):
            row = places[one, a]
            own = 0.5 * covariance[node, w, row, row] * sizes[one, a]
            blocks = min(a // 4, harmonics)
            for block in range(blocks):
                column, b = places[one, 4 * block], 4 * block
                own += covariance[node, w, row, column] * sizes[one, b]
                own += covariance[node, w, row, column + 1] * sizes[one, b + 1]
                own += covariance[node, w, row, column + 2] * sizes[one, b + 2]
                own += covariance[node, w, row, column + 3] * sizes[one, b + 3]
            for b in range(4 * blocks, a):
                own += covariance[node, w, row, places[one, b]] * sizes[one, b]
            for other in range(one + 1, lists):
                if owner[other] == node:
                    for b in range(count):
                        own += covariance[node, w, row, places[other, b]] * sizes[other, b]
            total += 2 * sizes[one, a] * own
    for component in range(common.shape[2]):
        change = 0.0
        for one in range(lists):
            if owner[one] >= 0:
                for n in range(count):
                    change += sizes[one, n] * common[owner[one], w, component, places[one, n]]
        total += change * change
    return total


@compiled
def _set_functions(
    about_half: bool,
    sines: int,
    scale: float,
    sin_node: float,
    cos_node: float,
    horizon: float,
    to: tuple[float, float, float],
    cos_o: float,
    knots: Array,
    coarse_knots: Array,
    fine: NDArray[np.int64],
    first: NDArray[np.int64],
    grazing: tuple[Array, NDArray[np.int64], NDArray[np.int64], int, float],
    starts: NDArray[np.int64],
    splines: Array,
    wave: Array,
    rise: Array,
    places: NDArray[np.int64],
    sizes: Array,
) -> None:
    """Places and values of the functions that are not 0 at a node that sees a direction at ``to``, moved to its horizon if below."""
    if to[2] >= horizon:
        _fill_functions(fine, first, grazing, starts, splines, wave, rise, 0, horizon, places, sizes, _OTHER)
        return
    sine, turn = math.sqrt(1 - horizon * horizon), math.atan2(to[1], to[0]) / 2
    own, own_along, own_across = _lobe(
        about_half, sin_node, cos_node, sine, horizon, sin_node - sine, math.cos(turn), math.sin(turn)
    )
    rise[1] = _rise(own, grazing[4])
    t = math.asinh(math.degrees(own) / scale)
    _set_splines(coarse_knots, t, 1, 0, starts, splines)
    _set_splines(knots, t, 1, 1, starts, splines)
    _set_waves(sines, own_along, own_across, 1, wave)
    _fill_functions(fine, first, grazing, starts, splines, wave, rise, 1, max(cos_o, horizon), places, sizes, _OTHER)


@compiled
def _fill_functions(
    fine: NDArray[np.int64],
    first: NDArray[np.int64],
    grazing: tuple[Array, NDArray[np.int64], NDArray[np.int64], int, float],
    starts: NDArray[np.int64],
    splines: Array,
    wave: Array,
    rise: Array,
    at: int,
    cos_o: float,
    places: NDArray[np.int64],
    sizes: Array,
    into: int,
) -> None:
    """The functions that are not 0, four splines of each harmonic first."""
    scales, orders, waves, grazing_first, _ = grazing
    count = 0
    for harmonic in range(fine.size):
        for n in range(4):
            places[into, count] = first[harmonic] + starts[at, fine[harmonic]] + n
            sizes[into, count] = splines[at, fine[harmonic], n] * wave[at, harmonic]
            count += 1
    for n in range(scales.size):
        decay = math.exp(-max(cos_o, 0.0) / scales[n])
        for harmonic in range(orders.size):
            at_place = harmonic * scales.size + n
            places[into, count + at_place] = grazing_first + at_place
            sizes[into, count + at_place] = decay * wave[at, waves[harmonic]] * rise[at] ** orders[harmonic]


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
