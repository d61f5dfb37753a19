"""The desk's server: its application, a socket bound before anything is promised, and the loop that serves it.

Watchers by link have a server of their own with one page and nothing that changes anything. Off unless asked for.
"""

from __future__ import annotations

import asyncio
import importlib
import os
import secrets
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import uvicorn
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.templating import Jinja2Templates
from starlette.types import ASGIApp, Receive, Scope, Send

from bench.web.access import LOOPBACK, Access, Guard, is_loopback
from bench.web.browsers import Browser, Greet, Hub, socket_route
from daq.setup.clock import SYSTEM, Clock
from daq.setup.errors import InputError

FRAME = Path(__file__).parent / "templates"


@dataclass(frozen=True)
class Place:
    """What a section is made for."""

    folder: Path  # the runs' folder, absolute; no request reaches a file outside it
    # plain values for single sections, keyed by the section's name
    options: Mapping[str, Any] = field(default_factory=dict)
    # what one section makes and another one needs, by the maker's name
    shared: dict[str, Any] = field(default_factory=dict, compare=False)


@dataclass(frozen=True)
class Section:
    """Pages of one module."""

    name: str  # short name; its static files are served under ``/static/NAME/``
    title: str  # of the navigation's entry
    href: str  # the page that it opens
    routes: Sequence[BaseRoute]  # starlette routes, websockets included; paths of different sections must differ
    static: Path | None = None  # folder of scripts, styles and pictures; None without any
    # context held open while the server runs (readers, workers); None without any
    running: Callable[[], AbstractAsyncContextManager[None]] | None = None


def templates_of(folder: Path) -> Jinja2Templates:
    """The pages in a section's folder, Jinja2 templates that extend ``frame.html``; every value is escaped."""
    loader = FileSystemLoader([folder, FRAME])
    return Jinja2Templates(
        env=Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    )


STATIC = Path(__file__).parent / "static"


def make_app(access: Access, sections: Sequence[Section]) -> Starlette:
    """The application that serves ``sections``; its first page is the first section's."""

    @asynccontextmanager
    async def running(app: Starlette) -> AsyncIterator[None]:
        async with AsyncExitStack() as stack:
            for section in sections:
                if section.running is not None:
                    await stack.enter_async_context(section.running())
            yield

    folders = [Mount("/static/web", StaticFiles(directory=STATIC), name="static")]
    folders += [Mount(f"/static/{one.name}", StaticFiles(directory=one.static)) for one in sections if one.static]

    async def first(request: Request) -> Response:
        return RedirectResponse(sections[0].href)

    templates = templates_of(FRAME)

    async def refusal(request: Request, error: Exception) -> Response:
        """A page, or JSON where a script asked; a refusal of a job or of the disk is 422, with its reason."""
        if not isinstance(request, Request):
            raise error  # of a websocket
        status, detail = (error.status_code, error.detail) if isinstance(error, HTTPException) else (422, str(error))
        if "text/html" not in request.headers.get("accept", ""):
            return JSONResponse({"error": detail}, status)
        return templates.TemplateResponse(request, "error.html", {"status": status, "detail": detail}, status)

    app = Starlette(
        routes=[Route("/", first), *folders, *(route for section in sections for route in section.routes)],
        middleware=[Middleware(Guard, access=access)],
        exception_handlers=dict.fromkeys((HTTPException, InputError, OSError), refusal),
        lifespan=running,
    )
    app.state.sections = tuple(sections)
    return app


PORT = 8625


def bind(host: str = LOOPBACK, port: int | None = None) -> tuple[socket.socket, Access]:
    """A listening socket and its access; port None: the first free one from `PORT` on, 0: any (or `InputError`)."""
    # another server of a second run may have the first ports
    ports = [port] if port is not None else range(PORT, PORT + 20)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    last: OSError | None = None
    for one in ports:
        listening = socket.socket(family, socket.SOCK_STREAM)
        if os.name == "posix":  # a server that died leaves its port taken; on Windows it means something else
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((host, one))
            listening.listen(64)
        except (OSError, OverflowError) as error:
            listening.close()
            last = error if isinstance(error, OSError) else OSError(str(error))
            continue
        token = None if is_loopback(host) else secrets.token_urlsafe(24)
        return listening, Access(host, listening.getsockname()[1], token)
    raise InputError(f"--host {host} --port {ports[0]}: cannot listen there ({last}); name another --port")


def serve(
    listening: socket.socket,
    access: Access,
    modules: Sequence[str],
    place: Place,
    *,
    on_ready: Callable[[], None] | None = None,
    own_signals: bool = True,
) -> None:
    """Serve sections (``section(place)`` of each module) to the end; ``on_ready`` is called once pages are answered."""
    app = make_app(access, [importlib.import_module(name).section(place) for name in modules])
    Server(app, on_ready, own_signals=own_signals).run([listening])


class Server(uvicorn.Server):
    """A server of one application; parameters as of `serve`."""

    def __init__(self, app: Starlette, on_ready: Callable[[], None] | None = None, *, own_signals: bool = True) -> None:
        super().__init__(uvicorn.Config(
            app,
            log_level="warning",
            access_log=False,
            server_header=False,
            date_header=False,
            lifespan="on",
            ws="websockets-sansio",
            ws_max_size=65536,
            ws_per_message_deflate=False,  # increments are small and the machine has better to do
            timeout_graceful_shutdown=1,
        ))  # fmt: skip
        self._on_ready, self._own_signals = on_ready, own_signals

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, and tell."""
        await super().startup(sockets)
        if self.started and self._on_ready is not None:
            self._on_ready()

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Heed signals only where they are this process's own."""
        if self._own_signals:
            with super().capture_signals():
                yield
        else:
            yield


MOST_PER_S = 30  # requests of one address: a page needs a dozen


class Watchers:
    """The second server, while it is open; ``url`` is the link with its token, empty while it is closed.

    Watchers are browsers of ``hub``; each gets what ``greet`` sends. They see the page ``show``, whose files, in the
    folder ``static``, are served under ``/static/live/``.
    """

    def __init__(self, hub: Hub, greet: Greet, show: Callable[[Request], Awaitable[Response]], static: Path) -> None:
        self.url = ""
        self._hub, self._greet, self._show, self._static = hub, greet, show, static
        self._server: Server | None = None
        self._task: asyncio.Task[None] | None = None

    def open(self, host: str = "0.0.0.0") -> None:
        """Begin to serve, at a new port with a new token; raises `InputError` where that cannot be."""
        if self._server is not None:
            return
        listening, access = bind(host, 0)
        self._server, self.url = Server(self.application(access), own_signals=False), access.url
        self._task = asyncio.create_task(self._server.serve([listening]))

    def application(self, access: Access) -> Starlette:
        """The page, its scripts and its socket: all that a watcher can reach."""
        static = [
            Mount(f"/static/{name}", StaticFiles(directory=folder))
            for name, folder in (("web", STATIC), ("live", self._static))
        ]
        routes = [Route("/", self._show), *static, socket_route("/live/socket", self._talk)]
        app = Starlette(routes=routes, middleware=[Middleware(Slow), Middleware(Guard, access=access)])
        app.state.sections = ()
        return app

    def close(self) -> None:
        """End the server; links that were given out lead nowhere."""
        if self._server is not None:
            self._server.should_exit = True
        self._server, self.url = None, ""

    async def _talk(self, browser: Browser) -> None:
        """Serve one watcher until it is gone, or turn it away where there are too many."""
        browser.reads_only = True
        if sum(one.reads_only for one in self._hub.browsers) >= 40:
            await browser.socket.close(4429, "too many watchers")
            return
        await self._hub.serve(browser, self._greet, lambda browser, said: None)  # what a watcher says does not count


class Slow:
    """ASGI middleware: refuse an address that asks too often."""

    def __init__(self, app: ASGIApp, clock: Clock = SYSTEM) -> None:
        self._app, self._clock, self._second = app, clock, 0
        self._asked: dict[str, int] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Count and pass on, or answer 429."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        second, address = int(self._clock.monotonic_s()), str((scope.get("client") or ("",))[0])
        if second != self._second:
            self._second, self._asked = second, {}
        self._asked[address] = self._asked.get(address, 0) + 1
        if self._asked[address] <= MOST_PER_S:
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 4429, "reason": "too often"})
        else:
            await PlainTextResponse("429: too often; wait a second", 429)(scope, receive, send)
