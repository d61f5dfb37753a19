"""A run so far as its page shows it, step by step: what `bench reprocess` finds in the same samples."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.flights.assemble import flights_of
from analysis.flights.classify import classify
from analysis.flights.table import FlightFlag, Flights
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.uncertainty import uncertainty_at
from analysis.residuals.observations import Observations, observed
from daq.recording import Recording
from daq.setup.setup import Setup
from kernels.arrays import Floats
from model.effects.registry import resolve

PLAIN, DOUBTFUL, POOR = range(3)  # marks of a flight
_POOR = FlightFlag.FALSE | FlightFlag.SETTLING | FlightFlag.CUT | FlightFlag.GAP


@dataclass(frozen=True)
class ReducedStep:
    """One step as a page shows it."""

    asked: float
    gamma: float  # measured on the plate; NaN where it could not be
    label: str  # class of the motion
    landing_s: Floats  # of each flight since the step's first sample, (n,)
    duration_s: Floats  # of each flight, (n,)
    residual_s: Floats  # landing less its prediction by the declared model, (n,); NaN where not compared
    noise_s: Floats  # uncertainty of that, (n,)
    mark: NDArray[np.uint8]  # `PLAIN`, `DOUBTFUL` (double hit, or unsure) or `POOR` (settling, cut, no flight), (n,)
    tones: list[dict[str, Any]]  # of each tone: multiple, amplitude and phase (degrees) on the plate and asked for

    def shows(self, other: ReducedStep, within_s: float) -> bool:
        """Whether another reduction of the step shows the same flights, none moved by more than ``within_s``."""
        if self.label != other.label or not np.array_equal(self.mark, other.mark):
            return False
        columns = ("duration_s", "landing_s", "residual_s")
        pairs = ((getattr(self, name), getattr(other, name)) for name in columns)
        return all(np.allclose(x, y, rtol=0.0, atol=within_s, equal_nan=True) for x, y in pairs)


def cut_to(recording: Recording, n_samples: int) -> None:
    """Leave out of an open recording what came after its first ``n_samples``."""
    recording.n_samples = min(recording.n_samples, n_samples)
    recording.steps = recording.steps[recording.steps["first_sample"] < recording.n_samples]
    recording.blocks = recording.blocks[recording.blocks["first_sample"] < recording.n_samples]
    recording.gaps = recording.gaps[recording.gaps[:, 0] < recording.n_samples]


def reduce_run(recording: Recording, played_first: Mapping[int, int]) -> tuple[list[ReducedStep], Observations]:
    """All steps of a run so far, and the observations for its verdict.

    Raises `InputError` where the samples are too few.

    Parameters
    ----------
    recording
        Open: the run's, however long it is yet.
    played_first
        By step, the index of its first sample among the played ones, from which phases count; where it is not known,
        that among the recorded ones.
    """
    flights = flights_of(recording)
    seen = observed(recording, flights, with_mode=False)
    residual, noise = np.full(len(flights), np.nan), np.full(len(flights), np.nan)
    if (judged := seen.scored).any():
        model = ForwardModel(seen, resolve(recording.setup.declared_values()))
        row = np.minimum(np.searchsorted(flights.landing_s, seen.measured.landing_s - 1e-9), len(flights) - 1)[judged]
        residual[row] = model.residuals({}).landing_s[judged]
        noise[row] = uncertainty_at(model, {}).landing_total_s[judged]
    mark = np.where(flights.has(FlightFlag.DOUBLE_HIT | FlightFlag.UNSURE), DOUBTFUL, PLAIN)
    mark = np.where(flights.has(_POOR), POOR, mark).astype(np.uint8)
    labels, steps = {one.step: one.label for one in classify(flights)}, []
    for k, row in enumerate(recording.steps):
        own, plate, first = flights.step == k, flights.plate.steps[k], int(row["first_sample"])
        steps.append(
            ReducedStep(
                asked=float(row["gamma"]),
                gamma=math.nan if plate is None else plate.gamma,
                label=labels.get(k, "undecided"),
                landing_s=flights.landing_s[own] - first / recording.rate_hz,
                duration_s=flights.duration_s[own],
                residual_s=residual[own],
                noise_s=noise[own],
                mark=mark[own],
                tones=_tones(flights, k, recording.setup, row, played_first.get(k, first)),
            )
        )
    return steps, seen


def _tones(flights: Flights, step: int, setup: Setup, row: np.void, first_played: int) -> list[dict[str, Any]]:
    """Amplitude and phase of each forcing tone of a step, on the plate and asked for."""
    plate, rows, gamma = flights.plate.steps[step], [], float(row["gamma"])
    # the plate's phases count from the first recorded sample, those asked for from the first played one
    recorded_s = float(flights.plate.true_time_s(row["first_sample"] / setup.sampling.rate_hz))
    turn = 2.0 * math.pi * setup.forcing.frequency_hz * (recorded_s - first_played / setup.sampling.rate_hz)
    for multiple, displacement in setup.forcing.displacement_tones():
        # a_p = -g gamma sum m^2 Re[d exp(i m w t)]
        target = -setup.g_mps2.value * gamma * multiple * multiple * displacement
        target_deg = math.degrees(cmath.phase(target)) if target else 0.0
        found: dict[str, Any] = {"multiple": multiple, "target_mps2": abs(target), "target_deg": target_deg}
        found |= {"mps2": None, "deg": None}
        if plate is not None and multiple in plate.multiples:
            z = plate.acceleration.amplitudes[plate.multiples.index(multiple)] * cmath.exp(1j * multiple * turn)
            found["mps2"], found["deg"] = float(abs(z)), math.degrees(cmath.phase(z))
        rows.append(found)
    return rows
