"""The whole loop: recordings in; residual, missing effect, error before and after, and the verdict out.

The rule kept here: steps held out at the start are looked at once, at the end; "explained" needs a named cause, a
remainder that is noise and held-out events that are missed by noise alone; what is not known is called unexplained.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.attribution.comparison import LogScoreDifference
from analysis.attribution.fit import Fitter
from analysis.attribution.hypothesis import Hypothesis, Rejected, SelectionResult
from analysis.attribution.priors import priors_of
from analysis.attribution.selection import StepwiseSelection
from analysis.discovery.discover import Discovery, discover
from analysis.loop.calibrations import fitted_calibrations
from analysis.loop.verdict import Failed, Verdict, failed_tests, verdict_of
from analysis.residuals.forward_model import TREND, ForwardModel
from analysis.residuals.lack_of_fit import GoodnessOfFit, goodness_of_fit
from analysis.residuals.observations import Observations, observations_from
from analysis.residuals.prediction_errors import (
    Errors,
    held_out_errors,
    noise_floors_us,
    noise_quantiles_us,
    scored_rows,
)
from analysis.residuals.whitening import step_losses
from analysis.thresholds import FROZEN, Thresholds
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from model.effects.registry import effect, registry, resolve, trend_name

Progress = Callable[[str, float], None]

Z95 = 1.96


@dataclass(frozen=True)
class Found:
    """One effect that was added: its name and its parameters as ``(value, low, high)`` with 95 % intervals."""

    name: str
    parameters: Mapping[str, tuple[float, float, float]]


@dataclass(frozen=True)
class ClosedLoop:
    """What closing the loop came to.

    Attributes
    ----------
    verdict
    effects
        What was added, never what was declared nor nuisances.
    discovered
        A smooth term found where no named effect suffices, or None.
    before, after
        Errors on the held-out steps.
    noise_floor_us, takeoff_floor_us
        What measurement noise alone would leave of landings and of take-offs, at the final model, on the same flights.
    held_out
        Numbers of the held-out steps (in the order of the recordings).
    remainder
        What is left after the best explanation.
    detection
        By effect and parameter, the size below which the run could not have shown it.
    not_identifiable
        Effects that this run could not show at any size.
    failed
        Tests that forbid the verdict "explained" or "nothing missing".
    limits
        Thresholds of the verdict.
    """

    verdict: Verdict
    effects: tuple[Found, ...]
    discovered: Discovery | None
    attribution: SelectionResult
    before: Errors
    after: Errors
    noise_floor_us: float
    takeoff_floor_us: float
    held_out: tuple[int, ...]
    remainder: GoodnessOfFit
    detection: Mapping[str, float]
    not_identifiable: tuple[str, ...]
    world: ForwardModel
    notes: tuple[str, ...]
    failed: tuple[Failed, ...] = ()
    limits: Thresholds = FROZEN

    @property
    def rejected(self) -> Rejected | None:
        """The best candidate that was refused, with its gain in nats and the reason; None where none gained anything.

        Of all that was refused although it gained more than what was accepted beside it, the one of greatest gain; or
        what was accepted and then withdrawn because the reserved steps did not bear it out.
        """
        return self.attribution.rejected

    @property
    def best(self) -> Hypothesis:
        """The best set of named effects."""
        return self.attribution.best


def close_loop(
    recordings: Sequence[Path],
    *,
    setup: Setup | None = None,
    limits: Thresholds = FROZEN,
    progress: Progress | None = None,
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

    Raises
    ------
    InputError
        Where a file is no recording, or there is too little in it to hold steps out.
    ValueError
        For declared effects that do not exist or are out of bounds.
    """
    say = progress or (lambda what, part: None)
    evidence = observations_from(
        recordings, setup=setup, progress=lambda name, part: say(f"reading {name}", 0.15 * part)
    )
    if len(evidence.steps) < 2 * limits.reserve_every or not len(evidence.plate):
        raise InputError(
            f"{', '.join(p.name for p in recordings)}: wanted at least {2 * limits.reserve_every} steps whose plate "
            f"motion can be measured, found {len(evidence.steps)}; record a ramp of more steps or pass more recordings"
        )
    world = ForwardModel(evidence, resolve(evidence.setup.declared_values()))
    train = np.arange(len(evidence.steps)) % limits.reserve_every != limits.reserve_every // 2
    fitter = Fitter(world, priors_of(evidence.setup), train)
    selection = StepwiseSelection(world, fitter, limits, lambda what, part: say(f"trying {what}", 0.15 + 0.7 * part))
    attribution = _borne_out(world, selection.run(), train, limits)
    best = attribution.best
    say("what remains", 0.87)
    left = goodness_of_fit(world, best.fitted.values, limits)
    rows, out = scored_rows(world, best.fitted.values, ~train)
    after, floors = (
        held_out_errors(world, best.fitted.values, rows, out),
        noise_floors_us(world, best.fitted.values, rows),
    )
    named, chance = best is not attribution.before, noise_quantiles_us(world, best.fitted.values, rows, limits.chance_p)
    verdict = verdict_of(named, left, after, floors, limits, chance)
    found = discover(world, fitter, best, limits) if verdict == "unexplained" else None
    say("detection limits", 0.97)
    detection, blind = detection_limits(attribution, limits)
    return ClosedLoop(
        verdict,
        tuple(_found(best)),
        found,
        attribution,
        held_out_errors(world, attribution.before.fitted.values, rows, out),
        after,
        *floors,
        tuple(int(n) for n in evidence.steps.number[~train]),
        left,
        detection,
        blind,
        world,
        _notes(evidence, attribution),
        failed_tests(named, left, after, floors, limits, chance),
        limits,
    )


def _borne_out(
    world: ForwardModel, found: SelectionResult, train: NDArray[np.bool_], limits: Thresholds
) -> SelectionResult:
    """What was found, less the last causes where the reserved steps speak against a gain that was small."""
    if found.best is found.before:
        return found
    chain = [*(found.earlier or (found.before,)), found.best]
    while len(chain) > 1:
        worse, better = (_all_steps(world, x, train) for x in chain[-2:])
        gain = LogScoreDifference.of(worse, better, np.ones_like(train))
        stands = gain.exceeds(limits.next_effect_nats, limits.next_effect_sigmas)
        if len(chain) > 2:  # of a further cause more is asked: the best of many gains by chance
            stands = stands and gain.gain > limits.reserve_factor * limits.next_effect_nats
        if stands or LogScoreDifference.of(worse, better, ~train).clipped > 0.0:
            break
        last = chain.pop()
        added = " + ".join(n for n in last.names if n not in chain[-1].names) or " + ".join(last.names)
        rejected = Rejected(tuple(added.split(" + ")), gain.gain, gain.error, "the reserved steps do not bear it out")
        said = f"the reserved steps do not bear out {added}: withdrawn"
        ties = (chain[-1],) if len(chain) > 1 else ()
        found = dataclasses.replace(
            found, best=chain[-1], ties=ties, rounds=(*found.rounds, said), rejected=rejected, earlier=tuple(chain[:-1])
        )
    return found


def _all_steps(world: ForwardModel, x: Hypothesis, train: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Loss of each step that the fit had not seen: held out in turn, or reserved."""
    reserved = np.asarray(sum(step_losses(world, x.whitener, world.residuals(x.fitted.values)).values()))
    return np.where(train, x.per_step, reserved)


def _found(best: Hypothesis) -> list[Found]:
    """Each added effect with its parameters and 95 % intervals."""
    tables: dict[str, dict[str, tuple[float, float, float]]] = {name: {} for name in best.names}
    fitted = best.fitted
    for key in best.free:
        name, q = key
        value, spread = fitted.values[key], Z95 * fitted.sigma(key)
        if q.endswith(TREND):
            bare = q.removesuffix(TREND)
            middle = fitted.values.get((name, bare), 0.0)
            size = abs(middle) if middle else 1.0
            change = "relative_change" if middle else "change"
            tables.setdefault(trend_name(), {})[f"{name}.{bare}_{change}"] = (
                value / size,
                (value - spread) / size,
                (value + spread) / size,
            )
            continue
        bounds = effect(name).effect.parameter(q)
        tables.setdefault(name, {})[q] = (value, max(value - spread, bounds.low), min(value + spread, bounds.high))
    return [Found(name, table) for name, table in tables.items()]


def detection_limits(attribution: SelectionResult, limits: Thresholds) -> tuple[dict[str, float], tuple[str, ...]]:
    """By ``effect.parameter``, the size below which this run could not have shown it; and what no size would show.

    From the derivatives at the best explanation, calibrations and nuisances free: the size that gains the threshold.
    """
    best = attribution.best.fitted
    sizes: dict[str, float] = {}
    blind: list[str] = []
    for entry in registry():
        e = entry.effect
        if e.nuisance or not e.library or not entry.hooks:
            continue
        shown = []
        for q in e.parameters:
            key = (e.name, q.name)
            if q.is_shape or key in best.free:
                continue
            size = best.fitter.detectable(best, key, limits.gain_nats)
            if size < q.high - q.low:
                shown.append(q.name)
                sizes[f"{e.name}.{q.name}"] = size
        if not shown and not any(k[0] == e.name for k in best.free):
            blind.append(e.name)
    return sizes, tuple(blind)


def _notes(evidence: Observations, attribution: SelectionResult) -> tuple[str, ...]:
    notes = list(evidence.notes)
    values = attribution.best.fitted.values
    for (name, q), value in values.items():
        entry = effect(name).effect
        parameter = entry.parameter(q.removesuffix(TREND))
        if entry.nuisance and parameter.calibration and abs(value) > 3.0 * parameter.calibration:
            notes.append(
                f"{name}.{q} = {value:.3g} {parameter.unit}: more than a harmless imperfection ({entry.summary})"
            )
    if math.isinf(float(np.max(evidence.weak_mps, initial=0.0))):
        notes.append("the accelerometer shows no impacts: contacts shorter than a sample had to be inferred")
    return tuple(notes)


def as_json(loop: ClosedLoop, next_run: dict[str, object] | None = None) -> dict[str, Any]:
    """The verdict for a machine; what does not exist is null. ``next_run``: see `analysis.loop.design.as_json`."""

    def plain(errors: Errors) -> dict[str, Any]:
        return {k: _finite(v) for k, v in dataclasses.asdict(errors).items()}

    return {
        "verdict": loop.verdict,
        "effects": [
            {
                "name": f.name,
                "parameters": {
                    k: {"value": _finite(v), "low": _finite(lo), "high": _finite(hi)}
                    for k, (v, lo, hi) in f.parameters.items()
                },
            }
            for f in loop.effects
        ],
        "discovered": [] if loop.discovered is None else [loop.discovered.as_json()],
        "tie_set": [list(x.names) for x in loop.attribution.ties],
        "before": plain(loop.before),
        "after": plain(loop.after),
        "noise_floor_us": _finite(loop.noise_floor_us),
        "takeoff_floor_us": _finite(loop.takeoff_floor_us),
        "held_out_steps": list(loop.held_out),
        "remainder": {
            "p_lack_of_fit": _finite(loop.remainder.p_lack_of_fit),
            "covariate": loop.remainder.covariate,
            "ratio": _finite(loop.remainder.ratio),
            "plate_rms_z": _finite(loop.remainder.plate_rms_z),
        },
        "next_run": next_run,
        "detection_limits": {k: _finite(v) for k, v in loop.detection.items()},
        "not_identifiable": list(loop.not_identifiable),
        "candidates": [
            {"names": list(names), "gain_nats": _finite(c.gain), "standard_error": _finite(c.error)}
            for names, c in sorted(loop.attribution.tried, key=lambda t: -t[1].gain)
        ],
        "rejected": _rejected(loop.rejected),
        "failed_tests": [
            {"test": f.test, "found": _finite(f.found), "allowed": _finite(f.allowed)} for f in loop.failed
        ],
        "rounds": list(loop.attribution.rounds),
        "nuisances": {
            f"{n}.{q}": _finite(v) for (n, q), v in loop.best.fitted.values.items() if (n, q) not in loop.best.free
        },
        "calibrations": [
            {k: x if isinstance(x, str) else _finite(x) for k, x in dataclasses.asdict(c).items()}
            for c in fitted_calibrations(loop.best)
        ],
        "notes": list(loop.notes),
        "flights": len(loop.world.evidence),
        "sources": list(loop.world.evidence.sources),
    }


def _rejected(x: Rejected | None) -> dict[str, Any] | None:
    if x is None:
        return None
    gains = {"gain_nats": _finite(x.gain), "standard_error": _finite(x.error)}
    return {"names": list(x.names), **gains, "reason": x.reason}


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def declared_after(loop: ClosedLoop) -> dict[str, dict[str, float]]:
    """Declared and added effects together, for the next prediction."""
    out = {name: dict(table) for name, table in resolve(loop.world.evidence.setup.declared_values()).items()}
    for name, q in loop.best.free:
        if not q.endswith(TREND):
            out.setdefault(name, {})[q] = loop.best.fitted.values[name, q]
    return out
