"""A displacement sensor on the plate that looks at the ball, as a laser.

It is stored, exported and drawn; no verdict reads it.
"""

from __future__ import annotations

from typing import ClassVar

from daq.channels.base import Channel, Scale
from daq.setup.values import PositiveQuantity, Quantity, QuantityTable, quantity


class DisplacementChannel(Channel):
    """Height of the ball above the plate: ``volts = offset_v + v_per_m * height``."""

    long_name: ClassVar[str] = "height of the ball above the plate, voltage of a displacement sensor"
    aliases: ClassVar[frozenset[str]] = frozenset({"displacement", "laser", "height", "ballheight"})

    v_per_m: PositiveQuantity  # required: a scale that is assumed would be believed
    offset_v: Quantity = quantity(0.0)

    def scale(self) -> Scale:
        """Height in millimetres."""
        return Scale(1e3 / self.v_per_m.value, self.offset_v.value, "mm")

    def calibrations(self) -> dict[str, QuantityTable | None]:
        """Scale and zero."""
        return {"v_per_m": self.v_per_m, "offset_v": self.offset_v}
