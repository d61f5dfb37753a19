"""How a mode of the plate moved in a recording: the exact answer to what the ball did to it.

The state is the complex amplitude ``z = q' - conj(turn) q`` with ``turn = -damping w + i w sqrt(1 - damping^2)``, so
that ``z' = turn z + push``: both pushes, the constant one of a block and the impulse of an impact, act in closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.signal import lfilter

from analysis.linear_algebra import solveh_banded
from analysis.plate.motion import StepPlate
from analysis.plate.ringing.ball_push import Push
from kernels import njit
from kernels.arrays import Bools, Complexes, Floats

KICK_MPS, KICK_PART = 2.5e-4, 1e-3  # uncertainty of an impact's kick, for a ball of the mode's mass
TORN_S = 0.5  # length of such a piece
LEFT = 0.005  # of the mode's power, which may be noise: where impacts are masked it is another one


def turn_of(frequency_hz: float, damping: float) -> complex:
    """Rate of a mode's complex amplitude, 1/s."""
    w = 2.0 * math.pi * frequency_hz
    return complex(-damping * w, w * math.sqrt(1.0 - damping**2))


def answer(push_mps2: Floats, block_s: float, frequency_hz: float, damping: float, *, turned: bool = False) -> Floats:
    """Mean acceleration in each block, (..., n), of a mode of mass ratio 1 under pushes that are constant in each.

    The transition from block to block is exact. The mode begins at rest under the first push. ``turned``, an impulse
    moves it by 1 at once, which makes sense in the difference of two modes: where the damping is not that of the
    masses and springs, modes answer in phases of their own.
    """
    turn = turn_of(frequency_hz, damping)
    pole = np.exp(turn * block_s)
    # velocity q' = sum over both poles; a step of the push makes q' = Im exp(turn t) / Im turn
    step = np.exp(turn * block_s * np.array([0.0, 1.0])).imag / turn.imag
    changes = np.diff(push_mps2, prepend=push_mps2[..., :1])
    begun = [1.0, -pole.real] if turned else [0.0, step[1]]
    speed = lfilter(begun, [1.0, -2.0 * pole.real, abs(pole) ** 2], changes)  # at the end of a block: step
    last = 2.0 * pole.real * speed[..., -1] - abs(pole) ** 2 * speed[..., -2]
    following = np.concatenate([speed[..., 1:], last[..., None]], axis=-1)
    return np.asarray((following - speed) / block_s)


def ringing_after_changes(
    forces_mps2: Complexes, forces_hz: Floats, block_s: float, frequency_hz: float, damping: float
) -> Complexes:
    """Amplitude at the blocks' edges of a mode under forces, less that under their tones as they are, (1 + n,).

    Where the tones' levels change, the mode lags behind; it then rings on with nothing but its own damping. The forces
    are analytic signals (l, 1 + n), of so many Hz each.
    """
    turn = turn_of(frequency_hz, damping)
    step, turning = np.exp(turn * block_s), np.exp(2j * np.pi * forces_hz * block_s)[:, None]
    steady = 0.5 * np.sum(forces_mps2 / (turning - step) + np.conj(forces_mps2) / (np.conj(turning) - step), axis=0)
    force = forces_mps2.real.sum(axis=0)[:-1]
    # it begins at rest under the force, as in `answer`
    lagging = lfilter([1.0], [1.0, -step], np.append(force[0] / (1.0 - step), force)) - steady
    return np.asarray(np.expm1(turn * block_s) / turn * lagging)


@dataclass(frozen=True)
class PushedPlate:
    """What the ball did to the plate of one recording, and how the plate answered."""

    push: Push  # for a ball of the mode's own mass, from the first sample on
    answer_mps2: Floats  # acceleration in each block less what the drive makes of it, (n,)
    known: Bools  # where no impact hides it, (n,)
    noise_mps2: float  # standard deviation of the answer without the mode
    until_s: float = math.inf  # then the ball left as it landed, and flew on to after the end of the recording
    torn_s: tuple[float, ...] = ()  # begins of pieces of `TORN_S` in which flights were missed: kicks are unknown there
    phase: complex = 1.0  # of the mode's mass ratio: see `answer`
    others: tuple[tuple[float, float, complex], ...] = ()  # further modes: frequency, damping, mass ratio
    after_changes: tuple[Complexes, ...] = ()  # of each mode, `ringing_after_changes` of the drive, (1 + n,)

    def moved(self, frequency_hz: float, damping: float, mass_ratio: float) -> ModeMotion:
        """The motion of a mode under this push, its kicks corrected by the acceleration; and further modes."""
        push, motions = self.push, list[ModeMotion]()
        time_s, kicks = np.append(0.0, push.impact_s), np.append(0.0, push.impulse_mps).astype(np.complex128)
        for hz, own_damping, ratio in ((frequency_hz, damping, mass_ratio * self.phase), *self.others):
            turn = turn_of(hz, own_damping)
            rest = -np.conj(turn) * push.contact_mps2[0] / abs(turn) ** 2  # at rest under the first push
            steps = np.append(rest, np.expm1(turn * push.block_s) / turn * push.contact_mps2)
            pressed = np.asarray(lfilter([1.0], [1.0, -np.exp(turn * push.block_s)], steps))
            motions.append(ModeMotion(turn, push, complex(ratio), pressed, time_s, kicks))
        for i, ringing in enumerate(self.after_changes):
            motions[i] = replace(motions[i], pressed=motions[i].pressed + ringing / motions[i].mass_ratio)
        for i, motion in enumerate(motions if self.known.any() else ()):
            others = sum((m.gained_mps for m in motions if m is not motion), np.zeros(len(self.known)))
            motions[i] = replace(motion, kicks=motion.kicks + self._correction(motion, others / push.block_s))
        return replace(motions[0], others=tuple(motions[1:]))

    def error(self, frequency_hz: float, damping: float, mass_ratio: float) -> tuple[float, float]:
        """Standard deviation of a mode's speed as `moved`, and of its displacement times the angular frequency, m/s.

        And the rate, 1/s, at which that error is forgotten. The amplitude's error is a damped random walk, by kicks
        that are not known exactly, which the acceleration shows in white noise: what a smoother leaves of it (Kailath,
        Sayed, Hassibi, Linear Estimation, 2000, ch. 16).
        """
        turn, lasts_s = turn_of(frequency_hz, damping), len(self.known) * self.push.block_s
        # a kick is a change of speed: half of its variance goes to each quadrature, and so does what a block shows
        walk = 0.5 * np.sum(KICK_MPS**2 + (KICK_PART * self.push.impulse_mps) ** 2) / lasts_s
        shown = 0.5 * (abs(turn) * mass_ratio / self.noise_mps2) ** 2 * np.count_nonzero(self.known) / lasts_s
        # no error is older than the recording
        rate = math.sqrt(max(turn.real**2, lasts_s**-2) + walk * shown)
        return mass_ratio * math.sqrt(walk / (2.0 * rate)), rate

    def _correction(self, motion: ModeMotion, others_mps2: Floats) -> Complexes:
        """By how much kicks differ from those of a motion beside others: a smoother of the mode's state, (1 + k,).

        From kick to kick the amplitude turns freely; the two real unknowns of each meet those of the next, so that the
        normal equations are banded.
        """
        turn, time_s, m = motion.turn, motion.time_s, len(motion.time_s)
        read = (self.answer_mps2 - others_mps2 - motion.gained_mps / self.push.block_s) / self.noise_mps2
        sums = _shown(self.known, read, time_s, turn, self.push.block_s, motion.mass_ratio / self.noise_mps2)
        total, side = sums[:, :3].T, sums[:, 3:]
        sure = 1.0 / (KICK_MPS**2 + (KICK_PART * np.abs(motion.kicks)) ** 2)
        for begin_s in (-TORN_S, *self.torn_s):
            # where flights were missed, or before the first sample, the plate may have got any kick
            sure[(time_s >= begin_s) & (time_s <= begin_s + TORN_S)] = 1.0  # m/s
        step = np.exp(turn * np.diff(time_s))
        own = sure + np.append(np.abs(step) ** 2 * sure[1:], 0.0)
        bands = np.zeros((4, 2 * m))
        bands[0, 0::2], bands[0, 1::2] = total[0] + own, total[1] + own
        bands[1, 0::2] = total[2]
        bands[1, 1:-1:2], bands[2, 0:-2:2] = step.imag * sure[1:], -step.real * sure[1:]
        bands[2, 1:-1:2], bands[3, 0:-2:2] = -step.real * sure[1:], -step.imag * sure[1:]
        off = solveh_banded(bands, side.ravel(), lower=True).reshape(m, 2) @ np.array([1.0, 1j])
        return np.asarray(off - np.append(0.0, step * off[:-1]))


@dataclass(frozen=True)
class ModeMotion:
    """Motion of a mode, and of others that add to it."""

    turn: complex  # rate of its complex amplitude
    push: Push  # what acts on it
    mass_ratio: complex  # the ball's mass over the mode's
    pressed: Complexes  # amplitude by the push of contacts at the edges of the blocks, (n + 1,)
    time_s: Floats  # the first sample and every impact, (1 + k,)
    kicks: Complexes  # by how much each changes the amplitude, (1 + k,)
    others: tuple[ModeMotion, ...] = ()

    @cached_property
    def struck(self) -> Complexes:
        """The amplitude by all kicks so far, just after each, (1 + k,)."""
        out, decay = self.kicks.copy(), np.exp(self.turn * np.diff(self.time_s))
        # a recurrence, not a sum of exponentials over all kicks: those would overflow in a long recording
        for i in range(1, len(out)):
            out[i] += decay[i - 1] * out[i - 1]
        return out

    def state(self, time_s: Floats, *, landings: bool = False) -> Floats:
        """Displacement and speed (m, 2) at times of the flights (m,), just after an impact at one of them.

        At ``landings`` the contact that their blocks show a part of has only begun.
        """
        time_s = time_s + self.push.late_s
        block_s, n = self.push.block_s, len(self.push.contact_mps2)
        block = np.clip(np.floor(time_s / block_s).astype(np.int64), 0, n - 1)
        since = self.turn * (time_s - block * block_s)
        pressed = self.pressed[block] * np.exp(since)
        if not landings:
            pressed = pressed + self.push.contact_mps2[block] * np.expm1(since) / self.turn
        z = self.mass_ratio * (pressed + self._struck(time_s))
        own = np.column_stack([z.imag / self.turn.imag, self._speed(z)])
        return sum((other.state(time_s - self.push.late_s, landings=landings) for other in self.others), own)

    def _struck(self, time_s: Floats) -> Complexes:
        """Amplitude by impacts so far, (m,)."""
        last = np.searchsorted(self.time_s, time_s, side="right") - 1
        found = self.struck[last] * np.exp(self.turn * (time_s - self.time_s[last]))
        return np.asarray(np.where(last >= 0, found, 0.0))

    def _speed(self, z: Complexes | complex) -> Floats:
        return np.asarray(z.real + self.turn.real / self.turn.imag * z.imag)

    @cached_property
    def gained_mps(self) -> Floats:
        """What the speed gains in each block but for the jumps of impacts, (n,): the integral of the acceleration."""
        acting = self.mass_ratio * self.pressed, self.time_s, self.mass_ratio * self.kicks
        own = _gained(*acting, self.turn, self.push.block_s)
        return sum((other.gained_mps for other in self.others), own)

    @cached_property
    def rises_mps(self) -> Floats:
        """By how much that gain changes over the length of each block, (n,)."""
        ratio = sum(float(m._speed(m.mass_ratio)) for m in (self, *self.others))
        pressed = self.push.block_s * ratio * self.push.contact_mps2
        return np.gradient(self.gained_mps - pressed) + self.push.block_s * ratio * self.push.rise_mps2


@njit(error_model="numpy", nogil=True)
def _gained(pressed: Complexes, time_s: Floats, kicks: Complexes, turn: complex, block_s: float) -> Floats:
    """What the speed of a mode gains in each block but for the jumps of kicks, (n,).

    ``pressed`` are amplitudes by contacts at the edges of the blocks, (n + 1,).
    """
    out, step, slope = np.empty(len(pressed) - 1), np.exp(turn * block_s), turn.real / turn.imag
    struck, jumps, before, k = 0.0j, 0.0, 0.0, 0
    for i in range(len(pressed)):
        struck *= step
        while k < len(time_s) and time_s[k] <= i * block_s:
            struck += kicks[k] * np.exp(turn * (i * block_s - time_s[k]))
            jumps += kicks[k].real + slope * kicks[k].imag
            k += 1
        z = pressed[i] + struck
        speed = z.real + slope * z.imag - jumps
        if i > 0:
            out[i - 1] = speed - before
        before = speed
    return out


@njit(error_model="numpy", nogil=True)
def _shown(known: Bools, read: Floats, time_s: Floats, turn: complex, block_s: float, scale: complex) -> Floats:
    """What known blocks show of the kick before each, (m, 5): normal equations of its two parts, their right sides.

    Parameters
    ----------
    known, read
        Whether a block is known, and its acceleration, in its noise, (n,).
    time_s
        Of the kicks, the first at 0, (m,).
    turn, block_s
        Rate of the mode's amplitude; length of a block.
    scale
        Mass ratio over the blocks' noise.
    """
    out, step, slope, k = np.zeros((len(time_s), 5)), np.exp(turn * block_s), turn.real / turn.imag, -1
    rate = 0.0j
    for i in range(len(known)):
        rate *= step
        while k + 1 < len(time_s) and time_s[k + 1] <= (i + 0.5) * block_s:
            k += 1
            rate = turn * scale * np.exp(turn * ((i + 0.5) * block_s - time_s[k]))
        if known[i]:
            a, b = rate.real + slope * rate.imag, slope * rate.real - rate.imag
            out[k, 0] += a * a
            out[k, 1] += b * b
            out[k, 2] += a * b
            out[k, 3] += a * read[i]
            out[k, 4] += b * read[i]
    return out


def without_ringing(step: StepPlate, noise_mps2: float) -> StepPlate:
    """The step with a mode's power, which is no noise, taken out of the residual of its fitted tones.

    What the mode adds to the tones is taken from them with an uncertainty of its own.

    Parameters
    ----------
    step
    noise_mps2
        Scatter of the acceleration about tones and mode, in blocks like those of the tones' fit.
    """
    fit = step.acceleration
    if fit.rms <= noise_mps2:
        return step
    rms = math.sqrt(noise_mps2**2 + LEFT * (fit.rms**2 - noise_mps2**2))
    return replace(step, acceleration=replace(fit, rms=rms, covariance=fit.covariance * (rms / fit.rms) ** 2))
