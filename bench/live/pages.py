"""The section of the desk that shows a run while it lasts: browsers, the run that they watch, runs that they start."""

from __future__ import annotations

import asyncio
import contextlib
import json
import multiprocessing
import re
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from bench.live.board import LONGEST_NOTE, Board, Message
from bench.live.processes import AskedRun, run_check, run_profile
from bench.live.scope_data import MinMax, PlateHeight
from bench.live.watched_run import WatchedRun
from bench.profiles.find import find_profile, load, scenario_names, shipped_names
from bench.terminal.orders import free_keys
from bench.web.browsers import Browser, Hub, socket_route
from bench.web.section import Place, Section, templates_of
from daq.setup.errors import InputError
from rig.profile import Profile, load_profile

COMMANDS = ("finish", "ramp_down", "pause", "go_on", "note", "next")


class Desk:
    """What browsers see and do.

    Parameters
    ----------
    folder
        Of the runs.
    offered
        Profiles that may be started, by name or path; none where the page only watches.
    watched
        Profile and board of a run that is under way; None where runs are started from the page.
    """

    def __init__(self, folder: Path, offered: Sequence[str], watched: tuple[Profile, str] | None) -> None:
        self.hub = Hub()
        self.watch: WatchedRun | None = None
        self._folder, self._offered, self._watched = folder, list(offered), watched
        self._passed: set[str] = set()  # profiles whose check was green
        self._run: Any = None
        self._check: Any = None
        self._check_pipe: Any = None
        self._checked = ""
        self._findings: Message | None = None

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Look after the run while the server runs."""
        MinMax(1, 1)
        PlateHeight(1.0, 1.0, 1.0, 1.0)  # compiled before a run needs them
        if self._watched is not None:
            profile, board_name = self._watched
            with contextlib.suppress(OSError):
                self.watch = WatchedRun(profile, Board(board_name), self.hub.tell)
        ticking = asyncio.create_task(self._tick_for_ever())
        try:
            yield
        finally:
            ticking.cancel()
            if self.watch is not None:
                self.watch.close()

    async def _tick_for_ever(self) -> None:
        due = time.monotonic()
        while True:
            if self.hub.lease.pass_time(time.monotonic()):
                self.hub.tell_lease()
            if self.watch is not None:
                self.watch.tick()
                self._follow(self.watch)
            self._look_at_check()
            due = max(due + 0.05, time.monotonic())
            await asyncio.sleep(due - time.monotonic())

    def _follow(self, watch: WatchedRun) -> None:
        """Watch the run that follows the one watched so far, where it was announced."""
        following, watch.successor = watch.successor, None
        if following is None:
            return
        with contextlib.suppress(OSError, InputError):  # it is over, or gone: what was watched stays
            profile, board = load_profile(following["profile"])[0], Board(following["board"])
            self.hub.tell({"kind": "started", "profile": profile.name, "out": "", "why": following["why"]})
            self.watch = WatchedRun(profile, board, self.hub.tell)
            watch.close()

    async def talk(self, browser: Browser) -> None:
        """Serve one browser until it is gone."""
        await self.hub.serve(browser, self._greet, self._obey)

    async def _greet(self, browser: Browser) -> None:
        offer = {"kind": "offer", "profiles": self._offered, "scenarios": scenario_names()}
        browser.send(json.dumps(offer | {"can_start": self._can_start}))
        if self._findings is not None:
            browser.send(json.dumps(self._findings))
        for message in self.watch.history() if self.watch is not None else []:
            browser.send(message)

    @property
    def _can_start(self) -> bool:
        return self._watched is None and (self._run is None or not self._run.is_alive())

    def _obey(self, browser: Browser, said: Message) -> None:
        """Do what a browser asks: anyone may stop the run at once; all else is for the browser with the controls."""
        wanted, lease, name = said.get("do"), self.hub.lease, browser.name
        if wanted == "ask":
            lease.ask(name, time.monotonic())
        elif wanted == "hand_over":
            lease.hand_over(name)
        elif wanted == "keep":
            lease.keep(name)
        elif wanted == "now":
            if self.watch is not None:
                self.watch.command({"do": "now"})
            return
        else:
            if not lease.may(name):
                _refuse(browser, "another browser holds the controls")
            elif wanted in COMMANDS and self.watch is not None:
                self.watch.command({"do": wanted, "text": str(said.get("text", ""))[:LONGEST_NOTE]})
            elif wanted == "check":
                self._start_check(str(said.get("profile", "")), str(said.get("scenario", "")))
            elif wanted == "start":
                self._start_run(browser, said)
            return
        self.hub.tell_lease()

    def _start_check(self, profile: str, scenario: str) -> None:
        """`bench check` of an offered profile, in a process of its own."""
        busy = self._check is not None and self._check.is_alive()
        if busy or not self._can_start or profile not in self._offered:
            return
        context = multiprocessing.get_context("spawn")
        self._check_pipe, theirs = context.Pipe(duplex=False)
        self._checked = f"{profile}|{scenario}"
        self._passed.discard(self._checked)
        asked = (theirs, profile, _known_scenario(scenario))
        self._check = context.Process(target=run_check, args=asked, name="check", daemon=True)
        self._check.start()
        theirs.close()
        self.hub.tell({"kind": "checking", "key": self._checked})

    def _look_at_check(self) -> None:
        """Tell the outcome of a check once it is there."""
        if self._check_pipe is None or not self._check_pipe.poll():
            return
        try:
            found = self._check_pipe.recv()
        except EOFError:
            found = {"error": "the check ended with an error of its own; see the terminal", "findings": []}
        self._check_pipe = None
        passed = not found["error"] and all(one["passed"] is not False for one in found["findings"])
        if passed:
            self._passed.add(self._checked)
        self._findings = {"kind": "checked", "key": self._checked, "passed": passed, **found}
        self.hub.tell(self._findings)

    def _start_run(self, browser: Browser, said: Message) -> None:
        """Start a ramp whose check was green, in a process of its own that outlives this one."""
        profile, scenario = str(said.get("profile", "")), str(said.get("scenario", ""))
        if not self._can_start or f"{profile}|{scenario}" not in self._passed:
            _refuse(browser, "a run starts once the check of its profile is green")
            return
        try:
            known, _ = load(profile)
            asked = asked_of(said, self._folder, Path(profile).stem)
        except InputError as error:
            _refuse(browser, str(error))
            return
        if self.watch is not None:
            self.watch.close()
        board = Board()
        self._run = multiprocessing.get_context("spawn").Process(
            target=run_profile, args=(profile, board.name, _known_scenario(scenario), asked), name="run"
        )
        self._run.start()
        self.hub.tell({"kind": "started", "profile": profile, "out": asked.out.name})
        self.watch = WatchedRun(known, board, self.hub.tell)


def _known_scenario(name: str) -> str | None:
    return name if name in scenario_names() else None


def _refuse(browser: Browser, why: str) -> None:
    browser.send(json.dumps({"kind": "refused", "why": why, "at": time.time()}))


def asked_of(said: Message, folder: Path, stem: str) -> AskedRun:
    """What the page asks of a run before it starts: name, note, keys and seed; the name is dated where none is given.

    Raises
    ------
    InputError
        For a name that is taken, or none of a file, keys that are none, and a seed that is no number.
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


def offered_profiles(folder: Path, wanted: str | None) -> list[str]:
    """Profiles that a page offers: the one asked for, those of the runs' folder, and the shipped ones.

    Raises
    ------
    InputError
        Where there is no such profile.
    """
    if wanted is not None:
        find_profile(wanted)
    own = sorted(str(path) for path in folder.glob("*.toml"))
    return list(dict.fromkeys([*([wanted] if wanted else []), *own, *shipped_names()]))


HERE = Path(__file__).parent


def section(place: Place) -> Section:
    """The section; ``place.options["live"]`` has ``offered`` and ``watched`` of `bench.live.pages.Desk`."""
    options = place.options.get("live", {})
    desk = Desk(place.folder, options.get("offered", ()), options.get("watched"))
    templates = templates_of(HERE / "templates")

    async def show(request: Request) -> Response:
        return templates.TemplateResponse(request, "live.html")

    routes = [Route("/live", show), socket_route("/live/socket", desk.talk)]
    return Section("live", "Live", "/live", routes, HERE / "static", desk.running)
