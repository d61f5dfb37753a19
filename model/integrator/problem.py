"""Measured flights, plate and parameters as the compiled kernels take them."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from kernels.arrays import Bools, Complexes, Floats
from model.effects.registry import null_row, registry
from model.integrator import predict, slopes, takeoff_slopes
from model.integrator.records import Events, Probe, Steps, Visibility
from model.integrator.variation import TONES

if TYPE_CHECKING:
    from model.integrator.one_step import Detection, Measured, PlateSteps


_T = TypeVar("_T", bound=np.generic)


@functools.cache
def columns_of(hook: str) -> NDArray[np.intp]:
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
def _nothing(hook: str) -> Floats:
    """The null values of `columns_of`."""
    return null_row(0.0)[columns_of(hook)]


def active(rows: Floats, hook: str) -> bool:
    """Whether any effect with ``hook`` acts in ``rows`` (..., P + 1)."""
    return bool((rows[..., columns_of(hook)] != _nothing(hook)).any())


def for_kernel(values: NDArray[_T]) -> NDArray[_T]:
    """An array as the kernels take it, contiguous and writable: numba compiles each layout, and each right, anew."""
    if values.flags.c_contiguous and values.flags.writeable:
        return values
    return np.require(values, requirements=["C", "W"])


def tones_for_kernel(omega_radps: Floats, acceleration_mps2: Complexes) -> Floats:
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
class Problem:
    """Measured flights, plate and parameters as the kernel takes them."""

    measured: Measured
    plate: PlateSteps
    rows: Floats
    detection: Detection
    kick: tuple[float, float]

    def predicted(self, tones: Complexes, wanted: Bools, probe: Probe) -> Floats:
        """The kernel's table (n, `predict.OUT_COLUMNS`); the mode's projections are added to those of ``probe``."""
        out = np.full((len(self.measured.landing_s), predict.OUT_COLUMNS), np.nan)
        seen = Visibility(0.0, self.detection.unseen_s, self.detection.passable_s, self.detection.closure_s)
        predict.one_ahead(self.events(wanted), self.steps(tones), self.rows, *self.acting, seen, self.kick, probe, out)
        return out

    def slopes(self, tones: Complexes, wanted: Bools, table: Floats) -> tuple[Floats, Floats]:
        """Derivatives (n, 3, d) of openings, landings and impact speeds in ``table``, and `takeoff_slopes.INFO`."""
        n, d = len(table), TONES + 2 * tones.shape[1]
        out, info = np.zeros((n, 3, d)), np.zeros((n, takeoff_slopes.INFO))
        slopes.slopes_ahead(self.events(wanted), self.steps(tones), self.rows, self.acting, table, out, info)
        return out, info

    @property
    def acting(self) -> tuple[bool, bool]:
        """Whether there are forces, and dry friction."""
        return active(self.rows, "force"), active(self.rows, "dry_friction")

    def steps(self, tones: Complexes) -> Steps:
        return Steps(for_kernel(self.plate.period_s), tones_for_kernel(self.plate.omega_radps, tones))

    def events(self, wanted: Bools) -> Events:
        m, n = self.measured, len(self.measured.landing_s)
        return Events(
            for_kernel(m.opening_s),
            for_kernel(m.landing_s),
            for_kernel(m.relaunched),
            for_kernel(m.linked),
            for_kernel(wanted),
            for_kernel(m.step),
            _of_each(np.any(self.rows[:, columns_of("rebound")] > 0.0, axis=1), n),
            _of_each(self.detection.gap_m, n),
            _of_each(self.detection.weak_mps, n),
            for_kernel(np.full(n, -1, dtype=np.int64) if m.beside is None else m.beside),
            for_kernel(np.zeros(n) if m.share is None else m.share),
            for_kernel(np.full(n, np.nan) if m.gained_mps is None else m.gained_mps),
            for_kernel(np.full(n, np.nan) if m.pressed_mps is None else m.pressed_mps),
            for_kernel(np.full(n, np.nan) if m.pressed_at is None else m.pressed_at),
        )


def driven(plate: PlateSteps, amplitudes: Complexes) -> Complexes:
    """Tones (m, k) less what a plate mode adds to them: the measured ones contain it, only the rest is driven."""
    tones, own = plate.acceleration_mps2, amplitudes.shape[1]
    driven = np.where(tones[:, :own] == 0.0, 0.0, tones[:, :own] - amplitudes)
    return np.concatenate([driven, tones[:, own:]], axis=1)
