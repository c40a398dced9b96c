"""Goniometer that turns within the plane of incidence: reflectance factors by wavelength, text (``.csv``).

The first line names the columns: ``Incident_angle``, ``Measure_angle``, and a wavelength each, ``390nm``. Angles are in degree from the normal; those of
measurement are signed, positive on the side of the mirror direction. Where the detector stands in the light that falls on the sample, all values of the row are 0.

The file says nothing of directions outside the plane of incidence. There the value is that of the plane where the half vector is as far from the normal, linear in the azimuth about
the mirror direction between both sides: right for the lobe of isotropic facets, and a guess for other light.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.grids import from_mirror, half_angles
from brdfpipe.errors import InputError
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import Format
from brdfpipe.exchange.text_lines import Lines
from brdfpipe.geometry import Array

FORMAT = Format(
    description="reflectance factors of a goniometer in the plane of incidence, by wavelength",
    files={},
    read="read",
    reads=(".csv",),
    begins=("Incident_angle,",),
)

_AZIMUTHS = np.linspace(0.0, 180.0, 13)
_SAME = 1e-5
"""Difference at which two angles are the same [degree]."""
_MOST_VALUES = 40_000_000
_ASSUMED = (
    "the file holds the plane of incidence alone. Other directions have the values of the plane where the half vector is as far from the normal, as of isotropic "
    "facets: integrals over the hemisphere, such as the reflectance, rest on this assumption"
)


def read(path: Path) -> ReadTable:
    """Read a table of reflectance factors as a table about the mirror direction.

    At all angles of the file the table has the file's values. Shadowed rows are interpolated between their neighbours in the plane.

    Raises InputError: the file contradicts itself, or is not of this format.
    """
    wavelength, angles, values = _columns(path)
    theta_i = np.unique(angles[:, 0])
    offset = np.unique(np.round(np.abs(angles[:, 1] - angles[:, 0]), 6))
    theta_s = np.union1d([0.0], offset)
    if theta_i.size * theta_s.size * _AZIMUTHS.size * wavelength.size > _MOST_VALUES:
        found = f"{theta_i.size} incidences, {theta_s.size} angles from the mirror direction"
        raise InputError(path, "the table is too large", found=found, accepted=f"at most {_MOST_VALUES} values")
    shape = theta_i.size, theta_s.size, _AZIMUTHS.size
    table, quality = np.empty((*shape, wavelength.size)), np.zeros(shape, dtype=np.int8)
    shadowed = (values == 0).all(axis=1)
    for row, incidence in enumerate(theta_i):
        of_row = angles[:, 0] == incidence
        if (of_row & ~shadowed).sum() < 2:
            raise InputError(path, "an incidence has fewer than two values", found=f"{incidence:g} degree")
        order = np.argsort(angles[of_row, 1], kind="stable")
        view, measured = angles[of_row, 1][order], values[of_row][order]
        if (repeated := np.flatnonzero(np.diff(view) == 0)).size:
            found = f"{view[repeated[0]]:g} at {incidence:g} degree of incidence"
            raise InputError(path, "a direction occurs twice", found=found, accepted="one row for each direction")
        _check_side(path, incidence, view, (measured == 0).all(axis=1))
        table[row], quality[row] = _about_mirror(incidence, theta_s, view, measured)
    hidden = angles[shadowed]
    notes = ["reflectance factors were divided by pi"]
    warnings = [_ASSUMED]
    if hidden.size:
        listed = ", ".join(
            f"{incidence:g}°: {hidden[hidden[:, 0] == incidence, 1].min():g} to {hidden[hidden[:, 0] == incidence, 1].max():g}"
            for incidence in np.unique(hidden[:, 0])
        )
        warnings.append(
            f"{len(hidden)} of {len(angles)} rows are all 0, where the detector shades the sample; they were interpolated from their neighbours in the "
            f"plane (incidence: views in degree; {listed})"
        )
    axes = {"theta_i": theta_i, "theta_s": theta_s, "phi_s": _AZIMUTHS}
    return ReadTable(
        "specular",
        axes,
        table,
        channels="spectral",
        wavelength=wavelength,
        quantity="pi_brdf",
        quality=quality,
        notes=tuple(notes),
        warnings=tuple(warnings),
    )


def _columns(path: Path) -> tuple[Array, Array, Array]:
    """Wavelengths [nm], angles (rows, 2) [degree], and reflectance factors (rows, wavelengths)."""
    lines = Lines(path)
    heads = [head.strip() for head in lines.next("the names of the columns").split(",")]
    if heads[:2] != ["Incident_angle", "Measure_angle"] or len(heads) < 3:
        found, accepted = ", ".join(heads)[:60], "Incident_angle, Measure_angle, and columns such as 390nm"
        raise lines.error("unknown columns", found=repr(found), accepted=accepted)
    named = [re.fullmatch(r"(\d{2,5}(?:\.\d{1,6})?) ?nm", head) for head in heads[2:]]
    wavelength = np.array([float(found[1]) if found else np.nan for found in named])
    if np.isnan(wavelength).any() or not (np.diff(wavelength) > 0).all():
        found = ", ".join(heads[2:])[:60]
        raise lines.error("the columns are not increasing wavelengths", found=found, accepted="390nm, 400nm, …")
    rows = []
    while not lines.ended:
        rows.append(lines.numbers(2 + wavelength.size, "columns"))
    if not rows:
        raise InputError(path, "no row of values", found="the names of the columns alone")
    table = np.array(rows)
    angles = table[:, :2]
    wrong = (angles[:, 0] < 0) | (angles[:, 0] >= 90) | (np.abs(angles[:, 1]) > 90)
    if wrong.any():
        found = f"{angles[wrong][0, 0]:g}, {angles[wrong][0, 1]:g}"
        raise InputError(path, "angles out of range", found=found, accepted="incidences 0 to 90, views -90 to 90")
    return wavelength, angles, table[:, 2:]


def _check_side(path: Path, incidence: float, view: Array, shadowed: NDArray[np.bool_]) -> None:
    """The detector shades the sample when it stands before the source, thus on its side."""
    if incidence > 0 and shadowed.any() and view[shadowed].mean() > 0:
        found = f"rows of 0 at views about {view[shadowed].mean():g} for {incidence:g} degree of incidence"
        accepted = "positive views on the side of the mirror direction"
        raise InputError(
            path, "the shadow of the detector is not on the side of the source", found=found, accepted=accepted
        )


def _about_mirror(incidence: float, theta_s: Array, view: Array, measured: Array) -> tuple[Array, NDArray[np.int8]]:
    """Values (θ_s, φ_s, wavelength) of one incidence, and their quality."""
    seen = ~(measured == 0).all(axis=1)

    def at(views: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Values in the plane, and which views are outside those of the file."""
        values = np.stack([np.interp(views, view[seen], column) for column in measured[seen].T], axis=-1)
        return values, (views < view[seen][0] - _SAME) | (views > view[seen][-1] + _SAME)

    theta, phi = np.meshgrid(theta_s, _AZIMUTHS, indexing="ij")
    theta_o, phi_o = from_mirror(np.full_like(theta, incidence), 0.0, theta, phi)
    tilt = half_angles(np.full_like(theta, incidence), np.zeros_like(theta), theta_o, phi_o)["theta_h"]
    (near, before), (far, beyond) = at(incidence - 2 * tilt), at(incidence + 2 * tilt)
    # Beyond the last view the side towards the normal stands for both: to hold the last value would draw a lobe out to the horizon.
    far = np.where(beyond[..., None], near, far)
    share = (phi / 180)[..., None]
    in_plane = np.where(phi == 0, incidence - theta, incidence + theta)
    outside = np.where(phi == 0, before, beyond)
    place = np.interp(in_plane, view, np.arange(view.size))
    known = seen[np.floor(place + _SAME).astype(int)] & seen[np.ceil(place - _SAME).astype(int)]
    quality = np.where(known, vocabulary.quality("measured"), vocabulary.quality("interpolated"))
    # At the mirror direction itself all azimuths are one direction.
    beside = (phi > 0) & (phi < 180) & (theta > 0)
    quality = np.where(outside | beside, vocabulary.quality("extrapolated"), quality)
    return (1 - share) * near + share * far, quality.astype(np.int8)
