"""The commands ``brdfpipe convert``, ``compare`` and ``formats``: BSDFs of this package and of other programs."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from brdfpipe.cli.console import FILE, exit_on_error, print_json
from brdfpipe.errors import InputError, printable
from brdfpipe.exchange.registry import FORMATS, GRID_OPTIONS, QUANTITIES, WRITTEN

_READ = click.Choice([name for name, known in FORMATS.items() if known.read])
_RESULTS_OR_FILE = click.Path(path_type=Path, exists=True)
_QUANTITY = click.Choice(QUANTITIES)
_OPTIONS = sorted({*GRID_OPTIONS, *(name for known in FORMATS.values() for name in known.options)})


@click.command(short_help="Write the BSDF of file IN as file OUT.")
@click.argument("source", metavar="IN", type=FILE)
@click.argument("target", metavar="OUT", type=click.Path(path_type=Path, dir_okay=False))
@click.option("--format", type=click.Choice(WRITTEN), default=None, help="Of OUT  [default: that of its suffix]")
@click.option("--from", "read_as", type=_READ, default=None, help="Format of IN  [default: that of its suffix]")
@click.option(
    "--quantity", type=_QUANTITY, default=None, help="What the values of IN are  [default: what the file says]"
)
@click.option(
    "--tolerance", type=float, default=None, help=f"Of BRDF·cos θ_o  [default: {GRID_OPTIONS['tolerance']:g}]"
)
@click.option(
    "--largest", type=int, default=None, help=f"Number of values of a channel  [default: {GRID_OPTIONS['largest']}]"
)
@click.option(
    "--wavelengths", default="", metavar="NM,NM,…", help="Of OUT, where it has a spectrum  [default: those of IN]"
)
@click.option(
    "--option",
    "further",
    multiple=True,
    metavar="NAME=VALUE",
    help="Of the format, as colour=rgb; see `brdfpipe formats`",
)
@exit_on_error
def convert(
    source: Path,
    target: Path,
    format: str | None,
    read_as: str | None,
    quantity: str | None,
    tolerance: float | None,
    largest: int | None,
    wavelengths: str,
    further: tuple[str, ...],
) -> int:
    """Write the BSDF of file IN, a bsdf.nc of the results or a file of another program, as file OUT: netCDF (.nc) or a file of another program.

    Prints the warnings of IN, the error of OUT and what OUT leaves out. `brdfpipe formats` lists the formats.
    """
    from brdfpipe.exchange import conversion
    from brdfpipe.exchange.records import statements

    if not target.parent.is_dir():
        raise click.BadParameter(f"the folder {target.parent} does not exist; make it first", param_hint="OUT")
    if target.exists() and target.samefile(source):
        raise click.BadParameter(f"{target} is the file that is read; give another one", param_hint="OUT")
    given = {"tolerance": tolerance, "largest": largest}
    options = {name: value for name, value in given.items() if value is not None} | dict(map(_option, further))
    wanted = _numbers(wavelengths)
    conversion.target(target, format, wavelengths=wanted, **options)  # a mistake is named before a long file is read
    with _options_in_place_of_keys({"table.format": "--from", "table.quantity": "--quantity"}):
        bsdf = conversion.open_bsdf(source, read_as, quantity)
    for warning in json.loads(bsdf.attrs.get("warnings", "[]")):
        click.echo(f"{source.name}: warning: {printable(warning)}", err=True)
    record = conversion.convert(bsdf, target, format, wavelengths=wanted, inputs={source.name: source}, **options)
    click.echo(f"{target}: {target.stat().st_size / 1e6:.2f} MB")
    for text in statements(record):
        click.echo(printable(text))
    return 0


@contextmanager
def _options_in_place_of_keys(options: dict[str, str]) -> Iterator[None]:
    """Errors of reading name an option of the command (key of material.yaml → option)."""
    try:
        yield
    except InputError as refusal:
        raise refusal.at_command_line(options) from refusal


def _numbers(text: str) -> list[float]:
    try:
        return [float(one) for one in text.split(",") if one.strip()]
    except ValueError:
        raise click.BadParameter(
            f"{printable(text)[:60]!r} is no list of numbers, as 450,550,650", param_hint="--wavelengths"
        ) from None


def _option(text: str) -> tuple[str, object]:
    """Name and value; true, false and numbers as such."""
    name, equals, value = text.partition("=")
    if not equals or not name.isidentifier():
        raise click.BadParameter(f"{printable(text)[:60]!r}; accepted: NAME=VALUE", param_hint="--option")
    if name not in _OPTIONS:
        raise click.BadParameter(
            f"unknown option {name[:40]!r}; accepted: {', '.join(_OPTIONS)}", param_hint="--option"
        )
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value


@click.command(short_help="Compare two BSDFs.")
@click.argument("first", type=_RESULTS_OR_FILE)
@click.argument("second", type=_RESULTS_OR_FILE)
@click.option("--first-from", type=_READ, default=None, help="Format of FIRST  [default: that of its suffix]")
@click.option("--first-quantity", type=_QUANTITY, default=None, help="What its values are  [default: what it says]")
@click.option("--second-from", type=_READ, default=None, help="Format of SECOND  [default: that of its suffix]")
@click.option("--second-quantity", type=_QUANTITY, default=None, help="What its values are  [default: what it says]")
@click.option("--json", "as_json", is_flag=True, help="Print the differences as JSON.")
@exit_on_error
def compare(
    first: Path,
    second: Path,
    first_from: str | None,
    first_quantity: str | None,
    second_from: str | None,
    second_quantity: str | None,
    as_json: bool,
) -> int:
    """Compare two BSDFs, each of the results of a material, a bsdf.nc or a file of another program: by direction, in reflectance, gloss and colour.

    Prints the warnings of files of other programs.
    """
    import numpy as np

    from brdfpipe.cli.summaries import bsdf_of
    from brdfpipe.comparison.bsdf_difference import as_text, difference
    from brdfpipe.exchange.conversion import NETCDF, open_bsdf

    bsdfs = []
    given = (first, "first", first_from, first_quantity), (second, "second", second_from, second_quantity)
    for place, name, read_as, quantity in given:
        path = bsdf_of(place) if place.is_dir() else place
        with _options_in_place_of_keys({"table.format": f"--{name}-from", "table.quantity": f"--{name}-quantity"}):
            bsdfs.append(open_bsdf(path, read_as, quantity))
        if path.suffix.lower() != NETCDF:
            for warning in json.loads(bsdfs[-1].attrs.get("warnings", "[]")):
                click.echo(f"{path.name}: warning: {printable(warning)}", err=True)
    found = difference(bsdfs[0], bsdfs[1])
    if not as_json:
        click.echo(as_text(found))
        return 0
    plain = {
        name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in found._asdict().items()
    }
    click.echo(json.dumps(_without_nan(plain), indent=1))
    return 0


def _without_nan(value: object) -> object:
    """Values for JSON, which has no NaN."""
    if isinstance(value, dict):
        return {key: _without_nan(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_without_nan(one) for one in value]
    return None if isinstance(value, float) and value != value else value


@click.command(short_help="List the formats of other programs.")
@click.option("--json", "as_json", is_flag=True, help="Print them as JSON instead of lines.")
@exit_on_error
def formats(as_json: bool) -> int:
    """List the formats of other programs: what their files hold, the endings of files, and the options of writing.

    netCDF (.nc) holds the BSDF itself and needs no format.
    """
    listing: dict[str, dict[str, Any]] = {
        name: {
            "description": known.description,
            "written": [group[0] for side in known.files.values() for group in side.values()],
            "read": list(known.readable_suffixes) if known.read else [],
            "options": {**(GRID_OPTIONS if known.takes == "grid" else {}), **known.options},
        }
        for name, known in FORMATS.items()
    }
    if as_json:
        print_json(listing)
        return 0
    for name, one in listing.items():
        click.echo(f"{name}: {one['description']}")
        for direction in ("written", "read"):
            if one[direction]:
                click.echo(f"    {direction}: {' '.join(one[direction])}")
        if one["options"]:
            listed = (
                f"{option}={value if isinstance(value, str) else json.dumps(value)}"
                for option, value in one["options"].items()
            )
            click.echo(f"    options: {' '.join(listed)}")
    return 0
