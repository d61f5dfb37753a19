"""Follow a forcing's tones cycle by cycle, and cut where they change.

Cycles are compared by joint least-squares fits of the tones to each, so neither the sampling's phase nor a constant nor
the other tone leaks in. A cut minimises the squared deviations from each part's mean, in units of their standard
deviations, plus a penalty for each part (optimal partitioning: Jackson et al., IEEE Signal Process. Lett. 12 (2005)
105).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from daq.lock_in import ToneFits
from daq.steps.forcing_detection import Region, Signal, weights
from kernels import njit
from kernels.arrays import Bools, Floats, Integers


class SegmentCosts:
    """Weighted means of a sequence over any range, and the squared deviations from them, in constant time.

    ``values`` is (n, d), as ``sigma``, the standard deviation of each.
    """

    def __init__(self, values: Floats, sigma: Floats) -> None:
        weight = 1.0 / sigma**2
        origin = np.median(values, axis=0)
        shifted = values - origin
        self._origin = origin
        self._w, self._wy, self._wyy = (
            np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(x, axis=0)])
            for x in (weight, weight * shifted, weight * shifted**2)
        )

    def cuts(self, penalty: float) -> list[int]:
        """Ends of the cheapest partition, the first and the last included; each part costs ``penalty``."""
        n = len(self._w) - 1
        previous = np.zeros(n + 1, np.int64)
        _partition(self._w, self._wy, self._wyy, penalty, previous)
        ends = [n]
        while ends[-1] > 0:
            ends.append(int(previous[ends[-1]]))
        return ends[::-1]

    def mean(self, start: int, stop: int) -> tuple[Floats, Floats]:
        """Mean of each column over ``start .. stop``, and its standard error."""
        w = self._w[stop] - self._w[start]
        return self._origin + (self._wy[stop] - self._wy[start]) / w, 1.0 / np.sqrt(w)


def segments(values: Floats, sigma: Floats, same: Floats, penalty: float) -> list[tuple[int, int]]:
    """Parts of constant level as ``(start, stop)``, in order, covering the sequence.

    ``values`` is (n, d), as ``sigma``, the standard deviation of each. A part costs ``penalty``; neighbouring parts
    whose means differ by less than ``same`` (d,) in each column are one.
    """
    costs = SegmentCosts(values, sigma)
    first, *others = pairwise(costs.cuts(penalty))
    parts = [first]
    for start, stop in others:
        before, sigma_before = costs.mean(*parts[-1])
        after, sigma_after = costs.mean(start, stop)
        if np.all(np.abs(after - before) < np.maximum(4.0 * np.hypot(sigma_before, sigma_after), same)):
            parts[-1] = (parts[-1][0], stop)
        else:
            parts.append((start, stop))
    return parts


@njit(error_model="numpy")
def _partition(w, wy, wyy, penalty, previous):  # type: ignore[no-untyped-def]
    """Begin of the last part of the cheapest partition up to each place, from cumulative sums (n + 1, d)."""
    n, d = w.shape[0] - 1, w.shape[1]
    best = np.zeros(n + 1)
    for stop in range(1, n + 1):
        best[stop] = np.inf
        for start in range(max(0, stop - 192), stop):  # longer parts come back together afterwards
            cost = best[start] + penalty
            for k in range(d):
                cost += wyy[stop, k] - wyy[start, k] - (wy[stop, k] - wy[start, k]) ** 2 / (w[stop, k] - w[start, k])
            if cost < best[stop]:
                best[stop], previous[stop] = cost, start


SETTLE_CYCLES = 2.0  # after a fade, not counted as hold
SHORTEST_WINDOWS = 4  # a shorter stillness is part of a fade
LEAST_SWEEP = 12  # windows; what is shorter may be a fade, what is longer and holds still is a step
QUIET = 2e-3  # of the largest amplitude
SAME_ADVANCE = 1e-3  # radians a window
PENALTY = 30.0


@dataclass(frozen=True)
class SteadySegment:
    """A stretch of constant tones: first sample of its fade, first constant sample, end, rough frequency."""

    start: int
    hold: int
    stop: int
    frequency_hz: float

    def settled(self, rate_hz: float) -> int:
        """First sample that counts as hold: two cycles after the fade, or the middle of a short step."""
        return min(self.hold + round(SETTLE_CYCLES * rate_hz / self.frequency_hz), (self.hold + self.stop) // 2)


@dataclass(frozen=True)
class _Track:
    """Fits of successive windows: amplitudes (n, k), noise (n, 1), the main tone's phase advance (n,), loudness."""

    edges: Integers
    amplitude: Floats
    floor: Floats
    advance: Floats
    main: int
    loud: Bools

    def frequency_change(self, a: int, b: int, signal: Signal) -> float:
        """Distance of windows ``a .. b`` from the reference frequency (first tone, hertz), by the median advance."""
        inner = self.advance[min(a + 1, b - 1) : b]
        window_s = float(self.edges[b] - self.edges[a]) / ((b - a) * signal.rate_hz)
        return float(np.median(inner)) / (2.0 * np.pi * window_s * weights(signal.forcing)[self.main][0])


def split_exactly(signal: Signal, near: list[Region]) -> list[Region]:
    """Move the border between two touching regions to where the one frequency stops fitting and the other starts."""
    exact = list(near)
    for i in range(len(exact) - 1):
        left, right = exact[i], exact[i + 1]
        if right.start > left.stop:
            continue
        reach = round(max(10 / left.frequency_hz, 0.1) * signal.rate_hz)
        low, high = max(left.start, left.stop - reach), min(right.stop, left.stop + reach)
        edges = _edges(low, high, signal.rate_hz, min(left.frequency_hz, right.frequency_hz))
        misfit = np.array([signal.fits(edges, side.frequency_hz).rms ** 2 for side in (left, right)]).T.reshape(-1, 2)
        before = np.concatenate([[0.0], np.cumsum(misfit[:, 0])])
        after = np.concatenate([np.cumsum(misfit[::-1, 1])[::-1], [0.0]])
        border = int(edges[np.argmin(before + after)])
        exact[i], exact[i + 1] = replace(left, stop=border), replace(right, start=border)
    return exact


def same_frequency(signal: Signal, region: Region, depth: int = 0) -> list[Region]:
    """Cut a region where its frequency changes, however little; each part carries its own frequency.

    A fit at a frequency that is off wobbles from cycle to cycle by a tenth of what the phase advances, so large
    changes are cut first and each part is looked at again.
    """
    track = _track(signal, region)
    if track is None or not track.loud.any():
        return []
    smooth = _running(track.advance[:, None], 5)[:, 0]
    loud = smooth[track.loud]
    spread = float(np.percentile(loud, 98) - np.percentile(loud, 2))
    # all of the region at one frequency, unless the advance of the phase says that it changes
    own = track.frequency_change(0, len(track.advance), signal)
    settled = replace(region, frequency_hz=region.frequency_hz + own)
    if depth >= 6 or spread < 5.0 * SAME_ADVANCE:
        return [settled]
    relative = track.floor[track.loud, 0] / track.amplitude[track.loud, track.main]
    noise = max(float(_noise(track.advance[:, None]).mean()), float(np.median(relative)))
    sigma = np.full((len(smooth), 1), max(0.1 * spread, noise))
    cuts = segments(smooth[:, None], sigma, np.array([SAME_ADVANCE]), PENALTY)
    # short pieces join what follows (they are the change itself), the last one what precedes
    borders = [0]
    for _, stop in cuts:
        if stop - borders[-1] >= SHORTEST_WINDOWS:
            borders.append(stop)
    borders = [*borders[: max(len(borders) - 1, 1)], cuts[-1][1]]
    if len(borders) == 2:
        return [settled]
    parts: list[Region] = []
    for a, b in pairwise(borders):
        change = track.frequency_change(a, b, signal)
        piece = Region(int(track.edges[a]), int(track.edges[b]), region.frequency_hz + change)
        parts += same_frequency(signal, piece, depth + 1)
    return parts


def steady_segments(signal: Signal, region: Region) -> list[SteadySegment]:
    """Stretches of a region in which every amplitude and the phase's advance are constant, each with its fade."""
    track = _track(signal, region)
    if track is None or not track.loud.any():
        return []
    values, sigma, same = _features(track)
    # what stands still long enough is a step, unless it moves with the path between its neighbours
    parts = segments(values, sigma, same, PENALTY)
    steady = np.array([_steady(track, a, b, sigma) for a, b in parts]) & ~_on_the_way(track.amplitude, parts)
    covered = sum(b - a for (a, b), s in zip(parts, steady, strict=True) if s)
    # where little holds still, that is chance, and the whole a sweep
    if covered < 0.3 * track.loud.sum() and track.loud.sum() >= LEAST_SWEEP:
        # a sweep that never rests is taken in equal pieces of its loud part, holds that drift in pieces between jumps
        first, last = (int(k) for k in np.flatnonzero(track.loud)[[0, -1]])
        change = np.abs(np.diff(track.amplitude[first : last + 1, track.main]))
        jumps = first + 1 + np.flatnonzero(change > 8.0 * np.median(change))
        borders = [first, *jumps.tolist(), last + 1]
        parts = [(k, min(k + 20, b)) for a, b in pairwise(borders) for k in range(a, b, 20)]
        steady = np.array([b - a >= SHORTEST_WINDOWS for a, b in parts])
    found: list[SteadySegment] = []
    fade_from = None
    for (a, b), take in zip(parts, steady, strict=True):
        if track.loud[a:b].mean() < 0.5:
            fade_from = None
        elif not take:
            fade_from = a if fade_from is None else fade_from
        else:
            begin, b = a if fade_from is None else fade_from, _last_constant(track, a, b)
            hz = region.frequency_hz + track.frequency_change(a, b, signal)
            fade, hold, stop = (int(track.edges[k]) for k in (begin, a, b))
            found.append(SteadySegment(fade, hold, stop, hz))
            fade_from = None
    return found


def frequency_correction(signal: Signal, start: int, stop: int, frequency_hz: float) -> tuple[float, float]:
    """Correction to ``frequency_hz`` by the slope of the tones' phases, with its standard deviation."""
    pieces = _edges(start, stop, signal.rate_hz, frequency_hz)
    edges = pieces[:: max(1, len(pieces) // 40)]
    if len(edges) < 3:
        return 0.0, np.inf
    fits = signal.fits(edges, frequency_hz)
    time = (edges[:-1] + edges[1:] - 1) / (2.0 * signal.rate_hz)
    time = time - time.mean()
    estimates, information = [], []
    for k, (multiple, _) in enumerate(weights(signal.forcing)):
        z = fits.amplitudes[:, k]
        phase = np.unwrap(np.angle(z))
        noise = np.median(fits.rms * np.sqrt(2.0 / fits.n)) / max(float(np.abs(z).mean()), 1e-300)
        sigma = max(float(noise), 1e-12) / (multiple * 2.0 * np.pi * np.sqrt(time @ time))
        estimates.append(float(time @ phase / (time @ time)) / (2.0 * np.pi * multiple))
        information.append(sigma**-2)
    total = float(np.sum(information))
    return float(np.dot(estimates, information)) / total, total**-0.5


def _edges(start: int, stop: int, rate_hz: float, frequency_hz: float) -> Integers:
    """Sample indices that cut ``start .. stop`` into whole cycles, enough samples in each piece for a fit."""
    cycle = rate_hz / frequency_hz
    piece = cycle * max(1, int(np.ceil(16 / cycle)))
    whole = np.arange(int((stop - start) / piece + 1e-9) + 1)
    edges: Integers = start + np.rint(whole * piece).astype(np.int64)
    return edges


def _track(signal: Signal, region: Region) -> _Track | None:
    """Fits of successive windows of a region; None where it is too short to hold a step."""
    edges = _edges(region.start, region.stop, signal.rate_hz, region.frequency_hz)
    if len(edges) < SHORTEST_WINDOWS + 1:
        return None
    looked_at = np.unique(np.linspace(0, len(edges) - 2, 16).astype(np.int64)).tolist()
    windows: dict[int, Floats] = {}

    def noted(start: int, stop: int) -> Floats:
        """Volts; a copy of the windows that are looked at again stays in memory."""
        x = signal.read(start, stop)
        inside = (k for k in looked_at if start <= edges[k] and edges[k + 1] <= stop)
        windows.update({k: x[edges[k] - start : edges[k + 1] - start].copy() for k in inside})
        return x

    fits = replace(signal, read=noted).fits(edges, region.frequency_hz)
    z, rms, n = fits.amplitudes, fits.rms, fits.n
    amplitude = np.abs(z)
    share = _independent_share(windows, edges, fits, signal.rate_hz)
    usual = _running(rms[:, None], 25, 0.8)  # a fade leaves much over, but that is short and no noise
    own = rms * np.sqrt(2.0 / (n * max(share, 1.0)))
    floor = np.maximum(usual * np.sqrt(2.0 / np.maximum(n * share, 1.0))[:, None], own[:, None])
    loud = amplitude.max(axis=1) > np.maximum(QUIET * amplitude.max(), 4.0 * rms * np.sqrt(2.0 / n))
    main = int(np.argmax(np.median(amplitude, axis=0)))
    advance = np.zeros(len(z))
    # phase gained in a window against the reference frequency
    advance[1:] = np.angle(z[1:, main] * np.conj(z[:-1, main]))
    advance[1:][~(loud[1:] & loud[:-1])] = 0.0
    return _Track(edges, amplitude, floor, advance, main, loud)


def _independent_share(windows: Mapping[int, Floats], edges: Integers, fits: ToneFits, rate_hz: float) -> float:
    """Share of the samples that count as independent noise for a tone, by what the fits leave over.

    White noise has 1; ringing far above the tones averages out, has more; hum repeats itself, has less: with r the
    lag-one correlation of means over a 64th of a window, ``(1 - r) / (1 + r)`` of those means.
    """
    shares = []
    for k, x in windows.items():
        turns = np.outer(fits.frequencies_hz / rate_hz, np.arange(edges[k], edges[k + 1]))
        rest = x - fits.offsets[k] - (fits.amplitudes[k, :, None] * np.exp(2j * np.pi * turns)).sum(axis=0).real
        width = max(rest.size // 64, 1)
        means = rest[: rest.size // width * width].reshape(-1, width).mean(axis=1)
        power = float(means @ means)
        r = float(means[1:] @ means[:-1]) / power if power > 0.0 else 0.0
        white = float(np.mean(rest**2)) / (width * power / means.size) if power > 0.0 else 1.0
        shares.append(white * (1.0 - max(r, 0.0)) / (1.0 + max(r, 0.0)))
    return max(float(np.median(shares)), 5e-4)


def _features(track: _Track) -> tuple[Floats, Floats, Floats]:
    """Amplitudes and the phase's advance, which hold still in a step; their noise, and the least change that counts."""
    amplitude, floor, main = track.amplitude, track.floor, track.main
    none = np.zeros_like(amplitude)
    sigma_a = np.maximum.reduce(
        [_noise(amplitude), floor + none, 3e-4 * amplitude, 0.1 * QUIET * amplitude.max() + none]
    )
    relative = sigma_a[:, main] / np.maximum(amplitude[:, main], 1e-300)
    both = track.loud & np.concatenate([[False], track.loud[:-1]])
    sigma_p = np.maximum(np.maximum(relative, _noise(track.advance[:, None])[:, 0]), SAME_ADVANCE)
    sigma_p = np.where(both, np.minimum(sigma_p, 1.0), 1.0)
    same = np.append(1e-3 * np.median(amplitude[track.loud], axis=0), SAME_ADVANCE)
    return np.column_stack([amplitude, track.advance]), np.column_stack([sigma_a, sigma_p]), same


def _noise(x: Floats) -> Floats:
    """Standard deviation of each value, from second differences near it (a fade has none), shape of ``x``."""
    if len(x) < 3:
        return np.zeros_like(x)
    bend = np.abs(np.diff(x, 2, axis=0))
    spread: Floats = 1.4826 / np.sqrt(6.0) * _running(np.pad(bend, ((1, 1), (0, 0)), mode="edge"), 25)
    return spread


def _running(x: Floats, width: int, quantile: float = 0.5) -> Floats:
    """Quantile over a sliding window along the first axis; the ends are mirrored."""
    half = min(width, len(x) - 1) // 2
    padded = np.pad(x, ((half, half), (0, 0)), mode="reflect")
    view = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0)
    found: Floats = np.median(view, axis=-1) if quantile == 0.5 else np.quantile(view, quantile, axis=-1)
    return found


def _steady(track: _Track, a: int, b: int, sigma: Floats) -> bool:
    """Whether a part is long, loud, and moves from end to end by less than 1 % or 6 standard errors (10 % or 2)."""
    n = b - a
    if n < SHORTEST_WINDOWS or track.loud[a:b].mean() <= 0.5:
        return False
    if n >= SHORTEST_WINDOWS + 2:  # the windows at the ends may hold a piece of what is beyond
        a, b, n = a + 1, b - 1, n - 2
    amplitude = track.amplitude[a:b]
    x = np.arange(n) - (n - 1) / 2.0
    change = np.abs(x @ amplitude / (x @ x)) * (n - 1)
    noise = sigma[a:b, : amplitude.shape[1]].mean(axis=0) / np.sqrt(x @ x) * (n - 1)
    little, much = 0.01 * amplitude.max(), 0.1 * amplitude.max()
    return not np.any(((change > little) & (change > 6.0 * noise)) | ((change > much) & (change > 2.0 * noise)))


def _last_constant(track: _Track, a: int, b: int) -> int:
    """End of a steady part without the one or two windows that hold the slow beginning of the next change."""
    if b - a < SHORTEST_WINDOWS + 6 or b == len(track.amplitude):
        return b
    inner, last = slice(a + 2, b - 2), np.arange(b - 2, b)  # the first ones may hold the end of the change before
    tones, at = track.amplitude[inner], np.arange(a + 2, b - 2)
    usual = np.median(_noise(tones), axis=0)
    going_on = np.array([np.polyval(np.polyfit(at, tone, 1), last) for tone in tones.T]).T
    moved = np.any(np.abs(track.amplitude[last] - going_on) > 6.0 * usual + 1e-4 * tones.max(axis=0), axis=1)
    return b - 2 if moved[0] else b - int(moved[1])


def _on_the_way(amplitude: Floats, parts: list[tuple[int, int]]) -> Bools:
    """Whether each short part belongs to a fade: it moves as fast as the path from the part before to the one after.

    A step between two others stands still while the path does not; a fade that was cut in pieces moves with it.
    """
    middle = np.array([(a + b - 1) / 2.0 for a, b in parts])
    mean = np.array([amplitude[a:b].mean(axis=0) for a, b in parts])
    moving = np.zeros(len(parts), bool)
    for i, (a, b) in enumerate(parts):
        before, after = i - 1, i + 1
        x = np.arange(a, b) - middle[i]
        # the first and the last part have no path through them
        if before < 0 or after == len(parts) or not x.any() or b - a > LEAST_SWEEP:
            continue
        own = x @ amplitude[a:b] / (x @ x)
        path = (mean[after] - mean[before]) / (middle[after] - middle[before])
        onward = own @ (mean[after] - mean[i]) >= 0.0 and own @ (mean[i] - mean[before]) >= 0.0
        moving[i] = onward and own @ path > 0.5 * float(path @ path)
    return moving
