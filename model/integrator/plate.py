"""The plate in closed form: its tones, and a mode that is struck by impacts and loaded by a ball at rest."""

from __future__ import annotations

import math

import numpy as np

from model.integrator.hooks import plate_mode, rebound
from model.integrator.records import Plate, Probe, compiled

STEPS_PER_PERIOD = 16  # of the fastest tone that matters: the quintic then errs by less than a nanosecond
MINOR = 1e-3  # part of the largest displacement below which a tone needs no finer steps


@compiled
def tones_at(t: float, plate: Plate) -> tuple[float, float, float]:
    """Displacement, velocity and acceleration of the plate's tones at time t."""
    w, ar, ai = plate.omega, plate.re, plate.im
    x, v, a = 0.0, 0.0, 0.0
    for k in range(w.shape[0]):
        if ar[k] == 0.0 and ai[k] == 0.0:
            continue
        c, s = math.cos(w[k] * t), math.sin(w[k] * t)
        acc = ar[k] * c - ai[k] * s
        a += acc
        v += (ai[k] * c + ar[k] * s) / w[k]
        x -= acc / (w[k] * w[k])
    return x, v, a


@compiled
def step_length(period: float, plate: Plate) -> float:
    """Integration step: a fixed part of the period of the fastest tone that matters."""
    w, ar, ai = plate.omega, plate.re, plate.im
    largest = 0.0
    for k in range(w.shape[0]):
        largest = max(largest, math.hypot(ar[k], ai[k]) / (w[k] * w[k]))
    fastest = 2.0 * math.pi / period
    for k in range(w.shape[0]):
        if math.hypot(ar[k], ai[k]) / (w[k] * w[k]) > MINOR * largest:
            fastest = max(fastest, w[k])
    return 2.0 * math.pi / (fastest * STEPS_PER_PERIOD)


@compiled
def damped_oscillation(s: float, q: float, qd: float, om: float, ze: float) -> tuple[float, float, float]:
    """Displacement, velocity and acceleration of a free damped oscillator, s after the state (q, qd)."""
    if q == 0.0 and qd == 0.0:
        return 0.0, 0.0, 0.0
    od = om * math.sqrt(1.0 - ze * ze)
    decay = math.exp(-ze * om * s)
    c, sn = math.cos(od * s), math.sin(od * s)
    b = (qd + ze * om * q) / od
    x = decay * (q * c + b * sn)
    v = decay * (od * (b * c - q * sn)) - ze * om * x
    return x, v, -2.0 * ze * om * v - om * om * x


@compiled
def mode_at(s: float, plate: Plate) -> tuple[float, float, float]:
    """Displacement, velocity and acceleration of the plate mode, s after its state."""
    return damped_oscillation(s, plate.q, plate.qd, plate.mode_omega, plate.damping)


@compiled
def with_state(plate: Plate, q: float, qd: float) -> Plate:
    """The same plate, its mode in the state (q, qd)."""
    return Plate(plate.omega, plate.re, plate.im, q, qd, plate.mode_omega, plate.damping)


@compiled
def mode_at_rest(t: float, plate: Plate, p: np.ndarray) -> tuple[float, float, float]:
    """Plate mode under a ball that has long been resting on it: displacement, velocity and acceleration at time t.

    The ball presses with ``ratio (g + a)`` per mass of the mode, ``a`` being the whole acceleration of the plate.
    """
    om, ze, ratio = plate_mode(p)
    w, ar, ai = plate.omega, plate.re, plate.im
    x, v, a = -ratio * p[-1] / (om * om), 0.0, 0.0
    for k in range(w.shape[0]):
        if ar[k] == 0.0 and ai[k] == 0.0:
            continue
        stiff, loss = om * om - (1.0 + ratio) * w[k] * w[k], 2.0 * ze * om * w[k]
        size = -ratio / (stiff * stiff + loss * loss)
        qr, qi = size * (ar[k] * stiff + ai[k] * loss), size * (ai[k] * stiff - ar[k] * loss)
        c, s = math.cos(w[k] * t), math.sin(w[k] * t)
        here = qr * c - qi * s
        x += here
        v -= w[k] * (qi * c + qr * s)
        a -= w[k] * w[k] * here
    return x, v, a


@compiled
def loaded(t: float, plate: Plate, p: np.ndarray) -> Plate:
    """The same plate with a ball resting on it from time t on.

    What the ball presses out of the mode is part of the tones; the state is what rings beside.
    """
    ratio = plate_mode(p)[2]
    if ratio == 0.0:
        return plate
    w, ar, ai, q, qd, om, ze = plate
    x, v, _ = mode_at_rest(t, plate, p)
    lr, li = ar.copy(), ai.copy()
    for k in range(w.shape[0]):
        if ar[k] != 0.0 or ai[k] != 0.0:
            push = complex(om * om - (1.0 + ratio) * w[k] * w[k], 2.0 * ze * om * w[k])
            z = complex(ar[k], ai[k]) * (1.0 + ratio * w[k] * w[k] / push)
            lr[k], li[k] = z.real, z.imag
    root = math.sqrt(1.0 + ratio)
    return Plate(w, lr, li, q - x, qd - v, om / root, ze / root)


@compiled
def mode_under_ball(t: float, s: float, plate: Plate, p: np.ndarray) -> tuple[float, float]:
    """Displacement and velocity of the mode, s after its state at time t, the ball resting on it all the while."""
    om, ze, ratio = plate_mode(p)
    if ratio == 0.0:
        return 0.0, 0.0
    root = math.sqrt(1.0 + ratio)
    x0, v0, _ = mode_at_rest(t, plate, p)
    x1, v1, _ = mode_at_rest(t + s, plate, p)
    x, v, _ = damped_oscillation(s, plate.q - x0, plate.qd - v0, om / root, ze / root)
    return x + x1, v + v1


@compiled
def strike(plate: Plate, s: float, impact: float, p: np.ndarray) -> tuple[float, float]:
    """State of the plate mode just after an impact, s after its last state."""
    ratio = plate_mode(p)[2]
    if ratio == 0.0:
        return 0.0, 0.0
    x, v, _ = mode_at(s, plate)
    return x, v - ratio / (1.0 + ratio) * (1.0 + rebound(impact, p)) * impact


@compiled
def _integral(rate: complex, before: complex, after: complex, length: float) -> complex:
    """Integral of ``exp(rate t)`` over ``length`` from its values ``before`` and ``after``."""
    if abs(rate) * length < 1e-6:
        return 0.5 * length * (before + after)
    return (after - before) / rate


@compiled
def project_mode(t0: float, t1: float, resting: bool, plate: Plate, p: np.ndarray, probe: Probe, m: int) -> None:
    """Add to a probe's projections the plate mode from t0, its state there being that of ``plate``, to t1, in step m.

    A projection is the integral of the mode's acceleration times ``exp(-i w t)``, in closed form.
    """
    ratio = plate_mode(p)[2]
    w, ar, ai, q, qd, om, ze = plate
    x0, v0 = 0.0, 0.0
    if resting:
        root = math.sqrt(1.0 + ratio)
        x0, v0, _ = mode_at_rest(t0, plate, p)
        om, ze = om / root, ze / root
    decay = complex(-ze * om, om * math.sqrt(1.0 - ze * ze))
    size = complex(q - x0, -((qd - v0) + ze * om * (q - x0)) / decay.imag) * decay * decay
    first, last = probe.first[m], probe.first[m + 1]
    r = first + np.searchsorted(probe.span_s[first:last, 1], t0)
    while r < last and probe.span_s[r, 0] < t1:
        a, b = max(t0, probe.span_s[r, 0]), min(t1, probe.span_s[r, 1])
        probe.observed_s[r] += b - a
        free_a, free_b = size * np.exp(decay * (a - t0)), size * np.exp(decay * (b - t0))
        for k in range(probe.omega.shape[1]):
            back = complex(0.0, -probe.omega[m, k])
            at_a, at_b = np.exp(back * a), np.exp(back * b)
            total = _integral(decay + back, free_a * at_a, free_b * at_b, b - a)
            total += _integral(np.conj(decay) + back, np.conj(free_a) * at_a, np.conj(free_b) * at_b, b - a)
            for j in range(w.shape[0] if resting else 0):
                if ar[j] == 0.0 and ai[j] == 0.0:
                    continue
                stiff = (1.0 + ratio) * (om * om - w[j] * w[j])
                push = complex(stiff, 2.0 * ze * om * (1.0 + ratio) * w[j])
                answer = ratio * w[j] * w[j] * complex(ar[j], ai[j]) / push
                own = complex(0.0, w[j])
                own_a, own_b = answer * np.exp(own * a), answer * np.exp(own * b)
                total += _integral(own + back, own_a * at_a, own_b * at_b, b - a)
                total += _integral(back - own, np.conj(own_a) * at_a, np.conj(own_b) * at_b, b - a)
            probe.projection[r, k] += 0.5 * total
        r += 1
