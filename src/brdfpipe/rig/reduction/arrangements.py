"""The arrangements of one load and side (an incidence each) joined into one dataset."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError, abbreviated
from brdfpipe.geometry import Array

ENTRANCE_EXCLUSION_RADIUS = 4.0
"""Radius [degree] about the entrance in use within which no cell is used, unless an etalon measured through it shows which it hides."""

_LISTED = 5
"""Most wavelengths listed in a message."""


class CalibrationError(BrdfpipeError):
    """A calibration profile that cannot be made, or may not be used."""


def join_arrangements(reduced: Sequence[xr.Dataset]) -> xr.Dataset:
    """Arrangements of one load and side as one dataset of kind ``reduced``, by rising incidence.

    Raises
    ------
    CalibrationError : there are none, or they differ in rig, load, side or reference filter.

    Notes
    -----
    A wavelength that an arrangement lacks is missing there. A warning names it.
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
    joined = joined.sortby("incidence")
    joined = vocabulary.add_warning(joined, *dict.fromkeys([*warnings, *_missing_wavelengths(reduced, wavelengths)]))
    return vocabulary.validate(joined, "reduced")


def _missing_wavelengths(reduced: Sequence[xr.Dataset], wavelengths: Array) -> Iterator[str]:
    """A warning of the wavelengths that some arrangements lack and others have."""
    missing = {
        float(arrangement["incidence"][0]): np.setdiff1d(wavelengths, arrangement["wavelength"].values)
        for arrangement in reduced
    }
    gaps = [
        f"{incidence:g}° at {abbreviated([f'{each:g}' for each in missing[incidence]], _LISTED)} nm"
        for incidence in sorted(missing)
        if missing[incidence].size
    ]
    if gaps:
        yield (
            f"Missing spectra: the {reduced[0].attrs['load']} in {reduced[0].attrs['side']} has no usable frame at {'; '.join(gaps)}, "
            "but has frames there at other incidences. They are interpolated from the neighbouring incidences. Repeat the missing frames "
            "with `brdfpipe rig scan … --resume`."
        )
