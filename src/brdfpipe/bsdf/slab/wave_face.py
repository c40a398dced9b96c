"""Operators of a face whose roughness is not large against the wavelength: coherent light, a halo, and facets where these hold.

Light that meets the heights h as it goes from one direction to another changes its wave vector by q along the normal and by 2πf along
the surface. Inside a body of index n a direction of the angle θ' has r = n cos θ', outside γ = cos θ. With k = 2π/λ

    outer reflection      q = k (γ_i + γ_o)
    transmission          q = k (r − γ)
    internal reflection   q = k (r_i + r_o)

Of each, the share e^(−g), g = (σq)², is coherent, and the rest a halo, per étendue

    |A|²/λ² K(g, f)/(q/k)²,

K the transform of the heights (:mod:`brdfpipe.bsdf.wave.height_transform`). A has the polarisation of first-order perturbation: the sheet
of dipoles (n² − 1) (E_∥ + D_z ẑ/n²) h at the mean plane radiates into the direction that leaves. Towards the mirrored and the refracted
direction |A|² is Fresnel's reflectance or transmittance times (q/k)². As g → 0 this is the Rayleigh-Rice theory of reflection and
transmission, as g grows Kirchhoff's integral, whose lobe is that of facets.

References
----------
Voronovich 1994, Wave Scattering from Rough Surfaces, ch. 4 and 5 (reciprocal amplitudes of both sides, first-order small slopes);
Elson 1984, Phys. Rev. B 30, 5460, and Stover, Optical Scattering, 3rd ed., ch. 4 (dipoles of first order); Krywonos, Harvey & Choi
2011, J. Opt. Soc. Am. A 28, 1121 (K).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.microfacet.builder import build as build_microfacet
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.representations.microfacet import Microfacet
from brdfpipe.bsdf.representations.wave import Wave
from brdfpipe.bsdf.slab import face
from brdfpipe.bsdf.slab.face import ELEMENTS, LEAST_LOSS, Azimuths, Face, Nodes
from brdfpipe.bsdf.wave import two_scale
from brdfpipe.bsdf.wave.builder import Relief, halo_table
from brdfpipe.bsdf.wave.builder import build as build_wave
from brdfpipe.bsdf.wave.halo import Field, Halo
from brdfpipe.bsdf.wave.roughness import roughness
from brdfpipe.geometry import Array, HalfVector
from brdfpipe.masking.modes import HALOS

NARROWEST_HALO = (0.03, 0.06)
"""Half width at 1/e [1], in sines of the angle outside, to which the core of a transmitted, and of an internally reflected, halo is cut
off where it is narrower: the light of the core is then coherent. Its wings are kept."""

PHASES = (10.0, 60.0)
"""Phase variances between which a face of low slopes passes from waves to facets."""

MASKED_SLOPES, MASKED_PHASES = (1.0, 2.0), (1.0, 10.0)
"""The same of slopes over the mean cosine of both directions, near grazing, where these halos lack masking; and phase variances from which it acts."""

_SHARPNESS = 8
_RIPPLE = 0.02
"""Standard width in sines outside over which a measured halo is smoothed."""
_LARGEST_SPREAD = 0.7
_LEAST_CHANGE = 1e-6
_LARGEST_SHARE = 1 - 1e-9
_WIDTH_NODES = 2001


class WaveSurface(NamedTuple):
    """The heights of a face and the light that they scatter."""

    facets: Microsurface
    outside: xr.Dataset
    """``bsdf`` dataset of waves, or of facets where these hold: the light that the face reflects outside"""
    relief: Relief | None
    """Heights and slopes that decide between waves and facets; None for waves alone"""
    table: xr.Dataset
    """Transform of the heights for the light inside too"""
    halo: Halo
    """The same, to be evaluated"""

    @classmethod
    def of(cls, facets: xr.Dataset, psd: xr.Dataset, index: xr.Dataset, wavelength: Array, optics: str) -> WaveSurface:
        """A face from its ``facets`` and ``psd`` datasets, in a body of an index at wavelengths [nm]."""
        # As light that passes the face: each facet reflects once.
        predicted = None
        if optics != "wave":
            predicted = build_microfacet(facets, index=index, diffuse="none", multiple_scattering="none")
        outside = build_wave(
            psd, index=index, wavelength=wavelength, diffuse="none", facets=facets, predicted=predicted, optics=optics
        )
        # Inside, phases and frequencies are n times as large: those of a wavelength n times as short.
        inner = wavelength[:1] / float(np.max(index["n"]))
        correlation, sigma = roughness(psd)
        table = halo_table(correlation, sigma, psd, inner, lay=False).assign(sigma=sigma)
        table.attrs = {"form": HALOS[0], "spectrum": psd.attrs["form"]}
        if psd.attrs["form"] == "measured":
            table = _without_ripple(table, _lowest_frequency(psd), _RIPPLE / (float(wavelength[0]) * 1e-3))
        relief = None if optics == "wave" else Relief.of(correlation, sigma, psd, "auto", None, facets)
        return cls(Microsurface.of(facets), outside, relief, table, Halo.of(table))

    @property
    def reflection(self) -> Representation:
        """The light that the face reflects outside, to be evaluated."""
        waves = self.outside.attrs["representation"] == Wave.name
        return Wave(self.outside) if waves else Microfacet(self.outside)

    def facet_share(self, change: Array, cosine: Array, wavelength: float) -> Array:
        """Share of the light [1] for which the face is one of facets, of q/k and the mean cosine of both directions."""
        if self.relief is None:
            return np.zeros_like(change)
        phase = (2e3 * np.pi * self.relief.sigma * change / wavelength) ** 2
        slope = max(self.relief.slope, 1e-300)
        by_phase = two_scale.rising_step(phase, PHASES)
        by_slope = two_scale.rising_step(np.array(slope), two_scale.SLOPES)
        by_masking = two_scale.rising_step(slope / np.maximum(cosine, 1e-300), MASKED_SLOPES)
        by_masking = by_masking * two_scale.rising_step(phase, MASKED_PHASES)
        return np.asarray(1 - (1 - by_phase) * (1 - by_slope) * (1 - by_masking))

    def transform(self, change: Array, along: Array, wavelength: float) -> Array:
        """K/λ² over (q/k)², of q/k and of λf, of one shape."""
        change, along = (part.reshape(-1) for part in np.broadcast_arrays(np.maximum(change, _LEAST_CHANGE), along))
        none = np.zeros_like(change)
        pair = HalfVector((along / change) ** 2, none, change, none, none, none)
        return self.halo.strength_and_transform(pair, (none, none), np.array([wavelength]))[1][:, 0] / change**2

    def is_of_facets(self, index: float, wavelength: float) -> bool:
        """Whether the face is one of facets for all transmitted light up to a wavelength [nm]."""
        change = np.array([index - 1])
        return bool(self.facet_share(change, np.ones(1), wavelength)[0] > _LARGEST_SHARE)

    def coherent(self, change: Array, wavelength: float) -> Array:
        """e^(−g) of q/k."""
        return np.asarray(np.exp(-self.halo.phase_variance(change, np.array([wavelength]))[..., 0]))

    def core(self, change: float, wavelength: float, narrowest: float) -> tuple[float, float, float]:
        """Half width at 1/e of a halo in λf, the λf at which its core is cut off, and the share of the halo that is left out with it."""
        along = np.concatenate([[0.0], np.geomspace(1e-6, 1.0, _WIDTH_NODES)]) * 2
        values = self.transform(np.full_like(along, change), along, wavelength)
        # A measured spectrum has no heights longer than the scan, and its halo a dip in the middle.
        peak = int(values.argmax())
        below = np.flatnonzero(values[peak:] < values[peak] / np.e)
        width = float(along[peak + below[0]]) if below.size else 1.0
        cut = max(narrowest**_SHARPNESS - width**_SHARPNESS, 0.0) ** (1 / _SHARPNESS)
        kept = self.transform(np.full_like(along, change), _without_core(along, cut), wavelength)
        whole = float(np.trapezoid(values * along, along))
        return width, cut, float(np.clip(1 - np.trapezoid(kept * along, along) / whole, 0.0, 1.0)) if cut else 0.0


def _lowest_frequency(psd: xr.Dataset) -> float:
    """Frequency [um-1] from which on the heights of a scan have waves: that of the long waves, or the first of the band."""
    first = float(psd["frequency"][0])
    if not (long_sigma := float(psd.get("long_sigma", 0.0))) > 0:
        return first
    return min(first, float(psd["long_slope"]) / (2 * np.pi * long_sigma))


def _without_ripple(table: xr.Dataset, first: float, width: float) -> xr.Dataset:
    """The table of a measured spectrum, smoothed over a width [um-1], because nodes do not resolve the chance ripple of one scan.

    Logarithms are averaged over logarithms of the frequency, from the ``first`` frequency with heights on, and the ratio to what results is
    averaged too: this keeps a power law, and the light of a ripple where it is. What the halo as a whole then lacks is added in proportion.
    """
    frequency = table["halo_frequency"].values
    measured = frequency >= first
    if np.count_nonzero(measured) < 2:
        return table
    known = np.log(frequency[measured])
    at = np.log(np.maximum(frequency, first))
    spread = np.minimum(width / np.exp(at), _LARGEST_SPREAD)
    weight = np.exp(-(((known - at[:, None]) / spread[:, None]) ** 2) / 2) * np.gradient(known)
    weight /= weight.sum(axis=1, keepdims=True)
    values = table["log_halo"].values[:, measured]
    smooth = values @ weight.T
    smooth = smooth + np.log(np.exp(values - smooth[:, measured]) @ weight.T)
    light = [
        np.trapezoid(np.exp(values) * frequency, frequency, axis=1) for values in (table["log_halo"].values, smooth)
    ]
    return table.assign(log_halo=(table["log_halo"].dims, smooth + np.log(light[0] / light[1])[:, None]))


def _without_core(along: Array, cut: float) -> Array:
    return np.asarray((along**_SHARPNESS + cut**_SHARPNESS) ** (1 / _SHARPNESS))


def lobe_widths(surface: WaveSurface, index: float, wavelength: float) -> tuple[float, float]:
    """Half width at 1/e of the transmitted and the internally reflected halo, in sines outside, as wide as their operators hold them."""
    changes = (max(index - 1, 1e-3), 2 * index)
    widths = (
        max(surface.core(change, wavelength, narrowest)[0], narrowest)
        for change, narrowest in zip(changes, NARROWEST_HALO, strict=True)
    )
    through, within = widths
    return through, within


def rough(
    surface: WaveSurface,
    masking: str,
    index: float,
    wavelength: float,
    nodes: Nodes,
    azimuths: Azimuths,
    sharp: tuple[bool, bool],
    panels: int = face.PANELS,
) -> Face:
    """A face of one wavelength [nm], with ``index`` that of the body and the heights seen from outside.

    ``sharp`` takes the transmitted, or the internally reflected, lobe of the facets as a single direction.

    What the face reflects outside is that of its ``outside``; the rest of the light from outside enters it. Halos are scaled until their
    sums over the nodes are what Fresnel's equations leave them beside the coherent light; the facets' loss is returned diffusely.
    """
    count, root = nodes.outside.size, np.sqrt(nodes.weight)
    outside, inside = np.radians(nodes.outside), np.radians(nodes.inside)
    air, body = np.cos(outside), index * np.cos(inside)
    model, zero, at = surface.reflection, np.zeros(count), np.array([wavelength])
    reflected = np.minimum(model.albedo(nodes.outside, zero, at)[:, 0], _LARGEST_SHARE)
    mirrored_outside = np.minimum(model.specular(nodes.outside, zero, at)[0][:, 0], reflected)
    alike, facets = face.smooth(index, nodes), face.FacetShares(surface.facets, masking, index, nodes, panels)

    change = np.abs(body - air[:, None])
    share = surface.facet_share(change, (air[:, None] + body / index) / 2, wavelength)
    straight_share = share[np.arange(count), np.arange(count)]
    entering = np.maximum(1 - reflected - LEAST_LOSS, 0.0)
    kernel = transmitted_halo(surface, index, wavelength, nodes, azimuths) * (1 - share)[..., None]
    if share.any():
        entering = (1 - straight_share) * entering + straight_share * np.minimum(facets.inward, entering)
        if not sharp[0]:
            kernel += face.transmitted_by_facets(surface.facets, masking, index, nodes, azimuths) * share[..., None]
    coherent = surface.coherent(np.diagonal(change), wavelength)
    coherent = coherent + (1 - coherent) * surface.core(index - 1, wavelength, NARROWEST_HALO[0])[2]
    coherent = np.minimum((1 - straight_share) * coherent + straight_share * sharp[0], _LARGEST_SHARE)
    straight = entering * coherent * alike.straight / alike.straight[0]
    left = entering * (1 - coherent)
    zeroth = kernel[0] @ azimuths.integrals(np.zeros(1))[:, 0] * np.multiply.outer(root[:count], root)
    sums = zeroth @ root / root[:count]
    scale = left / np.maximum(sums, 1e-300)
    leaving = (scale * root[:count]) @ zeroth / root
    leaving[:count] += straight[0]
    # Light from inside that would leave more than it is.
    excess = np.minimum(_LARGEST_SHARE / np.maximum(leaving, 1e-300), 1.0)
    kernel *= (scale[:, None] * np.multiply.outer(root[:count], root) * excess)[..., None]
    leaving = np.minimum(leaving, _LARGEST_SHARE)

    change = body[:, None] + body
    share = surface.facet_share(change, (body[:, None] + body) / (2 * index), wavelength)
    mirror_share = np.diagonal(share)
    staying = np.maximum(1 - leaving - LEAST_LOSS, 0.0)
    within = mirrored_halo(surface, index, wavelength, nodes, azimuths) * (1 - share)[..., None]
    if share.any():
        staying = (1 - mirror_share) * staying + mirror_share * np.minimum(facets.mirrored, staying)
        if not sharp[1]:
            within += face.mirrored_by_facets(surface.facets, masking, index, nodes, azimuths) * share[..., None]
    coherent = surface.coherent(2 * body, wavelength)
    coherent = coherent + (1 - coherent) * surface.core(2 * index, wavelength, NARROWEST_HALO[1])[2]
    coherent = ((1 - mirror_share) * coherent + mirror_share * sharp[1]) * alike.mirrored[0]
    coherent = np.minimum(coherent, staying * _LARGEST_SHARE)
    mirrored = coherent * alike.mirrored / np.maximum(alike.mirrored[0], 1e-300)
    remaining = staying - coherent
    scale, correction = face.balance(within[0], azimuths, root, root, remaining, remaining)
    within *= scale[..., None]
    corrections = (
        float(root[:count] ** 2 @ np.abs(sums - left)) / float(root[:count] @ root[:count]),
        correction * float(root**2 @ remaining) / float(root @ root),
    )
    made = Face(
        reflected,
        straight,
        mirrored,
        kernel,
        within,
        np.zeros(count),
        np.zeros((2, root.size)),
        root,
        max(corrections),
        mirrored_outside,
    )
    return face.with_losses(made, azimuths)


class Fields(NamedTuple):
    """Fields at the mean plane of a plane wave of unit flux along the normal, from either side, (directions,)."""

    s: Field
    p: Field
    normal: Field
    """D along the normal, of light polarised p"""

    @classmethod
    def from_outside(cls, along: Array, index: float) -> Fields:
        """Of light whose wave vector along the surface is ``along`` times k."""
        air, body = np.sqrt(1 - along**2), np.sqrt(index**2 - along**2)
        root, into_p = np.sqrt(2 * air), index**2 * air + body
        return cls(root / (air + body), root * body / into_p, root * index**2 * along / into_p)

    @classmethod
    def from_inside(cls, along: Array, index: float) -> Fields:
        """The same from inside; beyond the critical angle the wave outside decays."""
        air, body = np.sqrt(1 - along**2 + 0j), np.sqrt(index**2 - along**2)
        root, into_p = np.sqrt(2 * body), index**2 * air + body
        return cls(root / (air + body), root * index * air / into_p, root * index * along / into_p)


def transmitted_halo(surface: WaveSurface, index: float, wavelength: float, nodes: Nodes, azimuths: Azimuths) -> Array:
    """I, Q and U of the transmitted halo from the nodes outside to those inside, (3, N, J, P)."""
    along_i, along_o = np.sin(np.radians(nodes.outside)), index * np.sin(np.radians(nodes.inside))
    change = np.abs(index * np.cos(np.radians(nodes.inside)) - np.cos(np.radians(nodes.outside))[:, None])
    strength = _strength(surface, index, wavelength, change, along_i, along_o, azimuths, 0)
    into = Fields(*(part[:, None, None] for part in Fields.from_outside(along_i, index)))
    out = Fields(*(part[:, None] for part in Fields.from_inside(along_o, index)))
    cos, sin = np.cos(azimuths.phi), np.sin(azimuths.phi)
    ss, pp = into.s * out.s * cos, into.p * out.p * cos + into.normal * out.normal / index**2
    s_to_p, p_to_s = into.s * out.p * sin, -into.p * out.s * sin
    return strength * _mueller(ss, s_to_p, p_to_s, pp)[[0, 1, 3]]


def mirrored_halo(surface: WaveSurface, index: float, wavelength: float, nodes: Nodes, azimuths: Azimuths) -> Array:
    """Mueller matrix of the internally reflected halo between the nodes inside, light that leaves first, (elements, J, J, P)."""
    along, body = index * np.sin(np.radians(nodes.inside)), index * np.cos(np.radians(nodes.inside))
    strength = _strength(surface, index, wavelength, body[:, None] + body, along, along, azimuths, 1)
    fields = Fields.from_inside(along, index)
    into, out = Fields(*(part[:, None] for part in fields)), Fields(*(part[:, None, None] for part in fields))
    cos, sin = np.cos(azimuths.phi), np.sin(azimuths.phi)
    ss, pp = into.s * out.s * cos, into.normal * out.normal / index**2 - into.p * out.p * cos
    s_to_p, p_to_s = into.s * out.p * sin, into.p * out.s * sin
    return strength * _mueller(ss, s_to_p, p_to_s, pp)


def _strength(
    surface: WaveSurface,
    index: float,
    wavelength: float,
    change: Array,
    along_i: Array,
    along_o: Array,
    azimuths: Azimuths,
    channel: int,
) -> Array:
    """(n² − 1)² K/λ² over (q/k)², (rows, columns, P), without the core of a narrow halo."""
    cut = surface.core((index - 1, 2 * index)[channel], wavelength, NARROWEST_HALO[channel])[1]
    along_i = along_i[:, None]
    squared = (along_i - along_o)[..., None] ** 2 + 4 * (along_i * along_o)[..., None] * np.sin(azimuths.phi / 2) ** 2
    along = _without_core(np.sqrt(squared), cut)
    values = surface.transform(change[..., None], along, wavelength).reshape(along.shape)
    return np.asarray((index**2 - 1) ** 2 * values)


def _mueller(ss: Field, s_to_p: Field, p_to_s: Field, pp: Field) -> Array:
    """Elements of the Mueller matrix of amplitudes."""
    a, b, c, d = (np.abs(part) ** 2 / 2 for part in (ss, p_to_s, s_to_p, pp))
    from_s, from_p = ss.conj() * s_to_p, p_to_s.conj() * pp
    direct, crossed = ss.conj() * pp, p_to_s.conj() * s_to_p
    elements = {
        "II": a + b + c + d,
        "QI": a + b - c - d,
        "QQ": a - b - c + d,
        "UI": (from_s + from_p).real,
        "UQ": (from_s - from_p).real,
        "UU": (direct + crossed).real,
        "VQ": (from_s - from_p).imag,
        "VU": (direct + crossed).imag,
        "VV": (direct - crossed).real,
    }
    return np.stack([elements[name] for name in ELEMENTS])
