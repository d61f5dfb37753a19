"""The simulated rig's instrument: each part does what its data sheet says, in blocks of any size."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rig.sim.instrument import SECTIONS, sections, shown_acceleration
from rig.sim.plant import Plant
from rig.sim.scenario import RIG_DEFAULTS, Scenario
from rig.sim.state import initial_state

RATE = 20e3
FINE = {"accelerometer_noise_g": 0.0, "accelerometer_v_per_g": 2.0, "drive_noise_v": 0.0, "continuity_noise_v": 0.0}
EVERYTHING = {
    "low_pass_hz": 5e3, "low_pass_poles": 4.0, "high_pass_hz": 0.5, "mount_hz": 6e3, "cross_axis": 0.05,
    "sensor_clip_g": 2.0, "flicker_v": 1e-3, "contact_flicker_v": 5e-3, "bias_v": 0.01, "warm_up_v": 3e-3,
    "mains_v": 5e-3, "mains_odd": 0.5, "contact_mains_v": 0.1, "drive_mains_v": 3e-3, "fir_samples": 32.0,
    "between_channels_s": 5e-6, "film_v": 0.4, "hysteresis_v": 1.0, "bounce_s": 5e-4,
}  # fmt: skip


def volts(rig: dict[str, float], drive_v: np.ndarray) -> np.ndarray:
    """What the three channels read, V, (n, 3)."""
    plant = Plant(Scenario("x", {}, rig), RATE, np.random.default_rng(3))
    return plant.exchange(drive_v) * plant.channel_scales["drive"]


def shaken(seconds: float = 2.0) -> np.ndarray:
    """A drive that makes the ball fly."""
    t = np.arange(round(seconds * RATE)) / RATE
    return -1.1 * np.sin(2.0 * np.pi * 25.37 * t) * np.minimum(t / 0.1, 1.0)


def answer(rig: dict[str, float], hz: float, channel: int = 1) -> complex:
    """Gain and phase of a part at a frequency: a small tone with it, over the same without, ball at rest."""
    t = np.arange(8000) / RATE
    tone = np.exp(-2j * np.pi * hz * t[4000:])
    with_it, without = (
        tone @ (x - x.mean())
        for x in (volts({**FINE, **part}, 0.3 * np.sin(2.0 * np.pi * hz * t))[4000:, channel] for part in (rig, {}))
    )
    return complex(with_it / without)


def test_a_rig_without_an_instrument_reads_as_it_always_did() -> None:
    """Codes of a shaken plate are those from before there was an instrument."""
    codes = Plant(Scenario("ideal"), RATE, np.random.default_rng(3)).exchange(shaken())
    expected = [[16388, -515, -2627], [16379, -267, -1243], [16390, 90, 406], [16384, 384, 1969], [16384, 619, 3113]]
    assert np.abs(codes[20000:40000:4000] - np.array(expected)).max() <= 1


def test_a_part_that_passes_everything_changes_nothing() -> None:
    """Followed on the fine grid, plate and ringing are what they are at the samples; impacts start in between."""
    plain, seen = (volts({**FINE, **part}, shaken()) for part in ({}, {"sensor_clip_g": 1e6}))
    assert np.abs(plain - seen).max() < 2.0 * 10.0 / 32768.0


@pytest.mark.parametrize("cut", [1, 7, 900])
def test_blocks_of_any_size_give_the_same_codes(cut: int) -> None:
    """With every part at work: one call, or many of so many samples."""
    drive_v = shaken(0.3 if cut == 1 else 1.0)
    plant, whole = (Plant(Scenario("x", {}, EVERYTHING), RATE, np.random.default_rng(3)) for _ in range(2))
    pieces = [plant.exchange(drive_v[i : i + cut]) for i in range(0, drive_v.size, cut)]
    assert np.array_equal(np.concatenate(pieces), whole.exchange(drive_v))


@pytest.mark.parametrize("key", [*EVERYTHING, "warm_up_s", "mount_damping", "fir_accelerometer_only"])
def test_each_key_changes_the_codes(key: str) -> None:
    """Everything at once, less one key: other codes."""
    less = {**EVERYTHING, key: 0.3 if RIG_DEFAULTS[key] else 1.0 - bool(EVERYTHING.get(key)), "low_pass_poles": 4.0}
    less["low_pass_poles"] = 2.0 if key == "low_pass_poles" else 4.0
    assert (volts(less, shaken(0.5)) != volts(EVERYTHING, shaken(0.5))).any()


@pytest.mark.parametrize(("poles", "delay"), [(1, 1.0), (2, math.sqrt(2.0)), (4, 2.6131)])
def test_a_low_pass_has_its_corner_and_its_delay(poles: int, delay: float) -> None:
    """At the corner 1/sqrt 2 is left; slow signals are late by the sum of the Butterworth poles' time constants."""
    part = {"low_pass_hz": 1000.0, "low_pass_poles": float(poles)}
    assert abs(answer(part, 1000.0)) == pytest.approx(math.sqrt(0.5), rel=0.01)
    late_s = -np.angle(answer(part, 50.0)) / (2.0 * np.pi * 50.0)
    assert late_s == pytest.approx(delay / (2.0 * np.pi * 1000.0), rel=0.02)


def test_noise_passes_the_low_pass() -> None:
    """A filter of 1 kHz leaves the part of the noise that its bandwidth is of half the rate."""
    rig = {"accelerometer_v_per_g": 2.0}
    still = np.zeros(40000)
    free = volts(rig, still)[:, 1].std()
    held = volts({**rig, "low_pass_hz": 1000.0, "low_pass_poles": 4.0}, still)[100:, 1].std()
    assert free == pytest.approx(0.06, rel=0.02) and held == pytest.approx(free * math.sqrt(0.1026), rel=0.05)


def test_mount_and_sideways_motion() -> None:
    """Below resonance a mount lifts by 1 / (1 - (f / f0)^2), heavily damped it does not; sideways motion is added."""
    assert abs(answer({"mount_hz": 4000.0}, 1000.0)) == pytest.approx(16.0 / 15.0, rel=3e-3)
    assert abs(answer({"mount_hz": 4000.0, "mount_damping": 1.0}, 1000.0)) == pytest.approx(16.0 / 17.0, rel=3e-3)
    assert abs(answer({"cross_axis": 0.05}, 90.0)) == pytest.approx(1.15, rel=0.01)


def test_a_coupling_blocks_gravity_and_lets_a_step_decay() -> None:
    """With the time constant of its corner, from the moment of the step."""
    step = np.where(np.arange(8000) >= 2000, 0.25, 0.0)
    rig = {**FINE, "accelerometer_reads_gravity": 1.0}
    seen = volts({**rig, "high_pass_hz": 3.0}, step)[:, 1] / 2.0
    assert np.abs(seen[:1990]).max() < 1e-3 and volts(rig, step)[100, 1] / 2.0 == pytest.approx(1.0, abs=1e-3)
    assert seen[2000 + round(RATE / (2.0 * np.pi * 3.0))] == pytest.approx(0.5 * math.exp(-1.0), rel=0.01)


def test_a_sensor_ends_where_its_range_does() -> None:
    """Impacts and tones are cut off there."""
    assert np.abs(volts({**FINE, "sensor_clip_g": 1.5}, shaken())[:, 1]).max() == pytest.approx(3.0, abs=1e-3)


def test_a_sigma_delta_converter_is_late_by_its_filter_and_rings_before_an_edge() -> None:
    """All channels by 32 samples, or the accelerometer alone; the contact overshoots before its edges."""
    whole, alone = {"fir_samples": 32.0}, {"fir_samples": 32.0, "fir_accelerometer_only": 1.0}
    for part, channel, late in ((whole, 1, 32), (whole, 2, 32), (alone, 1, 32), (alone, 2, 0)):
        turned = answer(part, 100.0, channel)
        assert abs(turned) == pytest.approx(1.0, abs=3e-3)
        assert np.angle(turned) == pytest.approx(-2.0 * np.pi * 100.0 * late / RATE, abs=3e-3)
    assert volts({**FINE, **whole}, shaken())[:, 0].max() > 5.1 > volts(FINE, shaken())[:, 0].max()


def test_a_cable_and_a_plate_hum_with_the_same_grid() -> None:
    """Two frequencies would beat, as no laboratory's mains do: 50.2 Hz hidden are all that the accelerometer shows."""
    hidden = {"mains_hum": {"amplitude_g": 0.05, "frequency_hz": 50.2}}
    rig = {**RIG_DEFAULTS, **FINE, "mains_v": 0.05}
    plant = Plant(Scenario("x", hidden, rig), RATE, np.random.default_rng(3))
    shown = plant.exchange(np.zeros(200000))[:, 1].reshape(10, -1)
    sizes = np.abs((shown - shown.mean()) @ np.exp(-2j * np.pi * 50.2 / RATE * np.arange(20000)))
    assert np.ptp(sizes) < 0.01 * sizes.mean()


def test_what_amplifier_and_cables_add() -> None:
    """Bias, a zero that warms up, and mains with odd harmonics, in the channels they belong to."""
    part = {"bias_v": 0.2, "warm_up_v": 0.1, "warm_up_s": 0.5, "mains_v": 0.04, "mains_odd": 0.6, "drive_mains_v": 0.03}
    seen = volts({**FINE, **part, "contact_mains_v": 0.2}, np.zeros(40000))
    assert seen[:400, 1].mean() == pytest.approx(0.3, abs=3e-3)
    assert seen[-400:, 1].mean() == pytest.approx(0.2 + 0.1 * math.exp(-4.0), abs=1e-3)
    lines = 2.0 * np.abs(np.fft.rfft(seen, axis=0)) / 40000  # two seconds: bins of half a hertz
    assert lines[[100, 300, 500], 1] == pytest.approx([0.04, 0.008, 0.0048], rel=0.1)
    assert lines[100, [0, 2]] == pytest.approx([0.2, 0.03], rel=0.01)


def test_flicker_has_the_same_noise_in_each_octave() -> None:
    """The band from f to 2 f holds the stated rms, low or high."""
    noise = volts({**FINE, "flicker_v": 0.02}, np.zeros(2**17))[:, 1]
    power = 2.0 * np.abs(np.fft.rfft(noise)) ** 2 / noise.size**2
    octaves = [math.sqrt(power[2**k : 2 ** (k + 1)].sum()) for k in range(7, 14)]
    assert octaves == pytest.approx([0.02] * 7, rel=0.2)


def test_a_multiplexed_card_takes_the_drive_last() -> None:
    """The accelerometer is ahead of the drive by one interval between channels, the contact by two."""
    assert np.angle(answer({"between_channels_s": 2e-5}, 200.0)) == pytest.approx(-2.0 * np.pi * 200.0 * 2e-5, rel=0.02)
    slow = {**FINE, "rc_open_s": 1e-3}
    plain, seen = (volts({**slow, "between_channels_s": s}, shaken())[:, 0] for s in (0.0, 1e-5))
    rising = np.flatnonzero((plain[:-1] > 1.0) & (plain[:-1] < 4.0) & (np.diff(plain) > 0.05)) + 1
    assert len(rising) > 20
    assert 5.0 - seen[rising] == pytest.approx((5.0 - plain[rising]) * math.exp(0.02), rel=2e-3)


def test_film_and_hysteresis_of_the_contact() -> None:
    """A film raises each closed level by its own chance; a comparator leaves two levels and switches late both ways."""
    closed = volts({**FINE, "film_v": 0.4}, shaken())[:, 0]
    levels = closed[1:][(np.abs(np.diff(closed)) < 1e-3) & (closed[1:] < 1.0) & (closed[1:] > 0.1)]
    assert levels.min() > 0.19 and levels.max() < 0.61 and levels.std() > 0.05
    slow = {**FINE, "rc_open_s": 5e-4, "rc_close_s": 5e-4}
    plain, two = volts(slow, shaken())[:, 0], volts({**slow, "hysteresis_v": 2.0}, shaken())[:, 0]
    assert len(np.unique(two)) == 2
    rises = np.flatnonzero(np.diff(two) > 1.0)
    falls = np.flatnonzero(np.diff(two) < -1.0)
    assert (plain[rises] <= 3.501).all() and (plain[rises + 1] >= 3.499).all() and len(rises) > 10
    assert (plain[falls] >= 1.499).all() and (plain[falls + 1] <= 1.501).all()


def test_only_a_low_pass_reads_noise_between_samples() -> None:
    """Without one there is one number a sample, and none beyond it is read."""
    scenario = Scenario("x", {}, {"mount_hz": 4e3})
    params, _ = scenario.parameters()
    state = initial_state(1, 2, -1.0 / RATE).view(np.recarray)
    state.dt_s, state.a0 = 1.0 / RATE, 2.0
    taps = sections({**RIG_DEFAULTS, "mount_hz": 4e3}, RATE)
    for noise in (np.zeros(1), np.array([np.nan])):
        seen = shown_acceleration.py_func(
            state[0], params.view(np.recarray)[0], taps, np.zeros((SECTIONS, 2)), noise, 0.0, 0.0, 1.0
        )
        assert seen == pytest.approx(3.0)


def test_a_low_pass_with_a_strange_number_of_poles_is_refused() -> None:
    """Named with what was wanted."""
    with pytest.raises(ValueError, match=r"rig\.low_pass_poles: wanted 1, 2 or 4, got 3"):
        Scenario("x", {}, {"low_pass_poles": 3})
