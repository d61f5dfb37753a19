"""The forcing: exact phase over any length, samples that depend on their index alone."""

from __future__ import annotations

from fractions import Fraction

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.programme.ramp import Fade, PhaseClock, drive_amplitudes, synthesise

DECIMAL_HZ = st.decimals(min_value="0.5", max_value="400", places=4)
RATES_HZ = st.sampled_from([8000.0, 20000.0, 44100.0, 48000.0, 200000.0, 51200.5])


@given(frequency=DECIMAL_HZ, rate_hz=RATES_HZ, sample=st.integers(0, 10**13))
def test_phase_never_drifts(frequency, rate_hz, sample) -> None:
    """The phase of any sample up to 10^13 is that of exact rational arithmetic."""
    clock = PhaseClock.of(float(frequency), rate_hz)
    exact = Fraction(str(frequency)) / Fraction(repr(rate_hz)) * sample
    assert Fraction(clock.phase(sample), clock.den) == exact - int(exact)


@pytest.mark.parametrize("first", [0, 10**9 - 100, 10**12])
@pytest.mark.parametrize("multiple", [1, 2, 7])
def test_samples_against_forty_digits(first: int, multiple: int) -> None:
    """After 10^9 and 10^12 samples each sample is still the sine of forty-digit arithmetic, to rounding."""
    clock = PhaseClock.of(25.37, 20000.0)
    drive = synthesise(clock, (multiple,), Fade(0, 0, (0j,), (0.6 - 0.8j,)), first, 200)
    with mpmath.workdps(40):
        turns = [mpmath.mpf(multiple) * (first + k) * 2537 / 2000000 for k in range(200)]
        exact = [0.6 * mpmath.cos(2 * mpmath.pi * t) + 0.8 * mpmath.sin(2 * mpmath.pi * t) for t in turns]
        worst = max(abs(x - y) for x, y in zip(drive.tolist(), exact, strict=True))
    assert worst < 8e-16


@given(cut=st.lists(st.integers(1, 400), min_size=1, max_size=8), first=st.integers(0, 10**10))
def test_blocks_do_not_show(cut: list[int], first: int) -> None:
    """The same samples come out bit for bit however they are cut into blocks, through a fade."""
    clock = PhaseClock.of(31.0417, 48000.0)
    fade = Fade(first + 100, 700, (0.1 + 0.2j, 0j), (1.5 - 0.5j, 0.3j))
    whole = synthesise(clock, (1, 3), fade, first, sum(cut))
    starts = np.cumsum([0, *cut[:-1]])
    pieces = [synthesise(clock, (1, 3), fade, first + int(s), n) for s, n in zip(starts, cut, strict=True)]
    assert np.array_equal(np.concatenate(pieces), whole)


@given(frequency=DECIMAL_HZ, rate_hz=RATES_HZ, cycle=st.integers(0, 10**10))
def test_cycle_boundaries(frequency, rate_hz, cycle) -> None:
    """A cycle starts at the first sample at or after its boundary, and a sample knows the next cycle."""
    clock = PhaseClock.of(float(frequency), rate_hz)
    start = clock.cycle_start(cycle)
    assert start * clock.num >= cycle * clock.den > (start - 1) * clock.num
    assert clock.cycle_after(start) == cycle
    assert clock.cycle_after(start + 1) == cycle + 1


def test_fade_is_bounded_and_lands() -> None:
    """A fade starts with its start, ends with its end, and is never steeper than 1.5 times a straight line."""
    fade = Fade(50, 1000, (1.0 + 0j,), (3.0 + 4j,))
    values = np.array([fade.at(n)[0] for n in range(0, 1200)])
    assert values[50] == 1.0 and values[1050] == values[-1] == 3.0 + 4j
    assert np.abs(np.diff(values)).max() <= 1.5 * abs(2 + 4j) / 1000 * (1 + 1e-9)


@pytest.mark.parametrize("ratio", [1, 2, 3])
def test_drive_makes_the_asked_acceleration(make_profile, ratio: int) -> None:
    """Through the declared response, the drive gives the acceleration of A [sin wt + sin c wt], gamma for gamma."""
    profile = make_profile(("g_per_volt = 2.0", "g_per_volt = 2.0\nphase_deg = 30.0"), ratio=ratio)
    response = 2.0 * np.exp(1j * np.pi / 6)
    phi = np.linspace(0, 2 * np.pi, 97)
    tones = zip(profile.forcing.displacement_tones(), drive_amplitudes(profile, 0.7), strict=True)
    in_g = sum(np.real(response * v * np.exp(1j * m * phi)) for (m, _), v in tones)
    assert in_g == pytest.approx(-0.7 * (np.sin(phi) + ratio**2 * np.sin(ratio * phi)), abs=1e-12)


def test_no_scale_no_drive(make_profile) -> None:
    """Without the drive's scale there are no drive volts."""
    setup = make_profile().setup().model_copy(update={"drive": type(make_profile().drive)()})
    with pytest.raises(ValueError, match="g_per_volt"):
        drive_amplitudes(setup, 1.0)


def test_impossible_clock_is_refused() -> None:
    """A tone too slow to count is refused."""
    with pytest.raises(ValueError, match="phase clock"):
        PhaseClock.of(1e-15, 20000.0)
