"""A joint verdict as JSON; its schema is `docs/reference/schemas/close-loop-runs.json`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from analysis.joint.constancy import OneRun
from analysis.joint.result import JointVerdict, OverRuns, RunOutcome


def as_json(found: JointVerdict) -> dict[str, Any]:
    """Names, numbers and None for what does not exist."""
    return {
        "verdict": found.verdict,
        "effects": list(found.names),
        "tie_set": [list(names) for names in found.ties],
        "odd_runs": [run.recording for run in found.odd],
        "dated": found.dated,
        "passes": found.passes,
        "parameters": [_parameter(x, found.runs) for x in found.parameters],
        "systematics": [_row(asdict(x)) for x in found.systematics],
        "runs": [_row(asdict(run)) for run in found.runs],
        "detection_limits": {name: _finite(size) for name, size in found.detection.items()},
        "candidates": [_row(asdict(x)) for x in found.candidates],
        "rounds": list(found.rounds),
    }


def _parameter(x: OverRuns, runs: Sequence[RunOutcome]) -> dict[str, Any]:
    test, one = x.constancy, x.one_run
    return {
        "effect": x.effect,
        "parameter": x.parameter,
        "unit": x.unit,
        "kind": x.kind,
        "value": _finite(x.value),
        "sigma": _finite(x.sigma),
        "spread": _finite(x.spread),
        "differs": x.differs,
        "one_run": None if one is None else _one_run(one, runs),
        "chi_square": _finite(test.chi_square),
        "degrees": test.degrees,
        "p_constant": _finite(test.p),
        "trend_per_day": _finite(test.slope),
        "trend_sigma": _finite(test.slope_sigma),
        "p_trend": _finite(test.p_trend),
        "values": [_finite(v) for v in x.values],
        "sigmas": [_finite(v) for v in x.sigmas],
    }


def _one_run(x: OneRun, runs: Sequence[RunOutcome]) -> dict[str, Any]:
    recording = runs[x.place].recording
    return {"recording": recording, "others": _finite(x.others), "others_sigma": _finite(x.others_sigma)}


def _row(record: dict[str, Any]) -> dict[str, Any]:
    return {
        k: _finite(v) if isinstance(v, float) else list(v) if isinstance(v, tuple) else v for k, v in record.items()
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
