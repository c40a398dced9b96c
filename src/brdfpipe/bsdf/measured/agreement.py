"""How well measured directions agree: the two sides of the plane of incidence, and the two directions of light of a pair."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from brdfpipe.bsdf.measured import basis as bases

_ASYMMETRIC = 5.0
"""Standard deviations by which the means of two sides differ significantly."""

_FEWEST_CELLS = 10  # cells from which a dependence on azimuth can be distinguished from noise
_COMMON_SHARE = 0.5  # share of the wavelengths at which a surface with a lay must show it


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


def azimuthal_residual(smoothed: xr.Dataset) -> float:
    """Amplitude of cos 2φ and sin 2φ in the residuals at normal incidence [standard uncertainties], of one wavelength.

    0 where it is not significant, away from normal incidence, and for a fit that does not assume an isotropic surface.
    """
    if float(smoothed["incidence"]) > 0 or smoothed.attrs.get("isotropic") == "false":
        return 0.0
    residual = smoothed["residual"].values
    used = np.isfinite(residual) & (smoothed["theta_s"].values > 0)
    if used.sum() < _FEWEST_CELLS:
        return 0.0
    twice = 2 * np.radians(smoothed["phi_s"].values[used])
    design = np.stack([np.cos(twice), np.sin(twice)], axis=1)
    part, *_ = np.linalg.lstsq(design, residual[used] - residual[used].mean(), rcond=None)
    amplitude = float(np.hypot(*part))
    return amplitude if amplitude > _ASYMMETRIC * float(np.sqrt(2 / used.sum())) else 0.0


def symmetry_warnings(smoothed: xr.Dataset) -> list[str]:
    """Warnings where the residuals contradict the mirror symmetry or the isotropy that the fit assumes, by incidence."""
    one_sided: list[str] = []
    azimuthal: list[str] = []
    for incidence in smoothed["incidence"].values:
        own = smoothed.sel(incidence=incidence)
        fits = [own.sel(wavelength=wavelength) for wavelength in own["wavelength"].values]
        for listed, measure in ((one_sided, asymmetry), (azimuthal, azimuthal_residual)):
            sizes = [measure(fit) for fit in fits]
            if np.mean([size > 0 for size in sizes]) > _COMMON_SHARE:
                listed.append(
                    f"{incidence:g}° ({np.median([size for size in sizes if size]):.1f} standard uncertainties)"
                )
    warnings = []
    if one_sided:
        warnings.append(
            f"The two sides of the plane of incidence differ at {', '.join(one_sided)}, although the fit assumes that they are alike. If the sample "
            "has a lay, set `rig.smoothing.isotropic: false` and `mirror_symmetric: false`; otherwise measure the angular target in this run."
        )
    if azimuthal:
        warnings.append(
            f"The light at normal incidence depends on the azimuth at {', '.join(azimuthal)}, as that of a surface with a lay, although the fit "
            "assumes an isotropic surface. Set `rig.smoothing.isotropic: false`."
        )
    return warnings


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
