"""The stages of the workflow, declared once.

A stage is an entry of :data:`STAGES`, a rule of the same name in ``workflow/rules`` with its input and output, and a script in
``workflow/scripts`` that reads, calls one function of the package and writes. The parameters of the rule, whose change reruns
the stage, its log and message, ``rule all``, the order of the report and the table of stages in the documentation follow from the entry.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, NamedTuple

from brdfpipe.bsdf.predictions import PREDICTIONS
from brdfpipe.catalogue.calibration_keys import EmulatedCalibration
from brdfpipe.catalogue.material import BASE_INDEX, OTHER_FACES, ROUTES, unused_keys
from brdfpipe.catalogue.material_keys import (
    MEASURED_GLOSS,
    BeckmannSurface,
    EmulatedRig,
    FlatSurface,
    GgxSurface,
    MeasuredSurface,
    MultiangleColours,
    MultiangleFile,
)
from brdfpipe.exchange.registry import FORMATS, Format
from brdfpipe.masking.modes import (
    HALOS,
    MODEL_DEFAULTS,
    RECIPES,
    SMITH_MASKINGS,
    TRUTHS,
    allows_several_reflections,
    optics_of,
)
from brdfpipe.scenes import geometries
from brdfpipe.scenes.domain import Domain
from brdfpipe.scenes.results import PARTS, RESULTS
from brdfpipe.store import canonical_json
from brdfpipe.texture.file_names import MAP_FILES, PAINT_FILES, PICTURE_FILES, RENDERER_FILES, TEXTURED_FORMATS

if TYPE_CHECKING:
    from brdfpipe.catalogue.calibration import Calibration
    from brdfpipe.catalogue.material import Material
    from brdfpipe.descriptions.keys import Keys
    from brdfpipe.rig.plan import Arrangement
    from brdfpipe.scenes.scene import Scene

Wildcards = Mapping[str, str]
"""Wildcards of a job beside its material or calibration: scan; or load, side and incidence."""


@dataclass(frozen=True)
class Subject:
    """A material or a calibration with the configuration and its rig arrangements: from these follow its stages and their parameters."""

    owner: Material | Calibration
    config: Mapping[str, Any]
    arrangements: Sequence[Arrangement] = ()
    """Arrangements of its run of a camera rig."""
    scene: Scene | None = None
    """What the results are for; None for stages that all scenes share, which are the same whatever a scene asks for."""

    def asks(self, *results: str) -> bool:
        """Whether the scene asks for one of these results; always without a scene."""
        return self.scene is None or self.scene.asks(*results)

    @property
    def exports(self) -> tuple[str, ...]:
        """Formats of the files for other programs."""
        named = tuple(self.owner.content["exports"])
        return named if self.scene is None else self.scene.exports(named)

    @property
    def route(self) -> str:
        """How the BSDF is obtained: measured, imported, flake or predicted."""
        return next((route for part, route in ROUTES if part in self.owner.content), "predicted")

    @cached_property
    def planned(self) -> bool:
        """Whether the model is the cheapest that the scene allows; keys of ``model`` decide themselves."""
        content = self.owner.content
        unplanned = "flat", MEASURED_GLOSS
        facets = not {"slab", "coat"} & set(content) and content.get("surface", {}).get("distribution") not in unplanned
        known = "surface" in content and "index" in content and facets and not content.get("model")
        return self.scene is not None and self.scene.plans and self.route == "predicted" and known

    @property
    def predicts(self) -> bool:
        """Whether a prediction is needed: as the BSDF, or beside a measured one."""
        return self.route == "predicted" or self.asks("comparison")

    def section(self, path: str) -> Any:
        """A part of the description, as ``slab.back``; ``rig`` of a calibration is its whole description."""
        content: Any = self.owner.content
        if path == "rig" and "rig" not in content:
            return content
        for name in path.split("."):
            content = content[name]
        return content


@dataclass(frozen=True)
class Condition:
    """Which materials have a stage."""

    words: str
    """For the documentation, after "materials with"; empty for all materials."""
    holds: Callable[[Subject], bool]

    def __and__(self, other: Condition) -> Condition:
        return Condition(f"{self.words}, {other.words}", lambda subject: self.holds(subject) and other.holds(subject))


@dataclass(frozen=True)
class StageKeys:
    """The keys that a stage depends on: its parameters."""

    description: tuple[str, ...] = ()
    """Keys of ``material.yaml``."""
    config: tuple[str, ...] = ()
    """Keys of ``config.yaml``."""
    read: Callable[[Subject, Wildcards], dict[str, Any]] = lambda subject, wildcards: {}

    def __or__(self, other: StageKeys) -> StageKeys:
        return StageKeys(
            self.description + other.description,
            self.config + other.config,
            lambda subject, wildcards: self.read(subject, wildcards) | other.read(subject, wildcards),
        )


@dataclass(frozen=True)
class Stage:
    """One stage: its result, the materials that have it, the keys that it depends on, and its script."""

    name: str
    """Of its rule."""
    makes: str
    when: Condition = Condition("", lambda subject: True)
    keys: StageKeys = StageKeys()
    script: str = ""
    """By default the name."""
    owner_kind: str = "material"
    """Owner of the results: ``material``, ``calibration`` or ``catalogue``."""
    instances: Callable[[Subject], list[dict[str, str]]] | None = None
    """Further wildcards of each job for a subject; None for a single job without any."""
    job_title: str = ""
    """Name of a job in logs and failures, with its wildcards; by default the name of the stage."""
    modules: tuple[str, ...] = ()
    """Modules that the script imports at run time by a name, for the code digest."""
    kind: str | None = None
    """Kind of its dataset; empty for a stage without one. By default the name of the script."""
    reported: bool = True
    """Whether the report reads that dataset."""
    of_prediction: bool = False
    """Whether only a prediction needs it."""
    stands_for: str = ""
    """Another stage in whose place its result is read, where a scene has this one instead."""
    intermediate: bool = False
    """Whether the result may be deleted: it is made again only when another stage that needs it runs."""
    fills_folder: bool = False
    """Whether the stage also writes other files into the folder of its result, which is its alone."""
    beside: tuple[str, ...] = ()
    """Patterns of files that the stage may write beside its result."""
    memory: int = 1000
    """Largest memory of a job, MB; workers hold libraries and what earlier stages left, 900 MB in a build of 100 materials."""
    minutes: int = 0
    """Longest time of a job on a busy core, for schedulers of clusters; 0: seconds."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "job_title", self.job_title or self.name)
        object.__setattr__(self, "script", self.script or self.name)
        if self.kind is None:
            object.__setattr__(self, "kind", self.script)

    def jobs(self, subject: Subject) -> list[dict[str, str]]:
        """Wildcards of the jobs for a subject, beside its name; no job where the condition does not hold."""
        if not self.when.holds(subject) or (self.of_prediction and not subject.predicts):
            return []
        return [{}] if self.instances is None else self.instances(subject)

    def parameters(self, subject: Subject, wildcards: Wildcards | None = None) -> dict[str, Any]:
        """The part of the description and the configuration that the stage depends on."""
        return self.keys.read(subject, wildcards or {})


# --- conditions


def _has(part: str, words: str = "") -> Condition:
    """See :meth:`brdfpipe.catalogue.material.Material.has`."""
    return Condition(words or f"`{part}`", lambda subject: subject.owner.has(part))  # type: ignore[union-attr]


_FULLEST = Condition("a scene with the fullest model", lambda subject: not subject.planned)
_PLANNED = Condition(
    "a scene with the cheapest model, `surface`, `index`, no `slab`, `coat` or `model`", lambda subject: subject.planned
)


def _names_file(part: str, key: str) -> Condition:
    """The description names a raw file for a part."""
    return Condition(f"`{key}.file`", lambda subject: part in subject.owner.files)


def _asked(*results: str) -> Condition:
    """The scene asks for one of these results; ``exports``: for any format."""
    named = [name for name in results if name in RESULTS]
    words = f"a scene that asks for {' or '.join(f'`{name}`' for name in results)}"
    return Condition(words, lambda subject: subject.asks(*named) or ("exports" in results and bool(subject.exports)))


_MEASURED_RELIEF = _names_file("surface", "surface")
_KNOWN_ROUGHNESS = Condition(
    "`surface.file` or `surface.length`",
    lambda subject: _MEASURED_RELIEF.holds(subject) or "length" in subject.owner.content.get("surface", {}),
)


_KNOWN_BY_GLOSS = Condition(
    f"`surface.distribution: {MEASURED_GLOSS}`",
    lambda subject: subject.owner.content.get("surface", {}).get("distribution") == MEASURED_GLOSS,
)
_OTHER_FINISH = Condition("a finish not known by gloss", lambda subject: not _KNOWN_BY_GLOSS.holds(subject))


def _face_optics(subject: Subject) -> str:
    """Optics of the faces of a clear body: waves, where their spectrum is known, have Smith's masking alone."""
    default = "auto" if _masking(subject) == SMITH_MASKINGS[0] else "facets"
    return str(subject.section("model").get("optics", default))


_WAVES = Condition("`model.optics` other than facets", lambda subject: optics_of(subject.section("model")) != "facets")
_TWO_FACES = Condition("`slab` or `coat`", lambda subject: bool({"slab", "coat"} & set(subject.owner.content)))
_ONE_FACE = Condition("no `slab` or `coat`", lambda subject: not _TWO_FACES.holds(subject))
_KNOWN_BACK_ROUGHNESS = Condition(
    "`slab.back.file` or `slab.back.length`",
    lambda subject: subject.owner.has("back") and bool({"file", "length"} & set(subject.section("slab.back"))),  # type: ignore[union-attr]
)


def _truth(subject: Subject) -> str:
    """What reference solutions are for: check, none or use."""
    return str(subject.section("model").get("truth", TRUTHS[0]))


_CHECKED = Condition("`model.truth: check`", lambda subject: _truth(subject) == "check")
_PREDICTED = Condition("`model.truth` other than use", lambda subject: _truth(subject) != "use")


def _masking(subject: Subject) -> str:
    """The masking that the keys or the recipe name, or the default; Smith's where nothing is traced."""
    model = subject.section("model")
    named = (
        RECIPES.get(model.get("recipe", ""), MODEL_DEFAULTS)["masking"] if "masking" not in model else model["masking"]
    )
    untraced = _TWO_FACES.holds(subject) or not _MEASURED_RELIEF.holds(subject)
    return SMITH_MASKINGS[0] if named == "auto" and untraced else str(named)


def _multiple_scattering(subject: Subject) -> str:
    """The mode that the key or the recipe names, or the default; ``none`` where ``auto`` cannot add light, or waves alone reflect it."""
    model = subject.section("model")
    modes = RECIPES.get(model.get("recipe", ""), MODEL_DEFAULTS) | model
    allowed = allows_several_reflections(_masking(subject), modes["diffuse"]) and optics_of(model) != "wave"
    named = str(modes["multiple_scattering"])
    # Gloss is a continuous function of the slopes only with all light that facets reflect.
    named = "directional" if named == "auto" and allowed and _KNOWN_BY_GLOSS.holds(subject) else named
    return "none" if named == "auto" and not allowed else named


_GRAIN = Condition(
    "`texture.pixel` of a scan",
    lambda subject: "texture" in subject.owner.content and "pictures" not in subject.section("texture"),
)

_TRACED_REFLECTIONS = Condition(
    "`model.multiple_scattering: auto` or measured",
    lambda subject: _multiple_scattering(subject) in ("auto", "measured"),
)
_TRACED_MASKING = Condition(
    "`model.masking: auto` or measured", lambda subject: _masking(subject) in ("auto", "measured")
)


def _has_waves_at_faces(subject: Subject) -> bool:
    known = _KNOWN_ROUGHNESS.holds(subject) or _KNOWN_BACK_ROUGHNESS.holds(subject)
    return known and _face_optics(subject) != "facets"


def _enabled(key: str) -> Condition:
    return Condition(f"`{key}: true` in the configuration", lambda subject: bool(subject.config[key]))


def _comparable(subject: Subject) -> bool:
    # A perfectly flat surface reflects into a single direction, for which no cell measures a BRDF.
    flat = subject.section("surface").get("distribution") == "flat"
    mirrors = flat or (subject.owner.has("slab") and _has_waves_at_faces(subject))  # type: ignore[union-attr]
    return not mirrors and any(item.load == "sample" and item.side == "reflection" for item in subject.arrangements)


# --- keys


def _keys(*names: str, optional: Sequence[str] = ()) -> StageKeys:
    """Keys at the top level of the description; an ``optional`` one is a parameter only where it is given."""

    def read(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
        given = [name for name in optional if name in subject.owner.content]
        return {name: subject.section(name) for name in (*names, *given)}

    return StageKeys((*names, *optional), (), read)


def _block(path: str, only: Sequence[str] = ()) -> StageKeys:
    """The keys of a block of the description: all, or some."""

    def read(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
        content = subject.section(path)
        return {key: content[key] for key in content if not only or key in only}

    return StageKeys(tuple(f"{path}.{key}" for key in only) or (path,), (), read)


def _spectrum(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
    """The block ``spectrum``; what a file inherits from the catalogue is a fallback, which a statement in the file overrules."""

    def with_fallbacks(block: Mapping[str, Any], place: str) -> dict[str, Any]:
        names = [
            name
            for name in ("geometry", "incidence", "specular_trap", "reflectance_uncertainty")
            if f"{place}.{name}" in subject.owner.inherited  # type: ignore[union-attr]
        ]
        return {**block, "fallbacks": names} if names and ("file" in block or "sci" in block) else dict(block)

    spectrum = with_fallbacks(subject.section("spectrum"), "spectrum")
    return spectrum | {
        half: with_fallbacks(spectrum[half], f"spectrum.{half}") for half in ("sci", "sce") if half in spectrum
    }


_SPECTRUM = StageKeys(("spectrum",), (), _spectrum)


def _read_by(stage: str, *declarations: type[Keys]) -> tuple[str, ...]:
    """The keys whose declaration names a stage."""
    return tuple(dict.fromkeys(key for declaration in declarations for key in declaration.read_by(stage)))


def _config_keys(**keys: str) -> StageKeys:
    """Keys of the configuration by the names of the parameters."""
    return StageKeys(
        (), tuple(keys.values()), lambda subject, _: {name: subject.config[key] for name, key in keys.items()}
    )


def _config_block(part: str) -> StageKeys:
    """All keys of a block of the configuration."""
    return StageKeys((), (part,), lambda subject, _: dict(subject.config[part]))


def _doubtful_inputs() -> StageKeys:
    """The uncertainties of inputs that a comparison may change."""
    return StageKeys((), ("comparison",), lambda subject, _: {"doubtful": dict(subject.config["comparison"])})


_SURFACES = (MeasuredSurface, BeckmannSurface, GgxSurface, FlatSurface)
_SCAN_KEYS, _SLOPE_KEYS, _SPECTRUM_KEYS = (_read_by(stage, *_SURFACES) for stage in ("surface", "facets", "psd"))
_COLOURS = (MultiangleFile, MultiangleColours)
_ARRANGEMENT = StageKeys(read=lambda subject, wildcards: {**wildcards, "incidence": float(wildcards["incidence"])})


_OF_FIRST_SCAN = ("azimuth", "region", "mask")
"""Keys of `surface` that further scans do not share."""


def _further_scan(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
    """Keys of a further scan: those of the first one, and its own instead; how the file is written only of the same extension."""
    surface = subject.section("surface")
    own = dict(surface["scans"][int(wildcards["scan"]) - 2])
    alike = PurePath(own["file"]).suffix.lower() == PurePath(surface["file"]).suffix.lower()
    shared = _SCAN_KEYS if alike else ("form", "lambda_s", "lambda_c", "outliers")
    return {key: surface[key] for key in shared if key in surface and key not in _OF_FIRST_SCAN} | own


def _facet_model(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
    """The choices of facets with their defaults, so that writing a default changes nothing."""
    model = subject.section("model")
    if "slab" in subject.owner.content:
        return {"masking": _masking(subject), "optics": _face_optics(subject)}
    # Facets alone are judged by the roughness.
    alone = {"optics": "facets"} if _KNOWN_ROUGHNESS.holds(subject) and optics_of(model) == "facets" else {}
    if "recipe" in model:
        return {"recipe": model["recipe"]} | alone
    chosen = {key: model.get(key, default) for key, default in MODEL_DEFAULTS.items()}
    return chosen | {"masking": _masking(subject), "multiple_scattering": _multiple_scattering(subject)} | alone


def _coated_model(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
    return {"masking": _masking(subject)} | _word_of_base(subject, wildcards)


def _word_of_base(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
    """The word of a face of a coated body that is not described itself: flat or same."""
    return {} if subject.owner.has("base") else {"base": subject.section(OTHER_FACES["base"])}  # type: ignore[union-attr]


def _wave_model(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
    """The choices of waves with their defaults."""
    model = subject.section("model")
    defaults = {"diffuse": MODEL_DEFAULTS["diffuse"], "halo": HALOS[0]}
    return {"optics": optics_of(model)} | {key: model.get(key, default) for key, default in defaults.items()}


def _base_of_reference(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
    return {"diffuse": subject.section("model").get("diffuse", MODEL_DEFAULTS["diffuse"])}


def _route(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
    return {"route": subject.route}


def _plan(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
    return {} if subject.scene is None else subject.scene.accepted_error


def source_of_bsdf(subject: Subject) -> str:
    """The stage whose dataset is the BSDF without the changes by the uncertainties of its inputs."""
    if subject.route != "predicted":
        return subject.route
    return next(name for name in PREDICTIONS if STAGES[name].jobs(subject))


EVERYWHERE = Domain({"hemisphere": {"theta_i": [0, 90], "phi_i": [0, 360]}})
"""All directions of reflection."""


def geometries_in(domain: Domain, config: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Parts of the appearance that depend on the domain of a scene → the geometries of the configuration, or of the domain, in it."""
    from brdfpipe.appearance.colours import FLOP_GEOMETRIES, GEOMETRIES

    further = config["appearance"]
    # Names of the flop index first: 45as45 is the same geometry as 45:0.
    names = [*FLOP_GEOMETRIES, *GEOMETRIES, *further["geometries"]]
    return {
        "gloss": geometries.gloss_angles(domain, config["gloss_angles"]),
        "haze": geometries.haze_windows(domain, further["haze"]),
        "colour": geometries.colour_geometries(domain, names),
    }


@lru_cache(64)
def _known_geometries(domain: str, config: str) -> dict[str, list[Any]]:
    """As :func:`geometries_in`, of JSON: the same for all materials of a scene; nobody may change it."""
    content = json.loads(domain)
    return geometries_in(EVERYWHERE if content is None else Domain(content), json.loads(config))


def _appearance_parts(subject: Subject) -> dict[str, list[Any]]:
    """The parts of the appearance that the scene asks for → their geometries in its domain; gloss and haze without any are left out."""
    domain = None if subject.scene is None else subject.scene.content["domain"]
    config = {key: subject.config[key] for key in ("appearance", "gloss_angles")}
    found = _known_geometries(canonical_json(domain), canonical_json(config))
    wanted = PARTS if subject.scene is None else subject.scene.parts
    return {part: found.get(part, []) for part in wanted if part not in ("gloss", "haze") or found[part]}


def _appearance(subject: Subject) -> dict[str, Any]:
    """The settings of the parts of the appearance that the scene asks for, empty where there are none; without ``parts``: all."""
    config, parts = subject.config, _appearance_parts(subject)
    cabin = None
    if subject.scene is not None and subject.scene.asks("veiling_glare"):
        cabin = subject.scene.content.get("glare", {})
    if not parts and cabin is None:
        return {}
    settings: dict[str, Any] = {} if list(parts) == list(PARTS) else {"parts": list(parts)}
    if cabin is not None:
        settings["cabin"] = cabin
    if "gloss" in parts:
        settings["gloss_angles"] = parts["gloss"]
    if "haze" in parts:
        settings["haze"] = parts["haze"]
    if "colour" in parts:
        settings |= {"illuminant": config["illuminant"], "observer": config["observer"]}
        own = {"geometries": parts["colour"], "standard_geometries": False}
        every = parts["colour"] == _appearance_parts(replace(subject, scene=None))["colour"]
        settings |= {"geometries": config["appearance"]["geometries"]} if every else own
    return settings


def _part_of_table(subject: Subject) -> dict[str, Any]:
    """What of the table of the configuration a scene needs, where that is not all: its wavelengths, incidences and side."""
    if subject.scene is None:
        return {}
    domain, bands = subject.scene.domain, subject.scene.content["bands"]
    nodes, needed = subject.config["table"]["theta_i"], domain.incidences
    part: dict[str, Any] = {} if isinstance(bands, str) else {"wavelength": bands}
    if not any(low <= nodes[0] and high >= nodes[-1] for low, high in needed):
        part["incidence"] = needed
    if not domain.transmits:
        part["side"] = "reflection"
    return part


def _texture(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
    """The keys of the texture, and the distance from which the scene sees it."""
    return dict(subject.section("texture")) | _viewing_distance(subject, wildcards)


def _picture_texture(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
    """The keys of the texture, with the geometries of its files and the formats of the materials that have it."""
    given = {key: value for key, value in subject.section("texture").items() if key != "pictures"}
    geometries = [picture["geometry"] for picture in subject.section("texture")["pictures"]]
    return given | {"geometries": geometries, "formats": _textured_formats(subject)}


def _viewing_distance(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
    """The distance from which the scene sees the texture, where it says so."""
    distance = None if subject.scene is None else subject.scene.content.get("viewing_distance")
    return {} if distance is None else {"distance": distance}


def _textured_formats(subject: Subject) -> list[str]:
    """The formats of the exports that can refer to maps."""
    return [name for name in TEXTURED_FORMATS if name in subject.exports]


def _gloss_readings(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
    measured = subject.section("measured")
    stated = {"gloss_u": u} if (u := measured["uncertainty"].get("gloss")) is not None else {}
    return {"gloss": measured["gloss"], "slopes": subject.section("surface")["slopes"]} | stated


def _fitted_readings(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
    """The readings that the BSDF was fitted to."""
    predicted = subject.route == "predicted" and _KNOWN_BY_GLOSS.holds(subject)
    return {"fitted": [f"gloss {angle}°" for angle in subject.section("measured")["gloss"]]} if predicted else {}


def _interior(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
    body = "coat" if "coat" in subject.owner.content else "slab"
    given = {key: value for key, value in subject.section(body).items() if key not in ("back", "base")}
    return (
        ({} if "absorption" in given else {"internal_transmittance": 1})
        | given
        | ({"body": body} if body == "coat" else {})
    )


def _page_parameters(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
    unused = unused_keys(subject.owner.content)
    return (
        _row_parameters(subject, wildcards)
        | ({"unused": unused} if unused else {})
        | ({"origins": [list(row) for row in rows]} if (rows := subject.owner.origins) else {})  # type: ignore[union-attr]
    )


def _row_parameters(subject: Subject, wildcards: Wildcards) -> dict[str, Any]:
    content = subject.owner.content
    accepted = {"accepted": content["accept"]} if "accept" in content else {}
    return {"description": content.get("description", "")} | accepted


# --- jobs


def _further_scans(subject: Subject) -> list[dict[str, str]]:
    return [{"scan": str(number)} for number, _ in enumerate(subject.section("surface").get("scans", []), start=2)]


def _arrangements(load: str) -> Callable[[Subject], list[dict[str, str]]]:
    """The arrangements of a run in which the sample, or the etalon, is measured."""

    def wildcards(subject: Subject) -> list[dict[str, str]]:
        return [
            {"load": load, "side": item.side, "incidence": f"{item.incidence:g}"}
            for item in subject.arrangements
            if item.load == load and not item.again
        ]

    return wildcards


def _sides(subject: Subject) -> list[dict[str, str]]:
    """The sides of the sample that were measured."""
    return [{"side": side} for side in dict.fromkeys(job["side"] for job in _arrangements("sample")(subject))]


class Export(NamedTuple):
    """The files of one format for one side of a material."""

    format: Format
    side: str

    @property
    def name(self) -> str:
        """Name of the stage and its rule."""
        return f"export_{self.format.name.replace('-', '_')}" + ("" if self.side == "reflection" else f"_{self.side}")

    @property
    def result(self) -> str:
        """Pattern of the dataset that says what was written."""
        return f"{{scene}}{{material}}/{self.name}.nc"

    @property
    def files(self) -> tuple[str, ...]:
        """Patterns of the files, the main one first."""
        return tuple(
            f"{{scene}}{{material}}/exports/{{material}}{suffix}" for suffix in self.format.suffixes(self.side)
        )

    @property
    def stage(self) -> Stage:
        name = self.format.name
        requested = Condition(f"`exports: [{name}]`", lambda subject: name in subject.exports)
        return Stage(
            self.name,
            f"{self.format.description}: {self.side}",
            when=requested & _has("slab") if self.side == "transmission" else requested,
            keys=StageKeys(("exports",), (), lambda subject, _: {"format": name, "side": self.side}),
            script="export",
            modules=(self.format.module,),
            beside=self.files,
            memory=1500,
            minutes=1,
        )


EXPORTS = tuple(Export(format, side) for format in FORMATS.values() for side in format.files)
"""One for each format and each side with separate files."""


_STAGES = (
    Stage(
        "surface",
        "the relief of the surface, read and levelled",
        when=_MEASURED_RELIEF,
        keys=_block("surface", _SCAN_KEYS),
        of_prediction=True,
    ),
    Stage(
        "scan",
        "a further scan of the surface, read and levelled",
        when=_MEASURED_RELIEF,
        keys=StageKeys(("surface.scans", *(f"surface.{key}" for key in _SCAN_KEYS)), (), _further_scan),
        script="surface",
        instances=_further_scans,
        job_title="surface-{scan}",
        reported=False,
        of_prediction=True,
    ),
    Stage(
        "facets",
        "the slope density of the facets",
        when=_has("surface") & _OTHER_FINISH,
        keys=_block("surface", _SLOPE_KEYS),
        of_prediction=True,
    ),
    Stage(
        "gloss_facets",
        "the slope density of a finish that is known by its gloss",
        when=_KNOWN_BY_GLOSS,
        keys=StageKeys(("measured.gloss", "measured.uncertainty.gloss", "surface.slopes"), (), _gloss_readings),
        kind="facets",
        reported=False,
        of_prediction=True,
        stands_for="facets",
    ),
    Stage(
        "psd",
        "the roughness spectrum of the surface",
        when=_KNOWN_ROUGHNESS,
        keys=_block("surface", _SPECTRUM_KEYS),
        of_prediction=True,
    ),
    Stage(
        "back_surface",
        "the relief of the back of a clear body",
        when=_names_file("back_surface", "slab.back"),
        keys=_block("slab.back", _SCAN_KEYS),
        script="other_surface",
        kind="surface",
        of_prediction=True,
    ),
    Stage(
        "back_facets",
        "the slope density of the back of a clear body",
        when=_has("back", "`slab.back`"),
        keys=_block("slab.back", _SLOPE_KEYS),
        script="facets",
        of_prediction=True,
    ),
    Stage(
        "back_psd",
        "the roughness spectrum of the back of a clear body",
        when=_KNOWN_BACK_ROUGHNESS,
        keys=_block("slab.back", _SPECTRUM_KEYS),
        script="psd",
        of_prediction=True,
    ),
    Stage(
        "base_surface",
        "the relief of the body below a coat",
        when=_names_file("base_surface", OTHER_FACES["base"]),
        keys=_block(OTHER_FACES["base"], _SCAN_KEYS),
        script="other_surface",
        kind="surface",
        of_prediction=True,
    ),
    Stage(
        "base_facets",
        "the slope density of the body below a coat",
        when=_has("base", f"`{OTHER_FACES['base']}`"),
        keys=_block(OTHER_FACES["base"], _SLOPE_KEYS),
        script="facets",
        of_prediction=True,
    ),
    Stage(
        "base_index",
        "the refractive index of the body below a coat",
        when=_has("coat"),
        keys=StageKeys((BASE_INDEX,), (), lambda subject, _: {"index": subject.section(BASE_INDEX)}),
        script="index",
        of_prediction=True,
    ),
    Stage(
        "visibility",
        "the visibility of the facets, traced on their heights, where Smith's masking does not describe it",
        when=_MEASURED_RELIEF & _TRACED_MASKING & _PREDICTED & _FULLEST,
        keys=StageKeys(("model.masking",), (), lambda subject, _: {"masking": _masking(subject)}),
        memory=2000,
        of_prediction=True,
    ),
    Stage(
        "spectrum",
        "the total reflectance, measured or recovered from a colour",
        when=_has("spectrum"),
        keys=_SPECTRUM,
        of_prediction=True,
    ),
    Stage(
        "index",
        "the refractive index",
        when=_has("index"),
        keys=_keys("index", optional=("index_uncertainty",)),
        of_prediction=True,
    ),
    Stage(
        "interreflection",
        "the light that the height map reflects more than once, traced on it, where there is enough of it",
        when=_MEASURED_RELIEF & _TRACED_REFLECTIONS & _ONE_FACE & _PREDICTED & _FULLEST,
        keys=StageKeys(
            ("model.multiple_scattering",),
            (),
            lambda subject, _: {"multiple_scattering": _multiple_scattering(subject)},
        ),
        memory=2000,
        of_prediction=True,
    ),
    Stage(
        "interior",
        "the internal transmittance of a clear body or a coat",
        when=_TWO_FACES,
        keys=StageKeys(
            tuple(
                f"{body}.{key}"
                for body in ("slab", "coat")
                for key in ("thickness", "internal_transmittance", "absorption", "transmittance_uncertainty")
            ),
            (),
            _interior,
        ),
        of_prediction=True,
    ),
    Stage(
        "multiangle",
        "colours or reflectance factors at several geometries",
        when=_has("multiangle"),
        keys=_block("multiangle", _read_by("multiangle", *_COLOURS)),
    ),
    Stage(
        "predicted",
        "the BSDF that facets, index and spectrum predict",
        when=_has("predicted", "`surface`, or a `spectrum` alone") & _ONE_FACE & _PREDICTED & _FULLEST,
        keys=StageKeys(("model",), (), _facet_model),
        kind="bsdf",
        of_prediction=True,
    ),
    Stage(
        "sheet",
        "the BSDF of a clear body that both faces, index and internal transmittance predict",
        when=_has("slab"),
        keys=StageKeys(("model",), (), _facet_model),
        kind="bsdf",
        memory=1500,
        of_prediction=True,
    ),
    Stage(
        "coated",
        "the BSDF that both faces, both indices, the coat and the spectrum predict of a coated body",
        when=_has("coat"),
        keys=StageKeys(("model.masking", OTHER_FACES["base"]), (), _coated_model),
        kind="bsdf",
        memory=1500,
        minutes=1,
        of_prediction=True,
    ),
    Stage(
        "wave",
        "the BSDF that the roughness spectrum predicts by wave optics, joined with that of facets",
        when=_has("predicted", "`surface`") & _KNOWN_ROUGHNESS & _WAVES & _ONE_FACE & _PREDICTED & _FULLEST,
        keys=StageKeys(("model",), (), _wave_model),
        kind="bsdf",
        of_prediction=True,
        minutes=1,
    ),
    Stage(
        "reference",
        "the BSDF that rays or diffraction on the height map give",
        when=_MEASURED_RELIEF & Condition("`model.truth: use`", lambda subject: _truth(subject) == "use"),
        keys=StageKeys(("model.diffuse",), (), _base_of_reference),
        kind="bsdf",
        of_prediction=True,
        minutes=1,
    ),
    Stage(
        "model_error",
        "the predicted BSDF beside rays and diffraction on its own scan",
        when=_MEASURED_RELIEF & _ONE_FACE & _CHECKED & _asked("model_error", "uncertainty"),
        of_prediction=True,
    ),
    Stage(
        "uncertainty",
        "the changes of the predicted BSDF by the uncertainties of its inputs",
        when=_has("predicted") & _ONE_FACE & _PREDICTED & _asked("uncertainty"),
        of_prediction=True,
    ),
    Stage(
        "sheet_uncertainty",
        "the changes of the BSDF of a clear body by the uncertainties of its inputs",
        when=_has("slab") & _asked("uncertainty"),
        kind="uncertainty",
        of_prediction=True,
    ),
    Stage(
        "coated_uncertainty",
        "the changes of the BSDF of a coated body by the uncertainties of its inputs",
        when=_has("coat") & _asked("uncertainty"),
        keys=StageKeys((OTHER_FACES["base"],), (), _word_of_base),
        kind="uncertainty",
        memory=1500,
        minutes=1,
        of_prediction=True,
    ),
    Stage(
        "flake",
        "the BRDF of an effect paint, fitted along the flake angle",
        when=_has("multiangle"),
        keys=_block("multiangle", _read_by("flake", *_COLOURS)),
        kind="bsdf",
    ),
    Stage(
        "flake_uncertainty",
        "the changes of the BSDF of an effect paint by the uncertainties of its colours, its clear coat and its fit",
        when=_has("multiangle") & _asked("uncertainty"),
        keys=_block("multiangle", _read_by("flake_uncertainty", *_COLOURS)),
        kind="uncertainty",
    ),
    Stage(
        "imported",
        "the BSDF of a file of another program or instrument",
        when=_has("table"),
        keys=_block("table", ("format", "quantity")),
        modules=tuple(format.module for format in FORMATS.values() if format.read),
        kind="bsdf",
        reported=False,
        memory=2000,
        minutes=1,
    ),
    Stage(
        "rig_run",
        "the frames of an emulated rig",
        when=_has("rig"),
        keys=_block("rig", EmulatedRig.read_by("rig_run")),
        intermediate=True,
        fills_folder=True,
        kind="",
        minutes=1,
    ),
    Stage(
        "calibration_run",
        "the frames of an emulated rig with the etalon",
        keys=_block("rig", EmulatedRig.read_by("rig_run")),
        script="rig_run",
        owner_kind="calibration",
        job_title="rig_run",
        intermediate=True,
        fills_folder=True,
        kind="",
        minutes=1,
    ),
    Stage(
        "reduced",
        "the light of each cell relative to the reference, of one arrangement",
        when=_has("rig"),
        keys=_block("rig", EmulatedRig.read_by("reduced")) | _ARRANGEMENT,
        instances=_arrangements("sample"),
        job_title="reduced-{load}-{side}-{incidence}",
        intermediate=True,
    ),
    Stage(
        "calibration_reduced",
        "the same for an arrangement of the etalon",
        keys=_block("rig", EmulatedRig.read_by("reduced")) | _ARRANGEMENT,
        script="reduced",
        owner_kind="calibration",
        instances=_arrangements("etalon"),
        job_title="reduced-{load}-{side}-{incidence}",
        reported=False,
        intermediate=True,
    ),
    Stage(
        "primary",
        "the calibrated BSDF of each cell, with its uncertainty",
        when=_has("rig"),
        keys=_block("rig", EmulatedRig.read_by("primary")),
        instances=_sides,
        job_title="primary-{side}",
        intermediate=True,
    ),
    Stage(
        "smoothed",
        "the values of the cells, smoothed at each incidence",
        when=_has("rig"),
        keys=_block("rig", EmulatedRig.read_by("smoothed")),
        instances=_sides,
        job_title="smoothed-{side}",
        intermediate=True,
    ),
    Stage(
        "calibration",
        "the calibration profile of a rig",
        keys=_block("rig", EmulatedCalibration.read_by("calibration")),
        owner_kind="calibration",
        intermediate=True,
        minutes=1,
    ),
    Stage("measured", "the measured BSDF, completed to all directions", when=_has("rig"), kind="bsdf", reported=False),
    Stage(
        "comparison",
        "measured against predicted, and the inputs that would agree",
        when=_has("rig") & _has("surface") & Condition("reflection measured", _comparable) & _asked("comparison"),
        keys=_config_block("comparison"),
    ),
    Stage(
        "bsdf",
        "the BSDF: measured, else of a file, else of flakes, else predicted",
        when=_asked("uncertainty"),
        keys=StageKeys(read=_route),
    ),
    Stage(
        "nominal_bsdf",
        "the same without the changes by the uncertainties of its inputs",
        when=Condition("a scene that does not ask for `uncertainty`", lambda subject: not subject.asks("uncertainty"))
        & _FULLEST,
        keys=StageKeys(read=_route),
        script="bsdf",
        reported=False,
        stands_for="bsdf",
    ),
    Stage(
        "plan",
        "the cheapest model whose error the scene accepts, by what was measured on other materials",
        when=_PLANNED,
        keys=StageKeys(read=_plan),
    ),
    Stage(
        "planned",
        "the BSDF of that model",
        when=_PLANNED,
        kind="bsdf",
        reported=False,
        stands_for="bsdf",
        memory=2000,
    ),
    Stage("checks", "reciprocity, energy and closure", when=_asked("checks")),
    Stage(
        "appearance",
        "gloss, haze and colours",
        when=Condition(_asked(*PARTS, "veiling_glare").words, lambda subject: bool(_appearance(subject))),
        keys=StageKeys(
            (), ("illuminant", "observer", "gloss_angles", "appearance"), lambda subject, _: _appearance(subject)
        ),
        minutes=1,
    ),
    Stage(
        "readings",
        "readings of instruments beside what the BSDF predicts of them",
        when=_has("measured") & _asked("comparison"),
        keys=_keys("measured") | StageKeys(("surface.distribution",), (), _fitted_readings) | _doubtful_inputs(),
    ),
    Stage(
        "preview",
        "a picture of the material",
        when=_enabled("preview") & _asked("preview"),
        keys=_config_keys(illuminant="illuminant", light="preview_light"),
        minutes=1,
    ),
    Stage(
        "table",
        "the BSDF on a grid of directions",
        when=_asked("table"),
        keys=StageKeys((), ("table",), lambda subject, _: dict(subject.config["table"]) | _part_of_table(subject)),
        kind="bsdf",
        minutes=1,
    ),
    Stage(
        "lambert_gauss",
        "the Lambert + Gaussian parameters",
        when=_asked("lambert_gauss"),
        keys=_config_block("lambert_gauss"),
        kind="bsdf",
    ),
    Stage(
        "texture",
        "the grain of the surface as a tileable map, and the facets that its pixels do not resolve",
        when=_GRAIN & _asked("texture"),
        keys=StageKeys(("texture",), (), _texture),
        beside=tuple(f"{{scene}}{{material}}/exports/{{material}}{end}" for end in MAP_FILES),
        memory=2000,
        minutes=1,
    ),
    Stage(
        "picture_texture",
        "the texture of an effect paint from pictures, with its sparkle and graininess, and materials of renderers with it",
        when=Condition("`texture.pictures`", lambda subject: "pictures" in subject.owner.content.get("texture", {}))
        & _asked("texture"),
        keys=StageKeys(("texture", "exports"), (), _picture_texture),
        kind="texture",
        beside=tuple(f"{{scene}}{{material}}/exports/{{material}}{end}" for end in (*PICTURE_FILES, *PAINT_FILES)),
        memory=2000,
        minutes=1,
    ),
    Stage(
        "unresolved",
        "the BSDF of what the pixels of a texture do not resolve, and materials of renderers with both",
        when=_GRAIN & _asked("texture"),
        keys=StageKeys(("exports",), (), lambda subject, _: {"formats": _textured_formats(subject)}),
        kind="bsdf",
        beside=tuple(f"{{scene}}{{material}}/exports/{{material}}{end}" for end in RENDERER_FILES),
        memory=1500,
        minutes=1,
    ),
    Stage(
        "texture_preview",
        "pictures of the visible structure as an eye sees it from a distance",
        when=_has("texture") & _enabled("preview") & _asked("preview") & _asked("texture"),
        keys=_config_keys(illuminant="illuminant") | StageKeys(read=_viewing_distance),
        kind="preview",
        memory=2000,
        minutes=1,
    ),
    *(export.stage for export in EXPORTS),
    Stage(
        "report",
        "the page of a material",
        when=_asked("page"),
        keys=StageKeys(("description", "accept"), (), _page_parameters),
        kind="",
        minutes=1,
    ),
    Stage(
        "summary",
        "the row of a material in the catalogue",
        keys=StageKeys(("description", "accept"), (), _row_parameters),
        kind="",
        minutes=1,
    ),
    Stage(
        "catalogue",
        "the catalogue: page, table, dataset and digests",
        owner_kind="catalogue",
        kind="",
        memory=2000,
        minutes=30,
    ),
)

STAGES: Mapping[str, Stage] = {stage.name: stage for stage in _STAGES}
"""In the order of the report."""
