"""The contact circuit between ball and plate. `analysis.events` dates its edges."""

from __future__ import annotations

from typing import ClassVar, Self

from pydantic import model_validator

from daq.channels.base import Channel, Scale
from daq.setup.values import Quantity, QuantityTable, quantity


class ContinuityChannel(Channel):
    """The contact circuit: ``open_v`` in the air, ``closed_v`` in contact."""

    long_name: ClassVar[str] = "contact circuit voltage"
    aliases: ClassVar[frozenset[str]] = frozenset(
        {"continuity", "contact", "contactcircuit", "circuit", "continuitycircuit", "cont"}
    )
    calibrated_by: ClassVar[str] = "contact"

    open_v: Quantity = quantity(5.0)
    closed_v: Quantity = quantity(0.0)

    @property
    def swing_v(self) -> float:
        """From closed to open."""
        return self.open_v.value - self.closed_v.value

    @property
    def middle_v(self) -> float:
        """Half way between the two levels."""
        return 0.5 * (self.open_v.value + self.closed_v.value)

    def scale(self) -> Scale | None:
        """0 closed, 1 open; an alternating voltage has no levels."""
        return Scale(1.0 / self.swing_v, self.closed_v.value, "0 closed, 1 open") if self.coupling == "dc" else None

    def calibrations(self) -> dict[str, QuantityTable | None]:
        """Both levels, where they are seen."""
        return {"closed_v": self.closed_v, "open_v": self.open_v} if self.coupling == "dc" else {}

    @model_validator(mode="after")
    def _levels(self) -> Self:
        """Refuse levels that cannot be distinguished or read."""
        open_v, closed_v = self.open_v.value, self.closed_v.value
        if open_v == closed_v:
            raise ValueError(
                f"open_v and closed_v are both {open_v:g} V: contact and flight could not be distinguished"
            )
        if max(abs(open_v), abs(closed_v)) > self.range_v:
            raise ValueError(
                f"open_v or closed_v lies outside range_v = {self.range_v:g} V; write a larger range_v here"
            )
        return self
