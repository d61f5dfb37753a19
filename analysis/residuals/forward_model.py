"""What a set of effects says of the evidence: residuals one event ahead, and their uncertainty.

The rule kept here: every residual is judged by the uncertainty of what was measured, carried through the prediction
(edges of this and the earlier flights, the plate's tones), never by the scatter of residuals.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.residuals.modulation import AmplitudeModulation
from analysis.residuals.observations import Observations
from analysis.residuals.plate_mode import INEXACT, Ringing
from analysis.residuals.plate_observables import expected, power_uncertainty
from model.effects.base import COMPILED_HOOKS
from model.effects.registry import effect, offsets, registry, row
from model.integrator.one_step import Detection, Predicted, one_ahead

Array = NDArray[np.float64]
ParameterId = tuple[str, str]
Values = Mapping[ParameterId, float]

DRIFT = "@drift"  # suffix of a parameter's trend: its change over the whole run
FARTHEST_PERIODS = 0.5  # a residual beyond says no more than one at this distance: another event was met
EDGE_STEP_S = 2e-6
KICK = 0.25  # of what gravity adds to a speed in a period: half a usual impact


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of opening and landing residuals at one point; arrays (n,), tones (n, q).

    ``*_sigma_s`` is that of the edges, carried through; ``*_by_tone`` the change for one sigma of each quadrature of
    each plate tone of the event's step, and of how a plate mode rang when the step began.
    """

    opening_sigma_s: Array
    landing_sigma_s: Array
    opening_by_tone: Array
    landing_by_tone: Array

    @property
    def landing_total_s(self) -> Array:
        """With the plate's share, (n,)."""
        return np.asarray(np.sqrt(self.landing_sigma_s**2 + np.sum(self.landing_by_tone**2, axis=1)))

    @property
    def opening_total_s(self) -> Array:
        """With the plate's share, (n,)."""
        return np.asarray(np.sqrt(self.opening_sigma_s**2 + np.sum(self.opening_by_tone**2, axis=1)))


@dataclass(frozen=True)
class Residuals:
    """Measured minus predicted, in seconds, (n,), NaN where there is no prediction; and of the plate data, (r,)."""

    opening_s: Array
    landing_s: Array
    plate: Array
    predicted: Predicted


class ForwardModel:
    """The evidence with everything that turns parameter values into residuals.

    Parameters
    ----------
    evidence
        What was measured.
    base
        Declared effects, by effect and parameter: the model before anything is added.
    """

    def __init__(self, evidence: Observations, base: Mapping[str, Mapping[str, float]]) -> None:
        self.evidence, self.declared = evidence, base
        self.base = {(e, q): v for e, table in base.items() for q, v in table.items()}
        self.gravity = evidence.setup.g_mps2.value
        self.ringing = None if evidence.swells is None else Ringing.of(evidence.swells, evidence.steps.plate)
        at_work = (evidence.plate, evidence.steps.plate, self.gravity)
        self.loading = None if self.ringing is None else self.ringing.loading(*at_work)
        self._nothing = row({}, self.gravity)
        self.opens = evidence.judged & ~evidence.measured.at_once  # a take-off that was seen, after a rest
        self._cache: dict[tuple[object, ...], Predicted] = {}
        self._run_part_events = evidence.steps.run_part[evidence.measured.step]

    def start(self, values: Values) -> dict[ParameterId, float]:
        """All non-absent parameters: the base, overridden by ``values``."""
        return {**self.base, **values}

    def rows(self, values: Values) -> Array:
        """Parameters of each event, (P + 1,) or with drifting parameters (n, P + 1)."""
        point = self.start(values)
        out = self._nothing.copy()
        for (name, key), value in point.items():
            if not key.endswith(DRIFT):
                out[offsets()[name, key]] = value
        drifting = [(k, v) for k, v in point.items() if k[1].endswith(DRIFT) and v != 0.0]
        if not drifting:
            return out
        out = np.repeat(out[None, :], len(self.evidence), axis=0)
        for (name, key), value in drifting:
            parameter = effect(name).effect.parameter(key.removesuffix(DRIFT))
            column = offsets()[name, parameter.name]
            trend = out[:, column] + value * self._run_part_events
            out[:, column] = np.clip(trend, parameter.low, parameter.high)
        return out

    def by_step(self, values: Values) -> dict[str, dict[str, Array]]:
        """Parameters in each step, by effect and parameter, for the plate data."""
        point = self.start(values)
        m = len(self.evidence.steps)
        out: dict[str, dict[str, Array]] = {}
        for name in {k[0] for k in point}:
            table = {q.name: np.full(m, q.absent) for q in effect(name).effect.parameters}
            for (n, key), value in point.items():
                if n == name and not key.endswith(DRIFT):
                    table[key] = np.full(m, value)
            for (n, key), value in point.items():
                if n == name and key.endswith(DRIFT):
                    table[key.removesuffix(DRIFT)] = (
                        table[key.removesuffix(DRIFT)] + value * self.evidence.steps.run_part
                    )
            out[name] = table
        return out

    def per_step(self, values: Values, hook: str, nothing: float) -> Array:
        """Product (around 1) or sum (around 0) of a plain hook over the effects, (m,)."""
        total = np.full(len(self.evidence.steps), nothing)
        point = self.start(values)
        names = [r for r in registry() if hook in r.hooks and any(k[0] == r.effect.name for k in point)]
        if names:
            tables = self.by_step({k: v for k, v in point.items() if k[0] in {r.effect.name for r in names}})
            for entry in names:
                table = tables[entry.effect.name]
                one = np.array(
                    [entry.hooks[hook](dict(zip(table, row, strict=True))) for row in zip(*table.values(), strict=True)]
                )
                total = total * one if nothing == 1.0 else total + one
        return total

    def predict(
        self,
        values: Values,
        *,
        landing_shift_s: Array | None = None,
        tones: NDArray[np.complex128] | None = None,
        rows: Array | None = None,
        kick: tuple[float, float] = (0.0, 0.0),
    ) -> Predicted:
        """One event ahead at ``values``; times are those that the instrument would show."""
        ev = self.evidence
        step = ev.measured.step
        shift = self.per_step(values, "contact_delay_s", 0.0)[step]
        reading = self.per_step(values, "accelerometer_factor", 1.0)
        loaded = self.per_step(values, "flight_gain", 0.0)
        gap = self.per_step(values, "gap_m", 0.0)[step]
        z = ev.steps.plate.acceleration_mps2 if tones is None else tones
        if np.any(loaded) and self.loading is not None:  # a flight starts from, and ends at, the plate in contact
            z = z - loaded[:, None] * self.loading.tones_mps2
        plate = replace(ev.steps.plate, acceleration_mps2=z / reading[:, None])
        if (swell := self._swell(values)) is not None:
            plate = swell[0].modulated(plate, *swell[1:])
        moved = ev.measured.landing_s - shift
        if landing_shift_s is not None:
            moved = moved + landing_shift_s
        measured = replace(ev.measured, opening_s=ev.measured.opening_s - shift, landing_s=moved)
        p = one_ahead(
            measured,
            plate,
            self.rows(values) if rows is None else rows,
            Detection(gap, ev.unseen_s, closure_s=ev.closure_s, weak_mps=ev.weak_mps),
            kick=kick,
            probe=self.ringing,
        )
        return replace(p, takeoff_s=p.takeoff_s + shift, landing_s=p.landing_s + shift, opening_s=p.opening_s + shift)

    def _swell(self, values: Values) -> tuple[AmplitudeModulation, Array, float] | None:
        """A swell of the plate's amplitude: what steps and windows say of it, its depth in each step, its frequency."""
        if self.evidence.swells is None:
            return None
        for name, table in self.by_step(values).items():
            hook = effect(name).hooks.get("modulation")
            if hook is None:
                continue
            swell = [hook(dict(zip(table, row, strict=True))) for row in zip(*table.values(), strict=True)]
            depth, omega = np.array(swell).T
            if np.any(depth):
                return self.evidence.swells, depth, float(omega[0]) / (2.0 * np.pi)
        return None

    def _kicks(self, values: Values) -> tuple[tuple[float, float], ...]:
        """One sigma of how a plate mode rang when a step began, beyond what the flights before say: half an impact."""
        point = self.start(values)
        ratio = point.get(("table_resonance", "mass_ratio"), 0.0)
        if ratio == 0.0:
            return ()
        speed = KICK * ratio * self.gravity * float(np.median(self.evidence.steps.plate.period_s))
        hz = point.get(("table_resonance", "frequency_hz"), effect("table_resonance").effect.absent["frequency_hz"])
        return (speed / (2.0 * np.pi * hz), 0.0), (0.0, speed)

    def residuals(self, values: Values, rows: Array | None = None) -> Residuals:
        """Measured minus predicted at ``values``."""
        ev = self.evidence
        if rows is None:
            flying = tuple(sorted(i for i in self.start(values).items() if i[0][0] not in plate_effects()))
            found = self._cache.get(flying)
            if found is None:
                if len(self._cache) > 64:
                    self._cache.clear()
                found = self._cache[flying] = self.predict(values)
            p = found
        else:
            p = self.predict(values, rows=rows)
        opening = np.where(self.opens, ev.measured.opening_s - p.opening_s, np.nan)
        landing = np.where(ev.judged, ev.measured.landing_s - p.landing_s, np.nan)
        said, vague = expected(ev.plate, self.by_step(values)), np.zeros(len(ev.plate))
        if self.ringing is not None:
            rung, vague = self.ringing.added(ev.plate, ev.steps.plate, p)
            said = said + rung
        if self.loading is not None:
            said = said + self.loading.added(self.per_step(values, "flight_gain", 0.0)[ev.plate.step])
        if (swell := self._swell(values)) is not None:
            swelling, leaking = swell[0].expected(ev.plate, ev.steps.plate, *swell[1:])
            said, vague = said + swelling, np.hypot(vague, leaking)
        vague = np.hypot(vague, power_uncertainty(ev.plate, said))
        plate = ev.plate.sigma / np.hypot(ev.plate.sigma, vague) * (ev.plate.value - said)
        return Residuals(opening, landing, plate, p)

    def uncertainty(self, values: Values) -> Uncertainty:
        """Uncertainty of the residuals at ``values``, by finite differences of the prediction itself."""
        ev = self.evidence
        n = len(ev)
        base = self.predict(values)
        open_var, land_var = ev.opening_sigma_s**2, ev.landing_sigma_s**2 + _finite(base.ambiguity_s) ** 2
        index = np.arange(n)
        for colour in range(3):
            chosen = index % 3 == colour
            moved = self.predict(values, landing_shift_s=np.where(chosen, EDGE_STEP_S, 0.0))
            for back in (1, 2):
                rows = (index - back >= 0) & chosen[np.maximum(index - back, 0)]
                sigma = ev.landing_sigma_s[np.maximum(index - back, 0)]
                open_var = open_var + np.where(rows, _slope(moved.opening_s - base.opening_s) * sigma, 0.0) ** 2
                land_var = land_var + np.where(rows, _slope(moved.landing_s - base.landing_s) * sigma, 0.0) ** 2
        columns_open, columns_land = [], []
        steps = ev.steps
        sigma = steps.sigma_mps2
        told = INEXACT * np.abs(base.mode_amplitudes[:, : sigma.shape[1]])
        if (swell := self._swell(values)) is not None:
            told = np.hypot(told, swell[0].leaking(steps.plate, *swell[1:]))
        wider = np.hypot(sigma, told) / np.where(sigma > 0.0, sigma, 1.0)
        moves: list[tuple[dict[str, Any], dict[str, Any]]] = []
        for j in np.flatnonzero(np.any(steps.spread_mps2, axis=(0, 2))):
            by = wider[:, j // 2, None] * steps.spread_mps2[:, j]
            moves.append(({"tones": steps.plate.acceleration_mps2 + by}, {"tones": steps.plate.acceleration_mps2 - by}))
        moves += [({"kick": kick}, {"kick": (-kick[0], -kick[1])}) for kick in self._kicks(values)]
        for there, back_again in moves:  # large enough that what is not linear in it counts as noise of its own
            ahead, behind = self.predict(values, **there), self.predict(values, **back_again)
            columns_open.append(_finite(0.5 * (ahead.opening_s - behind.opening_s)))
            columns_land.append(_finite(0.5 * (ahead.landing_s - behind.landing_s)))
            open_var = open_var + _finite(0.5 * (ahead.opening_s + behind.opening_s) - base.opening_s) ** 2
            land_var = land_var + _finite(0.5 * (ahead.landing_s + behind.landing_s) - base.landing_s) ** 2
        shape = (0, n)
        return Uncertainty(
            np.sqrt(open_var),
            np.sqrt(land_var),
            np.array(columns_open).reshape(-1, *shape[1:]).T,
            np.array(columns_land).reshape(-1, *shape[1:]).T,
        )


def _finite(x: Array) -> Array:
    return np.where(np.abs(x) < 5e-3, np.nan_to_num(x), 0.0)


def _slope(difference: Array) -> Array:
    return np.clip(np.nan_to_num(difference) / EDGE_STEP_S, -30.0, 30.0)


@functools.cache
def plate_effects() -> frozenset[str]:
    """Names of the effects that touch plate data only, never a flight."""
    of_plate_and_sensors = {"contact_delay_s", "accelerometer_factor", "gap_m", "modulation", "flight_gain"}
    flying = of_plate_and_sensors | set(COMPILED_HOOKS)
    return frozenset(r.effect.name for r in registry() if r.hooks and not flying & r.hooks.keys())
