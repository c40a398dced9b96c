"""Time to build clear sheets, on one core, beside the time of exponentials.

Usage: python benchmarks/sheets.py
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np
import xarray as xr

from brdfpipe import psd
from brdfpipe.bsdf import slab
from brdfpipe.facets.analytic_distributions import analytic, flat

WAVELENGTHS = np.linspace(400.0, 700.0, 41)
COLOURED = xr.DataArray(np.linspace(0.1, 0.95, 41), dims="wavelength", coords={"wavelength": WAVELENGTHS})


def rough(a: float) -> xr.Dataset:
    """Facets of a Beckmann density; flat for a = 0."""
    return analytic("beckmann", a) if a else flat()


def facets(front: float, back: float, inside: float | xr.DataArray) -> xr.Dataset:
    """A sheet of facets; equal faces are one dataset."""
    first = rough(front)
    return slab.build(first, first if back == front else rough(back), index=1.5, internal_transmittance=inside)


def film(sigma: float, length: float) -> xr.Dataset:
    """A film of equal faces with waves; lengths in um."""
    relief, spectrum = analytic("beckmann", 2 * sigma / length), psd.analytic("gaussian", sigma=sigma, length=length)
    return slab.build(relief, relief, index=1.5, internal_transmittance=0.95, front_psd=spectrum, back_psd=spectrum)


CASES: Mapping[str, Callable[[], xr.Dataset]] = {
    "facets a = 0.3, both faces": lambda: facets(0.3, 0.3, 0.8),
    "facets a = 0.3, smooth back": lambda: facets(0.3, 0, 0.8),
    "facets a = 0.3 and 0.1": lambda: facets(0.3, 0.1, 0.8),
    "facets a = 0.1, both faces": lambda: facets(0.1, 0.1, 0.9),
    "facets a = 0.05, both faces": lambda: facets(0.05, 0.05, 0.9),
    "facets a = 0.3, both faces, 41 wavelengths": lambda: facets(0.3, 0.3, COLOURED),
    "facets a = 0.3 and 0.1, 41 wavelengths": lambda: facets(0.3, 0.1, COLOURED),
    "waves, sigma = 0.05 um, 2 um, both faces": lambda: film(0.05, 2.0),
}


def main() -> None:
    """Print processor seconds, and their ratio to exponentials of four million numbers."""
    slab.build(flat(), flat(), index=1.5)
    numbers = np.random.default_rng(0).random(4_000_000)
    for name, build in CASES.items():
        start = time.process_time()
        for _ in range(10):
            np.exp(numbers)
        unit = (time.process_time() - start) / 10
        start = time.process_time()
        build()
        seconds = time.process_time() - start
        print(f"{name:45s} {seconds:6.2f} s {seconds / unit:7.0f} exponentials of 4 million", flush=True)


if __name__ == "__main__":
    main()
