"""The tones of a recorded drive, which have one level in common: constant in a hold, and whatever it is in a fade."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.linear_algebra import solve, solveh_banded
from kernels.arrays import Complexes, Floats, Integers


@dataclass(frozen=True)
class OneLevel:
    """A drive of tones whose level is the same for all.

    The level multiplies the tones of what was asked for, and recorded is that, or its first or second derivative. So in
    a fade a recorded tone is more than its level times a sine, and each of several tones something else. Bands of
    frequency do not separate them: the spectrum of a fade of two cycles is as wide as the distance between the tones.
    """

    level: Floats  # with its first two derivatives, per radian of the forcing, (3, 1 + n)
    turning: Complexes  # exp(i k w t) of each tone, (k, 1 + n)
    recorded: Complexes  # analytic signal of each tone as it is recorded, (k, 1 + n)
    left: Floats  # of the recorded drive, (n,)

    @classmethod
    def of(
        cls, drive: Floats, block_s: float, frequency_hz: float, multiples: Sequence[int], holds: Integers
    ) -> OneLevel:
        """Of a recorded drive (n,), as the derivative that leaves least; ``holds`` begin and end at blocks (m, 2)."""
        angle = 2.0 * math.pi * frequency_hz * block_s * np.arange(0.5, len(drive) + 1.0)
        asked = np.asarray(drive / max(float(np.std(drive)), 1e-300), dtype=np.float64)
        found = (cls._fitted(asked, angle, 1j * np.array(multiples)[:, None], holds, order) for order in range(3))
        return min(found, key=lambda one: float(one.left @ one.left))

    @classmethod
    def _fitted(cls, drive: Floats, angle: Floats, s: Complexes, holds: Integers, order: int) -> OneLevel:
        """What is recorded taken for the derivative of that ``order``: level and tones are fitted in turn."""
        n, level = len(drive), np.outer([1.0, 0.0, 0.0], np.ones(len(angle)))
        splines, which = _splines(angle, holds)
        parts = [math.comb(order, k) * s ** (-k) for k in range(order + 1)]  # of the level and its derivatives
        for _ in range(6):
            turning = np.exp(s * angle)
            tones = turning * sum(part * own for part, own in zip(parts, level, strict=False))
            columns = np.concatenate([tones.real, -tones.imag])[:, :n]
            sizes = solve(columns @ columns.T + 1e-9 * n * np.eye(len(columns)), columns @ drive)
            a = (sizes[: len(s)] + 1j * sizes[len(s) :])[:, None]
            # the phases of all tones say by how much the frequency is off
            ahead = np.arange(n + 1) - 0.5 * n
            slope = np.sum((s * a * tones).real, axis=0)[:n] * ahead[:n]
            off = float(slope @ (drive - (a * tones).real.sum(axis=0)[:n])) / max(float(slope @ slope), 1e-300)
            angle = angle + off * ahead
            turning = np.exp(s * angle)
            made = sum(
                (part * a * turning).real.sum(axis=0)[:, None] * own for part, own in zip(parts, splines, strict=False)
            )
            level = np.einsum("nk,dnk->dn", _sizes(made[:n], which[:n], drive)[which], splines)
        tones = a * turning * sum(part * own for part, own in zip(parts, level, strict=False))
        return cls(level, turning, tones, drive - tones.real.sum(axis=0)[:n])


def _splines(angle: Floats, holds: Integers) -> tuple[Floats, Integers]:
    """Cubic splines with two derivatives at angles (n,), (3, n, 4), and which four unknowns they belong to, (n, 4).

    About ten to a turn of the forcing, or one to four blocks; in a hold all have the same unknown. A knot lies at the
    end of each hold, so that the level is constant up to there and free at once.
    """
    spacing = max(0.2 * np.pi, 4.0 * float(angle[1] - angle[0]))
    ends = np.unique([0, *np.minimum(holds[:, 1], len(angle) - 1), len(angle) - 1])
    counts = np.maximum(np.rint(np.diff(angle[ends]) / spacing), 1.0)
    place = np.interp(angle, angle[ends], np.append(0.0, np.cumsum(counts)))
    own = np.clip(np.searchsorted(ends, np.arange(len(angle)), "right") - 1, 0, len(counts) - 1)
    per_angle = (counts / np.diff(angle[ends]))[own]  # it may differ from one end to the other: there all is constant
    first = np.minimum(place.astype(np.int64), int(place[-1]) - 1)
    powers = (place - first)[:, None] ** np.arange(4)
    by_power = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0
    slope = np.diag(np.arange(1.0, 4.0), 1)
    splines = np.array([
        powers @ np.linalg.matrix_power(slope, k) @ by_power * per_angle[:, None] ** k for k in range(3)
    ])  # fmt: skip
    knot, held = np.arange(first[-1] + 4), np.full(first[-1] + 4, -1)
    for k, (begin, end) in enumerate(holds):
        held[(knot + 1 > place[begin]) & (knot - 3 < place[min(end, len(angle) - 1)] - 0.5)] = k
    unknown = np.cumsum((np.diff(held, prepend=-1) != 0) | (held < 0))
    return splines, (unknown - unknown[0])[first[:, None] + np.arange(4)]


def _sizes(made: Floats, which: Integers, wanted: Floats) -> Floats:
    """Unknowns by which ``made`` (n, 4), each of one of them, is nearest to what is wanted (n,)."""
    count = int(which.max()) + 2  # the last belongs to the block after the last
    bands, side = np.zeros((4, count)), np.bincount(which.ravel(), (made * wanted[:, None]).ravel(), count)
    for i in range(4):
        for j in range(4):
            later = which[:, i] - which[:, j]
            rows = later >= 0
            np.add.at(bands, (later[rows], which[rows, j]), made[rows, i] * made[rows, j])
    bands[0] += 1e-9 * float(bands[0].max()) + 1e-300
    return np.asarray(solveh_banded(bands, side, lower=True))
