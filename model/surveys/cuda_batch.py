"""The same flights on a graphics processor: a thread for each orbit, or for each single flight.

The functions are those of the processor (`kernels.device`): no equation stands here. What the device cannot decide (an
orbit that neither closes nor is seen to be chaotic, a flight flagged undecidable) is left to the processor.
"""

# numba.cuda fills its names in when it is imported
# mypy: disable-error-code="attr-defined"
from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import cuda
from numpy.typing import NDArray

from kernels.device import on_device, require_device
from model.flight import first_landing
from model.flight.branches import fill_edges, fold
from model.flight.friction import land_with_friction
from model.flight.numerics import Floats
from model.flight.records import EdgeTables, FrictionRestitution
from model.orbits.attractor import FEW_FLIGHTS
from model.orbits.cycles import CHATTERS, FLIGHTS, PERIOD, RESETS, Flown, Integers
from model.orbits.friction_cycles import fly_with_notes
from model.surveys.cycle_batch import CHATTERING, OPEN, OUTCOME_SIZE
from model.tones import Forcing

THREADS = 128  # of a block
ROWS = 16_384  # points flown at a time: 150 MB of flights on the device


_fill_edges, _land, _fly, _fold = (on_device(k) for k in (fill_edges, land_with_friction, fly_with_notes, fold))


@cuda.jit(device=True)  # type: ignore[no-untyped-call]
def _begin(tones: Floats, turning: Floats, gamma: float, law: Floats, edges: Floats) -> Any:
    """The law of a row, and its tables made in ``edges`` (2, numbers of a table)."""
    up, down = edges[0], edges[1]
    n_up = _fill_edges(tones, turning, gamma / (1.0 + law[0]), up)
    n_down = _fill_edges(tones, turning, gamma / (1.0 - law[1]), down)
    return FrictionRestitution(law[0], law[1], law[2], law[3]), EdgeTables(up, n_up, down, n_down)


@cuda.jit
def _land_each(
    tones: Floats, turning: Floats, gammas: Floats, laws: Floats, starts: Floats, edges: Floats, landed: Floats
) -> None:
    """A flight a thread."""
    row = cuda.grid(1)
    if row >= gammas.shape[0]:
        return
    law, tables = _begin(tones, turning, gammas[row], laws[row], edges[row])
    phi0 = tables.up[2 * int(starts[row, 2])] if starts[row, 2] >= 0.0 else starts[row, 0]
    tau, phi, speed, flag = _land(tones, gammas[row], tables, law, phi0, starts[row, 1], starts[row, 2] >= 0.0)
    landed[row, 0], landed[row, 1], landed[row, 2], landed[row, 3] = tau, phi, speed, flag


@cuda.jit
def _fly_each(
    tones: Floats, turning: Floats, gammas: Floats, laws: Floats, edges: Floats, numbers: Floats, whole: Integers,
    notes: Integers, outcome: Integers, kept: Floats,
) -> None:  # fmt: skip
    """An orbit a thread, from rest until it closes."""
    row = cuda.grid(1)
    if row >= gammas.shape[0]:
        return
    law, tables = _begin(tones, turning, gammas[row], laws[row], edges[row])
    if tables.n_up == 0:
        outcome[row, PERIOD] = 1
        return
    tau, phase, speed = numbers[row, 0], numbers[row, 1], numbers[row, 2]
    symbol, threshold, mark = whole[row, 0], whole[row, 1], whole[row, 2]
    flown = Flown(tau, phase, speed, symbol, threshold, mark)
    first, stop, periods, _, _ = _fly(tones, gammas[row], tables, law, 0.0, 0.0, flown, notes[row])
    if first < 0:
        outcome[row, FLIGHTS] = OPEN
        return
    start = first
    for k in range(first, stop):
        if threshold[k] >= 0:
            outcome[row, RESETS] += 1
            if _fold(phase[k], 0.0) < _fold(phase[start], 0.0):
                start = k
        if mark[k] & CHATTERS:
            outcome[row, CHATTERING] = 1
    outcome[row, PERIOD], outcome[row, FLIGHTS] = periods, stop - first
    for k in range(kept.shape[1]):
        if k == stop - first:
            break
        j = start + k
        kept[row, k] = tau[j if j < stop else j - (stop - first)]


def _launch(kernel: Any, rows: int, arguments: tuple[Any, ...]) -> None:
    kernel[-(-rows // THREADS), THREADS](*arguments)


def landings(forcing: Forcing, gammas: Floats, laws: Floats, starts: Floats) -> Floats:
    """One flight a row.

    Parameters
    ----------
    gammas, laws : (m,), (m, 4) arrays
        Amplitudes; ``mu_up, mu_down, e0, e1``.
    starts : (m, 3) array
        Take-off phase (folded onto the table of the way up), speed off the plate, and the window at whose threshold the
        ball starts from rest (-1: launched at the phase).

    Returns
    -------
    (m, 4) array
        Flight time, landing phase (any turn), impact speed, flags.

    Raises
    ------
    NoDevice
        Where there is none.
    """
    require_device()
    tones, turning = forcing.tones, first_landing.turning_points(forcing)
    edges, landed = np.zeros((gammas.size, 2, turning.size + 2)), np.zeros((gammas.size, 4))
    _launch(_land_each, gammas.size, (tones, turning, gammas, laws, starts, edges, landed))
    return landed


def cycles(forcing: Forcing, gammas: Floats, laws: Floats, keep: int) -> tuple[NDArray[np.int64], Floats]:
    """``outcome`` and ``kept`` as `model.surveys.cycle_batch` fills them; what does not close soon is left OPEN.

    Raises
    ------
    NoDevice
        Where there is none.
    """
    require_device()
    tones, turning = forcing.tones, first_landing.turning_points(forcing)
    outcome = np.zeros((gammas.size, OUTCOME_SIZE), dtype=np.int64)
    kept = np.full((gammas.size, keep), math.nan)
    rows, size = min(ROWS, gammas.size), turning.size + 2
    scratch = (
        cuda.device_array((rows, 2, size)),
        cuda.device_array((rows, 3, FEW_FLIGHTS)),
        cuda.device_array((rows, 3, FEW_FLIGHTS), dtype=np.int64),
        cuda.device_array((rows, 2, size), dtype=np.int64),
    )
    for start in range(0, gammas.size, ROWS):
        some = slice(start, start + ROWS)
        arguments = (tones, turning, gammas[some], laws[some], *scratch, outcome[some], kept[some])
        _launch(_fly_each, gammas[some].size, arguments)
    return outcome, kept
