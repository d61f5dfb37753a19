"""Tables of a closed loop (steps, flights, plate data, parameters with intervals), and its JSON, null for what is not.

Calibrations are free in every fit, within their stated uncertainty, so that no effect is named for what they explain.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from analysis.attribution.candidates import Candidate, Point, null_value_of, parameter_of
from analysis.attribution.fit import Fitted
from analysis.attribution.hypothesis import Hypothesis, Refits, Rejected, Scatter, remaining_candidates
from analysis.attribution.rebound_scatter import SCATTER
from analysis.attribution.selection import SelectionResult
from analysis.discovery.discover import Discovery
from analysis.discovery.symbolic import FittedForm
from analysis.loop.result import (
    AddedEffect,
    Calibration,
    ClosedLoop,
    FittedParameter,
    FlightTable,
    Predictions,
    Selection,
    Source,
    StepTable,
    TestedCandidate,
)
from analysis.loop.term_effect import TermEffect
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.uncertainty import uncertainty_at
from analysis.residuals.values import TREND, ParameterId, Values
from analysis.statistics import Z95
from analysis.thresholds import Thresholds
from daq.files.json_values import json_object
from daq.recording import open_recording
from daq.recording.header import stored_id
from kernels.arrays import Bools
from model.effects.registry import effect


def step_table(model: ForwardModel, train: Bools) -> StepTable:
    """Steps of the observations; those outside ``train`` (m,) are held out."""
    steps = model.observations.steps
    return StepTable(steps.recording, steps.number, steps.gamma, steps.ratio, steps.plate.period_s, ~train)


def flight_table(model: ForwardModel, before: Values, after: Values) -> FlightTable:
    """Flights with the predictions at the fitted values ``before`` and ``after``."""
    observations = model.observations
    first = _predictions(model, before)
    second, measured = first if after == before else _predictions(model, after), observations.measured
    return FlightTable(
        measured.step, measured.opening_s, measured.landing_s, observations.scored, model.from_rest, first, second,
        model.covariates(after),
    )  # fmt: skip


def _predictions(model: ForwardModel, values: Values) -> Predictions:
    r, u = model.residuals(values), uncertainty_at(model, values)
    predicted = r.predicted.opening_s, r.predicted.landing_s
    return Predictions(*predicted, r.opening_s, r.landing_s, u.opening_total_s, u.landing_total_s)


def source_of(path: Path) -> Source:
    """Provenance of a recording: date, rig, note and software."""
    with open_recording(path) as opened:
        setup, attrs = opened.setup, opened.attrs
        rig = f"{setup.name} ({setup.description})" if setup.description else setup.name
        note, version, commit = (str(attrs.get(key, "")) for key in ("note", "software_version", "software_commit"))
        started, backend = str(attrs.get("started", "")), str(attrs.get("backend", ""))
        simulated = bool(attrs.get("simulated", False))
        return Source(path.name, rig, started, backend, simulated, note, version, commit, stored_id(opened), str(path))


def fitted_parameters(
    best: Hypothesis, scatter: Scatter | None = None, beyond: Mapping[ParameterId, tuple[float, float]] | None = None
) -> tuple[FittedParameter, ...]:
    """Every parameter that the best hypothesis fits: those of the added effects first, in the order added.

    A ``scatter`` of the restitution is the last of these; ``beyond`` is what other forms add to intervals.

    The standard deviation of an added one has what ordinary instruments add of it (`Parameter.ordinary`).
    """
    fitted, values = best.fitted, best.fitted.values

    def one(key: ParameterId, added: bool) -> FittedParameter:
        name, q = key
        plain, sigma = q.removesuffix(TREND), float(fitted.sigma(key))
        if added and plain == q:
            sigma = math.hypot(sigma, effect(name).effect.parameter(plain).ordinary)
        return FittedParameter(
            name, plain, float(values[key]), sigma, added, q.endswith(TREND), (beyond or {}).get(key, (0.0, 0.0))
        )

    noise = () if scatter is None else (FittedParameter(*SCATTER, scatter.sd, scatter.sigma, True, False),)
    return (*(one(k, True) for k in best.free), *noise, *(one(k, False) for k in values if k not in best.free))


def added_effects(names: Sequence[str], parameters: Sequence[FittedParameter]) -> tuple[AddedEffect, ...]:
    """Each added effect with its parameters and 95 % intervals.

    A trend is named ``parameter_drift``, and given relative to its parameter's middle, or as it is where that is zero.
    """
    tables: dict[str, dict[str, tuple[float, float, float]]] = {name: {} for name in names}
    middles = {(p.effect, p.parameter): p.value for p in parameters if not p.trend}
    for p in (p for p in parameters if p.added):
        low, high = p.value - Z95 * p.sigma - p.beyond[0], p.value + Z95 * p.sigma + p.beyond[1]
        if p.trend:
            middle = middles.get((p.effect, p.parameter), 0.0)
            size = abs(middle) if middle else 1.0
            change = "relative_change" if middle else "change"
            drift = (p.value / size, low / size, high / size)
            tables.setdefault("parameter_drift", {})[f"{p.effect}.{p.parameter}_{change}"] = drift
            continue
        bounds = effect(p.effect).effect.parameter(p.parameter)
        tables.setdefault(p.effect, {})[p.parameter] = (p.value, max(low, bounds.low), min(high, bounds.high))
    return tuple(AddedEffect(name, table) for name, table in tables.items())


def selected(found: SelectionResult, library: Sequence[Candidate], limits: Thresholds) -> Selection:
    """Outcome of the selection among a ``library`` as names and numbers."""
    best = found.best
    beyond = beyond_own_form(best, remaining_candidates(library, best), limits)
    parameters = fitted_parameters(best, found.scatter, beyond)
    return Selection(
        effects=added_effects(best.names, parameters),
        names=best.names,
        ties=tuple(x.names for x in found.ties),
        parameters=parameters,
        calibrations=tuple(
            Calibration(*key, float(best.fitted.values[key]), best.fitted.sigma(key), prior.mean, prior.sigma)
            for key, prior in sorted(best.fitted.fitter.priors.items())
            if key in best.fitted.keys and key not in best.free
        ),
        candidates=tuple(TestedCandidate(names, c.gain, c.error) for names, c in found.tried),
        rounds=found.rounds,
        rejected=found.rejected,
        chance=found.chance,
    )


Form = tuple[float, dict[ParameterId, tuple[float, float]]]  # its weight over that of the named one; values and sigmas


def beyond_own_form(
    best: Hypothesis, others: Sequence[Candidate], limits: Thresholds
) -> dict[ParameterId, tuple[float, float]]:
    """How much farther than its own form says the interval of each free parameter reaches, below and above.

    A simpler form is named until a fuller one is better beyond doubt, and one cause until a second one is. What such a
    form that was not named would make of a value belongs into its interval all the same, by the evidence for it: the
    interval is that of the mixture of all (Bayesian model averaging; Hoeting, Madigan, Raftery and Volinsky, Stat. Sci.
    14, 382, 1999), so that no threshold decides. Decision 720.

    ``others`` are fuller forms of the effects of the ``best`` hypothesis, and what else could be added.

    A form has the weight of its likelihood less what a tie allows (`Thresholds.tie_nats`, about half the logarithm of
    the number of events, as in Schwarz's criterion), shared among all other causes. Fuller forms are fitted, as their
    shapes are no linear matter; of other causes the linear gain counts.
    """
    sizes = {k: (best.fitted.values[k], best.fitted.sigma(k)) for k in best.free if not parameter_of(k).is_shape}
    fuller = [c for c in others if any(x.names == c.names and set(x.free) < set(c.free) for x in best.candidates)]
    rest = [c for c in others if c not in fuller]
    cost, attempted = limits.tie_nats + math.log(max(len(rest), 1)), Refits(best.fitter).attempted
    forms = [form for c in fuller for form in attempted((c,), _fitted_form, best, c, limits) or ()]
    forms += [form for c in rest for form in attempted((c,), _linear_form, best, c, cost) or ()]
    out = {}
    for key, (value, sigma) in sizes.items():
        parts = [(1.0, value, sigma), *((weight, *table[key]) for weight, table in forms if key in table)]
        low, high = _interval(parts)
        out[key] = max(value - Z95 * sigma - low, 0.0), max(high - value - Z95 * sigma, 0.0)
    return out


def _fitted_form(best: Hypothesis, c: Candidate, limits: Thresholds) -> list[Form]:
    """A fuller form of one of the effects, fitted from where its shapes may begin; nothing where none is finite."""
    own, refits = next(x for x in best.candidates if x.names == c.names), Refits(best.fitter)
    extra = tuple(k for k in c.free if k not in best.free)
    # by the new shape an effect of no size changes nothing: such a size begins elsewhere
    begins = {
        k for k in (*own.free, *extra) if parameter_of(k).is_shape or (k in own.free and not best.fitted.differs((k,)))
    }
    starts: dict[tuple[float, ...], tuple[float, Point]] = {}
    for point in {tuple((k, v) for k, v in s.items() if k in begins): None for s in c.starts or ({},)}:
        shapes = {k: v for k, v in point if k in extra}
        led = {**best.fitter.linear_step(best.fitted, extra, shapes)[1], **dict(point)}
        loss = refits.profile_loss(best.whitener, led)
        at = tuple(shapes.values())
        if at not in starts or loss < starts[at][0]:
            starts[at] = loss, led
    found = list[tuple[float, Fitted]]()
    for _, start in sorted(starts.values(), key=lambda pair: pair[0])[:4]:
        x = refits.attempted((c,), best.fitter.fit, best.whitener, (*best.free, *extra), start)
        if x is not None:
            found.append((refits.profile_loss(best.whitener, x.values) + x.prior_penalty, x))
    if not found:
        return []
    loss, x = min(found, key=lambda pair: pair[0])
    gain = min(best.level + best.fitted.prior_penalty - loss, 500.0)
    return [(math.exp(gain - limits.tie_nats), {k: (x.values[k], x.sigma(k)) for k in best.free})]


def _linear_form(best: Hypothesis, c: Candidate, cost: float) -> list[Form]:
    """What another cause would make of the values, by each shape that it may have, were residuals linear in it."""
    free = tuple(k for k in c.free if k not in best.free)
    shapes = [k for k in free if parameter_of(k).is_shape]
    settings = dict.fromkeys(tuple(s.get(k, null_value_of(k)) for k in shapes) for s in c.starts or ({},))
    out = []
    for at in settings if len(shapes) < len(free) else ():
        gain, values = best.fitter.linear_step(best.fitted, free, dict(zip(shapes, at, strict=True)))
        if not 0.0 < gain < math.inf:
            continue
        table = {}
        for k in best.free:
            moved = values[k] - best.fitted.values[k]
            # another parameter takes from the knowledge of a value what it moves it by, over its own significance
            table[k] = values[k], math.hypot(best.fitted.sigma(k), moved / math.sqrt(2.0 * gain))
        out.append((math.exp(min(gain, 700.0) - cost) / len(settings), table))
    return out


def _interval(parts: Sequence[tuple[float, float, float]]) -> tuple[float, float]:
    """Ends of the central 95 % of a mixture of normal parts: weight, value and standard deviation each."""
    weight, value, sigma = np.array(parts).T
    weight, sigma = weight / weight.sum(), np.maximum(sigma, 1e-12 * np.abs(value) + 1e-300)
    low, high = float(np.min(value - 5.0 * sigma)), float(np.max(value + 5.0 * sigma))

    def end(p: float) -> float:
        return float(brentq(lambda x: float(weight @ ndtr((x - value) / sigma)) - p, low, high))

    return end(0.025), end(0.975)


def loop_json(
    loop: ClosedLoop, next_run: dict[str, object] | None = None, term_effect: TermEffect | None = None
) -> dict[str, Any]:
    """The verdict as JSON values.

    Parameters
    ----------
    loop
        The closed loop.
    next_run
        Ranked next runs, see `analysis.loop.design.ranking_json`.
    term_effect
        The discovered term as an effect.
    """
    return json_object({
        "verdict": loop.verdict,
        "effects": [_effect(e) for e in loop.selection.effects],
        "discovered": [] if loop.discovered is None else [_discovery(loop.discovered)],
        "kept": None if term_effect is None else _term_effect(term_effect),
        "tie_set": loop.selection.ties,
        "before": loop.errors.before,
        "after": loop.errors.after,
        "given_openings": loop.errors.given_openings,
        "noise_floor_us": loop.errors.landing_floor_us,
        "takeoff_floor_us": loop.errors.takeoff_floor_us,
        "held_out_steps": loop.held_out,
        "remainder": {
            "p_lack_of_fit": loop.remainder.p_lack_of_fit,
            "covariate": loop.remainder.covariate,
            "rms_standardised_residual": loop.remainder.ratio,
            "plate_rms_z": loop.remainder.plate_rms_z,
        },
        "next_run": next_run,
        "detection_limits": loop.detection.sizes,
        "not_identifiable": loop.detection.at_no_size,
        "candidates": [
            {"names": c.names, "gain_nats": c.gain, "standard_error": c.error}
            for c in sorted(loop.selection.candidates, key=lambda c: -c.gain)
        ],
        "rejected": rejected_json(loop.selection.rejected),
        "chance": [
            {"names": x.names, "gain_nats": x.gain, "p": x.p, "critical_nats": x.critical, "accepted": x.accepted}
            for x in loop.selection.chance
        ],
        "failed_tests": loop.failed,
        "rounds": loop.selection.rounds,
        "nuisances": {f"{p.effect}.{p.parameter}": p.value for p in loop.selection.parameters if not p.added},
        "calibrations": loop.selection.calibrations,
        "notes": loop.notes,
        "flights": len(loop.flights),
        "sources": [source.path for source in loop.sources],
        "source_ids": [source.identity for source in loop.sources],
    })  # fmt: skip


def rejected_json(x: Rejected | None) -> dict[str, Any] | None:
    """The best refused candidate, or None."""
    if x is None:
        return None
    return json_object({"names": x.names, "gain_nats": x.gain, "standard_error": x.error, "reason": x.reason})


def _effect(e: AddedEffect) -> dict[str, Any]:
    intervals = {k: {"value": v, "low": lo, "high": hi} for k, (v, lo, hi) in e.parameters.items()}
    return {"name": e.name, "parameters": intervals}


def _term_effect(term_effect: TermEffect) -> dict[str, Any]:
    own = {name: value for name, value in vars(term_effect).items() if name != "words"}
    return own | {"form": term_effect.form or None, "effects": [_effect(e) for e in term_effect.effects]}


def _form(form: FittedForm) -> dict[str, Any]:
    rows = zip(form.parameters, form.values, form.sigmas, form.units, strict=True)
    return {
        "name": form.name,
        "expression": form.expression,
        "parameters": {n: {"value": v, "sigma": s, "unit": unit} for n, v, s, unit in rows},
        "loss_nats": form.loss,
        "standard_error": form.error,
        "as_good": form.as_good,
    }


def _discovery(found: Discovery) -> dict[str, Any]:
    return {
        "term": found.term,
        "covariate": found.covariate.words,
        "description": found.description,
        "unit": found.curve.unit,
        "covariate_unit": found.covariate.unit,
        "knots": found.covariate.scale * found.curve.knots,
        "values": found.curve.values,
        "low": found.curve.low,
        "high": found.curve.high,
        "similar_effects": [name for name, _ in found.similar_effects],
        "tied_covariates": found.tied_covariates,
        "forms": [_form(form) for form in found.forms],
        "suggested_form": found.suggested or None,
        "instead_of": found.instead_of,
        "after_us": found.after.landing_rms_us,
        "noise_floor_us": found.noise_floor_us,
    }
