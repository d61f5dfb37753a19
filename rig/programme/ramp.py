"""The amplitude programme as a value, every step printable and storable before anything moves; its drive samples.

Seconds are derived from whole samples. A step begins at the first sample of a cycle of the first tone; it fades from
the step before within the slew limit, settles, and holds.

A drive sample is a function of its index only, whatever block it falls in. Phase is counted in whole numbers. With the
forcing at ``num / den`` turns a sample (an exact fraction), the phase of sample n is ``(n * num) mod den``: nothing
accumulates, so nothing drifts. The sine is a polynomial of additions and multiplications, so the same samples come out
bit for bit on every IEEE machine. Decision 26.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, field, replace
from fractions import Fraction
from functools import lru_cache

import numpy as np

from daq.setup.errors import InputError
from daq.setup.setup import Setup
from kernels import njit
from kernels.arrays import Complexes, Floats, Integers
from rig.profile import Limits, Profile, RampTable

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


LONGEST_RUN_DAYS = 30.0
"""Longer ramps are refused: a slip in the profile rather than a plan."""


@dataclass(frozen=True)
class Step:
    """One amplitude: ``fade_samples + settling + holding = n_samples``, from ``first_sample``."""

    index: int
    gamma: float
    direction: int
    first_sample: int = field(default=0, kw_only=True)
    fade_samples: int = field(default=0, kw_only=True)
    settle_samples: int = field(default=0, kw_only=True)
    n_samples: int = field(default=0, kw_only=True)
    fade_cycles: int
    settle_cycles: int
    hold_cycles: int

    def placed(self, clock: PhaseClock, first_cycle: int, settle_cycles: int) -> Step:
        """This step begun at ``first_cycle`` and settled for ``settle_cycles``, in samples."""
        cycle, bounds = first_cycle, [clock.cycle_start(first_cycle)]
        for length in (self.fade_cycles, settle_cycles, self.hold_cycles):
            cycle += length
            bounds.append(clock.cycle_start(cycle))
        fade, settle, n = (bound - bounds[0] for bound in bounds[1:])
        return replace(
            self,
            first_sample=bounds[0],
            fade_samples=fade,
            settle_samples=settle,
            n_samples=n,
            settle_cycles=settle_cycles,
        )

    @property
    def end_sample(self) -> int:
        """The first sample after the step."""
        return self.first_sample + self.n_samples


@dataclass(frozen=True)
class NextSteps:
    """What a person wants driven next, in place of the steps that are left."""

    gammas: tuple[float, ...] = ()  # empty where whoever chose the steps so far is to choose again
    ratio: int | None = None  # c; None keeps it
    why: str = ""  # the person's reason


@dataclass(frozen=True)
class Peaks:
    """What a step asks of drive and plate, as peaks from rest."""

    gamma_peak: float
    drive_v: float
    acceleration_mps2: float
    velocity_mps: float
    displacement_m: float


@dataclass(frozen=True)
class Programme:
    """All steps of a run, in order."""

    clock: PhaseClock
    rate_hz: float
    steps: tuple[Step, ...]

    @property
    def n_samples(self) -> int:
        """Samples of all steps (the fade to zero after the last is not counted)."""
        return self.steps[-1].end_sample


def plan(profile: Profile) -> Programme:
    """The programme of ``profile``'s ramp.

    Raises `daq.setup.errors.InputError` when it would last longer than `LONGEST_RUN_DAYS`, or the forcing is too slow
    for its clock.
    """
    ramp, rate_hz = profile.ramp, profile.sampling.rate_hz
    try:
        clock = PhaseClock.of(profile.forcing.frequency_hz, rate_hz)
    except ValueError as error:
        raise InputError(f"profile {profile.name!r}: {error}; change forcing.frequency_hz") from error
    steps: list[Step] = []
    cycle, previous = 0, 0.0
    for index, gamma in enumerate(ramp.gammas()):
        fade, direction = fade_cycles(ramp, gamma - previous), -1 if gamma < previous else 1
        step = Step(index, gamma, direction, fade, ramp.settle_cycles, ramp.hold_cycles)
        steps.append(step.placed(clock, cycle, ramp.settle_cycles))
        days = steps[-1].end_sample / rate_hz / 86400.0
        if days > LONGEST_RUN_DAYS:
            length = f"{days / 365.25:.3g} years" if days > 1000.0 else f"{days:.0f} days"
            raise InputError(
                f"profile {profile.name!r}: step {index} of the ramp would end after {length}; a run lasts at "
                f"most {LONGEST_RUN_DAYS:g} days: give fewer steps, fewer cycles to settle and hold, or a faster slew"
            )
        cycle += step.fade_cycles + step.settle_cycles + step.hold_cycles
        previous = gamma
    return Programme(clock, rate_hz, tuple(steps))


def fade_cycles(ramp: RampTable, change: float) -> int:
    """Whole cycles in which gamma can change by ``change`` within the slew limit."""
    # the middle of a fade is 1.5 times as steep as a straight line
    cycles = 1.5 * abs(change) / ramp.slew_per_cycle - 1e-9
    return max(2, math.ceil(min(cycles, 1e15)))


def peaks(setup: Setup, gamma: float) -> Peaks:
    """What ``gamma`` asks of drive and plate; exact to rounding for any tones."""
    tones = setup.forcing.displacement_tones()
    at_one = _peaks_at_one(tones, drive_amplitudes(setup, 1.0), setup.forcing.frequency_hz, setup.g_mps2.value)
    return Peaks(*(gamma * value for value in astuple(at_one)))


@lru_cache(maxsize=16)
def _peaks_at_one(
    tones: tuple[tuple[int, complex], ...], drive_v: tuple[complex, ...], frequency_hz: float, g: float
) -> Peaks:
    """What gamma = 1 asks: all of it grows with gamma."""
    w = 2.0 * math.pi * frequency_hz
    multiples = np.array([m for m, _ in tones])
    # gamma = A w^2 / g of the first tone: at 1 its displacement has the size g / w^2
    x: Complexes = np.array([d for _, d in tones], dtype=np.complex128) * g / w**2
    a = -x * (multiples * w) ** 2
    return Peaks(
        gamma_peak=_highest(multiples, -a) / g,
        drive_v=_largest(multiples, np.array(drive_v)),
        acceleration_mps2=_largest(multiples, a),
        velocity_mps=_largest(multiples, 1j * multiples * w * x),
        displacement_m=_largest(multiples, x),
    )


def forbidden(limits: Limits, step: Step, asked: Peaks) -> list[str]:
    """One line for each limit that ``step`` would exceed, naming both."""
    pairs = [
        ("drive_v", asked.drive_v, limits.drive_v, "V of drive"),
        ("plate_mps2", asked.acceleration_mps2, limits.plate_mps2, "m/s^2 of plate acceleration"),
        ("displacement_m", asked.displacement_m, limits.displacement_m, "m of plate displacement"),
        ("velocity_mps", asked.velocity_mps, limits.velocity_mps, "m/s of plate velocity"),
    ]
    return [
        f"step {step.index} (gamma {step.gamma:g}) asks for {value:.4g} {what}; limits.{name} allows {limit:g}"
        for name, value, limit, what in pairs
        if limit is not None and value > limit * (1.0 + 1e-9)
    ]


def _largest(multiples: Integers, amplitudes: Complexes) -> float:
    """Peak size of ``sum Re[z exp(i m phi)]`` over a turn."""
    return max(_highest(multiples, amplitudes), _highest(multiples, -amplitudes))


def _highest(multiples: Integers, amplitudes: Complexes) -> float:
    """Highest value of ``sum Re[z exp(i m phi)]``: Newton's steps from each top of a grid, none of which is missed."""
    n = 64 * int(multiples.max())
    phi = 2.0 * np.pi * np.arange(n) / n
    y = np.real(np.exp(1j * np.outer(phi, multiples)) @ amplitudes)
    at = phi[(y >= np.roll(y, 1)) & (y >= np.roll(y, -1))]
    for _ in range(8):
        turned = np.exp(1j * np.outer(at, multiples)) * amplitudes
        slope, bend = -np.imag(turned @ multiples), -np.real(turned @ multiples**2)
        at = at - np.clip(slope / np.minimum(bend, -1e-300), -np.pi / n, np.pi / n)
    return float(max(y.max(), np.real(np.exp(1j * np.outer(at, multiples)) @ amplitudes).max()))


class HighPass:
    """First-order high-pass that remembers; ``corner_hz`` None lets everything pass.

    With ``r = 2 pi corner / rate``, a straight piece of slope ``s`` a sample is answered by
    ``y[n] = exp(-r) y[n-1] + s (1 - exp(-r)) / r``.
    """

    def __init__(self, corner_hz: float | None, rate_hz: float) -> None:
        self._r = 2.0 * math.pi * corner_hz / rate_hz if corner_hz else 0.0
        self._state: Floats | None = None

    def __call__(self, volts: Floats) -> Floats:
        """The next samples (n,), filtered; before the first the circuit had rested at it."""
        if self._r == 0.0 or not len(volts):
            return volts
        decay = math.exp(-self._r)
        gain = (1.0 - decay) / self._r
        from scipy.signal import lfilter  # takes most of a second to import

        if self._state is None:
            self._state = np.array([-gain * volts[0]])
        out, self._state = lfilter([gain, -gain], [1.0, -decay], volts, zi=self._state)
        return np.asarray(out)
