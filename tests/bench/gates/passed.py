"""A runs' folder whose rig has passed the gates up to the check, for tests that begin at the ramp."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.gates.state import GATES, Result, State, inputs_of, save_state
from bench.profiles.find import load, shipped_folder

DEVICE = {"name": "the simulated rig"}


def passed(folder: Path, name: str = "rig.toml", like: str = "simulated", **more: Any) -> State:
    """A folder with a profile, made where it is not there, and a state in which every gate up to the check is green."""
    if not (folder / name).exists():
        text = (shipped_folder() / f"{like}.toml").read_text(encoding="utf-8")
        (folder / name).write_text(text, encoding="utf-8")
    profile = load(folder / name)[0]
    rig = {"scenario": more.get("scenario", ""), "seed": 0} if like == "simulated" else {}
    results = {
        gate: Result(True, inputs_of(gate, profile, rig, DEVICE), "2026-11-25T12:00:00+00:00") for gate in GATES[:4]
    }
    state = State(profile=name, device=DEVICE, results=results, **more)
    save_state(folder, state)
    return state
