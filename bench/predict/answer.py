"""The answer to a request of `bench predict`: an orbit, a list of bifurcations, a diagram or a figure of the paper.

With ``--json -`` standard output carries the JSON and nothing else; progress goes to standard error.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import h5py

from bench.outputs import HDF5, JSON, PICTURE, File, check_outputs
from bench.predict.bifurcations import bifurcations
from bench.predict.diagram import diagram
from bench.predict.orbit import orbit
from bench.predict.request import Request, ball_for, forcing_of, parse_effects
from bench.terminal.console import EXIT_USAGE, fail, write_json
from daq.setup.errors import InputError


def run(request: Request) -> None:
    """Answer ``request``; leaves with status 2 and one line where it cannot be answered."""
    with _stopped_at_once() if request.out is None else nullcontext():
        _answer(request)


@contextmanager
def _stopped_at_once() -> Iterator[None]:
    """Ctrl-C ends the process: a compiled search heeds no exception, and no file is half written."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _answer(request: Request) -> None:
    """The branch for each kind of request."""
    try:
        _refuse_unwritten(request)
        check_outputs(
            File("--out", request.out, HDF5, continues=None if request.overwrite else _is_diagram),
            File("--figure", request.figure, PICTURE),
            File("--json", request.json, JSON),
            inputs=[request.profile], overwrite=request.overwrite,
        )  # fmt: skip
        if request.profile is not None:
            from bench.predict.profile_ramp import print_ramp, ramp_json, with_profile  # pydantic is slow to import

            request = with_profile(request, request.profile)
            if request.gamma is None and request.gamma_peak is None and request.gamma_range is None:
                rows = ramp_json(request, str(request.profile))
                write_json(rows, request.json)
                if request.json is None:
                    print_ramp(rows)
                return
        ball = ball_for(request)
        if request.gamma_range is None:
            orbit(ball, request)
        elif request.bifurcations:
            bifurcations(ball, request)
        else:
            diagram(ball, request, forcing_of(request), parse_effects(request.effects))
    except ValueError as error:
        fail(str(error), EXIT_USAGE)


def _refuse_unwritten(request: Request) -> None:
    """Refuse a picture or an HDF5 file of what is no diagram: none would be written.

    Raises
    ------
    InputError
        With the option, and what it goes with.
    """
    if request.gamma_range is not None and not request.bifurcations:
        return
    for option, path in (("--out", request.out), ("--figure", request.figure)):
        if path is not None:
            asked = "--bifurcations" if request.bifurcations else "this call"
            diagram_call = f"--gamma-range FROM TO {option} {path}"
            raise InputError(f"{option} {path}: {asked} writes no such file; it is for a diagram: {diagram_call}")


def _is_diagram(path: Path) -> bool:
    """True for a file of `bench predict --out`, which can be continued."""
    try:
        with h5py.File(path, "r") as file:
            return "job" in file.attrs and "chunk_done" in file
    except OSError:
        return False
