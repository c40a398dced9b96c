"""The keys of ``certificate.yaml``: a reflectance standard, lit at normal incidence."""

from typing import Annotated

from pydantic import Field, Strict

from brdfpipe.descriptions.keys import NAME, NAME_WORDS, Choice, Keys, key, mapping_or_value

Theta = Annotated[float, Field(ge=0, le=90, description="an angle from the normal in degree")]
Ratio = Annotated[float, Field(ge=0, le=90, description="a ratio to the BRDF at 0 degree")]
RelativeU = Annotated[float, Field(ge=0, le=1, description="a relative standard uncertainty")]
Ratios = Annotated[tuple[Theta, Ratio], Strict(False)]
UncertainRatios = Annotated[tuple[Theta, Ratio, RelativeU], Strict(False)]


class FactorTable(Keys):
    """A table of the reflectance factor."""

    file: str = key(
        "CSV file beside certificate.yaml with the columns wavelength [nm], reflectance_factor, u (relative)",
        required=True,
        max_length=1000,
        example="certificate.csv",
    )


Factor = Annotated[float, Field(gt=0, le=2, description="a number or {file: certificate.csv}")]


class CertificateKeys(Keys):
    """The certificate of a reflectance standard, lit at normal incidence."""

    id: str = key(f"name of the certificate; {NAME_WORDS}", required=True, pattern=f"^{NAME}$")
    valid_until: str = key('last day of validity, a date in quotes, "2027-06-30"', required=True, max_length=10)
    reflectance_factor: Annotated[FactorTable | Factor, Choice(mapping_or_value)] = key(
        "the BRDF at normal incidence and view, times π: a number above 0 and at most 2, or {file: certificate.csv}",
        required=True,
    )
    u: float = key(
        "relative standard uncertainty (k = 1) of a single reflectance factor, and of ratios in `angles` that state none",
        default=0.005,
        ge=0,
        le=1,
    )
    tilt_u: float = key(
        "root mean square angle of the etalon's normal from the direction of the light, by its flatness and its seat in the holder",
        default=0.1,
        unit="degree",
        ge=0,
        le=5,
    )
    angles: list[
        Annotated[UncertainRatios | Ratios, Choice(lambda item: 0 if isinstance(item, list) and len(item) > 2 else 1)]
    ] = key(
        "BRDF against the angle from the normal: [angle in degree, ratio to 0 degree, relative standard uncertainty], "
        "[[0, 1], [30, 0.99, 0.002], [60, 0.95, 0.004]]; linear in between",
        default=[[0, 1]],
        min_length=1,
        max_length=500,
    )
