"""From points in frames to the track of the ball.

The rule kept here: the ball is what falls. Points are linked from frame to frame afresh (a tracker's own numbering
changes when it loses the ball); among the tracks the one whose motion is free flight under one common acceleration
is the ball, however long the others are. Two such tracks at once are an error, not a choice.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from daq.setup.errors import InputError

Array = NDArray[np.float64]

_WINDOW = 7  # samples in which free flight is looked for
_LONGEST_GAP = 8.0  # frames a track may be lost
_GATE_OF_RANGE = 0.012
_NEW_GATE_OF_RANGE, _NEW_FALL_OF_RANGE = 0.04, 0.15  # a track's first step: across, and up or down
_RIVAL_SHARE = 0.4
_RIVAL_TRAVEL = 0.3  # of the ball's way: the background flickers where the ball comes to rest
_LEAST_BALLISTIC = 6  # windows


@dataclass
class _Open:
    """A track being linked."""

    index: list[int]
    clock: float
    position: Array
    velocity: Array = field(default_factory=lambda: np.zeros(2))
    speed: float = 0.0  # vertical, of late: the step across a bounce is short, the one after it is not
    fresh: bool = True


@dataclass(frozen=True)
class Track:
    """The ball.

    Attributes
    ----------
    index : (n,) int64
        Which of the points it is, in time order.
    clock : (n,) float64
        Frame numbers or seconds.
    x, height : (n,) float64
        Position across, and height counted upward, in the points' unit.
    acceleration : float
        Typical downward acceleration in free flight (unit per clock^2), positive.
    ballistic : int
        Windows of the track that are free flight.
    """

    index: NDArray[np.int64]
    clock: Array
    x: Array
    height: Array
    acceleration: float
    ballistic: int


def ball_of(clock: Array, x: Array, y: Array, where: str) -> Track:
    """Choose the ball's track among points (n,), and turn it upright.

    Raises
    ------
    InputError
        Nothing moves, nothing falls freely, or two things do at once.
    """
    frame = _frame_length(clock)
    spread = float(np.ptp(y))
    if not spread > 0.0:
        raise InputError(f"{where}: no motion: the tracked height never changes")
    tracks = [np.array(t) for t in link(clock / frame, x, y) if len(t) >= _WINDOW]
    judged = sorted(((*free_fall(clock[t], y[t], spread), k) for k, t in enumerate(tracks)), reverse=True)
    if not judged or judged[0][0] < _LEAST_BALLISTIC:
        raise InputError(
            f"{where}: no motion that looks like free flight in {len(np.unique(clock))} frames; the clip must show the "
            "ball falling and bouncing, at least seven frames a flight"
        )
    count, acceleration, best = judged[0]
    for rival_count, rival_acceleration, rival in judged[1:]:
        together = np.intersect1d(clock[tracks[best]], clock[tracks[rival]])
        alike = 0.5 < rival_acceleration / acceleration < 2.0
        alike &= float(np.ptp(y[tracks[rival]])) > _RIVAL_TRAVEL * float(np.ptp(y[tracks[best]]))
        if rival_count >= max(_RIVAL_SHARE * count, 2 * _LEAST_BALLISTIC) and alike and len(together) >= _WINDOW:
            raise InputError(
                f"{where}: two movers: one near x = {np.median(x[tracks[best]]):.0f}, another near "
                f"x = {np.median(x[tracks[rival]]):.0f}, both in free flight at once; film or crop to one ball"
            )
    chosen = tracks[best]
    upright = -np.sign(acceleration)
    return Track(chosen, clock[chosen], x[chosen], upright * y[chosen], abs(acceleration), count)


def _frame_length(clock: Array) -> float:
    steps = np.diff(np.unique(clock))
    return float(np.median(steps)) if len(steps) else 1.0


def link(frames: Array, x: Array, y: Array) -> list[list[int]]:
    """Chain points from frame to frame; returns the points' indices of each track.

    A point may go on where the track was heading, or anywhere between there and the mirror image of that step: a
    bounce turns the vertical speed over within a frame.
    """
    spread = max(float(np.ptp(y)), float(np.ptp(x)) * 0.2)
    gate, new_gate = _GATE_OF_RANGE * spread, _NEW_GATE_OF_RANGE * spread
    live: list[_Open] = []
    done: list[list[int]] = []
    starts = np.flatnonzero(np.diff(frames, prepend=-np.inf) > 1e-6)
    for start, stop in zip(starts, np.append(starts[1:], len(frames)), strict=True):
        now = float(frames[start])
        done += [t.index for t in live if now - t.clock > _LONGEST_GAP]
        live = [t for t in live if now - t.clock <= _LONGEST_GAP]
        free = set(range(int(start), int(stop)))
        for cost, track, i in sorted(_candidates(live, range(int(start), int(stop)), x, y, now, gate, new_gate)):
            del cost
            chain = live[track]
            if i in free and chain.clock < now:
                free.discard(i)
                here, span = np.array([x[i], y[i]]), now - chain.clock
                chain.velocity = (here - chain.position) / span
                chain.speed = max(abs(float(chain.velocity[1])), 0.75 * chain.speed)
                chain.position, chain.clock, chain.fresh = here, now, False
                chain.index.append(i)
        live += [_Open([i], now, np.array([x[i], y[i]])) for i in sorted(free)]
    return done + [t.index for t in live]


def _candidates(
    live: list[_Open], points: range, x: Array, y: Array, now: float, gate: float, new_gate: float
) -> list[tuple[float, int, int]]:
    found = []
    fall = _NEW_FALL_OF_RANGE / _NEW_GATE_OF_RANGE * new_gate
    for k, track in enumerate(live):
        span = now - track.clock
        reach = (new_gate if track.fresh else gate) * max(1.0, span) ** 0.5
        ahead = track.velocity * span
        for i in points:
            dx, dy = x[i] - track.position[0], y[i] - track.position[1]
            miss = float(np.hypot(dx - ahead[0], dy - ahead[1]))
            sideways = abs(dx - ahead[0])
            if miss <= reach + 0.15 * abs(ahead[1]):
                found.append((miss, k, i))
            elif sideways <= reach and abs(dy) <= (fall if track.fresh else 1.15 * track.speed * span + reach):
                found.append((miss + reach, k, i))
    return found


def free_fall(clock: Array, y: Array, spread: float) -> tuple[int, float]:
    """How many windows of a track are free flight, and their common signed acceleration."""
    if len(y) < _WINDOW:
        return 0, 0.0
    t, h = sliding_window_view(clock, _WINDOW), sliding_window_view(y, _WINDOW)
    span = t[:, -1] - t[:, 0]
    compact = span <= 1.5 * (_WINDOW - 1) * _frame_length(clock)
    t, h, span = t[compact], h[compact], span[compact]
    if not len(t):
        return 0, 0.0
    s = (t - t.mean(axis=1, keepdims=True)) / span[:, None]
    basis = np.stack([np.ones_like(s), s, s * s], axis=2)
    coefficient = np.linalg.solve(basis.transpose(0, 2, 1) @ basis, basis.transpose(0, 2, 1) @ h[..., None])
    residual = np.sqrt(((h - (basis @ coefficient)[..., 0]) ** 2).mean(axis=1))
    travel = np.ptp(h, axis=1)
    moves = (travel > 0.004 * spread) & (residual < 0.06 * travel)
    bend = 2.0 * coefficient[:, 2, 0] / span**2
    moves &= np.abs(bend) * span**2 / 8.0 > 1.5 * residual
    if not moves.any():
        return 0, 0.0
    middle = float(np.median(bend[moves]))
    near = moves & (np.abs(bend - middle) < 0.4 * abs(middle))
    return int(near.sum()), float(np.median(bend[near])) if near.any() else 0.0
