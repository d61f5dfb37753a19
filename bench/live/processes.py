"""Processes of the page: itself, of one run or by itself; the runs that it starts; what goes with runs in a terminal.

None of them depends on another one once it is under way.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import datetime
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import typer

from bench.live.board import LONGEST_NOTE, Board, Message, RunSide
from bench.profiles.edit import with_values
from bench.profiles.find import load, refuse_forbidden
from bench.terminal.run_console import free_keys, leave_keys_to_the_parent, spawned
from bench.web.packages import require_packages
from daq.setup.errors import InputError
from rig.execution.operator import Status, StopRequest
from rig.profile import Profile, parse_profile
from rig.programme.ramp import NextSteps

if TYPE_CHECKING:
    from bench.jobs.run_ramp import Onlooker

SECTIONS = ("bench.live.pages", "bench.runs.pages", "bench.drops.desk", "bench.agent.section")
LINGER_S = 3.0  # in which browsers get the last word of a run


class PageProcess:
    """The page of one run, in a process of its own that the run never waits for.

    Raises `InputError` when the page cannot be served.

    ``host`` and ``port`` as of `bench.web.serve.bind`.
    """

    def __init__(self, profile: Profile, board: Board, folder: Path, host: str, port: int | None) -> None:
        require_packages()
        made_of = SECTIONS, profile, board.name, str(folder), host, port
        ours, self._process = spawned(_serve_run, *made_of, name="page")
        self.url, fault = "", "it does not start"
        try:
            if ours.poll(60.0):
                self.url, fault = ours.recv()
        except EOFError:
            pass  # it ended before it could say why
        if not self.url:
            self._process.terminate()
            raise InputError(f"the page cannot be served: {fault}")

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
    from bench.web.serve import Place, bind, serve

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


class Onlookers:
    """One page for several runs, one after another, and the printed verdicts; a context in which they are driven.

    ``folder`` is of the recordings; ``page`` the address and port, None for no page; with ``watch`` the verdict after
    each step is printed on standard error.
    """

    def __init__(self, folder: Path, page: tuple[str, int | None] | None, *, watch: bool = False) -> None:
        self._folder, self._page, self._watch = folder, page, watch
        self._served: PageProcess | None = None
        self._boards: list[Board] = []
        self._profiles = TemporaryDirectory()

    def __enter__(self) -> Onlookers:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._served is not None:
            self._served.close()
        for board in self._boards:
            board.close()
        self._profiles.cleanup()

    @contextmanager
    def of_run(self, profile: Profile, text: str, why: str = "") -> Iterator[Onlooker | None]:
        """An onlooker for `bench.jobs.run_ramp.record` during the next run; None where no one looks on.

        Raises `InputError` when the page cannot be served.

        ``why`` is the reason of the run, said on a page that is there already.
        """
        if self._page is None and not self._watch:
            yield None
            return
        board = Board()
        self._boards.append(board)
        if self._page is not None and self._served is None:
            self._served = PageProcess(profile, board, self._folder, *self._page)
            typer.echo(f"watch it at {self._served.url}", err=True)
        elif self._page is not None:
            path = Path(self._profiles.name) / f"{len(self._boards)}.toml"
            path.write_text(text, encoding="utf-8")
            # the page of the run before goes on to this one; its lane takes a reason of a few lines
            following = {"kind": "next", "board": board.name, "profile": str(path), "why": why[:480]}
            self._boards[-2].events.put(following)
        watcher = _Watcher(profile, board.name) if self._watch else None
        try:
            yield RunSide(board, None if watcher is None else watcher.look)
            if watcher is not None:
                watcher.print_what_came(within_s=20.0)  # the verdict after the last step is still on its way
        finally:
            if watcher is not None:
                watcher.close()


class _Watcher:
    """The analyst of a run, whose verdicts are printed."""

    def __init__(self, profile: Profile, board_name: str) -> None:
        from bench.live.analyst import start_analyst

        self._pipe, self._process = start_analyst(profile, board_name, pictures=False)
        self._blocks = 0
        self._printed: dict[int, str] = {}  # by step

    def look(self, status: Status) -> None:
        """Print what has come, after every 16th block; never waits."""
        self._blocks += 1
        if self._blocks % 16 == 0:
            self.print_what_came(0.0)

    def close(self) -> None:
        """End the analyst."""
        self._process.terminate()
        self._process.join(2.0)

    def print_what_came(self, within_s: float) -> None:
        """Print what comes within a time."""
        try:
            while self._pipe.poll(within_s):
                message: dict[str, Any] = self._pipe.recv()
                if message["kind"] == "verdict":
                    said = [*(f"- {one}" for one in message["candidates"]), *message["lines"]]
                    typer.echo("\n    ".join([f"  {message['headline']}", *said]), err=True)
                elif message["kind"] == "flights":
                    line = f"step {message['step']}: gamma {message['gamma']:.4f}, {message['label']}"
                    if self._printed.get(message["step"]) != line:  # the end may correct it
                        typer.echo(line, err=True)
                    self._printed[message["step"]] = line
        except (EOFError, OSError):
            return  # it is done, or gone: the run goes on without


@dataclass(frozen=True)
class AskedRun:
    """What a person gives a run before it starts: its file, a note, free keys, and the seed of a simulated rig."""

    out: Path
    note: str | None = None
    keys: dict[str, Any] = field(default_factory=dict)
    seed: int = 0


def asked_of(said: Message, folder: Path, stem: str, seed: int) -> AskedRun:
    """What the page asks of a run before it starts: name, note and keys; the name is dated where none is given.

    Raises `InputError` for a name that is taken, or none of a file, and keys that are none.
    """
    name = str(said.get("name", "")).strip().removesuffix(".h5") or f"{stem}-{datetime.now():%Y%m%d-%H%M%S}"
    if not re.fullmatch(r"[\w.+ -]{1,100}", name) or name.startswith("."):
        raise InputError(f"name {name!r}: wanted at most 100 letters, digits and . _ + -, as run-12")
    out = folder / f"{name}.h5"
    if out.exists():
        raise InputError(f"name {name}: {out.name} is there, and a recording is never overwritten; take another name")
    keys = free_keys([one.strip() for one in re.split(r"[,\n]", str(said.get("keys", ""))) if one.strip()])
    note = str(said.get("note", "")).strip()[:LONGEST_NOTE]
    return AskedRun(out, note or None, keys, seed)


def run_profile(profile: str, board_name: str, scenario: str | None, asked: AskedRun) -> None:
    """`bench ramp`, watched: the process of a run that was started from the page.

    Where a person chooses the next steps, they are driven as a run of their own, with the same limits and interlock,
    and so on; each has a board, which the page of the run before is shown.
    """
    board, first = Board(board_name), asked.out
    side = RunSide(board)
    try:
        checked, text = load(profile)
        with TemporaryDirectory() as folder:
            for number in itertools.count(2):
                steps = _drive(checked, text, side, scenario, asked)
                if steps is None or not steps.gammas:
                    break
                text = with_values(text, {"ramp.gamma": list(steps.gammas), "ramp.order": None}, profile)
                checked = parse_profile(text, profile)
                keys = {**asked.keys, "continues": first.name, "chosen_because": f"chosen by a person, {steps.why}"}
                numbered = (first.with_name(f"{first.stem}-{n}.h5") for n in itertools.count(number))
                asked = replace(asked, out=next(path for path in numbered if not path.exists()), keys=keys)
                path = Path(folder) / f"{number}.toml"
                path.write_text(text, encoding="utf-8")
                before, board = board, Board()
                side = RunSide(board)
                words = f"{', '.join(f'{gamma:g}' for gamma in steps.gammas)} {steps.why}".strip()
                before.events.put({"kind": "next", "board": board.name, "profile": str(path), "why": words[:480]})
    except (InputError, OSError) as error:
        side.end(None, str(error))
    finally:
        board.close()


def _drive(checked: Profile, text: str, side: RunSide, scenario: str | None, asked: AskedRun) -> NextSteps | None:
    """One run; the steps that a person chose to follow it, or None."""
    from bench.jobs.run_ramp import make_backend, record

    def check(steps: NextSteps) -> None:
        if steps.ratio not in (None, checked.forcing.ratio):
            raise InputError(f"c = {steps.ratio}: the rig was checked with c = {checked.forcing.ratio}; check it anew")
        ramp = checked.ramp.model_copy(update={"gamma": steps.gammas, "order": None})
        refuse_forbidden("these steps", checked.model_copy(update={"ramp": ramp}))

    refuse_forbidden(asked.out.name, checked)
    seed = asked.seed if checked.backend.kind == "simulated" else 0
    backend = make_backend(checked, scenario=Path(scenario) if scenario else None, seed=seed, watched=True)
    request = StopRequest(check)
    record(
        checked, text, backend, asked.out, note=asked.note, extra=asked.keys or None, quiet=True, paced=True,
        onlooker=side, request=request,
    )  # fmt: skip
    return request.then
