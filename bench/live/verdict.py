"""The verdict so far: are the residuals noise, which candidates could already explain them, what will tell them apart.

A cheap form of the closed loop over the steps that are over: tests of the residuals at the declared model, and the
linearised gain of each candidate. It names nothing; that is for `bench close-loop` on the whole recording.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from analysis.attribution.candidates import Candidate, candidates_of
from analysis.attribution.fit import Fitted, Fitter
from analysis.attribution.hypothesis import Refits
from analysis.attribution.priors import null_value_of, parameter_of, priors_of
from analysis.report.gamma import gamma_scale
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.lack_of_fit import goodness_of_fit
from analysis.residuals.observations import Observations, join
from analysis.residuals.prediction_errors import near_grazing, noise_quantiles_us
from analysis.residuals.values import TREND, ParameterId
from analysis.residuals.whitening import Whitener
from analysis.statistics import MAD_TO_SIGMA
from analysis.thresholds import FROZEN
from bench.live.prediction import nominal_forcing
from daq.setup.setup import Setup
from model.effects.registry import resolve
from model.effects.routing import ball_effects
from model.orbits.attractor import attractor
from model.orbits.make_ball import make_ball

LISTED = 4  # candidates
LOOKED_AHEAD = 3  # steps to come
MOST_STARTS = 12  # of a candidate's shapes
LEAST_DIFFERENCE_MS = 0.01

Promising = tuple[float, Candidate, dict[ParameterId, float]]


def verdict_of(parts: list[Observations], step: int, upcoming: tuple[float, ...]) -> dict[str, Any]:
    """The verdict after a step.

    Parameters
    ----------
    parts
        Observations of the steps that are over, one each.
    step
        The last one's number.
    upcoming
        Gammas of the steps to come.

    Returns
    -------
    dict
        A message: ``within`` noise or not, ``headline``, ``candidates`` and ``lines`` in words, ``floor_us``.
    """
    out: dict[str, Any] = {
        "kind": "verdict", "step": step, "within": True, "headline": "no flights to judge yet", "candidates": [],
        "lines": [], "floor_us": None,
    }  # fmt: skip
    # each step begins its own clock here, so nothing can be said of slow changes
    seen = dataclasses.replace(parts[0] if len(parts) == 1 else join(parts), modulation=None)
    world = ForwardModel(seen, resolve(seen.setup.declared_values()))
    if not seen.scored.any():
        return out
    found = goodness_of_fit(world, {})
    spread_us, out["floor_us"], chance_us = _sizes_us(world)
    enough = found.p_lack_of_fit < FROZEN.lack_p and max(found.ratio, found.plate_rms_z) > FROZEN.lack_ratio
    sizes = f"landings scatter by {spread_us:.2g} \u00b5s, noise {out['floor_us']:.2g} \u00b5s"
    out["lines"] = [f"{len(seen.steps)} steps, {int(seen.scored.sum())} flights; {sizes}"]
    if not enough and not spread_us > chance_us:
        out["headline"] = "within noise of the declared model"
        return out
    out |= {"within": False, "headline": "more than noise: the declared model misses something"}
    promising = _promising(world)
    out["candidates"] = [f"{' + '.join(c.names)} (gain {gain:.3g} nats)" for gain, c, _ in promising]
    if not promising:
        out["lines"].append("no single candidate explains it yet")
    out["lines"] += _next_steps(seen.setup, promising, upcoming, step)
    return out


def _sizes_us(world: ForwardModel) -> tuple[float, float, float]:
    """Scatter of the landings that can be judged, its noise, and what noise alone hardly ever exceeds."""
    kept = world.evidence.scored & ~near_grazing(world, {})
    kept = kept if kept.any() else world.evidence.scored
    residual, noise = world.residuals({}).landing_s[kept], world.uncertainty({}).landing_total_s[kept]
    seen = residual[np.isfinite(residual)]
    scatter = MAD_TO_SIGMA * float(np.median(np.abs(seen))) if len(seen) else math.nan
    chance_us = noise_quantiles_us(world, {}, np.flatnonzero(kept))[0]
    return 1e6 * scatter, 1e6 * float(np.median(noise)), chance_us


def _promising(world: ForwardModel) -> list[Promising]:
    """Candidates whose linearised gain is beyond doubt, the largest first, one a name."""
    fitter = Fitter(world, priors_of(world.evidence.setup), np.ones(len(world.evidence.steps), bool))
    declared = Refits(fitter).reweighted(fitter.fit(Whitener.of(world, {}), (), {}))
    found: dict[tuple[str, ...], Promising] = {}
    for candidate in candidates_of(world):
        free = tuple(key for key in candidate.free if key not in declared.free)
        if not free or any(key[1].endswith(TREND) for key in free):
            continue
        gain, values = _linear(fitter, declared, candidate, free)
        if gain > FROZEN.gain_nats and gain > found.get(candidate.names, (0.0,))[0]:
            found[candidate.names] = gain, candidate, values
    return sorted(found.values(), key=lambda one: -one[0])[:LISTED]


def _linear(
    fitter: Fitter, declared: Fitted, candidate: Candidate, free: Sequence[ParameterId]
) -> tuple[float, dict[ParameterId, float]]:
    """The largest linearised gain over the candidate's shapes, and the values there."""
    shapes = [key for key in free if parameter_of(key).is_shape]
    if not shapes:
        return fitter.linear_step(declared, free)
    settings = {tuple(start.get(key, null_value_of(key)) for key in shapes) for start in candidate.starts}
    steps = [
        fitter.linear_step(declared, free, dict(zip(shapes, at, strict=True)))
        for at in sorted(settings)[:: max(1, len(settings) // MOST_STARTS)]
    ]
    return max(steps, key=lambda one: one[0], default=(0.0, {}))


def _next_steps(setup: Setup, promising: list[Promising], upcoming: tuple[float, ...], step: int) -> list[str]:
    """What steps to come will tell of the two best candidates that act on the ball."""
    if not upcoming:
        return []
    acting = [one for one in promising if ball_effects(_effects(setup, one))][:2]
    if len(acting) < 2:
        return []
    chosen = sorted({round(k) for k in np.linspace(0, len(upcoming) - 1, LOOKED_AHEAD)})
    shown = gamma_scale(setup.forcing, setup.forcing.ratio).factor
    names = [" + ".join(one[1].names) for one in acting]
    lines = []
    for k in chosen:
        means = [_mean_ms(setup, _effects(setup, one), upcoming[k]) for one in acting]
        apart = abs(means[0] - means[1])
        if apart > LEAST_DIFFERENCE_MS:
            where = f"step {step + 2 + k} (\u0393 {shown * upcoming[k]:.3g})"
            lines.append(f"{where}: {names[0]} and {names[1]} differ by {apart:.2g} ms of flight")
    return lines or [f"the steps to come will hardly tell {names[0]} from {names[1]}"]


def _effects(setup: Setup, one: Promising) -> dict[str, dict[str, float]]:
    """Declared effects and a candidate at its linearised values."""
    effects = {name: dict(table) for name, table in setup.declared_values().items()}
    for key in one[1].free:
        effects.setdefault(key[0], {})[key[1]] = one[2].get(key, null_value_of(key))
    return effects


def _mean_ms(setup: Setup, effects: dict[str, dict[str, float]], gamma: float) -> float:
    """Mean flight time of the motion that a model predicts; NaN where it has none."""
    with contextlib.suppress(ValueError, ArithmeticError):
        forcing, hz = nominal_forcing(setup), setup.forcing.frequency_hz
        ball = make_ball(forcing, ball_effects(resolve(effects)), frequency_hz=hz, g_mps2=setup.g_mps2.value)
        tau = attractor(ball, gamma).tau
        return 1e3 * float(np.mean(tau)) / (2.0 * math.pi * hz) if tau.size else 0.0
    return math.nan
