"""The first bifurcation of a recording, measured and predicted: a ball with effects over the measured plate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.flights.classify import Change, StepClass, changes, classify
from analysis.flights.table import Flights
from analysis.plate.motion import StepPlate
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from kernels.arrays import Floats, Integers
from model.bifurcations.sweep import TYPES, observed_bifurcations
from model.effects.registry import effect, resolve
from model.effects.routing import Effects, accelerometer_response, ball_effects
from model.orbits.attractor import Ball
from model.orbits.make_ball import make_ball
from model.tones import Forcing

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


def forcing_of(plate: StepPlate, setup: Setup, effects: Effects) -> tuple[Forcing, float]:
    """Measured forcing with its first tone at phase zero, and its gamma with ``b = 1`` for the setup's tones.

    The tones are divided by the accelerometer's declared response; gamma is as measured. With a declared harmonic
    distortion the significant measured harmonics are part of the forcing.
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
    return Forcing.of_displacements(multiples, displacement, from_first=True), plate.gamma


def ball_on(plate: StepPlate, setup: Setup, effects: Effects) -> tuple[Ball, Forcing, float]:
    """Ball with those of ``effects`` that act on it, over the measured plate; its forcing and gamma.

    Effects between drive and plate are part of the measured motion.
    """
    forcing, gamma = forcing_of(plate, setup, effects)
    own = ball_effects(effects)
    return make_ball(forcing, own, frequency_hz=plate.frequency_hz, g_mps2=setup.g_mps2.value), forcing, gamma


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
    ball, _, _ = ball_on(plates[-1], setup, effects)
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
