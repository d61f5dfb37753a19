"""The verdict for programs: JSON of a closed loop, null for what does not exist."""

from __future__ import annotations

from typing import Any

from analysis.attribution.hypothesis import Rejected
from analysis.discovery.discover import Discovery
from analysis.discovery.symbolic import FittedForm
from analysis.loop.result import AddedEffect, ClosedLoop
from analysis.loop.term_effect import TermEffect
from daq.files.json_values import json_object


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
            {
                "names": x.names,
                "gain_nats": x.gain,
                "p": x.p,
                "critical_nats": x.critical,
                "accepted": x.accepted,
            }
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
