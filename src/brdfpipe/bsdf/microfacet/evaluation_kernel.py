"""Compiled kernel: the BRDF of the microfacet model for many directions, on one core.

It covers the physical maskings, the coupled diffuse base and all modes of multiple scattering.

The arithmetic is that of :class:`~brdfpipe.bsdf.microfacet.model.Model`, whose tables it reads, without arrays in between. Results agree
to 1e-12 where the BRDF does not amplify the rounding of angles: it does within 0.01 degree of the horizon, as 1/cos θ, and on lobes narrower
than 0.1 degree. Directions pass in blocks that stay in the processor's cache.
Elementary functions are written out as polynomials (after fdlibm and Cephes) so that the compiler evaluates several directions at once
and results do not depend on the processor's mathematical library. There is no ``fastmath``: operations are neither reordered nor fused.

All compiled functions are in this module, because the compiler's cache of a function does not see changes in other modules.

References
----------
Cody & Waite 1980, Software Manual for the Elementary Functions; Abramowitz & Stegun 1964, §17.6 (Landen's transformation).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray
from scipy.interpolate import PPoly, RectBivariateSpline

from brdfpipe.bsdf.microfacet.albedo_table import AlbedoTable, lay_scale
from brdfpipe.bsdf.microfacet.anisotropic_quadrature import axis_ratio
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.compilation import compiled
from brdfpipe.facets.planar_density import Ellipse, PlanarDensity
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array, HalfVector
from brdfpipe.masking.smith import PlanarSmith, Smith
from brdfpipe.masking.visibility import VisibilityRatio
from brdfpipe.piecewise import PiecewiseCubic

_BLOCK = 512  # directions that are evaluated together
_SUMMED = 84  # partial sums of an integral, so that the compiler adds several numbers at once
_ROWS = 20  # numbers of each direction in the work space
_ROUNDER = 6755399441055744.0  # 1.5 × 2⁵²: adding and subtracting it rounds to an integer, whose bits are the lowest of the sum
_LOG_2_HIGH, _LOG_2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_ROOT_HALF = 0x3FE6A09E667F3BCD  # bits of √½
_LEAST = 1e-150
_TOGETHER = 16  # wavelengths that the compiler evaluates together; it evaluates what is left over one by one
_CELLS_A_SPAN = 4
_NEXT = np.uintp(1)
_LANDEN_ERROR = 1e-12
_SMALL_TANGENT = 0.09  # up to which seven terms of a series give the arc tangent

# --- tables


class Curve(NamedTuple):
    """A :class:`~brdfpipe.piecewise.PiecewiseCubic` of one or several values."""

    offset: float
    shift: int
    first_key: int
    steps: int
    guide: NDArray[Any]
    nodes: Array
    """(n + 1,), the last one infinite"""
    coefficients: Array
    """(n, 4, values), highest power first"""
    last: float

    @classmethod
    def of(cls, cubic: PiecewiseCubic) -> Curve:
        intervals = cubic.nodes.size - 1
        coefficients = np.moveaxis(cubic.coefficients.reshape(4, intervals, -1), 0, 1)
        nodes = np.append(cubic.nodes[:-1], np.inf)
        return cls(
            cubic.offset,
            cubic.shift,
            cubic.first_key,
            cubic.steps,
            cubic.guide.astype(np.uint16 if intervals < 2**16 else np.uint32),
            nodes,
            np.array(coefficients, order="C"),
            cubic.last,
        )


class SplineAxis(NamedTuple):
    """Knots of a cubic B-spline along one axis, and its four basis functions in each span as polynomials."""

    first: float
    last: float
    cells_a_unit: float
    guide: NDArray[np.int32]
    """Span of each cell of a fine, even division, or the one before"""
    knots: Array
    """(spans + 1,), the last one infinite"""
    basis: Array
    """(spans, 4 powers, 4 functions), highest power first"""

    @classmethod
    def of(cls, knots: Array) -> SplineAxis:
        """Of the full vector of knots, the first and last of which are fourfold."""
        spans = knots.size - 7
        basis = np.empty((spans, 4, 4))
        for function in range(spans + 3):
            pieces = PPoly.from_spline((knots, np.eye(spans + 3)[function], 3)).c[:, 3 : 3 + spans]
            for span in range(max(function - 3, 0), min(function + 1, spans)):
                basis[span, :, function - span] = pieces[:, span]
        inner = knots[3:-3]
        length = float(inner[-1] - inner[0])
        cells = max(int(np.ceil(_CELLS_A_SPAN * length / np.diff(inner).min())), 1)
        # One cell less, so that rounding cannot put a number beyond its span.
        starts = inner[0] + (np.arange(cells + 2) - 1) * (length / cells)
        guide = np.clip(np.searchsorted(inner, starts, side="right") - 1, 0, spans - 1)
        return cls(
            float(inner[0]),
            float(inner[-1]),
            cells / length,
            guide.astype(np.int32),
            np.append(inner[:-1], np.inf),
            basis,
        )


class SplineSurface(NamedTuple):
    """A tensor product of cubic B-splines."""

    x: SplineAxis
    y: SplineAxis
    coefficients: Array
    """(x functions, y functions, values)"""
    patches: Array
    """(16 numbers of each pair of spans, flat) of a single value: coefficients of powers of x times those of y, highest first"""

    @classmethod
    def of(cls, splines: list[RectBivariateSpline]) -> SplineSurface:
        """Of splines over the same nodes."""
        knots_x, knots_y = splines[0].get_knots()
        shape = knots_x.size - 4, knots_y.size - 4
        coefficients = np.stack([spline.get_coeffs().reshape(shape) for spline in splines], axis=-1)
        x, y = SplineAxis.of(knots_x), SplineAxis.of(knots_y)
        if len(splines) > 1:
            return cls(x, y, coefficients, np.empty(0))
        windows = np.lib.stride_tricks.sliding_window_view(coefficients[..., 0], (4, 4))
        patches = np.einsum("xaf,xyfg,ybg->xyab", x.basis, windows, y.basis, optimize=True)
        return cls(x, y, coefficients, np.ascontiguousarray(patches).reshape(-1))


class UniformSurface(NamedTuple):
    """A tensor product of cubic B-splines with even steps, which needs less memory than patches."""

    coefficients: Array
    """(x nodes, y nodes), two more at each edge"""
    first: tuple[float, float]
    nodes_a_unit: tuple[float, float]

    @classmethod
    def of(cls, spline: RectBivariateSpline) -> UniformSurface:
        """The same function as an interpolating spline between evenly spaced nodes."""
        axes = []
        for knots in spline.get_knots():
            # The second node and the last but one are no knots.
            axes.append(np.linspace(knots[0], knots[-1], knots.size - 4))
            assert np.allclose(axes[-1][2:-2], knots[4:-4], rtol=0, atol=1e-8 * (knots[-1] - knots[0])), "uneven nodes"
        (x, y), (step_x, step_y) = axes, (float(nodes[1] - nodes[0]) for nodes in axes)
        along_x, curved = (
            _uniform_coefficients(spline(x, y, 0, order), spline(x, y, 2, order), step_x) for order in (0, 2)
        )
        coefficients = np.pad(_uniform_coefficients(along_x.T, curved.T, step_y).T, 1, mode="edge")
        return cls(np.array(coefficients, order="C"), (float(x[0]), float(y[0])), (1 / step_x, 1 / step_y))


def _uniform_coefficients(values: Array, second: Array, step: float) -> Array:
    """Coefficients of a uniform spline from values and second derivatives at its nodes, (nodes + 2, …): f = (a + 4 b + c)/6."""
    inner = values - step**2 / 6 * second
    ends = [6 * values[at] - 4 * inner[at] - inner[beside] for at, beside in ((0, 1), (-1, -2))]
    return np.concatenate([ends[0][None], inner, ends[1][None]])


class VisibilityTables(NamedTuple):
    """A :class:`~brdfpipe.masking.visibility.VisibilityRatio`."""

    log_ratio: Array
    """(grazing, steepness, asymmetry), each with its last node twice; of size 0 for Smith's masking"""
    last_grazing: float
    last_steepness: float
    width: float
    """Median slope"""
    limit: Curve
    """Factor of a direction over its cosine"""

    @classmethod
    def of(cls, ratio: VisibilityRatio | None, width: float) -> VisibilityTables:
        """Of a surface with a median slope; ``ratio`` is None for Smith's masking."""
        if ratio is None:
            return cls(np.empty((0, 0, 0)), 1.0, 1.0, 1.0, _broken_line(np.array([0.0, 1.0]), np.ones(2)))
        limit = _broken_line(ratio.limit_cos, ratio.limit)
        log_ratio = np.ascontiguousarray(np.pad(ratio.log_ratio, [(0, 1)] * 3, mode="edge"))
        return cls(log_ratio, *ratio.last, width, limit)


def _broken_line(x: Array, y: Array) -> Curve:
    """Linear between the nodes x, from about 0 or more, and held before the first."""
    if x[0] > 1e-12:
        x, y = np.append(0.0, x), np.append(y[0], y)
    nodes = np.append(0.0, x[1:])
    zero = np.zeros(y.size - 1)
    return Curve.of(PiecewiseCubic.of(PPoly(np.stack([zero, zero, np.diff(y) / np.diff(nodes), y[:-1]]), nodes)))


class FurtherLight(NamedTuple):
    """A :class:`~brdfpipe.bsdf.microfacet.second_reflection.SecondReflection`, or none if its table is empty."""

    log_factor: Array
    """(plane, θ_i, θ_o, φ, wavelength or 1), and further wavelengths that mean nothing"""
    weight: Array
    """(θ, φ), or (θ, 0)"""
    slope: float
    grazing_scale: float

    @classmethod
    def of(cls, log_factor: Array, weight: Array, slope: float, grazing_scale: float) -> FurtherLight:
        """Of a table with few wavelengths, or with many, which are filled up to a number that is evaluated fast."""
        wavelengths = log_factor.shape[-1]
        added = -wavelengths % _TOGETHER if wavelengths > _TOGETHER / 2 else 0
        filled = np.pad(log_factor, [(0, 0)] * 4 + [(0, added)])
        return cls(filled, np.array(weight, dtype=float, order="C"), slope, grazing_scale)


NO_FURTHER_LIGHT = FurtherLight(np.empty((0, 0, 0, 0, 0)), np.empty((0, 0)), 1.0, 1.0)


class IsotropicTables(NamedTuple):
    """Facets of an isotropic surface, and its albedo."""

    log_density: Curve
    excess: Curve
    albedo: Curve
    furnace: Curve
    separable: bool
    visibility: VisibilityTables
    further: FurtherLight


class FacetTables(NamedTuple):
    """Facets of an isotropic surface alone."""

    log_density: Curve
    excess: Curve
    separable: bool
    visibility: VisibilityTables

    @classmethod
    def of(cls, surface: Microsurface, masking: str) -> FacetTables:
        """Of an isotropic surface with a physical masking."""
        assert isinstance(surface.density, RadialDensity)
        assert isinstance(surface.smith, Smith)
        facets = Curve.of(surface.density.log_density), Curve.of(surface.smith.spline)
        ratio = surface.ratio if masking == "measured" else None
        return cls(*facets, masking == "separable", VisibilityTables.of(ratio, surface.typical_slope))


class LayFacetTables(NamedTuple):
    """Facets of a surface with a lay alone."""

    lay: float
    along: float
    across: float
    ends: tuple[float, float]
    """asinh(reach/scale) along the lay and across it"""
    log_density: Array
    """Coefficients of the uniform cubic B-spline, two more at each edge, (across, along)"""
    excess: UniformSurface
    last_excess: float
    separable: bool

    @classmethod
    def of(cls, surface: Microsurface, masking: str) -> LayFacetTables:
        """Of a surface with a lay and Smith's masking."""
        density, smith = surface.density, surface.smith
        assert isinstance(density, PlanarDensity)
        assert isinstance(smith, PlanarSmith)
        return cls(
            density.ellipse.lay,
            density.ellipse.along,
            density.ellipse.across,
            (density.along.end, density.across.end),
            # Continued as mirror images over the edges, as scipy does.
            np.pad(density.log_coefficients, 2, mode="reflect"),
            UniformSurface.of(smith.spline),
            smith.last,
            masking == "separable",
        )


class LayTables(NamedTuple):
    """Facets of a surface with a lay, and its albedo."""

    facets: LayFacetTables
    albedo: SplineSurface
    furnace: SplineSurface
    albedo_scale: float
    wide: float
    """Azimuth of the wider axis [degree]"""
    landen: Array
    """(steps, 2) means a and b of Landen's transformation"""
    further: FurtherLight


Rows: TypeAlias = tuple[Array, ...]
"""Values of the directions of a block, (directions,) each"""

Pair: TypeAlias = Rows
"""Squared slope, cos ζ, cos θ_i, sin θ_i, cos θ_o, sin θ_o, sin θ_i − sin θ_o"""

Tables: TypeAlias = IsotropicTables | LayTables


class Shading(NamedTuple):
    """Spectral fields, (wavelength,) each."""

    n: Array
    """(wavelength,) or, if neither n nor k depends on wavelength, of length 1"""
    k: Array
    base: Array
    """BRDF of the diffuse base where all light enters and leaves; 0 without one"""
    returned: Array
    """The same of the light that compensates multiple scattering"""
    absorbs: bool
    """Whether some k is above 0"""
    has_base: bool
    has_returned: bool


def tables_of(
    surface: Microsurface,
    masking: str,
    albedo: AlbedoTable,
    furnace: AlbedoTable | None,
    further: FurtherLight = NO_FURTHER_LIGHT,
) -> Tables:
    """Tables of a surface with a physical masking, of its albedos, and of the light that it reflects more than once."""
    assert masking != "measured" or surface.ratio is not None
    furnace = albedo if furnace is None else furnace
    if isinstance(surface.density, RadialDensity):
        facets = FacetTables.of(surface, masking)
        albedos = Curve.of(albedo.spline), Curve.of(furnace.spline)
        return IsotropicTables(
            facets.log_density, facets.excess, *albedos, facets.separable, facets.visibility, further
        )
    ellipse = surface.density.ellipse
    ratio, wide = axis_ratio(ellipse)
    return LayTables(
        LayFacetTables.of(surface, masking),
        SplineSurface.of(albedo.surfaces),
        SplineSurface.of(furnace.surfaces),
        lay_scale(ellipse),
        wide,
        _landen_steps(ratio),
        further,
    )


def _landen_steps(ratio: float) -> Array:
    """Arithmetic and geometric means from 1 and the ratio of the axes, as long as they differ, (steps, 2)."""
    steps, a, b = [], 1.0, ratio
    while a - b > _LANDEN_ERROR:
        steps.append((a, b))
        a, b = (a + b) / 2, math.sqrt(a * b)
    return np.array(steps).reshape(-1, 2)


# --- elementary functions


@compiled
def _at_most(x: float, limit: float) -> float:
    """The smaller one; unlike the built-in function, without a branch for NaN."""
    return x if x < limit else limit


@compiled
def _at_least(x: float, limit: float) -> float:
    return x if x > limit else limit


def _reinterpreted(source: Any, target: Any) -> Any:
    """A function of compiled code from a value to the one of another type with the same bits."""

    @intrinsic
    def reinterpret(typing_context: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.bitcast(arguments[0], context.get_value_type(target))

        return target(source), generate

    return reinterpret


_bits, _number = _reinterpreted(types.float64, types.int64), _reinterpreted(types.int64, types.float64)


@compiled
def _sine_cosine(x: float) -> tuple[float, float]:
    """Of an angle in radian within ±π/4. The terms of a polynomial are added in pairs (Estrin), so that few wait for another."""
    z = x * x
    w = z * z
    sine = 2.75573137070700676789e-06 + z * -2.50507602534068634195e-08 + w * 1.58969099521155010221e-10
    sine = (8.33333333332248946124e-03 + z * -1.98412698298579493134e-04) + w * sine
    sine = x + x * z * (-1.66666666666666324348e-01 + z * sine)
    cosine = 2.08757232129817482790e-09 + z * -1.13596475577881948265e-11
    cosine = (2.48015872894767294178e-05 + z * -2.75573143513906633035e-07) + w * cosine
    cosine = w * ((4.16666666666666019037e-02 + z * -1.38888888888741095749e-03) + w * cosine)
    return sine, 1 - (0.5 * z - cosine)


@compiled
def _of_degrees(angle: float) -> tuple[float, float]:
    """Sine and cosine of an angle in degree; the reduction to an eighth of the circle is exact."""
    shifted = angle * (1 / 90) + _ROUNDER
    sine, cosine = _sine_cosine((angle - 90 * (shifted - _ROUNDER)) * (math.pi / 180))
    quarter = _bits(shifted)
    odd = quarter & 1 != 0
    first, second = (cosine, sine) if odd else (sine, cosine)
    return -first if quarter & 2 != 0 else first, -second if (quarter + 1) & 2 != 0 else second


@compiled
def _exponential(x: float) -> float:
    """exp(x), as the square of exp(x/2), which neither overflows nor loses digits before the result does."""
    x = x if x > -1400 else -1400.0
    x = x if x < 1400 else 1400.0
    shifted = x * (0.5 * 1.4426950408889634) + _ROUNDER
    k = shifted - _ROUNDER
    r = x * 0.5 - k * _LOG_2_HIGH - k * _LOG_2_LOW
    square = r * r
    fourth = square * square
    value = (1 / 40320 + r * (1 / 362880)) + square * (1 / 3628800 + r * (1 / 39916800)) + fourth * (1 / 479001600)
    value = ((1 / 24 + r * (1 / 120)) + square * (1 / 720 + r * (1 / 5040))) + fourth * value
    value = ((1 + r) + square * (1 / 2 + r * (1 / 6))) + fourth * value
    value *= _number((_bits(shifted) + 1023) << 52)
    return value * value


@compiled
def _logarithm(x: float) -> float:
    """Of a normal number above 0."""
    exponent = (_bits(x) - _ROOT_HALF) >> 52
    f = _number(_bits(x) - (exponent << 52)) - 1
    k = _number(_bits(_ROUNDER) + exponent) - _ROUNDER
    s = f / (2 + f)
    z = s * s
    w = z * z
    even = w * (3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01))
    odd = 2.857142874366239149e-01 + w * (1.818357216161805012e-01 + w * 1.479819860511658591e-01)
    half = 0.5 * f * f
    rest = s * (half + even + z * (6.666666666666735130e-01 + w * odd))
    return k * _LOG_2_HIGH - ((half - (rest + k * _LOG_2_LOW)) - f)


@compiled
def _inverse_sinh(x: float) -> float:
    """asinh of |x| < 1e150, to an absolute 1e-16, with the sign of x."""
    size = _at_most(abs(x), 1e150)
    value = _logarithm(size + math.sqrt(size * size + 1))
    return -value if x < 0 else value


@compiled
def _arc_tangent(t: float) -> float:
    """Of 0 <= t <= 1 [rad]."""
    large = t > 0.4142135623730950
    x = (t - 1) / (t + 1) if large else t
    z = x * x
    above = -7.500855792314704667340e1 + z * (-1.615753718733365076637e1 + z * -8.750608600031904122785e-1)
    above = -6.485021904942025371773e1 + z * (-1.228866684490136173410e2 + z * above)
    below = 4.328810604912902668951e2 + z * (1.650270098316988542046e2 + z * (2.485846490142306297962e1 + z))
    below = 1.945506571482613964425e2 + z * (4.853903996359136964868e2 + z * below)
    value = x + x * (z * above / below)
    return value + math.pi / 4 if large else value


@compiled
def _small_angle(t: float) -> float:
    """Arc tangent of a number within ± the small tangent [rad]."""
    z = t * t
    w = z * z
    value = (1 / 9 - z * (1 / 11)) + w * (1 / 13)
    value = (1 / 5 - z * (1 / 7)) + w * value
    return t - t * z * (1 / 3 - z * value)


@compiled
def _angle(y: float, x: float) -> float:
    """Angle of the vector (x, y) [rad], from −π to π."""
    size_x, size_y = abs(x), abs(y)
    steep = size_y > size_x
    low, high = (size_x, size_y) if steep else (size_y, size_x)
    value = _arc_tangent(low / _at_least(high, _LEAST))
    value = math.pi / 2 - value if steep else value
    value = math.pi - value if x < 0 else value
    return -value if y < 0 else value


# --- facets


@compiled
def _four_rows(space: Array, first: int, size: int) -> Rows:
    return space[first, :size], space[first + 1, :size], space[first + 2, :size], space[first + 3, :size]


@compiled
def _rows(space: Array, size: int) -> Rows:
    """The rows of a work space for a block of directions; arrays of their own, because the compiler must see that they do not overlap."""
    first, last = _four_rows(space, 0, size) + _four_rows(space, 4, size), _four_rows(space, 16, size)
    return first + _four_rows(space, 8, size) + _four_rows(space, 12, size) + last


@compiled
def _distinct(theta: Array, phi: Array) -> int:
    """Number of directions of a block that differ: 1 if all are the same, as those of incidence often are, else all."""
    for j in range(1, theta.size):
        if theta[j] != theta[0] or phi[j] != phi[0]:
            return theta.size
    return 1


@compiled
def _spread(values: Array, count: int) -> None:
    """Repeat the value of directions that are all the same."""
    if count < values.size:
        values[:] = values[0]


@compiled
def _half_vectors(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, pair: Pair) -> None:
    """Rows of ``pair``: squared slope, cos ζ, cos θ_i, sin θ_i, cos θ_o, sin θ_o, sin θ_i − sin θ_o.

    With s and c of the half angles, sin θ_i − sin θ_o = 2 (c_i c_o − s_i s_o)(s_i c_o − c_i s_o), which is 0 for equal angles. Directions
    below the surface count as at the horizon.
    """
    slope_squared, cos_zeta, cosines_i, sines_i, cosines_o, sines_o, differences = pair
    for j in range(theta_i.size):
        s_i, c_i = _sine_cosine(_at_most(theta_i[j], 90.0) * (math.pi / 360))
        s_o, c_o = _sine_cosine(_at_most(theta_o[j], 90.0) * (math.pi / 360))
        sin_i, cos_i = 2 * s_i * c_i, _at_least((c_i - s_i) * (c_i + s_i), 0.0)
        sin_o, cos_o = 2 * s_o * c_o, _at_least((c_o - s_o) * (c_o + s_o), 0.0)
        turned = phi_i[j] - phi_o[j]
        turned -= 360 * (turned * (1 / 360) + _ROUNDER - _ROUNDER)
        # Half the angle from the mirror direction: exactly 0 there.
        sine, cosine = _sine_cosine((180 - abs(turned)) * (math.pi / 720))
        sine *= 2 * cosine
        difference = 2 * (c_i * c_o - s_i * s_o) * (s_i * c_o - c_i * s_o)
        tangential = difference * difference + 4 * (sin_i * sin_o) * (sine * sine)
        normal = _at_least(cos_i + cos_o, _LEAST)
        normal *= normal
        slope_squared[j], cos_zeta[j] = tangential / normal, _at_most(math.sqrt(tangential + normal) * 0.5, 1.0)
        cosines_i[j], sines_i[j], cosines_o[j], sines_o[j], differences[j] = cos_i, sin_i, cos_o, sin_o, difference


@compiled
def _within(x: float, last: float) -> float:
    """Limited to [0, last]; the last for NaN, which must not index a table."""
    return (x if x > 0 else 0.0) if x < last else last


@compiled
def _interval(x: float, curve: Curve) -> int:
    index = curve.guide[(_bits(x + curve.offset) >> curve.shift) - curve.first_key]
    for _ in range(curve.steps):
        index += x >= curve.nodes[index + 1]
    return index


@compiled
def _values(x: Array, curve: Curve, out: Array) -> None:
    """The curve's first value at each x; ``out`` may be x."""
    offset, shift, first_key, steps, last = curve.offset, curve.shift, curve.first_key, curve.steps, curve.last
    guide, nodes, c = curve.guide, curve.nodes, curve.coefficients
    for j in range(x.size):
        out[j] = _within(x[j], last)
    for j in range(x.size):
        at = out[j]
        # Unsigned indices are not counted from the end where they are negative, which saves a comparison each.
        index = np.uintp(guide[np.uintp((_bits(at + offset) >> shift) - first_key)])
        index += np.uintp(at >= nodes[index + _NEXT])
        if steps > 1:
            while at >= nodes[index + _NEXT]:
                index += _NEXT
        step = at - nodes[index]
        out[j] = ((c[index, 0, 0] * step + c[index, 1, 0]) * step + c[index, 2, 0]) * step + c[index, 3, 0]


@compiled
def _mirrors(pair: Pair, density: Array, excess_i: Array, excess_o: Array, separable: bool, mirrors: Array) -> None:
    """D G2 / (4 cos θ_i cos θ_o) from P22 and the mean excess slopes."""
    for j in range(mirrors.size):
        cos_i, sin_i, cos_o, sin_o = pair[2][j], pair[3][j], pair[4][j], pair[5][j]
        g_i, g_o = _at_least(excess_i[j], 0.0), _at_least(excess_o[j], 0.0)
        if separable:
            visible = (cos_i + g_i * sin_i) * (cos_o + g_o * sin_o)
        else:
            visible = cos_i * cos_o + (g_i * sin_i * cos_o + g_o * sin_o * cos_i)
        spread = 1 + pair[0][j]
        mirrors[j] = density[j] * (spread * spread) * (0.25 / visible)


@compiled
def _isotropic_mirrors(
    pair: Pair, work: Rows, count: int, tables: IsotropicTables | FacetTables, mirrors: Array
) -> None:
    _density(pair[0], tables.log_density, work[0])
    _mirrors_of_density(pair, work, count, tables, mirrors)


@compiled
def _density(slope_squared: Array, log_density: Curve, density: Array) -> None:
    """P22."""
    _values(slope_squared, log_density, density)
    for j in range(density.size):
        density[j] = _exponential(density[j]) if slope_squared[j] <= log_density.last else 0.0


@compiled
def _mirrors_of_density(
    pair: Pair, work: Rows, count: int, tables: IsotropicTables | FacetTables, mirrors: Array
) -> None:
    """BRDF of perfectly mirroring facets of known P22, the first row of the work space."""
    density, excess_i, excess_o = work[0], work[1], work[2]
    for j in range(mirrors.size):
        excess_i[j], excess_o[j] = pair[2][j] / pair[3][j], pair[4][j] / pair[5][j]
    _values(excess_i[:count], tables.excess, excess_i)
    _values(excess_o, tables.excess, excess_o)
    _spread(excess_i, count)
    _mirrors(pair, density, excess_i, excess_o, tables.separable, mirrors)
    if tables.visibility.log_ratio.size:
        _limit_visibility(pair, (density, excess_i, excess_o, *work[3:7]), tables.visibility, mirrors)


@compiled
def _limit_visibility(pair: Pair, rows: Rows, table: VisibilityTables, mirrors: Array) -> None:
    """Multiply by the ratio of the traced visibility to Smith's, as :meth:`~brdfpipe.masking.visibility.VisibilityRatio.visibility`.

    The first row is P22, with which ``mirrors`` are compared where no facet is hidden; the others are work space.
    """
    density, grazing, steepness, asymmetry, ratio, limit_i, limit_o = rows
    table_size = table.log_ratio.shape
    width, last_grazing, last_steepness = table.width, table.last_grazing, table.last_steepness
    cells = float(table_size[0] - 2), float(table_size[1] - 2), float(table_size[2] - 2)
    for j in range(mirrors.size):
        slope, cos_zeta, cos_i, cos_o = math.sqrt(pair[0][j]), pair[1][j], pair[2][j], pair[4][j]
        sin_zeta = math.sqrt(_at_least((1 - cos_zeta) * (1 + cos_zeta), 0.0))
        reach = _at_most(slope * sin_zeta, cos_zeta) * (cos_i + cos_o)
        different = abs(cos_i - cos_o) * cos_zeta / reach if reach > 0 else 0.0
        inclined = width * sin_zeta
        grazing[j] = _at_most(inclined / (inclined + cos_zeta), last_grazing) / last_grazing * cells[0]
        steepness[j] = _at_most(_inverse_sinh(slope / width), last_steepness) / last_steepness * cells[1]
        asymmetry[j] = _at_most(different, 1.0) * cells[2]
    flat, rows_apart = table.log_ratio.reshape(table.log_ratio.size), np.uintp(table_size[2])
    layers_apart = np.uintp(table_size[1]) * rows_apart
    for j in range(mirrors.size):
        x, y, z = grazing[j], steepness[j], asymmetry[j]
        x_0, y_0, z_0 = _node_before(x), _node_before(y), _node_before(z)
        x, y, z = x - x_0, y - y_0, z - z_0
        first = np.uintp(x_0) * layers_apart + np.uintp(y_0) * rows_apart + np.uintp(z_0)
        near = _on_plane(flat, first, rows_apart, y, z)
        ratio[j] = near * (1 - x) + _on_plane(flat, first + layers_apart, rows_apart, y, z) * x
    _values(pair[2], table.limit, limit_i)
    _values(pair[4], table.limit, limit_o)
    for j in range(mirrors.size):
        spread = 1 + pair[0][j]
        unhidden = density[j] * (spread * spread) * (0.25 / (pair[2][j] * pair[4][j]))
        limited = _at_most(mirrors[j] * _exponential(ratio[j]), unhidden)
        mirrors[j] = limited * (limit_i[j] * limit_o[j])


@compiled
def _node_before(place: float) -> int:
    """The first node for NaN, which must not index a table."""
    return int(place if place > 0 else 0.0)


@compiled
def _on_plane(c: Array, first: np.uintp, rows_apart: np.uintp, y: float, z: float) -> float:
    """Bilinear between four nodes."""
    near = c[first] * (1 - z) + c[first + _NEXT] * z
    far = c[first + rows_apart] * (1 - z) + c[first + rows_apart + _NEXT] * z
    return near * (1 - y) + far * y


@compiled
def _between(x: float, axis: SplineAxis) -> float:
    """Limited to the axis; its last for NaN."""
    return (x if x > axis.first else axis.first) if x < axis.last else axis.last


@compiled
def _span(x: float, axis: SplineAxis) -> np.uintp:
    index = np.uintp(axis.guide[np.uintp(np.int64((x - axis.first) * axis.cells_a_unit))])
    # Of a cell, which holds one knot at most, one comparison is enough; rounding may need another.
    index += np.uintp(x >= axis.knots[index + _NEXT])
    while x >= axis.knots[index + _NEXT]:
        index += _NEXT
    return index


@compiled
def _basis(s: float, b: Array) -> tuple[float, float, float, float]:
    """The four basis functions of a span at a distance from its first knot."""
    return (
        ((b[0, 0] * s + b[1, 0]) * s + b[2, 0]) * s + b[3, 0],
        ((b[0, 1] * s + b[1, 1]) * s + b[2, 1]) * s + b[3, 1],
        ((b[0, 2] * s + b[1, 2]) * s + b[2, 2]) * s + b[3, 2],
        ((b[0, 3] * s + b[1, 3]) * s + b[2, 3]) * s + b[3, 3],
    )


@compiled
def _surface_values(x: Array, y: Array, surface: SplineSurface, out: Array) -> None:
    """The value of a surface of one value at each place, held beyond its edges; ``out`` may be x or y."""
    axis_x, axis_y, c = surface.x, surface.y, surface.patches
    columns = np.uintp(axis_y.basis.shape[0])
    for n in range(x.size):
        at_x, at_y = _between(x[n], axis_x), _between(y[n], axis_y)
        i, j = _span(at_x, axis_x), _span(at_y, axis_y)
        s, t = at_x - axis_x.knots[i], at_y - axis_y.knots[j]
        first = np.uintp(16) * (i * columns + j)
        value = _cubic(c, first, t)
        value = value * s + _cubic(c, first + np.uintp(4), t)
        value = value * s + _cubic(c, first + np.uintp(8), t)
        out[n] = value * s + _cubic(c, first + np.uintp(12), t)


@compiled
def _cubic(c: Array, first: np.uintp, t: float) -> float:
    return ((c[first] * t + c[first + np.uintp(1)]) * t + c[first + np.uintp(2)]) * t + c[first + np.uintp(3)]


@compiled
def _uniform_basis(x: float) -> tuple[float, float, float, float]:
    """The uniform cubic B-splines about a position between its two middle ones, 0 <= x <= 1."""
    y = 1 - x
    return (
        y * y * y * (1 / 6),
        x * x * (x - 2) * 0.5 + 2 / 3,
        y * y * (y - 2) * 0.5 + 2 / 3,
        x * x * x * (1 / 6),
    )


@compiled
def _uniform_values(along: Array, across: Array, coefficients: Array, rows: Rows, out: Array) -> None:
    """A uniform spline at fractional indices of its columns and rows; minus infinity beyond them. ``out`` may be ``along``.

    ``rows`` are work space. The weights of the nodes are computed before the nodes are read, so that those of several directions are
    computed at once.
    """
    start, a_0, a_1, a_2, a_3, b_0, b_1, b_2, b_3 = rows
    flat, width = coefficients.reshape(coefficients.size), coefficients.shape[1]
    last_row, last_column = float(coefficients.shape[0] - 5), float(width - 5)
    for j in range(out.size):
        at = across[j], along[j]
        inside = (at[0] >= 0) & (at[0] <= last_row) & (at[1] >= 0) & (at[1] <= last_column)
        row, column = (at[0], at[1]) if inside else (0.0, 0.0)
        first_row, first_column = np.floor(row), np.floor(column)
        a_0[j], a_1[j], a_2[j], a_3[j] = _uniform_basis(row - first_row)
        b_0[j], b_1[j], b_2[j], b_3[j] = _uniform_basis(column - first_column)
        place = (first_row + 1) * width + (first_column + 1)
        start[j] = place if inside else -1.0
    step = np.uintp(width)
    for j in range(out.size):
        place = start[j]
        first = np.uintp(np.int64(place if place > 0 else 0.0))
        w = b_0[j], b_1[j], b_2[j], b_3[j]
        value = a_0[j] * _weighted(flat, first, w)
        value += a_1[j] * _weighted(flat, first + step, w)
        value += a_2[j] * _weighted(flat, first + np.uintp(2) * step, w)
        value += a_3[j] * _weighted(flat, first + np.uintp(3) * step, w)
        out[j] = value if place > 0 else -math.inf


@compiled
def _weighted(c: Array, first: np.uintp, w: tuple[float, float, float, float]) -> float:
    return (w[0] * c[first] + w[1] * c[first + np.uintp(1)]) + (
        w[2] * c[first + np.uintp(2)] + w[3] * c[first + np.uintp(3)]
    )


@compiled
def _grid_positions(
    phi_i: Array, phi_o: Array, pair: Pair, tables: LayFacetTables, across: Array, along: Array
) -> None:
    """Fractional indices, on the nodes of the density, of the slopes that mirror one direction into the other."""
    _, _, cosines_i, sines_i, cosines_o, sines_o, differences = pair
    # Slopes along the mean azimuth of both directions and across it, turned to those of the lay.
    lay, width_along, width_across = tables.lay, tables.along, tables.across
    for j in range(along.size):
        sine, cosine = _of_degrees((phi_i[j] - phi_o[j]) / 2)
        scale = -1 / _at_least(cosines_i[j] + cosines_o[j], _LEAST)
        ahead, beside = scale * (sines_i[j] + sines_o[j]) * cosine, scale * differences[j] * sine
        sine, cosine = _of_degrees((phi_i[j] + phi_o[j]) / 2 - lay)
        along[j] = (ahead * cosine - beside * sine) / width_along
        across[j] = (ahead * sine + beside * cosine) / width_across
    for slope, end, size in (
        (along, tables.ends[0], tables.log_density.shape[1]),
        (across, tables.ends[1], tables.log_density.shape[0]),
    ):
        half, scale = (size - 5) / 2, (size - 5) / (2 * end)
        for j in range(slope.size):
            slope[j] = _inverse_sinh(slope[j]) * scale + half


@compiled
def _excess_with_lay(
    phi: Array, cosines: Array, sines: Array, tables: LayFacetTables, rows: Rows, excess: Array
) -> None:
    """Mean excess slopes towards directions; ``rows`` are work space."""
    width, turn = rows[:2]
    surface = tables.excess
    last_row, last_column = surface.coefficients.shape[0] - 5.0, surface.coefficients.shape[1] - 5.0
    lay, along, across, last = tables.lay, tables.along, tables.across, tables.last_excess
    for j in range(phi.size):
        sine, cosine = _of_degrees(phi[j] - lay)
        x, y = along * cosine, across * sine
        width[j] = math.sqrt(x * x + y * y)
        angle = _angle(y, x) * (180 / math.pi)
        turn[j] = angle + (360.0 if angle < 0 else 0.0)
    for j in range(phi.size):
        slope = cosines[j] / sines[j] / width[j]
        place = (_inverse_sinh(slope if slope < last else last) - surface.first[0]) * surface.nodes_a_unit[0]
        excess[j] = _within(place, last_row)
        turn[j] = _within((turn[j] - surface.first[1]) * surface.nodes_a_unit[1], last_column)
        width[j] = width[j] if slope < last else 0.0
    _uniform_values(turn, excess, surface.coefficients, rows[2:11], excess[: phi.size])
    for j in range(phi.size):
        excess[j] *= width[j]


@compiled
def _facets_with_lay(
    phi_i: Array, phi_o: Array, pair: Pair, work: Rows, count: int, tables: LayFacetTables, other: Array
) -> None:
    """Mean excess slopes of both directions and P22, in the first rows of the work space; so is ``other``."""
    excess_i, excess_o, density = work[:3]
    _excess_with_lay(phi_i[:count], pair[2], pair[3], tables, (other, *work[2:]), excess_i)
    _excess_with_lay(phi_o, pair[4], pair[5], tables, (other, *work[2:]), excess_o)
    _spread(excess_i, count)
    _grid_positions(phi_i, phi_o, pair, tables, other, density)
    _uniform_values(density, other, tables.log_density, work[3:12], density)
    for j in range(density.size):
        density[j] = _exponential(density[j])


@compiled
def _arcs(azimuths: Array, wide: float, landen: Array, rows: Rows, arcs: Array) -> None:
    """Arcs of azimuths from the wider axis [degree], as :func:`~brdfpipe.bsdf.microfacet.anisotropic_quadrature.azimuth_to_arc`.

    Landen's transformation φ' = φ + ω, tan ω = (b/a) tan φ, carries an ellipse to a rounder one; the arc is φ/2ⁿ of the last.
    """
    sines, cosines = rows
    share = 90 / math.pi
    for j in range(azimuths.size):
        arcs[j] = azimuths[j] - wide
        sines[j], cosines[j] = _of_degrees(arcs[j])
    steps = landen.shape[0]
    for step in range(steps):
        a, b = landen[step, 0], landen[step, 1]
        # ω − φ, within a right angle, from the vector of ω turned by −φ.
        if (a - b) * (a - b) < 4 * _SMALL_TANGENT * _SMALL_TANGENT * (a * b):
            for j in range(azimuths.size):
                sine, cosine = sines[j], cosines[j]
                arcs[j] += share * _small_angle((b - a) * (sine * cosine) / (a * (cosine * cosine) + b * (sine * sine)))
        else:
            for j in range(azimuths.size):
                sine, cosine = sines[j], cosines[j]
                arcs[j] += share * _angle((b - a) * (sine * cosine), a * (cosine * cosine) + b * (sine * sine))
        share *= 0.5
        for j in range(azimuths.size if step + 1 < steps else 0):
            sine, cosine = sines[j], cosines[j]
            x, y = a * cosine, b * sine
            shorter = 1 / math.sqrt(x * x + y * y)
            cosines[j], sines[j] = (cosine * x - sine * y) * shorter, (cosine * y + sine * x) * shorter
    for j in range(azimuths.size):
        arcs[j] -= 360 * np.floor(arcs[j] / 360)


# --- Fresnel's reflectance and what the facets leave


@compiled
def _transparent(c: float, n: float) -> float:
    """Fresnel's reflectance of n >= 1 for unpolarised light."""
    contrast = (n - 1) * (n + 1)
    q = math.sqrt(contrast + c * c)
    into_s, into_p = _at_least(c + q, _LEAST), _at_least(n * n * c + q, _LEAST)
    r_s = contrast / (into_s * into_s)
    r_p = contrast * ((n * n + 1) * (c * c) - 1) / (into_p * into_p)
    return (_at_most(r_s * r_s, 1.0) + _at_most(r_p * r_p, 1.0)) * 0.5


@compiled
def _absorbing(c: float, n: float, k: float) -> float:
    """The same of n + ik: powers of complex amplitudes in real arithmetic."""
    real, imaginary = (n - 1) * (n + 1) - k * k, 2 * n * k
    square = real + c * c
    size = math.sqrt(square * square + imaginary * imaginary)
    longer = math.sqrt((size + abs(square)) * 0.5)
    shorter = imaginary / _at_least(2 * longer, _LEAST)
    root, root_i = (longer, shorter) if square >= 0 else (shorter, longer)
    power = real * real + imaginary * imaginary
    into_s = (c + root) * (c + root) + root_i * root_i
    ahead, aside = (real + 1) * c + root, imaginary * c + root_i
    into_p = ahead * ahead + aside * aside
    ahead, aside = (real + 2) * (c * c) - 1, imaginary * (c * c)
    into_s, into_p = _at_least(into_s, _LEAST), _at_least(into_p, _LEAST)
    f_p = (power / into_p) * ((ahead * ahead + aside * aside) / into_p)
    return (_at_most(power / (into_s * into_s), 1.0) + _at_most(f_p, 1.0)) * 0.5


@compiled
def _reflected(mirrors: Array, cos_zeta: Array, shading: Shading, out: Array) -> None:
    """Fill in F D G2 / (4 cos θ_i cos θ_o)."""
    if shading.n.size == 1:
        n, k = shading.n[0], shading.k[0]
        if shading.absorbs:
            for j in range(mirrors.size):
                mirrors[j] *= _absorbing(cos_zeta[j], n, k)
        else:
            for j in range(mirrors.size):
                mirrors[j] *= _transparent(cos_zeta[j], n)
        if out.shape[1] == 1:
            out[:, 0] = mirrors
        else:
            for j in range(mirrors.size):
                out[j] = mirrors[j]
    elif shading.absorbs:
        for j in range(mirrors.size):
            for w in range(out.shape[1]):
                out[j, w] = mirrors[j] * _absorbing(cos_zeta[j], shading.n[w], shading.k[w])
    else:
        for j in range(mirrors.size):
            for w in range(out.shape[1]):
                out[j, w] = mirrors[j] * _transparent(cos_zeta[j], shading.n[w])


@compiled
def _add_products(of_direction: Array, of_wavelength: Array, out: Array) -> None:
    if out.shape[1] == 1:
        flat, factor = out.reshape(out.size), of_wavelength[0]
        for j in range(flat.size):
            flat[j] += of_direction[j] * factor
    else:
        for j in range(out.shape[0]):
            for w in range(out.shape[1]):
                out[j, w] += of_direction[j] * of_wavelength[w]


@compiled
def _left(albedo: float) -> float:
    """Share that an albedo leaves, in [0, 1]."""
    rest = 1 - albedo
    rest = rest if rest > 0 else 0.0
    return rest if rest < 1 else 1.0


@compiled
def _add_isotropic_base(
    theta_i: Array, theta_o: Array, count: int, albedo: Curve, factor: Array, work: Rows, out: Array
) -> None:
    """Add the light of the base, reduced by what the facets reflect of both directions."""
    c, left = albedo.coefficients, work[0]
    if c.shape[2] == 1:
        other = work[1]
        for j in range(theta_i.size):
            left[j], other[j] = 90 - theta_i[j], 90 - theta_o[j]
        _values(left[:count], albedo, left)
        _values(other, albedo, other)
        _spread(left, count)
        for j in range(theta_i.size):
            left[j] = _left(left[j]) * _left(other[j])
        _add_products(left, factor, out)
        return
    for j in range(theta_i.size):
        grazing_i, grazing_o = _within(90 - theta_i[j], albedo.last), _within(90 - theta_o[j], albedo.last)
        at_i, at_o = _interval(grazing_i, albedo), _interval(grazing_o, albedo)
        s, t = grazing_i - albedo.nodes[at_i], grazing_o - albedo.nodes[at_o]
        c_i, c_o = c[at_i], c[at_o]
        for w in range(out.shape[1]):
            e_i = ((c_i[0, w] * s + c_i[1, w]) * s + c_i[2, w]) * s + c_i[3, w]
            e_o = ((c_o[0, w] * t + c_o[1, w]) * t + c_o[2, w]) * t + c_o[3, w]
            out[j, w] += factor[w] * (_left(e_i) * _left(e_o))


@compiled
def _add_base_with_lay(places: Rows, count: int, albedo: SplineSurface, factor: Array, work: Rows, out: Array) -> None:
    """The same; rows of ``places`` are the coordinates of the albedo of both directions."""
    size, width = out.shape
    if albedo.coefficients.shape[2] == 1:
        left = work[0]
        _surface_values(places[0][:count], places[1], albedo, left)
        _spread(left, count)
        _surface_values(places[2], places[3], albedo, work[1])
        for j in range(size):
            left[j] = _left(left[j]) * _left(work[1][j])
        _add_products(left, factor, out)
        return
    e_i, e_o = np.empty(width), np.empty(width)
    for j in range(size):
        _spectrum_on_surface(places[0][j], places[1][j], albedo, e_i)
        _spectrum_on_surface(places[2][j], places[3][j], albedo, e_o)
        for w in range(width):
            out[j, w] += factor[w] * (_left(e_i[w]) * _left(e_o[w]))


@compiled
def _spectrum_on_surface(x: float, y: float, surface: SplineSurface, values: Array) -> None:
    x, y = _between(x, surface.x), _between(y, surface.y)
    i, j = _span(x, surface.x), _span(y, surface.y)
    basis_x = _basis(x - surface.x.knots[i], surface.x.basis[i])
    basis_y = _basis(y - surface.y.knots[j], surface.y.basis[j])
    values[:] = 0.0
    for a in range(4):
        row = surface.coefficients[i + np.uintp(a)]
        f_0, f_1, f_2, f_3 = (
            basis_x[a] * basis_y[0],
            basis_x[a] * basis_y[1],
            basis_x[a] * basis_y[2],
            basis_x[a] * basis_y[3],
        )
        r_0, r_1, r_2, r_3 = row[j], row[j + np.uintp(1)], row[j + np.uintp(2)], row[j + np.uintp(3)]
        for w in range(values.size):
            values[w] += (f_0 * r_0[w] + f_1 * r_1[w]) + (f_2 * r_2[w] + f_3 * r_3[w])


# --- light that facets reflect more than once


@compiled
def _nodes_of_further_light(
    theta: Array, cosines: Array, sines: Array, table: FurtherLight, node: Array, hidden: Array
) -> None:
    """Places of directions among the nodes θ, in steps, and cos θ Λ of a GGX surface."""
    last, slope, inverse = float(table.log_factor.shape[1] - 1), table.slope, 1 / table.grazing_scale
    nodes_a_unit = last / math.asinh(90 * inverse)
    for j in range(theta.size):
        grazing = _at_least(90 - theta[j], 0.0) * inverse
        place = last - _logarithm(grazing + math.sqrt(grazing * grazing + 1)) * nodes_a_unit
        node[j] = _at_least(place, 0.0)
        across = slope * sines[j]
        hidden[j] = (math.sqrt(cosines[j] * cosines[j] + across * across) - cosines[j]) * 0.5


@compiled
def _weight_of_direction(node: float, phi: float, weight: Array) -> float:
    """Factor of a direction of a surface with a lay."""
    turns, row = weight.shape[1], min(int(node), weight.shape[0] - 2)
    around = phi / 360
    around = _within((around - math.floor(around)) * turns, float(turns))
    first, share = int(around), around - math.floor(around)
    column, following = first % turns, (first + 1) % turns
    near = weight[row, column] * (1 - share) + weight[row, following] * share
    far = weight[row + 1, column] * (1 - share) + weight[row + 1, following] * share
    share = _at_most(node - row, 1.0)
    return near * (1 - share) + far * share


@compiled
def _add_further_light(
    theta_i: Array,
    phi_i: Array,
    theta_o: Array,
    phi_o: Array,
    pair: Pair,
    count: int,
    table: FurtherLight,
    work: Rows,
    out: Array,
) -> None:
    """Add the light that facets reflect more than once."""
    share_i, share_o, share_a, factor, first = work[:5]
    planes, nodes, _, azimuths, width = table.log_factor.shape
    size, slope = theta_i.size, table.slope
    _nodes_of_further_light(theta_i[:count], pair[2], pair[3], table, share_i, factor)
    _nodes_of_further_light(theta_o, pair[4], pair[5], table, share_o, first)
    _spread(share_i, count)
    _spread(factor, count)
    if table.weight.shape[1]:
        weights = work[5]
        for j in range(size):
            weight_i = _weight_of_direction(share_i[j], phi_i[j], table.weight)
            weights[j] = weight_i * _weight_of_direction(share_o[j], phi_o[j], table.weight)
    last_cell, last_azimuth = float(nodes - 2), float(azimuths - 1)
    degree = math.pi / 180
    for j in range(size):
        # In one order, so that exchanged directions give the same bits.
        low, high = _at_most(share_i[j], share_o[j]), _at_least(share_i[j], share_o[j])
        row, column = _at_most(np.floor(low), last_cell), _at_most(np.floor(high), last_cell)
        share_i[j], share_o[j] = _at_most(low - row, 1.0), _at_most(high - column, 1.0)
        cos_i, cos_o, hidden_i, hidden_o = pair[2][j], pair[4][j], factor[j], first[j]
        turn = abs(phi_i[j] - phi_o[j])
        turn = abs(turn - 360 * np.floor(turn * (1 / 360)) - 180) * degree
        inverse = 1 / _at_most(slope * (cos_i + cos_o) + 1e-3, 4.0)
        near, far = turn * inverse, math.pi * inverse
        reach = _logarithm(far + math.sqrt(far * far + 1))
        seen = 16 * _at_least(cos_i * cos_o + (hidden_i * cos_o + hidden_o * cos_i), _LEAST)
        inverse = 1 / (reach * seen)
        azimuth = _logarithm(near + math.sqrt(near * near + 1)) * (seen * inverse)
        azimuth = _within(azimuth * last_azimuth, last_azimuth)
        cell = _at_most(np.floor(azimuth), last_azimuth - 1)
        share_a[j] = azimuth - cell
        factor[j] = cos_i * cos_o * (reach * inverse)
        first[j] = ((row * nodes + column) * azimuths + cell) * width
    if table.weight.shape[1]:
        for j in range(size):
            factor[j] *= work[5][j]
    flat, shares = table.log_factor.reshape(table.log_factor.size), (share_i, share_o, share_a)
    sizes = nodes * azimuths * width, azimuths * width, width
    if planes > 1:
        following, second_factor = work[6], work[7]
        plane_size = float(nodes * sizes[0])
        for j in range(size):
            swapped = theta_i[j] > theta_o[j]
            turn = (phi_i[j] - phi_o[j]) / 360 if swapped else (phi_o[j] - phi_i[j]) / 360
            place = ((phi_o[j] if swapped else phi_i[j]) / 180 + turn - np.floor(turn) - 0.5) * planes
            place -= planes * np.floor(place / planes)
            plane = _within(np.floor(place), planes - 1.0)
            share = place - plane
            following[j] = first[j] + (plane + 1 if plane + 1 < planes else 0.0) * plane_size
            first[j] += plane * plane_size
            second_factor[j] = factor[j] * share
            factor[j] *= 1 - share
        _add_light_of_plane(flat, following, shares, second_factor, sizes, out)
    _add_light_of_plane(flat, first, shares, factor, sizes, out)


@compiled
def _add_light_of_plane(
    flat: Array, first: Array, shares: Rows, factor: Array, sizes: tuple[int, int, int], out: Array
) -> None:
    """Add the exponential of an interpolation between the eight nodes from the index ``first`` on, which is overwritten.

    ``sizes`` are those of a layer, a row and a spectrum of the table.
    """
    (share_i, share_o, share_a), (layer_size, row_size, width) = shares, sizes
    if width == 1:
        rows_apart, layers_apart = np.uintp(row_size), np.uintp(layer_size)
        for j in range(first.size):
            start, x, y, z = np.uintp(np.int64(first[j])), share_i[j], share_o[j], share_a[j]
            near = _on_plane(flat, start, rows_apart, y, z)
            first[j] = near * (1 - x) + _on_plane(flat, start + layers_apart, rows_apart, y, z) * x
        for j in range(first.size):
            first[j] = _exponential(first[j]) * factor[j]
        _add_products(first, np.ones(out.shape[1]), out)
        return
    spectrum = np.empty(width)
    for j in range(first.size):
        x, y, z = share_i[j], share_o[j], share_a[j]
        a, b, c, d = (1 - x) * (1 - y), (1 - x) * y, x * (1 - y), x * y
        a_0, b_0, c_0, d_0 = a * (1 - z), b * (1 - z), c * (1 - z), d * (1 - z)
        a_1, b_1, c_1, d_1 = a * z, b * z, c * z, d * z
        begin = int(first[j])
        row_a, row_b = flat[begin : begin + 2 * width], flat[begin + row_size : begin + row_size + 2 * width]
        begin += layer_size
        row_c, row_d = flat[begin : begin + 2 * width], flat[begin + row_size : begin + row_size + 2 * width]
        for w in range(width):
            near = (a_0 * row_a[w] + b_0 * row_b[w]) + (c_0 * row_c[w] + d_0 * row_d[w])
            far = (a_1 * row_a[width + w] + b_1 * row_b[width + w]) + (c_1 * row_c[width + w] + d_1 * row_d[width + w])
            spectrum[w] = _exponential(near + far)
        values, common = out[j], factor[j]
        for w in range(values.size):
            values[w] += common * spectrum[w]


@compiled
def _clear_below(theta_i: Array, theta_o: Array, out: Array) -> None:
    for j in range(theta_i.size):
        if not (theta_i[j] < 90 and theta_o[j] < 90):
            out[j] = 0.0


# --- whole evaluations


@compiled
def _evaluate_isotropic(
    theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, tables: IsotropicTables, shading: Shading, out: Array
) -> None:
    space = np.empty((_ROWS, _BLOCK))
    rows = _rows(space, _BLOCK)
    for start in range(0, theta_i.size, _BLOCK):
        end = min(start + _BLOCK, theta_i.size)
        if end - start < _BLOCK:
            rows = _rows(space, end - start)
        polar_i, polar_o, values = theta_i[start:end], theta_o[start:end], out[start:end]
        azimuth_i, azimuth_o = phi_i[start:end], phi_o[start:end]
        pair, mirrors, work = rows[:7], rows[7], rows[8:]
        count = _distinct(polar_i, azimuth_i)
        _half_vectors(polar_i, azimuth_i, polar_o, azimuth_o, pair)
        _isotropic_mirrors(pair, work, count, tables, mirrors)
        _reflected(mirrors, pair[1], shading, values)
        if tables.further.log_factor.size:
            _add_further_light(polar_i, azimuth_i, polar_o, azimuth_o, pair, count, tables.further, work, values)
        if shading.has_base:
            _add_isotropic_base(polar_i, polar_o, count, tables.albedo, shading.base, work, values)
        if shading.has_returned:
            _add_isotropic_base(polar_i, polar_o, count, tables.furnace, shading.returned, work, values)
        _clear_below(polar_i, polar_o, values)


@compiled
def _evaluate_with_lay(
    theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, tables: LayTables, shading: Shading, out: Array
) -> None:
    space = np.empty((_ROWS, _BLOCK))
    rows = _rows(space, _BLOCK)
    for start in range(0, theta_i.size, _BLOCK):
        end = min(start + _BLOCK, theta_i.size)
        if end - start < _BLOCK:
            rows = _rows(space, end - start)
        polar_i, polar_o, values = theta_i[start:end], theta_o[start:end], out[start:end]
        azimuth_i, azimuth_o = phi_i[start:end], phi_o[start:end]
        pair, mirrors, work, places = rows[:7], rows[7], rows[8:], rows[12:16]
        count = _distinct(polar_i, azimuth_i)
        _half_vectors(polar_i, azimuth_i, polar_o, azimuth_o, pair)
        _facets_with_lay(azimuth_i, azimuth_o, pair, work, count, tables.facets, mirrors)
        _mirrors(pair, work[2], work[0], work[1], tables.facets.separable, mirrors)
        _reflected(mirrors, pair[1], shading, values)
        if tables.further.log_factor.size:
            _add_further_light(polar_i, azimuth_i, polar_o, azimuth_o, pair, count, tables.further, work, values)
        if shading.has_base or shading.has_returned:
            for j in range(mirrors.size):
                places[0][j] = _inverse_sinh((90 - polar_i[j]) / tables.albedo_scale)
                places[2][j] = _inverse_sinh((90 - polar_o[j]) / tables.albedo_scale)
            _arcs(azimuth_i[:count], tables.wide, tables.landen, work[:2], places[1])
            _arcs(azimuth_o, tables.wide, tables.landen, work[:2], places[3])
            _spread(places[1], count)
        if shading.has_base:
            _add_base_with_lay(places, count, tables.albedo, shading.base, work, values)
        if shading.has_returned:
            _add_base_with_lay(places, count, tables.furnace, shading.returned, work, values)
        _clear_below(polar_i, polar_o, values)


@compiled
def _evaluate_further_light(
    theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, table: FurtherLight, out: Array
) -> None:
    space = np.empty((_ROWS, _BLOCK))
    out[:] = 0.0
    for start in range(0, theta_i.size, _BLOCK):
        end = min(start + _BLOCK, theta_i.size)
        rows = _rows(space, end - start)
        polar_i, polar_o, azimuth_i, azimuth_o = (
            theta_i[start:end],
            theta_o[start:end],
            phi_i[start:end],
            phi_o[start:end],
        )
        count = _distinct(polar_i, azimuth_i)
        _half_vectors(polar_i, azimuth_i, polar_o, azimuth_o, rows[:7])
        _add_further_light(polar_i, azimuth_i, polar_o, azimuth_o, rows[:7], count, table, rows[8:], out[start:end])


@compiled
def _sum_over_facets(
    theta_i: Array,
    slope: Array,
    slope_weight: Array,
    first: Array,
    azimuths: Array,
    tables: FacetTables,
    n: Array,
    k: Array,
    sums: Array,
) -> None:
    turns, orders, absorbs = azimuths.shape[1], sums.shape[1], bool(k.any())
    together = _BLOCK // turns
    space, of_slope = np.empty((_ROWS, _BLOCK)), np.empty((2, together))
    parts = np.empty((orders, _SUMMED))
    for row in range(theta_i.size):
        cosine, sin_i = math.cos(theta_i[row]), math.sin(theta_i[row])
        cos_i = _at_least(cosine, _LEAST)
        parts[:] = 0.0
        for start in range(0, slope.shape[1], together):
            count = min(together, slope.shape[1] - start)
            rows = _rows(space, count * turns)
            pair, mirrors, work, light = rows[:7], rows[7], rows[8:19], rows[19]
            squares, densities = of_slope[0, :count], of_slope[1, :count]
            for place in range(count):
                squares[place] = slope[row, start + place] * slope[row, start + place]
            _values(squares, tables.log_density, densities)
            for place in range(count):
                u, open_range = squares[place], math.pi - first[row, start + place]
                s, begin = slope[row, start + place], first[row, start + place]
                density = _exponential(densities[place]) if u <= tables.log_density.last else 0.0
                weight = 8 * slope_weight[row, start + place] * s * open_range / ((1 + u) * (1 + u))
                over, root = 1 / (1 + u), 1 / math.sqrt(1 + u)
                at = place * turns
                for turn in range(turns):
                    # cos 2x = −sin 2y = −2 sin y cos y of y = x − π/4, for angles 2x up to π.
                    sine, other = _sine_cosine((begin + open_range * azimuths[0, turn] - math.pi / 2) * 0.5)
                    facing = _at_least(cosine + 2 * s * sin_i * (sine * other), 0.0)
                    cos_o = _at_most(_at_least(2 * facing * over - cosine, _LEAST), 1.0)
                    pair[0][at + turn], pair[1][at + turn] = u, _at_most(facing * root, 1.0)
                    pair[2][at + turn], pair[3][at + turn] = cos_i, sin_i
                    pair[4][at + turn], pair[5][at + turn] = cos_o, math.sqrt((1 - cos_o) * (1 + cos_o))
                    work[0][at + turn] = density
                    light[at + turn] = weight * azimuths[1, turn] * cos_o * facing
            _mirrors_of_density(pair, work, 1, tables, mirrors)
            for j in range(light.size):
                light[j] *= mirrors[j]
            if n.size:
                _add_reflected(light, pair[1], n, k, absorbs, parts)
            else:
                _add_moments(light, pair[1], work[0], work[1], work[2], parts)
        for order in range(orders):
            total = 0.0
            for j in range(_SUMMED):
                total += parts[order, j]
            sums[row, order] = total


@compiled
def _add_reflected(light: Array, cosine: Array, n: Array, k: Array, absorbs: bool, parts: Array) -> None:
    """Add light, and light times the reflectance of each index, to sums (1 + index, partial sums)."""
    for start in range(0, light.size, _SUMMED):
        size = min(_SUMMED, light.size - start)
        l_0, c, total = light[start : start + size], cosine[start : start + size], parts[0, :size]
        for j in range(size):
            total[j] += l_0[j]
        for w in range(n.size):
            total = parts[w + 1, :size]
            if absorbs:
                for j in range(size):
                    total[j] += l_0[j] * _absorbing(c[j], n[w], k[w])
            else:
                for j in range(size):
                    total[j] += l_0[j] * _transparent(c[j], n[w])


@compiled
def _add_moments(light: Array, cosine: Array, x: Array, before: Array, last: Array, parts: Array) -> None:
    """Add light times Chebyshev's polynomials of 2c − 1 to sums (orders, partial sums), which the compiler adds up side by side.

    The other arrays are work space.
    """
    for j in range(light.size):
        x[j] = 2 * cosine[j] - 1
        before[j], last[j] = 1.0, x[j]
    for start in range(0, light.size, _SUMMED):
        size = min(_SUMMED, light.size - start)
        l_0, x_0 = light[start : start + size], x[start : start + size]
        t_0, t_1 = before[start : start + size], last[start : start + size]
        for order in range(0, parts.shape[0], 2):
            even, odd = parts[order, :size], parts[order + 1, :size]
            for j in range(size):
                a, b = t_0[j], t_1[j]
                even[j] += l_0[j] * a
                odd[j] += l_0[j] * b
                a = 2 * x_0[j] * b - a
                t_0[j], t_1[j] = a, 2 * x_0[j] * a - b


def sum_over_facets(
    tables: FacetTables,
    theta_i: Array,
    slope: Array,
    slope_weight: Array,
    first: Array,
    azimuths: tuple[Array, Array],
    index: tuple[Array, Array] | None,
    orders: int = 0,
) -> Array:
    """Light that the facets of an isotropic surface reflect as perfect mirrors and of each index, (θ, 1 + index).

    Without an index it is light of perfect mirrors times Chebyshev's polynomials of 2 cos ζ − 1, (θ, orders), the first of which is 1.

    Parameters
    ----------
    tables : of the surface
    theta_i : (θ,) angles of incidence [rad]
    slope, slope_weight : (θ, S) slopes of a quadrature and their weights
    first : (θ, S) azimuth [rad] from which on, to π, a facet mirrors the light upwards
    azimuths : nodes and weights (B,) of a quadrature from 0 to 1 for that range
    index : n and k (index,) with n >= 1 or k > 0
    orders : number of polynomials
    """
    n, k = (np.empty(0), np.empty(0)) if index is None else (np.ascontiguousarray(part, dtype=float) for part in index)
    sums = np.zeros((theta_i.size, 1 + n.size if n.size else orders + orders % 2))
    _sum_over_facets(theta_i, slope, slope_weight, first, np.stack(azimuths), tables, n, k, sums)
    return sums if n.size else sums[:, :orders]


@compiled
def _isotropic_facets(
    theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, tables: FacetTables, visible: Array, density: Array
) -> None:
    space = np.empty((_ROWS, _BLOCK))
    for start in range(0, theta_i.size, _BLOCK):
        block = slice(start, min(start + _BLOCK, theta_i.size))
        rows = _rows(space, block.stop - start)
        pair, work, count = rows[:7], rows[8:], _distinct(theta_i[block], phi_i[block])
        _half_vectors(theta_i[block], phi_i[block], theta_o[block], phi_o[block], pair)
        work[0][:] = 1.0
        _mirrors_of_density(pair, work, count, tables, visible[block])
        _density(pair[0], tables.log_density, density[block])


@compiled
def _lay_facets(
    theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, tables: LayFacetTables, visible: Array, density: Array
) -> None:
    space = np.empty((_ROWS, _BLOCK))
    for start in range(0, theta_i.size, _BLOCK):
        block = slice(start, min(start + _BLOCK, theta_i.size))
        rows = _rows(space, block.stop - start)
        pair, work, count = rows[:7], rows[8:], _distinct(theta_i[block], phi_i[block])
        _half_vectors(theta_i[block], phi_i[block], theta_o[block], phi_o[block], pair)
        _facets_with_lay(phi_i[block], phi_o[block], pair, work, count, tables, rows[7])
        density[block] = work[2]
        work[2][:] = 1.0
        _mirrors(pair, work[2], work[0], work[1], tables.separable, visible[block])


def facets(tables: FacetTables | LayFacetTables, angles: Sequence[Array]) -> tuple[Array, Array]:
    """(1 + s²)² G2 / (4 cos θ_i cos θ_o) and P22 of the facets of slope s that mirror one direction into the other, (directions,) each.

    The product is the BRDF of perfectly mirroring facets [sr-1]; arguments as for :func:`evaluate`, of directions above the horizon.
    """
    one, two, three, four = (_read_only(angle) for angle in angles)
    visible, density = np.empty(one.size), np.empty(one.size)
    if isinstance(tables, FacetTables):
        _isotropic_facets(one, two, three, four, tables, visible, density)
    else:
        _lay_facets(one, two, three, four, tables, visible, density)
    return visible, density


@compiled
def _arcs_of_azimuths(azimuths: Array, wide: float, landen: Array, result: Array) -> None:
    space = np.empty((_ROWS, _BLOCK))
    for start in range(0, azimuths.size, _BLOCK):
        block = slice(start, min(start + _BLOCK, azimuths.size))
        count = _distinct(azimuths[block], azimuths[block])
        rows = _rows(space, block.stop - start)
        _arcs(azimuths[block][:count], wide, landen, rows[:2], result[block])
        _spread(result[block], count)


def arcs(ellipse: Ellipse, azimuth: Array) -> Array:
    """As :func:`~brdfpipe.bsdf.microfacet.anisotropic_quadrature.azimuth_to_arc`, of many azimuths (directions,)."""
    (ratio, wide), result = axis_ratio(ellipse), np.empty(azimuth.size)
    _arcs_of_azimuths(_read_only(azimuth), wide, _landen_steps(ratio), result)
    return result


def further_light(table: FurtherLight, angles: Sequence[Array], width: int) -> Array:
    """BRDF of the light that facets reflect more than once [sr-1], (directions, width); arguments as for :func:`evaluate`."""
    theta_i, phi_i, theta_o, phi_o = (_read_only(angle) for angle in angles)
    result = np.empty((theta_i.size, width))
    _evaluate_further_light(theta_i, phi_i, theta_o, phi_o, table, result)
    return result


@compiled
def _reflectances(cosine: Array, n: Array, k: Array, absorbs: bool, result: Array) -> None:
    for j in range(cosine.size):
        for w in range(n.size):
            result[j, w] = _absorbing(cosine[j], n[w], k[w]) if absorbs else _transparent(cosine[j], n[w])


def reflectances(cosine: Array, n: Array, k: Array) -> Array:
    """Fresnel's reflectance for unpolarised light of bodies with n >= 1 or k > 0, (directions, index), of cosines (directions,)."""
    result = np.empty((cosine.size, n.size))
    cosine, n, k = (np.ascontiguousarray(values, dtype=float) for values in (cosine, n, k))
    _reflectances(cosine, n, k, bool(k.any()), result)
    return result


def half_vectors(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> HalfVector:
    """As :func:`brdfpipe.geometry.half_vector`, of directions above the horizon, (directions,) degree each."""
    rows = tuple(np.empty((7, theta_i.size)))
    _half_vectors(_read_only(theta_i), _read_only(phi_i), _read_only(theta_o), _read_only(phi_o), rows)
    return HalfVector(*rows[:6])


def evaluate(tables: Tables, shading: Shading, angles: Sequence[Array], width: int) -> Array:
    """BRDF [sr-1], (directions, width), 0 unless both directions are above the surface.

    Parameters
    ----------
    angles : θ_i, φ_i, θ_o and φ_o, (directions,) degree each; 0 <= θ <= 180
    width : number of wavelengths
    """
    theta_i, phi_i, theta_o, phi_o = (_read_only(angle) for angle in angles)
    result = np.empty((theta_i.size, width))
    if isinstance(tables, IsotropicTables):
        _evaluate_isotropic(theta_i, phi_i, theta_o, phi_o, tables, shading, result)
    else:
        _evaluate_with_lay(theta_i, phi_i, theta_o, phi_o, tables, shading, result)
    return result


def _read_only(angle: Array) -> Array:
    """A contiguous view that cannot be written, so that there is one type of array to compile for."""
    view = np.ascontiguousarray(angle, dtype=float).view()
    view.flags.writeable = False
    return view
