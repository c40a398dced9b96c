"""The certificate of an etalon: ``certificate.yaml`` and the table it may name."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np

from brdfpipe import documents, installation
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.geometry import Array

COLUMNS = ("wavelength", "reflectance_factor", "u")
"""Of a table: nm, π times the BRDF at 0 degree, its relative standard uncertainty."""

DEPARTURE, AT = 0.05, 60.0
"""Relative standard uncertainty of the shape of an etalon of which the certificate does not tell it, at this angle [degree]; it grows with
the square of the angle.

Diffuse standards are no Lambertian ones, as is often believed of them: pressed and sintered PTFE, opal glass and ceramics lit at normal
incidence lose some percent towards 60°, and ten and more towards grazing, each its own (Weidner & Hsia 1981, Höpe & Hauer 2010). The
etalon that stands for them in the emulator loses as much as this.

References
----------
Weidner & Hsia 1981 (J. Opt. Soc. Am. 71, 856); Höpe & Hauer 2010 (Metrologia 47, 295).
"""

_EVERYWHERE = (100.0, 20000.0)
"""Wavelengths that a certificate with one number covers [nm]."""


class CertificateError(BrdfpipeError):
    """The certificate does not say what is asked of it."""


@dataclass(frozen=True)
class Certificate:
    """What a calibration laboratory says of an etalon lit at normal incidence."""

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

    @classmethod
    def load(cls, path: str | Path) -> Certificate:
        """Read ``certificate.yaml`` and the table it names.

        Raises
        ------
        InputError : naming the file, the line, what stands there and what could.
        """
        path = Path(path)
        content = documents.read(path, installation.project_folder() / "config" / "schemas" / "certificate.schema.yaml")
        told = content["reflectance_factor"]
        if isinstance(told, dict):
            home = "the certificate's folder"
            table = read_table(documents.file_beside(path, told["file"], "reflectance_factor.file", home))
        else:
            table = np.array([[wavelength, told, content["u"]] for wavelength in _EVERYWHERE])
        angles = np.array([_angle(each, content["u"]) for each in content["angles"]])
        if angles[0, 0] != 0 or (np.diff(angles[:, 0]) <= 0).any():
            accepted = "[[0, 1], [30, 0.99], …], rising from 0 degree"
            raise InputError(path, "the angles do not rise from 0", where="angles", accepted=accepted)
        if not angles[0, 1] > 0:
            raise InputError(path, "no light at 0 degree", where="angles", found=angles[0, 1], accepted="1")
        return cls(
            identity=content["id"],
            valid_until=_date(path, content["valid_until"], "valid_until"),
            wavelength=table[:, 0],
            reflectance_factor=table[:, 1],
            u=table[:, 2],
            theta=angles[:, 0],
            shape=angles[:, 1] / angles[0, 1],
            shape_u=angles[:, 2],
        )

    def brdf(self, wavelength: Array, theta: Array) -> tuple[Array, Array]:
        """BRDF [1/sr] and its relative standard uncertainty, (wavelength, theta) and (wavelength,); linear in between.

        Beyond its last angle the etalon is taken as it is there; :meth:`shape_u_at` says how far that may be off.

        Raises
        ------
        CertificateError : a wavelength the certificate does not cover.
        """
        low, high = self.wavelength[0], self.wavelength[-1]
        if wavelength.min() < low or wavelength.max() > high:
            raise CertificateError(
                f"the certificate {self.identity} covers {low:g} to {high:g} nm, the etalon was measured from "
                f"{wavelength.min():g} to {wavelength.max():g} nm; leave wavelengths out of the plan, or have it extended"
            )
        height = np.interp(wavelength, self.wavelength, self.reflectance_factor) / np.pi
        return height[:, None] * np.interp(theta, self.theta, self.shape), np.interp(
            wavelength, self.wavelength, self.u
        )

    def shape_u_at(self, theta: Array) -> Array:
        """Relative standard uncertainty of the BRDF over that at 0 degree, (theta,) [degree]: linear between the angles that are stated, and
        beyond the last one as far as such etalons depart from what they are there."""
        beyond = DEPARTURE * np.maximum(theta**2 - self.theta[-1] ** 2, 0.0) / AT**2
        return np.asarray(np.hypot(np.interp(theta, self.theta, self.shape_u), beyond))


def _angle(told: list[float], u: float) -> list[float]:
    """Angle, ratio and its relative standard uncertainty: where none is stated that of the reflectance factor, of which the ratio is made;
    at 0 degree there is none."""
    return told if len(told) == 3 else [*told, u if told[0] > 0 else 0.0]


def read_table(path: Path) -> Array:
    """The columns :data:`COLUMNS` of a CSV file; lines with # are comments.

    Raises
    ------
    InputError : naming the line, what stands there and what could.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(path, "not UTF-8 text", where=f"byte {error.start}", accepted="a CSV file") from error
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if _says_something(line)]
    rows = list(csv.reader(io.StringIO("\n".join(line for _, line in lines))))
    if not rows or tuple(cell.strip() for cell in rows[0]) != COLUMNS:
        where, found = (f"line {lines[0][0]}", lines[0][1][:80]) if lines else (None, "nothing")
        accepted = ", ".join(COLUMNS)
        raise InputError(path, "the titles are not those of a certificate", where=where, found=found, accepted=accepted)
    table = np.array([_row(path, number, row) for (number, _), row in zip(lines[1:], rows[1:], strict=True)])
    if len(table) < 2 or (np.diff(table[:, 0]) <= 0).any():
        raise InputError(path, "the wavelengths do not rise", accepted="two lines or more, in nm, rising")
    return table


def _says_something(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _row(path: Path, number: int, row: list[str]) -> list[float]:
    try:
        values = [float(cell) for cell in row]
    except ValueError:
        values = []
    good = len(values) == len(COLUMNS) and 100 <= values[0] <= 20000 and 0 < values[1] <= 2 and 0 <= values[2] <= 1
    if not good:
        accepted = (
            "a wavelength in nm, a reflectance factor above 0 and at most 2, and a relative uncertainty from 0 to 1"
        )
        raise InputError(path, "no line of a certificate", where=f"line {number}", found=row, accepted=accepted)
    return values


def _date(path: Path, text: str, key: str) -> date:
    try:
        return date.fromisoformat(text)
    except ValueError as error:
        raise InputError(path, "no date", where=key, found=repr(text), accepted='"2027-06-30"') from error
