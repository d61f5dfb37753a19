"""A recording held against the model: ideal plus declared effects, step by step, and the first bifurcation.

The rule kept here: like with like. The model flies over the plate that was measured, its state is carried from step to
step as on the bench, and where the recording has no second witness the instrument's blindness is put on the model too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from analysis.flights.classify import BandTest, Change, StepClass, band_test, changes, classify
from analysis.flights.table import FlightFlag, Flights
from analysis.plate.motion import StepPlate
from daq.setup.setup import Setup
from model.bifurcations.forbidden_zones import forbidden_zones
from model.bifurcations.sweep import observed
from model.contact_sensor import Instrument, observe
from model.effects.registry import effect, resolve
from model.effects.routing import Effects, of_the_ball, reading
from model.orbits.attractor import AT_REST, Attractor, Ball, attractor
from model.orbits.make_ball import ball_of
from model.tones import Forcing

Floats = npt.NDArray[np.float64]

MOST_GAMMA = 500.0  # of a plate: beyond what shakers reach, with room
FLIGHTS = 2048  # flown before a step is called chaotic
CYCLES_SHOWN = 4  # cycles put through the instrument
NEAR_SAMPLES = 1.0
SHORT = 0.02  # of the longest predicted flight: what is shorter is a bounce
BIFURCATION_STEPS = 200
STARTS = ("take-off", "rest")  # of the model; an integrated ball may come back to rest just above its threshold
SEEN = 4.0  # standard deviations by which a harmonic stands out


@dataclass(frozen=True)
class StepComparison:
    """One step, measured and predicted.

    Attributes
    ----------
    step : int
    gamma, gamma_peak : float
        As the accelerometer shows them.
    measured : StepClass
    predicted : str
        The model's attractor in words.
    predicted_s : array
        Flight times of one predicted cycle as the instrument would show them (of some flights where chaotic).
    periodic : bool
        Whether the model predicts a cycle.
    mean_ratio : float
        Mean measured flight time, double hits apart, over mean predicted, bounces apart; NaN without either.
    rms_s : float
        Rms distance of measured flights to the nearest predicted time, in periodic windows; NaN elsewhere.
    within_sample : float
        Fraction of measured flights within one sample of a predicted time, in periodic windows; NaN elsewhere.
    doubt : str
        Why a periodic step cannot judge the model, empty when it can: ``sensitive`` (the uncertainty of gamma alone
        moves the prediction by a third of a sample or more: grazing, or a bifurcation next to it) or ``unsettled``
        (the predicted cycle attracts so slowly that the settle time does not reach it).
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
    doubt: str
    bands: tuple[BandTest, ...]


@dataclass(frozen=True)
class FirstBifurcation:
    """The first change of the motion after take-off: measured bracket, prediction, and their ratio.

    ``predicted_gamma`` is the model's first change of any type after its take-off, ``same_type_gamma`` its first of the
    measured type (NaN: none in the range). Ratios are of the bracket's middle.
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


@dataclass(frozen=True)
class Comparison:
    """A whole recording against the model.

    ``short_by`` is one minus the median ratio of flight times, over the steps in which both are cycles (all, where
    there are none); ``within_sample`` is over the flights of periodic steps without doubt.
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


def forcing_of(plate: StepPlate, setup: Setup, effects: Effects) -> tuple[Forcing, float]:
    """The measured forcing with its first tone at phase zero, and its gamma with ``b = 1`` for the setup's tones.

    Gamma is what the accelerometer shows; where it is declared to read too much, the tones are by so much smaller.
    Where the plate is declared to move at harmonics, those that were measured belong to its motion.
    """
    multiples = list(plate.forcing_multiples)
    if any("harmonics" in effect(name).hooks for name in effects):
        sigma = plate.acceleration.amplitude_sigma()
        size = np.abs(plate.acceleration.amplitudes)
        multiples += [m for i, m in enumerate(plate.multiples) if m not in multiples and size[i] > SEEN * sigma[i]]
    rows = [plate.multiples.index(m) for m in multiples]
    z = plate.acceleration.amplitudes[rows] / reading(effects)
    n = np.array(multiples, dtype=float)
    displacement = np.abs(z) / n**2
    phase = np.angle(z) - 0.5 * np.pi
    phase = np.mod(phase - n * phase[0] + np.pi, 2.0 * np.pi) - np.pi
    b = displacement / (setup.g_mps2.value * plate.gamma)
    return Forcing(tuple(n), tuple(b.tolist()), tuple(phase.tolist())), plate.gamma


def ball_on(plate: StepPlate, setup: Setup, effects: Effects) -> tuple[Ball, Forcing, float]:
    """The ball with those of ``effects`` that act on it, over the plate that was measured; its forcing and gamma.

    Effects between drive and plate are in the measured motion already.
    """
    forcing, gamma = forcing_of(plate, setup, effects)
    own = of_the_ball(effects)
    return ball_of(forcing, own, frequency_hz=plate.frequency_hz, g_mps2=setup.g_mps2.value), forcing, gamma


def _check_plausible(flights: Flights) -> None:
    """Refuse a plate that no shaker moves so: its scale is wrong, and its flights would be followed for hours."""
    for plate in flights.plate.steps:
        if plate is not None and plate.gamma > MOST_GAMMA:
            raise ValueError(
                f"step {plate.step}: the accelerometer reads gamma = {plate.gamma:.4g}; no shaker goes beyond "
                f"{MOST_GAMMA:g}: check channels.accelerometer.sensitivity and its unit, or pass a --profile"
            )


def compare(
    flights: Flights,
    setup: Setup,
    *,
    effects: Effects | None = None,
    steps_table: npt.NDArray[np.void] | None = None,
) -> Comparison:
    """Hold a recording's flights against the model.

    Parameters
    ----------
    flights : Flights
    setup : Setup
    effects : dict, optional
        Effects of the model by name; the setup's declared ones where not given.
    steps_table : STEP_DTYPE array, optional
        The recording's; tells how long each step settled.

    Raises
    ------
    ValueError
        For effects that the model does not know, or a plate beyond `MOST_GAMMA`.
    """
    _check_plausible(flights)
    declared = resolve(setup.declared_values() if effects is None else effects)
    classes = classify(flights)
    steps, last = [], AT_REST
    for plate, own in zip(flights.plate.steps, classes, strict=True):
        if plate is None or not plate.gamma > 0:
            continue
        ball, forcing, gamma = ball_on(plate, setup, declared)
        found = attractor(ball, gamma, last, FLIGHTS)
        around = [attractor(ball, max(gamma + d * plate.gamma_uncertainty, 0.0), last, FLIGHTS) for d in (-1.0, 1.0)]
        settled = steps_table["settle_cycles"][plate.step] if steps_table is not None and len(steps_table) else np.nan
        last = found.last
        doubt = _doubt(found, around, 1.0 / (3.0 * flights.plate.rate_hz) * plate.omega_radps, float(settled))
        steps.append(_step(flights, plate, own, found, forcing, doubt))
    gammas = np.array([np.nan if p is None else p.gamma for p in flights.plate.steps])
    order = _order(gammas)
    seen = changes(tuple(classes[i] for i in order), gammas[order])
    chosen = [s for s in steps if s.periodic and s.measured.flights and s.predicted_s.size and not s.doubt]
    count = sum(s.measured.flights for s in chosen)
    inside = sum(s.within_sample * s.measured.flights for s in chosen if np.isfinite(s.within_sample))
    alike = [s.mean_ratio for s in steps if np.isfinite(s.mean_ratio) and s.measured.kind == "cycle" and s.periodic]
    ratios = alike or [s.mean_ratio for s in steps if np.isfinite(s.mean_ratio)]
    return Comparison(
        tuple(steps),
        seen,
        _first(flights, setup, seen, declared),
        tuple(sorted(declared)),
        1.0 - float(np.median(ratios)) if ratios else float("nan"),
        inside / count if count else float("nan"),
        count,
        sum(s.measured.double_hits for s in steps),
        flights.plate.rate_hz,
        flights.plate.ratio,
    )


def _order(gammas: Floats) -> npt.NDArray[np.int64]:
    """The steps along the ramp: as they came where gamma turns once at most, by gamma where they were shuffled."""
    known = gammas[np.isfinite(gammas)]
    turns = np.count_nonzero(np.diff(np.sign(np.diff(known))))
    return np.arange(len(gammas)) if turns <= 1 else np.argsort(gammas, kind="stable")


def _doubt(found: Attractor, around: list[Attractor], allowed: float, settle_cycles: float) -> str:
    """Why a predicted cycle cannot be held against the flights to ``allowed`` (phase); empty when it can."""
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
    flights: Flights, plate: StepPlate, own: StepClass, found: Attractor, forcing: Forcing, doubt: str
) -> StepComparison:
    """One step's figures."""
    predicted = seen_by_instrument(found, plate.frequency_hz, flights)
    good = (flights.step == plate.step) & flights.good()
    tau = flights.duration_s[good]
    periodic = found.kind != "chaotic"
    proper = flights.duration_s[good & ~flights.has(FlightFlag.DOUBLE_HIT)]
    launched = predicted[predicted > SHORT * predicted.max()] if predicted.size else predicted
    ratio = float(proper.mean() / launched.mean()) if proper.size and launched.size else float("nan")
    rms, within = float("nan"), float("nan")
    if periodic and tau.size and predicted.size:
        distance = np.abs(tau[:, None] - predicted[None, :]).min(axis=1)
        rms = float(np.sqrt(np.mean(distance**2)))
        within = float(np.mean(distance <= NEAR_SAMPLES / flights.plate.rate_hz))
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
        doubt if periodic else "",
        bands,
    )


def seen_by_instrument(found: Attractor, frequency_hz: float, flights: Flights) -> Floats:
    """Flight times (s) of an attractor as this recording's instrument shows them.

    With the accelerometer as second witness every flight is seen; without it `model.contact_sensor` merges those whose
    contact in between is too short for the sampled circuit.
    """
    unit = 1.0 / (2.0 * np.pi * frequency_hz)
    if flights.edges.witness is not None or found.tau.size == 0:
        return np.asarray(found.tau * unit)
    tau = np.tile(found.tau, CYCLES_SHOWN)
    phase = np.tile(found.phase, CYCLES_SHOWN)
    takeoff = np.empty(tau.size)
    landed = 0.0
    for i in range(tau.size):
        wait = np.mod(phase[i] - landed + 1e-6, 2.0 * np.pi) - 1e-6  # rounding must not turn no wait into a turn
        takeoff[i] = landed + max(wait, 0.0)
        landed = takeoff[i] + tau[i]
    takeoff_s, landing_s = takeoff * unit, np.minimum((takeoff + tau) * unit, np.append(takeoff[1:] * unit, np.inf))
    shown = observe(takeoff_s, landing_s, Instrument(rate_hz=flights.plate.rate_hz))
    first, last = shown.first, shown.last
    return np.asarray((landing_s[last] - takeoff_s[first])[1:]) if first.size > 1 else np.zeros(0)


def _first(flights: Flights, setup: Setup, seen: tuple[Change, ...], effects: Effects) -> FirstBifurcation:
    """The first change after take-off, measured and predicted, in gamma."""
    measured = next((c for c in seen if c.type not in ("take-off", "landing for good")), None)
    plates = [p for p in flights.plate.steps if p is not None and p.gamma > 0]
    nan = float("nan")
    if not plates:
        return FirstBifurcation(measured, "", nan, nan)
    ball, _, _ = ball_on(plates[-1], setup, effects)
    low, high = min(p.gamma for p in plates), 1.2 * max(p.gamma for p in plates)
    found = [b for b in observed(ball, low, high, sweep="up", steps=BIFURCATION_STEPS) if b.type not in STARTS]
    if not found:
        return FirstBifurcation(measured, "", nan, nan)
    same = next((b.gamma for b in found if measured is not None and b.type == measured.type), nan)
    return FirstBifurcation(measured, found[0].type, found[0].gamma, same)
