"""The drop test in the page's process: one state that all browsers see, corrections by hand, and the page's section."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter
from starlette.exceptions import HTTPException
from starlette.requests import Request as WebRequest
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from analysis.drop.corrections import Corrections
from analysis.drop.film.video import FILMS
from bench.drops.worker import work
from bench.jobs.drop_test import POSITIVE, Request, check_request
from bench.terminal.run_console import spawned
from bench.web.access import file_inside
from bench.web.browsers import Browser, Hub, socket_route
from bench.web.serve import Place, Section, templates_of
from daq.files.disk import write_whole
from daq.files.json_values import json_text
from daq.files.wav import is_wav, open_wav
from daq.setup.errors import InputError

HERE = Path(__file__).parent
ENDING = ".drop.json"
_SAME_S = 1e-7


def moved(part: Corrections, gone_s: float | None, new_s: float | None, same_s: float = _SAME_S) -> Corrections:
    """``part`` with an impact taken away (``gone_s``, known to ``same_s``), added (``new_s``) or, with both, moved."""
    ignored, added = part.ignore_s, part.add_s
    if gone_s is not None:
        own = [t for t in added if abs(t - gone_s) <= same_s]
        if own:
            nearest = min(own, key=lambda t: abs(t - gone_s))
            added = tuple(t for t in added if t != nearest)
        else:
            ignored = (*ignored, gone_s)
    if new_s is not None:
        back = [t for t in ignored if abs(t - new_s) <= _SAME_S]
        if back:
            ignored = tuple(t for t in ignored if t not in back)
        else:
            added = (*added, round(new_s, 7))  # decimals of a second of a person's mark
    return replace(part, ignore_s=ignored, add_s=added)


def side_file(file: Path) -> Path:
    """The file next to a recording of a drop that has its result with all corrections."""
    return file.with_name(file.name + ENDING)


def saved_request(target: Path, files: Sequence[Path]) -> Request | None:
    """The request of the result in ``target`` on ``files``; None: none, or other files' (`InputError`: no result)."""
    try:
        text = target.read_text(encoding="utf-8")
    except OSError:
        return None
    try:
        saved = TypeAdapter(Request).validate_python(json.loads(text)["options"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{target}: wanted the result of a drop test as JSON; move it away or remove it") from error
    names = [file.name for file in files]
    if [file.name for file in saved.files] != names or len(saved.corrections) != len(names):
        return None
    return replace(saved, files=tuple(files))


SUFFIXES = {".wav", ".csv", ".tsv", ".txt", ".xls", ".xlsx", *FILMS}
Message = dict[str, Any]


class DropDesk:
    """State of the page, and what browsers may do to it; files of ``folder`` may be opened.

    ``request``: a drop test to show from the start, of files anywhere; None leaves the choice to the browser.
    ``target``: file for the JSON; None: next to the first file.
    """

    def __init__(self, folder: Path, request: Request | None = None, target: Path | None = None) -> None:
        self.hub = Hub()
        self.request = request
        self.pictures: dict[int, bytes] = {}
        self._folder, self._fixed, self._target = folder, request is not None, target
        self._undo: list[Request] = []
        self._shown: Message | None = None
        self._payload: Message | None = None
        self._pipe: Any = None
        self._process: Any = None
        self._asked: Request | None = None  # what the worker is at

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Look after the worker while the server runs."""
        ticking = asyncio.create_task(self._tick_for_ever())
        try:
            yield
        finally:
            ticking.cancel()
            self._end_worker()

    async def _tick_for_ever(self) -> None:
        if self.request is not None:
            self._measure()
        while True:
            self.hub.pass_time()
            self._look_at_worker()
            await asyncio.sleep(0.05)

    async def talk(self, browser: Browser) -> None:
        """Serve one browser until it is gone."""
        await self.hub.serve(browser, self._greet, self._obey)

    async def _greet(self, browser: Browser) -> None:
        offered = [] if self._fixed else await asyncio.to_thread(self._offered)
        browser.send(json.dumps({"kind": "offer", "files": offered, "choose": not self._fixed}))
        browser.send(json.dumps(self._form()))
        if self._shown is not None:
            browser.send(json.dumps(self._shown))

    def _offered(self) -> list[str]:
        """Files below the folder that may hold a drop, without hidden ones."""
        files = [path for path in sorted(self._folder.rglob("*")) if path.suffix.lower() in SUFFIXES and path.is_file()]
        inside = [path.relative_to(self._folder) for path in files]
        shown = [path.as_posix() for path in inside if not any(part.startswith(".") for part in path.parts)]
        return shown[:500]

    def _form(self) -> Message:
        """The request as the form shows it."""
        request = self.request
        if request is None:
            return {"kind": "request", "files": []}
        return {
            "kind": "request",
            "files": [path.name for path in request.files],
            "heights_m": list(request.heights_m),
            "can_undo": bool(self._undo),
            **{name: getattr(request, name) for name in POSITIVE},
        }

    def _obey(self, browser: Browser, said: Message) -> None:
        """Do what a browser asks; all but questions of the lease only for the holder of the controls."""
        wanted = said.get("do")
        if self.hub.gives_controls(browser, wanted):
            return
        try:
            if not self.hub.lease.may(browser.name):
                raise InputError("another browser holds the controls")
            self._do(str(wanted), said)
        except (InputError, HTTPException) as error:
            why = error.detail if isinstance(error, HTTPException) else str(error)
            browser.send(json.dumps({"kind": "no", "why": why}))

    def _do(self, wanted: str, said: Message) -> None:
        if wanted == "open" and not self._fixed:
            self._open(said.get("files"))
        elif self.request is None:
            raise InputError("open a file first")
        elif wanted == "correct":
            self._correct(self.request, said)
        elif wanted == "options":
            # an empty field is the default
            found: dict[str, Any] = {name: _number(said.get(name)) for name in POSITIVE}
            if found["gravity_mps2"] is None:
                found["gravity_mps2"] = Request.gravity_mps2
            given = said.get("heights_m")
            heights = tuple(h for h in map(_number, given if isinstance(given, list) else []) if h is not None)
            self._change(replace(self.request, heights_m=heights, **found))
        elif wanted == "undo" and self._undo:
            self.request = self._undo.pop()
            self._measure()
        elif wanted == "reset":
            bare = tuple(replace(part, ignore_s=(), add_s=()) for part in self.request.corrected)
            self._change(replace(self.request, corrections=bare))
        elif wanted == "save":
            self._save(self.request)

    def _open(self, names: object) -> None:
        """Show files of the folder; a result next to the first comes back with its corrections."""
        if not isinstance(names, list) or not 0 < len(names) <= 24:
            raise InputError("open 1 to 24 files at a time")
        files = [file_inside(self._folder, str(name)) for name in names]
        request = saved_request(side_file(files[0]), files) or Request(tuple(files))
        check_request(request)
        self.request, self._undo, self._shown, self._payload, self.pictures = request, [], None, None, {}
        self._measure()

    def _correct(self, request: Request, said: Message) -> None:
        """An impact moved, added or taken away."""
        number = said.get("file")
        gone, new, same = (_number(said.get(key)) for key in ("gone_s", "new_s", "same_s"))
        if not isinstance(number, int) or not 0 <= number < len(request.files) or (gone is None and new is None):
            raise InputError("wanted a file, and the time of an impact")
        parts = list(request.corrected)
        parts[number] = moved(parts[number], gone, new, min(max(same or 0.0, 1e-9), 1.0))
        if len(parts[number].ignore_s) + len(parts[number].add_s) > 2000:
            raise InputError("more than 2000 corrections: choose another part of the file instead")
        self._change(replace(request, corrections=tuple(parts)))

    def _change(self, request: Request) -> None:
        check_request(request)
        if self.request is not None:
            self._undo.append(self.request)
        self.request = request
        self._measure()

    def _save(self, request: Request) -> None:
        """The JSON as `bench drop --json` writes it."""
        if self._payload is None or self._asked is not None:
            raise InputError("there is no result to keep yet")
        target = self._target or side_file(request.files[0])
        if self._target is None:
            saved_request(target, request.files)  # refuses to write over a file of another kind
        try:
            write_whole(target, json_text(self._payload))
        except OSError as error:
            raise InputError(f"{target}: cannot be written ({error.strerror or error})") from error
        self.hub.tell({"kind": "saved", "as": target.name})

    def _measure(self) -> None:
        """Ask the worker for the present request, now or when it has done what it is at."""
        self.hub.tell(self._form())
        if self._asked is not None:
            return
        if self._process is None or not self._process.is_alive():
            self._pipe, self._process = spawned(work, not self._fixed, name="drop test", daemon=True)
        self._asked = self.request
        self._pipe.send(self._asked)
        self.hub.tell({"kind": "working", "what": "measuring", "done": 0, "total": 0})

    def _look_at_worker(self) -> None:
        """Pass on what the worker says; a result of a request that was changed meanwhile is passed over."""
        while self._asked is not None and self._pipe.poll():
            try:
                answer = self._pipe.recv()
            except (EOFError, OSError):
                why = "the process that measures has died of this file"
                answer = ("done", {"kind": "refused", "why": why, "files": [], "command": None}, None, {})
                self._end_worker()
            if answer[0] == "progress":
                _, what, done, total = answer
                self.hub.tell({"kind": "working", "what": what, "done": done, "total": total})
                continue
            current, self._asked = self._asked, None
            if current != self.request:
                self._measure()
                return
            _, self._shown, self._payload, self.pictures = answer
            self.hub.tell(self._shown or {})

    def _end_worker(self) -> None:
        if self._process is not None:
            self._process.terminate()
            self._process.join(2.0)
            self._pipe.close()
        self._process = self._pipe = None


def _number(value: object) -> float | None:
    """A finite number that a browser sent; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)


def section(place: Place) -> Section:
    """The section; ``place.options["drop"]`` has ``request`` and ``target`` of `DropDesk`."""
    options = place.options.get("drop", {})
    desk = DropDesk(place.folder, options.get("request"), options.get("target"))
    templates = templates_of(HERE)

    async def show(request: WebRequest) -> Response:
        return templates.TemplateResponse(request, "page.html")

    def wave(request: WebRequest) -> Response:
        # lowest and highest samples of a stretch of an open sound, by column
        try:
            number, width = int(request.query_params["file"]), int(request.query_params["width"])
            start_s, stop_s = (float(request.query_params[key]) for key in ("start_s", "stop_s"))
        except (KeyError, ValueError) as error:
            raise HTTPException(422, "wanted file, start_s, stop_s and width") from error
        files = desk.request.files if desk.request is not None else ()
        if not 0 <= number < len(files) or not is_wav(files[number]):
            raise HTTPException(404, "no such sound is open")
        if not (0.0 <= start_s < stop_s < 1e9 and 0 < width <= 8192):
            raise HTTPException(422, "wanted 0 <= start_s < stop_s, and at most 8192 columns")
        try:
            at, low, high = open_wav(files[number]).envelope(start_s, stop_s, width)
        except (InputError, OSError) as error:
            raise HTTPException(422, str(error)) from error
        return JSONResponse({"time_s": at.tolist(), "low": low.tolist(), "high": high.tolist()})

    async def picture(request: WebRequest) -> Response:
        made = desk.pictures.get(request.path_params["file"])
        if made is None:
            raise HTTPException(404, "no picture of that file")
        return Response(made, media_type="image/png")

    routes = [
        Route("/drop", show), Route("/drop/wave", wave), Route("/drop/picture/{file:int}", picture),
        socket_route("/drop/socket", desk.talk),
    ]  # fmt: skip
    return Section("drop", "Drop test", "/drop", routes, HERE / "static", desk.running)
