"""The verdict so far in words: is it noise, which candidates could already explain it, what steps to come will tell."""

from __future__ import annotations

import contextlib
import math
from typing import Any

import numpy as np

from analysis.loop.so_far import Promising, SoFar, judge_so_far
from analysis.report.gamma import gamma_scale
from analysis.residuals.observations import Observations
from bench.live.prediction import nominal_forcing
from daq.setup.setup import Setup
from model.effects.registry import resolve
from model.effects.routing import ball_effects
from model.orbits.attractor import attractor
from model.orbits.make_ball import make_ball

LOOKED_AHEAD = 3  # steps to come
LEAST_DIFFERENCE_MS = 0.01


def verdict_of(seen: Observations, step: int, look: int, upcoming: tuple[float, ...]) -> dict[str, Any]:
    """The verdict after a step.

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

    Returns
    -------
    dict
        A message: ``within`` noise or not, ``headline``, ``candidates`` and ``lines`` in words, ``floor_us``.
    """
    found = judge_so_far(seen, look)
    out: dict[str, Any] = {
        "kind": "verdict", "step": step, "within": True, "headline": "no flights to judge yet", "candidates": [],
        "lines": [], "floor_us": None,
    }  # fmt: skip
    if found is None:
        return out
    out["floor_us"] = found.floor_us
    sizes = f"landings missed by {found.landing_rms_us:.2g} \u00b5s rms, noise floor {found.floor_us:.2g} \u00b5s"
    out["lines"] = [f"{len(seen.steps)} steps, {found.flights} flights; {sizes}"]
    if found.within:
        out["headline"] = "within noise of the declared model"
        return out
    out |= {"within": False, "headline": "more than noise: the declared model misses something"}
    out["candidates"] = [f"{' + '.join(one.names)} (gain {one.gain:.3g} nats)" for one in found.promising]
    out["lines"].append(_chance(found))
    if not found.promising:
        out["lines"].append("no single candidate explains it yet")
    out["lines"] += _next_steps(seen.setup, found.promising, upcoming, step)
    return out


def _chance(found: SoFar) -> str:
    """What the accusation is worth."""
    return f"probability of so much by noise alone: {found.p:.1g}; at this step {found.level:.1g} is asked"


def _next_steps(setup: Setup, promising: tuple[Promising, ...], upcoming: tuple[float, ...], step: int) -> list[str]:
    """What steps to come will tell of the two best candidates that act on the ball."""
    acting = [one for one in promising if ball_effects(_effects(setup, one))][:2]
    if len(acting) < 2 or not upcoming:
        return []
    chosen = sorted({round(k) for k in np.linspace(0, len(upcoming) - 1, LOOKED_AHEAD)})
    shown = gamma_scale(setup.forcing, setup.forcing.ratio).factor
    names = [" + ".join(one.names) for one in acting]
    lines = []
    for k in chosen:
        means = [_mean_ms(setup, _effects(setup, one), upcoming[k]) for one in acting]
        difference_ms = abs(means[0] - means[1])
        if difference_ms > LEAST_DIFFERENCE_MS:
            where = f"step {step + 2 + k} (\u0393 {shown * upcoming[k]:.3g})"
            lines.append(f"{where}: {names[0]} and {names[1]} differ by {difference_ms:.2g} ms of flight")
    return lines or [f"the steps to come will hardly tell {names[0]} from {names[1]}"]


def _effects(setup: Setup, one: Promising) -> dict[str, dict[str, float]]:
    """Declared effects and a candidate at its linearised values."""
    effects = {name: dict(table) for name, table in setup.declared_values().items()}
    for (name, parameter), value in one.values.items():
        effects.setdefault(name, {})[parameter] = value
    return effects


def _mean_ms(setup: Setup, effects: dict[str, dict[str, float]], gamma: float) -> float:
    """Mean flight time of the motion that a model predicts; NaN where it has none."""
    with contextlib.suppress(ValueError, ArithmeticError):
        forcing, hz = nominal_forcing(setup), setup.forcing.frequency_hz
        ball = make_ball(forcing, ball_effects(resolve(effects)), frequency_hz=hz, g_mps2=setup.g_mps2.value)
        tau = attractor(ball, gamma).tau
        return 1e3 * float(np.mean(tau)) / (2.0 * math.pi * hz) if tau.size else 0.0
    return math.nan
