"""The section of the desk that shows a run while it lasts: browsers, the run that they watch, runs that they start."""

from __future__ import annotations

import asyncio
import contextlib
import json
import multiprocessing
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from bench.live.board import LONGEST_NOTE, Board, Message
from bench.live.processes import AskedRun, run_profile
from bench.live.scope_data import MinMax
from bench.live.watched_run import WatchedRun
from bench.profiles.find import load
from bench.web.browsers import Browser, Hub, socket_route
from bench.web.serve import Place, Section, Watchers, templates_of
from daq.setup.errors import InputError
from rig.profile import Profile, load_profile

HERE = Path(__file__).parent
COMMANDS = ("finish", "ramp_down", "pause", "go_on", "note", "next")


class Desk:
    """What browsers see and do; ``watched``: profile and board of a run in a terminal (None: runs are started here)."""

    def __init__(self, watched: tuple[Profile, str] | None) -> None:
        self.hub = Hub()
        self.watch: WatchedRun | None = None
        self._watched = watched
        self._run: Any = None
        self.watchers = Watchers(self.hub, self._greet, partial(_show, watching=True), HERE / "static")

    @property
    def busy(self) -> bool:
        """Whether a run that was started from the page is under way."""
        if self._run is not None:
            return bool(self._run.is_alive())
        return self.watch is not None and not self.watch.is_silent

    def outcome_of(self, out: str) -> Message | None:
        """How the run into the recording ``out`` ended; None where that is not known."""
        watch = self.watch
        return None if watch is None or watch.out not in ("", out) else watch.ended

    def start(self, profile: Path, scenario: str | None, asked: AskedRun) -> Message:
        """Start a ramp in a process that outlives this one (raises `InputError`); what `attach` needs to find it."""
        known, _ = load(profile)
        if self.watch is not None:
            self.watch.close()
        board = Board()
        self._run = multiprocessing.get_context("spawn").Process(
            target=run_profile, args=(str(profile), board.name, scenario, asked), name="run"
        )
        self._run.start()
        self.hub.tell({"kind": "started", "profile": known.name, "out": asked.out.name})
        self.watch = WatchedRun(known, board, self.hub.tell)
        return {"board": board.name, "profile": str(profile), "out": asked.out.name}

    def attach(self, run: Message) -> None:
        """Watch a run that another server has started; one that is over or gone is not watched."""
        with contextlib.suppress(OSError, InputError):
            self.watch = WatchedRun(load(run["profile"])[0], Board(run["board"]), self.hub.tell)
            self.watch.command({"do": "announce"})

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Look after the run while the server runs."""
        MinMax(1, 1)  # compiled before a run needs it
        if self._watched is not None:
            profile, board_name = self._watched
            with contextlib.suppress(OSError):
                self.watch = WatchedRun(profile, Board(board_name), self.hub.tell)
        ticking = asyncio.create_task(self._tick_for_ever())
        try:
            yield
        finally:
            ticking.cancel()
            self.watchers.close()
            if self.watch is not None:
                self.watch.close(leave=self.busy)

    async def _tick_for_ever(self) -> None:
        due = time.monotonic()
        while True:
            self.hub.pass_time()
            if self.watch is not None:
                self.watch.tick()
                self._follow(self.watch)
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
        await self.hub.serve(browser, self._greet, self.obey)

    async def _greet(self, browser: Browser) -> None:
        browser.send(json.dumps({"kind": "offer", "in_terminal": self._watched is not None}))
        if not browser.reads_only:
            browser.send(json.dumps({"kind": "shared", "url": self.watchers.url}))
        for message in self.watch.history() if self.watch is not None else []:
            browser.send(message)

    def obey(self, browser: Browser, said: Message) -> None:
        """Do what a browser asks: anyone may stop the run at once; all else is for the browser with the controls."""
        wanted = said.get("do")
        if self.hub.gives_controls(browser, wanted):
            return
        if wanted == "now":
            if self.watch is not None:
                self.watch.command({"do": "now"})
        elif not self.hub.lease.may(browser.name):
            refused = {"kind": "refused", "why": "another browser holds the controls", "at": time.time()}
            browser.send(json.dumps(refused))
        elif wanted == "share":
            (self.watchers.open if said.get("on") is True else self.watchers.close)()
            for one in self.hub.browsers:
                if not one.reads_only:
                    one.send(json.dumps({"kind": "shared", "url": self.watchers.url}))
        elif wanted in COMMANDS and self.watch is not None:
            self.watch.command({"do": wanted, "text": str(said.get("text", ""))[:LONGEST_NOTE]})


async def _show(request: Request, *, watching: bool = False) -> Response:
    return templates_of(HERE / "templates").TemplateResponse(request, "live.html", {"watching": watching})


def desk_of(place: Place) -> Desk:
    """The desk of a place, which other sections start runs on; ``place.options["live"]["watched"]`` as of `Desk`."""
    desk: Desk = place.shared.setdefault("live", Desk(place.options.get("live", {}).get("watched")))
    return desk


def section(place: Place) -> Section:
    """The section that watches a run."""
    desk = desk_of(place)
    routes = [Route("/live", _show), socket_route("/live/socket", desk.talk)]
    return Section("live", "Live", "/live", routes, HERE / "static", desk.running)
