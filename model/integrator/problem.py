"""What one-event predictions are made from: plate, flights, errors; the records that kernels take; the effects' hooks.

Records are named tuples, which numba passes as it passes their fields. Reading an array out of a record counts a
reference: what runs at every step takes the arrays themselves.

The hooks of all effects, each kind summed, are written as one source from the effects found in `model.effects`, and
compiled at their first call: an effect costs a file and no edit here, and one whose parameters are absent costs next to
nothing. Decision 2.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from kernels import njit
from kernels.arrays import Bools, Complexes, Floats, Integers
from kernels.errors import InputError
from model.effects.base import SIGNATURES
from model.effects.registry import null_row, registry

_F = TypeVar("_F", bound=Callable[..., object])


def compiled(function: _F) -> _F:
    """Compile ``function`` at its first call, without fused operations; threads may run it at once."""
    return cast(_F, njit(error_model="numpy", nogil=True)(function))


def inlined(function: _F) -> _F:
    """Compile ``function`` into every kernel that calls it."""
    return cast(_F, njit(error_model="numpy", forceinline=True)(function))


class SecondMode(NamedTuple):
    """A second plate mode, which rings freely: displacement, velocity, angular frequency, damping ratio, at time t."""

    t: float
    q: float
    qd: float
    omega: float
    damping: float


class Mode(NamedTuple):
    """A free damped oscillator: displacement, velocity, angular frequency, damping ratio; and the second mode."""

    q: float
    qd: float
    omega: float
    damping: float
    second: SecondMode = SecondMode(0.0, 0.0, 0.0, 1.0, 0.0)


class Plate(NamedTuple):
    """The plate as it moves under a flight: its tones, and a mode that rings from a given moment on.

    ``tones`` (k, 3) holds their angular frequencies and the real and imaginary parts of their accelerations in m/s^2.
    """

    tones: Floats
    mode: Mode


class Law(NamedTuple):
    """What acts on the ball: all parameters, the step of the integration, and whether there are forces and friction.

    ``turning`` is room for the plate's phasors, see `model.integrator.plate.start_turning`, ``under`` for its tones
    (k, 3) under a ball at rest.
    """

    p: Floats
    step_s: float
    forced: bool
    rubbed: bool
    turning: Floats
    under: Floats


class Acting(NamedTuple):
    """All parameters, one row or one an event (n or 1, P + 1), and whether there are forces, and dry friction."""

    rows: Floats
    forced: bool
    rubbed: bool


class Visibility(NamedTuple):
    """What the contact circuit shows of a flight.

    The height at which it opens; flights no instrument has seen; how long an impact keeps it closed.
    """

    gap_m: float
    unseen_s: float
    closure_s: float


class StepEnds(NamedTuple):
    """Length of a step of the integration, and height, velocity and acceleration at both its ends."""

    d: float
    h0: float
    v0: float
    a0: float
    h1: float
    v1: float
    a1: float


class Start(NamedTuple):
    """The start of a segment: height and velocity, and displacement and velocity of the plate, its mode included."""

    h: float
    v: float
    x: float
    xd: float


class Flight(NamedTuple):
    """One flight that the instrument sees; ``kind`` 1 thrown or bounced at once, 0 after rest, -1 none.

    ``hidden`` counts the flights passed over before it; ``(q, qd)`` is the mode's state at take-off; ``reach`` is by
    how much higher it would end with each m/s more at the start, see `model.integrator.flight.flight`.
    """

    takeoff: float
    launch: float
    landing: float
    impact: float
    opening: float
    hidden: int
    kind: int
    q: float
    qd: float
    reach: float


EVENT_DTYPE = np.dtype([
    ("opening", "f8"), ("landing", "f8"), ("step", "i8"), ("relaunched", "?"), ("linked", "?"), ("wanted", "?"),
    ("bounces", "?"),  # the ball may rebound from its impact
    ("gap_m", "f8"), ("weak_mps", "f8"),  # of `model.integrator.problem.Detection`
    ("other_step", "i8"), ("share", "f8"), ("part", "f8"), ("ahead_s", "f8"),
    ("gained_mps", "f8"), ("pressed_mps", "f8"), ("pressed_at", "f8"),
    ("q", "f8"), ("qd", "f8"), ("after_q", "f8"), ("after_qd", "f8"),  # the mode at the opening, and after the landing
    # a second one at the opening; 0 for none
    ("second_q", "f8"), ("second_qd", "f8"), ("second_radps", "f8"), ("second_damping", "f8"),
], align=True)  # fmt: skip
"""A measured flight; what else its fields hold stands at `model.integrator.problem.Measured`."""
Event = Any  # a row of that type, as kernels read it

PREDICTION_DTYPE = np.dtype([
    ("takeoff_s", "f8"), ("launch", "f8"), ("landing_s", "f8"), ("impact", "f8"), ("opening_s", "f8"), ("hidden", "f8"),
    ("kind", "f8"),  # -1 none; what is before it is predicted
    ("launch_mps", "f8"), ("impact_mps", "f8"),  # of the measured flight itself, m/s
    ("ambiguity_s", "f8"),  # by how much later the landing may be seen
])  # fmt: skip
Prediction = Any  # a row of that type


class Steps(NamedTuple):
    """The plate in each step: period of the forcing (m,), and its tones (m, k, 3) as in `Plate`."""

    period: Floats
    tones: Floats


class Probe(NamedTuple):
    """Intervals of time in which the mode's motion is projected on tones, and the projections so far.

    Where each step's intervals begin (m + 1,); the intervals (r, 2); angular frequencies (m, l); projections (r, l) and
    the time for which the mode was known (r,).
    """

    first: Integers
    span_s: Floats
    omega: Floats
    projection: Complexes
    observed_s: Floats


class Chain(NamedTuple):
    """The last landing in a chain of flights: time, impact speed, the mode's state just after it.

    ``known`` tells whether it belongs to the chain, ``chained`` how many impact speeds in a row were asked for: the
    first one's own prediction needs none.
    """

    t: float
    impact: float
    q: float
    qd: float
    known: bool
    chained: int


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
    # displacement and velocity of a plate mode at the opening, and just after the landing, (n, 4), as measured; with
    # those of a second one at the opening, its angular frequency and damping ratio, (n, 8).
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

    ``span_s`` (r, 2) are intervals of time, in order within a step, which begin at ``first`` (m + 1,), where the last
    ends, too; ``omega_radps`` (m, l) angular frequencies.
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


gravity: Callable[..., float]
"""Constant downward acceleration of the ball, m/s^2, of ``(p)``: the local g and what effects add to it."""
force: Callable[..., float]
"""Sum of the effects' accelerations, m/s^2, of ``(s, h, v, u, p)``."""
dry_friction: Callable[..., float]
"""Sum of dry frictions, m/s^2, of ``(h, speed, direction, p)``."""
takeoff_threshold: Callable[..., float]
"""Sum of take-off thresholds, m/s^2, of ``(dwell_s, p)``."""
rebound: Callable[..., float]
"""Coefficient of restitution, of ``(v, p)``."""
plate_mode: Callable[..., tuple[float, float, float]]
"""Plate mode struck by impacts: angular frequency, damping ratio, mass ratio, of ``(p)``."""

_NOTHING = {"gravity": "p[-1]", "plate_mode": "(1.0, 0.0, 0.0)"}  # else 0


def _source() -> str:
    """One function a hook, each the sum of the effects' own; that of gravity begins with the local g."""
    entries = registry()
    lines = ["from kernels import njit"]
    for e in entries:
        lines += [f"from {e.module} import {hook} as {hook}_{e.effect.name}" for hook in SIGNATURES if hook in e.hooks]
    for hook, signature in SIGNATURES.items():
        arguments, nothing = signature.removesuffix(", k"), _NOTHING.get(hook, "0.0")
        terms = [f"{hook}_{e.effect.name}({arguments}, {e.offset})" for e in entries if hook in e.hooks]
        if hook == "plate_mode" and len(terms) > 1:
            raise InputError("only one effect may bring a plate mode")
        total = " + ".join([nothing, *terms] if hook == "gravity" else terms) or nothing
        lines += ["", "@njit(error_model='numpy')", f"def {hook}({arguments}):", f"    return {total}"]
    return "\n".join(lines)


exec(compile(_source(), "<the hooks of all effects>", "exec"), globals())
