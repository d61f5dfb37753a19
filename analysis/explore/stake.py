"""A stake: what a verdict's causes predict of a forcing that was never driven, and whether a later run meets it.

Landings are predicted one flight ahead, from the event measured before, so that no motion has to begin alike. Nothing
is fitted to the later run: parameters stay at their values, and their covariance widens the prediction.

References
----------
G. E. P. Box, J. R. Stat. Soc. A 143, 383 (1980): a model is criticised by what it predicted of new data.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.special import chdtrc
from scipy.stats import norm

from analysis.attribution.candidates import candidates_of
from analysis.attribution.choice import contained_in
from analysis.attribution.fit import Fitter
from analysis.attribution.hypothesis import Hypothesis, Refits
from analysis.attribution.proposals import Proposals
from analysis.attribution.selection import SelectionResult
from analysis.explore.choice import MOST_EXPLANATIONS, Block, Option, Pool, best_block, divergences
from analysis.explore.explanations import Explanation, Weighed, slopes_at, weighed
from analysis.linear_algebra import inv, solve
from analysis.loop.close_loop import FittedLoop
from analysis.loop.design import simulate_steps
from analysis.loop.result import ClosedLoop
from analysis.loop.verdict import Failed
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.uncertainty import Uncertainty, uncertainty_at
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.observations import Observations
from analysis.residuals.prediction_errors import near_grazing
from analysis.residuals.values import TREND, ParameterId, Values
from analysis.thresholds import FARTHEST_SIGMAS, FROZEN, OUTLIER_FRACTION, SCALE_KNOWN, SHARED_S
from daq.recording import open_recording
from daq.setup.errors import InputError
from daq.setup.setup import Stake, StakedParameter, StakedStep
from kernels.arrays import Bools, Floats, Integers
from model.effects.registry import resolve

MISSED_P = 0.01  # probability that right causes miss one of the intervals of a stake
FEWEST = 3  # landings of a step that has an interval
SAME_GAMMA = 0.02  # relative difference within which two gammas of one forcing count as one
MEDIAN = math.pi / 2.0  # variance of a median over that of a mean, of normal errors


def staked(
    fitted: FittedLoop, options: Sequence[Option], steps: int, written: tuple[str, str], recordings: Sequence[Path]
) -> tuple[Block, Stake] | None:
    """The block by which the rivals of a named set would contradict it most for the rig's time, and the prediction.

    None where nothing is named, where a drift is (a later run does not share it), or no rival differs anywhere.

    Parameters
    ----------
    fitted
        The fits behind the verdict.
    options, steps
        Forcings that may be driven, and the steps of a block.
    written, recordings
        Software and time of writing, and the recordings that the verdict is on.
    """
    model, best = fitted.model, fitted.selection.best
    if not best.free or any(q.endswith(TREND) for _, q in best.free):
        return None
    known = _rivals(fitted)
    rival = known.explanations[1]
    asked: list[tuple[float, float, float]] = []  # ratio, frequency and gamma of each step that was driven
    for path in recordings:
        with open_recording(path) as opened:
            own_hz = opened.setup.forcing.frequency_hz
            asked += [(float(step["ratio"]), own_hz, float(step["gamma"])) for step in opened.steps]
    driven = np.array(asked).reshape(-1, 3)
    pools = [_new(Pool.of(option, model, best.fitter, known), driven) for option in options]
    pools = [pool for pool in pools if len(pool.option.gammas) >= steps]

    weights = np.array([x.probability for x in known.explanations[1:]])

    def worth(total: Floats) -> float:  # a rival that is far off already is not worth another step
        return float(weights @ np.log1p(divergences(total, known, known.explanations)[1:, 0]))

    block = best_block(pools, known, (), steps, worth)
    if block is None:
        return None
    total = next(p for p in pools if p.option is block.option).products[list(block.steps)].sum(axis=0)
    nats = float(divergences(total, known, known.explanations)[1, 0])
    covariance = np.asarray(inv(known.information), dtype=np.float64)
    rows = _predicted(block, model, known, rival, covariance)
    if not rows:
        return None
    values = known.explanations[0].values
    parameters = tuple(
        StakedParameter(effect=n, parameter=q, value=float(values[n, q]), cause=(n, q) in best.free)
        for n, q in known.keys
    )
    return block, Stake(
        named=best.names, rival=rival.names, nats=nats, chance=MISSED_P,
        software=written[0], written=written[1], recordings=tuple(map(str, recordings)), parameters=parameters,
        covariance=tuple(tuple(map(float, row)) for row in covariance), steps=tuple(rows),
    )  # fmt: skip


def _rivals(fitted: FittedLoop) -> Weighed:
    """The named set, then its rivals: what ties, the best other first cause, the declared model, each further effect.

    Each but the further effects, which have their own probability, counts fully. All that is known is of the named
    set's own parameters.
    """
    found, best = fitted.selection, fitted.selection.best
    of_all, own = weighed(fitted.model, best.fitter, best, found.ties[1:]), _explanation(best)
    rows, precision = of_all.known_under(own)
    instead = [_explanation(x) for x in (*found.ties[1:], *runner_up(found))]
    more = [x for x in of_all.explanations if x.names not in {own.names, *(y.names for y in instead)}]
    rivals = (*instead, _explanation(found.before), *more)[: MOST_EXPLANATIONS - 1]
    keys = tuple(of_all.keys[i] for i in rows)
    return Weighed((own, *rivals), keys, len(keys), precision, np.zeros(len(keys)))


def _explanation(x: Hypothesis) -> Explanation:
    return Explanation(x.names, x.free, x.fitted.values, 1.0)


def runner_up(found: SelectionResult) -> list[Hypothesis]:
    """The best other cause of the first round, fitted."""
    kin, refits = contained_in(found.best.names), Refits(found.before.fitter)
    library = candidates_of(refits.model)
    ranked = [names for names, _ in sorted(found.tried, key=lambda x: -x[1].gain) if not contained_in(names) & kin]
    others = [names for names in ranked if any(c.names == names for c in library)]
    options = [c for c in library if c.names in others[:1]]
    fits = [refits.attempted((c,), Proposals(refits, FROZEN).add, found.before, c) for c in options]
    return sorted((x for x in fits if x is not None), key=lambda x: float(x.per_step.sum()))[:1]


def _new(pool: Pool, driven: Floats) -> Pool:
    """The pool with the steps in which the ball flies, of gammas that were not ``driven`` at that forcing."""
    forcing, gammas = pool.option.setup.forcing, np.array(pool.option.gammas)
    same = (driven[:, 0] == forcing.ratio) & np.isclose(driven[:, 1], forcing.frequency_hz, rtol=SAME_GAMMA)
    near = np.isclose(gammas[:, None], driven[same, 2], rtol=SAME_GAMMA)
    places = np.flatnonzero(np.isfinite(pool.flight_s) & ~near.any(axis=1))
    option = replace(
        pool.option,
        gammas=tuple(gammas[places].tolist()),
        seconds=lambda some: pool.option.seconds([int(places[i]) for i in some]),
    )
    return Pool(option, pool.products[places], pool.flight_s[places])


# -- the prediction ----------------------------------------------------------------------------------------------------
def _predicted(
    block: Block, model: ForwardModel, known: Weighed, rival: Explanation, covariance: Floats
) -> list[StakedStep]:
    """Each step's interval, and where a rival, and the declared model, would put the median."""
    truth, declared = known.explanations[0].values, next(x for x in known.explanations if not x.names)
    gammas = np.array(block.gammas)
    steps = simulate_steps(block.option.setup, gammas, model, truth, carried=True)
    model = ForwardModel(steps, model.declared)
    landed = model.residuals(truth).landing_s
    rival_s, declared_s = (landed - model.residuals(x.values).landing_s for x in (rival, declared))
    intervals = _Intervals.of(model, truth, known.keys, covariance, len(gammas))
    flight_s = model.observations.measured.landing_s - model.observations.measured.opening_s
    out = []
    for i, gamma in enumerate(block.gammas):
        events = intervals.landings(np.array([i]))
        if len(events) < FEWEST:
            continue
        numbers: dict[str, float] = {
            "gamma": gamma, "within_us": 1e6 * intervals.half_s(events),
            "flight_ms": 1e3 * float(np.mean(flight_s[events])),
            "rival_us": 1e6 * float(np.median(rival_s[events])),
            "declared_us": 1e6 * float(np.median(declared_s[events])),
        }  # fmt: skip
        finite = {k: float(f"{x:.6g}") for k, x in numbers.items() if math.isfinite(x)}
        out.append(StakedStep.model_validate(finite))
    return out


@dataclass(frozen=True)
class _Intervals:
    """What noise and the parameters' own uncertainty make of the median landing of a step."""

    usable: Bools  # (n,): landings that are scored, and not near-grazing
    step: Integers  # (n,)
    noise: Uncertainty
    slopes: Floats  # of landings by the parameters' coordinates, (n, K)
    whitener: Whitener  # of all residuals, which are ``raw``, with derivatives ``stacked``
    raw: Floats
    stacked: Floats
    covariance: Floats
    sigmas: float  # half an interval, so many standard deviations

    @classmethod
    def of(
        cls, model: ForwardModel, values: Values, keys: Sequence[ParameterId], covariance: Floats, m: int
    ) -> _Intervals:
        """Of the observations of ``model``; ``m`` intervals together are missed by chance with `MISSED_P`."""
        ev, whitener = model.observations, Whitener.of(model, values, lean=True)
        # nothing is fitted: coordinates and bounds of parameters, free of priors
        fitter = Fitter(model, {}, np.ones(len(ev.steps), dtype=bool))
        raw, stacked = slopes_at(model, fitter, whitener, values, [(key, ()) for key in keys])
        slopes = np.zeros((len(ev), len(keys)))
        landing = np.flatnonzero(whitener.order >= len(whitener.opening))
        slopes[whitener.landing[whitener.order[landing] - len(whitener.opening)]] = stacked[landing]
        usable = ev.scored & ~near_grazing(model, values)
        # the noise's own scale is known to `SCALE_KNOWN`; two sides, and as many intervals as steps
        sigmas = (1.0 + SCALE_KNOWN) * float(norm.isf(0.5 * MISSED_P / m))
        noise = uncertainty_at(model, values)
        return cls(usable, ev.measured.step, noise, slopes, whitener, raw, stacked, covariance, sigmas)

    def landings(self, steps: Integers) -> Integers:
        """Landings of some steps that count."""
        return np.flatnonzero(self.usable & np.isin(self.step, steps))

    def half_s(self, events: Integers) -> float:
        """Half the interval of the median of some landings of a step."""
        own, by_tone = self.noise.landing_sigma_s[events], self.noise.landing_by_tone[events]
        slope = np.median(self.slopes[events], axis=0)
        variance = MEDIAN * float(np.mean(own**2)) / len(events) + SHARED_S**2
        variance += float(np.sum(np.median(by_tone, axis=0) ** 2) + slope @ self.covariance @ slope)
        return self.sigmas * math.sqrt(variance)


# -- a later run -------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class StepMet:
    """A staked step of a later run."""

    staked: StakedStep  # what was predicted of it, with the noise of earlier runs
    median_us: float  # NaN where there are too few
    half_us: float  # half of its interval with this run's own noise
    landings: int  # how many there are

    @property
    def met(self) -> bool:
        """Whether the median lies in the interval."""
        return abs(self.median_us) <= self.half_us


@dataclass(frozen=True)
class Outcome:
    """A later run held against a stake."""

    steps: tuple[StepMet, ...]
    flights: float  # rms of residuals over noise and parameters' uncertainty, of take-offs or landings, the larger
    plate: float  # the same of plate data
    flights_met: bool  # whether ``flights`` is as small as a verdict asks for
    plate_met: bool  # the same of ``plate``

    @property
    def met(self) -> bool:
        """Whether the run does what was predicted of it."""
        return self.flights_met and self.plate_met and all(step.met for step in self.steps)

    @property
    def words(self) -> str:
        """What came of it, in a sentence."""
        missed = [f"gamma {s.staked.gamma:g}" for s in self.steps if not s.met]
        faults = [f"landings at {', '.join(missed)} lie outside their intervals"] if missed else []
        if not self.flights_met:
            faults.append(f"flights are off by {self.flights:.2f} times what noise and parameters allow")
        if not self.plate_met:
            faults.append(f"the plate is off by {self.plate:.2f} standard deviations rms")
        return f"not met: the verdict is withdrawn ({'; '.join(faults)})" if faults else "met"


def steps_of(stake: Stake, recording: Path) -> list[Integers]:
    """Numbers of the steps of a recording in which each staked gamma was asked for.

    Raises `InputError` where one was not.
    """
    with open_recording(recording) as opened:
        asked = opened.steps["gamma"]
    found = [np.flatnonzero(np.isclose(asked, step.gamma, rtol=SAME_GAMMA)) for step in stake.steps]
    for step, numbers in zip(stake.steps, found, strict=True):
        if not len(numbers):
            raise InputError(
                f"{recording}: has no step at the staked gamma {step.gamma:g}; drive the stake's ramp to its end"
            )
    return found


def held_against(stake: Stake, observations: Observations, numbers: Sequence[Integers]) -> Outcome:
    """A later run held against a stake; nothing is fitted.

    ``numbers`` are, of each staked step, that of `steps_of` the run.
    """
    model = ForwardModel(observations, resolve(observations.setup.declared_values()))
    keys: list[ParameterId] = [(p.effect, p.parameter) for p in stake.parameters]
    values = dict(zip(keys, (p.value for p in stake.parameters), strict=True))
    intervals = _Intervals.of(model, values, keys, np.array(stake.covariance), len(stake.steps))
    missed_s = model.residuals(values).landing_s
    steps = []
    for step, own in zip(stake.steps, numbers, strict=True):
        rows = np.flatnonzero(np.isin(observations.steps.number, own))
        events = intervals.landings(rows)
        median = half = math.nan  # where the ball does not fly as predicted
        if len(events) >= FEWEST:
            # a landing that is not predicted is missed by as much as can be
            period_s = observations.steps.plate.period_s[rows[0]]
            missed = np.where(np.isfinite(missed_s[events]), missed_s[events], period_s)
            median, half = 1e6 * float(np.median(missed)), 1e6 * intervals.half_s(events)
        steps.append(StepMet(step, median, half, len(events)))
    whitener, raw, slopes = intervals.whitener, intervals.raw, intervals.stacked
    flights = _flights(whitener, raw, slopes, stake, intervals.usable)
    n, sigma = len(whitener.step), observations.plate.sigma
    z = np.clip(raw[n:] / sigma, -FARTHEST_SIGMAS, FARTHEST_SIGMAS)
    plate = _standardised(z, slopes[n:] / sigma[:, None], stake)[0] if len(z) else 0.0
    by_chance = all(p >= FROZEN.lack_p or ratio <= FROZEN.lack_ratio for ratio, p in flights)
    worst = max((ratio for ratio, _ in flights), default=0.0)
    return Outcome(tuple(steps), worst, plate, by_chance, plate <= FROZEN.plate_rms_z)


def _flights(whitener: Whitener, raw: Floats, slopes: Floats, stake: Stake, firm: Bools) -> list[tuple[float, float]]:
    """`_standardised` of take-offs from rest and of landings, each without the few that may be other events."""
    n = len(whitener.step)
    z = np.clip(whitener.white_all(raw)[:n], -FARTHEST_SIGMAS, FARTHEST_SIGMAS)
    jacobian = whitener.white_slopes(slopes, raw)[:n]
    event = np.concatenate([whitener.opening, whitener.landing])[whitener.order]
    opening = (np.arange(n) < len(whitener.opening))[whitener.order]
    out = []
    for channel in (opening, ~opening):
        rows = np.flatnonzero(channel & firm[event])
        few = math.ceil(OUTLIER_FRACTION * len(rows))
        rows = rows[np.argsort(np.abs(z[rows]))[: len(rows) - few]]
        if len(rows):
            out.append(_standardised(z[rows], jacobian[rows], stake))
    return out


def _standardised(z: Floats, jacobian: Floats, stake: Stake) -> tuple[float, float]:
    """Rms of unit residuals that share the errors of the parameters, and the probability of so large a one."""
    inner = np.eye(len(z)) + jacobian @ np.array(stake.covariance) @ jacobian.T
    square = float(z @ solve(inner, z))
    return math.sqrt(square / len(z)), float(chdtrc(len(z), square / (1.0 + SCALE_KNOWN) ** 2))


def with_outcome(loop: ClosedLoop, outcome: Outcome, run: str) -> ClosedLoop:
    """The loop with what came of its stake in the later ``run``: where that is not met, its verdict is withdrawn."""
    note = f"the prediction staked on {run}: {outcome.words}"
    loop = replace(loop, notes=(*(n for n in loop.notes if n != note), note))
    if outcome.met:
        return loop
    missed = Failed("stake", float(sum(not step.met for step in outcome.steps)), 0.0)
    return replace(loop, verdict="unexplained", failed=(*(f for f in loop.failed if f.test != "stake"), missed))
