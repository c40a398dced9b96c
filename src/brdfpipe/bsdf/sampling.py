"""Outgoing directions drawn as a BSDF sends its light, for Monte Carlo programs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf import cells, representations
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array

_VARIANCE = 0.02
"""Relative excess of the weights' rms over their mean that the cells are refined to, and half their relative variance."""

DEFENSIVE = 0.05
"""Share of the samples that is spread evenly, so that no light is out of reach of the cells' own distribution."""


@dataclass(frozen=True)
class Distribution:
    """Where light from one direction goes: a constant density a cell, and two directions apart that carry a finite share."""

    theta: Array
    """Polar edges of the first cells [degree]"""
    phi: Array
    """Azimuthal edges of the first cells [degree]"""
    mesh: cells.Mesh
    leaves: cells.Indices
    probability: Array
    """(leaves,) of drawing a cell, given that the sample is none of the specular ones"""
    density: Array
    """(leaves,) probability per solid angle of all samples [sr-1]"""
    specular_probability: Array
    """(2,) of the mirror direction and of the straight or refracted one"""
    specular_direction: Array
    """(2, 2) θ and φ of these [degree]"""
    specular_share: Array
    """(2, wavelength) reflectance and transmittance that they carry"""

    def pdf(self, theta_o: Array, phi_o: Array) -> Array:
        """Density of the samples that are not specular [sr-1], of the shape of the directions."""
        theta, phi = np.broadcast_arrays(np.asarray(theta_o, dtype=float), np.asarray(phi_o, dtype=float))
        turned = (phi.ravel() - self.phi[0]) % 360 + self.phi[0]
        row = np.searchsorted(self.theta, theta.ravel(), side="right") - 1
        column = np.searchsorted(self.phi, turned, side="right") - 1
        rows, columns = self.theta.size - 1, self.phi.size - 1
        covered = (row >= 0) & (row <= rows) & (theta.ravel() <= self.theta[-1])
        root = np.clip(row, 0, rows - 1) * columns + np.clip(column, 0, columns - 1)
        of_leaf = np.zeros(self.mesh.owner.size)
        of_leaf[self.leaves] = self.density
        found = of_leaf[self.mesh.leaf_of(root, theta.ravel(), turned)]
        return np.where(covered, found, 0.0).reshape(theta.shape)

    def draw(self, n: int, generator: np.random.Generator) -> tuple[Array, Array, Array, Array]:
        """θ_o and φ_o [degree], pdf [sr-1] and which specular direction it is (-1 for none), (n,) each."""
        choice, polar, azimuth = generator.random((3, n))
        reflected, passed = self.specular_probability
        which = np.where(choice < reflected, 0, np.where(choice < reflected + passed, 1, -1))
        rest = np.clip((choice - reflected - passed) / max(1 - reflected - passed, 1e-300), 0.0, 1.0)
        running = np.cumsum(self.probability)
        leaf = np.minimum(np.searchsorted(running, rest * running[-1], side="right"), running.size - 1)
        low, high = np.radians(self.mesh.low[self.leaves[leaf]]), np.radians(self.mesh.high[self.leaves[leaf]])
        # Even in solid angle is even in sin²(θ/2), which keeps its digits at the pole where cos θ loses them.
        first, last = np.sin(low[:, 0] / 2) ** 2, np.sin(high[:, 0] / 2) ** 2
        theta = 2 * np.degrees(np.arcsin(np.sqrt(np.clip(first + polar * (last - first), 0.0, 1.0))))
        phi = np.degrees(low[:, 1] + azimuth * (high[:, 1] - low[:, 1])) % 360
        pdf = np.where(which < 0, self.density[leaf], np.nan)
        for k in (0, 1):
            theta, phi = np.where(which == k, self.specular_direction[k, :, None], np.stack([theta, phi]))
        return theta, phi, pdf, which


def distribution(bsdf: xr.Dataset, theta_i: float, phi_i: float, wavelength: Array | None = None) -> Distribution:
    """A density close to the mean over wavelength of f |cos θ_o|.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    theta_i, phi_i : degree
    wavelength : (wavelength,) nm; None for the dataset's own

    Notes
    -----
    Of all densities that are constant over given cells, the one in proportion to the rms of f |cos θ_o| over each has weights of the
    least variance; the cells are halved until that is small. A twentieth of the samples is spread over all cells evenly.
    """
    theta, phi = _edges(bsdf, theta_i, phi_i)
    low, high = cells.rectangles(theta, phi)
    at = np.array([theta_i]), np.array([phi_i])
    integrand = representations.integrand_of(bsdf, *at, wavelength)
    rule = cells.constant(integrand, representations.wavelengths_of(bsdf, wavelength))
    mesh = cells.refine((np.zeros(low.shape[0], dtype=np.intp), low, high), rule, _VARIANCE)
    leaves = mesh.leaves
    size, wanted = cells.solid_angle(mesh.low[leaves], mesh.high[leaves]), mesh.value[leaves, 0]
    rough = wanted.sum()
    even = size / size.sum()
    probability = (1 - DEFENSIVE) * wanted / rough + DEFENSIVE * even if rough > 0 else even
    share = np.stack([part[0] for part in representations.specular(bsdf, *at, wavelength)])
    expected = share.mean(axis=1)
    specular = expected / (rough + expected.sum()) if rough + expected.sum() > 0 else np.zeros(2)
    passed = float(representations.refracted(bsdf, np.array(theta_i), wavelength)) if expected[1] > 0 else 180 - theta_i
    return Distribution(
        theta,
        phi,
        mesh,
        leaves,
        probability,
        probability / size * (1 - specular.sum()),
        specular,
        np.array([[theta_i, (phi_i + 180) % 360], [passed, (phi_i + 180) % 360]]),
        share,
    )


def _edges(bsdf: xr.Dataset, theta_i: float, phi_i: float) -> tuple[Array, Array]:
    """Edges over the side the light comes from and, where light passes, the other one too."""
    near, phi = representations.cell_edges(bsdf, theta_i, phi_i, through=False)
    if not representations.transmits(bsdf):
        return near, phi
    far, _ = representations.cell_edges(bsdf, theta_i, phi_i, through=True)
    return np.union1d(near, far), phi


def sample(
    bsdf: xr.Dataset,
    n: int,
    seed: int,
    theta_i: float,
    phi_i: float = 0.0,
    wavelength: Array | None = None,
) -> xr.Dataset:
    """Draw outgoing directions; see :meth:`brdfpipe.bsdf.accessor.BSDFAccessor.sample`."""
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
        raise VocabularyError(f"the number of samples must be an integer >= 1; found {n!r}")
    drawn = distribution(bsdf, theta_i, phi_i, wavelength)
    theta_o, phi_o, pdf, which = drawn.draw(int(n), np.random.default_rng(seed))
    weight = _weights(bsdf, drawn, (theta_i, phi_i), (theta_o, phi_o, pdf, which), wavelength)
    spectral = ("wavelength",) if wavelength is not None or "wavelength" in bsdf.coords else ()
    if not spectral:
        weight = weight[:, 0]
    result = xr.Dataset(
        {
            "theta_o": ("sample", theta_o),
            "phi_o": ("sample", phi_o),
            "pdf": ("sample", pdf),
            "weight": (("sample", *spectral), weight),
            "weight_variance": (spectral, weight.var(axis=0, ddof=min(1, int(n) - 1))),
            "specular": ("sample", which >= 0, {"units": "1", "long_name": "whether the sample is a specular ray"}),
            "theta_i": float(theta_i),
            "phi_i": float(phi_i),
        }
    )
    if spectral:
        own = bsdf["wavelength"].values if wavelength is None else wavelength
        # Asked for in any order, as ``evaluate`` allows.
        result = result.assign_coords(wavelength=own)
    return vocabulary.label(result, "samples")


def _weights(
    bsdf: xr.Dataset,
    drawn: Distribution,
    incidence: tuple[float, float],
    samples: tuple[Array, Array, Array, Array],
    wavelength: Array | None,
) -> Array:
    """f |cos θ_o| / pdf, or reflectance over probability of a specular ray, (samples, wavelength)."""
    theta_o, phi_o, pdf, which = samples
    rough = which < 0
    module = representations.representation(bsdf)
    theta_i, phi_i = (np.full(int(rough.sum()), angle, dtype=float) for angle in incidence)
    values = module.evaluate(bsdf, theta_i, phi_i, theta_o[rough], phi_o[rough], wavelength)
    width = representations.wavelengths_of(bsdf, wavelength)
    weight = np.empty((theta_o.size, width))
    weight[rough] = values * (np.abs(np.cos(np.radians(theta_o[rough]))) / pdf[rough])[:, None]
    for k in (0, 1):
        if drawn.specular_probability[k] > 0:
            weight[which == k] = drawn.specular_share[k] / drawn.specular_probability[k]
    return weight
