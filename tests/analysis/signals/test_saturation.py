"""Readings that stand at their end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from analysis.flights.assemble import FlightFlag, flights_of
from analysis.flights.compare import plausibility_warnings
from analysis.residuals.observations import observed
from analysis.statistics import nearest
from daq.files.tables import Block
from daq.instrument.channel_limits import NO_ENDS, common_ends, drive_is_cut_off, ends_in_noise, share_at_an_end
from daq.recording import open_recording
from daq.recording.writer import RecordingWriter

N, RATE_HZ = 4096, 20000.0


@pytest.mark.parametrize("noise", [0.0, 0.3, 3.0, 100.0])
@pytest.mark.parametrize("amplitude", [1, 3, 30, 1000, 20000])
def test_a_sine_that_turns_at_its_ends_does_not_stand_there(amplitude: float, noise: float) -> None:
    """Whole codes, with and without noise: only what is cut off stands at an end, for as long as it would be beyond."""
    rng = np.random.default_rng(7)
    codes = np.rint(amplitude * np.sin(2.0 * np.pi * 25.37 / 20000.0 * np.arange(N)) + noise * rng.standard_normal(N))
    assert share_at_an_end(codes, RATE_HZ) == 0.0
    if amplitude >= 30 and noise < 0.01 * amplitude:
        limit = np.floor(0.9 * amplitude)
        beyond = np.mean(codes >= limit)
        assert share_at_an_end(np.minimum(codes, limit), RATE_HZ) == pytest.approx(beyond, abs=0.01)
        flat = np.minimum(codes, limit) + 0.005 * amplitude * rng.standard_normal(N)
        assert share_at_an_end(flat, RATE_HZ) == pytest.approx(beyond, abs=0.02)
    assert share_at_an_end(np.zeros(N), RATE_HZ) == 0.0


@pytest.mark.parametrize("noise", [0.1, 0.2, 0.3, 0.5, 1.0])
@pytest.mark.parametrize("place", np.arange(0.0, 1.0, 0.125))
def test_a_sensor_that_ends_between_two_codes_is_at_its_end_in_either(place: float, noise: float) -> None:
    """A level that the converter reads as one code or the next, noise of less than a code: motion is cut off there."""
    rng, end = np.random.default_rng(6), 1530.0 + place
    g = 1700.0 * np.sin(2.0 * np.pi * 25.37 / RATE_HZ * np.arange(N))
    codes = np.rint(np.minimum(g, end) + noise * rng.standard_normal(N))
    assert share_at_an_end(codes, RATE_HZ) == pytest.approx(np.mean(g >= end), abs=0.02)


@pytest.mark.parametrize("tones", [(1,), (1, 2)])
def test_an_end_that_noise_hides_is_where_motion_no_longer_moves(tones: tuple[int, ...]) -> None:
    """An end .8 % below the peak of the strongest motion, noise of .6 %: found where it is, and nowhere without one,
    under a harmonic of 5 %, or with an impact that reads farther than a filter makes of one that is cut off."""
    rng, turns = np.random.default_rng(8), 2.0 * np.pi * 25.37 / RATE_HZ * np.arange(20000)
    g = np.sum([np.sin(m * turns) for m in tones], axis=0)
    noise = 0.006 * g.max() * rng.standard_normal((2, g.size))
    end, tones_hz = 0.992 * g.max(), [25.37 * m for m in tones]
    weak, cut = 0.7 * g + noise[0], np.minimum(g, end) + noise[1]
    low, high = ends_in_noise([weak, cut], NO_ENDS, RATE_HZ, tones_hz)
    assert low == -np.inf and high == pytest.approx(end - 0.024 * g.max(), abs=0.003 * g.max())
    overshot = np.where(np.arange(g.size) == 777, 1.1 * end, weak)  # as behind a filter of four poles
    assert ends_in_noise([overshot, cut], NO_ENDS, RATE_HZ, tones_hz) == (low, high)
    bent, struck = g + 0.05 * np.sin(3.0 * turns), weak + 4.0 * (np.arange(g.size) == 777)
    for others in ([weak, g + noise[1]], [weak, bent + noise[1]], [struck, cut]):
        assert ends_in_noise(others, NO_ENDS, RATE_HZ, tones_hz) == NO_ENDS


@pytest.mark.parametrize("rate_hz", [20000.0, 51200.0])
def test_impacts_that_are_all_alike_are_at_no_end(rate_hz: float) -> None:
    """Sixty impacts of 7 g within a twentieth: their peaks crowd, but do not stay; cut off at 5 g they do."""
    rng, time_s = np.random.default_rng(4), np.arange(round(3.0 * rate_hz)) / rate_hz
    since = np.mod(time_s, 0.05)
    size = 8.0 * (1.0 + 0.003 * rng.standard_normal(61))[(time_s / 0.05).astype(int)]
    g = np.sin(2.0 * np.pi * 20.0 * time_s) + size * np.exp(-since / 1e-3) * np.sin(2.0 * np.pi * 1800.0 * since)
    noise = 0.03 * rng.standard_normal(time_s.size)
    assert common_ends([g + noise], rate_hz) == NO_ENDS
    low, high = common_ends([np.minimum(g, 5.0) + noise], rate_hz)
    assert low == -np.inf and high == pytest.approx(4.88, abs=0.08)


def test_impacts_alone_at_the_end_are_no_motion_that_is_cut_off() -> None:
    """Ringing of 9 g on motion of 3 g, a sensor that ends at 6 g: the motion is not cut off."""
    rng, time_s = np.random.default_rng(3), np.arange(N) / RATE_HZ
    since = np.mod(time_s, 0.02)
    g = 3.0 * np.sin(2.0 * np.pi * 25.37 * time_s) + 9.0 * np.exp(-since / 1e-3) * np.sin(2.0 * np.pi * 1800.0 * since)
    shown = np.clip(g, -6.0, 6.0) + 0.03 * rng.standard_normal(N)
    assert share_at_an_end(shown, RATE_HZ) == 0.0


@pytest.mark.parametrize("offset_v", [0.00155, -0.3])
def test_an_end_is_known_again_when_units_have_changed(offset_v: float) -> None:
    """A range without noise behind it, cut off at .4 V and read as volts of four bytes: the same share as codes."""
    codes = 0.4 * 838860.0 * np.clip(1.1 * np.sin(2.0 * np.pi * 25.37 / RATE_HZ * np.arange(N)), -1.0, 1.0)
    volts = (np.rint(codes) / 838860.0 + offset_v).astype(np.float32)
    ends = [(end - offset_v) / 0.0102 for end in common_ends([volts], RATE_HZ)]
    shown = (volts - np.float32(offset_v)) / np.float32(0.0102)
    beyond = np.mean(np.abs(codes) >= 0.4 * 838860.0 - 1.0)
    assert share_at_an_end(shown, RATE_HZ, (ends[0], ends[1])) == pytest.approx(beyond, abs=0.01)


@pytest.mark.parametrize(("zero_g", "far_g"), [(np.nan, np.inf), (0.0, 3.9), (0.5, np.inf)])
def test_a_sensor_ends_as_far_below_zero_as_above(zero_g: float, far_g: float) -> None:
    """Gravity and motion of 5.2 g, 4 g either way: the lower end is hardly reached, and gamma was 8 % too small."""
    noise = 0.03 * np.random.default_rng(3).standard_normal(N)
    g = np.clip(1.0 + 5.2 * np.sin(2.0 * np.pi * 25.0 * np.arange(N) / RATE_HZ), -4.0, 4.0) + noise
    low, high = common_ends([g, np.maximum(g, -3.0)], RATE_HZ, zero_g)
    assert high == pytest.approx(3.9, abs=0.05)
    assert -low == pytest.approx(far_g, abs=0.1)
    assert common_ends([np.maximum(g, -3.0)], RATE_HZ, 0.0)[0] > -3.0  # an end of its own


@pytest.mark.parametrize("end_g", [4.0, 6.0])
def test_a_sensor_at_its_end_makes_no_flights(make, end_g: float) -> None:
    """Impacts that ring beyond the end of the sensor, and motion beyond it: each landing found is one."""
    rig = {"sensor_clip_g": end_g}
    with open_recording(make(np.linspace(1.0, 4.9, 12) / 5.0, ratio=2, hold=20, rig=rig).path) as recording:
        flights = flights_of(recording)
    ideal = make(np.linspace(1.0, 4.9, 12) / 5.0, ratio=2, hold=20).path
    with open_recording(ideal) as recording:
        truth = flights_of(recording).landing_s
    taken = flights.landing_s[~flights.has(FlightFlag.FALSE)]
    assert np.abs(truth[nearest(truth, taken)] - taken).max() < 5e-4
    assert len(taken) > 0.9 * len(truth)
    for step in flights.plate.steps:
        assert step is not None
        assert step.saturated or step.gamma_peak < 1.1 * end_g
        assert not step.saturated or step.gamma_peak > 0.98 * end_g


def test_motion_beyond_the_sensors_end_by_some_per_cent_keeps_its_gamma(make) -> None:
    """Peaks of up to 4.6 g behind a sensor that ends at 4 g: gamma comes from the rest of each cycle, as uncertain as
    it is stated, and the steps are used and named; cut off in the fit, they were 4 and 11 % too small."""
    gammas = np.linspace(1.0, 4.9, 12) / 5.0
    with open_recording(make(gammas, ratio=2, hold=20).path) as recording:
        whole = flights_of(recording).plate
    with open_recording(make(gammas, ratio=2, hold=20, rig={"sensor_clip_g": 4.0}).path) as recording:
        plate = flights_of(recording).plate
        kept = observed(recording, flights_of(recording)).steps.number
    pulls = []
    for own, cut in zip(whole.steps, plate.steps, strict=True):
        assert own is not None and cut is not None and cut.usable
        assert cut.gamma == pytest.approx(own.gamma, rel=5e-3)
        pulls.append((cut.gamma - own.gamma) / cut.gamma_uncertainty)
    assert np.abs(pulls).max() < 3.0
    assert kept.tolist() == list(range(12))
    (warning,) = plate.warnings()
    assert "in step 9, 10, 11:" in warning and "gamma comes from the rest" in warning


def test_steps_whose_landings_a_sensor_at_its_end_may_miss_are_left_out(make) -> None:
    """A ball that bounces closes no circuit: flights of cut off steps are unsure, and no closed loop uses the steps."""
    gammas, bounces = np.linspace(1.0, 4.9, 12) / 5.0, {"restitution": {"e0": 0.4}}
    path = make(gammas, ratio=2, hold=20, effects=bounces, rig={"sensor_clip_g": 4.0}).path
    with open_recording(path) as recording:
        flights = flights_of(recording)
        seen = observed(recording, flights)
    cut_off = [s.step for s in flights.plate.steps if s is not None and s.saturated]
    assert cut_off and flights.has(FlightFlag.UNSURE)[np.isin(flights.step, cut_off)].all()
    assert seen.steps.number.tolist() == [k for k in range(12) if k not in cut_off]
    assert any("only the accelerometer shows its landings" in note for note in seen.notes)


def test_steps_of_a_saturated_accelerometer_are_told_and_left_out(make, tmp_path: Path) -> None:
    """A sensor that ends at 1.2 g, and both tones together reach twice gamma: steps beyond are named in a warning, and
    no closed loop uses them."""
    with open_recording(make([0.3, 0.5, 0.8, 0.9], hold=20).path) as source:
        codes = np.column_stack([source.codes(name) for name in source.channels])
        at = source.channels.index("accelerometer")
        one_g = 9.80665 * abs(source.setup.channels.accelerometer.volts_per_mps2) / source.scale("accelerometer")[0]
        rest = round(float(np.median(codes[:2000, at])))
        codes[:, at] = np.clip(codes[:, at], rest - round(1.2 * one_g), rest + round(1.2 * one_g))
        with RecordingWriter(
            tmp_path / "cut.h5", source.setup, profile_text="", channels=source.channels, backend="test", simulated=True
        ) as writer:
            writer.append(Block(0, codes, lost_before=0))
            for step in source.steps:
                writer.mark_step(step)
    with open_recording(tmp_path / "cut.h5") as recording:
        flights = flights_of(recording)
        (warning,) = (w for w in plausibility_warnings(recording, flights, None) if "saturates" in w)
        seen = observed(recording, flights)
    assert "the accelerometer saturates in step 2, 3:" in warning
    assert warning in seen.notes
    assert seen.steps.number.tolist() == [0, 1]


@pytest.mark.parametrize("rate_hz", [1e3, 2e3, 5e3, 20e3])
def test_a_whole_drive_of_few_samples_a_cycle_is_not_cut_off(rate_hz: float) -> None:
    """The same few places of a sine are read in each cycle, so that readings crowd at its peaks, too."""
    rng, time_s = np.random.default_rng(1), np.arange(int(rate_hz)) / rate_hz
    for phase in rng.uniform(0.0, 2.0 * np.pi, 30):
        drive = 0.3 * np.sin(2.0 * np.pi * 25.0 * time_s + phase) + rng.normal(0.0, 1e-3, time_s.size)
        assert not drive_is_cut_off(drive, rate_hz)
    assert drive_is_cut_off(np.minimum(drive, 0.25), rate_hz) == (rate_hz >= 8e3)
