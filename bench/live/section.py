"""The section of the desk that shows a run while it lasts: one page and one websocket."""

from __future__ import annotations

from pathlib import Path

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from bench.live.desk import Desk
from bench.web.hub import socket_route
from bench.web.section import Place, Section, templates_of

HERE = Path(__file__).parent


def section(place: Place) -> Section:
    """The section; ``place.options["live"]`` has ``offered`` and ``watched`` of `bench.live.desk.Desk`."""
    options = place.options.get("live", {})
    desk = Desk(place.folder, options.get("offered", ()), options.get("watched"))
    templates = templates_of(HERE / "templates")

    async def show(request: Request) -> Response:
        return templates.TemplateResponse(request, "live.html")

    routes = [Route("/live", show), socket_route("/live/socket", desk.talk)]
    return Section("live", "Live", "/live", routes, HERE / "static", desk.running)
