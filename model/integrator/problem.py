"""What one-event predictions are made from: plate, flights, what is missed of them; arrays as kernels take them."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from kernels.arrays import Bools, Complexes, Floats, Integers
from model.effects.registry import null_row, registry

_T = TypeVar("_T", bound=np.generic)


@dataclass(frozen=True)
class PlateSteps:
    """The plate's motion in each step: tones on one time axis."""

    omega_radps: Floats  # (m, k); any positive frequency in unused places
    # (m, k): the plate's is ``Re sum acceleration exp(i omega t)``; zeros in unused places
    acceleration_mps2: Complexes
    period_s: Floats  # period of the forcing, shape (m,)
    derived: int = 0  # how many of the last tones were not measured but follow from the others


@dataclass(frozen=True)
class Measured:
    """Measured flights in order, as the predictions need them; arrays of shape (n,)."""

    opening_s: Floats  # when the circuit opened
    landing_s: Floats  # when it closed
    relaunched: Bools  # the ball left at the landing before, not after a rest
    linked: Bools  # the flight before in the table is the flight before in reality
    step: Integers  # row of `PlateSteps`
    wanted: Bools  # flights for which a prediction is wanted
    other_step: Integers | None = None  # in a fade: row of the other step (-1: the plate at rest); None without fades
    share: Floats | None = None  # and the share of its motion
    # integral of the plate's acceleration plus gravity over a flight in a fade, as the accelerometer shows it; NaN
    # where the plate's tones tell it, None where they always do
    gained_mps: Floats | None = None
    pressed_mps: Floats | None = None  # the same over the contact before it
    pressed_at: Floats | None = None  # part of the contact at which the centre of ``pressed_mps`` is
    part: Floats | None = None  # part by which the plate moved more in the flight than in its step; None for all alike
    ahead_s: Floats | None = None  # by how much earlier
    # displacement and velocity of a plate mode at the opening, and just after the landing, (n, 4), as measured.
    # NaN or None where it is followed from flight to flight.
    mode: Floats | None = None


@dataclass(frozen=True)
class Detection:
    """What the contact circuit misses."""

    gap_m: Floats | float = 0.0  # height at which the circuit opens, one number or (n,)
    unseen_s: float = 1e-4  # flights shorter than this are passed over: no instrument has seen them
    # how long an impact keeps the circuit closed, the ball gone or not: one passed over delays the opening
    closure_s: float = 0.0
    # an impact slower than this, from which the ball leaves at once, may have left no mark: the measured flight
    # went on through it. Infinite where nothing but the contact circuit watches; one number or (n,).
    weak_mps: Floats | float = 0.0


class Projected(Protocol):
    """What a plate mode adds to the measured tones: see `model.integrator.one_step.Predicted`."""

    @property
    def mode_amplitudes(self) -> Complexes: ...
    @property
    def projection(self) -> Complexes: ...
    @property
    def observed_s(self) -> Floats: ...


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
    def first(self) -> Integers: ...
    @property
    def span_s(self) -> Floats: ...
    @property
    def omega_radps(self) -> Floats: ...

    def of_tones(self, projection: Complexes, observed_s: Floats) -> Complexes:
        """Contribution to the plate's tones (m, k), m/s^2, of integrals (r, l) of ``acceleration exp(-i w t)``."""
        ...


@dataclass(frozen=True)
class ContinuousProbe:
    """Tones measured all the time, far from one another."""

    omega_radps: Floats

    @property
    def first(self) -> Integers:
        return np.arange(len(self.omega_radps) + 1)

    @property
    def span_s(self) -> Floats:
        return np.tile([-np.inf, np.inf], (len(self.omega_radps), 1))

    def of_tones(self, projection: Complexes, observed_s: Floats) -> Complexes:
        return np.asarray(2.0 * projection / np.where(observed_s > 0.0, observed_s, 1.0)[:, None])


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
