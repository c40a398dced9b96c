"""An etalon measured before and after the sample: its light at the time of the sample, and its change meanwhile.

Lamp, filters and camera divide out of both. What is left is a change of the etalon itself, of its place in the holder, or of the optics behind
the splitter.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.geometry import Array
from brdfpipe.rig.plan import ETALON_AFTER
from brdfpipe.rig.reduction.arrangements import finite_median

NOTED = 0.01
"""Change of the etalon's light from before to after that gives a warning."""

_LEFT_OUT = "left out"
_CHANGE = {"units": "1", "long_name": "logarithm of the etalon's light after the sample over that before"}


def measured_twice(frames: xr.Dataset, incidence: float | None) -> bool:
    """Whether frames of an entrance show the etalon before and after the sample."""
    own = (incidence is None) | (frames["incidence"].values == incidence)
    return all((own & (frames["purpose"].values == purpose)).any() for purpose in ("etalon", ETALON_AFTER))


def before_and_after(frames: xr.Dataset) -> tuple[xr.Dataset, xr.Dataset]:
    """The frames with the etalon's of one time alone: before the sample, and after it."""
    purpose = frames["purpose"].values
    after = purpose == ETALON_AFTER
    others = np.where(purpose == "etalon", _LEFT_OUT, np.where(after, "etalon", purpose))
    return frames.isel(frame=~after), frames.assign_coords(purpose=("frame", others)).isel(frame=others != _LEFT_OUT)


def interpolated(before: xr.Dataset, after: xr.Dataset, frames: xr.Dataset) -> xr.Dataset:
    """The etalon's relative light at the mean time of the sample's frames, linear between two datasets of kind ``reduced``.

    A value that one of them lacks is that of the other. Adds ``etalon_change(incidence, wavelength, cell)``.
    """
    after = after.reindex(wavelength=before["wavelength"])
    share = _share_of_after(before, after, frames)
    first, second = before["signal"].values, after["signal"].values
    both = np.isfinite(first) & np.isfinite(second)
    weight = np.where(both, share[..., None], np.where(np.isfinite(second), 1.0, 0.0))
    mean = before.copy()
    for name, field in before.data_vars.items():
        if name == "signal" or str(name).startswith("signal_u_"):
            one, other = (1 - weight) * field.values, weight * after[name].values
            one, other = np.where(weight < 1, one, 0.0), np.where(weight > 0, other, 0.0)
            independent = field.attrs.get("correlation") == "independent"
            # What all cells have in common may be the same at both times, too.
            mean[name] = field.copy(data=np.hypot(one, other) if independent else one + other)
    with np.errstate(invalid="ignore", divide="ignore"):
        change = np.where(both & (first > 0) & (second > 0), np.log(second / first), np.nan)
    mean["etalon_change"] = (before["signal"].dims, change, _CHANGE)
    texts = [*vocabulary.warnings(after), *_warning(finite_median(change, axis=2), before)]
    mean = vocabulary.add_warning(mean, *dict.fromkeys(texts))
    return vocabulary.validate(mean, "reduced")


def of_profile(etalon: xr.Dataset) -> dict[str, Any]:
    """The median change of the cells (incidence, wavelength), as a variable of a calibration profile; none if it was not measured."""
    if "etalon_change" not in etalon:
        return {}
    change = finite_median(etalon["etalon_change"].values, axis=2)
    return {"etalon_change": (("incidence", "wavelength"), change, _CHANGE)}


def _share_of_after(before: xr.Dataset, after: xr.Dataset, frames: xr.Dataset) -> Array:
    """(incidence, wavelength) weight of the measurement after the sample, from 0 to 1; a half if no frame shows the sample."""
    start, end = (dataset["elapsed"].values for dataset in (before, after))
    of_sample = frames["elapsed"].values[frames["load"].values == "sample"]
    if not of_sample.size:
        return np.full(start.shape, 0.5)
    return np.clip(np.nan_to_num((of_sample.mean() - start) / (end - start), nan=0.5), 0.0, 1.0)


def _warning(change: Array, before: xr.Dataset) -> list[str]:
    finite = np.abs(np.nan_to_num(change))
    if finite.max() <= NOTED:
        return []
    _, wavelength = np.unravel_index(int(finite.argmax()), finite.shape)
    return [
        f"The etalon's light changed by {np.expm1(change.flat[int(finite.argmax())]):+.1%} from before to after the sample (largest, at "
        f"{before['wavelength'].values[wavelength]:g} nm and {before['incidence'].values[0]:g}°). Check that it lay in the holder as before, and is clean; "
        "its light at the time of the sample is interpolated."
    ]
