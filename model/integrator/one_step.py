"""Flights with any set of effects, in SI units: one event ahead of a measurement, or one after another from a start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import model.tones
from kernels.arrays import Bools, Complexes, Floats, Integers
from model.effects.registry import row
from model.integrator import predict
from model.integrator.plate import loaded
from model.integrator.problem import (
    EVENT_DTYPE,
    PREDICTION_DTYPE,
    Acting,
    ContinuousProbe,
    Detection,
    Law,
    Measured,
    Mode,
    Plate,
    PlateSteps,
    Probe,
    Projected,
    Steps,
    ToneProbe,
    Visibility,
    active,
    columns_of,
    for_kernel,
    plate_mode,
    tones_for_kernel,
)

MODE = ("q", "qd", "after_q", "after_qd")
SECOND = ("second_q", "second_qd", "second_radps", "second_damping")
OF_KERNEL = ("takeoff_s", "landing_s", "opening_s", "hidden", "kind", "launch_mps", "impact_mps", "ambiguity_s")


@dataclass(frozen=True)
class Predicted:
    """Prediction of each measured flight from the landing before; arrays of shape (n,), NaN where there is none."""

    takeoff_s: Floats  # predicted
    landing_s: Floats  # predicted
    opening_s: Floats  # predicted opening of the circuit
    hidden: Floats  # flights passed over
    kind: Floats  # 1 thrown or bounced at once, 0 after a rest, -1 no prediction
    launch_mps: Floats  # speed of the measured flight itself
    impact_mps: Floats  # the same
    # by how much later the landing may be detected, where bounces that no instrument resolves follow it
    ambiguity_s: Floats
    mode_amplitudes: Complexes  # contribution of a plate mode to each of the plate's tones, (m, k), m/s^2
    projection: Complexes  # the mode's motion projected on the tones of a `ToneProbe` in its intervals, (r, l)
    observed_s: Floats  # for how much of their time it is known, (r,)


@dataclass(frozen=True)
class Problem:
    """Measured flights, plate and parameters as the kernel takes them."""

    measured: Measured
    plate: PlateSteps
    rows: Floats
    detection: Detection
    kick: tuple[float, float]

    def predicted(self, tones: Complexes, wanted: Bools, probe: Probe) -> NDArray[np.void]:
        """Rows (n,) of `PREDICTION_DTYPE`; the mode's projections are added to those of ``probe``."""
        out = np.full(len(self.measured.landing_s), np.nan, PREDICTION_DTYPE)
        seen = Visibility(0.0, self.detection.unseen_s, self.detection.closure_s)
        predict.one_ahead(self.events(wanted), self.steps(tones), self.acting, seen, self.kick, probe, out)
        return out

    @property
    def acting(self) -> Acting:
        """The parameters, and whether there are forces, and dry friction."""
        return Acting(self.rows, active(self.rows, "force"), active(self.rows, "dry_friction"))

    def steps(self, tones: Complexes) -> Steps:
        return Steps(for_kernel(self.plate.period_s), tones_for_kernel(self.plate.omega_radps, tones))

    def events(self, wanted: Bools) -> NDArray[np.void]:
        """Rows of `EVENT_DTYPE`; what is not given is NaN, in no fade, and as in its step."""
        m = self.measured
        rows = np.zeros(len(m.landing_s), EVENT_DTYPE)
        rows["other_step"] = -1
        for name in ("gained_mps", "pressed_mps", "pressed_at", *MODE):
            rows[name] = np.nan
        rows["opening"], rows["landing"], rows["wanted"] = m.opening_s, m.landing_s, wanted
        rows["bounces"] = np.any(self.rows[:, columns_of("rebound")] > 0.0, axis=1)
        rows["gap_m"], rows["weak_mps"] = self.detection.gap_m, self.detection.weak_mps
        for name in rows.dtype.names or ():
            if getattr(m, name, None) is not None and name != "wanted":
                rows[name] = getattr(m, name)
        if m.mode is not None:
            for name, values in zip((*MODE, *SECOND)[: m.mode.shape[1]], m.mode.T, strict=True):
                rows[name] = values
        return rows


def driven(plate: PlateSteps, amplitudes: Complexes) -> Complexes:
    """Tones (m, k) less what a plate mode adds to them: the measured ones contain it, only the rest is driven."""
    tones, own = plate.acceleration_mps2, amplitudes.shape[1]
    # a tone that was not fitted stays none
    driven = np.where(tones[:, :own] == 0.0, 0.0, tones[:, :own] - amplitudes)
    return np.concatenate([driven, tones[:, own:]], axis=1)


def one_ahead(
    measured: Measured,
    plate: PlateSteps,
    rows: Floats,
    detection: Detection | None = None,
    *,
    kick: tuple[float, float] = (0.0, 0.0),
    probe: ToneProbe | None = None,
    mode: Projected | None = None,
) -> Predicted:
    """Predict each flight's take-off and landing from the measured landing before it.

    Parameters
    ----------
    measured, plate
        The events and the plate's motion.
    rows
        All parameters, shape (P + 1,) or one row an event (n, P + 1): see `model.effects.registry.row`.
    detection
        What the contact circuit misses.
    kick
        Added to a plate mode's displacement (m) and velocity (m/s) wherever the chain of flights begins anew: how the
        mode rang before is known no better; a part of it where ``pressed_mps`` tells.
    probe
        How the plate's tones were measured; without one, all the time.
    mode
        What a plate mode adds, not projected anew: as measured, or of a prediction of almost the same.
    """
    rows = for_kernel(rows.reshape(-1, rows.shape[-1]))
    problem = Problem(measured, plate, rows, Detection() if detection is None else detection, kick)
    tones, own = plate.acceleration_mps2, plate.acceleration_mps2.shape[1] - plate.derived
    amplitudes = np.zeros((len(tones), own), dtype=np.complex128)
    probe = ContinuousProbe(plate.omega_radps[:, :own]) if probe is None else probe
    span_s = for_kernel(probe.span_s)
    projection, observed_s = np.zeros((0, 0), dtype=np.complex128), np.zeros(len(span_s))
    ringing = bool(np.any(rows[:, columns_of("plate_mode")] > 0.0))
    if ringing and mode is not None:
        amplitudes, projection, observed_s = mode.mode_amplitudes, mode.projection, mode.observed_s
    elif ringing:  # two passes: the measured tones contain what the mode adds, and only the rest is driven
        amplitudes, projection, observed_s = _mode_projected(problem, probe)
    if ringing:
        tones = driven(plate, amplitudes)
    unused = np.zeros((0, 0), dtype=np.complex128), np.zeros(len(span_s))
    silent = Probe(np.zeros(len(tones) + 1, dtype=np.int64), span_s, np.zeros((len(tones), 0)), *unused)
    out = problem.predicted(tones, measured.wanted, silent)
    for name in ("takeoff_s", "landing_s", "opening_s", "hidden"):
        out[name][out["kind"] < 0] = np.nan
    return Predicted(
        **{name: out[name].copy() for name in OF_KERNEL},
        mode_amplitudes=amplitudes,
        projection=projection,
        observed_s=observed_s,
    )


def _mode_projected(problem: Problem, probe: ToneProbe) -> tuple[Complexes, Complexes, Floats]:
    """What a plate mode adds to the measured tones (m, k), its projections, and the time observed in each span, s."""
    plate, rows = problem.plate, problem.rows
    tones, own = plate.acceleration_mps2, plate.acceleration_mps2.shape[1] - plate.derived
    span_s, first = for_kernel(probe.span_s), for_kernel(probe.first)
    projection = np.zeros((len(span_s), probe.omega_radps.shape[1]), dtype=np.complex128)
    observed_s = np.zeros(len(span_s))
    nothing = np.zeros(len(problem.measured.landing_s), dtype=np.bool_)
    problem.predicted(tones, nothing, Probe(first, span_s, for_kernel(probe.omega_radps), projection, observed_s))
    amplitudes = probe.of_tones(projection, observed_s)
    of_step = np.add.reduceat(np.append(observed_s, 0.0), first[:-1]) * (np.diff(first) > 0)
    for k in np.flatnonzero(of_step == 0.0):  # the ball never left: its mass moves with the plate
        amplitudes[k] = _carried(plate.omega_radps[k, :own], tones[k, :own], rows[0])
    return amplitudes, projection, observed_s


def _carried(omega_radps: Floats, tones: Complexes, row: Floats) -> Complexes:
    """Part of measured tones (k,) that a ball resting on the plate mode all the time adds to them."""
    row = for_kernel(row)
    om, ze, _ = plate_mode(row)
    measured = tones_for_kernel(omega_radps, tones)
    loaded(0.0, Plate(measured, Mode(0.0, 0.0, om, ze)), row, under := np.empty_like(measured))
    _, re, im = under.T
    factor = np.divide(re + 1j * im, tones, out=np.ones_like(tones), where=tones != 0.0)
    # measured is the driven tone times the factor of the loaded mode: what is added is the rest
    return np.asarray(tones * (1.0 - 1.0 / factor))


@dataclass(frozen=True)
class Orbit:
    """Flights one after another, shape (n,) each: SI units, velocities relative to the plate."""

    takeoff_s: Floats
    launch_mps: Floats
    landing_s: Floats
    impact_mps: Floats
    after_rest: Bools
    hidden: Integers


def simulate(
    effects: Mapping[str, Mapping[str, float]],
    plate: model.tones.Plate,
    *,
    g_mps2: float,
    period_s: float,
    flights: int,
    start: tuple[float, float] = (0.0, 0.0),
    unseen_s: float = 0.0,
) -> Orbit:
    """Fly ``flights`` flights from an impact; fewer come back when the ball stays on the plate.

    Raises `ValueError` for unknown effects or parameters, or values out of bounds.

    Parameters
    ----------
    effects
        By name and parameter.
    plate, period_s
        Its tones, and the period of the forcing.
    start
        Time (s) and speed (m/s) of the impact.
    unseen_s
        Flights shorter than this are passed over.
    """
    tones = tones_for_kernel(plate.omega_radps, plate.acceleration)
    return flown(law_of(effects, g_mps2), tones, period_s, flights, start, unseen_s)


def law_of(effects: Mapping[str, Mapping[str, float]], g_mps2: float) -> Law:
    """What acts on a ball with ``effects`` by name and parameter, for `flown`; raises as `simulate` does."""
    rows = row(effects, g_mps2)
    acting = active(rows, "force"), active(rows, "dry_friction")
    return Law(for_kernel(rows), 0.0, *acting, np.empty((0, 6)), np.empty((0, 3)))


def flown(
    law: Law, tones: Floats, period_s: float, flights: int, start: tuple[float, float], unseen_s: float = 0.0
) -> Orbit:
    """`simulate` under a ``law`` made once, over a plate with ``tones`` (k, 3): see `problem.tones_for_kernel`."""
    out = np.empty(flights, PREDICTION_DTYPE)
    out = out[: predict.simulate(float(start[0]), float(start[1]), period_s, tones, law, unseen_s, out)]
    flown = {name: out[name].copy() for name in ("takeoff_s", "launch_mps", "landing_s", "impact_mps")}
    return Orbit(**flown, after_rest=out["kind"] == 0.0, hidden=out["hidden"].astype(np.int64))
