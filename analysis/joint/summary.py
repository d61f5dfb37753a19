"""One run in a small table: what its recording tells about calibrations and candidates; tables of all runs aligned.

A recording is read, reduced, fitted for its own calibrations, linearised there to second order and let go; only the
summary stays. Summaries of all runs are brought to one set of coordinates.

Systematic errors that all runs of a rig share, how the contact's edges are dated, are nuisances with a prior: an
estimator of edges errs alike in every run, by its threshold, the sampling, or the edges that it does not detect. Ten
runs average noise, and not this. So each run's summary has derivatives to these errors too, and one value of each,
common to all runs, is fitted with every candidate: only what such an error cannot imitate can be named.

What delays both edges alike is a calibration of each run, `contact_latency`. Openings may be off against closings. A
contact from which the ball leaves at once is seen only where noise or sampling has made it longer, so its closing is
dated too early: by up to half of its length, and by no more than an edge's own uncertainty. Decision 158.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from analysis.attribution.candidates import Prior, candidates_of, coordinate_of, null_value_of, parameter_of, scale_of
from analysis.attribution.chance import Place, places
from analysis.attribution.fit import Fitter, of_same_events
from analysis.attribution.hypothesis import Hypothesis, Refits
from analysis.explore.explanations import adjusted_gradient_and_information, secants_at, slopes_at
from analysis.joint.population import Population, Priors, Quadratic, normal_equations
from analysis.joint.result import RunOutcome
from analysis.linear_algebra import bounded_step
from analysis.loop.result import as_tree, from_tree
from analysis.loop.verdict import failed_tests
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.lack_of_fit import goodness_of_fit
from analysis.residuals.noise.changes import EDGE_STEP_S
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.observations import Observations, observations_from
from analysis.residuals.prediction_errors import held_out_errors, noise_floors_us, scored_rows
from analysis.residuals.values import TREND, ParameterId, Values
from analysis.thresholds import Thresholds
from daq.recording import open_recording
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from kernels.arrays import Floats, Integers
from model.effects.registry import resolve

NAMES = ("openings late beside closings", "closings of brief contacts late")
PLACES: tuple[Place, ...] = tuple((("systematic", name), ()) for name in NAMES)
"""What their coordinates are called among those of a run's summary."""
UNIT_S = 1e-6  # of their coordinates


def systematic_errors(model: ForwardModel, whitener: Whitener, at: Values) -> tuple[Floats, tuple[float, ...]]:
    """What a run at the parameter values ``at`` tells of the errors of `NAMES`, per `UNIT_S`.

    Derivatives of the bare residuals, (r, 2), and standard deviations of their priors; 0 where it has no such edges.
    """
    observations, measured = model.observations, model.observations.measured
    brief = np.append(measured.relaunched[1:] & measured.linked[1:], False)
    now = model.residuals(at)
    raw, columns = whitener.stacked(now), []
    for closings, openings in ((np.zeros_like(brief), 1.0), (brief, 0.0)):
        late_s = np.where(closings, EDGE_STEP_S, 0.0)
        earlier = model.predict(at, landing_shift_s=-late_s, near=now.predicted)
        landed = np.where(observations.scored, measured.landing_s - late_s - earlier.landing_s, np.nan)
        opened = measured.opening_s - openings * EDGE_STEP_S - earlier.opening_s
        there = replace(now, landing_s=landed, opening_s=np.where(model.from_rest, opened, np.nan))
        change = of_same_events(whitener.stacked(there) - raw, whitener)
        columns.append(change * UNIT_S / EDGE_STEP_S)
    edges = (observations.opening_sigma_s, model.from_rest), (observations.landing_sigma_s, brief)
    opening_s, closing_s = (float(np.median(sigma_s[some])) if some.any() else 0.0 for sigma_s, some in edges)
    # all edges together may be off by a tenth of one edge's uncertainty; closings by half of what their prior allows
    sigma_s = (0.1 * opening_s, min(0.5 * observations.circuit.closure_s, closing_s))
    return np.column_stack(columns), tuple(s / UNIT_S for s in sigma_s)


@dataclass(frozen=True)
class Point:
    """Where runs are linearised."""

    # of what each run has its own value of: calibrations, and effects that differ between runs
    priors: Mapping[ParameterId, Prior]
    # values of the effects named so far that all runs share
    shared: Mapping[ParameterId, float] = field(default_factory=dict)
    # what all runs together tell of bent calibrations, see `bent`: their mean and their spread from run to run.
    # It takes the place of their priors in a run's own fit, so that each run is linearised where all runs put
    # it.
    population: Mapping[ParameterId, Prior] = field(default_factory=dict)

    @property
    def own(self) -> tuple[ParameterId, ...]:
        """What each run has its own value of, in order."""
        return tuple(sorted(self.priors))

    @property
    def bent(self) -> tuple[ParameterId, ...]:
        """Of what each run has its own value of, that on which events depend by a root: no straight line near nothing.

        A derivative at a run's own value follows the run's noise, and a run whose noise points up weighs more.
        """
        return tuple(key for key in self.own if parameter_of(key).power > 1.0)

    @property
    def names(self) -> frozenset[str]:
        """Effects whose shared parameters are set."""
        return frozenset(name for name, _ in self.shared)


@dataclass(frozen=True)
class Option:
    """One setting of a candidate: its effects, and the sizes that it frees, at given shapes."""

    names: tuple[str, ...]
    sizes: tuple[Place, ...]


@dataclass(frozen=True)
class RunSummary:
    """What remains of one run."""

    outcome: RunOutcome  # how it fits at the point where it is linearised
    # what the quadratic's coordinates stand for: the run's own, the shared ones, systematic errors that all runs share,
    # then sizes of candidates
    columns: tuple[Place, ...]
    options: tuple[Option, ...]  # the candidates
    quadratic: Quadratic  # log likelihood about the run's own fit
    # widths of the priors of shared systematic errors, see `systematic_errors`
    systematic_sigma: tuple[float, ...]
    lost: bool  # whether landings are so far off that nothing is linear

    def as_row(self) -> dict[str, Any]:
        """For a journal: numbers, texts and arrays packed as text."""
        arrays: dict[str, Floats] = {}
        tree = as_tree(self, "", arrays)
        packed = {k: (v.shape, base64.b64encode(v.astype("<f8").tobytes()).decode("ascii")) for k, v in arrays.items()}
        return {"summary": tree, "arrays": packed}

    @classmethod
    def from_row(cls, row: Mapping[str, Any]) -> RunSummary:
        """From a journal."""
        packed = row["arrays"].items()
        arrays = {k: np.frombuffer(base64.b64decode(text), "<f8").reshape(shape) for k, (shape, text) in packed}
        found: RunSummary = from_tree(cls, row["summary"], arrays)
        return found


def summarise(
    path: Path,
    point: Point,
    limits: Thresholds,
    setup: Setup | None = None,
    known: MutableMapping[Path, Observations] | None = None,
    *,
    candidates: bool = True,
) -> RunSummary:
    """Reduce one recording to its summary; raises `InputError` where the file is no recording, or shows too little.

    It is linearised at ``point``, its own calibrations fitted first; ``setup`` and ``known`` as in
    `analysis.residuals.observations.observations_from`. Without ``candidates`` it holds what is named only, and takes a
    third of the time.
    """
    with open_recording(path) as opened:
        started = str(opened.attrs.get("started") or "")
    observations = observations_from([path], setup=setup, known=known)
    if len(observations.steps) < 2 or not len(observations.plate):
        raise InputError(
            f"{path}: wanted at least 2 steps whose plate motion can be measured, found "
            f"{len(observations.steps)}; leave this recording out"
        )
    effects: dict[str, dict[str, float]] = {}
    for (name, q), value in point.shared.items():
        effects.setdefault(name, {})[q] = value
    declared = resolve(observations.setup.declared_values())
    # what is shared is added to what is declared, or takes its place; `resolve` fills in the other parameters
    declared |= {name: {**declared.get(name, {}), **own} for name, own in resolve(effects).items()}
    model = ForwardModel(observations, declared)
    fitter = Fitter(model, {**point.priors, **point.population}, np.ones(len(observations.steps), dtype=np.bool_))
    fitted = Refits(fitter).converged((), Whitener.of(model, {}), (), {})
    options = _options(model, fitted) if candidates else ()
    named = (*((key, ()) for key in (*point.own, *sorted(point.shared))), *PLACES)
    columns = (*named, *dict.fromkeys(place for option in options for place in option.sizes))
    values = fitted.fitted.values
    quadratic, systematic_sigma = _to_second_order(model, fitter, fitted, columns)
    left = goodness_of_fit(model, values, limits)
    rows, left_out = scored_rows(model, values, np.ones(len(observations.steps), dtype=np.bool_))
    after, floors = held_out_errors(model, values, rows, left_out), noise_floors_us(model, values, rows)
    outcome = RunOutcome(
        str(path), started, len(observations), len(observations.steps), left.ratio, left.plate_rms_z,
        left.p_lack_of_fit, float(after.landing_rms_us), float(floors[0]),
        tuple(x.test for x in failed_tests(False, left, after, floors, limits)),
    )  # fmt: skip
    return RunSummary(outcome, columns, options, quadratic, systematic_sigma, bool(fitted.whitener.lost))


def _options(model: ForwardModel, fitted: Hypothesis) -> tuple[Option, ...]:
    """Candidates to be added to what is named; a drift within a run belongs to that run and is left to `close_loop`."""
    out: dict[tuple[Place, ...], Option] = {}
    for candidate in candidates_of(model):
        # a drift's size in one run is no property that runs share
        if any(q.endswith(TREND) for _, q in candidate.free):
            continue
        for sizes in places([candidate], fitted):
            out.setdefault(sizes, Option(candidate.names, sizes))
    return tuple(out.values())


def _to_second_order(
    model: ForwardModel, fitter: Fitter, fitted: Hypothesis, columns: Sequence[Place]
) -> tuple[Quadratic, tuple[float, ...]]:
    """The run's log likelihood about its own fit, origin in coordinates; and the priors of shared systematic errors."""
    at, whitener = {**model.base, **fitted.fitted.values}, fitted.whitener
    errors, sigma = systematic_errors(model, whitener, at)
    ours = np.array([place in PLACES for place in columns])
    raw, slopes = slopes_at(model, fitter, whitener, at, [p for p in columns if p not in PLACES])
    sizes = len(columns) - int(np.flatnonzero(ours)[-1]) - 1  # of candidates, last of all
    if sizes:
        tried = columns[-sizes:]
        slopes[:, -sizes:] = secants_at(model, fitter, whitener, at, tried, raw, slopes[:, -sizes:])
    both = np.empty((len(raw), len(columns)))
    both[:, ours], both[:, ~ours] = errors, slopes
    origin = np.zeros(len(columns))
    for i, (key, _) in enumerate(columns[: int(np.flatnonzero(ours)[0])]):
        origin[i] = coordinate_of(key, at.get(key, null_value_of(key)))
    return Quadratic(origin, *adjusted_gradient_and_information(whitener, raw, both)), sigma


@dataclass(frozen=True)
class Aligned:
    """All runs in the same coordinates: each run's own parameters first (q), then shared ones, systematic errors that
    all runs share, and candidates.
    """

    point: Point
    columns: tuple[Place, ...]  # what each coordinate stands for, K in all
    options: tuple[Option, ...]  # candidates that at least half of the runs can show
    runs: tuple[Quadratic, ...]  # a quadratic each; what a run cannot show has no information
    prior: Priors  # of means and shared parameters
    width: Floats  # of the priors of what runs have their own values of, (q,)
    low: Floats  # least values of the coordinates, (K,)
    high: Floats  # largest ones, (K,)

    @property
    def named(self) -> int:
        """Number of coordinates before the candidates'."""
        return len(self.point.own) + len(self.point.shared) + len(PLACES)

    def places_of(self, option: Option) -> Integers:
        """Columns of a candidate."""
        return self.named + np.array([self.columns[self.named :].index(s) for s in option.sizes], dtype=np.int64)

    def loss(self, found: Population, x: Floats) -> float:
        """Loss of all runs and of the priors at a point, nats."""
        away = x - self.prior.mean
        return sum(run.loss_at(x) for run in found.runs) + 0.5 * float(self.prior.precision @ away**2)

    def fit(self, runs: Sequence[Quadratic], start: Floats, free: Integers) -> Floats:
        """Fit of what is free, within the bounds of sizes and shared parameters, (K,)."""
        # the means of calibrations, which come first, are held by their priors
        x, bounded = start.copy(), free >= len(self.point.own)
        below = np.where(bounded, (self.low - start)[free], -np.inf)
        above = np.where(bounded, (self.high - start)[free], np.inf)
        x[free] += bounded_step(*normal_equations(runs, start, self.prior, free), below, above, rcond=1e-13)
        return x

    def left_out(self, found: Population, free: Integers) -> Floats:
        """Loss of each run at the fit of all others, (R,)."""
        others = ([*found.runs[:i], *found.runs[i + 1 :]] for i in range(len(found.runs)))
        fits = (self.fit(some, found.x, free) for some in others)
        return np.array([run.loss_at(x) for run, x in zip(found.runs, fits, strict=True)])


def aligned(summaries: Sequence[RunSummary], point: Point, released: frozenset[str]) -> Aligned:
    """All runs in the same coordinates.

    All summaries are at ``point``; ``released`` effects were named: the mean of what they set has no prior.
    """
    counts: dict[Option, int] = {}
    for run in summaries:
        for option in run.options:
            counts[option] = counts.get(option, 0) + 1
    options = tuple(o for o, n in counts.items() if 2 * n >= len(summaries))
    own, shared = point.own, tuple(sorted(point.shared))
    columns = (*((k, ()) for k in (*own, *shared)), *PLACES, *dict.fromkeys(s for o in options for s in o.sizes))
    mean, precision = np.zeros(len(columns)), np.zeros(len(columns))
    width = np.array([width_of(key, point.priors[key].sigma) for key in own])
    for i, key in enumerate(own):
        mean[i] = coordinate_of(key, point.priors[key].mean)
        precision[i] = 0.0 if key[0] in released else width[i] ** -2.0
    first, named = len(own) + len(shared), len(own) + len(shared) + len(PLACES)
    sigma = np.max([run.systematic_sigma for run in summaries], axis=0)
    # a systematic error of a narrower prior is none
    precision[first:named] = np.maximum(sigma, 1e-3) ** -2.0
    bounds = [
        (-np.inf, np.inf)
        if place in PLACES
        else (coordinate_of(place[0], parameter_of(place[0]).low), coordinate_of(place[0], parameter_of(place[0]).high))
        for place in columns
    ]
    runs = tuple(_on(run, columns, named) for run in summaries)
    low, high = np.array(bounds).reshape(-1, 2).T
    return Aligned(point, columns, options, runs, Priors(mean, precision), width, low, high)


def width_of(key: tuple[str, str], sigma: float) -> float:
    """Standard deviation of a parameter's prior in coordinates."""
    return float(sigma ** (1.0 / parameter_of(key).power)) / scale_of(key)


def _on(run: RunSummary, columns: Sequence[Place], named: int) -> Quadratic:
    """A run's quadratic on the common columns; those that are named stand in the same place in every run."""
    known = {place: j for j, place in enumerate(run.columns[named:], start=named)}
    mine = np.array([j for j, place in enumerate(columns) if j < named or place in known], dtype=np.int64)
    theirs = np.array([j if j < named else known[columns[j]] for j in mine], dtype=np.int64)
    k, old = len(columns), run.quadratic
    origin = np.zeros(k)
    origin[mine] = old.origin[theirs]
    gradient, information = np.zeros(k), np.zeros((k, k))
    gradient[mine] = old.gradient[theirs]
    information[np.ix_(mine, mine)] = old.information[np.ix_(theirs, theirs)]
    return Quadratic(origin, gradient, information)
