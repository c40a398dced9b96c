"""The basis functions of a smoothed BSDF.

Directions are ϑ from the mirror direction and φ about it, 0 towards the normal. A basis gives its functions at directions, and rows D with
‖D c‖² the roughness of the sum with coefficients c.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brdfpipe.geometry import Array, unit_vector
from brdfpipe.hemisphere import panel_rule
from brdfpipe.store import canonical_json

if TYPE_CHECKING:
    from scipy.sparse import csr_array

DEGREE = 3
RESOLUTION, TOWARDS_GRAZING = "resolution", "grazing"
"""Components of the uncertainty by what cells do not tell, see :mod:`brdfpipe.bsdf.measured.resolution`: of a lobe's edge, or a lobe narrower than the
cells; and of light that leaves near the horizon."""
GRAZING = (0.05, 0.15)  # scales in cos θ_o of the functions that describe the BSDF towards grazing
GRAZING_HARMONICS = 2  # of φ; of the second, the fit has next to nothing
GRAZING_WIDTH = 30.0  # distance from the mirror direction beyond which these harmonics have their full size [degree]
_GRAZING_RESISTANCE = 1.0, 4.0, 1e4
"""Resistance of cos kφ, k = 0, 1, 2, times a function of cos θ_o against a size above 0. Less of it follows facets better where cells see them towards
grazing, and errs more where none do: what the fit would change without it is an uncertainty, see :mod:`brdfpipe.bsdf.measured.resolution`."""
_LOBE = 12.0  # distance from the mirror direction to which lobes are resolved [degree]
_PLACES = 8  # places in an interval at which splines are compared
_MOST_POINTS = 20_000  # largest number of points over the sphere: 1.4° apart
_AZIMUTHAL = 5.0  # weight of curvature along φ over that along ϑ: lobes vary less around the mirror direction


def has_all_knots(k: int) -> bool:
    """Whether cos kφ has all knots: a lobe stretched along, or across, the plane of incidence needs even k; others have every second knot."""
    return k == 1 or k % 2 == 0


@dataclass(frozen=True)
class PSpline:
    """Tensor product of cubic B-splines in t = asinh(ϑ/scale) and harmonics of φ, and two functions of cos θ_o with a few harmonics.

    Near a lobe t is a length, far from it the logarithm of one: evenly spaced knots fit lobes of any width. Smooth functions of ϑ and φ
    cannot follow the BSDF towards grazing; the functions of cos θ_o do. They have harmonics of φ, because facets brighten grazing light on the
    far side of the normal alone. The radial part of cos kφ starts with ϑ^k (up to the third power) and
    that of k = 0 without slope: so the sum is smooth at ϑ = 0. Roughness is the energy of a thin plate
    ∫ (η_tt² + 2ρ η_tφ²/τ² + ρ² η_φφ²/τ⁴) dt dφ/2π, τ = tanh t, which makes lengths along φ those along t. Only a constant has none.

    Source: Eilers & Marx 1996 (P-splines); Wood 2003 (thin plates).
    """

    name: ClassVar[str] = "pspline"
    edges: tuple[float, ...]  # of the intervals in t, an even number of them
    scale: float = 3.0
    harmonics: int = 4
    symmetric: bool = True  # even about the plane of incidence: without sin kφ
    grazing_harmonics: int = 0  # of the functions of cos θ_o

    @classmethod
    def default(cls, *, symmetric: bool = True) -> PSpline:
        """Knots 0.15 apart to 12° and 0.27 beyond: a Gaussian lobe of any width changes to its base within Δt ≈ 0.2."""
        knee, end = np.arcsinh(_LOBE / cls.scale), np.arcsinh(180 / cls.scale)
        edges = [*np.linspace(0, knee, 15), *np.linspace(knee, end, 11)[1:]]
        return cls(tuple(float(edge) for edge in edges), symmetric=symmetric, grazing_harmonics=GRAZING_HARMONICS)

    @cached_property
    def orders(self) -> NDArray[np.int64]:
        """(harmonics,) k of cos kφ, then without symmetry of sin kφ, in the order of the terms."""
        cosines = np.arange(self.harmonics + 1)
        return cosines if self.symmetric else np.concatenate([cosines, cosines[1:]])

    @cached_property
    def harmonic(self) -> NDArray[np.int64]:
        """(terms,) k of the cos kφ or sin kφ in each function."""
        sizes = [self._radial(k, np.zeros(1)).shape[1] for k in range(self.harmonics + 1)]
        cosines = np.repeat(np.arange(self.harmonics + 1), sizes)
        sines = np.empty(0, dtype=int) if self.symmetric else cosines[cosines > 0]
        return np.concatenate([cosines, sines, np.repeat(self.grazing_orders, len(GRAZING))])

    @cached_property
    def grazing_orders(self) -> NDArray[np.int64]:
        """(grazing harmonics,) k of cos kφ, then without symmetry of sin kφ, of the functions of cos θ_o."""
        cosines = np.arange(self.grazing_harmonics + 1)
        return cosines if self.symmetric else np.concatenate([cosines, cosines[1:]])

    def rows(self, theta: Array, phi: Array, cosine: Array) -> Array:
        """The functions (directions, terms) at ϑ and φ [degree] and cos θ_o of the same directions."""
        t = np.arcsinh(np.asarray(theta) / self.scale)
        splines = {fine: self._splines(fine, t).toarray() for fine in (True, False)}
        blocks = [self._smooth_at_0(k, splines[has_all_knots(k)]) * wave[:, None] for k, wave in self._harmonics(phi)]
        grazing = _grazing(cosine)
        return np.concatenate(
            [*blocks, *(grazing * wave[:, None] for _, wave in self._grazing_waves(theta, phi))], axis=1
        )

    def sums(self, coefficient: Array, theta: Array, phi: Array, cosine: Array, even: Array, odd: Array) -> Array:
        """Sums (directions, any) of the functions with coefficients (terms, any), weighted by ``even`` or ``odd`` (directions,) by k.

        With sparse splines, of which four are not 0 at a direction: several times as fast as with :meth:`rows`.
        """
        t = np.arcsinh(np.asarray(theta) / self.scale)
        splines = {fine: self._splines(fine, t) for fine in (True, False)}
        total = np.zeros((t.size, coefficient.shape[1]))
        grazing, first = _grazing(cosine), coefficient.shape[0] - len(GRAZING) * self.grazing_orders.size
        for number, (k, wave) in enumerate(self._grazing_waves(theta, phi)):
            own = coefficient[first + number * len(GRAZING) :][: len(GRAZING)]
            total += grazing @ own * (wave * (odd if k % 2 else even))[:, None]
        for (k, wave), own in zip(self._harmonics(phi), self.of_all_splines(coefficient), strict=True):
            total += (splines[has_all_knots(k)] @ own) * (wave * (odd if k % 2 else even))[:, None]
        return total

    def of_all_splines(self, coefficient: Array) -> list[Array]:
        """Coefficients (terms, …) of each harmonic, (splines, …), with those of the splines that it leaves out, which are 0."""
        parts, start = [], 0
        for k in self.orders.tolist():
            left_out = min(max(k, 1), DEGREE)
            own = coefficient[start : start + self.knots(has_all_knots(k)).size - DEGREE - 1 - left_out]
            start += len(own)
            # The first two splines of k = 0 are one function.
            before = own[:1] if k == 0 else np.zeros((left_out, *own.shape[1:]))
            parts.append(np.concatenate([before, own]))
        return parts

    @cached_property
    def coarser(self) -> Array:
        """Matrix (terms, fewer) to the coefficients from those of the same functions with every second knot in the lobe, which these contain."""
        from scipy.interpolate import BSpline
        from scipy.linalg import block_diag

        lobe = int(np.searchsorted(self.edges, np.arcsinh(_LOBE / self.scale) + 1e-9))
        edges = np.concatenate([self.edges[:lobe:2], self.edges[lobe:]])
        knots = np.concatenate([edges[:1].repeat(DEGREE), edges, edges[-1:].repeat(DEGREE)])
        t = np.linspace(self.edges[0], self.edges[-1], _PLACES * len(self.edges))
        coarse = BSpline.design_matrix(t, knots, DEGREE).toarray()
        blocks = []
        for k in self.orders.tolist():
            own = self._smooth_at_0(k, self._splines(has_all_knots(k), t).toarray())
            blocks.append(
                np.linalg.lstsq(own, self._smooth_at_0(k, coarse))[0] if has_all_knots(k) else np.eye(own.shape[1])
            )
        return np.asarray(block_diag(*blocks, np.eye(len(GRAZING) * self.grazing_orders.size)))

    def roughness(self, theta: Array, phi: Array, *, resisted: bool = True) -> Array:
        """Rows D (any, terms); the cells at ϑ and φ do not matter to this basis.

        ``resisted`` is whether harmonics of the functions of cos θ_o are resisted more than these functions themselves.
        """
        t, weight = panel_rule(self.edges, 4)
        root, scale = np.sqrt(weight)[:, None], 1 / np.tanh(t)[:, None]
        blocks = []
        for k in range(self.harmonics + 1):
            value, slope, bend = (root * self._radial(k, t, derivative) for derivative in range(3))
            along_phi = np.sqrt(_AZIMUTHAL) * k * scale
            rows = [bend, np.sqrt(2) * along_phi * slope, along_phi**2 * value] if k else [bend]
            blocks.append(np.concatenate(rows) * np.sqrt(0.5 if k else 1.0))
        if not self.symmetric:
            blocks += blocks[1:]
        from scipy.linalg import block_diag

        resistance = (
            np.array(_GRAZING_RESISTANCE)[self.grazing_orders] if resisted else np.ones(self.grazing_orders.size)
        )
        grazing = resistance.repeat(len(GRAZING))
        return np.asarray(block_diag(*blocks, np.diag(grazing)))

    def _harmonics(self, phi: Array) -> Iterator[tuple[int, Array]]:
        """k, and cos kφ or sin kφ, of :attr:`orders`."""
        return _waves(self.orders, self.harmonics, phi)

    def _grazing_waves(self, theta: Array, phi: Array) -> Iterator[tuple[int, Array]]:
        """The same of :attr:`grazing_orders`, which vanish at ϑ = 0 as the k-th power of ϑ."""
        rise = np.asarray(theta) / np.hypot(theta, GRAZING_WIDTH)
        for k, wave in _waves(self.grazing_orders, self.grazing_harmonics, phi):
            yield k, wave * rise**k

    def _radial(self, k: int, t: Array, derivative: int = 0) -> Array:
        return self._smooth_at_0(k, self._splines(has_all_knots(k), t, derivative).toarray())

    def _smooth_at_0(self, k: int, splines: Array) -> Array:
        """The splines whose products with cos kφ are smooth at ϑ = 0."""
        if k:
            return splines[:, min(k, 3) :]
        # The slopes at 0 of the first two cancel.
        return np.concatenate([splines[:, :1] + splines[:, 1:2], splines[:, 2:]], axis=1)

    def knots(self, fine: bool) -> Array:
        """Of the splines, with the ends fourfold."""
        edges = np.asarray(self.edges)[:: 1 if fine else 2]
        return np.concatenate([edges[:1].repeat(DEGREE), edges, edges[-1:].repeat(DEGREE)])

    def _splines(self, fine: bool, t: Array, derivative: int = 0) -> csr_array:
        from scipy.interpolate import BSpline
        from scipy.sparse import csr_array

        knots = self.knots(fine)
        inside = np.minimum(t, knots[-1])
        if derivative == 0:
            return BSpline.design_matrix(inside, knots, DEGREE)
        return csr_array(BSpline(knots, np.eye(knots.size - DEGREE - 1), DEGREE)(inside, derivative))


@dataclass(frozen=True)
class Keldysh:
    """The basis of Voloboy et al. 2005 (Keldysh Institute preprint), p_n(2^j ϑ/ϑ_max) cos kφ, repaired or as printed.

    p_n(x) = (1 + n/4)² (1 + 4/n)^{n/2} (1 − x²)² xⁿ on |x| ≤ 1 has its maximum 1 at x = √(n/(n + 4)). As printed, every function vanishes at
    90°, and n = 0 occurs with every cos kφ, which is ambiguous at ϑ = 0. Repaired: an additional constant, ϑ_max as a parameter, and
    n ≥ k with n − k even, the powers of smooth functions of the plane.
    """

    name: ClassVar[str] = "keldysh"
    domain: float = 90.0  # ϑ_max [degree], where all but the constant vanish
    scales: int = 3
    orders: int = 5
    harmonics: int = 4
    symmetric: bool = True
    printed: bool = False

    @cached_property
    def terms(self) -> NDArray[np.int64]:
        """(terms, 4): scale j, order n, harmonic k and whether it is a sine; j = −1 is the constant."""
        terms = [] if self.printed else [(-1, 0, 0, 0)]
        for j, n, k in itertools.product(range(self.scales), range(self.orders), range(self.harmonics + 1)):
            if self.printed or (n >= k and (n - k) % 2 == 0):
                terms += [(j, n, k, sine) for sine in ((0, 1) if k and not self.symmetric else (0,))]
        return np.array(terms)

    @property
    def harmonic(self) -> NDArray[np.int64]:
        return self.terms[:, 2]

    def rows(self, theta: Array, phi: Array, cosine: Array) -> Array:
        return self._radial(theta)[0] * self._azimuthal(phi)[0]

    def sums(self, coefficient: Array, theta: Array, phi: Array, cosine: Array, even: Array, odd: Array) -> Array:
        """See :meth:`PSpline.sums`."""
        weight = np.where(self.harmonic % 2, odd[:, None], even[:, None])
        return (self.rows(theta, phi, cosine) * weight) @ coefficient

    def roughness(self, theta: Array, phi: Array, *, resisted: bool = True) -> Array:
        """√Ω ∇F on the cells, Ω their Voronoi solid angles: ∇ = e_ϑ ∂_ϑ + e_φ (1/sin ϑ) ∂_φ, per radian."""
        value, slope = self._radial(theta)
        wave, wave_slope = self._azimuthal(phi)
        across = value / np.maximum(np.sin(np.radians(theta)), 1e-6)[:, None]
        at_zero = np.asarray(theta)[:, None] < 1e-6
        # At ϑ = 0, p_n(ϑ)/sin ϑ is the slope; only functions of the printed basis do not vanish there.
        across = np.where(at_zero & (value == 0), slope, across)
        root = np.sqrt(solid_angles(theta, phi))[:, None]
        return np.concatenate([root * slope * wave, root * across * wave_slope])

    def _radial(self, theta: Array) -> tuple[Array, Array]:
        """Radial parts (directions, terms) and their derivatives per radian."""
        radial, which = np.unique(self.terms[:, :2], axis=0, return_inverse=True)  # each occurs with several cos kφ
        j, n = radial.T
        stretch = np.where(j < 0, 0.0, 2.0**j / self.domain)
        x = np.asarray(theta, dtype=float)[:, None] * stretch
        inside = np.maximum(1 - x * x, 0.0)
        power, lower = x**n, n * x ** np.maximum(n - 1, 0)
        peak = _peak(n)
        slope = peak * (lower * inside**2 - 4 * x * power * inside) * np.degrees(stretch)
        return (peak * power * inside**2)[:, which.ravel()], slope[:, which.ravel()]

    def _azimuthal(self, phi: Array) -> tuple[Array, Array]:
        """cos kφ or sin kφ (directions, terms), and their derivatives per radian."""
        azimuthal, which = np.unique(self.terms[:, 2:], axis=0, return_inverse=True)
        k, sine = azimuthal.T
        angle = np.radians(np.asarray(phi, dtype=float))[:, None] * k - np.where(sine, np.pi / 2, 0.0)
        return np.cos(angle)[:, which.ravel()], (-k * np.sin(angle))[:, which.ravel()]


def _waves(orders: NDArray[np.int64], cosines: int, phi: Array) -> Iterator[tuple[int, Array]]:
    """k, and cos kφ, or sin kφ behind the constant and as many ``cosines``."""
    azimuth = np.radians(phi)
    for number, k in enumerate(orders.tolist()):
        yield k, np.cos(k * azimuth) if number <= cosines else np.sin(k * azimuth)


def _grazing(cosine: Array) -> Array:
    return np.exp(-np.maximum(cosine, 0.0)[:, None] / np.array(GRAZING))


Basis: TypeAlias = PSpline | Keldysh


def polynomial(n: int, x: Array) -> Array:
    """p_n(x) of the preprint on |x| ≤ 1, 0 beyond."""
    return np.asarray(_peak(np.array(n)) * np.maximum(1 - x * x, 0.0) ** 2 * x**n)


def _peak(n: Array | NDArray[np.int64]) -> Array:
    return np.asarray((1 + n / 4) ** 2 * (1 + 4 / np.maximum(n, 1)) ** (n / 2))


def to_json(basis: Basis) -> str:
    """A basis as an attribute of a dataset."""
    return canonical_json({"name": basis.name, **asdict(basis)})


@cache
def from_json(text: str) -> Basis:
    """The basis of such an attribute."""
    fields = json.loads(text)
    if fields.pop("name") == Keldysh.name:
        return Keldysh(**fields)
    return PSpline(**{**fields, "edges": tuple(fields["edges"])})


def solid_angles(theta: Array, phi: Array) -> Array:
    """Voronoi solid angles [sr] of directions (n,) [degree]: of all directions nearer to one than to any other.

    Where there are no cells, points all over the sphere bound the outermost cells as neighbours at their own distance would. Cells of equal
    direction share one solid angle.
    """
    from scipy.spatial import SphericalVoronoi, cKDTree

    # Adding 0 makes one of the two zeros that floating-point numbers have.
    points, index = np.unique(np.round(unit_vector(theta, phi), 7) + 0.0, axis=0, return_inverse=True)
    index = index.ravel()
    if not points.size:
        return np.empty(0)
    tree = cKDTree(points)
    nearest = np.asarray(tree.query(points, k=[2])[0])[:, 0] if len(points) > 1 else np.full(1, np.inf)
    spacing = np.clip(nearest, *np.radians([0.1, 10.0]))
    sphere = _fibonacci_sphere(int(np.clip(4 * np.pi / np.median(spacing) ** 2, 400, _MOST_POINTS)))
    distance, closest = tree.query(sphere)
    filled = np.concatenate([points, sphere[distance > 1.5 * np.maximum(spacing[closest], np.median(spacing))]])
    filled /= np.linalg.norm(filled, axis=1, keepdims=True)
    areas = np.asarray(SphericalVoronoi(filled, threshold=1e-8).calculate_areas(), dtype=float)
    return (areas[: len(points)] / np.bincount(index))[index]


def _fibonacci_sphere(count: int) -> Array:
    """Even points over the sphere, (count, 3)."""
    z = 1 - (2 * np.arange(count) + 1) / count
    azimuth = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)
