"""Comparison of a recording with the model: ideal plus declared effects, step by step, and the first bifurcation.

The model flies over the measured plate, and its state is carried from step to step as on the bench. Where the
accelerometer shows no impacts, the model's flights are passed through the contact circuit's limits too. Warnings about
the recording itself are here as well: doubtful instruments, uneven times, events changed by hand.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from analysis.flights.classify import BandTest, Change, StepClass, band_test, changes, classify
from analysis.flights.table import FlightFlag, Flights
from analysis.plate.motion import StepPlate
from daq.instrument.instrument import Instrument
from daq.recording import Recording
from daq.recording.notebook import in_words
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from kernels.arrays import Floats, Integers
from model.bifurcations.forbidden_zones import forbidden_zones
from model.bifurcations.sweep import TYPES, observed_bifurcations
from model.effects.registry import Effects, accelerometer_response, ball_effects, effect, resolve
from model.orbits.attractor import AT_REST, Attractor, Ball, attractor
from model.orbits.make_ball import make_ball
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
        (ball, forcing), gamma = ball_on(plate, setup, declared), plate.gamma
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


MAX_GAMMA = 500.0  # largest gamma of a plate, beyond what shakers reach
SAME_WITHIN = 2.0  # factor in gamma beyond which a change of the measured type is another one
STARTS = ("take-off", "rest")  # changes of the model at its start; an integrated ball may come back to rest there


@dataclass(frozen=True)
class FirstBifurcation:
    """The first change of the motion after take-off: measured bracket, prediction, and their ratio.

    ``predicted_gamma`` is the model's first change of any type after its take-off, ``same_type_gamma`` its first of the
    measured type (NaN: none up to `SAME_WITHIN` times the measured gamma). Ratios are of the bracket's middle.
    """

    measured: Change | None
    predicted_type: str
    predicted_gamma: float
    same_type_gamma: float

    @property
    def middle(self) -> float:
        """Middle of the measured bracket, gamma."""
        return float("nan") if self.measured is None else 0.5 * (self.measured.gamma_before + self.measured.gamma_after)

    @property
    def ratio(self) -> float:
        """Measured over predicted."""
        return self.middle / self.predicted_gamma


def ball_on(plate: StepPlate, setup: Setup, effects: Effects) -> tuple[Ball, Forcing]:
    """Ball with those of ``effects`` that act on it, over the measured plate, and its forcing.

    The forcing has its first tone at phase zero; at the measured gamma ``b = 1`` for the setup's tones. The tones are
    divided by the accelerometer's declared response. With a declared harmonic distortion the significant measured
    harmonics are part of the forcing. Effects between drive and plate are part of the measured motion.
    """
    multiples = list(plate.forcing_multiples)
    if any("harmonics" in effect(name).hooks for name in effects):
        sigma = plate.acceleration.amplitude_sigma()
        size = np.abs(plate.acceleration.amplitudes)
        # a harmonic below four times its uncertainty may be noise
        multiples += [m for i, m in enumerate(plate.multiples) if m not in multiples and size[i] > 4.0 * sigma[i]]
    rows = [plate.multiples.index(m) for m in multiples]
    n = np.array(multiples, dtype=float)
    z = plate.acceleration.amplitudes[rows] / accelerometer_response(effects, 2.0 * np.pi * plate.frequency_hz * n)
    displacement = -z / (n**2 * setup.g_mps2.value * plate.gamma)
    forcing = Forcing.of_displacements(multiples, displacement, from_first=True)
    own = ball_effects(effects)
    return make_ball(forcing, own, frequency_hz=plate.frequency_hz, g_mps2=setup.g_mps2.value), forcing


def check_plausible(flights: Flights) -> None:
    """Refuse a plate motion beyond any shaker: its scale is wrong, and its flights would take hours to compute."""
    for plate in flights.plate.steps:
        if plate is not None and plate.gamma > MAX_GAMMA:
            raise InputError(
                f"step {plate.step}: the accelerometer reads gamma = {plate.gamma:.4g}; no shaker goes beyond "
                f"{MAX_GAMMA:g}: check channels.accelerometer.sensitivity and its unit, or pass a --profile"
            )


def first_bifurcation(flights: Flights, setup: Setup, effects: Effects) -> FirstBifurcation:
    """The first bifurcation of a recording; the model's motion in each step is not computed for it.

    Raises `ValueError` for effects that the model does not know, or a plate beyond `MAX_GAMMA`.

    Parameters
    ----------
    flights : Flights
    setup : Setup
    effects : dict
        Effects of the model by name.
    """
    check_plausible(flights)
    return first_after_takeoff(flights, setup, changes_along(flights, classify(flights)), resolve(effects))


def changes_along(flights: Flights, classes: Sequence[StepClass]) -> tuple[Change, ...]:
    """Changes of the measured motion along the ramp."""
    gammas = np.array([np.nan if p is None else p.gamma for p in flights.plate.steps])
    order = _order(gammas)
    return changes(tuple(classes[i] for i in order), gammas[order])


def _order(gammas: Floats) -> Integers:
    """Order of the steps along the ramp: in time where gamma turns at most once, by gamma where they are shuffled."""
    known = gammas[np.isfinite(gammas)]
    turns = np.count_nonzero(np.diff(np.sign(np.diff(known))))
    return np.arange(len(gammas)) if turns <= 1 else np.argsort(gammas, kind="stable")


def first_after_takeoff(flights: Flights, setup: Setup, seen: tuple[Change, ...], effects: Effects) -> FirstBifurcation:
    """The first change after take-off, measured and predicted, in gamma."""
    measured = next((c for c in seen if c.type not in ("take-off", "landing for good")), None)
    plates = [p for p in flights.plate.steps if p is not None and p.gamma > 0]
    nan = float("nan")
    if not plates:
        return FirstBifurcation(measured, "", nan, nan)
    ball, _ = ball_on(plates[-1], setup, effects)
    # the model's change may come a fifth beyond the largest gamma measured
    low, high = min(p.gamma for p in plates), 1.2 * max(p.gamma for p in plates)
    wanted, found = "" if measured is None else measured.type, None
    farthest = math.inf if measured is None else SAME_WITHIN * max(measured.gamma_before, measured.gamma_after)
    # the steps of a ramp are coarser than 1e-4 in gamma: a narrower window of the model cannot be seen
    fine = {"narrowest": 1e-4, "sharp": 1e-6}
    for change in observed_bifurcations(ball, low, high, sweep="up", steps=200, **fine):
        if change.type in STARTS:
            continue
        if found is not None and change.gamma > farthest:
            break
        found = found or change
        if wanted not in TYPES or change.type == wanted:
            same = change.gamma if change.type == wanted else nan
            return FirstBifurcation(measured, found.type, found.gamma, same)
    if found is None:
        return FirstBifurcation(measured, "", nan, nan)
    return FirstBifurcation(measured, found.type, found.gamma, nan)


def plausibility_warnings(recording: Recording, flights: Flights, instrument: Instrument | None) -> list[str]:
    """Warnings, one sentence each, about a recording whose flights are known; no number changes."""
    found = []
    jitter = float(recording.attrs.get("jitter_s", 0.0)) * recording.rate_hz
    # an rms deviation of a sample from even sampling is worth a warning
    if jitter > 1.0:
        found.append(
            f"the file's times differ from {recording.rate_hz:.6g} samples/s by {jitter:.3g} samples rms, and samples "
            'are counted: "within one sample" is of the count, not of the times'
        )
    doubts = () if instrument is None else instrument.doubts
    odd = (*flights.plate.warnings(), *in_words(flights.edges.by_hand))
    return [*found, *(doubt.sentence for doubt in doubts), *odd]
