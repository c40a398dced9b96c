"""The keys of ``material.yaml``.

To add a key, declare it here in its block and read it in the stage. Words of a stage are repeated where its module takes long to import;
tests compare them. A block with keys of several stages names the stage of each.
"""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Self

from pydantic import Field, Strict, model_validator

from brdfpipe.catalogue.reading_keys import MeasuredReadings
from brdfpipe.descriptions.keys import (
    NAME,
    NAME_WORDS,
    WHOLE,
    Choice,
    Items,
    Keys,
    OneOf,
    by_key,
    by_word,
    key,
    mapping_or_value,
)
from brdfpipe.errors import InputError
from brdfpipe.exchange.registry import FORMATS, QUANTITIES, WRITTEN
from brdfpipe.masking.modes import (
    HALOS,
    MASKINGS_OF_MULTIPLE_SCATTERING,
    MASKINGS_WITHOUT_LAY,
    MODEL_DEFAULTS,
    MODES,
    OPTICS,
    RECIPES,
    SMITH_MASKINGS,
    TRUTHS,
    WAVE_OPTICS,
    optics_of,
)

EXPORT_WORDS = "; ".join(f"{name}: {FORMATS[name].description}" for name in WRITTEN)

READABLE_TABLES = tuple(name for name, format in FORMATS.items() if format.read)
"""Formats of other programs that are read."""

UNITS = ("nm", "um", "mm", "m")


def _surface_formats() -> Iterable[str]:
    from brdfpipe.surfaces.reading import FORMATS

    return FORMATS


def _spectrum_formats() -> Iterable[str]:
    from brdfpipe.spectra.formats.registry import FORMATS

    return FORMATS


def _file(holds: str = "", kind: str = "a file", **notes: Any) -> Any:
    help = f"{holds}{', ' if holds else ''}{kind} in the material's own folder"
    return key(help, required=True, min_length=1, max_length=255, **notes)


def _azimuth(**notes: Any) -> Any:
    help = "direction of a line profile, counter-clockwise from x"
    return key(help, default_words="0", unit="degree", ge=-360, le=360, **notes)


def _scale() -> Any:
    return key("fraction (0 to 1) or percent, where the file does not state it")


Scale = Annotated[str, OneOf(("fraction", "percent"))]
Length = Annotated[float, Field(gt=0, le=1_000_000)]
MissingHeights = Annotated[
    Annotated[list[float], Items(), Field(min_length=1, max_length=20)] | float,
    Choice(lambda missing: 0 if isinstance(missing, list) else 1),
]
_LIKE_FIRST = "that of the first scan, for files of the same extension"


# --- surface


class Acceptance(Keys):
    """A warning that is known."""

    warning: str = key(
        "a part of its text, in any case of letters",
        required=True,
        min_length=8,
        max_length=255,
        example="may be truncated",
    )
    reason: str = key(
        "why it does not matter for this material", required=True, min_length=1, max_length=255, example="cut by hand"
    )


PixelsOrLength = Annotated[str, OneOf(("um", "pixels"))]
Limits = Annotated[tuple[Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)]], Strict(False)]
Corner = Annotated[tuple[float, float], Strict(False)]


def _position_unit() -> Any:
    return key("unit of the positions: um (or µm), or pixels, counted in points of the file", default_words="um")


class Region(Keys):
    """The rectangle of a scan that counts."""

    x: Limits = key("from and to, from the left edge", example=[0, 500])
    y: Limits = key("from and to, from the lower edge of a map", example=[0, 500])
    unit: PixelsOrLength = _position_unit()

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        for name, limits in (("x", self.x), ("y", self.y)):
            if limits is not None and limits[0] >= limits[1]:
                problem, found = "the region ends where it begins, or before", f"{limits[0]:g} to {limits[1]:g}"
                raise InputError("", problem, where=name, found=found, accepted="two rising numbers")
        return self


class MaskFile(Keys):
    """A picture of the points of a scan that do not count."""

    file: str = _file(
        "a picture of as many points as the map, upper edge first, whose dark points are left out",
        details="Dark is below half of the range of 8 or 16 bits; what is transparent counts as white.",
        example="mask.png",
    )


class MaskPolygons(Keys):
    """Polygons whose inside does not count."""

    polygons: list[Annotated[list[Corner], Field(min_length=3, max_length=10_000, description="corners [x, y]")]] = key(
        "polygons, each a list of corners [x, y] from the lower left, whose inside is left out",
        required=True,
        default_words="instead of `file`",
        min_length=1,
        max_length=1000,
        example=[[[0, 0], [50, 0], [0, 50]]],
    )
    unit: PixelsOrLength = _position_unit()


Mask = Annotated[MaskFile | MaskPolygons, Choice(by_key("file", "polygons"), (("file", "polygons"),))]


class Scan(Keys):
    """A further scan of the same surface."""

    file: str = _file(example="scan.txt")
    azimuth: float = _azimuth()
    repeat: bool = key(
        "true for a second scan of the same place as the first, whose difference is noise",
        default=False,
        details="It is neither counted nor joined. Not with `noise` and `lambda_s`.",
    )
    format: Annotated[str, OneOf(_surface_formats)] = key("as `surface.format`", default_words=_LIKE_FIRST)
    unit: Annotated[str, OneOf(UNITS)] = key("as `surface.unit`", default_words=_LIKE_FIRST)
    lateral_unit: Annotated[str, OneOf(UNITS)] = key("as `surface.lateral_unit`", default_words=_LIKE_FIRST)
    pitch: Annotated[
        Annotated[tuple[Length, Length], Strict(False)] | Length,
        Choice(lambda pitch: 0 if isinstance(pitch, list) else 1),
    ] = key("as `surface.pitch`", default_words=_LIKE_FIRST)
    missing: MissingHeights = key("as `surface.missing`", default_words=_LIKE_FIRST, example=-25400)


def states_lay(isotropic: bool | None, layout: str | None) -> bool:
    """Whether these keys of a surface say that its facets have a lay."""
    return isotropic is False or (layout == "line" and isotropic is None)


class MeasuredSurface(Keys):
    """A scan of a surface, and how it is read."""

    not_together = (("noise", "lambda_s"),)
    requires = {"noise_uncertainty": "noise"}  # noqa: RUF012

    file: str = _file("the scan", details="See [formats](#formats-of-surfaces).", stage="surface")
    format: Annotated[str, OneOf(_surface_formats)] = key(
        "how the file is written; metropro must be named, because its extension .dat means text",
        default_words="by the extension",
        stage="surface",
    )
    layout: Annotated[str, OneOf(("line", "grid", "xyz"))] = key(
        "text files only: line (x and z, or z alone), grid (a matrix of heights) or xyz (three columns)",
        stage="surface",
    )
    unit: Annotated[str, OneOf(UNITS)] = key(
        "unit of the heights: nm, um (or µm), mm or m; needed for text and NumPy files that do not state it",
        details="A `tmd` file takes it too, for all its lengths.",
        stage="surface",
    )
    lateral_unit: Annotated[str, OneOf(UNITS)] = key(
        "unit of x, y and pitch: nm, um (or µm), mm or m",
        default_words="the unit of the heights",
        details="An `nms` file takes it too.",
        stage="surface",
    )
    pitch: Annotated[
        Annotated[tuple[Length, Length], Strict(False)] | Length,
        Choice(lambda pitch: 0 if isinstance(pitch, list) else 1),
    ] = key(
        "distance between neighbouring points in lateral_unit; one number above 0 or [x, y]",
        default_words="what the file states",
        stage="surface",
    )
    missing: MissingHeights = key(
        "a height that marks missing ones, as the file writes it (in µm where the file states its unit), or a list of several",
        default_words="NaN, empty fields, and what the format states",
        example=-25400,
        stage="surface",
    )
    region: Region = key("the rectangle of the scan that counts {x, y, unit}", stage="surface")
    mask: Mask = key(
        "places of the map that do not count: a picture {file} or {polygons, unit}",
        details="Positions are those of the file, before `region`.",
        stage="surface",
    )
    outliers: Annotated[str, OneOf(("report", "remove"))] = key(
        "spikes, single heights far from all their neighbours: report them, or remove them, which makes them missing",
        default_words="`report`",
        stage="surface",
    )
    channel: str = key(
        "instruments' files only: the name of the height channel",
        default_words="the first",
        min_length=1,
        max_length=200,
        stage="surface",
    )
    form: Annotated[str, OneOf(("plane", "polynomial-2", "cylinder", "none"))] = key(
        "form that is subtracted: plane, polynomial-2 (bent in any way), cylinder (bent one way) or none",
        default="plane",
        details="`cylinder` is a parabola along the one direction that fits best.",
        stage="surface",
    )
    lambda_s: float = key(
        "cutoff wavelength of a Gaussian low-pass filter",
        unit="µm",
        default_words="no filter",
        gt=0,
        le=1_000_000,
        details="Applied after the form (ISO 16610; half of the amplitude passes).",
        stage="surface",
    )
    lambda_c: float = key(
        "cutoff wavelength of a Gaussian high-pass filter",
        unit="µm",
        default_words="no filter",
        gt=0,
        le=1_000_000,
        details="Applied after the low-pass filter.",
        stage="surface",
    )
    isotropic: bool = key(
        "true if the finish looks the same from every azimuth; a single line profile needs true",
        default_words="as measured",
        stage="facets",
    )
    method: Annotated[str, OneOf(("mixture", "abel", "crf"))] = key(
        "how line profiles become a slope density: mixture, abel or crf",
        default_words="`mixture`",
        details="See [the model](model.md). A map does not use it, and a warning says so.",
        stage="facets",
    )
    noise: float = key(
        "rms of the instrument's white height noise, which is subtracted from slopes and spectrum; 0 for none",
        unit="µm",
        default_words="from the plateau of the spectrum at its highest frequencies, where it has one",
        ge=0,
        le=1000,
        details="See [noise](model.md#roughness-spectrum-and-noise). Not with `lambda_s`, after which noise is not white.",
        stage="facets psd",
    )
    noise_uncertainty: float = key(
        "standard uncertainty of `noise`, at most the noise itself",
        unit="µm",
        default_words="none is assumed, and the stage `uncertainty` says that it is not stated",
        ge=0,
        le=1000,
        example=0.0005,
        stage="facets psd",
    )
    azimuth: float = _azimuth(stage="surface")
    scans: list[Scan] = key(
        "further scans of the same surface, read like the first; a second line perpendicular to the first shows a lay",
        min_length=1,
        max_length=98,
        details="See [several scans](#several-scans-of-one-surface).",
    )

    @property
    def is_line(self) -> bool:
        """Whether the description says that the file is a line profile; a file may be one without that."""
        return self.layout == "line"

    @property
    def has_lay(self) -> bool:
        """Whether the description says that the facets have a lay; a map may show one without that."""
        return states_lay(self.isotropic, self.layout)

    @model_validator(mode="after")
    def _check_noise(self) -> Self:
        if self.noise is not None and self.noise_uncertainty is not None and self.noise_uncertainty > self.noise:
            accepted = f"at most {self.noise:g} um, `noise`"
            found = f"{self.noise_uncertainty:g} um"
            raise InputError(
                "", "more than the noise itself", where="noise_uncertainty", found=found, accepted=accepted
            )
        return self

    @model_validator(mode="after")
    def _check_filters(self) -> Self:
        if self.lambda_s is not None and self.lambda_c is not None and self.lambda_s >= self.lambda_c:
            problem, accepted = (
                "the high-pass filter is not above the low-pass filter",
                f"above {self.lambda_s:g} um, `lambda_s`",
            )
            raise InputError("", problem, where="lambda_c", found=f"{self.lambda_c:g} um", accepted=accepted)
        return self

    @model_validator(mode="after")
    def _check_layout(self) -> Self:
        if self.is_line:
            if self.mask is not None:
                raise InputError("", "a mask needs a map", where="layout", found="line", accepted="`region` for lines")
            if self.region is not None and self.region.y is not None:
                raise InputError("", "a line has no y", where="region.y", found="layout line", accepted="x alone")
        elif self.layout is not None and self.azimuth is not None:
            problem = "`azimuth` applies to line profiles only"
            raise InputError("", problem, where="azimuth", found=f"layout {self.layout}", accepted="layout line")
        return self

    @model_validator(mode="after")
    def _check_line_profile(self) -> Self:
        if not self.is_line or self.isotropic:
            return self
        azimuths = {(scan.azimuth or 0.0) % 180 for scan in self.scans or [] if not scan.repeat}
        if azimuths <= {(self.azimuth or 0.0) % 180}:
            accepted = "true, if the finish looks the same from every azimuth: one line profile shows one azimuth alone"
            if self.isotropic is None:
                raise InputError("", "the key 'isotropic' is missing", accepted=accepted)
            raise InputError("", "not an accepted value", where="isotropic", found=self.isotropic, accepted=accepted)
        if self.method not in (None, "mixture"):
            problem, accepted = "lines in two directions are counted as a mixture", "mixture, or `isotropic: true`"
            raise InputError("", problem, where="method", found=repr(self.method), accepted=accepted)
        return self


def _distribution() -> Any:
    help = (
        "instead of a file, a finish without a scan; beckmann (Gaussian slopes, with slope_rms), ggx (with a), flat (polished, with neither), "
        "or measured-gloss (slopes that have the gloss of `measured.gloss`)"
    )
    return key(help, required=True, default_words="instead of `file`", stage="facets psd")


MEASURED_GLOSS = "measured-gloss"
"""The finish that is known by gloss readings."""

Distribution = Annotated[str, OneOf(("beckmann", "ggx", "flat", MEASURED_GLOSS))]


class GgxSurface(Keys):
    """An assumed finish with GGX slopes."""

    distribution: Distribution = _distribution()
    a: float = key(
        "width of the slopes of a ggx finish",
        required=True,
        default_words="with `ggx`",
        ge=1e-6,
        le=3,
        example=0.15,
        stage="facets",
    )


class FlatSurface(Keys):
    """A polished surface."""

    distribution: Distribution = _distribution()


class GlossSurface(Keys):
    """A finish that is known by gloss readings."""

    distribution: Distribution = _distribution()
    slopes: Annotated[str, OneOf(("any", "beckmann", "ggx"))] = key(
        "with measured-gloss: slopes from Beckmann's to GGX (any), or one of both",
        default="any",
        details="See [a finish known by gloss](#a-finish-known-by-gloss).",
        stage="gloss_facets",
    )


class BeckmannSurface(Keys):
    """An assumed finish with Gaussian slopes."""

    distribution: Distribution = _distribution()
    slope_rms: float = key(
        "root mean square slope √⟨p² + q²⟩ of a beckmann finish",
        required=True,
        default_words="with `beckmann`",
        ge=1e-6,
        le=3,
        example=0.15,
        stage="facets psd",
    )
    length: float = key(
        "correlation length ℓ of a beckmann finish: the autocovariance of its heights falls to 1/e there",
        unit="µm",
        ge=0.01,
        le=100_000,
        example=5,
        stage="psd",
        details="The rms height is then slope_rms · ℓ / 2. Waves need it: without it, the finish is one of facets.",
    )


AssumedSurface = Annotated[
    GgxSurface | FlatSurface | GlossSurface | BeckmannSurface,
    Choice(by_word("distribution", "ggx", "flat", MEASURED_GLOSS)),
]
Surface = Annotated[
    MeasuredSurface | AssumedSurface, Choice(by_key("file", "distribution"), (("file", "distribution"),))
]


# --- index


class IndexPair(Keys):
    """The complex refractive index of a metal, at every wavelength."""

    n: float = key("real part of the refractive index", required=True, gt=0, lt=5)
    k: float = key(
        "extinction coefficient; above 0 the body is opaque, and without it write the number n alone", ge=0, lt=20
    )


class IndexFile(Keys):
    """A table of the refractive index."""

    file: str = _file(example="scan.txt")


IndexNumber = Annotated[
    float, Field(ge=1, lt=5, description="a number from 1 to 5, a plastic's name, {n, k} or {file: table.txt}")
]
IndexName = Annotated[str, Field(max_length=64)]


def _index_form(index: Any) -> int:
    if isinstance(index, Mapping):
        return 0 if "n" in index or "k" in index else 1
    return 3 if isinstance(index, str) and any(letter.isalpha() for letter in index) else 2


Index = Annotated[IndexPair | IndexFile | IndexNumber | IndexName, Choice(_index_form)]


def _refuse_index_without_k(index: Any) -> None:
    if isinstance(index, IndexPair) and index.k is None:
        from brdfpipe.optics.index import missing_k_error

        raise missing_k_error("", index.n)


# --- bodies with two faces: slab and coat


class TransmittanceFile(Keys):
    """A table of the internal transmittance."""

    file: str = _file(example="scan.txt")
    scale: Scale = _scale()


class AbsorptionFile(Keys):
    """A table of the absorption coefficient."""

    file: str = _file(example="scan.txt")
    unit: Annotated[str, OneOf(("1/mm", "1/cm", "1/m"))] = key(
        "unit of the coefficient: 1/mm, 1/cm or 1/m", default="1/mm"
    )


Transmittance = Annotated[float, Field(ge=0, le=1, description="a number from 0 to 1, or {file: table.txt}")]
Absorption = Annotated[
    float, Field(ge=0, le=10_000, description="a number from 0 to 10000, in 1/mm, or {file: table.txt}")
]
LikeFront = Annotated[str, OneOf(("same", "flat"))]


class _Clear(Keys):
    """What light passes between two faces."""

    not_together = (("internal_transmittance", "absorption"),)

    thickness: float = key("thickness of the body or of the coat", required=True, unit="mm", gt=0, le=1000, example=2)
    internal_transmittance: Annotated[TransmittanceFile | Transmittance, Choice(mapping_or_value)] = key(
        "share of the light that passes from face to face at normal incidence, without the faces' reflection; a number from 0 to 1 or {file: …}",
        default_words="1",
        details="A file holds wavelength and value.",
    )
    absorption: Annotated[AbsorptionFile | Absorption, Choice(mapping_or_value)] = key(
        "absorption coefficient a in 1/mm, where exp(-a d) passes a path of d mm; a number or {file: …}",
        default_words="instead of `internal_transmittance`",
    )
    transmittance_uncertainty: float = key(
        "standard uncertainty of the internal transmittance, a share of 1 that is common to all wavelengths",
        default_words="none is assumed",
        ge=0,
        le=0.5,
        example=0.005,
    )


class Slab(_Clear):
    """A clear body with two faces."""

    back: Annotated[Surface | LikeFront, Choice(mapping_or_value)] = key(
        "the other face: same (like the front), flat (polished), or a surface of its own {file, …} or {distribution, …}",
        default="same",
        details="A surface of its own is described as seen from its own side, without `scans`.",
    )


class CoatedBody(Keys):
    """The opaque body below a clear coat."""

    index: Index = key(
        "refractive index of the body, as `index`: a number, a name, {n, k} of a metal or {file: …}",
        required=True,
        example=1.59,
        details="That of the coat, if no light is reflected between both, as between a lacquer and the binder of a base coat.",
    )
    surface: Annotated[Surface | LikeFront, Choice(mapping_or_value)] = key(
        "face between body and coat: flat, same (of the same slopes as the outer face), or a surface of its own {file, …} or {distribution, …}",
        default="flat",
        details="A surface of its own is described as seen from above, without `scans`.",
    )

    @model_validator(mode="after")
    def _check_index(self) -> Self:
        _refuse_index_without_k(self.index)
        return self


class Coat(_Clear):
    """A clear coat, or a film, on an opaque body."""

    base: CoatedBody = key("the opaque body below {index, surface}", required=True)


# --- spectrum

GEOMETRY = "sci (specular reflection included) or sce (excluded); a file that states it may leave it out"
Geometry = Annotated[str, OneOf(("sci", "sce"))]
Observer = Annotated[int, OneOf((10, 2))]


def _incidence() -> Any:
    return key(
        "angle of incidence of the measurement", unit="degree", default_words="what the file states, or 8", ge=0, lt=90
    )


def _specular_trap() -> Any:
    return key(
        "with geometry sce: half angle of the instrument's gloss trap about the mirror direction",
        unit="degree",
        default_words="5",
        gt=0,
        le=90,
        details="What the facets mirror into the trap is added; a rough surface mirrors little there.",
    )


def _reflectance_uncertainty() -> Any:
    return key(
        "standard uncertainty of the reflectance, a share of 1 that is common to all wavelengths",
        default_words="none is assumed",
        ge=0,
        le=0.5,
        example=0.003,
    )


ColumnName = Annotated[int | str, Choice(lambda column: 1 if isinstance(column, str) else 0)]


class MeasuredSpectrum(Keys):
    """A measured total reflectance."""

    file: str = _file("the total reflectance", details="See [formats](#formats-of-spectra).")
    geometry: Geometry = key(GEOMETRY, default_words="what the file states")
    incidence: float = _incidence()
    specular_trap: float = _specular_trap()
    format: Annotated[str, OneOf(_spectrum_formats)] = key("how the file is written", default_words="by the extension")
    scale: Scale = _scale()
    sample: ColumnName = key("which sample of a file that holds several, by name or by number")
    column: ColumnName = key("which column of the file, by name or by number (the wavelength is column 1)")
    uncertainty: ColumnName = key("the column of standard uncertainties, by name or by number")
    reflectance_uncertainty: float = _reflectance_uncertainty()
    allow_fluorescent: bool = key(
        "true accepts a reflectance above 1.1, which otherwise counts as a mistake", default=False
    )

    @model_validator(mode="after")
    def _check_uncertainty(self) -> Self:
        if self.uncertainty is not None and self.reflectance_uncertainty is not None:
            problem = "the column of `uncertainty` states it for each wavelength"
            where, accepted = "reflectance_uncertainty", "either `uncertainty` or `reflectance_uncertainty`"
            raise InputError("", problem, where=where, found=self.reflectance_uncertainty, accepted=accepted)
        return self

    @model_validator(mode="after")
    def _check_trap(self) -> Self:
        if self.specular_trap is not None and self.geometry == "sci":
            problem = "a gloss trap needs a reflectance with the specular excluded"
            raise InputError("", problem, where="specular_trap", found="geometry sci", accepted="geometry sce")
        return self


SEARCHES = ("random4", "adaptive4")
"""Methods that search at random."""


class Colour(Keys):
    """A colour, from which a reflectance spectrum is recovered."""

    lab: Annotated[
        tuple[
            Annotated[float, Field(ge=0, le=100, description="L*")],
            Annotated[float, Field(ge=-200, le=200, description="a*")],
            Annotated[float, Field(ge=-200, le=200, description="b*")],
        ],
        Strict(False),
    ] = key(
        "the three numbers L*, a*, b*",
        required=True,
        default_words="instead of `file`",
        details="See [from a colour](#a-spectrum-from-a-colour).",
    )
    illuminant: str = key(
        "illuminant of the colour, D65, D50, A or another CIE illuminant",
        required=True,
        default_words="needed with `lab`",
        details="See [illuminants](#illuminants).",
    )
    observer: Observer = key("observer of the colour, 10 or 2 degree", required=True, default_words="needed with `lab`")
    geometry: Geometry = key(GEOMETRY, required=True)
    incidence: float = _incidence()
    specular_trap: float = _specular_trap()
    reflectance_uncertainty: float = _reflectance_uncertainty()
    method: Annotated[str, OneOf(("lhtss", "basis4", *SEARCHES))] = key(
        "how a spectrum is found: lhtss (smooth and exact), or a mixture of four basis spectra: basis4 (exact), random4 or adaptive4 (random searches)",
        default_words="`lhtss`",
    )
    threshold: float = key(
        "for random4 and adaptive4: colour difference ΔE*ab below which the search ends",
        default_words="1",
        ge=1e-6,
        le=100,
    )
    seed: Annotated[int, WHOLE] = key(
        "for random4 and adaptive4: seed of the random numbers, an integer", default_words="0", ge=0, le=4_294_967_295
    )

    @model_validator(mode="after")
    def _check_search_keys(self) -> Self:
        for name in ("seed", "threshold"):
            if (value := getattr(self, name)) is not None and self.method not in SEARCHES:
                problem = f"no effect, because `method: {self.method or 'lhtss'}` does not search"
                accepted = f"`{name}` with `method: {'` or `'.join(SEARCHES)}`; leave it out otherwise"
                raise InputError("", problem, where=name, found=value, accepted=accepted)
        return self


class SpectrumOfPair(Keys):
    """One of two measurements of a sample, with the specular component included or excluded."""

    file: str = _file("the total reflectance", details="See [formats](#formats-of-spectra).")
    incidence: float = _incidence()
    format: Annotated[str, OneOf(_spectrum_formats)] = key("how the file is written", default_words="by the extension")
    scale: Scale = _scale()
    sample: ColumnName = key("as `spectrum.sample`")
    column: ColumnName = key("as `spectrum.column`")
    uncertainty: ColumnName = key("as `spectrum.uncertainty`")
    allow_fluorescent: bool = key("as `spectrum.allow_fluorescent`", default=False)


class SpectrumPair(Keys):
    """Total reflectances of one sample with the specular component included and excluded."""

    sci: SpectrumOfPair = key(
        "with the specular component included {file, …}, which the BRDF keeps",
        required=True,
        default_words="instead of `file`, with `sce`",
        details="See [both together](#specular-included-and-excluded).",
    )
    sce: SpectrumOfPair = key(
        "with the specular component excluded {file, …}, whose difference is compared with the mirrored light",
        required=True,
        default_words="with `sci`",
    )
    specular_trap: float = key(
        "as `spectrum.specular_trap`, of the measurement with the specular component excluded",
        unit="degree",
        default_words="5",
        gt=0,
        le=90,
    )
    reflectance_uncertainty: float = _reflectance_uncertainty()


def _spectrum_form(spectrum: Any) -> int:
    pair = isinstance(spectrum, Mapping) and ("sci" in spectrum or "sce" in spectrum) and "file" not in spectrum
    return 2 if pair else by_key("file", "lab")(spectrum)


Spectrum = Annotated[
    MeasuredSpectrum | Colour | SpectrumPair,
    Choice(_spectrum_form, (("file", "lab"), ("file", "sci"), ("file", "sce"), ("lab", "sci"), ("lab", "sce"))),
]


# --- multiangle

Polar = Annotated[float, Field(ge=0, lt=90, description="a polar angle from the normal in degree")]
Azimuth = Annotated[
    float, Field(ge=-720, le=720, description="an azimuth in degree; the mirror direction is at 180 from the incidence")
]
Three = Annotated[tuple[float, float, float], Strict(False)]


class MultiangleColour(Keys):
    """A colour at one geometry."""

    geometry: Annotated[int | str, Choice(lambda name: 1 if isinstance(name, str) else 0)] = key(
        'a geometry by name, best in quotes: "45:-30" (view positive on the illuminator\'s side), "45as15", "45as25az90"'
    )
    theta_i: Polar = key("instead of the name: polar angle of incidence", unit="degree")
    phi_i: Azimuth = key("azimuth of incidence", unit="degree")
    theta_o: Polar = key("polar angle of the view", unit="degree")
    phi_o: Azimuth = key("azimuth of the view", unit="degree")
    lab: Three = key("three numbers L*, a*, b*")
    xyz: Three = key("three numbers X, Y, Z (Y = 100 for the perfect diffuser)")
    reflectance: list[float] = key(
        "reflectance factors at the wavelengths of `multiangle.wavelength`, a list", min_length=4, max_length=1000
    )


class _Multiangle(Keys):
    illuminant: str = key("illuminant of L*a*b* or XYZ, D65, D50, A or another CIE illuminant", stage="multiangle")
    observer: Observer = key("observer of L*a*b* or XYZ, 10 or 2 degree", stage="multiangle")
    scale: Scale = key(
        "scale of reflectance factors: fraction (1 for the perfect diffuser) or percent", stage="multiangle"
    )
    index: float = key("refractive index of the clear coat", default=1.5, gt=1, lt=5, stage="flake")
    form: Annotated[str, OneOf(("exponential", "gaussian", "double-exponential"))] = key(
        "decrease along the flake angle, each plus a constant: exponential, gaussian or double-exponential",
        default="exponential",
        details="`double-exponential` needs five geometries or more.",
        stage="flake",
    )
    model: Annotated[str, OneOf(("flake", "flake-physical"))] = key(
        "flake (the patent's) or flake-physical (with the interface's transmission and the gloss of the clear coat)",
        default="flake",
        details="See [the model](model.md#effect-pigments).",
        stage="flake",
    )
    clear_coat: Annotated[
        Annotated[float, Field(ge=0.0001, le=1, description="smooth, none or a slope")]
        | Annotated[str, OneOf(("smooth", "none"))],
        Choice(lambda coat: 1 if isinstance(coat, str) else 0),
    ] = key(
        "with flake-physical, surface of the coat: smooth, none (no gloss), or its root mean square slope from 0.0001 to 1",
        default_words="`smooth`",
        stage="flake",
    )
    colour_uncertainty: float = key(
        "standard uncertainty of each L*, a* and b* (or X, Y, Z, or reflectance factor), in its unit, independent from geometry to geometry",
        default_words="none is assumed",
        details="For all values alike; columns of a file state it one by one. See [uncertainties](#uncertainties-of-colours).",
        gt=0,
        le=10,
        example=0.2,
        stage="multiangle",
    )
    scale_uncertainty: float = key(
        "relative standard uncertainty of all colours together, as that of the white standard",
        default_words="none is assumed",
        ge=0,
        le=0.2,
        example=0.005,
        stage="flake_uncertainty",
    )
    index_uncertainty: float = key(
        "standard uncertainty of the refractive index of the clear coat",
        default_words="none is assumed",
        ge=0,
        le=1,
        example=0.01,
        stage="flake_uncertainty",
    )
    clear_coat_uncertainty: float = key(
        "standard uncertainty of the slope of a rough clear coat",
        default_words="none is assumed",
        ge=0,
        le=1,
        example=0.005,
        stage="flake_uncertainty",
    )

    @model_validator(mode="after")
    def _check_clear_coat(self) -> Self:
        if self.clear_coat_uncertainty is not None and (self.clear_coat is None or isinstance(self.clear_coat, str)):
            problem, where = "only the slope of a rough clear coat has an uncertainty", "clear_coat_uncertainty"
            found = "none given" if self.clear_coat is None else str(self.clear_coat)
            raise InputError(
                "", problem, where=where, found=f"`clear_coat`: {found}", accepted="`clear_coat` with a slope"
            )
        return self


class MultiangleFile(_Multiangle):
    """A file of colours at several geometries."""

    file: str = _file(
        "the colours",
        "a CSV file",
        details=(
            "Separated by `,`, by tab, or by `;` with decimal commas. Its first line names the columns: `geometry` or the four angles; then `L`, `a`, `b`, "
            "or `X`, `Y`, `Z`, or wavelengths (`400`, `R400nm`); and their [uncertainties](#uncertainties-of-colours), if known."
        ),
        stage="multiangle",
    )


class MultiangleColours(_Multiangle):
    """Colours at several geometries."""

    colours: list[MultiangleColour] = key(
        "three entries or more, each {geometry, lab}, {geometry, xyz} or {geometry, reflectance}; theta_i, phi_i, theta_o, phi_o may replace the geometry",
        required=True,
        default_words="instead of `file`",
        min_length=3,
        max_length=1000,
        stage="multiangle",
    )
    wavelength: list[Annotated[float, Field(ge=100, le=20_000, description="a wavelength in nm")]] = key(
        "wavelengths of `reflectance`, a list",
        unit="nm",
        min_length=4,
        max_length=1000,
        details="400 to 700 nm or wider, in steps of at most 50 nm (25 nm in a file of `spectrum`).",
        stage="multiangle",
    )


Multiangle = Annotated[MultiangleFile | MultiangleColours, Choice(by_key("file", "colours"), (("file", "colours"),))]


# --- table


class TableFile(Keys):
    """A table of a BSDF in a file of another program or instrument."""

    file: str = _file("the table", "a file of a BSDF", stage="imported")
    format: Annotated[str, OneOf(READABLE_TABLES)] = key(
        "format of the file", default_words="that of its suffix and its beginning", stage="imported"
    )
    quantity: Annotated[str, OneOf(QUANTITIES)] = key(
        "what the values are: brdf, brdf_cos (BRDF times cos θ_o) or pi_brdf (reflectance factors)",
        default_words="what the format or the file says",
        stage="imported",
    )


# --- texture


class ScanTexture(Keys):
    """The grain of a measured surface as a tileable map."""

    pixel: float = key(
        "side of a pixel of the map, from the pitch of the scan to a 32nd of its shorter side",
        required=True,
        unit="µm",
        gt=0,
        le=10_000,
        example=10,
        details="A scene with a `viewing_distance` may make it coarser.",
    )
    size: Annotated[int, WHOLE] = key("pixels along either side of the map", default=512, ge=32, le=4096)
    method: Annotated[str, OneOf(("spectrum", "structure"))] = key(
        "how the map is made: spectrum (power spectrum and heights, random phases) or structure (pieces of the scan; keeps cells and ridges)",
        default="spectrum",
    )
    seed: Annotated[int, WHOLE] = key("the same seed gives the same map", default=0, ge=0, le=1_000_000)
    interpolation: Annotated[str, OneOf(("bilinear", "nearest"))] = key(
        "how the renderer interpolates between pixels: bilinear or nearest", default="bilinear"
    )


class TexturePicture(Keys):
    """A picture of a paint at one geometry."""

    file: str = _file("a linear picture, seen along the normal of the sample", example="45as15.tif")
    geometry: str = key(
        "geometry of the picture as `multiangle` names it, or diffuse", required=True, max_length=40, example="45as15"
    )


class PictureTexture(Keys):
    """The texture of an effect paint from pictures."""

    pictures: list[TexturePicture] = key(
        "pictures, each {file, geometry}: PNG or TIFF, grey or colour of 8 bits, or grey of 16 bits or 32-bit floats",
        required=True,
        default_words="instead of a scan's grain",
        min_length=1,
        max_length=8,
    )
    pixel: float = key(
        "side of a pixel of the pictures on the sample", required=True, unit="µm", ge=0.1, le=10_000, example=20
    )
    curve: Annotated[str, OneOf(("linear", "srgb"))] = key(
        "what the values are to the light: linear (proportional) or srgb",
        default_words="`srgb` of 8 bits, with a warning, else `linear`",
    )
    size: Annotated[int, WHOLE] = key("pixels along either side of the texture", default=512, ge=32, le=4096)
    method: Annotated[str, OneOf(("structure", "spectrum"))] = key(
        "how the texture is made: structure (pieces of the picture; keeps sparkles) or spectrum (power spectrum and values, random phases)",
        default="structure",
    )
    seed: Annotated[int, WHOLE] = key("the same seed gives the same texture", default=0, ge=0, le=1_000_000)

    @model_validator(mode="after")
    def _check_geometries(self) -> Self:
        names = [picture.geometry.strip() for picture in self.pictures]
        if repeated := next((name for number, name in enumerate(names) if name in names[:number]), None):
            raise InputError("", "two pictures of one geometry", where="pictures", found=repeated, accepted="each once")
        return self


Texture = Annotated[
    ScanTexture | PictureTexture,
    # Keys that a texture of pictures is mistaken to have are refused with those that it has.
    Choice(
        lambda given: int(
            isinstance(given, Mapping) and not given.keys().isdisjoint({"pictures", "picture", "file", "curve"})
        )
    ),
]


# --- rig


class Smoothing(Keys):
    """Smoothing of measured cells."""

    mode: Annotated[str, OneOf(("pspline", "keldysh", "keldysh-printed"))] = key(
        "pspline, keldysh (the preprint's, repaired) or keldysh-printed (as printed, for comparison)", default="pspline"
    )
    strength: float = key("strength of smoothing", default_words="by cross-validation", gt=0)
    mirror_symmetric: bool = key(
        "true if both sides of the plane of incidence are alike: of every surface without a lay, and of a lay along or across that plane",
        default=True,
    )
    isotropic: bool = key(
        "true if the sample may be rotated in its plane without a change; false for a surface with a lay, of which the two directions of light are "
        "not averaged",
        default=True,
    )

    @model_validator(mode="before")
    @classmethod
    def _refuse_former_key(cls, content: Any) -> Any:
        if isinstance(content, dict) and "symmetric" in content:
            instead = "`mirror_symmetric: true` and `isotropic: true`"
            if content["symmetric"] is False:
                instead = "`isotropic: false`, and `mirror_symmetric: false` unless the lay is along or across the plane of incidence"
            problem = "`symmetric` was split: a surface with a lay may be alike on both sides of the plane of incidence"
            raise InputError("", problem, where="symmetric", accepted=instead)
        return content

    @model_validator(mode="after")
    def _check_lay(self) -> Self:
        if self.isotropic and not self.mirror_symmetric:
            problem = "a surface that may be rotated without a change is alike on both sides of every plane"
            raise InputError(
                "", problem, where="mirror_symmetric", found="false", accepted="true, or `isotropic: false` beside it"
            )
        return self


class Emulation(Keys):
    """A run of the emulator instead of a measurement."""

    truth: str = key(
        "name of the material of this catalogue that the emulator measures",
        required=True,
        default_words="needed with `plan`",
        min_length=1,
        max_length=64,
    )
    seed: Annotated[int, WHOLE] = key(
        "seed of the emulated rig's random properties; the same as in its calibration", default=0, ge=0, le=1_000_000
    )
    session: Annotated[int, WHOLE] = key("seed of the random properties of a day", default=1, ge=0, le=1_000_000)


class _Rig(Keys):
    calibration: str = key(
        "name of the calibration's folder in calibrations/ of the catalogue", required=True, min_length=1, max_length=64
    )
    smoothing: Smoothing = key(
        "how the values of the cells are smoothed {mode, strength, mirror_symmetric, isotropic}",
        default=Smoothing.model_construct(),
        stage="smoothed",
    )
    lamp_hours: float = key(
        "hour counter of the lamp at the measurement", unit="h", default=0, ge=0, le=100_000, stage="primary"
    )
    override: bool = key(
        "true uses frames and a profile that are otherwise refused; the results record it",
        default=False,
        stage="reduced primary",
    )


class MeasuredRig(_Rig):
    """A measurement with a camera rig."""

    run: str = key(
        "folder of a finished run, in the material's own folder", required=True, min_length=1, max_length=200
    )


class EmulatedRig(_Rig):
    """A measurement that the emulator makes."""

    plan: str = _file("the plan of the measurement", "a plan.yaml", default_words="instead of `run`")
    emulate: Emulation = key("emulator instead of a measurement {truth, seed, session}", required=True, stage="rig_run")


RigRoute = Annotated[MeasuredRig | EmulatedRig, Choice(by_key("run", "emulate"), (("run", "emulate"),))]


# --- model and the whole


class Model(Keys):
    """How the reflection is modelled."""

    not_together = (
        ("recipe", "masking"),
        ("recipe", "diffuse"),
        ("recipe", "multiple_scattering"),
        ("recipe", "optics"),
    )

    optics: Annotated[str, OneOf(OPTICS)] = key(
        "how the surface reflects: facets (geometrical optics), wave (coherent mirror reflection and a halo), composite (facets with finer "
        "roughness) or auto (waves or facets, by roughness, slope and incidence, and facets where the roughness is not known)",
        default_words=f"`{OPTICS[0]}`",
        details="See [waves](model.md#waves). A scan, or a beckmann finish with `length`, gives the roughness spectrum that wave needs.",
    )
    halo: Annotated[str, OneOf(HALOS)] = key(
        "theory of the halo of waves: ssa1, ghs or rayleigh-rice",
        default_words=f"`{HALOS[0]}`",
        details="See [waves](model.md#waves).",
    )

    masking: Annotated[str, OneOf(MODES["masking"])] = key(
        "masking and shadowing of facets by their neighbours: auto (measured where the heights differ from Smith's masking), "
        "height-correlated, separable, measured (traced on the heights), blinn, liu, crf or none",
        default_words=f"`{MODEL_DEFAULTS['masking']}`",
        details="See [modes](model.md#modes-and-what-they-break). With blinn, liu, crf or none `optics` is facets.",
    )
    diffuse: Annotated[str, OneOf(MODES["diffuse"])] = key(
        "the diffuse part: coupled to the facets' transmission, crf (the patent's) or none",
        default_words=f"`{MODEL_DEFAULTS['diffuse']}`",
    )
    multiple_scattering: Annotated[str, OneOf(MODES["multiple_scattering"])] = key(
        "light reflected by more than one facet: auto (where it is more than 1 % of the reflected light, measured on a map and "
        "directional without one and without a lay), none (lost), compensated (given back as diffuse light), directional (in the directions that "
        "Smith's surface gives it) or measured (traced on the height map)",
        default_words=f"`{MODEL_DEFAULTS['multiple_scattering']}`",
        details="See [light reflected more than once](model.md#light-reflected-more-than-once).",
    )
    truth: Annotated[str, OneOf(TRUTHS)] = key(
        "reference solutions on the height map: check (the prediction is compared with traced rays and diffraction), none, or use (the "
        "reference that holds is the BSDF, instead of a prediction)",
        default_words=f"`{TRUTHS[0]}`, where the surface is measured",
        details="See [the error of a model](model.md#the-error-of-a-model).",
    )
    recipe: Annotated[str, OneOf(tuple(RECIPES))] = key(
        "all choices of a source together, instead of the other keys: crf (patent US 9,395,299)"
    )

    @property
    def effective_masking(self) -> str:
        """The masking that the keys, the recipe or the default give."""
        return self.masking or RECIPES.get(self.recipe or "", MODEL_DEFAULTS)["masking"]

    @property
    def effective_optics(self) -> str:
        """The optics that the keys, the recipe or the default give."""
        return optics_of(self.model_dump(exclude_none=True))

    @model_validator(mode="after")
    def _check_optics(self) -> Self:
        """Refuse keys of facets with waves, and of waves with facets."""
        if self.effective_optics == "facets":
            if self.halo not in (None, HALOS[0]):
                raise InputError(
                    "",
                    "a halo belongs to waves",
                    where="halo",
                    found=repr(self.halo),
                    accepted="`optics: wave`, composite or auto",
                )
            return self
        for name, found in (("masking", self.masking), ("multiple_scattering", self.multiple_scattering)):
            if found is not None and self.optics == "wave":
                problem = "`optics: wave` has no facets"
                raise InputError(
                    "", problem, where=name, found=repr(found), accepted=f"`optics: {self.optics}` without `{name}`"
                )
        if self.diffuse == "crf":
            raise InputError(
                "",
                f"`optics: {self.optics}` couples its base",
                where="diffuse",
                found="'crf'",
                accepted="coupled or none",
            )
        return self

    @model_validator(mode="after")
    def _check_truth(self) -> Self:
        """Refuse choices of a prediction beside ``truth: use``, which takes the reference solution instead."""
        defaults = {"optics": OPTICS[0], "halo": HALOS[0], **MODEL_DEFAULTS, "diffuse": self.diffuse}
        for name, default in defaults.items():
            if self.truth == "use" and (found := getattr(self, name)) not in (None, default):
                problem = f"`truth: use` takes the reference solution on the map, which knows no `{name}`"
                accepted = f"`truth: use` without `{name}`, or `truth: check`"
                raise InputError("", problem, where=name, found=repr(found), accepted=accepted)
        return self

    @model_validator(mode="after")
    def _check_compensation(self) -> Self:
        masking, mode = self.effective_masking, self.multiple_scattering or MODEL_DEFAULTS["multiple_scattering"]
        defined = MASKINGS_OF_MULTIPLE_SCATTERING[mode]
        if self.multiple_scattering == "auto":
            # Stages leave several reflections out with other maskings. A key that does nothing is a mistake.
            defined = MASKINGS_OF_MULTIPLE_SCATTERING["directional"]
            if self.diffuse == "crf":
                problem = "`diffuse: crf` follows its source, which has no light that is reflected more than once"
                accepted = "`diffuse: crf` without `multiple_scattering`, or `diffuse: coupled`"
                raise InputError("", problem, where="multiple_scattering", found="'auto'", accepted=accepted)
        if masking not in defined:
            problem = f"`multiple_scattering: {mode}` is defined for Smith's masking"
            accepted = f"{' or '.join(defined)}, or `multiple_scattering: none`"
            raise InputError("", problem, where="masking", found=repr(masking), accepted=accepted)
        return self


class Material(Keys):
    """One material of a catalogue, as a laboratory knows it."""

    at_least_one = ("surface", "spectrum", "multiangle", "table", "rig")
    not_together = tuple(
        ("table", other) for other in ("surface", "index", "slab", "coat", "spectrum", "multiangle", "rig", "model")
    )
    requires = {"surface": "index", "slab": "surface", "coat": "surface", "index_uncertainty": "index"}  # noqa: RUF012

    name: str = key(NAME_WORDS, default_words="the name of the folder", pattern=f"^{NAME}$")
    description: str = key(
        "one line of text for the reader of the report",
        max_length=2000,
        example="one line for the reader of the report",
    )
    surface: Surface = key("a measured surface {file, …} or an assumed finish {distribution, …}")
    index: Index = key(
        "refractive index: a number, the name of a plastic (ABS, PC/ABS, PP, PMMA, …), {n, k} of a metal, or {file: …}: "
        "a table of wavelength, n and optionally k, or a page of refractiveindex.info (.yml)",
        details="See [refractive index](#refractive-index).",
    )
    index_uncertainty: float = key(
        "standard uncertainty of the refractive index n, common to all wavelengths",
        default_words="none is assumed",
        ge=0,
        le=1,
        example=0.005,
        stage="index",
    )
    slab: Slab = key(
        "a clear body with two faces {thickness, internal_transmittance or absorption, back}; `surface` is its front",
        details="It replaces `spectrum`. See [clear bodies](#clear-bodies).",
    )
    coat: Coat = key(
        "a clear coat or film on an opaque body {thickness, internal_transmittance or absorption, base}; `surface` and `index` are those of the coat",
        details="`spectrum` is that of the coated body. See [coated bodies](#coated-bodies).",
    )
    spectrum: Spectrum = key("a measured total reflectance {file, geometry, …} or a colour {lab, geometry, …}")
    multiangle: Multiangle = key(
        "colours of an effect paint at several geometries {file or colours, illuminant, observer, index, form, …}",
        details="See [effect pigments](#effect-pigments).",
    )
    measured: MeasuredReadings = key(
        "readings of the laboratory's own instruments, which are compared with the prediction {gloss, haze, lab, …, uncertainty, instrument, date}",
        details="See [readings](#readings).",
    )
    table: TableFile = key(
        "a table of the BSDF, from another program or instrument {file, format, quantity}",
        details="It needs nothing else. See [tables of other programs](#tables-of-other-programs).",
    )
    texture: Texture = key(
        "visible structure beside the BRDF, for scenes that ask for `texture`: the grain of the scan as a tileable map {pixel, size, method, seed, interpolation}, "
        "or an effect paint {pictures, pixel, curve, size, method, seed}",
        details="See [texture](texture.md).",
    )
    rig: RigRoute = key(
        "a measurement with a camera rig {run, calibration, …}, or one that the emulator makes {plan, emulate, calibration, …}",
        details="See [the camera rig](rig.md#from-a-run-to-a-bsdf).",
    )
    model: Model = key("how the reflection is modelled", default=Model.model_construct())
    exports: Annotated[list[Annotated[str, OneOf(WRITTEN)]], Items()] = key(
        "files for other programs; " + EXPORT_WORDS, default_words="`exports` of the configuration", example=["astm"]
    )
    accept: list[Acceptance] = key(
        "warnings that are known and accepted, each with its reason",
        default_words="none",
        example=[{"warning": "may be truncated", "reason": "the strip was cut by hand"}],
        details="See [accepted warnings](nightly.md#accepted-warnings).",
    )
    scene: str = key(
        "what its results are for; the name of a shipped scene, or the path of a file in relation to this one",
        default_words="`scene` of the configuration",
        details="See [scenes](scenes.md).",
        min_length=1,
        max_length=255,
    )

    @model_validator(mode="after")
    def _check_index(self) -> Self:
        _refuse_index_without_k(self.index)
        return self

    @model_validator(mode="after")
    def _check_gloss_finish(self) -> Self:
        """Refuse a finish of gloss readings without them, or where they are those of two faces."""
        accepted = "`measured.gloss` at two or three of 20, 60 and 85 degree"
        if self.two_faces is not None and isinstance(self.two_faces[2], GlossSurface):
            problem, accepted = (
                "the other face of a clear or coated body has no gloss of its own",
                "same, flat, or another surface",
            )
            where = f"{self.two_faces[1]}.distribution"
            raise InputError("", problem, where=where, found=repr(MEASURED_GLOSS), accepted=accepted)
        if not isinstance(self.surface, GlossSurface):
            return self
        readings = None if self.measured is None else self.measured.gloss
        found = 0 if readings is None else len(readings.model_fields_set)
        problem = "the gloss readings are missing" if found == 0 else "one gloss reading alone" if found == 1 else ""
        if self.two_faces is not None:
            problem = "a clear or coated body has gloss from both faces"
            accepted = f"no `{self.two_faces[0]}`, or another finish than {MEASURED_GLOSS}"
        if problem:
            raise InputError("", problem, where="surface.distribution", found=repr(MEASURED_GLOSS), accepted=accepted)
        return self

    @model_validator(mode="after")
    def _check_roughness_spectrum(self) -> Self:
        """Refuse waves where no roughness spectrum is known."""
        faces = [self.surface] if self.slab is None else [self.surface, self.slab.back]
        known = any(isinstance(face, MeasuredSurface) or getattr(face, "length", None) is not None for face in faces)
        needed = self.model.optics in WAVE_OPTICS and self.model.optics != "auto"
        problem = "needs a roughness spectrum" if needed and not known else ""
        accepted = "facets; or a measured `surface`, or a beckmann finish with `length`"
        if self.slab is not None and self.model.optics == "composite":
            problem, accepted = "is for a body with one face", "facets, wave or auto with `slab`"
        if self.slab is not None and self.model.halo not in (None, HALOS[0]):
            problem, accepted = f"of a clear body has no `halo: {self.model.halo}`", f"`halo: {HALOS[0]}` with `slab`"
        if problem:
            raise InputError(
                "",
                f"`model.optics: {self.model.effective_optics}` {problem}",
                where="model.optics",
                found=repr(self.model.optics),
                accepted=accepted,
            )
        return self

    @model_validator(mode="after")
    def _check_measured_modes(self) -> Self:
        """Refuse masking and reflections that are traced on a map where there is none."""
        for name, what, others in (
            ("masking", "masking is", SMITH_MASKINGS),
            ("multiple_scattering", "light reflected more than once is", ("directional", "compensated", "none")),
        ):
            if getattr(self.model, name) == "measured" and not isinstance(self.surface, MeasuredSurface):
                problem = f"{what} traced on measured heights, and the surface is not measured"
                accepted = "a measured `surface`, or " + " or ".join(others)
                raise InputError("", problem, where=f"model.{name}", found="'measured'", accepted=accepted)
        return self

    @model_validator(mode="after")
    def _check_modes_of_scan(self) -> Self:
        """Refuse modes that a line profile or a lay does not have, where the description says that the scan is or has one."""
        if not isinstance(self.surface, MeasuredSurface):
            return self
        if self.surface.has_lay and self.model.masking in MASKINGS_WITHOUT_LAY:
            problem = "this masking is for a surface without a lay"
            accepted = f"`surface.isotropic: true`, or auto or {' or '.join(SMITH_MASKINGS)}"
            raise InputError("", problem, where="model.masking", found=repr(self.model.masking), accepted=accepted)
        for name, value, others in (
            ("multiple_scattering", "measured", "auto, directional, compensated or none"),
            ("truth", "use", "check or none"),
        ):
            if self.surface.is_line and getattr(self.model, name) == value:
                problem = "rays are traced on a height map, and `surface.layout` is line"
                accepted = f"an areal map as `surface.file`, or {others}"
                raise InputError("", problem, where=f"model.{name}", found=repr(value), accepted=accepted)
        return self

    @model_validator(mode="after")
    def _check_reference_solution(self) -> Self:
        """Refuse a reference solution in place of the prediction where there is no height map to compute it on."""
        if self.model.truth != "use":
            return self
        accepted = (
            f"a measured `surface` without `slab` or `coat`, or {' or '.join(name for name in TRUTHS if name != 'use')}"
        )
        for problem, found in (
            (
                "a reference solution needs a height map, and the surface is not measured",
                not isinstance(self.surface, MeasuredSurface),
            ),
            ("a clear or coated body has no reference solution", self.two_faces is not None),
            ("a reference solution couples its diffuse base", "crf" in (self.model.diffuse, self.model.recipe)),
        ):
            if found:
                raise InputError("", problem, where="model.truth", found="'use'", accepted=accepted)
        return self

    @model_validator(mode="after")
    def _check_texture(self) -> Self:
        """Refuse the texture of a scan where there is no scan, or where the BRDF is not that of its facets alone."""
        if not isinstance(self.texture, ScanTexture):
            return self
        other = next((name for name in ("slab", "coat", "rig", "multiangle") if getattr(self, name) is not None), None)
        measured = isinstance(self.surface, MeasuredSurface) and not self.surface.is_line
        if measured and other is None:
            return self
        problem = "the grain of a scan needs a height map, of which the BRDF is predicted"
        found = f"`{other}`" if measured else "no `surface.file` with a map"
        raise InputError(
            "",
            problem,
            where="texture",
            found=found,
            accepted="a measured areal `surface` on an opaque body, or no `texture`",
        )

    @property
    def two_faces(self) -> tuple[str, str, Any] | None:
        """Of a clear body or a coated one: its key, the key of its other face, and that face."""
        if self.slab is not None:
            return "slab", "slab.back", self.slab.back
        return None if self.coat is None else ("coat", "coat.base.surface", self.coat.base.surface)

    @model_validator(mode="after")
    def _check_two_faces(self) -> Self:
        """Refuse keys that contradict a body with two faces."""
        if self.two_faces is None:
            return self
        key, other_key, other = self.two_faces
        if self.slab is not None and self.coat is not None:
            problem, accepted = (
                "`slab` and `coat` exclude each other",
                "`slab`, a clear body, or `coat`, on an opaque one",
            )
            raise InputError("", problem, accepted=accepted)
        if self.model.effective_masking not in ("auto", *SMITH_MASKINGS):
            problem, accepted = f"a {key} needs one of Smith's maskings", ", ".join(SMITH_MASKINGS)
            masking = repr(self.model.recipe or self.model.masking)
            raise InputError("", problem, where="model.masking", found=masking, accepted=accepted)
        base = (
            "the body below a coat has a diffuse part of its own" if self.coat else "a clear body has no diffuse base"
        )
        for name, problem in (
            ("diffuse", base),
            ("multiple_scattering", f"a {key} always includes the light that its facets reflect more than once"),
        ):
            if (value := getattr(self.model, name)) is not None:
                accepted = f"`{key}` without `model.{name}`"
                raise InputError("", problem, where=f"model.{name}", found=repr(value), accepted=accepted)
        if isinstance(self.index, IndexPair) and self.index.k > 0:
            what = "body of a slab" if self.slab else "coat"
            problem = f"the {what} would be opaque: an extinction coefficient absorbs all light within micrometres"
            accepted = f"k of 0; give its absorption by `{key}.internal_transmittance` or `{key}.absorption`"
            raise InputError("", problem, where="index.k", found=self.index.k, accepted=accepted)
        if isinstance(other, MeasuredSurface) and other.scans is not None:
            problem = "further scans are accepted for the front alone"
            raise InputError("", problem, where=f"{other_key}.scans", accepted="one file")
        return self

    @model_validator(mode="after")
    def _check_slab(self) -> Self:
        """Refuse a spectrum of a clear body."""
        if self.slab is not None and self.spectrum is not None:
            problem = "`slab` and `spectrum` exclude each other: a clear body has no diffuse base, its colour is from absorption"
            accepted = (
                "`slab` with `internal_transmittance` or `absorption`; or `spectrum` without `slab`, for an opaque body"
            )
            raise InputError("", problem, accepted=accepted)
        return self

    @model_validator(mode="after")
    def _check_coat(self) -> Self:
        """Refuse keys that contradict a coated body."""
        if self.coat is None:
            return self
        if isinstance(self.coat.base.index, IndexPair) and self.spectrum is not None:
            problem, accepted = (
                "a metal sends back no light from below its face",
                "`coat` on a metal without `spectrum`",
            )
            raise InputError("", problem, where="spectrum", accepted=accepted)
        if self.model.optics not in (None, "auto", "facets"):
            problem, found = "a coat has facets alone", repr(self.model.optics)
            raise InputError("", problem, where="model.optics", found=found, accepted="facets, with `coat`")
        return self
