"""The verdict for programs: JSON of a closed loop, null for what does not exist."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from analysis.attribution.hypothesis import Rejected
from analysis.discovery.discover import Discovery
from analysis.discovery.symbolic import FittedForm
from analysis.loop.kept_term import KeptTerm
from analysis.loop.result import AddedEffect, ClosedLoop


def as_json(
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
    return {
        "verdict": loop.verdict,
        "effects": [_effect(e) for e in loop.effects],
        "discovered": [] if loop.discovered is None else [_discovery(loop.discovered)],
        "kept": None if kept is None else _kept(kept),
        "tie_set": [list(names) for names in loop.ties],
        "before": _row(loop.before),
        "after": _row(loop.after),
        "given_openings": _row(loop.given_openings),
        "noise_floor_us": _finite(loop.noise_floor_us),
        "takeoff_floor_us": _finite(loop.takeoff_floor_us),
        "held_out_steps": list(loop.held_out),
        "remainder": {
            "p_lack_of_fit": _finite(loop.remainder.p_lack_of_fit),
            "covariate": loop.remainder.covariate,
            "rms_standardised_residual": _finite(loop.remainder.ratio),
            "plate_rms_z": _finite(loop.remainder.plate_rms_z),
        },
        "next_run": next_run,
        "detection_limits": {k: _finite(v) for k, v in loop.detection.items()},
        "not_identifiable": list(loop.not_identifiable),
        "candidates": [
            {"names": list(c.names), "gain_nats": _finite(c.gain), "standard_error": _finite(c.error)}
            for c in sorted(loop.candidates, key=lambda c: -c.gain)
        ],
        "rejected": rejected_json(loop.rejected),
        "chance": [
            {
                "names": list(x.names),
                "gain_nats": _finite(x.gain),
                "p": x.p,
                "critical_nats": _finite(x.critical),
                "accepted": x.accepted,
            }
            for x in loop.chance
        ],
        "failed_tests": [_row(f) for f in loop.failed],
        "rounds": list(loop.rounds),
        "nuisances": {f"{p.effect}.{p.parameter}": _finite(p.value) for p in loop.parameters if not p.added},
        "calibrations": [_row(c) for c in loop.calibrations],
        "notes": list(loop.notes),
        "flights": len(loop.flights),
        "sources": list(loop.paths),
        "source_ids": [source.identity for source in loop.sources],
    }


def rejected_json(x: Rejected | None) -> dict[str, Any] | None:
    """The best refused candidate, or None."""
    if x is None:
        return None
    gains = {"gain_nats": _finite(x.gain), "standard_error": _finite(x.error)}
    return {"names": list(x.names), **gains, "reason": x.reason}


def _effect(e: AddedEffect) -> dict[str, Any]:
    intervals = {
        k: {"value": _finite(v), "low": _finite(lo), "high": _finite(hi)} for k, (v, lo, hi) in e.parameters.items()
    }
    return {"name": e.name, "parameters": intervals}


def _kept(kept: KeptTerm) -> dict[str, Any]:
    return {
        "name": kept.name,
        "file": kept.file,
        "form": kept.form or None,
        "verdict": kept.verdict,
        "effects": [_effect(e) for e in kept.effects],
        "before": _row(kept.before),
        "after": _row(kept.after),
        "noise_floor_us": _finite(kept.noise_floor_us),
    }


def _form(form: FittedForm) -> dict[str, Any]:
    rows = zip(form.parameters, form.values, form.sigmas, form.units, strict=True)
    return {
        "name": form.name,
        "expression": form.expression,
        "parameters": {n: {"value": _finite(v), "sigma": _finite(s), "unit": unit} for n, v, s, unit in rows},
        "loss_nats": _finite(form.loss),
        "standard_error": _finite(form.error),
        "as_good": form.as_good,
    }


def _discovery(found: Discovery) -> dict[str, Any]:
    return {
        "term": found.term,
        "covariate": found.covariate,
        "description": found.description,
        "unit": found.term_unit,
        "covariate_unit": found.unit,
        "knots": (found.scale * found.knots).tolist(),
        "values": found.values.tolist(),
        "low": found.low.tolist(),
        "high": found.high.tolist(),
        "similar_effects": [name for name, _ in found.similar_effects],
        "tied_covariates": list(found.tied_covariates),
        "forms": [_form(form) for form in found.forms],
        "suggested_form": found.suggested or None,
    }


def _row(record: Any) -> dict[str, Any]:
    """A flat record of names and numbers."""
    return {k: x if isinstance(x, str) else _finite(x) for k, x in dataclasses.asdict(record).items()}


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
