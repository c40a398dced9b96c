"""The certificate of an etalon: ``certificate.yaml`` and the table it may name."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np

from brdfpipe import documents
from brdfpipe.descriptions import reading
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.geometry import Array
from brdfpipe.rig.description import read_csv
from brdfpipe.rig.reduction.certificate_keys import CertificateKeys

COLUMNS = ("wavelength", "reflectance_factor", "u")
"""Columns of the table: nm, π times the BRDF at 0 degree, its relative standard uncertainty."""

SHAPE_U, SHAPE_U_ANGLE = 0.05, 60.0
"""Relative standard uncertainty of an etalon's shape without certified ratios, at this angle [degree]; it grows with the square of the angle.

Diffuse standards are not Lambertian: at normal incidence pressed and sintered PTFE, opal glass and ceramics lose some percent towards 60°,
and ten and more towards grazing (Weidner & Hsia 1981, J. Opt. Soc. Am. 71, 856; Höpe & Hauer 2010, Metrologia 47, 295).
"""

_GRAZING = 89.0  # angle from the normal up to which a cell may see the etalon [degree]
_ALL_WAVELENGTHS = (100.0, 20000.0)  # wavelengths that a certificate with one number covers [nm]


class CertificateError(BrdfpipeError):
    """The certificate does not cover the measurement."""


@dataclass(frozen=True)
class Certificate:
    """The certified BRDF of an etalon lit at normal incidence."""

    identity: str
    valid_until: date
    wavelength: Array
    """Nanometres, rising."""
    reflectance_factor: Array
    """π times the BRDF at 0 degree."""
    u: Array
    """Relative standard uncertainty."""
    theta: Array
    """Degree, rising from 0."""
    shape: Array
    """BRDF over that at 0 degree, at theta."""
    shape_u: Array
    """Its relative standard uncertainty."""
    tilt_u: float = 0.0
    """Root mean square angle of the etalon's normal, anywhere on it, from the direction of the light [degree]."""

    @classmethod
    def load(cls, path: str | Path) -> Certificate:
        """Read ``certificate.yaml`` and the table it names.

        Raises
        ------
        InputError : naming the file, the line, what was found and what is accepted.
        """
        path = Path(path)
        content = reading.read(path, CertificateKeys)
        factor = content["reflectance_factor"]
        if isinstance(factor, dict):
            table = read_table(
                documents.file_beside(path, factor["file"], "reflectance_factor.file", "the certificate's folder")
            )
        else:
            table = np.array([[wavelength, factor, content["u"]] for wavelength in _ALL_WAVELENGTHS])
        # A ratio without an uncertainty has that of the reflectance factor; at 0 degree the ratio is exactly 1.
        default = [[content["u"] if entry[0] > 0 else 0.0] for entry in content["angles"]]
        angles = np.array([[*entry, *u][:3] for entry, u in zip(content["angles"], default, strict=True)])
        if angles[0, 0] != 0 or (np.diff(angles[:, 0]) <= 0).any():
            accepted = "[[0, 1], [30, 0.99], …], increasing from 0 degree"
            raise InputError(path, "the angles do not increase from 0", where="angles", accepted=accepted)
        if not angles[0, 1] > 0:
            raise InputError(
                path, "the ratio at 0 degree is not above 0", where="angles", found=angles[0, 1], accepted="1"
            )
        return cls(
            identity=content["id"],
            valid_until=_date(path, content["valid_until"], "valid_until"),
            wavelength=table[:, 0],
            reflectance_factor=table[:, 1],
            u=table[:, 2],
            theta=angles[:, 0],
            shape=angles[:, 1] / angles[0, 1],
            shape_u=angles[:, 2],
            tilt_u=content["tilt_u"],
        )

    def brdf(self, wavelength: Array, theta: Array) -> tuple[Array, Array]:
        """BRDF [1/sr] and its relative standard uncertainty, (wavelength, theta) and (wavelength,); linear in between.

        Beyond the last certified angle its ratio is used, with the uncertainty of :meth:`shape_u_at`.

        Raises CertificateError: the certificate does not cover a wavelength.
        """
        low, high = self.wavelength[0], self.wavelength[-1]
        if wavelength.min() < low or wavelength.max() > high:
            raise CertificateError(
                f"the certificate {self.identity} covers {low:g} to {high:g} nm, the etalon was measured from "
                f"{wavelength.min():g} to {wavelength.max():g} nm; remove wavelengths from the plan, or have the certificate extended"
            )
        height = np.interp(wavelength, self.wavelength, self.reflectance_factor) / np.pi
        u = np.interp(wavelength, self.wavelength, self.u)
        return height[:, None] * np.interp(theta, self.theta, self.shape), u

    def shape_u_at(self, theta: Array) -> Array:
        """Relative standard uncertainty of the BRDF over that at 0 degree, (theta,) [degree]: linear between the certified
        angles; beyond the last one it grows by :data:`SHAPE_U`."""
        beyond = SHAPE_U * np.maximum(theta**2 - self.theta[-1] ** 2, 0.0) / SHAPE_U_ANGLE**2
        return np.asarray(np.hypot(np.interp(theta, self.theta, self.shape_u), beyond))

    def tilt_error(self, theta: Array) -> Array:
        """Relative standard uncertainty by the normal of the etalon, (theta,) [degree]: of the cosine of view, in any azimuth; none beyond the horizon."""
        slope = np.where(theta < _GRAZING, np.tan(np.radians(np.minimum(theta, _GRAZING))), 0.0)
        return np.asarray(slope * np.radians(self.tilt_u) / np.sqrt(2))


def read_table(path: Path) -> Array:
    """The columns :data:`COLUMNS` of a CSV file; lines with # are comments.

    Raises InputError: naming the line, what was found and what is accepted.
    """
    rows = read_csv(path)
    where, titles = rows.pop(0) if rows else (None, ["nothing"])
    if titles != list(COLUMNS):
        found, accepted = ",".join(titles)[:80], ", ".join(COLUMNS)
        raise InputError(path, "wrong column titles", where=where, found=found, accepted=accepted)
    table = np.array([_row(path, where, cells) for where, cells in rows])
    if len(table) < 2 or (np.diff(table[:, 0]) <= 0).any():
        raise InputError(path, "the wavelengths do not increase", accepted="two lines or more, in nm, increasing")
    return table


def _row(path: Path, where: str, cells: list[str]) -> list[float]:
    try:
        values = [float(cell) for cell in cells]
    except ValueError:
        values = []
    if not (len(values) == len(COLUMNS) and 100 <= values[0] <= 20000 and 0 < values[1] <= 2 and 0 <= values[2] <= 1):
        accepted = "a wavelength in nm, a reflectance factor above 0 and at most 2, a relative uncertainty from 0 to 1"
        raise InputError(path, "not an accepted line", where=where, found=cells, accepted=accepted)
    return values


def _date(path: Path, text: str, key: str) -> date:
    try:
        return date.fromisoformat(text)
    except ValueError as error:
        raise InputError(path, "not a date", where=key, found=repr(text), accepted='"2027-06-30"') from error
