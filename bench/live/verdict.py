"""What the page says of models: the diagram of the declared one, and the verdict so far in words.

The verdict: is it noise, which candidates could already explain it, what will the steps to come tell?
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from analysis.loop.so_far import Promising, judge_so_far
from analysis.report.gamma import gamma_scale
from analysis.residuals.observations import Observations
from daq.setup.setup import Setup
from model.bifurcations.forbidden_zones import forbidden_zones
from model.effects.routing import Effects, ball_effects
from model.orbits.attractor import attractor
from model.orbits.exact_ball import IdealBall
from model.orbits.make_ball import make_ball
from model.surveys.diagram import diagram
from model.tones import Forcing


def nominal_forcing(setup: Setup) -> Forcing:
    """The forcing as the profile asks for it, its first tone at phase zero."""
    multiples, displacements = zip(*setup.forcing.displacement_tones(), strict=True)
    return Forcing.of_displacements(multiples, np.array(displacements), from_first=True)


def predicted(setup: Setup, gammas: tuple[float, ...]) -> Iterator[dict[str, Any]]:
    """Portions of the prediction: lists of gammas as shown, flight times (ms), and zones (gamma, low, high; ms)."""
    shown = gamma_scale(setup.forcing, setup.forcing.ratio).factor
    low, high = 0.97 * min(gammas), 1.03 * max(gammas)
    omega = 2.0 * np.pi * setup.forcing.frequency_hz
    forcing, declared = nominal_forcing(setup), setup.declared_values()
    own = ball_effects(declared)
    ball = make_ball(forcing, own, frequency_hz=setup.forcing.frequency_hz, g_mps2=setup.g_mps2.value)
    grid = np.linspace(low, high, 480 if isinstance(ball, IdealBall) else 160)
    zone_grid = np.linspace(low, high, 120)
    # a little wider than the grid, so that neighbouring bars of a zone overlap
    half = 0.52 * (zone_grid[1] - zone_grid[0]) * shown
    # twenty gammas at a time: between two portions the caller looks at the run
    portions = -(-len(grid) // 20)
    for k in range(portions):
        rows = diagram(ball, grid[k::portions])  # every so many-th: the whole range is there at once, coarsely
        finite = np.isfinite(rows.tau)
        x = np.repeat(rows.gamma[:, None], rows.tau.shape[1], axis=1)[finite] * shown
        zones = [
            [float(gamma * shown), half, float(1e3 * a / omega), float(1e3 * b / omega)]
            for gamma in zone_grid[k::portions]
            for a, b in forbidden_zones(forcing, float(gamma))
            if a > 0.0
        ]
        yield {
            "kind": "model",
            "gamma": [round(float(v), 5) for v in x],
            "tau_ms": [round(float(v), 4) for v in 1e3 * rows.tau[finite] / omega],
            "zones": [[round(v, 5) for v in zone] for zone in zones],
            "part": (k + 1) / portions,
        }


def verdict_of(seen: Observations, step: int, look: int, upcoming: tuple[float, ...]) -> dict[str, Any]:
    """The verdict after a step.

    Returns a message: ``within`` noise or not, ``headline``, ``candidates`` and ``lines`` in words, ``floor_us``.

    Parameters
    ----------
    seen
        Observations of the steps that are over.
    step
        The last one's number, from 0.
    look
        The number of this verdict among those of the run, from 1.
    upcoming
        Gammas of the steps to come.
    """
    found = judge_so_far(seen, look)
    out: dict[str, Any] = {"kind": "verdict", "step": step, "within": True, "candidates": []}
    if found is None:
        return out | {"headline": "no flights to judge yet", "lines": [], "floor_us": None}
    sizes = f"landings missed by {found.landing_rms_us:.2g} \u00b5s rms, noise floor {found.floor_us:.2g} \u00b5s"
    lines = [f"{len(seen.steps)} steps, {found.flights} flights; {sizes}"]
    out |= {"lines": lines, "floor_us": found.floor_us}
    if found.within:
        return out | {"headline": "within noise of the declared model"}
    lines.append(f"probability of so much by noise: {found.p:.1g}; at this step {found.level:.1g} is asked")
    if not found.promising:
        lines.append("no single candidate explains it yet")
    lines += _next_steps(seen.setup, found.promising, upcoming, step)
    candidates = [f"{' + '.join(one.names)} (gain {one.gain:.3g} nats)" for one in found.promising]
    headline = "more than noise: the declared model misses something"
    return out | {"within": False, "headline": headline, "candidates": candidates}


def _next_steps(setup: Setup, promising: tuple[Promising, ...], upcoming: tuple[float, ...], step: int) -> list[str]:
    """What three of the steps to come will tell of the two best candidates that act on the ball."""
    balls = []
    for one in promising:
        effects = {name: dict(table) for name, table in setup.declared_values().items()}
        for (name, parameter), value in one.values.items():
            effects.setdefault(name, {})[parameter] = value  # a candidate at its linearised values
        if own := ball_effects(effects):
            balls.append((" + ".join(one.names), own))
    if len(balls) < 2 or not upcoming:
        return []
    (first, own), (second, other) = balls[:2]
    shown = gamma_scale(setup.forcing, setup.forcing.ratio).factor
    lines = []
    for k in sorted({round(k) for k in np.linspace(0, len(upcoming) - 1, 3)}):
        difference_ms = abs(_mean_ms(setup, own, upcoming[k]) - _mean_ms(setup, other, upcoming[k]))
        if difference_ms > 0.01:
            where = f"step {step + 1 + k} (\u0393 {shown * upcoming[k]:.3g})"
            lines.append(f"{where}: {first} and {second} differ by {difference_ms:.2g} ms of flight")
    return lines or [f"the steps to come will hardly tell {first} from {second}"]


def _mean_ms(setup: Setup, effects: Effects, gamma: float) -> float:
    """Mean flight time of the motion that a model predicts; NaN where it has none."""
    with contextlib.suppress(ValueError, ArithmeticError):
        forcing, hz = nominal_forcing(setup), setup.forcing.frequency_hz
        tau = attractor(make_ball(forcing, effects, frequency_hz=hz, g_mps2=setup.g_mps2.value), gamma).tau
        return 1e3 * float(np.mean(tau)) / (2.0 * math.pi * hz) if tau.size else 0.0
    return math.nan
