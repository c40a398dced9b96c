"""Section of a material's page on the visible structure beside the BRDF: a tile, its spectrum, and how it fits the BRDF."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import xarray as xr

from brdfpipe.errors import plain
from brdfpipe.report.cards import Section, Table
from brdfpipe.report.formatting import number
from brdfpipe.report.plots.raster import ColourMap, false_colour, framed, viridis
from brdfpipe.report.plots.raster import light as grey
from brdfpipe.report.plots.svg import WIDTH, Array, Axis, Figure, Line, chart, frame, image, legend, linear_ticks, png
from brdfpipe.texture.height_pixels import central_slopes, unit_normals

_LIGHTS = {"spot": "Under a spot at 45as15", "diffuse": "In diffuse light"}
_PICTURE = 400
"""Side of a picture in figure units."""
_SHOWN = 400
"""Pixels of a tile along a side of its figure, at most."""
_MILLIMETRES = 2000.0
"""Side from which on axes are in mm [µm]."""
_LIGHT = np.array([-0.5, 0.5, np.sqrt(0.5)])
"""Direction to the light of the shaded tile."""
_LEAST_SHARE = 1e-4
"""Smaller differences are rounding, or mean nothing beside the others."""
_LEAST = 1e-8
"""Of the largest power: less is not drawn."""


def texture_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """The tile and its spectrum; empty where the scene asks for no texture."""
    section = Section("Visible structure")
    if (pictured := datasets.get("picture_texture")) is not None:
        section.figures += _seen(datasets.get("texture_preview"))
        section.figures += [
            figure for number in range(pictured.sizes["geometry"]) for figure in _of_picture(pictured, number)
        ]
        section.tables.append(_sparkles(pictured))
        return section
    if (texture := datasets.get("texture")) is None:
        return section
    section.figures += [*_seen(datasets.get("texture_preview")), _relief(texture), _tile(texture), _spectra(texture)]
    section.tables.append(_numbers(texture, datasets.get("unresolved")))
    if "level_pixel" in texture:
        section.tables.append(_levels(texture))
    return section


def _seen(preview: xr.Dataset | None) -> Iterator[Figure]:
    """The structure as an eye sees it from a distance, in each light."""
    if preview is None:
        return
    pictures = [(str(preview.attrs["light"]), preview["picture"].values)]
    if "picture_in" in preview:
        pictures += zip(preview["light_of"].values.tolist(), preview["picture_in"].values, strict=True)
    width, distance = float(preview.attrs["picture_width"]), float(preview.attrs["viewing_distance"])
    for (light, pixels), contrast in zip(pictures, np.atleast_1d(preview.attrs["contrast"]), strict=True):
        title = f"{_LIGHTS[light]}, from {distance:g} m"
        shown = image(png(pixels), (WIDTH - _PICTURE) / 2, 0, _PICTURE, _PICTURE, smooth=True)
        svg = frame(f"A panel {title[0].lower()}{title[1:]}, {width:.3g} mm along a side", _PICTURE, [shown])
        note = (
            f"{width:.3g} mm along a side, as an eye sees it that resolves one minute of arc: two pixels of the picture. Contrast: {100 * contrast:.2g} % rms. A white diffuser "
            f"has {100 * float(preview.attrs['white_level']):.0f} % of the screen's white."
        )
        yield Figure(title, svg, note=note)


def _picture(
    texture: xr.Dataset, values: Array, title: str, unit: str, note: str, colours: ColourMap = viridis
) -> Figure:
    """A part of a tile (rows, columns), the lower row first; the colours span the central 99 % of its values."""
    shown = values[:_SHOWN, :_SHOWN].astype(float)
    extent = shown.shape[0] * float(texture.attrs["pixel"])
    low, high = np.percentile(shown, [0.5, 99.5]).tolist()
    high = max(high, low + 1e-3 * max(abs(low), abs(high), 1e-9))
    scale, length = (1000.0, "mm") if extent >= _MILLIMETRES else (1.0, "µm")
    svg, _ = framed(
        f"{title}, {plain(extent, 4)} micrometres along a side",
        png(*false_colour(shown, low, high, colours=colours)),
        (f"x, {length}", 0.0, extent / scale),
        (f"y, {length}", 0.0, extent / scale),
        unit,
        [((value - low) / (high - low), name) for value, name in linear_ticks(low, high, count=5)],
        colours=colours,
    )
    whole = "The whole tile" if shown.shape == values.shape else "A part of the tile"
    return Figure(title, svg, note=f"{whole}; it repeats without a border. {note}")


def _tile(texture: xr.Dataset) -> Figure:
    note = "The colours span the central 99\u202f%."
    return _picture(texture, texture["height"].values, "Height map, tileable", "µm", note)


def _relief(texture: xr.Dataset) -> Figure:
    slopes = central_slopes(texture["height"].values.astype(float), float(texture.attrs["pixel"]))
    light = unit_normals(*slopes) @ _LIGHT / _LIGHT[2]
    note = "Shaded as if it were matt and grey, by light from the upper left at 45°: for the shapes of the grain, not for its gloss."
    return _picture(texture, light, "Grain of the tile, shaded", "light / level", note, grey)


def _spectra(texture: xr.Dataset) -> Figure:
    powers = texture["sample_psd"].values, texture["tile_psd"].values
    return _spectrum(
        texture["texture_frequency"].values, powers, "scan, on the same pixels", "µm⁴", "Spectrum of the texture"
    )


def _of_picture(texture: xr.Dataset, number: int) -> Iterator[Figure]:
    """The tile of a geometry, and its spectrum."""
    geometry = str(texture["geometry"].values[number])
    light, title = texture["relative_light"].values[number], f"Light over its mean, {geometry}"
    note = "Black to white is the central 99\u202f% of the light, which stretches a weak contrast; see the scale."
    yield _picture(texture, light, title, "light / mean", note, grey)
    powers = texture["sample_contrast_psd"].values[number], texture["tile_contrast_psd"].values[number]
    yield _spectrum(texture["texture_frequency"].values, powers, "picture", "µm²", f"Spectrum of the light, {geometry}")


def _sparkles(texture: xr.Dataset) -> Table:
    columns = (
        ("sparkle_density", "Sparkles, mm⁻²"),
        ("tile_sparkle_density", "of the tile"),
        ("sparkle_area", "Area, µm²"),
        ("sparkle_contrast", "Contrast"),
        ("graininess", "Graininess"),
        ("tile_graininess", "of the tile"),
        ("illumination_range", "Illumination"),
        ("spectrum_difference", "Spectrum"),
    )
    shares = ("illumination_range", "spectrum_difference")
    rows = [
        (
            str(geometry),
            *(
                f"{100 * float(texture[name].values[row]):.1f} %"
                if name in shares
                else number(float(texture[name].values[row]), 3)
                for name, _ in columns
            ),
        )
        for row, geometry in enumerate(texture["geometry"].values)
    ]
    threshold, distance = float(texture.attrs["sparkle_threshold"]), float(texture.attrs["graininess_distance"])
    note = (
        f"Sparkle: neighbouring pixels brighter than {1 + threshold:g} times the median; contrast: mean of the peaks over the median, less 1. Graininess: rms contrast that an eye "
        f"sees at {distance:g} m; it is meant for diffuse light. Illumination: largest over least, less 1, divided out. Spectrum: largest relative difference of tile and "
        "picture up to half the Nyquist frequency. Instruments evaluate by unpublished procedures: their numbers are others."
    )
    return Table("Sparkle and graininess", ("Geometry", *(title for _, title in columns)), rows, note)


def _spectrum(frequency: Array, powers: tuple[Array, Array], of: str, unit: str, title: str) -> Figure:
    marks = [Line(frequency, powers[0], "c0", of), Line(frequency, powers[1], "c1", "tile", "dash")]
    joined = np.concatenate(powers)
    top = 10.0 ** np.ceil(np.log10(joined.max()) + 0.1)
    bottom = max(10.0 ** np.floor(np.log10(joined[joined > 0].min())), top * _LEAST)
    svg = chart(
        f"Power spectral density of {of.partition(',')[0]} and tile against spatial frequency, both logarithmic",
        Axis("spatial frequency, µm⁻¹", float(frequency[0]) / 1.2, float(frequency[-1]) * 1.2, log=True),
        Axis(f"spectral density S, {unit}", float(bottom), float(top), log=True),
        marks,
    )
    return Figure(title, svg, legend(marks), "Means over rings of frequencies.")


def _numbers(texture: xr.Dataset, rest: xr.Dataset | None) -> Table:
    pixel, side = float(texture.attrs["pixel"]), texture.sizes["x"]
    rows = [
        ("Pixel", f"{number(pixel)} µm", f"{side} × {side} pixels, {number(side * pixel / 1000)} mm along a side"),
        ("Slopes left to the BRDF", _percent(texture["unresolved_share"]), "of the mean square slope of all facets"),
        (
            "Facets at other slopes",
            _percent(texture["split_difference"]),
            "when those of the map and of the rest are put together",
        ),
        (
            "Difference of the spectra",
            _percent(texture["spectrum_difference"]),
            "largest, up to half the Nyquist frequency",
        ),
        ("Difference of the heights", _percent(texture["value_difference"]), "of the cumulated distributions"),
        ("Difference of the slopes", _percent(texture["slope_difference"]), "of the cumulated distributions"),
    ]
    if rest is not None and "mean_difference" in rest.attrs:
        rows.append(
            (
                "Map with the rest, from afar",
                f"{100 * float(rest.attrs['mean_difference']):.1f} %",
                "rms difference from the BRDF without a map, in lights of 5° about the mirror direction",
            )
        )
        if rest.attrs["lay_difference"]:
            lay = f"{100 * float(rest.attrs['lay_difference']):.1f} %"
            rows.append(
                ("at single azimuths", lay, "from the mean over azimuths: lay of the map, which the BRDF has not")
            )
    note = (
        f"Method {texture.attrs['method']}, seed {texture.attrs['seed']}. The map goes with the BRDF of `unresolved.nc`: with that of all facets the slopes of "
        "the map would count twice."
    )
    return Table("Texture in numbers", ("Quantity", "Value", "Of"), rows, note.replace("`", ""))


def _levels(texture: xr.Dataset) -> Table:
    chosen, tried = float(texture.attrs["pixel"]), texture["level_difference"]
    rows = [
        (
            f"{number(float(pixel))} µm",
            f"{100 * float(difference):.2g} %",
            "chosen" if pixel == chosen else "too coarse",
        )
        for pixel, difference in zip(tried["level_pixel"].values[::-1], tried.values[::-1], strict=True)
    ]
    note = (
        "The coarsest pixel is taken whose pattern under a small light has, for an eye at that distance, the contrast of the finest pixel. Differences below 10 % are "
        "not noticed; where the contrast is below 20 %, they are relative to 20 %."
    )
    if not float(tried.values[0]):
        note += " No coarser pixel has it: the finest is that of `texture.pixel`."
    title = f"Level of detail at {plain(float(texture.attrs['viewing_distance']))} m"
    return Table(title, ("Pixel", "Difference of contrast", "Choice"), rows, note)


def _percent(value: xr.DataArray) -> str:
    share = float(value)
    return f"{100 * share:.2g} %" if share >= _LEAST_SHARE or not share else f"less than {100 * _LEAST_SHARE:g} %"
