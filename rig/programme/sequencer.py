"""From a programme to blocks of drive samples and step marks: a state machine without I/O.

Which state follows which is data (`TRANSITIONS`), and a sample depends on the programme, the stops
asked for and its index, never on how the run was cut into blocks.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from daq.files.tables import DRIVE_DTYPE
from daq.setup.setup import Setup
from kernels.arrays import Floats
from rig.programme.ramp import Fade, PhaseClock, Programme, Step, drive_amplitudes, stop_fade_samples, synthesise

BLOCKS_PER_CYCLE = 4
LONGEST_PAUSE_S = 600.0  # an unattended plate must not shake for ever

_OPEN_END = 2**62


class State(enum.Enum):
    """Where a run is."""

    FADING = "fading"
    SETTLING = "settling"
    HOLDING = "holding"
    PAUSED = "paused"
    STOPPING = "stopping"
    RESTING = "resting"
    DONE = "done"


class Event(enum.Enum):
    """What takes a run from one state to the next."""

    FADED = "faded"
    SETTLED = "settled"
    NEXT = "held, another step follows"
    LAST = "held, no step follows"
    WAIT = "held, asked to pause before the next step"
    STOP = "asked to ramp down"
    CUT = "asked to be at zero now"
    ZERO = "drive at zero"
    RESTED = "rested"


class Stop(enum.IntEnum):
    """How to stop; the higher wins."""

    FINISH_STEP = 1
    RAMP_DOWN = 2
    NOW = 3


MOVING = (State.FADING, State.SETTLING, State.HOLDING)
_DRIVEN = (*MOVING, State.PAUSED)
STILL = (State.RESTING, State.DONE)

TRANSITIONS: dict[tuple[State, Event], State] = {
    (State.FADING, Event.FADED): State.SETTLING,
    (State.SETTLING, Event.SETTLED): State.HOLDING,
    (State.HOLDING, Event.NEXT): State.FADING,
    (State.HOLDING, Event.LAST): State.STOPPING,
    (State.HOLDING, Event.WAIT): State.PAUSED,
    (State.PAUSED, Event.NEXT): State.FADING,
    **{(state, Event.STOP): State.STOPPING for state in (*_DRIVEN, State.STOPPING)},
    **{(state, Event.CUT): State.RESTING for state in (*_DRIVEN, State.STOPPING)},
    **{(state, event): state for state in STILL for event in (Event.STOP, Event.CUT)},
    (State.STOPPING, Event.ZERO): State.RESTING,
    (State.RESTING, Event.RESTED): State.DONE,
}
"""The whole machine. A pair that is not here cannot happen."""


class Sequencer:
    """Drive samples of a programme, a block at a time.

    Parameters
    ----------
    programme
        The steps.
    setup
        Forcing and drive scale.
    amplitudes
        Complex drive volts of each tone for a gamma; `rig.programme.ramp.drive_amplitudes` where nothing better is
        known.
    controlled
        Whether a step settles until `settled` is called, instead of for its planned cycles.

    Attributes
    ----------
    state : State
    position : int
        Index of the next sample to be made.
    step : Step
        The step under way (the last one when stopping).
    marks : list of Step
        Steps begun (as planned) and ended (with the samples they really had) since the caller last emptied the list.
    given_up : bool
        Whether a pause was not ended for `LONGEST_PAUSE_S`, and ended the run.
    fades : list of Fade
        Changes of the drive's amplitudes since the caller last emptied the list; together they are the drive.
    steering : bool
        Whether every change is one that `steer` asked for, and the programme's own are only planned.
    """

    def __init__(
        self,
        programme: Programme,
        setup: Setup,
        *,
        amplitudes: Callable[[float], tuple[complex, ...]] | None = None,
        controlled: bool = False,
    ) -> None:
        self.programme = programme
        self.state = State.FADING
        self.position = 0  # index of the next sample to be made
        self.step = programme.steps[0]  # the one under way, the last one when stopping
        # steps begun, as planned, and ended, with the samples they really had, since the caller last emptied the list
        self.marks: list[Step] = []
        self._amplitudes = amplitudes or partial(drive_amplitudes, setup)
        self._controlled = controlled
        self._multiples = tuple(m for m, _ in setup.forcing.displacement_tones())
        self._zero = tuple(0j for _ in self._multiples)
        # given up: a pause was not ended for `LONGEST_PAUSE_S`, and ended the run
        self._finish_step = self._pausing = self.given_up = False
        self._planned = self._fade = Fade(0, self.step.fade_samples, self._zero, self._amplitudes(self.step.gamma))
        self._steered: Fade | None = None
        self.steering = False  # whether every change is one that `steer` asked for, and the programme's own are planned
        self.fades = [self._fade]  # changes of the drive since the caller last emptied it; together they are the drive
        self._until = self.step.fade_samples

    @property
    def done(self) -> bool:
        """Whether the drive is at zero and has rested there."""
        return self.state is State.DONE

    def take(self, n_samples: int) -> Floats:
        """The next drive volts, shape ``(n_samples,)``; zeros once the run is done."""
        out = np.zeros(n_samples)
        filled = 0
        while filled < n_samples and not self.done:
            if self.state is State.FADING and self.position == self.step.first_sample:
                self.marks.append(self.step)
            # up to the next change of state or of the drive, so that blocks of any size give the same samples
            piece = min(n_samples - filled, self._until - self.position)
            if self._steered is not None:
                if self._steered.first_sample == self.position:
                    self._change(self._steered)
                    self._steered = None
                else:
                    piece = min(piece, self._steered.first_sample - self.position)
            if self.state not in STILL:
                clock, begin = self.programme.clock, self.position
                out[filled : filled + piece] = synthesise(clock, self._multiples, self._fade, begin, piece)
            filled += piece
            self.position += piece
            while self.position == self._until and not self.done:
                self._handle(self._ended())
        self.position += n_samples - filled
        return out

    def stop(self, how: Stop) -> None:
        """Stop as asked, from the next sample on; a stop already under way is never made slower."""
        if how is Stop.FINISH_STEP:
            self._finish_step = True
            if self.state is State.PAUSED:  # the step is over
                self._handle(Event.STOP)
        else:
            self._handle(Event.STOP if how is Stop.RAMP_DOWN else Event.CUT)

    def pause(self, wanted: bool) -> None:
        """Pause at the end of the present step, at its amplitude; or go on with the next cycle.

        A pause that is not ended becomes a stop after `LONGEST_PAUSE_S`.
        """
        self._pausing = wanted
        if self.state is State.PAUSED and not wanted:
            clock = self.programme.clock
            self._until = min(self._until, clock.cycle_start(clock.cycle_after(self.position + 1)))

    @property
    def amplitudes(self) -> tuple[complex, ...]:
        """Complex volts of each tone that the present fade, as planned, leads to."""
        return self._planned.end

    def planned(self, sample: int) -> tuple[complex, ...]:
        """Complex volts of each tone that the programme has at ``sample``, from the present fade on."""
        return self._planned.at(sample)

    def steer(self, first_sample: int, n_samples: int, amplitudes: tuple[complex, ...]) -> None:
        """Fade to ``amplitudes`` at a sample still to be made; the programme's own changes are not made any more.

        Raises `ValueError` for a sample that is made already, or before an earlier order was carried out.
        """
        if first_sample < self.position or self._steered is not None:
            raise ValueError(f"cannot steer at sample {first_sample}: at {self.position}, or an order is waiting")
        self.steering = True
        self._steered = Fade(first_sample, n_samples, self._fade.end, amplitudes)

    def release(self, n_cycles: int) -> None:
        """Fade back to the programme, over ``n_cycles`` or what is left of its own fade, and follow it from there."""
        clock, self._steered, self.steering = self.programme.clock, None, False
        end = max(self._planned.first_sample + self._planned.n_samples, self.position + clock.cycle_start(n_cycles))
        self._change(Fade(self.position, end - self.position, self._fade.at(self.position), self._planned.end))

    def retarget(self, amplitudes: tuple[complex, ...], n_cycles: int) -> int:
        """While settling (else ValueError): fade to ``amplitudes`` from the next cycle on; returns where that ends."""
        if self.state is not State.SETTLING:
            raise ValueError(f"cannot change amplitudes while {self.state.value}")
        clock = self.programme.clock
        cycle = clock.cycle_after(self.position)
        first = clock.cycle_start(cycle)
        self._set_fade(Fade(first, clock.cycle_start(cycle + n_cycles) - first, self._planned.end, amplitudes))
        return first + self._planned.n_samples

    def settled(self) -> None:
        """While settling under control: hold from the next cycle on."""
        if self.state is State.SETTLING and self._until == _OPEN_END:
            clock = self.programme.clock
            first_cycle = clock.cycle_after(self.step.first_sample)
            settle_cycles = clock.cycle_after(self.position) - first_cycle - self.step.fade_cycles
            self.step = self.step.placed(clock, first_cycle, settle_cycles)
            self._until = self.step.first_sample + self.step.settle_samples

    def _set_fade(self, fade: Fade) -> None:
        """Plan a change of the programme, and make it unless another steers."""
        self._planned = fade
        if self.steering:
            return
        if fade.first_sample < self._fade.first_sample + self._fade.n_samples:  # of a release that is not over
            fade = replace(fade, start=self._fade.at(fade.first_sample))
        self._change(fade)

    def _change(self, fade: Fade) -> None:
        self._fade = fade
        self.fades.append(fade)

    def _ended(self) -> Event:
        """The event that the end of the present state is."""
        if self.state is State.HOLDING:
            last = self._finish_step or self.step.index + 1 == len(self.programme.steps)
            return Event.LAST if last else Event.WAIT if self._pausing else Event.NEXT
        if self.state is State.PAUSED:
            self.given_up = self._pausing
            return Event.STOP if self._pausing else Event.NEXT
        return {
            State.FADING: Event.FADED,
            State.SETTLING: Event.SETTLED,
            State.STOPPING: Event.ZERO,
            State.RESTING: Event.RESTED,
        }[self.state]

    def _handle(self, event: Event) -> None:
        """Go where the table says and set up what that state needs."""
        before, self.state = self.state, TRANSITIONS[self.state, event]
        if before is self.state and event in (Event.STOP, Event.CUT):
            return
        if event in (Event.STOP, Event.CUT, Event.LAST):
            self.steering, self._steered = False, None
        if before in MOVING and (before is State.HOLDING or self.state not in MOVING):
            n = self.position - self.step.first_sample
            if n > 0:
                settle = self.step.settle_samples if before is State.HOLDING else n
                self.marks.append(replace(self.step, n_samples=n, settle_samples=settle))
        clock = self.programme.clock
        if self.state is State.FADING:
            planned = self.programme.steps[self.step.index + 1]
            self.step = planned.placed(clock, clock.cycle_after(self.position), planned.settle_cycles)
            target = self._amplitudes(self.step.gamma)
            self._set_fade(Fade(self.position, self.step.fade_samples, self._planned.end, target))
            self._until = self.position + self.step.fade_samples
        elif self.state is State.SETTLING:
            self._until = _OPEN_END if self._controlled else self.step.first_sample + self.step.settle_samples
        elif self.state is State.HOLDING:
            self._until = self.step.end_sample
        elif self.state is State.PAUSED:
            self._until = self.position + round(LONGEST_PAUSE_S * self.programme.rate_hz)
        elif self.state is State.STOPPING:
            self._set_fade(Fade(self.position, stop_fade_samples(clock), self._fade.at(self.position), self._zero))
            self._until = self.position + self._fade.n_samples
        elif self.state is State.RESTING:
            if event is Event.CUT:
                self._set_fade(Fade(self.position, 0, self._zero, self._zero))
            self._until = self.position + clock.cycle_start(1)


def largest_block(clock: PhaseClock, wanted: int) -> int:
    """Samples a block may have so that a stop is seen within a quarter of a cycle; at most ``wanted``."""
    return max(1, min(wanted, clock.den // (BLOCKS_PER_CYCLE * clock.num)))


def change_rows(setup: Setup, fades: Sequence[Fade]) -> NDArray[np.void]:
    """`DRIVE_DTYPE` rows of ``fades``: one a tone."""
    multiples = [m for m, _ in setup.forcing.displacement_tones()]
    rows = [
        (fade.first_sample, fade.n_samples, multiple, start.real, start.imag, end.real, end.imag)
        for fade in fades
        for multiple, start, end in zip(multiples, fade.start, fade.end, strict=True)
    ]
    return np.array(rows, DRIVE_DTYPE)
