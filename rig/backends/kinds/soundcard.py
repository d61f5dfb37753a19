"""Options of a sound card."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from daq.channels.registry import Channels
from daq.setup.errors import InputError
from daq.setup.values import Frozen
from rig.backends.kinds.base import BackendKind, BackendOptions


class InputTable(Frozen):
    """Which input of a card each channel is wired to, counted from 1."""

    continuity: int = Field(default=1, ge=1, description="input of the contact circuit")
    accelerometer: int = Field(default=2, ge=1, description="input of the accelerometer")
    drive: int = Field(default=3, ge=1, description="input of the looped-back drive")
    displacement: int = Field(default=4, ge=1, description="input of the displacement sensor")

    def wired(self, channels: Channels) -> dict[str, int]:
        """Input of each channel that the profile records, in the order of a frame."""
        return {name: getattr(self, name) for name in channels.recorded()}


class CardOptions(BackendOptions):
    """A sound card that plays the drive."""

    required: ClassVar[tuple[str, ...]] = ("device",)

    device: str = Field(default="", description="words of the card's name, see `bench devices`")
    output: int = Field(default=1, ge=1, description="the output that drives the amplifier, from 1")
    output_range_v: float = Field(default=10.0, gt=0, description="volts at full scale of the output")
    inputs: InputTable = InputTable()
    buffer_s: float = Field(default=0.02, gt=0, le=1, description="drive handed over ahead of time")
    gate_port: str = Field(default="", description="serial port of a gate in the drive's way; empty: there is none")
    gate_limit: float = Field(
        default=1.0, gt=0, le=1, description="largest drive that the gate lets through, of its full scale"
    )
    gate_rate_hz: float = Field(default=20_000.0, ge=1000, le=200_000, description="samples a second of the gate")


class SoundcardOptions(CardOptions):
    """A sound card that plays the drive and records the channels."""

    kind: Literal["soundcard"] = "soundcard"


def card_options(options: BackendOptions) -> CardOptions:
    """``options``, which must be those of a sound card; raises `InputError`."""
    if not isinstance(options, CardOptions):
        raise InputError(f"backend.kind is {options.kind}; wanted a profile whose back end is a sound card")
    return options


BACKEND = BackendKind(SoundcardOptions, "rig.backends.soundcard:open_soundcard")
