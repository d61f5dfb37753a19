"""Tables of the window edges of many gammas at once, with the plate's s, s' and q' there.

As `model.flight.branches.fill_edges`, a gamma a lane (`kernels.lanes`): what does not depend on gamma, the turning
points and the forcing there, is computed once for all. A table is named by its place and the number of its edges, of
each lane its own.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from kernels.arrays import Floats
from kernels.lanes import ROW, WIDTH, any_of, floor, gather, load, root, select, size, spread, store
from model.flight.branches import TWO_PI, arrange
from model.flight.lanes.plate_lanes import plate
from model.flight.numerics import Number, compiled, inlined, sincos

TABLE = ROW  # numbers a table holds of an edge: its phase, and s, s' and q' there
FOUND = 5  # rows of lanes that a crossing needs while tables are made
CONVERGED = 1e-8  # a last step of Newton smaller than this leaves an error of its square


@inlined
def _part_of_half_turn(cosine: Any) -> Any:
    """``acos(cosine) / pi`` to 2e-5 (Abramowitz and Stegun 4.4.45)."""
    u = size(cosine)
    angle = root(select(u < 1.0, 1.0 - u, 0.0)) * (1.5707288 + u * (-0.2121144 + u * (0.0742610 - 0.0187293 * u)))
    return select(cosine < 0.0, math.pi - angle, angle) * (1.0 / math.pi)


@inlined
def crossing_lanes(tones: Floats, gamma: Any, lo: float, hi: float, guess: Any, rising: Any, wanted: Any) -> Any:
    """The root of ``gamma q - 1`` in ``[lo, hi]`` of every wanted lane: Newton inside a shrinking bracket."""
    low, high = spread(lo), spread(hi)
    x = select((guess > lo) & (guess < hi), guess, 0.5 * (lo + hi))
    moving = wanted
    for _ in range(80):
        q, jerk, snap = spread(0.0), spread(0.0), spread(0.0)
        for j in range(tones.shape[0]):
            n = tones[j, 0]
            sine, cosine = sincos(n * x + tones[j, 2])
            weight = tones[j, 1] * n * n
            sine = weight * sine
            q = q + sine
            jerk = jerk + (weight * n) * cosine
            snap = snap + n * n * sine
        value = gamma * q - 1.0
        below = select(value < 0.0, spread(1.0), spread(0.0)) == rising
        low, high = select(below, x, low), select(below, high, x)
        step = value / (gamma * jerk)
        new = x - step
        inside = (new > low) & (new < high)
        new = select(inside, new, 0.5 * (low + high))
        still = size(new - x) <= 2e-16 * (1.0 + size(x))
        gentle = inside & (size(step) <= CONVERGED) & (size(step * snap) <= CONVERGED * size(jerk))
        x = select(moving, new, x)
        moving = moving & ~(still | gentle)
        if not any_of(moving):
            break
    return x


@compiled
def fill_tables(tones: Floats, turning: Floats, gammas: Floats, table: Floats, windows: Any, found: Floats) -> None:
    """Tables of edges of all ``gammas`` (a multiple of `WIDTH`), as `model.flight.branches.fill_edges` orders them."""
    m = turning.shape[0]
    stride = TABLE * (m + 2)
    # turning points do not depend on gamma: their q is computed once for all lanes
    q_turning = np.empty(m)
    for i in range(m):
        q_turning[i] = 0.0
        for j in range(tones.shape[0]):
            n = tones[j, 0]
            q_turning[i] += tones[j, 1] * n * n * math.sin(n * turning[i] + tones[j, 2])
    for start in range(0, gammas.shape[0], WIDTH):
        gamma = load(gammas, start)
        for i in range(m):
            nxt = i + 1 if i + 1 < m else 0
            lo, hi = turning[i], turning[nxt] + (TWO_PI if nxt == 0 else 0.0)
            below_lo = select(gamma * q_turning[i] < 1.0, spread(1.0), spread(0.0))
            below_hi = select(gamma * q_turning[nxt] < 1.0, spread(1.0), spread(0.0))
            crosses = ~(below_lo == below_hi)
            if any_of(crosses):
                part = (1.0 / gamma - q_turning[i]) / (q_turning[nxt] - q_turning[i])
                guess = lo + (hi - lo) * _part_of_half_turn(1.0 - 2.0 * part)  # exact for one sine
                x = crossing_lanes(tones, gamma, lo, hi, guess, below_lo, crosses)
                s, slope, _, jerk, _ = plate(tones, x)
                store(found, (FOUND * i) * WIDTH, select(crosses, x, math.nan))
                store(found, (FOUND * i + 1) * WIDTH, s)
                store(found, (FOUND * i + 2) * WIDTH, slope)
                store(found, (FOUND * i + 3) * WIDTH, jerk)
                store(found, (FOUND * i + 4) * WIDTH, below_lo)
            else:
                store(found, (FOUND * i) * WIDTH, spread(math.nan))
        for lane in range(WIDTH):
            base = (start + lane) * stride
            count, shift = 0, False
            for i in range(m):
                x = found[FOUND * i * WIDTH + lane]
                if x == x:
                    shift = shift or (count == 0 and found[(FOUND * i + TABLE) * WIDTH + lane] == 0.0)
                    for k in range(TABLE):
                        table[base + TABLE * count + k] = found[(FOUND * i + k) * WIDTH + lane]
                    count += 1
            windows[start + lane] = arrange(table, base, TABLE, count, shift)


@inlined
def fold_onto(table: Floats, base: Number, phi: Number) -> Number:
    """``phi`` shifted by whole turns onto a table's period."""
    first = gather(table, base)
    folded = phi - TWO_PI * floor((phi - first) * (1.0 / TWO_PI))
    folded = select(folded < first, folded + TWO_PI, folded)
    return select(folded >= first + TWO_PI, folded - TWO_PI, folded)
