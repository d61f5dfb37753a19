"""Processes of the page: itself (of one run, or by itself), and those that it starts: a check and a run.

None of them depends on another one once it is under way.
"""

from __future__ import annotations

import importlib.util
import itertools
import re
from dataclasses import dataclass, field, replace
from datetime import datetime
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bench.live.board import LONGEST_NOTE, Board, Message
from bench.live.run_side import RunSide
from bench.terminal.run_console import free_keys, leave_keys_to_the_parent, spawned
from bench.web.packages import require_packages
from daq.setup.errors import InputError
from rig.execution.operator import StopRequest
from rig.profile import Profile, parse_profile
from rig.programme.ramp import NextSteps

SECTIONS = ("bench.live.pages", "bench.runs.pages", "bench.drops.section", "bench.agent.section")
GATES = "bench.gates.desk"  # where runs are started from the page
LINGER_S = 3.0  # in which browsers get the last word of a run


def sections(*, starts: bool = False) -> tuple[str, ...]:
    """Modules of the desk's sections that there are, with the six gates where the page ``starts`` runs.

    Raises `InputError` without the packages of the page.
    """
    require_packages()
    names = (GATES, *SECTIONS) if starts else SECTIONS
    return tuple(name for name in names if importlib.util.find_spec(name.rpartition(".")[0]) is not None)


class PageProcess:
    """The page of one run, in a process of its own that the run never waits for.

    Raises `InputError` when the page cannot be served.

    ``host`` and ``port`` as of `bench.web.serve.bind`.
    """

    def __init__(self, profile: Profile, board: Board, folder: Path, host: str, port: int | None) -> None:
        made_of = sections(), profile, board.name, str(folder), host, port
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


@dataclass(frozen=True)
class AskedRun:
    """What a person gives a run before it starts: its file, a note, free keys, and the seed of a simulated rig."""

    out: Path
    note: str | None = None
    keys: dict[str, Any] = field(default_factory=dict)
    seed: int = 0


def asked_of(said: Message, folder: Path, stem: str) -> AskedRun:
    """What the page asks of a run before it starts: name, note, keys and seed; the name is dated where none is given.

    Raises `InputError` for a name that is taken, or none of a file, keys that are none, and a seed that is no number.
    """
    name = str(said.get("name", "")).strip().removesuffix(".h5") or f"{stem}-{datetime.now():%Y%m%d-%H%M%S}"
    if not re.fullmatch(r"[\w.+ -]{1,100}", name) or name.startswith("."):
        raise InputError(f"name {name!r}: wanted at most 100 letters, digits and . _ + -, as run-12")
    out = folder / f"{name}.h5"
    if out.exists():
        raise InputError(f"name {name}: {out.name} is there, and a recording is never overwritten; take another name")
    seed = str(said.get("seed", "")).strip() or "0"
    if not seed.isdecimal() or len(seed) > 9:
        raise InputError(f"seed {seed!r}: wanted a whole number, as 7")
    keys = free_keys([one.strip() for one in re.split(r"[,\n]", str(said.get("keys", ""))) if one.strip()])
    note = str(said.get("note", "")).strip()[:LONGEST_NOTE]
    return AskedRun(out, note or None, keys, int(seed))


def run_profile(profile: str, board_name: str, scenario: str | None, asked: AskedRun) -> None:
    """`bench ramp`, watched: the process of a run that was started from the page.

    Where a person chooses the next steps, they are driven as a run of their own, with the same limits and interlock,
    and so on; each has a board, which the page of the run before is shown.
    """
    from bench.profiles.edit import with_values
    from bench.profiles.find import load

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
    from bench.profiles.find import refuse_forbidden

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
