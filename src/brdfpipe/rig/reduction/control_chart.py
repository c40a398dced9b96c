"""The control chart of calibration profiles: how far each profile differs from those before it."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import date

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy import stats

from brdfpipe import vocabulary
from brdfpipe.errors import abbreviated
from brdfpipe.geometry import Array
from brdfpipe.rig.reduction.arrangements import CalibrationError, finite_median

ALARM = 3.0
"""Control limit in standard deviations, for one watched value. Several at once share its false-alarm rate."""

CELL_CHANGE_SIGMA, CELL_CHANGE_LEAST = 5.0, 0.03
"""A cell has changed if it differs from the other cells by this many standard uncertainties, and by at least this share."""

_EXPECTED_SCATTER = {"level": 0.01, "spectrum": 0.003}
"""Expected relative scatter of profiles: of the mean over all wavelengths, and of each wavelength against that mean."""
_EXPECTED_WEIGHT = 3  # number of profiles that the expected scatter counts for
_LISTED = 5  # most cells listed in a warning
_NEW_CHART = "remove `previous` from calibration.yaml to begin a new chart"


def extend_chart(profile: xr.Dataset, previous: xr.Dataset) -> xr.Dataset:
    """Append a new profile to the control chart of the previous one.

    A loss of the rig looks like a gain of the etalon. So changes common to all cells, of the mean over wavelengths (``level``) or of one
    wavelength against that mean (``spectrum``), are watched. A change of a single cell is what a profile corrects: it only gives a warning.

    Parameters
    ----------
    profile, previous : kind ``calibration``, of one rig

    Returns
    -------
    The profile with ``scale_change(profile, wavelength)`` of all profiles up to this one, ``change(profile, watched)`` from the mean of
    the earlier profiles without violation, its ``limit``, and ``violation``. If the new profile exceeds a limit, the attribute
    ``drift_violation`` says so, and :func:`brdfpipe.rig.reduction.primary.apply_profile` refuses it.

    Raises
    ------
    CalibrationError : the previous profile is of other optics, of a later day, or shares no entrance, cell or wavelength.
    """
    log_ratio = _log_scale_ratio(profile, previous)
    step = finite_median(log_ratio, axis=1)
    earlier = previous["scale_change"].reindex(wavelength=profile["wavelength"].values).values
    change = np.vstack([earlier, earlier[-1] + step])
    if not np.isfinite(change).all(axis=0).any():
        raise CalibrationError(f"{_name(previous)} shares no wavelength, or no cell, with this one; {_NEW_CHART}")
    names, days = (np.append(previous[name].values, profile[name].values[-1]) for name in ("profile", "profile_day"))
    profile = profile.drop_dims("profile").assign(chart_points(names, days, change, profile["wavelength"].values))
    profile = vocabulary.add_warning(profile, *_changed_cells(profile, previous, log_ratio - step[:, None]))
    if violations := list(_violations(profile)):
        profile = profile.assign_attrs(drift_violation="; ".join(violations))
    return vocabulary.validate(profile, "calibration")


def chart_points(names: ArrayLike, days: ArrayLike, scale_change: Array, wavelength: Array) -> xr.Dataset:
    """The chart's points, one for each profile, from the logarithm (profile, wavelength) of the scale over that of the first profile.

    A change is taken from the mean of the earlier profiles without violation. The change of the spectrum is that of the wavelength [nm] that
    differs most from the level. Only wavelengths that all profiles have count.
    """
    shared = np.isfinite(scale_change).all(axis=0)
    level = scale_change[:, shared].mean(axis=1, keepdims=True)
    watched = level, scale_change[:, shared] - level
    shape = len(level), len(watched)
    change, limit, violation = np.zeros(shape), np.full(shape, np.nan), np.zeros(shape, dtype=bool)
    departing = np.full(len(level), np.nan)
    for new in range(1, len(level)):
        sound = ~violation[:new].any(axis=1)
        for column, (values, expected) in enumerate(zip(watched, _EXPECTED_SCATTER.values(), strict=True)):
            before = values[:new][sound]
            difference = values[new] - before.mean(axis=0)
            # The expected scatter is a prior, updated by the scatter of the profiles so far.
            observed = ((before - before.mean(axis=0)) ** 2).sum() / difference.size
            variance = (_EXPECTED_WEIGHT * expected**2 + observed) / (_EXPECTED_WEIGHT + len(before) - 1)
            largest = int(np.argmax(np.abs(difference)))
            change[new, column] = difference[largest]
            # The largest of several values exceeds its limit as rarely as a single value exceeds ALARM.
            sigmas = float(stats.norm.isf(stats.norm.sf(ALARM) / difference.size))
            limit[new, column] = sigmas * np.sqrt(variance * (1 + 1 / len(before)))
        departing[new] = wavelength[shared][largest]
        violation[new] = np.abs(change[new]) > limit[new]
    points = {"change": change, "limit": limit, "violation": violation}
    chart = xr.Dataset(
        {
            "profile_day": ("profile", np.asarray(days)),
            "scale_change": (("profile", "wavelength"), scale_change),
            "departing_wavelength": ("profile", departing),
            **{name: (("profile", "watched"), values) for name, values in points.items()},
        },
        coords={"profile": np.asarray(names), "watched": np.array(list(_EXPECTED_SCATTER))},
    )
    return vocabulary.label(chart, "calibration")


def _violations(profile: xr.Dataset) -> Iterator[str]:
    """Why the newest profile violates the chart."""
    point = profile.isel(profile=-1)
    descriptions = {
        "level": "{:+.1%} from the earlier ones",
        "spectrum": f"{{:+.1%}} more at {point['departing_wavelength']:g} nm than at all wavelengths together",
    }
    for watched, description in descriptions.items():
        watched_point = point.sel(watched=watched)
        if watched_point["violation"]:
            change, limit = (np.expm1(float(watched_point[name])) for name in ("change", "limit"))
            yield (
                f"the profile of {profile.attrs['day']} differs by {description.format(change)}, beyond the control limit of {limit:.1%}: the "
                f"etalon is dirty or aged, or the optics were changed ({_NEW_CHART} if they were)"
            )


def _name(profile: xr.Dataset) -> str:
    return f"the previous profile, {profile['profile'].values[-1]} of {profile.attrs['day']},"


def _log_scale_ratio(profile: xr.Dataset, previous: xr.Dataset) -> Array:
    """Logarithm of the scale over that of the previous profile, (wavelength, cell); missing where either is."""
    if previous.attrs["rig_digest"] != profile.attrs["rig_digest"]:
        raise CalibrationError(
            f"{_name(previous)} is of other optics: the rig's description was changed since. A chart is of one rig; {_NEW_CHART}"
        )
    if date.fromisoformat(previous.attrs["day"]) > date.fromisoformat(profile.attrs["day"]):
        raise CalibrationError(
            f"{_name(previous)} was measured after this one ({profile.attrs['day']}); name an earlier one as `previous` in calibration.yaml"
        )
    shared = np.intersect1d(profile["incidence"].values, previous["incidence"].values)
    if not shared.size:
        raise CalibrationError(
            f"{_name(previous)} was measured through other entrances; measure the etalon through one of them too (`etalon_entrances` in "
            f"plan.yaml), or {_NEW_CHART}"
        )
    # Each profile's scales refer to its first entrance, which may differ.
    entrance = float(shared[0])
    now, before = (item["cell_scale"] / item["path"].sel(incidence=entrance, drop=True) for item in (profile, previous))
    return np.asarray(np.log(now.values / _on_grid_of(profile, before)))


def _changed_cells(profile: xr.Dataset, previous: xr.Dataset, log_change: Array) -> Iterator[str]:
    """A warning of cells whose scale changed against the other cells; ``log_change`` is (wavelength, cell)."""
    u_now, u_before = (dataset["cell_scale_u_calibration"] / dataset["cell_scale"] for dataset in (profile, previous))
    u = finite_median(np.hypot(u_now.values, _on_grid_of(profile, u_before)), axis=0)
    change = finite_median(log_change, axis=0)
    order = np.argsort(-np.abs(np.nan_to_num(change)), kind="stable")
    changed = [int(cell) for cell in order if abs(change[cell]) > max(CELL_CHANGE_SIGMA * u[cell], CELL_CHANGE_LEAST)]
    if changed:
        # A cell whose scale has grown has lost light.
        losses = [f"{profile['cell'].values[cell]} by {np.expm1(-change[cell]):+.0%}" for cell in changed]
        yield (
            f"{len(changed)} cell{'s' if len(changed) > 1 else ''} changed against the others since {previous['profile'].values[-1]}: "
            f"{abbreviated(losses, _LISTED)}. Clean fibres that lost light, and check that none was moved or exchanged."
        )


def _on_grid_of(profile: xr.Dataset, values: xr.DataArray) -> Array:
    """Values at the wavelengths and cells of a profile, missing where there are none."""
    return np.asarray(values.reindex_like(profile["cell_scale"]).values)
