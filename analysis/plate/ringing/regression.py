"""A plate mode, or two, by regression: gain and mass ratio are linear, frequency and damping are searched.

References
----------
W. K. Newey, K. D. West, Econometrica 55, 703 (1987): covariance where the remainder is correlated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from analysis.linear_algebra import eigh, lstsq, pinv, solve, svd
from analysis.plate.ringing.in_blocks import noise_power, over_noise
from analysis.plate.ringing.mode_motion import TORN_S, PushedPlate, answer, turn_of
from kernels.arrays import Bools, Complexes, Floats, Integers

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
    second: PlateMode | None = None  # identified with it, where one mode does not suffice
    noise_mps2: float = math.nan  # of the remainder, what differs from block to block
    left_hz: float = math.nan  # where most of the rest lies

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

    Modes are ``shaken`` by the ball's push, and by forces of the drive, of any size. ``begun`` are the blocks at
    which their state is free, so that they ring on from there whatever was before. ``x`` are logarithms of frequency
    and damping, of one mode or of several, one after the other.
    """

    left: Floats
    basis: Floats  # orthonormal, (k, l)
    shaken: Floats  # by the push and by what may be forces, (1 + l, n)
    carried: Floats  # what the ball that lies on the plate does to one without springs, in the known blocks
    known: Bools
    block_s: float
    cluster: Integers
    begun: tuple[int, ...]
    rubs: bool = False  # whether the push holds the rod's that the ball drags along
    # the noise over how large a force or a free state may be: without it those on two modes grow against each other
    ridge: float = 0.0
    phases: bool = True  # whether each of several modes answers the push in a phase of its own

    @classmethod
    def of(
        cls, acceleration: Floats, basis: Floats, shaken: Floats, contact: Floats, known: Bools, block_s: float,
        begun: Sequence[int],
    ) -> Regression:  # fmt: skip
        left, carried = (x[known] - basis @ (basis.T @ x[known]) for x in (acceleration, contact))
        cluster = (np.flatnonzero(known) * block_s / CLUSTER_S).astype(np.int64)
        # no force is larger than some times the plate's acceleration
        ridge = math.sqrt(noise_power(left, known)) / max(3.0 * float(np.std(acceleration[known])), 1e-300)
        return cls(left, basis, shaken, carried, known, block_s, cluster, tuple(begun), ridge=ridge)

    def answers(self, x: Floats) -> Floats:
        """Answers of each of k modes to the push, in a phase of their own, of each to l forces, how they ring on."""
        n, pushes, forced, free, turned = self.shaken.shape[1], [], [], [], []
        modes = np.exp(x).reshape(-1, 2)
        for mode in modes:
            found = answer(self.shaken, self.block_s, *mode)
            pushes.append(found[0])
            forced.append(found[1:])
            phased = self.phases and len(modes) > 1
            turned.append(answer(self.shaken[0], self.block_s, *mode, turned=True) if phased else np.zeros(n))
            for at in self.begun:
                ringing = np.zeros(n, dtype=np.complex128)
                ringing[at:] = np.exp(turn_of(*mode) * self.block_s * np.arange(n - at))
                free += [ringing.real, ringing.imag]
        return np.concatenate([pushes, np.diff(turned, axis=0), *forced, free]).T

    def columns(self, x: Floats) -> Floats:
        """`answers` in the known blocks, less what the rest could explain."""
        rows = self.answers(x).T[:, self.known]  # in rows: several times faster
        return np.asarray(rows - (rows @ self.basis) @ self.basis.T).T

    def sizes(self, columns: Floats, modes: int = 1) -> Floats:
        """Mass ratios of so many modes, not negative, sizes of the forces, and of the free states."""
        used = np.arange(columns.shape[1])
        while True:
            out = self._solved(columns, modes, used)
            if (out[:modes] >= 0.0).all():
                return out
            # no mass is negative: the rest is then fitted without the push
            used = used[(used >= modes) | (out[used] > 0.0)]

    def _solved(self, columns: Floats, modes: int, used: Integers) -> Floats:
        """Sizes of the columns, of which only some are ``used``, of any sign."""
        out, norms = np.zeros(columns.shape[1]), np.maximum(np.linalg.norm(columns, axis=0), 1e-100)
        normal, side = columns.T @ columns / np.outer(norms, norms), columns.T @ self.left / norms
        normal += np.diag(1e-9 + self._ridges(norms, modes))
        out[used] = solve(normal[np.ix_(used, used)], side[used]) / norms[used]
        return out

    def _ridges(self, norms: Floats, modes: int) -> Floats:
        """What is known beforehand of forces and free states of several modes, for columns of length 1, (k,)."""
        known = (modes > 1) & (np.arange(len(norms)) >= 2 * modes - 1)
        return np.where(known, np.square(self.ridge / norms), 0.0)

    def ratios(self, x: Floats, sizes: Floats) -> tuple[Complexes, float]:
        """Mass ratios of the modes, in the phases in which they answer the push, and of all that moves with an impact.

        See `mode_motion.answer`.
        """
        turns = np.array([turn_of(*mode) for mode in np.exp(x).reshape(-1, 2)])
        turned = np.diff(sizes[len(turns) : 2 * len(turns) - 1], prepend=0.0, append=0.0)
        return sizes[: len(turns)] - 1j * turns.imag * turned, float(np.sum(sizes[: len(turns)] - turns.real * turned))

    def forced(self, x: Floats) -> bool:
        """Whether the mode surely answers the drive, too."""
        columns = self.columns(x)
        forces, fewer = columns[:, 1 : len(self.shaken)], np.delete(columns, np.s_[1 : len(self.shaken)], axis=1)
        before = self.left - fewer @ self.sizes(fewer)
        own = (forces - fewer @ lstsq(fewer, forces)[0]) / np.maximum(np.linalg.norm(forces, axis=0), 1e-300)
        directions, lengths, _ = svd(own, full_matrices=False)
        directions = directions[:, lengths > 3e-5 * lengths[0]]  # `sizes` follows no others either
        shown = directions.T @ before
        after = before - directions @ shown
        # a zero that wanders is fitted, too, and differs more from piece to piece than white noise
        spread, turned = eigh(self._between_pieces((directions * after[:, None]).T))
        return 0.5 * float(np.sum((turned.T @ shown) ** 2 / np.maximum(spread, np.mean(after**2)))) > SURE_NATS

    def _between_pieces(self, scores: Floats) -> Floats:
        """Covariance of the sums of scores (k, n) of the known blocks, by how much they differ from piece to piece."""
        pieces = np.array([np.bincount(self.cluster, row) for row in scores])
        out = pieces @ pieces.T
        for lag in range(1, LAGS + 1):  # Newey and West's
            late = pieces[:, lag:] @ pieces[:, :-lag].T
            out += (1.0 - lag / (LAGS + 1.0)) * (late + late.T)
        return np.asarray(out)

    def _unpushed(self, columns: Floats, modes: int, which: int = 0, instead: Floats | float = 0.0) -> Floats:
        """What is left without the push on one of so many modes, or with something else in its place."""
        other = columns.copy()
        other[:, which] = instead
        return np.asarray(self.left - other @ self._solved(other, modes, np.arange(other.shape[1])))

    def gained(self, x: Floats) -> float:
        """By how much the push raises the likelihood of white noise, nats."""
        before, left = self._unpushed(self.columns(x), len(x) // 2), self.remainder(x)
        return 0.5 * (float(before @ before) / float(left @ left) - 1.0) * len(left)

    def rubbed_nats(self, x: Floats, rubbed_mps2: Floats | float) -> float:
        """By how much the likelihood of white noise would rise if the rod stood elsewhere: on the plate, or not."""
        shaken = self.shaken.copy()
        shaken[0] += (1.0 - 2.0 * self.rubs) * rubbed_mps2
        left, other = self.remainder(x), replace(self, shaken=shaken).remainder(x)
        return 0.5 * (float(left @ left) / float(other @ other) - 1.0) * len(left)

    def left_nats(self, x: Floats) -> float:
        """By how much the likelihood could rise if what is left beyond noise were explained."""
        left = self.remainder(x)
        return 0.5 * (over_noise(left, self.known) - 1.0) * len(left)

    def remainder(self, x: Floats) -> Floats:
        """What the modes leave."""
        columns = self.columns(x)
        return np.asarray(self.left - columns @ self.sizes(columns, len(x) // 2))

    def slopes(self, x: Floats) -> Floats:
        """Slopes of the fitted answer in the logarithms of frequency and damping, (k, len(x))."""
        sizes, h = self.sizes(self.columns(x), len(x) // 2), 1e-4
        ahead, behind = ([self.columns(x + d * e) @ sizes for e in np.eye(len(x))] for d in (h, -h))
        return np.asarray((np.array(ahead) - np.array(behind)).T / (2.0 * h))

    def with_another(self, x: Floats) -> Floats | None:
        """A mode, and the one elsewhere that answers best what it, or small changes of it, leave; None for none."""
        known = np.column_stack([self.columns(x), self.slopes(x)])
        own = np.linalg.qr(known / np.maximum(np.linalg.norm(known, axis=0), 1e-300))[0]
        left = self.left - own @ (own.T @ self.left)
        looked = replace(self, left=left, basis=np.hstack([self.basis, own])).looked
        # nearer than that, two modes are one
        others = [y for gain, y in looked if gain > 0.0 and abs(y[0] - x[0]) > 2.0 * math.log(GRID)]
        return np.append(x, others[0]) if others else None

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
        modes = len(starts[0]) // 2
        low, high = np.tile(np.log([[0.5 * LOWEST_HZ, LEAST_DAMPING], [2.0 * HIGHEST_HZ, MOST_DAMPING]]), modes)
        fits = [
            least_squares(self.remainder, x, bounds=(low, high), x_scale=0.1, xtol=1e-4, ftol=1e-6, max_nfev=25)
            for x in starts
        ]
        # none at a bound where there is another: with the mode out of range free states explain much, but no impact
        inside = [f for f in fits if math.log(LOWEST_HZ) < f.x[0] < math.log(HIGHEST_HZ)]
        return np.asarray(min(inside or fits, key=lambda f: f.cost).x)

    def _rivals(self, x: Floats, which: int, gain: float) -> Floats:
        """How far modes that do nearly as well lie from one of those at ``x``, (3, 3); nothing where none comes near.

        Far above its own frequency a mode answers as a free mass: the likelihood hardly falls over octaves, and what
        the model lacks moves its maximum. As the model is true to 1 % of the answer, 1e-4 of the gain tell nothing.
        Decision 713.
        """
        if gain < SURE_NATS:
            return np.zeros((3, 3))
        tempered, own = 1.0 + 1e-4 * gain, slice(2 * which, 2 * which + 2)
        away = np.stack(np.meshgrid(math.log(GRID) * np.arange(-9, 10), np.log([0.25, 0.5, 1.0, 2.0, 4.0])), axis=-1)
        away, nats = away.reshape(-1, 2), np.empty(away.size // 2)
        for i, step in enumerate(away):
            at = x.copy()
            at[own] = np.minimum(at[own] + step, np.log([HIGHEST_HZ, MOST_DAMPING]))
            nats[i] = 0.5 * math.log(np.sum(self.remainder(at) ** 2)) * len(self.left)
        weight = np.exp((nats.min() - nats) / tempered)
        out = np.zeros((3, 3))
        out[:2, :2] = (weight * away.T) @ away / weight.sum()
        return out

    def worst_cluster(self, x: Floats) -> int | None:
        """The first piece with far more left than the usual one; None where none is."""
        power, count = (np.bincount(self.cluster, v) for v in (self.remainder(x) ** 2, np.ones(len(self.left))))
        rms = np.sqrt(power / np.maximum(count, 1.0))
        bad = np.flatnonzero((count >= FEWEST_IN_CLUSTER) & (rms > TORN * np.median(rms[count > 0])))
        return int(bad[0]) if len(bad) else None

    def all_judged(self, x: Floats, forcing_hz: float) -> PlateMode | None:
        """The first mode at ``x``, with the second one where there are two; None where it is none."""
        mode, second = self.judged(x, forcing_hz), self.judged(x, forcing_hz, 1) if len(x) > 2 else None
        if mode is None or second is None:
            return mode
        before = self.remainder(self.followed([x[:2]]))
        return replace(mode, second=replace(second, before_mps2=float(np.std(before))))

    def judged(self, x: Floats, forcing_hz: float, which: int = 0) -> PlateMode | None:
        """One of the modes at ``x`` with its covariance; None where it is none."""
        modes, columns = len(x) // 2, self.columns(x)
        frequency, damping = (float(v) for v in np.exp(x[2 * which :][:2]))
        sizes = self.sizes(columns, modes)
        ratio, left, before = float(sizes[which]), self.left - columns @ sizes, self._unpushed(columns, modes, which)
        # far below all that shakes it a mode answers as a mass does: what a mass's load explains as well, to the 8 nats
        # that chance gives once in 3,000, shows none
        loaded = self._unpushed(columns, modes, which, self.carried)
        jacobian = np.column_stack([self.slopes(x), columns])
        # columns of one size: frequency, damping and free states differ by many powers of ten
        norms = np.linalg.norm(jacobian, axis=0)
        jacobian, own = jacobian / np.maximum(norms, 1e-300), [2 * which, 2 * which + 1, 2 * modes + which]
        known = np.append(np.zeros(2 * modes), self._ridges(np.maximum(norms[2 * modes :], 1e-100), modes))
        inverse = pinv(jacobian.T @ jacobian + np.diag(known), rcond=1e-10)
        meat = self._between_pieces((jacobian * left[:, None]).T)
        place, size = np.ix_(own, own), np.outer(norms[own], norms[own])
        robust = (inverse @ meat @ inverse)[place] / size
        white = inverse[place] / size * np.mean(left**2)
        to_own = np.array([frequency, damping, 1.0])
        # of a correlated remainder fewer values are independent, by the ratio of both variances
        # a mode differs from the load where it is slow, and so is a zero that wanders
        slow = loaded - left
        of_slow = self._between_pieces((slow * left)[None])[0, 0] / max(float(slow @ slow) * np.mean(left**2), 1e-300)
        alike = robust[2, 2] / white[2, 2], of_slow
        gain, over_load = (
            0.5 * (float(x @ x) / float(left @ left) - 1.0) * len(left) / max(float(k), 1.0)
            for x, k in zip((before, loaded), alike, strict=True)
        )
        at_bound = not 1.02 * LEAST_DAMPING < damping < 0.98 * MOST_DAMPING
        bound = at_bound or (damping > STRONG_DAMPING and frequency > forcing_hz)
        enough = gain >= GAIN_NATS and over_load >= 8.0
        if ratio <= 0.0 or not enough or bound or not LOWEST_HZ < frequency < HIGHEST_HZ:
            return None
        rms, over = [float(np.sqrt(np.mean(v**2))) for v in (left, before)], over_noise(left, self.known)
        blurred = np.square([RESOLVED * damping, RESOLVED, (RESOLVED_RATIO + RESOLVED * damping) * ratio])
        covariance = (robust * over + white + np.diag(blurred) + self._rivals(x, which, gain)) * np.outer(
            to_own, to_own
        )
        found = PlateMode(frequency, damping, ratio, covariance, rms[0], rms[1], gain)
        # what hardly rings, at a frequency that nothing tells, answers as a mass does: flights tell better what it is
        if found.sure and damping > STRONG_DAMPING and found.sigmas()[0] > 0.1 * frequency:
            return None
        series = np.zeros(len(self.known))
        series[self.known] = left
        power, width = np.abs(np.fft.rfft(series)) ** 2, max(round(len(series) * self.block_s), 1)  # of 1 Hz
        left_hz = float(np.argmax(np.convolve(power, np.ones(width), "same")) / (len(series) * self.block_s))
        return replace(found, noise_mps2=rms[0] / math.sqrt(over), left_hz=left_hz)
