"""The plate on an even grid of time: turned phasors against the closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from model.effects.registry import row
from model.integrator.plate import (
    SHORT_TURN,
    loaded,
    mode_under_ball,
    motion,
    ringing_at,
    start_turning,
    tones_at,
    turn_twice_as_far,
    turned,
)
from model.integrator.problem import Mode, Plate, SecondMode

TONES = np.array([[160.0, 8.0, -3.0], [200.0, 0.0, 0.0], [320.0, 1.0, 2.0], [314.0, -0.2, 0.1]])
SECOND = SecondMode(40.9, -1e-5, 2e-3, 78.0, 0.06)
MODE, TWO = Mode(2e-5, -3e-3, 60.0, 0.08), Mode(2e-5, -3e-3, 60.0, 0.08, SECOND)


@pytest.mark.parametrize("mode", [MODE, TWO, Mode(0.0, 0.0, 60.0, 0.08)])
def test_turned_phasors_are_the_closed_form(mode: Mode) -> None:
    """Two thousand turns, doubled in between, forwards and back, lead where cosines lead, mode and silent tones too."""
    for d in (1.3e-4, -2e-4):
        t, s, since, turning = 41.0, 0.2, 0.0, np.empty((len(TONES) + 2, 6))
        n = start_turning(t, s, d, TONES, mode, turning)
        assert n == 5
        for k in range(2000):
            if k in (3, 9):
                turn_twice_as_far(n, turning)
                d *= 2.0
            since += d
            found = turned(n, turning)
        wanted = np.add(tones_at(t + since, TONES), ringing_at(t + since, s + since, mode))
        sizes = np.array([10.0 / 160.0**2, 10.0 / 160.0, 10.0])
        assert np.abs(np.array(found) - wanted) / sizes == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.01, -0.13, 0.999 * SHORT_TURN, 1.001 * SHORT_TURN, -2.0])
def test_a_turn_is_cosine_and_sine_however_short(angle: float) -> None:
    """Series below a third of a radian and library functions above agree to the last bits."""
    tones, turning = np.array([[100.0, 1.0, 0.0]]), np.empty((3, 6))
    start_turning(0.0, 0.0, angle / 100.0, tones, Mode(0.0, 0.0, 1.0, 0.0), turning)
    assert turning[2, 2:4] == pytest.approx([np.cos(angle), np.sin(angle)], rel=4e-16, abs=1e-300)


@pytest.mark.parametrize("mode", [MODE, TWO, Mode(0.0, 0.0, 60.0, 0.08)])
def test_phasors_begin_where_the_plate_is(mode: Mode) -> None:
    """Before the first turn they give the closed form's displacement, velocity and acceleration."""
    turning = np.empty((len(TONES) + 2, 6))
    n = start_turning(41.0, 0.2, 1e-4, TONES, mode, turning)
    assert motion(n, turning) == pytest.approx(np.add(tones_at(41.0, TONES), ringing_at(41.0, 0.2, mode)), rel=1e-11)


def test_a_ball_that_rests_on_two_modes_moves_the_first_by_the_motion_of_both() -> None:
    """Displacement, speed and the whole plate's acceleration are those of the differential equations."""
    om, ze, ratio, g, t = MODE.omega, MODE.damping, 0.12, 9.81, 41.0
    mode = {"mass_ratio": ratio, "frequency_hz": om / (2.0 * np.pi), "damping": ze}
    p, plate = row({"table_resonance": mode}, g), Plate(TONES, TWO)

    def rate(s: float, y: np.ndarray) -> list[float]:
        # what the tones are without the first mode, and the second one
        driven = tones_at(t + s, TONES)[2] + ringing_at(t + s, 0.0, Mode(0.0, 0.0, om, ze, SECOND))[2]
        free = -2.0 * ze * om * y[1] - om * om * y[0] - ratio * (g + driven)
        return [y[1], free / (1.0 + ratio)]

    for s in (0.03, -0.03):
        end = solve_ivp(rate, (0.0, s), [MODE.q, MODE.qd], rtol=1e-10, atol=1e-13).y[:, -1]
        assert mode_under_ball(t, s, plate, p) == pytest.approx(tuple(end), rel=1e-6)
        mode = loaded(t, plate, p, under := np.empty_like(TONES))
        whole = np.add(tones_at(t + s, under), ringing_at(t + s, s, mode))[2]
        driven = np.add(tones_at(t + s, TONES), ringing_at(t + s, 0.0, Mode(0.0, 0.0, om, ze, SECOND)))[2]
        assert whole == pytest.approx(driven + rate(s, end)[1], rel=1e-6)
