"""Reduced arrangements (an incidence each) of one load and side, joined into one dataset, and what their evaluation shares."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError, abbreviated
from brdfpipe.geometry import Array

ENTRANCE_EXCLUSION_RADIUS = 4.0
"""Radius [degree] about the entrance in use within which no cell is used, unless an etalon measured through it shows which it hides."""


class CalibrationError(BrdfpipeError):
    """A calibration profile that cannot be made, or may not be used."""


def join_arrangements(reduced: Sequence[xr.Dataset]) -> xr.Dataset:
    """Arrangements of one load and side as one dataset of kind ``reduced``, by rising incidence.

    A wavelength that an arrangement lacks is missing there, with a warning.

    Raises CalibrationError: there are none, or they differ in rig, load, side or reference filter.
    """
    if not reduced:
        raise CalibrationError("no arrangement to join; check `runs` and `side` in the plan")
    for name in ("rig_digest", "load", "side", "filter"):
        if len(values := {str(arrangement.attrs[name]) for arrangement in reduced}) > 1:
            raise CalibrationError(
                f"the frames differ in {name}: {', '.join(sorted(values))}; reduce runs of one rig together"
            )
    wavelengths = np.unique(np.concatenate([arrangement["wavelength"].values for arrangement in reduced]))
    # The thumbnail and the cell positions belong to a single arrangement and are left out.
    parts = [
        arrangement[[name for name, field in arrangement.data_vars.items() if "incidence" in field.dims]].reindex(
            wavelength=wavelengths, fill_value={"signal_quality": vocabulary.quality("missing")}
        )
        for arrangement in reduced
    ]
    joined = xr.concat(
        parts, "incidence", data_vars="minimal", coords="minimal", compat="override", combine_attrs="override"
    )
    warnings = [text for arrangement in reduced for text in vocabulary.warnings(arrangement)]
    joined.attrs.pop("warnings", None)
    warnings += _missing_wavelengths(reduced, wavelengths)
    joined = vocabulary.add_warning(joined.sortby("incidence"), *dict.fromkeys(warnings))
    return vocabulary.validate(joined, "reduced")


def finite_median(values: Array, axis: int) -> Array:
    """Median of the finite values along an axis, NaN without any; faster than numpy's ``nanmedian`` and without its warnings."""
    ordered = np.sort(values, axis=axis)  # NaN last
    count = np.isfinite(ordered).sum(axis=axis, keepdims=True)
    lower, upper = (np.take_along_axis(ordered, np.maximum(at, 0), axis) for at in ((count - 1) // 2, count // 2))
    return np.where(count > 0, (lower + upper) / 2, np.nan).squeeze(axis)


def _missing_wavelengths(reduced: Sequence[xr.Dataset], wavelengths: Array) -> Iterator[str]:
    """A warning of the wavelengths that some arrangements lack and others have."""
    gaps = []
    for arrangement in sorted(reduced, key=lambda arrangement: float(arrangement["incidence"][0])):
        missing = np.setdiff1d(wavelengths, arrangement["wavelength"].values)
        if missing.size:
            listed = abbreviated([f"{wavelength:g}" for wavelength in missing], 5)
            gaps.append(f"{arrangement['incidence'][0]:g}° at {listed} nm")
    if gaps:
        yield (
            f"Missing spectra: the {reduced[0].attrs['load']} in {reduced[0].attrs['side']} has no usable frame at {'; '.join(gaps)}, "
            "but has frames there at other incidences. They are interpolated from the neighbouring incidences. Repeat the missing frames "
            "with `brdfpipe rig scan … --resume`."
        )
