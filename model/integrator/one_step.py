"""Flights with any set of effects, in SI units: one event ahead of a measurement, or one after another from a start."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

import model.tones
from model.effects.registry import null_row, registry, row
from model.integrator import predict, slopes
from model.integrator.hooks import plate_mode
from model.integrator.plate import loaded
from model.integrator.records import Events, Law, Mode, Plate, Probe, Steps, Visibility
from model.integrator.variation import Columns

Array = NDArray[np.float64]
_T = TypeVar("_T", bound=np.generic)


@functools.cache
def _columns(hook: str) -> NDArray[np.intp]:
    """Places in the row of all parameters of the effects that define ``hook``."""
    return np.array(
        [
            e.offset + i
            for e in registry()
            if hook in e.hooks
            for i, q in enumerate(e.effect.parameters)
            if not q.is_shape or q.name == "of"
        ],
        dtype=np.intp,
    )


@functools.cache
def _nothing(hook: str) -> Array:
    """The null values of `_columns`."""
    return null_row(0.0)[_columns(hook)]


def _active(rows: Array, hook: str) -> bool:
    return bool((rows[..., _columns(hook)] != _nothing(hook)).any())


def _for_kernel(values: NDArray[_T]) -> NDArray[_T]:
    """An array as the kernels take it, contiguous and writable: numba compiles each layout, and each right, anew."""
    if values.flags.c_contiguous and values.flags.writeable:
        return values
    return np.require(values, requirements=["C", "W"])


def _tones(omega_radps: Array, acceleration_mps2: NDArray[np.complex128]) -> Array:
    """Tones (..., k) as the kernels take them, (..., k, 3)."""
    out = np.empty((*acceleration_mps2.shape, 3))
    out[..., 0], out[..., 1], out[..., 2] = omega_radps, acceleration_mps2.real, acceleration_mps2.imag
    return out


def _of_each(value: NDArray[_T] | float, n: int) -> NDArray[Any]:
    """One value, or one an event, as the kernel takes it: shape (n,), always read-only, so that it compiles once."""
    one = np.asarray(value)
    values = np.empty(n, dtype=one.dtype if one.dtype == np.bool_ else np.float64)
    values[:] = one
    values.flags.writeable = False
    return values


@dataclass(frozen=True)
class PlateSteps:
    """The plate's motion in each step: tones on one time axis.

    Parameters
    ----------
    omega_radps, acceleration_mps2
        Angular frequencies and complex amplitudes, shape (m, k); the plate's acceleration is
        ``Re sum acceleration exp(i omega t)``. Unused places hold zeros and any positive frequency.
    period_s
        Period of the forcing, shape (m,).
    derived
        How many of the last tones were not measured but follow from the others.
    """

    omega_radps: Array
    acceleration_mps2: NDArray[np.complex128]
    period_s: Array
    derived: int = 0


@dataclass(frozen=True)
class Measured:
    """Measured flights in order, as the predictions need them; arrays of shape (n,).

    Parameters
    ----------
    opening_s, landing_s
        When the circuit opened and closed.
    relaunched
        The ball left at the landing before, not after a rest.
    linked
        The flight before in the table is the flight before in reality.
    step
        Row of `PlateSteps`.
    wanted
        Flights for which a prediction is wanted.
    beside, share
        While the drive fades from step to step: row of the other step (-1: the plate at rest), and the share of its
        motion. None where no flight is flown in a fade.
    """

    opening_s: Array
    landing_s: Array
    relaunched: NDArray[np.bool_]
    linked: NDArray[np.bool_]
    step: NDArray[np.int64]
    wanted: NDArray[np.bool_]
    beside: NDArray[np.int64] | None = None
    share: Array | None = None


@dataclass(frozen=True)
class Detection:
    """What the contact circuit misses.

    Parameters
    ----------
    gap_m
        Height at which the circuit opens, one number or (n,).
    unseen_s
        Flights shorter than this are passed over: no instrument has seen them.
    passable_s
        Flights shorter than this may have escaped the instrument: they are passed over when they end before the
        measured flight begins.
    closure_s
        How long an impact keeps the circuit closed, the ball gone or not: one passed over delays the opening.
    weak_mps
        An impact slower than this, from which the ball leaves at once, may have left no mark: the measured flight went
        on through it. Infinite where nothing but the contact circuit watches; one number or (n,).
    """

    gap_m: Array | float = 0.0
    unseen_s: float = 1e-4
    passable_s: float = 2e-3
    closure_s: float = 0.0
    weak_mps: Array | float = 0.0


@dataclass(frozen=True)
class Predicted:
    """Prediction of each measured flight from the landing before; arrays of shape (n,), NaN where there is none.

    Parameters
    ----------
    takeoff_s, landing_s, opening_s
        Predicted events; the circuit opens at ``opening_s``.
    hidden
        Flights passed over.
    kind
        1 thrown or bounced at once, 0 after a rest, -1 no prediction.
    launch_mps, impact_mps
        Speeds of the measured flight itself.
    ambiguity_s
        By how much later the landing may be detected, where bounces that no instrument resolves follow it.
    mode_amplitudes
        Contribution of a plate mode to each of the plate's tones, (m, k), m/s^2.
    projection, observed_s
        The mode's motion projected on the tones of a `ToneProbe` in its intervals, (r, l), and for how much of their
        time it is known, (r,).
    table
        The kernel's table, (n, `predict.OUT_COLUMNS`), for derivatives of the prediction.
    """

    takeoff_s: Array
    landing_s: Array
    opening_s: Array
    hidden: Array
    kind: Array
    launch_mps: Array
    impact_mps: Array
    ambiguity_s: Array
    mode_amplitudes: NDArray[np.complex128]
    projection: NDArray[np.complex128]
    observed_s: Array
    table: Array | None = None


class ToneProbe(Protocol):
    """The time intervals and frequencies at which plate tones were measured; projects a mode's motion on them.

    Attributes
    ----------
    first
        Where each step's intervals begin in ``span_s``, and where the last ends, (m + 1,).
    span_s
        Intervals of time, in order within a step, (r, 2).
    omega_radps
        Angular frequencies, (m, l).
    """

    @property
    def first(self) -> NDArray[np.int64]: ...
    @property
    def span_s(self) -> Array: ...
    @property
    def omega_radps(self) -> Array: ...

    def of_tones(self, projection: NDArray[np.complex128], observed_s: Array) -> NDArray[np.complex128]:
        """Contribution to the plate's tones (m, k), m/s^2, of integrals (r, l) of ``acceleration exp(-i w t)``."""
        ...


@dataclass(frozen=True)
class ContinuousProbe:
    """Tones measured all the time, far apart from one another."""

    omega_radps: Array

    @property
    def first(self) -> NDArray[np.int64]:
        return np.arange(len(self.omega_radps) + 1)

    @property
    def span_s(self) -> Array:
        return np.tile([-np.inf, np.inf], (len(self.omega_radps), 1))

    def of_tones(self, projection: NDArray[np.complex128], observed_s: Array) -> NDArray[np.complex128]:
        return np.asarray(2.0 * projection / np.where(observed_s > 0.0, observed_s, 1.0)[:, None])


@dataclass(frozen=True)
class _Problem:
    """Measured flights, plate and parameters as the kernel takes them."""

    measured: Measured
    plate: PlateSteps
    rows: Array
    detection: Detection
    kick: tuple[float, float]

    def predicted(self, tones: NDArray[np.complex128], wanted: NDArray[np.bool_], probe: Probe) -> Array:
        """The kernel's table (n, `predict.OUT_COLUMNS`); the mode's projections are added to those of ``probe``."""
        out = np.full((len(self.measured.landing_s), predict.OUT_COLUMNS), np.nan)
        seen = Visibility(0.0, self.detection.unseen_s, self.detection.passable_s, self.detection.closure_s)
        predict.one_ahead(self.events(wanted), self.steps(tones), self.rows, *self.acting, seen, self.kick, probe, out)
        return out

    def slopes(
        self, tones: NDArray[np.complex128], wanted: NDArray[np.bool_], columns: Columns, table: Array
    ) -> tuple[Array, Array]:
        """Derivatives (n, 3, d) of openings, landings and impact speeds in ``table``, and their info (n, `slopes.INFO`)."""
        n, d = len(table), slopes.TONES + 2 * tones.shape[1] + len(columns.place)
        out, info = np.zeros((n, 3, d)), np.zeros((n, slopes.INFO))
        slopes.slopes_ahead(
            self.events(wanted), self.steps(tones), self.rows, self.acting, self.kick, columns, table, out, info
        )
        return out, info

    @property
    def acting(self) -> tuple[bool, bool]:
        """Whether there are forces, and dry friction."""
        return _active(self.rows, "force"), _active(self.rows, "dry_friction")

    def steps(self, tones: NDArray[np.complex128]) -> Steps:
        return Steps(_for_kernel(self.plate.period_s), _tones(self.plate.omega_radps, tones))

    def events(self, wanted: NDArray[np.bool_]) -> Events:
        m, n = self.measured, len(self.measured.landing_s)
        return Events(
            _for_kernel(m.opening_s),
            _for_kernel(m.landing_s),
            _for_kernel(m.relaunched),
            _for_kernel(m.linked),
            _for_kernel(wanted),
            _for_kernel(m.step),
            _of_each(np.any(self.rows[:, _columns("rebound")] > 0.0, axis=1), n),
            _of_each(self.detection.gap_m, n),
            _of_each(self.detection.weak_mps, n),
            _for_kernel(np.full(n, -1, dtype=np.int64) if m.beside is None else m.beside),
            _for_kernel(np.zeros(n) if m.share is None else m.share),
        )


def one_ahead(
    measured: Measured,
    plate: PlateSteps,
    rows: Array,
    detection: Detection | None = None,
    *,
    kick: tuple[float, float] = (0.0, 0.0),
    probe: ToneProbe | None = None,
    mode: Predicted | None = None,
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
        mode rang before is known no better.
    probe
        How the plate's tones were measured; without one, all the time.
    mode
        A prediction whose plate mode is taken over, not projected anew: for small changes of events and tones.
    """
    n = len(measured.landing_s)
    rows = _for_kernel(rows.reshape(-1, rows.shape[-1]))
    problem = _Problem(measured, plate, rows, Detection() if detection is None else detection, kick)
    tones, own = plate.acceleration_mps2, plate.acceleration_mps2.shape[1] - plate.derived
    amplitudes = np.zeros((len(tones), own), dtype=np.complex128)
    probe = ContinuousProbe(plate.omega_radps[:, :own]) if probe is None else probe
    nothing, span_s = np.zeros(len(tones) + 1, dtype=np.int64), _for_kernel(probe.span_s)
    projection, observed_s = np.zeros((0, 0), dtype=np.complex128), np.zeros(len(span_s))
    ringing = bool(np.any(rows[:, _columns("plate_mode")] > 0.0))
    if ringing and mode is not None:
        amplitudes, projection, observed_s = mode.mode_amplitudes, mode.projection, mode.observed_s
    elif ringing:
        projection = np.zeros((len(span_s), probe.omega_radps.shape[1]), dtype=np.complex128)
        first = _for_kernel(probe.first)
        problem.predicted(
            tones,
            np.zeros(n, dtype=np.bool_),
            Probe(first, span_s, _for_kernel(probe.omega_radps), projection, observed_s),
        )
        amplitudes = probe.of_tones(projection, observed_s)
        of_step = np.add.reduceat(np.append(observed_s, 0.0), first[:-1]) * (np.diff(first) > 0)
        for k in np.flatnonzero(of_step == 0.0):  # the ball never left: its mass moves with the plate
            amplitudes[k] = _carried(plate.omega_radps[k, :own], tones[k, :own], rows[0])
    if ringing:
        tones = _driven(plate, amplitudes)
    unused = np.zeros((0, 0), dtype=np.complex128), np.zeros(len(span_s))
    silent = Probe(nothing, span_s, np.zeros((len(tones), 0)), *unused)
    out = problem.predicted(tones, measured.wanted, silent)
    out[out[:, 6] < 0, :6] = np.nan
    takeoff, _, landing, _, *others = out[:, :10].T
    columns: tuple[Any, ...] = (takeoff, landing, *others, amplitudes, projection, observed_s, out)
    return Predicted(*columns)


def _driven(plate: PlateSteps, amplitudes: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Tones (m, k) less what a plate mode adds to them: the measured ones contain it, only the rest is driven."""
    tones, own = plate.acceleration_mps2, amplitudes.shape[1]
    driven = np.where(tones[:, :own] == 0.0, 0.0, tones[:, :own] - amplitudes)
    return np.concatenate([driven, tones[:, own:]], axis=1)


@dataclass(frozen=True)
class Slopes:
    """Derivatives of a prediction, arrays of n events; zeros where they cannot be used.

    Parameters
    ----------
    landing, landing_before, kick
        Of opening, landing and impact speed by the landing before and the one before that, (n, 3) each, and by
        displacement and velocity of a plate mode where the chain of flights began, (n, 3, 2).
    tones
        By the real and imaginary part of each tone of the event's step, (n, 3, k, 2).
    parameters
        By each parameter asked for, (n, 3, c).
    info
        What the second order is about, (n, `model.integrator.slopes.INFO`).
    """

    landing: Array
    landing_before: Array
    kick: Array
    tones: Array
    parameters: Array
    info: Array


def slopes_of(
    measured: Measured,
    plate: PlateSteps,
    rows: Array,
    detection: Detection,
    found: Predicted,
    places: Sequence[int] = (),
    changes: Sequence[float] = (),
) -> Slopes:
    """Derivatives of a prediction without another flight: of all it depends on.

    Parameters
    ----------
    measured, plate, rows, detection
        Those of the prediction.
    found
        The prediction, see `one_ahead`.
    places, changes
        Parameters to which derivatives are wanted, as places in a row, (c,), and a small change of each: hooks have
        differences, in that direction.
    """
    rows = _for_kernel(rows.reshape(-1, rows.shape[-1]))
    problem, tones = _Problem(measured, plate, rows, detection, (0.0, 0.0)), plate.acceleration_mps2
    if np.any(rows[:, _columns("plate_mode")] > 0.0):
        tones = _driven(plate, found.mode_amplitudes)
    columns = Columns(
        _for_kernel(np.asarray(places, dtype=np.int64)), _for_kernel(np.asarray(changes, dtype=np.float64))
    )
    if found.table is None:
        raise ValueError("the prediction was not made by one_ahead; wanted one with the kernel's table")
    out, info = problem.slopes(tones, measured.wanted, columns, found.table)
    out[info[:, 0] == 0.0] = 0.0
    k, first = tones.shape[1], slopes.TONES
    return Slopes(
        out[..., slopes.LANDING],
        out[..., slopes.LANDING_BEFORE],
        out[..., slopes.KICK : slopes.KICK_RATE + 1],
        out[..., first : first + 2 * k].reshape(len(out), 3, k, 2),
        out[..., first + 2 * k :],
        info,
    )


def _carried(omega_radps: Array, tones: NDArray[np.complex128], row: Array) -> NDArray[np.complex128]:
    """Part of measured tones (k,) that a ball resting on the plate mode all the time adds to them."""
    row = _for_kernel(row)
    om, ze, _ = plate_mode(row)
    _, re, im = loaded(0.0, Plate(_tones(omega_radps, tones), Mode(0.0, 0.0, om, ze)), row).tones.T
    factor = np.divide(re + 1j * im, tones, out=np.ones_like(tones), where=tones != 0.0)
    return np.asarray(tones * (1.0 - 1.0 / factor))


@dataclass(frozen=True)
class Orbit:
    """Flights one after another, shape (n,) each: SI units, velocities relative to the plate."""

    takeoff_s: Array
    launch_mps: Array
    landing_s: Array
    impact_mps: Array
    after_rest: NDArray[np.bool_]
    hidden: NDArray[np.int64]


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

    Raises
    ------
    ValueError
        For unknown effects or parameters, or values out of bounds.
    """
    rows = row(effects, g_mps2)
    out = np.empty((flights, 6))
    tones = _tones(plate.omega_radps, plate.acceleration)
    acting = _active(rows, "force"), _active(rows, "dry_friction")
    law = Law(_for_kernel(rows), 0.0, *acting, np.empty((0, 6)), np.empty((0, 12)))
    out = out[: predict.simulate(float(start[0]), float(start[1]), period_s, tones, law, unseen_s, out)]
    return Orbit(out[:, 0], out[:, 1], out[:, 2], out[:, 3], out[:, 4] == 0.0, out[:, 5].astype(np.int64))
