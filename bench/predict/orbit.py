"""The orbit at one gamma, as `bench predict` prints it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bench.predict.request import Request, forcing_of, seconds_of
from bench.terminal.console import CYCLES, print_lines, write_json
from daq.setup.errors import InputError
from model.orbits.attractor import Attractor, Ball, attractor, sweep


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
