"""Ringing plate modes identified from recorded volts, and up to which gamma the plate is true to its drive.

No flight is predicted. Per ball mass, the ball pushes the plate by ``-(g + a)`` while it lies on it, with the measured
acceleration ``a`` of the plate, and by an impulse ``-J`` at each landing; see `ball_push`. The accelerometer shows the
drive times a gain, and a mode's answer ``q''`` of ``q'' + 2 damping w q' + w^2 q = mass_ratio * push``. Gain and mass
ratio are linear and regressed; only frequency and damping are searched. That none is identified is no proof that there
is none (``python -m benchmarks.analysis.ringing``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from analysis.linear_algebra import NotFiniteError, lstsq, solve
from analysis.plate.motion import StepPlate
from analysis.plate.ringing.ball_push import SHORTEST_REST_S, Push, ball_push, filled_after_impacts
from analysis.plate.ringing.in_blocks import HUM_HZ, LEAD_S, drive_regressors, unmasked, volts_in_blocks
from analysis.plate.ringing.mode_motion import PushedPlate, answer, ringing_after_changes, turn_of
from analysis.plate.ringing.regression import CLUSTER_S, SURE_NATS, PlateMode, Regression
from analysis.signals import restored
from daq.recording import Recording
from kernels.arrays import Bools, Complexes, Floats

RATE_HZ = 1000.0  # of the block means: far above any mode that a ball shakes
ROUNDS = 15  # until mode, the accelerometer's zero and what impacts hide agree
AGREED_MPS2 = 5e-4  # change of the impacts' mean push at which they agree with the motion: .00005 of the ball's weight
SETTLED = 3e-4  # relative change of frequency and damping
RINGS_ON = 2.0  # of the mask: what still rings behind it would pull


@dataclass(frozen=True)
class Identified:
    """What recorded volts show of a plate that the ball strikes."""

    mode: PlateMode | None = None
    quiet: bool = False  # whether they leave room for no mode that would be sure
    # what the ball did to the plate, of each recording; empty where the plate does not surely answer in all of them
    pushed: tuple[PushedPlate, ...] = ()

    @classmethod
    def together(cls, parts: Sequence[Identified]) -> Identified:
        """Of several recordings of one plate, the mode that is surest."""
        mode = max((x.mode for x in parts if x.mode), key=lambda m: m.gain_nats, default=None)
        pushed = tuple(push for x in parts for push in x.pushed) if all(x.pushed for x in parts) else ()
        return cls(mode, all(x.quiet for x in parts), pushed)


def identified_mode(
    recording: Recording, takeoff_s: Floats, landing_s: Floats, mask_s: float, high_pass_hz: float = 0.0
) -> Identified:
    """The mode that the ball's push shakes; none where none is identified, without a drive, or with too few impacts.

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
        return Identified()
    whole = _Recorded.of(recording, takeoff_s, landing_s, mask_s, high_pass_hz)
    record = whole.last(max(len(whole.acceleration) - round(100.0 / whole.block_s), 0))  # thrown hardest there
    forcing_hz, begun, forces, found, earlier = recording.setup.forcing.frequency_hz, [0], 0, None, None
    for _ in range(4):  # three pieces may be left out
        if len(record.landing_s) < 20 or np.count_nonzero(record.known) < 1000:
            return Identified()
        try:
            seen, found = record.settled(begun, found, forces)
            if found is None:
                return Identified(quiet=True)
            if len(begun) == 1 and not record.promises(seen, found):
                return Identified(seen.judged(found, forcing_hz))
            # a plate that goes as it is asked feels no force of the drive: none is looked for where noise is left
            if len(record.driven) and len(begun) == 1 and seen.left_nats(found) > SURE_NATS:
                other, x = record.settled(begun, None, len(record.driven))
                if x is not None and other.forced(x):
                    forces, seen, found = len(record.driven), other, x
            elif forces and len(found) == 2 and not seen.forced(found):  # they stood for a flight that was missed
                seen, found = record.settled(begun, found, forces := 0)
            seen, found = record.second(seen, begun, found, forces, forcing_hz)
        except NotFiniteError:  # a drive that stands still explains no acceleration
            return Identified()
        worst = None if found is None else seen.worst_cluster(found)
        # a flight that was missed spoils what follows: where the fit without a piece loses one before, it was none
        if earlier and worst is not None and worst * CLUSTER_S < begun[-1] * record.block_s:
            (seen, found), worst = earlier, None
        if found is None or worst is None:
            break
        earlier = seen, found
        record, ends = record.without(worst)  # after it the plate rings on from an unknown state
        begun.append(min(ends, len(record.known) - 2))
    mode = None if found is None else seen.all_judged(found, forcing_hz)
    if mode is None or found is None or not mode.sure:
        # what the ball did is known even where no mode is, if the plate surely answers; but the drive's part, fitted
        # with another mode, may hold some of this one's motion, so that the acceleration corrects no kick
        if found is None or len(begun) > 1 or seen.gained(found) < SURE_NATS:
            return Identified(mode)
        pushed = whole.pushed(seen, found)
        return Identified(mode, pushed=(replace(pushed, known=np.zeros_like(pushed.known)),))
    pushed = whole.pushed(seen, found)
    return Identified(replace(mode, pushed=pushed), pushed=(pushed,))


@dataclass(frozen=True)
class _Recorded:
    """Acceleration (n,), regressors (n, k), unmasked blocks (n,), and flights.

    The first regressors may be forces: ``driven`` are their analytic signals (l, 1 + n), of so many Hz each (l,).
    ``left_s`` is the take-off of a flight that the end cuts off; infinite without one.
    """

    acceleration: Floats
    linear: Floats
    known: Bools
    block_s: float
    takeoff_s: Floats
    landing_s: Floats
    gravity_mps2: float
    driven: Complexes
    driven_hz: Floats
    left_s: float = math.inf

    @classmethod
    def of(
        cls, recording: Recording, takeoff_s: Floats, landing_s: Floats, mask_s: float, high_pass_hz: float
    ) -> _Recorded:
        """A whole recording, as `identified_mode` takes it."""
        width = max(round(recording.rate_hz / RATE_HZ), 1)
        block_s = width / recording.rate_hz
        acceleration, drive = volts_in_blocks(recording, width)
        if high_pass_hz > 0.0:
            acceleration = restored(acceleration, high_pass_hz, 1.0 / block_s)
        landed = landing_s < (len(acceleration) - 1) * block_s
        steps, changed = recording.steps, recording.drive_changes["first_sample"]
        begins = steps["first_sample"] + steps["settle_samples"]
        ends = steps["first_sample"] + steps["n_samples"]
        spans = np.column_stack([begins, ends]) // width
        quiet = [not np.any((changed >= a * width) & (changed < b * width)) for a, b in spans]
        known = unmasked(len(acceleration), block_s, landing_s, RINGS_ON * mask_s)
        if not landed.all():  # the impulse at the end of the flight before needs this flight
            last = int(np.argmin(landed))
            known[int((landing_s[max(last - 1, 0)] - LEAD_S) / block_s) :] = False
        linear, driven, driven_hz = drive_regressors(drive, block_s, recording.setup.forcing, spans[quiet])
        return cls(
            acceleration, linear, known, block_s, takeoff_s[landed], landing_s[landed], recording.setup.g_mps2.value,
            driven, driven_hz, float(np.min(takeoff_s[~landed], initial=math.inf)),
        )  # fmt: skip

    def last(self, skipped: int) -> _Recorded:
        """Without the first blocks."""
        inside, shift_s = self.takeoff_s > skipped * self.block_s, skipped * self.block_s
        return _Recorded(
            self.acceleration[skipped:], self.linear[skipped:], self.known[skipped:], self.block_s,
            self.takeoff_s[inside] - shift_s, self.landing_s[inside] - shift_s, self.gravity_mps2,
            self.driven[:, skipped:], self.driven_hz, self.left_s - shift_s,
        )  # fmt: skip

    def without(self, worst: int) -> tuple[_Recorded, int]:
        """With the blocks of a piece unknown, and the first block after them."""
        at, (first, stop) = np.arange(len(self.known)), (int(k * CLUSTER_S / self.block_s) for k in (worst, worst + 1))
        return replace(self, known=self.known & ((at < first) | (at >= stop))), stop

    def made(self, sizes: Floats) -> tuple[Floats, Floats]:
        """What the regressors make with their sizes, and what of it is the mains' hum, (n,) each."""
        hum = np.s_[-2 * len(HUM_HZ) :]
        return self.linear @ sizes, self.linear[:, hum] @ sizes[hum]

    def push(
        self, acceleration: Floats, hum: Floats, before: Push | None, mass_ratio: float, rubs: bool = False
    ) -> Push:
        """What the ball does to a plate whose acceleration has no zero: it goes nowhere, whatever impacts give it.

        Whether the mains' ``hum`` shakes the plate, or only the accelerometer's cable, flights from rest show. A ball
        that ``rubs`` at a rod that stands on the plate drags that along.
        """
        # both ends fade: the plate is cut off there in full swing, as if it went somewhere
        weight = np.hanning(len(acceleration))
        gained = 0.0 if before is None else mass_ratio * before.impacts_mps2
        felt = acceleration - np.average(acceleration + gained, weights=weight)
        rest = (self.block_s, self.takeoff_s, self.landing_s, self.gravity_mps2, mass_ratio, before)
        push = min((ball_push(x, *rest) for x in (felt, felt - hum)), key=lambda push: push.missed_mps)
        # a ball that flies on to the end presses no more
        lies = np.clip(self.left_s / self.block_s - np.arange(len(felt)), 0.0, 1.0)
        pressed = lies * push.contact_mps2 + rubs * push.rubbed_mps2
        return replace(push, contact_mps2=pressed, rise_mps2=lies * push.rise_mps2)

    def promises(self, seen: Regression, x: Floats) -> bool:
        """Whether a mode found first, without forces, could become sure, with them or without."""
        driven = replace(seen, shaken=np.vstack([seen.shaken, self.linear[:, : len(self.driven)].T]))
        # what impacts hide, once known, has raised a gain by 4 parts in 10, never to twice
        return max(seen.gained(x), driven.gained(x)) > 0.5 * SURE_NATS

    def second(
        self, seen: Regression, begun: Sequence[int], found: Floats | None, forces: int, forcing_hz: float
    ) -> tuple[Regression, Floats | None]:
        """Two modes in place of one, where more than noise is left and both are sure.

        Before a piece is left out, as what a second mode does in it looks like a flight that was missed.
        """
        if found is None or len(found) > 2 or seen.left_nats(found) <= SURE_NATS:
            return seen, found
        if (another := seen.with_another(found)) is None:
            return seen, found
        # a tenth of what one mode leaves: less may be what no mode explains
        one_mps2 = float(np.std(seen.remainder(found)))
        start = replace(seen, phases=False).followed([another])
        if np.std(seen.remainder(start)) > 0.9 * one_mps2:
            return seen, found
        both, x = self.settled(begun, start, forces)
        if x is None:
            return seen, found
        first, second = (both.judged(x, forcing_hz, which) for which in (0, 1))
        if not (first and second and first.sure and second.remainder_mps2 < 0.9 * one_mps2):
            return seen, found
        return both, x

    def settled(self, begun: Sequence[int], found: Floats | None, forces: int) -> tuple[Regression, Floats | None]:
        """The regression, and logarithms of frequency and damping, when what impacts hide agrees with the mode found.

        Where impacts hide the acceleration, the ball feels what the model says. The plate goes nowhere, so what it
        gains by impacts, which the acceleration between them lacks, is its mean. On a quiet plate no mode is searched,
        and none that promises too little is followed. So many ``forces`` may drive the mode, too.
        """
        known, ratio, push, fresh, rubs = self.known, 0.0, None, found is None, False
        # the drive's part is the same for every mode tried: an orthonormal basis takes it out of any column
        basis, upper = np.linalg.qr(self.linear[known])

        def drive_part(seen: Floats) -> tuple[Floats, Floats]:
            return self.made(solve(upper, basis.T @ seen[known]))

        driven, hum = drive_part(self.acceleration)
        acceleration = driven + filled_after_impacts(self.acceleration - driven, known)
        for rounds in range(ROUNDS):
            push = self.push(acceleration, hum, push, ratio, rubs)
            impulses = push.impacts_mps2
            shaken = np.vstack([push.contact_mps2 + impulses, self.linear[:, :forces].T])
            seen = Regression.of(acceleration, basis, shaken, push.contact_mps2, known, self.block_s, begun)
            seen = replace(seen, rubs=rubs)
            if fresh and rounds == 0 and seen.quiet:
                return seen, None
            again = fresh and rounds == 1  # the first search did not know what is hidden
            # of two modes far from their place, phases would explain whatever is there
            followed = replace(seen, phases=rounds > 0).followed
            x = seen.searched() if found is None or again else followed([found])
            rubs ^= seen.rubbed_nats(x, push.rubbed_mps2) > 8.0  # chance gives so much once in 3,000
            sizes = seen.sizes(seen.columns(x), len(x) // 2)
            mode, ratio = seen.answers(x) @ sizes, seen.ratios(x, sizes)[1]
            driven, hum = drive_part(acceleration - mode)
            acceleration = np.where(known, acceleration, driven + mode - ratio * impulses)
            close = found is not None and np.max(np.abs(x - found)) < SETTLED * (1 if len(x) == 2 else 10)
            settled = not again and rubs == seen.rubs and bool(close)
            settled = settled or (fresh and rounds == 0 and not forces and not self.promises(seen, x))
            found = x
            if settled:
                break
        return seen, x

    def pushed(self, seen: Regression, x: Floats) -> PushedPlate:
        """What the ball did to the plate of the whole recording, of which ``seen`` is the end."""
        skipped, k, forces = len(self.known) - len(seen.known), len(x) // 2, len(seen.shaken) - 1
        sizes, modes = seen.sizes(seen.columns(x), k), np.exp(x).reshape(-1, 2)
        left = (self.acceleration[skipped:] - seen.answers(x) @ sizes)[seen.known]
        driven, hum = self.made(np.asarray(lstsq(self.linear[skipped:][seen.known], left)[0], dtype=np.float64))
        of_forces, (ratios, jump) = sizes[2 * k - 1 :][: k * forces].reshape(k, forces), seen.ratios(x, sizes)
        after_changes = list[Complexes]()
        for mode, own in zip(modes, of_forces, strict=True) if forces else ():
            rings = ringing_after_changes(own[:, None] * self.driven, self.driven_hz, self.block_s, *mode)
            turn = turn_of(*mode)
            # what is gone within a cycle of the drive is over with the change itself, where flights are not compared
            rings = rings * (-turn.real < self.driven_hz[0])
            lagging_mps = rings.real + turn.real / turn.imag * rings.imag
            force = self.linear[:, :forces] @ own
            driven += answer(force, self.block_s, *mode) - np.diff(lagging_mps) / self.block_s
            after_changes.append(rings)
        acceleration = driven + filled_after_impacts(self.acceleration - driven, self.known)
        (hz, damping, ratio), *others = zip(*modes.T.tolist(), ratios.tolist(), strict=True)
        before: Push | None = None
        torn_s = tuple((skipped + at) * self.block_s - CLUSTER_S for at in seen.begun[1:])
        # how fast a ball leaves that leaves as it lands, only the flight's end tells
        last_s = float(self.landing_s[-1])
        until_s = last_s if self.left_s < last_s + SHORTEST_REST_S else math.inf
        left_mps2, phase = float(np.std(seen.remainder(x))), ratio / ratio.real
        pushed_by = partial(
            PushedPlate, answer_mps2=self.acceleration - driven, known=self.known, noise_mps2=left_mps2,
            until_s=until_s, torn_s=torn_s, phase=phase, others=tuple(others), after_changes=tuple(after_changes),
        )  # fmt: skip
        for _ in range(ROUNDS):  # impacts are sharper from the motion as modelled: it has no noise
            plate = pushed_by(self.push(acceleration, hum, before, jump, seen.rubs))
            acceleration = driven + plate.moved(hz, damping, ratio.real).gained_mps / self.block_s
            # what the ball's weight lacks in the mean would lift the plate, and every flight with it
            if before and abs(float(np.mean(plate.push.impacts_mps2 - before.impacts_mps2))) < AGREED_MPS2:
                break
            before = plate.push
        return plate


UNTRUE = 0.05  # part of the drive's speed that the mode's may have
CURES = (
    # factors of frequency, damping and mass ratio
    ("half the ball", (1.0, 1.0, 0.5)),
    ("twice the moving mass on the same springs", (np.sqrt(0.5), np.sqrt(0.5), 0.5)),
    ("springs four times as stiff", (2.0, 0.5, 1.0)),
    ("four times the damping", (1.0, 4.0, 1.0)),
)  # fmt: skip


def parts_of_drive(mode: PlateMode, span_s: Floats, drive_mps: Floats, factors: Floats) -> Floats:
    """Speed of the mode over that of the drive's tones, both rms, in each step, (m,).

    Parameters
    ----------
    mode
        With what the ball did to the plate.
    span_s
        Begin and end of each step, (m, 2).
    drive_mps
        Rms speed of the drive's tones in each, (m,).
    factors
        Of frequency, damping and mass ratio, (3,): another plate under the same impacts where they are not 1.
    """
    if mode.pushed is None:
        return np.full(len(drive_mps), np.nan)
    # another plate would not have answered as this one did, so that nothing of that corrects its kicks
    others = tuple((f * factors[0], min(d * factors[1], 0.9), m * factors[2]) for f, d, m in mode.pushed.others)
    push = replace(mode.pushed, others=others)
    if not np.all(factors == 1.0):
        push = replace(push, known=np.zeros_like(push.known), after_changes=())
    hz, damping, mass_ratio = np.array([mode.frequency_hz, mode.damping, mode.mass_ratio]) * factors
    motion, block_s = push.moved(float(hz), min(float(damping), 0.9), float(mass_ratio)), push.push.block_s
    speeds = [np.std(motion.state(np.arange(begin, end, block_s))[:, 1]) for begin, end in span_s]
    return np.asarray(speeds) / drive_mps


def ringing_in_words(mode: PlateMode, gamma: Floats, span_s: Floats, drive_mps: Floats) -> str:
    """The mode, from which gamma on it spoils the plate's motion, and what it would be of another plate or ball.

    ``gamma`` of each step, (m,); the rest as in `parts_of_drive`.
    """
    gamma, span_s, drive_mps = (x[np.argsort(gamma)] for x in (gamma, span_s, drive_mps))
    part = parts_of_drive(mode, span_s, drive_mps, np.ones(3))
    true = np.flatnonzero(part < UNTRUE)
    first = int(true[-1]) + 1 if len(true) else 0
    loaded_hz = mode.frequency_hz / np.sqrt(1.0 + mode.mass_ratio)
    words = (
        f"the plate rings at {mode.frequency_hz:.3g} Hz under the ball ({loaded_hz:.3g} Hz with the ball on it, "
        f"damping {mode.damping:.2g}, the ball weighs {100.0 * mode.mass_ratio:.2g} % of what moves): "
        f"{100.0 * part[-1]:.2g} % of the drive's speed at gamma {gamma[-1]:.3g}"
    )
    if (more := mode.second) is not None:
        words = (
            f"one mode does not suffice, of the {more.before_mps2:.2g} m/s^2 that it leaves one of "
            f"{more.frequency_hz:.3g} Hz (damping {more.damping:.2g}, {100.0 * more.mass_ratio:.2g} %) explains all "
            f"but {more.remainder_mps2:.2g}; {words}"
        )
    if mode.remainder_mps2 > 1.2 * mode.noise_mps2:
        words = (
            f"{words}; {mode.remainder_mps2:.2g} m/s^2 are left where noise is {mode.noise_mps2:.2g}, most of it at "
            f"{mode.left_hz:.2g} Hz"
        )
    if first == len(part):
        return f"{words}, nowhere lastingly above {100.0 * UNTRUE:g} %"
    cures = (
        f"{100.0 * parts_of_drive(mode, span_s[-1:], drive_mps[-1:], np.array(factors))[0]:.2g} % with {what}"
        for what, factors in CURES
    )
    since = f"; the plate is not true to its drive (to {100.0 * UNTRUE:g} %) from gamma {gamma[first]:.3g} on"
    return f"{words}{since}; under the same impacts {', '.join(cures)}"


def remarks(mode: PlateMode | None, steps: Sequence[StepPlate], rate_hz: float) -> tuple[str, ...]:
    """The sentence about a mode that is sure, of steps of a recording; none about another."""
    if mode is None or mode.pushed is None or not steps:
        return ()
    tones = [s.forcing() for s in steps]
    drive_mps = np.sqrt([0.5 * np.sum(np.abs(z.acceleration / z.omega_radps) ** 2) for z in tones])
    span_s = np.array([(s.first_sample, s.last_sample) for s in steps]) / rate_hz
    return (ringing_in_words(mode, np.array([s.gamma for s in steps]), span_s, drive_mps),)
