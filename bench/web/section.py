"""A section of the desk: the pages of one module, and the places that sections are made for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from starlette.routing import BaseRoute
from starlette.templating import Jinja2Templates

FRAME = Path(__file__).parent / "templates"


@dataclass(frozen=True)
class Place:
    """What a section is made for."""

    folder: Path  # the runs' folder, absolute; no request reaches a file outside it
    # plain values for single sections, keyed by the section's name
    options: Mapping[str, Any] = field(default_factory=dict)
    # what one section makes and another one needs, by the maker's name
    shared: dict[str, Any] = field(default_factory=dict, compare=False)


@dataclass(frozen=True)
class Section:
    """Pages of one module."""

    name: str  # short name; its static files are served under ``/static/NAME/``
    title: str  # of the navigation's entry
    href: str  # the page that it opens
    routes: Sequence[BaseRoute]  # starlette routes, websockets included; paths of different sections must differ
    static: Path | None = None  # folder of scripts, styles and pictures; None without any
    # context held open while the server runs (readers, workers); None without any
    running: Callable[[], AbstractAsyncContextManager[None]] | None = None


def templates_of(folder: Path) -> Jinja2Templates:
    """The pages in a section's folder, Jinja2 templates that extend ``frame.html``; every value is escaped."""
    loader = FileSystemLoader([folder, FRAME])
    return Jinja2Templates(
        env=Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    )
