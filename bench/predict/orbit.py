"""What `bench predict` does with its options: one orbit, a list of bifurcations, a diagram or a figure of the paper.

The rule kept here: with ``--json -`` standard output carries the JSON and nothing else; progress goes to standard
error.
"""

from __future__ import annotations

import math
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.outputs import HDF5, JSON, PICTURE, File, check_outputs
from bench.terminal.console import EXIT_USAGE, fail, write_json
from daq.setup.errors import InputError
from model.bifurcations.events import Bifurcation
from model.orbits.attractor import Attractor, Ball, attractor, sweep
from model.orbits.make_ball import make_ball
from model.tones import STANDARD_GRAVITY_MPS2, Forcing

SWEEP_STEPS = 400  # gammas of the sweep that leads to a single gamma


@dataclass(frozen=True)
class Request:
    """The options of `bench predict`, as given."""

    ratio: int = 1
    gamma: float | None = None
    gamma_peak: float | None = None
    gamma_range: tuple[float, float] | None = None
    bifurcations: bool = False
    effects: tuple[str, ...] = ()
    frequency_hz: float | None = None
    sweep: str | None = None
    phase_deg: float = 0.0
    steps: int = 1000
    adaptive: bool = False
    grid: tuple[str, ...] = ()
    narrowest: float | None = None
    workers: int = 1
    cluster: str | None = None
    paper_figure: int | None = None
    json_to: str | None = None
    profile: str | None = None
    g_mps2: float = STANDARD_GRAVITY_MPS2
    out: Path | None = None
    figure: Path | None = None
    overwrite: bool = False


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
    try:
        picture = request.figure
        if request.paper_figure is not None:
            picture = picture or Path(f"figure{request.paper_figure}.png")
        check_outputs(
            File("--out", request.out, HDF5, continues=None if request.overwrite else _is_diagram),
            File("--figure", picture, PICTURE),
            File("--json", request.json_to, JSON),
            inputs=[request.profile], overwrite=request.overwrite,
        )  # fmt: skip
        if request.paper_figure is not None and picture is not None:
            from bench.predict.figures import paper_figure

            paper_figure(request.paper_figure, picture, request.steps)
            return
        if request.profile is not None:
            from bench.predict.profile_ramp import print_ramp, ramp_json, with_profile

            request = with_profile(request, request.profile)
            if request.gamma is None and request.gamma_peak is None and request.gamma_range is None:
                rows = ramp_json(request, str(request.profile))
                write_json(rows, request.json_to)
                if request.json_to is None:
                    print_ramp(rows)
                return
        ball = ball_for(request)
        if request.gamma_range is None:
            _one(ball, request)
        elif request.bifurcations:
            _bifurcations(ball, request)
        else:
            from bench.predict.diagram import diagram

            diagram(ball, request, forcing_of(request), parse_effects(request.effects))
    except ValueError as error:
        fail(str(error), EXIT_USAGE)


def _is_diagram(path: Path) -> bool:
    """Whether `bench predict --out` wrote the file, so that it can be gone on with."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return "job" in file.attrs and "chunk_done" in file
    except OSError:
        return False


def parse_effects(given: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """``name.parameter=value`` options as a table by effect and parameter.

    Raises
    ------
    InputError
        For text of another form.
    """
    effects: dict[str, dict[str, float]] = {}
    for text in given:
        place, equals, value = text.partition("=")
        name, dot, parameter = place.strip().partition(".")
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not (equals and dot and name and parameter and math.isfinite(number)):
            raise InputError(f"--effect wants name.parameter=number, such as restitution.e0=0.514, not {text!r}")
        effects.setdefault(name, {})[parameter] = number
    return effects


def forcing_of(request: Request) -> Forcing:
    """The plate's motion but for its amplitude."""
    return Forcing.superposition(request.ratio, phase_rad=(0.0, math.radians(request.phase_deg)))


def ball_for(request: Request) -> Ball:
    """The ball that ``request`` is about.

    Raises
    ------
    InputError
        For options without meaning.
    """
    if request.sweep not in (None, "up", "down"):
        raise InputError(f"--sweep wants up or down, not {request.sweep!r}")
    if request.frequency_hz is not None and not (math.isfinite(request.frequency_hz) and request.frequency_hz > 0):
        raise InputError(f"--frequency-hz wants a positive number, not {request.frequency_hz!r}")
    forcing = forcing_of(request)
    if not forcing.moves:
        raise InputError("the two tones cancel: the plate does not move; change --c or --phase-deg")
    return make_ball(forcing, parse_effects(request.effects), frequency_hz=request.frequency_hz, g_mps2=request.g_mps2)


def _gamma(request: Request) -> float:
    if (request.gamma is None) == (request.gamma_peak is None):
        raise InputError("give one of --gamma, --gamma-peak (at c = 1), --gamma-range and --profile")
    if request.gamma is not None:
        value = request.gamma
    else:
        if request.ratio != 1:
            raise InputError("--gamma-peak goes with --c 1 alone; give --gamma, the paper's A w^2 / g")
        first = forcing_of(request).amplitude[0]
        value = (request.gamma_peak or 0.0) / first
    if not (math.isfinite(value) and value >= 0.0):
        raise InputError(f"gamma wants a number that is not negative, not {value!r}")
    return value


def _one(ball: Ball, request: Request) -> None:
    gamma = _gamma(request)
    if request.sweep is None:
        found = attractor(ball, gamma)
    else:
        import numpy as np

        start = 0.0 if request.sweep == "up" else 2.0 * gamma
        found = sweep(ball, np.linspace(start, gamma, SWEEP_STEPS))[-1]
    answer = orbit_json(found, request.ratio, gamma, request.frequency_hz)
    write_json(answer, request.json_to)
    if request.json_to is None:
        print(f"c = {request.ratio}, gamma = {gamma:.9g}: {found.label}")
        for tau in found.tau:
            seconds = "" if request.frequency_hz is None else f"   {tau / (2 * math.pi * request.frequency_hz):.9f} s"
            print(f"  tau = {tau:.9f}{seconds}")


def orbit_json(found: Attractor, ratio: int, gamma: float, frequency_hz: float | None) -> dict[str, Any]:
    """One orbit as scripts read it."""
    tau = [float(t) for t in found.tau]
    seconds = None if frequency_hz is None else [t / (2.0 * math.pi * frequency_hz) for t in tau]
    return {
        "c": ratio,
        "gamma": gamma,
        "kind": found.kind,
        "period": found.period,
        "flights": found.flights,
        "resets": found.resets,
        "locked": found.locked,
        "tau": tau,
        "flight_time_s": seconds,
    }


def _bifurcations(ball: Ball, request: Request) -> None:
    from model.bifurcations.find import find_bifurcations
    from model.flight.branches import q_and_slope
    from model.flight.first_landing import turning_points

    forcing = forcing_of(request)
    peak = max(q_and_slope(forcing.tones, float(p))[0] for p in turning_points(forcing))
    low, high = request.gamma_range or (0.0, 0.0)
    # what happens at the very start of the range is not a change within it
    found = [
        b for b in find_bifurcations(ball, low, high, narrowest=request.narrowest, sweep=request.sweep) if b.gamma > low
    ]
    write_json([bifurcation_json(b, peak) for b in found], request.json_to)
    if request.json_to is None:
        print(f"{'gamma':>16} {'gamma_peak':>16}  {'type':<22} period")
        for b in found:
            print(f"{b.gamma:16.10f} {b.gamma * peak:16.10f}  {b.type:<22} {b.before.period} -> {b.after.period}")


def bifurcation_json(found: Bifurcation, peak: float) -> dict[str, Any]:
    """One bifurcation as scripts read it; ``peak`` is gamma_peak over gamma."""
    return {
        "gamma": found.gamma,
        "gamma_peak": found.gamma * peak,
        "type": found.type,
        "period_before": found.before.period,
        "period_after": found.after.period,
    }
