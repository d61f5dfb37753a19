"""Blocks of steps that a rig drives one after another: what one is, how it ended, and which may be driven.

A block is a short ramp of its own, within the same limits as any other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.profiles.edit import with_values
from bench.profiles.plan import planned, refuse_forbidden
from daq.recording import open_recording
from daq.setup.errors import InputError
from rig.profile import Profile, parse_profile
from rig.programme.forcing import stop_fade_samples
from rig.programme.ramp import NextSteps, plan

if TYPE_CHECKING:
    from analysis.explore.choice import Option
    from analysis.residuals.values import ParameterId

LEAST_STEPS = 2  # held, of a block that is gone on with


@dataclass(frozen=True)
class Aims:
    """When to stop, and what may be changed."""

    budget_s: float  # rig time
    # standard deviation asked for, by effect and parameter
    until: Mapping[ParameterId, float] = field(default_factory=dict)
    # size down to which "nothing missing" is to be shown, in units of the size at which each effect would
    # matter
    limit: float = 1.0
    ratios: tuple[int, ...] = (1, 2, 3)  # values of c that may be driven
    frequencies_hz: tuple[float, ...] = ()  # of the first tone, that may be driven
    steps: int = 4  # of each block
    hold_cycles: int = 14  # of each step
    # waited after each fade. The plate must settle, the ball need not: each flight is judged from the event
    # before.
    settle_cycles: int = 4


@dataclass(frozen=True)
class Chosen:
    """A block to be driven: its profile as text, its rig time, and the reason in words."""

    text: str
    seconds: float
    reason: str


@dataclass(frozen=True)
class Driven:
    """The end of a block."""

    why: str = ""  # why it was not completed; empty where it was
    then: NextSteps | None = None  # what the person who ended it wants driven next; None where that is nothing more


def by_person(block: Chosen, wanted: NextSteps) -> Chosen:
    """The block with a person's steps; raises `InputError` where a limit forbids one."""
    ratio = {} if wanted.ratio is None else {"forcing.ratio": wanted.ratio}
    changes = _in_order(wanted.gammas) | ratio | {"stake": None}  # other steps are another prediction
    text = with_values(block.text, changes, "the block")
    profile = parse_profile(text, "the block")
    refuse_forbidden("these gammas", profile)
    why = f"chosen by a person{f', {wanted.why}' if wanted.why else ''}"
    return Chosen(text, run_seconds(profile), f"{forcing_in_words(profile)}: {why}")


def forcing_in_words(profile: Profile) -> str:
    """The forcing of a block in words."""
    forcing, ramp = profile.forcing, profile.ramp
    listed = ", ".join(f"{g:g}" for g in ramp.gammas())
    return f"c = {forcing.ratio}, {forcing.frequency_hz:g} Hz, gamma {listed}"


def tells(path: Path) -> bool:
    """Whether enough steps of a block were held to their end."""
    with open_recording(path) as opened:
        steps = opened.steps
        whole = steps["first_sample"] + steps["n_samples"] <= opened.n_samples
        held = whole & (steps["settle_samples"] < steps["n_samples"])
        return int(np.count_nonzero(held)) >= LEAST_STEPS


def as_driven(path: Path) -> Chosen:
    """The block that a recording holds."""
    with open_recording(path) as opened:
        reason = str(opened.attrs["extra"].get("chosen_because", "recorded before"))
        return Chosen(str(opened.attrs.get("profile_text", "")), opened.n_samples / opened.rate_hz, reason)


# -- what may be driven ------------------------------------------------------------------------------------------------
def offers(text: str, aims: Aims) -> list[Option]:
    """Every forcing that may be driven, up and down, with the gammas that the limits allow.

    Raises `InputError` where the limits allow none.
    """
    from analysis.explore.choice import Option

    profile = parse_profile(text, "profile")
    found = []
    for ratio in aims.ratios:
        for frequency_hz in aims.frequencies_hz or (profile.forcing.frequency_hz,):
            allowed = [g for g in _gammas(profile, ratio) if _allowed(text, aims, ratio, frequency_hz, g)]
            if len(allowed) < aims.steps:
                continue
            for gammas in (allowed, allowed[::-1]):
                whole = parse_profile(block_text(text, aims, ratio, frequency_hz, gammas))
                found.append(Option(whole.setup(), tuple(gammas), aims.hold_cycles, partial(_part_seconds, whole)))
    if not found:
        raise InputError(
            f"the limits of this profile allow no block of {aims.steps} steps: raise [limits], or give fewer"
        )
    return found


def _gammas(profile: Profile, ratio: int) -> list[float]:
    """Gammas for a ratio: the range of the profile's ramp over its take-off, and farther."""
    own = profile.ramp.gammas()
    takeoff, own_takeoff = (0.5 if c == 1 else 1.0 / (1.0 + c**2) for c in (ratio, profile.forcing.ratio))
    scale = takeoff / own_takeoff
    # from just above take-off to half as far again as the profile's own ramp
    low, high = max(min(own) * scale, 1.1 * takeoff), 1.5 * max(own) * scale
    return [float(f"{g:.4g}") for g in np.linspace(low, high, 10)]


def block_text(text: str, aims: Aims, ratio: int, frequency_hz: float, gammas: Sequence[float]) -> str:
    """The profile ``text`` with the ramp of a block, its gammas in the order given."""
    return with_values(text, {
        "forcing.ratio": ratio,
        "forcing.frequency_hz": frequency_hz,
        **_in_order(gammas),
        "ramp.hold_cycles": aims.hold_cycles,
        "ramp.settle_cycles": aims.settle_cycles,
    }, "the profile")  # fmt: skip


def _in_order(gammas: Sequence[float]) -> dict[str, Any]:
    """The steps of a ramp, up or down as they are given."""
    return {"ramp.gamma": list(gammas), "ramp.order": "down" if gammas[-1] < gammas[0] else "up"}


def _allowed(text: str, aims: Aims, ratio: int, frequency_hz: float, gamma: float) -> bool:
    """Whether the rig's limits allow a step."""
    try:
        return not planned(parse_profile(block_text(text, aims, ratio, frequency_hz, [gamma])))[2]
    except InputError:
        return False


def _part_seconds(whole: Profile, places: Sequence[int]) -> float:
    """Rig time of a block with only some steps of ``whole``, its fades and the end at rest included."""
    gammas = whole.ramp.gammas()
    ramp = whole.ramp.model_copy(update={"gamma": tuple(gammas[i] for i in places), "order": None})
    return run_seconds(whole.model_copy(update={"ramp": ramp}))


def run_seconds(profile: Profile) -> float:
    """Rig time of a profile's ramp, from the first sample to rest."""
    programme = plan(profile)
    rest = stop_fade_samples(programme.clock) + programme.clock.cycle_start(1)
    return (programme.n_samples + rest) / programme.rate_hz
