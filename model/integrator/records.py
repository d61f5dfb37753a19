"""Records that the integrator's kernels take; named tuples, which numba passes as it passes their fields.

Reading an array out of a record counts a reference: what runs at every step takes the arrays themselves.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np

from kernels import njit
from kernels.arrays import Complexes, Floats, Integers

_F = TypeVar("_F", bound=Callable[..., object])


def compiled(function: _F) -> _F:
    """Compile ``function`` at its first call, without fused operations; threads may run it at once."""
    return cast(_F, njit(error_model="numpy", nogil=True)(function))


def inlined(function: _F) -> _F:
    """Compile ``function`` into every kernel that calls it."""
    return cast(_F, njit(error_model="numpy", forceinline=True)(function))


class Mode(NamedTuple):
    """A free damped oscillator: displacement, velocity, angular frequency, damping ratio."""

    q: float
    qd: float
    omega: float
    damping: float


class Plate(NamedTuple):
    """The plate as it moves under a flight: its tones, and a mode that rings from a given moment on.

    ``tones`` (k, 3) holds their angular frequencies and the real and imaginary parts of their accelerations in m/s^2.
    """

    tones: Floats
    mode: Mode


class Law(NamedTuple):
    """What acts on the ball: all parameters, the step of the integration, and whether there are forces and friction.

    ``turning`` is room for the plate's phasors, see `model.integrator.plate.start_turning`.
    """

    p: Floats
    step_s: float
    forced: bool
    rubbed: bool
    turning: Floats


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
