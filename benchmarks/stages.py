"""Write docs/stages.md from declarations: the stages, the formats, and the modules that each stage depends on.

A test (``tests/test_stages.py``) fails if the page is stale or if a stage depends on more modules than its limit.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from brdfpipe.exchange.registry import FORMATS
from brdfpipe.jobs import code
from brdfpipe.jobs.rules import Pipeline
from brdfpipe.stages import EXPORTS, STAGES, Stage

PROJECT = Path(__file__).resolve().parents[1]
PAGE = PROJECT / "docs" / "stages.md"

LIMITS = {"predicted": 50, "flake": 30, "measured": 21, "smoothed": 20}
"""Most modules that a stage may depend on."""

BEFORE_COMMIT = "497fb8d"
"""Of 22 November 2026, the last one before packages were lazy and layers held. BEFORE and EDITED were counted there."""

BEFORE = {
    name: int(count)
    for name, count in re.findall(
        r"(\w+) (\d+)",
        """surface 15, facets 22, back_surface 15, masking 11, spectrum 18, index 11, interior 7, multiangle 23, predicted 95, flake 94,
        rig_run 122, reduced 113, primary 96, smoothed 96, calibration 96, measured 95, comparison 120, bsdf 4, checks 94,
        appearance 94, preview 98, table 94, lambert_gauss 98, export_astm 97, export_astm_transmission 97, report 145, catalogue 145""",
    )
}
"""Stage → modules in its digest."""

EDITED = {
    "catalogue/material.py": 18,
    "vocabulary.py": 27,
    "bsdf/checks.py": 18,
    "bsdf/flake.py": 18,
    "appearance/haze.py": 18,
    "report/catalogue/page.py": 2,
}
"""Module → stages that an edit reran; `catalogue/material.py` was `catalogue.py` then, `report/catalogue/page.py` was `report/catalogue.py`."""

Row = tuple[object, ...]


def main() -> None:
    PAGE.write_text(page(), encoding="utf-8")
    print(f"wrote {PAGE.relative_to(PROJECT)}")


def modules(stage: Stage) -> tuple[str, ...]:
    """Modules of the package that a stage's digest covers."""
    return code.modules(script(stage), extra_modules=stage.modules)


def script(stage: Stage) -> Path:
    return PROJECT / "workflow" / "scripts" / f"{stage.script}.py"


def page() -> str:
    covered = {stage.name: modules(stage) for stage in STAGES.values()}
    own = [name for name, stage in STAGES.items() if stage.script in (name, "export")]
    return "\n".join(
        [
            "# Stages",
            "",
            "`python benchmarks/stages.py` writes this page from the declarations in `src/brdfpipe/stages.py` and `src/brdfpipe/exchange/`.",
            "",
            "`CONTRIBUTING.md` says how to add a stage or a format.",
            "",
            *table(
                (
                    "Stage",
                    "Makes",
                    "From",
                    "Of materials with",
                    "Keys of `material.yaml`",
                    "Keys of `config.yaml`",
                    "Kind",
                ),
                stages(),
            ),
            "",
            "A stage runs again when its input, one of its keys, its code or a library that its code imports has changed.",
            "",
            "## Formats of other programs",
            "",
            *table(("Format", "Holds", "Files of a material", "Carries", "Read", "Takes", "Options"), formats()),
            "",
            "## Code that a stage depends on",
            "",
            f"Number of modules in the digest of each stage. Before: counted at commit {BEFORE_COMMIT} of 22 November 2026, the last one whose packages "
            "imported all their modules at once. Since then packages are lazy and every name is imported from its own module. Now: counted when "
            "this page was written; a test keeps it up to date and holds the limits of the fourth column.",
            "",
            *table(
                ("Stage", "Before", "Now", "At most", "Libraries"),
                (
                    (
                        f"`{name}`",
                        BEFORE.get(name, ""),
                        len(covered[name]),
                        LIMITS.get(name, ""),
                        ", ".join(code.libraries(script(STAGES[name]), extra_modules=STAGES[name].modules)),
                    )
                    for name in own
                ),
            ),
            "",
            f"Number of stages, of {len(own)} with a script of their own, that run again when a module is edited, before (the same commit) and now:",
            "",
            *table(("Module", "Before", "Now", "Which"), edits(covered, own)),
            "",
        ]
    )


def stages() -> Iterable[Row]:
    sources = rule_inputs()
    for name, stage in STAGES.items():
        yield (
            f"`{name}`",
            stage.makes,
            ", ".join(sources[name]),
            {"calibration": "each calibration", "catalogue": "all together"}.get(
                stage.owner_kind, stage.when.words or "any"
            ),
            ", ".join(f"`{key}`" for key in stage.keys.description),
            ", ".join(f"`{key}`" for key in stage.keys.config),
            stage.kind,
        )


def rule_inputs() -> dict[str, list[str]]:
    """Rule → its input: stages whose results it names, raw files, and other files in the words of the function that finds them."""
    inputs = {export.name: ["`bsdf`"] for export in EXPORTS}
    for path in sorted((PROJECT / "workflow" / "rules").glob("*.smk")):
        for name, body in re.findall(r"^use rule \w+ as (\w+) with:\n(.*?)(?=^\S|\Z)", path.read_text(), re.M | re.S):
            source = body.partition("output:")[0]
            stages = re.findall(r'^\s+(\w+)="\{material\}', source, re.M)
            for arguments in re.findall(r"results_of\(([^)]*)\)", source):
                stages += re.findall(r'"(\w+)"', arguments)
            found_by = [
                getattr(Pipeline, method).__doc__ for method in re.findall(r"(?:=|unpack\()pipeline\.(\w+)\)?,", source)
            ]
            inputs[name] = [
                *(f"`{stage}`" for stage in stages),
                *["raw files"] * ("raw_file(" in source),
                *(text[0].lower() + text[1:].rstrip(".") for text in found_by),
            ]
    return {
        **inputs,
        "report": ["all datasets with a kind"],
        "summary": ["all datasets with a kind"],
        "catalogue": ["`summary`"],
    }


def formats() -> Iterable[Row]:
    for name, format in FORMATS.items():
        files = [f"`<material>{suffix}`" for side in format.files for suffix in format.suffixes(side)]
        options = ", ".join(f"`{option}`: {default}" for option, default in format.options.items())
        yield (
            f"`{name}`",
            format.description,
            ", ".join(files) or "none",
            ", ".join(("reflection", *format.carries)),
            "yes" if format.read else "no",
            format.takes,
            options,
        )


def edits(covered: dict[str, tuple[str, ...]], own: list[str]) -> Iterable[Row]:
    for file, before in EDITED.items():
        module = "brdfpipe." + file.removesuffix(".py").replace("/", ".")
        names = [name for name in own if module in covered[name]]
        yield f"`{file}`", before, len(names), "all" if len(names) == len(own) else ", ".join(names)


def table(heads: tuple[str, ...], rows: Iterable[Row]) -> list[str]:
    lines = [heads, tuple("---" for _ in heads), *rows]
    return [f"| {' | '.join(map(str, row))} |" for row in lines]


if __name__ == "__main__":
    main()
