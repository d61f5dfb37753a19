"""The catalogue's section of the desk: the table, a run, and runs laid over each other.

A request names a run by its short name, never a file.
"""

from __future__ import annotations

import json
import re
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import Route

from analysis.loop.verdict import short_verdict
from bench.runs.catalogue import ENDS, WITH_NONE, Catalogue, Query, Row
from bench.runs.folder import run_id
from bench.runs.prepare import Workshop
from bench.runs.scope import Scope, change_of
from bench.web.serve import Place, Section, templates_of
from daq.files.json_values import json_values
from daq.recording.notebook import Remarks, in_words, with_note, with_tags
from daq.setup.errors import InputError

NAME = "runs"
STATIC, TEMPLATES = (Path(__file__).parent / name for name in ("static", "templates"))
FRESH_S = 1.0  # within which the folder is not looked through again
MOST_RUNS = 24  # laid over each other
MOST_EVENTS = 200  # in one stretch of a scope
Change = Callable[[Remarks], Remarks]
ID = re.compile(r"[0-9a-f]{12}")


def section(place: Place) -> Section:
    """The pages of the runs below ``place.folder``."""
    pages = Pages(place.folder)
    routes = [
        Route("/runs", pages.table),
        Route("/runs/compare", pages.compare),
        Route("/runs/file", pages.named),
        Route("/runs/api/list", pages.rows),
        Route("/runs/api/quantities", pages.quantities),
        Route("/runs/api/{id}", pages.details),
        Route("/runs/api/{id}/open", pages.open),
        Route("/runs/api/{id}/view", pages.view),
        Route("/runs/api/{id}/flights", pages.flights),
        Route("/runs/api/{id}/events", pages.events),
        Route("/runs/api/{id}/why", pages.why),
        Route("/runs/api/{id}/events", pages.remark, methods=["POST"]),
        Route("/runs/api/{id}/remarks", pages.remark, methods=["POST"]),
        Route("/runs/{id}", pages.run),
    ]
    return Section(NAME, "Runs", "/runs", routes, STATIC, pages.running)


class Pages:
    """Routes of the section; those that read files run in threads."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._catalogue: Catalogue | None = None
        self._workshop: Workshop | None = None
        self._scopes: dict[str, Scope] = {}
        self._updated_s = -FRESH_S
        self._lock = threading.Lock()
        self._templates = templates_of(TEMPLATES)

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """The catalogue and the worker, while the server runs."""
        try:
            yield
        finally:
            with self._lock:
                for scope in self._scopes.values():
                    scope.close()
                if self._workshop is not None:
                    self._workshop.close()
                self._catalogue = self._workshop = None

    @property
    def catalogue(self) -> Catalogue:
        """Opened at the first request."""
        with self._lock:
            if self._catalogue is None:
                self._catalogue = Catalogue(self.folder)
            return self._catalogue

    @property
    def workshop(self) -> Workshop:
        """Opened at the first request."""
        with self._lock:
            if self._workshop is None:
                self._workshop = Workshop(self.folder)
            return self._workshop

    def table(self, request: Request) -> Response:
        """The page with the table."""
        verdicts = {verdict: short_verdict(verdict) for verdict in WITH_NONE}
        values = {"ends": ENDS, "verdicts": verdicts, "folder": self.folder}
        return self._templates.TemplateResponse(request, "table.html", values)

    def run(self, request: Request) -> Response:
        """The page of one run."""
        row = self._row(request)
        return self._templates.TemplateResponse(request, "run.html", {"id": row["id"], "path": row["path"]})

    def named(self, request: Request) -> Response:
        """The page of the run whose file the address names, by its path below the folder."""
        return RedirectResponse(f"/runs/{run_id(request.query_params.get('path', ''))}")

    def compare(self, request: Request) -> Response:
        """The page of runs laid over each other."""
        return self._templates.TemplateResponse(request, "compare.html", {"ids": ",".join(self._ids(request))})

    def rows(self, request: Request) -> Response:
        """Rows of the table for the query in the address."""
        catalogue = self.catalogue
        if time.monotonic() - self._updated_s > FRESH_S:
            catalogue.update()
            self._updated_s = time.monotonic()
        query = _query(request)
        return _json({"said": catalogue.said or None, "runs": catalogue.runs(query), **catalogue.counts()})

    def details(self, request: Request) -> Response:
        """One run: its row, its notes and every verdict on it."""
        row = self._row(request)
        try:
            notes = [asdict(note) for note in self.catalogue.notebook(row)]
            said = set(in_words(self.catalogue.remarks(row).events))
        except InputError:
            notes, said = [], set()  # the row says why
        loops = []
        for loop in self.catalogue.loops(row["identity"]):
            # a verdict on several recordings has the sentences of all of them
            same = said == set(loop["by_hand"]) if loop["together"] == 1 else said <= set(loop["by_hand"])
            loops.append(loop | {"outdated": not same})
        return _json({"run": row, "notes": notes, "loops": loops})

    def open(self, request: Request) -> Response:
        """Facts that a run's scope needs; they are made at the first call and asked for again."""
        row = self._row(request)
        file, scope = self.catalogue.file_of(row), self._scopes.get(row["id"])
        if scope is None or not scope.is_current():
            path = self.workshop.pyramid(row, file)
            if path is None:
                return _json({"state": "working"})
            if scope is not None:
                scope.close()
            scope = self._scopes[row["id"]] = Scope(path, file)
        return _json({"state": "ready", **scope.facts()})

    def view(self, request: Request) -> Response:
        """A stretch of a run."""
        scope = self._opened(self._row(request))
        try:
            start_s, stop_s = (float(request.query_params[key]) for key in ("start_s", "stop_s"))
            width = int(request.query_params["width"])
        except (KeyError, ValueError) as error:
            raise HTTPException(422, "wanted start_s, stop_s and width") from error
        return _json(scope.view(start_s, stop_s, width))

    def flights(self, request: Request) -> Response:
        """Steps of a run, with their flights."""
        row = self._row(request)
        if row["ended"] == "damaged" and not row["n_samples"]:
            raise HTTPException(422, row["why"])
        made = self.workshop.flights(row, self.catalogue.file_of(row))
        return _json({"state": "working"} if made is None else {"state": "ready", "steps": made["steps"]})

    def events(self, request: Request) -> Response:
        """Events of a stretch, at most `MOST_EVENTS`, how many there are, and what was changed by hand."""
        row, given = self._row(request), request.query_params
        try:
            stretch = sorted(float(given[key]) for key in ("from_s", "to_s"))
        except (KeyError, ValueError) as error:
            raise HTTPException(422, "expected from_s and to_s") from error
        file = self.catalogue.file_of(row)
        made = self.workshop.flights(row, file)
        if made is None:
            return _json({"state": "working"})
        first, end = (int(i) for i in np.searchsorted(made["events"]["shown_s"], stretch))
        columns = {name: values[first : min(end, first + MOST_EVENTS)] for name, values in made["events"].items()}
        about = {"state": "ready", "count": end - first, "changes": made["changes"], "said": made["said"]}
        return _json(about | {"events": columns})

    def why(self, request: Request) -> Response:
        """Rivals and steps behind the latest verdict on a run, or the flights of the ``step`` that is named."""
        row = self._row(request)
        loop = next(iter(self.catalogue.loops(row["identity"])), None)
        if loop is None:
            raise HTTPException(404, "no closed loop of this run is saved; bench close-loop RECORDING makes one")
        files = self.catalogue.file_of(row), self.catalogue.file_of(loop)
        found = self.workshop.evidence(row, *files)
        if found is None:
            return _json({"state": "working"})
        if "step" not in request.query_params:
            return _json({"state": "ready", "rivals": found["rivals"], "steps": found["steps"]})
        asked = request.query_params["step"]
        rows = [i for i, step in enumerate(found["flights"]["step"]) if str(step) == asked]
        return _json({"state": "ready", **{name: [x[i] for i in rows] for name, x in found["flights"].items()}})

    def quantities(self, request: Request) -> Response:
        """Calibrations and effects by date, of the runs asked for or of all."""
        return _json({"quantities": self.catalogue.quantities(self._ids(request))})

    async def remark(self, request: Request) -> Response:
        """Tags added or taken away, a note added; or an event changed by hand (`bench.runs.scope.change_of`)."""
        row, body = self._row(request), await request.body()
        try:
            answer = json.loads(body)
            if request.url.path.endswith("/events"):  # in the time of the page's scope
                change = change_of(answer, self._opened(row).recorded_s)
            else:
                change = _remark(answer)
        except InputError as error:
            raise HTTPException(422, str(error)) from error
        except (ValueError, AttributeError, KeyError, TypeError, RecursionError) as error:
            wanted = "add, remove or note; of an event, undo, or kind, was_s and now_shown_s"
            raise HTTPException(422, f"wanted JSON with {wanted}") from error
        return await run_in_threadpool(self._changed, row, change)

    def _opened(self, row: Row) -> Scope:
        """The scope of a run that was opened before."""
        if (scope := self._scopes.get(row["id"])) is None:
            raise HTTPException(409, "open the run first")
        return scope

    def _changed(self, row: Row, change: Change) -> Response:
        changed = self.catalogue.change_remarks(row, change)
        notes = [asdict(note) for note in self.catalogue.notebook(row)]
        return _json({"tags": list(changed.tags), "notes": notes, "said": in_words(changed.events)})

    def _row(self, request: Request) -> Row:
        """The run that the address names; 404 where there is none."""
        id = request.path_params["id"]
        row = self.catalogue.run(id) if ID.fullmatch(id) else None
        if row is None and ID.fullmatch(id):  # perhaps recorded since the table was last brought up to date
            self.catalogue.update()
            row = self.catalogue.run(id)
        if row is None:
            raise HTTPException(404, "no such run")
        return row

    def _ids(self, request: Request) -> list[str]:
        """The runs that the address names; 404 for names that can be none, or too many."""
        ids = [one for one in request.query_params.get("ids", "").split(",") if one]
        if len(ids) > MOST_RUNS or not all(ID.fullmatch(one) for one in ids):
            raise HTTPException(404, f"wanted at most {MOST_RUNS} runs by their short names")
        return ids


def _remark(answer: Any) -> Change:
    """Tags and notes that a page adds or takes away; raises AttributeError or TypeError for anything else."""
    add, remove = (tuple(map(str, answer.get(key, []))) for key in ("add", "remove"))
    note = str(answer.get("note", ""))

    def change(now: Remarks) -> Remarks:
        now = with_tags(with_tags(now, remove, remove=True), add)
        return with_note(now, note) if note else now

    return change


def _query(request: Request) -> Query:
    """The query in an address."""
    given = request.query_params
    try:
        low, high = given.get("gamma_low", ""), given.get("gamma_high", "")
        gamma = (float(low or 0), float(high or "inf")) if low or high else None
        limit, c = int(given.get("limit", "-1")), int(given["c"]) if given.get("c") else None
    except ValueError as error:
        raise InputError("wanted numbers for c, gamma and limit") from error
    words = {name: given.get(name, "") for name in ("profile", "verdict", "ended", "since", "until", "text")}
    tags, lost, sort = tuple(given.get("tags", "").split()), given.get("lost") == "1", given.get("sort", "-date")
    return Query(**words, c=c, gamma=gamma, tags=tags, lost=lost, sort=sort, limit=limit)


def _json(answer: Any) -> Response:
    return JSONResponse(json_values(answer))
