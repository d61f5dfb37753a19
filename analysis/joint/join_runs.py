"""Joint verdict: pass after pass over the recordings, one at a time, until nothing more gains and nothing moves.

Each pass linearises every run at the effects named so far; while these move, candidates are left out. An effect is
named when runs that its fit did not see gain, and chance does not let the best of all candidates gain as much.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from analysis.attribution.candidates import (
    Prior,
    coordinate_of,
    null_value_of,
    parameter_of,
    priors_of,
    scale_of,
    value_at,
)
from analysis.joint.choice import Candidates, Tested, days_since_first, parameters_over_runs, systematics_of
from analysis.joint.population import LEAST_SPREAD, Population, each_on_its_own, fit_population
from analysis.joint.result import Candidate, JointVerdict
from analysis.joint.summary import Aligned, Point, RunSummary, aligned, summarise
from analysis.loop.close_loop import judge_loop
from analysis.loop.verdict import Verdict
from analysis.residuals.observations import Observations
from analysis.residuals.values import TREND, ParameterId
from analysis.thresholds import FROZEN, LEADING_P
from daq.files.disk import Journal
from daq.recording import open_recording
from daq.recording.header import refuse_repeated
from daq.recording.notebook import state_of
from daq.setup.errors import InputError
from daq.setup.provenance import software_commit, software_version
from daq.setup.setup import Setup
from kernels.arrays import Floats
from model.effects.registry import registry

Progress = Callable[[str, float], None]


def join_runs(
    recordings: Sequence[Path],
    *,
    setup: Setup | None = None,
    journal: Journal | None = None,
    progress: Progress | None = None,
) -> JointVerdict:
    """Judge many runs of one rig together, each with its own calibrations.

    Parameters
    ----------
    recordings
        At least three; one is in memory at a time, and the flights of the first ones.
    setup
        Replaces the setups stored in the recordings.
    journal
        Keeps every summary, so that a verdict that was interrupted goes on.
    progress
        Called with what is being done and the fraction of the pass.

    Raises
    ------
    InputError
        Where a file is no recording or shows too little, there are too few, or two hold the same samples.
    ValueError
        For declared effects that do not exist or are out of bounds.
    """
    if len(recordings) < 3:  # fewer tell nothing of how runs differ
        raise InputError(
            f"{', '.join(map(str, recordings))}: wanted at least 3 recordings, to see how runs differ; "
            "name more, or judge them as one run"
        )
    refuse_repeated(recordings)
    return _Search(_Passes(recordings, setup, journal, progress or (lambda what, part: None))).run()


@dataclass
class _Passes:
    """Summaries of all runs at a point, made or taken from the journal."""

    recordings: Sequence[Path]
    setup: Setup | None
    journal: Journal | None
    progress: Progress
    done: int = 0
    known: dict[Path, Observations] = field(default_factory=dict)

    def priors(self) -> dict[ParameterId, Prior]:
        """Priors of calibrations that cover what every run states."""
        found = {} if self.setup is None else priors_of(self.setup)
        for path in self.recordings if self.setup is None else ():
            with open_recording(path) as opened:
                stated = priors_of(opened.setup)
            # of each parameter the widest that any run states
            found |= {k: prior for k, prior in stated.items() if k not in found or prior.sigma > found[k].sigma}
        found.pop(("contact_closure", "late_s"), None)  # all runs share it: the first of `summary.NAMES`
        return found

    def at(self, point: Point, candidates: bool) -> list[RunSummary]:
        """Summaries at a point, with ``candidates`` or without, one recording read at a time."""
        self.done += 1
        out = []
        for i, path in enumerate(self.recordings):
            self.progress(f"pass {self.done}: {path.name}", i / len(self.recordings))
            # what a summary depends on: file and events as they are now, point, setup, effects and software
            effects = [(r.effect.name, r.effect.parameters) for r in registry()]
            made = [software_version(), software_commit(), effects, FROZEN, candidates]
            here = [*(sorted(x.items()) for x in (point.priors, point.shared, point.population)), self.setup]
            key = hashlib.sha256(repr([state_of(path), here, made]).encode()).hexdigest()[:24]
            row = None if self.journal is None else self.journal.rows.get(key)
            if row is None:
                # flights of the first recordings stay in memory, about 100 MB of them; the others are read in each pass
                few = path in self.known or sum(map(len, self.known.values())) < 200_000
                known = self.known if few else None
                summary = summarise(path, point, FROZEN, self.setup, known, candidates=candidates)
                if self.journal is not None:
                    self.journal.add(key, summary.as_row())
            else:
                summary = RunSummary.from_row(row)
                outcome = dataclasses.replace(summary.outcome, recording=str(path))
                summary = dataclasses.replace(summary, outcome=outcome)
            out.append(summary)
        return out


@dataclass
class _State:
    """Where the search stands: the point, its summaries, and the fit of all runs."""

    point: Point
    named: tuple[tuple[str, ...], ...]  # candidates accepted, in order
    summaries: list[RunSummary]
    model: Aligned
    found: Population

    @property
    def names(self) -> tuple[str, ...]:
        """Named effects, each once."""
        return tuple(dict.fromkeys(n for names in self.named for n in names))

    @property
    def days(self) -> tuple[Floats, bool]:
        """Days from the first run to each, (R,), and whether they are known."""
        return days_since_first([s.outcome.started for s in self.summaries])


@dataclass
class _Search:
    """Forward selection with steps back, linearised anew after each change."""

    passes: _Passes
    rounds: list[str] = field(default_factory=list)
    dropped: set[tuple[str, ...]] = field(default_factory=set)

    @functools.cached_property
    def declared(self) -> Mapping[ParameterId, Prior]:
        """Priors of calibrations before any run."""
        return self.passes.priors()

    def run(self) -> JointVerdict:
        state = self._begun_alone(self._at(Point(self.declared), (), candidates=True))
        first: list[Tested] = []
        ties: tuple[tuple[str, ...], ...] = (state.names,) if state.named else ()
        for depth in range(len(state.named), FROZEN.most_effects):
            state = self._with_candidates(state)
            candidates = Candidates(state.model, state.found, FROZEN)
            tested = candidates.tested(depth)
            first = first or tested
            judged = self._judged_again(state, candidates, tested, depth)
            chosen, tied = candidates.chosen([t for t in judged if t.option.names not in self.dropped])
            if chosen is None:
                best = ""
                if judged:
                    names, why = judged[0].option.names, judged[0].refusal or "dropped before"
                    best = f" (the best, {' + '.join(names)}: {why})"
                self.rounds.append(f"round {depth + 1}: nothing more gains beyond doubt{best}")
                break
            self.rounds.append(
                f"round {depth + 1}: {' + '.join(chosen.option.names)} gains {chosen.held_out.gain:.0f} +- "
                f"{chosen.held_out.error:.0f} nats on runs left out (p = {chosen.p:.2g} that the best of all "
                "candidates does so by chance)"
            )
            others = (t.option.names for t in tied if t is not chosen)
            ties = tuple(dict.fromkeys((*state.names, *n) for n in (chosen.option.names, *others)))
            state = self._without_idle(self._converged(self._with(state, chosen)))
        state = self._with_candidates(self._own_where_they_differ(state))
        if not state.named:
            ties = ()
        tried = tuple(
            Candidate(t.option.names, t.gain, t.held_out.gain, t.held_out.error, t.p, t.refusal) for t in first
        )
        days, dated = state.days
        runs = tuple(dataclasses.replace(s.outcome, days=float(t)) for s, t in zip(state.summaries, days, strict=True))
        verdict: Verdict = "explained" if state.names else "nothing_missing"
        return JointVerdict(
            "unexplained" if any(run.failed for run in runs) else verdict, state.names, ties,
            parameters_over_runs(state.model, state.found, days, FROZEN, self.declared),
            systematics_of(state.model, state.found), runs,
            Candidates(state.model, state.found, FROZEN).detection_limits(), tried, tuple(self.rounds),
            self.passes.done, dated,
        )  # fmt: skip

    def _at(self, point: Point, named: tuple[tuple[str, ...], ...], *, candidates: bool = False) -> _State:
        """All runs linearised at a point, and their fit."""
        summaries = self.passes.at(point, candidates)
        model = aligned(summaries, point, frozenset(n for names in named for n in names))
        start = model.runs[0].origin.copy()
        found = fit_population(model.runs, start, model.width, model.prior, np.arange(model.named, dtype=np.int64))
        found = dataclasses.replace(found, x=model.fit(found.runs, found.x, found.free))
        return _State(point, named, summaries, model, found)

    def _with_candidates(self, state: _State) -> _State:
        """The state with all candidates, where they were left out while its point moved."""
        return state if state.model.options else self._at(state.point, state.named, candidates=True)

    def _begun_alone(self, state: _State) -> _State:
        """Where a run by itself is not explained, what its own closed loop names is where the search begins."""
        enough = 2 * FROZEN.reserve_every  # steps, for a verdict on one run
        odd = [s for s in state.summaries if (s.outcome.failed or s.lost) and s.outcome.steps >= enough]
        if not odd:
            return state
        worst = max(odd, key=lambda s: (s.lost, s.outcome.ratio))
        path = next(p for p, s in zip(self.passes.recordings, state.summaries, strict=True) if s is worst)
        loop, fitted = judge_loop([path], setup=self.passes.setup, limits=FROZEN, anyway=True)
        best = fitted.selection.best
        free = {k: v for k, v in best.fitted.values.items() if k in best.free and not k[1].endswith(TREND)}
        if not free:
            return state
        self.rounds.append(
            f"{path.name}, not explained as declared, by itself names {' + '.join(loop.selection.names)}"
        )
        names = tuple(n for n in dict.fromkeys(k[0] for k in free))
        return self._without_idle(self._converged(self._at(_moved(state.point, free), (names,))))

    def _judged_again(self, state: _State, candidates: Candidates, tested: list[Tested], depth: int) -> list[Tested]:
        """All candidates, the first of them judged by runs linearised at its value, where it leads but is refused."""
        if not tested or not tested[0].refusal or tested[0].p > LEADING_P or tested[0].option.names in self.dropped:
            return tested
        there = self._with(state, tested[0])
        without = _without(there, frozenset(key for key, _ in tested[0].option.sizes))
        if without is None:
            return tested
        gain = there.model.loss(there.found, without.x) - there.model.loss(there.found, there.found.x)
        gains = there.model.left_out(without, without.free)
        gains = gains - there.model.left_out(there.found, there.found.free)
        return [candidates.judged_again(tested[0], gain, gains, depth), *tested[1:]]

    def _with(self, state: _State, chosen: Tested) -> _State:
        """The state with one more effect, at the values that the linear fit gives."""
        values: dict[ParameterId, float] = {}
        for (key, shapes), x in zip(chosen.option.sizes, chosen.sizes, strict=True):
            own = state.point.own
            base = state.found.x[own.index(key)] if key in own else coordinate_of(key, null_value_of(key))
            values[key] = value_at(key, base + float(x))
            values |= dict(shapes)
        return self._at(_moved(state.point, values), (*state.named, chosen.option.names))

    def _converged(self, state: _State) -> _State:
        """Linearised anew until the shared parameters stay, and the means of bent calibrations."""
        # the linear fit holds near its point only, so it is made anew there
        for _ in range(4):
            q, shared = len(state.point.own), sorted(state.point.shared)
            values = {k: value_at(k, float(state.found.x[q + i])) for i, k in enumerate(shared)}
            population: dict[ParameterId, Prior] = {}  # means and spreads of bent calibrations, in their own units
            for key in state.point.bent:
                i = state.point.own.index(key)
                least = LEAST_SPREAD * float(state.model.width[i])
                spread = max(float(state.found.spread[i]), least) * scale_of(key)
                mean = value_at(key, float(state.found.x[i]))
                population[key] = Prior(mean, float(spread ** parameter_of(key).power))
            here = {**state.point.shared, **{k: p.mean for k, p in state.point.population.items()}}
            there = {**values, **{k: p.mean for k, p in population.items()}}
            places = {k: i for i, (k, _) in enumerate(state.model.columns[: state.model.named])}
            # converged: no shared parameter moves by a third of its uncertainty
            if here.keys() == there.keys() and all(
                abs(coordinate_of(k, v) - coordinate_of(k, here[k])) < 0.3 * state.found.sigma(places[k])
                for k, v in there.items()
            ):
                break
            point = dataclasses.replace(_moved(state.point, values), population=population)
            state = self._at(point, state.named)
        return state

    def _without_idle(self, state: _State) -> _State:
        """Step back: the named effect that runs left out do not need is dropped, the least needed first."""
        full = state.model.left_out(state.found, state.found.free)
        gains = {}
        for names in state.named:
            without = _without(state, frozenset(k for k in state.point.shared if k[0] in names))
            if without is not None:
                gains[names] = float((state.model.left_out(without, without.free) - full).sum())
        least = min(gains, key=lambda n: gains[n], default=None)
        if least is None or gains[least] > FROZEN.first_effect_nats:
            return state
        self.rounds.append(
            f"{' + '.join(least)} gains no more than {gains[least]:.1f} nats next to the others: dropped"
        )
        self.dropped.add(least)
        shared = {k: v for k, v in state.point.shared.items() if k[0] not in least}
        point = dataclasses.replace(state.point, shared=shared)
        return self._converged(self._at(point, tuple(n for n in state.named if n != least)))

    def _own_where_they_differ(self, state: _State) -> _State:
        """Shared parameters that differ between runs become the runs' own, about a mean."""
        every = parameters_over_runs(state.model, state.found, state.days[0], FROZEN, self.declared)
        keys = [key for x in every if x.differs and (key := (x.effect, x.parameter)) in state.point.shared]
        if not keys:
            return state
        priors = dict(state.point.priors)
        for key in keys:
            place = len(state.point.own) + sorted(state.point.shared).index(key)
            values, sigmas = each_on_its_own(state.model.runs, state.found, place)
            # three times the spread found, so that the prior does not shrink it again from pass to pass
            width = 3.0 * max(float(np.std(values[np.isfinite(sigmas)])), 1e-3) * scale_of(key)
            priors[key] = Prior(state.point.shared[key], float(width ** parameter_of(key).power))
            self.rounds.append(f"{key[0]}.{key[1]} differs between runs: each has its own value")
        shared = {k: v for k, v in state.point.shared.items() if k not in keys}
        return self._at(Point(priors, shared, state.point.population), state.named, candidates=True)


def _without(state: _State, keys: frozenset[ParameterId]) -> Population | None:
    """The fit with shared parameters at what does nothing; None where none of them is shared (a calibration)."""
    shared = sorted(state.point.shared)
    places = {len(state.point.own) + i: k for i, k in enumerate(shared) if k in keys}
    if not places:
        return None
    x, rows = state.found.x.copy(), np.array(list(places), dtype=np.int64)
    x[rows] = [coordinate_of(k, null_value_of(k)) for k in places.values()]
    free = np.setdiff1d(state.found.free, rows)
    return dataclasses.replace(state.found, x=state.model.fit(state.found.runs, x, free), free=free)


def _moved(point: Point, values: dict[ParameterId, float]) -> Point:
    """The point with parameters set: a prior's mean where runs have their own values, else the shared value."""
    priors = {k: Prior(values.get(k, p.mean), p.sigma) for k, p in point.priors.items()}
    return Point(priors, {**point.shared, **{k: v for k, v in values.items() if k not in priors}})
