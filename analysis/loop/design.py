"""Discrimination design: the run that would separate hypotheses which the data do not separate.

Every candidate run is simulated under the best hypothesis, and its rivals are fitted to that simulation. The value of
a run is the loss of the best-fitting rival, in nats (Box and Hill, Technometrics 9, 57, 1967).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from analysis.attribution.candidates import Prior, null_value_of, priors_of
from analysis.attribution.fit import Fitter
from analysis.loop.close_loop import FittedLoop
from analysis.plate.ringing.modes import Identified
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.observations import Observations, Steps
from analysis.residuals.plate_data.plate_observables import (
    GAIN,
    GATE,
    PHASE,
    SECOND,
    THIRD,
    PlateData,
    expected,
    share_of_first,
)
from analysis.residuals.values import TREND, ParameterId, Values
from daq.setup.setup import Setup
from daq.setup.values import STANDARD_GRAVITY_MPS2
from kernels.arrays import Floats
from model.effects.base import COMPILED_HOOKS
from model.effects.registry import effect, registry
from model.integrator.one_step import simulate
from model.integrator.problem import Measured, PlateSteps
from model.tones import Plate

STEPS = 14  # of a designed ramp
SETTLE_CYCLES, HOLD_CYCLES = 20, 30  # of each simulated step
OVER_AMPLITUDE = {GAIN: 1, PHASE: 1, GATE: 1, SECOND: 2, THIRD: 2}
"""Power of a tone's amplitude by which the uncertainty of a kind of plate data falls; 0 for others."""


@dataclass(frozen=True)
class Design:
    """A run that could be made next."""

    id: str  # a short name
    description: str  # a sentence
    ratio: int  # c of the ramp
    gammas: tuple[float, ...]  # of the ramp, rising, whatever the order in which they are run
    order: str = "up"  # of the ramp
    # standard deviations from a calibration made with the run (flip test, drop test), by parameter
    priors: Mapping[ParameterId, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Ranked:
    """A design with the least loss of any rival, in nats, and that rival."""

    design: Design
    nats: float
    closest_rival: tuple[str, ...]


def designs_for(gamma: Floats, ratio: int) -> list[Design]:
    """Candidate runs: other ratios, farther into the irregular range, another order of steps, calibrations with it.

    Parameters
    ----------
    gamma, ratio
        Of the steps of the run that was made, (m,), and its c.
    """
    low, high = float(np.min(gamma)), float(np.max(gamma))

    def over(stop: float, c: int) -> tuple[float, ...]:
        threshold = 1.0 / (1.0 + c**2) if c > 1 else 0.5
        scale = threshold * (1.0 + ratio**2 if ratio > 1 else 2.0)  # in units of the threshold of the present ratio
        return tuple(float(g) for g in np.linspace(1.05 * low * scale, stop * scale, STEPS))

    same = tuple(float(g) for g in np.linspace(low, high, STEPS))
    out = [
        Design(f"ratio_{c}", f"c = {c}, the same range over the threshold", c, over(high, c))
        for c in (1, 2, 3)
        if c != ratio
    ]
    out.append(Design("farther", "farther into the irregular range", ratio, over(2.0 * high, ratio)))
    out.append(Design("farther_ratio_2", "c = 2, farther into the irregular range", 2, over(2.0 * high, 2)))
    out.append(Design("shuffled", "the same steps, shuffled", ratio, same, "shuffled"))
    for test, words in (("flip test", "flip test of the accelerometer"), ("drop test", "drop test along the rod")):
        every = ((r.effect.name, q) for r in registry() for q in r.effect.parameters)
        priors = {(name, q.name): q.calibrated_by[test] for name, q in every if test in q.calibrated_by}
        out.append(Design(test.replace(" ", "_"), f"the same ramp after a {words}", ratio, same, priors=priors))
    return out


def rank(fitted: FittedLoop, designs: Sequence[Design]) -> list[Ranked]:
    """Designs by how well they separate the ties, best first; empty where nothing ties.

    Every design is simulated under the best hypothesis, and its rivals are fitted to that simulation.
    """
    model, best = fitted.model, fitted.selection.best
    # a design separates at most three tied hypotheses from the best
    rivals = fitted.selection.ties[1:4]
    if not rivals:
        return []
    out = []
    for design in designs:
        made = ForwardModel(simulate_design(design, model, best.fitted.values), model.declared)
        priors = priors_of(model.observations.setup)
        for key, sigma in design.priors.items():  # a calibration made with the run finds what the best hypothesis says
            priors[key] = Prior(best.fitted.values.get(key, null_value_of(key)), sigma)
        fitter = Fitter(made, priors, np.ones(len(made.observations.steps), dtype=bool))
        whitener = Whitener.of(made, best.fitted.values)
        losses = [(float(fitter.fit(whitener, x.free, x.fitted.values).loss), x.names) for x in rivals]
        nats, names = min(losses)
        out.append(Ranked(design, nats, names))
    return sorted(out, key=lambda r: -r.nats)


def simulate_design(design: Design, model: ForwardModel, fitted: Values) -> Observations:
    """Noise-free observations of the design under the parameters ``fitted``, with the uncertainties of ``model``."""
    gammas = np.array(design.gammas)
    if design.order == "shuffled":
        gammas = np.random.default_rng(1).permutation(gammas)
    setup = model.observations.setup
    forcing = setup.forcing.model_copy(update={"ratio": design.ratio})
    return simulate_steps(setup.model_copy(update={"forcing": forcing}), gammas, model, fitted)


def simulate_steps(
    setup: Setup, gammas: Floats, model: ForwardModel, fitted: Values, *, carried: bool = False
) -> Observations:
    """Noise-free observations of steps one after another, with the uncertainties of ``model``.

    ``setup`` is that of ``model``, with the forcing of these steps; ``gammas`` are in the order of the run, (m,). Where
    motion is ``carried`` the end of a step is the start of the next one, as on a rig; else each starts from rest.
    """
    observations = model.observations
    values = model.start(fitted)
    omega = 2 * math.pi * setup.forcing.frequency_hz
    tones = setup.forcing.displacement_tones()
    m, k = len(gammas), len(tones)
    z = np.zeros((m, observations.steps.sigma_mps2.shape[1]), complex)
    w = np.ones_like(z, dtype=float)
    for j, (multiple, amplitude) in enumerate(tones):
        z[:, j] = -setup.g_mps2.value * gammas * multiple**2 * amplitude
        w[:, j] = multiple * omega
    plate = PlateSteps(w, z, np.full(m, 2 * math.pi / omega))
    spread = np.zeros((m, 2 * z.shape[1], z.shape[1]), complex)
    for j in range(2 * k):
        spread[:, j, j // 2] = (1.0, 1j)[j % 2] * float(
            np.median(observations.steps.sigma_mps2[observations.steps.forcing])
        )
    part = (np.arange(m) + 0.5) / m - 0.5
    forcing = np.tile(np.arange(w.shape[1]) < k, (m, 1))
    ratio = np.full(m, setup.forcing.ratio)
    steps = Steps(np.zeros(m, dtype=np.int64), np.arange(m), gammas, ratio, part, plate, spread, forcing)
    measured = _flights(values, plate, part, setup.g_mps2.value, carried)
    n = len(measured.landing_s)
    opening_sigma, landing_sigma = (
        np.full(n, float(np.median(x))) for x in (observations.opening_sigma_s, observations.landing_sigma_s)
    )
    data = _plate_rows(observations.plate, steps, k)
    made = replace(
        observations,
        measured=measured,
        opening_sigma_s=opening_sigma,
        landing_sigma_s=landing_sigma,
        scored=measured.wanted,
        time_s=measured.landing_s,
        weak_mps=np.full(n, float(np.min(observations.weak_mps, initial=np.inf))),
        steps=steps,
        plate=data,
        setup=setup,
        modulation=None,
        ringing=Identified(),
        circuit=replace(observations.circuit, heard=None),
        run_part=part[measured.step],
    )
    truth = ForwardModel(made, model.declared)
    return replace(made, plate=replace(data, value=expected(data, truth.by_step(fitted))))


def _flights(
    values: Mapping[ParameterId, float], plate: PlateSteps, part: Floats, g_mps2: float, carried: bool
) -> Measured:
    """Flights of every step by the integrator, with drifting parameters at their value in the step."""
    found, start = [], (0.0, 0.0)
    for i in range(len(part)):
        effects: dict[str, dict[str, float]] = {}
        for (name, q), value in values.items():
            entry = effect(name)
            if q.endswith(TREND) or not entry.hooks.keys() & set(COMPILED_HOOKS):
                continue
            parameter = entry.effect.parameter(q)
            moved = value + values.get((name, q + TREND), 0.0) * part[i]
            effects.setdefault(name, {})[q] = float(np.clip(moved, parameter.low, parameter.high))
        period = plate.period_s[i]
        tones = Plate(plate.omega_radps[i], plate.acceleration_mps2[i])
        orbit = simulate(effects, tones, g_mps2=g_mps2, period_s=period, flights=600, start=start, unseen_s=1e-3)
        whole = orbit.landing_s < (SETTLE_CYCLES + HOLD_CYCLES) * period
        if carried and whole.any():
            last = int(np.flatnonzero(whole)[-1])
            start = float(orbit.landing_s[last] % period), float(orbit.impact_mps[last])
        keep = (orbit.takeoff_s > SETTLE_CYCLES * period) & (orbit.landing_s < (SETTLE_CYCLES + HOLD_CYCLES) * period)
        place = np.arange(int(keep.sum()))
        links = ~orbit.after_rest[keep] & (place > 0), place > 0, np.full(len(place), i, dtype=np.int64), place > 1
        found.append((orbit.takeoff_s[keep], orbit.landing_s[keep], *links))
    return Measured(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _plate_rows(seen: PlateData, steps: Steps, tones: int) -> PlateData:
    """Plate data of a new run: the kinds that the present run gave, in each step, where noise is what it was there."""
    rows: list[tuple[float, ...]] = []
    seen_mps2 = seen.scale * np.where(np.isin(seen.kind, (GAIN, PHASE)), np.abs(seen.own_share), 1.0)
    turns = steps.plate.omega_radps[:, :tones] * steps.plate.period_s[:, None] / (2.0 * np.pi)
    driven = np.rint(turns).astype(np.int64)
    for kind in np.unique(seen.kind):
        like, power = seen.kind == kind, OVER_AMPLITUDE.get(int(kind), 0)
        noise, omega = (float(np.median(x[like])) for x in (seen.sigma * seen_mps2**power, seen.omega_radps))
        for i in range(len(steps)):
            if {SECOND: 2, THIRD: 3}.get(int(kind)) in driven[i].tolist():  # a forcing tone there
                continue
            scale = float(np.abs(steps.plate.acceleration_mps2[i, 0]))
            for j in range(tones if kind in (GAIN, PHASE) else 1):
                tone = steps.plate.omega_radps[i, j] if kind in (GAIN, PHASE) else omega
                sigma = noise / float(np.abs(steps.plate.acceleration_mps2[i, j])) ** power
                rows.append((kind, i, 0.0, sigma, tone, scale / STANDARD_GRAVITY_MPS2, scale))
    table = np.array(rows, dtype=np.float64).reshape(-1, 7)
    kind, step = table[:, 0].astype(np.int64), table[:, 1].astype(np.int64)
    multiple = np.rint(table[:, 4] * steps.plate.period_s[step] / (2.0 * np.pi)).astype(np.int64)
    value, error, omega_radps, asked, scale = table[:, 2:].T
    first, others = steps.plate.acceleration_mps2[:, :1], steps.plate.acceleration_mps2[:, 1:tones]
    shares = share_of_first(first, others, driven[:, 1:])
    further, mains = driven[step, 1:], np.zeros(len(step), dtype=np.complex128)
    return PlateData(kind, step, value, error, omega_radps, asked, scale, multiple, further, shares[step], mains)


def ranking_json(ranked: Sequence[Ranked]) -> dict[str, object] | None:
    """The ranking for programs, or None where there is nothing to separate."""
    if not ranked:
        return None
    best = ranked[0].design
    return {
        "id": best.id, "description": best.description, "tone_ratio": best.ratio, "gammas": list(best.gammas),
        "order": best.order,
        "ranked": [
            {"id": r.design.id, "description": r.design.description, "nats": r.nats,
             "closest_rival": list(r.closest_rival)}
            for r in ranked
        ],
    }  # fmt: skip
