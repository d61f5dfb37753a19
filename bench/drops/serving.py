"""`bench drop --page`: the page of one drop test, served until Ctrl-C."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bench.jobs.drop_test import Request
from bench.web.packages import require_packages


def serve_page(request: Request, target: Path | None, port: int | None, say: Callable[[str], None]) -> None:
    """Serve the page; ``say`` is told its address, ``target`` takes the JSON that is kept (default: beside the file).

    Raises
    ------
    InputError
        When the page cannot be served.
    """
    require_packages()
    from bench.web.section import Place
    from bench.web.serve import bind, serve

    listening, access = bind(port=port)
    place = Place(request.files[0].resolve().parent, {"drop": {"request": request, "target": target}})
    serve(listening, access, ["bench.drops.section"], place, on_ready=lambda: say(access.url))
