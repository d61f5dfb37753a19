"""The plate's motion in lanes, and the root that a branch of a flight holds, from one sine and cosine a step.

The harmonics are whole numbers, so ``sin n phi`` and ``cos n phi`` are powers of ``cos phi + i sin phi``: to
``n`` roundings, as the product ``n phi`` is. The root is begun where the polynomial of fifth degree has it that takes
h, h' and h'' at both ends of its bracket, and ends with Householder steps of third order.
"""

from __future__ import annotations

from typing import Any

from kernels.arrays import Floats
from kernels.lanes import any_of, select, size
from model.flight.numerics import C4, C6, C8, S3, S5, S7, Number, inlined, sincos

PLAIN_GRAZE = 1e-9  # heights nearer to the plate than this are left to the kernels of one flight
NEAR = 0.05  # radians over which `turned` is exact to rounding
CONVERGED = 1e-5  # a last step smaller than this leaves an error of its fourth power


@inlined
def plate(tones: Floats, x: Number) -> Any:
    """``s, s', q = -s'', q', -q''`` at ``x``; of harmonics that are whole numbers."""
    return plate_at(tones, sincos(x))


@inlined
def plate_at(tones: Floats, angle: tuple[Number, Number]) -> Any:
    """`plate` at the phase whose sine and cosine are given."""
    sine, cosine = angle
    zero = 0.0 * sine
    s, slope, q, jerk, snap = zero, zero, zero, zero, zero
    for j in range(tones.shape[0]):
        n, b = tones[j, 0], tones[j, 1]
        im, re = sine, cosine
        if n != 1.0:
            im, re = _power(n, sine, cosine)
        if tones[j, 2] != 0.0:
            sine_p, cosine_p = sincos(tones[j, 2])
            im, re = im * cosine_p + re * sine_p, re * cosine_p - im * sine_p
        n2 = n * n
        im, re = b * im, (b * n) * re
        s, slope, q, jerk, snap = s + im, slope + re, q + n2 * im, jerk + n2 * re, snap + (n2 * n2) * im
    return s, slope, q, jerk, snap


@inlined
def _power(n: float, sine: Number, cosine: Number) -> tuple[Number, Number]:
    """``sin n phi`` and ``cos n phi`` by squaring."""
    left = int(n)
    im, re = 0.0 * sine, 0.0 * cosine + 1.0
    while True:
        if left % 2 == 1:
            im, re = re * sine + im * cosine, re * cosine - im * sine
        left //= 2
        if left == 0:
            break
        sine, cosine = 2.0 * sine * cosine, (cosine - sine) * (cosine + sine)
    return im, re


@inlined
def turned(angle: tuple[Number, Number], d: Number) -> tuple[Number, Number]:
    """Sine and cosine of a phase on by ``d``, at most `NEAR`: cheaper than from the phase."""
    sine, cosine = angle
    y = d * d
    sin_d = d + d * y * (S3 + y * (S5 + y * S7))
    off = y * (-0.5 + y * (C4 + y * (C6 + y * C8)))  # cos d - 1
    return sine + (sine * off + cosine * sin_d), cosine + (cosine * off - sine * sin_d)


@inlined
def start_of_root(left: Any, right: Any, guess: Number) -> Number:
    """Where the polynomial through ``left`` and ``right`` (phase, h, h', h'') vanishes.

    ``guess`` is a place between; a step that leaves the bracket is not taken.
    """
    lo, h, h1, h2 = left
    hi, g, g1, g2 = right
    w = hi - lo
    a1, a2 = w * h1, 0.5 * w * w * h2
    # what is left of h, h' and h'' at the far end
    r, r1, r2 = g - (h + a1 + a2), w * g1 - (a1 + 2.0 * a2), w * w * g2 - 2.0 * a2
    a3 = 10.0 * r - 4.0 * r1 + 0.5 * r2
    a4 = -15.0 * r + 7.0 * r1 - r2
    a5 = 6.0 * r - 3.0 * r1 + 0.5 * r2
    u = (guess - lo) / w
    for _ in range(2):
        f = h + u * (a1 + u * (a2 + u * (a3 + u * (a4 + u * a5))))
        f1 = a1 + u * (2.0 * a2 + u * (3.0 * a3 + u * (4.0 * a4 + u * (5.0 * a5))))
        f2 = 2.0 * a2 + u * (6.0 * a3 + u * (12.0 * a4 + u * (20.0 * a5)))
        new = u - 2.0 * f * f1 / (2.0 * f1 * f1 - f * f2)
        u = select((new > 0.0) & (new < 1.0), new, u)
    return lo + w * u


@inlined
def _heights(gamma: Number, take_off: Any, x: Number, motion: Any) -> Any:
    """h and its four derivatives at ``x``, where the plate's ``motion`` (`plate`) is given."""
    phi0, s0, slope0, v0, h0, level = take_off
    s, slope, q, jerk, snap = motion
    t = x - phi0
    h = h0 + gamma * (s0 + slope0 * t - s) + t * (v0 - 0.5 * level * t)
    return h, gamma * (slope0 - slope) + v0 - level * t, gamma * q - level, gamma * jerk, -gamma * snap


@inlined
def root_in_branch(
    tones: Floats, gamma: Number, take_off: Any, bracket: Any, x: Number, of_speed: bool, away: Any
) -> Any:  # fmt: skip
    """The one root of ``h``, or ``of_speed`` ``h'``, in the bracket of every lane that is ``away`` from it.

    From a good start, by steps of third order; for a standstill one of Halley's comes before, for which the sine and
    cosine are turned. Seldom must any lane do so twice. Returns phase, (h, h', s, s', q) there, lanes that have not
    converged. ``take_off`` is the start of the segment: its phase (less the turns since), s and s' there, speed, height
    and pull; ``x`` is where to begin.
    """
    lo, hi = bracket
    end = (x, x, x, x, x)
    # two rounds are taken mostly
    for _ in range(8):
        near = x
        angle = sincos(x)
        if of_speed:  # for ``h`` the start is so good that it would cost more than it saves
            heights = _heights(gamma, take_off, x, plate_at(tones, angle))
            f, f1, f2 = heights[1:4]
            new = x - 2.0 * f * f1 / (2.0 * f1 * f1 - f * f2)
            d = select((new > lo) & (new <= hi) & (size(new - x) <= NEAR), new - x, 0.0)
            near = x + d
            angle = turned(angle, d)
        s, slope, q, jerk, snap = plate_at(tones, angle)
        heights = _heights(gamma, take_off, near, (s, slope, q, jerk, snap))
        f, f1, f2, f3 = heights[1:] if of_speed else heights[:4]
        g = f1 * f1
        # Householder's third-order step: the error left is the fourth power of it
        step = 3.0 * f * (2.0 * g - f * f2) / (6.0 * f1 * (g - f * f2) + f * f * f3)
        new = near - step
        inside = (new > lo) & (new <= hi)
        gentle = (size(step) <= CONVERGED) & (size(step * f2) <= CONVERGED * size(f1))
        h, h1, h2, h3, h4 = heights
        third, half = step * (1.0 / 3.0), 0.5 * step
        # the state at the new phase by Taylor from the old one: no second sine and cosine
        there = (
            h - step * (h1 - half * (h2 - third * h3)),
            h1 - step * (h2 - half * (h3 - third * h4)),
            s - step * (slope + half * (q - third * jerk)),
            slope + step * (q - half * (jerk + third * snap)),
            q - step * (jerk + half * snap),
        )
        end = select(away, there, end)
        x = select(away, select(inside, new, select(new > hi, 0.5 * (near + hi), 0.5 * (near + lo))), x)
        away = away & ~(inside & gentle)
        if not any_of(away):
            break
    return x, end, away
