"""Whether imported data can be what their profile says: rates, channels, gamma as achieved, rows that are missing.

A remark states a finding and its meaning; it changes nothing. A file is refused where going on would give wrong numbers
without a word. What contradicts the profile is a doubt (`daq.instrument`). Decision 113.

Gamma at the plate is measured over a step's hold, without what impacts add to the accelerometer. An impact and its
ringing fall on the same phase of every cycle, so that a fit through them is wrong by up to half a percent. They are
masked: after every closing of the contact circuit, and wherever the accelerometer is far from the motion (a contact may
be shorter than a sample). What remains is fitted as in the run and in the analysis. A table that rings for longer than
any mask bends such a fit far more than the impacts bend one of all samples, which is then taken.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from daq.importers.formats.columns import TIME_UNITS_S, Column
from daq.importers.timebase import JITTER_SHARE, Timebase, Times
from daq.loaded_tones import LoadedTones
from daq.lock_in import LockIn, fit_tones
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from daq.steps.find_steps import SAME_FREQUENCY, FoundStep
from daq.steps.forcing_detection import Read, Signal, gamma_of, tones_hz, weights
from kernels.arrays import Bools, Complexes, Floats, Integers

OTHER_RATE = 0.02  # relative deviation of a rate or frequency that is reported
MIXED = 1.05  # ratio of the fastest to the slowest part of a file beyond which no one rate describes it


def remarks(
    base: Timebase, steps: NDArray[np.void], channels: list[str], *, from_drive: bool, timed: bool
) -> list[str]:
    """Remarks on channels, times, pauses and steps."""
    said = []
    if "continuity" not in channels:
        said.append("no continuity: only the plate can be analysed")
    if not from_drive:
        which = "no drive" if "drive" not in channels else "no steps in the drive"
        said.append(f"{which}: steps were looked for in the accelerometer, and gamma is the plate's")
    if base.packet > 1:
        said.append(f"each {base.packet} rows share a time: they are taken as even, at {base.rate_hz:.6g} samples/s")
    if not base.uniform and base.jitter_s * base.rate_hz > JITTER_SHARE:
        said.append(
            f"times are not even and are stored as they came; the analysis counts samples at {base.rate_hz:.6g} "
            f"samples/s, from which they differ by {base.jitter_s * 1e6:.3g} us rms"
        )
    if len(base.gaps) <= 5:  # few enough to be listed one by one
        said += [f"a pause before sample {at}: {lost} samples missing (+-{sigma})" for at, lost, sigma in base.gaps]
    else:
        first, longest = base.gaps[0], base.gaps[np.argmax(base.gaps[:, 1])]
        said.append(
            f"{len(base.gaps)} pauses, {base.gaps[:, 1].sum()} samples missing in all; the first before sample "
            f"{first[0]}, the longest ({longest[1]} samples, +-{longest[2]}) before sample {longest[0]}; --json lists "
            "them"
        )
    if len(base.gaps) and not timed:
        said.append("rows are missing where the forcing's phase jumps; whole cycles more may be missing there")
    if not len(steps):
        said.append("no steps were found: nothing holds still within a factor of 8 of the profile's frequency")
    return said


def rate_warnings(rate_hz: float, setup: Setup, steps: NDArray[np.void]) -> list[str]:
    """Deviations of sample rate and forcing frequency from the profile; ``setup`` as the profile has it."""
    said = []
    expected = setup.sampling.rate_hz
    if setup.sampling.stated and abs(rate_hz / expected - 1.0) > OTHER_RATE:
        said.append(
            f"{rate_hz:.6g} samples/s, where profile {setup.name!r} says {expected:.6g}: is the unit of time right?"
        )
    forcing_hz = setup.forcing.frequency_hz
    if rate_hz < 4.0 * forcing_hz * setup.forcing.ratio:
        said.append(
            f"{rate_hz:.6g} samples/s are too few for the profile's forcing at {forcing_hz:g} Hz: is the unit of time "
            "right (--map time=COLUMN:ms)?"
        )
    found = steps["frequency_hz"]
    if len(found) and (found.min() > (1.0 + OTHER_RATE) * forcing_hz or found.max() < (1.0 - OTHER_RATE) * forcing_hz):
        said.append(f"the steps are at {np.median(found):.5g} Hz, where profile {setup.name!r} says {forcing_hz:.5g}")
    return said


def range_warnings(peak_v: Mapping[str, float], setup: Setup) -> list[str]:
    """Channels that read more than their range by a twentieth."""
    described = {role: setup.channels.get(role) for role in peak_v}
    return [
        f"the {role} reads up to {peak:.4g} V; profile {setup.name!r} says range_v = {channel.range_v:g}"
        for role, peak in peak_v.items()
        if (channel := described[role]) is not None and peak > 1.05 * channel.range_v
    ]


def refuse_other_unit(path: Path, time: Column, rate_hz: float, setup: Setup) -> None:
    """Refuse times in another unit: a rate that is the profile's by a power of a thousand (raises InputError)."""
    if not setup.sampling.stated:
        return
    ratio = rate_hz / setup.sampling.rate_hz
    for other in (1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9):
        if abs(ratio / other - 1.0) < OTHER_RATE:
            unit_s = TIME_UNITS_S[time.unit or "s"] * other
            right = next((name for name, size in TIME_UNITS_S.items() if abs(size / unit_s - 1.0) < 1e-9), "")
            said = f"is it in {right} (--map time={time.name}:{right})" if right else "is its unit right"
            raise InputError(
                f"{path}: column {time.name} in {time.unit or 's'} gives {rate_hz:.6g} samples/s, profile "
                f"{setup.name!r} says {setup.sampling.rate_hz:.6g}; {said}? If not, correct sampling.rate_hz."
            )


def refuse_mixed_rates(path: Path, times: Times, n: int, quantum_s: float) -> None:
    """Refuse a file whose parts were sampled at different rates.

    Raises `InputError` with the two rates, and the row near which they meet.

    The ``n`` times (at least 2) are seconds that do not fall; ``quantum_s`` is the rounding step of the column.
    """
    parts = min(32, n // 16)
    if parts < 2:
        return
    edges = np.linspace(0, n, parts + 1).astype(np.int64).tolist()
    # a median lies between the extremes: where these are alike everywhere, none has to be found
    ends = [_steps(times, a, b, quantum_s) for a, b in pairwise(edges)]
    spans = np.array([(own.min(), own.max()) for own in ends])
    if 0.0 < spans.max() < MIXED * spans.min():
        return
    # times may be rounded in a way that their digits do not show (single precision): then longer steps agree
    for rounding_s in (quantum_s, 5.0 * (times(n - 1, n)[0] - times(0, 1)[0]) / (n - 1)):
        steps = np.array([np.median(_steps(times, a, b, rounding_s)) for a, b in pairwise(edges)])
        slowest, fastest = float(steps.max()), float(steps.min())
        if fastest <= 0.0 or slowest < MIXED * fastest:
            return
    middle = np.sqrt(slowest * fastest)
    change = 1 + int(np.argmax((steps[1:] > middle) != (steps[:-1] > middle)))
    raise InputError(
        f"{path}: sampled at mixed rates: {1.0 / steps[change - 1]:.6g} samples/s before row {edges[change]} or so, "
        f"{1.0 / steps[change]:.6g} after; wanted one rate: import each part from a file of its own."
    )


def _steps(times: Times, start: int, stop: int, quantum_s: float) -> Floats:
    """Seconds between samples, by strides long enough that rounding does not bias them."""
    own = times(start, min(stop, start + (1 << 16)))
    mean_s = float(own[-1] - own[0]) / (len(own) - 1)
    # fifty rounding steps long: a median of shorter ones would be a multiple of the rounding
    stride = max(int(min(np.ceil(50.0 * quantum_s / max(mean_s, 1e-12)), len(own) // 4)), 1)
    return np.asarray((own[stride:] - own[:-stride]) / stride)


RINGING_S = (3e-3, 2e-3, 1e-3)  # masked after a closing: the longest that leaves enough
LEAST_QUIET = 0.5  # part of a hold that remains


def achieved_gamma(volts: Mapping[str, Read], step: FoundStep, rate_hz: float, setup: Setup) -> tuple[float, float]:
    """Gamma by the accelerometer and its standard uncertainty, the sensitivity's included.

    ``volts`` gives volts of samples ``a .. b``, by channel; a step's hold counts from where it has settled.
    """
    sensor = setup.channels.accelerometer
    volts_per_g = sensor.volts_per_mps2 * setup.g_mps2.value
    forcing = [m for m, _ in weights(setup.forcing)]
    # three harmonics, which a mask at one phase of the cycle would mix into the tones; more are undetermined there
    harmonics = [m for m in range(1, 4) if m * step.frequency_hz < 0.45 * rate_hz]
    multiples = sorted({*forcing, *harmonics})
    try:
        sums = _sums(volts, step, rate_hz, step.frequency_hz * np.array(multiples, np.float64), setup)
        values, sigmas = LoadedTones.of_sorts(sums, volts_per_g).solve()
        rows = [multiples.index(m) for m in forcing]
        values, sigmas = values[rows], sigmas[rows]
    except ValueError:  # too few samples for harmonics, or a table that rings on
        signal = Signal(volts["accelerometer"], rate_hz, setup.forcing)
        tones = signal.fit(step.settled(rate_hz), step.stop, step.frequency_hz)
        values, sigmas = tones.amplitudes, tones.amplitude_sigma()
    gamma = gamma_of(values / volts_per_g, setup.forcing)
    noise = gamma_of(sigmas / volts_per_g + 0j, setup.forcing)
    return gamma, float(np.hypot(noise, gamma * sensor.sensitivity.uncertainty / sensor.sensitivity.value))


def _sums(volts: Mapping[str, Read], step: FoundStep, rate_hz: float, fitted_hz: Floats, setup: Setup) -> LockIn:
    """Normal equations of the hold: masked and unmasked samples, in contact and in flight."""
    contact = setup.channels.continuity if "continuity" in volts else None
    sums = LockIn(rate_hz, fitted_hz, sorts=4)
    motion_hz = tones_hz(step.frequency_hz, setup.forcing)
    start = step.settled(rate_hz)
    pieces = max((step.stop - start) // max(1 << 18, round(20 * rate_hz / step.frequency_hz)), 1)
    cuts = np.linspace(start, step.stop, pieces + 1).astype(np.int64).tolist()
    for a, b in pairwise(cuts):
        x = volts["accelerometer"](a, b)
        touching = np.zeros(b - a, np.bool_)
        if contact is not None and contact.coupling == "dc":
            touching = (volts["continuity"](a, b) < contact.middle_v) == (contact.swing_v > 0.0)
        quiet = _quiet(x, a, rate_hz, motion_hz, touching)
        sums.add(x, a, (np.where(quiet, 0, 2) + touching).astype(np.int8))
    return sums


def _quiet(x: Floats, first: int, rate_hz: float, motion_hz: Floats, touching: Bools) -> Bools:
    """Samples that no impact has touched; all of them where too few would remain."""
    closings = np.flatnonzero(touching[1:] & ~touching[:-1]) + 1  # impacts, where the contact sees them
    tones = np.exp(2j * np.pi * np.outer(motion_hz / rate_hz, np.arange(first, first + len(x))))
    whole = fit_tones(x, first, rate_hz, motion_hz, np.ones(len(x), np.bool_))
    if _rings_on(x - whole.offset - (whole.amplitudes @ tones).real, closings, rate_hz):
        raise ValueError("the table rings for longer than any mask")
    for ringing_s in RINGING_S:
        quiet = _clear(len(x), closings, rate_hz, ringing_s)
        for _ in range(2):
            if np.mean(quiet) < LEAST_QUIET:
                break
            motion = fit_tones(x, first, rate_hz, motion_hz, quiet)
            away = np.abs(x - motion.offset - (motion.amplitudes @ tones).real)
            noise = 1.4826 * float(np.median(away))
            # far from the motion: an impact; a file without noise has at least its harmonics
            limit = max(6.0 * noise, 1e-3 * np.abs(motion.amplitudes).max())
            outliers = np.flatnonzero(away > limit)
            quiet = _clear(len(x), np.concatenate([closings, outliers]), rate_hz, ringing_s)
        if np.mean(quiet) >= LEAST_QUIET:
            return quiet
    return np.ones(len(x), np.bool_)


def _rings_on(left: Floats, closings: Integers, rate_hz: float) -> bool:
    """Whether the ringing of an impact outlasts the longest mask; ``left`` is the accelerometer less the motion."""
    lead, width = round(2e-4 * rate_hz), max(round(RINGING_S[-1] * rate_hz), 1)
    behind = round(RINGING_S[0] * rate_hz)
    inside = closings[(closings > lead + width) & (closings + behind + width < len(left))]
    if len(inside) < 4:
        return False
    windows = np.lib.stride_tricks.sliding_window_view(left, width)
    before, at, after = (np.median(windows[inside + shift].std(axis=1)) for shift in (-lead - width, 0, behind))
    # what is left after the mask stands out of what was there before, and is a good part of the ringing
    return bool(after > 5.0 * before and after > 0.2 * at)


def _clear(n: int, impacts: Integers, rate_hz: float, ringing_s: float) -> Bools:
    """Samples of ``n`` away from all ``impacts``."""
    change = np.zeros(n + 1, np.int64)
    np.add.at(change, np.maximum(impacts - round(2e-4 * rate_hz), 0), 1)
    np.add.at(change, np.minimum(impacts + max(round(ringing_s * rate_hz), 1), n), -1)
    return np.asarray(np.cumsum(change[:-1]) == 0)


def lost_rows(read: Read, found: list[FoundStep], rate_hz: float) -> Integers:
    """Places where rows are missing: ``(k, 3)``, row before which, how many, and their uncertainty.

    A forcing that runs on through the steps keeps its phase at most of their borders; where it jumps by what a number
    of samples explains in all tones, these are missing. Whole cycles more leave no trace.

    ``read`` gives volts of samples ``a .. b`` of the channel in which the steps were found.
    """
    borders = [
        (last, step)
        for last, step in pairwise(found)
        if abs(last.frequency_hz - step.frequency_hz) < SAME_FREQUENCY * step.frequency_hz
    ]
    if len(borders) < 4:
        return np.zeros((0, 3), np.int64)
    jumps = [_Jump.at(*border, rate_hz) for border in borders]
    # where the phase jumps at most borders, the forcing starts anew in every step and says nothing
    usual_rad = float(np.median([np.abs(jump.angles(np.zeros(1))).max() for jump in jumps]))
    if usual_rad > 0.03:
        return np.zeros((0, 3), np.int64)
    out = []
    for (last, step), jump in zip(borders, jumps, strict=True):
        # phases agree to this, at best
        lost = jump.lost(max(usual_rad, 1e-4))
        if lost is not None:
            out.append((jump.place(read, last, step, lost[0]), *lost))
    return np.array(out, np.int64).reshape(-1, 3)


@dataclass(frozen=True)
class _Jump:
    """Phases of the tones before and after a border of two steps."""

    before: Complexes  # unit phasors of the tones at sample 0 by the mean frequency, (k,)
    after: Complexes  # the same, (k,)
    sigma_rad: Floats  # uncertainty of the phase between them, (k,)
    turns: Floats  # cycles of each tone in a sample, (k,)

    @classmethod
    def at(cls, last: FoundStep, step: FoundStep, rate_hz: float) -> Self:
        """The jump between two steps; each is carried to their border by its own frequency."""
        border_s = 0.5 * (last.stop + step.hold) / rate_hz
        mean_hz = 0.5 * (last.tones.frequencies_hz + step.tones.frequencies_hz)
        units, variance = [], np.zeros(len(mean_hz))
        for one in (last, step):
            tones = one.tones
            carried = tones.amplitudes * np.exp(2j * np.pi * (tones.frequencies_hz - mean_hz) * border_s)
            units.append(carried / np.abs(carried))
            away_s = abs(border_s - 0.5 * (one.hold + one.stop) / rate_hz)
            slope = 2.0 * np.pi * away_s * one.frequency_sigma_hz * tones.frequencies_hz / one.frequency_hz
            variance += (tones.amplitude_sigma() / np.abs(tones.amplitudes)) ** 2 + slope**2
        return cls(units[0], units[1], np.sqrt(variance), mean_hz / rate_hz)

    def angles(self, lost: Floats) -> Floats:
        """Jump of each tone's phase that is left if so many samples (n,) are missing, (n, k)."""
        advanced = self.before * np.exp(2j * np.pi * np.outer(lost, self.turns))
        return np.asarray(np.angle(self.after / advanced))

    def lost(self, sure_rad: float) -> tuple[int, int] | None:
        """Number of samples missing and its uncertainty; None where none are, or no number explains all tones."""
        sigma_rad = np.hypot(self.sigma_rad, sure_rad)
        # a loss is a jump by more than its uncertainty, and by more than a sample and a half in every tone
        least = np.maximum(5.0 * sigma_rad, 2.0 * np.pi * 1.5 * self.turns)
        if np.all(np.abs(self.angles(np.zeros(1))) < least):
            return None
        counts = np.arange(1.0, 1.0 / self.turns.min())
        misfit = np.abs(self.angles(counts)).max(axis=1)
        best = int(np.argmin(misfit))
        sigma = float(np.min(sigma_rad / self.turns)) / (2.0 * np.pi)
        return (int(counts[best]), math.ceil(3.0 * sigma)) if misfit[best] < least.max() else None

    def place(self, read: Read, last: FoundStep, step: FoundStep, lost: int) -> int:
        """Sample before which they are missing: the old phase fits best up to it, the new one from it on."""
        cycle = round(1.0 / self.turns.min())
        start, stop = max(last.stop - 2 * cycle, last.hold), min(step.hold + 2 * cycle, step.stop)
        x, index = read(start, stop), np.arange(start, stop)
        x = x - x.mean()
        models = np.zeros((2, len(x)))
        here = index - start
        ends = (here - cycle, here), (here, here + cycle)  # windows on one side each
        for model, carried, window in zip(models, (0, lost), ends, strict=True):
            low, high = (np.clip(end, 0, len(x)) for end in window)
            for u, turns in zip(self.before, self.turns, strict=True):
                wave = np.exp(2j * np.pi * turns * index)
                sums = np.concatenate([[0.0], np.cumsum(x * wave.conj())])
                size = 2.0 * np.abs(sums[high] - sums[low]) / np.maximum(high - low, 1)
                model += size * (u * np.exp(2j * np.pi * turns * carried) * wave).real
        misfit = (x - models) ** 2
        before = np.concatenate([[0.0], np.cumsum(misfit[0])])
        after = np.concatenate([np.cumsum(misfit[1][::-1])[::-1], [0.0]])
        return int(start + np.argmin(before + after))
