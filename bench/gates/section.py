"""The section of the desk with the six gates: its page, the profile's keys, and the socket."""

from __future__ import annotations

from pathlib import Path

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from bench.gates.desk import Gates
from bench.live.pages import desk_of
from bench.profiles.edit import fields_of
from bench.web.browsers import socket_route
from bench.web.section import Place, Section, templates_of
from daq.setup.errors import InputError
from daq.setup.values import read_toml_text

HERE = Path(__file__).parent


def section(place: Place) -> Section:
    """The section; ``place.options["gates"]["offered"]`` is a profile to begin with."""
    gates = Gates(place.folder, desk_of(place), place.options.get("gates", {}).get("offered"))
    templates = templates_of(HERE / "templates")

    async def show(request: Request) -> Response:
        return templates.TemplateResponse(request, "gates.html")

    def fields(request: Request) -> Response:
        """Every key of the profile, with its value, unit, limits and help."""
        if not gates.state.profile:
            raise HTTPException(404, "no profile is chosen")
        try:
            return JSONResponse({"fields": fields_of(read_toml_text(gates.path))})
        except (InputError, OSError) as error:
            raise HTTPException(422, str(error)) from error

    routes = [Route("/gates", show), Route("/gates/fields", fields), socket_route("/gates/socket", gates.talk)]
    return Section("gates", "Start", "/gates", routes, HERE / "static", gates.running)
