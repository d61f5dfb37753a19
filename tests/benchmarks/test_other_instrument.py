"""The other plant's instruments: each part does to the volts what its data sheet says, and none does nothing."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.plants import other_plant as plant
from benchmarks.plants.handed_over import FLIGHTS, Afterwards
from benchmarks.plants.instrument import PULSE, RINGING, Instrument, accelerometer_v, contact_v, flicker
from rig.profile import load_setup

RATE, OVER = 20e3, 10
NONE = np.empty((0, 2))


def shown(part: Instrument, felt_g: np.ndarray, impacts: np.ndarray = NONE, rate: float = RATE) -> np.ndarray:
    """Acceleration in g behind an instrument without noise."""
    return 10.0 * accelerometer_v(part, felt_g, impacts, rate, OVER, 0.0, np.random.default_rng(1))


def answer(part: Instrument, hz: float, n: int = 8000) -> complex:
    """Gain and phase of a part at a frequency, by a fit to the second half of a sine."""
    felt = np.sin(2.0 * np.pi * hz * np.arange(n * OVER) / (RATE * OVER))
    t = np.arange(n // 2, n) / RATE
    basis = np.column_stack([np.sin(2.0 * np.pi * hz * t), np.cos(2.0 * np.pi * hz * t)])
    (real, imaginary), *_ = np.linalg.lstsq(basis, shown(part, felt)[n // 2 :], rcond=None)
    return complex(real, imaginary)


def test_published_recordings_stay_as_they_were() -> None:
    """Without an instrument the plant gives the volts on which the published scores stand."""
    data = plant.simulate(plant.Run(gammas=(0.6, 1.2, 1.8), cycles=12, seed=5))
    for name, at, total in (
        ("continuity_v", 4.958053368370256, 100748.75158574773),
        ("accelerometer_v", 0.0837095154183039, 2883.7737514209657),
        ("drive_v", -0.08782012252051526, 282.1501264119095),
    ):
        assert data[name][4321] == pytest.approx(at, rel=1e-12) and data[name].sum() == pytest.approx(total, rel=1e-12)


def test_flights_flown_are_the_truth_between_edges_and_impacts() -> None:
    """Each flight of the truth ends at an impact, none overlaps the next, and the circuit reads open in its middle."""
    data = plant.simulate(
        plant.Run(gammas=(1.2, 1.8), seed=5, jitter_s=0.0, hidden=plant.hidden_by("restitution", "medium"))
    )
    flights = data["flights"]
    assert np.isin(flights[:, 1], data["impacts"][:, 0]).all() and (np.diff(flights.ravel()) >= 0.0).all()
    long = flights[np.diff(flights)[:, 0] > 1e-3]
    assert (data["continuity_v"][(long.mean(axis=1) * RATE).astype(int)] > 4.0).all() and len(long) > 50


@pytest.mark.parametrize(("poles", "delay"), [(1, 1.0), (2, math.sqrt(2.0)), (4, 2.6131)])
def test_a_low_pass_has_its_corner_and_its_delay(poles: int, delay: float) -> None:
    """At the corner 1/sqrt 2 is left; slow signals are late by the sum of the Butterworth poles' time constants."""
    part = Instrument(low_pass_hz=3000.0, low_pass_poles=poles)
    assert abs(answer(part, 3000.0)) == pytest.approx(math.sqrt(0.5), rel=1e-3)
    assert -np.angle(answer(part, 50.0)) / (2.0 * np.pi * 50.0) == pytest.approx(
        delay / (2.0 * np.pi * 3000.0), rel=5e-3
    )


def test_a_low_pass_keeps_what_would_alias_away() -> None:
    """A tone above half the sampling rate is weakened as an analogue filter does before it is folded down."""
    part = Instrument(low_pass_hz=5000.0, low_pass_poles=2)
    felt = np.sin(2.0 * np.pi * 17e3 * np.arange(4000 * OVER) / (RATE * OVER))
    left = math.sqrt(2.0) * shown(part, felt)[1000:].std()
    assert left == pytest.approx(1.0 / math.sqrt(1.0 + (17.0 / 5.0) ** 4), rel=0.05)
    assert math.sqrt(2.0) * shown(Instrument(), felt)[1000:].std() == pytest.approx(1.0, rel=1e-3)


def test_noise_passes_the_filter_of_its_channel() -> None:
    """Behind a filter of 1 kHz the noise between samples is a small part of that in front of it."""
    rng, still = np.random.default_rng(3), np.zeros(20000 * OVER)
    free = accelerometer_v(Instrument(), still, NONE, RATE, OVER, 0.03, rng)
    held = accelerometer_v(Instrument(low_pass_hz=1000.0, low_pass_poles=4), still, NONE, RATE, OVER, 0.03, rng)
    assert free.std() == pytest.approx(0.003, rel=0.03)
    assert held.std() == pytest.approx(0.003 * math.sqrt(1000.0 * 1.026 / 10000.0), rel=0.05)
    assert np.diff(held).std() < 0.3 * held.std() * math.sqrt(2.0)


def test_a_sigma_delta_converter_rings_before_a_step_and_is_late_by_its_delay() -> None:
    """Its filter passes 0.4 of the rate, stops 0.6 of it, and answers a step symmetrically about the delay."""
    part = Instrument(fir_samples=32)
    assert abs(answer(part, 8000.0)) == pytest.approx(1.0, abs=0.01)
    felt = np.sin(2.0 * np.pi * 12e3 * np.arange(4000 * OVER) / (RATE * OVER))
    assert np.abs(shown(part, felt)[200:]).max() < 0.01
    step = shown(part, (np.arange(200 * OVER) >= 100 * OVER).astype(float))
    before, after = step[132 - 20 : 132], step[133 : 133 + 20]
    assert before == pytest.approx(1.0 - after[::-1], abs=0.06) and np.abs(before).max() > 0.05
    assert np.abs(step[:100]).max() < 1e-3
    assert part.shown_at_s(2, RATE) == pytest.approx(-32 / RATE)
    assert replace(part, fir_accelerometer_only=1.0).shown_at_s(2, RATE) == 0.0


def test_a_coupling_lets_nothing_constant_through() -> None:
    """A step decays with the time constant of the corner, and gravity is gone."""
    felt = 1.0 + (np.arange(8000 * OVER) >= 2000 * OVER)
    seen = shown(Instrument(high_pass_hz=3.0), felt)
    assert np.abs(seen[:1999]).max() < 1e-9
    tau = 1.0 / (2.0 * np.pi * 3.0)
    assert seen[2000 + int(tau * RATE)] == pytest.approx(math.exp(-1.0), rel=1e-3)


def test_a_mount_lifts_the_sensitivity_at_its_resonance() -> None:
    """At its own frequency by 1 / 2 D; below by 1 + (f / f0)^2; with D = 1 it falls instead."""
    part = Instrument(mount_hz=4000.0, mount_damping=0.05)
    assert abs(answer(part, 4000.0)) == pytest.approx(10.0, rel=0.02)
    assert abs(answer(part, 400.0)) == pytest.approx(1.0 + 0.01, rel=2e-3)
    assert abs(answer(replace(part, mount_damping=1.0), 4000.0)) == pytest.approx(0.5, rel=2e-3)


def test_sideways_motion_is_taken_for_vertical_one() -> None:
    """At the sideways mode the cross-axis part of it is added, at rest nothing."""
    part = Instrument(cross_axis=0.05)
    assert abs(answer(part, 90.0)) == pytest.approx(1.15, rel=0.02)
    assert shown(part, np.ones(1000))[-1] == pytest.approx(1.0)


def test_impacts_ring_from_their_own_moment() -> None:
    """A table that rings follows its decaying sine between samples; a pulse has its share of the impact's momentum."""
    impacts, felt = np.array([[0.0123456, 0.4]]), np.zeros(600 * OVER)
    size, hz, decay_s = RINGING
    t = np.arange(600) / RATE - 0.0123456
    ringing = np.where(t > 0.0, -0.4 * size * np.exp(-t / decay_s) * np.sin(2.0 * np.pi * hz * t), 0.0)
    assert shown(Instrument(), felt, impacts) == pytest.approx(ringing, abs=1e-4)
    pulse = shown(Instrument(pulse=1.0), np.zeros(6000 * OVER), impacts, rate=200e3)
    assert -9.80665 * pulse.sum() / 200e3 == pytest.approx(0.4 * PULSE[0], rel=0.05)


def test_what_the_accelerometers_amplifier_adds() -> None:
    """Bias, a zero that warms up, mains with odd harmonics, and an end of the range."""
    still = np.zeros(40000 * OVER)
    part = Instrument(bias_v=0.02, warm_up_v=0.01, warm_up_s=0.5, mains_v=0.004, mains_odd=0.6)
    volts = shown(part, still) / 10.0
    assert volts[: int(RATE / 50)].mean() == pytest.approx(0.03, abs=3e-4)
    assert volts[-int(RATE / 50) :].mean() == pytest.approx(0.02 + 0.01 * math.exp(-4.0), abs=2e-5)
    lines = 2.0 * np.abs(np.fft.rfft(volts)) / volts.size  # two seconds: bins of half a hertz
    assert lines[[100, 300, 500]] == pytest.approx([0.004, 0.0008, 0.00048], rel=0.1)
    assert np.abs(shown(Instrument(sensor_clip_g=2.0), np.full(100, -5.0))).max() == 2.0


def test_flicker_has_the_same_noise_in_each_octave() -> None:
    """The band from f to 2 f holds the stated rms, low or high."""
    noise = flicker(2**18, 0.002, np.random.default_rng(2))
    power = 2.0 * np.abs(np.fft.rfft(noise)) ** 2 / noise.size**2
    octaves = [math.sqrt(power[2**k : 2 ** (k + 1)].sum()) for k in range(8, 17)]
    assert octaves == pytest.approx([0.002] * 9, rel=0.15)


def circuit(part: Instrument, n: int = 4000, rate: float = RATE) -> np.ndarray:
    """Volts of a contact that opens at 20.01 ms and closes at 80.02 ms."""
    times, opens = np.array([0.02001, 0.08002]), np.array([True, False])
    return contact_v(part, times, opens, rate, OVER, n, np.random.default_rng(1))


def test_a_slow_contact_follows_its_time_constants() -> None:
    """From the exact edge on, up with one time constant and down with another."""
    volts, t = circuit(Instrument(rc_open_s=2e-4, rc_close_s=5e-5)), np.arange(4000) / RATE
    up = (t > 0.02001) & (t < 0.08)
    assert volts[up] == pytest.approx(4.96 - 4.93 * np.exp(-(t[up] - 0.02001) / 2e-4), abs=1e-9)
    assert volts[t > 0.08002] == pytest.approx(0.03 + 4.93 * np.exp(-(t[t > 0.08002] - 0.08002) / 5e-5), abs=1e-6)


def test_a_comparator_with_hysteresis_switches_late_both_ways() -> None:
    """It reads open when the voltage has passed the upper threshold, closed when it has passed the lower."""
    part, rate = Instrument(rc_open_s=2e-4, rc_close_s=2e-4, hysteresis_v=2.0), 1e6
    reads_open = circuit(part, 200_000, rate) > 2.5
    assert set(np.unique(circuit(part))) == {0.03, 4.96}
    up, down = np.flatnonzero(np.diff(reads_open.astype(int))) / rate
    assert up - 0.02001 == pytest.approx(2e-4 * math.log(4.93 / (4.96 - 3.5)), abs=3e-6)
    assert down - 0.08002 == pytest.approx(2e-4 * math.log(4.93 / (1.5 - 0.03)), abs=3e-6)


def test_film_and_chatter_show_where_the_contact_is_closed() -> None:
    """A film raises the closed level only; chatter opens the circuit for a while after a landing and then no more."""
    clean, film = circuit(Instrument()), circuit(Instrument(film_v=0.6))
    assert film[clean > 4.0] == pytest.approx(4.96) and film[clean < 4.0].min() > 0.2
    chatter = [contact_v(Instrument(bounce_s=2e-3), np.array([0.02, 0.08]), np.array([True, False]), 1e5, 1, 10000,
                         np.random.default_rng(seed)) for seed in range(20)]  # fmt: skip
    after = np.array([volts[8001:] > 2.5 for volts in chatter])
    assert after[:, :200].any() and not after[:, 200:].any()


def test_a_multiplexed_card_takes_each_channel_later_than_the_one_before() -> None:
    """The accelerometer is ahead by one interval between channels, the drive by two."""
    part = Instrument(between_channels_s=5e-6)
    assert np.angle(answer(part, 100.0)) / (2.0 * np.pi * 100.0) == pytest.approx(5e-6, rel=1e-3)
    assert part.shown_at_s(0, RATE) == 0.0 and part.shown_at_s(2, RATE) == 1e-5


@pytest.mark.parametrize("rate", [10e3, 44.1e3, 96e3])
def test_an_instrument_changes_the_volts_and_not_the_flights(rate: float) -> None:
    """At any rate: the same flights, the contact unchanged, impacts seen."""
    run = plant.Run(gammas=(1.6,), cycles=10, rate_hz=rate, seed=4, jitter_s=0.0)
    plain = plant.simulate(run)
    behind = plant.simulate(replace(run, instrument=Instrument(low_pass_hz=3000.0, low_pass_poles=2)))
    assert np.array_equal(plain["flights"], behind["flights"])
    assert np.count_nonzero((plain["continuity_v"] > 2.5) != (behind["continuity_v"] > 2.5)) <= len(plain["impacts"])
    assert np.abs(behind["accelerometer_v"]).max() > 1.2 * np.abs(plain["accelerometer_v"]).max()


def test_what_happens_to_a_file_afterwards(tmp_path) -> None:
    """Rate, drive, delays, losses and clock change as stated; the profile has what its owner would know."""
    run = plant.Run(gammas=(1.6,), cycles=10, seed=4)
    data, rng = plant.simulate(run), np.random.default_rng(1)
    n = data["time_s"].size
    for polyphase in (False, True):
        out = Afterwards(resampled_hz=48e3, polyphase=polyphase).apply(data, RATE, rng)
        assert out["time_s"][4800] == pytest.approx(0.1)
        assert out["drive_v"][4800] == pytest.approx(data["drive_v"][2000], abs=2e-3)
    assert np.array_equal(Afterwards(drive="inverted").apply(data, RATE, rng)["drive_v"], -data["drive_v"])
    late = Afterwards(late_samples=(("accelerometer_v", 2),)).apply(data, RATE, rng)
    assert np.array_equal(late["accelerometer_v"][2:], data["accelerometer_v"][:-2])
    filled = Afterwards(filled_hz=6.4e3).apply(data, RATE, rng)["accelerometer_v"]
    assert np.array_equal(filled[[0, 3, 4, 6, 7]], data["accelerometer_v"][[0, 0, 3, 3, 6]])
    assert n - 900 <= Afterwards(losses=3).apply(data, RATE, rng)["time_s"].size <= n - 20
    fast = Afterwards(clock=6e-5).apply(data, RATE, rng)
    assert fast["time_s"][-1] == pytest.approx(data["time_s"][-1] * 1.00006, rel=1e-12)
    assert fast[FLIGHTS] == pytest.approx(data[FLIGHTS] * 1.00006, rel=1e-12)
    missing = Afterwards(drive="missing")
    assert "drive_v" not in missing.apply(data, RATE, rng)
    described = tmp_path / "profile.toml"
    described.write_text(missing.profile(plant.profile_of(run)), encoding="utf-8")
    setup, _ = load_setup(described)
    assert setup.drive.g_per_volt is None
    described.write_text(
        Afterwards(resampled_hz=44.1e3, drive="scaled").profile(plant.profile_of(run)), encoding="utf-8"
    )
    setup, _ = load_setup(described)
    assert setup.sampling.rate_hz == 44.1e3 and setup.drive.g_per_volt is None
