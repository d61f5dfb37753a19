"""What the six gates know: one JSON file in the runs' folder, replaced whole, so that no reload or crash loses it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any, Self

from pydantic import TypeAdapter, ValidationError

from bench.gates.inputs import Inputs
from daq.files.json_values import json_text
from daq.files.whole_file import write_whole

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
