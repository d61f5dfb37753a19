"""The track of the ball from points in frames, and the flights that it is cut into.

The ball is what falls. Points are linked from frame to frame afresh (a tracker's own numbering changes when it loses
the ball); among the tracks the one whose motion is free flight under one common acceleration is the ball, however long
the others are. Two such tracks at once are an error, not a choice.

A flight is what lies between two impacts and has enough samples to be a curve; everything else (hand, rest, bounces of
a few frames) is left out and not guessed at.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import signal

from analysis.statistics import mad_sigma
from daq.setup.errors import InputError
from kernels.arrays import Bools, Floats, Integers

_WINDOW = 7  # samples in which free flight is looked for
_LEAST_BALLISTIC = 6  # windows


@dataclass
class _Open:
    """A track being linked."""

    index: list[int]
    clock: float
    position: Floats
    velocity: Floats = field(default_factory=lambda: np.zeros(2))
    speed: float = 0.0  # vertical, of late: the step across a bounce is short, the one after it is not
    bend: Floats = field(default_factory=lambda: np.zeros(2))  # change of velocity from step to step, of late
    steps: int = 0

    def goes_on(self, i: int, here: Floats, now: float) -> None:
        """Take a point into the track."""
        span = now - self.clock
        velocity = (here - self.position) / span
        change = (velocity - self.velocity) / span
        turned = self.velocity[1] < 0.0 < velocity[1] or velocity[1] < 0.0 < self.velocity[1]
        if self.steps >= 1 and not (turned and abs(change[1]) > 4.0 * abs(self.bend[1])):  # a bounce bends no flight
            self.bend = change if self.steps == 1 else 0.5 * (self.bend + change)
        self.velocity, self.position, self.clock = velocity, here, now
        self.steps += 1
        self.speed = max(abs(float(velocity[1])), 0.75 * self.speed)
        self.index.append(i)


@dataclass(frozen=True)
class Track:
    """The ball."""

    index: Integers  # (n,) which of the points it is, in time order
    clock: Floats  # (n,) frame numbers or seconds
    x: Floats  # position across, in the points' unit, (n,)
    height: Floats  # counted upward, (n,)
    acceleration: float  # typical downward acceleration in free flight (unit per clock^2), positive
    remarks: tuple[str, ...] = ()  # what was noticed


def ball_of(clock: Floats, x: Floats, y: Floats, where: str, axis_deg: float | None = None) -> Track:
    """Choose the ball's track among points (n,), and turn it upright.

    ``axis_deg``: direction of the fall, degrees right of down; found where None.

    Raises `InputError` where nothing moves, nothing falls freely, or two things do at once.
    """
    if axis_deg is not None:
        x, y = _turned(x, y, np.radians(axis_deg))
    spread = float(np.ptp(y))
    if not spread > 0.0:
        raise InputError(f"{where}: no motion: the tracked height never changes")
    tracks = [np.array(t) for t in link(clock / _frame_length(clock), x, y) if len(t) >= _WINDOW]
    if len(np.unique(clock)) == len(clock) and free_fall(clock, y, spread)[0] >= _LEAST_BALLISTIC:
        tracks = [np.arange(len(clock))]  # somebody tracked one ball: every point is its
    judged = sorted(((*free_fall(clock[t], y[t], spread), k) for k, t in enumerate(tracks)), reverse=True)
    if not judged or judged[0][0] < _LEAST_BALLISTIC:
        raise InputError(
            f"{where}: no motion that looks like free flight in {len(np.unique(clock))} frames; the clip must show the "
            "ball falling and bouncing, at least seven frames a flight"
        )
    count, acceleration, best = judged[0]
    chosen = tracks[best]
    for rival_count, rival_acceleration, k in judged[1:]:
        rival = tracks[k]
        _, own, other = np.intersect1d(clock[chosen], clock[rival], return_indices=True)
        # the background flickers where the ball comes to rest: a rival must travel 30 % of the ball's way
        far = float(np.ptp(y[rival])) > 0.3 * float(np.ptp(y[chosen]))
        alike = far and 0.5 < rival_acceleration / acceleration < 2.0
        # a part that is seen in less than 40 % of the ball's free flight is no rival
        if len(own) < _WINDOW or not alike or rival_count < max(0.4 * count, 2 * _LEAST_BALLISTIC):
            continue
        distance_x, distance_y = x[chosen[own]] - x[rival[other]], y[chosen[own]] - y[rival[other]]
        # two parts of one block, on both sides of a rod, stay at one distance, to 3 % of the way
        if np.hypot(np.std(distance_x), np.std(distance_y)) >= 0.03 * max(float(np.ptp(y[chosen[own]])), 1e-12):
            raise InputError(
                f"{where}: two movers: one near x = {np.median(x[chosen]):.0f}, another near "
                f"x = {np.median(x[rival]):.0f}, both in free flight at once; film or crop to one ball"
            )
    remarks: tuple[str, ...] = ()
    if axis_deg is None and float(np.ptp(x)) > 0.0:
        angle = _tilt_of_fall(clock[chosen], x[chosen], y[chosen], acceleration)
        if abs(angle) > 0.0175:  # rad; a fall that leans less is measured along the picture's columns
            x, y = _turned(x, y, angle)
            acceleration /= float(np.cos(angle))
            remarks = (f"the fall leans by {np.degrees(angle):+.1f} degrees in the picture; heights are along it",)
    upright = -np.sign(acceleration)
    return Track(chosen, clock[chosen], x[chosen], upright * y[chosen], abs(acceleration), remarks)


def _turned(x: Floats, y: Floats, angle: float) -> tuple[Floats, Floats]:
    """Across and along a fall that leans by ``angle`` to the right of down."""
    return x * np.cos(angle) - y * np.sin(angle), y * np.cos(angle) + x * np.sin(angle)


def _tilt_of_fall(clock: Floats, x: Floats, y: Floats, acceleration: float) -> float:
    """Angle of the fall from the vertical axis: of a straight path, else of the acceleration; 0 where not clear."""
    slope = float(np.polyfit(y, x, 1)[0])
    left = x - slope * y
    # points within 1 % of the height from one line are a straight path
    if mad_sigma(left - np.median(left)) < 0.01 * float(np.ptp(y)):
        return float(np.arctan(slope))  # up and down one line: a guided block, or a ball that drifts not at all
    across, down = parabolas(clock, x), parabolas(clock, y)
    free = down.compact & (np.abs(down.bend - acceleration) < 0.3 * abs(acceleration))
    if int(free.sum()) < _LEAST_BALLISTIC:
        return 0.0
    angle = np.arctan2(across.bend[free] * np.sign(acceleration), np.abs(down.bend[free]))
    middle = float(np.median(angle))
    error = mad_sigma(angle - middle) / np.sqrt(max(float(free.sum()) / _WINDOW, 1.0))
    return middle if abs(middle) > 4.0 * error else 0.0


@dataclass(frozen=True)
class _Parabolas:
    """Parabolas through windows, (n,) each."""

    bend: Floats  # second derivative
    span: Floats  # time
    residual: Floats  # rms
    travel: Floats  # range
    compact: Bools  # without a gap


def parabolas(clock: Floats, y: Floats) -> _Parabolas:
    """Parabolas through each window of consecutive samples of ``y`` (n,)."""
    t, h = sliding_window_view(clock, _WINDOW), sliding_window_view(y, _WINDOW)
    span = t[:, -1] - t[:, 0]
    s = (t - t.mean(axis=1, keepdims=True)) / span[:, None]
    basis = np.stack([np.ones_like(s), s, s * s], axis=2)
    coefficient = np.linalg.solve(basis.transpose(0, 2, 1) @ basis, basis.transpose(0, 2, 1) @ h[..., None])
    residual = np.sqrt(((h - (basis @ coefficient)[..., 0]) ** 2).mean(axis=1))
    compact = span <= 1.5 * (_WINDOW - 1) * _frame_length(clock)
    return _Parabolas(2.0 * coefficient[:, 2, 0] / span**2, span, residual, np.ptp(h, axis=1), compact)


def _frame_length(clock: Floats) -> float:
    steps = np.diff(np.unique(clock))
    return float(np.median(steps)) if len(steps) else 1.0


def link(frames: Floats, x: Floats, y: Floats) -> list[list[int]]:
    """Chain points from frame to frame; returns the points' indices of each track.

    A point may go on where the track was heading, or anywhere between there and the mirror image of that step: a
    bounce turns the vertical speed over within a frame.
    """
    spread = max(float(np.ptp(y)), float(np.ptp(x)) * 0.2)
    places = np.column_stack([x, y])
    live: list[_Open] = []
    done: list[list[int]] = []
    starts = np.flatnonzero(np.diff(frames, prepend=-np.inf) > 1e-6)
    for start, stop in zip(starts, np.append(starts[1:], len(frames)), strict=True):
        now, points = float(frames[start]), range(int(start), int(stop))
        done += [t.index for t in live if now - t.clock > 8.0]  # a track may be lost for eight frames
        live = [t for t in live if now - t.clock <= 8.0]
        free = set(points)
        for _, k, i in sorted(_candidates(live, points, places, now, spread)):
            if i in free and live[k].clock < now:  # neither has a better partner
                free.discard(i)
                live[k].goes_on(i, places[i], now)
        live += [_Open([i], now, places[i]) for i in sorted(free)]
    return done + [t.index for t in live]


def _candidates(
    live: list[_Open], points: range, places: Floats, now: float, spread: float
) -> list[tuple[float, int, int]]:
    """Tracks and points that may belong together, with how far off each point is."""
    found = []
    for k, track in enumerate(live):
        span = now - track.clock
        # of the range of all points: a track's first step goes 4 % at most, later ones miss the prediction by 1.2 %
        reach = spread * (0.012 if track.steps else 0.04) * max(1.0, span) ** 0.5
        ahead = track.velocity * span
        falling = ahead + 0.5 * track.bend * span * (span + 1.0)
        for i in points:
            dx, dy = places[i] - track.position
            miss = min(float(np.hypot(dx - a[0], dy - a[1])) for a in (ahead, falling))
            most = 1.15 * track.speed * span + reach if track.steps else 0.15 * spread  # the same, up or down
            if miss <= reach + 0.15 * abs(ahead[1]) + abs(float(track.bend[1])) * span:
                found.append((miss, k, i))
            elif abs(dx - ahead[0]) <= reach and abs(dy) <= most:
                found.append((miss + reach, k, i))
    return found


def free_fall(clock: Floats, y: Floats, spread: float) -> tuple[int, float]:
    """Number of windows of a track that are free flight, and their common signed acceleration."""
    if len(y) < _WINDOW:
        return 0, 0.0
    fit = parabolas(clock, y)
    moves = fit.compact & (fit.travel > 0.004 * spread) & (fit.residual < 0.06 * fit.travel)
    moves &= np.abs(fit.bend) * fit.span**2 / 8.0 > 1.5 * fit.residual
    if not moves.any():
        return 0, 0.0
    middle = float(np.median(fit.bend[moves]))
    near = moves & (np.abs(fit.bend - middle) < 0.4 * abs(middle))
    return int(near.sum()), float(np.median(fit.bend[near])) if near.any() else 0.0


Indices = NDArray[np.intp]

LEAST_SAMPLES = 6
_LEAST_FLIGHT_FRAMES = 6.0
_SAME_FRAMES = 2.0  # an impact left out by hand is the one within so many frames


@dataclass(frozen=True)
class Clip:
    """The ball's path in one file, upright."""

    name: str
    frame: Floats  # in frames, not always whole, (n,)
    height: Floats  # in the file's unit, counted upward, (n,)
    acceleration: float  # rough free-fall acceleration, unit per frame^2
    across: Floats | None = None  # (n,) place across the fall, where the unit is pixels
    # the film has edges by which a motion of its camera along the fall would be seen, and was moved back
    watched: bool = True
    no_impact: tuple[float, ...] = ()  # frames at which a person says that there is no impact
    impact: tuple[float, ...] = ()  # at which there is one


@dataclass(frozen=True)
class Flight:
    """Samples of one flight."""

    clip: int  # number of the file it belongs to
    order: int  # 0 for the fall, then 1, 2, ...
    frame: Floats  # in frames, not always whole, (n,)
    height: Floats  # in the file's unit, counted upward, (n,)
    lands: bool  # whether an impact at the end was filmed
    # height from the middle of the picture's used part to its ends, where its distortion is taken as none
    reach: float = 0.0


def flights_of(clip: Clip, number: int = 0) -> list[Flight]:
    """Cut ``clip`` at its impacts.

    Raises `InputError` where there is no impact, or none with a flight after it that could be resolved.
    """
    t, h = clip.frame, clip.height
    low = _corrected(clip, impact_samples(clip))
    if not len(low):
        raise InputError(
            f"{clip.name}: no impact with a bounce after it among {len(t)} tracked frames; a bounce must last at least "
            f"{_LEAST_FLIGHT_FRAMES:.0f} frames to be measured: film faster or drop from higher"
        )
    parts = [Flight(number, 0, *_fall(t[: low[0]], h[: low[0]], clip.acceleration), True)]
    ends = [(int(stop), True) for stop in low[1:]] + [_end_of_last(clip, int(low[-1]))]
    for k, (start, (stop, lands)) in enumerate(zip(low, ends, strict=True)):
        frame, height = _inside(t[start + 1 : stop], h[start + 1 : stop])
        if len(frame) >= LEAST_SAMPLES:  # and it bends as free flight does; a ball at rest or in a hand does not
            s = frame - frame.mean()
            bend = -2.0 * float(np.polynomial.polynomial.polyfit(s, height, 2)[2])
            if 0.5 * clip.acceleration < bend < 2.0 * clip.acceleration:  # friction and a tilted picture stay inside
                parts.append(Flight(number, k + 1, frame, height, lands))
    return parts


def impact_samples(clip: Clip) -> Indices:
    """Samples at which the ball turns over as in an impact, before any correction by hand.

    The velocity turns over within a few frames; a hand that lifts the ball turns slowly.
    """
    t, h = clip.frame, clip.height
    least = max(clip.acceleration * (_LEAST_FLIGHT_FRAMES / 2.0) ** 2 / 2.0, 8.0 * jitter(h))
    low, _ = signal.find_peaks(-h, prominence=least)
    found: list[int] = []
    for i in low:
        before, after = slice(max(i - 5, 0), i), slice(i + 1, i + 6)
        if len(t[before]) < 3 or len(t[after]) < 3:
            continue
        down, up = np.polyfit(t[before], h[before], 1)[0], np.polyfit(t[after], h[after], 1)[0]
        # no ball leaves faster than it came; 30 % more, with the errors of both speeds, is a hand
        if down < 0.0 < up and up < 1.3 * -down + 1e-9:
            found.append(int(i))
        elif found:
            break  # whatever follows is not bouncing any more
    return np.array(found, dtype=np.intp)


def near_impacts(clip: Clip, frames: Floats) -> Bools:
    """Flags of those ``frames`` (n,) that mean an impact that was found."""
    found = clip.frame[impact_samples(clip)]
    off = np.abs(np.asarray(frames)[:, None] - found[None]).min(axis=1, initial=np.inf)
    return np.asarray(off <= _SAME_FRAMES)


def _corrected(clip: Clip, low: Indices) -> Indices:
    """Impacts without those that a person left out, and with those added."""
    gone = np.abs(clip.frame[low][:, None] - np.array(clip.no_impact)[None]).min(axis=1, initial=np.inf)
    added = [int(np.abs(clip.frame - when).argmin()) for when in clip.impact]
    inside = [i for i in added if 0 < i < len(clip.frame) - 1]
    return np.union1d(low[gone > _SAME_FRAMES], np.array(inside, dtype=np.intp))


def jitter(height: Floats) -> float:
    """Noise of single samples from third differences, which no smooth path survives."""
    third = np.diff(height, 3)
    return mad_sigma(third) / np.sqrt(20.0) if len(third) else 0.0


def _end_of_last(clip: Clip, start: int) -> tuple[int, bool]:
    """End of the last resolved flight (a sample), and whether it lands there: the first turn upward after its apex, a
    fifth more than the time a fall from there takes, or the end of the track.
    """
    t, h = clip.frame, clip.height
    top = start + 1
    while top + 1 < len(h) and h[top + 1] >= h[top]:
        top += 1
    stop = top + 1
    latest = t[top] + 1.2 * float(np.sqrt(2.0 * max(h[top] - h[start], 0.0) / clip.acceleration)) + 1.0
    while stop < len(h) and h[stop] < h[stop - 1] and t[stop] <= latest:
        stop += 1
    return stop - 1, stop < len(h)


def _fall(t: Floats, h: Floats, acceleration: float) -> tuple[Floats, Floats]:
    """The free part of the fall: from the impact backward as long as one parabola explains it."""
    start = len(t)
    while start > 0 and (start == len(t) or h[start - 1] > h[start]):
        start -= 1
    if len(t) - start < LEAST_SAMPLES:
        return t[start:], h[start:]
    first = len(t) - LEAST_SAMPLES
    noise = max(jitter(h[start:]), 5e-4 * float(np.ptp(h)), 0.01 * acceleration)
    for begin in range(len(t) - LEAST_SAMPLES, start - 1, -1):
        s = t[begin:] - t[-1]
        fit = np.polynomial.Polynomial.fit(s, h[begin:], 2)
        residual = h[begin:] - fit(s)
        released = float(fit.deriv()(s[0])) <= 0.5 * acceleration
        # no parabola: by three standard deviations over all, or by six where a hand may still hold the ball
        bent = np.sqrt((residual**2).mean()) > 3.0 * noise or abs(residual[:2]).max() > 6.0 * noise
        if not bent and released:
            first = begin
        elif len(t) - begin > 2 * LEAST_SAMPLES:
            break
    # a hand lets go gradually: the top 4 % of the fall are left out
    free = h[first:] < h[first] - 0.04 * (h[first] - h[-1])
    if free.sum() >= LEAST_SAMPLES:
        first += int(np.argmax(free))
    return _inside(t[first:], h[first:])


def _inside(t: Floats, h: Floats) -> tuple[Floats, Floats]:
    """A long flight without its samples next to the impacts: their exposure or the contact may straddle one."""
    return (t[1:-1], h[1:-1]) if len(t) >= 2 * LEAST_SAMPLES else (t, h)
