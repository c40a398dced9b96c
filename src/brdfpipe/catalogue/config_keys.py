"""The keys of ``config.yaml``: settings for all materials of a catalogue. The defaults are the values of ``config/config.yaml``."""

from collections.abc import Iterable
from typing import Annotated, Self

from pydantic import Field, Strict, model_validator

from brdfpipe.catalogue.material_keys import EXPORT_WORDS, Observer
from brdfpipe.descriptions.keys import Items, Keys, OneOf, key
from brdfpipe.errors import InputError
from brdfpipe.exchange.registry import WRITTEN

PolarAngles = Annotated[
    list[Annotated[float, Field(ge=0, lt=90, description="an angle from the normal")]], Items(rising=True)
]

FullAngle = Annotated[float, Field(gt=0, le=60, description="a full angle in degree")]


def _sets() -> Iterable[str]:
    from brdfpipe.flakes.geometries import SETS

    return SETS


class HazeWindow(Keys):
    """A pair of receptors on both sides of the mirror direction."""

    angle: float = key("angle of incidence", required=True, unit="degree", ge=0, le=85)
    offset: float = key(
        "angle between the mirror direction and the middle of a receptor", required=True, unit="degree", gt=0, le=60
    )
    aperture: Annotated[tuple[FullAngle, FullAngle], Strict(False)] = key(
        "full angles of a receptor in the plane of incidence and across it", required=True, unit="degree"
    )


class Appearance(Keys):
    """Further colours, and the reflectance haze."""

    geometries: Annotated[list[Annotated[str, OneOf(_sets)]], Items()] = key(
        "sets of geometries, of standards and of portable instruments, for colours beside 45:0 and E2194"
    )
    haze: list[HazeWindow] = key(
        "windows of the reflectance haze {angle, offset, aperture}, each a pair of receptors on both sides of the mirror direction",
        max_length=12,
    )


class Table(Keys):
    """Angles of the tabulated BRDF."""

    refine: bool = key("whether angles are added about the mirror directions, on the scale of the material's lobe")
    theta_i: PolarAngles = key("increasing angles of incidence", unit="degree", min_length=2, max_length=181)
    theta_o: PolarAngles = key(
        "increasing polar angles of the outgoing direction", unit="degree", min_length=2, max_length=181
    )
    phi_o: Annotated[list[Annotated[float, Field(ge=0, le=180, description="an azimuth")]], Items(rising=True)] = key(
        "increasing azimuths of the outgoing direction, from 0 (towards the source) to 180 (mirror direction); mirrored to 360",
        unit="degree",
        min_length=2,
        max_length=361,
    )
    phi_i: Annotated[list[Annotated[float, Field(ge=0, le=360, description="an azimuth")]], Items(rising=True)] = key(
        "surfaces with a lay: increasing azimuths of incidence, counted from the lay",
        unit="degree",
        min_length=2,
        max_length=361,
    )

    @model_validator(mode="after")
    def _check_azimuths(self) -> Self:
        if self.phi_o is not None and (self.phi_o[0], self.phi_o[-1]) != (0, 180):
            span, problem = f"{self.phi_o[0]:g} to {self.phi_o[-1]:g}", "the azimuths do not span half a circle"
            raise InputError("", problem, where="phi_o", found=span, accepted="0 to 180")
        return self


class LambertGauss(Keys):
    """The Lambert and Gauss fit."""

    theta_i: Annotated[
        list[Annotated[float, Field(ge=0, le=85, description="an angle of incidence")]], Items(rising=True)
    ] = key("increasing angles of incidence", unit="degree", min_length=1, max_length=86)


class Comparison(Keys):
    """Standard uncertainties of the inputs of a prediction."""

    index_u: float = key("standard uncertainty of the refractive index", ge=0, le=1)
    slope_u: float = key("relative standard uncertainty of the facets' slopes", ge=0, le=1)
    diffuse_u: float = key("relative standard uncertainty of the diffuse reflectance below the facets", ge=0, le=1)


class JobLimits(Keys):
    """What one stage of one material may take; beyond that it fails, and no other material with it."""

    seconds: float = key("wall time", unit="s", gt=0)
    memory: float = key("memory of the process", unit="MB", ge=1000)


class Config(Keys):
    """Settings for all materials of a catalogue."""

    scene: str = key(
        "what the results are for; the name of a shipped scene, or the path of a file in relation to this one",
        details="See [scenes](scenes.md). The command line and the key `scene` of a material come first.",
        min_length=1,
        max_length=255,
    )
    illuminant: str = key("illuminant of colours and previews, D65, D50, A or another CIE illuminant")
    observer: Observer = key("observer of colours and previews, 10 or 2 degree")
    gloss_angles: Annotated[list[Annotated[int, OneOf((20, 60, 85))]], Items()] = key(
        "angles of the gloss meter, among 20, 60 and 85", unit="degree", min_length=1
    )
    appearance: Appearance = key("further colours, and the reflectance haze {geometries, haze}")
    table: Table = key("angles of the tabulated BRDF {refine, theta_i, theta_o, phi_o, phi_i}")
    lambert_gauss: LambertGauss = key("the Lambert and Gauss fit {theta_i}")
    comparison: Comparison = key(
        "how well the inputs of a prediction are known before they are fitted to what a rig measured; 0 keeps an input as it is"
    )
    preview: bool = key("whether the report shows a rendered picture of the material")
    preview_light: Annotated[str, OneOf(("studio", "sun", "overcast", "spot", "tubes"))] = key(
        "light of the picture: studio (soft boxes), sun (a small disc under a clear sky), overcast (a sky alone), "
        "spot (one lamp) or tubes (rows of them)"
    )
    exports: Annotated[list[Annotated[str, OneOf(WRITTEN)]], Items()] = key(
        "files for materials without `exports`; " + EXPORT_WORDS
    )
    job_limits: JobLimits = key("what one stage of one material may take before it is ended {seconds, memory}")
