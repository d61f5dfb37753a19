"""The amplitude programme as a value: every step, printable and storable before anything moves.

Seconds are derived from whole samples. A step begins at the first sample of a cycle of the first
tone; it fades from the step before within the slew limit, settles, and holds.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, replace
from functools import lru_cache

import numpy as np

from daq.setup.errors import InputError
from daq.setup.setup import Setup
from kernels.arrays import Complexes, Integers
from rig.profile import Limits, Profile, RampTable
from rig.programme.forcing import PhaseClock, drive_amplitudes

LONGEST_RUN_DAYS = 30.0
"""Longer ramps are refused: a slip in the profile rather than a plan."""


@dataclass(frozen=True)
class Step:
    """One amplitude: ``fade_samples + settling + holding = n_samples``, from ``first_sample``."""

    index: int
    gamma: float
    direction: int
    first_sample: int
    fade_samples: int
    settle_samples: int
    n_samples: int
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
        step = Step(
            index=index,
            gamma=gamma,
            direction=-1 if gamma < previous else 1,
            first_sample=0,
            fade_samples=0,
            settle_samples=0,
            n_samples=0,
            fade_cycles=fade_cycles(ramp, gamma - previous),
            settle_cycles=ramp.settle_cycles,
            hold_cycles=ramp.hold_cycles,
        )
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
