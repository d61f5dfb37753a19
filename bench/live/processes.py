"""Processes of the page: itself (of one run, or by itself), and those that it starts: a check and a run.

None of them depends on another one once it is under way.
"""

from __future__ import annotations

import importlib.util
import multiprocessing
from dataclasses import asdict, dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from bench.live.board import Board
from bench.live.run_side import RunSide
from bench.terminal.signals import leave_keys_to_the_parent
from bench.web.packages import require_packages
from daq.setup.errors import InputError
from rig.backends.base import BackendError
from rig.profile import Profile

SECTIONS = ("bench.live.pages", "bench.runs.pages", "bench.drops.section")
LINGER_S = 3.0  # in which browsers get the last word of a run


def sections() -> tuple[str, ...]:
    """Modules of the desk's sections that there are; raises `InputError` without the packages of the page."""
    require_packages()
    return tuple(name for name in SECTIONS if importlib.util.find_spec(name.rpartition(".")[0]) is not None)


class PageProcess:
    """The page of one run, in a process of its own that the run never waits for.

    Parameters
    ----------
    profile, board
        Of the run.
    folder
        Of the runs.
    host, port
        Where to listen; see `bench.web.serve.bind`.

    Raises
    ------
    InputError
        When the page cannot be served.
    """

    def __init__(self, profile: Profile, board: Board, folder: Path, host: str, port: int | None) -> None:
        modules = sections()
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe(duplex=False)
        self._process = context.Process(
            target=_serve_run, args=(theirs, modules, profile, board.name, str(folder), host, port), name="page"
        )
        self._process.start()
        theirs.close()
        self.url, fault = "", "it does not start"
        try:
            if ours.poll(60.0):
                self.url, fault = ours.recv()
        except EOFError:
            pass  # it ended before it could say why
        if not self.url:
            self._process.terminate()
            raise InputError(f"the page cannot be served: {fault}")

    @property
    def pid(self) -> int | None:
        """Of the process."""
        return self._process.pid

    def close(self) -> None:
        """Let the page say how the run ended, and end it."""
        self._process.join(LINGER_S)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(LINGER_S)


def _serve_run(
    pipe: Connection, modules: tuple[str, ...], profile: Profile, board: str, folder: str, host: str, port: int | None
) -> None:
    """The page's process during a run."""
    from bench.web.section import Place
    from bench.web.serve import bind, serve

    def answer(url: str, fault: str) -> None:
        pipe.send((url, fault))
        pipe.close()

    leave_keys_to_the_parent()
    try:
        listening, access = bind(host, port)
    except InputError as error:
        answer("", str(error))
        return
    place = Place(Path(folder).resolve(), {"live": {"watched": (profile, board)}})
    serve(listening, access, modules, place, on_ready=lambda: answer(access.url, ""), own_signals=False)


def run_check(pipe: Connection, profile: str, scenario: str | None) -> None:
    """`bench check`; sends its findings, or why there are none."""
    from bench.jobs.run_ramp import check_rig, open_rig

    answer: dict[str, Any] = {"error": "", "findings": []}
    try:
        rig = open_rig(profile, "check", Path(scenario) if scenario else None, 0)
        answer["findings"] = [asdict(finding) for finding in check_rig(*rig)]
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
    from bench.profiles.plan import refuse_forbidden

    board = Board(board_name)
    side = RunSide(board)
    try:
        checked, text = load(profile)
        refuse_forbidden(profile, checked)
        seed = asked.seed if checked.backend.kind == "simulated" else 0
        backend = make_backend(checked, scenario=Path(scenario) if scenario else None, seed=seed, real_time=True)
        record(
            checked, text, backend, asked.out, note=asked.note, extra=asked.keys or None, quiet=True, paced=True,
            onlooker=side,
        )  # fmt: skip
    except (InputError, OSError) as error:
        side.end(None, str(error))
    finally:
        board.close()
