"""Spheres rendered by Radiance, in the light of this package's preview."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import numpy as np

from brdfpipe.appearance.lights import lights
from brdfpipe.appearance.preview_geometry import SPHERE_RADIUS
from brdfpipe.geometry import Array

_RISES, _TURNS = 181, 361
"""Directions of the table of light: 1 degree apart."""


def rendered(programs: Path, primitive: str, modifier: str, folder: Path, side: int) -> Array:
    """Radiance (side, side) of a sphere of a material as :func:`brdfpipe.appearance.preview_geometry.sphere` sees it, at the exposure of the preview; 0 beside it.

    Parameters
    ----------
    programs : folder that holds Radiance's ``bin`` and ``lib``
    primitive, modifier : the material, and its name
    folder : for the files of the scene
    side : pixels
    """
    rise, turn = np.meshgrid(np.linspace(-90, 90, _RISES), np.linspace(0, 360, _TURNS), indexing="ij")
    across = np.cos(np.radians(rise))
    directions = np.stack(
        [across * np.cos(np.radians(turn)), across * np.sin(np.radians(turn)), np.sin(np.radians(rise))], axis=-1
    )
    studio = lights("studio")
    light = studio.radiance(directions) * studio.exposure
    (folder / "light.dat").write_text(
        f"2\n-90 90 {_RISES}\n0 360 {_TURNS}\n" + "\n".join(" ".join(f"{one:.6g}" for one in row) for row in light)
    )
    (folder / "light.cal").write_text(
        "rise = 180/PI*asin(Dz);\nazimuth = 180/PI*atan2(Dy,Dx);\nturn = if(azimuth, azimuth, azimuth + 360);\n"
    )
    scene = f"""{primitive}
{modifier} sphere ball
0
0
4 0 0 0 1
void brightdata pattern
5 noop {folder / "light.dat"} {folder / "light.cal"} rise turn
0
0
pattern glow even
0
0
4 1 1 1 0
even source around
0
0
4 0 0 1 360
"""
    (folder / "scene.rad").write_text(scene)
    environment = {**os.environ, "RAYPATH": f".:{programs / 'lib'}"}

    def run(name: str, *arguments: str) -> bytes:
        return subprocess.run(
            [programs / "bin" / name, *arguments], check=True, capture_output=True, env=environment, cwd=folder
        ).stdout

    (folder / "scene.oct").write_bytes(run("oconv", "scene.rad"))
    # A distant sphere: parallel rays along +y. Where Radiance samples the lobe, many samples; where it gathers all light, one bounce.
    view = ["-vtl", "-vp", "0", "-5", "0", "-vd", "0", "1", "0", "-vu", "0", "0", "1"]
    field = f"{1 / SPHERE_RADIUS:.6f}"
    noise = [
        "-ab",
        "1",
        "-aa",
        "0",
        "-ad",
        "512",
        "-as",
        "0",
        "-ss",
        "256",
        "-st",
        "0",
        "-lw",
        "0",
        "-ps",
        "1",
        "-pj",
        "0",
    ]
    (folder / "scene.hdr").write_bytes(
        run("rpict", *view, "-vh", field, "-vv", field, "-x", str(side), "-y", str(side), *noise, "scene.oct")
    )
    values = run("pvalue", "-h", "-H", "-df", "-b", "scene.hdr")
    picture = np.frombuffer(values, dtype="<f4").reshape(side, side).astype(float)
    z, x = np.meshgrid(*[(np.arange(side) + 0.5) / side - 0.5] * 2, indexing="ij")
    return np.where(np.hypot(x, z) < SPHERE_RADIUS - 1 / side, picture, 0.0)
