"""Primary data of a known BSDF: the cells of a rig, and errors drawn from their stated uncertainties."""

from __future__ import annotations

import numpy as np
import rig_primary
import xarray as xr

from brdfpipe import facets, optics, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.measured.basis import solid_angles
from brdfpipe.bsdf.registry import representation
from brdfpipe.specular_directions import cos_view, outgoing

INCIDENCES = (10.0, 30.0, 45.0, 60.0)
WAVELENGTHS = np.arange(450.0, 651.0, 50.0)

U = {"noise": 0.01, "calibration": 0.005, "certificate": 0.01, "reference": 0.01, "repeat": 0.003, "glare": 1e-4}
"""Standard uncertainties: relative, but that of the glare in 1/sr."""

OWN = {
    "noise": ("incidence", "wavelength", "cell"),
    "calibration": ("wavelength", "cell"),
    "repeat": ("incidence", "wavelength"),
    "reference": ("incidence",),
    "glare": ("incidence",),
    "certificate": (),
}
"""Dimensions along which errors are independent."""

DIMS = ("incidence", "wavelength", "cell")


def measured(bsdf: xr.Dataset, seed: int | None = 0, *, incidences=INCIDENCES, wavelengths=WAVELENGTHS) -> xr.Dataset:
    """Kind ``primary``: the BSDF at the cells of a rig, with errors if there is a seed."""
    theta, phi = rig_primary.cells()
    incidence, wavelength = np.asarray(incidences, dtype=float), np.asarray(wavelengths, dtype=float)
    truth = _at_cells(bsdf, incidence, wavelength, theta, phi)
    errors = {name: _drawn(name, truth.shape, seed) for name in OWN}
    value = truth.copy()
    for name in ("calibration", "certificate", "reference", "repeat"):
        value = value * (1 + U[name] * errors[name])
    dark = 1e-5
    noise = np.hypot(U["noise"] * truth, dark)
    value = value + noise * errors["noise"] + U["glare"] * errors["glare"]
    parts = {name: U[name] * np.abs(value) for name in OWN} | {"noise": noise, "glare": np.full_like(value, U["glare"])}
    above = np.broadcast_to((cos_view(incidence[:, None], theta, phi) > 0.07)[:, None], value.shape)
    quality = np.where(above, vocabulary.quality("measured"), vocabulary.quality("shadowed")).astype(np.int8)
    variables = {
        f"brdf_u_{name}": (DIMS, part, {"correlation": "independent" if "cell" in OWN[name] else "common"})
        for name, part in parts.items()
    }
    primary = xr.Dataset(
        {
            "brdf": (DIMS, np.where(above, value, np.nan)),
            "brdf_u": (DIMS, np.sqrt(np.sum(np.square([*parts.values()]), axis=0))),
            "brdf_quality": (DIMS, quality),
            **variables,
        },
        coords={
            "incidence": incidence,
            "wavelength": wavelength,
            "theta_s": ("cell", theta),
            "phi_s": ("cell", phi),
            "solid_angle": ("cell", np.where(theta < 10, solid_angles(theta, phi), np.nan)),
        },
        attrs={"side": "reflection"},
    )
    return vocabulary.label(primary, "primary")


def truth(bsdf: xr.Dataset, primary: xr.Dataset, theta, phi) -> np.ndarray:
    """The BSDF at cells of other directions."""
    return _at_cells(bsdf, primary["incidence"].values, primary["wavelength"].values, theta, phi)


def _drawn(name: str, shape: tuple[int, ...], seed: int | None) -> np.ndarray:
    own = [size if dim in OWN[name] else 1 for dim, size in zip(DIMS, shape, strict=True)]
    return (
        np.zeros(own) if seed is None else np.random.default_rng([seed, sorted(OWN).index(name)]).standard_normal(own)
    )


def _at_cells(bsdf, incidence, wavelength, theta, phi) -> np.ndarray:
    theta_o, phi_o = outgoing(incidence[:, None], theta, phi)
    theta_i = np.broadcast_to(incidence[:, None], theta_o.shape)
    evaluate = representation(bsdf).evaluate
    brdf = evaluate(theta_i, np.zeros_like(theta_i), np.minimum(theta_o, 90.0), phi_o, wavelength)
    return np.moveaxis(np.broadcast_to(brdf, (*theta_o.shape, wavelength.size)), -1, 1)


def deviating(finish, index, spectrum=None, *, slope=1.1, shift=0.03, diffuse=0.95, **choices) -> xr.Dataset:
    """The BSDF of a material whose slopes, index and diffuse reflectance deviate from their descriptions; its facets reflect once."""
    choices = {"multiple_scattering": "none"} | choices
    index = optics.refractive_index(index)
    shifted = index.assign(n=index["n"].copy(data=index["n"].values + shift))
    bsdf = microfacet.build(facets.scaled(finish, slope), index=shifted, spectrum=spectrum, **choices)
    return bsdf.assign(diffuse=bsdf["diffuse"] * diffuse)
