"""Reduction of one step while it lasts: flights, cycle, tones and landing residuals, by the analysis' own functions."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.flights.assemble import flights_of
from analysis.flights.classify import classify
from analysis.flights.table import FlightFlag, Flights
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.observations import Observations, observed
from bench.live.window import StepWindow
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from model.effects.registry import resolve

Floats = NDArray[np.float64]

PLAIN, DOUBTFUL, POOR = 0, 1, 2  # marks of a flight
LEAST_CYCLES = 3.0  # of a step, before it is reduced
_POOR = FlightFlag.FALSE | FlightFlag.SETTLING | FlightFlag.CUT | FlightFlag.GAP


@dataclass(frozen=True)
class ReducedStep:
    """One step as a page shows it.

    Attributes
    ----------
    gamma
        Measured on the plate; NaN where it could not be.
    label
        Class of the motion.
    landing_s, duration_s
        Of each flight, (n,): since the step's first sample, and of the flight.
    residual_s, noise_s
        Landing less its prediction by the declared model, and the uncertainty of that, (n,); NaN where not compared.
    mark
        `PLAIN`, `DOUBTFUL` (double hit, or unsure) or `POOR` (settling, cut, no flight), (n,).
    tones
        Of each tone: multiple, amplitude and phase (degrees) on the plate and asked for.
    observations
        For the verdict; None where there are none.
    """

    gamma: float
    label: str
    landing_s: Floats
    duration_s: Floats
    residual_s: Floats
    noise_s: Floats
    mark: NDArray[np.uint8]
    tones: list[dict[str, Any]]
    observations: Observations | None


def reduce_step(window: StepWindow, gamma: float, first_played: int) -> ReducedStep | None:
    """Reduce the frames of a step so far; None where they are too few.

    Parameters
    ----------
    window
        The step's frames.
    gamma
        Asked for.
    first_played
        Index of the step's first sample among the played ones, from which phases count.
    """
    if window.n_samples < LEAST_CYCLES * window.rate_hz / window.setup.forcing.frequency_hz:
        return None
    try:
        flights = flights_of(window)
    except InputError:
        return None
    plate = flights.plate.steps[0]
    seen = observed(window, flights)
    residual, noise = _residuals(flights, seen, window.setup)
    mark = np.where(flights.has(FlightFlag.DOUBLE_HIT | FlightFlag.UNSURE), DOUBTFUL, PLAIN)
    return ReducedStep(
        gamma=math.nan if plate is None else plate.gamma,
        label=classify(flights)[0].label,
        landing_s=flights.landing_s,
        duration_s=flights.duration_s,
        residual_s=residual,
        noise_s=noise,
        mark=np.where(flights.has(_POOR), POOR, mark).astype(np.uint8),
        tones=_tones(flights, window.setup, gamma, first_played),
        observations=seen if len(seen.steps) else None,
    )


def _residuals(flights: Flights, seen: Observations, setup: Setup) -> tuple[Floats, Floats]:
    """Landing residuals at the declared model and their uncertainty, one a flight."""
    residual, noise = np.full(len(flights), np.nan), np.full(len(flights), np.nan)
    if not seen.scored.any():
        return residual, noise
    model = ForwardModel(seen, resolve(setup.declared_values()))
    row = np.minimum(np.searchsorted(flights.landing_s, seen.measured.landing_s - 1e-9), len(flights) - 1)
    kept = seen.scored
    residual[row[kept]] = model.residuals({}).landing_s[kept]
    noise[row[kept]] = model.uncertainty({}).landing_total_s[kept]
    return residual, noise


def _tones(flights: Flights, setup: Setup, gamma: float, first_played: int) -> list[dict[str, Any]]:
    """Amplitude and phase of each forcing tone, on the plate and asked for."""
    plate = flights.plate.steps[0]
    turn = 2.0 * math.pi * setup.forcing.frequency_hz * first_played / setup.sampling.rate_hz
    rows = []
    for multiple, displacement in setup.forcing.displacement_tones():
        wanted = -setup.g_mps2.value * gamma * multiple * multiple * displacement
        row: dict[str, Any] = {
            "multiple": multiple,
            "target_mps2": abs(wanted),
            "target_deg": math.degrees(cmath.phase(wanted)) if wanted else 0.0,
            "mps2": None,
            "deg": None,
        }
        if plate is not None and multiple in plate.multiples:
            z = plate.acceleration.amplitudes[plate.multiples.index(multiple)] * cmath.exp(-1j * multiple * turn)
            row["mps2"], row["deg"] = float(abs(z)), math.degrees(cmath.phase(z))
        rows.append(row)
    return rows
