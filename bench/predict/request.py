"""The options of `bench predict` as a value, the ball and forcing that they describe, and the orbit at one gamma."""

from __future__ import annotations

import math
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.terminal.console import CYCLES, print_lines, write_json
from daq.setup.errors import InputError
from model.flight.branches import q_and_slope
from model.flight.windows import turning_points
from model.orbits.attractor import Attractor, Ball, attractor, sweep
from model.orbits.make_ball import make_ball
from model.tones import STANDARD_GRAVITY_MPS2, Forcing


@dataclass(frozen=True)
class DiagramOptions:
    """How a diagram is computed."""

    steps: int = 1000
    adaptive: bool = False
    grid: tuple[str, ...] = ()
    keep: int = 64
    workers: int = 1
    cluster: str | None = None


@dataclass(frozen=True)
class Files:
    """Where the answer goes."""

    json: str | None = None
    out: Path | None = None
    figure: Path | None = None
    overwrite: bool = False


@dataclass(frozen=True)
class GivenProfile:
    """A profile's path or name, and values of it that are replaced: ``KEY=NUMBER`` each."""

    name: str
    what_if: tuple[str, ...] = ()


@dataclass(frozen=True)
class Request:
    """The options of `bench predict`, as given."""

    ratio: int = 1
    gamma: float | None = None
    gamma_peak: float | None = None
    gamma_range: tuple[float, float] | None = None
    bifurcations: bool = False
    branches: bool = False
    effects: tuple[str, ...] = ()
    frequency_hz: float | None = None
    sweep: str | None = None
    phase_deg: float = 0.0
    narrowest: float | None = None
    profile: GivenProfile | None = None
    g_mps2: float = STANDARD_GRAVITY_MPS2
    diagram: DiagramOptions = DiagramOptions()
    files: Files = Files()


def parse_effects(given: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """``name.parameter=value`` options as a table by effect and parameter (raises `InputError`)."""
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
    """The ball that ``request`` is about; raises `InputError` for options without meaning."""
    if request.sweep not in (None, "up", "down"):
        raise InputError(f"--sweep wants up or down, not {request.sweep!r}")
    if request.frequency_hz is not None and not (math.isfinite(request.frequency_hz) and request.frequency_hz > 0):
        raise InputError(f"--frequency-hz wants a positive number, not {request.frequency_hz!r}")
    if not math.isfinite(request.phase_deg):
        raise InputError(f"--phase-deg wants a number, not {request.phase_deg!r}")
    forcing = forcing_of(request)
    if not forcing.moves:
        raise InputError("the two tones cancel: the plate does not move; change --c or --phase-deg")
    return make_ball(forcing, parse_effects(request.effects), frequency_hz=request.frequency_hz, g_mps2=request.g_mps2)


def seconds_of(tau: list[float], frequency_hz: float | None) -> list[float] | None:
    """Flight times in seconds; None without a frequency."""
    return None if frequency_hz is None else [t / (2.0 * math.pi * frequency_hz) for t in tau]


def gamma_peak_over_gamma(forcing: Forcing) -> float:
    """Peak acceleration of the plate over A w^2, dimensionless."""
    return max(q_and_slope(forcing.tones, float(p))[0] for p in turning_points(forcing))


def orbit(ball: Ball, request: Request) -> None:
    """Print or write the attractor at the gamma of ``request``; raises `InputError` where it names none."""
    if (request.gamma is None) == (request.gamma_peak is None):
        raise InputError("give one of --gamma, --gamma-peak (at c = 1), --gamma-range and --profile")
    gamma = request.gamma
    if gamma is None:
        if request.ratio != 1:
            raise InputError("--gamma-peak goes with --c 1 only; give --gamma, the paper's A w^2 / g")
        gamma = (request.gamma_peak or 0.0) / forcing_of(request).amplitude[0]
    if not (math.isfinite(gamma) and gamma >= 0.0):
        raise InputError(f"gamma wants a number that is not negative, not {gamma!r}")
    if request.sweep is None:
        found = attractor(ball, gamma)
    else:
        start = 0.0 if request.sweep == "up" else 2.0 * gamma
        # a sweep in steps so small that the ball stays on its branch
        found = sweep(ball, np.linspace(start, gamma, 400))[-1]
    write_json(orbit_json(found, request.ratio, gamma, request.frequency_hz), request.files.json)
    if request.files.json is None:
        print(f"c = {request.ratio}, gamma = {gamma:.9g}: {found.label}")
        for tau in found.tau:
            seconds = "" if request.frequency_hz is None else f"   {tau / (2 * math.pi * request.frequency_hz):.9f} s"
            print(f"  tau = {tau:.9f}{seconds}")
        print_lines(
            "gamma = A w^2/g of the first tone; tau = w t: a flight's time in radians of the first tone", CYCLES
        )


def orbit_json(found: Attractor, ratio: int, gamma: float, frequency_hz: float | None) -> dict[str, Any]:
    """One orbit as scripts read it."""
    row: dict[str, Any] = {"c": ratio, "gamma": gamma}
    row |= {name: getattr(found, name) for name in ("kind", "period", "flights", "resets", "locked")}
    row["tau"] = [float(t) for t in found.tau]
    row["flight_time_s"] = seconds_of(row["tau"], frequency_hz)
    return row


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
