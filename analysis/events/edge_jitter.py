"""Edge jitter from the repetition of the motion: scatter of the contact circuit beyond the edges' own uncertainty.

No model of the ball is used. In a step where the motion repeats after a few periods, corresponding edges of successive
cycles form a sequence. Its slow change (an amplitude modulation) and its spectral lines (hum) do not count as jitter.

Edges that are rounded to samples scatter by the rounding as well. At one place between two samples, where all edges are
if a cycle is a whole number of samples, the rounding repeats, and jitter shows only in edges that change their sample.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from analysis.statistics import median, nearest
from kernels.arrays import Bools, Floats, Integers

MATCH_S = 5e-4  # largest difference between an edge and that of the next cycle
MIN_STEPS = 3


@dataclass(frozen=True)
class Scatter:
    """Scatter of edges from cycle to cycle, in each step that repeats."""

    # variance beyond what is stated, s^2, (k,), of steps whose edges are at several places between samples; below zero
    # where edges scatter by less
    excess_s2: Floats = field(default_factory=lambda: np.zeros(0))
    # squared scatter of rounded edges at one place, s^2, (r,)
    repeated_s2: Floats = field(default_factory=lambda: np.zeros(0))
    # degrees of freedom of the step's scatter, (r,)
    freedom: Integers = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    excess_freedom: int = 0  # of all steps of ``excess_s2`` together
    sampling_s: float = 0.0  # interval of the samples to which edges are rounded; 0 where they are not

    @classmethod
    def of(
        cls,
        time_s: Floats,
        sigma_s: Floats,
        step: Integers,
        seen: Bools,
        period_s: Floats,
        lines_radps: Sequence[Floats] = (),
        sampling_s: float = 0.0,
    ) -> Self:
        """From edges.

        Parameters
        ----------
        time_s, sigma_s, step
            Edges in order, their uncertainty and their step, arrays (n,).
        seen
            Edges used, (n,).
        period_s
            Period of the forcing in each step, (m,).
        lines_radps
            Angular frequencies of each step's lines that are no multiple of the forcing.
        sampling_s
            Interval of the samples to which edges are rounded; 0 where they are not.
        """
        excess, repeated, freedoms, excess_freedom = [], [], [], 0
        for i, period in enumerate(period_s):
            own = np.flatnonzero(seen & (step == i))
            sigma = median(sigma_s[own]) if len(own) else 0.0
            read_once = sampling_s > 0.0 and bool(rounded(sigma, sampling_s))
            squares, freedom, same, pairs, still = 0.0, 0, 0.0, 0, False
            for sequence, off, cycle_s in _sequences(time_s[own], float(period)):
                left, free = _left(sequence, off, lines_radps[i] if len(lines_radps) else np.zeros(0))
                squares, freedom = squares + float(left @ left), freedom + free
                if read_once and free:
                    square, n = _at_one_place(left * math.sqrt(len(left) / free), cycle_s / sampling_s)
                    same, pairs = same + square, pairs + n
                    # edges that move by less than half a sample over the step are all at one place
                    still = still or len(off) * abs(cycle_s / sampling_s - round(cycle_s / sampling_s)) < 0.5
            # fewer than three degrees of freedom say nothing of a variance
            if freedom < 3:
                continue
            if pairs:
                repeated.append(same / pairs)
                freedoms.append(freedom)
            if not still:
                middle = (1.0 - 2.0 / (9.0 * freedom)) ** 3  # median over mean of chi square (Wilson-Hilferty)
                excess.append(squares / freedom / middle - sigma**2)
                excess_freedom += freedom
        return cls(np.array(excess), np.array(repeated), np.array(freedoms, dtype=np.int64), excess_freedom, sampling_s)

    @classmethod
    def together(cls, parts: Sequence[Scatter]) -> Scatter:
        """Of several recordings, at least one; their rounding is left out where they are not sampled alike."""
        alike = len({x.sampling_s for x in parts}) == 1
        return cls(
            np.concatenate([x.excess_s2 for x in parts]),
            np.concatenate([x.repeated_s2 for x in parts]),
            np.concatenate([x.freedom for x in parts]),
            sum(x.excess_freedom for x in parts),
            parts[0].sampling_s if alike else 0.0,
        )

    def less(self, motion_s: float) -> Self:
        """Without the scatter of the motion itself, which a ringing plate makes."""
        repeated = np.maximum(self.repeated_s2 - motion_s**2, 0.0)
        return replace(self, excess_s2=self.excess_s2 - motion_s**2, repeated_s2=repeated)

    @property
    def tells(self) -> bool:
        """Whether enough steps repeat."""
        return max(len(self.excess_s2), len(self.repeated_s2)) >= MIN_STEPS

    def raised(self, sigma_s: Floats, others_s: float = math.nan) -> Floats:
        """Uncertainties (n,) raised by the jitter; as they are where fewer than `MIN_STEPS` steps repeat.

        ``others_s`` is the jitter of the circuit's other edges, NaN for unknown: the fewer edges repeat, the more it
        counts, and it stands for the jitter where too few do.
        """
        by_others = sigma_s if math.isnan(others_s) else np.hypot(sigma_s, others_s)
        if len(self.excess_s2) >= MIN_STEPS:
            freedom = self.excess_freedom
            own = np.sqrt(sigma_s**2 + max(float(np.median(self.excess_s2)), 0.0))
        elif math.isfinite(self.jitter_s):
            freedom, own = int(np.sum(self.freedom)), np.hypot(sigma_s, self.jitter_s)
        else:
            return by_others
        if math.isnan(others_s):
            return np.asarray(own)
        # variance of the logarithm of a median of chi squares; openings and closings jitter by one variance to a
        # factor of 1.5
        chance, unlike = math.pi / freedom, math.log(1.5) ** 2
        return np.asarray(own * (by_others / own) ** (chance / (chance + unlike)))

    @property
    def jitter_s(self) -> float:
        """Jitter of edges before they are rounded to samples; infinite where edges at one place do not tell it."""
        if self.sampling_s == 0.0 or len(self.repeated_s2) < MIN_STEPS:
            return math.inf
        return _before_rounding(self.repeated_s2, self.freedom, self.sampling_s)


def raised_together(sigmas_s: Sequence[Floats], scatters: Sequence[Scatter]) -> list[Floats]:
    """Uncertainties of several recordings of one rig, each raised by its own steps that repeat.

    Where these are too few, as in a short block, the circuit is the same, and those of all recordings tell that are
    sampled alike. The uncertainties are those without jitter there, and already raised elsewhere.
    """
    out = []
    for sigma_s, own in zip(sigmas_s, scatters, strict=True):
        alike = [x for x in scatters if x.sampling_s == own.sampling_s]
        out.append(sigma_s if own.tells else Scatter.together(alike).raised(sigma_s))
    return out


def rounded(sigma_s: ArrayLike, sampling_s: float) -> Bools:
    """Whether edges were rounded to samples: they are known no better than to the rounding's standard deviation."""
    # a rounded edge's stated error is that of the rounding or more, five percent left for what was averaged
    return np.asarray(sigma_s) >= 0.95 * sampling_s / math.sqrt(12.0)


def _at_one_place(left_s: Floats, samples: float) -> tuple[float, int]:
    """Half the squared differences of edges at one place, summed over pairs, and their number.

    ``left_s`` (n,) are deviations of edges that come every so many samples.
    """
    i, j = np.triu_indices(len(left_s), 1)
    away = samples * (j - i)
    # a tenth of a sample counts as the same place
    near = np.abs(away - np.round(away)) < 0.1
    return 0.5 * float(np.sum((left_s[i] - left_s[j])[near] ** 2)), int(np.count_nonzero(near))


def _before_rounding(squares: Floats, freedom: Integers, sampling_s: float) -> float:
    """Jitter from the squared scatter of steps' edges at one place between two samples, unknown in each step.

    Averaged over all places, jitter of J leaves the variance ``J T / sqrt(pi)`` while it is below a third of the
    interval ``T``, else ``J^2 + T^2 / 12``.
    """
    # a step whose edges hop between distant samples must not decide: it counts as three times the middle at most
    most = max(3.0 * float(np.median(squares)), 0.25 * sampling_s**2)  # two neighbouring samples in turn
    share = float(np.average(np.minimum(squares, most), weights=freedom)) / sampling_s**2
    return sampling_s * (math.sqrt(math.pi) * share if share < 1.0 / 6.0 else math.sqrt(share - 1.0 / 12.0))


def _left(time_s: Floats, off_s: Floats, lines_radps: Floats) -> tuple[Floats, int]:
    """Deviations (n,) from a cubic and the lines, and their degrees of freedom."""
    slow = _cubics(len(off_s))
    left, freedom = off_s - slow @ (slow.T @ off_s), len(off_s) - slow.shape[1] - 2 * len(lines_radps)
    if freedom <= 0:
        return np.zeros_like(off_s), 0
    if len(lines_radps):
        regular = time_s - off_s - time_s[0]  # a line at jittered times would fit the jitter itself
        lines = np.exp(1j * np.outer(regular, lines_radps))
        shapes = np.hstack([slow, lines.real, lines.imag])
        left = off_s - shapes @ np.linalg.lstsq(shapes, off_s, rcond=None)[0]
    return left, freedom


@lru_cache(maxsize=256)
def _cubics(n: int) -> Floats:
    """Orthonormal polynomials to the third power over ``n`` places, (n, 4)."""
    return np.asarray(np.linalg.qr(np.polynomial.chebyshev.chebvander(np.linspace(-1.0, 1.0, n), 3))[0])


def _sequences(time_s: Floats, period_s: float) -> list[tuple[Floats, Floats, float]]:
    """Sequences of corresponding edges of successive cycles, for the shortest cycle after which most edges repeat.

    Of each the times, the times less whole cycles, and the cycle.
    """
    # longer cycles than six periods leave too few repetitions in a step
    for cycle in range(1, 6 + 1):
        later = time_s + cycle * period_s
        inside = later < time_s[-1] + MATCH_S if len(time_s) else np.zeros(0, dtype=bool)
        # six edges with a next cycle at least; a longer cycle leaves fewer, so none is looked for
        if inside.sum() < 6:
            break
        partner = nearest(time_s, later)
        matched = inside & (np.abs(time_s[partner] - later) < MATCH_S)
        # a fifth may be missing, by chatter or a lost edge; of irregular motion fewer find a partner
        if matched.sum() >= 0.8 * inside.sum():
            return _chained(time_s, partner, matched, cycle * period_s)
    return []


def _chained(time_s: Floats, partner: Integers, matched: Bools, cycle_s: float) -> list[tuple[Floats, Floats, float]]:
    """Each sequence from its first edge on: times, times less whole cycles, and the cycle."""
    out, later = [], np.where(matched, partner, -1).tolist()
    for first in sorted(set(np.flatnonzero(matched).tolist()).difference(later)):
        chain = [first]
        while (following := later[chain[-1]]) >= 0:
            chain.append(following)
        own = time_s[chain]
        out.append((own, own - own[0] - cycle_s * np.arange(len(chain)), cycle_s))
    return out
