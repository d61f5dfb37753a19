"""Comparison of a recording with the model: ideal plus declared effects, step by step, and the first bifurcation.

The model flies over the measured plate, and its state is carried from step to step as on the bench. Where the
accelerometer shows no impacts, the model's flights are passed through the contact circuit's limits too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from analysis.flights.classify import BandTest, Change, StepClass, band_test, classify
from analysis.flights.first_bifurcation import (
    FirstBifurcation,
    ball_on,
    changes_along,
    check_plausible,
    first_after_takeoff,
)
from analysis.flights.table import FlightFlag, Flights
from analysis.plate.motion import StepPlate
from daq.setup.setup import Setup
from kernels.arrays import Floats, Integers
from model.bifurcations.forbidden_zones import forbidden_zones
from model.effects.registry import resolve
from model.effects.routing import Effects
from model.orbits.attractor import AT_REST, Attractor, attractor
from model.tones import Forcing

MAX_FLIGHTS = 2048  # flights computed before a step is called chaotic
CYCLES_SHOWN = 4  # cycles passed through the contact sensor's limits
SENSITIVE_SAMPLES = 1.0 / 3.0  # shift of a flight time by the uncertainty of gamma that is too large to judge


@dataclass(frozen=True)
class StepComparison:
    """One step, measured and predicted.

    Attributes
    ----------
    step : int
    gamma, gamma_peak : float
        Measured by the accelerometer.
    measured : StepClass
    predicted : str
        Label of the model's attractor.
    predicted_s : array
        Flight times of one predicted cycle as the sensors would show them (of some flights where chaotic).
    periodic : bool
        Whether the model predicts a cycle.
    mean_ratio : float
        Mean measured flight time, without double hits, over mean predicted, without bounces; NaN without either.
    rms_s : float
        Rms distance of measured flights to the nearest predicted time, in periodic windows; NaN elsewhere.
    within_sample : float
        Fraction of measured flights within one sample of a predicted time, in periodic windows; NaN elsewhere.
    unfit_reason : str
        Reason why a periodic step cannot test the model, empty when it can. ``sensitive``: the uncertainty of gamma
        moves the prediction by `SENSITIVE_SAMPLES` or more (grazing, or a bifurcation nearby). ``unsettled``:
        the predicted cycle attracts so slowly that the settle time does not reach it.
    bands : tuple of BandTest
        The ideal model's forbidden bands, tested.
    """

    step: int
    gamma: float
    gamma_peak: float
    measured: StepClass
    predicted: str
    predicted_s: Floats
    periodic: bool
    mean_ratio: float
    rms_s: float
    within_sample: float
    unfit_reason: str
    bands: tuple[BandTest, ...]


@dataclass(frozen=True)
class Comparison:
    """Comparison of a whole recording with the model.

    ``short_by`` is one minus the median ratio of flight times, over the steps in which both are cycles (all, where
    there are none); ``within_sample`` is over the flights of periodic steps without `unfit_reason`.
    """

    steps: tuple[StepComparison, ...]
    changes: tuple[Change, ...]
    first: FirstBifurcation
    effects: tuple[str, ...]
    short_by: float
    within_sample: float
    periodic_flights: int
    double_hits: int
    rate_hz: float
    ratio: int


def compare(
    flights: Flights, setup: Setup, *, effects: Effects | None = None, steps_table: npt.NDArray[np.void] | None = None
) -> Comparison:
    """Compare a recording's flights with the model.

    Raises `ValueError` for effects that the model does not know, or a plate beyond `MAX_GAMMA`.

    Parameters
    ----------
    flights : Flights
    setup : Setup
    effects : dict, optional
        Effects of the model by name; by default the setup's declared ones.
    steps_table : STEP_DTYPE array, optional
        Step table of the recording, with each step's settle time.
    """
    check_plausible(flights)
    declared = resolve(setup.declared_values() if effects is None else effects)
    classes = classify(flights)
    steps, last = [], AT_REST
    settle = steps_table["settle_cycles"] if steps_table is not None else np.zeros(0)
    for plate, own in zip(flights.plate.steps, classes, strict=True):
        if plate is None or not plate.gamma > 0:
            continue
        ball, forcing, gamma = ball_on(plate, setup, declared)
        found = attractor(ball, gamma, last, MAX_FLIGHTS)
        near = [max(gamma + d * plate.gamma_uncertainty, 0.0) for d in (-1.0, 1.0)]
        around = [attractor(ball, g, last, MAX_FLIGHTS) for g in near]
        settled = float(settle[plate.step]) if settle.size else np.nan
        last = found.last
        unfit = _unfit_reason(found, around, SENSITIVE_SAMPLES / flights.plate.rate_hz * plate.omega_radps, settled)
        steps.append(_step(flights, plate, own, found, forcing, unfit))
    seen = changes_along(flights, classes)
    chosen = [s for s in steps if s.periodic and s.measured.flights and s.predicted_s.size and not s.unfit_reason]
    count = sum(s.measured.flights for s in chosen)
    inside = sum(s.within_sample * s.measured.flights for s in chosen if np.isfinite(s.within_sample))
    alike = [s.mean_ratio for s in steps if np.isfinite(s.mean_ratio) and s.measured.kind == "cycle" and s.periodic]
    ratios = alike or [s.mean_ratio for s in steps if np.isfinite(s.mean_ratio)]
    return Comparison(
        tuple(steps),
        seen,
        first_after_takeoff(flights, setup, seen, declared),
        tuple(sorted(declared)),
        1.0 - float(np.median(ratios)) if ratios else float("nan"),
        inside / count if count else float("nan"),
        count,
        sum(s.measured.double_hits for s in steps),
        flights.plate.rate_hz,
        flights.plate.ratio,
    )


def _unfit_reason(found: Attractor, around: list[Attractor], allowed: float, settle_cycles: float) -> str:
    """Reason why a predicted cycle cannot be compared to within ``allowed`` (phase); empty when it can."""
    if found.kind == "chaotic" or found.tau.size == 0:
        return ""
    for other in around:
        if other.tau.size != found.tau.size or np.abs(np.sort(other.tau) - np.sort(found.tau)).max() > allowed:
            return "sensitive"
    if found.multiplier and np.isfinite(settle_cycles):
        rounds = settle_cycles / max(found.period or 1, 1)
        if abs(found.multiplier) ** rounds > allowed:
            return "unsettled"
    return ""


def _step(
    flights: Flights, plate: StepPlate, own: StepClass, found: Attractor, forcing: Forcing, unfit: str
) -> StepComparison:
    """Comparison of one step."""
    predicted = as_detected(found, plate.frequency_hz, flights)
    good = (flights.step == plate.step) & flights.good()
    tau = flights.duration_s[good]
    periodic = found.kind != "chaotic"
    proper = flights.duration_s[good & ~flights.has(FlightFlag.DOUBLE_HIT)]
    # predicted bounces below 2 % of the longest flight are the end of a chatter: no flight that starts from rest
    launched = predicted[predicted > 0.02 * predicted.max()] if predicted.size else predicted
    ratio = float(proper.mean() / launched.mean()) if proper.size and launched.size else float("nan")
    rms, within = float("nan"), float("nan")
    if periodic and tau.size and predicted.size:
        distance = np.abs(tau[:, None] - predicted[None, :]).min(axis=1)
        rms = float(np.sqrt(np.mean(distance**2)))
        # within one sample of a predicted flight time
        within = float(np.mean(distance <= 1.0 / flights.plate.rate_hz))
    unit = 1.0 / plate.omega_radps
    bands = tuple(
        band_test(flights, plate.step, float(low) * unit, float(high) * unit)
        for low, high in forbidden_zones(forcing, plate.gamma)
        if low > 0.0
    )
    return StepComparison(
        plate.step,
        plate.gamma,
        plate.gamma_peak,
        own,
        found.label,
        predicted,
        periodic,
        ratio,
        rms,
        within,
        unfit if periodic else "",
        bands,
    )


def as_detected(found: Attractor, frequency_hz: float, flights: Flights) -> Floats:
    """Flight times (s) of an attractor as this recording's sensors show them.

    With impacts in the accelerometer every flight is detected. Without them the model of the contact sensor merges
    flights whose contact in between is too short for the sampled circuit.
    """
    unit = 1.0 / (2.0 * np.pi * frequency_hz)
    if flights.edges.sensor_offset is not None or found.tau.size == 0:
        return np.asarray(found.tau * unit)
    tau = np.tile(found.tau, CYCLES_SHOWN)
    phase = np.tile(found.phase, CYCLES_SHOWN)
    takeoff = np.empty(tau.size)
    landed = 0.0
    for i in range(tau.size):
        wait = np.mod(phase[i] - landed + 1e-6, 2.0 * np.pi) - 1e-6  # rounding must not turn zero into a whole period
        takeoff[i] = landed + max(wait, 0.0)
        landed = takeoff[i] + tau[i]
    takeoff_s, landing_s = takeoff * unit, np.minimum((takeoff + tau) * unit, np.append(takeoff[1:] * unit, np.inf))
    first, last = seen_open(takeoff_s, landing_s, flights.plate.rate_hz)
    return np.asarray((landing_s[last] - takeoff_s[first])[1:]) if first.size > 1 else np.zeros(0)


def seen_open(takeoff_s: Floats, landing_s: Floats, rate_hz: float) -> tuple[Integers, Integers]:
    """First and last of the flights (n,) that make one visible flight each, to a contact circuit read once a sample."""
    # an event on a sample belongs to it, rounding or not
    opens, closes = (np.ceil(x * rate_hz * (1.0 - 4e-16)).astype(np.int64) for x in (takeoff_s, landing_s))
    open_once = np.flatnonzero(closes > opens)
    begins = np.append(True, opens[open_once[1:]] > closes[open_once[:-1]])[: len(open_once)]
    return open_once[begins], open_once[np.roll(begins, -1)]
