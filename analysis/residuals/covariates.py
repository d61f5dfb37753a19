"""Covariates of every flight: quantities on which a missing cause may depend.

A covariate is known before its flight ends. It is computed from the measured events and the plate's tones only, so
that no residual can explain itself. The few that describe the flight's own end are marked and serve figures and tests
of fit only.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from analysis.residuals.observations import Observations
from kernels.arrays import Bools, Complexes, Floats, Integers
from model.effects.registry import registry
from model.integrator.problem import PlateSteps


@dataclass(frozen=True)
class Covariate:
    """Name and unit of a covariate."""

    words: str  # its name in prose
    unit: str = ""  # as printed
    scale: float = 1.0  # factor to it from SI
    ahead: bool = True  # True where it is known at take-off: only these may carry a term of the model


COVARIATES: Mapping[str, Covariate] = {
    "gamma": Covariate("gamma"),
    "time_in_run_s": Covariate("time in run", "s"),
    "previous_flight_s": Covariate("previous flight", "ms", 1e3),
    "earlier_flight_s": Covariate("flight before the previous", "ms", 1e3),
    "previous_impact_mps": Covariate("impact speed", "m/s"),
    "dwell_s": Covariate("dwell time", "ms", 1e3),
    "plate_at_impact_mps2": Covariate("plate acceleration", "m/s^2"),
    "plate_speed_at_impact_mps": Covariate("plate velocity at the impact", "m/s"),
    "impact_phase_rad": Covariate("phase of the impact", "rad"),
    "takeoff_phase_rad": Covariate("take-off phase", "rad"),
    "launch_mps": Covariate("launch speed", "m/s", ahead=False),
    "plate_speed_at_takeoff_mps": Covariate("plate velocity at take-off", "m/s"),
    "flights_since_rest": Covariate("flights since the last rest"),
    "turn": Covariate("turn (every other flight)"),
    "step_number": Covariate("step number", ahead=False),
    "time_in_step_s": Covariate("time in the step", "s"),
    "flight_s": Covariate("flight time", "ms", 1e3, ahead=False),
    "impact_mps": Covariate("impact speed of this flight", "m/s", ahead=False),
    "landing_phase_rad": Covariate("landing phase", "rad", ahead=False),
    "height_m": Covariate("greatest height", "mm", 1e3, ahead=False),
    "plate_speed_at_landing_mps": Covariate("plate velocity at landing", "m/s", ahead=False),
}


def covariates_of(ev: Observations, late_s: tuple[Floats, Floats], reading: Complexes | Floats) -> dict[str, Floats]:
    """Covariates of every flight of the observations.

    Arrays (n,) by the names of `COVARIATES`, SI units; NaN where the flight before is not known.

    Parameters
    ----------
    ev
        The observations.
    late_s
        By how much later than they happened openings and landings were seen, (n,) each.
    reading
        What the accelerometer shows of each tone of the plate, relative to it, (m, k).
    """
    gravity = ev.setup.g_mps2.value
    events, step = ev.measured, ev.measured.step
    plate = replace(ev.steps.plate, acceleration_mps2=ev.steps.plate.acceleration_mps2 / reading)
    before = np.maximum(np.arange(len(step)) - 1, 0)
    linked = events.linked
    land, opening = events.landing_s - late_s[1], events.opening_s - late_s[0]
    start = np.where(events.relaunched & linked, land[before], opening)
    lasts = land - start
    launch, impact = _ends(gravity, plate, step, start, lasts, events.relaunched & linked)
    _, at_land, a_land = _plate(plate, step, land)
    _, at_start, _ = _plate(plate, step, start)

    def previous(x: Floats) -> Floats:
        return np.where(linked, x[before], np.nan)

    index, begun = np.arange(len(step)), np.full(int(step.max(initial=0)) + 1, np.inf)
    rested = np.maximum.accumulate(np.where(events.relaunched & linked, 0, index))
    np.minimum.at(begun, step, land)

    return {
        "gamma": ev.steps.gamma[step],
        "time_in_run_s": ev.time_s,
        "previous_flight_s": previous(lasts),
        "earlier_flight_s": previous(previous(lasts)),
        "previous_impact_mps": previous(impact),
        "dwell_s": np.where(linked, start - land[before], np.nan),
        "plate_at_impact_mps2": previous(a_land),
        "plate_speed_at_impact_mps": previous(at_land),
        "impact_phase_rad": previous(_phase(plate, step, land)),
        "takeoff_phase_rad": _phase(plate, step, start),
        "launch_mps": launch,
        "plate_speed_at_takeoff_mps": at_start,
        "flights_since_rest": (index - rested).astype(np.float64),
        "turn": index % 2.0,
        "step_number": ev.steps.number[step].astype(np.float64),
        "time_in_step_s": land - begun[step],
        "flight_s": lasts,
        "impact_mps": impact,
        "landing_phase_rad": _phase(plate, step, land),
        "height_m": _height(gravity, plate, step, start, lasts, launch),
        "plate_speed_at_landing_mps": at_land,
    }


def _plate(plate: PlateSteps, step: Integers, t: Floats) -> tuple[Floats, Floats, Floats]:
    """Displacement, velocity and acceleration of the plate at times of the shape of ``step``."""
    w, z = plate.omega_radps[step], plate.acceleration_mps2[step]
    turned = z * np.exp(1j * w * t[:, None])
    # a tone z exp(i w t) of the acceleration integrates to z / (i w), and twice to -z / w^2
    return -(turned / w**2).real.sum(axis=1), (turned / (1j * w)).real.sum(axis=1), turned.real.sum(axis=1)


def _phase(plate: PlateSteps, step: Integers, t: Floats) -> Floats:
    """Phase of the first tone's displacement, 0 where it crosses zero going up, in [0, 2 pi)."""
    w, z = plate.omega_radps[step, 0], plate.acceleration_mps2[step, 0]
    return np.asarray(np.mod(w * t + np.angle(-z) + 0.5 * math.pi, 2.0 * math.pi))


def _ends(
    g: float, plate: PlateSteps, step: Integers, start: Floats, lasts: Floats, relaunched: Bools
) -> tuple[Floats, Floats]:
    """Launch and impact speed relative to the plate of flights under gravity, from where they began and ended."""
    x0, v0, _ = _plate(plate, step, start)
    x1, v1, _ = _plate(plate, step, start + lasts)
    # the path over the plate is closed: h(0) = h(T) = 0 gives the launch speed, dh/dt at T the impact speed
    launch = np.where(relaunched, 0.5 * g * lasts + (x1 - x0) / lasts - v0, 0.0)
    return np.maximum(launch, 0.0), np.maximum(g * lasts + v1 - v0 - launch, 0.0)


def _height(g: float, plate: PlateSteps, step: Integers, start: Floats, lasts: Floats, launch: Floats) -> Floats:
    """Greatest height above the plate under gravity."""
    x0, v0, _ = _plate(plate, step, start)
    best = np.zeros(len(step))
    # 33 points: the highest of them lies within 0.1 % of a parabola's height below its top
    for part in np.linspace(0.0, 1.0, 33)[1:-1]:
        s = part * lasts
        x, _, _ = _plate(plate, step, start + s)
        best = np.maximum(best, (launch + v0) * s - 0.5 * g * s * s - (x - x0))
    return best


@functools.cache
def followed_parameters() -> tuple[tuple[str, int, str], ...]:
    """Parameters that stand for a quantity of the flight: effect, place in the row, and name of the covariate."""
    out = []
    for r in registry():
        for i, q in enumerate(r.effect.parameters):
            if q.covariate and q.covariate not in COVARIATES:
                known = ", ".join(k for k, c in COVARIATES.items() if c.ahead)
                raise ValueError(f"effect {r.effect.name}: no covariate is called {q.covariate!r}; known are {known}")
            if q.covariate:
                out.append((r.effect.name, r.offset + i, q.covariate))
    return tuple(out)
