"""Contribution of a ringing plate mode to measured tones, offset, windows and mass loading, for the same masked fits.

A mode rings at its own frequency and with the load of the ball. The part of it that a masked fit attributes to tones,
offset, modulation or mass loading follows from the normal equations over the unmasked intervals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Self

import numpy as np
from scipy.special import spherical_jn

from analysis.plate.ringing.mode_motion import ModeMotion
from analysis.plate.step_state import FitIntervals, in_both_senses, signed_frequencies, solved
from analysis.residuals.plate_data.modulation import AmplitudeModulation
from analysis.residuals.plate_data.plate_observables import (
    GAIN,
    GATE,
    HUM,
    MODULATION,
    OFFSET,
    PHASE,
    SECOND,
    THIRD,
    PlateData,
)
from kernels import njit
from kernels.arrays import Bools, Complexes, Floats, Integers
from model.integrator.one_step import Predicted
from model.integrator.problem import PlateSteps

LEAST = 1e-6  # least driven part of a tone
SMALL = 1e-3  # relative change for which a load's contribution is taken as linear
# relative uncertainty of the contribution: the impact template absorbs a part; more of it where flights tell the motion
INEXACT, INEXACT_AS_MEASURED = 0.03, 0.01


def driven(z: Complexes, mode_amplitudes: Complexes) -> Complexes:
    """Driven part of the tones (measured minus mode); floored at 1e-6 of the tone so that log ratios stay finite."""
    left = z - mode_amplitudes
    return np.where(np.abs(left) > LEAST * np.abs(z), left, LEAST * z)


@dataclass(frozen=True)
class Loading:
    """Contribution to tones and data of a plate that moves more without the ball on it, per unit of relative change."""

    tones_mps2: Complexes  # to the plate's tones, beyond those of contact, (m, j)
    data: Floats  # to the plate data, except the flight-to-contact ratio itself, (r,)
    power: Floats  # power of the change with which a datum grows, (r,)

    def added(self, change: Floats) -> Floats:
        """Contribution of ``change`` (r,) in each datum's step, (r,)."""
        return np.asarray(self.data * np.abs(change) ** self.power * np.sign(change))


@dataclass(frozen=True)
class IntervalSums:
    """Sums over the intervals of each of n fits."""

    rows: Integers  # the intervals, in the order of their fits
    some: Bools  # whether a fit has any, (n,)
    first: Integers  # where each of those that have some begins in ``rows``
    seconds: Floats  # their length together, (n,)

    @classmethod
    def of(cls, rows: Integers, fit: Integers, n: int, seconds: Floats) -> Self:
        """Of intervals ``rows`` in the order of their ``fit``; ``seconds`` are those of all intervals."""
        first = np.searchsorted(fit, np.arange(n))
        some = np.diff(np.append(first, len(fit))) > 0
        lengths = np.asarray(np.bincount(fit, seconds[rows], minlength=n), dtype=np.float64)
        return cls(rows, some, first[some], lengths)

    def total(self, x: Complexes | Floats) -> Complexes | Floats:
        """Sum of ``x`` (intervals, ...) in each fit, (n, ...)."""
        out = np.zeros((len(self.some), *x.shape[1:]), dtype=x.dtype)
        if len(self.first):
            out[self.some] = np.add.reduceat(x[self.rows], self.first, axis=0)
        return out

    def sides(self, projection: Complexes, observed_s: Floats) -> tuple[Complexes, Floats]:
        """Right sides of the fits, (n, 1 + 2 k), from projections (intervals, 1 + k); the part of the time known.

        Where the mode was not followed for all of the time, its mean over the rest is taken to be the same.
        """
        part = np.divide(self.total(observed_s), self.seconds, out=np.zeros(len(self.some)), where=self.seconds > 0.0)
        sums = self.total(projection) / np.where(part > 0.0, part, 1.0)[:, None]
        return np.concatenate([sums, np.conj(sums[:, 1:])], axis=1), part


@dataclass(frozen=True)
class BlockIntegrals:
    """Integrals of an acceleration times ``exp(-i omega t)`` over intervals (r, 2), from its integrals over blocks.

    In each block it is linear. A block that an interval begins or ends in may hold an impact, or a bounce that is too
    short to be seen: there it goes on as in the interval's next block.
    """

    begin: int  # the first block of all
    place: Floats  # begin and end of each interval from there, in blocks, (2, r)
    level: Complexes  # integral of the exponential over each block, over the block's length, (n, k)
    tilt: Complexes  # of the exponential times the distance from the block's middle, (n, k)

    @classmethod
    def of(cls, span_s: Floats, block_s: float, omega_radps: Floats, n: int) -> Self:
        """For intervals ``span_s`` (r, 2), tones (k,), and so many blocks in all."""
        place = np.clip(span_s.T / block_s, 0.0, n)
        begin, end = int(place.min()), min(int(place.max()) + 1, n)
        middle_s, half = (np.arange(begin, end)[:, None] + 0.5) * block_s, 0.5 * omega_radps * block_s
        turning = np.exp(-1j * omega_radps * middle_s)
        return cls(begin, place - begin, np.sinc(half / np.pi) * turning, -0.5j * spherical_jn(1, half) * turning)

    def of_motion(self, motion: ModeMotion) -> Complexes:
        """Of a mode's acceleration, (r, k)."""
        rows = slice(self.begin, self.begin + len(self.level))
        return _integrals(motion.gained_mps[rows], motion.rises_mps[rows], self.place, self.level, self.tilt)


@njit(error_model="numpy", nogil=True)
def _integrals(own: Floats, rise: Floats, place: Floats, level: Complexes, tilt: Complexes) -> Complexes:
    """Integrals over intervals, (r, k), of what blocks hold and how it rises in each: see `BlockIntegrals`."""
    out = np.zeros((place.shape[1], level.shape[1]), dtype=np.complex128)
    for r in range(place.shape[1]):
        start, stop = place[0, r], place[1, r]
        first, last = int(np.ceil(start)), int(np.floor(stop))
        sign = 1.0 if last > first else -1.0  # both parts of an only block are more than it
        for i in range(min(first, last), max(first, last)):
            for k in range(level.shape[1]):
                out[r, k] += sign * (own[i] * level[i, k] + rise[i] * tilt[i, k])
        for inside, edge, part, side in ((first, first - 1, first - start, -0.5), (last - 1, last, stop - last, 0.5)):
            edge = min(max(edge, 0), len(own) - 1)
            at, farther = (inside, side * (1.0 + part)) if last > first else (edge, 0.0)
            for k in range(level.shape[1]):
                out[r, k] += part * (own[at] + farther * rise[at]) * level[edge, k]
    return out


@dataclass(frozen=True)
class Ringing:
    """Projection of a plate mode on the fitted tones; a `model.integrator.problem.ToneProbe`."""

    intervals: FitIntervals  # unmasked intervals of the fits
    # zero and every fitted tone, the forcing's (or its only one and the second harmonic) first, (m, 1 + k)
    omega_radps: Floats
    seen_mps2: Complexes  # the tones as fitted, (m, k); 0 where none was
    tones: Integers  # number of tones of the forcing, (m,)
    place: Integers  # index of the fitted tone that is each tone of the plate, (m, j)
    integrals: dict[int, BlockIntegrals] = field(default_factory=dict, repr=False, compare=False)  # by step, as asked

    @classmethod
    def of(cls, measured: AmplitudeModulation, plate: PlateSteps) -> Self:
        """From the fits of the steps and the plate made of them."""
        distance = np.abs(plate.omega_radps[:, :, None] - measured.omega_radps[:, None, :])
        omega = np.column_stack([np.zeros(len(measured.omega_radps)), measured.omega_radps])
        return cls(measured.intervals, omega, measured.seen_mps2, measured.tones, np.argmin(distance, axis=2))

    # -- the probe of the integrator -----------------------------------------------------------------------------------
    @cached_property
    def first(self) -> Integers:
        """First interval of each step, and the end of the last, (m + 1,)."""
        return np.searchsorted(self.intervals.step, np.arange(len(self.omega_radps) + 1))

    @property
    def span_s(self) -> Floats:
        """The intervals, (r, 2)."""
        return self.intervals.span_s

    def of_tones(self, projection: Complexes, observed_s: Floats) -> Complexes:
        """Contribution of the mode to the fitted tones of the plate, (m, j), m/s^2."""
        contact, rest = self._of_places(projection, observed_s)
        found = self._solved(contact + rest)[:, 1 : self.omega_radps.shape[1]]
        return np.take_along_axis(2.0 * found, self.place, 1)

    def of_motions(self, motions: Sequence[ModeMotion], recording: Integers) -> Complexes:
        """Projection (r, 1 + k) of a mode's motion in each recording, of steps ``recording`` (m,)."""
        out = np.zeros((len(self.span_s), self.omega_radps.shape[1]), dtype=np.complex128)
        for i in np.flatnonzero(np.diff(self.first)):
            rows, motion = slice(self.first[i], self.first[i + 1]), motions[recording[i]]
            block_s, n = motion.push.block_s, len(motion.gained_mps)
            if i not in self.integrals:
                self.integrals[int(i)] = BlockIntegrals.of(self.span_s[rows], block_s, self.omega_radps[i], n)
            out[rows] = self.integrals[int(i)].of_motion(motion)
        return out

    # -- plate data ---------------------------------------------------------------------------------
    def added(
        self, data: PlateData, plate: PlateSteps, p: Predicted, inexact: float = INEXACT
    ) -> tuple[Floats, Floats]:
        """Contribution of a prediction's mode to each datum and its standard deviation, (r,) each."""
        if not np.any(p.mode_amplitudes):
            return np.zeros(len(data)), np.zeros(len(data))
        return self._added(data, plate, (p.mode_amplitudes, p.projection, p.observed_s), inexact)

    def _added(
        self,
        data: PlateData,
        plate: PlateSteps,
        mode: tuple[Complexes, Complexes, Floats],
        inexact: float,
        *,
        interferes: bool = True,
    ) -> tuple[Floats, Floats]:
        """Contribution of a motion with its amplitudes in the plate's tones, projections and seconds followed."""
        out, (mode_amplitudes, projection, observed_s) = np.zeros(len(data)), mode
        contact_side, rest_side = self._of_places(projection, observed_s)
        found, step = self._solved(contact_side + rest_side), data.step
        out += np.where(data.kind == OFFSET, found[step, 0].real, 0.0)
        k = np.argmin(np.abs(self.omega_radps[step] - data.omega_radps[:, None]), axis=1)
        power, inexact_power = self._powers(2.0 * found[step, k], (step, k) if interferes else None, inexact)
        powers = np.where(data.kind == HUM, 1.0, np.where(np.isin(data.kind, (SECOND, THIRD)), data.scale**-2.0, 0.0))
        out += powers * power
        sigma = np.where(data.kind == OFFSET, inexact * np.abs(out), powers * inexact_power)
        rows = np.flatnonzero((data.kind == GAIN) | (data.kind == PHASE))
        j = np.argmin(np.abs(plate.omega_radps[step[rows]] - data.omega_radps[rows, None]), axis=1)
        z = plate.acceleration_mps2[step[rows], j]
        ratio = z / driven(z, mode_amplitudes[step[rows], j])
        out[rows] = np.where(data.kind[rows] == GAIN, np.log(np.abs(ratio)), np.angle(ratio))
        sigma[rows] = inexact * np.abs(ratio - 1.0)
        rows = np.flatnonzero(data.kind == GATE)
        sides = np.concatenate([contact_side + rest_side, contact_side * self._own], axis=1)
        contact, flight = (np.sum(row * sides, axis=1) for row in self._first_tone)
        z = driven(plate.acceleration_mps2[step[rows], 0], mode_amplitudes[step[rows], 0])
        there, here = (np.abs(z + x[step[rows]]) for x in (flight, contact))
        out[rows] = np.log(np.maximum(there, LEAST * np.abs(z)) / np.maximum(here, LEAST * np.abs(z)))
        sigma[rows] = inexact * np.abs((flight - contact)[step[rows]] / z)
        rows = np.flatnonzero(data.kind == MODULATION)
        out[rows], sigma[rows] = self._in_windows(found, projection, observed_s, inexact)
        return out, sigma

    def _powers(self, mode: Complexes, at: tuple[Integers, Integers] | None, inexact: float) -> tuple[Floats, Floats]:
        """By how much the mode raises the power of tones ``at`` step and place, and the standard deviation, (r,) each.

        It interferes with what else such a tone is made of: with what is left of the tone as fitted, without it.
        """
        seen = np.zeros(len(mode)) if at is None else np.column_stack([0.0 * self.seen_mps2[:, 0], self.seen_mps2])[at]
        left = np.where(seen == 0.0, 0.0, seen - mode)
        power = np.where(seen == 0.0, np.abs(mode) ** 2, np.abs(seen) ** 2 - np.abs(left) ** 2)
        return power, 2.0 * inexact * np.abs(mode) * np.maximum(np.abs(left), np.abs(mode))

    # -- a plate that the ball loads --------------------------------------------------------------------------------
    def loading(self, data: PlateData, plate: PlateSteps, gravity_mps2: float) -> Loading:
        """Contribution of a plate that accelerates by ``c (a_p + g)`` more in flight, a_p being that of contact.

        This is a plate driven by a force, whose mass is smaller by c without the ball. Flight times are unchanged: all
        of the relative motion is 1 + c times as large.
        """
        projection, observed_s = SMALL * self._lifted(gravity_mps2), self.intervals.seconds
        tones = self.of_tones(projection, observed_s) * (plate.acceleration_mps2 != 0.0)
        added, _ = self._added(data, plate, (tones, projection, observed_s), INEXACT, interferes=False)
        power = np.where(np.isin(data.kind, (SECOND, THIRD, HUM)), 2.0, 1.0)
        return Loading(tones / SMALL, np.where(data.kind == GATE, 0.0, added / SMALL**power), power)

    def _lifted(self, gravity_mps2: float) -> Complexes:
        """Projection of ``a_p + g`` in flight and of zero in contact, (r, 1 + k): the ball's load taken away."""
        step, w = self.intervals.step, self.omega_radps[self.intervals.step]
        length, middle = self.intervals.seconds[:, None], self.intervals.span_s.mean(axis=1)[:, None]

        def turned(rate: Floats) -> Complexes:
            return np.asarray(length * np.sinc(rate * length / (2.0 * np.pi)) * np.exp(1j * rate * middle))

        out = gravity_mps2 * turned(-w)
        for j in range(int(self.tones.max(initial=0))):
            z = np.where(self.tones > j, self.seen_mps2[:, j], 0.0)[step, None]
            own = w[:, j + 1, None]
            out += 0.5 * (z * turned(own - w) + np.conj(z) * turned(-own - w))
        return np.where(self.intervals.contact[:, None], 0.0, out)

    @cached_property
    def _turns(self) -> Floats:
        """The constant and both senses of every tone, (m, 1 + 2 k)."""
        return signed_frequencies(self.omega_radps[:, 1:])

    @cached_property
    def _own(self) -> Bools:
        """Turns that are the constant or the forcing's, (m, 1 + 2 k)."""
        return in_both_senses(np.arange(self.seen_mps2.shape[1]) < self.tones[:, None])

    @cached_property
    def _gram(self) -> Complexes:
        """Normal equations of the steps' fits, (m, 1 + 2 k, 1 + 2 k)."""
        return self.intervals.gram(self._turns, in_both_senses(self.seen_mps2 != 0.0))

    @cached_property
    def _inverse(self) -> Complexes:
        return solved(self._gram, np.broadcast_to(np.eye(self._gram.shape[1], dtype=np.complex128), self._gram.shape))

    @cached_property
    def _places(self) -> tuple[IntervalSums, IntervalSums]:
        """Sums over each step's intervals in contact, and over the rest."""
        both = (np.flatnonzero(self.intervals.contact == place) for place in (True, False))
        step, m = self.intervals.step, len(self._turns)
        contact, rest = (IntervalSums.of(rows, step[rows], m, self.intervals.seconds) for rows in both)
        return contact, rest

    def _of_places(self, projection: Complexes, observed_s: Floats) -> tuple[Complexes, Complexes]:
        """Right sides of the steps' fits from intervals in contact and from the rest, (m, 1 + 2 k) each."""
        contact, rest = (place.sides(projection, observed_s)[0] for place in self._places)
        return contact, rest

    def _solved(self, sides: Complexes) -> Complexes:
        """Amplitudes of all turns in the steps' fits, (m, 1 + 2 k), from their right sides."""
        return np.asarray((self._inverse @ sides[..., None])[..., 0])

    # -- contact and flight -----------------------------------------------------------------------------------------
    @cached_property
    def _gates(self) -> Complexes:
        """Normal equations of the joint fits of contact and flight, (m, 2 p, 2 p)."""
        extra = self.intervals.in_contact.overlaps(self._turns, self._turns)
        fitted = np.diagonal(self._gram, axis1=1, axis2=2) != 0.0
        coupling = extra * (fitted[:, :, None] & self._own[:, None, :])
        own = extra * (self._own[:, :, None] & self._own[:, None, :])
        return np.block([[self._gram, coupling], [np.conj(coupling.transpose(0, 2, 1)), own]])

    @cached_property
    def _first_tone(self) -> tuple[Complexes, Complexes]:
        """Rows of the inverse of `_gates` that give the first tone in contact and in flight, (m, 2 p) each."""
        every = solved(self._gates, np.broadcast_to(np.eye(self._gates.shape[1]), self._gates.shape).astype(complex))
        return 2.0 * (every[:, 1] + every[:, self._turns.shape[1] + 1]), 2.0 * every[:, 1]

    # -- windows ----------------------------------------------------------------------------------------------------
    @cached_property
    def _windows(self) -> tuple[IntervalSums, Integers, Complexes, Complexes]:
        """Sums over each window; the windows' steps; inverse normal matrices, and these times the Gram matrix."""
        rows = np.flatnonzero(self.intervals.window >= 0)
        of = self.intervals.window[rows]
        step = self.intervals.step[rows[np.searchsorted(of, np.arange(int(of.max(initial=-1)) + 1))]]
        every = self._turns[step]
        own = self._own[step]
        windows = self.intervals.in_windows
        gram = windows.overlaps(every, every)
        one = np.eye(every.shape[1], dtype=np.complex128) * own[:, :, None]
        inverse = solved(gram * (own[:, :, None] & own[:, None, :]), one)
        return IntervalSums.of(rows, of, len(step), self.intervals.seconds), step, inverse, inverse @ gram

    def _in_windows(
        self, found: Complexes, projection: Complexes, observed_s: Floats, inexact: float
    ) -> tuple[Floats, Floats]:
        """Relative deviation of the forcing's amplitude in each window and its standard deviation, (w,) each."""
        sums, step, inverse, of_steps = self._windows
        sides, part = sums.sides(projection, observed_s)
        left = (inverse @ sides[..., None] - of_steps @ found[step, :, None])[..., 0]
        own = np.where(self._own[step, 1 : self.omega_radps.shape[1]], self.seen_mps2[step], 0.0)
        power = np.sum(np.abs(own) ** 2, axis=1)
        change = 2.0 * np.sum((np.conj(own) * left[:, 1 : self.omega_radps.shape[1]]).real, axis=1)
        # windows in whose whole time the mode is followed
        value, known = change / np.where(power > 0.0, power, 1.0), part > 0.99
        usual = float(np.sqrt(np.mean(value[known] ** 2))) if known.any() else 0.0
        return np.where(known, value, 0.0), np.where(known, inexact * np.abs(value), usual)
