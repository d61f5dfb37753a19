"""A joint verdict as JSON; its schema is `docs/reference/schemas/close-loop-runs.json`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from analysis.joint.constancy import OneRun
from analysis.joint.result import JointVerdict, OverRuns, RunOutcome
from daq.files.json_values import json_object


def joint_json(found: JointVerdict) -> dict[str, Any]:
    """Names, numbers and None for what does not exist."""
    return json_object({
        "verdict": found.verdict,
        "effects": list(found.names),
        "tie_set": [list(names) for names in found.ties],
        "odd_runs": [run.recording for run in found.odd],
        "dated": found.dated,
        "passes": found.passes,
        "parameters": [_parameter(x, found.runs) for x in found.parameters],
        "systematics": found.systematics,
        "runs": found.runs,
        "detection_limits": found.detection,
        "candidates": found.candidates,
        "rounds": found.rounds,
    })  # fmt: skip


def _parameter(x: OverRuns, runs: Sequence[RunOutcome]) -> dict[str, Any]:
    test, one = x.constancy, x.one_run
    return {
        "effect": x.effect,
        "parameter": x.parameter,
        "unit": x.unit,
        "kind": x.kind,
        "value": x.value,
        "sigma": x.sigma,
        "spread": x.spread,
        "differs": x.differs,
        "one_run": None if one is None else _one_run(one, runs),
        "chi_square": test.chi_square,
        "degrees": test.degrees,
        "p_constant": test.p,
        "trend_per_day": test.slope,
        "trend_sigma": test.slope_sigma,
        "p_trend": test.p_trend,
        "values": x.values,
        "sigmas": x.sigmas,
    }


def _one_run(x: OneRun, runs: Sequence[RunOutcome]) -> dict[str, Any]:
    recording = runs[x.place].recording
    return {"recording": recording, "others": x.others, "others_sigma": x.others_sigma}
