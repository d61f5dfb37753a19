"""Options of a sound card with a serial DAQ."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from rig.backends.kinds.base import BackendKind
from rig.backends.kinds.soundcard import CardOptions


class SoundcardSerialOptions(CardOptions):
    """A sound card that plays the drive and a serial device that records the channels; ``inputs`` is not used."""

    required: ClassVar[tuple[str, ...]] = ("device", "port")

    kind: Literal["soundcard+serial"] = "soundcard+serial"
    port: str = Field(default="", description="the port's name")
    baud: int = Field(default=2_000_000, gt=0, description="bits a second")


BACKEND = BackendKind(SoundcardSerialOptions, "rig.backends.serial_daq:open_soundcard_serial")
