"""The forcing as drive samples: every sample is a function of its index only, whatever block it falls in.

Phase is counted in whole numbers. With the forcing at ``num / den`` turns a sample (an exact
fraction), the phase of sample n is ``(n * num) mod den``: nothing accumulates, so nothing drifts. The sine is a
polynomial of additions and multiplications, so the same samples come out bit for bit on every IEEE machine.
Decision 26.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from daq.setup.errors import InputError
from daq.setup.setup import Setup
from kernels import njit
from kernels.arrays import Floats

# a stop is seen within a quarter of a cycle (`rig.programme.sequencer.largest_block`): the fade ends within two
STOP_FADE_CYCLES = Fraction(3, 2)


@dataclass(frozen=True)
class PhaseClock:
    """Turns of the first tone by sample index, exactly: ``num / den`` turns a sample."""

    num: int
    den: int

    @classmethod
    def of(cls, frequency_hz: float, rate_hz: float) -> PhaseClock:
        """The clock of ``frequency_hz`` sampled at ``rate_hz``, both taken as the decimals they are written as."""
        # within 2^-80 of a turn a sample, far below what a float frequency can say
        turns = (Fraction(repr(frequency_hz)) / Fraction(repr(rate_hz))).limit_denominator(2**40)
        if turns <= 0:
            raise InputError(f"no usable phase clock for {frequency_hz} Hz at {rate_hz} samples a second")
        return cls(turns.numerator, turns.denominator)

    def phase(self, sample: int) -> int:
        """Phase of ``sample`` in units of ``1 / den`` turns, in ``[0, den)``."""
        return sample * self.num % self.den

    def cycle_start(self, cycle: int) -> int:
        """First sample at or after the start of ``cycle`` (cycle 0 starts at sample 0)."""
        return -(-cycle * self.den // self.num)

    def cycle_after(self, sample: int) -> int:
        """The first cycle whose first sample is ``sample`` or later."""
        return (sample - 1) * self.num // self.den + 1


def stop_fade_samples(clock: PhaseClock) -> int:
    """Samples of the fade to zero."""
    return int(STOP_FADE_CYCLES * clock.den / clock.num)


@dataclass(frozen=True)
class Fade:
    """Drive amplitudes that go from ``start`` to ``end`` (complex volts, one a tone) and stay there.

    The weight of ``end`` is ``s^2 (3 - 2 s)`` with ``s = (n - first_sample) / n_samples`` clipped to [0, 1]: its
    slope is zero at both ends and at most 1.5 over the fade.
    """

    first_sample: int
    n_samples: int
    start: tuple[complex, ...]
    end: tuple[complex, ...]

    def at(self, sample: int) -> tuple[complex, ...]:
        """Complex volts of each tone at ``sample``."""
        w = _weight(sample - self.first_sample, self.n_samples)
        return tuple(a + w * (b - a) for a, b in zip(self.start, self.end, strict=True))


def drive_amplitudes(setup: Setup, gamma: float) -> tuple[complex, ...]:
    """Complex drive volts of each tone that should move the plate with ``gamma``.

    The plate's ``x = A sum Re[d_m exp(i m w t)]`` has ``a_p = -g gamma sum m^2 Re[d_m exp(i m w t)]``, and the drive is
    ``a_p / (g * g_per_volt * exp(i phase))`` tone by tone. Behind a coupling capacitor a tone at ``f`` keeps
    ``(i f / fc) / (1 + i f / fc)`` of itself, and is asked for by so much more.

    Raises `InputError` where the drive's scale was not measured.
    """
    f_hz, corner_hz = setup.forcing.frequency_hz, setup.drive.highpass_hz or 0.0
    volts = []
    for m, d in setup.forcing.displacement_tones():
        response = setup.drive.response(m)
        if response is None:
            raise InputError("drive.g_per_volt is unknown")
        volts.append(-gamma * m * m * d / response * (1.0 - 1j * corner_hz / (m * f_hz)))
    return tuple(volts)


def synthesise(clock: PhaseClock, multiples: tuple[int, ...], fade: Fade, first_sample: int, n_samples: int) -> Floats:
    """Drive volts of samples ``first_sample`` to ``first_sample + n_samples``, shape ``(n_samples,)``."""
    out = np.zeros(n_samples)
    for multiple, start, end in zip(multiples, fade.start, fade.end, strict=True):
        # The m-th tone is a clock of its own: m turns for each turn, still a whole-number count.
        step = multiple * clock.num % clock.den
        phase = multiple * clock.phase(first_sample) % clock.den
        _add_tone(out, (phase, step, clock.den), first_sample - fade.first_sample, fade.n_samples, start, end)
    return out


@njit()
def _weight(since: int, length: int) -> float:
    """The weight of a fade's end ``since`` samples after its start."""
    if since >= length:
        return 1.0
    if since <= 0:
        return 0.0
    s = since / length
    return s * s * (3.0 - 2.0 * s)


@njit()
def _add_tone(out: Floats, turns: tuple[int, int, int], since: int, length: int, start: complex, end: complex) -> None:
    """Add ``Re[V exp(i 2 pi phase / den)]`` to ``out``, V fading from ``start`` to ``end``.

    ``turns`` is the phase of the first sample, its step from sample to sample, and ``den``.
    """
    phase, step, den = turns
    for i in range(out.size):
        w = _weight(since + i, length)
        cosine, sine = _cos_sin_turns(phase / den)
        real, imag = start.real + w * (end.real - start.real), start.imag + w * (end.imag - start.imag)
        out[i] += real * cosine - imag * sine
        phase += step
        if phase >= den:
            phase -= den


@njit()
def _cos_sin_turns(turns: float) -> tuple[float, float]:
    """Cosine and sine of ``2 pi turns``, ``turns`` in [0, 1], to 4e-16: Taylor series about the nearest quarter."""
    quarter = int(4.0 * turns + 0.5)
    x = 6.283185307179586 * (turns - 0.25 * quarter)  # at most pi / 4 in size
    y = x * x
    s = x * (1.0 + y * (-1 / 6 + y * (1 / 120 + y * (-1 / 5040 + y * (1 / 362880 + y * (-1 / 39916800
        + y * (1 / 6227020800 + y * (-1 / 1307674368000))))))))  # fmt: skip
    c = 1.0 + y * (-1 / 2 + y * (1 / 24 + y * (-1 / 720 + y * (1 / 40320 + y * (-1 / 3628800
        + y * (1 / 479001600 + y * (-1 / 87178291200 + y / 20922789888000)))))))  # fmt: skip
    if quarter % 4 == 0:
        return c, s
    if quarter % 4 == 1:
        return -s, c
    if quarter % 4 == 2:
        return -c, -s
    return s, -c
