"""OpenPBR in MaterialX (``.mtlx``): the parameters that come nearest to a BSDF, for Blender, USD and the renderers that read no tables.

A dielectric is a GGX lobe with Fresnel's reflectance over a Lambertian base, whose light is reduced by the lobe's reflectance from the direction
of view, as MaterialX layers them; a metal is a lobe with Schlick's curve. To either MaterialX adds light that facets reflect more than once.
"""

from __future__ import annotations

import re
from pathlib import Path

import xarray as xr

from brdfpipe import store
from brdfpipe.exchange import records
from brdfpipe.exchange.fits.forms import by_albedo
from brdfpipe.exchange.fits.renderer import Fitted, fitted
from brdfpipe.exchange.registry import Format

FORMAT = Format(
    description="parameters of OpenPBR in MaterialX, fitted, for renderers",
    files={"reflection": {"write": (".mtlx",)}},
    takes="cells",
    carries=("colour", "specular"),
    options={"largest_error": 0.25, "largest_delta_e": 5.0},
)


def write(bsdf: xr.Dataset, path: Path, *, largest_error: float, largest_delta_e: float) -> records.Record:
    """Write the reflecting side.

    Parameters
    ----------
    bsdf : kind ``bsdf``, without a lay
    path : the file; it appears whole or not at all
    largest_error : limit of the median error, relative to BRDF·cos θ_o [1]
    largest_delta_e : limit of CIEDE2000 off the lobe, D65 and 2 degree

    Raises
    ------
    ExchangeError : the fit is beyond a limit, the surface has a lay, or no light is reflected.
    """
    found = fitted(
        bsdf,
        "OpenPBR",
        by_albedo,
        exact_fresnel=True,
        compensated=True,
        largest_error=largest_error,
        largest_delta_e=largest_delta_e,
    )
    record = found.record(FORMAT, "OpenPBR")
    store.write_text(path, _document(found, record))
    return record


def _document(found: Fitted, record: records.Record) -> str:
    from xml.etree import ElementTree as xml

    name = re.sub(r"[^A-Za-z0-9_]", "_", record["material"])
    root = xml.Element("materialx", version="1.39", colorspace="lin_rec709")
    for sentence in _sentences(record):
        # Two hyphens would end a comment of XML.
        root.append(xml.Comment(f" {re.sub('-(?=-)', '- ', sentence)} "))
    shader = xml.SubElement(root, "open_pbr_surface", name=f"surface_{name}", type="surfaceshader")
    colour = ", ".join(f"{value:.4f}" for value in found.colour)
    inputs = {
        "base_weight": ("float", "1.0"),
        "base_color": ("color3", colour),
        "base_metalness": ("float", "1.0" if found.is_metal else "0.0"),
        "specular_weight": ("float", "1.0"),
        "specular_roughness": ("float", f"{found.roughness:.4f}"),
        **({} if found.is_metal else {"specular_ior": ("float", f"{found.fit.index:.4f}")}),
    }
    for key, (kind, value) in inputs.items():
        xml.SubElement(shader, "input", name=key, type=kind, value=value)
    material = xml.SubElement(root, "surfacematerial", name=f"material_{name}", type="material")
    xml.SubElement(material, "input", name="surfaceshader", type="surfaceshader", nodename=f"surface_{name}")
    xml.indent(root)
    return f'<?xml version="1.0"?>\n{xml.tostring(root, encoding="unicode")}\n'


def _sentences(record: records.Record) -> list[str]:
    error = record["error"]
    return [
        f"brdfpipe: {record['material']}, digest of the BSDF {record['digest']}",
        f"fitted: off by {error['median']:.0%} of BRDF cos theta_o (median) and {error['percentile_95']:.0%} (95th percentile) at {error['directions']} "
        f"directions, by {error['albedo']:.1%} of the directional reflectance, and by a CIEDE2000 of {error['delta_e_00']:.1f} off the lobe",
        *(f"NOT in this file: {text}" for text in record["left_out"].values()),
    ]
