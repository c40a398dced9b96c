"""What more nodes of the integrals of gloss and albedo cost in time, and give in accuracy."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from unittest.mock import patch

import numpy as np
from choice_table import Choice, Metric, Option, largest, timed
from resolution_choices import GLOSS_ANGLES, facet_bsdf

from brdfpipe.appearance import apertures
from brdfpipe.appearance.apertures import FINE, QUICK, Rule
from brdfpipe.appearance.gloss_meter import RECEPTOR, gloss_at
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.registry import representation
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import around_mirror

_DENSE = Rule((12, 16), 12)


def quadrature_of_gloss() -> Choice:
    """Nodes of the integral over source and receptor."""
    rules = {
        "a point source, 3": ("the size of the source", Rule((1, 1), 3)),
        "2 × 3, 2": ("", Rule((2, 3), 2)),
        "3 × 4, 3": ("", Rule((3, 4), 3)),
        "3 × 4, 4 (quick)": ("", QUICK),
        "4 × 6, 5 (used)": ("", FINE),
        "8 × 12, 8": ("", Rule((8, 12), 8)),
    }
    slopes = (0.003, 0.03, 0.3)
    found: dict[str, list[float]] = {name: [] for name in rules}
    seconds: dict[str, float] = dict.fromkeys(rules, 0.0)
    nodes: dict[str, int] = dict.fromkeys(rules, 0)
    for slope in slopes:
        sample = apertures.sample_of(facet_bsdf(slope), None)

        def units(rule: Rule, sample: apertures.Sample = sample) -> Array:
            return np.array([gloss_at(sample, angle, np.zeros(1), rule)[0] for angle in GLOSS_ANGLES])

        dense = units(_DENSE)
        for name, (_, rule) in rules.items():
            value, took = timed(lambda rule=rule, units=units: units(rule), 20)
            found[name].append(largest(value - dense))
            seconds[name] += took
            nodes[name] += sum(_window_nodes(sample, angle, rule) for angle in GLOSS_ANGLES)
    options = [
        Option(
            f"{name}: {nodes[name] / len(slopes):.0f} nodes",
            text,
            {f"slope {slope:g}": error for slope, error in zip(slopes, found[name], strict=True)},
            {"three angles": seconds[name] / len(slopes)},
        )
        for name, (text, _) in rules.items()
    ]
    return Choice(
        "Quadrature of gloss",
        f"Points of the source in and across the plane of incidence, and in each panel of the receptor along each side; nodes of 20, 60 and 85° together, whose "
        f"panels are graded on the scale of the lobe. Against {_DENSE.source[0]} × {_DENSE.source[1]}, {_DENSE.window}; the largest error at 20, 60 and 85°, GU.",
        {name: Metric("GU", 1e-5) for name in options[0].errors},
        next(option.name for option in options if "(used)" in option.name),
        options,
    )


def _window_nodes(sample: apertures.Sample, angle: float, rule: Rule) -> int:
    light = apertures.source(angle, rule)
    window = apertures.centred(*RECEPTOR[angle])
    return apertures.window_nodes(apertures.Beam(angle, light, window, rule.window), sample.lobe).weight.size


def quadrature_of_albedo() -> Choice:
    """Rules for the integral over the hemisphere."""
    slopes, theta_i = (0.03, 0.3), np.array([0.0, 45.0, 75.0, 85.0])
    zero, used = np.zeros(theta_i.size), representation(facet_bsdf(0.3)).accuracy
    ways: dict[str, Callable[[Representation, float], Array]] = {}
    for order, turns in ((1, 2), (2, 4), (3, 8), (4, 12), (6, 24)):
        ways[f"rings about the mirror direction, {order} in a panel and {turns} in half a turn"] = (
            lambda model, slope, order=order, turns=turns: _by_rings(model, slope, theta_i, order, turns)
        )
    for accuracy in (1e-1, 1e-4, 1e-6, 1e-8):
        ways[f"adaptive cubature to {accuracy:.0e}{' (used)' if accuracy == used else ''}"] = (
            lambda model, slope, accuracy=accuracy: model.integrate(theta_i, zero, None, relative=accuracy).value[:, 0]
        )
    errors: dict[str, dict[str, float]] = {name: {} for name in ways}
    seconds, nodes = ({name: [] for name in ways} for _ in range(2))
    for slope in slopes:
        model = representation(facet_bsdf(slope))
        dense = model.integrate(theta_i, zero, None, relative=1e-10).value[:, 0]
        for name, integrate in ways.items():
            value, took = timed(partial(integrate, model, slope), 10)
            errors[name][f"slope {slope:g}"] = largest(value / dense - 1)
            seconds[name].append(took)
            nodes[name].append(_evaluations(model, partial(integrate, model, slope)))
    options = [
        Option(
            f"{name}: {np.mean(nodes[name]) / theta_i.size:.0f} nodes",
            "",
            errors[name],
            {"four incidences": float(np.mean(seconds[name]))},
        )
        for name in ways
    ]
    return Choice(
        "Quadrature of an albedo",
        f"Rules over the hemisphere and their nodes of one incidence, on facets over a diffuse base; against the adaptive cubature to 1e-10. The largest relative error at "
        f"{', '.join(f'{angle:g}' for angle in theta_i)}°. The cubature to 1e-01 is that of its first mesh, before it refines.",
        {name: Metric("", 1e-9) for name in options[0].errors},
        next(option.name for option in options if "(used)" in option.name),
        options,
    )


def _by_rings(model: Representation, slope: float, theta_i: Array, order: int, turns: int) -> Array:
    """Albedo (incidences,) by a fixed rule about the mirror direction, for a lobe of a slope."""
    albedo = []
    for angle in theta_i:
        rule = around_mirror(float(angle), slope, order=order, turns=turns)
        incidence = np.full_like(rule.theta, angle), np.zeros_like(rule.theta)
        albedo.append(rule.weight @ model.evaluate(*incidence, rule.theta, rule.phi, None)[:, 0])
    return np.array(albedo)


def _evaluations(model: Representation, integrate: Callable[[], Array]) -> int:
    """Directions that an integration evaluates."""
    counted, original = 0, model.evaluate

    def evaluate(*at: Array | None) -> Array:
        nonlocal counted
        counted += np.size(at[0])
        return original(*at)

    with patch.object(model, "evaluate", evaluate):
        integrate()
    return counted
