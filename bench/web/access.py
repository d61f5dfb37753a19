"""Who may talk to the desk, checked at every request and websocket before any page; and which files one may name.

A page of another site must not be able to drive the plate through the operator's browser. So the Host header must
name this server (an attacker's name that resolves to this machine does not), and a request that changes
something, or opens a websocket, must come from a page of this server (its Origin). Beyond the own machine a token is
needed too. Files are those below the runs' folder, and no other.
"""

from __future__ import annotations

import hmac
import ipaddress
import socket
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import parse_qsl, urlencode, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import cookie_parser
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from daq.setup.errors import InputError

LOOPBACK = "127.0.0.1"
COOKIE = "shakerbench_token"
MOST_BODY_BYTES = 1_000_000


@dataclass(frozen=True)
class Access:
    """Address of the server, and what a request needs; without a token only the own machine's (`InputError`)."""

    host: str  # where the server listens
    port: int
    # secret that a browser presents once (``?token=``) and keeps as a cookie; None on the own machine only
    token: str | None = None

    def __post_init__(self) -> None:
        """Refuse to listen to the network without a token."""
        if self.token is None and not is_loopback(self.host):
            raise InputError(f"--host {self.host}: other machines may only come in with a token; leave --host out")

    def knows_host(self, host: str) -> bool:
        """Whether a Host header (``name:port``) names this server."""
        try:
            parts = urlsplit(f"//{host}")
            name, port = parts.hostname or "", parts.port if parts.port is not None else 80
        except ValueError:
            return False
        if port != self.port or "@" in host or parts.path or parts.query or parts.fragment:
            return False
        if is_loopback(self.host):
            return name == "localhost" or name == self.host
        if self.host in ("0.0.0.0", "::"):  # every address of this machine; a name that is not ours is an attack
            return _is_address(name) or name in ("localhost", socket.gethostname().lower())
        return name == self.host.lower()

    @property
    def url(self) -> str:
        """Address of the first page, with the token where there is one."""
        name = socket.gethostname() if self.host in ("0.0.0.0", "::") else self.host
        shown = f"[{name}]" if ":" in name else name
        return f"http://{shown}:{self.port}/" + (f"?{urlencode({'token': self.token})}" if self.token else "")


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches an address."""
    return host == "localhost" or (_is_address(host) and ipaddress.ip_address(host).is_loopback)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


class Guard:
    """ASGI middleware: refuse what `Access` does not know, and set the headers that confine a page."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or answer it with a refusal."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        answer = self._refusal(scope, headers) or self._without_token(scope, headers)
        confined = _confined(send, headers.get("host", ""))
        if answer is None:
            await self._app(scope, _bounded(receive), confined)
        elif scope["type"] == "websocket":
            await receive()  # the connection's opening
            # codes from 4000 on are an application's own: 403 as a browser would get it for a page
            await send({"type": "websocket.close", "code": 4403, "reason": "refused"})
        else:
            await answer(scope, receive, confined)

    def _refusal(self, scope: Scope, headers: Headers) -> Response | None:
        """Answer to a request of a strange host or origin, or with too large a body; None for one of ours."""
        hosts, origins = headers.getlist("host"), headers.getlist("origin")
        if len(hosts) != 1 or not self._access.knows_host(hosts[0]):
            return PlainTextResponse("421: this server is not known by that name", 421)
        # a websocket has no method: like all that changes something it must come from a page of this server
        must_be_ours = bool(origins) or scope.get("method", "") not in ("GET", "HEAD")
        foreign = headers.get("sec-fetch-site") in ("cross-site", "same-site")
        if must_be_ours and origins != [f"http://{hosts[0]}"]:
            return PlainTextResponse("403: only pages of this server may ask for that", 403)
        if not must_be_ours and foreign and headers.get("sec-fetch-dest") != "document":
            return PlainTextResponse("403: pages of other sites may only link to this one", 403)
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > MOST_BODY_BYTES:
            return PlainTextResponse("413: too much", 413)
        return None

    def _without_token(self, scope: Scope, headers: Headers) -> Response | None:
        """Answer to a request without the token; it is taken once from the address and stored as a cookie."""
        token = self._access.token
        if token is None or _same(cookie_parser(headers.get("cookie", "")).get(COOKIE, ""), token):
            return None
        query = parse_qsl(scope.get("query_string", b"").decode("latin-1"))
        if scope["type"] == "http" and scope["method"] == "GET" and _same(dict(query).get("token", ""), token):
            rest = urlencode([(key, value) for key, value in query if key != "token"])
            path = "/" + scope["path"].lstrip("/\\")  # never another host's
            answer = RedirectResponse(path + (f"?{rest}" if rest else ""), 303)
            answer.set_cookie(COOKIE, token, httponly=True, samesite="strict", path="/")
            return answer
        return PlainTextResponse("401: open the address with ?token=... that the server printed", 401)


def _same(given: str, wanted: str) -> bool:
    """Whether two secrets are one, in a time that does not depend on where they differ."""
    return hmac.compare_digest(given.encode(), wanted.encode())


def _bounded(receive: Receive) -> Receive:
    """``receive`` that gives up on a body without end."""
    seen = 0

    async def bounded() -> Message:
        nonlocal seen
        message = await receive()
        if message["type"] == "http.request":
            seen += len(message.get("body", b""))
            if seen > MOST_BODY_BYTES:
                return {"type": "http.disconnect"}
        return message

    return bounded


def _confined(send: Send, host: str) -> Send:
    """``send`` with headers that let a page load from this server only; a route's own headers stay."""
    confining = {
        "content-security-policy": (
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; font-src 'self'; "
            f"connect-src 'self' ws://{host}; form-action 'self'; frame-ancestors 'none'; base-uri 'none'"
        ),
        "x-content-type-options": "nosniff",
        "x-frame-options": "DENY",
        "referrer-policy": "no-referrer",
        "cross-origin-opener-policy": "same-origin",
        "cross-origin-resource-policy": "same-origin",
        "cache-control": "no-store",
    }

    async def confined(message: Message) -> None:
        if message["type"] == "http.response.start":
            message.setdefault("headers", [])
            headers = MutableHeaders(scope=message)
            for name, value in confining.items():
                headers.setdefault(name, value)
        await send(message)

    return confined


def file_inside(folder: Path, name: str) -> Path:
    """The file by its relative path below ``folder``, links followed; else a 404 that tells nothing of why."""
    refused = HTTPException(404, "no such file in the runs' folder")
    parts = name.split("/")
    if not name or any(part in ("", ".", "..") or "\\" in part or ":" in part or "\0" in part for part in parts):
        raise refused
    try:
        path = folder.joinpath(*parts).resolve(strict=True)
        is_inside = path.is_relative_to(folder.resolve(strict=True)) and path.is_file()
    except (OSError, RuntimeError) as error:
        raise refused from error
    if not is_inside:
        raise refused
    return path
