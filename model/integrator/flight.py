"""One flight with any effects: segments between standstills, each integrated to its end.

Gravity and the plate's motion, known in closed form, are never integrated; Runge-Kutta carries only the deviation that
forces and friction add. Impacts and standstills are found on Hermite polynomials of the whole motion.
"""

from __future__ import annotations

from kernels.arrays import Floats
from model.integrator.plate import (
    STEPS_PER_PERIOD,
    motion,
    ringing_at,
    start_turning,
    tones_at,
    turn_twice_as_far,
    turned,
)
from model.integrator.problem import (
    Law,
    Mode,
    Plate,
    Start,
    StepEnds,
    compiled,
    dry_friction,
    force,
    gravity,
    inlined,
    takeoff_threshold,
)

WAIT_PARTS = 3  # parts of a step at which a ball at rest is looked at: thresholds are passed for short moments
LONGEST_PERIODS = 60.0
MOST_SECANTS = 40
GOES_ON, LANDS, STANDS = range(3)  # how a segment ends
NO_PULL_MPS2 = 1e-9  # a threshold met so closely is met: within a picosecond of the slowest forcing
MOST_STEPS = 100  # of Halley's method: a grazing root is met by halves
SMALL_STEP, SMALLEST_STEP = 1e-6, 1e-13  # of a step of the integration; of Halley's method the last, and near a graze
Coefficients = tuple[float, float, float, float, float, float]
State = tuple[float, float, float, float]


@inlined
def _coefficients(ends: StepEnds) -> Coefficients:
    """Coefficients of the quintic in the part z of the step."""
    # what the first three coefficients leave of height, velocity and acceleration at the far end gives the last three
    d, h0, v0, a0, h1, v1, a1 = ends
    c0, c1, c2 = h0, v0 * d, 0.5 * a0 * d * d
    e = h1 - c0 - c1 - c2
    f = v1 * d - c1 - 2.0 * c2
    k = a1 * d * d - 2.0 * c2
    return c0, c1, c2, 10.0 * e - 4.0 * f + 0.5 * k, -15.0 * e + 7.0 * f - k, 6.0 * e - 3.0 * f + 0.5 * k


@compiled
def hermite5(z: float, ends: StepEnds) -> tuple[float, float]:
    """Height and velocity of the quintic at the part z in [0, 1] of the step."""
    c0, c1, c2, c3, c4, c5 = _coefficients(ends)
    h = c0 + z * (c1 + z * (c2 + z * (c3 + z * (c4 + z * c5))))
    v = (c1 + z * (2.0 * c2 + z * (3.0 * c3 + z * (4.0 * c4 + z * 5.0 * c5)))) / ends.d
    return h, v


@compiled
def crossing(level: float, lo: float, hi: float, ends: StepEnds) -> float:
    """Where in [lo, hi] the quintic crosses ``level``; its value minus level must differ in sign at the ends.

    Halley's method from where the chord crosses it, by bisection wherever it would leave the bracket.
    """
    c0, c1, c2, c3, c4, c5 = _coefficients(ends)
    c0 -= level
    below = c0 + lo * (c1 + lo * (c2 + lo * (c3 + lo * (c4 + lo * c5))))
    above = c0 + hi * (c1 + hi * (c2 + hi * (c3 + hi * (c4 + hi * c5))))
    at = lo + (hi - lo) * below / (below - above) if below != above else lo
    return _root((c0, c1, c2, c3, c4, c5), lo, hi, at, below > 0.0)


@compiled
def standstill(ends: StepEnds, hi: float) -> float:
    """Where in [0, hi] the quintic's velocity vanishes; the velocities at 0 and hi differ in sign."""
    _, c1, c2, c3, c4, c5 = _coefficients(ends)
    return _root((c1, 2.0 * c2, 3.0 * c3, 4.0 * c4, 5.0 * c5, 0.0), 0.0, hi, 0.5 * hi, ends.v0 > 0.0)


@compiled
def slowest(ends: StepEnds) -> float:
    """Where in [0, 1] the quintic's acceleration vanishes; the accelerations at the ends differ in sign."""
    _, _, c2, c3, c4, c5 = _coefficients(ends)
    return _root((2.0 * c2, 6.0 * c3, 12.0 * c4, 20.0 * c5, 0.0, 0.0), 0.0, 1.0, 0.5, ends.a0 > 0.0)


@compiled
def _root(polynomial: Coefficients, lo: float, hi: float, guess: float, positive: bool) -> float:
    """The root of a quintic in [lo, hi], where it is ``positive`` at lo: Halley's method from a guess, or bisection."""
    c0, c1, c2, c3, c4, c5 = polynomial
    z = guess if lo < guess < hi else 0.5 * (lo + hi)
    for _ in range(MOST_STEPS):
        f = c0 + z * (c1 + z * (c2 + z * (c3 + z * (c4 + z * c5))))
        slope = c1 + z * (2.0 * c2 + z * (3.0 * c3 + z * (4.0 * c4 + z * 5.0 * c5)))
        half_bend = c2 + z * (3.0 * c3 + z * (6.0 * c4 + z * 10.0 * c5))
        if (f > 0.0) == positive:
            lo = z
        else:
            hi = z
        bent = f * half_bend
        below = slope * slope - bent
        on = z - f * slope / below if below != 0.0 else lo
        length = SMALLEST_STEP
        if not lo < on < hi:
            on = 0.5 * (lo + hi)
        elif abs(bent) < 0.1 * below:  # the error of a step is as the cube of its length
            length = SMALL_STEP
        if abs(on - z) < length:
            return on
        z = on
    return z


@compiled
def first_standstill(ends: StepEnds, direction: float) -> float:
    """First place in (0, 1] of a step at which a motion in ``direction`` ends, or -1.

    A motion that turns and turns back inside the step counts, too: the velocities at both ends do not show it.
    """
    if ends.v1 * direction < 0.0:
        return standstill(ends, 1.0) if ends.v0 * direction > 0.0 else 1.0
    if ends.v0 * direction > 0.0 and ends.a0 * direction < 0.0 < ends.a1 * direction:
        # both ends move in ``direction``: between them the velocity has its extremum where the acceleration vanishes
        z = slowest(ends)
        if hermite5(z, ends)[1] * direction < 0.0:
            return standstill(ends, z)
    return -1.0


@compiled
def first_touch(ends: StepEnds) -> float:
    """First place in (0, 1] of a step where the height falls below zero, or -1; a dip inside the step counts, too."""
    if ends.h1 <= 0.0:
        lo = 0.0
        if ends.h0 <= 0.0:  # the flight starts in this step: leave the plate first
            lo = 0.5
            while lo > 1e-9 and hermite5(lo, ends)[0] <= 0.0:
                lo *= 0.5
        return crossing(0.0, lo, 1.0, ends)
    if ends.v0 < 0.0 < ends.v1:
        z = standstill(ends, 1.0)
        if hermite5(z, ends)[0] < 0.0:
            return crossing(0.0, 0.0, z, ends)
    return -1.0


@compiled
def pull(t: float, s: float, h: float, tones: Floats, mode: Mode, p: Floats, forced: bool) -> float:
    """Relative acceleration of a ball that does not move along the rod, friction left out, m/s^2.

    ``forced`` tells whether any effect exerts a force.
    """
    _, v, a = tones_at(t, tones)
    _, qv, qa = ringing_at(t, s, mode)
    return pull_of(v + qv, a + qa, h, p, forced)


@compiled
def pull_of(v: float, a: float, h: float, p: Floats, forced: bool) -> float:
    """`pull` where the plate has the velocity ``v`` and the acceleration ``a``."""
    return float(-gravity(p) - a + (force(0.0, h, 0.0, v, p) if forced else 0.0))


@compiled
def between(lo: float, hi: float, below: float, above: float, k: int) -> float:
    """Where to look next for the sign change between ``below`` < 0 at lo and ``above`` > 0 at hi, in round k."""
    # a bisection now and then: a secant creeps where the function is a step
    if k % 8 == 7 or above <= below:
        return 0.5 * (lo + hi)
    at = lo - below * (hi - lo) / (above - below)
    return at if lo < at < hi else 0.5 * (lo + hi)


@compiled
def narrowed(
    bracket: tuple[float, float, float, float], side: int, mid: float, here: float
) -> tuple[float, float, float, float, int]:
    """The bracket of `between` with ``here`` at ``mid``, and the side that moved.

    Where the same side moves again the value at the other counts half (Illinois method), so that it moves, too.
    """
    lo, hi, below, above = bracket
    if here > 0.0:
        return lo, mid, 0.5 * below if side > 0 else below, here, 1
    return mid, hi, here, 0.5 * above if side < 0 else above, -1


@compiled
def wait(t0: float, h: float, s0: float, dwell0: float, plate: Plate, law: Law) -> tuple[float, float]:
    """How long a ball at standstill stays: on the plate (h = 0) until it is thrown, in mid-air until friction yields.

    ``s0`` is the time since the state of the plate mode. Returns seconds and the direction in which it goes; direction
    0 when it never does.
    """
    p, (tones, mode) = law.p, plate
    # static friction is the limit of dry friction at speed 0
    up = dry_friction(h, 0.0, 1.0, p)
    down = dry_friction(h, 0.0, -1.0, p)
    last, over_before, f_before = 0.0, 0.0, 0.0
    fine = law.step_s / WAIT_PARTS
    n = int(LONGEST_PERIODS * STEPS_PER_PERIOD * WAIT_PARTS)
    turning = law.turning
    moving = start_turning(t0 - fine, s0 - fine, fine, tones, mode, turning)
    for i in range(n):
        s = i * fine
        _, v, a = turned(moving, turning)
        f = pull_of(v, a, h, p, law.forced)
        over = f - up - (takeoff_threshold(dwell0 + s, p) if h == 0.0 else 0.0)
        direction = 1.0 if over > 0.0 else (-1.0 if h > 0.0 and f < -down else 0.0)
        if direction != 0.0:
            if i == 0:
                return 0.0, direction
            lo, hi = last, s
            below, above = (over_before, over) if direction > 0.0 else (-down - f_before, -down - f)
            side = 0
            for k in range(MOST_SECANTS):
                mid = between(lo, hi, below, above, k)
                f = pull(t0 + mid, s0 + mid, h, tones, mode, p, law.forced)
                held = takeoff_threshold(dwell0 + mid, p) if h == 0.0 else 0.0
                here = f - up - held if direction > 0.0 else -down - f
                if abs(here) < NO_PULL_MPS2:
                    return mid, direction
                lo, hi, below, above, side = narrowed((lo, hi, below, above), side, mid, here)
            return hi, direction
        last, over_before, f_before = s, over, f
    return 0.0, 0.0


@inlined
def _effects(s: float, h: float, v: float, u: float, direction: float, p: Floats, acting: tuple[bool, bool]) -> float:
    """Acceleration by forces, and by friction against the motion in ``direction``, where either is ``acting``."""
    total = force(s, h, v, u, p) if acting[0] else 0.0
    return total - (direction * dry_friction(h, abs(v), direction, p) if acting[1] else 0.0)


@inlined
def _coasting(s: float, start: Start, plate: tuple[float, float, float], g: float) -> State:
    """Under gravity, without forces, s after ``start``: height, velocity, the plate's velocity, relative acceleration.

    ``plate`` is its displacement, velocity and acceleration then.
    """
    x, xd, xdd = plate
    h = start.h + start.v * s - 0.5 * g * s * s - (x - start.x - start.xd * s)
    return h, start.v - g * s - (xd - start.xd), xd, -g - xdd


@inlined
def _runge_kutta(
    s: float, step: float, deviation: tuple[float, float], f0: float, coasting: tuple[State, State], direction: float,
    law: Law,
) -> tuple[float, float]:  # fmt: skip
    """The deviation from coasting and its rate, a step after s; ``coasting`` is that half a step and a step after s."""
    dev, devd = deviation
    (hbm, vbm, um, _), (hb1, vb1, ue, _) = coasting
    p, acting = law.p, (law.forced, law.rubbed)
    half = 0.5 * step
    sm, se = s + half, s + step
    d1, e1 = devd, f0
    vv = vbm + devd + half * e1
    e2 = _effects(sm, hbm + dev + half * d1, vv, vv + um, direction, p, acting)
    d2 = devd + half * e1
    vv = vbm + devd + half * e2
    e3 = _effects(sm, hbm + dev + half * d2, vv, vv + um, direction, p, acting)
    d3 = devd + half * e2
    vv = vb1 + devd + step * e3
    e4 = _effects(se, hb1 + dev + step * d3, vv, vv + ue, direction, p, acting)
    d4 = devd + step * e3
    dev += step * (d1 + 2.0 * d2 + 2.0 * d3 + d4) / 6.0
    devd += step * (e1 + 2.0 * e2 + 2.0 * e3 + e4) / 6.0
    return dev, devd


@inlined
def _is_constant(fr: float, direction: float, p: Floats) -> bool:
    """Whether dry friction ``fr`` is Coulomb's: the same at two other places and speeds."""
    one, other = dry_friction(1.0, 1.0, direction, p), dry_friction(0.0, 0.1, direction, p)
    return bool(fr == -direction * one and fr == -direction * other)


@inlined
def segment(
    s0: float, begin: tuple[float, float], direction: float, started: tuple[int, tuple[float, float, float]], law: Law,
    gap: float, longest_s: float,
) -> tuple[int, float, float, float, float]:  # fmt: skip
    """Fly until impact or, with dry friction, standstill.

    ``s0`` is the time since take-off (and since the mode's state), ``begin`` height and velocity then, ``started`` the
    number of phasors in ``law.turning`` that turn by half the first step, and the plate's motion there. Returns
    (ended, s, h, v, opened): ended is `LANDS`, `STANDS`, or `GOES_ON` where neither comes in ``longest_s`` from
    take-off; ``opened`` the time since take-off at which the height passed ``gap``, or -1.
    """
    p, acting, turning = law.p, (law.forced, law.rubbed), law.turning
    g = gravity(p)
    step = law.step_s / 16.0
    moving, (x0, xd0, xdd0) = started
    h, v = begin
    start, dev, devd = Start(h, v, x0, xd0), 0.0, 0.0
    fr = -direction * dry_friction(h, abs(v), direction, p) if law.rubbed else 0.0
    constant = law.rubbed and not law.forced and _is_constant(fr, direction, p)
    f0 = _effects(s0, h, v, xd0, direction, p, acting)
    a = -g - xdd0 + f0
    halved = (law.forced or law.rubbed) and not constant
    if not halved:
        turn_twice_as_far(moving, turning)
    s, opened = 0.0, -1.0
    last = min(LONGEST_PERIODS * STEPS_PER_PERIOD * law.step_s, longest_s - s0)
    while s < last:
        se = s + step
        middle = _coasting(s + 0.5 * step, start, turned(moving, turning), g) if halved else (0.0, 0.0, 0.0, 0.0)
        end = _coasting(se, start, turned(moving, turning), g)
        hb1, vb1, ue, ab1 = end
        f1 = 0.0
        if constant:  # the deviation is known in closed form
            dev, devd, f1 = 0.5 * fr * se * se, fr * se, fr
        elif halved:
            dev, devd = _runge_kutta(s0 + s, step, (dev, devd), f0, (middle, end), direction, law)
            f1 = _effects(s0 + se, hb1 + dev, vb1 + devd, vb1 + devd + ue, direction, p, acting)
        h1, v1 = hb1 + dev, vb1 + devd
        a1 = ab1 + f1
        ends = StepEnds(step, h, v, a, h1, v1, a1)
        if opened < 0.0 and h1 > gap >= h:
            opened = s0 + s if gap == 0.0 else s0 + s + step * crossing(gap, 0.0, 1.0, ends)
        touch = first_touch(ends)
        if law.rubbed:
            z = first_standstill(ends, direction)
            if z >= 0.0 and (touch < 0.0 or z < touch):
                return STANDS, s0 + s + z * step, max(hermite5(z, ends)[0], 0.0), 0.0, opened
        if touch >= 0.0:
            return LANDS, s0 + s + touch * step, 0.0, hermite5(touch, ends)[1], opened
        s, h, v, a, f0 = se, h1, v1, a1, f1
        if step < law.step_s:  # by halves of it, exactly
            step *= 2.0
            turn_twice_as_far(moving, turning)
    return GOES_ON, s0 + s, h, v, opened


@compiled
def flight(
    t0: float, v0: float, plate: Plate, law: Law, gap: float, longest_s: float
) -> tuple[float, float, float, float]:
    """From leaving the plate at t0 with relative velocity v0 to the impact.

    Returns (duration, impact speed, time from take-off to opening, height gained at the end by each m/s of ``v0``);
    duration -1 when it does not land within ``longest_s``. The gain is exact but for what forces and friction that are
    not constant make of it.
    """
    p, turning = law.p, law.turning
    s, h, v, opened, direction, reach, kept, stands = 0.0, 0.0, v0, -1.0, 1.0, 0.0, 1.0, False
    for _ in range(400):  # segments, and standstills in mid-air that last
        # a short first step resolves tiny flights and the opening of the contact, where the height is a cubic
        moving = start_turning(t0 + s, s, law.step_s / 32.0, plate.tones, plate.mode, turning)
        seen = motion(moving, turning)
        if stands:
            # in mid-air: the take-off threshold belongs to a ball at height 0
            h_above, before = max(h, 1e-12), direction
            free = pull_of(seen[1], seen[2], h_above, p, law.forced)
            up, down = dry_friction(h_above, 0.0, 1.0, p), dry_friction(h_above, 0.0, -1.0, p)
            direction = 1.0 if free > up else (-1.0 if free < -down else 0.0)
            stays = direction == 0.0
            if stays:
                stay, direction = wait(t0 + s, h_above, s, 0.0, plate, law)
                if direction == 0.0:
                    break
                s += stay
            if h <= 0.0 and direction < 0.0:
                return s, 0.0, opened, reach
            # what a standstill leaves of a change of velocity: the ratio of the accelerations after and before it
            ahead = free - up if direction > 0.0 else free + down
            behind = free - up if before > 0.0 else free + down
            kept *= 0.0 if stays or behind == 0.0 else ahead / behind
            if stays:
                stands = False
                continue
        begun = s
        ended, s, h, v, o = segment(s, (h, v), direction, (moving, seen), law, gap, longest_s)
        reach += kept * (s - begun)
        if opened < 0.0:
            opened = o
        if ended == LANDS:
            return s, -v, opened, reach
        if ended == GOES_ON:
            break
        stands = True
    return -1.0, 0.0, opened, reach
