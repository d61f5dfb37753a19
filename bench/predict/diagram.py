"""The diagrams of `bench predict`: over a range of gammas and any other axes, on one core, several, or a cluster.

Progress goes to standard error, at most once a second.
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.predict.request import Request, check_adaptive, seconds_of
from bench.terminal.console import write_json
from daq.setup.errors import InputError
from model.orbits.attractor import Ball
from model.surveys import ensemble
from model.surveys.diagram import KINDS, Rows, adaptive, empty_rows
from model.surveys.diagram import diagram as rows_at
from model.tones import Forcing

MOST_GAMMAS = 1_000_000


def diagram(ball: Ball, request: Request, forcing: Forcing, effects: Mapping[str, Mapping[str, float]]) -> None:
    """Fly the diagram that ``request`` asks for, and write it as HDF5, picture and JSON, whichever were asked for.

    Raises `InputError` for options that contradict one another.
    """
    job = _job(request, effects)
    ensemble.check(job)
    if request.files.json is not None and not request.diagram.adaptive:
        _check_json(job.size, job)
    if request.files.figure is not None and len(job.axes) > 1:
        raise InputError("--figure shows a diagram over gamma, or a map over gamma and one --grid; give only --out")
    if request.files.out is None and request.files.figure is None and request.files.json is None:
        raise InputError("a diagram wants --out diagram.h5, --figure diagram.png or --json; or ask for --bifurcations")
    if request.files.overwrite and request.files.out is not None:
        request.files.out.unlink(missing_ok=True)
    if request.diagram.adaptive:
        if request.sweep or request.diagram.grid or request.diagram.workers > 1 or request.diagram.cluster:
            raise InputError("--adaptive goes with neither --sweep, --grid, --workers nor --cluster")
        check_adaptive(request.diagram.steps)
        rows = adaptive(partial(rows_at, ball), *(request.gamma_range or (0.0, 0.0)), request.diagram.steps)
        if request.files.out is not None:
            ensemble.save(job, rows, request.files.out)
    else:
        rows = _flown(job, request)
    if request.files.json is not None:
        _check_json(rows.gamma.size, job)
        write_json([_row_json(rows, i, job) for i in range(rows.gamma.size)], request.files.json)
    if request.files.figure is not None and not job.axes:
        from bench.predict.figures import diagram_picture  # matplotlib is slow to import

        diagram_picture(rows.sorted(), forcing, request, request.files.figure)


def _job(request: Request, effects: Mapping[str, Mapping[str, float]]) -> ensemble.Job:
    """The diagram as a job of points, which may be flown in part and gone on with; raises `InputError`."""
    if request.diagram.steps > MOST_GAMMAS:
        raise InputError(f"--steps wants at most {MOST_GAMMAS:,} (half a kilobyte each), not {request.diagram.steps:,}")
    low, high = request.gamma_range or (0.0, 0.0)
    if not (math.isfinite(low) and math.isfinite(high) and 0.0 <= low < high):
        raise InputError(f"--gamma-range wants a smaller and a larger number, neither negative, not {low:g} {high:g}")
    gammas = np.linspace(low, high, request.diagram.steps)[:: -1 if request.sweep == "down" else 1]
    axes = []
    for text in request.diagram.grid:
        name, equals, values = text.partition("=")
        wanted = f"--grid wants name.parameter=from:to:count, such as restitution.e0=0:0.9:10, not {text!r}"
        try:
            first, last, count = values.split(":")
            if int(count) > MOST_GAMMAS:
                raise OverflowError(f"--grid wants at most {MOST_GAMMAS:,} values of {name}, not {int(count):,}")
            numbers = np.linspace(float(first), float(last), int(count))
        except ValueError as error:
            raise InputError(wanted) from error
        except OverflowError as error:
            raise InputError(str(error)) from error
        if not (equals and "." in name and numbers.size and np.all(np.isfinite(numbers))):
            raise InputError(wanted)
        axes.append(ensemble.Axis(name.strip(), tuple(numbers.tolist())))
    return ensemble.Job(
        request.ratio, tuple(gammas.tolist()), math.radians(request.phase_deg), effects, tuple(axes),
        frequency_hz=request.frequency_hz, sweep=request.sweep is not None, keep=request.diagram.keep,
        g_mps2=request.g_mps2,
    )  # fmt: skip


def _flown(job: ensemble.Job, request: Request) -> Rows:
    """The rows of a job, flown into its file; none where they are not asked for."""
    with tempfile.TemporaryDirectory() as folder:
        path = request.files.out or Path(folder) / "diagram.h5"
        ensemble.run(
            job, path, workers=request.diagram.workers, cluster=request.diagram.cluster, progress=Progress("points")
        )
        if request.files.figure is not None and job.axes:
            from bench.predict.figures import map_picture  # matplotlib is slow to import

            map_picture(path, job, request.files.figure)
        if (request.files.figure is None or job.axes) and request.files.json is None:
            return empty_rows(np.empty(0), 0)
        return ensemble.load(path)[0]


class Progress:
    """A line on standard error, at most once a second; ``what`` is counted."""

    def __init__(self, what: str) -> None:
        self.what = what
        self.began = self.said = time.monotonic()

    def __call__(self, done: int, total: int) -> None:
        """Say how far it is."""
        now = time.monotonic()
        if now - self.said >= 1.0:
            self.said = now
            sys.stderr.write(f"{done} of {total} {self.what}, {now - self.began:.0f} s\n")


def _check_json(size: int, job: ensemble.Job) -> None:
    """Refuse more rows than a JSON is good for (raises `InputError`)."""
    if size > 100_000 or job.axes:
        raise InputError("as JSON at most 100000 gammas and no --grid; give --out for HDF5")


def _row_json(rows: Rows, i: int, job: ensemble.Job) -> dict[str, Any]:
    """The attractor of a row as scripts read it."""
    tau = rows.tau[i][np.isfinite(rows.tau[i])].tolist()
    return {
        "c": job.ratio, "gamma": float(rows.gamma[i]), "kind": KINDS[int(rows.kind[i])],
        "period": int(rows.period[i]) or None, "flights": int(rows.flights[i]), "resets": int(rows.resets[i]),
        "locked": bool(rows.locked[i]), "tau": tau, "flight_time_s": seconds_of(tau, job.frequency_hz),
    }  # fmt: skip
