"""Cycles of many parameter points in one compiled call: signatures and flight times.

The rule kept here: the same orbits as `model.orbits.ideal_cycles` and `model.orbits.friction_cycles`; a row that does
not close is left to `model.orbits.attractor`, which knows locked cycles and chaos.
"""

from __future__ import annotations

import math

import numpy as np

from model.flight.branches import fill_edges, fold
from model.flight.friction import fill_rough_edges
from model.flight.numerics import Floats, compiled
from model.orbits.friction_cycles import CHATTERS, fly_rough_until_closed
from model.orbits.ideal_cycles import FLIGHTS, PERIOD, RESETS, Integers, fly_until_closed

CHATTERING = 3  # column of the outcome: the cycle holds a completed chatter
OUTCOME_SIZE = 4


@compiled
def _keep_cycle(
    tau: Floats,
    phase: Floats,
    threshold: Integers,
    first: int,
    stop: int,
    periods: int,
    outcome: Integers,
    kept: Floats,
) -> None:
    """Write a cycle's outcome, and its flight times from the reset with the smallest phase on."""
    start = first
    resets = 0
    for k in range(first, stop):
        if threshold[k] >= 0:
            resets += 1
            if fold(phase[k], 0.0) < fold(phase[start], 0.0):
                start = k
    outcome[FLIGHTS] = stop - first
    outcome[RESETS] = resets
    outcome[PERIOD] = periods
    for k in range(min(stop - first, kept.shape[0])):
        j = start + k
        kept[k] = tau[j if j < stop else j - (stop - first)]


@compiled
def ideal_batch(
    tones: Floats, turning: Floats, gammas: Floats, max_flights: int, outcome: Integers, kept: Floats
) -> None:
    """Fill ``outcome`` (m, OUTCOME_SIZE; FLIGHTS -1 where the orbit from rest did not close) and ``kept`` (m, keep)."""
    edge = np.empty(turning.shape[0] + 2)
    tau = np.empty(max_flights)
    phase = np.empty(max_flights)
    speed = np.empty(max_flights)
    index = np.empty(max_flights, dtype=np.int64)
    threshold = np.empty(max_flights, dtype=np.int64)
    outcome[:] = 0
    kept[:] = math.nan
    for row in range(gammas.shape[0]):
        n_windows = fill_edges(tones, turning, gammas[row], edge)
        outcome[row, PERIOD] = 1
        if n_windows == 0:
            continue
        first, stop, periods = fly_until_closed(
            tones, gammas[row], edge, n_windows, 0.0, tau, phase, speed, index, threshold
        )
        if first < 0:
            outcome[row, FLIGHTS] = -1
        else:
            _keep_cycle(tau, phase, threshold, first, stop, periods, outcome[row], kept[row])


@compiled
def rough_batch(
    tones: Floats, turning: Floats, gammas: Floats, rough: Floats, max_flights: int, outcome: Integers, kept: Floats
) -> None:
    """`ideal_batch` of rough balls, with ``mu_up, mu_down, e0, e1`` in the rows of ``rough`` (m, 4)."""
    up = np.empty(turning.shape[0] + 2)
    down = np.empty(turning.shape[0] + 2)
    tau = np.empty(max_flights)
    phase = np.empty(max_flights)
    speed = np.empty(max_flights)
    index = np.empty(max_flights, dtype=np.int64)
    threshold = np.empty(max_flights, dtype=np.int64)
    mark = np.empty(max_flights, dtype=np.int64)
    outcome[:] = 0
    kept[:] = math.nan
    for row in range(gammas.shape[0]):
        ball = (rough[row, 0], rough[row, 1], rough[row, 2], rough[row, 3])
        n_up, n_down = fill_rough_edges(tones, turning, gammas[row], ball, up, down)
        outcome[row, PERIOD] = 1
        if n_up == 0:
            continue
        first, stop, periods, _, _ = fly_rough_until_closed(
            tones, gammas[row], up, n_up, down, n_down, ball, 0.0, 0.0, tau, phase, speed, index, threshold, mark
        )
        if first < 0:
            outcome[row, FLIGHTS] = -1
            continue
        _keep_cycle(tau, phase, threshold, first, stop, periods, outcome[row], kept[row])
        for k in range(first, stop):
            if mark[k] & CHATTERS:
                outcome[row, CHATTERING] = 1
