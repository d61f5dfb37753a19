"""Flights with any set of effects, in SI units: one event ahead of a measurement, or marching on from a start.

The rule kept here: all effects are compiled into one kernel, composed from the files in `model.effects`; an effect
whose parameters are absent costs next to nothing.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from model.effects.base import COMPILED_HOOKS
from model.effects.registry import null_row, registry, row

Array = NDArray[np.float64]
_T = TypeVar("_T", bound=np.generic)

_SIGNATURES = {
    "force": ("s, h, v, u, p", "0.0"),
    "dry": ("h, speed, direction, p", "0.0"),
    "hold": ("dwell_s, p", "0.0"),
    "rebound": ("v, p", "0.0"),
}


def _composed_source() -> str:
    """Header that sums the hooks of all effects, then the kernel's own text."""
    template = Path(__file__).with_name("kernel.py").read_text(encoding="utf-8")
    lines = ["import math", "import numpy as np", "from kernels import njit"]
    entries = registry()
    for entry in entries:
        for hook in entry.hooks.keys() & set(COMPILED_HOOKS):
            lines.append(f"from {entry.module} import {hook} as {hook}_{entry.effect.name}")
    for hook, (arguments, nothing) in _SIGNATURES.items():
        terms = [f"{hook}_{e.effect.name}({arguments}, {e.offset})" for e in entries if hook in e.hooks]
        lines += [
            "",
            "@njit(error_model='numpy')",
            f"def {hook}({arguments}):",
            f"    return {' + '.join(terms) or nothing}",
        ]
    modes = [f"mode_{e.effect.name}(p, {e.offset})" for e in entries if "mode" in e.hooks]
    if len(modes) > 1:
        raise ValueError("only one effect may bring a plate mode")
    lines += [
        "",
        "@njit(error_model='numpy')",
        "def mode(p):",
        f"    return {modes[0] if modes else '1.0, 0.0, 0.0'}",
        "",
    ]
    return "\n".join(lines) + template.split("# ---- kernel ----", 1)[1]


@functools.cache
def kernel() -> ModuleType:
    """The kernel of all effects, a module composed once a process; its machine code is kept as any kernel's is."""
    name = f"{__package__}.composed"
    module = ModuleType(name, "The kernel of all effects, composed by `model.integrator.one_step`.")
    sys.modules[name] = module  # numba looks a compiled function's module up by its name
    exec(compile(_composed_source(), f"<{name}>", "exec"), module.__dict__)
    return module


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


def _active(rows: Array, hook: str) -> bool:
    columns = _columns(hook)
    return bool(np.any(rows[..., columns] != null_row(0.0)[columns]))


def _for_kernel(values: NDArray[_T]) -> NDArray[_T]:
    """An array as the kernels take it, contiguous and writable: numba compiles each layout, and each right, anew."""
    return np.require(values, requirements=["C", "W"])


def _of_each(value: Array | float, n: int) -> Array:
    """One number, or one an event, as the kernel takes it: shape (n,), always read-only, so that it compiles once."""
    values = np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), n))
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
        Which flights a prediction is wanted for.
    """

    opening_s: Array
    landing_s: Array
    relaunched: NDArray[np.bool_]
    linked: NDArray[np.bool_]
    step: NDArray[np.int64]
    wanted: NDArray[np.bool_]


@dataclass(frozen=True)
class Predicted:
    """What one event ahead says of each measured flight; arrays of shape (n,), NaN where nothing can be said.

    ``kind`` is 1 when thrown or bounced at once, 0 after a rest, -1 when there is no prediction; ``launch_mps`` and
    ``impact_mps`` are those of the measured flight itself, ``predicted_*`` those of the predicted one. ``doubt_s`` is
    by how much later the landing may be seen, where bounces that no instrument resolves follow it. ``rung`` (m, k) is
    what a plate mode puts into each of the plate's tones, m/s^2; ``heard`` (r, l) and ``heard_s`` (r,) are what it does
    in the stretches of an `ToneProbe`, and for how much of their time that is known.
    """

    takeoff_s: Array
    predicted_launch_mps: Array
    landing_s: Array
    predicted_impact_mps: Array
    opening_s: Array
    hidden: Array
    kind: Array
    launch_mps: Array
    impact_mps: Array
    doubt_s: Array
    rung: NDArray[np.complex128]
    heard: NDArray[np.complex128]
    heard_s: Array


class ToneProbe(Protocol):
    """How the plate's tones were measured, and what that makes of the motion of a plate mode.

    Attributes
    ----------
    first
        Where each step's stretches begin in ``span_s``, and where the last ends, (m + 1,).
    span_s
        Stretches of time that were listened to, in order within a step, (r, 2).
    omega_radps
        Pitches that are listened to, (m, l).
    """

    @property
    def first(self) -> NDArray[np.int64]: ...
    @property
    def span_s(self) -> Array: ...
    @property
    def omega_radps(self) -> Array: ...

    def of_tones(self, heard: NDArray[np.complex128], heard_s: Array) -> NDArray[np.complex128]:
        """What the plate's tones (m, k) take ``heard`` (r, l) for, integrals of ``acceleration exp(-i w t)``, m/s^2."""
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

    def of_tones(self, heard: NDArray[np.complex128], heard_s: Array) -> NDArray[np.complex128]:
        return np.asarray(2.0 * heard / np.where(heard_s > 0.0, heard_s, 1.0)[:, None])


def one_ahead(
    measured: Measured,
    plate: PlateSteps,
    rows: Array,
    *,
    gap_m: Array | float = 0.0,
    unseen_s: float = 1e-4,
    passable_s: float = 2e-3,
    closure_s: float = 0.0,
    weak_mps: Array | float = 0.0,
    kick: tuple[float, float] = (0.0, 0.0),
    ear: ToneProbe | None = None,
) -> Predicted:
    """Predict each flight's take-off and landing from the measured landing before it.

    Parameters
    ----------
    measured, plate
        The events and the plate's motion.
    rows
        All parameters, shape (P + 1,) or one row an event (n, P + 1): see `model.effects.row`.
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
    kick
        Added to a plate mode's displacement (m) and velocity (m/s) wherever the chain of flights begins anew: how the
        mode rang before is known no better.
    ear
        How the plate's tones were measured; without one, all the time.
    """
    n = len(measured.landing_s)
    rows = _for_kernel(rows if len(rows) == n and rows.ndim == 2 else np.broadcast_to(rows, (n, rows.shape[-1])))
    ringing = bool(np.any(rows[:, _columns("mode")] > 0.0))
    elastic = np.any(rows[:, _columns("rebound")] > 0.0, axis=1)
    gap, weak = (_of_each(x, n) for x in (gap_m, weak_mps))

    ear = ContinuousProbe(plate.omega_radps[:, : plate.omega_radps.shape[1] - plate.derived]) if ear is None else ear
    span_s, heard, heard_s = ear.span_s, np.zeros((0, 0), dtype=np.complex128), np.zeros(len(ear.span_s))

    def told(tones: NDArray[np.complex128], wanted: NDArray[np.bool_], listen: Array) -> Array:
        """The kernel's table; what is listened to is added to what has been heard."""
        out = np.full((n, 10), np.nan)
        kernel().one_ahead(
            _for_kernel(measured.opening_s),
            _for_kernel(measured.landing_s),
            _for_kernel(measured.relaunched),
            _for_kernel(measured.linked),
            _for_kernel(wanted),
            _for_kernel(measured.step),
            _for_kernel(plate.period_s),
            _for_kernel(plate.omega_radps),
            _for_kernel(tones.real),
            _for_kernel(tones.imag),
            rows,
            _active(rows, "force"),
            _active(rows, "dry"),
            elastic,
            gap,
            unseen_s,
            passable_s,
            closure_s,
            weak,
            np.array(kick),
            _for_kernel(ear.first if listen.shape[1] else np.zeros(len(tones) + 1, dtype=np.int64)),
            _for_kernel(span_s),
            _for_kernel(listen),
            heard,
            heard_s,
            out,
        )
        return out

    tones, own = plate.acceleration_mps2, plate.acceleration_mps2.shape[1] - plate.derived
    rung = np.zeros((len(tones), own), dtype=np.complex128)
    if ringing:  # what the mode does to the plate is in the measured tones already: only the rest is driven
        heard = np.zeros((len(span_s), ear.omega_radps.shape[1]), dtype=np.complex128)
        told(tones, np.zeros(n, dtype=np.bool_), ear.omega_radps)
        rung = ear.of_tones(heard, heard_s)
        of_step = np.add.reduceat(np.append(heard_s, 0.0), ear.first[:-1]) * (np.diff(ear.first) > 0)
        for k in np.flatnonzero(of_step == 0.0):  # the ball never left: its mass moves with the plate
            rung[k] = _carried(plate.omega_radps[k, :own], tones[k, :own], rows[0])
        driven = np.where(tones[:, :own] == 0.0, 0.0, tones[:, :own] - rung)
        tones = np.concatenate([driven, tones[:, own:]], axis=1)
    out = told(tones, measured.wanted, np.zeros((len(tones), 0)))
    missing = out[:, 6] < 0
    out[missing, :6] = np.nan
    columns: tuple[Any, ...] = (*out.T, rung, heard, heard_s)
    return Predicted(*columns)


def _carried(omega_radps: Array, tones: NDArray[np.complex128], row: Array) -> NDArray[np.complex128]:
    """Part of measured tones (k,) that a ball resting on the plate mode all the time adds to them."""
    k = kernel()
    row = _for_kernel(row)
    om, ze, _ = k.mode(row)
    re, im = _for_kernel(tones.real), _for_kernel(tones.imag)
    *_, loaded_re, loaded_im = k.loaded(0.0, 0.0, 0.0, om, ze, _for_kernel(omega_radps), re, im, row)
    factor = np.divide(loaded_re + 1j * loaded_im, tones, out=np.ones_like(tones), where=tones != 0.0)
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


def march(
    effects: Mapping[str, Mapping[str, float]],
    *,
    g_mps2: float,
    period_s: float,
    omega_radps: Array,
    acceleration_mps2: NDArray[np.complex128],
    flights: int,
    start_s: float = 0.0,
    impact_mps: float = 0.0,
    unseen_s: float = 0.0,
) -> Orbit:
    """Fly ``flights`` flights from an impact at ``start_s``; fewer come back when the ball stays on the plate.

    Raises
    ------
    ValueError
        For unknown effects or parameters, or values out of bounds.
    """
    rows = row(effects, g_mps2)
    out = np.empty((flights, 6))
    n, *_ = kernel().march(
        start_s,
        impact_mps,
        0.0,
        0.0,
        period_s,
        _for_kernel(omega_radps),
        _for_kernel(acceleration_mps2.real),
        _for_kernel(acceleration_mps2.imag),
        _for_kernel(rows),
        _active(rows, "force"),
        _active(rows, "dry"),
        0.0,
        unseen_s,
        out,
    )
    out = out[:n]
    return Orbit(out[:, 0], out[:, 1], out[:, 2], out[:, 3], out[:, 4] == 0.0, out[:, 5].astype(np.int64))
