"""A rig profile: the setup of the measurement (`daq.setup.setup.Setup`), the ramp, the limits and the back end.

A profile is checked whole before anything uses it, and what a *rig* can do is said by its
``[limits]``, not by the parser: any frequency and any ratio c >= 1 are profiles (other people's rigs are not ours).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from daq.setup.setup import Setup, Stake
from daq.setup.values import Frozen, load_toml, parse_toml
from rig.backends.kinds.base import OptionsByKind
from rig.backends.kinds.simulated import SimulatedOptions

MAX_STEPS = 100_000
MOST_RATE_HZ = 1e6
"""Samples a second of a run; the sample path is measured at 200 kHz on four channels."""
MOST_RATIO = 1000
"""c of a run; the peaks of a step are sought at 512 points in each cycle of the fastest tone."""


class GammaTable(Frozen):
    """Evenly spaced gammas, both ends included."""

    start: float = Field(ge=0)
    stop: float = Field(ge=0)
    steps: int = Field(ge=1, le=MAX_STEPS)

    @model_validator(mode="after")
    def _one_step(self) -> Self:
        """Refuse a span that one step cannot cover."""
        if self.steps == 1 and self.start != self.stop:
            raise ValueError(f"one step cannot go from {self.start:g} to {self.stop:g}: give steps >= 2")
        return self

    def values(self) -> tuple[float, ...]:
        """The gammas, rounded where only binary noise is left (0.7, not 0.7000000000000001)."""
        return tuple(float(round(x, 12)) for x in np.linspace(self.start, self.stop, self.steps))


def _not_empty(gammas: tuple[float, ...]) -> tuple[float, ...]:
    if not 1 <= len(gammas) <= MAX_STEPS:
        raise ValueError(f"wanted 1 to {MAX_STEPS} gammas, came {len(gammas)}")
    return gammas


GammaList = Annotated[tuple[Annotated[float, Field(ge=0)], ...], AfterValidator(_not_empty)]
Gammas = Annotated[
    Annotated[GammaTable, Tag("table")] | Annotated[GammaList, Tag("list")],
    Discriminator(lambda value: "list" if isinstance(value, (list, tuple)) else "table"),
]


class RampTable(Frozen):
    """The amplitude programme as a person writes it; `rig.programme.ramp.Programme` is what comes of it."""

    gamma: Gammas = Field(description="{ start, stop, steps } or a list")
    order: Literal["up", "down", "up-and-down", "shuffled"] | None = Field(
        default=None, description="left out: up for a table, as written for a list"
    )
    seed: int = Field(default=0, ge=0, description="of the shuffled order")
    settle_cycles: int = Field(default=10, ge=0, description="cycles of the first tone waited after each fade")
    hold_cycles: int = Field(default=20, ge=1, description="cycles of the first tone measured in each step")
    slew_per_cycle: float = Field(default=0.1, gt=0, description="largest change of gamma in one cycle")

    def gammas(self) -> tuple[float, ...]:
        """Every step's gamma in the order of the run."""
        values = self.gamma.values() if isinstance(self.gamma, GammaTable) else self.gamma
        if self.order is None:
            return values
        up = tuple(sorted(values))
        if self.order == "shuffled":
            return tuple(up[i] for i in np.random.default_rng(self.seed).permutation(len(up)))
        return {"up": up, "down": up[::-1], "up-and-down": up + up[-2::-1]}[self.order]


class Limits(Frozen):
    """What must not be exceeded, each as a peak from rest."""

    drive_v: float = Field(gt=0, description="drive at the output")
    plate_mps2: float = Field(gt=0, description="plate acceleration")
    displacement_m: float = Field(gt=0, description="plate displacement")
    velocity_mps: float | None = Field(default=None, gt=0, description="plate velocity; left out: no limit")
    contact_cycles: int = Field(
        default=20, ge=0, description="longest time without a contact, or a flight where one must be; 0: unwatched"
    )


class BranchTable(Frozen):
    """Control-based continuation: the ball is held on the locked cycle, beyond where that is stable."""

    authority: float = Field(default=0.02, gt=0, le=0.2, description="largest correction, as a part of the drive")
    kick: float = Field(default=0.0, ge=0, le=0.02, description="of each held cycle, at random to both sides")
    seed: int = Field(default=0, ge=0, description="of the kicks")
    timing_s: float = Field(default=2e-6, gt=0, description="least standard uncertainty of a landing's time")


class ControlTable(Frozen):
    """The closed loop on the plate's measured amplitude; a profile without it drives open loop."""

    tolerance: float = Field(default=0.005, gt=0, lt=0.5, description="of each tone's amplitude, relative")
    tolerance_deg: float = Field(default=0.5, gt=0, lt=45, description="of each tone's phase")
    window_cycles: int = Field(default=8, ge=2, description="cycles of one measurement; a step needs two that agree")
    wait_cycles: int = Field(default=6, ge=0, description="cycles let pass after each change of the drive")
    max_cycles: int = Field(default=1000, ge=8, description="a step that has not settled by then stops the run")
    branch: BranchTable | None = Field(default=None, description="hold the ball on the locked cycle")


class Profile(Setup):
    """A whole profile: the measuring part, the ramp, the limits and the back end."""

    ramp: RampTable
    limits: Limits
    control: ControlTable | None = None
    stake: Stake | None = Field(default=None, description="what a named cause predicts of this ramp")
    backend: OptionsByKind = SimulatedOptions()

    @model_validator(mode="after")
    def _drivable(self) -> Self:
        """Refuse what cannot be driven: an unknown drive scale, too fast a tone, a marker beyond the drive's limit."""
        if self.drive.g_per_volt is None:
            raise ValueError("drive.g_per_volt: missing; a ramp cannot be driven without the drive's scale")
        if self.sampling.rate_hz > MOST_RATE_HZ:
            raise ValueError(
                f"sampling.rate_hz: wanted at most {MOST_RATE_HZ:g} to drive a ramp, came {self.sampling.rate_hz:g}; "
                "every sample passes the interlock and the recorder as it comes"
            )
        highest = self.forcing.multiples[-1]
        if highest > MOST_RATIO:
            raise ValueError(f"forcing.ratio: wanted at most {MOST_RATIO} to drive a ramp, came {highest}")
        highest_hz = self.forcing.frequency_hz * highest
        if highest_hz * 8 > self.sampling.rate_hz:
            raise ValueError(
                f"forcing: wanted at least 8 samples in a cycle of the fastest tone, came {highest_hz:g} Hz "
                f"at sampling.rate_hz = {self.sampling.rate_hz:g}"
            )
        if self.backend.marker_v > self.limits.drive_v:  # it is played before the run, and passes no clamp
            raise ValueError(
                f"backend.marker_v: the chirp that finds the loop-back has {self.backend.marker_v:g} V; limits.drive_v "
                f"allows {self.limits.drive_v:g}; lower it"
            )
        return self

    def setup(self) -> Setup:
        """Measuring part, which a recording keeps."""
        return Setup.model_validate(self.model_dump(include=set(Setup.model_fields)))


class _MeasuringProfile(Setup):
    """A profile of which only the measuring part is asked for; the rest is checked where it stands."""

    ramp: RampTable | None = None
    limits: Limits | None = None
    control: ControlTable | None = None
    stake: Stake | None = None
    backend: OptionsByKind | None = None


def load_profile(path: Path | str) -> tuple[Profile, str]:
    """Read a profile that can drive a rig; returns it with the file's text, which recordings keep.

    Raises `daq.setup.errors.InputError` when the file cannot be read or does not fit: the message lists every fault by
    its dotted key.
    """
    return load_toml(Path(path), Profile)


def parse_profile(text: str, name: str = "profile") -> Profile:
    """Check a profile's TOML ``text``; ``name`` stands for the file in messages (raises `InputError`)."""
    return parse_toml(text, Profile, name)


def load_setup(path: Path | str) -> tuple[Setup, str]:
    """Read the measuring part of a profile; the tables that drive may be absent (raises InputError)."""
    whole, text = load_toml(Path(path), _MeasuringProfile)
    return Setup.model_validate(whole.model_dump(include=set(Setup.model_fields), exclude_unset=True)), text


def json_schema() -> str:
    """The JSON Schema by which an editor completes and checks a profile, as text."""
    schema = Profile.model_json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "Rig profile"
    schema["properties"]["$schema"] = {"type": "string"}
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"
