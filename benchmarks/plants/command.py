"""What a drive asks of a plate: two tones whose level goes from step to step in a quintic fade."""

from __future__ import annotations

import math

import numpy as np

from kernels import njit

G = 9.80665


@njit()
def level_at(gammas, step_s, fade_s, t):
    """Amplitude level and its first two time derivatives: a quintic fade at the start of each step."""
    k = min(int(t / step_s), gammas.size - 1)
    before = gammas[k - 1] if k > 0 else 0.0
    x = (t - k * step_s) / fade_s
    if x >= 1.0:
        return gammas[k], 0.0, 0.0
    rise = gammas[k] - before
    value = x * x * x * (10.0 + x * (6.0 * x - 15.0))
    first = 30.0 * x * x * (1.0 - x) ** 2
    second = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x)
    return before + rise * value, rise * first / fade_s, rise * second / fade_s**2


@njit()
def tones(w, c, t):
    """The waveform sin wt + sin cwt and its first two time derivatives."""
    a, b = w * t, c * w * t
    sa, sb = math.sin(a), math.sin(b)
    return sa + sb, w * (math.cos(a) + c * math.cos(b)), -w * w * (sa + c * c * sb)


@njit()
def commanded(gammas, step_s, fade_s, w, c, t):
    """Displacement, velocity and acceleration asked of the plate, SI."""
    if t < 0.0:
        return 0.0, 0.0, 0.0
    level, d_level, dd_level = level_at(gammas, step_s, fade_s, t)
    s, ds, dds = tones(w, c, t)
    unit = G / (w * w)
    return (
        unit * level * s,
        unit * (d_level * s + level * ds),
        unit * (dd_level * s + 2.0 * d_level * ds + level * dds),
    )


@njit()
def commands(gammas, step_s, fade_s, w, c, time_s):
    """Commanded acceleration at each sample."""
    out = np.empty(time_s.size)
    for k in range(time_s.size):
        out[k] = commanded(gammas, step_s, fade_s, w, c, time_s[k])[2]
    return out
