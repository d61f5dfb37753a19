"""Bifurcation diagrams: the cycle at each of many gammas, on a grid or with more gammas where something happens.

A row says what its attractor is, not only where its points lie; flight times are those of one
cycle, so a diagram needs no transient thrown away and shows no point twice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kernels.arrays import Bools, Floats
from kernels.errors import InputError
from model.flight import windows
from model.flight.windows import check_gamma, lengthened
from model.orbits.attractor import AT_REST, MAX_FLIGHTS, Attractor, Ball, attractor, sweep
from model.orbits.cycles import FLIGHTS, PERIOD, RESETS
from model.orbits.exact_ball import FrictionBall, IdealBall
from model.tones import Forcing

KEEP = 64  # flight times stored of a row
KINDS = ("periodic", "chattering", "chaotic")  # the codes 0, 1, 2


@dataclass(frozen=True)
class Rows:
    """Attractors, one a row: arrays of equal length, ``tau`` (m, keep) filled with NaN beyond a cycle's flights.

    ``kind`` indexes `KINDS`; ``period`` is 0 when chaotic, ``flights`` 0 at rest.
    """

    gamma: Floats
    kind: NDArray[np.int8]
    period: NDArray[np.int32]
    flights: NDArray[np.int32]
    resets: NDArray[np.int32]
    locked: Bools
    tau: Floats

    def sorted(self) -> Rows:
        """In ascending gamma."""
        order = np.argsort(self.gamma, kind="stable")
        return Rows(*(getattr(self, name)[order] for name in FIELDS))


FIELDS = tuple(field.name for field in fields(Rows))


def joined(parts: list[Rows]) -> Rows:
    """One after another."""
    return Rows(*(np.concatenate([getattr(p, name) for p in parts]) for name in FIELDS))


def empty_rows(gammas: Floats, keep: int) -> Rows:
    """Rows to be filled."""
    m = len(gammas)
    period, flights, resets = np.zeros((3, m), dtype=np.int32)
    tau = np.full((m, keep), np.nan)
    return Rows(
        np.array(gammas, dtype=np.float64), np.zeros(m, dtype=np.int8), period, flights, resets, np.zeros(m, bool), tau
    )


def rows_of(gammas: Floats, found: Iterable[Attractor], keep: int) -> Rows:
    """Attractors as rows, one at a time."""
    rows = empty_rows(gammas, keep)
    for i, each in enumerate(found):
        put(rows, i, each)
    return rows


def diagram(ball: Ball, gammas: ArrayLike) -> Rows:
    """The attractor reached from rest at each gamma; raises `InputError` if a gamma is negative or not finite."""
    grid = np.ascontiguousarray(gammas, dtype=np.float64)
    if not np.all(np.isfinite(grid) & (grid >= 0.0)):
        raise InputError("every gamma must be finite and not negative")
    if isinstance(ball, IdealBall):
        laws = None
    elif isinstance(ball, FrictionBall):
        laws = np.tile(ball.law, (grid.size, 1))
    else:
        return rows_of(grid, (attractor(ball, gamma) for gamma in grid.tolist()), KEEP)
    return exact_rows(ball.forcing, grid, laws, lambda _: ball, KEEP)


def exact_rows(
    forcing: Forcing, gammas: Floats, laws: Floats | None, ball_at: Callable[[int], Ball], keep: int
) -> Rows:
    """Rows of exact balls, ``laws`` (m, 4): few one at a time, many in lanes; what those leave open as `attractor`."""
    lengthening = 1.0 if laws is None else lengthened(laws[:, 1], laws[:, 2])
    check_gamma(forcing, gammas, lengthening)
    # the kernels in lanes take half a minute to compile, once: few rows are flown one at a time
    if gammas.size < 1000:
        return rows_of(gammas, (attractor(ball_at(i), gamma) for i, gamma in enumerate(gammas.tolist())), keep)
    from model.surveys import cycle_batch  # many modules, only for many rows

    tones, turning, rows = forcing.tones, windows.turning_points(forcing), empty_rows(gammas, keep)
    each = np.zeros((gammas.size, 4)) if laws is None else np.ascontiguousarray(laws)
    outcome = np.empty((gammas.size, cycle_batch.OUTCOME_SIZE), dtype=np.int64)
    batch = cycle_batch.ideal_batch if laws is None else cycle_batch.friction_batch
    batch(cycle_batch.Points(tones, turning, gammas, each, True, outcome, rows.tau), MAX_FLIGHTS)
    rows.kind[:] = outcome[:, cycle_batch.CHATTERING] + 2 * outcome[:, cycle_batch.CHAOTIC]
    rows.period[:], rows.flights[:], rows.resets[:] = outcome[:, [PERIOD, FLIGHTS, RESETS]].T
    rows.locked[:] = outcome[:, cycle_batch.LOCKED]
    for row in np.flatnonzero(outcome[:, FLIGHTS] == cycle_batch.OPEN).tolist():
        put(rows, row, attractor(ball_at(row), float(gammas[row])))
    return rows


def put(rows: Rows, i: int, found: Attractor) -> None:
    """Write one attractor into row ``i``."""
    rows.kind[i], rows.locked[i] = KINDS.index(found.kind), found.locked
    rows.period[i], rows.flights[i], rows.resets[i] = found.period or 0, found.flights, found.resets
    n = min(found.tau.size, rows.tau.shape[1])
    rows.tau[i] = np.nan
    rows.tau[i, :n] = found.tau[:n]


def swept(ball: Ball, gammas: ArrayLike, *, keep: int = KEEP) -> Rows:
    """The attractors of a sweep through ``gammas`` in the order given, the state carried from each to the next."""
    grid = np.asarray(gammas, dtype=np.float64)
    return rows_of(grid, sweep(ball, grid.tolist(), AT_REST), keep)


def adaptive(rows_at: Callable[[Floats], Rows], low: float, high: float, steps: int, *, halvings: int = 12) -> Rows:
    """A diagram with more gammas where something happens.

    Every step of an even grid at whose ends the attractor differs (in kind, period, flights or resets) is halved, at
    most ``halvings`` times; chaos next to chaos is left as it is.

    ``rows_at`` maps gammas to their rows (`diagram` of a ball).
    """
    rows = rows_at(np.linspace(low, high, steps))
    for _ in range(halvings):
        flights, resets = rows.flights * (rows.kind == 0), rows.resets * (rows.kind < 2)
        marks = np.stack([rows.kind, rows.period, flights, resets], axis=1)
        change = np.flatnonzero(np.any(marks[1:] != marks[:-1], axis=1))
        # in chaotic ranges every halving finds new changes: the diagram grows to fifty times its grid at most
        if change.size == 0 or rows.gamma.size + change.size > 50 * steps:
            break
        rows = joined([rows, rows_at(0.5 * (rows.gamma[change] + rows.gamma[change + 1]))]).sorted()
    return rows
