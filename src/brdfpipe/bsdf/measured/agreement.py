"""How well measured directions agree: the two sides of the plane of incidence, and the two directions of light of a pair."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from brdfpipe.bsdf.measured import basis as bases

_ASYMMETRIC = 5.0
"""Standard deviations by which the means of two sides differ significantly."""


def asymmetry(smoothed: xr.Dataset) -> float:
    """Difference of the mean residuals of the two sides of the plane of incidence [standard uncertainties].

    ``smoothed`` is of one incidence and one wavelength. 0 where the difference is not significant, and for a fit that does not assume
    symmetry.
    """
    residual, across = smoothed["residual"].values, np.sin(np.radians(smoothed["phi_s"].values))
    sides = [residual[np.isfinite(residual) & side] for side in (across > 0.1, across < -0.1)]
    if min(side.size for side in sides) < 2 or not bases.from_json(smoothed.attrs["basis"]).symmetric:
        return 0.0
    difference = abs(float(sides[0].mean() - sides[1].mean()))
    return difference if difference > _ASYMMETRIC * float(np.sqrt(sum(1 / side.size for side in sides))) else 0.0


def uncertainty_enlargement(bsdf: xr.Dataset, smoothed: xr.Dataset) -> dict[float, float]:
    """Factor by which the completion enlarged the uncertainty of each measured incidence [degree], as it contradicts the others.

    ``smoothed`` is the reflection from which the BSDF (representation ``rig``) was completed.
    """
    nodes = bsdf.isel(node=bsdf["transmitted"].values == 0)
    factors = {}
    for node, incidence in enumerate(nodes["incidence"].values.tolist()):
        for smoothed_factor in smoothed["coefficient_factor"].values[smoothed["incidence"].values == incidence]:
            known = np.isfinite(smoothed_factor).all(axis=(1, 2))
            completed, fitted = (
                np.linalg.norm(part[known]) for part in (nodes["coefficient_factor"].values[node], smoothed_factor)
            )
            # The entrance, which hides cells at normal incidence, makes the ratio smaller than 1.
            factors[incidence] = max(float(completed / fitted), 1.0) if known.any() else 1.0
    return factors


def pair_differences(pairs: xr.Dataset, enlarged: Mapping[float, float]) -> xr.Dataset:
    """Relative differences of pairs of incidences, medians over wavelength.

    Parameters
    ----------
    pairs : of :func:`brdfpipe.bsdf.measured.reciprocity.reciprocity`
    enlarged : of :func:`uncertainty_enlargement`; uncertainties of single directions are taken before it

    Returns
    -------
    Dataset of (pair, phi_o) [1]: ``difference`` f(i → o) / f(o → i) − 1; ``change_of_forward`` and ``change_of_backward``, BSDF / f(i → o) − 1
        and BSDF / f(o → i) − 1; ``difference_u`` and ``change_u``, their uncertainties; ``score``, f(i → o) − f(o → i) over its uncertainty
    """
    forward, backward, averaged = (pairs[name].where(pairs[name] > 0) for name in ("forward", "backward", "averaged"))
    forward_u, backward_u = (
        pairs[name] / xr.DataArray([enlarged.get(angle, 1.0) for angle in pairs[end].values.tolist()], dims="pair")
        for name, end in (("forward_u", "incidence"), ("backward_u", "incidence_2"))
    )
    differences = {
        "difference": forward / backward - 1,
        "difference_u": np.hypot(forward_u / forward, backward_u / backward),
        "change_of_forward": averaged / forward - 1,
        "change_of_backward": averaged / backward - 1,
        "change_u": pairs["averaged_u"] / averaged,
        "score": (forward - backward) / np.hypot(forward_u, backward_u),
    }
    return xr.Dataset(differences).median(str(pairs["forward"].dims[2]))
