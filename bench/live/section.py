"""The section of the desk that shows a run while it lasts: one page and one websocket."""

from __future__ import annotations

import re
from pathlib import Path

from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from bench.live.desk import Desk
from bench.web.html import Html
from bench.web.hub import Browser
from bench.web.page import page
from bench.web.section import Place, Section

HERE = Path(__file__).parent
_NAME = re.compile(r"[0-9a-f]{16,64}")


def section(place: Place) -> Section:
    """The section; ``place.options["live"]`` has ``offered`` and ``watched`` of `bench.live.desk.Desk`."""
    options = place.options.get("live", {})
    desk = Desk(place.folder, options.get("offered", ()), options.get("watched"))
    body = Html((HERE / "page.html").read_text(encoding="utf-8"))

    async def show(request: Request) -> Response:
        scripts, styles = ["/static/live/live.js"], ["/static/live/live.css"]
        return HTMLResponse(page(request, "live", body, scripts=scripts, styles=styles, name="live"))

    async def talk(socket: WebSocket) -> None:
        name = socket.query_params.get("browser", "")
        if not _NAME.fullmatch(name):
            await socket.close(4400)
            return
        await socket.accept()
        await desk.talk(Browser(socket, name))

    routes = [Route("/live", show), WebSocketRoute("/live/socket", talk)]
    return Section("live", "Live", "/live", routes, HERE / "static", desk.running)
