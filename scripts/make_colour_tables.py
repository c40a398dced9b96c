"""Write the colour-matching functions, illuminants and basis spectra that brdfpipe ships, from the colour-science package.

Run ``python scripts/make_colour_tables.py`` after a change here; a test compares the shipped files with what this writes.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

TABLES = Path(__file__).parents[1] / "src" / "brdfpipe" / "spectra" / "tables"
WAVELENGTH = np.arange(360, 781, 5)
OBSERVERS = {"2": "CIE 1931 2 Degree Standard Observer", "10": "CIE 1964 10 Degree Standard Observer"}
ILLUMINANTS = ("D65", "A", "D50", "C", "E", "FL2", "LED-B3")
BASIS = ("red", "green", "blue", "cyan")


def main() -> None:
    """Write the tables."""
    TABLES.mkdir(exist_ok=True)
    for name, text in tables().items():
        (TABLES / name).write_bytes(text.encode("ascii"))


def tables() -> dict[str, str]:
    """File name → content of each table."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # colour-science warns about every optional package that is absent
        import colour

        matching = [colour.MSDS_CMFS[title][WAVELENGTH] for title in OBSERVERS.values()]
        power = [_power(colour.SDS_ILLUMINANTS[name]) for name in ILLUMINANTS]
        basis = [_reflectance(colour.recovery.SDS_SMITS1999[name]) for name in BASIS]
        version = colour.__version__
    observers = [f"{axis}{observer}" for observer in OBSERVERS for axis in "xyz"]
    return {
        "cmf.csv": _csv(
            "CIE 1931 2 degree and CIE 1964 10 degree colour-matching functions (CIE 15:2018), every 5 nm",
            version,
            observers,
            np.hstack(matching),
        ),
        "illuminants.csv": _csv(
            "Relative spectral power of CIE illuminants (CIE 15:2018), every 5 nm; 0 where CIE gives no value",
            version,
            list(ILLUMINANTS),
            np.stack(power, axis=1),
        ),
        "basis.csv": _csv(
            "Four basis reflectances of Smits 1999 (J. Graphics Tools 4, 11), straight between the centres of its ten bins, peak 1",
            version,
            list(BASIS),
            np.stack(basis, axis=1),
        ),
    }


def _power(illuminant: object) -> np.ndarray:
    known = dict(zip(illuminant.wavelengths, illuminant.values, strict=True))  # type: ignore[attr-defined]
    return np.array([known.get(float(wavelength), 0.0) for wavelength in WAVELENGTH])


def _reflectance(bins: object) -> np.ndarray:
    values = np.interp(WAVELENGTH, bins.wavelengths, bins.values)  # type: ignore[attr-defined]
    return values / values.max()


def _csv(title: str, version: str, names: list[str], values: np.ndarray) -> str:
    lines = [f"# {title}", f"# Made by scripts/make_colour_tables.py from colour-science {version} (BSD-3-Clause)"]
    lines.append(",".join(["wavelength_nm", *names]))
    for wavelength, row in zip(WAVELENGTH, values, strict=True):
        lines.append(",".join([str(wavelength), *(f"{value:.8g}" for value in row)]))
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
