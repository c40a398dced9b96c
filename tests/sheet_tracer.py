"""Photons between the faces of a sheet: a path tracer that shares nothing with the package but the model of a face."""

from __future__ import annotations

import numpy as np
from scipy.special import beta, erf

from brdfpipe.bsdf.registry import representation
from brdfpipe.hemisphere import panel_rule


class Tracer:
    """Photons with an electric field between two Beckmann faces: facets drawn from their density, weighted by how much of them is seen.

    What the facets lose leaves diffusely on both sides, in proportion to what they lose there and to the étendue. The field is a
    complex vector, so no frame of polarisation is needed but that of each facet.
    """

    def __init__(self, front: float, back: float, index: float, inside: float, seed: int) -> None:
        self.a, self.index, self.inside = (front, back), index, inside
        self.generator = np.random.default_rng(seed)
        by_width = {width: self._lost(width) for width in set(self.a)}
        self.diffuse = [by_width[width] for width in self.a]

    def _lost(self, a):
        """Polar angles, their losses of s and p, the cells between them, and the cumulated share of the cells."""
        if a == 0:
            return None
        edges = np.concatenate([np.linspace(0, 90, 91), np.linspace(90, 180, 121)[1:]])
        middle = (edges[1:] + edges[:-1]) / 2
        lost = np.maximum(1 - np.array([self._kept(a, theta) for theta in middle]).T, 0)
        extent = np.abs(np.diff(np.cos(np.radians(edges)) ** 2)) * np.where(middle > 90, self.index**2, 1.0)
        cumulated = np.cumsum(extent * lost.sum(axis=0))
        return middle, lost, edges, cumulated / cumulated[-1]

    def _kept(self, a, theta, rings=150, turns=48):
        """Shares of s and p light from a polar angle that are scattered once, by facets of equal shares of the slopes on one side."""
        slope = a * np.sqrt(-np.log1p(-(np.arange(rings) + 0.5) / rings))
        turn = np.pi * (np.arange(turns) + 0.5) / turns
        p, q = (np.multiply.outer(slope, wave(turn)).ravel() for wave in (np.cos, np.sin))
        normal = np.column_stack([-p, -q, np.ones(p.size)]) / np.sqrt(1 + p * p + q * q)[:, None]
        travel = np.tile([-np.sin(np.radians(theta)), 0.0, -np.cos(np.radians(theta))], (p.size, 1))
        from_air = np.full(p.size, theta < 90)
        s_axis = np.cross(travel, [0.0, 0.0, 1.0])
        shares = []
        for field in (s_axis, np.cross(travel, s_axis)):
            field = field / np.linalg.norm(field, axis=1, keepdims=True)
            branches = self._scatter(travel, field.astype(complex), from_air, normal)
            shares.append(
                sum(
                    (power * self._seen(a, travel, out, normal, from_air, air)).mean()
                    for out, _, power, air in branches
                )
            )
        return shares

    @staticmethod
    def _hidden(a, cos):
        nu = np.abs(cos) / np.sqrt(np.maximum(1 - cos**2, 1e-300)) / a
        return np.where(nu > 6, 0.0, (erf(nu) - 1 + np.exp(-(nu**2)) / (nu * np.sqrt(np.pi))) / 2)

    def _seen(self, a, travel, out, normal, from_air, air):
        """Share of a facet that light meets on its way, and leaves unhidden, over its projected area."""
        facing = (travel * normal).sum(axis=1) / normal[:, 2] / travel[:, 2]
        hidden_i, hidden_o = self._hidden(a, travel[:, 2]), self._hidden(a, out[:, 2])
        seen = np.where(air == from_air, 1 / (1 + hidden_i + hidden_o), beta(1 + hidden_i, 1 + hidden_o))
        return np.where((out[:, 2] > 0) == air, np.maximum(facing, 0) * seen, 0.0)

    def meet(self, face, travel, field, weight, from_air):
        """New directions, fields and weights of light that meets a face, z pointing out of the body there; and who is now in air."""
        if self.a[face] == 0:
            return self._facet(face, travel, field, weight, from_air, np.broadcast_to([0.0, 0.0, 1.0], travel.shape))
        share = 0.15
        diffuse = self.generator.random(weight.size) < share
        slope = self.generator.normal(0, self.a[face] / np.sqrt(2), (weight.size, 2))
        normal = np.column_stack([-slope, np.ones(weight.size)])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        by_facet = self._facet(face, travel, field, weight / (1 - share), from_air, normal)
        spread = self._spread(face, travel, field, weight / share)
        return [np.where(diffuse.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in zip(spread, by_facet, strict=True)]

    def _spread(self, face, travel, field, weight):
        """The light that a face loses, from everywhere on both sides, with the polarisation of what it loses there."""
        middle, lost, edges, cumulated = self.diffuse[face]
        theta = np.degrees(np.arccos(np.clip(-travel[:, 2], -1, 1)))
        in_s = (np.abs((field * self._s_axis(travel)).sum(axis=1))) ** 2
        carried = in_s * np.interp(theta, middle, lost[0]) + (1 - in_s) * np.interp(theta, middle, lost[1])
        cell = np.searchsorted(cumulated, self.generator.random(weight.size))
        low, high = np.cos(np.radians(edges[cell])) ** 2, np.cos(np.radians(edges[cell + 1])) ** 2
        cos = np.sqrt(low + self.generator.random(weight.size) * (high - low)) * np.where(middle[cell] > 90, -1, 1)
        phi, sin = 2 * np.pi * self.generator.random(weight.size), np.sqrt(1 - cos**2)
        out = np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=1)
        s_axis = self._s_axis(out)
        is_s = self.generator.random(weight.size) * lost[:, cell].sum(axis=0) < lost[0, cell]
        turned = np.where(is_s[:, None], s_axis, np.cross(out, s_axis))
        return out, turned.astype(complex), weight * carried, cos > 0

    @staticmethod
    def _s_axis(travel, normal=(0.0, 0.0, 1.0)):
        axis = np.cross(travel, normal)
        return axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-300)

    def _facet(self, face, travel, field, weight, from_air, normal):
        """Reflected or refracted at a facet, drawn by the power of its field."""
        branches = self._scatter(travel, field, from_air, normal)
        choice = self.generator.random(weight.size) < branches[0][2]
        out, field, _, air = (
            np.where(choice.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in zip(*branches, strict=True)
        )
        if self.a[face]:
            weight = weight * self._seen(self.a[face], travel, out, normal, from_air, air)
        return out, field, weight, air

    def _scatter(self, travel, field, from_air, normal):
        """Direction, unit field, power and side of the light that a facet reflects, and of the light that it refracts."""
        towards = normal * np.where(from_air, 1.0, -1.0)[:, None]
        cos = np.clip(-(travel * towards).sum(axis=1), 0.0, 1.0)
        ratio = np.where(from_air, 1 / self.index, self.index)
        inner = np.emath.sqrt(1 - ratio**2 * (1 - cos**2) + 0j)
        s_axis = np.cross(travel, towards)
        length = np.linalg.norm(s_axis, axis=1, keepdims=True)
        s_axis = np.where(length > 1e-9, s_axis / np.maximum(length, 1e-300), self._s_axis(travel, [0.3, 0.9, 0.3]))
        mirrored = travel + 2 * cos[:, None] * towards
        refracted = ratio[:, None] * travel + (ratio * cos - inner.real)[:, None] * towards
        in_s, in_p = ((field * axis).sum(axis=1) for axis in (s_axis, np.cross(travel, s_axis)))
        with np.errstate(invalid="ignore"):
            r_s = np.nan_to_num((ratio * cos - inner) / (ratio * cos + inner), nan=-1.0)
            r_p = np.nan_to_num((cos - ratio * inner) / (cos + ratio * inner), nan=-1.0)
        t_s, t_p = (np.sqrt(np.maximum(1 - np.abs(r) ** 2, 0.0)) for r in (r_s, r_p))
        branches = []
        for out, s, p, air in (
            (mirrored, r_s * in_s, r_p * in_p, from_air),
            (refracted, t_s * in_s, t_p * in_p, ~from_air),
        ):
            power = np.abs(s) ** 2 + np.abs(p) ** 2
            turned = s[:, None] * s_axis + p[:, None] * np.cross(out, s_axis)
            branches.append((out, turned / np.sqrt(np.maximum(power, 1e-300))[:, None], power, air))
        return branches

    def trace(self, theta_i, photons):
        """Direction and weight of every photon that came out, z towards the front; and which it was. Natural light falls in."""
        flip, theta = np.array([1.0, 1.0, -1.0]), np.radians(theta_i)
        travel = np.tile([-np.sin(theta), 0.0, -np.cos(theta)], (photons, 1))
        turn = self.generator.uniform(0, np.pi, (photons, 1))
        s_axis = np.tile([0.0, 1.0, 0.0], (photons, 1))
        field = (np.cos(turn) * s_axis + np.sin(turn) * np.cross(travel, s_axis)).astype(complex)
        weight, who = np.ones(photons), np.arange(photons)
        from_air = np.ones(photons, dtype=bool)
        face, escaped = (0 if theta_i < 90 else 1), []
        for _ in range(400):
            turn = flip if face else np.ones(3)
            travel, field, weight, air = self.meet(face, travel * turn, field * turn, weight, from_air)
            travel, field = travel * turn, field * turn
            escaped.append((travel[air], weight[air], who[air]))
            survive = ~air & (weight > 0)
            travel, field, weight, who = travel[survive], field[survive], weight[survive], who[survive]
            weight = weight * self.inside ** (1 / np.abs(travel[:, 2]))
            lives = self.generator.random(weight.size) < np.minimum(weight / 0.1, 1)
            travel, field, weight, who = travel[lives], field[lives], np.maximum(weight, 0.1)[lives], who[lives]
            if not weight.size:
                break
            from_air, face = np.zeros(weight.size, dtype=bool), 1 - face
        return [np.concatenate(parts) for parts in zip(*escaped, strict=True)]


class CoatTracer(Tracer):
    """A coat on an opaque body: below the face of the base light is scattered by Lambert's law, loses its polarisation, and comes back or not."""

    def __init__(self, coat, base, coat_index, index, inside, reflectance, seed):
        super().__init__(coat, 0.0, coat_index, inside, seed)
        self.below, self.reflectance = Tracer(base, 0.0, index / coat_index, 1.0, seed + 1), reflectance

    def trace(self, theta_i, photons):
        """Direction and weight of every photon that came out, and which it was. Natural light falls in from above."""
        theta = np.radians(theta_i)
        travel = np.tile([-np.sin(theta), 0.0, -np.cos(theta)], (photons, 1))
        turn = self.generator.uniform(0, np.pi, (photons, 1))
        s_axis = np.tile([0.0, 1.0, 0.0], (photons, 1))
        field = (np.cos(turn) * s_axis + np.sin(turn) * np.cross(travel, s_axis)).astype(complex)
        weight, who = np.ones(photons), np.arange(photons)
        from_air, escaped = np.ones(photons, dtype=bool), []
        for _ in range(400):
            travel, field, weight, air = self.meet(0, travel, field, weight, from_air)
            escaped.append((travel[air], weight[air], who[air]))
            state = self._where(~air & (weight > 0), travel, field, weight, who)
            travel, field, weight, who = self._from_base(*self._roulette(*self._crossed(*state)))
            travel, field, weight, who = self._roulette(*self._crossed(travel, field, weight, who))
            if not weight.size:
                break
            from_air = np.zeros(weight.size, dtype=bool)
        return [np.concatenate(parts) for parts in zip(*escaped, strict=True)]

    def _from_base(self, travel, field, weight, who):
        """The light that comes up from the base, also what has been in the body."""
        risen, into_body = [(travel[:0], field[:0], weight[:0], who[:0])], np.ones(weight.size, dtype=bool)
        while weight.size:
            travel, field, weight, above = self.below.meet(0, travel, field, weight, into_body)
            risen.append((travel[above], field[above], weight[above], who[above]))
            travel, field, weight, who = self._where(~above & (weight > 0), travel, field, weight, who)
            weight = weight * self.reflectance
            # Lambert's law: the square of the sine is evenly distributed.
            sine = np.sqrt(self.generator.random(weight.size))
            phi = self.generator.uniform(0, 2 * np.pi, weight.size)
            travel = np.stack([sine * np.cos(phi), sine * np.sin(phi), np.sqrt(1 - sine**2)], axis=1)
            turn, s_axis = self.generator.uniform(0, np.pi, (weight.size, 1)), self._s_axis(travel)
            field = (np.cos(turn) * s_axis + np.sin(turn) * np.cross(travel, s_axis)).astype(complex)
            travel, field, weight, who = self._roulette(travel, field, weight, who)
            into_body = np.zeros(weight.size, dtype=bool)
        return [np.concatenate(parts) for parts in zip(*risen, strict=True)]

    @staticmethod
    def _where(where, *parts):
        return [part[where] for part in parts]

    def _crossed(self, travel, field, weight, who):
        return travel, field, weight * self.inside ** (1 / np.abs(travel[:, 2])), who

    def _roulette(self, travel, field, weight, who):
        lives = self.generator.random(weight.size) < np.minimum(weight / 0.1, 1)
        travel, field, weight, who = self._where(lives, travel, field, weight, who)
        return travel, field, np.maximum(weight, 0.1), who


SECTORS = [(low, high, ahead) for low, high in ((0, 20), (20, 45), (45, 70), (70, 90)) for ahead in (True, False)]
"""Polar angles, and whether azimuths are those towards the mirror direction."""


class Traced:
    """The photons that came out, in sectors of directions."""

    def __init__(self, travel, weight, who, photons):
        self.weight, self.who, self.photons = weight, who, photons
        self.theta = np.degrees(np.arccos(np.clip(travel[:, 2], -1, 1)))
        self.ahead = travel[:, 0] < 0

    def share(self, where):
        """Share of the light in some directions, and its standard error."""
        by_photon = np.bincount(self.who, np.where(where, self.weight, 0.0), self.photons)
        return by_photon.mean(), by_photon.std() / np.sqrt(self.photons)

    def beside(self, bsdf, theta_i):
        """Sector, light of a BSDF in it, light of the photons, and the standard error of that."""
        model = representation(bsdf)
        mirrored = model.specular(np.array([theta_i]), np.zeros(1), None)[0][0, 0]
        for low, high, ahead in SECTORS:
            theta, d_theta = panel_rule(np.linspace(low, high, 13), 6)
            phi, d_phi = panel_rule(np.linspace(90, 180, 13) if ahead else np.linspace(0, 90, 7), 6)
            values = model.evaluate(theta_i, 0.0, theta[:, None], phi, None)[..., 0]
            scattered = 2 * float(
                (np.radians(d_theta) * np.sin(2 * np.radians(theta)) / 2) @ values @ np.radians(d_phi)
            )
            predicted = scattered + (mirrored if ahead and low <= theta_i < high else 0.0)
            yield (
                (low, high, ahead),
                predicted,
                *self.share((self.theta >= low) & (self.theta < high) & (self.ahead == ahead)),
            )
