"""Regression of a plate mode on recorded volts, and the blocks that they are reduced to.

References
----------
W. K. Newey, K. D. West, Econometrica 55, 703 (1987): covariance where the remainder is correlated.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from analysis.linear_algebra import lstsq, pinv
from analysis.plate.mains_lines import MAINS_HZ
from analysis.plate.ringing.mode_motion import TORN_S, PushedPlate, answer, turn_of
from analysis.signals import block_means, pieces
from daq.recording import Recording
from kernels.arrays import Bools, Complexes, Floats, Integers

LEAD_S = 1e-3  # before an impact, left out with it
HUM_HZ = tuple(k * hz for hz in MAINS_HZ for k in (1, 3, 5))
INTEGRALS = 3  # the drive, and its first and second integral
LEAKS = 0.1  # of the forcing's frequency: below it an integral of the drive leaks, as it would wander


def volts_in_blocks(recording: Recording, width: int) -> tuple[Floats, Floats]:
    """Block means of acceleration in m/s^2, whatever its zero, and drive in volts, (n,) each.

    Blocks begin and end at a sample, of which half belongs to either, so that their times are those of flights.
    """
    parts: dict[str, list[Floats]] = {"accelerometer": [], "drive": []}
    rest = {name: np.zeros(0, dtype=np.float32) for name in parts}
    for piece in pieces(recording, ("accelerometer", "drive")):
        for name, found in parts.items():
            volts = np.concatenate([rest[name], piece.own(name)])
            n = max(len(volts) - 1, 0) // width
            begun = block_means(volts, width)[:n].astype(np.float64)
            found.append(0.5 * (begun + block_means(volts, width, 1)[:n]))
            rest[name] = volts[n * width :].copy()
    both = {name: np.concatenate(found) for name, found in parts.items()}
    return both["accelerometer"] / recording.setup.channels.accelerometer.volts_per_mps2, both["drive"]


def unmasked(n: int, block_s: float, landing_s: Floats, mask_s: float) -> Bools:
    """Blocks (n,) without an impact or its ringing, and not at the end."""
    edges = np.zeros(n + 1, dtype=np.int64)
    first = np.clip(((landing_s - LEAD_S) / block_s).astype(np.int64), 0, n)
    last = np.clip(((landing_s + mask_s) / block_s).astype(np.int64) + 1, 0, n)
    np.add.at(edges, first, 1)
    np.add.at(edges, last, -1)
    edges[max(n - round(0.1 / block_s), 0)] += 1  # s: there the drive is cut off, and its integrals are not known
    return np.asarray(np.cumsum(edges[:-1]) == 0)


def over_noise(left: Floats, known: Bools) -> float:
    """Mean square of what is left in the known blocks over that of its noise, at least 1.

    Noise is what differs from block to block; what a model misses of a motion far below the blocks' rate does not.
    """
    noise = 0.5 * float(np.mean(np.diff(left)[np.diff(np.flatnonzero(known)) == 1] ** 2))
    return max(float(np.mean(left**2)) / noise, 1.0)


def drive_regressors(recording: Recording, drive_v: Floats, block_s: float) -> tuple[Floats, int]:
    """What the drive makes of the plate, (n, k), and how many of the first columns may be forces on the plate.

    Each tone with its first two integrals, and each a quarter of a period later: the drive may be a force, or what is
    recorded of it an acceleration, a speed or a path, in any phase. In steady tones these are two columns a tone; where
    the level changes they are not. Bends by the level, squares, cubes and products of tones are no force. Two for each
    line of the mains (`HUM_HZ`) are the last columns.
    """
    forcing = recording.setup.forcing
    w, n = 2.0 * math.pi * forcing.frequency_hz, len(drive_v)
    time_s = (np.arange(n) + 0.5) * block_s
    tones = _tones(drive_v, block_s, forcing.multiples, w)
    integrals = np.concatenate([_integrals(z, block_s, w) for z in tones])
    forces = _scaled(np.concatenate([integrals.real, integrals.imag]))
    level = np.abs(tones[0]) ** 2
    first = tones[0]
    columns = [*(level * z for z in tones), first**2, first**3]
    for further in tones[1:]:
        columns += [first * further, np.conj(first) * further, further**2]
    bent = _scaled(np.concatenate([[z.real, z.imag] for z in columns]))
    slow = np.cos(np.pi * np.arange(4)[:, None] * np.arange(n) / n)  # the zero wanders
    hum = [part(2.0 * np.pi * line * time_s) for line in HUM_HZ for part in (np.cos, np.sin)]
    return np.concatenate([forces, bent, slow, hum]).T, len(forces)


def _tones(drive_v: Floats, block_s: float, multiples: Sequence[float], w: float) -> list[Complexes]:
    """Analytic signal of the drive about each tone, (n,) each, up to the middle between it and the next."""
    n = len(drive_v)
    relative = 2.0 * np.pi * np.fft.fftfreq(2 * n, block_s) / w  # zeros behind the end: what leaks does not come round
    spectrum = np.where(relative > 0.0, 2.0 * np.fft.fft(drive_v, 2 * n), 0.0)
    edges = [0.0, *(0.5 * (a + b) for a, b in itertools.pairwise(multiples)), np.inf]
    bands = ((relative > low) & (relative <= high) for low, high in itertools.pairwise(edges))
    return [np.asarray(np.fft.ifft(np.where(band, spectrum, 0.0))[:n]) for band in bands]


def _integrals(tone: Complexes, block_s: float, w: float) -> Complexes:
    """An analytic signal and its integrals over time in units of 1/w, (`INTEGRALS`, n)."""
    n = len(tone)
    relative = 2.0 * np.pi * np.fft.fftfreq(2 * n, block_s) / w
    once = -1j * relative / (relative**2 + LEAKS**2)
    return np.asarray(np.fft.ifft(np.fft.fft(tone, 2 * n) * once ** np.arange(INTEGRALS)[:, None])[:, :n])


def _scaled(table: Floats) -> Floats:
    """Rows that are not zero, scaled to a root mean square of 1."""
    size = np.sqrt(np.mean(table**2, axis=1))
    return np.asarray(table[size > 0.0] / size[size > 0.0, None])


EFFECT = "table_resonance"  # by which a verdict names the mode
LOWEST_HZ, HIGHEST_HZ = 0.7, 200.0
GRID = 1.12  # ratio of neighbouring frequencies of the first look
# what is found at a bound, or so damped above the drive, is no mode
LEAST_DAMPING, MOST_DAMPING, STRONG_DAMPING = 1e-3, 0.9, 0.5
CLUSTER_S = TORN_S  # length of the pieces whose scores are taken as independent
FEWEST_IN_CLUSTER, TORN = 50, 1.6  # blocks of a piece that is left out, with so many times the usual remainder
RESOLVED, RESOLVED_RATIO = 0.03, 0.002  # of half-width, damping and mass ratio: what blocks blur
LAGS = 2  # pieces whose scores are correlated
GAIN_NATS, SURE_NATS = 15.0, 200.0  # least gain of a mode that is there, and of one without a near rival
# of the best mode of the first look; of what is left, over noise: below both a search would find none that is sure
QUIET_NATS, QUIET_OVER_NOISE = 0.5 * GAIN_NATS, 1.03
LEFT_BY_TWO = 0.9  # of what one mode leaves of the acceleration, where a second one is said to be missing


@dataclass(frozen=True)
class PlateMode:
    """A damped mode of the plate that the ball strikes."""

    frequency_hz: float  # of ``q'' + 2 damping w q' + w^2 q = mass_ratio * push``
    damping: float  # over critical
    mass_ratio: float  # ball over moving mass
    covariance: Floats  # of the three, (3, 3)
    remainder_mps2: float  # root mean square of what is left of the acceleration with the mode
    before_mps2: float  # the same without it
    gain_nats: float  # by how much the mode raises the likelihood, the remainder's correlation allowed for
    pushed: PushedPlate | None = None  # what the ball did to the plate, where the mode is sure
    second: PlateMode | None = None  # where one mode does not suffice: it answers what is left, roughly

    def sigmas(self) -> tuple[float, float, float]:
        """Standard deviations of frequency, damping and mass ratio."""
        f, d, m = np.sqrt(np.diag(self.covariance))
        return float(f), float(d), float(m)

    @property
    def sure(self) -> bool:
        """Whether no other minimum comes near, so that its values may be taken for measured."""
        return self.gain_nats > SURE_NATS

    def measured(self) -> dict[tuple[str, str], tuple[float, float]]:
        """Values and standard deviations, by effect and parameter."""
        names = ("frequency_hz", "damping", "mass_ratio")
        return {(EFFECT, name): (getattr(self, name), sigma) for name, sigma in zip(names, self.sigmas(), strict=True)}


@dataclass(frozen=True)
class Regression:
    """Unmasked blocks with everything linear but the mode taken out of them.

    The mode is ``shaken`` by the ball's push, and by forces of the drive, of any size. ``begun`` are the blocks at
    which the mode's state is free, so that it rings on from there whatever was before.
    """

    left: Floats
    basis: Floats  # orthonormal, (k, l)
    shaken: Floats  # by the push and by what may be forces, (1 + l, n)
    known: Bools
    block_s: float
    cluster: Integers
    begun: tuple[int, ...]

    @classmethod
    def of(
        cls, acceleration: Floats, basis: Floats, shaken: Floats, known: Bools, block_s: float,
        begun: Sequence[int],
    ) -> Regression:  # fmt: skip
        seen = acceleration[known]
        cluster = (np.flatnonzero(known) * block_s / CLUSTER_S).astype(np.int64)
        return cls(seen - basis @ (basis.T @ seen), basis, shaken, known, block_s, cluster, tuple(begun))

    def answers(self, frequency_hz: float, damping: float) -> Floats:
        """The mode's answers to push and forces, and how it rings on from each free state, (n, 1 + l + 2 r)."""
        (pushes, n), turn = self.shaken.shape, turn_of(frequency_hz, damping)
        out = np.zeros((pushes + 2 * len(self.begun), n))
        out[:pushes] = answer(self.shaken, self.block_s, frequency_hz, damping)
        for k, at in enumerate(self.begun):
            ringing = np.exp(turn * self.block_s * np.arange(n - at))
            out[pushes + 2 * k, at:], out[pushes + 2 * k + 1, at:] = ringing.real, ringing.imag
        return out.T

    def columns(self, frequency_hz: float, damping: float) -> Floats:
        """`answers` in the known blocks, less what the rest could explain."""
        x = self.answers(frequency_hz, damping)[self.known]
        return np.asarray(x - self.basis @ (self.basis.T @ x))

    def sizes(self, columns: Floats) -> Floats:
        """Mass ratio, not negative, sizes of the forces, and of the free states."""
        normal, side = columns.T @ columns, columns.T @ self.left
        out = pinv(normal, rcond=1e-12) @ side
        # no mass is negative: the rest is then fitted without the push
        if out[0] < 0.0:
            out = np.append(0.0, pinv(normal[1:, 1:], rcond=1e-12) @ side[1:])
        return np.asarray(out)

    def forced(self, x: Floats) -> bool:
        """Whether the mode surely answers the drive, too."""
        columns = self.columns(*np.exp(x))
        fewer = np.delete(columns, np.s_[1 : len(self.shaken)], axis=1)
        before, after = (float(np.sum((self.left - c @ self.sizes(c)) ** 2)) for c in (fewer, columns))
        return 0.5 * (before / after - 1.0) * len(self.left) > SURE_NATS

    def _unpushed(self, columns: Floats) -> Floats:
        """What is left without the push."""
        return np.asarray(self.left - columns[:, 1:] @ lstsq(columns[:, 1:], self.left)[0])

    def gained(self, x: Floats) -> float:
        """By how much the push raises the likelihood of white noise, nats."""
        before, left = self._unpushed(self.columns(*np.exp(x))), self.remainder(x)
        return 0.5 * (float(before @ before) / float(left @ left) - 1.0) * len(left)

    def left_nats(self, x: Floats) -> float:
        """By how much the likelihood could rise if what is left beyond noise were explained."""
        left = self.remainder(x)
        return 0.5 * (over_noise(left, self.known) - 1.0) * len(left)

    def remainder(self, x: Floats) -> Floats:
        """What is left at the logarithms of frequency and damping."""
        columns = self.columns(*np.exp(x))
        return np.asarray(self.left - columns @ self.sizes(columns))

    def slopes(self, x: Floats) -> Floats:
        """Slopes of the fitted answer in the logarithms of frequency and damping, (k, 2)."""
        sizes, h = self.sizes(self.columns(*np.exp(x))), 1e-4
        ahead, behind = ([self.columns(*np.exp(x + d * e)) @ sizes for e in np.eye(2)] for d in (h, -h))
        return np.asarray((np.array(ahead) - np.array(behind)).T / (2.0 * h))

    def without(self, x: Floats) -> Regression:
        """The same with a mode, and small changes of it, among what is linear."""
        known = np.column_stack([self.columns(*np.exp(x)), self.slopes(x)])
        own = np.linalg.qr(known / np.maximum(np.linalg.norm(known, axis=0), 1e-300))[0]
        left = self.left - own @ (own.T @ self.left)
        return replace(self, left=left, basis=np.hstack([self.basis, own]))

    def second(self, forcing_hz: float) -> PlateMode | None:
        """The mode that answers what a first one leaves; None where it explains little of that."""
        gain, start = self.looked[0]
        if gain < 0.5 * (1.0 - LEFT_BY_TWO**2) * float(self.left @ self.left):
            return None
        mode = self.judged(self.followed([start]), forcing_hz)
        return mode if mode and mode.sure and mode.remainder_mps2 < LEFT_BY_TWO * mode.before_mps2 else None

    def searched(self) -> Floats:
        """Logarithms of frequency and damping of the best mode of all."""
        return self.followed([x for _, x in self.looked[:3]])

    @property
    def quiet(self) -> bool:
        """Whether the ball's push explains nothing, and no more than noise is left."""
        power, gain = float(self.left @ self.left), self.looked[0][0]
        nats = 0.5 * (power / (power - gain) - 1.0) * len(self.left)
        return nats < QUIET_NATS and over_noise(self.left, self.known) < QUIET_OVER_NOISE

    @cached_property
    def looked(self) -> list[tuple[float, Floats]]:
        """By how much modes of a grid lower the sum of squares, and their logarithms, the best of each rise first."""
        count = int(math.log(HIGHEST_HZ / LOWEST_HZ) / math.log(GRID))
        at = np.log([[(LOWEST_HZ * GRID**k, d) for d in (0.01, 0.05, 0.2, 0.6)] for k in range(count)])
        gain = np.array([self._gains_of_push(np.exp(row)) for row in at])
        best = np.pad(gain.max(axis=1), 1)
        # local maxima: the best of the whole look would be neighbours of one
        inner = [k for k in range(count) if best[k + 1] >= max(best[k], best[k + 2])]
        found = [(float(best[k + 1]), np.asarray(at[k, np.argmax(gain[k])])) for k in inner]
        return sorted(found, key=lambda pair: -pair[0])

    def _gains_of_push(self, modes: Floats) -> Floats:
        """By how much answers of modes (r, 2) to the push lower the sum of squares, (r,)."""
        x = np.array([answer(self.shaken[0], self.block_s, *mode)[self.known] for mode in modes])
        own = x @ self.basis
        # a push that had to act backwards explains nothing
        return np.asarray(np.maximum(x @ self.left, 0.0) ** 2 / (np.sum(x**2, axis=1) - np.sum(own**2, axis=1)))

    def followed(self, starts: list[Floats]) -> Floats:
        """The best minimum from some starts."""
        low, high = np.log([[0.5 * LOWEST_HZ, LEAST_DAMPING], [2.0 * HIGHEST_HZ, MOST_DAMPING]])
        fits = [
            least_squares(self.remainder, x, bounds=(low, high), x_scale=0.1, xtol=1e-4, ftol=1e-6, max_nfev=25)
            for x in starts
        ]
        # none at a bound where there is another: with the mode out of range free states explain much, but no impact
        inside = [f for f in fits if math.log(LOWEST_HZ) < f.x[0] < math.log(HIGHEST_HZ)]
        return np.asarray(min(inside or fits, key=lambda f: f.cost).x)

    def worst_cluster(self, x: Floats) -> int | None:
        """The first piece with far more left than the usual one; None where none is."""
        power, count = (np.bincount(self.cluster, v) for v in (self.remainder(x) ** 2, np.ones(len(self.left))))
        rms = np.sqrt(power / np.maximum(count, 1.0))
        bad = np.flatnonzero((count >= FEWEST_IN_CLUSTER) & (rms > TORN * np.median(rms[count > 0])))
        return int(bad[0]) if len(bad) else None

    def judged(self, x: Floats, forcing_hz: float) -> PlateMode | None:
        """The mode at the logarithms of frequency and damping with its covariance; None where it is none."""
        frequency, damping = (float(v) for v in np.exp(x))
        columns = self.columns(*np.exp(x))
        sizes = self.sizes(columns)
        left = self.left - columns @ sizes
        before = self._unpushed(columns)
        jacobian = np.column_stack([self.slopes(x), columns])
        # columns of one size: frequency, damping and free states differ by many powers of ten
        norms = np.linalg.norm(jacobian, axis=0)
        jacobian, size = jacobian / np.maximum(norms, 1e-300), norms[:3]
        inverse = pinv(jacobian.T @ jacobian, rcond=1e-10)
        scores = np.array([np.bincount(self.cluster, row) for row in (jacobian * left[:, None]).T])
        meat = scores @ scores.T
        for lag in range(1, LAGS + 1):  # Newey and West's
            late = scores[:, lag:] @ scores[:, :-lag].T
            meat += (1.0 - lag / (LAGS + 1.0)) * (late + late.T)
        found = (inverse @ meat @ inverse)[:3, :3] / np.outer(size, size)
        white = inverse[:3, :3] / np.outer(size, size) * np.mean(left**2)
        to_own = np.array([frequency, damping, 1.0])
        # of a correlated remainder fewer values are independent, by the ratio of both variances
        correlated = max(float(found[2, 2] / white[2, 2]), 1.0)
        gain = 0.5 * (float(before @ before) / float(left @ left) - 1.0) * len(left) / correlated
        at_bound = not 1.02 * LEAST_DAMPING < damping < 0.98 * MOST_DAMPING
        bound = at_bound or (damping > STRONG_DAMPING and frequency > forcing_hz)
        if sizes[0] <= 0.0 or gain < GAIN_NATS or bound or not LOWEST_HZ < frequency < HIGHEST_HZ:
            return None
        rms = [float(np.sqrt(np.mean(v**2))) for v in (left, before)]
        blurred = np.square([RESOLVED * damping, RESOLVED, (RESOLVED_RATIO + RESOLVED * damping) * sizes[0]])
        covariance = (found * over_noise(left, self.known) + white + np.diag(blurred)) * np.outer(to_own, to_own)
        return PlateMode(frequency, damping, float(sizes[0]), covariance, rms[0], rms[1], gain)
