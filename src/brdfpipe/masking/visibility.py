"""Masking G1 and masking-shadowing G2 of a facet distribution, by mode.

References
----------
Heitz 2014 (JCGT 3(2)), eqs. 72 and 99; Blinn 1977; patent US 9,395,299, claim 2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import vocabulary
from brdfpipe.content_cache import cached_by_content
from brdfpipe.errors import VocabularyError
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array, HalfVector, broadcast, check_angles, checked_angles, half_vector
from brdfpipe.masking import liu
from brdfpipe.masking.smith import PlanarSmith, Smith, cotangent

_BELOW_GRAZING = 90 - 1e-9  # largest angle of a pair of directions [degree]


def g1(facets: xr.Dataset, theta: ArrayLike, phi: ArrayLike = 0.0) -> xr.DataArray:
    """Smith masking of a facet distribution: the visible fraction of facets that face a direction.

    Parameters
    ----------
    facets : kind ``facets``; its mean slope is zero
    theta, phi : degree, broadcastable; 0 <= theta <= 90

    Returns
    -------
    DataArray [1], in [0, 1], named ``g1``; plain angles give the dimension ``direction``

    Raises
    ------
    VocabularyError : the dataset is not of kind ``facets``, or an angle is out of range.

    Notes
    -----
    G1 = 1 / (1 + Λ), Λ(θ) = E[(p̃ − cot θ)⁺] / cot θ. Exact for the tabulated density; no Gaussian assumption.

    References
    ----------
    Heitz 2014, eq. 72; Ashikhmin 2000; patent US 9,395,299, claim 2.
    """
    vocabulary.validate(facets, "facets")
    polar, azimuth = broadcast(theta=checked_angles("theta", theta, 0, 90), phi=checked_angles("phi", phi, -720, 720))
    cos, sin, excess = _excess_towards(facets, polar.values, azimuth.values)
    result = polar.copy(data=cos / (cos + excess * sin))
    return result.rename("g1").assign_attrs(units="1", long_name="Smith masking G1")


def g2(
    facets: xr.Dataset,
    theta_i: ArrayLike,
    phi_i: ArrayLike,
    theta_o: ArrayLike,
    phi_o: ArrayLike,
    mode: str = "height-correlated",
) -> xr.DataArray:
    """Masking and shadowing: the fraction of facets visible from both directions.

    Parameters
    ----------
    facets : kind ``facets``; its mean slope is zero
    theta_i, phi_i, theta_o, phi_o : degree, broadcastable; 0 <= θ < 90
    mode : a key of :data:`VISIBILITY`, or ``liu`` (:mod:`brdfpipe.masking.liu`)

    Returns
    -------
    DataArray [1], in [0, 1], named ``g2``

    Raises
    ------
    VocabularyError : the dataset is not of kind ``facets``, an angle is out of range, or the mode is unknown.
    """
    vocabulary.validate(facets, "facets")
    if mode not in (*VISIBILITY, "liu"):
        raise VocabularyError(f"unknown masking mode {mode!r}; accepted: {', '.join(VISIBILITY)}, liu")
    angles = broadcast(
        theta_i=checked_angles("theta_i", theta_i, 0, _BELOW_GRAZING),
        phi_i=checked_angles("phi_i", phi_i, -720, 720),
        theta_o=checked_angles("theta_o", theta_o, 0, _BELOW_GRAZING),
        phi_o=checked_angles("phi_o", phi_o, -720, 720),
    )
    theta_i, phi_i, theta_o, phi_o = (angle.values for angle in angles)
    pair = half_vector(theta_i, phi_i, theta_o, phi_o)
    if mode == "liu":
        if facets["slope_density"].ndim == 2:
            raise VocabularyError(
                "masking mode 'liu' is for isotropic surfaces; this one has a lay. Choose another `model.masking`"
            )
        table = liu.LiuMasking.of(liu.Marginal.of(RadialDensity.of(facets)))
        values = liu.attenuation(pair, phi_i, phi_o, table)
    else:
        excess_i, excess_o = (_excess_towards(facets, *towards)[2] for towards in ((theta_i, phi_i), (theta_o, phi_o)))
        values = np.minimum(VISIBILITY[mode](pair, excess_i, excess_o) * (pair.cos_i * pair.cos_o), 1.0)
    result = angles[0].copy(data=np.broadcast_to(values, theta_i.shape))
    return result.rename("g2").assign_attrs(units="1", long_name=f"masking and shadowing G2, {mode}")


def g1_along(slopes: ArrayLike, theta: ArrayLike) -> Array:
    """Smith masking from the slopes along a line, without a fitted density.

    Parameters
    ----------
    slopes : (n,) slopes towards the viewer [1], of mean zero; missing ones are left out
    theta : (m,) degree, 0 to 90

    Returns
    -------
    (m,) G1 in [0, 1]

    Raises
    ------
    VocabularyError : no finite slope, a mean that is not zero, or an angle is out of range.

    Notes
    -----
    One sort and its cumulative sums give E[(p − μ)⁺] for every angle at once.
    """
    p = np.sort(np.asarray(slopes, dtype=float).ravel())
    p = p[np.isfinite(p)]
    if p.size == 0 or abs(p.mean()) > 1e-6 * max(float(np.abs(p).max()), 1e-300):
        raise VocabularyError(
            f"masking needs slopes of mean zero; found {p.size} slopes of mean {p.mean() if p.size else np.nan:g}. Level the surface first"
        )
    angles = np.radians(np.atleast_1d(check_angles("theta", theta, 0, 90)))
    cos, sin = np.where(angles >= np.pi / 2, 0.0, np.cos(angles)), np.sin(angles)
    mu = cotangent(cos, sin)
    beyond = np.concatenate([np.cumsum(p[::-1])[::-1], [0.0]])
    first = np.searchsorted(p, mu)
    count = p.size - first
    excess = np.where(count > 0, (beyond[first] - np.where(count > 0, mu, 0.0) * count) / p.size, 0.0)
    return np.divide(cos, cos + excess * sin, out=np.zeros_like(cos), where=cos > 0)


def _excess_towards(facets: xr.Dataset, theta: Array, phi: Array) -> tuple[Array, Array, Array]:
    """cos θ, sin θ and the mean excess slope towards directions in degree."""
    angles = np.radians(theta)
    cos, sin = np.where(theta >= 90, 0.0, np.cos(angles)), np.sin(angles)
    smith = PlanarSmith.of(facets) if "phi" in facets["lambda_smith"].dims else Smith.of(facets)
    return cos, sin, smith.excess(cotangent(cos, sin), phi)


Visibility = Callable[[HalfVector, Array, Array], Array]


def _height_correlated(pair: HalfVector, excess_i: Array, excess_o: Array) -> Array:
    cos_i, cos_o = pair.cos_i, pair.cos_o
    return 1 / (cos_i * cos_o + (excess_i * pair.sin_i * cos_o + excess_o * pair.sin_o * cos_i))


def _blinn(pair: HalfVector, excess_i: Array, excess_o: Array) -> Array:
    grooved = 2 * pair.cos_alpha / (pair.cos_zeta * np.maximum(pair.cos_i, pair.cos_o))
    return np.minimum(1 / (pair.cos_i * pair.cos_o), grooved)


@dataclass(frozen=True)
class VisibilityRatio:
    """Visibility of a map's facets over Smith's height-correlated one, from a table.

    Its coordinates are the same for exchanged directions, so the result is reciprocal. With the width w of the slope density (its median),
    the slope s of the facet and the angle ζ between its normal and the directions:

    - grazing = 1 / (1 + cot ζ / w), from 0 at ζ = 0 to 1 at ζ = 90 degree
    - steepness = asinh(s / w)
    - asymmetry = δ / min(1, s tan ζ), δ = |cos θ_i − cos θ_o| / (cos θ_i + cos θ_o): 1 for directions as different as the
      horizon, or the facet's slope, allows

    The logarithm of the ratio is interpolated with cubic splines to a finer table, linearly in that, and held beyond the last nodes. A
    ``limit`` over the cosine of either direction keeps perfect mirrors from reflecting more than they receive.
    """

    log_ratio: Array
    """Logarithm of the ratio at the nodes of the finer table, evenly spaced from 0: over grazing, steepness and asymmetry"""
    last: tuple[float, float]
    """Grazing and steepness at the last nodes; the asymmetry ends at 1"""
    limit_cos: Array
    """Increasing cosines of a direction"""
    limit: Array
    """Factor of a direction at these cosines"""

    @classmethod
    def of(cls, dataset: xr.Dataset) -> VisibilityRatio:
        """The ratio of a ``visibility`` dataset, or of a ``bsdf`` with masking ``measured``."""
        ratio = dataset["visibility_ratio"].transpose("grazing", "steepness", "asymmetry").values
        limit_cos, limit = np.array([0.0, 1.0]), np.ones(2)
        if "visibility_limit" in dataset:
            limit_cos = np.cos(np.radians(dataset["limit_theta"].values[::-1].astype(float)))
            limit = dataset["visibility_limit"].values[::-1].astype(float)
        last = float(dataset["grazing"][-1]), float(dataset["steepness"][-1])
        return cls(_finer_log(ratio), last, limit_cos, limit)

    def __call__(self, pair: HalfVector, width: float) -> Array:
        """Ratio of G2 to Smith's at directions above the horizon; ``width`` is the median slope of the facets."""
        from scipy.ndimage import map_coordinates

        slope, cos_zeta = np.sqrt(pair.slope_squared), pair.cos_zeta
        sin_zeta = np.sqrt(np.maximum((1 - cos_zeta) * (1 + cos_zeta), 0.0))
        total, difference = pair.cos_i + pair.cos_o, np.abs(pair.cos_i - pair.cos_o)
        reach = np.minimum(slope * sin_zeta, cos_zeta) * total
        asymmetry = np.divide(difference * cos_zeta, reach, out=np.zeros(np.shape(reach)), where=reach > 0)
        shares = [
            np.minimum(width * sin_zeta / (width * sin_zeta + cos_zeta), self.last[0]) / self.last[0],
            np.minimum(np.arcsinh(slope / width), self.last[1]) / self.last[1],
            np.minimum(asymmetry, 1.0),
        ]
        places = [share * (size - 1) for share, size in zip(shares, self.log_ratio.shape, strict=True)]
        at = np.stack(np.broadcast_arrays(*places))
        log_ratio = map_coordinates(self.log_ratio, at.reshape(3, -1), order=1, mode="nearest", prefilter=False)
        return np.asarray(np.exp(log_ratio.reshape(at.shape[1:])))

    def visibility(self, pair: HalfVector, excess_i: Array, excess_o: Array, width: float) -> Array:
        """G2 / (cos θ_i cos θ_o), with G2 up to 1; finite as long as one of the directions is above the horizon."""
        visible = _height_correlated(pair, excess_i, excess_o) * self(pair, width)
        with np.errstate(divide="ignore"):
            visible = np.minimum(visible, 1 / (pair.cos_i * pair.cos_o))
        limit_i, limit_o = (np.interp(cos, self.limit_cos, self.limit) for cos in (pair.cos_i, pair.cos_o))
        return np.asarray(visible * (limit_i * limit_o))


_FINER = 4  # nodes of the finer table per node


@cached_by_content(4)
def _finer_log(ratio: Array) -> Array:
    """The logarithm of a table, interpolated with cubic splines to a finer one."""
    from scipy.ndimage import zoom

    table = np.log(ratio.astype(float))
    return np.asarray(zoom(table, [(_FINER * (size - 1) + 1) / size for size in table.shape], order=3, mode="mirror"))


@dataclass(frozen=True)
class SingleVisibility:
    """Facets visible from one direction, over Smith's G1 = 1/(1 + Λ), from a table.

    With the width w of the slope density, a direction at θ, and the slope t by which the facet falls towards it, the table is one over
    grazing = 1 / (1 + cot θ / w) and asinh(t / w). It is interpolated linearly, and held beyond its last nodes. A facet is on the far side
    where cot θ + t < 0: no light reaches it, whatever the table says.
    """

    grazing: Array
    """Nodes, increasing from 0"""
    steepness: Array
    """Nodes of asinh(t / w), increasing"""
    ratio: Array
    """(grazing, steepness)"""

    @classmethod
    def of(cls, dataset: xr.Dataset) -> SingleVisibility:
        """The ratio of a ``visibility`` dataset, or of a ``bsdf`` with masking ``measured``."""
        ratio = dataset["single_ratio"].transpose("grazing", "steepness_towards")
        return cls(dataset["grazing"].values, dataset["steepness_towards"].values, ratio.values)

    def __call__(self, cot_theta: ArrayLike, slope_towards: ArrayLike, width: float) -> Array:
        """Ratio of G1 to Smith's; ``cot_theta`` ≥ 0 and ``slope_towards`` broadcast, ``width`` is the median slope of the facets."""
        from scipy.interpolate import RegularGridInterpolator

        grazing = np.minimum(width / (width + np.asarray(cot_theta, dtype=float)), self.grazing[-1])
        steepness = np.arcsinh(np.asarray(slope_towards, dtype=float) / width)
        steepness = np.clip(steepness, self.steepness[0], self.steepness[-1])
        table = RegularGridInterpolator((self.grazing, self.steepness), self.ratio)
        return np.asarray(table(np.stack(np.broadcast_arrays(grazing, steepness), axis=-1)))


VISIBILITY: dict[str, Visibility] = {
    "height-correlated": _height_correlated,
    "separable": lambda pair, g_i, g_o: 1 / ((pair.cos_i + g_i * pair.sin_i) * (pair.cos_o + g_o * pair.sin_o)),
    "crf": lambda pair, g_i, g_o: 1 / (pair.cos_i * (pair.cos_o + g_o * pair.sin_o)),
    "blinn": _blinn,
    "none": lambda pair, g_i, g_o: 1 / (pair.cos_i * pair.cos_o),
}
"""G2 / (cos θ_i cos θ_o) by mode, from the pair of directions and the mean excess slopes g = Λ cot θ towards them.

``height-correlated``: 1/(1 + Λ_i + Λ_o), Heitz 2014 eq. 99, the default · ``separable``: G1(i) G1(o) · ``crf``: G1(o) alone, the
patent's, which is neither reciprocal nor keeps energy · ``blinn``: V-grooves, min(1, 2 cos α cos θ / cos ζ), Blinn 1977 ·
``none``: 1. The first two are finite as long as one of the directions is above the horizon.
"""
