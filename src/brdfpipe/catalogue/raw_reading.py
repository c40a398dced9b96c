"""What the raw files of a material hold, read as the build reads them; nothing is computed from them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.catalogue.catalogue import Catalogue
from brdfpipe.catalogue.format_checks import check_flakes
from brdfpipe.catalogue.material import BASE_INDEX, OTHER_FACES, Material
from brdfpipe.errors import BrdfpipeError, InputError, abbreviated, naming_key, naming_origin, plain, shortened
from brdfpipe.stages import STAGES, Subject

_READ_BY = {"table": "imported"}
"""Part of a description → stage that reads its file, where the names differ."""

_MOST_WORDS = 160
_MOST_COLUMNS = 8


def describe_files(catalogue: Catalogue, material: Material) -> list[str]:
    """Read every raw file of a material; a line for each file, and below it one for each correction and each warning.

    The frames of a rig are left out: the build reads them.

    Raises
    ------
    InputError : the first file that the build will refuse; scans that it will refuse to count together.
    """
    with naming_origin(material.inherited):
        return _described(catalogue, material)


def _described(catalogue: Catalogue, material: Material) -> list[str]:
    lines: list[str] = []
    scans: list[xr.Dataset] = []
    for part, path in material.files.items():
        if part.startswith("texture-"):
            lines += _picture_words(material, path)
            continue
        if part in ("rig", "mask", "spectrum_sce"):  # frames; the others are read with their map or spectrum
            continue
        name, _, number = part.partition("-")
        stage = STAGES[_READ_BY.get(name, "scan" if number else name)]
        spec = stage.parameters(Subject(material, catalogue.config), {"scan": number} if number else {})
        beside = material.files.get({"surface": "mask", "spectrum": "spectrum_sce"}.get(part, ""))
        dataset = _read(name, path, spec, beside, "coat" if material.has("coat") else "slab")
        lines += _words(path, name, dataset)
        if name == "surface":
            scans.append(dataset)
        if name == "multiangle":
            check_flakes(dataset, material)
        if name in ("index", "base_index"):
            _check_absorption(dataset, name, material, path)
    if scans:
        _check_scans(catalogue, material, scans)
        _check_grain(material, scans[0])
    return lines


def _picture_words(material: Material, path: Path) -> Iterator[str]:
    from brdfpipe.texture.picture_reading import read_picture

    keys = material.content["texture"]
    picture = read_picture(path, keys.get("curve"))
    values = picture.values
    millimetres = " × ".join(plain(count * keys["pixel"] / 1000) for count in reversed(values.shape))
    counts = " × ".join(str(count) for count in reversed(values.shape))
    light = f"light from {values.min():.3g} to {values.max():.3g}, {values.mean():.3g} in the mean"
    yield f"{path.name}: picture of {counts} pixels, {millimetres} mm of the sample, {picture.stored}, {light}"
    yield from (f"  warning: {text.removeprefix(f'{path.name}: ')}" for text in picture.warnings)


def _read(part: str, path: Path, spec: dict[str, Any], beside: Path | None, body: str) -> xr.Dataset:
    """The dataset of a file, by the function of the stage that reads it; ``body`` is the key of what has an interior."""
    from brdfpipe.exchange.reading import read as read_table
    from brdfpipe.flakes.reading import ingest as read_colours
    from brdfpipe.optics.index import refractive_index
    from brdfpipe.optics.interior import ingest as read_interior
    from brdfpipe.spectra.ingestion import ingest as read_spectrum
    from brdfpipe.surfaces.reading import ingest as read_surface

    if part in ("index", "base_index"):
        with naming_key(BASE_INDEX if part == "base_index" else "index", "index"):
            return refractive_index(spec["index"], path, uncertainty=spec.get("index_uncertainty"))
    if part == "table":
        return read_table(path, **spec)
    if part == "spectrum":
        return read_spectrum(spec, path, excluded=beside)
    if part == "interior":
        with naming_key(body, "slab"):
            return read_interior(spec, path)
    if part == "multiangle":
        return read_colours(spec, path)
    with naming_key(OTHER_FACES.get(part.removesuffix("_surface"), "surface"), "surface"):
        return read_surface(path, spec, beside)


def _check_absorption(index: xr.Dataset, part: str, material: Material, path: Path) -> None:
    """Refuse an index that absorbs where the models of sheets and coats need a real one."""
    largest = float(index["k"].max())
    if largest <= 0:
        return
    found = f"k up to {largest:g}"
    for body in ("slab", "coat"):
        if part == "index" and material.has(body):
            accepted = f"k = 0, and the absorption in `{body}`"
            raise InputError(path, f"the index of the {body} absorbs", found=found, accepted=accepted, key="index.file")
    if part == "base_index" and "spectrum" in material.content:
        problem, accepted = "light does not come back from below the face of a metal", "k = 0, or no `spectrum`"
        raise InputError(path, problem, found=found, accepted=accepted, key=f"{BASE_INDEX}.file")


def _check_scans(catalogue: Catalogue, material: Material, scans: list[xr.Dataset]) -> None:
    """Refuse what the stage of the facets will refuse for the scans' kind, direction or bandwidth."""
    from brdfpipe.facets.estimation import check_scans

    try:
        check_scans(scans, **STAGES["facets"].parameters(Subject(material, catalogue.config)))
    except BrdfpipeError as refusal:
        raise InputError(material.files["surface"], str(refusal)) from None


def _check_grain(material: Material, surface: xr.Dataset) -> None:
    """Refuse what the stage of the texture will refuse for the scan's extent, pitch or gaps."""
    from brdfpipe.texture.height_pixels import check_pixel

    if "texture" in material.content:
        try:
            check_pixel(surface, material.content["texture"]["pixel"])
        except BrdfpipeError as refusal:
            raise InputError(material.files["surface"], str(refusal)) from None


def _words(path: Path, part: str, dataset: xr.Dataset) -> Iterator[str]:
    yield shortened(f"{path.name}: {_content(dataset)}", _MOST_WORDS)
    titles = _titles(path) if part == "spectrum" else ""
    if titles:
        yield f"  {titles}"
    # A reader's line may name the file itself.
    history = [line.removeprefix(f"{path.name}: ") for line in dataset.attrs.get("history", "").splitlines() if line]
    yield from (f"  {shortened(line, _MOST_WORDS)}" for line in history)
    yield from (f"  warning: {text.removeprefix(f'{path.name}: ')}" for text in vocabulary.warnings(dataset))


def _titles(path: Path) -> str:
    """Titles of the columns of a text file of a spectrum; empty for other files."""
    from brdfpipe.columns import TEXT_SUFFIXES, read_columns

    if path.suffix.lower() not in TEXT_SUFFIXES:
        return ""
    try:
        names = read_columns(path).names
    except BrdfpipeError:  # rows of samples, which are no columns
        return ""
    return f"columns: {abbreviated([name or '(no title)' for name in names], _MOST_COLUMNS)}" if names else ""


def _content(dataset: xr.Dataset) -> str:
    """What a dataset holds, in a line."""
    if dataset.attrs["kind"] == "surface":
        return relief_words(dataset)
    spectral = [
        name
        for name, values in dataset.data_vars.items()
        if values.dims == ("wavelength",) and not str(name).endswith("_u")
    ]
    if dataset.attrs["kind"] in ("spectrum", "index", "interior") and spectral:
        nm, values = dataset["wavelength"].values, dataset[spectral[0]].values
        label = str(dataset[spectral[0]].attrs.get("long_name", spectral[0]))
        if dataset.attrs.get("geometry") == "sce":
            label = "reflectance without the specular component"
        known = ", with its uncertainty" if f"{spectral[0]}_u" in dataset else ""
        geometry = (
            f", {dataset.attrs['geometry']} at {dataset.attrs['theta_i']:g}°" if "geometry" in dataset.attrs else ""
        )
        return (
            f"{label} from {values.min():.4g} to {values.max():.4g} at {nm.size} wavelengths from {nm[0]:g} to {nm[-1]:g} nm"
            f"{geometry}{known}"
        )
    sizes = ", ".join(f"{size} × {str(dim).replace('_', ' ')}" for dim, size in dataset.sizes.items())
    return f"{dataset.attrs['kind']} of {sizes}"


def relief_words(surface: xr.Dataset) -> str:
    """Size, pitch, extent and range of the heights of a surface, in a line."""
    height = surface["height"].values
    pitches = [surface.attrs[f"pitch_{dim}"] for dim in reversed(surface["height"].dims)]
    counts = " × ".join(str(count) for count in reversed(height.shape))
    pitch = " × ".join(plain(value, 4) for value in pitches)
    extent = " × ".join(plain(value * count, 4) for value, count in zip(pitches, reversed(height.shape), strict=True))
    missing = float(np.isnan(height).mean())
    return (
        f"{'line' if height.ndim == 1 else 'map'} of {counts} heights, pitch {pitch} µm, extent {extent} µm, levelled heights from "
        f"{plain(np.nanmin(height), 4)} to {plain(np.nanmax(height), 4)} µm, {missing:.2%} missing"
    )
