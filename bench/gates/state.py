"""What the six gates know: one JSON file in the runs' folder, replaced whole, so that no reload or crash loses it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Self

from bench.gates.inputs import GATES, Inputs
from daq.files.json_values import json_text
from daq.files.whole_file import write_whole

FILE = "desk.json"
MOST_UNDO = 20
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
    """Everything that has to outlive the page.

    Attributes
    ----------
    profile
        Name of the profile's file in the folder; empty before one was chosen.
    scenario, seed
        What a simulated rig hides, and the seed of its noise.
    device
        The card as it was found.
    results
        By gate.
    undo
        Earlier texts of the profile, oldest first.
    run
        The run that is under way: its board, profile and recording; None without one.
    queue
        Runs to follow: gammas and reason of each.
    rounds
        Verdicts of this profile and its improved ones, oldest first.
    """

    profile: str = ""
    scenario: str = ""
    seed: int = 0
    device: Message = field(default_factory=dict)
    results: dict[str, Result] = field(default_factory=dict)
    undo: tuple[str, ...] = ()
    run: Message | None = None
    queue: tuple[Message, ...] = ()
    rounds: tuple[Message, ...] = ()

    def passed(self, gate: str, result: Result) -> Self:
        """This state with the result of a gate."""
        return replace(self, results=self.results | {gate: result})

    def edited(self, before: str) -> Self:
        """This state after the profile, whose text was ``before``, was changed."""
        return replace(self, undo=(*self.undo, before)[-MOST_UNDO:])


def load_state(folder: Path) -> State:
    """The state in a folder; a new one where there is none, or the file is no state (which is then set aside)."""
    path = folder / FILE
    if not path.is_file():
        return State()
    try:
        read = json.loads(path.read_text(encoding="utf-8"))
        results = {
            gate: Result(**{**one, "rows": tuple(one["rows"])})
            for gate, one in read.pop("results").items()
            if gate in GATES
        }
        lists = {key: tuple(read[key]) for key in ("undo", "queue", "rounds")}
        return State(**{**read, **lists}, results=results)
    except (ValueError, TypeError, KeyError, AttributeError):
        path.replace(path.with_suffix(".json.unreadable"))
        return State()


def save_state(folder: Path, state: State) -> None:
    """Replace the state's file (raises OSError)."""
    write_whole(folder / FILE, json_text(asdict(state)))
