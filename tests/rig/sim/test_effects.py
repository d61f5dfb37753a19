"""Hidden effects have the size their parameters say: against textbook formulas, on noiseless sensors."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest

from rig.sim.forces import rebound
from rig.sim.plant import Plant
from rig.sim.scenario import Scenario
from rig.sim.state import initial_state

RATE_HZ = 20000.0
FREQUENCY_HZ = 25.0
OMEGA = 2.0 * math.pi * FREQUENCY_HZ
QUIET = {"accelerometer_noise_g": 0.0, "continuity_noise_v": 0.0, "adc_range_v": 1.0}
T = np.arange(round(4.0 * RATE_HZ)) / RATE_HZ
LATE = slice(round(2.0 * RATE_HZ), None)


def plate_g(effects: dict[str, dict[str, float]], volts: float, rig: dict[str, float] | None = None) -> np.ndarray:
    """Accelerometer reading in g over the last two of four seconds of ``volts cos wt`` (2 g a volt)."""
    plant = Plant(Scenario("one", effects, QUIET | (rig or {})), RATE_HZ, np.random.default_rng(0))
    drive_v = volts * np.cos(OMEGA * T) * np.minimum(T, 1.0)
    return plant.exchange(drive_v)[LATE, 1] * plant.channel_scales["accelerometer"] / 0.1


def tone(x: np.ndarray, frequency_hz: float = FREQUENCY_HZ) -> complex:
    """Complex amplitude of a tone with a whole number of cycles in the two seconds."""
    return complex(2.0 * np.mean(x * np.exp(-2j * math.pi * frequency_hz * T[LATE])))


def test_gain_errors_scale_the_plate_and_its_reading() -> None:
    """Drive gain +10 %, accelerometer gain -5 %, offset 0.2 g."""
    assert tone(plate_g({"drive_gain": {"relative": 0.1}}, 0.3)) == pytest.approx(0.66, abs=2e-4)
    assert tone(plate_g({"accelerometer_gain": {"relative": -0.05}}, 0.3)) == pytest.approx(0.57, abs=2e-4)
    assert plate_g({"accelerometer_offset": {"offset_g": 0.2}}, 0.3).mean() == pytest.approx(0.2, abs=2e-4)


def test_lag_is_that_of_a_first_order_low_pass() -> None:
    """1 ms: amplitude 1/sqrt(1 + (w tau)^2), phase -atan(w tau)."""
    found = tone(plate_g({"phase_lag": {"time_constant_s": 1e-3}}, 0.3)) / 0.6
    assert found == pytest.approx(1.0 / (1.0 + 1j * OMEGA * 1e-3), abs=3e-4)


def test_the_accelerometers_lag_is_that_of_its_low_pass() -> None:
    """0.5 ms: the reading falls behind the plate by atan(w tau), with amplitude 1/sqrt(1 + (w tau)^2)."""
    found = tone(plate_g({"accelerometer_lag": {"time_constant_s": 5e-4}}, 0.3)) / 0.6
    assert found == pytest.approx(1.0 / (1.0 + 1j * OMEGA * 5e-4), abs=3e-4)


def test_the_accelerometers_high_pass_turns_its_reading_forward() -> None:
    """2 Hz: the reading leads the plate by atan(2 / f), and its zero at rest stays where it is."""
    shown = plate_g({"accelerometer_high_pass": {"corner_hz": 2.0}}, 0.3)
    assert tone(shown) / 0.6 == pytest.approx(1.0 / (1.0 - 4j * np.pi / OMEGA), abs=1e-3)
    assert np.mean(shown) == pytest.approx(np.mean(plate_g({}, 0.3)), abs=2e-3)


def test_a_cable_that_picks_up_the_mains_leaves_the_plate_alone() -> None:
    """0.1 g at 50 Hz in the reading, the forcing tone as it was."""
    shown = plate_g({"mains_pickup": {"amplitude_g": 0.1, "frequency_hz": 50.0, "phase_rad": 0.0}}, 0.3)
    assert abs(tone(shown, 50.0)) == pytest.approx(0.1, abs=2e-4)
    assert tone(shown) == pytest.approx(0.6, abs=2e-4)


def test_a_shaker_without_equaliser_is_a_second_order_high_pass() -> None:
    """5 Hz, damping 0.3: a = g s^2 / (s^2 + 2 d w0 s + w0^2)."""
    s, w0 = 1j * OMEGA, 2.0 * math.pi * 5.0
    found = tone(plate_g({}, 0.3, {"shaker_frequency_hz": 5.0, "shaker_damping": 0.3})) / 0.6
    assert found == pytest.approx(s * s / (s * s + 0.6 * w0 * s + w0 * w0), abs=3e-4)


def test_compression_falls_with_the_mean_square() -> None:
    """Gain 1 / (1 + k V^2 / 2) at amplitude V."""
    found = tone(plate_g({"gain_compression": {"per_v2": 0.5}}, 0.4))
    assert found == pytest.approx(0.8 / (1.0 + 0.5 * 0.08), abs=1e-3)


def test_distortion_makes_the_textbook_harmonics() -> None:
    """V + k2 V^2 + k3 V^3 of a cosine: k2 V^2 / 2 at 2f, k3 V^3 / 4 at 3f."""
    x = plate_g({"harmonic_distortion": {"second_per_v": 0.1, "third_per_v2": 0.2}}, 0.4)
    assert tone(x, 2.0 * FREQUENCY_HZ) == pytest.approx(2.0 * 0.1 * 0.08, abs=3e-4)
    assert tone(x, 3.0 * FREQUENCY_HZ) == pytest.approx(2.0 * 0.2 * 0.016, abs=3e-4)
    assert abs(x.mean()) < 2e-4


def test_a_bent_drive_of_three_tones_leaves_the_table_without_a_mean_acceleration() -> None:
    """The cube of tones at w, 2 w and 3 w has a mean, .0072 g here, which no suspension would let the plate follow."""
    bent = Scenario("bent", {"harmonic_distortion": {"third_per_v2": 0.2}}, QUIET)
    plant = Plant(bent, RATE_HZ, np.random.default_rng(0))
    drive_v = 0.2 * np.minimum(T, 1.0) * sum(np.cos(k * OMEGA * T) for k in (1, 2, 3))
    felt = plant.exchange(drive_v)[LATE, 1] * plant.channel_scales["accelerometer"] / 0.1
    assert abs(felt.mean()) < 2e-4


def test_hum_and_modulation_stand_where_they_should() -> None:
    """Hum at 50 Hz; modulation's sidebands at half the depth."""
    hum = plate_g({"mains_hum": {"amplitude_g": 0.05, "frequency_hz": 50.0}}, 0.3)
    assert abs(tone(hum, 50.0)) == pytest.approx(0.05, abs=2e-4)
    breathing = plate_g({"amplitude_modulation": {"depth": 0.1, "frequency_hz": 1.0}}, 0.3)
    assert abs(tone(breathing, FREQUENCY_HZ + 1.0)) == pytest.approx(0.5 * 0.1 * 0.6, abs=3e-4)


def test_a_ball_in_contact_loads_the_table() -> None:
    """At rest on the plate, mass ratio r: 1 / (1 + r) of the unloaded amplitude."""
    assert tone(plate_g({"mass_loading": {"mass_ratio": 0.08}}, 0.3)) == pytest.approx(0.6 / 1.08, abs=2e-4)


def test_the_slow_mode_answers_the_balls_load() -> None:
    """Ball at rest: y'' (1 + R) + 2 d w0 y' + w0^2 y = -R a, and the plate feels a + y''."""
    ratio, w0, damping = 0.05, 2.0 * math.pi * 8.0, 0.1
    effect = {"table_resonance": {"frequency_hz": 8.0, "damping": damping, "mass_ratio": ratio}}
    s = 1j * OMEGA
    response = -ratio * s * s / (s * s * (1.0 + ratio) + 2.0 * damping * w0 * s + w0 * w0)
    assert tone(plate_g(effect, 0.3)) == pytest.approx(0.6 * (1.0 + response), abs=3e-4)


def test_impacts_set_the_slow_mode_ringing_at_its_frequency() -> None:
    """A bouncing run puts power at the mode's frequency that a clean run does not have."""
    effect = {"table_resonance": {"frequency_hz": 8.0, "damping": 0.02, "mass_ratio": 0.05}}
    rig = {"ring_g_s_per_m": 0.0, "adc_range_v": 10.0}
    shaken, clean = plate_g(effect, 1.93, rig), plate_g({}, 1.93, rig)
    assert abs(tone(shaken, 8.0)) > 20.0 * abs(tone(clean, 8.0))


def first_opening_phase(effects: dict[str, dict[str, float]], volts: float) -> float:
    """Phase of the plate's forcing, sin convention, at which the circuit first opens late in the run."""
    plant = Plant(Scenario("one", effects, QUIET | {"adc_range_v": 10.0}), RATE_HZ, np.random.default_rng(0))
    codes = plant.exchange(-volts * np.sin(OMEGA * T) * np.minimum(T, 1.0))[LATE, 0]
    opened = np.flatnonzero((codes[1:] > 1638) & (codes[:-1] <= 1638))[0]
    return float((OMEGA * T[LATE][opened]) % (2.0 * math.pi))


@pytest.mark.parametrize(
    ("effects", "threshold_g"),
    [
        ({}, 1.0),
        ({"local_gravity": {"relative": 0.08}}, 1.08),
        ({"adhesion": {"pull_g": 0.2}}, 1.2),
        ({"position_force": {"spring_per_s2": 0.0, "magnet_g": 0.15, "range_m": 0.002}}, 1.15),
        ({"coulomb_friction": {"mu_up": 0.1, "mu_down": 0.0}}, 1.1),
        ({"stribeck_friction": {"mu_static": 0.2, "mu_kinetic": 0.05, "speed_mps": 0.05}}, 1.2),
        ({"ageing_threshold": {"pull_g": 0.2, "time_constant_s": 1e-4}}, 1.2),
    ],
)
def test_take_off_waits_for_what_holds_the_ball(effects: dict[str, dict[str, float]], threshold_g: float) -> None:
    """The circuit opens where gamma_peak sin(phase) reaches the threshold, within a sample."""
    wanted = math.asin(threshold_g / 1.6)
    assert first_opening_phase(effects, 0.8) == pytest.approx(wanted, abs=1.5 * OMEGA / RATE_HZ)


def test_a_contact_gap_opens_late_and_closes_on_time() -> None:
    """0.3 micrometres: the opening waits for the ball to rise, by the cube-root law of a tangency; landings stay."""
    volts = -0.8 * np.sin(OMEGA * T) * np.minimum(T, 1.0)
    rigs = [Scenario("a", {}, QUIET | {"adc_range_v": 10.0})]
    rigs.append(Scenario("b", {"contact_gap": {"gap_m": 3e-7}}, QUIET | {"adc_range_v": 10.0}))
    open_ = [Plant(rig, RATE_HZ, np.random.default_rng(0)).exchange(volts)[LATE, 0] > 8192 for rig in rigs]
    rising = [np.flatnonzero(x[1:] & ~x[:-1]) for x in open_]
    falling = [np.flatnonzero(~x[1:] & x[:-1]) for x in open_]
    jerk = 1.6 * 9.80665 * OMEGA * math.cos(math.asin(1.0 / 1.6))
    late_s = (6.0 * 3e-7 / jerk) ** (1.0 / 3.0)
    assert np.mean(rising[1] - rising[0]) / RATE_HZ == pytest.approx(late_s, rel=0.05)
    assert np.array_equal(falling[0], falling[1])


def test_an_impact_holds_the_circuit_closed() -> None:
    """A locked ball is never seen in contact; with a closure of 0.8 ms each impact is, for that long."""
    volts = -1.7 * np.sin(OMEGA * T) * np.minimum(T, 1.0)
    rig = Scenario("c", {"contact_closure": {"duration_s": 8e-4}}, QUIET | {"adc_range_v": 10.0})
    closed = Plant(rig, RATE_HZ, np.random.default_rng(0)).exchange(volts)[LATE, 0] < 8192
    edges = np.flatnonzero(np.diff(closed.astype(int)))
    lengths = np.diff(edges)[::2] if closed[edges[0] + 1] else np.diff(edges)[1::2]
    assert lengths / RATE_HZ == pytest.approx(8e-4, abs=1.1e-4)


def test_contact_bounce_opens_the_circuit_after_landings_only() -> None:
    """With bounce there are more openings than flights, all extra ones within the bounce time of a closing."""
    volts = -0.9 * np.sin(OMEGA * T) * np.minimum(T, 1.0)
    rigs = [Scenario("a", {}, QUIET), Scenario("b", {}, QUIET | {"bounce_s": 2e-3})]
    open_ = [Plant(rig, RATE_HZ, np.random.default_rng(0)).exchange(volts)[LATE, 0] > 16384 for rig in rigs]
    differs = np.flatnonzero(open_[0] != open_[1])
    landings = np.flatnonzero(open_[0][:-1] & ~open_[0][1:])
    since = differs - landings[np.searchsorted(landings, differs, side="right") - 1]
    assert differs.size > 50
    assert since.max() <= 2e-3 * RATE_HZ + 2


def test_phase_is_measured_as_the_tests_mean_it() -> None:
    """The ideal plate at 0.3 V: 0.6 g, no phase."""
    found = tone(plate_g({}, 0.3))
    assert abs(found) == pytest.approx(0.6, rel=5e-4)
    assert abs(cmath.phase(found)) < 5e-4


def test_a_rebound_that_scatters_does_so_as_a_two_sided_exponential() -> None:
    """Its mean is e0, its standard deviation as given, its kurtosis that of the distribution, 6."""
    effects = {"restitution": {"e0": 0.5}, "restitution_scatter": {"sd": 0.02}}
    parameters, _ = Scenario("one", effects, QUIET).parameters()
    state = initial_state(1, 2, 0.0)[0]
    off = np.array([rebound(state, parameters[0], 0.3, x) for x in np.random.default_rng(5).random(20000)]) - 0.5
    assert off.mean() == pytest.approx(0.0, abs=6e-4)
    assert off.std() == pytest.approx(0.02, rel=0.03)
    assert np.mean(off**4) / off.var() ** 2 == pytest.approx(6.0, abs=0.6)
