"""Coupling capacitors: the filter against the circuit's response, and the drive that is asked for behind one."""

from __future__ import annotations

import numpy as np
import pytest

from bench.profiles.find import load
from rig.profile import parse_profile
from rig.programme.ramp import Fade, HighPass, PhaseClock, drive_amplitudes, synthesise


@pytest.mark.parametrize("f_hz", [2.0, 5.0, 20.0, 400.0])
def test_response_is_the_circuits(f_hz: float) -> None:
    """A tone keeps ``(i f / fc) / (1 + i f / fc)`` of itself, block by block as at once; 5 Hz turns 20 Hz by 14 deg."""
    rate_hz, corner_hz = 20000.0, 5.0
    n = np.arange(200_000)
    tone = np.cos(2 * np.pi * f_hz * n / rate_hz)
    part = HighPass(corner_hz, rate_hz)
    out = np.concatenate([part(piece) for piece in np.split(tone, [1, 1000, 1777])])
    assert np.array_equal(out, HighPass(corner_hz, rate_hz)(tone))
    last = slice(100_000, 200_000)
    kept = 2 * np.mean(out[last] * np.exp(-2j * np.pi * f_hz * n[last] / rate_hz))
    expected = (1j * f_hz / corner_hz) / (1 + 1j * f_hz / corner_hz)
    assert abs(kept - expected) < 1e-3 * abs(expected)
    if f_hz == 20.0:
        assert np.degrees(np.angle(kept)) == pytest.approx(14.04, abs=0.05)


def test_without_a_corner_nothing_changes() -> None:
    """No capacitor: the very same samples."""
    volts = np.arange(5.0)
    assert HighPass(None, 1000.0)(volts) is volts


def test_the_drive_is_asked_for_so_that_the_plate_gets_its_waveform() -> None:
    """Two tones at c = 2 behind a 5 Hz corner: what comes out is what was wanted; uncorrected, 10 % off."""
    _, text = load("c2")
    plain = parse_profile(text)
    coupled = parse_profile(text.replace("[drive] ", "[drive]\nhighpass_hz = 5.0\n#", 1))
    assert coupled.drive.highpass_hz == 5.0
    clock = PhaseClock.of(plain.forcing.frequency_hz, plain.sampling.rate_hz)

    def played(profile: object) -> np.ndarray:
        target = drive_amplitudes(profile, 0.8)  # type: ignore[arg-type]
        return synthesise(clock, (1, 2), Fade(0, 0, target, target), 0, 60_000)

    wanted = played(plain)[40_000:]
    for profile, near in ((coupled, 1e-3), (plain, 0.5)):
        got = HighPass(5.0, plain.sampling.rate_hz)(played(profile))[40_000:]
        off = np.sqrt(np.mean((got - wanted) ** 2) / np.mean(wanted**2))
        assert off < near
    assert off > 0.1
