"""The desk's page on which a person arms real hardware for one call of an agent."""

from __future__ import annotations

import json
from pathlib import Path

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from bench.agent.door import Door, arm, armed, disarm
from bench.web.serve import Place, Section, templates_of
from daq.setup.errors import InputError

HERE = Path(__file__).parent


def section(place: Place) -> Section:
    """The page; profiles are those that an agent may name."""
    door, templates = Door(place.folder), templates_of(HERE)

    def show(request: Request) -> Response:
        found = door.profiles()
        names = {"names": [*found["own"], *(name for name in found["shipped"] if name != "simulated")]}
        return templates.TemplateResponse(request, "page.html", names)

    def state(request: Request) -> Response:
        return JSONResponse(armed(place.folder))

    async def change(request: Request) -> Response:
        try:
            name = json.loads(await request.body())["profile"]
            if name is None:
                disarm(place.folder)
            else:
                arm(place.folder, door.text_of(name), name)
        except InputError:
            raise
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise HTTPException(422, "wanted JSON with profile: a name, or null") from error
        return state(request)

    routes = [Route("/agent", show), Route("/agent/armed", state), Route("/agent/armed", change, methods=["POST"])]
    return Section("agent", "Agent", "/agent", routes, HERE / "static")
