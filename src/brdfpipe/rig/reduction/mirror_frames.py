"""From the frames of a turned mirror to a table of fibres with the directions that they show."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array, unit_vector
from brdfpipe.rig.description import Fibre, Rig
from brdfpipe.rig.plan import MIRROR
from brdfpipe.rig.reduction import brackets, pictures
from brdfpipe.rig.reduction.brackets import DarkFrames
from brdfpipe.rig.reduction.cell_signals import cell_signals
from brdfpipe.rig.reduction.fibre_directions import Directions, fit_directions
from brdfpipe.rig.reduction.lamp_monitor import REPEAT_U
from brdfpipe.rig.reduction.session_registration import centre_disc, register_fibres

_DISC_CELLS = 60
"""Cells of the disc that tie the mount to the mirror direction: all share one error, so that more add little."""


class MirrorError(BrdfpipeError):
    """Frames that show no directions."""


class Calibration(NamedTuple):
    """Directions of the fibres of a rig."""

    fibres: tuple[Fibre, ...]
    """As found; as described where no direction is found."""
    moved: Array
    """(fibre,) angle from the described direction [degree]; missing where none is found."""
    directions: Directions


def calibrate_directions(frames: xr.Dataset, rig: Rig) -> Calibration:
    """The directions of the fibres from frames of kind ``frames`` of a turned mirror, and of the angular target if they hold it.

    Raises
    ------
    MirrorError : there are no such frames, of another rig, or no fibre is lit well enough from enough directions.
    ExposureError : there are no dark frames of an exposure time.
    """
    own = frames.isel(frame=frames["purpose"].values == MIRROR)
    if frames.attrs["rig_digest"] != rig.digest:
        raise MirrorError(f"the frames were taken with another rig than {rig.name} as described")
    if not own.sizes["frame"]:
        raise MirrorError("the run has no frames of a turned mirror; its plan needs `runs: [target, mirror]`")
    darks = DarkFrames.of(frames, rig)
    aims = np.unique(np.stack([own["aim_theta"].values, own["aim_phi"].values], axis=1), axis=0)
    spot, scales, merged = None, [], []
    for theta, phi in aims:
        at = (own["aim_theta"].values == theta) & (own["aim_phi"].values == phi)
        bracket = brackets.read_bracket(own.isel(frame=at), darks, rig)
        spot = spot or brackets.locate_reference_spot(rig, bracket)
        scales.append(brackets.scale_bracket(bracket, spot, rig))
        merged.append(pictures.merge_bracket(bracket, scales[-1]))
    if all(picture is None for picture in merged):
        raise MirrorError("the reference spot is out of range, or dark, in every frame of the mirror")
    # The aims together light every fibre.
    registration = register_fibres(rig, *pictures.lamp_weighted_mean(merged, scales), frames, own, darks)
    registration = centre_disc(rig, registration, frames, frames, darks)
    cells = cell_signals(rig, registration, np.arange(len(merged), dtype=float), merged, scales, REPEAT_U)
    parts = [name for name in cells if str(name).startswith("signal_u_")]
    u = np.sqrt(sum(cells[name].values ** 2 for name in parts))
    disc = np.flatnonzero(cells["kind"].values == "disc")
    used = np.concatenate([np.arange(len(rig.fibres)), disc[:: max(disc.size // _DISC_CELLS, 1)]])
    described = cells["theta_s"].values[used], cells["phi_s"].values[used]
    entrance = float(own["incidence"].values[0])
    try:
        found = fit_directions(
            entrance,
            (aims[:, 0], aims[:, 1]),
            described,
            cells["kind"].values[used] == "disc",
            cells["signal"].values[:, used],
            u[:, used],
            fixed_u=registration.direction_u,
        )
    except ValueError as error:
        raise MirrorError(f"{error}; turn it in smaller steps (`mirror.step`), or lengthen exposures") from None
    count = len(rig.fibres)
    fibres = tuple(
        replace(fibre, theta_s=float(theta), phi_s=float(phi), u=float(u)) if np.isfinite(u) else fibre
        for fibre, theta, phi, u in zip(rig.fibres, found.theta_s, found.phi_s, found.u, strict=False)
    )
    before, after = (unit_vector(*angles) for angles in (described, (found.theta_s, found.phi_s)))
    moved = np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(after - before, axis=1) / 2, 0, 1)))[:count]
    return Calibration(fibres, np.where(found.found[:count], moved, np.nan), found)
