"""Result of a joint verdict over many runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from analysis.joint.population import Constancy, OneRun
from analysis.loop.verdict import Verdict
from daq.files.json_values import json_object


@dataclass(frozen=True)
class RunOutcome:
    """How one run fits."""

    recording: str
    started: str  # ISO 8601; empty where that is not known
    flights: int
    steps: int
    # the next three as in `analysis.residuals.lack_of_fit.GoodnessOfFit`
    ratio: float
    plate_rms_z: float
    p_lack_of_fit: float
    landing_rms_us: float
    noise_floor_us: float  # the part of ``landing_rms_us`` that noise makes
    failed: tuple[str, ...]  # tests of a verdict that it does not pass; empty where it is explained
    days: float = 0.0  # since the first run of a joint verdict; its number where dates are not known


@dataclass(frozen=True)
class OverRuns:
    """A parameter over the runs."""

    effect: str
    parameter: str
    unit: str
    kind: str  # ``effect`` (named), or ``calibration``
    value: float  # mean of all runs, or the value that they share
    sigma: float  # its standard deviation
    spread: float  # from run to run
    values: tuple[float, ...]  # of each run by itself, (R,)
    sigmas: tuple[float, ...]  # their standard deviations, (R,); infinite where a run cannot tell
    constancy: Constancy  # test of these values, with a trend per day
    differs: bool  # whether they differ between runs beyond chance
    one_run: OneRun | None  # the only run that shows a named effect; None where others show it, too


@dataclass(frozen=True)
class Systematic:
    """A systematic error of the contact's edges that all runs share, fitted with everything else."""

    name: str  # what is late
    value_us: float  # by how much
    sigma_us: float  # how well that is known
    prior_us: float  # standard deviation of its prior about zero


@dataclass(frozen=True)
class Candidate:
    """A candidate added to the declared model: gain of all runs, gain on runs left out, probability by chance."""

    names: tuple[str, ...]
    gain: float
    held_out: float
    error: float
    p: float
    refusal: str


@dataclass(frozen=True)
class JointVerdict:
    """Joint verdict over many runs of one rig."""

    verdict: Verdict
    names: tuple[str, ...]  # effects that the runs share
    ties: tuple[tuple[str, ...], ...]  # sets that the runs do not distinguish from it, the one named first
    parameters: tuple[OverRuns, ...]  # named effects and calibrations over the runs
    systematics: tuple[Systematic, ...]  # errors of the contact's edges that all runs share
    runs: tuple[RunOutcome, ...]
    # by ``effect.parameter``, the size below which all runs together could not have shown it.
    detection: Mapping[str, float]
    candidates: tuple[Candidate, ...]  # of the first round, the best first
    rounds: tuple[str, ...]  # course of the search, a line each
    passes: int  # how often every recording was read
    dated: bool  # whether times are dates

    @property
    def odd(self) -> tuple[RunOutcome, ...]:
        """Runs that the joint values do not explain."""
        return tuple(run for run in self.runs if run.failed)


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
    shown_by = None
    if one is not None:
        recording = runs[one.place].recording
        shown_by = {"recording": recording, "others": one.others, "others_sigma": one.others_sigma}
    own = {name: value for name, value in vars(x).items() if name != "constancy"}
    return own | {
        "one_run": shown_by, "chi_square": test.chi_square, "degrees": test.degrees, "p_constant": test.p,
        "trend_per_day": test.slope, "trend_sigma": test.slope_sigma, "p_trend": test.p_trend,
    }  # fmt: skip
