"""Processes that the page starts: a check, and a run. Neither depends on the page once it is under way."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from bench.live.board import Board
from bench.live.run_side import RunSide
from daq.setup.errors import InputError
from rig.backends.base import BackendError


def run_check(pipe: Connection, profile: str, scenario: str | None) -> None:
    """`bench check`; sends its findings, or why there are none."""
    from bench.jobs.run_ramp import make_backend, warm_up
    from bench.profiles.find import load
    from rig.checks.check import Check

    answer: dict[str, Any] = {"error": "", "findings": []}
    try:
        checked, _ = load(profile)
        backend = make_backend(checked, scenario=Path(scenario) if scenario else None)
        if not backend.simulated:
            warm_up(checked)
        answer["findings"] = [asdict(finding) for finding in Check(checked, backend).run()]
    except (InputError, BackendError, OSError) as error:
        answer["error"] = str(error)
    pipe.send(answer)
    pipe.close()


@dataclass(frozen=True)
class AskedRun:
    """What a person gives a run before it starts: its file, a note, free keys, and the seed of a simulated rig."""

    out: Path
    note: str | None = None
    keys: dict[str, Any] = field(default_factory=dict)
    seed: int = 0


def run_profile(profile: str, board_name: str, scenario: str | None, asked: AskedRun) -> None:
    """`bench ramp`, watched: the process of a run that was started from the page."""
    from bench.jobs.run_ramp import make_backend, record
    from bench.profiles.find import load
    from bench.profiles.plan import planned, refusal

    board = Board(board_name)
    side = RunSide(board)
    try:
        checked, text = load(profile)
        faults = planned(checked)[2]
        if faults:
            raise InputError(refusal(profile, faults))
        hidden = Path(scenario) if scenario else None
        seed = asked.seed if checked.backend.kind == "simulated" else 0
        backend = make_backend(checked, scenario=hidden, seed=seed, real_time=True)
        record(
            checked, text, backend, asked.out, note=asked.note, extra=asked.keys or None, quiet=True, paced=True,
            onlooker=side,
        )  # fmt: skip
    except (InputError, OSError) as error:
        side.end(None, str(error))
    finally:
        board.close()
