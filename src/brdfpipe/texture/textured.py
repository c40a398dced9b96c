"""A BRDF with its visible structure: a value for each place of a tile, whose mean over the tile is the BRDF."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import BrdfpipeError, VocabularyError
from brdfpipe.flakes.refraction import flake_angle
from brdfpipe.geometry import Array, check_angles, unit_vector
from brdfpipe.texture.picture_texture import COAT_INDEX, nearest_geometry
from brdfpipe.texture.scan_texture import map_slopes, normals_of
from brdfpipe.texture.seen_from_afar import AREAS, in_frames, local_frames, seen_from_afar
from brdfpipe.texture.slope_split import MapSlopes

_BINS_PER_WIDTH, _MOST_BINS, _PLACES = 40.0, 100_000, 12
"""Bins of the slopes of the map per slope rms of the rest, and places between its pixels, for the mean over a tile to 1e-3."""


def _paired(*given: Array) -> Iterator[Array]:
    """Directions and places, of one length."""
    try:
        together = np.broadcast_arrays(*given)
    except ValueError:
        names = "theta_i", "phi_i", "theta_o", "phi_o", "x", "y"
        shapes = ", ".join(f"{name} {one.shape}" for name, one in zip(names, given, strict=True) if one.shape)
        raise VocabularyError(
            f"directions and places of different shapes: {shapes}; give equal lengths, or shapes that broadcast as in numpy"
        ) from None
    yield from (one.ravel() for one in together)


class Textured:
    """A BRDF as a function of directions and place.

    Parameters
    ----------
    bsdf : kind ``bsdf``, of the material without a map
    texture : kind ``texture``, of a scan or of pictures
    rest : kind ``bsdf``, of what the pixels of the texture of a scan do not resolve

    Raises
    ------
    BrdfpipeError : ``rest`` is missing.
    VocabularyError : a dataset of the wrong kind.
    """

    def __init__(self, bsdf: xr.Dataset, texture: xr.Dataset, rest: xr.Dataset | None = None) -> None:
        self._bsdf = vocabulary.validate(bsdf, "bsdf")
        self._texture = vocabulary.validate(texture, "texture")
        self._rest = None if rest is None else vocabulary.validate(rest, "bsdf")
        if self._rest is None and texture.attrs["source"] == "scan":
            raise BrdfpipeError(
                "the texture of a scan needs the BSDF of what its pixels do not resolve; give `unresolved.nc`, or the result of "
                "brdfpipe.texture.unresolved.unresolved_bsdf"
            )

    def evaluate(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        theta_o: ArrayLike,
        phi_o: ArrayLike,
        x: ArrayLike,
        y: ArrayLike,
        wavelength: ArrayLike | None = None,
    ) -> xr.DataArray:
        """BRDF at places of the surface.

        Parameters
        ----------
        theta_i, phi_i, theta_o, phi_o : degree, directions of reflection, broadcast with the places
        x, y : um, any; the tile repeats. The slopes between pixels are interpolated as the texture says
        wavelength : (m,) nm; by default those of the BSDF

        Returns
        -------
        DataArray ``brdf`` [sr-1] (place, wavelength), or (place,) of a BSDF without wavelengths

        Raises
        ------
        VocabularyError : an angle is out of range or in radians.

        Notes
        -----
        Of a scan f(x, y) = f · f_map(x, y) / mean(f_map), where f_map is that of the rest in the frame of the normal at the place. The mean over a tile is f, whatever the
        split missed of it. Of pictures f(x, y) = f · t(x, y), where t is the relative light of the picture whose flake angle is nearest.
        """
        given = {"theta_i": theta_i, "phi_i": phi_i, "theta_o": theta_o, "phi_o": phi_o}
        angles = [
            check_angles(name, one, *((0, 90) if name.startswith("theta") else (-720, 720)))
            for name, one in given.items()
        ]
        # At the horizon both are infinite, of a value that is 0.
        angles[0], angles[2] = (np.minimum(angles[k], 89.999) for k in (0, 2))
        *angles, x, y = _paired(*angles, np.asarray(x, float), np.asarray(y, float))
        own = self._bsdf["wavelength"].values if "wavelength" in self._bsdf.coords else None
        wavelengths = own if wavelength is None else np.atleast_1d(np.asarray(wavelength, dtype=float))
        # Directions that repeat have one value, and one mean.
        pairs, which = np.unique(np.stack(angles), axis=1, return_inverse=True)
        full = representation(self._bsdf).evaluate(pairs[0], pairs[1], pairs[2], pairs[3], wavelengths)
        which = which.ravel()
        if self._rest is None:
            picture = nearest_geometry(self._texture, flake_angle(pairs[0], pairs[1], pairs[2], pairs[3], COAT_INDEX))[
                which
            ]
            values = full[which] * self._light_at(x, y, picture)[:, None]
        else:
            mean = seen_from_afar(self._rest, self._slopes, *pairs, wavelength=wavelengths)
            towards = unit_vector(angles[0], angles[1]), unit_vector(angles[2], angles[3])
            here = in_frames(self._rest, local_frames(*self._slopes_at(x, y)), *towards, AREAS[0], wavelengths)
            values = here * np.divide(full, mean, out=np.zeros_like(full), where=mean > 0)[which]
        attributes = {"units": "sr-1", "long_name": "bidirectional reflectance distribution function at a place"}
        if wavelengths is None:
            return xr.DataArray(values[:, 0], dims="place", name="brdf", attrs=attributes)
        return xr.DataArray(values, {"wavelength": wavelengths}, ("place", "wavelength"), "brdf", attributes)

    @cached_property
    def _slopes(self) -> MapSlopes:
        return map_slopes(self._texture, _BINS_PER_WIDTH, _MOST_BINS, _PLACES)

    @cached_property
    def _normals(self) -> Array:
        return normals_of(self._texture)

    def _slopes_at(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Slopes at places [um], as a renderer interpolates the normals."""
        normal = np.zeros((x.size, 3))
        for share, row, column in self._pixels(x, y):
            normal += share[:, None] * self._normals[row, column]
        return -normal[:, 0] / normal[:, 2], -normal[:, 1] / normal[:, 2]

    def _light_at(self, x: Array, y: Array, picture: NDArray[np.intp]) -> Array:
        """Relative light of pictures at places [um]."""
        light = self._texture["relative_light"].values
        return np.asarray(sum(share * light[picture, row, column] for share, row, column in self._pixels(x, y)))

    def _pixels(self, x: Array, y: Array) -> Iterator[tuple[Array, NDArray[np.intp], NDArray[np.intp]]]:
        """Share, row and column of the pixels that a place [um] is interpolated from."""
        pixel, sizes = float(self._texture.attrs["pixel"]), self._texture.sizes
        if self._texture.attrs["interpolation"] == "nearest":
            at = [np.floor(one / pixel).astype(np.intp) for one in (y, x)]
            yield np.ones(x.size), at[0] % sizes["y"], at[1] % sizes["x"]
            return
        # Values are at the middles of pixels.
        column, row = x / pixel - 0.5, y / pixel - 0.5
        left, low = np.floor(column).astype(np.intp), np.floor(row).astype(np.intp)
        for up, share_y in ((0, 1 - (row - low)), (1, row - low)):
            for on, share_x in ((0, 1 - (column - left)), (1, column - left)):
                yield share_y * share_x, (low + up) % sizes["y"], (left + on) % sizes["x"]
