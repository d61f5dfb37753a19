"""Ideal orbits side by side, from rest until they close: as `model.orbits.ideal_cycles`, a gamma a lane."""

from __future__ import annotations

from typing import Any

import numpy as np

from kernels.lanes import WIDTH, gather, load, select, spread, store
from model.flight.branches import TWO_PI, branch_of, fold, q_and_slope
from model.flight.ideal import land
from model.flight.edge_table import TABLE
from model.flight.ideal_lanes import land_lanes
from model.flight.segment import shape
from model.flight.numerics import Floats, compiled

# rows of the lanes' state
GAMMA, BASE, LAST, BRANCH, PHI0, RESET, X, TURNS, SPEED, PLAIN, LANDED = range(11)


@compiled
def _land_alone(
    tones: Floats, gamma: float, table: Floats, base: int, n: int, phi0: float, reset: bool, edge: Floats
) -> Any:
    """A flight that is not plain, by `model.flight.ideal.land`."""
    for i in range(2 * n + 1):
        edge[i] = table[base + TABLE * i]
    a0 = 0.0 if reset else max(gamma * q_and_slope(tones, phi0)[0] - 1.0, 0.0)
    tau, landing, speed, _ = land(tones, gamma, edge, n, phi0, a0, 0.0)
    return tau, landing, speed, branch_of(edge, n, landing)


@compiled
def fly_rows(
    tones: Floats, gammas: Floats, n_rows: int, table: Floats, windows: Any, closes: bool,
    taus: Floats, phases: Floats, thresholds: Any, closed: Any,
) -> int:  # fmt: skip
    """Fly every row from rest at phase 0 until a threshold repeats or its arrays are full.

    Fills taus, phases and thresholds (rows, most) and ``closed`` (rows, 3): first, stop, periods. Returns the flights.
    """
    most = taus.shape[1]
    stride = table.shape[0] // gammas.shape[0]
    size = stride // TABLE
    state = np.zeros((11, WIDTH))
    flat = state.reshape(-1)
    row = np.full(WIDTH, -1, dtype=np.int64)
    count = np.zeros(WIDTH, dtype=np.int64)
    turn = np.zeros(WIDTH, dtype=np.int64)
    seen = np.zeros((WIDTH, size), dtype=np.int64)
    seen_turn = np.zeros((WIDTH, size), dtype=np.int64)
    edge = np.empty(size)
    highest = 0.0
    for j in range(tones.shape[0]):
        highest += tones[j, 1]
    taken = 0
    flown = 0
    busy = 0
    for lane in range(WIDTH):
        count[lane] = most
    while True:
        for lane in range(WIDTH):
            done = row[lane] < 0
            while True:
                if done:
                    while taken < n_rows and windows[taken] == 0:
                        closed[taken, 0], closed[taken, 1], closed[taken, 2] = -1, 0, 0
                        taken += 1
                    if taken >= n_rows:
                        if row[lane] >= 0:
                            busy -= 1
                        row[lane] = -1
                        break
                    if row[lane] < 0:
                        busy += 1
                    r = taken
                    taken += 1
                    row[lane], count[lane], turn[lane] = r, 0, 0
                    last = 2 * windows[r]
                    base = r * stride
                    for i in range(size):
                        seen[lane, i] = -1
                    state[GAMMA, lane], state[BASE, lane], state[LAST, lane] = gammas[r], base, last
                    landing = fold(0.0, table[base])
                    i = 0
                    while i + 1 < last and landing >= table[base + TABLE * (i + 1)]:
                        i += 1
                    state[X, lane], state[LANDED, lane] = landing, i
                r = row[lane]
                i = int(state[LANDED, lane])
                last = int(state[LAST, lane])
                base = r * stride
                k = count[lane]
                waits = i % 2 == 1 or state[X, lane] <= table[base + TABLE * i]
                if waits:
                    i += i % 2
                    if i == last:
                        i = 0
                        turn[lane] += 1
                    if closes and seen[lane, i] >= 0:
                        closed[r, 0], closed[r, 1], closed[r, 2] = seen[lane, i], k, turn[lane] - seen_turn[lane, i]
                        done = True
                        continue
                    seen[lane, i] = k
                    seen_turn[lane, i] = turn[lane]
                if k == most:
                    closed[r, 0], closed[r, 1], closed[r, 2] = -1, k, 0
                    done = True
                    continue
                phi0 = table[base + TABLE * i] if waits else state[X, lane]
                state[PHI0, lane], state[BRANCH, lane], state[RESET, lane] = phi0, i, 1.0 if waits else 0.0
                phases[r, k] = phi0
                thresholds[r, k] = i // 2 if waits else -1
                break
        if busy == 0:
            return flown
        flown += busy
        gamma, base_, last_ = load(flat, GAMMA * WIDTH), load(flat, BASE * WIDTH), load(flat, LAST * WIDTH)
        branch_, phi_ = load(flat, BRANCH * WIDTH), load(flat, PHI0 * WIDTH)
        s0, slope0, _ = shape(tones, phi_)
        x, turns, landed, speed, plain = land_lanes(
            tones, highest, table, gamma, base_, last_, branch_, phi_, s0, slope0
        )
        store(flat, X * WIDTH, x)
        store(flat, TURNS * WIDTH, turns)
        store(flat, LANDED * WIDTH, landed)
        store(flat, PLAIN * WIDTH, select(plain, spread(1.0), spread(0.0)))
        for lane in range(WIDTH):
            r = row[lane]
            if r < 0:
                continue
            k = count[lane]
            phi0 = state[PHI0, lane]
            tau = state[X, lane] - phi0 + state[TURNS, lane]
            if state[PLAIN, lane] == 0.0:
                tau, state[X, lane], _, branch = _land_alone(
                    tones, gammas[r], table, r * stride, windows[r], phi0, state[RESET, lane] == 1.0, edge
                )
                state[LANDED, lane] = branch
            taus[r, k] = tau
            turn[lane] += round((phi0 + tau - state[X, lane]) / TWO_PI)
            count[lane] = k + 1
