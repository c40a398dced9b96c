"""The Mueller matrix of a microfacet BRDF.

Frames. Light travels along k, which is −w_i before and w_o after the reflection. Its s axis is perpendicular to the plane of
k and the surface normal z, and its p axis lies in it: s = k × z / |k × z|, p = k × s, so that (s, p, k) is right-handed. Hence
s_i = (−sin φ_i, cos φ_i, 0) and s_o = (sin φ_o, −cos φ_o, 0), the same vector for a mirror reflection. These formulas are also
used at θ = 0, where the plane is not defined: the frame follows the given azimuth.

Stokes vectors. With fields E e^{−iωt} (so that N = n + ik absorbs) S0 = |E_s|² + |E_p|², S1 = |E_s|² − |E_p|²,
S2 = 2 Re(E_s* E_p), S3 = 2 Im(E_s* E_p): S2 > 0 is light polarised along s + p, and S3 > 0 is light whose field turns from s to p,
counter-clockwise for an observer who looks into the light ("left" in optics, positive helicity).

References
----------
Born & Wolf, Principles of Optics, 7th ed., §1.4 and §1.5.2; Priest & Germer 2000 (Proc. MSS Specialty Group on Camouflage),
polarimetric microfacet BRDF.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from brdfpipe.geometry import Array, frame_rotation, half_vector
from brdfpipe.optics.fresnel_equations import fresnel as fresnel_reflectance

_PERFECT_MIRROR = 1e70
"""Index beyond which a body is a perfect mirror in double precision, and N⁴ might overflow."""


def mueller(
    shape_factor: ArrayLike,
    theta_i: ArrayLike,
    phi_i: ArrayLike,
    theta_o: ArrayLike,
    phi_o: ArrayLike,
    n: ArrayLike,
    k: ArrayLike = 0.0,
    diffuse: ArrayLike = 0.0,
) -> Array:
    """Mueller matrix BRDF of a microfacet surface over a depolarising base.

    Parameters
    ----------
    shape_factor : (…) D G / (4 cos θ_i cos θ_o) [sr⁻¹], the BRDF of perfect mirrors
    theta_i, phi_i, theta_o, phi_o : (…) degree, broadcastable; 0 <= θ <= 90
    n, k : (wavelength,) or scalars; refractive index n + ik of the body relative to the outer medium
    diffuse : (…, wavelength) BRDF of the diffuse part [sr⁻¹]

    Returns
    -------
    (…, wavelength, 4, 4) [sr⁻¹], M = D G / (4 cos θ_i cos θ_o) R(−ψ_o) M_F R(ψ_i) + diag(f_d, 0, 0, 0), with M_F from
    :func:`facet_mueller` and ψ from :func:`frame_rotation`; M[0, 0] is the BRDF for unpolarised light

    Raises
    ------
    BrdfpipeError : n <= 0, k < 0, or undefined values.
    """
    n, k = np.atleast_1d(n), np.atleast_1d(k)
    cos_zeta = half_vector(theta_i, phi_i, theta_o, phi_o).cos_zeta
    psi_i, psi_o = frame_rotation(theta_i, phi_i, theta_o, phi_o)
    facet = facet_mueller(cos_zeta[..., None], n, k)
    turned = rotation(-psi_o)[..., None, :, :] @ facet @ rotation(psi_i)[..., None, :, :]
    specular = np.asarray(shape_factor, dtype=float)[..., None, None, None] * turned
    diffuse = np.asarray(diffuse, dtype=float)
    shape = np.broadcast_shapes(specular.shape[:-2], diffuse.shape)
    matrix = np.broadcast_to(specular, (*shape, 4, 4)).copy()
    matrix[..., 0, 0] += diffuse
    return matrix


def facet_mueller(cos_zeta: ArrayLike, n: ArrayLike, k: ArrayLike = 0.0) -> Array:
    """Mueller matrix (…, 4, 4) [1] of the Fresnel reflection by one facet, in the facet's own s–p frame.

    Parameters
    ----------
    cos_zeta : cosine of the angle of incidence on the facet, in [0, 1]
    n, k : refractive index n + ik relative to the outer medium, broadcastable; total reflection for n < 1, a mirror for n = inf

    Notes
    -----
    With F = |r|² and Z = r_s* r_p the upper block is ½(F_s ± F_p) and the lower block Re Z, ∓Im Z, which converts circular to linear
    polarisation at metals and at total reflection. M[0, 0] is exactly the reflectance of :func:`brdfpipe.optics.fresnel`, which also
    refuses invalid input.
    """
    fresnel = fresnel_reflectance(cos_zeta, n, k)
    z = phased_product(cos_zeta, n, k)
    matrix = np.zeros((*np.broadcast_shapes(fresnel.mean.shape, z.shape), 4, 4))
    matrix[..., 0, 0] = matrix[..., 1, 1] = fresnel.mean
    matrix[..., 0, 1] = matrix[..., 1, 0] = (fresnel.s - fresnel.p) / 2
    matrix[..., 2, 2] = matrix[..., 3, 3] = z.real
    matrix[..., 2, 3], matrix[..., 3, 2] = -z.imag, z.imag
    return matrix


def phased_product(cos_zeta: ArrayLike, n: ArrayLike, k: ArrayLike) -> NDArray[np.complex128]:
    """r_s* r_p of a smooth interface, in a form without cancellation as N → 1."""
    c = np.clip(np.asarray(cos_zeta, dtype=float), 0.0, 1.0)
    n, k = np.asarray(n, dtype=float), np.asarray(k, dtype=float)
    mirror, absent = n > _PERFECT_MIRROR, (n == 1) & (k == 0)
    index = np.where(mirror | absent, 2.0, n) + 1j * k
    contrast = (index - 1) * (index + 1)
    q = np.sqrt(contrast + c * c)
    # The evanescent wave decays: take the root with Im q >= 0, independent of the sign of zero.
    q = q.real + 1j * np.abs(q.imag)
    into_p = index * index * c + q
    r_s = -contrast / (c + q) ** 2
    r_p = (contrast / into_p) * (((index * index + 1) * (c * c) - 1) / into_p)
    return np.where(absent, 0.0, np.where(mirror, -1.0, np.conj(r_s) * r_p))


def rotation(psi: ArrayLike) -> Array:
    """Mueller matrices (…, 4, 4) of a rotation of the axes by ψ [radian] from s towards p."""
    cos, sin = np.cos(2 * np.asarray(psi, dtype=float)), np.sin(2 * np.asarray(psi, dtype=float))
    matrix = np.zeros((*cos.shape, 4, 4))
    matrix[..., 0, 0] = matrix[..., 3, 3] = 1
    matrix[..., 1, 1] = matrix[..., 2, 2] = cos
    matrix[..., 1, 2], matrix[..., 2, 1] = sin, -sin
    return matrix


def stokes_out(mueller: ArrayLike, stokes_in: ArrayLike) -> Array:
    """Stokes vectors (…, 4) of the outgoing light: Mueller matrices (…, 4, 4) times Stokes vectors (…, 4)."""
    return np.einsum("...ab,...b->...a", np.asarray(mueller, dtype=float), np.asarray(stokes_in, dtype=float))


def degree_of_polarisation(stokes: ArrayLike) -> Array:
    """√(S1² + S2² + S3²) / S0 of Stokes vectors (…, 4) [1]; 0 without light."""
    s = np.asarray(stokes, dtype=float)
    part = np.linalg.norm(s[..., 1:], axis=-1)
    return np.divide(part, s[..., 0], out=np.zeros_like(part), where=s[..., 0] > 0)
