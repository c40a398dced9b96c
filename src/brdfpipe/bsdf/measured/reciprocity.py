"""Reciprocity of a measured BSDF: how far f(σ₁ → σ₂) and f(σ₂ → σ₁) disagree before both are averaged, and after."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.measured.evaluation import evaluate, uncertainty

CONTRADICTING = 2.0
"""Disagreement of the two directions of light, over its uncertainty, above which it is significant."""


def reciprocity(bsdf: xr.Dataset, azimuths: int = 13) -> xr.Dataset:
    """The BRDF from one measured incidence to another and back, before and after both are averaged.

    Parameters
    ----------
    bsdf : representation ``rig``
    azimuths : number of azimuths, evenly from φ = 0 to 180 degree

    Returns
    -------
    Dataset of (pair, phi_o, wavelength), a pair for every two different measured incidences ``incidence`` and ``incidence_2``:
        ``forward`` f(σ₁ → σ₂) and ``backward`` f(σ₂ → σ₁), each from its own incidence, ``averaged`` from the BSDF [sr-1], and their
        standard uncertainties. Before averaging, the residual is forward − backward; after, it is averaged − forward and averaged − backward.
        Of a BSDF that is not averaged (attribute ``reciprocity``), ``averaged`` is ``forward``
    """
    vocabulary.validate(bsdf, "bsdf")
    one_way = bsdf.assign_attrs(reciprocity="none")
    spectral = str(bsdf["coefficient"].dims[1])
    measured = (bsdf["coefficient_quality"] == vocabulary.quality("measured")).any(spectral)
    incidence = bsdf["incidence"].values[measured.values & (bsdf["transmitted"].values == 0)]
    first, second = (incidence[index] for index in np.triu_indices(incidence.size, 1))
    phi = np.linspace(0.0, 180.0, azimuths)
    forward = first[:, None], np.zeros(1), second[:, None], phi
    backward = second[:, None], np.zeros(1), first[:, None], -phi
    rows = (
        ("forward", "from the first incidence to the second", one_way, forward),
        ("backward", "from the second incidence to the first", one_way, backward),
        ("averaged", "of both directions", bsdf, forward),
    )
    fields, dims = {}, ("pair", "phi_o", spectral)
    for name, words, dataset, angles in rows:
        for suffix, prefix, quantity in (("", "", evaluate), ("_u", "standard uncertainty of: ", uncertainty)):
            values = quantity(dataset, *angles, None)
            fields[name + suffix] = (dims, values, {"units": "sr-1", "long_name": f"{prefix}BRDF {words}"})
    degree = {"units": "degree", "long_name": "angle of incidence"}
    coords = {"incidence": ("pair", first, degree), "incidence_2": ("pair", second, degree), "phi_o": phi}
    if spectral in bsdf.coords:
        coords[spectral] = bsdf[spectral]
    return vocabulary.label(xr.Dataset(fields, coords), "reciprocity")


def contradictions(bsdf: xr.Dataset) -> xr.DataArray:
    """Disagreement of the BRDF between two incidences and back before they are averaged, over the uncertainty of the difference.

    Parameters
    ----------
    bsdf : representation ``rig``

    Returns
    -------
    ``(incidence, incidence_2)``, rms over azimuth and wavelength [1]; the measured incidences of reflection, missing on the diagonal
    """
    pairs = reciprocity(bsdf.assign_attrs(reciprocity="none"))
    z = (pairs["forward"] - pairs["backward"]) / xr.DataArray(np.hypot(pairs["forward_u"], pairs["backward_u"]))
    rms = np.sqrt((z**2).mean([dim for dim in z.dims if dim != "pair"]).values)
    incidence = np.union1d(pairs["incidence"], pairs["incidence_2"])
    first, second = (np.searchsorted(incidence, pairs[name]) for name in ("incidence", "incidence_2"))
    table = np.full((incidence.size, incidence.size), np.nan)
    table[first, second] = table[second, first] = rms
    return xr.DataArray(
        table, {"incidence": incidence, "incidence_2": incidence}, ("incidence", "incidence_2"), "contradiction"
    )


def with_contradictions(bsdf: xr.Dataset) -> xr.Dataset:
    """A BSDF whose uncertainties are enlarged at incidences that contradict the others, which its attributes name with their contradiction.

    A wrong incidence contradicts all others, a right one only the wrong ones: so the median of an incidence's contradictions counts.
    """
    table = contradictions(bsdf)
    if not table.size:
        return bsdf
    median = np.nanquantile(table.values, 0.5, axis=1, method="lower")
    by_incidence = dict(zip(table["incidence"].values, median, strict=True))
    bsdf = bsdf.assign_attrs(contradiction=float(table.max()))
    contradicting = {incidence: size for incidence, size in by_incidence.items() if size > CONTRADICTING}
    if not contradicting:
        return bsdf
    bsdf = bsdf.assign_attrs(
        contradicting_incidences=[float(incidence) for incidence in contradicting],
        contradicting_times=[float(size) for size in contradicting.values()],
    )
    sizes = [by_incidence.get(incidence, max(by_incidence.values())) for incidence in bsdf["incidence"].values]
    enlarged = (bsdf["transmitted"].values == 0) & (np.array(sizes) > CONTRADICTING)
    factor = xr.DataArray(np.where(enlarged, sizes, 1.0), dims="node")
    names = [name for name in ("coefficient_factor", "coefficient_common") if name in bsdf]
    fields = {name: (bsdf[name] * factor).transpose(*bsdf[name].dims).astype(bsdf[name].dtype) for name in names}
    listed = ", ".join(f"{incidence:g}° ({size:.1f} times)" for incidence, size in contradicting.items())
    return vocabulary.add_warning(
        bsdf.assign(fields),
        f"Reciprocity is violated beyond the stated uncertainty at {listed}. Possible causes: a picture of another incidence, a sample that "
        "moved, is uneven or has a lay, or an entrance whose path was not calibrated. The uncertainties there were enlarged by the same "
        "factors. Measure these incidences again.",
    )
