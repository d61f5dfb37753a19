"""The six gates: what each was passed with, and what they know, in one JSON file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any, Self

from pydantic import TypeAdapter, ValidationError

from daq.files.disk import write_whole
from daq.files.json_values import json_text
from rig.profile import Profile
from rig.programme.ramp import peaks

GATES = ("card", "wiring", "calibrate", "check", "ramp", "verdict")
Inputs = dict[str, Any]
_WIRED = ("terminal", "coupling", "range_v", "serial_number", "sign")  # of a channel, before its scale is known


def inputs_of(gate: str, profile: Profile, rig: Mapping[str, Any], device: Mapping[str, Any]) -> Inputs:
    """What a gate is passed with, by name: its own inputs and those of the gates before it.

    ``gate`` is one before ``verdict``, which judges the recording. ``rig`` is what a simulated rig hides, and its seed,
    empty for a device; ``device`` the card as the first gate found it.
    """
    whole = profile.model_dump(mode="json")
    backend = dict(whole["backend"])
    wired = backend.pop("inputs", None)
    parts: list[tuple[str, Inputs]] = [
        ("card", {"backend": backend, "sampling": whole["sampling"], "rig": dict(rig)}),
        ("wiring", {
            "device": dict(device), "inputs": wired,
            "wires": {name: {key: channel[key] for key in _WIRED if key in channel}
                      for name, channel in whole["channels"].items() if channel},
        }),
        ("calibrate", {key: whole[key] for key in ("channels", "drive", "g_mps2")}),
        ("check", {
            "forcing": whole["forcing"], "limits": whole["limits"],
            "highest": max(peaks(profile, gamma).gamma_peak for gamma in set(profile.ramp.gammas())),
        }),
        ("ramp", {key: whole[key] for key in ("ramp", "control", "ball", "declared")}),
    ]  # fmt: skip
    found: Inputs = {}
    for name, part in parts:
        found |= part
        if name == gate:
            break
    return found


def changed(before: Any, now: Any, name: str = "") -> list[str]:
    """Dotted names of what differs between two inputs."""
    if isinstance(before, dict) and isinstance(now, dict):
        keys = [*before, *(key for key in now if key not in before)]
        return [
            line for key in keys for line in changed(before.get(key), now.get(key), f"{name}.{key}" if name else key)
        ]
    return [] if before == now else [name]


FILE = "desk.json"
Message = dict[str, Any]


@dataclass(frozen=True)
class Result:
    """Outcome of a gate: passed or not, with which inputs, when (ISO 8601), rows that the page shows, a recording."""

    passed: bool
    inputs: Inputs
    at: str
    rows: tuple[Message, ...] = ()
    file: str = ""


@dataclass(frozen=True)
class State:
    """Everything that has to outlive the page."""

    profile: str = ""  # name of the profile's file in the folder; empty before one was chosen
    scenario: str = ""  # what a simulated rig hides
    seed: int = 0  # of its noise
    device: Message = field(default_factory=dict)  # the card as it was found
    results: dict[str, Result] = field(default_factory=dict)  # by gate
    undo: tuple[str, ...] = ()  # earlier texts of the profile, oldest first
    run: Message | None = None  # the run that is under way: its board, profile, recording and inputs; None without one
    queue: tuple[Message, ...] = ()  # runs to follow: the note of each
    rounds: tuple[Message, ...] = ()  # verdicts of this profile and its improved ones, oldest first

    def passed(self, gate: str, result: Result) -> Self:
        """This state with the result of a gate."""
        return replace(self, results=self.results | {gate: result})

    def edited(self, before: str) -> Self:
        """This state after the profile, whose text was ``before``, was changed; 20 changes can be undone."""
        return replace(self, undo=(*self.undo, before)[-20:])


def now() -> str:
    """The time of a result (ISO 8601, UTC)."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def load_state(folder: Path) -> tuple[State, str]:
    """The state in a folder, and a fault; where the file holds no state it is set aside, and the fault says where to.

    Raises `OSError` when the file cannot be read or set aside.
    """
    path = folder / FILE
    if not path.is_file():
        return State(), ""
    try:
        return TypeAdapter(State).validate_json(path.read_bytes()), ""
    except ValidationError as error:
        aside = next(one for n in count(1) if not (one := path.with_name(f"{FILE}.unreadable-{n}")).exists())
        path.rename(aside)
        place = ".".join(str(part) for part in error.errors()[0]["loc"]) or "the file"
        why = f"{place}: {error.errors()[0]['msg']}"
        return State(), f"{path}: holds no state of the gates ({why}); it is now {aside.name}, and the gates begin anew"


def save_state(folder: Path, state: State) -> None:
    """Replace the state's file (raises OSError)."""
    write_whole(folder / FILE, json_text(asdict(state)))
