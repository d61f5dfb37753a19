"""The verdict for programs: JSON of a closed loop, null for what does not exist."""

from __future__ import annotations

from typing import Any

from analysis.attribution.hypothesis import Rejected
from analysis.discovery.discover import Discovery
from analysis.discovery.symbolic import FittedForm
from analysis.loop.kept_term import KeptTerm
from analysis.loop.result import AddedEffect, ClosedLoop
from daq.files.json_values import json_object


def loop_json(
    loop: ClosedLoop, next_run: dict[str, object] | None = None, kept: KeptTerm | None = None
) -> dict[str, Any]:
    """The verdict as JSON values.

    Parameters
    ----------
    loop
        The closed loop.
    next_run
        Ranked next runs, see `analysis.loop.design.ranking_json`.
    kept
        The discovered term as a kept effect.
    """
    return json_object({
        "verdict": loop.verdict,
        "effects": [_effect(e) for e in loop.effects],
        "discovered": [] if loop.discovered is None else [_discovery(loop.discovered)],
        "kept": None if kept is None else _kept(kept),
        "tie_set": loop.ties,
        "before": loop.before,
        "after": loop.after,
        "given_openings": loop.given_openings,
        "noise_floor_us": loop.noise_floor_us,
        "takeoff_floor_us": loop.takeoff_floor_us,
        "held_out_steps": loop.held_out,
        "remainder": {
            "p_lack_of_fit": loop.remainder.p_lack_of_fit,
            "covariate": loop.remainder.covariate,
            "rms_standardised_residual": loop.remainder.ratio,
            "plate_rms_z": loop.remainder.plate_rms_z,
        },
        "next_run": next_run,
        "detection_limits": loop.detection,
        "not_identifiable": loop.not_identifiable,
        "candidates": [
            {"names": c.names, "gain_nats": c.gain, "standard_error": c.error}
            for c in sorted(loop.candidates, key=lambda c: -c.gain)
        ],
        "rejected": rejected_json(loop.rejected),
        "chance": [
            {
                "names": x.names,
                "gain_nats": x.gain,
                "p": x.p,
                "critical_nats": x.critical,
                "accepted": x.accepted,
            }
            for x in loop.chance
        ],
        "failed_tests": loop.failed,
        "rounds": loop.rounds,
        "nuisances": {f"{p.effect}.{p.parameter}": p.value for p in loop.parameters if not p.added},
        "calibrations": loop.calibrations,
        "notes": loop.notes,
        "flights": len(loop.flights),
        "sources": loop.paths,
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


def _kept(kept: KeptTerm) -> dict[str, Any]:
    return {
        "name": kept.name,
        "file": kept.file,
        "form": kept.form or None,
        "verdict": kept.verdict,
        "effects": [_effect(e) for e in kept.effects],
        "before": kept.before,
        "after": kept.after,
        "noise_floor_us": kept.noise_floor_us,
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
        "covariate": found.covariate,
        "description": found.description,
        "unit": found.term_unit,
        "covariate_unit": found.unit,
        "knots": found.scale * found.knots,
        "values": found.values,
        "low": found.low,
        "high": found.high,
        "similar_effects": [name for name, _ in found.similar_effects],
        "tied_covariates": found.tied_covariates,
        "forms": [_form(form) for form in found.forms],
        "suggested_form": found.suggested or None,
    }
