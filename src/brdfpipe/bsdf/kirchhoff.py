"""The BSDF of a measured height map by Kirchhoff's diffraction integral on the map: a reference solution for models of the surface.

References
----------
Beckmann & Spizzichino 1963, ch. 3 and 5; Stover, Optical Scattering, 3rd ed., ch. 4, for the Bragg frequency of a direction.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import vocabulary
from brdfpipe.bsdf.microfacet.builder import index_on, wavelengths_of
from brdfpipe.bsdf.representations.kirchhoff import Diffraction, Kirchhoff
from brdfpipe.bsdf.spectrum_closure import around_mirror_direction, with_base
from brdfpipe.geometry import Array
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.optics.index import refractive_index
from brdfpipe.references.height_mesh import HeightMapError, HeightMesh
from brdfpipe.references.phase_spectrum import phase_spectrum

SLOPE_LIMIT = 0.2
"""Typical slope √⟨p² + q²⟩ above which the result warns: masking, the local angle of incidence and second reflections are left out."""
COARSE_WARNING = 1e-3
"""Share of steps between neighbouring heights of more than π in phase above which the result warns."""
SCALING_LIMIT = 0.1
"""Change of the diffracted light by scaling it to all that is not coherent, above which the result warns."""
EXCESS_LIMIT = 0.01
"""Coherent and diffracted light beyond all light, of any incidence, above which the result warns."""
LAY_LIMIT = 1.2
"""Ratio of the principal slopes above which the mean over azimuth is reported as such."""


def build(
    surface: xr.Dataset,
    *,
    index: xr.Dataset | float | str,
    spectrum: xr.Dataset | None = None,
    wavelength: ArrayLike | None = None,
) -> xr.Dataset:
    """BSDF of a height map from the diffraction of light on the map itself.

    Parameters
    ----------
    surface : kind ``surface``, a levelled map of low slopes
    index, spectrum : as for :func:`brdfpipe.bsdf.microfacet.build`
    wavelength : [nm], increasing; by default those of the spectrum, else of the index, else :data:`brdfpipe.bsdf.microfacet.builder.WAVELENGTHS`

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``kirchhoff``, the mean over the azimuth of incidence. Coherent light is not part of the
    BSDF but of its specular reflectance. Its uncertainty is the scatter between blocks of the map, and by speckle. The attribute
    ``diffracted_light_scaling`` is the factor, furthest from 1, by which diffracted light was scaled to all that is not coherent

    Raises
    ------
    HeightMapError : a surface that :func:`brdfpipe.references.phase_spectrum.phase_spectrum` refuses, or unusable wavelengths.
    VocabularyError : a dataset of the wrong kind.

    Notes
    -----
    f = F(ζ) U(q, f)/λ², q = 2π(cos θ_i + cos θ_o)/λ, f the Bragg frequency of the directions, U the spectrum of exp(i q h); the coherent
    share is |⟨exp(i q h)⟩|² at q = 4π cos θ_i/λ. Valid from the smooth to the geometric limit while slopes are small. Light beyond the
    highest frequency that the pitch samples is 0.
    """
    index = vocabulary.validate(index, "index") if isinstance(index, xr.Dataset) else refractive_index(index)
    if spectrum is not None:
        vocabulary.validate(spectrum, "spectrum")
    given = wavelengths_of(spectrum, index, wavelength, HeightMapError)
    n, k, _, warnings = index_on(index, given)
    n, k = np.broadcast_to(n, given.shape), np.broadcast_to(k, given.shape)
    if np.any((n < 1) & (k == 0)):
        raise HeightMapError(
            f"the refractive index falls to {np.min(n):g}, below that of air, without absorption; accepted: n >= 1, or k > 0"
        )
    found = phase_spectrum(surface, 4e3 * np.pi / float(given[0]))
    nodes = ("phase_per_height", "spatial_frequency")
    bsdf = xr.Dataset(
        {
            "log_phase_spectrum": (nodes, np.log(found.spectrum / found.phase[:, None] ** 2)),
            "log_phase_spectrum_change": (("block", *nodes), np.log1p(found.changes)),
            "coherent_share": (nodes[:1], found.coherent),
            "coherent_share_change": (("block", nodes[0]), found.coherent_changes),
            "frequency_scale": found.frequency_scale,
            "measured_area": float(surface["height"].notnull().sum())
            * surface.attrs["pitch_x"]
            * surface.attrs["pitch_y"],
            "n": ("wavelength", n),
            "k": ("wavelength", k),
        },
        coords={"phase_per_height": found.phase, "spatial_frequency": found.frequency, "wavelength": given},
        attrs={"representation": Kirchhoff.name, "band": surface.attrs["band"]},
    )
    scaling = float(found.scaling[np.abs(found.scaling - 1).argmax()])
    bsdf.attrs["diffracted_light_scaling"] = scaling
    diffraction = Diffraction.of(bsdf)
    slope = diffraction.lobe_slope(float(given[given.size // 2]))

    def diffracted(theta_i: float, half_angle: float = 180.0) -> Array:
        return around_mirror_direction(
            lambda i, azimuth_i, o, azimuth_o: diffraction.brdf(i, azimuth_i, o, azimuth_o, given, n, k),
            theta_i,
            slope,
            half_angle,
        )

    def reflected(theta: Array) -> Array:
        cosine = np.cos(np.radians(np.minimum(theta, 89.99)))[:, None]
        mirror = fresnel(cosine, n, k).mean
        halo = np.stack([diffracted(min(float(angle), 89.99)) for angle in theta])
        returned = mirror * diffraction.coherent_share(cosine, given) + halo
        if (excess := float(returned.max()) - 1) > EXCESS_LIMIT:
            first = float(theta[(returned > 1 + EXCESS_LIMIT).any(axis=1).argmax()])
            warnings.append(
                f"from an incidence of {min(first, 89.99):g}° on, coherent and diffracted light together are up to {1 + excess:.1%} of the incident light: "
                "Kirchhoff's integral leaves out masking, and the reflectance is stated as 100 % there; evaluate the BSDF at smaller angles"
            )
        return np.minimum(returned, 1.0)

    def trapped(theta_i: float, half_angle: float) -> Array:
        cosine = np.array([[np.cos(np.radians(theta_i))]])
        coherent = fresnel(cosine, n, k).mean * diffraction.coherent_share(cosine, given)
        return np.asarray(coherent[0] + diffracted(theta_i, half_angle))

    bsdf = with_base(bsdf, reflected, spectrum, trapped)
    warnings += light_warnings(bsdf)
    warnings += _limits(surface, found.coarse, float(found.frequency[-1]), float(given[0]))
    return vocabulary.label(vocabulary.add_warning(bsdf, *warnings), "bsdf")


def light_warnings(bsdf: xr.Dataset) -> list[str]:
    """A warning where the light that the map diffracts is not all that is not coherent."""
    scaling = float(bsdf.attrs["diffracted_light_scaling"])
    if abs(scaling - 1) <= SCALING_LIMIT:
        return []
    return [
        f"diffracted light was scaled by {scaling:.2f} to all that is not coherent: the map is few waves wide; measure a larger area"
    ]


def _limits(surface: xr.Dataset, coarse: float, nyquist: float, shortest: float) -> list[str]:
    """What limits the result."""
    mesh = HeightMesh.of(surface)
    warnings = []
    slope, anisotropy = np.sqrt(2) * mesh.typical_slope, mesh.anisotropy
    if slope > SLOPE_LIMIT:
        warnings.append(
            f"the typical slope of the surface is {slope:.2g}: above {SLOPE_LIMIT:g} Kirchhoff's integral on the map leaves out masking, the "
            "local angle of incidence and second reflections; trace rays instead (`brdfpipe.bsdf.traced.build`)"
        )
    if coarse > COARSE_WARNING:
        warnings.append(
            f"the phase of reflected light changes by more than π between {coarse:.2%} of neighbouring heights; measure with a finer pitch"
        )
    if anisotropy > LAY_LIMIT:
        warnings.append(
            f"the principal slopes of the surface differ by a factor {anisotropy:.2f}, and the BSDF is the mean over the azimuth of "
            "incidence: it does not show the lay"
        )
    reach = nyquist * shortest * 1e-3
    if reach < 1:
        warnings.append(
            f"the pitch of the map samples diffracted light up to {np.degrees(np.arcsin(reach)):.0f}° from the mirror direction at "
            f"{shortest:g} nm and normal incidence; beyond it the BSDF has no diffracted light. A finer pitch reaches further"
        )
    return warnings
