"""The registration of a session's pictures, from its frames: the fibres, other arrangements, and the angular target."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr

from brdfpipe.geometry import Array
from brdfpipe.rig.description import Rig
from brdfpipe.rig.reduction import glare, pictures, registration
from brdfpipe.rig.reduction.arrangements import ENTRANCE_EXCLUSION_RADIUS
from brdfpipe.rig.reduction.brackets import Darkness
from brdfpipe.rig.reduction.registration import Registration


def register_fibres(
    rig: Rig, picture: Array, variance: Array, frames: xr.Dataset, chosen: xr.Dataset, darkness: Darkness
) -> Registration:
    """Register the mean picture of an arrangement to its fibres.

    Where too few fibres shine, scale and radial term come from another arrangement of the session.

    Parameters
    ----------
    picture, variance : (y, x) of the arrangement
    frames : of the whole session
    chosen : of the arrangement
    """
    # The glare of a bright lobe is uneven across a faint spot and would shift its centroid.
    background = pictures.background(rig, registration.register(rig, picture, variance).screen)
    clean = glare.removed(picture, glare.estimate(picture, variance, background))
    own = registration.register(rig, clean, variance)
    if own.spots >= registration.FIBRES_ENOUGH:
        return own
    others = frames.isel(
        frame=np.isin(frames["purpose"].values, ("sample", "etalon"))
        & ~np.isin(frames["shot"].values, chosen["shot"].values)
    )
    for _, arrangement in others.groupby(["purpose", "side", "incidence"]) if others.sizes["frame"] else ():
        other = pictures.merged_picture(_middle_wavelength(arrangement), darkness, rig)
        if other and (seen := registration.register(rig, *other)).spots >= registration.FIBRES_ENOUGH:
            return registration.register(rig, clean, variance, seen.screen)
    return own


def centre_disc(
    rig: Rig, session: Registration, frames: xr.Dataset, target: xr.Dataset, darkness: Darkness
) -> Registration:
    """Find the mirror direction on the disc, and the focal length, in the pictures of the rig's angular target.

    Parameters
    ----------
    session : registration of the session's pictures
    frames : of the session
    target : frames with pictures of the target, of this session or another; without any the disc's centre is as described
    """
    own = target.isel(frame=target["purpose"].values == "target")
    if rig.target is None or not own.sizes["frame"]:
        return session
    target_darkness = darkness if target is frames else Darkness.of(target, rig)
    picture = pictures.merged_picture(own, target_darkness, rig)
    if picture is None:
        return session
    # The target leaves few spots but the reference, enough for the shift of its pictures; the lens is the same in every session.
    in_target = registration.register(rig, *picture, session.screen)
    falloff = lens_falloff(rig, session, frames, darkness)
    if falloff is None and target is not frames:
        falloff = lens_falloff(rig, in_target, target, target_darkness)
    spots = rig.target
    centred = registration.centre_disc(in_target, *picture, spots.theta_s, spots.phi_s, spots.radius, falloff)
    screen = replace(session.screen, disc=centred.screen.disc, focal_length=centred.screen.focal_length)
    return replace(session, screen=screen, direction_u=centred.direction_u, scale_u=centred.scale_u)


def lens_falloff(rig: Rig, session: Registration, frames: xr.Dataset, darkness: Darkness) -> Array | None:
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
    picture = pictures.merged_picture(_middle_wavelength(etalon), darkness, rig)
    return None if picture is None else registration.falloff(session, picture[0], float(clear[0]))


def _middle_wavelength(frames: xr.Dataset) -> xr.Dataset:
    wavelengths = np.unique(frames["wavelength"].values)
    return frames.isel(frame=frames["wavelength"].values == wavelengths[wavelengths.size // 2])
