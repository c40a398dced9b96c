from __future__ import annotations

import io
import re
from base64 import b64decode

import numpy as np
import samples
import xarray as xr
from PIL import Image

from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.facets import analytic
from brdfpipe.report.plots import spectrum

Datasets = dict[str, xr.Dataset]


def _picture(svg: str) -> np.ndarray:
    data = re.search(r"data:image/png;base64,([^\"]+)", svg)
    assert data is not None
    return np.asarray(Image.open(io.BytesIO(b64decode(data[1]))).convert("RGB"))


def test_a_spectrum_with_the_specular_included_is_the_total(full: Datasets) -> None:
    shown = spectrum.spectrum_figure(full["spectrum"], full["bsdf"])
    assert [label for *_, label in shown.legend] == [
        "± 2 standard uncertainties",
        "total reflectance",
        "mirrored by the facets",
    ]


def test_a_spectrum_with_the_specular_excluded_is_below_the_total(full: Datasets) -> None:
    excluded = full["spectrum"].assign_attrs(geometry="sce")
    bsdf = microfacet.build(full["facets"], index=full["index"], spectrum=excluded, multiple_scattering="none")
    shown = spectrum.spectrum_figure(excluded, bsdf)
    assert [label for *_, label in shown.legend][1:3] == ["total reflectance", "measured, specular excluded"]
    assert "The total reflectance includes the mirrored light that the measurement excluded." in shown.note
    total = spectrum._total(excluded, bsdf)
    assert total is not None
    assert (total[1] > excluded["total_reflectance"].values).all()


def test_without_a_bsdf_a_spectrum_with_the_specular_excluded_is_still_not_called_total(full: Datasets) -> None:
    shown = spectrum.spectrum_figure(full["spectrum"].assign_attrs(geometry="sce"))
    assert [label for *_, label in shown.legend] == ["± 2 standard uncertainties", "measured, specular excluded"]


def test_the_spectral_strip_is_blue_green_red() -> None:
    strip = _picture(f'"{spectrum.visible_strip(400.0, 700.0)}"')[0].astype(int)
    at = {wavelength: strip[round((wavelength - 400) / 300 * 139)] for wavelength in (450, 530, 640)}
    assert [int(np.argmax(at[wavelength])) for wavelength in (450, 530, 640)] == [2, 1, 0]


def test_the_part_of_the_facets_in_the_spectrum_is_that_of_all_azimuths() -> None:
    surface, options = analytic("beckmann", a_x=0.1, a_y=0.6), {"index": 1.5, "multiple_scattering": "none"}
    with samples.coarse_albedo_tables():
        brushed = microfacet.build(surface, spectrum=samples.spectrum(0.3), **options)
    shown = spectrum._specular_part(brushed, brushed["wavelength"].values)
    assert shown is not None
    facets = brushed.assign(diffuse=xr.zeros_like(brushed["diffuse"]))
    # Eight azimuths integrate what varies as cos 2φ and cos 4φ exactly; more of it is below the fourth digit.
    around = facets.bsdf.albedo(8.0, np.arange(0.0, 360.0, 15.0)).mean("direction")
    np.testing.assert_allclose(shown, around.values, rtol=1e-4)


def test_a_perfectly_diffuse_material_has_no_part_of_the_facets() -> None:
    matt = lambertian(samples.spectrum(0.3))
    assert spectrum._specular_part(matt, matt["wavelength"].values) is None
