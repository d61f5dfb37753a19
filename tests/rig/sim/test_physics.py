"""The simulated rig's mechanics against published numbers and against an independent fine integration."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rig.sim.ball_motion import _height, _root
from rig.sim.plant import Plant
from rig.sim.scenario import Scenario
from rig.sim.state import HANGING

G = 9.80665
RATE_HZ = 20000.0
FREQUENCY_HZ = 25.37
OMEGA = 2.0 * math.pi * FREQUENCY_HZ


def drive(gamma_peak: float, seconds: float, c: int = 1) -> np.ndarray:
    """Volts for the paper's waveform at 2 g per volt, faded in over half a second."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    wave = np.sin(OMEGA * t) if c == 1 else np.sin(OMEGA * t) + c * c * np.sin(c * OMEGA * t)
    return -0.5 * gamma_peak * wave * np.minimum(t / 0.5, 1.0)


def flights(scenario: Scenario, volts: np.ndarray, last: int, samples: int = 20) -> np.ndarray:
    """Take-off and landing times, from the plant's own books, of the ``last`` flights: (n, 2).

    The books are read every so many ``samples``, in which one flight may end; of a chatter within one sample the last.
    """
    plant = Plant(scenario, RATE_HZ, np.random.default_rng(5))
    head = round(0.7 * volts.size)
    plant.exchange(volts[:head])
    seen, rows = int(plant._state["impacts"][0]), []
    for k in range(head, volts.size, samples):
        plant.exchange(volts[k : k + samples])
        impacts = int(plant._state["impacts"][0])
        if impacts != seen:
            assert samples == 1 or impacts == seen + 1
            seen = impacts
            landed, duration = float(plant._state["landed_s"][0]), float(plant._state["flight_s"][0])
            rows.append((landed - duration, landed))
    return np.array(rows[-last:])


@pytest.mark.parametrize(
    ("gamma_peak", "taus"),
    [
        (1.1, (1.741151,)),
        (1.5, (3.566217,)),
        (2.0, (4.658851,)),
        (3.0, (5.967608,)),
        (3.8, (5.823950, 6.742421)),
        (4.0, (5.320300, 7.058725)),
    ],
)
def test_ideal_flights_have_the_published_lengths(gamma_peak: float, taus: tuple[float, ...]) -> None:
    """One sine: the cycles' flight times agree with the published six decimals."""
    found = flights(Scenario("ideal"), drive(gamma_peak, 4.0), 2 * len(taus))
    lengths = np.sort(OMEGA * (found[:, 1] - found[:, 0]))[::2]
    assert lengths == pytest.approx(taus, abs=2e-6)


def test_two_tones_give_the_papers_three_cycle() -> None:
    """c = 2, gamma = 1.28: the three flight times of the paper's first figure."""
    found = flights(Scenario("ideal"), drive(1.28, 5.0, c=2), 6)
    lengths = np.sort(OMEGA * (found[:, 1] - found[:, 0]))[::2]
    assert lengths == pytest.approx((2.506845, 2.758548, 7.053544), abs=5e-6)


def landing_after(takeoff_s: float, gamma_peak: float, force: Callable[[float, float, float], float]) -> float:
    """Landing time by an eighth-order integration in SI of one flight that starts with the plate's speed."""

    def slope(t: float, y: np.ndarray) -> tuple[float, float]:
        return y[1], -G + gamma_peak * G * math.sin(OMEGA * t) + force(t, y[0], y[1])

    def height(t: float, y: np.ndarray) -> float:
        return float(y[0]) if t > takeoff_s + 1e-3 else 1.0

    height.terminal, height.direction = True, -1.0  # type: ignore[attr-defined]
    found = solve_ivp(
        slope, (takeoff_s, takeoff_s + 0.2), (0.0, 0.0), "DOP853", events=height, rtol=1e-11, atol=1e-15, max_step=2e-4
    )
    return float(found.t_events[0][0])


FORCES: dict[str, tuple[dict[str, dict[str, float]], Callable[[float, float, float], float]]] = {
    "none": ({}, lambda t, h, v: 0.0),
    "viscous": ({"viscous_damping": {"rate_per_s": 5.0}}, lambda t, h, v: -5.0 * v),
    "spring and magnet": (
        {"position_force": {"spring_per_s2": 200.0, "magnet_g": 0.02, "range_m": 0.002}},
        lambda t, h, v: -200.0 * h - 0.02 * G * math.exp(-h / 0.002),
    ),
    "latch": (
        {"latch_force": {"pull_g": 0.1, "height_m": 0.002, "width_m": 0.0005}},
        lambda t, h, v: -0.05 * G * (1.0 + math.tanh((h - 0.002) / 0.0005)),
    ),
    "friction": (
        {"coulomb_friction": {"mu_up": 0.1, "mu_down": 0.2}},
        lambda t, h, v: -0.1 * G if v > 0.0 else 0.2 * G,
    ),
    "friction at one speed": (
        {"velocity_friction": {"mu": 0.2, "centre_mps": 0.1, "width_mps": 0.06}},
        lambda t, h, v: -math.copysign(0.2 * math.exp(-(((abs(v) - 0.1) / 0.06) ** 2)) * G, v),
    ),
    "air cushion": (
        {"air_cushion": {"rate_per_s": 100.0, "height_m": 1e-4}},
        lambda t, h, v: -100.0 * v / (1.0 + max(h, 0.0) / 1e-4) ** 3,
    ),
    "oil film": (
        {"oil_film": {"pull_g": 0.8, "height_m": 1e-4, "speed_mps": 0.03}},
        lambda t, h, v: -0.8 * G * math.exp(-h / 1e-4) * v / (v + 0.03) if v > 0.0 else 0.0,
    ),
    "friction with height": (
        {"height_friction": {"mu_per_m": 30.0}},
        lambda t, h, v: -math.copysign(30.0 * h * G, v),
    ),
}


@pytest.mark.parametrize("case", FORCES)
@pytest.mark.parametrize("gamma_peak", [1.5, 2.6])
def test_landings_agree_with_a_fine_integration(case: str, gamma_peak: float) -> None:
    """Each force moves the landing where an independent integrator puts it, to a tenth of a microsecond."""
    effects, force = FORCES[case]
    for takeoff_s, landing_s in flights(Scenario("one", effects), drive(gamma_peak, 2.0), 3):
        assert landing_s == pytest.approx(landing_after(takeoff_s, gamma_peak, force), abs=1e-7)


def test_drag_acts_on_the_speed_over_ground() -> None:
    """Drag moves a landing by over 100 microseconds; with the plate's own speed in it, it is right to one percent."""

    def drag(t: float, h: float, v: float) -> float:
        over_ground = v + 2.6 * G / OMEGA * math.cos(OMEGA * t)
        return -20.0 * abs(over_ground) * over_ground

    scenario = Scenario("drag", {"quadratic_drag": {"k_per_m": 20.0}})
    for takeoff_s, landing_s in flights(scenario, drive(2.6, 12.0), 3):
        without = landing_after(takeoff_s, 2.6, lambda t, h, v: 0.0)
        wanted = landing_after(takeoff_s, 2.6, drag)
        assert abs(wanted - without) > 1e-4
        assert landing_s - without == pytest.approx(wanted - without, rel=0.01)


def test_chatter_converges_and_ends() -> None:
    """e = 0.5 at low amplitude: ever shorter bounces, each half as long as the one before, a score of them a cycle."""
    found = flights(Scenario("e", {"restitution": {"e0": 0.5}}), drive(1.2, 4.0), 400, samples=1)
    lengths = found[:, 1] - found[:, 0]
    short = (lengths[:-1] < 6e-4) & (lengths[1:] < lengths[:-1]) & (lengths[1:] > 6e-5)
    assert np.count_nonzero(short) > 50
    assert lengths[1:][short] / lengths[:-1][short] == pytest.approx(0.5, abs=0.02)
    cycles = (found[-1, 1] - found[0, 0]) * FREQUENCY_HZ
    assert 8 < lengths.size / cycles < 25


def test_friction_delays_take_off_until_the_pull_exceeds_it() -> None:
    """With friction f the ball leaves where -a_p = g (1 + f)."""
    found = flights(Scenario("f", {"coulomb_friction": {"mu_up": 0.3, "mu_down": 0.3}}), drive(2.0, 2.0), 3)
    phase = (OMEGA * found[:, 0]) % (2.0 * math.pi)
    assert phase == pytest.approx(math.asin(1.3 / 2.0), abs=1e-6)


def test_a_flight_that_rises_twice_under_friction_repeats_wherever_the_samples_fall() -> None:
    """c = 2: the long flight stops falling and rises again in mid-air; in a locked motion all of them are alike."""
    rod = Scenario("rod", {"coulomb_friction": {"mu_up": 0.12, "mu_down": 0.15}})
    found = flights(rod, drive(1.5, 4.0, c=2), 24)
    lengths = found[:, 1] - found[:, 0]
    assert lengths.max() > 0.05
    assert np.ptp(lengths[lengths > 0.05]) < 1e-7


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_height_is_crossed_where_it_is_reached(sign: float) -> None:
    """Going up and going down, the place found in an interval is that of the height asked for."""
    rng = np.random.default_rng(3)
    for _ in range(300):
        path = (0.0, sign * rng.uniform(1.0, 3.0), *rng.uniform(-0.1, 0.1, 4))
        level = sign * rng.uniform(0.05, 0.5)
        assert _height(path, _root(path, 0.0, 1.0, False, level)) == pytest.approx(level, abs=1e-12)


@pytest.mark.parametrize(("gamma_peak", "period"), [(1.57, 1), (1.90, 2)])
def test_locked_cycle_with_restitution_lives_and_doubles_where_it_should(gamma_peak: float, period: int) -> None:
    """e = 0.4: coming from above, period 1 is locked inside its window 1.346 to 1.793 and doubled above it."""
    t = np.arange(round(14.0 * RATE_HZ)) / RATE_HZ
    amplitude = np.interp(t, [0.0, 0.5, 2.0, 7.0], [0.0, 2.5, 2.5, gamma_peak])
    found = flights(Scenario("e", {"restitution": {"e0": 0.4}}), -0.5 * amplitude * np.sin(OMEGA * t), 5)
    gaps = OMEGA * np.diff(found[:, 1])
    assert gaps[:2] + gaps[1:3] == pytest.approx(4.0 * math.pi, abs=1e-5)
    assert (abs(gaps[0] - gaps[1]) < 1e-5) == (period == 1)


def test_ball_hangs_on_the_rod_where_friction_can_hold_it() -> None:
    """Strong friction: the ball stops in mid-air and stays there for a while, out of contact."""
    strong = Scenario("hang", {"coulomb_friction": {"mu_up": 0.5, "mu_down": 0.5}})
    plant = Plant(strong, RATE_HZ, np.random.default_rng(1))
    hung = 0
    for volts in np.split(drive(1.6, 2.0), 4000):
        plant.exchange(volts)
        if plant._state["state"][0] == HANGING:
            hung += 1
            assert plant._state["height_m"][0] > 1e-6
            assert plant._state["speed_mps"][0] == 0.0
    assert hung > 200
