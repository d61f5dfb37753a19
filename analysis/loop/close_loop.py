"""The closed loop: recordings in; residual, missing effect, errors before and after, and the verdict out.

Steps held out at the start are used once, at the end. "Explained" needs a named cause, a remainder that is noise, and
errors on the held-out steps that noise explains. What is not known is called unexplained. Decision 277.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from analysis.attribution.candidates import candidates_of, priors_of
from analysis.attribution.detectability import detection_limits
from analysis.attribution.fit import Fitter
from analysis.attribution.hypothesis import Refits, Rejected, with_hidden_free
from analysis.attribution.rebound_scatter import with_scatter
from analysis.attribution.selection import SelectionResult, StepwiseSelection
from analysis.discovery.discover import discover
from analysis.linear_algebra import NotFiniteError
from analysis.loop.result import ClosedLoop, DetectionLimits, HeldOutErrors, PlateTable
from analysis.loop.tables import flight_table, selected, source_of, step_table
from analysis.loop.verdict import Failed, confirmed_on_reserve, failed_tests, verdict_of
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.lack_of_fit import goodness_of_fit
from analysis.residuals.noise.whitening import step_losses
from analysis.residuals.observations import Observations, observations_from
from analysis.residuals.prediction_errors import (
    given_openings,
    held_out_errors,
    noise_floors_us,
    noise_quantiles_us,
    scored_rows,
)
from analysis.residuals.values import TREND, ParameterId, plate_effects
from analysis.signals import LEAST_HZ
from analysis.thresholds import FAR_CYCLES, FEWEST_TAKEOFFS, FROZEN, Thresholds
from daq.instrument.instrument import refuse_doubtful
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from kernels.arrays import Bools
from model.effects.registry import effect, resolve

Progress = Callable[[str, float], None]

HIGH_PASS = "accelerometer_high_pass", "corner_hz"


@dataclass(frozen=True)
class FittedLoop:
    """The forward model and the fitted hypotheses behind a `ClosedLoop`, for what needs further predictions."""

    model: ForwardModel
    selection: SelectionResult


def close_loop(
    recordings: Sequence[Path],
    *,
    setup: Setup | None = None,
    limits: Thresholds = FROZEN,
    progress: Progress | None = None,
    anyway: bool = False,
) -> ClosedLoop:
    """Close the loop on recordings of one rig.

    Parameters
    ----------
    recordings
        Recordings of one rig; their steps are judged together.
    setup
        Replaces the setup stored in the recordings.
    limits
        Thresholds of the verdict.
    progress
        Called with what is being done and the fraction done.
    anyway
        Go on where a recording contradicts its profile so far that a verdict means nothing.

    Raises
    ------
    InputError
        Where a file is no recording or contradicts its profile, holds too little to hold steps out, or no model can be
        fitted to it.
    ValueError
        For declared effects that do not exist or are out of bounds.
    """
    return completed(*judge_loop(recordings, setup=setup, limits=limits, progress=progress, anyway=anyway))


def fit_loop(
    recordings: Sequence[Path], *, setup: Setup | None = None, progress: Progress | None = None, anyway: bool = False
) -> tuple[ClosedLoop, FittedLoop]:
    """`close_loop`, with the fitted model behind its result: next runs are ranked by it."""
    loop, fitted = judge_loop(recordings, setup=setup, progress=progress, anyway=anyway)
    return completed(loop, fitted), fitted


def judge_loop(
    recordings: Sequence[Path],
    *,
    setup: Setup | None = None,
    limits: Thresholds = FROZEN,
    progress: Progress | None = None,
    known: MutableMapping[Path, Observations] | None = None,
    anyway: bool = False,
) -> tuple[ClosedLoop, FittedLoop]:
    """`fit_loop` without the discovered term, on which no verdict depends: see `completed`.

    ``known`` is that of `analysis.residuals.observations.observations_from`.
    """
    say = progress or (lambda what, part: None)
    if not anyway:
        refuse_doubtful(recordings, setup)
    observations = observations_from(
        recordings, setup=setup, progress=lambda name, part: say(f"reading {name}", 0.15 * part), known=known
    )
    names = ", ".join(p.name for p in recordings)
    if len(observations.steps) < 2 * limits.reserve_every or not len(observations.plate):
        raise InputError(
            f"{names}: wanted at least {2 * limits.reserve_every} steps whose plate motion can be measured, found "
            f"{len(observations.steps)}; record a ramp of more steps or pass more recordings"
        )
    if not observations.scored.any():
        raise InputError(
            f"{names}: wanted flights whose landing can be predicted from the one before, found none; see with "
            "bench info whether the contact channel is what the profile says, or drive harder"
        )
    try:
        found = _loop_of(observations, recordings, limits, say, anyway=anyway)
        corner_hz = high_pass_hz(found[0])
        if corner_hz > 0.0:
            # what an impact leaves behind such a high-pass bends the tones that were taken, and hides how the plate
            # rings: read once more, knowing it
            observations = observations_from(recordings, setup=setup, high_pass_hz=corner_hz)
            if corner_hz > LEAST_HZ or observations.ringing.mode is not None:
                found = _loop_of(observations, recordings, limits, say, anyway=anyway, seen={HIGH_PASS: corner_hz})
        return found
    except NotFiniteError as error:
        raise InputError(
            f"{names}: the declared model cannot be fitted, {error}; look at the channels with bench info, and at the "
            "profile's scales, senses and declared effects"
        ) from error


def _loop_of(
    observations: Observations,
    recordings: Sequence[Path],
    limits: Thresholds,
    say: Progress,
    *,
    anyway: bool,
    seen: Mapping[ParameterId, float] | None = None,
) -> tuple[ClosedLoop, FittedLoop]:
    """The loop closed on what was observed; ``seen`` as in `candidates_of`."""
    model = ForwardModel(observations, resolve(observations.setup.declared_values()))
    if not anyway:
        refuse_far_off(model, recordings)
    selection = _selection_of(model, limits, say, seen)
    say("what remains", 0.87)
    judged = _judge(selection, limits)
    if (other := with_scatter(selection, limits, lambda x: _selection_of(x, limits, say, seen))) is not None:
        again = _judge(other, limits)
        # what is left may pass by its size; a scatter must leave nothing that follows anything
        if again["verdict"] == "explained" and again["remainder"].p_lack_of_fit >= limits.lack_p:
            selection, judged, model = other, again, other.best.model
    points, plate = (selection.before.fitted.values, selection.best.fitted.values), model.observations.plate
    say("detection limits", 0.97)
    detection, unidentifiable = detection_limits(selection.best, limits)
    result = ClosedLoop(
        **judged,
        selection=selected(selection, candidates_of(model, seen), limits),
        detection=DetectionLimits(detection, unidentifiable),
        flights=flight_table(model, *points),
        plate=PlateTable(plate.kind, plate.step, plate.value, plate.sigma, *(model.residuals(x).plate for x in points)),
        discovered=None,
        steps=step_table(model, selection.best.fitter.train),
        setup=observations.setup,
        limits=limits,
        sources=tuple(source_of(path) for path in recordings),
        notes=_notes(observations, selection),
    )
    return result, FittedLoop(model, selection)


def _selection_of(
    model: ForwardModel, limits: Thresholds, say: Progress, seen: Mapping[ParameterId, float] | None
) -> SelectionResult:
    """The effects that a model lacks, fitted to the end; ``seen`` as in `candidates_of`."""
    train = np.arange(len(model.observations.steps)) % limits.reserve_every != limits.reserve_every // 2
    fitter = Fitter(model, priors_of(model.observations.setup), train)
    library = candidates_of(model, seen)
    stepwise = StepwiseSelection(
        model, fitter, limits, lambda what, part: say(f"trying {what}", 0.15 + 0.7 * part), library
    )
    found = withdraw_unconfirmed(model, stepwise.run(), train, limits)
    best, ties = with_hidden_free(Refits(fitter).settled(found.best)), found.ties
    return dataclasses.replace(found, best=best, ties=(best, *ties[1:]) if ties else ())


def high_pass_hz(loop: ClosedLoop) -> float:
    """Corner of the accelerometer's high-pass that a verdict names; 0 for none."""
    named = [e.parameters[HIGH_PASS[1]][0] for e in loop.selection.effects if e.name == HIGH_PASS[0]]
    return max(named, default=0.0)


def refuse_far_off(model: ForwardModel, recordings: Sequence[Path]) -> None:
    """Refuse landings and take-offs from rest that the declared model both misses by a good part of a cycle.

    An effect may move landings as far (a restitution does), but no take-off of a resting ball.
    """
    left, measured = model.residuals({}), model.observations.measured
    period_s = model.observations.steps.plate.period_s[measured.step]
    rows = model.observations.scored & model.from_rest
    if rows.sum() < FEWEST_TAKEOFFS:
        return
    opening, landing = (
        np.median(np.where(np.isfinite(x), np.abs(x) / period_s, 0.5)[rows]) for x in (left.opening_s, left.landing_s)
    )
    if opening > FAR_CYCLES and landing > FAR_CYCLES:
        missed_ms = [1e3 * part * float(np.median(period_s)) for part in (opening, landing)]
        raise InputError(
            f"{', '.join(str(p) for p in recordings)}: the declared model misses take-offs by "
            f"{missed_ms[0]:.0f} ms and landings by {missed_ms[1]:.0f} ms, "
            "farther than any effect moves both, so a channel is not what the profile says; check sign, sensitivity, "
            "open_v, closed_v and ratio against bench info; --anyway goes on all the same"
        )


def completed(loop: ClosedLoop, fitted: FittedLoop) -> ClosedLoop:
    """The loop with a term discovered where it is unexplained; ``loop`` and ``fitted`` are of `judge_loop`.

    What an explanation leaves may be improbable and pass by its size. Then a formula is looked for in its place, and
    where one does better the verdict is *unexplained*. Decision 671.
    """
    best, left, limits = fitted.selection.best, loop.remainder, loop.limits
    by_size = loop.verdict == "explained" and left.p_lack_of_fit < limits.law_p
    # no term of the ball's motion changes take-offs alone, nor the plate, nor single landings that are lost
    fails = loop.verdict == "unexplained" and not (left.flights_pass(limits) or left.only_takeoffs_fail(limits))
    if not (fails or (by_size and set(best.names) - plate_effects())):
        return loop
    try:
        found = discover(fitted.model, best.fitter, best, limits, in_place=by_size)
    except NotFiniteError as error:
        return dataclasses.replace(loop, notes=(*loop.notes, f"the search for a smooth term ended early: {error}"))
    if fails:
        return dataclasses.replace(loop, discovered=found)
    if found is None or not found.refutes(limits):
        return loop
    law = Failed("law", found.gain.gain, limits.gain_nats)
    return dataclasses.replace(loop, verdict="unexplained", failed=(law,), discovered=found)


def _judge(selection: SelectionResult, limits: Thresholds) -> dict[str, Any]:
    """Verdict, errors on the held-out steps, and remainder."""
    best, model, train = selection.best, selection.best.model, selection.best.fitter.train
    values = best.fitted.values
    left = goodness_of_fit(model, values, limits)
    rows, left_out = scored_rows(model, values, ~train)
    after = held_out_errors(model, values, rows, left_out)
    floors, chance = noise_floors_us(model, values, rows), noise_quantiles_us(model, values, rows, limits.chance_p)
    given = given_openings(model, values, rows, limits.chance_p)
    named, before = best is not selection.before, selection.before.fitted.values
    failed = failed_tests(named, left, after, floors, limits, chance, given)
    errors = HeldOutErrors(held_out_errors(model, before, rows, left_out), after, given, *floors)
    return {"verdict": verdict_of(named, failed), "failed": failed, "errors": errors, "remainder": left}


def withdraw_unconfirmed(
    model: ForwardModel, found: SelectionResult, train: Bools, limits: Thresholds
) -> SelectionResult:
    """The selection less the last effects whose small gain the reserved steps contradict."""
    if found.best is found.before:
        return found
    chain = [*(found.earlier or (found.before,)), found.best]
    while len(chain) > 1:
        losses = []  # of each step by a fit that had not seen it: held out in turn, or reserved
        for x in chain[-2:]:
            reserved = np.asarray(sum(step_losses(model, x.whitener, model.residuals(x.fitted.values)).values()))
            losses.append(np.where(train, x.per_step, reserved))
        worse, better = losses
        stands, gain = confirmed_on_reserve(worse, better, train, limits, further=len(chain) > 2)
        if stands:
            break
        last = chain.pop()
        added = tuple(n for n in last.names if n not in chain[-1].names) or last.names
        found = dataclasses.replace(
            found,
            best=chain[-1],
            ties=(chain[-1],) if len(chain) > 1 else (),
            rounds=(*found.rounds, f"the steps held out of the fit do not improve with {' + '.join(added)}: withdrawn"),
            rejected=Rejected(added, gain.gain, gain.error, "the reserved steps do not bear it out"),
            earlier=tuple(chain[:-1]),
        )
    return found


def _notes(observations: Observations, selection: SelectionResult) -> tuple[str, ...]:
    """Remarks on the data, and imperfections of the instruments that are larger than harmless."""
    notes = list(observations.notes)
    values = selection.best.fitted.values
    for (name, q), value in values.items():
        entry = effect(name).effect
        parameter = entry.parameter(q.removesuffix(TREND))
        if entry.nuisance and parameter.calibration and abs(value) > 3.0 * parameter.calibration:
            notes.append(
                f"{name}.{q} = {value:.3g} {parameter.unit}: more than a harmless imperfection ({entry.summary})"
            )
    if math.isinf(float(np.max(observations.weak_mps, initial=0.0))):
        notes.append("the accelerometer shows no impacts: contacts shorter than a sample had to be inferred")
    return tuple(notes)
