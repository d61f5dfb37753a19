"""Measure the instruments of a recording from the holds of a few of its steps, in bounded memory."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from daq.channels.continuity import ContinuityChannel
from daq.instrument.channel_limits import (
    NO_ENDS,
    STANDS,
    Ends,
    NoiseSpectrum,
    common_ends,
    drive_is_cut_off,
    measure_noise,
    share_at_an_end,
)
from daq.instrument.held_readings import held_samples, without_stair
from daq.lock_in import ToneFit, fit_tones
from daq.setup.setup import Setup
from daq.steps.forcing_detection import Read, gamma_of
from kernels.arrays import Bools, Floats, Integers

STEPS, SAMPLES = 24, 1 << 16  # steps that are looked at, spread over the recording, and samples of each
PADDING = 8  # of the spectrum in which they are
BETWEEN = (0.3, 0.7)  # part of the way from one level to the other in which a contact is only while it changes
DELAYS_S = np.linspace(-7.5e-4, 7.5e-4, 7)  # after an edge, at which the plate is looked at: either may be late
RESTS = 0.9  # peak below which it certainly rests


@dataclass(frozen=True)
class Hold:
    """One step's hold; accelerations by the profile's sense and scale, in units of g."""

    frequency_hz: float  # of the step
    tones_hz: tuple[float, ...]  # found in the drive; in the accelerometer where there is none
    plate: ToneFit  # fit in volts of the profile's tones, first, and of others that were found
    drive: ToneFit | None  # the same; None where it was not recorded
    peak_g: float  # largest acceleration of the plate, up or down, by its tones
    middle: Mapping[str, float]  # by channel, part of the samples between its extremes
    high: float = np.nan  # part of the time that the contact is at its higher level; NaN without one
    # the plate's acceleration at `DELAYS_S` after the contact's voltage rises from standing still, (n, 7)
    rises_g: Floats = field(default_factory=lambda: np.zeros((0, len(DELAYS_S))))
    falls_g: Floats = field(default_factory=lambda: np.zeros((0, len(DELAYS_S))))  # the same after it falls, (n, 7)
    growth: float = 0.0  # relative growth of the strongest tone from the hold's begin to its end

    def gammas(self, setup: Setup) -> tuple[float, float, float]:
        """Gamma by the drive (NaN: unknown), gamma at the plate, and the latter's uncertainty."""
        rows = slice(len(setup.forcing.displacement_tones()))
        per_g = abs(volts_per_g(setup))
        seen = gamma_of(self.plate.amplitudes[rows] / per_g, setup.forcing)
        sigma = gamma_of(self.plate.amplitude_sigma()[rows] / per_g + 0j, setup.forcing)
        if self.drive is None or setup.drive.g_per_volt is None:
            return np.nan, seen, sigma
        return gamma_of(self.drive.amplitudes[rows], setup.forcing) * setup.drive.g_per_volt.value, seen, sigma


@dataclass(frozen=True)
class Measured:
    """Everything that was measured: by step, and of the noise of all of them.

    ``ends_v`` are the volts beyond which the accelerometer does not read, infinite where it does not come to its end;
    ``cut_off`` is the number of holds whose motion goes beyond, ``drive_cut_off`` that of those in which the drive's
    reading is at its end. ``held_samples`` as in `daq.instrument.held_readings.held_samples`.
    """

    holds: tuple[Hold, ...]
    levels_v: tuple[float, float] | None
    bias_v: float | None
    noise: NoiseSpectrum | None
    interpolation_hz: float | None
    ends_v: Ends = NO_ENDS
    cut_off: int = 0
    drive_cut_off: int = 0
    held_samples: float = 1.0


def volts_per_g(setup: Setup) -> float:
    """Volts of the accelerometer for one g of the place, by the profile's sense."""
    return setup.channels.accelerometer.volts_per_mps2 * setup.g_mps2.value


def measure(
    read: Mapping[str, Read], n_samples: int, rate_hz: float, steps: NDArray[np.void], gaps: Integers, setup: Setup
) -> Measured:
    """Measure the instruments.

    Parameters
    ----------
    read
        Gives volts of samples ``a .. b``, by channel; ``accelerometer`` is there.
    n_samples, rate_hz
    steps
        `STEP_DTYPE` rows.
    gaps
        ``(k, 2)``: sample before which samples were lost, and how many.
    setup
        Sense and scale in which the accelerations are given, and the contact's coupling.
    """
    spans = _spans(steps, gaps, n_samples, rate_hz)
    pieces = [(a, {role: own(a, b) for role, own in read.items()}, hz) for a, b, hz in spans]
    held = held_samples([volts["accelerometer"] for _, volts, _ in pieces])
    for _, volts, _ in pieces:
        without_stair(volts["accelerometer"], held)
    contact = setup.channels.continuity if "continuity" in read else None
    levels = None if contact is None else _levels([volts["continuity"] for _, volts, _ in pieces], contact)
    if contact is not None and levels is not None and levels[1] - levels[0] < 0.2 * abs(contact.swing_v):
        # a ball that is launched as it lands shows no contact: what it did on its way there counts
        levels = _levels([read["continuity"](0, min(min(a for a, _, _ in spans) + 1, n_samples))], contact)
    holds, rests, quiet, bias = [], list[Floats](), list[Bools](), list[float]()
    for first, volts, hz in pieces:
        high = None if levels is None else volts["continuity"] > 0.5 * (levels[0] + levels[1])
        hold, rest = _hold(first, volts, hz, rate_hz, high, setup)
        holds.append(hold)
        bias.append(hold.plate.offset)
        rests.append(rest)
        quiet.append(_quiet(rest, high, rate_hz))
    shown = [volts["accelerometer"] for _, volts, _ in pieces]
    ends_v = common_ends(shown, rate_hz)
    channels = [[volts[role] for _, volts, _ in pieces] for role in read]
    # impacts follow one another by more than the 12.8 ms of a periodogram
    return Measured(
        tuple(holds),
        levels,
        float(np.median(bias)) if bias else None,
        measure_noise(rests, quiet, rate_hz, 1 << max(round(math.log2(12.8e-3 * rate_hz)), 4)),
        interpolation_hz(channels, rate_hz),
        ends_v,
        sum(share_at_an_end(x, rate_hz, ends_v) > STANDS for x in shown),
        sum(drive_is_cut_off(v["drive"], rate_hz) for _, v, _ in pieces if "drive" in v),
        held,
    )


def _spans(steps: NDArray[np.void], gaps: Integers, n_samples: int, rate_hz: float) -> list[tuple[int, int, float]]:
    """First sample, end and frequency of the holds that are looked at; of one with a gap, the longer part."""
    out = []
    chosen = np.unique(np.linspace(0, len(steps) - 1, min(STEPS, len(steps))).round().astype(np.int64))
    for row in steps[chosen]:
        hz = float(row["frequency_hz"])
        first, stop = int(row["first_sample"] + row["settle_samples"]), int(row["first_sample"] + row["n_samples"])
        cuts = [first, *(int(g) for g in gaps[:, 0] if first < g < stop), min(stop, n_samples)]
        a = max(range(len(cuts) - 1), key=lambda i: cuts[i + 1] - cuts[i])
        first, stop = cuts[a], min(cuts[a + 1], cuts[a] + SAMPLES)
        if hz > 0.0 and (stop - first) * hz / rate_hz >= 6.0:
            whole = int((stop - first) * hz / rate_hz)
            out.append((first, first + round(whole * rate_hz / hz), hz))
    return out


def _levels(volts: list[Floats], contact: ContinuityChannel | None) -> tuple[float, float] | None:
    """Lower and upper level of a contact circuit with direct coupling; None where its voltage never changes."""
    if contact is None or contact.coupling == "ac" or not volts:
        return None
    # quantiles: spikes at the edges are no levels
    low, high = (float(x) for x in np.quantile(np.concatenate(volts), (0.01, 0.99)))
    return low, high


def _hold(
    first: int, volts: Mapping[str, Floats], hz: float, rate_hz: float, high: Bools | None, setup: Setup
) -> tuple[Hold, Floats]:
    """One hold, and the accelerometer's volts less the motion."""
    driven = "drive" in volts and float(np.ptp(volts["drive"])) > 0.0
    # parts of the strongest tone from which one below or above it is a tone: in the accelerometer impacts and
    # a bent table make lines as well
    n, limits = len(volts["accelerometer"]), (0.03, 0.1) if driven else (0.08, 0.3)
    found = _tones_hz(volts["drive" if driven else "accelerometer"], rate_hz, hz, limits)
    own = [m * hz for m, _ in setup.forcing.displacement_tones()]
    nearest = [own[int(np.argmin(np.abs(np.array(own) - f)))] for f in found]
    # a tone of the profile is taken where the one found cannot be distinguished from it
    found = [x if abs(x - f) < 0.5 * rate_hz / n else f for x, f in zip(nearest, found, strict=True)]
    others = [f for f in found if f not in own]
    plate = fit_tones(volts["accelerometer"], first, rate_hz, own + others)
    turns = 2j * np.pi * np.outer(plate.frequencies_hz / rate_hz, np.arange(first, first + n))
    motion = np.asarray((plate.amplitudes[:, None] * np.exp(turns)).real.sum(axis=0))
    acceleration = motion / volts_per_g(setup)
    none = np.zeros((0, len(DELAYS_S)))
    rises, falls = (none, none) if high is None else _at_edges(high, acceleration, rate_hz, hz)
    half = round(int(0.5 * n * hz / rate_hz) * rate_hz / hz)  # whole cycles
    shown = volts["drive" if driven else "accelerometer"] * np.exp(-turns[int(np.argmax(np.abs(plate.amplitudes)))])
    begin, end = abs(shown[:half].sum()), abs(shown[n - half :].sum())
    hold = Hold(
        hz, tuple(found), plate, fit_tones(volts["drive"], first, rate_hz, own + others) if driven else None,
        float(np.abs(acceleration).max()), {role: _between(x) for role, x in volts.items()},
        np.nan if high is None else float(high.mean()), rises, falls,
        # the middles of the two halves are half a hold from each other
        growth=float(4.0 * (end - begin) / max(begin + end, 1e-300)),
    )  # fmt: skip
    return hold, volts["accelerometer"] - plate.offset - motion


def _tones_hz(volts: Floats, rate_hz: float, hz: float, limits: tuple[float, float]) -> list[float]:
    """Frequencies of the lines that reach a part of the strongest one: ``limits`` below it and above it."""
    width = max(int(rate_hz / (64 * hz)), 1)  # samples averaged to a point: tones are slow
    x = volts[: len(volts) // width * width].reshape(-1, width).mean(axis=1)
    n = PADDING * len(x)
    size = np.abs(np.fft.rfft((x - x.mean()) * np.blackman(len(x)), n))
    inner = size[1:-1]
    k = np.flatnonzero((inner > size[:-2]) & (inner >= size[2:]) & (np.arange(1, len(size) - 1) > 2 * PADDING)) + 1
    if not len(k):
        return [hz]
    strongest = k[np.argmax(size[k])]
    k = k[size[k] > np.where(k < strongest, *limits) * size[strongest]]
    left, middle, right = (np.log(size[k + i] + 1e-300) for i in (-1, 0, 1))
    # vertex of the parabola through three logarithms: exact for the Gaussian that a Blackman line nearly is
    shift = 0.5 * (left - right) / np.minimum(left - 2.0 * middle + right, -1e-12)
    return [float(f) for f in (k + shift) * rate_hz / (width * n)]


def _between(volts: Floats) -> float:
    """Part of the samples that lie between the extremes: near zero for a contact circuit, a quarter for a sine."""
    low, high = np.quantile(volts, [0.005, 0.995])
    place = (volts - low) / max(high - low, 1e-300)
    return float(np.mean((place > BETWEEN[0]) & (place < BETWEEN[1])))


def _at_edges(high: Bools, acceleration: Floats, rate_hz: float, hz: float) -> tuple[Floats, Floats]:
    """Acceleration at the rises of a level, and at its falls, between two states of some length."""
    starts = np.flatnonzero(np.diff(high)) + 1
    bounds = np.concatenate([[0], starts, [len(high)]])
    state, length = high[bounds[:-1]], np.diff(bounds)
    # shorter contacts and openings are bounce
    lasting = length > 1e-3 * rate_hz
    at, state = bounds[:-1][lasting], state[lasting]
    changes = np.concatenate([[True], state[1:] != state[:-1]])[: len(at)]
    at, state = at[changes], state[changes]
    # only a take-off after a rest is at the threshold: contact before it and flight after it must last
    least = max(3e-3, 0.08 / hz) * rate_hz
    length = np.diff(np.append(at, len(high)))
    sound = np.zeros(len(at), np.bool_)
    sound[1:-1] = (length[:-2] > least) & (length[1:-1] > least)
    shifts = np.rint(DELAYS_S * rate_hz).astype(np.int64)
    rises, falls = (
        acceleration[np.clip(at[own, None] + shifts, 0, len(high) - 1)] for own in (sound & state, sound & ~state)
    )
    return rises, falls


def _quiet(rest: Floats, high: Bools | None, rate_hz: float) -> Bools:
    """Samples of the accelerometer less the motion that lie away from every edge of the contact."""
    loud = np.zeros(len(rest) + 1)
    if high is not None:
        # an impact rings, and its edge comes a little after it
        before, after = (round(s * rate_hz) for s in (1e-3, 8e-3))
        for edge in np.flatnonzero(np.diff(high)) + 1:
            loud[max(int(edge) - before, 0)] += 1.0
            loud[min(int(edge) + after, len(rest))] -= 1.0
    return np.asarray(np.cumsum(loud[:-1]) <= 0.0)


LINE_SAMPLES = 1 << 13  # looked at together for lines


def interpolation_hz(channels: Sequence[Sequence[Floats]], rate_hz: float) -> float | None:
    """Beat of two sample rates at which the noise of several channels comes and goes; None where it does not.

    A value interpolated linearly between two others has less noise the farther it is from both, so that the noise
    varies with the beat of the two rates, in all channels alike. ``channels`` holds stretches of volts (n,) for each
    channel.
    """
    lines = [line for stretches in channels if (line := _line(stretches)) is not None]
    for line in lines:
        near = [other for other in lines if abs(other - line) < 3.0 / LINE_SAMPLES]
        # one channel may hum: two must show the same line
        if len(near) >= 2:
            return float(np.mean(near)) * rate_hz
    return None


def _line(stretches: Sequence[Floats]) -> float | None:
    """Strongest line in the size of the second differences, in units of the rate; None where chance explains it.

    A line in the differences themselves is a tone picked up by the cable, and no trace of interpolation.
    """
    sizes, bends = np.zeros(LINE_SAMPLES // 2 + 1), np.zeros(LINE_SAMPLES // 2 + 1)
    level, count, hann = 0.0, 0, np.hanning(LINE_SAMPLES)
    for volts in stretches:
        bend = np.diff(volts, 2)[: (len(volts) - 2) // LINE_SAMPLES * LINE_SAMPLES].reshape(-1, LINE_SAMPLES)
        size = np.abs(bend)
        usual = (float(np.median(size)) or float(size.mean())) if size.size else 0.0
        if usual > 0.0:
            # impacts and edges are no noise: a second difference counts for three times the usual size at most
            limit = 3.0 * usual
            size, bend = np.minimum(size, limit) / usual, np.clip(bend, -limit, limit) / usual
            level, count = level + float(size.mean(axis=1).sum()), count + len(size)
            sizes += (np.abs(np.fft.rfft((size - size.mean(axis=1, keepdims=True)) * hann)) ** 2).sum(axis=0)
            bends += (np.abs(np.fft.rfft(bend * hann)) ** 2).sum(axis=0)
    if not count:
        return None
    first = LINE_SAMPLES // 64  # below, the motion itself comes and goes
    k = first + int(np.argmax(sizes[first:-2]))
    modulation = 4.0 * np.sqrt(sizes[k] / count) / LINE_SAMPLES / (level / count)
    ratio = float(sizes[k] / np.median(sizes[first:]))
    chance = len(sizes) * np.exp(-count * (ratio - 1.0 - np.log(ratio)))  # Chernoff's bound for a sum of exponentials
    tones = [
        float(bends[q - 1 : q + 2].max() / max(float(np.median(bends[q - 32 : q + 33])), 1e-300))
        for q in (k // 2, (LINE_SAMPLES - k) // 2)
    ]
    # good filters modulate by less than 0.22; a line of the motion itself stands in the differences as well
    return None if modulation < 0.22 or chance > 1e-9 or max(tones) > 20.0 else k / LINE_SAMPLES
