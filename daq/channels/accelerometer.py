"""The accelerometer on the plate. `analysis.plate` fits its tones, `analysis.events` dates impacts by it."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from daq.channels.base import Channel, Scale
from daq.setup.values import STANDARD_GRAVITY_MPS2, PositiveQuantity, Quantity, QuantityTable

ACCELEROMETER_UNITS_V_PER_MPS2: dict[str, float] = {
    "V/g": 1.0 / STANDARD_GRAVITY_MPS2,
    "mV/g": 1e-3 / STANDARD_GRAVITY_MPS2,
    "V/(m/s^2)": 1.0,
    "mV/(m/s^2)": 1e-3,
}


class AccelerometerChannel(Channel):
    """The plate's accelerometer: ``volts = offset_v + sensitivity * sign * (a_p + g if reads_gravity)``."""

    long_name: ClassVar[str] = "plate accelerometer voltage"
    aliases: ClassVar[frozenset[str]] = frozenset(
        {"accelerometer", "acceleration", "accel", "acc", "plateacceleration", "plate"}
    )
    calibrated_by: ClassVar[str] = "accelerometer"

    sensitivity: PositiveQuantity
    unit: Literal["V/g", "mV/g", "V/(m/s^2)", "mV/(m/s^2)"] = Field(description="of sensitivity")
    offset_v: Quantity | None = Field(default=None, description="reading at zero; left out: unknown")
    reads_gravity: bool = Field(default=False, description="whether it reads g at rest")
    sign: Literal[-1, 1] = Field(default=1, description="-1: it reads less when the plate is accelerated up")

    @property
    def volts_per_mps2(self) -> float:
        """Signed sensitivity in V/(m/s^2); the unit's g is the standard gravity of data sheets."""
        return self.sign * self.sensitivity.value * ACCELEROMETER_UNITS_V_PER_MPS2[self.unit]

    def scale(self) -> Scale:
        """Plate acceleration; a zero that is not known counts as 0 V."""
        zero_v = self.offset_v.value if self.offset_v is not None else 0.0
        return Scale(1.0 / self.volts_per_mps2, zero_v, "m/s\u00b2")

    def calibrations(self) -> dict[str, QuantityTable | None]:
        """Sensitivity, and the zero where the coupling lets it through."""
        offset: dict[str, QuantityTable | None] = {"offset_v": self.offset_v} if self.coupling == "dc" else {}
        return {"sensitivity": self.sensitivity} | offset
