"""From points in frames to the track of the ball.

The ball is what falls. Points are linked from frame to frame afresh (a tracker's own numbering
changes when it loses the ball); among the tracks the one whose motion is free flight under one common acceleration
is the ball, however long the others are. Two such tracks at once are an error, not a choice.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from analysis.statistics import MAD_TO_SIGMA
from daq.setup.errors import InputError

Array = NDArray[np.float64]

_WINDOW = 7  # samples in which free flight is looked for
_LONGEST_GAP = 8.0  # frames a track may be lost
_GATE_OF_RANGE = 0.012
_NEW_GATE_OF_RANGE, _NEW_FALL_OF_RANGE = 0.04, 0.15  # a track's first step: across, and up or down
_RIVAL_SHARE = 0.4
_RIVAL_TRAVEL = 0.3  # of the ball's way: the background flickers where the ball comes to rest
_LEAST_BALLISTIC = 6  # windows
_STRAIGHT = 0.01  # of the height of a path, by which points of a straight one lie beside it
_RIGID = 0.03  # of the way, by which the distance of two parts of one body varies
_LEAST_LEAN = 0.0175  # rad; what leans less is measured along the picture's columns


@dataclass
class _Open:
    """A track being linked."""

    index: list[int]
    clock: float
    position: Array
    velocity: Array = field(default_factory=lambda: np.zeros(2))
    speed: float = 0.0  # vertical, of late: the step across a bounce is short, the one after it is not
    bend: Array = field(default_factory=lambda: np.zeros(2))  # change of velocity from step to step, of late
    steps: int = 0
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
    remarks: tuple[str, ...] = ()


def ball_of(clock: Array, x: Array, y: Array, where: str, axis_deg: float | None = None) -> Track:
    """Choose the ball's track among points (n,), and turn it upright.

    ``axis_deg``: direction of the fall, degrees right of down; found where None.

    Raises
    ------
    InputError
        Nothing moves, nothing falls freely, or two things do at once.
    """
    frame = _frame_length(clock)
    if axis_deg is not None:
        x, y = _turned(x, y, np.radians(axis_deg))
    spread = float(np.ptp(y))
    if not spread > 0.0:
        raise InputError(f"{where}: no motion: the tracked height never changes")
    tracks = [np.array(t) for t in link(clock / frame, x, y) if len(t) >= _WINDOW]
    if len(np.unique(clock)) == len(clock) and free_fall(clock, y, spread)[0] >= _LEAST_BALLISTIC:
        tracks = [np.arange(len(clock))]  # somebody tracked one ball: every point is its
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
        alike &= not _rigid(clock, x, y, tracks[best], tracks[rival])
        if rival_count >= max(_RIVAL_SHARE * count, 2 * _LEAST_BALLISTIC) and alike and len(together) >= _WINDOW:
            raise InputError(
                f"{where}: two movers: one near x = {np.median(x[tracks[best]]):.0f}, another near "
                f"x = {np.median(x[tracks[rival]]):.0f}, both in free flight at once; film or crop to one ball"
            )
    chosen = tracks[best]
    remarks: tuple[str, ...] = ()
    if axis_deg is None and float(np.ptp(x)) > 0.0:
        angle = _refit_without_excess(clock[chosen], x[chosen], y[chosen], acceleration)
        if abs(angle) > _LEAST_LEAN:
            x, y = _turned(x, y, angle)
            acceleration /= float(np.cos(angle))
            remarks = (f"the fall leans by {np.degrees(angle):+.1f} degrees in the picture; heights are along it",)
    upright = -np.sign(acceleration)
    return Track(chosen, clock[chosen], x[chosen], upright * y[chosen], abs(acceleration), count, remarks)


def _rigid(clock: Array, x: Array, y: Array, one: NDArray[np.int64], other: NDArray[np.int64]) -> bool:
    """Whether two tracks keep their distance, as the parts of one block behind a rod do."""
    _, a, b = np.intersect1d(clock[one], clock[other], return_indices=True)
    if len(a) < _WINDOW:
        return False
    apart = np.hypot(np.std(x[one[a]] - x[other[b]]), np.std(y[one[a]] - y[other[b]]))
    return bool(apart < _RIGID * max(float(np.ptp(y[one[a]])), 1e-12))


def _turned(x: Array, y: Array, angle: float) -> tuple[Array, Array]:
    """Across and along a fall that leans by ``angle`` to the right of down."""
    return x * np.cos(angle) - y * np.sin(angle), y * np.cos(angle) + x * np.sin(angle)


def _refit_without_excess(clock: Array, x: Array, y: Array, acceleration: float) -> float:
    """Angle of the fall from the vertical axis: of a straight path, else of the acceleration; 0 where not clear."""
    slope = float(np.polyfit(y, x, 1)[0])
    left = x - slope * y
    if MAD_TO_SIGMA * float(np.median(np.abs(left - np.median(left)))) < _STRAIGHT * float(np.ptp(y)):
        return float(np.arctan(slope))  # up and down one line: a guided block, or a ball that drifts not at all
    across, _ = _bends(clock, x)
    down, free = _bends(clock, y)
    free &= np.abs(down - acceleration) < 0.3 * abs(acceleration)
    if int(free.sum()) < _LEAST_BALLISTIC:
        return 0.0
    angle = np.arctan2(across[free] * np.sign(acceleration), np.abs(down[free]))
    middle = float(np.median(angle))
    error = MAD_TO_SIGMA * float(np.median(np.abs(angle - middle))) / np.sqrt(max(float(free.sum()) / _WINDOW, 1.0))
    return middle if abs(middle) > 4.0 * error else 0.0


def _bends(clock: Array, y: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Second derivative in each window of consecutive samples, and which windows have no gap."""
    t, h = sliding_window_view(clock, _WINDOW), sliding_window_view(y, _WINDOW)
    span = t[:, -1] - t[:, 0]
    s = (t - t.mean(axis=1, keepdims=True)) / span[:, None]
    basis = np.stack([np.ones_like(s), s, s * s], axis=2)
    normal = basis.transpose(0, 2, 1) @ basis
    coefficient = np.linalg.solve(normal, basis.transpose(0, 2, 1) @ h[..., None])
    return 2.0 * coefficient[:, 2, 0] / span**2, span <= 1.5 * (_WINDOW - 1) * _frame_length(clock)


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
                velocity = (here - chain.position) / span
                change = (velocity - chain.velocity) / span
                turned = chain.velocity[1] < 0.0 < velocity[1] or velocity[1] < 0.0 < chain.velocity[1]
                if chain.steps >= 1 and not (turned and abs(change[1]) > 4.0 * abs(chain.bend[1])):
                    chain.bend = change if chain.steps == 1 else 0.5 * (chain.bend + change)
                chain.velocity = velocity
                chain.steps += 1
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
        falling = ahead + 0.5 * track.bend * span * (span + 1.0)
        for i in points:
            dx, dy = x[i] - track.position[0], y[i] - track.position[1]
            miss = min(float(np.hypot(dx - a[0], dy - a[1])) for a in (ahead, falling))
            sideways = abs(dx - ahead[0])
            if miss <= reach + 0.15 * abs(ahead[1]) + abs(float(track.bend[1])) * span:
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
