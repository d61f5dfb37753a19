"""What the ball does to the plate, and how a plate mode moves under it.

What the ball does to the plate, per ball mass, from recorded volts: its weight and inertia, and its impacts.
Over a flight the relative velocity falls by ``I``, the integral of ``g + a``; from ``v_start`` it comes to the impact
speed ``I - v_start``. The displacement of the whole flight is zero, so ``v_start`` is the double integral of ``g + a``
over the flight's length; after a rest it is 0. An impact's impulse is the impact speed plus ``v_start`` of the flight
that follows at once. No model of the ball enters.

How a mode of the plate moved in a recording: the exact answer to what the ball did to it.
The state is the complex amplitude ``z = q' - conj(turn) q`` with ``turn = -damping w + i w sqrt(1 - damping^2)``, so
that ``z' = turn z + push``: both pushes, the constant one of a block and the impulse of an impact, act in closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.signal import lfilter

from analysis.linear_algebra import solveh_banded
from analysis.plate.motion import StepPlate
from kernels import njit
from kernels.arrays import Bools, Complexes, Floats, Integers

SHORTEST_REST_S = 1.2e-3  # after a shorter contact the ball left as it landed
LONG_S, FEWEST_FLIGHTS = 5e-3, 10  # flights from rest that show a friction and an accelerometer that is late
# friction (m/s^2) and lateness (s), where flights of one length leave open which of both it is
USUAL = np.array([1.0, 1e-4])
LEAST_SPREAD_MPS = 1e-6  # of flights without noise


@dataclass(frozen=True)
class Push:
    """Push on the plate for a ball of unit mass, upwards."""

    contact_mps2: Floats  # of the ball that lies on it, mean in each block, (n,)
    impact_s: Floats  # of the impacts as the accelerometer shows them, in order, (m,)
    impulse_mps: Floats  # of the same, (m,)
    block_s: float  # length of a block
    late_s: float = 0.0  # by so much the accelerometer shows what happens too late
    rise_mps2: Floats | float = 0.0  # change of the contact's push over the length of each block, (n,)
    missed_mps: float = np.inf  # median speed by which flights from rest miss the plate; none where they are too few
    stays: bool = False  # whether the ball that lands stays there: it leaves at once only as the plate falls away

    @property
    def impacts_mps2(self) -> Floats:
        """Mean push of the impacts in each block, (n,); one between two centres of blocks is shared by both."""
        n = len(self.contact_mps2)
        place = self.impact_s / self.block_s - 0.5
        block = np.clip(np.floor(place).astype(np.int64), 0, n - 2)
        part = np.clip(place - block, 0.0, 1.0)
        out = np.zeros(n)
        np.add.at(out, block, self.impulse_mps * (1.0 - part) / self.block_s)
        np.add.at(out, block + 1, self.impulse_mps * part / self.block_s)
        return out


def filled_after_impacts(acceleration_mps2: Floats, known: Bools) -> Floats:
    """The acceleration (n,) with a line through the blocks that impacts hide: their rings and pulses push no ball."""
    out, rows = acceleration_mps2.copy(), np.flatnonzero(known)
    hidden = np.flatnonzero(~known)
    if not len(rows) or not len(hidden):
        return out
    out[hidden] = np.interp(hidden, rows, acceleration_mps2[rows])
    return out


def ball_push(
    acceleration_mps2: Floats, block_s: float, takeoff_s: Floats, landing_s: Floats, gravity_mps2: float,
    mass_ratio: float = 0.0, before: Push | None = None,
) -> Push:  # fmt: skip
    """What the ball does to the plate while it lies on it, and at each landing.

    Parameters
    ----------
    acceleration_mps2, block_s
        Of the plate, means (n,) of blocks of that length.
    takeoff_s, landing_s
        Of the flights (m,), in order.
    gravity_mps2, mass_ratio
        Of the place; of the ball and what moves under it: with the ball on it the plate accelerates by so much less.
    before
        The push from an acceleration that was known less well; how late the accelerometer is, and whether the ball
        bounces, go on from there.
    """
    late_s, stays = (0.0, False) if before is None else (before.late_s, before.stays)
    felt, edges_s = gravity_mps2 + acceleration_mps2, np.arange(len(acceleration_mps2) + 1) * block_s
    bounced, landed_s = np.append(np.inf, takeoff_s[1:] - landing_s[:-1]) < SHORTEST_REST_S, landing_s
    # a contact stays closed for longer than it touches; a ball that does not bounce leaves where nothing presses it
    presses = np.interp(np.roll(landing_s, 1) + late_s, edges_s[:-1] + 0.5 * block_s, felt) > 0.0
    takeoff_s = np.where(bounced & ~(presses & stays), np.roll(landing_s, 1), takeoff_s)
    takeoff_s, landing_s = takeoff_s + late_s, landing_s + late_s
    length_s = landing_s - takeoff_s
    flight = np.clip(np.searchsorted(takeoff_s, edges_s, side="right") - 1, 0, len(takeoff_s) - 1)
    until_s = np.clip(edges_s, takeoff_s[flight], landing_s[flight])
    air = np.diff((np.cumsum(length_s) - length_s)[flight] + until_s - takeoff_s[flight]) / block_s
    # Impacts keep to a phase: what blocks blur would add up, the jump of the plate that is suddenly loaded above all.
    free = felt / (air + (1.0 - air) / (1.0 + mass_ratio))
    # velocity at the blocks' edges is exact, as blocks are means; the spline keeps it there
    once = CubicSpline(edges_s, np.append(0.0, np.cumsum(free)) * block_s)
    twice = once.antiderivative()
    begun = once(takeoff_s)
    gained, back = once(landing_s) - begun, (twice(landing_s) - twice(takeoff_s)) / length_s - begun
    flown = (np.cumsum(gained) - gained)[flight] + once(until_s) - begun[flight]
    inside = np.clip(np.searchsorted(takeoff_s, edges_s[:-1] + 0.5 * block_s) - 1, 0, len(takeoff_s) - 1)
    free_mps = (back * (bounced & (not stays)) + begun)[inside] - once(np.stack([edges_s[:-1], edges_s[1:]]))
    long, missed_mps = ~bounced & (landing_s - takeoff_s > LONG_S), np.inf
    if np.sum(long) >= FEWEST_FLIGHTS:
        friction, slowed_mps = 0.0, np.zeros_like(free_mps)
        for _ in range(2):  # a friction slows the ball on both ways, and lets it turn round earlier
            ball_mps = free_mps - friction * slowed_mps
            rate = air * np.sum(ball_mps, axis=0) / np.maximum(np.sum(np.abs(ball_mps), axis=0), LEAST_SPREAD_MPS)
            slowed, slowed_back, slowed_mps = _over_flights(rate, block_s, takeoff_s, landing_s, inside)
            friction, later_s = _missed(back[long], slowed_back[long], (gained / length_s)[long])
        late_s, begun_s, ended_s = late_s + later_s, takeoff_s + later_s, landing_s + later_s
        gained = once(ended_s) - once(begun_s) + friction * slowed
        back = (twice(ended_s) - twice(begun_s)) / length_s - once(begun_s) + friction * slowed_back
        missed_mps = float(np.median(np.abs(back[long])))
    if np.sum(left := bounced & ~presses) >= FEWEST_FLIGHTS:
        stays = bool(np.median(back[left]) < 0.005 * np.median(gained[left]))  # slower than that is no bounce
    start = back * (bounced & (not stays))
    # what changes at an impact is the speed over the plate, which recoils
    loaded = 1.0 + mass_ratio
    pressed = -np.diff(once(edges_s) - flown) / block_s / loaded
    rise = -(1.0 - air) * once(edges_s[:-1] + 0.5 * block_s, 2) * block_s / loaded
    impulse = -(gained - start + np.append(start[1:], 0.0)) / loaded
    return Push(pressed, landed_s + late_s, impulse, block_s, late_s, rise, missed_mps, stays)


def _missed(back_mps: Floats, slowed_back: Floats, closing_mps2: Floats) -> tuple[float, float]:
    """Friction (m/s^2) and lateness (s) of the accelerometer that bring flights from rest (n,) back to the plate.

    By ``back_mps`` each would have had to start to come back. A friction takes ``slowed_back`` times itself from that;
    a late accelerometer has not shown the end of a flight yet, in which the ball comes closer by ``closing_mps2`` times
    the lateness and the flight's length.
    """
    spread_mps = 1.5 * float(np.median(np.abs(back_mps - np.median(back_mps)))) + LEAST_SPREAD_MPS
    missed = np.column_stack([slowed_back, closing_mps2])

    def left(x: Floats) -> Floats:
        return np.append((back_mps + missed @ x) / spread_mps, x / USUAL)

    found = least_squares(left, np.zeros(2), loss="soft_l1", x_scale=USUAL).x
    return float(found[0]), float(found[1])


def _over_flights(
    rate: Floats, block_s: float, takeoff_s: Floats, landing_s: Floats, flight: Integers
) -> tuple[Floats, Floats, Floats]:
    """Integral of a rate (n,) over each flight, the mean of it over the flight, (m,) each; so far in blocks, (2, n)."""
    edges_s = np.arange(len(rate) + 1) * block_s
    once = np.append(0.0, np.cumsum(rate)) * block_s
    twice = np.append(0.0, np.cumsum(0.5 * (once[1:] + once[:-1]))) * block_s
    begun = np.interp(takeoff_s, edges_s, once)
    path = np.interp(landing_s, edges_s, twice) - np.interp(takeoff_s, edges_s, twice)
    so_far = np.stack([once[:-1], once[1:]]) - begun[flight]
    return np.interp(landing_s, edges_s, once) - begun, path / (landing_s - takeoff_s) - begun, so_far


KICK_MPS, KICK_PART = 2.5e-4, 1e-3  # uncertainty of an impact's kick, for a ball of the mode's mass
TORN_S = 0.5  # length of such a piece
LEFT = 0.005  # of the mode's power, which may be noise: where impacts are masked it is another one


def turn_of(frequency_hz: float, damping: float) -> complex:
    """Rate of a mode's complex amplitude, 1/s."""
    w = 2.0 * math.pi * frequency_hz
    return complex(-damping * w, w * math.sqrt(1.0 - damping**2))


def answer(push_mps2: Floats, block_s: float, frequency_hz: float, damping: float) -> Floats:
    """Mean acceleration in each block, (..., n), of a mode of mass ratio 1 under pushes that are constant in each.

    The transition from block to block is exact. The mode begins at rest under the first push.
    """
    turn = turn_of(frequency_hz, damping)
    pole = np.exp(turn * block_s)
    # velocity q' = sum over both poles; a step of the push makes q' = Im exp(turn t) / Im turn
    step = np.exp(turn * block_s * np.array([0.0, 1.0])).imag / turn.imag
    changes = np.diff(push_mps2, prepend=push_mps2[..., :1])
    speed = lfilter([0.0, step[1]], [1.0, -2.0 * pole.real, abs(pole) ** 2], changes)  # at the end of a block: step
    last = 2.0 * pole.real * speed[..., -1] - abs(pole) ** 2 * speed[..., -2]
    following = np.concatenate([speed[..., 1:], last[..., None]], axis=-1)
    return np.asarray((following - speed) / block_s)


@dataclass(frozen=True)
class PushedPlate:
    """What the ball did to the plate of one recording, and how the plate answered."""

    push: Push  # for a ball of the mode's own mass, from the first sample on
    answer_mps2: Floats  # acceleration in each block less what the drive makes of it, (n,)
    known: Bools  # where no impact hides it, (n,)
    noise_mps2: float  # standard deviation of the answer without the mode
    until_s: float = math.inf  # then the ball may have flown on, to after the end of the recording
    torn_s: tuple[float, ...] = ()  # begins of pieces of `TORN_S` in which flights were missed: kicks are unknown there

    def moved(self, frequency_hz: float, damping: float, mass_ratio: float) -> ModeMotion:
        """The motion of a mode under this push, kicks corrected by the acceleration between them."""
        turn, push = turn_of(frequency_hz, damping), self.push
        factor = np.expm1(turn * push.block_s) / turn
        rest = -np.conj(turn) * push.contact_mps2[0] / abs(turn) ** 2  # at rest under the first push
        pressed = lfilter([1.0], [1.0, -np.exp(turn * push.block_s)], np.append(rest, factor * push.contact_mps2))
        time_s, kicks = np.append(0.0, push.impact_s), np.append(0.0, push.impulse_mps).astype(np.complex128)
        motion = ModeMotion(turn, push, mass_ratio, np.asarray(pressed), time_s, kicks)
        return replace(motion, kicks=kicks + self._correction(motion)) if self.known.any() else motion

    def error_mps(self, frequency_hz: float, damping: float, mass_ratio: float) -> float:
        """Standard deviation of a mode's speed as `moved`, and of its displacement times the angular frequency.

        The amplitude's error is a damped random walk, by kicks that are not known exactly, which the acceleration
        shows in white noise: what a smoother leaves of it (Kailath, Sayed, Hassibi, Linear Estimation, 2000, ch. 16).
        """
        turn, lasts_s = turn_of(frequency_hz, damping), len(self.known) * self.push.block_s
        # a kick is a change of speed: half of its variance goes to each quadrature, and so does what a block shows
        walk = 0.5 * np.sum(KICK_MPS**2 + (KICK_PART * self.push.impulse_mps) ** 2) / lasts_s
        shown = 0.5 * (abs(turn) * mass_ratio / self.noise_mps2) ** 2 * np.count_nonzero(self.known) / lasts_s
        return mass_ratio * math.sqrt(walk / (2.0 * math.sqrt(turn.real**2 + walk * shown)))

    def _correction(self, motion: ModeMotion) -> Complexes:
        """By how much kicks differ from those of a motion: a smoother of the mode's state, (1 + k,).

        From kick to kick the amplitude turns freely; the two real unknowns of each meet those of the next, so that the
        normal equations are banded.
        """
        turn, time_s, m = motion.turn, motion.time_s, len(motion.time_s)
        read = (self.answer_mps2 - motion.gained_mps / self.push.block_s) / self.noise_mps2
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
    """Motion of a mode."""

    turn: complex  # rate of its complex amplitude
    push: Push  # what acts on it
    mass_ratio: float  # the ball's mass over the mode's
    pressed: Complexes  # amplitude by the push of contacts at the edges of the blocks, (n + 1,)
    time_s: Floats  # the first sample and every impact, (1 + k,)
    kicks: Complexes  # by how much each changes the amplitude, (1 + k,)

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
        return np.column_stack([z.imag / self.turn.imag, self._speed(z)])

    def _struck(self, time_s: Floats) -> Complexes:
        """Amplitude by impacts so far, (m,)."""
        last = np.searchsorted(self.time_s, time_s, side="right") - 1
        found = self.struck[last] * np.exp(self.turn * (time_s - self.time_s[last]))
        return np.asarray(np.where(last >= 0, found, 0.0))

    def _speed(self, z: Complexes) -> Floats:
        return np.asarray(z.real + self.turn.real / self.turn.imag * z.imag)

    @cached_property
    def gained_mps(self) -> Floats:
        """What the speed gains in each block but for the jumps of impacts, (n,): the integral of the acceleration."""
        return self.mass_ratio * _gained(self.pressed, self.time_s, self.kicks, self.turn, self.push.block_s)

    @cached_property
    def rises_mps(self) -> Floats:
        """By how much that gain changes over the length of each block, (n,)."""
        pressed = self.push.block_s * self.mass_ratio * self.push.contact_mps2
        return np.gradient(self.gained_mps - pressed) + self.push.block_s * self.mass_ratio * self.push.rise_mps2


@njit(error_model="numpy", nogil=True)
def _gained(pressed: Complexes, time_s: Floats, kicks: Complexes, turn: complex, block_s: float) -> Floats:
    """What the speed of a mode of mass ratio 1 gains in each block but for the jumps of kicks, (n,).

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
def _shown(known: Bools, read: Floats, time_s: Floats, turn: complex, block_s: float, scale: float) -> Floats:
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
