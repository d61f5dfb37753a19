"""The closed forms of one flight, against integration in small steps and known limits."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from analysis.drop.laws import FlightLaw

LAWS = [FlightLaw(9.81), FlightLaw(9.81, 0.3), FlightLaw(9.81, 0.0, 0.14), FlightLaw(9.81, 0.2, 0.5)]


def _integrated(law: FlightLaw, speed: float) -> tuple[float, float]:
    def rhs(_t: float, s: np.ndarray) -> list[float]:
        return [s[1], -law.g_mps2 * (1 + law.friction * np.sign(s[1])) - law.drag_per_m * abs(s[1]) * s[1]]

    def top(_t: float, s: np.ndarray) -> float:
        return s[1]

    def land(_t: float, s: np.ndarray) -> float:
        return s[0]

    top.terminal = land.terminal = True
    top.direction = land.direction = -1
    up = solve_ivp(rhs, (0, 10), [0.0, speed], events=top, rtol=1e-11, atol=1e-12)
    down = solve_ivp(rhs, (0, 10), [up.y[0, -1], -1e-12], events=land, rtol=1e-11, atol=1e-12)
    return up.t[-1] + down.t[-1], -down.y[1, -1]


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("speed", [0.05, 1.0, 4.0])
def test_duration_and_return_speed_match_integration(law: FlightLaw, speed: float) -> None:
    """Flight time and landing speed equal those of an adaptive integrator."""
    duration, landing = _integrated(law, speed)
    assert law.duration_s(speed) == pytest.approx(duration, rel=1e-7)
    assert law.return_speed_mps(speed) == pytest.approx(landing, rel=1e-6)


@pytest.mark.parametrize("law", LAWS)
def test_takeoff_speed_inverts_duration(law: FlightLaw) -> None:
    """The speed found from a duration gives that duration."""
    speeds = np.array([0.01, 0.3, 2.0, 6.0])
    assert law.takeoff_speed_mps(law.duration_s(speeds)) == pytest.approx(speeds, rel=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_the_path_is_the_flight(law: FlightLaw) -> None:
    """Positions about the apex reach the take-off and landing speeds at take-off and landing."""
    speed = 1.7
    rise, fall = law.rise_s(speed), law.fall_s(law.apex_m(speed))
    assert law.velocity_mps(-rise) == pytest.approx(speed, rel=1e-9)
    assert law.drop_m(-rise) == pytest.approx(law.apex_m(speed), rel=1e-9)
    assert law.drop_m(fall) == pytest.approx(law.apex_m(speed), rel=1e-9)
    assert law.velocity_mps(fall) == pytest.approx(-law.return_speed_mps(speed), rel=1e-9)
    assert law.fall_m(law.return_speed_mps(speed)) == pytest.approx(law.apex_m(speed), rel=1e-9)


def test_a_vanishing_drag_is_a_parabola() -> None:
    """With next to no drag, and with none, a flight is that of two parabolas."""
    up, down = 9.81 * 1.1, 9.81 * 0.9
    for law in (FlightLaw(9.81, 0.1, 2e-9), FlightLaw(9.81, 0.1)):
        assert law.duration_s(2.0) == pytest.approx(2.0 / up + 2.0 / np.sqrt(up * down), rel=1e-7)
        assert law.drop_m(np.array([-0.1, 0.0, 0.3])) == pytest.approx([0.005 * up, 0.0, 0.045 * down], rel=1e-7)


def test_friction_only_rescales_impact_times() -> None:
    """Under friction alone successive flights keep one ratio: impact times cannot tell it from restitution."""
    law = FlightLaw(9.81, 0.3)
    speeds = np.array([0.2, 1.0, 3.0])
    ratio = law.duration_s(0.5 * law.return_speed_mps(speeds)) / law.duration_s(speeds)
    assert np.ptp(ratio) < 1e-12
