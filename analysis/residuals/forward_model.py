"""Forward model: parameter values to residuals one event ahead.

The uncertainty of a residual (`analysis.residuals.noise.uncertainty`) is that of the measured numbers (edges of this
and the earlier flights, the plate's tones), propagated through the prediction; it is never taken from the scatter of
residuals.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from analysis.computing import Memory
from analysis.flights.assemble import GLITCH_S
from analysis.residuals.covariates import covariates_of, followed_parameters
from analysis.residuals.observations import Observations
from analysis.residuals.plate_data.measured_mode import MeasuredMode, undriven_tones
from analysis.residuals.plate_data.modulation import AmplitudeModulation
from analysis.residuals.plate_data.plate_mode import INEXACT, INEXACT_AS_MEASURED, Ringing
from analysis.residuals.plate_data.plate_observables import GAIN, PLATE_HOOKS, expected, power_uncertainty, share
from analysis.residuals.values import (
    TREND,
    AllValues,
    Own,
    ParameterId,
    Values,
    calibrating_effects,
    driving_effects,
    ringing_effects,
)
from kernels.arrays import Bools, Complexes, Floats
from model.effects.registry import Registered, effect, offsets, registry, row
from model.integrator.one_step import Predicted, one_ahead
from model.integrator.problem import Detection, Measured, PlateSteps, active, columns_of, plate_mode

MOST_STORED = {"flights": 128, "plate": 512, "slopes": 512}  # stored results: of predictions, plate data and hooks
DELAYS = "contact_delay_s", "closing_delay_s", "impact_delay_s"


@dataclass(frozen=True)
class Inputs:
    """What a prediction is made from: parameters (P + 1,) or (n, P + 1), plate, the circuit's height (n,), and by how
    much later than they happened openings and landings were seen, (n,) each."""

    rows: Floats
    plate: PlateSteps
    gap_m: Floats
    opening_late_s: Floats
    landing_late_s: Floats


@dataclass(frozen=True)
class Residuals:
    """Measured minus predicted, in seconds, (n,), NaN where there is no prediction; and of the plate data, (r,)."""

    opening_s: Floats
    landing_s: Floats
    plate: Floats
    predicted: Predicted


class ForwardModel:
    """Observations with everything that turns parameter values into residuals.

    Parameters
    ----------
    observations
        The observations.
    base
        Declared effects, by effect and parameter: the model before anything is added.
    like
        A forward model of the same plate: what depends only on the plate is taken from it.

    Attributes
    ----------
    memory, slope_memory : Memory
        Of what depends on the flights, and of its derivatives: whoever computes it keeps it here.
    """

    def __init__(
        self, observations: Observations, base: Mapping[str, Mapping[str, float]], like: ForwardModel | None = None
    ) -> None:
        self.observations, self.declared = observations, base
        self.base = {(e, q): v for e, table in base.items() for q, v in table.items()}
        self.gravity = observations.setup.g_mps2.value
        if like is None:
            known = observations.modulation
            self.ringing = None if known is None else Ringing.of(known, observations.steps.plate)
            at_work = (observations.plate, observations.steps.plate, self.gravity)
            self.loading = None if self.ringing is None else self.ringing.loading(*at_work)
            self._plate_memory = Memory(MOST_STORED["plate"])
        else:
            self.ringing, self.loading, self._plate_memory = like.ringing, like.loading, like._plate_memory
        self.memory, self.slope_memory = Memory(MOST_STORED["flights"]), Memory(MOST_STORED["slopes"])
        self._nothing = row({}, self.gravity)
        # take-offs after a rest, as the circuit saw
        self.from_rest = observations.scored & ~observations.measured.relaunched
        self.declared_covariates: dict[str, Floats] = {}  # computed where an effect follows one
        of_steps = observations.steps.run_part[observations.measured.step]
        self._run_part_events = of_steps if observations.run_part is None else observations.run_part

    def start(self, values: Values) -> AllValues:
        """All parameters that are set: the base, overridden by ``values``."""
        return values if isinstance(values, AllValues) else AllValues({**self.base, **values})

    def rows(self, values: Values) -> Floats:
        """Parameters of each event, (P + 1,) or with drifting parameters (n, P + 1)."""
        point = self.start(values)
        out = self._nothing.copy()
        for (name, key), value in point.items():
            if not key.endswith(TREND):
                out[offsets()[name, key]] = value
        drifting = [(k, v) for k, v in point.items() if k[1].endswith(TREND) and v != 0.0]
        followed = [x for x in followed_parameters() if any(name == x[0] for name, _ in point)]
        if not drifting and not followed:
            return out
        out = np.repeat(out[None, :], len(self.observations), axis=0)
        if followed and not self.declared_covariates:  # as measured, by the declared calibrations
            self.declared_covariates.update(self.covariates({}))
        for _, column, covariate in followed:
            out[:, column] = self.declared_covariates[covariate]
        for (name, key), value in drifting:
            parameter = effect(name).effect.parameter(key.removesuffix(TREND))
            column = offsets()[name, parameter.name]
            trend = out[:, column] + value * self._run_part_events
            # at both ends of a run a drift may lead beyond what the parameter can be
            out[:, column] = np.clip(trend, parameter.low, parameter.high)
        return out

    def covariates(self, values: Values) -> dict[str, Floats]:
        """`covariates_of` the flights; of ``values`` only delays and the accelerometer's response matter."""
        return covariates_of(self.observations, self.late_s(values), self.reading(values))

    def by_step(self, values: Values) -> dict[str, dict[str, Floats]]:
        """Parameters in each step, by effect and parameter, for the plate data."""
        point = self.start(values)
        return {name: self._in_steps(name, own) for name, own in point.own.items()}

    def _in_steps(self, name: str, own: Own) -> dict[str, Floats]:
        """Parameters of one effect in each step."""
        m, run_part = len(self.observations.steps), self.observations.steps.run_part
        table = {q.name: np.full(m, q.null_value) for q in effect(name).effect.parameters}
        table |= {key: np.full(m, value) for (_, key), value in own if not key.endswith(TREND)}
        for (_, key), value in own:
            if key.endswith(TREND):
                table[key.removesuffix(TREND)] = table[key.removesuffix(TREND)] + value * run_part
        return table

    def _hook_in_steps(self, entry: Registered, hook: str, own: Own) -> Floats:
        """Values of a plain hook of one effect in each step, (m,) or (m, j)."""

        def made() -> Floats:
            table = self._in_steps(entry.effect.name, own)
            if any(key.endswith(TREND) for (_, key), _ in own):
                rows = zip(*table.values(), strict=True)
                return np.array([entry.hooks[hook](dict(zip(table, row, strict=True))) for row in rows])
            once = np.asarray(entry.hooks[hook]({q: float(x[0]) for q, x in table.items()}))
            return np.tile(once, (len(self.observations.steps), *([1] * once.ndim)))

        return self._plate_memory.recall((hook, entry.effect.name, own), made)

    def _with_hook(self, values: Values, hook: str) -> Iterator[tuple[Registered, Own]]:
        """Effects at work that have a hook, with their own parameters."""
        point = self.start(values)
        for entry in _having(hook):
            if own := point.own.get(entry.effect.name):
                yield entry, own

    def per_step(self, values: Values, hook: str) -> Floats:
        """Sum of a plain hook over the effects, (m,)."""
        total = np.zeros(len(self.observations.steps))
        for entry, own in self._with_hook(values, hook):
            total = total + self._hook_in_steps(entry, hook, own)
        return total

    def reading(self, values: Values, *, without: str = "") -> Complexes | Floats:
        """What the accelerometer shows of each tone of the plate, relative to it, ``without`` an effect, (m, k)."""
        total: Complexes | Floats = np.ones(self.observations.steps.plate.omega_radps.shape)
        for entry, own in self._with_hook(values, "accelerometer_response"):
            if entry.effect.name != without:
                key = ("reading", entry.effect.name, own)
                total = total * self._plate_memory.recall(key, functools.partial(self._reading_of, entry, own))
        return total

    def _reading_of(self, entry: Registered, own: Own) -> Complexes | Floats:
        """What one effect makes the accelerometer show of each tone, (m, k)."""
        omega, table = self.observations.steps.plate.omega_radps, self._in_steps(entry.effect.name, own)
        hook = entry.hooks["accelerometer_response"]
        points = [dict(zip(table, map(float, row), strict=True)) for row in zip(*table.values(), strict=True)]
        drifts = any(key.endswith(TREND) for (_, key), _ in own)
        each = zip(points, omega, strict=True)
        shown = np.array([hook(p, w) for p, w in each]) if drifts else np.asarray(hook(points[0], omega))
        if "pickup_mps2" not in entry.hooks:
            return shown
        # a driven tone on which the mains lie is the plate's but for them
        data, mains = self.observations.plate, np.zeros(omega.shape, dtype=np.complex128)
        rows = data.rows_of(GAIN)
        tone = np.abs(omega[data.step[rows]] - data.omega_radps[rows, None]).argmin(axis=1)
        mains[data.step[rows], tone] = data.mains[rows]
        picked_up = self._hook_in_steps(entry, "pickup_mps2", own)[:, None] * mains
        return np.where(self.observations.steps.forcing, 1.0 + picked_up, shown)

    def _expected(self, values: Values) -> Floats:
        """Expected value of each plate datum under the effects, (r,): the sum of what each adds."""
        total = np.zeros(len(self.observations.plate))
        for name, own in self.start(values).own.items():
            if PLATE_HOOKS & effect(name).hooks.keys():
                total = total + self._plate_memory.recall((name, own), functools.partial(self._expected_of, name, own))
        return total

    def _expected_of(self, name: str, own: Own) -> Floats:
        if any(key.endswith(TREND) for (_, key), _ in own):
            return expected(self.observations.plate, {name: self._in_steps(name, own)})
        return share(self.observations.plate, name, effect(name).effect.null_values | {q: v for (_, q), v in own})

    def inputs(self, values: Values, tones: Complexes | None = None, rows: Floats | None = None) -> Inputs:
        """What a prediction at ``values`` is made from, with other ``tones`` (m, k) or ``rows`` where given."""
        values = self.start(values)
        if tones is None:
            key = ("inputs", values.of(calibrating_effects()))
            calibrated = self._plate_memory.recall(key, lambda: self._calibrated(values, None))
        else:
            calibrated = self._calibrated(values, tones)
        return Inputs(self.rows(values) if rows is None else rows, *calibrated)

    def _calibrated(self, values: Values, tones: Complexes | None) -> tuple[PlateSteps, Floats, Floats, Floats]:
        """The plate as it moved, the contact circuit's height, and delays of openings and landings, (n,) each."""
        ev = self.observations
        loaded = self.per_step(values, "flight_gain")
        z = ev.steps.plate.acceleration_mps2 if tones is None else tones
        if np.any(loaded) and self.loading is not None:  # a flight starts from, and ends at, the plate in contact
            z = z - loaded[:, None] * self.loading.tones_mps2
        reading = self.reading(values)
        # where the plate stands still whatever is read (mains in the cable), a mode's part is not its motion either
        # of a reading a million times the plate's motion none is the plate's
        plate = replace(ev.steps.plate, acceleration_mps2=np.where(np.abs(reading) < 1e6, z / reading, 0.0))
        if (swings := self.modulation_at(values)) is not None:
            plate = swings[0].modulated(plate, *swings[1:])
        return plate, self.per_step(values, "gap_m")[ev.measured.step], *self.late_s(values)

    def late_s(self, values: Values) -> tuple[Floats, Floats]:
        """By how much later than they happened openings and landings were seen, (n,) each."""
        seen, heard = self.observations.measured, self.observations.circuit.heard
        edge, later, mark = (self.per_step(values, hook)[seen.step] for hook in DELAYS)
        # by how much later than it moves the accelerometer shows the plate at the first tone
        motion_s = -np.angle(self.reading(values)[:, 0]) / self.observations.steps.plate.omega_radps[:, 0]
        closing, mark = edge + later, mark + motion_s[seen.step]
        # a ball that leaves as it lands was seen when that landing was
        left = np.where(seen.relaunched, closing, edge)
        if heard is None:
            return left, closing
        left_heard = seen.relaunched & np.append(False, heard[:-1])
        return np.where(left_heard, mark, left), np.where(heard, mark, closing)

    def is_idle(self, key: ParameterId) -> bool:
        """Whether a parameter changes nothing that was observed."""
        heard, uneven = self.observations.circuit.heard, self.observations.circuit.uneven
        if key == ("contact_closure", "late_s"):  # where no opening tells the motion, a closing that is late is a lag
            return not uneven or int(self.from_rest.sum()) < 40
        return key == ("accelerometer_lag", "impact_s") and (heard is None or not heard.any())

    def predict(
        self,
        values: Values,
        *,
        landing_shift_s: Floats | None = None,
        tones: Complexes | None = None,
        rows: Floats | None = None,
        kick: tuple[float, float] = (0.0, 0.0),
        near: Predicted | None = None,
        wanted: Bools | None = None,
    ) -> Predicted:
        """One event ahead at ``values``; times as the instrument would show them.

        ``near`` is a prediction of almost the same: a plate mode keeps its share in the measured tones. Of all events
        that are compared only those ``wanted`` (n,) are predicted, where given.
        """
        x = self.inputs(values, tones, rows)
        measured, mode = self.measured_at(x, wanted), self.measured_mode(x.rows)
        if mode is not None:  # it is known everywhere, and so is a kick to it
            measured, kick = replace(measured, mode=mode.kicked(kick)), (0.0, 0.0)
            # it was seen as the accelerometer shows it, but for a high-pass, which was undone
            mode = mode.read(self.reading(values, without="accelerometer_high_pass"))
        if landing_shift_s is not None:
            measured = replace(measured, landing_s=measured.landing_s + landing_shift_s)
        p = one_ahead(measured, x.plate, x.rows, self.detection_at(x), kick=kick, probe=self.ringing, mode=mode or near)
        return replace(
            p,
            takeoff_s=p.takeoff_s + x.opening_late_s,
            landing_s=p.landing_s + x.landing_late_s,
            opening_s=p.opening_s + x.opening_late_s,
        )

    def measured_mode(self, rows: Floats) -> MeasuredMode | None:
        """How a plate mode of the parameters (..., P + 1) moved under what the ball did; None where not known."""
        seen, ringing, each = self.observations, self.ringing, rows.reshape(-1, rows.shape[-1])
        if ringing is None or not seen.ringing.pushed or not active(rows, "plate_mode"):
            return None
        if np.ptp(each[:, columns_of("plate_mode")], axis=0).any():  # it drifts itself, not only another parameter
            return None
        mode = plate_mode(each[0])
        undriven = self._plate_memory.recall("undriven", lambda: undriven_tones(seen, ringing))
        made = functools.partial(MeasuredMode.of, seen, ringing, mode, undriven)
        return self._plate_memory.recall(("measured mode", *mode), made)

    def measured_at(self, x: Inputs, wanted: Bools | None = None) -> Measured:
        """The flights as they were, less the instruments' delay."""
        seen = self.observations.measured
        of = seen.wanted if wanted is None else wanted & seen.wanted
        opening, landing = seen.opening_s - x.opening_late_s, seen.landing_s - x.landing_late_s
        return replace(seen, opening_s=opening, landing_s=landing, wanted=of)

    def detection_at(self, x: Inputs) -> Detection:
        ev = self.observations
        return Detection(x.gap_m, GLITCH_S, closure_s=ev.circuit.closure_s, weak_mps=ev.weak_mps)

    def predicted(self, values: Values, wanted: Bools | None = None) -> Predicted:
        """`predict` at ``values``, at least of ``wanted`` (n,) where given; stored: plate data need no new flight."""
        values = self.start(values)
        key = "predicted", values.flying
        if wanted is None or self.memory.holds(key):
            return self.memory.recall(key, lambda: self.predict(values))
        return self.memory.recall((*key, wanted.tobytes()), lambda: self.predict(values, wanted=wanted))

    def modulation_at(self, values: Values) -> tuple[AmplitudeModulation, Floats, float] | None:
        """Modulation of the plate's amplitude as measured, with its depth in each step and its frequency."""
        if self.observations.modulation is None:
            return None
        for entry, own in self._with_hook(values, "modulation"):
            depth, omega = self._hook_in_steps(entry, "modulation", own).T
            if np.any(depth):
                return self.observations.modulation, depth, float(omega[0]) / (2.0 * np.pi)
        return None

    def inexact(self, values: Values) -> float:
        """Relative uncertainty of what a plate mode adds to the tones."""
        return INEXACT if self.measured_mode(self.inputs(values).rows) is None else INEXACT_AS_MEASURED

    def moved_landings(
        self, values: Values, shift_s: Floats, wanted: Bools | None = None
    ) -> Iterator[tuple[Predicted, tuple[Bools, ...]]]:
        """Predictions with every third landing moved by ``shift_s`` (n,), so that each event depends on one of them.

        Yields
        ------
        Predicted
            With the landings of one colour moved.
        tuple of bool arrays, shape (n,)
            Events whose own landing, the one before, and the one two before has been moved.
        """
        index, near = np.arange(len(self.observations)), self.predicted(values)
        for colour in range(3):
            own = np.where(index % 3 == colour, shift_s, 0.0)
            moved = self.predict(values, landing_shift_s=own, near=near, wanted=wanted)
            yield moved, tuple((index >= back) & ((index - back) % 3 == colour) for back in range(3))

    def residuals(self, values: Values, rows: Floats | None = None, wanted: Bools | None = None) -> Residuals:
        """Measured minus predicted at ``values``; at least of the events ``wanted`` (n,), where given."""
        ev, values = self.observations, self.start(values)
        p = self.predicted(values, wanted) if rows is None else self.predict(values, rows=rows)
        opening = np.where(self.from_rest, ev.measured.opening_s - p.opening_s, np.nan)
        landing = np.where(ev.scored, ev.measured.landing_s - p.landing_s, np.nan)
        if (ringing := self.ringing) is not None and np.any(p.mode_amplitudes):
            known = self.measured_mode(self.inputs(values).rows) if rows is None else None
            if known is None:
                shown, of = replace(p, mode_amplitudes=p.mode_amplitudes * self.reading(values)), values.flying
            else:  # where it was seen without flights it is what the accelerometer shows, less a high-pass
                of = values.of(ringing_effects())
                passed = self.reading(AllValues({k: v for k, v in of if k[0] == "accelerometer_high_pass"}))
                shown = replace(p, mode_amplitudes=known.mode_amplitudes * passed)
            added = functools.partial(ringing.added, ev.plate, ev.steps.plate, shown, self.inexact(values))
            with np.errstate(over="ignore", invalid="ignore"):  # of a mode that diverges
                mode = self.memory.recall(("mode in plate data", of), added) if rows is None else added()
                plate = self._plate_residuals(values, *mode)
        else:
            key = ("plate residuals", values.of(driving_effects()))
            plate = self._plate_memory.recall(key, lambda: self._plate_residuals(values))
        return Residuals(opening, landing, plate, p)

    def _plate_residuals(self, values: Values, mode: Floats | float = 0.0, mode_sigma: Floats | float = 0.0) -> Floats:
        """Measured minus expected plate data at ``values``, (r,), scaled where what is expected is uncertain."""
        ev = self.observations
        predicted, inexact = self._expected(values) + mode, np.zeros(len(ev.plate)) + mode_sigma
        if self.loading is not None:
            predicted = predicted + self.loading.added(self.per_step(values, "flight_gain")[ev.plate.step])
        if (swings := self.modulation_at(values)) is not None:
            swings_data, leaking = swings[0].expected(ev.plate, ev.steps.plate, *swings[1:])
            predicted, inexact = predicted + swings_data, np.hypot(inexact, leaking)
        inexact = np.hypot(inexact, power_uncertainty(ev.plate, predicted))
        scale = ev.plate.sigma / np.hypot(ev.plate.sigma, inexact)
        return np.asarray(scale * (ev.plate.value - predicted))


@functools.cache
def _having(hook: str) -> tuple[Registered, ...]:
    """Effects that define a hook."""
    return tuple(r for r in registry() if hook in r.hooks)
