"""The desk's application: sections, static files and errors behind the guard."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from bench.web.access import Access, Guard
from bench.web.section import FRAME, Section, templates_of

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
        """A page, or JSON where a script asked."""
        if not isinstance(error, HTTPException):
            raise error
        status = error.status_code
        if "text/html" not in request.headers.get("accept", ""):
            return JSONResponse({"error": error.detail}, status)
        return templates.TemplateResponse(request, "error.html", {"status": status, "detail": error.detail}, status)

    app = Starlette(
        routes=[Route("/", first), *folders, *(route for section in sections for route in section.routes)],
        middleware=[Middleware(Guard, access=access)],
        exception_handlers={HTTPException: refusal},
        lifespan=running,
    )
    app.state.sections = tuple(sections)
    return app
