"""Masking G₁ and shadowing G₂ against the angle: after Smith, and by ray casting over the heights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from brdfpipe.facets.analytic_distributions import equivalent_densities
from brdfpipe.masking.analytic_smith import beckmann_lambda, ggx_lambda
from brdfpipe.masking.smith import PlanarSmith
from brdfpipe.report.formatting import EXPANDED_UNCERTAINTY
from brdfpipe.report.plots.slope_density import equivalent_label
from brdfpipe.report.plots.svg import Array, Axis, Figure, Line, Mark, Pattern, Points, chart, legend

_SMITH_G2: Sequence[tuple[str, str, str, Pattern]] = (
    ("g2_height_correlated", "c0", "Smith, height-correlated", "line"),
    ("g2_separable", "c3", "Smith, separable", "dash"),
)
_CAST = f"rays cast over the heights, {EXPANDED_UNCERTAINTY}"


def smith_masking(facets: xr.Dataset) -> Figure:
    """Smith's G1 of an isotropic facet distribution, beside a Beckmann and a GGX."""
    theta, lambda_smith = facets["theta"].values.astype(float), facets["lambda_smith"].values.astype(float)
    fine, (beckmann, ggx) = np.linspace(0.5, 89.9, 180), equivalent_densities(facets)
    marks = [
        _g1_line(theta, lambda_smith, "c0", "facets"),
        Line(fine, 1 / (1 + beckmann_lambda(fine, beckmann.widths[0])), "ref", equivalent_label(beckmann), "dash"),
        Line(fine, 1 / (1 + ggx_lambda(fine, ggx.widths[0])), "ref", equivalent_label(ggx), "dots"),
    ]
    return _figure("Masking G₁(θ)", "G₁", marks, "1 / (1 + Λ), Smith.")


def smith_masking_with_lay(facets: xr.Dataset, lay: float) -> Figure:
    """Smith's G1 along the lay and across it."""
    theta, smith = facets["theta"].values.astype(float), PlanarSmith.of(facets)
    mu, opposite = 1 / np.tan(np.radians(theta)), np.array([[0.0], [180.0]])
    marks = [
        _g1_line(theta, smith.excess(mu, lay + turn + opposite).mean(axis=0) / mu, style, f"{name} the lay")
        for turn, style, name in ((0, "c0", "along"), (90, "c2", "across"))
    ]
    note = "1 / (1 + Λ), Smith; Λ is the mean of the two opposite directions."
    return _figure("Masking G₁(θ)", "G₁", marks, note)


def raycast_figure(comparison: xr.Dataset, facets: xr.Dataset | None = None) -> Figure:
    """G1 by ray casting over the heights against Smith's G1 of the facet distribution.

    ``comparison`` is of kind ``masking``; ``facets``, of kind ``facets``, have a finer Smith curve than the comparison.
    """
    theta, g1 = comparison["theta"].values.astype(float), comparison["g1_raycast"].values
    marks: list[Mark] = [
        Line(*_smith_curve(comparison, facets), "c0", "Smith, of the facet distribution"),
        Points(theta, g1, 2 * raycast_uncertainty(comparison), "c2", _CAST),
    ]
    note = "Mean over the azimuths. They agree where the facet distribution represents the surface."
    return _figure("Masking G₁(θ) against ray casting", "G₁", marks, note)


def bistatic_figure(comparison: xr.Dataset) -> Figure | None:
    """G2 of the mirror direction by ray casting against Smith's two forms; None where it was not cast."""
    if "g2_raycast" not in comparison:
        return None
    theta, cast = comparison["theta"].values.astype(float), comparison["g2_raycast"].values.astype(float)
    known = np.isfinite(cast)  # no facet may face both directions at grazing
    marks: list[Mark] = [
        Line(theta, comparison[name].values.astype(float), style, label, pattern)
        for name, style, label, pattern in _SMITH_G2
        if name in comparison
    ]
    u = raycast_uncertainty(comparison, "g2_raycast_u")
    marks.append(Points(theta[known], cast[known], 2 * u[known], "c2", _CAST))
    note = (
        "Incidence θ, view −θ, both in one plane; mean over the azimuths, Smith with the slopes of the lines cast. "
        "This tests Smith's assumption; the agreement of G₁ does not."
    )
    return _figure("Masking and shadowing G₂(θ, −θ)", "G₂", marks, note)


def _smith_curve(comparison: xr.Dataset, facets: xr.Dataset | None) -> tuple[Array, Array]:
    """Smith's G1 of the comparison; the finer curve of the facets where it is the same."""
    theta, compared = comparison["theta"].values.astype(float), comparison["g1_smith"].values.astype(float)
    if facets is None or "lambda_smith" not in facets or facets["lambda_smith"].dims != ("theta",):
        return theta, compared
    fine = np.r_[0.0, facets["theta"].values.astype(float)]
    g1 = np.r_[1.0, 1 / (1 + facets["lambda_smith"].values.astype(float))]
    return (fine, g1) if np.allclose(np.interp(theta, fine, g1), compared, atol=2e-3) else (theta, compared)


def raycast_uncertainty(comparison: xr.Dataset, name: str = "g1_raycast_u") -> Array:
    """Standard uncertainty of G1, or G2, by ray casting; NaN where it is not known."""
    return comparison[name].values.astype(float) if name in comparison else np.full(comparison.sizes["theta"], np.nan)


def _g1_line(theta: Array, lambda_smith: Array, style: str, label: str) -> Line:
    return Line(np.r_[0.0, theta], np.r_[1.0, 1 / (1 + lambda_smith)], style, label)


def _figure(title: str, name: str, marks: Sequence[Mark], note: str) -> Figure:
    svg = chart(
        f"Masking {name} against the polar angle",
        Axis("angle from the normal θ, degree", 0.0, 90.0, step=15),
        Axis(f"{name}, visible fraction of the facets", 0.0, 1.02, step=0.2),
        marks,
    )
    return Figure(title, svg, legend(marks), note)
