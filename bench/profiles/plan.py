"""The programme of a profile's ramp, the peaks of its steps, and the limits that they would exceed."""

from __future__ import annotations

from daq.setup.errors import InputError
from rig.profile import Profile
from rig.programme.ramp import Peaks, Programme, Step, forbidden, peaks, plan


def planned(profile: Profile) -> tuple[Programme, list[tuple[Step, Peaks]], list[str]]:
    """The programme, each step with its peaks, and one line for each limit that a step would exceed."""
    programme = plan(profile)
    by_gamma = {gamma: peaks(profile, gamma) for gamma in {step.gamma for step in programme.steps}}
    rows = [(step, by_gamma[step.gamma]) for step in programme.steps]
    faults = [line for step, asked in rows for line in forbidden(profile.limits, step, asked)]
    return programme, rows, faults


def refusal(profile: str, faults: list[str]) -> str:
    """The message that refuses a ramp."""
    shown = "\n".join(f"  {line}" for line in faults[:20])
    more = f"\n  and {len(faults) - 20} more" if len(faults) > 20 else ""
    return f"{profile}: limits forbid this ramp; lower ramp.gamma or change [limits]\n{shown}{more}"


def refuse_forbidden(name: str, profile: Profile) -> None:
    """Refuse a ramp that a limit forbids; ``name`` is how it was called.

    Raises `InputError` with the step and the limit.
    """
    if faults := planned(profile)[2]:
        raise InputError(refusal(name, faults))
