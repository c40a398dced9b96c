"""Draw the figures of the documentation from the examples: ``python docs/make_figures.py [FOLDER]``; the same bytes each time."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import brdfpipe
from brdfpipe import appearance, spectra
from brdfpipe.bsdf.microfacet.builder import build
from brdfpipe.facets.analytic_distributions import analytic
from brdfpipe.facets.estimation import estimate
from brdfpipe.figures.canvas import BSDFFigure
from brdfpipe.optics.index import refractive_index
from brdfpipe.surfaces.reading import ingest

HERE = Path(__file__).parent
GRAIN = HERE.parent / "examples" / "abs-grain"


def axes(title: str, x: str, y: str, **options: object):
    """A figure with axes, and the axes."""
    figure = BSDFFigure(figsize=(6.4, 4.2), layout="constrained")
    ax = figure.subplots()
    ax.set(xlabel=x, ylabel=y, **options)
    ax.grid(alpha=0.3)
    ax.set_title(title, fontsize=10)
    return figure, ax


def grain(folder: Path) -> None:
    """The grained panel of the examples."""
    reflectance = {"file": GRAIN / "reflectance.txt", "geometry": "sci", "scale": "percent"}
    bsdf = brdfpipe.predict(GRAIN / "grain.x3p", "ABS", reflectance, uncertainty=False, name="abs-grain")
    bsdf.bsdf.plot.polar().save(folder / "grain-polar.svg")
    bsdf.bsdf.plot.lobe().save(folder / "grain-lobe.png", dpi=90)


def slopes(folder: Path) -> None:
    """The counted slope density beside that of a normal distribution."""
    facets = estimate([ingest(GRAIN / "grain.x3p", {"form": "plane"})])
    rms = float(facets["slope_rms"])
    slope = np.linspace(0, 4 * rms, 200)
    figure, ax = axes("Slopes of the facets of abs-grain", "slope [1]", "density [1]", yscale="log")
    counted = facets["slope_density"]
    inside = facets["slope"].values <= 4 * rms
    ax.plot(facets["slope"][inside], counted[inside], ".", label="counted on the scan")
    ax.plot(slope, np.exp(-((slope / rms) ** 2)) / (np.pi * rms**2), label=f"normal, rms slope {rms:.2f}")
    ax.legend()
    figure.titled("").save(folder / "slopes.svg")


def gloss(folder: Path) -> None:
    """Gloss against roughness."""
    slope, index = np.geomspace(0.005, 0.5, 16), refractive_index(1.5)
    values = [appearance.gloss(build(analytic("beckmann", a=a), index=index), [20, 60, 85]) for a in slope]
    title = "Gloss of a black plastic, n = 1.5, with normally distributed slopes"
    figure, ax = axes(title, "rms slope [1]", "gloss [GU]", xscale="log")
    for column, angle in enumerate((20, 60, 85)):
        ax.plot(slope, [float(np.ravel(value)[column]) for value in values], label=f"{angle}°")
    ax.legend(title="gloss at")
    figure.titled("").save(folder / "gloss.svg")


def energy(folder: Path) -> None:
    """The reflectance of a white plastic with the coupled base and with a base that is only added."""
    facets, index = analytic("beckmann", a=0.2), refractive_index(1.5)
    white = spectra.recover([97, 0, 1], illuminant="D65", observer=10)
    theta = np.linspace(0, 88, 45)
    figure, ax = axes("White plastic, n = 1.5, rms slope 0.2", "incidence [degree]", "reflectance at 550 nm [1]")
    for name, words in (("coupled", "base coupled to the facets (default)"), ("crf", "base as in US 9,395,299")):
        bsdf = build(facets, index=index, spectrum=white, diffuse=name)
        ax.plot(theta, bsdf.bsdf.albedo(theta, wavelength=550).squeeze(), label=words)
    ax.axhline(1, color="black", linewidth=0.8, linestyle="--", label="all light")
    ax.legend()
    figure.titled("").save(folder / "energy.svg")


def main() -> None:
    """Draw all figures into a folder."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "figures"
    folder.mkdir(exist_ok=True)
    for draw in (grain, slopes, gloss, energy):
        draw(folder)


if __name__ == "__main__":
    main()
