"""What every kind of channel has: its names and its entry in a profile's ``[channels]``."""

from __future__ import annotations

from typing import ClassVar, Literal, NamedTuple

from pydantic import Field

from daq.setup.values import Frozen, QuantityTable


class Scale(NamedTuple):
    """A channel's reading in SI: ``(volts - zero_v) * per_volt``, in ``unit``."""

    per_volt: float
    zero_v: float
    unit: str


class Channel(Frozen):
    """A channel: one voltage, sampled."""

    long_name: ClassVar[str]
    """What is measured, for other readers of a recording."""
    aliases: ClassVar[frozenset[str]]
    """Names of its column in other people's files: letters and digits, lower case."""
    calibrated_by: ClassVar[str] = ""
    """Kind of ``bench calibrate`` that measures it; empty: none does."""

    terminal: str = Field(default="", description="the plug, in your words")
    coupling: Literal["dc", "ac"] = Field(default="dc", description="ac: capacitors in the input")
    range_v: float = Field(default=10.0, gt=0, description="volts at full scale of the input")
    serial_number: str = Field(default="", description="of the sensor")

    def scale(self) -> Scale | None:
        """Scale to SI; None where the channel does not say it by itself."""
        return None

    def calibrations(self) -> dict[str, QuantityTable | None]:
        """Quantities of the channel that can be calibrated, by key; None: not measured."""
        return {}
