"""OpenPBR in MaterialX (``.mtlx``): the parameters that come nearest to a BSDF, for Blender, USD and the renderers that read no tables.

A dielectric is a GGX lobe with Fresnel's reflectance over a Lambertian base, whose light is reduced by the lobe's reflectance from the direction
of view, as MaterialX layers them; a metal is a lobe with Schlick's curve. To either MaterialX adds light that facets reflect more than once.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr

from brdfpipe import store
from brdfpipe.errors import InputError
from brdfpipe.exchange import records
from brdfpipe.exchange.fits.evaluated import number, shading_model
from brdfpipe.exchange.fits.forms import by_albedo
from brdfpipe.exchange.fits.renderer import Fitted, fitted
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import Format
from brdfpipe.exchange.window_xml import parsed

FORMAT = Format(
    description="parameters of OpenPBR in MaterialX, fitted, for renderers",
    files={"reflection": {"write": (".mtlx",)}},
    refuses=("lay",),
    takes="cells",
    carries=("colour", "specular"),
    options={"largest_error": 0.25, "largest_delta_e": 5.0},
    read="read",
)

_SHADER = "open_pbr_surface"
_COLOUR_SPACES = ("", "lin_rec709")
_DEFAULTS: Mapping[str, float] = {
    "base_weight": 1.0,
    "base_metalness": 0.0,
    "specular_roughness": 0.3,
    "specular_ior": 1.5,
}
_BASE_COLOUR = (0.8, 0.8, 0.8)
"""Of OpenPBR 1.1."""
_ONE = ("specular_weight",)
"""Inputs that are read at this value alone."""


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
        *records.heading(record),
        f"fitted: off by {error['median']:.0%} of BRDF cos theta_o (median) and {error['percentile_95']:.0%} (95th percentile) at {error['directions']} "
        f"directions, by {error['albedo']:.1%} of the directional reflectance, and by a CIEDE2000 of {error['delta_e_00']:.1f} off the lobe",
        *(f"NOT in this file: {text}" for text in record["left_out"].values()),
    ]


def read(path: Path) -> ReadTable:
    """The microfacet model of the one OpenPBR surface of a document: GGX facets over a Lambertian base, or a metal.

    Raises InputError: the file is damaged or has entities, it has no OpenPBR surface or several, an input is connected to a node, or out of range.
    """
    root = parsed(path, "a MaterialX document")
    shaders = root.findall(_SHADER)
    if root.tag != "materialx" or len(shaders) != 1:
        found = f"{str(root.tag)[:40]} with {len(shaders)} of {_SHADER}"
        raise InputError(path, "not one OpenPBR surface", found=found, accepted=f"materialx with one {_SHADER}")
    space = root.get("colorspace", "")
    inputs: dict[str, str] = {}
    for one in shaders[0].findall("input"):
        name, value = one.get("name", "")[:40], one.get("value")
        if value is None:
            accepted = "values alone; what textures and nodes hold varies over the surface"
            raise InputError(path, f"the input {name} has no value", found="a connection", accepted=accepted)
        inputs[name], space = value, one.get("colorspace", space)
    if space not in _COLOUR_SPACES:
        raise InputError(path, "unknown colour space", found=repr(space)[:40], accepted=_COLOUR_SPACES[-1])
    values = {name: _numbers(path, inputs, name, (default,))[0] for name, default in _DEFAULTS.items()}
    for name in _ONE:
        if (given := _numbers(path, inputs, name, (1.0,))[0]) != 1:
            raise InputError(path, f"{name} is not read", found=f"{given:g}", accepted="1")
    known = {*_DEFAULTS, *_ONE, "base_color"}
    return shading_model(
        path,
        colour=values["base_weight"] * np.array(_numbers(path, inputs, "base_color", _BASE_COLOUR)),
        metalness=values["base_metalness"],
        roughness=values["specular_roughness"],
        index=values["specular_ior"],
        form="OpenPBR",
        warnings=tuple(f"the input {name} was not evaluated" for name in sorted(set(inputs) - known)),
    )


def _numbers(path: Path, inputs: Mapping[str, str], name: str, default: tuple[float, ...]) -> list[float]:
    """The numbers of an input, as many as its default has."""
    words = inputs[name].split(",") if name in inputs else default
    if len(words) != len(default):
        raise InputError(path, f"wrong number of values of {name}", found=f"{len(words)}", accepted=f"{len(default)}")
    try:
        return [number(path, float(word), name) for word in words]
    except ValueError as error:
        raise InputError(path, f"{name} is not a number", found=repr(inputs[name])[:40], accepted="numbers") from error
