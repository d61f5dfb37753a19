"""The browsers of a page: what each still has to get, and which of them holds the controls."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import time
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, TypeAlias

from starlette.routing import WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

GONE_S = 6.0  # the controls wait for a browser that loads the page again
SILENT_S = 15.0  # after which a holder that does not answer loses the controls to the one that asked
NAME, NO_NAME = re.compile(r"[0-9a-f]{16,64}"), 4400  # of a browser; why a socket is closed without one


class Browser:
    """One open page, by its own name; ``words_only``: it draws no scope, ``reads_only``: it may do nothing else."""

    def __init__(self, socket: WebSocket, name: str) -> None:
        self.socket, self.name = socket, name
        self.words_only = self.reads_only = False
        self._queue: asyncio.Queue[str | bytes] = asyncio.Queue(400)

    def send(self, message: str | bytes, *, passing: bool = False) -> None:
        """Queue a message; one that is ``passing`` (a piece of the scope) is left out for a browser that is behind."""
        if self.words_only and isinstance(message, bytes):
            return
        # a browser this far behind gets no more of the scope until it has caught up
        if passing and self._queue.qsize() > 100:
            return
        # a browser that is behind by the whole queue loses messages: the run must not wait for it
        with contextlib.suppress(asyncio.QueueFull):
            self._queue.put_nowait(message)

    async def deliver(self) -> None:
        """Send what is queued, until the browser is gone."""
        with contextlib.suppress(WebSocketDisconnect, RuntimeError, OSError):
            while True:
                message = await self._queue.get()
                if isinstance(message, bytes):
                    await self.socket.send_bytes(message)
                else:
                    await self.socket.send_text(message)


Greet: TypeAlias = Callable[[Browser], Awaitable[None]]
Obey: TypeAlias = Callable[[Browser, dict[str, Any]], None]


class Lease:
    """Who holds the controls: one browser, until it gives them away, is gone, or does not answer."""

    def __init__(self) -> None:
        self.holder: str | None = None
        self.asked_by: str | None = None
        self._asked_at = 0.0
        self._gone_at: float | None = None

    def may(self, name: str) -> bool:
        """Whether a browser holds the controls."""
        return self.holder == name

    def ask(self, name: str, now: float) -> None:
        """Ask for the controls: given at once where no one holds them."""
        if self.holder in (None, name):
            self._give(name)
        elif self.asked_by is None:
            self.asked_by, self._asked_at = name, now

    def hand_over(self, name: str) -> None:
        """The holder ``name`` gives the controls to the one that asked, or sets them free."""
        if self.holder == name:
            self._give(self.asked_by)

    def keep(self, name: str) -> None:
        """The holder ``name`` keeps the controls."""
        if self.holder == name:
            self.asked_by = None

    def came(self, name: str) -> None:
        """A browser is there (again)."""
        if self.holder == name:
            self._gone_at = None

    def left(self, name: str, now: float) -> None:
        """A browser is gone."""
        if self.asked_by == name:
            self.asked_by = None
        if self.holder == name:
            self._gone_at = now

    def pass_time(self, now: float) -> bool:
        """Take the controls from who is gone or silent; whether something changed."""
        gone = self._gone_at is not None and now - self._gone_at > GONE_S
        silent = self.asked_by is not None and now - self._asked_at > SILENT_S
        if gone or silent:
            self._give(self.asked_by)
        return gone or silent

    def _give(self, name: str | None) -> None:
        self.holder, self.asked_by, self._gone_at = name, None, None


class Hub:
    """All browsers of the page."""

    def __init__(self) -> None:
        self.browsers: list[Browser] = []
        self.lease = Lease()
        self._thin_until = 0.0

    def enter(self, browser: Browser) -> None:
        """A browser opens the page; the first one gets the controls."""
        self.browsers.append(browser)
        if browser.reads_only:
            return
        self.lease.came(browser.name)
        if self.lease.holder is None:
            self.lease.ask(browser.name, time.monotonic())
        self.tell_lease()

    def leave(self, browser: Browser) -> None:
        """A browser is gone."""
        self.browsers.remove(browser)
        if browser.reads_only:
            return
        if all(other.name != browser.name for other in self.browsers):
            self.lease.left(browser.name, time.monotonic())
        self.tell_lease()

    async def serve(self, browser: Browser, greet: Greet, obey: Obey) -> None:
        """Serve one browser until it is gone: ``greet`` it, then obey each JSON object it says, and nothing else."""
        delivering = asyncio.create_task(browser.deliver())
        self.enter(browser)
        try:
            await greet(browser)
            while (message := await browser.socket.receive())["type"] != "websocket.disconnect":
                with contextlib.suppress(ValueError, RecursionError):
                    said = json.loads(message.get("text") or "")  # a binary frame has no text
                    if isinstance(said, dict) and not browser.reads_only:
                        obey(browser, said)
        finally:
            delivering.cancel()
            self.leave(browser)

    def gives_controls(self, browser: Browser, wanted: object) -> bool:
        """Do what a browser wants of the controls (ask, hand_over, keep); whether it wanted one of these."""
        if wanted == "ask":
            self.lease.ask(browser.name, time.monotonic())
        elif wanted == "hand_over":
            self.lease.hand_over(browser.name)
        elif wanted == "keep":
            self.lease.keep(browser.name)
        else:
            return False
        self.tell_lease()
        return True

    def pass_time(self) -> None:
        """Take the controls from who is gone or silent."""
        if self.lease.pass_time(time.monotonic()):
            self.tell_lease()

    def tell_lease(self) -> None:
        """Tell every browser whether it holds the controls."""
        lease, active = self.lease, [one for one in self.browsers if not one.reads_only]
        for one in active:
            one.send(json.dumps({
                "kind": "lease", "mine": lease.may(one.name), "free": lease.holder is None,
                "asked": lease.asked_by is not None, "asked_by_me": lease.asked_by == one.name,
                "browsers": len(active),
            }))  # fmt: skip

    def tell(self, message: Mapping[str, Any] | bytes, *, passing: bool = False) -> None:
        """Tell all browsers; those that read only get no passing message, and the run's state twice a second."""
        packed, thinned = (message, passing) if isinstance(message, bytes) else (json.dumps(message), passing)
        if not isinstance(message, bytes) and message.get("kind") == "state":
            now = time.monotonic()
            thinned = now < self._thin_until
            if not thinned:
                # those who only read get a state twice a second
                self._thin_until = now + 0.5
        for one in self.browsers:
            if not (one.reads_only and thinned):
                one.send(packed, passing=passing)


def socket_route(path: str, talk: Greet) -> WebSocketRoute:
    """The websocket of a page: ``talk`` serves each browser that gives itself a name, the others are turned away."""

    async def accept(socket: WebSocket) -> None:
        name = socket.query_params.get("browser", "")
        if not NAME.fullmatch(name):
            await socket.close(NO_NAME)
            return
        await socket.accept()
        await talk(Browser(socket, name))

    return WebSocketRoute(path, accept)
