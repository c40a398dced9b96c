"""Surface texture parameters of ISO 25178 and ISO 4287, each with its formula."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.errors import BrdfpipeError
from brdfpipe.vocabulary import label, validate

NAMES = (
    *("Sa", "Sq", "Sz", "Ssk", "Sku", "Sdq", "Sdr"),
    *("Ra", "Rq", "Rz", "Rsk", "Rku", "Rdq", "Rdq_7point"),
    "missing_fraction",
)
"""Surface texture parameters, of a map (S…) and of a line (R…)."""

Scalars = Mapping[str, tuple[float, str, str]]
"""name → value, units, long name"""


def parameters(surface: xr.Dataset) -> xr.Dataset:
    """Height and gradient parameters of a surface, over all of it, without further filter.

    Parameters
    ----------
    surface : kind ``surface``; level it first, the heights are taken about their mean alone

    Returns
    -------
    Dataset of scalars. Areal: Sa Sq Sz [um], Ssk Sku Sdq Sdr [1]. Line: Ra Rq Rz [um], Rsk Rku Rdq Rdq_7point [1]. Both:
    ``missing_fraction`` [1]. ``long_name`` names each formula. NaN where no facet, or no height spread, defines the value.

    Raises
    ------
    VocabularyError : the dataset is not of kind ``surface``.
    BrdfpipeError : no height is valid.

    Notes
    -----
    Sdq and Sdr take every cell of four heights as four triangles, both diagonals in turn, as the facets that scatter light
    do; a triangle counts if its three heights are valid. Sdq = sqrt(<p² + q²>): both components together, not per axis.
    A line parameter covers the whole line as one section, without a λc filter.

    References
    ----------
    ISO 25178-2:2021, 4.3 and 4.4; ISO 21920-2:2021, 4.3 and 4.5 (7-point slope: ISO 4287:1997).
    """
    validate(surface, "surface")
    height = surface.height.values
    valid = height[~np.isnan(height)].astype(np.float64)
    if valid.size == 0:
        raise BrdfpipeError("the surface has no valid height")
    if height.ndim == 2:
        letter, gradients = "S", _areal_gradients(height, surface.attrs["pitch_x"], surface.attrs["pitch_y"])
    else:
        letter, gradients = "R", _line_gradients(height, surface.attrs["pitch_x"])
    missing = (1 - valid.size / height.size, "1", "share of heights that are missing")
    scalars = {**_heights(valid, letter), **gradients, "missing_fraction": missing}
    values = {name: ((), value, {"units": u, "long_name": text}) for name, (value, u, text) in scalars.items()}
    attrs = {name: surface.attrs[name] for name in ("levelling", "band")}
    return label(xr.Dataset(values, attrs=attrs), "parameters")


def with_parameters(surface: xr.Dataset) -> xr.Dataset:
    """The surface with its texture parameters (:func:`parameters`) as further variables."""
    return surface.assign(parameters(surface).data_vars)


def _heights(z: NDArray[np.float64], letter: str) -> Scalars:
    z = z - z.mean()
    square = z * z
    rms = float(np.sqrt(square.mean()))
    skewness = float((square * z).mean()) / rms**3 if rms else np.nan
    kurtosis = float((square * square).mean()) / rms**4 if rms else np.nan
    over = "the area" if letter == "S" else "the line as one section"
    return {
        f"{letter}a": (float(np.abs(z).mean()), "um", f"arithmetic mean height {letter}a = <|z|> over {over}"),
        f"{letter}q": (rms, "um", f"root mean square height {letter}q = sqrt(<z²>) over {over}"),
        f"{letter}z": (float(np.ptp(z)), "um", f"highest peak to deepest pit {letter}z = max z - min z over {over}"),
        f"{letter}sk": (skewness, "1", f"skewness {letter}sk = <z³>/{letter}q³"),
        f"{letter}ku": (kurtosis, "1", f"kurtosis {letter}ku = <z⁴>/{letter}q⁴"),
    }


def _areal_gradients(height: NDArray[np.floating], pitch_x: float, pitch_y: float) -> Scalars:
    p = np.diff(height, axis=1) / pitch_x
    q = np.diff(height, axis=0) / pitch_y
    count, square_sum, excess_sum = 0, 0.0, 0.0
    # Every triangle of a cell has one edge along x (lower or upper) and one along y (left or right).
    for p_edge in (p[:-1], p[1:]):
        for q_edge in (q[:, :-1], q[:, 1:]):
            square = p_edge * p_edge + q_edge * q_edge
            # sqrt(1 + s²) - 1 in this form, since the difference cancels on smooth surfaces.
            excess = square / (1 + np.sqrt(1 + square))
            present = ~np.isnan(square)
            if not present.all():
                square, excess = square[present], excess[present]
            count += square.size
            square_sum += float(square.sum(dtype=np.float64))
            excess_sum += float(excess.sum(dtype=np.float64))
    sdq = (square_sum / count) ** 0.5 if count else np.nan
    sdr = excess_sum / count if count else np.nan
    return {
        "Sdq": (sdq, "1", "root mean square gradient Sdq = sqrt(<p² + q²>), four triangles a cell"),
        "Sdr": (sdr, "1", "developed interfacial area ratio Sdr = <sqrt(1 + p² + q²)> - 1, four triangles a cell"),
    }


def _line_gradients(height: NDArray[np.floating], pitch: float) -> Scalars:
    z = height.astype(np.float64)
    forward = np.diff(z) / pitch
    central = (z[6:] - z[:-6] - 9 * (z[5:-1] - z[1:-5]) + 45 * (z[4:-2] - z[2:-4])) / (60 * pitch)
    return {
        "Rdq": (_rms(forward), "1", "root mean square slope Rdq, by forward difference of neighbours"),
        "Rdq_7point": (_rms(central), "1", "root mean square slope Rdq, by the 7-point formula"),
    }


def _rms(values: NDArray[np.float64]) -> float:
    present = values[~np.isnan(values)]
    return float(np.sqrt(np.mean(present**2))) if present.size else float("nan")
