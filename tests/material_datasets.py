"""Small, realistic datasets of one material, as the stages write them."""

from __future__ import annotations

import json

import numpy as np
import xarray as xr

from brdfpipe import facets, store, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.surfaces.texture_parameters import with_parameters

Datasets = dict[str, xr.Dataset]


def surface_map(rows: int = 96, columns: int = 128) -> xr.Dataset:
    """A smooth random map with a hole."""
    rng = np.random.default_rng(7)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(columns), np.fft.fftfreq(rows)))
    spectrum = np.fft.fft2(rng.normal(size=(rows, columns))) * np.exp(-((12 * frequency) ** 2))
    height = np.fft.ifft2(spectrum).real
    height *= 2.0 / height.std()
    height[20:40, 30:60] = np.nan
    surface = xr.Dataset(
        {"height": (("y", "x"), height)},
        coords={"x": 2.0 * np.arange(columns), "y": 2.0 * np.arange(rows)},
        attrs={"pitch_x": 2.0, "pitch_y": 2.0, "levelling": "plane", "band": "2 to 256 um"},
    )
    return with_parameters(vocabulary.label(surface, "surface"))


def surface_line(size: int = 4000) -> xr.Dataset:
    """A line profile with a gap."""
    height = np.cumsum(np.random.default_rng(3).normal(size=size)) * 0.01
    height[1000:1100] = np.nan
    attrs = {"pitch_x": 0.5, "levelling": "plane", "band": "0.5 to 2000 um"}
    line = xr.Dataset({"height": ("x", height)}, coords={"x": 0.5 * np.arange(size)}, attrs=attrs)
    return with_parameters(vocabulary.label(line, "surface"))


def _spectrum() -> xr.Dataset:
    wavelength = np.arange(400.0, 701.0, 10.0)
    reflectance = 0.06 + 0.5 / (1 + np.exp(-(wavelength - 600) / 14))
    attrs = {"geometry": "sci", "theta_i": 8.0, "method": "measured", "residual_delta_e": np.nan}
    values = {
        "total_reflectance": ("wavelength", reflectance),
        "total_reflectance_u": ("wavelength", np.full(wavelength.size, 0.004)),
    }
    return vocabulary.label(xr.Dataset(values, coords={"wavelength": wavelength}, attrs=attrs), "spectrum")


def _index() -> xr.Dataset:
    coords = {"wavelength": [400.0, 550.0, 700.0]}
    values = {"n": ("wavelength", [1.57, 1.55, 1.54]), "k": ("wavelength", [0.0, 0.0, 0.0])}
    return vocabulary.label(xr.Dataset(values, coords=coords, attrs={"source": "constant"}), "index")


def _facets() -> xr.Dataset:
    beckmann = facets.analytic("beckmann", 0.2)
    size = beckmann.sizes["slope"]
    quality = np.full(size, vocabulary.quality("measured"))
    quality[size // 2 :] = vocabulary.quality("extrapolated")
    return vocabulary.label(
        beckmann.assign(
            D_u=beckmann["D"] * 0.05,
            slope_density_quality=("slope", quality),
            anisotropy=1.25,
            facet_count=123456.0,
            effective_count=2345.0,
            noise_ratio=1.1,
            correlation_length=14.0,
            slope_rms_scale=("scale", [0.2, 0.18, 0.14, np.nan]),
        ).assign_coords(scale=[1.0, 2.0, 4.0, 8.0]),
        "facets",
    )


def _checks() -> xr.Dataset:
    theta_i, wavelength = np.array([0.0, 30.0, 60.0, 85.0]), np.array([450.0, 550.0, 650.0])
    verdicts = {
        "reciprocity": {"verdict": "pass", "text": "f(i,o) equals f(o,i)"},
        "energy": {"verdict": "warn", "text": "close to 1 at 85 degree"},
    }
    values = {
        "albedo": (("theta_i", "wavelength"), np.linspace(0.1, 0.4, 12).reshape(4, 3)),
        "reciprocity_residual": 1e-9,
        "energy_excess": 0.0,
        "negative_fraction": 0.0,
        "closure_residual": np.nan,
        "floor": 1e-3,
    }
    coords = {"theta_i": theta_i, "wavelength": wavelength}
    return vocabulary.label(xr.Dataset(values, coords=coords, attrs={"verdicts": json.dumps(verdicts)}), "checks")


def _appearance() -> xr.Dataset:
    values = {
        "gloss": ("gloss_angle", [3.21, 21.43, 48.94]),
        "haze": 18.22,
        "lab": (("geometry", "component"), [[45.21, 41.05, 27.21], [39.7, 48.69, 40.98]]),
        "flop_index": np.nan,
        "srgb": ("channel", [0.66, 0.2, 0.23]),
    }
    coords = {
        "gloss_angle": [20.0, 60.0, 85.0],
        "geometry": ["8:total", "45:0"],
        "component": ["L*", "a*", "b*"],
        "channel": ["R", "G", "B"],
    }
    attrs = {"illuminant": "D65", "observer": 10, "total_geometry": "8:total"}
    return vocabulary.label(xr.Dataset(values, coords=coords, attrs=attrs), "appearance")


def _lambert_gauss() -> xr.Dataset:
    values = {
        "lambert": ("theta_i", [0.1, 0.1, 0.09]),
        "gauss_peak": ("theta_i", [0.3, 0.5, 2.0]),
        "gauss_fwhm_parallel": ("theta_i", [20.0, 21.0, 25.0]),
        "gauss_fwhm_perpendicular": ("theta_i", [20.0, 19.0, 15.0]),
        "gauss_reflectance": ("theta_i", [0.04, 0.05, 0.09]),
        "fit_residual": ("theta_i", [0.02, 0.03, 0.2]),
    }
    attrs = {"representation": "lambert_gauss"}
    return vocabulary.label(xr.Dataset(values, coords={"theta_i": [0.0, 30.0, 60.0]}, attrs=attrs), "bsdf")


def stored(datasets: Datasets, material: str = "abs-grain") -> Datasets:
    """The datasets with the provenance that storing gives them."""
    result = {}
    for stage, dataset in datasets.items():
        dataset = dataset.assign_attrs(
            material=material,
            stage=stage,
            inputs=json.dumps({"raw": "ab" * 32}),
            parameters=json.dumps({"form": "plane"}),
            software=json.dumps({"numpy": "2.4.0"}),
        )
        result[stage] = dataset.assign_attrs(digest=store.digest(dataset))
    return result


def full_material() -> Datasets:
    """Everything that the workflow can know of one material."""
    finish, index, spectrum = _facets(), _index(), _spectrum()
    return stored(
        {
            "surface": vocabulary.add_history(surface_map(), "A plane was taken away."),
            "facets": finish,
            "spectrum": vocabulary.add_warning(spectrum, "R is high at 700 nm: check the `white` reference."),
            "index": index,
            "bsdf": microfacet.build(finish, index=index, spectrum=spectrum, multiple_scattering="none"),
            "checks": _checks(),
            "appearance": _appearance(),
            "lambert_gauss": _lambert_gauss(),
        }
    )
