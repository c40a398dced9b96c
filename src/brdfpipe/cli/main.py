"""The command line: ``brdfpipe build``, ``check``, ``diff``, ``verify``, ``snapshot``, ``release``, ``prune``, ``scenes`` and ``new``; ``convert``,
``compare`` and ``formats`` are in :mod:`brdfpipe.cli.tables`, ``show`` and ``plot`` in :mod:`brdfpipe.cli.show`, ``doctor`` in
:mod:`brdfpipe.cli.doctor`, the group ``rig`` in :mod:`brdfpipe.cli.rig`.

Exit codes: 0 every material was built (or is ok), 1 at least one was not, 2 the command, the catalogue or the configuration
cannot be used, 130 interrupted, 143 terminated. The verdict of a material's checks and the budget of its scene change it only with ``--fail-on``.
"""

from __future__ import annotations

import os
from importlib.metadata import version
from pathlib import Path

import click

from brdfpipe.cli.console import FILE, FOLDER, PRESENT, Commands, exit_on_error, print_json
from brdfpipe.cli.doctor import doctor
from brdfpipe.cli.rig import rig
from brdfpipe.cli.serving import serve
from brdfpipe.cli.show import plot, show
from brdfpipe.cli.tables import compare, convert, formats
from brdfpipe.cli.watching import watch
from brdfpipe.errors import BrdfpipeError, printable


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(version("brdfpipe"), prog_name="brdfpipe")
def main() -> None:
    """Trustworthy BRDFs for a catalogue of plastics, paints and films."""


@main.command(short_help="Build every material of CATALOGUE that changed.")
@click.argument("catalogue", type=FOLDER)
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--results", type=FOLDER, default=Path("results"), show_default=True, help="Folder of the results.")
@click.option(
    "--cores", type=click.IntRange(1), default=None, help="Number of stages at the same time  [default: all cores]"
)
@click.option("--config", type=FILE, default=None, help="Configuration instead of the project's config/config.yaml.")
@click.option(
    "--scene",
    default=None,
    metavar="NAME|FILE",
    help="What the results are for, instead of what the materials and the configuration name.  `brdfpipe scenes` lists them.",
)
@click.option("--dry-run", is_flag=True, help="List what would be built; build nothing.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
@click.option(
    "--fail-on",
    type=click.Choice(["warn", "fail", "budget"]),
    multiple=True,
    help="Exit with 1 also if a material has this verdict or a worse one, or exceeds the budget of its scene. May be repeated.",
)
@click.option("--notify", default=None, metavar="COMMAND", help="Run afterwards, with the summary (JSON) as its input.")
@click.option("--profile", default=None, hidden=True)
@exit_on_error
def build(
    catalogue: Path,
    names: tuple[str, ...],
    results: Path,
    cores: int | None,
    config: Path | None,
    scene: str | None,
    dry_run: bool,
    as_json: bool,
    fail_on: tuple[str, ...],
    notify: str | None,
    profile: str | None,
) -> int:
    """Build every material of CATALOGUE that changed, and the catalogue page; with NAMEs (* and ? match), these materials alone.

    Exit code: 0 if every material was built; 1 if one was not, an export was refused, or if --fail-on says so; 2 if the
    catalogue or the configuration cannot be used, or the command of --notify failed.
    """
    import json

    from brdfpipe.jobs import notification
    from brdfpipe.jobs.build import build as build_catalogue

    if profile is not None:
        raise click.UsageError(
            "brdfpipe build runs on this machine alone; on a cluster run "
            f"`snakemake --profile {profile} --config catalogue={catalogue.resolve()} --directory {results}`, and after failures "
            "brdfpipe build without --profile, which makes the page (docs/cluster.md)"
        )
    summary = build_catalogue(
        catalogue, results, cores=cores or _cores(), config=config, scene=scene, names=names, dry_run=dry_run
    )
    if as_json:
        print_json(summary.plain)
    else:
        click.echo(printable(summary.text))
    code = 1 if summary.has_failed(fail_on) else 0
    if notify:
        notification.notify(notify, json.dumps(summary.plain, indent=1, ensure_ascii=False))
    return code


@main.command(short_help="Delete results of materials that left CATALOGUE.")
@click.argument("catalogue", type=FOLDER)
@click.option("--results", type=PRESENT, default=Path("results"), show_default=True, help="Folder of the results.")
@click.option(
    "--keep",
    type=click.IntRange(0),
    default=10,
    show_default=True,
    help="How many of snakemake's logs stay, the last ones; each build writes one.",
)
@click.option("--dry-run", is_flag=True, help="List what would be deleted; delete nothing.")
@exit_on_error
def prune(catalogue: Path, results: Path, keep: int, dry_run: bool) -> int:
    """Delete the results of materials and calibrations that are no longer in CATALOGUE, and snakemake's old logs."""
    from brdfpipe.catalogue.catalogue import load
    from brdfpipe.jobs.lock import locked
    from brdfpipe.jobs.pruning import prune as prune_results

    loaded = load(catalogue)
    with locked(results):
        pruned = prune_results(results, loaded, keep=keep, dry_run=dry_run)
    for path in pruned.paths:
        click.echo(path)
    verb = "would be deleted" if dry_run else "deleted"
    click.echo(f"{len(pruned.paths)} folders and files {verb}, {pruned.size / 1e6:.1f} MB")
    return 0


@main.command(short_help="Check the descriptions and files of CATALOGUE.")
@click.argument("catalogue", type=FOLDER)
@click.option("--config", type=FILE, default=None, help="Configuration instead of the project's config/config.yaml.")
@click.option("--scene", default=None, metavar="NAME|FILE", help="As for `brdfpipe build`.")
@click.option(
    "--read", "reads", is_flag=True, help="Read every raw file too, as the build does, and say what it holds."
)
@click.option("--json", "as_json", is_flag=True, help="Print what was found as JSON instead of lines.")
@exit_on_error
def check(catalogue: Path, config: Path | None, scene: str | None, reads: bool, as_json: bool) -> int:
    """Check descriptions, keys, scenes, files and formats of CATALOGUE; raw files are read with --read alone.

    Lists every mistake of a description. What only the content of a raw file shows, such as a text file whose unit or pitch must be a
    key, --read refuses in the words of the build. Colours are checked too: one that no spectrum has, and colours of an effect paint that its
    form does not fit. No dataset is computed.

    Exit code: 1 if a material is wrong or needs a reader that is not installed, or an export will be refused.
    """
    from brdfpipe.catalogue.catalogue import ignored, load
    from brdfpipe.catalogue.configuration import load_config
    from brdfpipe.catalogue.format_checks import check_formats, refused_exports
    from brdfpipe.catalogue.material import summary_words, unused_keys
    from brdfpipe.catalogue.raw_reading import describe_files
    from brdfpipe.jobs.runs import planned_runs
    from brdfpipe.jobs.scene_notices import scene_notices

    loaded = load(catalogue, load_config(config), scene)
    problems = {**loaded.failures, **planned_runs(loaded)[1]}
    summaries, contents, refused = {}, {}, {}
    for material in loaded.materials:
        if material.name in problems:
            continue
        try:
            check_formats(material)
            contents[material.name] = describe_files(loaded, material) if reads else []
        except BrdfpipeError as refusal:
            problems[material.name] = str(refusal)
        else:
            unused = "".join(f"; `{key}` is not used: {why}" for key, why in unused_keys(material.content).items())
            refused[material.name] = refused_exports(material)
            summaries[material.name] = f"ok ({', '.join(summary_words(material))}){unused}"
    skipped, notices = ignored(loaded.folder), list(scene_notices(loaded.scenes, loaded.config))
    unwritten = sum(map(len, refused.values()))
    if as_json:
        further = loaded.further_problems
        found = {
            "ok": dict(sorted(summaries.items())),
            "wrong": {name: [problems[name], *further.get(name, ())] for name in sorted(problems)},
            "contents": {name: list(lines) for name, lines in sorted(contents.items()) if lines},
            "refused_exports": {name: reasons for name, reasons in sorted(refused.items()) if reasons},
            "ignored": skipped,
            "unused_defaults": list(loaded.unused_defaults),
            "notices": notices,
        }
        print_json(found)
        return 1 if problems or unwritten else 0
    for name, message in sorted({**problems, **summaries}.items()):
        click.echo(f"{name}: {message}")
        for line in contents.get(name, ()):
            click.echo(printable(f"  {line}"))
        for format, reason in refused.get(name, {}).items():
            click.echo(f"  export {format} will not be written: {reason}; change `exports`")
        for mistake in loaded.further_problems.get(name, ()):
            click.echo(f"  also {mistake}")
    for name, reason in skipped.items():
        click.echo(f"{name}: ignored: {reason}")
    for key in loaded.unused_defaults:
        click.echo(f"{loaded.defaults.path.name}: `{key}` is not used: no material inherits it")
    for notice in notices:
        click.echo(notice)
    exports = f", {unwritten} export{'s' if unwritten > 1 else ''} refused" if unwritten else ""
    click.echo(f"{len(summaries)} ok, {len(problems)} wrong{exports}")
    return 1 if problems or unwritten else 0


@main.command(short_help="Report what changed between two results, and why.")
@click.argument("older", type=FOLDER, nargs=-1, metavar="[EARLIER]... OLD")
@click.argument("new", type=FOLDER)
@click.option("--json", "as_json", is_flag=True, help="Print all figures as JSON instead of lines.")
@click.option("--html", type=click.Path(path_type=Path, dir_okay=False), default=None, help="Also write a page.")
@exit_on_error
def diff(older: tuple[Path, ...], new: Path, as_json: bool, html: Path | None) -> int:
    """Report what changed from the results OLD to the results NEW, and why.

    EARLIER results, the oldest first, are for the charts of the page alone.

    For each material: the difference of its colour (ΔE00), gloss, BRDF and verdict, and the raw files, keys, versions
    of libraries or code that caused it.
    """

    from brdfpipe import store
    from brdfpipe.catalogue.names import CHANGES
    from brdfpipe.releases import words
    from brdfpipe.releases.differences import differences, read_releases

    if not older:
        raise click.UsageError("two folders of results are needed, the older one first")
    folders = [*older, new] if html else [older[-1], new]
    releases = [read_releases(folder) for folder in folders]
    found = differences(*releases[-2:])
    if html is not None:
        from brdfpipe.releases.history import histories
        from brdfpipe.releases.page import changes_page

        pictures = {
            (Path(scene).name, name): str(row["thumbnail"].values)
            for scene, one in releases[-1].items()
            for name, row in one.rows.items()
        }
        written = changes_page(
            found,
            histories(releases),
            [folder.resolve().name for folder in folders],
            pictures=pictures,
            linked=html.name == CHANGES and (html.parent / "index.html").is_file(),
        )
        store.write_text(html, written)
    if as_json:
        print_json(words.plain(found))
    else:
        click.echo(printable("\n".join(words.lines(found))))
    return 0


@main.command(short_help="Keep a copy of RESULTS in FOLDER.")
@click.argument("results", type=PRESENT)
@click.argument("folder", type=FOLDER)
@click.option("--name", default=None, help="Of the copy  [default: its time in UTC]")
@click.option(
    "--keep", type=click.IntRange(1), default=None, help="How many copies stay, the last ones  [default: all]"
)
@exit_on_error
def snapshot(results: Path, folder: Path, name: str | None, keep: int | None) -> int:
    """Keep a copy of RESULTS as they are now in FOLDER, for `brdfpipe diff`; files that did not change since the last copy are stored once."""
    from brdfpipe.releases.snapshots import take_snapshot

    taken = take_snapshot(results, folder, name=name, keep=keep)
    click.echo(f"{taken.path}: {taken.copied} files copied, {taken.linked} as in the copy before")
    for old in taken.deleted:
        click.echo(f"deleted {folder / old}")
    return 0


@main.command(short_help="Archive CATALOGUE and its results in one zip file.")
@click.argument("catalogue", type=FOLDER)
@click.option("--metadata", type=FILE, required=True, help="release.yaml: title, creators, publisher, date, license.")
@click.option("--results", type=PRESENT, default=Path("results"), show_default=True, help="Folder of the results.")
@click.option("--config", type=FILE, default=None, help="The configuration of the build.")
@click.option("--output", type=click.Path(path_type=Path), default=Path("release.zip"), show_default=True)
@exit_on_error
def release(catalogue: Path, metadata: Path, results: Path, config: Path | None, output: Path) -> int:
    """Archive CATALOGUE, its results, configuration and library versions with metadata (RO-Crate) in one zip file.

    Results that are not those of the present inputs, keys, code and libraries are refused. Those of scenes that the catalogue does not name are left out.
    """
    from brdfpipe.catalogue.catalogue import load
    from brdfpipe.catalogue.configuration import load_config
    from brdfpipe.descriptions import reading
    from brdfpipe.jobs.build import refuse_outdated
    from brdfpipe.jobs.lock import locked
    from brdfpipe.releases.archive import write_archive
    from brdfpipe.releases.release_keys import Release

    stated = reading.read(metadata, Release)
    refuse_outdated(catalogue, results, config)
    with locked(results):
        parts = write_archive(load(catalogue, load_config(config)), results, stated, config, output)
    click.echo(
        f"{output}: {len(parts)} files, {output.stat().st_size / 1e6:.1f} MB; `brdfpipe verify {output}` checks it"
    )
    return 0


@main.command(short_help="Check that no file of RESULTS is damaged.")
@click.argument("results", type=click.Path(path_type=Path, exists=True))
@click.option("--json", "as_json", is_flag=True, help="Print the problems as JSON instead of lines.")
@exit_on_error
def verify(results: Path, as_json: bool) -> int:
    """Compute the digests of all files of RESULTS again: a folder of results, or an archive of `brdfpipe release`.

    Exit code: 1 if a file is damaged, missing or unknown.
    """
    from brdfpipe.releases.verification import verify_archive, verify_results

    problems = verify_results(results) if results.is_dir() else verify_archive(results)
    if as_json:
        print_json({"results": str(results), "problems": problems})
        return 1 if problems else 0
    for problem in problems:
        click.echo(printable(problem))
    count = f"{len(problems)} problem{'s' if len(problems) > 1 else ''}"
    click.echo(f"{results}: {count}" if problems else f"{results}: every file is as it was written")
    return 1 if problems else 0


@main.command(short_help="List the shipped scenes.")
@click.option("--json", "as_json", is_flag=True, help="Print their keys as JSON instead of lines.")
@exit_on_error
def scenes(as_json: bool) -> int:
    """List the shipped scenes, their purposes and what they ask for, and where their files are."""
    from brdfpipe.scenes.scene import load_scene, shipped_scenes

    files = shipped_scenes()
    contents = {name: load_scene(name).content for name in files}
    if as_json:
        print_json(contents)
        return 0
    for name, content in contents.items():
        click.echo(f"{name}: {content['purpose']} ({', '.join(content['results'])})")
    folder = next(iter(files.values())).parent
    click.echo(f"Their files are in {folder}; copy one under another name to start a scene of your own.")
    return 0


@main.command(short_help="Start a material NAME.")
@click.argument("name")
@click.option("--folder", type=FOLDER, default=Path(), show_default=True, help="The catalogue.")
@exit_on_error
def new(name: str, folder: Path) -> int:
    """Start a material NAME: a folder with a commented material.yaml."""
    from brdfpipe.catalogue.material import start_material

    path = start_material(folder, name)
    click.echo(f"Fill in {path}, put the raw files beside it, then run `brdfpipe check {folder}`.")
    return 0


@main.command(short_help="Copy the example catalogue to FOLDER.")
@click.argument("folder", type=FOLDER)
@exit_on_error
def examples(folder: Path) -> int:
    """Copy the example catalogue to FOLDER, a material in a folder of its own for each way to know a surface."""
    from brdfpipe.catalogue.examples import copy_examples

    for name in copy_examples(folder):
        click.echo(f"{folder / name}")
    click.echo(f"`brdfpipe build {folder}` builds them; to learn with, they are synthetic")
    return 0


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


rig.add_command(watch)
for command in (show, plot, convert, compare, formats, doctor, rig, serve):
    main.add_command(command)

if __name__ == "__main__":
    main()
