"""Processes of the page: itself, of one run or by itself; the runs that it starts; what goes with runs in a terminal.

None of them depends on another one once it is under way.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import typer

from bench.jobs.run_ramp import Onlooker, make_backend, record
from bench.live.board import LONGEST_NOTE, Board, Message, RunSide
from bench.profiles.edit import with_values
from bench.profiles.find import load, refuse_forbidden
from bench.terminal.run_console import free_keys, leave_keys_to_the_parent, spawned
from bench.web.packages import require_packages
from daq.files.disk import Closing
from daq.setup.errors import InputError
from rig.execution.operator import Status, StopRequest
from rig.profile import Profile, parse_profile
from rig.programme.ramp import NextSteps

SECTIONS = ("bench.live.pages", "bench.runs.pages", "bench.drops.desk", "bench.agent.section")
LINGER_S = 3.0  # in which browsers get the last word of a run


def _serve_run(
    pipe: Connection, modules: tuple[str, ...], profile: Profile, board: str, folder: str, host: str, port: int | None
) -> None:
    """The page's process during a run: sends its address, or why there is none."""
    from bench.web.serve import Place, bind, serve

    leave_keys_to_the_parent()
    try:
        listening, access = bind(host, port)
    except InputError as error:
        pipe.send(("", str(error)))
        return
    place = Place(Path(folder).resolve(), {"live": {"watched": (profile, board)}})
    serve(listening, access, modules, place, on_ready=lambda: pipe.send((access.url, "")), own_signals=False)


class Onlookers(Closing):
    """A page (address and port) for runs one after another, and with ``watch`` their verdicts on standard error."""

    def __init__(self, folder: Path, page: tuple[str, int | None] | None, *, watch: bool = False) -> None:
        self._folder, self._page, self._watch = folder, page, watch
        self._served: BaseProcess | None = None
        self._boards: list[Board] = []
        self._profiles = TemporaryDirectory()

    def close(self) -> None:
        """Let the page say how the last run ended, and end it."""
        if (page := self._served) is not None:
            page.join(LINGER_S)
            page.terminate()
            page.join(LINGER_S)
        for board in self._boards:
            board.close()
        self._profiles.cleanup()

    def _serve(self, profile: Profile, board: str, host: str, port: int | None) -> None:
        """Start the page, a process of its own that no run waits for (`InputError`: it cannot be served)."""
        require_packages()
        made_of = SECTIONS, profile, board, str(self._folder), host, port
        ours, self._served = spawned(_serve_run, *made_of, name="page")
        url, fault = "", "it does not start"
        with suppress(EOFError):  # it ended before it could say why
            if ours.poll(60.0):
                url, fault = ours.recv()
        if not url:
            self._served.terminate()
            raise InputError(f"the page cannot be served: {fault}")
        typer.echo(f"watch it at {url}", err=True)

    @contextmanager
    def of_run(self, profile: Profile, text: str, why: str = "") -> Iterator[Onlooker | None]:
        """An onlooker for `bench.jobs.run_ramp.record` during the next run, which ``why`` is for; None for no one."""
        if self._page is None and not self._watch:
            yield None
            return
        board = Board()
        self._boards.append(board)
        if self._page is not None and self._served is None:
            self._serve(profile, board.name, *self._page)
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
        from bench.live.analyst import analyse

        self._pipe, self._process = spawned(analyse, board_name, profile, False, name="analyst", daemon=True)
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
    """What the page asks of a run: name (by default a date), note and keys (`InputError` where one will not do)."""
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
