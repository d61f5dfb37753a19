"""What an operator asks of a run, and what the run tells: the only words between them, whoever stands in between."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from daq.setup.errors import InputError
from rig.programme.ramp import NextSteps, Step
from rig.programme.sequencer import State, Stop


class StopRequest:
    """What the operator asks of a run, by a signal, a page, a terminal or a test; the strongest stop counts.

    Parameters
    ----------
    check
        Raises `daq.setup.errors.InputError` for next steps that cannot be driven. None where nothing follows a run
        but its end.

    Attributes
    ----------
    wanted, why
        The stop asked for, and the reason that the recording keeps.
    then
        What is to be driven after that stop; None where it is the end.
    pause
        Whether to pause at the end of the present step.
    notes
        Texts to record with the sample at which they are read; the run empties the list.
    """

    def __init__(self, check: Callable[[NextSteps], object] | None = None) -> None:
        self._check = check
        self.wanted: Stop | None = None  # the stop asked for
        self.why = ""  # its reason, which the recording keeps
        self.then: NextSteps | None = None  # what is to be driven after that stop; None where it is the end
        self.pause = False  # whether to pause at the end of the present step
        self.notes: list[str] = []  # to record with the sample at which they are read; the run empties the list

    def ask(self, how: Stop, why: str, then: NextSteps | None = None) -> None:
        """Ask for a stop; a weaker request than the present one is ignored, of equal ones the last counts."""
        if self.wanted is None or how >= self.wanted:
            self.wanted, self.why, self.then = how, why, then

    @property
    def leads(self) -> bool:
        """Whether a person may choose what is driven next."""
        return self._check is not None

    def hold(self, who: str, why: str = "") -> None:
        """Hold the drive as it is at the end of the present step, until asked to go on; recorded as a note."""
        self._pause(True, f"{who}: hold after this step", why)

    def go_on(self, who: str, why: str = "") -> None:
        """Go on after a hold; recorded as a note."""
        self._pause(False, f"{who}: go on", why)

    def take_over(self, who: str, steps: NextSteps) -> None:
        """Finish the present step, then drive ``steps`` instead of what is left (raises InputError: it cannot be)."""
        if self._check is None:
            raise InputError("steps to be driven next: a ramp drives what was planned; stop it and start another")
        if steps.gammas:
            self._check(steps)
        words = _with_reason(
            f"{who}: step finished, {'own steps' if steps.gammas else 'another choice'} next", steps.why
        )
        self.ask(Stop.FINISH_STEP, words, steps)

    def _pause(self, wanted: bool, words: str, why: str) -> None:
        if wanted is not self.pause:
            self.pause = wanted
            self.notes = [*self.notes, _with_reason(words, why)]


def _with_reason(words: str, why: str) -> str:
    return f"{words}: {why}" if why else words


@dataclass(frozen=True)
class Status:
    """State of a run after a block.

    ``achieved_gamma`` and its uncertainty are those of the last step held (NaN before). ``limits_in_use`` is the used
    part of each limit that is known, ``contact_age_cycles`` the time since the last contact or impact.
    ``left_samples`` are those still to be driven; they stand still through a pause.
    """

    state: State
    step: Step
    n_steps: int
    sample: int
    n_samples: int
    left_samples: int
    plate_mps2: float
    limits_in_use: Mapping[str, float]
    contact_age_cycles: float
    achieved_gamma: float
    achieved_gamma_uncertainty: float
    lost_samples: int


@dataclass(frozen=True)
class RunSummary:
    """Outcome of a run; ``asked`` where the operator ended it, and nothing else did.

    ``let_go`` says why a ball that was to be held on a branch was let go, or that it never was held; empty where it was
    held to the end.
    """

    how: Literal["complete", "stopped", "failed"]
    why: str
    asked: bool
    n_samples: int
    steps_driven: int
    steps_planned: int
    lost_samples: int
    wall_s: float
    let_go: str = ""
