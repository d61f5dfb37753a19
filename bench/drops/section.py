"""The page of drop tests, as a section of the desk and by itself: one websocket, stretches of a sound, film tracks."""

from __future__ import annotations

from pathlib import Path

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from bench.drops.desk import DropDesk
from bench.web.browsers import socket_route
from bench.web.section import Place, Section, templates_of
from daq.files.wav import is_wav, open_wav
from daq.setup.errors import InputError

HERE = Path(__file__).parent


def section(place: Place) -> Section:
    """The section; ``place.options["drop"]`` has ``request`` and ``target`` of `bench.drops.desk.DropDesk`."""
    options = place.options.get("drop", {})
    desk = DropDesk(place.folder, options.get("request"), options.get("target"))
    templates = templates_of(HERE)

    async def show(request: Request) -> Response:
        return templates.TemplateResponse(request, "page.html")

    def wave(request: Request) -> Response:
        return JSONResponse(_envelope(desk, request))

    async def picture(request: Request) -> Response:
        made = desk.pictures.get(request.path_params["file"])
        if made is None:
            raise HTTPException(404, "no picture of that file")
        return Response(made, media_type="image/png")

    routes = [
        Route("/drop", show), Route("/drop/wave", wave), Route("/drop/picture/{file:int}", picture),
        socket_route("/drop/socket", desk.talk),
    ]  # fmt: skip
    return Section("drop", "Drop test", "/drop", routes, HERE / "static", desk.running)


def _envelope(desk: DropDesk, request: Request) -> dict[str, list[float]]:
    """Lowest and highest samples of a stretch of an open sound, by column."""
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
    return {"time_s": at.tolist(), "low": low.tolist(), "high": high.tolist()}
