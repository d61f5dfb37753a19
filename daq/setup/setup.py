"""Setup of a measurement: channels, scales, coupling, the ball, declared effects, local g.

Stored, resolved, in every recording, so that the analysis needs no rig. Every number that scales a measurement is a
`Quantity` that can carry its uncertainty, date and source; nothing is guessed.
"""

from __future__ import annotations

import datetime
import math
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

STANDARD_GRAVITY_MPS2 = 9.80665
FAR_OUTSIDE = 10.0  # multiple of a channel's range beyond which a reading is no measurement

ACCELEROMETER_UNITS_V_PER_MPS2: dict[str, float] = {
    "V/g": 1.0 / STANDARD_GRAVITY_MPS2,
    "mV/g": 1e-3 / STANDARD_GRAVITY_MPS2,
    "V/(m/s^2)": 1.0,
    "mV/(m/s^2)": 1e-3,
}


class Frozen(BaseModel):
    """Strict and immutable: an unknown key, a wrong type or a non-finite number is refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def _bare_number(value: Any) -> Any:
    """Let a profile write ``x = 0.3`` for ``x = {value = 0.3}``."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return {"value": value}
    return value


def _iso_date(value: Any) -> Any:
    """Take ``2026-11-20`` as text for the date it writes."""
    try:
        return datetime.date.fromisoformat(value) if isinstance(value, str) else value
    except ValueError:
        raise ValueError("wanted a date as 2026-11-20") from None


class QuantityTable(Frozen):
    """A number with its uncertainty, date and source."""

    value: float
    uncertainty: float = Field(default=0.0, ge=0.0, description="one standard deviation, in the unit of the value")
    date: Annotated[datetime.date | None, BeforeValidator(_iso_date)] = None
    source: str = ""

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Editors accept the bare number as well."""
        return {"anyOf": [{"type": "number"}, handler.resolve_ref_schema(handler(core_schema))]}


Quantity = Annotated[QuantityTable, BeforeValidator(_bare_number)]


def _positive_quantity(quantity: QuantityTable) -> QuantityTable:
    """Refuse a scale that is not greater than zero."""
    if quantity.value <= 0.0:
        raise ValueError(f"wanted a value greater than 0, came {quantity.value:g}")
    return quantity


PositiveQuantity = Annotated[Quantity, AfterValidator(_positive_quantity)]


def _q(value: float, uncertainty: float = 0.0) -> QuantityTable:
    return QuantityTable(value=value, uncertainty=uncertainty)


class Sampling(Frozen):
    """Sampling of all channels."""

    rate_hz: float = Field(default=20000.0, gt=0)

    @property
    def stated(self) -> bool:
        """Whether the rate is given, rather than left at its default."""
        return "rate_hz" in self.model_fields_set


class Forcing(Frozen):
    """Plate displacement ``A [b1 sin(wt + p1) + b2 sin(c wt + p2)]``; the defaults are the paper's superposition."""

    frequency_hz: float = Field(gt=0)
    ratio: int = Field(default=1, ge=1, description="c, the second tone's multiple of the first")
    amplitude: tuple[float, float] = Field(default=(1.0, 1.0), description="b1, b2: displacement relative to A")
    phase_deg: tuple[float, float] = (0.0, 0.0)

    @model_validator(mode="after")
    def _moves(self) -> Self:
        """Refuse tones that cancel: `gamma` would mean nothing."""
        if sum(abs(amplitude) for _, amplitude in self.displacement_tones()) < 1e-9:
            raise ValueError("the two tones cancel: amplitude and phase_deg must leave the plate a motion")
        return self

    def displacement_tones(self) -> tuple[tuple[int, complex], ...]:
        """Tones of ``x_p / A`` as ``(multiple, amplitude)``, meaning ``Re[amplitude exp(i multiple w t)]``.

        At c = 1 the two tones are one: only their complex sum exists.
        """
        b, p = self.amplitude, [math.radians(d) for d in self.phase_deg]
        first, second = (-1j * bi * complex(math.cos(pi), math.sin(pi)) for bi, pi in zip(b, p, strict=True))
        if self.ratio == 1:
            return ((1, first + second),)
        return ((1, first), (self.ratio, second))


class ToneScale(Frozen):
    """Scale from drive volts to plate acceleration of one tone."""

    g_per_volt: PositiveQuantity
    phase_deg: Quantity = _q(0.0)


class Drive(Frozen):
    """Scale from drive volts to plate acceleration (in units of the local g, positive up), flat over the tones
    unless the second one has a scale of its own.

    ``a_p / g = g_per_volt * exp(i phase) * drive_v``, for each tone; ``g_per_volt = None``: not measured.
    """

    g_per_volt: PositiveQuantity | None = None
    phase_deg: Quantity = _q(0.0)
    second: ToneScale | None = Field(default=None, description="of the second tone, where it is not the first's")
    highpass_hz: float | None = Field(
        default=None, gt=0, description="corner of the output's coupling capacitor; the drive is asked for so much more"
    )

    def response(self, multiple: int) -> complex | None:
        """Plate acceleration in g for a volt of the tone at ``multiple`` of the forcing; None: not measured."""
        scale = self.second if self.second is not None and multiple > 1 else self
        if scale.g_per_volt is None:
            return None
        phase = math.radians(scale.phase_deg.value)
        return scale.g_per_volt.value * complex(math.cos(phase), math.sin(phase))


class ContinuityChannel(Frozen):
    """The contact circuit: ``open_v`` in the air, ``closed_v`` in contact."""

    terminal: str = ""
    coupling: Literal["dc", "ac"] = "dc"
    range_v: float = Field(default=10.0, gt=0)
    open_v: Quantity = _q(5.0)
    closed_v: Quantity = _q(0.0)
    serial_number: str = ""

    @property
    def swing_v(self) -> float:
        """From closed to open."""
        return self.open_v.value - self.closed_v.value

    @property
    def middle_v(self) -> float:
        """Half way between the two levels."""
        return 0.5 * (self.open_v.value + self.closed_v.value)

    @model_validator(mode="after")
    def _levels(self) -> Self:
        """Refuse levels that cannot be distinguished or read."""
        open_v, closed_v = self.open_v.value, self.closed_v.value
        if open_v == closed_v:
            raise ValueError(f"open_v and closed_v are both {open_v:g} V: contact could not be told from flight")
        if max(abs(open_v), abs(closed_v)) > self.range_v:
            raise ValueError(f"open_v or closed_v lies outside range_v = {self.range_v:g} V")
        return self


class AccelerometerChannel(Frozen):
    """The plate's accelerometer: ``volts = offset_v + sensitivity * sign * (a_p + g if reads_gravity)``."""

    terminal: str = ""
    coupling: Literal["dc", "ac"] = "dc"
    range_v: float = Field(default=10.0, gt=0)
    sensitivity: PositiveQuantity
    unit: Literal["V/g", "mV/g", "V/(m/s^2)", "mV/(m/s^2)"]
    offset_v: Quantity | None = Field(default=None, description="reading at zero; left out: unknown")
    reads_gravity: bool = False
    sign: Literal[-1, 1] = 1
    serial_number: str = ""

    @property
    def volts_per_mps2(self) -> float:
        """Signed sensitivity in V/(m/s^2); the unit's g is the standard gravity of data sheets."""
        return self.sign * self.sensitivity.value * ACCELEROMETER_UNITS_V_PER_MPS2[self.unit]


class DriveChannel(Frozen):
    """The looped-back drive voltage."""

    terminal: str = ""
    coupling: Literal["dc", "ac"] = "dc"
    range_v: float = Field(default=10.0, gt=0)
    serial_number: str = ""


class Channels(Frozen):
    """The recorded channels; continuity may be absent (then only the plate is analysed)."""

    continuity: ContinuityChannel | None = ContinuityChannel()
    accelerometer: AccelerometerChannel
    drive: DriveChannel = DriveChannel()


class Ball(Frozen):
    """The block on its rod."""

    mass_kg: float = Field(gt=0)


class Setup(Frozen):
    """The measuring part of a rig profile, resolved."""

    name: str
    description: str = ""
    g_mps2: PositiveQuantity = _q(STANDARD_GRAVITY_MPS2, 1e-3)
    sampling: Sampling = Sampling()
    forcing: Forcing
    drive: Drive = Drive()
    channels: Channels
    ball: Ball
    calibration_days: int = Field(default=365, ge=1, description="age from which a calibration is warned about")
    declared: dict[str, dict[str, Quantity]] = Field(
        default_factory=dict, description="known effects by name, each with its parameters"
    )

    def declared_values(self) -> dict[str, dict[str, float]]:
        """Declared effects as plain numbers, for `model.effects`."""
        return {name: {key: q.value for key, q in table.items()} for name, table in self.declared.items()}
