"""A high-pass undone before impacts are taken away, and put back."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import bilinear, lfilter

from analysis.flights.scan import plate_of, scan
from analysis.signals import PAD, PIECE, HighPass, Piece
from daq.recording import open_recording
from kernels.arrays import Floats

RATE_HZ, CORNER_HZ = 20e3, 3.0


def passed(volts: Floats, change: Callable[[Piece], None] = lambda piece: None) -> Floats:
    """The volts after both filters, piece by piece, ``change`` between them."""
    high_pass, out = HighPass(CORNER_HZ, RATE_HZ), []
    padded = np.concatenate([np.full(PAD, volts[0]), volts, np.full(PAD, volts[-1])]).astype(np.float32)
    for first in range(0, volts.size, PIECE):
        count = min(PIECE, volts.size - first)
        piece = Piece(first, count, {"accelerometer": padded[first : first + count + 2 * PAD].copy()})
        high_pass.undo(piece)
        change(piece)
        high_pass.redo(piece)
        out.append(piece.own("accelerometer").astype(np.float64))
    return np.concatenate(out)


def test_undone_and_put_back_a_recording_is_what_it_was() -> None:
    """A constant, tones and noise over three pieces come out as they went in, and the seams show nothing."""
    t = np.arange(2 * PIECE + 5000) / RATE_HZ
    noise = 1e-3 * np.random.default_rng(5).standard_normal(t.size)
    volts = 0.2 + 0.3 * np.sin(2.0 * np.pi * 25.37 * t) + noise
    assert np.abs(passed(volts) - volts).max() < 1e-5


def test_impact_taken_away_behind_a_high_pass_leaves_no_tail() -> None:
    """Of impacts with an area, taken away in the restored volts, the recorded tail of 53 ms goes with them."""
    n, starts, wave = PIECE + 20000, np.arange(3000, PIECE + 19000, 4001), np.sin(np.linspace(0.0, np.pi, 21))
    impacts = np.zeros(n)
    for start in starts:
        impacts[start : start + wave.size] = wave
    behind = lfilter(*bilinear([1.0, 0.0], [1.0, 2.0 * np.pi * CORNER_HZ], fs=RATE_HZ), impacts)
    tail = behind[starts[0] + 40 : starts[0] + 1000]
    assert tail.mean() < -5e-3

    def take_away(piece: Piece) -> None:
        own = piece.channels["accelerometer"]
        place = np.arange(own.size) - PAD + piece.first
        inside = (place >= 0) & (place < n)
        own[inside] -= impacts[place[inside]].astype(np.float32)

    left = passed(behind, take_away)
    assert left == pytest.approx(0.0, abs=0.08 * abs(tail.mean()))


def test_tones_behind_a_high_pass_are_those_of_the_motion(make) -> None:
    """Behind 3 Hz the tones err by six of their uncertainties, with the high-pass known by less than one."""
    gammas = [0.9, 1.2, 1.5, 1.8]
    with open_recording(make(gammas, hold=40).path) as recording:
        motion = plate_of(recording)
    with open_recording(make(gammas, hold=40, rig={"high_pass_hz": CORNER_HZ}).path) as recording:
        bent, mended = (scan(recording, high_pass_hz=hz).plate for hz in (0.0, CORNER_HZ))
    for own, before, after in zip(motion.steps, bent.steps, mended.steps, strict=True):
        assert own is not None and before is not None and after is not None
        wanted = own.tone(1)[0] / (1.0 - 1j * CORNER_HZ / own.frequency_hz)
        sigma = before.acceleration.amplitude_sigma()[0]
        assert abs(after.tone(1)[0] - wanted) < sigma
        assert abs(before.tone(1)[0] - wanted) > 3.0 * sigma


def test_tails_of_impacts_tell_the_corner_of_a_coupling_that_is_declared(make) -> None:
    """Behind 3 Hz that nobody measured, the harmonics that tails leave are taken away where the profile says AC."""
    quiet = {"high_pass_hz": CORNER_HZ, "accelerometer_noise_g": 1e-3}
    with open_recording(make(np.linspace(1.0, 1.8, 8), hold=40, rig=quiet).path) as recording:
        bent = plate_of(recording)
        channels = recording.setup.channels
        sensor = channels.accelerometer.model_copy(update={"coupling": "ac", "offset_v": None})
        channels = channels.model_copy(update={"accelerometer": sensor})
        recording.setup = recording.setup.model_copy(update={"channels": channels})
        mended = plate_of(recording)
    second = [[abs(s.tone(2)[0]) / abs(s.tone(1)[0]) for s in own.steps if s is not None] for own in (bent, mended)]
    assert np.median(second[0]) > 2.5e-4
    assert np.median(second[1]) < 0.3 * np.median(second[0])
