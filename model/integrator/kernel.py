"""One flight after another with any set of effects, in SI units, by numerical integration: the compiled part.

The rule kept here: what is known in closed form (gravity, the plate's tones, the ring of a plate mode) is never
integrated; Runge-Kutta carries only the deviation that forces and friction add, and impacts and standstills are
found on quintic and cubic Hermite polynomials of the whole motion.

This file is a template: `model.integrator.one_step` compiles its text behind a header that composes the hooks of all
effects (`force`, `dry`, `hold`, `rebound`, `mode`), so that an effect costs a file and no edit here. The hooks below
stand for "no effect", which also lets this file be imported and checked by itself.
"""

# mypy: ignore-errors
from __future__ import annotations

import math

import numpy as np

from kernels import njit


@njit(error_model="numpy")
def force(s, h, v, u, p):
    """Sum of the effects' accelerations, m/s^2."""
    return 0.0


@njit(error_model="numpy")
def dry(h, speed, direction, p):
    """Sum of dry frictions, m/s^2."""
    return 0.0


@njit(error_model="numpy")
def hold(dwell_s, p):
    """Sum of take-off thresholds, m/s^2."""
    return 0.0


@njit(error_model="numpy")
def rebound(v, p):
    """Coefficient of restitution at impact speed v."""
    return 0.0


@njit(error_model="numpy")
def mode(p):
    """Plate mode struck by impacts: omega, damping, mass ratio."""
    return 1.0, 0.0, 0.0


# ---- kernel ----
STEPS_PER_PERIOD = 16  # of the fastest tone that matters: the quintic then errs by less than a nanosecond
MINOR = 1e-3  # a tone of less than this part of the largest displacement needs no finer steps
FIRST_STEP_PART = 1.0 / 16.0  # of a full step, so that tiny flights and the opening of the contact are resolved
WAIT_PARTS = 3  # a ball at rest is looked at so many times more often: thresholds are passed for short moments
LONGEST_PERIODS = 60.0
TAIL_PART = 2e-4  # a bounce shorter than this part of a period begins the tail of a chatter, summed in closed form
MOST_BOUNCES = 400
MOST_SECANTS = 40
UNRESOLVED_PART = 0.2  # of the time between impacts that are one: how well it is known which one counts
RESOLVED_S = 8e-5  # impacts closer together are one to the contact circuit: which one it was is no free choice
NO_PULL_MPS2 = 1e-9  # a threshold met so closely is met: within a picosecond of the slowest forcing


@njit(error_model="numpy")
def plate(t, w, ar, ai):
    """Displacement, velocity and acceleration of the plate's tones at time t."""
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


@njit(error_model="numpy")
def pace(period, w, ar, ai):
    """Integration step: a fixed part of the period of the fastest tone that matters."""
    largest = 0.0
    for k in range(w.shape[0]):
        largest = max(largest, math.hypot(ar[k], ai[k]) / (w[k] * w[k]))
    fastest = 2.0 * math.pi / period
    for k in range(w.shape[0]):
        if math.hypot(ar[k], ai[k]) / (w[k] * w[k]) > MINOR * largest:
            fastest = max(fastest, w[k])
    return 2.0 * math.pi / (fastest * STEPS_PER_PERIOD)


@njit(error_model="numpy")
def ring(s, q, qd, om, ze):
    """Displacement, velocity and acceleration of the plate mode, s after the state (q, qd)."""
    if q == 0.0 and qd == 0.0:
        return 0.0, 0.0, 0.0
    od = om * math.sqrt(1.0 - ze * ze)
    decay = math.exp(-ze * om * s)
    c, sn = math.cos(od * s), math.sin(od * s)
    b = (qd + ze * om * q) / od
    x = decay * (q * c + b * sn)
    v = decay * (od * (b * c - q * sn)) - ze * om * x
    return x, v, -2.0 * ze * om * v - om * om * x


@njit(error_model="numpy")
def settled(t, w, ar, ai, p):
    """Plate mode under a ball that has long been resting on it: displacement, velocity and acceleration at time t.

    The ball presses with ``ratio (g + a)`` per mass of the mode, ``a`` being the whole acceleration of the plate.
    """
    om, ze, ratio = mode(p)
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


@njit(error_model="numpy")
def loaded(t, q, qd, om, ze, w, ar, ai, p):
    """The same plate with a ball resting on it from time t on: state, pitch and damping of the mode, and tones.

    What the ball presses out of the mode is part of the tones; the state is what rings beside.
    """
    ratio = mode(p)[2]
    if ratio == 0.0:
        return q, qd, om, ze, ar, ai
    x, v, _ = settled(t, w, ar, ai, p)
    lr, li = ar.copy(), ai.copy()
    for k in range(w.shape[0]):
        if ar[k] != 0.0 or ai[k] != 0.0:
            push = complex(om * om - (1.0 + ratio) * w[k] * w[k], 2.0 * ze * om * w[k])
            z = complex(ar[k], ai[k]) * (1.0 + ratio * w[k] * w[k] / push)
            lr[k], li[k] = z.real, z.imag
    root = math.sqrt(1.0 + ratio)
    return q - x, qd - v, om / root, ze / root, lr, li


@njit(error_model="numpy")
def pressed(t, s, q, qd, w, ar, ai, p):
    """The plate mode s after the state (q, qd) at time t, the ball resting on the plate all the while."""
    om, ze, ratio = mode(p)
    if ratio == 0.0:
        return 0.0, 0.0, 0.0
    root = math.sqrt(1.0 + ratio)
    x0, v0, _ = settled(t, w, ar, ai, p)
    x1, v1, a1 = settled(t + s, w, ar, ai, p)
    x, v, a = ring(s, q - x0, qd - v0, om / root, ze / root)
    return x + x1, v + v1, a + a1


@njit(error_model="numpy")
def hermite5(z, d, h0, v0, a0, h1, v1, a1):
    """Quintic through height, velocity and acceleration at both ends of a step d; z in [0, 1]: height, velocity."""
    c0, c1, c2 = h0, v0 * d, 0.5 * a0 * d * d
    e = h1 - c0 - c1 - c2
    f = v1 * d - c1 - 2.0 * c2
    k = a1 * d * d - 2.0 * c2
    c3 = 10.0 * e - 4.0 * f + 0.5 * k
    c4 = -15.0 * e + 7.0 * f - k
    c5 = 6.0 * e - 3.0 * f + 0.5 * k
    h = c0 + z * (c1 + z * (c2 + z * (c3 + z * (c4 + z * c5))))
    v = (c1 + z * (2.0 * c2 + z * (3.0 * c3 + z * (4.0 * c4 + z * 5.0 * c5)))) / d
    return h, v


@njit(error_model="numpy")
def crossing(level, lo, hi, d, h0, v0, a0, h1, v1, a1):
    """Where in [lo, hi] the quintic crosses ``level``; its value minus level must differ in sign at the ends."""
    flo = hermite5(lo, d, h0, v0, a0, h1, v1, a1)[0] - level
    for _ in range(60):
        mid = 0.5 * (lo + hi)
        fm, vm = hermite5(mid, d, h0, v0, a0, h1, v1, a1)
        fm -= level
        if (fm > 0.0) == (flo > 0.0):
            lo, flo = mid, fm
        else:
            hi = mid
        if vm != 0.0:
            z = mid - fm / (vm * d)
            if lo < z < hi:
                fz = hermite5(z, d, h0, v0, a0, h1, v1, a1)[0] - level
                if (fz > 0.0) == (flo > 0.0):
                    lo, flo = z, fz
                else:
                    hi = z
        if hi - lo < 1e-13:
            break
    return 0.5 * (lo + hi)


@njit(error_model="numpy")
def standstill(d, h0, v0, a0, h1, v1, a1):
    """Where in [0, 1] the quintic's velocity vanishes in a step d; the velocities at the ends differ in sign."""
    lo, hi = 0.0, 1.0
    for _ in range(44):
        z = 0.5 * (lo + hi)
        if (hermite5(z, d, h0, v0, a0, h1, v1, a1)[1] > 0.0) == (v1 > 0.0):
            hi = z
        else:
            lo = z
    return 0.5 * (lo + hi)


@njit(error_model="numpy")
def first_touch(d, h0, v0, a0, h1, v1, a1):
    """First place in (0, 1] of a step where the height falls below zero, or -1; sees a dip inside the step, too."""
    if h1 <= 0.0:
        lo = 0.0
        if h0 <= 0.0:  # the flight starts in this step: leave the plate first
            lo = 0.5
            while lo > 1e-9 and hermite5(lo, d, h0, v0, a0, h1, v1, a1)[0] <= 0.0:
                lo *= 0.5
        return crossing(0.0, lo, 1.0, d, h0, v0, a0, h1, v1, a1)
    if v0 < 0.0 < v1:
        z = standstill(d, h0, v0, a0, h1, v1, a1)
        if hermite5(z, d, h0, v0, a0, h1, v1, a1)[0] < 0.0:
            return crossing(0.0, 0.0, z, d, h0, v0, a0, h1, v1, a1)
    return -1.0


@njit(error_model="numpy")
def pull(t, s, h, direction, q, qd, om, ze, w, ar, ai, p):
    """Relative acceleration of a ball that does not move along the rod, friction left out, m/s^2."""
    _, v, a = plate(t, w, ar, ai)
    _, qv, qa = ring(s, q, qd, om, ze)
    return -p[-1] - a - qa + force(0.0, h, 0.0, v + qv, p)


@njit(error_model="numpy")
def between(lo, hi, below, above, k):
    """Where to look next for the sign change between ``below`` < 0 at lo and ``above`` > 0 at hi, in round k."""
    if k % 4 == 3 or above <= below:
        return 0.5 * (lo + hi)
    at = lo - below * (hi - lo) / (above - below)
    return at if lo < at < hi else 0.5 * (lo + hi)


@njit(error_model="numpy")
def wait(t0, h, s0, dwell0, q, qd, om, ze, w, ar, ai, dt, p):
    """How long a ball at standstill stays: on the plate (h = 0) until it is thrown, in mid-air until friction yields.

    ``s0`` is the time since the state (q, qd) of the plate mode. Returns seconds and the direction in which it goes;
    direction 0 when it never does.
    """
    up = dry(h, 0.0, 1.0, p)
    down = dry(h, 0.0, -1.0, p)
    last, over_before, f_before = 0.0, 0.0, 0.0
    fine = dt / WAIT_PARTS
    n = int(LONGEST_PERIODS * STEPS_PER_PERIOD * WAIT_PARTS)
    for i in range(n):
        s = i * fine
        f = pull(t0 + s, s0 + s, h, 0.0, q, qd, om, ze, w, ar, ai, p)
        over = f - up - (hold(dwell0 + s, p) if h == 0.0 else 0.0)
        direction = 1.0 if over > 0.0 else (-1.0 if h > 0.0 and f < -down else 0.0)
        if direction != 0.0:
            if i == 0:
                return 0.0, direction
            lo, hi = last, s
            below, above = (over_before, over) if direction > 0.0 else (-down - f_before, -down - f)
            for k in range(MOST_SECANTS):
                mid = between(lo, hi, below, above, k)
                f = pull(t0 + mid, s0 + mid, h, 0.0, q, qd, om, ze, w, ar, ai, p)
                here = f - up - (hold(dwell0 + mid, p) if h == 0.0 else 0.0) if direction > 0.0 else -down - f
                if here > 0.0:
                    hi, above, below = mid, here, 0.5 * below
                else:
                    lo, below, above = mid, here, 0.5 * above
                if abs(here) < NO_PULL_MPS2:
                    return mid, direction
            return hi, direction
        last, over_before, f_before = s, over, f
    return 0.0, 0.0


@njit(error_model="numpy")
def segment(t0, s0, h0, v0, direction, q, qd, om, ze, w, ar, ai, dt, p, forced, rough, gap):
    """Fly until impact or, with dry friction, standstill.

    ``s0`` is the time since take-off (and since the mode's state). Returns (ended, s, h, v, opened):
    ended 1 impact, 2 standstill, 0 never; ``opened`` the time since take-off at which the height passed ``gap``, or -1.
    """
    g = p[-1]
    x0, vp0, acc0 = plate(t0, w, ar, ai)
    rx0, rv0, ra0 = ring(s0, q, qd, om, ze)
    dev, devd = 0.0, 0.0
    h, v, up = h0, v0, vp0 + rv0
    fr = -direction * dry(h, abs(v), direction, p) if rough else 0.0
    steady = rough and fr == -direction * dry(1.0, 1.0, direction, p) and fr == -direction * dry(0.0, 0.1, direction, p)
    f0 = (force(s0, h, v, up, p) if forced else 0.0) + fr
    a = -g - acc0 - ra0 + f0
    opened = -1.0
    step = dt * FIRST_STEP_PART
    s = 0.0
    limit = LONGEST_PERIODS * STEPS_PER_PERIOD * dt
    while s < limit:
        half = 0.5 * step
        sm, se = s + half, s + step
        xe, vpe, acce = plate(t0 + se, w, ar, ai)
        rxe, rve, rae = ring(s0 + se, q, qd, om, ze)
        hb1 = h0 + v0 * se - 0.5 * g * se * se - (xe - x0 - vp0 * se) - (rxe - rx0 - rv0 * se)
        vb1 = v0 - g * se - (vpe - vp0) - (rve - rv0)
        f1 = 0.0
        if rough and not forced and steady:  # constant friction: the deviation is known in closed form
            dev, devd, f1 = 0.5 * fr * se * se, fr * se, fr
        elif forced or rough:
            xm, vpm, _ = plate(t0 + sm, w, ar, ai)
            rxm, rvm, _ = ring(s0 + sm, q, qd, om, ze)
            hbm = h0 + v0 * sm - 0.5 * g * sm * sm - (xm - x0 - vp0 * sm) - (rxm - rx0 - rv0 * sm)
            vbm = v0 - g * sm - (vpm - vp0) - (rvm - rv0)
            um, ue = vpm + rvm, vpe + rve
            d1, e1 = devd, f0
            vv = vbm + devd + half * e1
            hh = hbm + dev + half * d1
            e2 = force(s0 + sm, hh, vv, vv + um, p) if forced else 0.0
            e2 -= direction * dry(hh, abs(vv), direction, p) if rough else 0.0
            d2 = devd + half * e1
            vv = vbm + devd + half * e2
            hh = hbm + dev + half * d2
            e3 = force(s0 + sm, hh, vv, vv + um, p) if forced else 0.0
            e3 -= direction * dry(hh, abs(vv), direction, p) if rough else 0.0
            d3 = devd + half * e2
            vv = vb1 + devd + step * e3
            hh = hb1 + dev + step * d3
            e4 = force(s0 + se, hh, vv, vv + ue, p) if forced else 0.0
            e4 -= direction * dry(hh, abs(vv), direction, p) if rough else 0.0
            d4 = devd + step * e3
            dev += step * (d1 + 2.0 * d2 + 2.0 * d3 + d4) / 6.0
            devd += step * (e1 + 2.0 * e2 + 2.0 * e3 + e4) / 6.0
            vv = vb1 + devd
            hh = hb1 + dev
            f1 = (force(s0 + se, hh, vv, vv + ue, p) if forced else 0.0) - (
                direction * dry(hh, abs(vv), direction, p) if rough else 0.0
            )
        h1, v1 = hb1 + dev, vb1 + devd
        a1 = -g - acce - rae + f1
        if opened < 0.0 and h1 > gap >= h:
            opened = s0 + s if gap == 0.0 else s0 + s + step * crossing(gap, 0.0, 1.0, step, h, v, a, h1, v1, a1)
        touch = first_touch(step, h, v, a, h1, v1, a1)
        if rough and v1 * direction < 0.0:
            z = standstill(step, h, v, a, h1, v1, a1) if v * direction > 0.0 else 1.0
            if touch < 0.0 or z < touch:
                hz = hermite5(z, step, h, v, a, h1, v1, a1)[0]
                return 2, s0 + s + z * step, max(hz, 0.0), 0.0, opened
        if touch >= 0.0:
            vt = hermite5(touch, step, h, v, a, h1, v1, a1)[1]
            return 1, s0 + s + touch * step, 0.0, vt, opened
        s, h, v, a, f0 = se, h1, v1, a1, f1
        step = min(2.0 * step, dt)
    return 0, s0 + s, h, v, opened


@njit(error_model="numpy")
def flight(t0, v0, q, qd, om, ze, w, ar, ai, dt, p, forced, rough, gap):
    """From leaving the plate at t0 with relative velocity v0 to the impact.

    Returns (duration, impact speed, time from take-off to opening); duration -1 when it does not land.
    """
    s, h, v, opened, direction = 0.0, 0.0, v0, -1.0, 1.0
    for _ in range(200):
        ended, s, h, v, o = segment(t0 + s, s, h, v, direction, q, qd, om, ze, w, ar, ai, dt, p, forced, rough, gap)
        if opened < 0.0:
            opened = o
        if ended == 1:
            return s, -v, opened
        if ended == 0:
            break
        stay, direction = wait(t0 + s, max(h, 1e-12), s, 0.0, q, qd, om, ze, w, ar, ai, dt, p)
        if direction == 0.0:
            break
        s += stay
        if h <= 0.0 and direction < 0.0:
            return s, 0.0, opened
    return -1.0, 0.0, opened


@njit(error_model="numpy")
def leave(t, v_in, dwell0, q, qd, om, ze, w, ar, ai, dt, p):
    """After an impact at time t with speed v_in: when, how fast and how the ball leaves the plate.

    Returns (time, launch velocity, kind, end of rebounds): kind 1 thrown or bounced at once, 0 after rest, -1 never.
    The tail of a chatter is summed as a geometric series under the net acceleration at its start.
    """
    e = min(max(rebound(v_in, p), 0.0), 0.999)
    v0 = e * v_in
    q, qd, om, ze, ar, ai = loaded(t, q, qd, om, ze, w, ar, ai, p)
    net = pull(t, 0.0, 0.0, 0.0, q, qd, om, ze, w, ar, ai, p)
    up = net - dry(0.0, 0.0, 1.0, p) - hold(dwell0, p)
    period = dt * STEPS_PER_PERIOD
    if v0 > 0.0:
        rise = net - dry(0.0, v0, 1.0, p)
        if rise >= 0.0:
            return t, v0, 1, t
        fall = net + dry(0.0, v0, -1.0, p)
        if fall < 0.0:
            lasts = v0 * (1.0 / -rise + 1.0 / math.sqrt(rise * fall))
            back = math.sqrt(fall / rise)
            if lasts > TAIL_PART * period:
                return t, v0, 1, t
            tail = lasts / (1.0 - e * back) if e * back < 1.0 else lasts
        elif v0 / -rise > TAIL_PART * period:
            return t, v0, 1, t
        else:
            tail = v0 / -rise
        stay, direction = wait(t + tail, 0.0, tail, dwell0, q, qd, om, ze, w, ar, ai, dt, p)
        if direction == 0.0:
            return t, 0.0, -1, t + tail
        return t + tail + stay, 0.0, 0, t + tail
    if up > 0.0:
        return t, 0.0, 1, t
    stay, direction = wait(t, 0.0, 0.0, dwell0, q, qd, om, ze, w, ar, ai, dt, p)
    if direction == 0.0:
        return t, 0.0, -1, t
    return t + stay, 0.0, 0, t


@njit(error_model="numpy")
def strike(q, qd, s, v_in, om, ze, ratio, p):
    """State of the plate mode just after an impact, s after its last state."""
    if ratio == 0.0:
        return 0.0, 0.0
    x, v, _ = ring(s, q, qd, om, ze)
    return x, v - ratio / (1.0 + ratio) * (1.0 + rebound(v_in, p)) * v_in


@njit(error_model="numpy")
def next_flight(
    t, v_in, q, qd, om, ze, ratio, w, ar, ai, dt, p, forced, rough, gap, unseen_s, after, passable_s, closure_s
):
    """From an impact at time t with speed v_in to the next flight that an instrument sees.

    Flights shorter than ``unseen_s`` are passed over, and those shorter than ``passable_s`` that end before ``after``;
    the impact that ends one keeps the circuit closed for ``closure_s``, wherever the ball is.
    (q, qd) is the mode's state just after the impact at t. Returns (take-off, launch velocity, landing, impact speed,
    opening, flights passed over, kind, q, qd at take-off); kind -1 when there is none.
    """
    dwell = 0.0
    for hidden in range(MOST_BOUNCES):
        off, v0, kind, _ = leave(t, v_in, dwell, q, qd, om, ze, w, ar, ai, dt, p)
        if kind < 0:
            break
        qt, qdt, _ = pressed(t, off - t, q, qd, w, ar, ai, p)
        lasts, v_hit, opened = flight(off, v0, qt, qdt, om, ze, w, ar, ai, dt, p, forced, rough, gap)
        if lasts < 0.0:
            break
        if lasts > unseen_s and not (lasts < passable_s and off + lasts < after):
            opens = off + max(opened, 0.0)
            if hidden > 0:
                opens = max(opens, t + closure_s)
            return off, v0, off + lasts, v_hit, opens, hidden, kind, qt, qdt
        dwell = 0.0 if kind == 1 else off - t + dwell
        t = off + lasts
        q, qd = strike(qt, qdt, lasts, v_hit, om, ze, ratio, p)
        v_in = v_hit
    return t, 0.0, t, 0.0, t, 0, -1, q, qd


@njit(error_model="numpy")
def weak_rebounds(land, hit, target, weak_mps, closure_s, q, qd, om, ze, ratio, w, ar, ai, dt, p, forced, rough):
    """Which landing ends a flight as the instrument shows it, given a first landing.

    An impact slower than ``weak_mps`` from which the ball leaves at once may have left no mark: the flight seems to go
    on through it, and ends at the impact nearest to ``target``, or at the end of the chatter where that is nearer.
    Impacts closer together than `RESOLVED_S` are one, and which of them is no free choice: the first where each keeps
    the circuit closed for a while (``closure_s``), else the last, less a part of what lies between, which is in doubt.
    (q, qd) is the mode's state just after the landing. Returns (landing, impact speed, impacts passed, doubt in s).
    """
    near, near_hit, near_passed, doubt = land, hit, 0, 0.0
    passed = 0
    while hit < weak_mps and passed < MOST_BOUNCES:
        off, v0, kind, end = leave(land, hit, 0.0, q, qd, om, ze, w, ar, ai, dt, p)
        passed += 1
        lasts, v_next = end - off, 0.0
        if kind == 1:
            lasts, v_next, _ = flight(off, v0, q, qd, om, ze, w, ar, ai, dt, p, forced, rough, 0.0)
            if lasts < 0.0:
                break
            q, qd = strike(q, qd, lasts, v_next, om, ze, ratio, p)
        land, hit = off + lasts, v_next
        if land - near <= RESOLVED_S:
            if closure_s == 0.0:
                near, near_hit, near_passed, doubt = land, hit, passed, doubt + UNRESOLVED_PART * (land - near)
        elif abs(land - target) < abs(near - target):
            near, near_hit, near_passed, doubt = land, hit, passed, 0.0
        if kind != 1 or land - RESOLVED_S > max(target, near):
            break
    return near, near_hit, near_passed, doubt


@njit(error_model="numpy")
def launch_of(t0, t1, v_near, t_near, q, qd, om, ze, w, ar, ai, dt, p, forced, rough):
    """Launch velocity and impact speed of a flight seen to leave at t0 and land at t1 (a two-point problem).

    Secant on the landing time from the drag-free answer, or from a launch velocity ``v_near`` known to land at
    ``t_near`` (-1: none); the drag-free answer itself where no flight lands at t1.
    """
    g = p[-1]
    x0, vp0, _ = plate(t0, w, ar, ai)
    x1, vp1, _ = plate(t1, w, ar, ai)
    rx0, rv0 = q, qd
    rx1, rv1, _ = ring(t1 - t0, q, qd, om, ze)
    lasts = t1 - t0
    v0 = (0.5 * g * lasts * lasts + x1 - x0 - vp0 * lasts + rx1 - rx0 - rv0 * lasts) / lasts
    hit = -(v0 - g * lasts - (vp1 - vp0) - (rv1 - rv0))
    if not (forced or rough):
        return v0, hit
    va, fa, va_hit = v_near, t_near - t1, hit
    first = 0 if v_near < 0.0 else 1
    vb = max(v0, 0.0) if first == 0 else max(v_near - 0.5 * g * fa, 0.0)
    for i in range(first, 7):
        s, v_hit, _ = flight(t0, vb, q, qd, om, ze, w, ar, ai, dt, p, forced, rough, 0.0)
        if s < 0.0:
            return max(v0, 0.0), max(hit, 0.0)
        fb = s - lasts
        va_hit = v_hit
        if abs(fb) < 1e-9:
            break
        if i == 0 or vb == va:
            va, fa = vb, fb
            vb = max(vb - 0.5 * g * fb, 0.0)
            if vb == va:
                break
        else:
            slope = (fb - fa) / (vb - va) if vb != va else 0.0
            if slope <= 0.0:
                break
            va, fa, vb = vb, fb, max(vb - fb / slope, 0.0)
            if vb == va:
                break
    return vb, va_hit


@njit(error_model="numpy")
def thrown_before(t_open, h_period, q, qd, s0, om, ze, w, ar, ai, dt, p):
    """The last moment before an opening at which a ball at rest is thrown: what the plate's motion says of it."""
    back = 0.5 * h_period
    level = dry(0.0, 0.0, 1.0, p) + hold(1e9, p)
    q, qd, om, ze, ar, ai = loaded(t_open, q, qd, om, ze, w, ar, ai, p)
    n = int(back / dt) * 4
    d = back / n
    later = t_open + 4.0 * d
    above = pull(later, s0 + later - t_open, 0.0, 0.0, q, qd, om, ze, w, ar, ai, p) - level
    for _i in range(n + 4):
        t = later - d
        over = pull(t, s0 + t - t_open, 0.0, 0.0, q, qd, om, ze, w, ar, ai, p) - level
        if above > 0.0 >= over:
            lo, hi, below = t, later, over
            for k in range(MOST_SECANTS):
                mid = between(lo, hi, below, above, k)
                here = pull(mid, s0 + mid - t_open, 0.0, 0.0, q, qd, om, ze, w, ar, ai, p) - level
                if here > 0.0:
                    hi, above, below = mid, here, 0.5 * below
                else:
                    lo, below, above = mid, here, 0.5 * above
                if abs(here) < NO_PULL_MPS2:
                    return mid
            return hi
        later, above = t, over
    return t_open


@njit(error_model="numpy")
def turned(rate, before, after, length):
    """Integral of ``exp(rate t)`` over ``length`` from its values ``before`` and ``after``."""
    if abs(rate) * length < 1e-6:
        return 0.5 * length * (before + after)
    return (after - before) / rate


@njit(error_model="numpy")
def hear(t0, t1, resting, q, qd, om, ze, w, ar, ai, p, first, last, span_s, listen, heard, heard_s):
    """Add to ``heard`` (r, l) what the plate mode does from t0, its state (q, qd), to t1, in stretches first to last.

    It is the integral of the mode's acceleration times ``exp(-i w t)``, w of ``listen`` (l,), in closed form; the time
    heard goes to ``heard_s`` (r,).
    """
    ratio = mode(p)[2]
    x0, v0 = 0.0, 0.0
    if resting:
        root = math.sqrt(1.0 + ratio)
        x0, v0, _ = settled(t0, w, ar, ai, p)
        om, ze = om / root, ze / root
    decay = complex(-ze * om, om * math.sqrt(1.0 - ze * ze))
    size = complex(q - x0, -((qd - v0) + ze * om * (q - x0)) / decay.imag) * decay * decay
    r = first + np.searchsorted(span_s[first:last, 1], t0)
    while r < last and span_s[r, 0] < t1:
        a, b = max(t0, span_s[r, 0]), min(t1, span_s[r, 1])
        heard_s[r] += b - a
        rung_a, rung_b = size * np.exp(decay * (a - t0)), size * np.exp(decay * (b - t0))
        for k in range(listen.shape[0]):
            back = complex(0.0, -listen[k])
            at_a, at_b = np.exp(back * a), np.exp(back * b)
            total = turned(decay + back, rung_a * at_a, rung_b * at_b, b - a)
            total += turned(np.conj(decay) + back, np.conj(rung_a) * at_a, np.conj(rung_b) * at_b, b - a)
            for j in range(w.shape[0] if resting else 0):
                if ar[j] == 0.0 and ai[j] == 0.0:
                    continue
                stiff = (1.0 + ratio) * (om * om - w[j] * w[j])
                push = complex(stiff, 2.0 * ze * om * (1.0 + ratio) * w[j])
                answer = ratio * w[j] * w[j] * complex(ar[j], ai[j]) / push
                own = complex(0.0, w[j])
                own_a, own_b = answer * np.exp(own * a), answer * np.exp(own * b)
                total += turned(own + back, own_a * at_a, own_b * at_b, b - a)
                total += turned(back - own, np.conj(own_a) * at_a, np.conj(own_b) * at_b, b - a)
            heard[r, k] += 0.5 * total
        r += 1


@njit(error_model="numpy", nogil=True)
def one_ahead(
    opening,
    landing,
    relaunched,
    linked,
    wanted,
    step,
    period,
    w,
    ar,
    ai,
    p,
    forced,
    rough,
    bounce,
    gap,
    unseen_s,
    passable_s,
    closure_s,
    weak_mps,
    kick,
    first,
    span_s,
    listen,
    heard,
    heard_s,
    out,
):
    """Predict each event from the measured one before it.

    ``opening, landing, relaunched, linked, step`` (n,) describe the measured flights in order: edges,
    whether it left at its predecessor's landing, whether its predecessor is the flight before it without a gap, and the
    row of ``period`` (m,), ``w, ar, ai`` (m, k) with the plate's motion; only those ``wanted`` are predicted;
    ``p`` (n, P + 1). Fills ``out`` (n, 10):
    take-off, launch velocity, landing, impact speed, opening, flights passed over, kind (-1 none) as predicted, then
    launch velocity and impact speed of the measured flight itself (where an elastic impact needs them).
    ``kick`` (2,) is added to the plate mode's displacement and velocity wherever the chain of flights begins anew.
    Column 9 is by how much later the landing may be seen: see `weak_rebounds`.
    Adds what the plate mode does in the stretches ``span_s`` (r, 2), of step m those from ``first[m]`` on,
    at the pitches of ``listen`` (m, l) to ``heard`` (r, l), and the time to ``heard_s`` (r,): see `hear`.
    """
    q, qd = 0.0, 0.0  # of the plate mode about its place without the ball, just after the landing before
    previous_hit = 0.0
    t_previous = np.inf
    known = False
    chained = 0  # flights in a row whose impact speed was asked for: the first one's own prediction leans on nothing
    for i in range(landing.shape[0]):
        m = step[i]
        pi = p[i]
        wi, ri, ii = w[m], ar[m], ai[m]
        dt = pace(period[m], wi, ri, ii)
        om, ze, ratio = mode(pi)
        out[i, 6] = -1.0
        chained += 1
        if not linked[i]:
            known, chained = False, 0
            rested = opening[i] - t_previous
            if 0.0 <= rested < LONGEST_PERIODS * period[m]:  # the plate goes on ringing from step to step
                q, qd, _ = pressed(t_previous, rested, q, qd, wi, ri, ii, pi)
            else:
                q, qd, _ = settled(opening[i], wi, ri, ii, pi)
            q, qd = q + kick[0], qd + kick[1]
            t_previous = opening[i]
        passed, out[i, 9] = 0, 0.0
        if (wanted[i] or bounce[i]) and linked[i] and (known or not bounce[i]):
            off, v0, land, hit, opened, hidden, kind, qt, qdt = next_flight(
                t_previous,
                previous_hit,
                q,
                qd,
                om,
                ze,
                ratio,
                wi,
                ri,
                ii,
                dt,
                pi,
                forced,
                rough,
                gap[i],
                min(unseen_s, 0.5 * (landing[i] - opening[i])),
                opening[i],
                passable_s,
                closure_s,
            )
            if kind >= 0 and hit < weak_mps[i]:
                qt, qdt = strike(qt, qdt, land - off, hit, om, ze, ratio, pi)
                land, hit, passed, out[i, 9] = weak_rebounds(
                    land,
                    hit,
                    landing[i],
                    weak_mps[i],
                    closure_s,
                    qt,
                    qdt,
                    om,
                    ze,
                    ratio,
                    wi,
                    ri,
                    ii,
                    dt,
                    pi,
                    forced,
                    rough,
                )
            out[i, 0], out[i, 1], out[i, 2], out[i, 3] = off, v0, land, hit
            out[i, 4], out[i, 5], out[i, 6] = opened, hidden, kind
        # the measured flight itself: how fast did it leave and land?
        t_landed = t_previous
        t_previous = landing[i]
        known = True
        # (a predicted flight leans on the flight before, and to tell which landing that was, on its prediction)
        needed = ratio != 0.0 or (bounce[i] and np.any(wanted[i + 1 : i + 3]))
        if not (needed or (bounce[i] and wanted[i])):
            chained = 0
            continue
        direct, start, lasts, v0, hit = relaunched[i] and linked[i], t_landed, -1.0, 0.0, 0.0
        if not (direct and bounce[i]):  # without a bounce the ball leaves as if from rest, at once or soon after
            qo, qdo, _ = pressed(t_landed, opening[i] - t_landed, q, qd, wi, ri, ii, pi)
            start = thrown_before(opening[i], period[m], qo, qdo, 0.0, om, ze, wi, ri, ii, dt, pi)
            start = max(start, t_landed)
        qs, qds, _ = pressed(t_landed, start - t_landed, q, qd, wi, ri, ii, pi)
        if not (relaunched[i] and bounce[i]):
            lasts, hit, _ = flight(start, 0.0, qs, qds, om, ze, wi, ri, ii, dt, pi, forced, rough, 0.0)
        if lasts < 0.0 or abs(start + lasts - landing[i]) > 0.1 * period[m]:
            if direct:
                start, qs, qds = t_landed, q, qd
            near = out[i, 1] if passed == 0 and out[i, 6] == 1.0 and relaunched[i] else -1.0
            v0, hit = launch_of(start, landing[i], near, out[i, 2], qs, qds, om, ze, wi, ri, ii, dt, pi, forced, rough)
        if passed > 0 and chained > 1 and abs(out[i, 2] - landing[i]) < passable_s:
            hit = out[i, 3]  # the flight as measured is several: only the prediction knows its last impact
        previous_hit = max(hit, 0.0)
        out[i, 7], out[i, 8] = v0, previous_hit
        if ratio != 0.0 and linked[i]:
            hear(
                t_landed,
                start,
                True,
                q,
                qd,
                om,
                ze,
                wi,
                ri,
                ii,
                pi,
                first[m],
                first[m + 1],
                span_s,
                listen[m],
                heard,
                heard_s,
            )
            hear(
                start,
                landing[i],
                False,
                qs,
                qds,
                om,
                ze,
                wi,
                ri,
                ii,
                pi,
                first[m],
                first[m + 1],
                span_s,
                listen[m],
                heard,
                heard_s,
            )
        q, qd = strike(qs, qds, landing[i] - start, previous_hit, om, ze, ratio, pi)


@njit(error_model="numpy")
def march(t, v_in, q, qd, period, w, ar, ai, p, forced, rough, gap, unseen_s, out):
    """Flights one after another from an impact at t: fills ``out`` (n, 6) and returns how many and the last state.

    Columns: take-off, launch velocity, landing, impact speed, kind, flights passed over.
    """
    dt = pace(period, w, ar, ai)
    om, ze, ratio = mode(p)
    for i in range(out.shape[0]):
        off, v0, land, hit, _, hidden, kind, qt, qdt = next_flight(
            t, v_in, q, qd, om, ze, ratio, w, ar, ai, dt, p, forced, rough, gap, unseen_s, -1e300, 0.0, 0.0
        )
        if kind < 0:
            return i, t, v_in, q, qd
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4], out[i, 5] = off, v0, land, hit, kind, hidden
        q, qd = strike(qt, qdt, land - off, hit, om, ze, ratio, p)
        t, v_in = land, hit
    return out.shape[0], t, v_in, q, qd
