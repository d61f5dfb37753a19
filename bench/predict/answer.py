"""The answer to a request of `bench predict`: an orbit, a list of bifurcations, or a diagram over gammas and more.

With ``--json -`` standard output carries the JSON and nothing else; progress goes to standard error.
"""

from __future__ import annotations

import math
import signal
import tempfile
import threading
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from bench.outputs import HDF5, JSON, PICTURE, File, check_outputs
from bench.predict.request import (
    Progress,
    Request,
    ball_for,
    forcing_of,
    gamma_peak_over_gamma,
    orbit,
    parse_effects,
    seconds_of,
)
from bench.terminal.console import write_json
from daq.setup.errors import InputError
from model.bifurcations.continuation import cycle_branches
from model.bifurcations.events import find_bifurcations
from model.orbits.attractor import Ball
from model.surveys import ensemble
from model.surveys.diagram import KINDS, Rows, adaptive, empty_rows
from model.surveys.diagram import diagram as rows_at

MOST_GAMMAS = 1_000_000


def run(request: Request) -> None:
    """Answer ``request``; raises `InputError`, also for what the model refuses."""
    if request.files.out is not None or threading.current_thread() is not threading.main_thread():
        _answer(request)
        return
    # Ctrl-C ends the process at once: a compiled search heeds no exception, and no file is half written
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        _answer(request)
    finally:
        signal.signal(signal.SIGINT, before)


def _answer(request: Request) -> None:
    """The branch for each kind of request."""
    if request.gamma_range is None or request.bifurcations:  # no diagram: no picture or HDF5 file would be written
        for option, path in (("--out", request.files.out), ("--figure", request.files.figure)):
            if path is not None:
                asked = "--bifurcations" if request.bifurcations else "this call"
                diagram_call = f"--gamma-range FROM TO {option} {path}"
                raise InputError(f"{option} {path}: {asked} writes no such file; it is for a diagram: {diagram_call}")
    given = request.profile
    check_outputs(
        File("--out", request.files.out, HDF5, continues=None if request.files.overwrite else _is_diagram),
        File("--figure", request.files.figure, PICTURE), File("--json", request.files.json, JSON),
        inputs=[None if given is None else given.name], overwrite=request.files.overwrite,
    )  # fmt: skip
    if given is not None:
        from bench.predict.profile_ramp import print_ramp, ramp_json, with_profile  # pydantic is slow to import

        request = with_profile(request, given)
        if request.gamma is None and request.gamma_peak is None and request.gamma_range is None:
            rows = ramp_json(request, given)
            write_json(rows, request.files.json)
            if request.files.json is None:
                print_ramp(rows)
            return
    ball = ball_for(request)
    if request.gamma_range is None:
        orbit(ball, request)
    elif request.bifurcations:
        _bifurcations(ball, request, *request.gamma_range)
    elif request.branches and request.files.figure is None and request.files.out is None:
        _branches(ball, request, *request.gamma_range)
    else:
        _diagram(ball, request)


def _is_diagram(path: Path) -> bool:
    """True for a file of `bench predict --out`, which can be continued."""
    try:
        with h5py.File(path, "r") as file:
            return "job" in file.attrs and "chunk_done" in file
    except OSError:
        return False


def _branches(ball: Ball, request: Request, low: float, high: float) -> None:
    """Print or write every branch of cycles in the gamma range of ``request``."""
    found = cycle_branches(ball, low, high)
    rows = [
        {
            "flights": b.flights, "period": b.periods, "gamma": b.gamma.tolist(), "multiplier": b.multiplier.tolist(),
            "phase": b.phase.tolist(), "tau": b.tau.tolist(),
        }
        for b in found
    ]  # fmt: skip
    write_json(rows, request.files.json)
    if request.files.json is None:
        print(f"{'flights':>7} {'period':>6} {'gamma from':>12} {'to':>12} {'multiplier from':>16} {'to':>10}  stable")
        for b in found:
            stable = b.gamma[abs(b.multiplier) < 1.0]
            where = f"{stable.min():.4f} to {stable.max():.4f}" if stable.size else "nowhere"
            print(
                f"{b.flights:7d} {b.periods:6d} {b.gamma[0]:12.6f} {b.gamma[-1]:12.6f} {b.multiplier[0]:16.4f} "
                f"{b.multiplier[-1]:10.4f}  {where}"
            )


def _bifurcations(ball: Ball, request: Request, low: float, high: float) -> None:
    """Print or write every bifurcation in the gamma range of ``request``."""
    peak = gamma_peak_over_gamma(forcing_of(request))
    found = find_bifurcations(ball, low, high, narrowest=request.narrowest, sweep=request.sweep)
    found = [b for b in found if b.gamma > low]  # what happens at the very start is not a change within the range
    rows = [
        {
            "gamma": b.gamma, "gamma_peak": b.gamma * peak, "type": b.type, "period_before": b.before.period,
            "period_after": b.after.period,
        }
        for b in found
    ]  # fmt: skip
    write_json(rows, request.files.json)
    if request.files.json is None:
        print(f"{'gamma':>16} {'gamma_peak':>16}  {'type':<22} period")
        for b in found:
            print(f"{b.gamma:16.10f} {b.gamma * peak:16.10f}  {b.type:<22} {b.before.period} -> {b.after.period}")


def _diagram(ball: Ball, request: Request) -> None:
    """Fly the diagram that ``request`` asks for, and write it as HDF5, picture and JSON, whichever were asked for."""
    job = _job(request)
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
        if request.diagram.steps > 20_000:  # it is in memory
            raise InputError(f"an adaptive diagram begins with at most 20,000 --steps, not {request.diagram.steps:,}")
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

        diagram_picture(rows.sorted(), forcing_of(request), request, request.files.figure)


def _job(request: Request) -> ensemble.Job:
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
        request.ratio, tuple(gammas.tolist()), math.radians(request.phase_deg), parse_effects(request.effects),
        tuple(axes), frequency_hz=request.frequency_hz, sweep=request.sweep is not None, keep=request.diagram.keep,
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
