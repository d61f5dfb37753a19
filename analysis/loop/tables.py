"""Tables of a closed loop (steps, flights, plate data, parameters with intervals), and its JSON, null for what is not.

Calibrations are free in every fit, within their stated uncertainty, so that no effect is named for what they explain.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from analysis.attribution.hypothesis import Hypothesis, Rejected, Scatter
from analysis.attribution.rebound_scatter import SCATTER
from analysis.discovery.discover import Discovery
from analysis.discovery.symbolic import FittedForm
from analysis.loop.result import (
    AddedEffect,
    ClosedLoop,
    FittedParameter,
    FlightTable,
    Predictions,
    Source,
    StepTable,
)
from analysis.loop.term_effect import TermEffect
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.uncertainty import uncertainty_at
from analysis.residuals.values import TREND, ParameterId, Values
from analysis.statistics import Z95
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
    return FlightTable(
        observations.measured.step,
        observations.measured.opening_s,
        observations.measured.landing_s,
        observations.scored,
        model.from_rest,
        first,
        first if after == before else _predictions(model, after),
        model.covariates(after),
    )


def _predictions(model: ForwardModel, values: Values) -> Predictions:
    r, u = model.residuals(values), uncertainty_at(model, values)
    return Predictions(
        r.predicted.opening_s,
        r.predicted.landing_s,
        r.opening_s,
        r.landing_s,
        u.opening_total_s,
        u.landing_total_s,
    )


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
    """Each added effect with its parameters and 95 % intervals; a trend is named ``parameter_drift``.

    Parameters
    ----------
    names
        Effects of the best hypothesis.
    parameters
        All that it fits. A trend is given relative to its parameter's middle, or as it is where that is zero.
    """
    tables: dict[str, dict[str, tuple[float, float, float]]] = {name: {} for name in names}
    middles = {(p.effect, p.parameter): p.value for p in parameters if not p.trend}
    for p in (p for p in parameters if p.added):
        low, high = p.value - Z95 * p.sigma - p.beyond[0], p.value + Z95 * p.sigma + p.beyond[1]
        if p.trend:
            middle = middles.get((p.effect, p.parameter), 0.0)
            size = abs(middle) if middle else 1.0
            change = "relative_change" if middle else "change"
            tables.setdefault("parameter_drift", {})[f"{p.effect}.{p.parameter}_{change}"] = (
                p.value / size,
                low / size,
                high / size,
            )
            continue
        bounds = effect(p.effect).effect.parameter(p.parameter)
        interval = (p.value, max(low, bounds.low), min(high, bounds.high))
        tables.setdefault(p.effect, {})[p.parameter] = interval
    return tuple(AddedEffect(name, table) for name, table in tables.items())


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
    return {
        "name": term_effect.name,
        "file": term_effect.file,
        "form": term_effect.form or None,
        "verdict": term_effect.verdict,
        "effects": [_effect(e) for e in term_effect.effects],
        "before": term_effect.before,
        "after": term_effect.after,
        "noise_floor_us": term_effect.noise_floor_us,
    }


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
