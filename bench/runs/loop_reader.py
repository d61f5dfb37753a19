"""Body of the process that reads saved closed loops; what it needs is imported before its time is counted."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from analysis.loop.result import ClosedLoop
from analysis.loop.storage import load_verdict
from analysis.loop.verdicts import VERDICTS, short_verdict
from bench.runs.rows import quantity, unit_of
from daq.files.json_values import json_object
from daq.recording.subprocess_reader import Tell
from daq.setup.errors import InputError


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
            # a 95 % interval is 1.96 standard deviations to either side
            sigma = (high - low) / (2.0 * 1.959964)
            quantities.append((effect.name, parameter, value, sigma if math.isfinite(sigma) else None))
    quantities += [(x.effect, x.parameter, x.value, x.sigma) for x in loop.selection.calibrations]
    return {
        "identities": [source.identity for source in loop.sources if source.identity],
        "verdict": loop.verdict,
        "summary": words + (f" (or {others} other sets)" if others > 0 else ""),
        "before_us": loop.errors.before.landing_rms_us,
        "after_us": loop.errors.after.landing_rms_us,
        "floor_us": loop.errors.landing_floor_us,
        "quantities": [
            quantity(f"{effect}.{parameter}", value, sigma, unit_of(effect, parameter), "verdict")
            for effect, parameter, value, sigma in quantities
            if math.isfinite(value)
        ],
    }
