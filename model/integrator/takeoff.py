"""From an impact to the next flight that an instrument sees, and from a measured flight back to its take-off."""

from __future__ import annotations

import math

import numpy as np

from model.integrator.flight import MOST_SECANTS, NO_PULL_MPS2, between, flight, narrowed, pull, pull_of, wait
from model.integrator.plate import (
    STEPS_PER_PERIOD,
    in_state,
    loaded,
    mode_under_ball,
    ringing_at,
    start_turning,
    strike,
    tones_at,
    turned,
)
from model.integrator.problem import (
    Flight,
    Law,
    Plate,
    Visibility,
    compiled,
    dry_friction,
    gravity,
    inlined,
    rebound,
    takeoff_threshold,
)

MOST_BOUNCES = 400
MOST_RESTITUTION = 0.999
PASSABLE_S = 2e-3  # shorter flights may have escaped the contact circuit
LANDS_WITHIN_S = 1e-9  # of a flight that is asked for
MOST_LAUNCHES = 24  # flown for one
SAME_LAUNCH_MPS = 1e-6  # closer launches of which one lands early and one late pass the plate above and below it
RESOLVED_S = 8e-5  # impacts closer together are one to the contact circuit: which one it was is no free choice


@compiled
def leave(t: float, impact: float, dwell0: float, bare: Plate, law: Law) -> tuple[float, float, int, float]:
    """After an impact at time t: when, how fast and how the ball leaves the plate.

    Returns (time, launch velocity, kind, end of rebounds): kind 1 thrown or bounced at once, 0 after rest, -1 never.
    The tail of a chatter is summed as a geometric series under the net acceleration at its start.
    """
    p = law.p
    e = min(max(rebound(impact, p), 0.0), MOST_RESTITUTION)
    v0 = e * impact
    plate = Plate(law.under, loaded(t, bare, p, law.under))
    net = pull(t, 0.0, 0.0, plate.tones, plate.mode, p, law.forced)
    up = net - dry_friction(0.0, 0.0, 1.0, p) - takeoff_threshold(dwell0, p)
    # a shorter bounce begins the tail of a chatter, summed in closed form
    shortest = 2e-4 * (law.step_s * STEPS_PER_PERIOD)
    if v0 > 0.0:
        rise = net - dry_friction(0.0, v0, 1.0, p)
        if rise >= 0.0:
            return t, v0, 1, t
        fall = net + dry_friction(0.0, v0, -1.0, p)
        if fall < 0.0:
            lasts = v0 * (1.0 / -rise + 1.0 / math.sqrt(rise * fall))
            back = math.sqrt(fall / rise)
            if lasts > shortest:
                return t, v0, 1, t
            # each bounce is e sqrt(fall / rise) times as long as the one before: a geometric series
            tail = lasts / (1.0 - e * back) if e * back < 1.0 else lasts
        # friction holds the ball where it stops: the rise is all there is
        elif v0 / -rise > shortest:
            return t, v0, 1, t
        else:
            tail = v0 / -rise
        stay, direction = wait(t + tail, 0.0, tail, dwell0, plate, law)
        if direction == 0.0:
            return t, 0.0, -1, t + tail
        return t + tail + stay, 0.0, 0, t + tail
    if up > 0.0:
        return t, 0.0, 1, t
    stay, direction = wait(t, 0.0, 0.0, dwell0, plate, law)
    if direction == 0.0:
        return t, 0.0, -1, t
    return t + stay, 0.0, 0, t


@compiled
def next_flight(t: float, impact: float, bare: Plate, law: Law, seen: Visibility, after: float) -> Flight:
    """From an impact at time t to the next flight that an instrument sees.

    Flights shorter than ``unseen_s`` are passed over, and those shorter than `PASSABLE_S` that end before ``after``;
    the impact that ends one keeps the circuit closed for ``closure_s``, wherever the ball is. The mode's state in
    ``bare`` is that just after the impact.
    """
    dwell, q, qd = 0.0, bare.mode.q, bare.mode.qd
    for hidden in range(MOST_BOUNCES):
        plate = Plate(bare.tones, in_state(bare.mode, q, qd))
        off, v0, kind, _ = leave(t, impact, dwell, plate, law)
        if kind < 0:
            break
        qt, qdt = mode_under_ball(t, off - t, plate, law.p)
        flying = Plate(plate.tones, in_state(plate.mode, qt, qdt))
        lasts, v_hit, opened, reach = flight(off, v0, flying, law, seen.gap_m, np.inf)
        if lasts < 0.0:
            break
        if lasts > seen.unseen_s and not (lasts < PASSABLE_S and off + lasts < after):
            opens = off + max(opened, 0.0)
            if hidden > 0:
                opens = max(opens, t + seen.closure_s)
            return Flight(off, v0, off + lasts, v_hit, opens, hidden, kind, qt, qdt, reach)
        dwell = 0.0 if kind == 1 else off - t + dwell
        t = off + lasts
        q, qd = strike(flying.mode, lasts, v_hit, law.p)
        impact = v_hit
    return Flight(t, 0.0, t, 0.0, t, 0, -1, q, qd, 0.0)


@inlined
def weak_rebounds(
    landing: tuple[float, float], target: float, weak_mps: float, seen: Visibility, bare: Plate, law: Law
) -> tuple[float, float, int, float]:
    """Which landing ends a flight as the instrument shows it, given a first landing and its impact speed.

    An impact slower than ``weak_mps`` from which the ball leaves at once may have left no mark: the flight seems to go
    on through it, and ends at the impact nearest to ``target``, or at the end of the chatter where that is nearer.
    Impacts closer together than `RESOLVED_S` are one, and which of them is no free choice: the first where each keeps
    the circuit closed for a while (``closure_s``), else the last, less a part of what lies between, which is uncertain.
    A stronger impact that keeps the circuit closed for no time at all may fall between two samples: it too is passed
    where the rebound after it is shorter than ``unseen_s``, so that no instrument separates both landings.
    The mode's state is that just after the landing. Returns (landing, impact speed, impacts passed, ambiguity in s).
    """
    land, hit = landing
    near, near_hit, near_passed, ambiguity = land, hit, 0, 0.0
    passed, q, qd = 0, bare.mode.q, bare.mode.qd
    while passed < MOST_BOUNCES:
        plate = Plate(bare.tones, in_state(bare.mode, q, qd))
        marked = hit >= weak_mps
        if marked and seen.closure_s > 0.0:
            break
        off, v0, kind, end = leave(land, hit, 0.0, plate, law)
        if marked and kind != 1:
            break
        passed += 1
        lasts, v_next = end - off, 0.0
        if kind == 1:
            # a longer flight ends at an impact that was seen, or farther from the target than the nearest one
            farthest = max(near, target) + max(RESOLVED_S, abs(near - target))
            lasts, v_next, _, _ = flight(off, v0, plate, law, 0.0, seen.unseen_s if marked else farthest - off)
            if lasts < 0.0 or (marked and lasts > seen.unseen_s):
                break
            q, qd = strike(plate.mode, lasts, v_next, law.p)
        land, hit = off + lasts, v_next
        if not marked and land - near <= RESOLVED_S:
            if seen.closure_s == 0.0:
                # which of the impacts that look like one was timed is known to a fifth of the time between them
                ambiguity += 0.2 * (land - near)
                near, near_hit, near_passed = land, hit, passed
        elif abs(land - target) < abs(near - target):
            near, near_hit, near_passed, ambiguity = land, hit, passed, 0.0
        if kind != 1 or land - RESOLVED_S > max(target, near):
            break
    return near, near_hit, near_passed, ambiguity


@inlined
def launch_of(t0: float, t1: float, near: tuple[float, float, float], plate: Plate, law: Law) -> tuple[float, float]:
    """Launch velocity and impact speed of a flight seen to leave at t0 and land at t1 (a two-point problem).

    Newton's method on the landing time from the drag-free answer, or from a flight that is known: ``near`` is its
    launch velocity (-1: none), its landing, and by how much later each m/s more lands. What two flights show of that
    corrects the next ones. The drag-free answer itself where no flight lands at all: without forces and friction it is
    exact, and only flown, as a ball cannot leave downwards, nor pass through the plate. The last flight is flown: what
    is interpolated makes derivatives noisy. Where no launch lands at t1, because the plate comes near in between, it is
    the slowest that passes it.
    """
    g, (tones, mode) = gravity(law.p), plate
    x0, vp0, _ = tones_at(t0, tones)
    x1, vp1, _ = tones_at(t1, tones)
    rx0, rv0, _ = ringing_at(t0, 0.0, mode)
    rx1, rv1, _ = ringing_at(t1, t1 - t0, mode)
    lasts = t1 - t0
    # free flight from plate to plate: h = 0 at both ends gives the launch speed
    v0 = (0.5 * g * lasts * lasts + x1 - x0 - vp0 * lasts + rx1 - rx0 - rv0 * lasts) / lasts
    hit = -(v0 - g * lasts - (vp1 - vp0) - (rv1 - rv0))
    known = near[0] >= 0.0 and near[2] > 0.0 and (law.forced or law.rubbed)
    va, fa, slope_a = near[0], near[1] - t1, near[2]
    vb, flown_hit, part = max(va - fa / slope_a if known else v0, 0.0), hit, 1.0
    early, late, late_hit = 0.0, np.inf, hit
    for _ in range(MOST_LAUNCHES):
        s, flown_hit, _, reach = flight(t0, vb, plate, law, 0.0, np.inf)
        if s < 0.0:
            return max(v0, 0.0), max(hit, 0.0)
        fb = s - lasts
        if abs(fb) < LANDS_WITHIN_S or (vb == 0.0 and fb > 0.0):
            return vb, flown_hit
        if fb < 0.0:
            early = vb
        else:
            late, late_hit = vb, flown_hit
        if late - early < SAME_LAUNCH_MPS:
            break
        slope = reach / flown_hit if flown_hit > 0.0 else np.inf
        if known and vb != va:
            part = 2.0 * (fb - fa) / (vb - va) / (slope_a + slope)
        # what spans the jump of a graze says nothing of the slope
        on = vb - fb / (slope * (part if 0.5 < part < 2.0 else 1.0))
        if not early < on < late:
            on = 0.5 * (early + late) if late < np.inf else vb - 0.5 * g * fb
        va, fa, slope_a, vb, known = vb, fb, slope, on, True
    return (late, late_hit) if late < np.inf else (vb, flown_hit)


@inlined
def thrown_before(t_open: float, period: float, bare: Plate, law: Law) -> float:
    """The last moment before an opening at which the plate throws a ball at rest; the opening where there is none."""
    p = law.p
    level = dry_friction(0.0, 0.0, 1.0, p) + takeoff_threshold(1e9, p)
    mode = loaded(t_open, bare, p, law.under)
    back = 0.5 * period
    # backwards by quarters of a step: the last moment counts, and a window may be short
    n = int(back / law.step_s) * 4
    d = back / n
    later = t_open + 4.0 * d
    turning = law.turning
    moving = start_turning(later + d, later + d - t_open, -d, law.under, mode, turning)
    _, v, a = turned(moving, turning)
    above = pull_of(v, a, 0.0, p, law.forced) - level
    for _ in range(n + 4):
        t = later - d
        _, v, a = turned(moving, turning)
        over = pull_of(v, a, 0.0, p, law.forced) - level
        if above > 0.0 >= over:
            lo, hi, below, side = t, later, over, 0
            for k in range(MOST_SECANTS):
                mid = between(lo, hi, below, above, k)
                here = pull(mid, mid - t_open, 0.0, law.under, mode, p, law.forced) - level
                if abs(here) < NO_PULL_MPS2:
                    return mid
                lo, hi, below, above, side = narrowed((lo, hi, below, above), side, mid, here)
            return hi
        later, above = t, over
    return t_open
