"""Friction and restitution: published bifurcations, 60 digits, brute force at 50 ns."""

import math

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.model.every_flight import every_flight
from benchmarks.model.first_landing import take_off_phases
from benchmarks.model.friction_reference import ExactRough, march
from model.flight import friction
from model.flight.bounces import PHASE_BOUND, tail_of_chatter
from model.flight.ideal import RESTS
from model.flight.numerics import FrictionRestitution
from model.flight.segment import UNDECIDED
from model.flight.windows import turning_points
from model.orbits.attractor import State
from model.orbits.cycles import CHATTERS, FRICTION, room_for
from model.orbits.exact_ball import FrictionBall, IdealBall
from model.orbits.make_ball import law_of
from model.tones import Forcing

ONE = Forcing.superposition(1)
G_MPS2 = 9.81


def lasting(gamma_peak, rough, n=4, v0=0.0):
    """The settled orbit at one sine."""
    return every_flight(FrictionBall(ONE, *rough), gamma_peak / 2, 4000, n, State(1.5, v0))


@pytest.mark.slow
def test_friction_alone_locks_and_doubles_where_published():
    """At mu = 0.3 without restitution the 1-cycle locks at 4.0564 and doubles at 4.507."""
    rough = FrictionRestitution(0.3, 0.3)
    assert lasting(4.0563, rough).tau[0] < 2 * np.pi - 1e-6
    assert lasting(4.0565, rough).tau == pytest.approx(2 * np.pi, abs=1e-6)
    assert np.ptp(lasting(4.5065, rough).tau) < 1e-3 < np.ptp(lasting(4.5075, rough).tau)


@pytest.mark.parametrize(("e", "k"), [(0.1, 1), (0.3, 1), (0.514, 1), (0.514, 2), (0.8, 3)])
def test_restitution_alone_locks_and_doubles_by_formula(e, k):
    """The locked bouncing cycle exists from k pi (1-e)/(1+e) and doubles where the formula says."""
    lock = k * math.pi * (1 - e) / (1 + e)
    double = math.hypot(lock, 2 * (1 + e * e) / (1 + e) ** 2)
    v0 = e * 2 * math.pi * k / (1 + e)  # the cycle's own rebound: tau = 2 pi k between equal heights
    for gamma_peak, stable in ((0.5 * (lock + double), True), (0.99 * double, True), (1.01 * double, False)):
        phase = math.acos(lock / gamma_peak) + 1e-6  # the plate's speed at impact is the lock's amplitude
        tau = every_flight(FrictionBall(ONE, e0=e), gamma_peak / 2, 0, 3000, State(phase, v0)).tau
        assert tau[0] == pytest.approx(2 * math.pi * k, abs=1e-4)
        departed = np.max(np.abs(tau[1000:] - 2 * math.pi * k))
        assert (departed < 1e-8) if stable else (departed > 1e-2)


def test_smooth_and_dead_is_the_ideal_ball():
    """Without friction and restitution the kernel flies the ideal ball's flights."""
    for ratio in (1, 2, 3):
        forcing = Forcing.superposition(ratio)
        for gamma in np.linspace(0.6, 6, 200):
            ideal, same = (every_flight(b, gamma, 0, 2) for b in (IdealBall(forcing), FrictionBall(forcing)))
            assert same.tau == pytest.approx(ideal.tau, abs=1e-10)
            assert np.array_equal(same.reset, ideal.reset)


def flown(forcing, gamma, law, phi0, v0):
    """One flight by the lone kernel: time, landing phase, impact speed, flag."""
    tables = friction.edge_tables(forcing.tones, turning_points(forcing), gamma, law)
    return friction.land_with_friction(forcing.tones, gamma, tables, law, phi0, v0, False)


def test_orbits_are_flown_flight_by_flight():
    """A flight of an orbit, and the next after its rebound, are those that the lone kernel flies from the plate."""
    rebounds = 0
    for ratio in (1, 2, 3):
        forcing = Forcing.superposition(ratio)
        for law in ((0.3, 0.2), (0.0, 0.3, 0.6), (0.2, 0.2, 0.514, 0.02)):
            ball = FrictionBall(forcing, *law)
            for gamma in np.linspace(0.7, 6, 40):
                path = ball.fly(gamma, State(0.4, 0.7), 6)
                tau, phi, speed, _ = flown(forcing, gamma, ball.law, 0.4, 0.7)
                assert (path.tau[0], path.speed[0]) == pytest.approx((tau, speed), abs=1e-9)
                v = friction.rebound(ball.law, speed)
                if path.tau.size > 1 and not path.chatter[0] and v > 0.0:
                    rebounds += 1
                    assert path.tau[1] == pytest.approx(flown(forcing, gamma, ball.law, phi, v)[0], abs=1e-7)
    assert rebounds > 100


def cases(n, seed, hanging):
    """Random balls with friction on random plates, with their take-offs: those that hang in mid-air, or the others."""
    rng = np.random.default_rng(seed)
    while n > 0:
        forcing = Forcing.superposition(int(rng.integers(1, 5)), (1.0, 1.0), (0.0, rng.uniform(0, 6)))
        gamma, phi0, v0 = rng.uniform(0.6, 5), rng.uniform(0, 2 * np.pi), float(10 ** rng.uniform(-3, 0.7))
        rough = FrictionRestitution(*rng.uniform(0, 0.6, 2) * rng.integers(0, 2, 2))
        tau, _, speed, flag = flown(forcing, gamma, rough, phi0, v0)
        if bool(flag & friction.HUNG) == hanging:
            n -= 1
            yield forcing, gamma, rough, phi0, v0, (tau, speed, flag)


@pytest.mark.slow
@pytest.mark.parametrize("hanging", [False, True])
def test_one_flight_to_60_digits(hanging):
    """Flight time, impact speed and hanging agree with the event-by-event 60-digit solver."""
    for forcing, gamma, rough, phi0, v0, (tau, impact, flag) in cases(6, 1, hanging):
        assert not flag & UNDECIDED
        landing, speed, waited = ExactRough(forcing, gamma, rough.mu_up, rough.mu_down).flight(mp.mpf(phi0), v0)
        assert tau == pytest.approx(float(landing - phi0), abs=1e-10)
        assert impact == pytest.approx(float(speed), abs=1e-9)
        assert (waited > 0) == hanging


def test_tail_of_chatter_keeps_its_bound():
    """The summed tail ends within 1e-9 of the end that the bounces, flown one by one to nothing, lead to."""
    rng = np.random.default_rng(4)
    tried = 0
    while tried < 200:
        forcing = Forcing.superposition(int(rng.integers(1, 4)))
        gamma, mu, e0 = rng.uniform(0.05, 4), rng.uniform(0, 0.4), rng.uniform(0.05, 0.9)
        rough = FrictionRestitution(mu, mu * rng.uniform(0, 1), e0, rng.uniform(-0.05, 0.05))
        phi0, v0 = rng.uniform(0, 2 * np.pi), 10 ** rng.uniform(-5, -2)
        tail = tail_of_chatter(forcing.tones, gamma, rough, phi0, v0)
        if tail < 0:
            continue
        tried += 1
        total, phi, v = 0.0, phi0, v0
        while v > 1e-12:
            tau, phi, speed, _ = flown(forcing, gamma, rough, phi, v)
            total += tau
            v = friction.rebound(rough, speed)
        assert tail == pytest.approx(total, abs=PHASE_BOUND)


STEP_S = 50e-9


def marched(forcing, gamma, rough, e1_s_per_m, phase, v0_mps, omega, step_s=STEP_S):
    """Impact times and speeds, hanging time and time of rest by brute force, and the error of its speeds.

    At a switch of the friction's sign or at an impact the march is wrong by part of a step: at most the step times the
    largest acceleration, for each of the few switches of a flight.
    """
    times, speeds = np.empty(400), np.empty(400)
    n, hung, rest, _ = march(
        forcing.tones, gamma, omega, G_MPS2, rough.mu_up, rough.mu_down, rough.e0, e1_s_per_m, phase, v0_mps, step_s,
        0.4, times, speeds,
    )  # fmt: skip
    n_, b, _ = forcing.tones.T
    largest = G_MPS2 * (1 + max(rough.mu_up, rough.mu_down) + gamma * float(np.sum(b * n_**2)))
    return times[:n], speeds[:n], hung, rest, 6 * step_s * largest


def bounces(forcing, gamma, law, phi, v):
    """Flight times and impact speeds of a chatter from its first bounce, and the time from its last landing to rest."""
    taus, speeds, rest = [], [], -1.0
    while rest < 0.0:
        tau, phi, speed, _ = flown(forcing, gamma, law, phi, v)
        v = friction.rebound(law, speed)
        rest = tail_of_chatter(forcing.tones, gamma, law, phi, v)
        taus.append(tau)
        speeds.append(speed)
    return taus, speeds, rest


@pytest.mark.parametrize(
    ("ratio", "gamma", "mu_up", "mu_down", "e0", "e1_s_per_m", "phase"),
    [(1, 0.45, 0.3, 0.2, 0.514, 0.0, 1.0), (1, 0.9, 0.5, 0.5, 0.3, 0.05, 0.8), (2, 0.8, 0.4, 0.4, 0.5, 0.1, 0.7),
     (3, 0.2, 0.3, 0.3, 0.6, 0.0, 2.9)],
)  # fmt: skip
def test_chatter_against_50_nanosecond_steps(ratio, gamma, mu_up, mu_down, e0, e1_s_per_m, phase):
    """From the first bounce to rest, impact times and energies agree with a brute force to its own error."""
    forcing, omega, v0_mps = Forcing.superposition(ratio), 2 * np.pi * 25.0, 0.12
    declared = {"mu_up": mu_up, "mu_down": mu_down}, {"e0": e0, "e1_s_per_m": e1_s_per_m}
    rough = law_of(dict(zip(("coulomb_friction", "restitution"), declared, strict=True)), omega / (2 * np.pi), G_MPS2)
    taus, impacts, rest_tau = bounces(forcing, gamma, rough, phase, v0_mps * omega / G_MPS2)
    chain = len(taus)
    times, speeds, _, rest, own = marched(forcing, gamma, rough, e1_s_per_m, phase, v0_mps, omega)
    fine = marched(forcing, gamma, rough, e1_s_per_m, phase, v0_mps, omega, STEP_S / 4)
    own_s = 1e-6 + 2 * np.maximum.accumulate(np.abs(times[:chain] - fine[0][:chain]))  # the chain amplifies it
    own_mps = own + 2 * np.maximum.accumulate(np.abs(speeds[:chain] - fine[1][:chain]))
    landing_s = np.cumsum(taus) / omega
    assert np.all(np.abs(landing_s - times[:chain]) <= own_s)
    speed_mps = np.array(impacts) * G_MPS2 / omega
    assert np.all(np.abs(speed_mps**2 - speeds[:chain] ** 2) / 2 <= (speed_mps + own_mps) * own_mps)
    assert landing_s[-1] + rest_tau / omega == pytest.approx(rest, abs=own_s[-1])
    assert own_s[-1] < 1e-3 * rest


def test_hanging_against_50_nanosecond_steps():
    """Flights that hang on the rod land when, and as hard as, a brute force says, to its own error."""
    omega = 2 * np.pi * 25.0
    for forcing, gamma, rough, phi0, v0, (tau, impact, _) in cases(4, 5, True):
        times, speeds, hung, _, own = marched(forcing, gamma, rough, 0.0, phi0, v0 * G_MPS2 / omega, omega)
        assert hung > 0.0
        assert tau / omega == pytest.approx(times[0], abs=4e-6)
        speed_mps = impact * G_MPS2 / omega
        assert abs(speed_mps**2 - speeds[0] ** 2) / 2 <= (speed_mps + own) * own


@settings(max_examples=80, deadline=None)
@given(
    ratio=st.integers(1, 5), gamma=st.floats(0, 50), mu_up=st.floats(0, 2), mu_down=st.floats(0, 0.9),
    e0=st.floats(0, 1), e1=st.floats(-0.05, 0.5), v0=st.one_of(st.just(0.0), st.floats(1e-6, 5)),
)  # fmt: skip
def test_orbits_never_gain_what_the_plate_cannot_give(ratio, gamma, mu_up, mu_down, e0, e1, v0):
    """Whatever the parameters, flights are finite or flagged, and impacts no faster than plate and fall allow."""
    forcing = Forcing.superposition(ratio)
    law, room = FrictionRestitution(mu_up, mu_down, e0, e1), room_for(30)
    tables = friction.edge_tables(forcing.tones, turning_points(forcing), gamma, law)
    if tables.n_up == 0:
        tau, _, speed, flag = friction.land_with_friction(forcing.tones, gamma, tables, law, 0.0, max(v0, 1e-6), False)
        assert flag & RESTS or 0.0 <= tau < np.inf
        assert speed >= 0.0
        return
    _, stop, *_ = FRICTION.fly_until_closed(forcing.tones, gamma, tables, law, 0.0, v0, room)
    path = [x[:stop] for x in room]
    tau, speed, threshold, mark = path[0], path[2], path[4], path[5]
    assert np.all(np.isfinite(tau))
    assert np.all(tau >= 0.0)
    assert np.all(speed >= 0.0)
    follows = np.flatnonzero(mark[:-1] & CHATTERS)
    from_threshold = threshold[follows + 1] >= 0
    starts = np.mod(path[1][follows + 1] - tables.up[0], 2 * np.pi) + tables.up[0]
    branch = np.searchsorted(tables.up[: 2 * tables.n_up], starts, side="right") - 1
    assert np.all(from_threshold | (branch % 2 == 0))  # at rest inside a take-off window it is lifted at once


def test_take_off_waits_for_friction():
    """From rest the ball leaves where -a_p exceeds g (1 + mu_up)."""
    ball = FrictionBall(ONE, mu_up=0.3)
    path = ball.fly(1.0, State(), 1)
    assert path.phase[0] == pytest.approx(math.asin(1.3 / 2), abs=1e-14)
    assert path.phase[0] > take_off_phases(ONE, 1.0).start[0]
    assert ball.fly(0.6, State(), 1).tau.size == 0


@pytest.mark.parametrize(
    "make",
    [
        lambda: FrictionBall(ONE, mu_down=1.0),
        lambda: FrictionBall(ONE, mu_up=-0.1),
        lambda: FrictionBall(ONE, e0=1.1),
        lambda: FrictionBall(ONE, e1=float("nan")),
        lambda: FrictionBall(ONE).fly(-1.0, State(), 1),
    ],
)
def test_nonsense_is_refused(make):
    """Friction that holds the ball up for ever, restitution above 1 and a negative gamma are errors."""
    with pytest.raises(ValueError, match="must"):
        make()
