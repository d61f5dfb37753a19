"""The third plant: its flights are those of a closed form or of a march by other means, its instruments as stated."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from benchmarks.plants.third_instrument import CARDS, Instrument, drawn
from benchmarks.plants.third_plant import G, Rig, profile_of, simulate
from rig.profile import load_setup

QUIET = Instrument(linear_phase=False, white_v=0.0, pink_g=0.0, rise_s=1e-9, fall_s=1e-9, table_share=0.0, mount_hz=2e4)


def test_an_ideal_ball_flies_as_the_closed_form_says():
    """Take-off where the plate falls faster than a stone, landing where the parabola meets the plate again."""
    rig = Rig(gammas=(0.9,), instrument=QUIET, cycles=20)
    w, level = 2.0 * math.pi * rig.frequency_hz, 2.0 * 0.9  # at c = 1 both tones have one frequency

    def above(t, t0):
        plate = level * G / w**2 * np.array([math.sin(w * t0), math.sin(w * t)])
        return plate[0] + level * G / w * math.cos(w * t0) * (t - t0) - 0.5 * G * (t - t0) ** 2 - plate[1]

    start = math.asin(1.0 / level) / w
    lasts = brentq(lambda s: above(start + s, start), 0.008, 0.06)
    late_s = (simulate(rig)["flights"][5:] - start) * rig.frequency_hz % 1.0 / rig.frequency_hz
    assert late_s[:, 1] == pytest.approx(lasts % (1.0 / rig.frequency_hz), abs=1e-8)
    assert ((late_s[:, 0] + 2.5e-6) * rig.frequency_hz % 1.0 < 5e-6 * rig.frequency_hz).all()  # to a point of the grid


def test_friction_oil_and_rebound_act_as_newton_says():
    """After the fade, the flight that follows a rebound is that of a general solver for differential equations."""
    rig = Rig(
        gammas=(0.8,), instrument=QUIET, cycles=40, friction=0.08, restitution=0.4, viscous_per_s=2.0, gain=0.05, seed=1
    )
    flights, w = simulate(rig)["flights"], 2.0 * math.pi * rig.frequency_hz
    chained = np.flatnonzero((flights[1:, 0] == flights[:-1, 1]) & (np.diff(flights[1:])[:, 0] > 3e-3)) + 1
    first = next(k for k in chained if flights[k - 1, 0] != flights[k - 2, 1] and flights[k - 1, 0] > 0.2)

    def flown(start, h, u):
        """Landing time and speed; the rod's friction turns with the speed, and the ball does not come to a stop."""

        def slope(t, y):
            free = -G + 1.05 * 0.8 * G * 2.0 * math.sin(w * t)
            return [y[1], free - 0.08 * G * math.tanh(y[1] / 1e-6) - 2.0 * y[1]]

        def lands(t, y):
            return y[0] if t > start + 1e-3 else 1.0

        lands.terminal, lands.direction = True, -1.0
        found = solve_ivp(slope, (start, start + 0.2), [h, u], "LSODA", events=lands, rtol=1e-10, atol=1e-13)
        return found.t_events[0][0], -found.y_events[0][0][1]

    landing, speed = flown(flights[first - 1, 0], 0.0, 1e-9)
    assert landing == pytest.approx(flights[first - 1, 1], abs=2e-6)
    assert flown(landing, 0.0, 0.4 * speed)[0] == pytest.approx(flights[first, 1], abs=3e-6)


def test_each_fault_shows_as_stated():
    """An impact rings at the table's frequency; a coupling passes no constant; the contact's edges are slow."""
    still = np.zeros(int(0.2 * 51200) * 8)
    ringing = replace(QUIET, table_share=0.08, mount_hz=2e4, table_hz=1000.0, table_damping=0.05)
    volts = ringing.accelerometer_v(still, np.array([[0.05, 0.3]]), np.random.default_rng(1))
    after = volts[int(0.0504 * 51200) : int(0.0604 * 51200)]
    spectrum = np.abs(np.fft.rfft(after * np.hanning(after.size), 2**14))
    assert np.argmax(spectrum) * 51200 / 2**14 == pytest.approx(1000.0, rel=0.03)
    assert np.abs(volts[: int(0.05 * 51200)]).max() < 1e-12
    coupled = replace(QUIET, coupling_hz=0.5).accelerometer_v(still + 1.0, np.empty((0, 2)), np.random.default_rng(1))
    assert coupled[-1] == pytest.approx(0.1 * math.exp(-2.0 * math.pi * 0.5 * 0.2), rel=0.01)
    slow = replace(QUIET, rise_s=2e-4, film_v=0.0).contact_v(np.array([[0.02, 0.04]]), 3000, np.random.default_rng(1))
    t = np.arange(3000) / 51200
    up = (t > 0.02) & (t < 0.04)
    assert slow[up] == pytest.approx(5.0 - 5.0 * np.exp(-(t[up] - 0.02) / 2e-4), abs=1e-9)


@pytest.mark.parametrize("card", CARDS)
def test_the_owners_profile_says_nothing_of_what_is_hidden(card, tmp_path):
    """It is the same with and without hidden effects, and can be read."""
    rig = Rig(gammas=(0.6, 1.2), instrument=drawn(card, np.random.default_rng(3)))
    text = profile_of(rig)
    assert text == profile_of(replace(rig, friction=0.1, restitution=0.3, gain=0.05, seed=5))
    path = tmp_path / "profile.toml"
    path.write_text(text, encoding="utf-8")
    assert load_setup(path)[0].sampling.rate_hz == rig.instrument.rate_hz
