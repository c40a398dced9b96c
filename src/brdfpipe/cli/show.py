"""The commands ``brdfpipe show`` and ``brdfpipe plot``: what a file or a folder of results holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from brdfpipe.cli.console import FILE_KINDS, exit_on_error, print_json
from brdfpipe.errors import printable

_PLOTS = ("polar", "cartesian", "lobe", "map", "preview")

_AS = click.option(
    "--as", "kind", type=click.Choice(FILE_KINDS), default=None, help="What FILE holds  [default: by its suffix]"
)
_SETTINGS = click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY=VALUE",
    help="How FILE is read: a key of `surface` or `spectrum` of material.yaml, as unit=um. May be repeated.",
)


@click.command(short_help="Summarise a dataset, a file or a folder of results.")
@click.argument("path", type=click.Path(path_type=Path, exists=True))
@_AS
@_SETTINGS
@click.option("--no-plot", is_flag=True, help="Print no plot.")
@click.option("--json", "as_json", is_flag=True, help="Print the figures as JSON.")
@exit_on_error
def show(path: Path, kind: str | None, settings: tuple[str, ...], no_plot: bool, as_json: bool) -> int:
    """Summarise PATH in the terminal, with a small plot: a dataset (.nc), a scan, a spectrum, a BSDF of another program, the results of a
    material, or a folder of results.

    Nothing is written.
    """
    from brdfpipe.cli import summaries

    if path.is_dir():
        found, dataset = summaries.of_folder(path)
    else:
        dataset = summaries.read_any(path, kind, settings)
        found = summaries.of_dataset(dataset)
    if as_json:
        print_json(found)
        return 0
    lines = summaries.lines(found)
    if dataset is not None and not no_plot:
        lines += ["", *summaries.plot(dataset)]
    click.echo(printable("\n".join(lines)))
    return 0


@click.command(short_help="Draw a BSDF as SVG, PNG or PDF.")
@click.argument("source", metavar="IN", type=click.Path(path_type=Path, exists=True))
@click.argument("target", metavar="OUT", type=click.Path(path_type=Path, dir_okay=False))
@click.option("--kind", type=click.Choice(_PLOTS), default="polar", show_default=True, help="Which figure.")
@click.option(
    "--theta-i",
    default=None,
    metavar="DEGREE,…",
    help="Angles of incidence; lobe and map take one  [default: 0,30,60; 45]",
)
@click.option("--wavelength", type=float, default=None, help="nm  [default: that next to 550]")
@exit_on_error
def plot(source: Path, target: Path, kind: str, theta_i: str | None, wavelength: float | None) -> int:
    """Draw the BSDF of IN (a dataset, the results of a material, or a file of another program) as OUT: .svg, .png or .pdf.

    Needs matplotlib: pip install 'brdfpipe[plot]'.
    """
    from brdfpipe.cli import summaries
    from brdfpipe.figures.bsdf_plots import BSDFPlots

    if source.is_dir():
        source = summaries.bsdf_of(source)
    options: dict[str, Any] = {}
    if kind != "preview":
        options["wavelength"] = wavelength
    if theta_i is not None and kind != "preview":
        angles = _angles(theta_i)
        if kind in ("lobe", "map") and len(angles) > 1:
            raise click.BadParameter(
                f"{kind} shows one angle of incidence; found {len(angles)}", param_hint="--theta-i"
            )
        options["theta_i"] = angles[0] if kind in ("lobe", "map") else angles
    figure = BSDFPlots(summaries.read_any(source, "bsdf"))(kind, **options)
    click.echo(f"{figure.save(target)}: {target.stat().st_size / 1e6:.2f} MB")
    return 0


def _angles(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        shown = f"{printable(text)[:60]!r} is no list of angles, as 0,30,60"
        raise click.BadParameter(shown, param_hint="--theta-i") from None
