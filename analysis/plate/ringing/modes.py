"""Identification of a ringing plate mode from recorded volts: what the ball does to the plate, and the answer to it.

No flight is predicted. Per ball mass, the ball pushes the plate by ``-(g + a)`` while it lies on it, with the measured
acceleration ``a`` of the plate, and by an impulse ``-J`` at each landing; see `ball_push`. The accelerometer shows the
drive times a gain, and a mode's answer ``q''`` of ``q'' + 2 damping w q' + w^2 q = mass_ratio * push``. Gain and mass
ratio are linear and regressed; only frequency and damping are searched. That none is identified is no proof that there
is none (``python -m benchmarks.analysis.ringing``).

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

from analysis.linear_algebra import NotFiniteError, lstsq, pinv, solve
from analysis.plate.ringing.ball_push import Push, ball_push, filled_after_impacts
from analysis.plate.ringing.in_blocks import HUM_HZ, LEAD_S, drive_regressors, over_noise, unmasked, volts_in_blocks
from analysis.plate.ringing.mode_motion import TORN_S, PushedPlate, answer, turn_of
from analysis.signals.high_pass import restored
from daq.recording import Recording
from kernels.arrays import Bools, Floats, Integers

EFFECT = "table_resonance"  # by which a verdict names the mode
RATE_HZ = 1000.0  # of the block means: far above any mode that a ball shakes
LOWEST_HZ, HIGHEST_HZ = 0.7, 200.0
DAMPINGS = (0.01, 0.05, 0.2, 0.6)
GRID = 1.12  # ratio of neighbouring frequencies of the first look
STARTS = 3
MOST_STEPS = 25  # of a search from one start
ROUNDS = 15  # until mode, the accelerometer's zero and what impacts hide agree
AGREED_MPS2 = 5e-4  # change of the impacts' mean push at which they agree with the motion: .00005 of the ball's weight
SETTLED = 3e-4  # relative change of frequency and damping
RINGS_ON = 2.0  # of the mask: what still rings behind it would pull
# what is found at a bound, or so damped above the drive, is no mode
LEAST_DAMPING, MOST_DAMPING, STRONG_DAMPING = 1e-3, 0.9, 0.5
MOST_RESTARTS, TORN = 3, 1.6  # pieces that are left out, each with so many times the usual remainder
FEWEST_BLOCKS, FEWEST_IN_CLUSTER = 1000, 50
RESOLVED, RESOLVED_RATIO = 0.03, 0.002  # of half-width, damping and mass ratio: what blocks blur
LAGS = 2  # pieces whose scores are correlated
FEWEST_IMPACTS = 20
CLUSTER_S = TORN_S  # length of the pieces whose scores are taken as independent
GAIN_NATS, SURE_NATS = 15.0, 200.0  # least gain of a mode that is there, and of one without a near rival
# of the best mode of the first look; of what is left, over noise: below both a search would find none that is sure
QUIET_NATS, QUIET_OVER_NOISE = 0.5 * GAIN_NATS, 1.03
LEFT_BY_TWO = 0.9  # of what one mode leaves of the acceleration, where a second one is said to be missing
MOST_S = 100.0  # of a long recording its end, where the ball is thrown hardest


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


def identified_mode(
    recording: Recording, takeoff_s: Floats, landing_s: Floats, mask_s: float, high_pass_hz: float = 0.0
) -> tuple[PlateMode | None, bool]:
    """The mode that the ball's push shakes, and whether the plate is quiet: whether volts leave room for none.

    The mode is None where none is identified, without a drive, or with too few impacts.

    Parameters
    ----------
    recording
        Open.
    takeoff_s, landing_s
        Of the true flights (n,), in order, on the recording's axis.
    mask_s
        How long the accelerometer shows more than the plate's motion after an impact.
    high_pass_hz
        Corner of the accelerometer's high-pass; 0 for none.
    """
    # without its drive the plate's own motion is not known, and over a gap the mode's state is lost
    if "drive" not in recording.channels or len(recording.gaps):
        return None, False
    width = max(round(recording.rate_hz / RATE_HZ), 1)
    block_s = width / recording.rate_hz
    acceleration, drive = volts_in_blocks(recording, width)
    if high_pass_hz > 0.0:
        acceleration = restored(acceleration, high_pass_hz, 1.0 / block_s)
    landed = landing_s < (len(acceleration) - 1) * block_s
    known = unmasked(len(acceleration), block_s, landing_s, RINGS_ON * mask_s)
    if not landed.all():  # the impulse at the end of the flight before needs this flight
        last = int(np.argmin(landed))
        known[int((landing_s[max(last - 1, 0)] - LEAD_S) / block_s) :] = False
    whole = _Recorded(
        acceleration, *drive_regressors(recording, drive, block_s), known, block_s, takeoff_s[landed],
        landing_s[landed], recording.setup.g_mps2.value,
    )  # fmt: skip
    skipped = max(len(acceleration) - round(MOST_S / block_s), 0)
    record, begun, found = replace(whole.last(skipped), forces=0), [0], None
    for _ in range(MOST_RESTARTS + 1):
        if len(record.landing_s) < FEWEST_IMPACTS or np.count_nonzero(record.known) < FEWEST_BLOCKS:
            return None, False
        try:
            seen, found = record.settled(begun, found)
            if found is None:
                return None, True
            # a plate that goes as it is asked feels no force of the drive: none is looked for where noise is left
            if len(begun) == 1 and seen.left_nats(found) > SURE_NATS:
                driven = replace(record, forces=whole.forces)
                other, x = driven.settled(begun, None)
                if x is not None and other.forced(x):
                    record, seen, found = driven, other, x
        except NotFiniteError:  # a drive that stands still explains no acceleration
            return None, False
        worst = seen.worst_cluster(found)
        if worst is None:
            break
        # a flight that was missed here: what the plate does then is left out, and it rings on from an unknown state
        ends = int((worst + 1) * CLUSTER_S / block_s)
        record = record.without(int(worst * CLUSTER_S / block_s), ends)
        begun.append(min(ends, len(record.known) - 2))
    forcing_hz = recording.setup.forcing.frequency_hz
    mode = None if found is None else seen.judged(found, forcing_hz)
    if mode is None or found is None or not mode.sure:
        return mode, False
    return replace(mode, pushed=whole.pushed(seen, found), second=seen.without(found).second(forcing_hz)), False


@dataclass(frozen=True)
class _Recorded:
    """Acceleration (n,), regressors (n, k), of which so many may be ``forces``, unmasked blocks (n,), and flights."""

    acceleration: Floats
    linear: Floats
    forces: int
    known: Bools
    block_s: float
    takeoff_s: Floats
    landing_s: Floats
    gravity_mps2: float

    def last(self, skipped: int) -> _Recorded:
        """Without the first blocks."""
        inside, shift_s = self.takeoff_s > skipped * self.block_s, skipped * self.block_s
        return _Recorded(
            self.acceleration[skipped:], self.linear[skipped:], self.forces, self.known[skipped:], self.block_s,
            self.takeoff_s[inside] - shift_s, self.landing_s[inside] - shift_s, self.gravity_mps2,
        )  # fmt: skip

    def without(self, first: int, stop: int) -> _Recorded:
        """With some blocks unknown."""
        at = np.arange(len(self.known))
        return replace(self, known=self.known & ((at < first) | (at >= stop)))

    def made(self, sizes: Floats) -> tuple[Floats, Floats]:
        """What the regressors make with their sizes, and what of it is the mains' hum, (n,) each."""
        hum = np.s_[-2 * len(HUM_HZ) :]
        return self.linear @ sizes, self.linear[:, hum] @ sizes[hum]

    def push(self, acceleration: Floats, hum: Floats, before: Push | None, mass_ratio: float) -> Push:
        """What the ball does to a plate whose acceleration has no zero: it goes nowhere, whatever impacts give it.

        Whether the mains' ``hum`` shakes the plate, or only the accelerometer's cable, flights from rest show.
        """
        # both ends fade: the plate is cut off there in full swing, as if it went somewhere
        weight, late_s = np.hanning(len(acceleration)), 0.0 if before is None else before.late_s
        gained = 0.0 if before is None else mass_ratio * before.impacts_mps2
        felt = acceleration - np.average(acceleration + gained, weights=weight)
        rest = (self.block_s, self.takeoff_s, self.landing_s, self.gravity_mps2, mass_ratio, late_s)
        return min((ball_push(x, *rest) for x in (felt, felt - hum)), key=lambda push: push.missed_mps)

    def settled(self, begun: Sequence[int], found: Floats | None) -> tuple[_Regression, Floats | None]:
        """The regression, and logarithms of frequency and damping, when what impacts hide agrees with the mode found.

        Where impacts hide the acceleration, the ball feels what the model says. The plate goes nowhere, so what it
        gains by impacts, which the acceleration between them lacks, is its mean. On a quiet plate no mode is searched.
        """
        known, ratio, push, fresh = self.known, 0.0, None, found is None
        # the drive's part is the same for every mode tried: an orthonormal basis takes it out of any column
        basis, upper = np.linalg.qr(self.linear[known])

        def drive_part(seen: Floats) -> tuple[Floats, Floats]:
            return self.made(solve(upper, basis.T @ seen[known]))

        driven, hum = drive_part(self.acceleration)
        acceleration = driven + filled_after_impacts(self.acceleration - driven, known)
        for rounds in range(ROUNDS):
            push = self.push(acceleration, hum, push, ratio)
            impulses = push.impacts_mps2
            shaken = np.vstack([push.contact_mps2 + impulses, self.linear[:, : self.forces].T])
            seen = _Regression.of(acceleration, basis, shaken, known, self.block_s, begun)
            if fresh and rounds == 0 and seen.quiet:
                return seen, None
            again = fresh and rounds == 1  # the first search did not know what is hidden
            x = seen.searched() if found is None or again else seen.followed([found])
            sizes = seen.sizes(seen.columns(*np.exp(x)))
            mode = seen.answers(*np.exp(x)) @ sizes
            driven, hum = drive_part(acceleration - mode)
            acceleration = np.where(known, acceleration, driven + mode - sizes[0] * impulses)
            settled = not again and found is not None and bool(np.max(np.abs(x - found)) < SETTLED)
            found, ratio = x, float(sizes[0])
            if settled:
                break
        return seen, x

    def pushed(self, seen: _Regression, x: Floats) -> PushedPlate:
        """What the ball did to the plate of the whole recording, of which ``seen`` is the end."""
        skipped, sizes = len(self.known) - len(seen.known), seen.sizes(seen.columns(*np.exp(x)))
        mode = seen.answers(*np.exp(x)) @ sizes
        left = (self.acceleration[skipped:] - mode)[seen.known]
        driven, hum = self.made(np.asarray(lstsq(self.linear[skipped:][seen.known], left)[0], dtype=np.float64))
        last = len(seen.shaken)
        driven += sizes[1:last] @ answer(self.linear[:, : last - 1].T, self.block_s, *np.exp(x))
        acceleration = driven + filled_after_impacts(self.acceleration - driven, self.known)
        known, before = (*(float(v) for v in np.exp(x)), float(sizes[0])), None
        torn_s = tuple((skipped + at) * self.block_s - CLUSTER_S for at in seen.begun[1:])
        last_s, longest_s = float(self.landing_s[-1]), float(np.max(self.landing_s - self.takeoff_s))
        until_s = last_s if len(self.known) * self.block_s < last_s + longest_s else math.inf
        rest = (self.acceleration - driven, self.known, float(np.std(seen.remainder(x))), until_s, torn_s)
        for _ in range(ROUNDS):  # impacts are sharper from the motion as modelled: it has no noise
            plate = PushedPlate(self.push(acceleration, hum, before, known[2]), *rest)
            acceleration = driven + plate.moved(*known).gained_mps / self.block_s
            # what the ball's weight lacks in the mean would lift the plate, and every flight with it
            if before and abs(float(np.mean(plate.push.impacts_mps2 - before.impacts_mps2))) < AGREED_MPS2:
                break
            before = plate.push
        return plate


@dataclass(frozen=True)
class _Regression:
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
    ) -> _Regression:  # fmt: skip
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

    def without(self, x: Floats) -> _Regression:
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
        return self.followed([x for _, x in self.looked[:STARTS]])

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
        at = np.log([[(LOWEST_HZ * GRID**k, d) for d in DAMPINGS] for k in range(count)])
        gain = np.array([[self._gain_of_push(*np.exp(x)) for x in row] for row in at])
        best = np.pad(gain.max(axis=1), 1)
        # local maxima: the best of the whole look would be neighbours of one
        inner = [k for k in range(count) if best[k + 1] >= max(best[k], best[k + 2])]
        found = [(float(best[k + 1]), np.asarray(at[k, np.argmax(gain[k])])) for k in inner]
        return sorted(found, key=lambda pair: -pair[0])

    def _gain_of_push(self, frequency_hz: float, damping: float) -> float:
        """By how much the answer to the push lowers the sum of squares."""
        x = answer(self.shaken[0], self.block_s, frequency_hz, damping)[self.known]
        own = self.basis.T @ x
        # a push that had to act backwards explains nothing
        return max(float(x @ self.left), 0.0) ** 2 / float(x @ x - own @ own)

    def followed(self, starts: list[Floats]) -> Floats:
        """The best minimum from some starts."""
        low, high = np.log([[0.5 * LOWEST_HZ, LEAST_DAMPING], [2.0 * HIGHEST_HZ, MOST_DAMPING]])
        fits = [
            least_squares(self.remainder, x, bounds=(low, high), x_scale=0.1, xtol=1e-4, ftol=1e-6, max_nfev=MOST_STEPS)
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
        before = self.left - columns[:, 1:] @ lstsq(columns[:, 1:], self.left)[0]
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
