"""What saved closed loops say, for the catalogue and as evidence on a run's page.

`look` is the body of the process that reads them for the catalogue: what it needs is imported before its time is
counted. The evidence (rivals, steps, residuals, the two edges of each flight) stands in the file; nothing is computed
anew. Decision 496.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from analysis.loop.result import ClosedLoop
from analysis.loop.storage import load_verdict
from analysis.loop.verdicts import VERDICTS, short_verdict
from analysis.statistics import Z95
from bench.runs.events import on_scope
from bench.runs.rows import quantity
from daq.files.json_values import json_object
from daq.recording.event_changes import BY_HAND
from daq.recording.subprocess_reader import Tell
from daq.setup.errors import InputError
from kernels.arrays import Bools, Floats, Integers
from model.effects.registry import unit_of


def look(names: list[str], tell: Tell) -> dict[str, Any]:
    """Verdicts by file name, as the catalogue holds them; None for a file that holds none."""
    found: dict[str, Any] = {}
    for name in names:
        tell(name)
        try:
            loop = load_verdict(Path(name))
            found[name] = json_object(_verdict(loop)) if loop.verdict in VERDICTS else None
        except InputError:
            found[name] = None
    return found


def _verdict(loop: ClosedLoop) -> dict[str, Any]:
    """The recordings, the verdict in words, its errors in us, parameters of added effects and fitted calibrations."""
    names = [effect.name for effect in loop.selection.effects]
    others = len(loop.selection.ties) - 1
    words = short_verdict(loop.verdict) + (f": {', '.join(names)}" if names else "")
    quantities = []
    for effect in loop.selection.effects:
        for parameter, (value, low, high) in effect.parameters.items():
            sigma = (high - low) / (2.0 * Z95)
            quantities.append((effect.name, parameter, value, sigma if math.isfinite(sigma) else None))
    quantities += [(x.effect, x.parameter, x.value, x.sigma) for x in loop.selection.calibrations]
    return {
        "identities": [source.identity for source in loop.sources if source.identity],
        "verdict": loop.verdict,
        "summary": words + (f" (or {others} other sets)" if others > 0 else ""),
        "before_us": loop.errors.before.landing_rms_us,
        "after_us": loop.errors.after.landing_rms_us,
        "floor_us": loop.errors.landing_floor_us,
        "by_hand": [line for line in loop.notes if BY_HAND in line],
        "quantities": [
            quantity(f"{effect}.{parameter}", value, sigma, unit_of(effect, parameter), "verdict")
            for effect, parameter, value, sigma in quantities
            if math.isfinite(value)
        ],
    }


def evidence(loop: ClosedLoop, identity: str, gaps: Integers, rate_hz: float) -> dict[str, Any]:
    """Rivals, steps and flights of one recording in a closed loop, flights as columns in order of take-off.

    Raises `InputError` where the loop is of other recordings.

    Parameters
    ----------
    loop
        As it was saved.
    identity
        Of the recording (`daq.recording.header.stored_id`).
    gaps, rate_hz
        Of the recording; times are also given as its scope counts them.
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
    for name, model in models.items():  # predicted times (s), residuals of both edges, the landing's uncertainty (us)
        columns |= {
            f"{name}_takeoff_s": model.takeoff_s[here],
            f"{name}_landing_s": model.landing_s[here],
            f"{name}_takeoff_us": 1e6 * model.takeoff_residual_s[here],
            f"{name}_us": 1e6 * model.landing_residual_s[here],
            f"{name}_sigma_us": 1e6 * model.landing_sigma_s[here],
        }
    return {
        "rivals": _rivals(loop),
        "steps": [
            {"step": int(steps.number[k]), "gamma": steps.gamma[k], "held_out": bool(steps.held_out[k]),
             "flights": int((mine := scored & (step == k)).sum()),
             **{f"{name}_us": _rms_us(columns[f"{name}_us"], mine) for name in models}}
            for k in np.flatnonzero(steps.recording == own[0])
        ],
        "flights": {name: np.round(x, 9) if x.dtype.kind == "f" else x for name, x in columns.items()},
    }  # fmt: skip


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
