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
from brdfpipe.report.plots.svg import Array, Axis, Figure, Line, Mark, Points, chart, legend

_CAST = f"rays cast over the heights, {EXPANDED_UNCERTAINTY}"


_SEE = "Where it falls below 1, neighbours hide facets, and the lobe loses light."


def smith_masking(facets: xr.Dataset) -> Figure:
    """Smith's G1 of an isotropic facet distribution, beside a Beckmann and a GGX."""
    theta, lambda_smith = facets["theta"].values.astype(float), facets["lambda_smith"].values.astype(float)
    fine, (beckmann, ggx) = np.linspace(0.5, 89.9, 180), equivalent_densities(facets)
    marks = [
        _g1_line(theta, lambda_smith, "c0", "facets"),
        Line(fine, 1 / (1 + beckmann_lambda(fine, beckmann.widths[0])), "ref", equivalent_label(beckmann), "dash"),
        Line(fine, 1 / (1 + ggx_lambda(fine, ggx.widths[0])), "ref", equivalent_label(ggx), "dots"),
    ]
    return _figure("Masking G₁(θ)", "G₁, visible share of the facets", marks, f"1 / (1 + Λ), Smith. {_SEE}")


def smith_masking_with_lay(facets: xr.Dataset, lay: float) -> Figure:
    """Smith's G1 along the lay and across it."""
    theta, smith = facets["theta"].values.astype(float), PlanarSmith.of(facets)
    mu, opposite = 1 / np.tan(np.radians(theta)), np.array([[0.0], [180.0]])
    marks = [
        _g1_line(theta, smith.excess(mu, lay + turn + opposite).mean(axis=0) / mu, style, f"{name} the lay")
        for turn, style, name in ((0, "c0", "along"), (90, "c2", "across"))
    ]
    note = "1 / (1 + Λ), Smith; Λ is the mean of the two opposite directions. " + _SEE
    return _figure("Masking G₁(θ)", "G₁, visible share of the facets", marks, note)


def bistatic_figure(comparison: xr.Dataset) -> Figure | None:
    """G2 of the mirror direction by ray casting against Smith's, of a dataset of kind ``model_error``; None where no line was cast."""
    theta, cast = comparison["theta_i"].values.astype(float), comparison["g2_raycast"].values.astype(float)
    known = np.isfinite(cast)  # no facet may face both directions at grazing
    if not known.any():
        return None
    u = comparison["g2_raycast_u"].values.astype(float)
    marks: list[Mark] = [
        Line(theta, comparison["g2_height_correlated"].values.astype(float), "c0", "Smith, height-correlated", "line"),
        Points(theta[known], cast[known], 2 * u[known], "c2", _CAST),
    ]
    note = (
        "Incidence θ, view −θ, both in one plane; mean over the axes of the scan, Smith with the slopes of the lines cast. "
        "It tests Smith's assumption that slopes alone decide what is hidden."
    )
    return _figure("Masking and shadowing G₂(θ, −θ)", "G₂, share of the facets that both directions see", marks, note)


def visibility_figure(visibility: xr.Dataset) -> Figure | None:
    """Visible shares of the light that facets reflect, traced on the heights and after Smith; None where nothing was traced."""
    if "visible_share" not in visibility:
        return None
    theta = visibility["theta_i"].values.astype(float)
    marks: list[Mark] = []
    for region, style, name in (("peak", "c0", "in the peak"), ("all", "c2", "all")):
        shares = visibility.sel(region=region)
        traced, u = (shares[name].values.astype(float) for name in ("visible_share", "visible_share_u"))
        marks += [
            Line(theta, shares["smith_visible_share"].values.astype(float), style, f"Smith, {name}"),
            Points(theta, traced, 2 * u, style, f"{visibility.attrs['method']}, {name}, {EXPANDED_UNCERTAINTY}"),
        ]
    note = (
        "Light that facets reflect once from the angle of incidence θ, and that no other facet intercepts on its way in or out, over all light "
        f"that they would reflect. {str(visibility.attrs['reason'])[:1].upper()}{str(visibility.attrs['reason'])[1:]}: "
        f"masking {visibility.attrs['masking']}."
    )
    return _figure(
        "Visible light of the facets, on the heights and after Smith",
        "visible share of the light reflected by facets",
        marks,
        note,
    )


def _g1_line(theta: Array, lambda_smith: Array, style: str, label: str) -> Line:
    return Line(np.r_[0.0, theta], np.r_[1.0, 1 / (1 + lambda_smith)], style, label)


def _figure(title: str, quantity: str, marks: Sequence[Mark], note: str) -> Figure:
    svg = chart(
        f"{title} against the polar angle",
        Axis("angle from the normal θ, degree", 0.0, 90.0, step=15),
        Axis(quantity, 0.0, 1.02, step=0.2),
        marks,
    )
    return Figure(title, svg, legend(marks), note)
