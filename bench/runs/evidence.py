"""The evidence behind the numbers of a verdict: rivals, steps, residuals, and the two edges of each flight.

All of it stands in the saved closed loop; nothing is computed anew.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bench.runs.events import on_scope
from daq.setup.errors import InputError
from kernels.arrays import Bools, Floats, Integers

if TYPE_CHECKING:
    from analysis.loop.result import ClosedLoop, Predictions


def evidence(loop: ClosedLoop, identity: str, gaps: Integers, rate_hz: float) -> dict[str, Any]:
    """Rivals, steps and flights of one recording in a closed loop, flights as columns in order of take-off.

    Parameters
    ----------
    loop
        As it was saved.
    identity
        Of the recording (`daq.recording.header.stored_id`).
    gaps, rate_hz
        Of the recording; times are also given as its scope counts them.

    Raises
    ------
    InputError
        Where the loop is of other recordings.
    """
    own = [i for i, source in enumerate(loop.sources) if source.identity == identity]
    if not own or not identity:
        raise InputError(
            f"the closed loop of {', '.join(s.file for s in loop.sources)} holds no flight of this recording"
        )
    steps, flights = loop.steps, loop.flights
    here = np.flatnonzero(steps.recording[flights.step] == own[0])
    step, scored = flights.step[here], flights.scored[here]
    models = {"declared": flights.before, "improved": flights.after}
    columns: dict[str, Any] = {
        "step": steps.number[step],
        "scored": scored,
        "takeoff_s": flights.takeoff_s[here],
        "landing_s": flights.landing_s[here],
        "shown_s": on_scope(flights.takeoff_s[here], gaps, rate_hz),
    }
    for name, model in models.items():
        columns |= _by(name, model, here)
    return {
        "rivals": _rivals(loop),
        "steps": [
            {"step": int(steps.number[k]), "gamma": steps.gamma[k], "held_out": bool(steps.held_out[k]),
             "flights": int((mine := scored & (step == k)).sum()),
             **{f"{name}_us": _rms_us(columns[f"{name}_us"], mine) for name in models}}
            for k in np.flatnonzero(steps.recording == own[0])
        ],
        "flights": {name: _rounded(values) for name, values in columns.items()},
    }  # fmt: skip


def _by(name: str, model: Predictions, here: Integers) -> dict[str, Floats]:
    """Predicted times (s), residuals of both edges and their uncertainty (us) by one model."""
    return {
        f"{name}_takeoff_s": model.takeoff_s[here],
        f"{name}_landing_s": model.landing_s[here],
        f"{name}_takeoff_us": 1e6 * model.takeoff_residual_s[here],
        f"{name}_us": 1e6 * model.landing_residual_s[here],
        f"{name}_sigma_us": 1e6 * model.landing_sigma_s[here],
    }


def _rivals(loop: ClosedLoop) -> list[dict[str, Any]]:
    """Each candidate of the first round with its gain (nats) and what became of it, the best first."""
    chosen, rejected = set(loop.selection.names), loop.selection.rejected
    ties = {names for names in loop.selection.ties if set(names) != chosen}
    rows: dict[tuple[str, ...], dict[str, Any]] = {
        one.names: {"gain": one.gain, "error": one.error, "outcome": "less good"} for one in loop.selection.candidates
    }
    for names in ties:
        rows.setdefault(names, {"gain": None, "error": None})["outcome"] = "the data cannot tell it from the best"
    if rejected is not None:
        rows[rejected.names] = {"gain": rejected.gain, "error": rejected.error, "outcome": rejected.reason}
    for names, row in rows.items():
        if set(names) <= chosen:
            row["outcome"] = "added"
    best = sorted(rows.items(), key=lambda item: -(item[1]["gain"] if item[1]["gain"] is not None else np.inf))
    return [{"names": list(names), **row} for names, row in best]


def _rms_us(residual_us: Floats, chosen: Bools) -> float | None:
    """Root mean square of those that are predicted, us; None where there is none."""
    known = residual_us[chosen & np.isfinite(residual_us)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None


def _rounded(values: Any) -> Any:
    """Times to the nanosecond, errors to the thousandth of a microsecond."""
    return np.round(values, 9) if values.dtype.kind == "f" else values
