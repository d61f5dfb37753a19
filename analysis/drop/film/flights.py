"""A tracked ball cut into flights: the fall, and the flight after each impact.

A flight is what lies between two impacts and has enough samples to be a curve; everything else (hand, rest, bounces of
a few frames) is left out and not guessed at.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from analysis.statistics import mad_sigma
from daq.setup.errors import InputError
from kernels.arrays import Bools, Floats

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
