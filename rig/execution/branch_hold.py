"""Control-based continuation: hold a ball on the locked cycle by small corrections of the drive at each launch.

The locked cycle over gamma is what a prediction gives. A ball that lands at phase ``p`` of the drive and is launched at
once lands a period later at ``p* + mu (p - p*)``, on the cycle where ``p = p*``. A drive greater by the part ``e`` and
ahead by the phase ``u``, both from the launch on, moves that landing by ``(1 - mu) (p*' e - u)``, where ``p*'`` is the
derivative of ``p*`` by the logarithm of gamma: the cycle of the changed drive is another one, and the deviation from it
grows by the same multiplier.

The state is the phase of a landing. A Kalman filter follows it through the landings as timed, the drive as it was, and
the offset between the phase that the accelerometer shows and that of the prediction; so the reference is where the ball
stays without a correction, and the mean correction goes to zero. At each launch the filter's state is predicted to it
from the last landing that is known, however late that is, and the pole placed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from daq.setup.errors import InputError
from kernels.arrays import Bools, Floats
from rig.execution.plate_monitor import MeterBlock
from rig.profile import BranchTable, Profile
from rig.programme.ramp import PhaseClock, drive_amplitudes
from rig.programme.sequencer import MOVING, Sequencer, State


@dataclass(frozen=True)
class Landing:
    """One landing: sample of the stretch it was looked for in, as a decimal, and standard uncertainty in samples."""

    place: float
    uncertainty: float


class LandingTimer:
    """Find and time the one landing in a short stretch of the accelerometer, to a small part of a sample.

    A ball that is launched as it lands touches the plate for less than a sample: its impact's ringing tells the
    landing. The waveform is learnt from the landings themselves, each laid over their mean. So times have a common
    offset, which whoever uses them must estimate. Decision 416.
    """

    def __init__(self, rate_hz: float) -> None:
        # the waveform from before the impact until most of the ringing is over
        self._lead, self.tail = round(0.8e-3 * rate_hz), round(2.6e-3 * rate_hz)
        n = self._lead + self.tail
        # constant to cubic: the plate's own motion over so short a time
        self._slow = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, n), 4))[0]
        self._window = np.minimum(1.0, np.minimum(np.arange(n) + 0.5, np.arange(n)[::-1] + 0.5) / (0.2 * n))
        self._turns = np.fft.rfftfreq(n)
        self._mean = np.zeros(n)
        self._count = 0

    def find(self, acceleration_mps2: Floats, quiet: Bools) -> Landing | None:
        """The landing in a stretch (n,); None where there is none, or none like those before.

        ``quiet`` (n,) marks samples without ringing, as `rig.execution.plate_monitor` judges: the first landing is
        found by it.
        """
        n = len(self._mean)
        stretches = np.lib.stride_tricks.sliding_window_view(acceleration_mps2, n)
        if not self._count:
            loud = np.flatnonzero(~quiet)
            if not loud.size or not self._lead <= loud[0] <= len(quiet) - self.tail:
                return None
            at = int(loud[0]) - self._lead
            self._learn(self._quick(stretches[at]))
            return Landing(float(loud[0]), 0.5)
        mean = self._quick(self._mean)
        # matched filter: in white noise the largest correlation is the likeliest place
        at = int(np.argmax(stretches @ mean))
        shown = self._quick(stretches[at])
        alike = float(shown @ mean) / max(float(np.linalg.norm(shown) * np.linalg.norm(mean)), 1e-300)
        size = float(shown @ mean) / float(mean @ mean)
        # another waveform, or a far weaker impact, is another landing than the one expected
        if alike < 0.7 or size < 0.25:
            return None
        shift, sigma = self._placed(stretches[at])
        # the start was the best whole sample: a fit that leaves it has found another ring of the waveform
        if abs(shift) > 2.0:
            return None
        # later landings would not better the mean
        if self._count < 64:
            self._learn(self._shifted(shown / size, -shift))
        return Landing(at + self._lead + shift, sigma)

    def _quick(self, x: Floats) -> Floats:
        """A stretch (n,) less the plate's motion."""
        return np.asarray(x - self._slow @ (self._slow.T @ x))

    def _shifted(self, x: Floats, samples: float) -> Floats:
        """A waveform (n,) later by ``samples``."""
        # a shift by a part of a sample is a phase that grows with frequency
        spectrum = np.fft.rfft(x) * np.exp(-2j * math.pi * self._turns * samples)
        return np.asarray(np.fft.irfft(spectrum, len(x)))

    def _placed(self, x: Floats) -> tuple[float, float]:
        """By how many samples the mean lies earlier than the landing in ``x`` (n,), and the standard uncertainty."""
        shift, sigma = 0.0, math.inf
        slope = np.fft.irfft(np.fft.rfft(self._mean) * 2j * math.pi * self._turns, len(x))
        # the start is right to a whole sample: Gauss-Newton converges from there in three steps
        for _ in range(3):
            wave, steep = self._shifted(self._mean, shift), self._shifted(slope, shift)
            terms = np.column_stack([wave, steep, self._slow])
            found, *_ = np.linalg.lstsq(terms, x, rcond=None)
            left = x - terms @ found
            # Gauss-Newton: the amplitude of the slope over that of the wave is the shift that is left
            shift -= float(found[1] / found[0])
            # a delay is known as well as the noise over the norm of the waveform's slope (Cramer and Rao's bound)
            sigma = float(np.std(left) / (abs(found[0]) * np.linalg.norm(self._quick(steep))))
        return shift, sigma

    def _learn(self, wave: Floats) -> None:
        """One more landing, laid over the mean."""
        self._count += 1
        self._mean += (self._window * wave - self._mean) / self._count


@dataclass(frozen=True)
class LockedBranch:
    """Landing phase (radians, from the zero of the first tone's sine) and multiplier of the locked cycle, (n,) each.

    ``gamma`` ascends; the branch is known between its ends.
    """

    gamma: Floats
    phase: Floats
    multiplier: Floats

    def at(self, gamma: float) -> Point | None:
        """The cycle at ``gamma``; None outside of what is known."""
        if not self.gamma[0] <= gamma <= self.gamma[-1]:
            return None
        slopes = np.gradient(self.phase, np.log(self.gamma))
        phase, multiplier, slope = (
            float(np.interp(gamma, self.gamma, values)) for values in (self.phase, self.multiplier, slopes)
        )
        return Point(phase, multiplier, slope)


@dataclass(frozen=True)
class Point:
    """The locked cycle at one gamma: landing phase, multiplier, and the phase's derivative by log gamma."""

    phase: float
    multiplier: float
    slope: float

    def next_landing(self, phase: float, part: float, ahead: float) -> float:
        """Phase of the landing after one at ``phase``, the drive greater by ``part`` and ``ahead`` by a phase."""
        p = self
        return p.phase + p.multiplier * (phase - p.phase) + (1.0 - p.multiplier) * (p.slope * part - ahead)

    def response(self, weight: float) -> Floats:
        """What the next landing gains by a correction of both kinds, (2,): each for 1 of the drive's rms.

        ``weight`` is the change of the drive, in parts of its rms, for each radian of phase.
        """
        return (1.0 - self.multiplier) * np.array([self.slope, -1.0 / weight])

    @property
    def pole(self) -> float:
        """What is to be left of a deviation a cycle later: with the least corrections, 1 over the multiplier."""
        size = abs(self.multiplier)
        # near mu = -1 the least correction would leave all of a deviation: at most 0.7 of it are left
        return math.copysign(min(size, 1.0 / size, 0.7), self.multiplier) if size > 0.0 else 0.0


TURN = 2.0 * math.pi
REACH = 1.0 / 12.0  # of a cycle, to both sides of where a landing is expected: there it is looked for
FADE = 1.0 / 32.0  # of a cycle, in which a correction is made; it ends at the launch: the flight before hardly feels it
FIRST = 0.3  # standard uncertainty of phase and offset before the first landing, radians


@dataclass(frozen=True)
class Launch:
    """The drive of one flight: gamma, greater by ``part``, earlier by the phase ``ahead``; and the cycle there."""

    gamma: float
    point: Point
    part: float = 0.0
    ahead: float = 0.0


class BranchHold:
    """Hold a ball on ``branch``, the locked cycle as predicted, once it is on it, through a programme's steps.

    ``table`` has authority, kicks and uncertainty. ``why`` says why it let go; empty while it has not.
    """

    def __init__(self, profile: Profile, table: BranchTable, branch: LockedBranch) -> None:
        self._table, self._branch = table, branch
        rate_hz, frequency_hz = profile.sampling.rate_hz, profile.forcing.frequency_hz
        clock = PhaseClock.of(frequency_hz, rate_hz)
        self._rate_hz = rate_hz
        self._cycle = clock.den / clock.num  # samples
        self._timer = LandingTimer(rate_hz)
        self._timing = table.timing_s * TURN * frequency_hz
        self._multiples = np.array([m for m, _ in profile.forcing.displacement_tones()])
        volts = np.abs(drive_amplitudes(profile, 1.0))
        # change of the drive in parts of its rms, for a radian by which it is ahead
        self._weight = float(np.linalg.norm(self._multiples * volts) / np.linalg.norm(volts))
        self._acceleration: Floats = np.zeros(0)
        self._quiet: Bools = np.zeros(0, np.bool_)
        self._first = 0
        self._launches: dict[int, Launch] = {}
        self._timed = -1  # last cycle whose landing was looked for
        self._restart(0.0, 0.0)
        self._missed = 0
        self._rng = np.random.default_rng(table.seed)
        self.holding = self._taken = False
        self.why = ""

    @property
    def unheld(self) -> str:
        """Why the ball was let go, or that it never was held; empty where it is or was to the end."""
        never = "it never came to rest on the locked cycle; begin where that is stable, with a smaller slew_per_cycle"
        return self.why or ("" if self._taken else never)

    def check_delay(self, delay_samples: float, gamma: float) -> None:
        """Refuse a device whose delay (samples, from the landing's frame to the drive) the branch does not allow.

        A landing known to ``timing_s`` is predicted through ``n`` launches with ``|mu|^(n - 1) sqrt(mu^2 - 1)`` times
        that uncertainty, and three of them must lie within the authority.

        Raises `daq.setup.errors.InputError` with the delay and the greatest one.
        """
        point = self._branch.at(gamma) or self._branch.at(float(self._branch.gamma[-1]))
        if point is None or abs(point.multiplier) <= 1.0:
            return
        size, most = abs(point.multiplier), float(np.linalg.norm(point.response(self._weight))) * self._table.authority
        # an error of the last known landing grows by |mu| in each launch that it is predicted through
        # three standard uncertainties of a predicted landing must lie within the authority
        spread = 3.0 * (size - abs(point.pole)) * math.sqrt(size**2 - 1.0) * self._timing
        launches = 1 + math.floor(math.log(most / spread) / math.log(size)) if most > spread else 0
        own = self._timer.tail + (REACH + FADE) * self._cycle
        ms = 1e3 / self._rate_hz
        if delay_samples + own > launches * self._cycle:
            raise InputError(
                f"a landing would be answered {(delay_samples + own) * ms:.0f} ms later, and at gamma {gamma:g} "
                f"(multiplier {point.multiplier:.2f}) the branch can be held {launches * self._cycle * ms:.0f} ms "
                "behind; take smaller blocks, a device with less delay, or a smaller ramp.gamma"
            )

    def observe(self, block: MeterBlock, sequencer: Sequencer, ahead: int) -> list[str]:
        """Take in a block, steer where a launch lies within the next ``ahead`` samples; what is to be noted of it."""
        # a plate that is brought to rest has no locked cycle
        if self.why or sequencer.state not in (*MOVING, State.PAUSED):
            self.holding = False
            return []
        held = self.holding
        self._keep(block)
        for cycle in sorted(k for k in self._launches if k > self._timed):
            place = self._place(cycle, self._launches[cycle].point.phase)
            if place + REACH * self._cycle + self._timer.tail >= self._first + len(self._quiet):
                break
            self._take_in(cycle, place)
        self._launch(sequencer, ahead)
        if self.why and sequencer.steering:
            sequencer.release(4)
        if self.why:
            return [f"branch: let go, {self.why}"]
        return [f"branch: held from gamma {sequencer.step.gamma:g} on"] if self.holding and not held else []

    def _keep(self, block: MeterBlock) -> None:
        """Append a block; what is older than two cycles goes."""
        if block.first_sample != self._first + len(self._quiet):
            self._first, self._quiet, self._acceleration = block.first_sample, self._quiet[:0], self._acceleration[:0]
        old = max(0, len(self._quiet) - round(2.0 * self._cycle))
        self._first += old
        self._acceleration = np.concatenate([self._acceleration[old:], block.acceleration_mps2])
        self._quiet = np.concatenate([self._quiet[old:], block.quiet])

    def _place(self, cycle: int, phase: float) -> float:
        """Sample at which ``cycle`` has ``phase``."""
        return (cycle + phase / TURN) * self._cycle

    def _restart(self, phase: float, offset: float) -> None:
        """Forget all landings but one."""
        self._foreseen = 0
        self._state = np.array([phase, offset])
        self._covariance = np.diag([FIRST**2, FIRST**2])

    def _take_in(self, cycle: int, place: float) -> None:
        """Time the landing of ``cycle``, expected at the sample ``place``, and correct the filter by it."""
        self._state, self._covariance = self._predicted(cycle)
        self._timed, point = cycle, self._launches[cycle].point
        self._launches = {k: launch for k, launch in self._launches.items() if k >= cycle}
        begin = max(round(place - REACH * self._cycle), self._first)
        window = slice(begin - self._first, round(place + REACH * self._cycle) + self._timer.tail - self._first)
        found = self._timer.find(self._acceleration[window], self._quiet[window])
        if found is None:
            self._judge("no landing where the branch has one")
            return
        shown = point.phase + (begin + found.place - place) * TURN / self._cycle
        sigma = math.hypot(found.uncertainty * TURN / self._cycle, self._timing)
        miss = shown - float(self._state.sum())
        # not yet locked: the filter begins anew from what is seen
        if not self.holding and abs(miss) > 0.03:
            self._restart(point.phase, shown - point.phase)
            return
        # Kalman: what is seen is the sum of phase and offset
        gain = self._covariance.sum(axis=1) / (self._covariance.sum() + sigma**2)
        self._state = self._state + gain * miss
        self._covariance = self._covariance - np.outer(gain, self._covariance.sum(axis=0))
        self._foreseen += 1
        away, most = float(self._state[0]) - point.phase, self.capture(point)
        self._judge(f"a landing {away:+.3f} rad off, of which {most:.3f} can be brought back" * (abs(away) > most))

    def _judge(self, fault: str) -> None:
        """Count faults in a row; let go at two of them."""
        self._missed = self._missed + 1 if fault else 0
        self._foreseen = 0 if fault else self._foreseen
        # landings in a row that are missing, or that no correction brings back
        if self.holding and self._missed >= 2:
            self._let_go(f"{fault}, at gamma {self._launches[self._timed].gamma:.4g}")

    def _let_go(self, why: str) -> None:
        self.why, self.holding = why, False

    def capture(self, point: Point) -> float:
        """Largest deviation (radians) that the authority can bring back, seen at once; infinite on a stable cycle."""
        size = abs(point.multiplier)
        most = float(np.linalg.norm(point.response(self._weight))) * self._table.authority
        return most / (size - 1.0) if size > 1.0 else math.inf

    def _predicted(self, cycle: int) -> tuple[Floats, Floats]:
        """State (phase, offset) and covariance at the landing of ``cycle``."""
        state, covariance = self._state, self._covariance
        for k in range(self._timed, cycle):
            if k not in self._launches:
                continue
            launch, after = self._launches[k], self._launches.get(k + 1, self._launches[k])
            point = launch.point
            state = np.array([point.next_landing(float(state[0]), launch.part, launch.ahead), state[1]])
            turn = np.diag([point.multiplier, 1.0])
            # the offset wanders slowly; where the programme moves gamma, the predicted phase moves too, right to 3 % of
            # the move
            drift = math.hypot(3e-5, 0.03 * (after.point.phase - point.phase))
            covariance = turn @ covariance @ turn + np.diag([3e-4**2, drift**2])
        return state, covariance

    def _launch(self, sequencer: Sequencer, ahead: int) -> None:
        """Where a flight begins within the next ``ahead`` samples, note its drive, and correct it."""
        gamma, length = self._gamma(sequencer, sequencer.position), round(FADE * self._cycle)
        point = self._branch.at(gamma)
        if point is None:
            if self.holding:
                self._let_go(f"the branch is not known at gamma {gamma:.4g}")
            self._launches.clear()
            self._foreseen = 0
            return
        turns = point.phase / TURN
        cycle = max(self._launches, default=0) + 1
        if abs(self._place(cycle, point.phase) - sequencer.position) > 1.5 * self._cycle:  # the first, or after a loss
            cycle = math.ceil((sequencer.position + length) / self._cycle - turns)
        begin = max(round(self._place(cycle, point.phase)) - length, sequencer.position)
        if begin >= sequencer.position + ahead:
            return
        # a launch without a correction is noted as well: landings are predicted through all of them
        launch = Launch(gamma, point)
        steady = sequencer.state in (State.SETTLING, State.HOLDING)
        self.holding = self.holding or (steady and self._foreseen >= 12)  # landings in a row as the filter foresaw
        self._taken |= self.holding
        if self.holding:
            self._launches[cycle] = launch
            after = self._branch.at(self._gamma(sequencer, begin + round(self._cycle))) or point
            launch = self._corrected(cycle, launch, after, sequencer.state is State.HOLDING)
            turned = (1.0 + launch.part) * np.exp(1j * self._multiples * launch.ahead)
            sequencer.steer(begin, length, tuple((np.array(sequencer.planned(begin)) * turned).tolist()))
        self._launches[cycle] = launch

    def _corrected(self, cycle: int, launch: Launch, after: Point, kicked: bool) -> Launch:
        """``launch`` with the correction that leaves the least of a deviation from ``after`` a cycle later."""
        phase, point = float(self._predicted(cycle)[0][0]), launch.point
        wanted = after.phase + point.pole * (phase - point.phase)
        # the least correction that moves the next landing as wanted: along the response (pseudo-inverse)
        response = point.response(self._weight)
        correction = response * (wanted - point.next_landing(phase, 0.0, 0.0)) / float(response @ response)
        if kicked:
            correction[1] += self._table.kick * (1.0 if self._rng.random() < 0.5 else -1.0)
        # scaled as a whole: its direction is what moves the landing
        correction *= min(1.0, self._table.authority / max(float(np.linalg.norm(correction)), 1e-300))
        return replace(launch, part=float(correction[0]), ahead=float(correction[1]) / self._weight)

    def _gamma(self, sequencer: Sequencer, sample: int) -> float:
        """Gamma that the programme has at ``sample``."""
        planned, end = np.abs(sequencer.planned(sample)), np.abs(sequencer.amplitudes)
        most = int(np.argmax(end))
        return float(sequencer.step.gamma * planned[most] / max(end[most], 1e-300))
