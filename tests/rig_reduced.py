"""Datasets of kind ``reduced`` in closed form: signals of an etalon and of a sample with known factors."""

from __future__ import annotations

from datetime import date

import numpy as np
import xarray as xr

from brdfpipe import specular_directions, vocabulary
from brdfpipe.rig.reduction.budget import BY_NAME
from brdfpipe.rig.reduction.calibration import calibrate
from brdfpipe.rig.reduction.certificate import Certificate
from brdfpipe.rig.reduction.primary import apply_profile
from brdfpipe.rig.reduction.relative_light import COMPONENTS

WAVELENGTHS = np.array([430.0, 470.0, 510.0, 550.0, 650.0])
LAMP = np.array([5e4, 1.6e5, 1.2e5, 1.25e5, 1.1e5])
PATHS = {0.0: 0.9, 10.0: 1.0, 30.0: 1.08, 45.0: 1.03, 60.0: 0.95}
NAMES = tuple(BY_NAME)


def certificate(u: float = 0.005, until: date = date(2030, 1, 1)) -> Certificate:
    theta = np.arange(0.0, 91.0, 1.0)
    return Certificate(
        "C-1", until, np.array([300.0, 900.0]), np.array([0.9, 0.9]), np.full(2, u), theta, shape(theta), 0 * theta
    )


def shape(theta):
    return 1 - 0.05 * (theta / 60) ** 2


def directions(count: int = 80, seed: int = 0):
    random = np.random.default_rng(seed)
    return np.sort(random.uniform(0.5, 105, count)), random.uniform(-180, 180, count)


def sample_brdf(incidence, theta_s, phi_s):
    """Some BRDF (wavelength, cell)."""
    return (0.1 + 0.3 * WAVELENGTHS[:, None] / 650) * (1 + np.exp(-theta_s / 20))


def etalon_brdf(entrance, theta_s, phi_s):
    angle = np.degrees(np.arccos(np.clip(specular_directions.cos_view_etalon(entrance, theta_s, phi_s), 0, 1)))
    return np.broadcast_to(
        0.9 / np.pi * np.interp(angle, np.arange(0.0, 91.0), shape(np.arange(0.0, 91.0))), (5, angle.size)
    )


def reduced(
    load: str,
    incidences=(10.0, 30.0),
    *,
    efficiency=1.0,
    hidden=None,
    stray: float = 0.0,
    relative: float = 1e-3,
    day: str = "2026-03-01",
    **attrs: object,
) -> xr.Dataset:
    """The result of a perfect reduction; ``hidden(incidence)`` is the missing share of each cell's light."""
    theta, phi = directions()
    signal = []
    for incidence in incidences:
        if load == "etalon":
            cosine = specular_directions.cos_view_etalon(incidence, theta, phi)
            brdf = etalon_brdf(incidence, theta, phi)
        else:
            cosine, brdf = specular_directions.cos_view(incidence, theta, phi), sample_brdf(incidence, theta, phi)
        light = (brdf * np.maximum(cosine, 0) + stray) * PATHS[incidence]
        light = light * (1 + 0.1 * np.sin(WAVELENGTHS[:, None] / 70))
        signal.append(light * efficiency * (1.0 if hidden is None else 1 - hidden(incidence)))
    values = np.array(signal)
    dims = ("incidence", "wavelength", "cell")
    variables = {"signal": (dims, values), "signal_quality": (dims, np.zeros(values.shape, dtype=np.int8))}
    floor = 1e-6 * np.broadcast_to(efficiency, theta.shape)
    variables |= {
        f"signal_u_{name}": (
            dims,
            np.hypot(relative * np.abs(values), floor) if name == "noise" else relative * np.abs(values),
            {"correlation": correlation},
        )
        for name, correlation in COMPONENTS.items()
    }
    variables["reference"] = (("incidence", "wavelength"), np.tile(LAMP, (len(incidences), 1)))
    variables["elapsed"] = (("incidence", "wavelength"), np.tile(60.0 * np.arange(5), (len(incidences), 1)))
    dataset = xr.Dataset(
        variables,
        coords={
            "incidence": list(incidences),
            "wavelength": WAVELENGTHS,
            "cell": ("cell", np.array([f"F{k}" for k in range(theta.size)])),
            "kind": ("cell", np.full(theta.size, "fibre")),
            "theta_s": ("cell", theta),
            "phi_s": ("cell", phi),
            "solid_angle": ("cell", np.full(theta.size, np.nan)),
        },
        attrs={"rig": "bench", "rig_digest": "abc", "sample": "tile", "side": "reflection", "load": load, "day": day}
        | {"filter": 1, "filter_u": 0.0, "disc_scale_u": 0.01}
        | attrs,
    )
    return vocabulary.validate(vocabulary.label(dataset, "reduced"), "reduced")


def brdf_of(sample: xr.Dataset, **options: object) -> xr.Dataset:
    return apply_profile(sample, calibrate(reduced("etalon"), certificate()), **options)


def above(incidence, least=0.1):
    theta, phi = directions()
    facing = np.max([specular_directions.cos_view_etalon(entrance, theta, phi) for entrance in (10.0, 30.0)], axis=0)
    return (specular_directions.cos_view(incidence, theta, phi) > least) & (facing > 0.11)
