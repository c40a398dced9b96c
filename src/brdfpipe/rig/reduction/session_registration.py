"""The registration of a session's pictures, from its frames: the fibres, other arrangements, and the angular target."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr

from brdfpipe.geometry import Array
from brdfpipe.rig.description import Rig
from brdfpipe.rig.reduction import glare, pictures, registration
from brdfpipe.rig.reduction.arrangements import ENTRANCE_EXCLUSION_RADIUS
from brdfpipe.rig.reduction.brackets import DarkFrames
from brdfpipe.rig.reduction.registration import Registration


def register_fibres(
    rig: Rig, picture: Array, variance: Array, frames: xr.Dataset, chosen: xr.Dataset, darks: DarkFrames
) -> Registration:
    """Register the mean picture (y, x) of an arrangement to its fibres.

    If too few fibres are bright enough, scale and radial term come from another arrangement among the session's ``frames``.
    """
    # The glare of a bright lobe is uneven across a faint spot and would shift its centroid.
    background = pictures.background(rig, registration.register(rig, picture, variance).screen)
    clean = glare.subtract(picture, glare.estimate(picture, variance, background))
    own = registration.register(rig, clean, variance)
    if own.spots >= registration.FIBRES_ENOUGH:
        return own
    others = frames.isel(
        frame=np.isin(frames["purpose"].values, ("sample", "etalon"))
        & ~np.isin(frames["shot"].values, chosen["shot"].values)
    )
    for _, arrangement in others.groupby(["purpose", "side", "incidence"]) if others.sizes["frame"] else ():
        other = pictures.merge_frames(_middle_wavelength(arrangement), darks, rig)
        if other and (lens := registration.register(rig, *other)).spots >= registration.FIBRES_ENOUGH:
            return registration.register(rig, clean, variance, lens.screen)
    return own


def centre_disc(
    rig: Rig, session: Registration, frames: xr.Dataset, target: xr.Dataset, darks: DarkFrames
) -> Registration:
    """Find the mirror direction on the disc, and the focal length, in the pictures of the rig's angular target.

    ``session`` and ``frames`` are the session's registration and frames; those of ``target`` may be of another session. Without a picture of
    the target the disc's centre is as described.
    """
    pictured = target.isel(frame=target["purpose"].values == "target")
    if rig.target is None or not pictured.sizes["frame"]:
        return session
    target_darks = darks if target is frames else DarkFrames.of(target, rig)
    picture = pictures.merge_frames(pictured, target_darks, rig)
    if picture is None:
        return session
    # Only the reference and few other spots are visible with the target, enough for the shift; the lens is the same in every session.
    in_target = registration.register(rig, *picture, session.screen)
    falloff = lens_falloff(rig, session, frames, darks)
    if falloff is None and target is not frames:
        falloff = lens_falloff(rig, in_target, target, target_darks)
    spots = rig.target
    centred = registration.fit_disc(in_target, *picture, spots.theta_s, spots.phi_s, spots.radius, falloff)
    screen = replace(session.screen, disc_centre=centred.screen.disc_centre, focal_length=centred.screen.focal_length)
    return replace(session, screen=screen, direction_u=centred.direction_u, scale_u=centred.scale_u)


def lens_falloff(rig: Rig, session: Registration, frames: xr.Dataset, darks: DarkFrames) -> Array | None:
    """Relative light that the lens passes at each pixel, from a picture of the etalon; None without one.

    The etalon is taken through the entrance that tilts it least without hiding a part of the disc.
    """
    etalon = frames.isel(frame=frames["purpose"].values == "etalon")
    rim = np.degrees(np.arctan(rig.screen.disc_radius / rig.screen.focal_length))
    entrances = np.unique(etalon["incidence"].values)
    # Towards an entrance σ the fixed direction is turned by 2σ.
    clear = entrances[(2 * entrances > rim + ENTRANCE_EXCLUSION_RADIUS) & (2 * entrances + rim < 90)]
    if not clear.size:
        return None
    etalon = etalon.isel(frame=etalon["incidence"].values == clear[0])
    picture = pictures.merge_frames(_middle_wavelength(etalon), darks, rig)
    return None if picture is None else registration.fit_falloff(session, picture[0], float(clear[0]))


def _middle_wavelength(frames: xr.Dataset) -> xr.Dataset:
    wavelengths = np.unique(frames["wavelength"].values)
    return frames.isel(frame=frames["wavelength"].values == wavelengths[wavelengths.size // 2])
