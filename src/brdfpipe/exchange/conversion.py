"""From any file of a BSDF to any other: this package's netCDF, and the formats of other programs."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import store, vocabulary
from brdfpipe.errors import InputError
from brdfpipe.exchange import registry
from brdfpipe.exchange.reading import read
from brdfpipe.exchange.registry import ExchangeError, Format
from brdfpipe.exchange.specular_shares import stated_beside

NETCDF = ".nc"


def open_bsdf(path: str | os.PathLike[str], format: str | None = None, quantity: str | None = None) -> xr.Dataset:
    """The BSDF of a netCDF file of this package, or of a file of another program; light in single directions that Integra keeps in a file beside is a warning.

    Parameters
    ----------
    path : the file
    format, quantity : of a file of another program, see :func:`brdfpipe.exchange.reading.read`

    Raises
    ------
    InputError, StoreError : the file cannot be read, or is no BSDF.
    """
    if Path(path).suffix.lower() != NETCDF:
        # A stage of a build reads the files that the description names, and none beside them.
        return vocabulary.add_warning(read(path, format, quantity=quantity), *stated_beside(Path(path)))
    if format is not None or quantity is not None:
        raise InputError(Path(path), "a netCDF file states its own format and quantity", found=format or quantity)
    return store.open_dataset(path, "bsdf")


def convert(
    bsdf: xr.Dataset,
    path: str | os.PathLike[str],
    format: str | None = None,
    *,
    wavelengths: Sequence[float] = (),
    inputs: Mapping[str, str | os.PathLike[str]] | None = None,
    **options: Any,
) -> Mapping[str, Any]:
    """Write a BSDF as netCDF (``.nc``), or in a format of another program.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    path, format, options : see :func:`brdfpipe.exchange.registry.write`
    wavelengths : of the files [nm], increasing, within those of the BSDF; by default all of a file with a spectrum
    inputs : name → raw file from which the BSDF comes, for the provenance of a netCDF file

    Returns
    -------
    The record of the file: its error and what it leaves out, see :mod:`brdfpipe.exchange.records`; empty for netCDF, which leaves nothing out

    Raises
    ------
    ExchangeError : the format or an option is unknown, or the format does not take such a BSDF.
    """
    written_as = target(path, format, wavelengths=wavelengths, **options)
    if len(wavelengths):
        bsdf = at_given_wavelengths(bsdf, wavelengths)
    if written_as is None:
        material = str(bsdf.attrs.get("material", Path(path).stem))
        store.save_dataset(bsdf, path, stage="convert", material=material, inputs=inputs)
        return {}
    declared, writer, options = written_as
    return declared.run(writer, bsdf, path, options)


def target(
    path: str | os.PathLike[str], format: str | None = None, *, wavelengths: Sequence[float] = (), **options: Any
) -> tuple[Format, str, dict[str, Any]] | None:
    """The format of a file to be written, its writer and all options; None of netCDF. Needs no BSDF, so that a mistake is named before one is read.

    Raises ExchangeError: the format or an option is unknown, or the format has no wavelengths; parameters as of :func:`convert`.
    """
    if Path(path).suffix.lower() == NETCDF and format is None:
        if options:
            raise ExchangeError(
                f"{Path(path).name}: netCDF has no option {next(iter(options))!r}; it holds the BSDF itself"
            )
        return None
    declared, writer = registry.writer_of(path, format)
    if len(wavelengths):
        if "spectrum" not in declared.carries:
            known = ", ".join(name for name in registry.WRITTEN if "spectrum" in registry.FORMATS[name].carries)
            raise ExchangeError(f"{declared.name}: the format has no wavelengths; accepted: {known}, or netCDF")
        options = {**declared.spectral, **options}
    declared.keywords(options)
    return declared, writer, options


def at_given_wavelengths(bsdf: xr.Dataset, wavelengths: Sequence[float]) -> xr.Dataset:
    """The BSDF at some wavelengths alone [nm], each between its own by linear interpolation, as everywhere.

    Raises ExchangeError: the BSDF has no wavelengths, or these do not increase or are out of its range.
    """
    wanted = np.asarray(wavelengths, dtype=float)
    if "wavelength" not in bsdf.coords:
        raise ExchangeError("the BSDF does not depend on wavelength; leave the wavelengths out")
    own = bsdf["wavelength"].values
    if not (
        np.isfinite(wanted).all() and (np.diff(wanted) > 0).all() and own[0] <= wanted[0] and wanted[-1] <= own[-1]
    ):
        listed = ", ".join(f"{one:g}" for one in wanted[:8])
        raise ExchangeError(f"wavelengths {listed} nm; accepted: increasing ones from {own[0]:g} to {own[-1]:g} nm")
    return bsdf.interp(wavelength=wanted)
