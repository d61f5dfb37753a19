"""The plate in closed form: its tones, and a mode that is struck by impacts and loaded by a ball at rest."""

from __future__ import annotations

import math

import numpy as np

from kernels.arrays import Floats
from model.flight.numerics import sincos
from model.integrator.problem import Mode, Plate, Probe, SecondMode, compiled, inlined, plate_mode, rebound

STEPS_PER_PERIOD = 16  # of the fastest tone that matters: the quintic then errs by less than a nanosecond
SHORT_TURN = 0.3  # rad: the next terms of the series in `_short_turn` are below 1e-16


@compiled
def tones_at(t: float, tones: Floats) -> tuple[float, float, float]:
    """Displacement, velocity and acceleration of the plate's tones at time t."""
    x, v, a = 0.0, 0.0, 0.0
    for k in range(tones.shape[0]):
        if tones[k, 1] == 0.0 and tones[k, 2] == 0.0:
            continue
        s, c = sincos(tones[k, 0] * t)
        acc, slow = tones[k, 1] * c - tones[k, 2] * s, 1.0 / tones[k, 0]
        a += acc
        v += (tones[k, 2] * c + tones[k, 1] * s) * slow
        x -= acc * (slow * slow)
    return x, v, a


@inlined
def _short_turn(angle: float) -> tuple[float, float]:
    """Cosine and sine; of an angle as small as a step's from their series, to the last bit but one."""
    y = angle * angle
    if y > SHORT_TURN * SHORT_TURN:
        sine, cosine = sincos(angle)
        return cosine, sine
    c = 1.0 - y * (1 / 2 - y * (1 / 24 - y * (1 / 720 - y * (1 / 40320 - y * (1 / 3628800 - y / 479001600)))))
    s = 1.0 - y * (1 / 6 - y * (1 / 120 - y * (1 / 5040 - y * (1 / 362880 - y / 39916800))))
    return c, s * angle


@inlined
def _start_ringing(row: int, s: float, d: float, free: tuple[float, float, float, float], turning: Floats) -> None:
    """A free oscillation s after its state as a decaying phasor, whose real part is the displacement."""
    q, qd, om, ze = free
    turning[row, 0], turning[row, 1] = 0.0, 0.0  # not by a slice: that takes seconds to compile
    if q != 0.0 or qd != 0.0:
        od = om * math.sqrt(1.0 - ze * ze)
        back, on = math.exp(-ze * om * s), math.exp(-ze * om * d)
        b, (sn, c), (turn_s, turn_c) = -(qd + ze * om * q) / od, sincos(od * s), sincos(od * d)
        turning[row, 0], turning[row, 1] = back * (q * c - b * sn), back * (b * c + q * sn)
        turning[row, 2], turning[row, 3] = on * turn_c, on * turn_s
        turning[row, 4], turning[row, 5] = -ze * om, od


@compiled
def start_turning(t: float, s: float, d: float, tones: Floats, mode: Mode, turning: Floats) -> int:
    """Phasors of what moves at time t, s after the mode's state, and their turns in a time d; how many they are.

    ``turning`` (k + 2, 6) holds each phasor, its turn, and what gives velocity and displacement: nodes of an even grid
    then need no trigonometry. The first two are displacements of the second mode and of the mode, zero where none is.
    """
    q, qd, om, ze, second = mode
    _start_ringing(0, t - second.t, d, (second.q, second.qd, second.omega, second.damping), turning)
    _start_ringing(1, s, d, (q, qd, om, ze), turning)
    n = 2
    for k in range(tones.shape[0]):
        om, re, im = tones[k, 0], tones[k, 1], tones[k, 2]
        if re == 0.0 and im == 0.0:
            continue
        sn, c = sincos(om * t)
        turning[n, 0], turning[n, 1] = re * c - im * sn, im * c + re * sn
        turning[n, 2], turning[n, 3] = _short_turn(om * d)
        slow = 1.0 / om
        turning[n, 4], turning[n, 5] = slow, slow * slow
        n += 1
    return n


@inlined
def _turn(k: int, turning: Floats) -> tuple[float, float]:
    """One more turn of a phasor."""
    re, im, c, s = turning[k, 0], turning[k, 1], turning[k, 2], turning[k, 3]
    re, im = re * c - im * s, im * c + re * s
    turning[k, 0], turning[k, 1] = re, im
    return re, im


@inlined
def _first_ringing(turning: Floats) -> int:
    """The first phasor of a mode that rings, 2 where none does."""
    if turning[0, 0] != 0.0 or turning[0, 1] != 0.0:
        return 0
    return 1 if turning[1, 0] != 0.0 or turning[1, 1] != 0.0 else 2


@inlined
def _rung(turning: Floats) -> tuple[float, float, float]:
    """Displacement, velocity and acceleration of the modes that ring."""
    x, v, a = 0.0, 0.0, 0.0
    for k in range(_first_ringing(turning), 2):
        re, im, fades, od = turning[k, 0], turning[k, 1], turning[k, 4], turning[k, 5]
        rate = fades * re - od * im
        x += re
        v += rate
        a += 2.0 * fades * rate - (fades * fades + od * od) * re
    return x, v, a


@inlined
def motion(n: int, turning: Floats) -> tuple[float, float, float]:
    """Displacement, velocity and acceleration of tones and mode where the phasors of ``turning`` stand."""
    x, v, a = _rung(turning)
    for k in range(2, n):
        re, im = turning[k, 0], turning[k, 1]
        a += re
        v += im * turning[k, 4]
        x -= re * turning[k, 5]
    return x, v, a


@inlined
def turned(n: int, turning: Floats) -> tuple[float, float, float]:
    """`motion` after one more turn of ``turning``."""
    for k in range(_first_ringing(turning), 2):
        _turn(k, turning)
    x, v, a = _rung(turning)
    for k in range(2, n):  # turned and added at once: most of the time of a flight goes here
        re, im = _turn(k, turning)
        a += re
        v += im * turning[k, 4]
        x -= re * turning[k, 5]
    return x, v, a


@inlined
def turn_twice_as_far(n: int, turning: Floats) -> None:
    """Double the time of a turn."""
    for k in range(n):
        c, s = turning[k, 2], turning[k, 3]
        turning[k, 2], turning[k, 3] = c * c - s * s, 2.0 * s * c


@compiled
def step_length(period: float, tones: Floats) -> float:
    """Integration step: a fixed part of the period of the fastest tone that matters."""
    largest = 0.0
    for k in range(tones.shape[0]):
        largest = max(largest, math.hypot(tones[k, 1], tones[k, 2]) / (tones[k, 0] * tones[k, 0]))
    fastest = 2.0 * math.pi / period
    for k in range(tones.shape[0]):
        # a tone of less than 1e-3 of the largest displacement needs no finer steps
        if math.hypot(tones[k, 1], tones[k, 2]) / (tones[k, 0] * tones[k, 0]) > 1e-3 * largest:
            fastest = max(fastest, tones[k, 0])
    return 2.0 * math.pi / (fastest * STEPS_PER_PERIOD)


@compiled
def between_steps(every: Floats, m: int, other: int, share: float, tones: Floats) -> None:
    """Fill ``tones`` (k, 3) with those of step ``m``, a ``share`` replaced by the step ``other`` (-1: at rest)."""
    for k in range(tones.shape[0]):
        om, re, im = every[m, k, 0], (1.0 - share) * every[m, k, 1], (1.0 - share) * every[m, k, 2]
        for j in range(tones.shape[0] if other >= 0 and share > 0.0 else 0):
            # frequencies that differ by less than 1e-6 are one
            if abs(every[other, j, 0] - om) < 1e-6 * om:
                re, im = re + share * every[other, j, 1], im + share * every[other, j, 2]
                break
        tones[k, 0], tones[k, 1], tones[k, 2] = om, re, im


@compiled
def correct(tones: Floats, part: float, ahead_s: float) -> None:
    """Make the tones (k, 3) greater by ``part``, their motion earlier by ``ahead_s``."""
    for k in range(tones.shape[0]):
        (s, c), (re, im) = sincos(tones[k, 0] * ahead_s), (tones[k, 1], tones[k, 2])
        tones[k, 1], tones[k, 2] = (1.0 + part) * (c * re - s * im), (1.0 + part) * (s * re + c * im)


@compiled
def mode_at(s: float, mode: Mode) -> tuple[float, float, float]:
    """Displacement, velocity and acceleration of the plate mode, s after its state, without the second one."""
    q, qd, om, ze, _ = mode
    if q == 0.0 and qd == 0.0:
        return 0.0, 0.0, 0.0
    od = om * math.sqrt(1.0 - ze * ze)
    decay = math.exp(-ze * om * s)
    sn, c = sincos(od * s)
    b = (qd + ze * om * q) / od
    x = decay * (q * c + b * sn)
    v = decay * (od * (b * c - q * sn)) - ze * om * x
    return x, v, -2.0 * ze * om * v - om * om * x


@inlined
def ringing_at(t: float, s: float, mode: Mode) -> tuple[float, float, float]:
    """`mode_at` with the second mode at time t."""
    x, v, a = mode_at(s, mode)
    second = mode.second
    if second.q == 0.0 and second.qd == 0.0:
        return x, v, a
    free = Mode(second.q, second.qd, second.omega, second.damping, second)
    more_x, more_v, more_a = mode_at(t - second.t, free)
    return x + more_x, v + more_v, a + more_a


@compiled
def in_state(mode: Mode, q: float, qd: float) -> Mode:
    """The same mode, in the state (q, qd)."""
    return Mode(q, qd, mode.omega, mode.damping, mode.second)


@inlined
def _exp(z: complex) -> complex:
    """``exp(z)``; numpy's own takes long to compile."""
    s, c = sincos(z.imag)
    return math.exp(z.real) * complex(c, s)


@inlined
def _second_under_ball(second: SecondMode, p: Floats) -> tuple[complex, complex, complex]:
    """Displacement and rate of the second mode as a decaying phasor; by which part a ball answers there.

    The ball rests on both: its inertia under that motion moves the mode by this part of it.
    """
    om, ze, ratio = plate_mode(p)
    od = second.omega * math.sqrt(1.0 - second.damping * second.damping)
    rate = complex(-second.damping * second.omega, od)
    size = complex(second.q, (rate.real * second.q - second.qd) / od)
    return size, rate, -ratio * rate * rate / ((1.0 + ratio) * rate * rate + 2.0 * ze * om * rate + om * om)


@compiled
def mode_at_rest(t: float, plate: Plate, p: Floats) -> tuple[float, float, float]:
    """Plate mode under a ball that has long been resting on it: displacement, velocity and acceleration at time t.

    The ball presses with ``ratio (g + a)`` per mass of the mode, ``a`` being the whole acceleration of the plate.
    """
    om, ze, ratio = plate_mode(p)
    tones, second = plate.tones, plate.mode.second
    x, v, a = -ratio * p[-1] / (om * om), 0.0, 0.0
    if second.q != 0.0 or second.qd != 0.0:
        size, rate, part = _second_under_ball(second, p)
        z = part * size * _exp(rate * (t - second.t))
        x, v, a = x + z.real, (rate * z).real, (rate * rate * z).real
    for k in range(tones.shape[0]):
        if tones[k, 1] == 0.0 and tones[k, 2] == 0.0:
            continue
        # q'' + 2 z w q' + w^2 q = -ratio (g + a): the ball's inertia adds to the mode's, its weight presses it down
        stiff, loss = om * om - (1.0 + ratio) * tones[k, 0] * tones[k, 0], 2.0 * ze * om * tones[k, 0]
        size = -ratio / (stiff * stiff + loss * loss)
        qr, qi = size * (tones[k, 1] * stiff + tones[k, 2] * loss), size * (tones[k, 2] * stiff - tones[k, 1] * loss)
        s, c = sincos(tones[k, 0] * t)
        here = qr * c - qi * s
        x += here
        v -= tones[k, 0] * (qi * c + qr * s)
        a -= tones[k, 0] * tones[k, 0] * here
    return x, v, a


@compiled
def loaded(t: float, plate: Plate, p: Floats, under: Floats) -> Mode:
    """The mode with a ball resting on it from time t on; ``under`` (k, 3) gets the tones of the plate then.

    What the ball presses out of the mode is part of the tones; the state is what rings besides. A kernel that returned
    arrays would have each reference to one counted, in all that call it, too.
    """
    ratio = plate_mode(p)[2]
    tones, (q, qd, om, ze, second) = plate
    for k in range(tones.shape[0]):
        under[k, 0], under[k, 1], under[k, 2] = tones[k, 0], tones[k, 1], tones[k, 2]
    if ratio == 0.0:
        return plate.mode
    x, v, _ = mode_at_rest(t, plate, p)
    if second.q != 0.0 or second.qd != 0.0:
        size, rate, part = _second_under_ball(second, p)
        z = size * (1.0 + part)
        second = SecondMode(second.t, z.real, (rate * z).real, second.omega, second.damping)
    for k in range(tones.shape[0]):
        if tones[k, 1] != 0.0 or tones[k, 2] != 0.0:
            # the plate's tone as it moves, the mode's forced answer included
            push = complex(om * om - (1.0 + ratio) * tones[k, 0] * tones[k, 0], 2.0 * ze * om * tones[k, 0])
            z = complex(tones[k, 1], tones[k, 2]) * (1.0 + ratio * tones[k, 0] * tones[k, 0] / push)
            under[k, 1], under[k, 2] = z.real, z.imag
    root = math.sqrt(1.0 + ratio)
    return Mode(q - x, qd - v, om / root, ze / root, second)


@compiled
def mode_under_ball(t: float, s: float, plate: Plate, p: Floats) -> tuple[float, float]:
    """Displacement and velocity of the mode, s after its state at time t, the ball resting on it all the while."""
    om, ze, ratio = plate_mode(p)
    if ratio == 0.0:
        return 0.0, 0.0
    mode = plate.mode
    if s == 0.0:  # a ball that bounces
        return mode.q, mode.qd
    root = math.sqrt(1.0 + ratio)
    x0, v0, _ = mode_at_rest(t, plate, p)
    x1, v1, _ = mode_at_rest(t + s, plate, p)
    x, v, _ = mode_at(s, Mode(mode.q - x0, mode.qd - v0, om / root, ze / root, mode.second))
    return x + x1, v + v1


@compiled
def strike(mode: Mode, s: float, impact: float, p: Floats) -> tuple[float, float]:
    """State of the plate mode just after an impact, s after its last state."""
    ratio = plate_mode(p)[2]
    if ratio == 0.0:
        return 0.0, 0.0
    x, v, _ = mode_at(s, mode)
    # momentum: both masses share the impact, and the ball leaves with the restitution's part of it
    return x, v - ratio / (1.0 + ratio) * (1.0 + rebound(impact, p)) * impact


@inlined
def _conjugate(z: complex) -> complex:
    return complex(z.real, -z.imag)


@compiled
def _first_ending_after(t: float, span_s: Floats, first: int, last: int) -> int:
    """The first of the intervals ``span_s[first:last]``, in order, that does not end before t."""
    while first < last:
        middle = (first + last) // 2
        if span_s[middle, 1] < t:
            first = middle + 1
        else:
            last = middle
    return first


@inlined
def _integral(rate: complex, before: complex, after: complex, length: float) -> complex:
    """Integral of ``exp(rate t)`` over ``length`` from its values ``before`` and ``after``."""
    size = rate.real * rate.real + rate.imag * rate.imag  # a quotient of complex numbers takes longer
    if size * length * length < 1e-12:
        return 0.5 * length * (before + after)
    return (after - before) * _conjugate(rate) * (1.0 / size)


@compiled
def project_mode(t0: float, t1: float, resting: bool, plate: Plate, p: Floats, probe: Probe, m: int) -> None:
    """Add to a probe's projections the plate mode from t0, its state there being that of ``plate``, to t1, in step m.

    A projection is the integral of the mode's acceleration times ``exp(-i w t)``, in closed form.
    """
    ratio = plate_mode(p)[2]
    tones, (q, qd, om, ze, _) = plate
    x0, v0 = 0.0, 0.0
    if resting:
        root = math.sqrt(1.0 + ratio)
        x0, v0, _ = mode_at_rest(t0, plate, p)
        om, ze = om / root, ze / root
    decay = complex(-ze * om, om * math.sqrt(1.0 - ze * ze))
    # the mode's acceleration is the real part of size exp(decay t)
    size = complex(q - x0, -((qd - v0) + ze * om * (q - x0)) / decay.imag) * decay * decay
    firsts, span_s, omega, projection, observed_s = probe
    first, last = firsts[m], firsts[m + 1]
    r = _first_ending_after(t0, span_s, first, last)
    own, ends = np.empty((tones.shape[0], 2), np.complex128), np.empty((tones.shape[0], 2), np.complex128)
    moving = 0  # tones that press on the mode through the ball, their rates and what they answer
    for j in range(tones.shape[0] if resting else 0):
        if tones[j, 1] == 0.0 and tones[j, 2] == 0.0:
            continue
        stiff = (1.0 + ratio) * (om * om - tones[j, 0] * tones[j, 0])
        push = complex(stiff, 2.0 * ze * om * (1.0 + ratio) * tones[j, 0])
        own[moving, 0] = complex(0.0, tones[j, 0])
        own[moving, 1] = ratio * tones[j, 0] * tones[j, 0] * complex(tones[j, 1], tones[j, 2]) / push
        moving += 1
    while r < last and span_s[r, 0] < t1:
        a, b = max(t0, span_s[r, 0]), min(t1, span_s[r, 1])
        observed_s[r] += b - a
        free_a, free_b = size * _exp(decay * (a - t0)), size * _exp(decay * (b - t0))
        for j in range(moving):
            ends[j, 0], ends[j, 1] = own[j, 1] * _exp(own[j, 0] * a), own[j, 1] * _exp(own[j, 0] * b)
        for k in range(omega.shape[1]):
            back = complex(0.0, -omega[m, k])
            at_a, at_b = _exp(back * a), _exp(back * b)
            total = _integral(decay + back, free_a * at_a, free_b * at_b, b - a)
            total += _integral(_conjugate(decay) + back, _conjugate(free_a) * at_a, _conjugate(free_b) * at_b, b - a)
            for j in range(moving):
                turn, own_a, own_b = own[j, 0], ends[j, 0], ends[j, 1]
                total += _integral(turn + back, own_a * at_a, own_b * at_b, b - a)
                total += _integral(back - turn, _conjugate(own_a) * at_a, _conjugate(own_b) * at_b, b - a)
            projection[r, k] += 0.5 * total
        r += 1
