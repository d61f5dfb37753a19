"""The answer to a request of `bench predict`: an orbit, a list of bifurcations, or a diagram.

With ``--json -`` standard output carries the JSON and nothing else; progress goes to standard error.
"""

from __future__ import annotations

import signal
import threading
from pathlib import Path

import h5py

from bench.outputs import HDF5, JSON, PICTURE, File, check_outputs
from bench.predict.diagram import diagram
from bench.predict.request import Request, ball_for, forcing_of, gamma_peak_over_gamma, orbit, parse_effects
from bench.terminal.console import write_json
from daq.setup.errors import InputError
from model.bifurcations.continuation import cycle_branches
from model.bifurcations.events import find_bifurcations
from model.orbits.attractor import Ball


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
        diagram(ball, request, forcing_of(request), parse_effects(request.effects))


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
