"""Watchers by link: a server of its own with one page and nothing that changes anything. Off unless asked for."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Receive, Scope, Send

from bench.web.access import Access, Guard
from bench.web.application import STATIC
from bench.web.browsers import Browser, Hub, socket_route
from bench.web.serve import Server, bind
from daq.setup.clock import SYSTEM, Clock

MOST_PER_S = 30  # requests of one address: a page needs a dozen
Greet = Callable[[Browser], Awaitable[None]]


class Watchers:
    """The second server, while it is open.

    Parameters
    ----------
    hub, greet
        Browsers of the page, and what each gets when it opens the page.
    show, static
        The page that watchers see, and the folder of its files, served under ``/static/live/``.

    Attributes
    ----------
    url
        The link with its token; empty while it is closed.
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
