"""What an operator asks of a run, and what the run tells: the only words between them, whoever stands in between."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from rig.programme.ramp import Step
from rig.programme.sequencer import State, Stop


class StopRequest:
    """What the operator asks of a run, by a signal, a page or a test; of several stops the strongest counts.

    Attributes
    ----------
    wanted, why
        The stop asked for, and the reason that the recording keeps.
    pause
        Whether to pause at the end of the present step.
    notes
        Texts to be kept with the sample at which they are read; the run empties the list.
    """

    def __init__(self) -> None:
        self.wanted: Stop | None = None
        self.why = ""
        self.pause = False
        self.notes: list[str] = []

    def ask(self, how: Stop, why: str) -> None:
        """Ask for a stop; a weaker request than the present one is ignored."""
        if self.wanted is None or how > self.wanted:
            self.wanted, self.why = how, why


@dataclass(frozen=True)
class Status:
    """State of a run after a block.

    ``achieved_gamma`` and its uncertainty are those of the last step held (NaN before). ``limits_in_use`` is the used
    part of each limit, ``contact_age_cycles`` the time since the last contact or impact.
    """

    state: State
    step: Step
    n_steps: int
    sample: int
    n_samples: int
    plate_mps2: float
    limits_in_use: Mapping[str, float]
    contact_age_cycles: float
    achieved_gamma: float
    achieved_gamma_uncertainty: float
    lost_samples: int


@dataclass(frozen=True)
class RunSummary:
    """Outcome of a run."""

    how: Literal["complete", "stopped", "failed"]
    why: str
    n_samples: int
    steps_driven: int
    steps_planned: int
    lost_samples: int
    wall_s: float
