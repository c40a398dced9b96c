"""Random outgoing directions in proportion to a BSDF, for Monte Carlo programs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf import sphere_cubature
from brdfpipe.geometry import Array

_VARIANCE = 0.02
"""Limit of the relative excess of the weights' rms over their mean, which is half their relative variance."""

DEFENSIVE = 0.05
"""Share of the samples that is uniform over the sphere, so that the weights are bounded."""


class Samples(NamedTuple):
    """Directions drawn from a :class:`Distribution`, (n,) each."""

    theta: Array
    """θ_o [degree]"""
    phi: Array
    """φ_o [degree]"""
    pdf: Array
    """Density [sr-1]; NaN for specular rays"""
    ray: NDArray[np.int64]
    """Index of the specular direction: 0 for reflection, 1 for transmission, -1 for scattered light"""

    @property
    def is_specular(self) -> NDArray[np.bool_]:
        return self.ray >= 0


@dataclass(frozen=True)
class Distribution:
    """Outgoing directions of one incidence: a constant density in each cell, and two specular directions of finite probability."""

    theta: Array
    """Polar edges of the first cells [degree]"""
    phi: Array
    """Azimuthal edges of the first cells [degree]"""
    mesh: sphere_cubature.Mesh
    leaves: sphere_cubature.Indices
    probability: Array
    """(leaves,) of a cell, if the sample is not specular"""
    density: Array
    """(leaves,) probability per solid angle, of all samples [sr-1]"""
    specular_probability: Array
    """(2,) of specular reflection and transmission"""
    specular_direction: Array
    """(2, 2) their θ and φ [degree]"""
    specular_share: Array
    """(2, wavelength) their reflectance and transmittance"""

    @classmethod
    def of(
        cls, edges: tuple[Array, Array], rule: sphere_cubature.Rule, specular_share: Array, specular_direction: Array
    ) -> Distribution:
        """Refine cells with the rule :func:`brdfpipe.bsdf.sphere_cubature.constant` until the variance of the weights is small.

        ``edges`` are the polar and azimuthal edges of the first cells [degree].
        """
        theta, phi = edges
        low, high = sphere_cubature.rectangles(theta, phi)
        mesh = sphere_cubature.refine((np.zeros(low.shape[0], dtype=np.intp), low, high), rule, _VARIANCE)
        leaves = mesh.leaves
        size = sphere_cubature.solid_angle(mesh.low[leaves], mesh.high[leaves])
        value = mesh.value[leaves, 0]
        scattered = value.sum()
        probability = uniform = size / size.sum()
        if scattered > 0:
            probability = (1 - DEFENSIVE) * value / scattered + DEFENSIVE * uniform
        expected = specular_share.mean(axis=1)
        total = scattered + expected.sum()
        specular = expected / total if total > 0 else np.zeros(2)
        density = probability / size * (1 - specular.sum())
        return cls(theta, phi, mesh, leaves, probability, density, specular, specular_direction, specular_share)

    def pdf(self, theta_o: Array, phi_o: Array) -> Array:
        """Density without the specular samples [sr-1], of the shape of the directions."""
        theta, phi = np.broadcast_arrays(np.asarray(theta_o, dtype=float), np.asarray(phi_o, dtype=float))
        turned = (phi.ravel() - self.phi[0]) % 360 + self.phi[0]
        row = np.searchsorted(self.theta, theta.ravel(), side="right") - 1
        column = np.searchsorted(self.phi, turned, side="right") - 1
        rows, columns = self.theta.size - 1, self.phi.size - 1
        covered = (row >= 0) & (row <= rows) & (theta.ravel() <= self.theta[-1])
        root = np.clip(row, 0, rows - 1) * columns + np.clip(column, 0, columns - 1)
        by_cell = np.zeros(self.mesh.owner.size)
        by_cell[self.leaves] = self.density
        density = by_cell[self.mesh.leaf_of(root, theta.ravel(), turned)]
        return np.where(covered, density, 0.0).reshape(theta.shape)

    def draw(self, n: int, generator: np.random.Generator) -> Samples:
        """Draw n directions."""
        choice, polar, azimuth = generator.random((3, n))
        reflected, transmitted = self.specular_probability
        ray = np.where(choice < reflected, 0, np.where(choice < reflected + transmitted, 1, -1))
        rest = np.clip((choice - reflected - transmitted) / max(1 - reflected - transmitted, 1e-300), 0.0, 1.0)
        running = np.cumsum(self.probability)
        leaf = np.minimum(np.searchsorted(running, rest * running[-1], side="right"), running.size - 1)
        low, high = np.radians(self.mesh.low[self.leaves[leaf]]), np.radians(self.mesh.high[self.leaves[leaf]])
        # Uniform in solid angle is uniform in sin²(θ/2), which is accurate at the pole, unlike cos θ.
        first, last = np.sin(low[:, 0] / 2) ** 2, np.sin(high[:, 0] / 2) ** 2
        theta = 2 * np.degrees(np.arcsin(np.sqrt(np.clip(first + polar * (last - first), 0.0, 1.0))))
        phi = np.degrees(low[:, 1] + azimuth * (high[:, 1] - low[:, 1])) % 360
        pdf = np.where(ray < 0, self.density[leaf], np.nan)
        for k in (0, 1):
            theta, phi = np.where(ray == k, self.specular_direction[k, :, None], np.stack([theta, phi]))
        return Samples(theta, phi, pdf, ray)


def as_dataset(samples: Samples, weight: Array, incidence: tuple[float, float], wavelength: Array | None) -> xr.Dataset:
    """Dataset of kind ``samples`` for one incidence (θ_i, φ_i) [degree].

    ``weight`` is (n, wavelength or 1), f |cos θ_o| / pdf, for a specular ray its reflectance or transmittance over its probability.
    """
    n = samples.theta.size
    spectral = () if wavelength is None else ("wavelength",)
    weight = weight if spectral else weight[:, 0]
    specular = {"units": "1", "long_name": "whether the sample is a specular ray"}
    result = xr.Dataset(
        {
            "theta_o": ("sample", samples.theta),
            "phi_o": ("sample", samples.phi),
            "pdf": ("sample", samples.pdf),
            "weight": (("sample", *spectral), weight),
            "weight_variance": (spectral, weight.var(axis=0, ddof=min(1, n - 1))),
            "specular": ("sample", samples.is_specular, specular),
            "theta_i": float(incidence[0]),
            "phi_i": float(incidence[1]),
        }
    )
    return vocabulary.label(result if wavelength is None else result.assign_coords(wavelength=wavelength), "samples")
