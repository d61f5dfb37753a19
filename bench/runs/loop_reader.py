"""Body of the process that reads saved closed loops; what it needs is imported before its time is counted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from analysis.loop.storage import load_verdict
from analysis.loop.verdict_json import loop_json
from daq.recording.subprocess_reader import Tell
from daq.setup.errors import InputError


def look(names: list[str], tell: Tell) -> dict[str, Any]:
    """Verdicts as JSON by file name; None for a file that holds none."""
    found: dict[str, Any] = {}
    for name in names:
        tell(name)
        try:
            found[name] = loop_json(load_verdict(Path(name)))
        except InputError:
            found[name] = None
    return found
