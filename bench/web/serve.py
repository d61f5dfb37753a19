"""The desk's server: a socket bound before anything is promised, and the loop that serves it."""

from __future__ import annotations

import importlib
import os
import secrets
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import uvicorn
from starlette.applications import Starlette

from bench.web.access import LOOPBACK, Access, is_loopback
from bench.web.application import make_app
from bench.web.section import Place
from daq.setup.errors import InputError

PORT = 8625


def bind(host: str = LOOPBACK, port: int | None = None, token: str | None = None) -> tuple[socket.socket, Access]:
    """A listening socket and the access that goes with it; a token is made where one is needed.

    Raises `InputError` when the address cannot be bound.

    Parameters
    ----------
    host
        Address to listen at.
    port
        None takes the first free one from `PORT` on; 0 any.
    token
        For browsers of other machines; None makes one where ``host`` is not the own machine's.
    """
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
        known = token or (None if is_loopback(host) else secrets.token_urlsafe(24))
        return listening, Access(host, listening.getsockname()[1], known)
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
    """Serve sections until the process is to end.

    Each of ``modules`` has a function ``section(place)``. ``on_ready`` is called once pages are answered; with
    ``own_signals`` Ctrl-C and SIGTERM end the server.
    """
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
