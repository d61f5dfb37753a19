"""Impacts in the accelerometer that the contact circuit denies: it reads open, and the ball was high above the plate.

A knock on the bench or a glitch of the converter looks like an impact. The take-off decides: no ball leaves more slowly
than the plate, and a flight that ended at such an impact would have to. What friction does to a flight stays far below
what is taken for a contradiction. Decision 296.
"""

from __future__ import annotations

import numpy as np

from analysis.plate.motion import PlateMotion
from kernels.arrays import Bools, Complexes, Floats, Integers


def denied(
    plate: PlateMotion,
    g_mps2: float,
    takeoff_s: Floats,
    landing_s: Floats,
    step: Integers,
    impact_s: Floats,
    host: Integers,
) -> Bools:
    """Whether the flight that an impact would end did not end there: no ball can have left so slowly.

    Parameters
    ----------
    plate : PlateMotion
    g_mps2 : float
        Local gravity.
    takeoff_s, landing_s : arrays, shape (n,)
        Intervals in the air by the contact circuit.
    step : int array, shape (n,)
        Step of each interval; -1 where the plate's motion is not that of a step.
    impact_s : array, shape (m,)
        Impacts within intervals, in order.
    host : int array, shape (m,)
        The interval of each impact.

    Returns
    -------
    bool array, shape (m,)
    """
    left = np.arange(impact_s.size)
    while left.size:
        own, time_s = host[left], impact_s[left]
        first, last = np.diff(own, prepend=-1) != 0, np.diff(own, append=-1) != 0
        begin_s = np.where(first, takeoff_s[own], np.roll(time_s, 1))
        whole_s = np.where(last, landing_s[own], np.roll(time_s, -1))
        slow = np.flatnonzero(_too_slow(plate, g_mps2, step[own], begin_s, time_s, whole_s))
        # only the first of an interval: without it, those after it may be right
        slow = slow[np.diff(own[slow], prepend=-1) != 0]
        if not slow.size:
            break
        left = np.delete(left, slow)
    out = np.ones(impact_s.size, dtype=np.bool_)
    out[left] = False
    return out


def _too_slow(
    plate: PlateMotion, g_mps2: float, step: Integers, begin_s: Floats, impact_s: Floats, whole_s: Floats
) -> Bools:
    """Whether a flight that began at a time and ended at an impact must have begun more slowly than the plate.

    Where the flight would have begun slowly even if it ended at ``whole_s``, something else is wrong.
    """
    omega, z = plate.forcing_tones(step)
    moving = omega > 0.0
    place = np.where(moving, -z / np.where(moving, omega, 1.0) ** 2, 0.0)

    def shown(time_s: Floats) -> Complexes:
        return np.asarray(place * np.exp(1j * np.where(moving, omega, 0.0) * plate.true_time_s(time_s)))

    begin = shown(begin_s)
    leaves_mps = (1j * np.where(moving, omega, 0.0) * begin).real.sum(axis=0)

    def start_mps(end_s: Floats) -> Floats:
        """Velocity of a free flight to ``end_s`` at its start, relative to the plate."""
        lasted_s = np.maximum(end_s - begin_s, 1e-9)
        rise_m = (shown(end_s) - begin).real.sum(axis=0)
        return np.asarray(rise_m / lasted_s + 0.5 * g_mps2 * lasted_s - leaves_mps)

    usual = 0.5 * g_mps2 * (impact_s - begin_s)
    # twice as far below the plate as the whole flight's, 0.3 of a free flight's (a friction of 0.5 g makes 0.1), and 3
    # cm/s
    least = np.maximum(np.maximum(-2.0 * start_mps(whole_s), 0.3 * usual), 0.03)
    return np.asarray((step >= 0) & moving.any(axis=0) & (start_mps(impact_s) < -least))
