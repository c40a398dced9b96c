"""Write the example materials: synthetic, seeded, the same bytes on every run.

``python examples/generate.py`` (or ``make examples``) writes the materials beside this file anew. A benchmark imports
:func:`write_materials` and asks for variants: other seeds, heights within 20 %, other colours.

Nothing here was measured. The textures imitate what a profilometer sees on such parts, so that every route of the workflow
has something to work on:

``abs-grain``   areal map (X3P) + spectrum (text) + index: a leather-like grain with a fine texture, black
``pp-moulding`` line profile (text) + spectrum (text) + index: an eroded mould, beige
``paint-lab``   a colour L*a*b* alone

:func:`write_textures` writes two further ones, whose visible structure is computed beside the BRDF:

``leather-texture``    areal map (X3P) of cells under a fine roughness, with its grain as a tileable map
``sparkling-texture``  colours at three geometries, and pictures of flakes at two of them and in diffuse light
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.surfaces import write_x3p
from brdfpipe.texture.png import png_bytes
from brdfpipe.vocabulary import label

Array = NDArray[np.float64]

ORIGIN = "synthetic: made by examples/generate.py, not measured"
WAVELENGTH = np.arange(360, 781, 10)


def write_materials(folder: Path, variant: int = 0) -> list[Path]:
    """Write the example materials into a catalogue.

    Parameters
    ----------
    folder : the catalogue; made if absent
    variant : 0 writes the examples themselves, ``abs-grain``; 1 … 999 write varied copies, ``abs-grain-001``

    Returns
    -------
    The folders of the materials.
    """
    if not 0 <= variant <= 999:
        raise ValueError(f"variant must lie in 0 … 999, found {variant}")
    written = []
    for seed, (name, write) in enumerate(_EXAMPLES.items()):
        material = Path(folder) / (f"{name}-{variant:03d}" if variant else name)
        material.mkdir(parents=True, exist_ok=True)
        write(material, np.random.default_rng([seed, variant]), float(variant > 0))
        written.append(material)
    return written


def write_textures(folder: Path) -> list[Path]:
    """Write the examples with a texture into a catalogue; return their folders."""
    written = []
    for seed, (name, write) in enumerate(_TEXTURES.items(), start=100):
        material = Path(folder) / name
        material.mkdir(parents=True, exist_ok=True)
        write(material, np.random.default_rng(seed))
        written.append(material)
    return written


def write_leather_texture(material: Path, random: np.random.Generator) -> None:
    """A leather grain with cells of about 120 um under the fine roughness of an etched mould: 224 x 224 heights at 3 um."""
    count, pitch = 224, 3.0
    ridges = _noise(random, (count, count), pitch, lambda k: np.exp(-(((k - 2 * np.pi / 120) / 0.012) ** 2)))
    creases = -np.exp(-((ridges / 0.45) ** 2))
    fine = _noise(random, (count, count), pitch, lambda k: np.exp(-((k * 10) ** 2) / 8))
    height = _with_slope(creases, 0.12, pitch) + _with_slope(fine, 0.14, pitch)
    _write_map(material / "leather.x3p", height - height.mean(), pitch)
    _write_description(
        material,
        f"""\
# A leather grain that an eye sees as structure, and a gloss that it does not resolve.
description: "Leather grain with its texture ({ORIGIN})"

surface:
  file: leather.x3p

index: PP

# The colour: L*, a*, b* under D65 for the 10 degree observer, specular included.
spectrum:
  lab: [34.0, 3.0, 6.0]
  illuminant: D65
  observer: 10
  geometry: sci

# A tileable map of what pixels of 9 um resolve, made of pieces of the scan; the BRDF of the rest goes with it.
texture:
  pixel: 9
  size: 256
  method: structure
  seed: 1
""",
    )


def write_sparkling_texture(material: Path, random: np.random.Generator) -> None:
    """An effect paint: discs of 40 um whose tilts are spread by 5 degree, drawn at two geometries and in diffuse light, 192 x 192 pixels of 20 um."""
    size, count = 192, 900
    tilt = random.normal(scale=5.0, size=(2, count))
    rows, columns = random.integers(0, size, (2, count))
    distance = np.hypot(*np.meshgrid(*[np.minimum(np.arange(size), size - np.arange(size))] * 2))
    disc = np.clip(1.5 - distance / 1.5, 0.0, 1.0)
    # The camera and the illumination: vignetting, a slight gradient, and read-out noise.
    x = np.linspace(-1, 1, size)
    illumination = 1 - 0.1 * (x**2 + x[:, None] ** 2) + 0.05 * x
    for name, at, lobe, body in (("45as15", 2.0, 2.0, 0.05), ("45as45", 7.0, 2.0, 0.03), ("diffuse", 0.0, 15.0, 0.6)):
        points = np.zeros((size, size))
        np.add.at(points, (rows, columns), np.exp(-((tilt[0] - at) ** 2 + tilt[1] ** 2) / (2 * lobe**2)))
        light = np.fft.irfft2(np.fft.rfft2(points) * np.fft.rfft2(disc), s=points.shape) + body
        light = light * illumination + 0.002 * random.standard_normal((size, size))
        # Of 12 bits, so that the last bits of a processor's arithmetic do not reach the file.
        steps = np.rint(np.clip(light / light.max(), 0, 1) * 4000).astype(np.uint16) * 16
        (material / f"{name}.png").write_bytes(png_bytes(steps))
    _write_description(
        material,
        f"""\
# A metallic paint whose flakes are seen one by one: colours for the BRDF, pictures for the texture.
description: "Metallic paint with sparkles ({ORIGIN})"

multiangle:
  colours:
    - {{geometry: 45as15, lab: [78.0, 0.0, -2.0]}}
    - {{geometry: 45as45, lab: [42.0, 0.5, -3.0]}}
    - {{geometry: 45as110, lab: [24.0, 0.5, -3.5]}}
  illuminant: D65
  observer: 10

# Pictures along the normal, 16 bits, proportional to the light.
texture:
  pictures:
    - {{file: 45as15.png, geometry: 45as15}}
    - {{file: 45as45.png, geometry: 45as45}}
    - {{file: diffuse.png, geometry: diffuse}}
  pixel: 20
  curve: linear
  size: 256
  seed: 1
""",
    )


def write_abs_grain(material: Path, random: np.random.Generator, spread: float) -> None:
    """Black grained ABS: 256 x 256 heights at 2 um, rms slope 0.2."""
    count, pitch = 256, 2.0
    ridges = _noise(random, (count, count), pitch, lambda k: np.exp(-(((k - 2 * np.pi / 90) / 0.018) ** 2)))
    # A leather grain is a net of creases: the level lines of a band-limited noise.
    creases = -np.exp(-((ridges / 0.45) ** 2))
    texture = _noise(random, (count, count), pitch, lambda k: np.exp(-((k * 9) ** 2) / 8))
    height = _with_slope(creases, 0.14, pitch) + _with_slope(texture, 0.143, pitch)
    height *= 1 + 0.2 * spread * random.uniform(-1, 1)
    _write_map(material / "grain.x3p", height - height.mean(), pitch)
    level, rise = 5.30 + 0.10 * spread * random.uniform(-1, 1), 0.05 + 0.02 * spread * random.uniform(-1, 1)
    _write_spectrum(material / "reflectance.txt", level + rise * ((WAVELENGTH - 570) / 210) ** 2)
    _write_description(
        material,
        f"""\
# A grained instrument panel, as a laboratory knows it: the relief, the colour and the plastic.
description: "Grained ABS instrument panel, black ({ORIGIN})"

# The relief: a height map. X3P says its own units and pitch. A plane is subtracted, nothing is filtered.
surface:
  file: grain.x3p
  form: plane

# The plastic, by name: its refractive index fixes how much the facets reflect.
index: ABS

# The colour: total reflectance at 8 degree, specular included (sci), in percent.
spectrum:
  file: reflectance.txt
  geometry: sci
  scale: percent
""",
    )


def write_pp_moulding(material: Path, random: np.random.Generator, spread: float) -> None:
    """Beige PP moulding: a profile of 4096 heights at 0.5 um, rms slope 0.08, tails a little heavier than Gaussian."""
    count, pitch = 4096, 0.5
    fine = _noise(random, (count,), pitch, lambda k: np.exp(-((k * 6) ** 2) / 8))
    waviness = _noise(random, (count,), pitch, lambda k: np.exp(-((k * 60) ** 2) / 8))
    # Sparks strike here more, there less: a slowly varying depth is what makes the tails of the slopes heavy.
    depth = 1 + 0.25 * _noise(random, (count,), pitch, lambda k: np.exp(-((k * 80) ** 2) / 8))
    height = _with_slope(depth * fine, 0.078, pitch) + _with_slope(waviness, 0.018, pitch)
    height *= 1 + 0.2 * spread * random.uniform(-1, 1)
    heights = "\n".join(f"{z:.4f}" for z in height - height.mean())
    _write(material / "profile.txt", f"# {ORIGIN}\n# heights along a line\n# unit: um\n# pitch: {pitch:g}\n{heights}\n")
    edge = 500 + 30 * spread * random.uniform(-1, 1)
    top = 58 + 6 * spread * random.uniform(-1, 1)
    _write_spectrum(material / "reflectance.txt", 20 + (top - 20) / (1 + np.exp(-(WAVELENGTH - edge) / 45)))
    _write_description(
        material,
        f"""\
# A moulding of which only a stylus profile was taken.
description: "PP moulding from an eroded mould, beige ({ORIGIN})"

# The relief: one line. A line tells nothing of the slopes across it: say that the finish looks the same in every direction.
# The file's header states unit and pitch; `unit: um` and `pitch: 0.5` here would do the same.
surface:
  file: profile.txt
  layout: line
  isotropic: true

index: PP

spectrum:
  file: reflectance.txt
  geometry: sci
  scale: percent
""",
    )


def write_paint_lab(material: Path, random: np.random.Generator, spread: float) -> None:
    """A paint known by its colour alone."""
    lab = np.array([48.0, 34.0, 22.0]) + spread * random.uniform(-1, 1, 3) * [8, 8, 8]
    _write_description(
        material,
        f"""\
# A paint of which only the colour is known. Without a relief it scatters as a Lambertian surface, and the report says so.
description: "Terracotta paint, known by its colour alone ({ORIGIN})"

# L*, a*, b* under D65 for the 10 degree observer, specular included (sci); a spectrum is recovered from it.
spectrum:
  lab: [{lab[0]:.1f}, {lab[1]:.1f}, {lab[2]:.1f}]
  illuminant: D65
  observer: 10
  geometry: sci

# Files for other programs.
exports: [astm]
""",
    )


_EXAMPLES: dict[str, Callable[[Path, np.random.Generator, float], None]] = {
    "abs-grain": write_abs_grain,
    "pp-moulding": write_pp_moulding,
    "paint-lab": write_paint_lab,
}


_TEXTURES: dict[str, Callable[[Path, np.random.Generator], None]] = {
    "leather-texture": write_leather_texture,
    "sparkling-texture": write_sparkling_texture,
}


def _noise(
    random: np.random.Generator, shape: tuple[int, ...], pitch: float, amplitude: Callable[[Array], Array]
) -> Array:
    """Gaussian noise of unit variance, isotropic, whose spectrum has ``amplitude`` at the wave number k [rad/um]."""
    wave_numbers = np.meshgrid(*(2 * np.pi * np.fft.fftfreq(n, pitch) for n in shape), indexing="ij")
    spectrum = np.fft.fftn(random.standard_normal(shape)) * amplitude(np.sqrt(sum(k * k for k in wave_numbers)))
    spectrum.flat[0] = 0
    noise = np.fft.ifftn(spectrum).real
    return np.asarray(noise / noise.std())


def _with_slope(height: Array, slope: float, pitch: float) -> Array:
    """The relief scaled to an rms slope, by forward differences along every axis."""
    square = sum(float(np.mean(np.diff(height, axis=axis) ** 2)) for axis in range(height.ndim))
    return height * (slope * pitch / np.sqrt(square))


def _write_map(path: Path, height: Array, pitch: float) -> None:
    # Rounded to a nanometre, so that the last bits of a processor's arithmetic do not reach the file.
    values = np.round(height, 3).astype(np.float32)
    axes = {dim: pitch * np.arange(count) for dim, count in zip("yx", height.shape, strict=True)}
    attrs = {"pitch_x": pitch, "pitch_y": pitch, "levelling": "none", "band": f"{pitch:g} um pitch"}
    write_x3p(label(xr.Dataset({"height": (("y", "x"), values)}, axes, attrs), "surface"), path)


def _write_spectrum(path: Path, percent: Array) -> None:
    rows = "\n".join(f"{w};{r:.2f}" for w, r in zip(WAVELENGTH, percent, strict=True))
    _write(path, f"# {ORIGIN}\n# total reflectance, specular included, d:8\nwavelength (nm);reflectance (%)\n{rows}\n")


def _write_description(material: Path, text: str) -> None:
    _write(material / "material.yaml", text)


def _write(path: Path, text: str) -> None:
    path.write_bytes(text.encode("utf-8"))


if __name__ == "__main__":
    for made in [*write_materials(Path(__file__).parent), *write_textures(Path(__file__).parent)]:
        print(made.name)
