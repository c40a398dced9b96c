"""A material of glTF 2.0 (``.gltf``): the parameters that come nearest to a BSDF, for web viewers and game engines.

A dielectric mixes a GGX lobe and a Lambertian base by Schlick's approximation at the facet between both directions (glTF 2.0, appendix B); its index is that
of ``KHR_materials_ior``.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import xarray as xr

from brdfpipe import store
from brdfpipe.errors import InputError
from brdfpipe.exchange import records
from brdfpipe.exchange.fits.evaluated import number, part, shading_model
from brdfpipe.exchange.fits.forms import by_fresnel
from brdfpipe.exchange.fits.renderer import fitted
from brdfpipe.exchange.listed_points import read_object
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import Format

FORMAT = Format(
    description="parameters of a material of glTF 2.0, fitted, for web viewers and game engines",
    files={"reflection": {"write": (".gltf",)}},
    refuses=("lay",),
    takes="cells",
    carries=("colour", "specular"),
    options={"largest_error": 0.25, "largest_delta_e": 5.0},
    read="read",
)

_IOR = "KHR_materials_ior"


def write(bsdf: xr.Dataset, path: Path, *, largest_error: float, largest_delta_e: float) -> records.Record:
    """Write the reflecting side; the error and what is left out are in ``extras``.

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
        "glTF",
        by_fresnel,
        exact_fresnel=False,
        compensated=False,
        largest_error=largest_error,
        largest_delta_e=largest_delta_e,
    )
    record = found.record(FORMAT, "glTF 2.0")
    material = {
        "name": record["material"],
        "pbrMetallicRoughness": {
            "baseColorFactor": [*record["parameters"]["base_colour"], 1.0],
            "metallicFactor": 1.0 if found.is_metal else 0.0,
            "roughnessFactor": record["parameters"]["roughness"],
        },
        "extras": {"brdfpipe": record},
    }
    document = {"asset": {"version": "2.0", "generator": "brdfpipe"}, "materials": [material]}
    if not found.is_metal:
        document["extensionsUsed"] = ["KHR_materials_ior"]
        material["extensions"] = {"KHR_materials_ior": {"ior": record["parameters"]["index"]}}
    store.write_text(path, json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    return record


def read(path: Path) -> ReadTable:
    """The microfacet model of the first material: GGX with Schlick's curve, and a Lambertian base (glTF 2.0, appendix B).

    Raises InputError: the file is damaged, has no material, or one with textures, or a parameter is out of range.
    """
    document = read_object(path)
    materials = document.get("materials", [])
    if not isinstance(materials, list) or not materials or not isinstance(materials[0], dict):
        raise InputError(path, "the file has no material", found=repr(materials)[:40], accepted="materials: [{…}]")
    material = materials[0]
    values = part(path, material, "pbrMetallicRoughness")
    if textures := [name for name in (*values, *material) if name.endswith("Texture")]:
        accepted = "a material of one appearance, without textures"
        raise InputError(path, "the material has textures", found=textures[0], accepted=accepted)
    extensions = part(path, material, "extensions")
    colour = values.get("baseColorFactor", [1.0, 1.0, 1.0, 1.0])
    if not isinstance(colour, list) or len(colour) != 4:
        raise InputError(path, "baseColorFactor is no colour", found=repr(colour)[:40], accepted="four numbers")
    red_green_blue = np.array([number(path, value, "baseColorFactor") for value in colour[:3]])
    warnings = [f"the extension {name} of the material was not evaluated" for name in sorted(set(extensions) - {_IOR})]
    if len(materials) > 1:
        warnings.append(f"the file has {len(materials)} materials; the first was read")
    return shading_model(
        path,
        colour=red_green_blue,
        metalness=number(path, values.get("metallicFactor", 1.0), "metallicFactor"),
        roughness=number(path, values.get("roughnessFactor", 1.0), "roughnessFactor"),
        index=number(path, part(path, extensions, _IOR).get("ior", 1.5), "ior"),
        form="glTF 2.0",
        warnings=tuple(warnings),
    )
