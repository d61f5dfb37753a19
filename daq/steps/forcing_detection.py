"""Detection of a forcing in a signal: where it is present, and roughly at which frequency.

Only the range of the frequency and the ratio of the two tones are assumed. A stretch in which the forcing's tones do
not carry a fifth of the alternating power is silence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.lock_in import ToneFit, ToneFits, fit_tones, fit_tones_each
from daq.setup.setup import Forcing
from kernels import njit
from kernels.arrays import Bools, Floats, Integers

Read = Callable[[int, int], Floats]

SPAN = 8.0  # the frequency is sought between hint / SPAN and hint * SPAN
_PAD = 4


@dataclass(frozen=True)
class Region:
    """Samples ``start .. stop`` in which a forcing near ``frequency_hz`` is present."""

    start: int
    stop: int
    frequency_hz: float


@dataclass(frozen=True)
class Signal:
    """A drive, or the plate's acceleration, and what is known of the forcing in it."""

    read: Read  # gives volts of samples ``a .. b``
    rate_hz: float
    forcing: Forcing  # ratio and relative amplitudes of its tones; its frequency is right within a factor of `SPAN`

    def fit(self, start: int, stop: int, frequency_hz: float) -> ToneFit:
        """The forcing's tones in samples ``start .. stop``."""
        return fit_tones(self.read(start, stop), start, self.rate_hz, tones_hz(frequency_hz, self.forcing))

    def fits(self, edges: Integers, frequency_hz: float) -> ToneFits:
        """The forcing's tones in each of the windows between ``edges``."""
        tones = tones_hz(frequency_hz, self.forcing)
        nothing = np.zeros(0)
        parts = [ToneFits(tones, np.zeros((0, len(tones)), np.complex128), nothing, nothing, np.zeros(0, np.int64))]
        while len(edges) > 1:
            n = int(np.searchsorted(edges, edges[0] + (1 << 17), side="right")) - 1
            n = min(max(n, 1), 100, len(edges) - 1)  # windows fitted in one go
            x = self.read(int(edges[0]), int(edges[n]))
            parts.append(fit_tones_each(x, edges[: n + 1], self.rate_hz, tones))
            edges = edges[n:]
        return ToneFits.join(parts)


@lru_cache(maxsize=16)
def weights(forcing: Forcing) -> tuple[tuple[int, float], ...]:
    """Expected relative acceleration of the tones, ``(multiple, amplitude)``: displacement times multiple squared."""
    return tuple((m, m * m * abs(z)) for m, z in forcing.displacement_tones() if abs(z) > 1e-12)


def tones_hz(frequency_hz: float, forcing: Forcing) -> Floats:
    """Frequencies of the forcing's tones when the first is at ``frequency_hz``."""
    return frequency_hz * np.array([float(m) for m, _ in weights(forcing)])


def gamma_of(amplitudes: NDArray[Any], forcing: Forcing) -> float:
    """Gamma from the tones' acceleration amplitudes in units of g: least squares on the forcing's shape.

    ``|a_m| / g = gamma m^2 |d_m|`` with ``d_m`` the tones of ``x_p / A``.
    """
    shape = np.array([w for _, w in weights(forcing)])
    return float(np.sum(shape * np.abs(amplitudes)) / np.sum(shape**2))


def regions(signal: Signal, start: int, stop: int) -> list[Region]:
    """Stretches of a nearly constant forcing frequency between two samples, in order."""
    rate_hz, hint_hz, tones = signal.rate_hz, signal.forcing.frequency_hz, weights(signal.forcing)
    window = round(min(max(10.0 / hint_hz, 0.1), 2.0) * rate_hz)
    hop = max(window // 2, 1)
    if stop - start < window:
        window = hop = stop - start
    if window < 8:
        return []
    top = max(m for m, _ in tones)
    reduce = max(1, int(rate_hz / (16 * SPAN * hint_hz * top)))
    if window // reduce < 8:  # far less than a cycle
        return []
    starts = np.arange(start, stop - window + 1, hop)  # windows overlap by half
    many = max((1 << 17) // window, 1)  # windows whose spectra are taken in one go
    found = []
    for i in range(0, len(starts), many):
        own = starts[i : i + many]
        means = np.empty((len(own), window // reduce))
        x = np.ascontiguousarray(signal.read(int(own[0]), int(own[-1]) + window), np.float64)
        _average(x, own - own[0], reduce, means)
        found.append(_look(means, rate_hz / reduce, tones, hint_hz))
    frequency, amplitude, share = np.concatenate(found, axis=1)
    active = (share > 0.2) & (amplitude > 2e-3 * amplitude.max()) & (amplitude > 0)
    return _grouped(starts, window, frequency, active, (start, stop))


@njit(error_model="numpy")
def _average(x, starts, reduce, means):  # type: ignore[no-untyped-def]
    """Fill in means of ``reduce`` values each, a row of them from each start on."""
    for row in range(means.shape[0]):
        for i in range(means.shape[1]):
            total = 0.0
            for k in range(reduce):
                total += x[starts[row] + i * reduce + k]
            means[row, i] = total / reduce


def _look(x: Floats, rate_hz: float, tones: tuple[tuple[int, float], ...], hint_hz: float) -> Floats:
    """Frequency, amplitude and share of the power (3, m) of the best fitting forcing in each window ``x`` (m, n)."""
    x = x - x.mean(axis=1, keepdims=True)
    hann = np.hanning(x.shape[1] + 2)[1:-1]
    n_fft = 1 << int(np.ceil(np.log2(x.shape[1] * _PAD)))
    step = rate_hz / n_fft
    top = max(m for m, _ in tones)
    low = max(int(hint_hz / SPAN / step), 2 * _PAD)  # below, the window's own lobe
    high = min(int(hint_hz * SPAN / step), (n_fft // 2 - 1) // top)
    looked_at = top * (high + 1) + 3  # bins: the highest tone's, and those around its peak
    spectrum = np.abs(np.fft.rfft(x * hann, n_fft, axis=1)[:, :looked_at]) * (2.0 / hann.sum())
    found = np.zeros((3, len(x)))
    power = np.mean(x**2, axis=1)
    if high <= low:
        return found
    bins = np.arange(low, high + 1)
    score = sum((w * spectrum[:, bins * m] for m, w in tones), np.zeros((len(x), len(bins))))
    for i in np.flatnonzero(power > 0.0):
        own, k = spectrum[i], int(bins[np.argmax(score[i])])
        strongest = max(tones, key=lambda tone: tone[0] * own[k * tone[0]])[0]
        first, last = max((k - 1) * strongest, 1), min((k + 1) * strongest, len(own) - 2)
        top_bin = first + int(np.argmax(own[first : last + 1]))
        # top of the peak by a parabola through its logarithm
        a, b, c = np.log(own[top_bin - 1 : top_bin + 2] + 1e-300)
        bend = a - 2.0 * b + c
        shift = 0.5 * float(a - c) / float(bend) if bend < 0 else 0.0
        frequency = (top_bin + shift) * step / strongest
        amplitude = float(np.hypot.reduce([own[k * m] for m, _ in tones]))
        found[:, i] = frequency, amplitude, 0.5 * amplitude**2 / power[i]
    return found


def _grouped(starts: Integers, window: int, frequency: Floats, active: Bools, ends: tuple[int, int]) -> list[Region]:
    """Join active windows of like frequency, and let each region reach half-way into what lies between."""
    groups: list[list[int]] = []
    hz = frequency.tolist()
    for i in np.flatnonzero(active).tolist():
        if groups and i - groups[-1][-1] <= 2:
            reference = median(hz[j] for j in groups[-1][-9:])
            if abs(hz[i] - reference) < 0.05 * reference:
                groups[-1].append(i)
                continue
        groups.append([i])
    groups = [g for g in groups if len(g) > 1 or len(starts) < 3]  # a single window straddles a change
    found: list[Region] = []
    for j, group in enumerate(groups):
        before = ends[0] if j == 0 else (starts[groups[j - 1][-1]] + window + starts[group[0]]) // 2
        after = ends[1] if j == len(groups) - 1 else (starts[group[-1]] + window + starts[groups[j + 1][0]]) // 2
        first, last = int(starts[group[0]]), int(starts[group[-1]]) + window
        begin, end = max(before, first - 2 * window), min(after, last + 2 * window)
        found.append(Region(int(begin), int(end), float(np.median(frequency[group]))))
    return found
