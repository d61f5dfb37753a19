"""Setup of a measurement: channels, scales, coupling, ball, declared effects, local g, and the age of its calibrations.

Stored, resolved, in every recording, so that the analysis needs no rig. Every number that scales a measurement is a
`Quantity` that can carry its uncertainty, date and source; nothing is guessed. A calibration that is missing or expired
is a warning that changes nothing: a recording is judged by the day it was made, a run by today.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Iterator
from typing import Self

from pydantic import Field, model_validator

from daq.channels.registry import Channels
from daq.setup.values import STANDARD_GRAVITY_MPS2, Frozen, PositiveQuantity, Quantity, QuantityTable, quantity

FAR_OUTSIDE = 10.0  # multiple of a channel's range beyond which a reading is no measurement


class Sampling(Frozen):
    """Sampling of all channels."""

    rate_hz: float = Field(default=20000.0, gt=0, description="samples a second, of every channel")

    @property
    def stated(self) -> bool:
        """Whether the rate is given, rather than left at its default."""
        return "rate_hz" in self.model_fields_set


class Forcing(Frozen):
    """Plate displacement ``A [b1 sin(wt + p1) + b2 sin(c wt + p2)]``; the defaults are the paper's superposition."""

    frequency_hz: float = Field(gt=0, description="of the first tone")
    ratio: int = Field(default=1, ge=1, description="c, the second tone's multiple of the first")
    amplitude: tuple[float, float] = Field(default=(1.0, 1.0), description="b1, b2: displacement relative to A")
    phase_deg: tuple[float, float] = Field(default=(0.0, 0.0), description="p1, p2")

    @model_validator(mode="after")
    def _moves(self) -> Self:
        """Refuse tones that cancel: `gamma` would mean nothing."""
        size = sum(abs(amplitude) for _, amplitude in self.displacement_tones())
        if size < 1e-9:
            raise ValueError("the two tones cancel: amplitude and phase_deg must leave the plate a motion")
        if not size <= 1e9:
            raise ValueError("amplitude is relative to A: at most 1e9 together")
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

    @property
    def multiples(self) -> tuple[int, ...]:
        """Multiples of the first tone at which the plate is driven, in order."""
        return tuple(sorted(multiple for multiple, _ in self.displacement_tones()))

    def multiples_at(self, ratio: int) -> tuple[int, ...]:
        """The same for a step of a recording whose c may be another one."""
        return self.multiples if ratio == self.ratio else tuple(sorted({1, ratio}))


class ToneScale(Frozen):
    """Scale from drive volts to plate acceleration of one tone."""

    g_per_volt: PositiveQuantity
    phase_deg: Quantity = quantity(0.0)


class Drive(Frozen):
    """Scale from drive volts to plate acceleration (in units of the local g, positive up), flat over the tones
    unless the second one has a scale of its own.

    ``a_p / g = g_per_volt * exp(i phase) * drive_v``, for each tone; ``g_per_volt = None``: not measured.
    """

    g_per_volt: PositiveQuantity | None = None
    phase_deg: Quantity = quantity(0.0)
    second: ToneScale | None = Field(default=None, description="of the second tone, where it is not the first's")
    highpass_hz: float | None = Field(
        default=None, gt=0, description="corner of the output's coupling capacitor; the drive is asked for so much more"
    )

    def scale(self, multiple: int) -> Drive | ToneScale:
        """Table that holds for the tone at ``multiple`` of the forcing."""
        return self.second if self.second is not None and multiple > 1 else self

    def response(self, multiple: int) -> complex | None:
        """Plate acceleration in g for a volt of the tone at ``multiple`` of the forcing; None: not measured."""
        scale = self.scale(multiple)
        if scale.g_per_volt is None:
            return None
        phase = math.radians(scale.phase_deg.value)
        return scale.g_per_volt.value * complex(math.cos(phase), math.sin(phase))


class Ball(Frozen):
    """The block on its rod."""

    mass_kg: float = Field(gt=0, description="of what moves: the block and what is fixed to it")


class Setup(Frozen):
    """The measuring part of a rig profile, resolved."""

    name: str = Field(description="of the rig, in recordings and reports")
    description: str = Field(default="", description="in your words")
    g_mps2: PositiveQuantity = quantity(STANDARD_GRAVITY_MPS2, 1e-3)
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


def quantities(setup: Setup) -> Iterator[tuple[str, str, QuantityTable | None]]:
    """Quantities that can be calibrated: ``(kind of bench calibrate or empty, dotted key, quantity or None)``."""
    channels, drive = setup.channels.recorded(), setup.drive
    rows = {
        name: [(channel.calibrated_by, f"channels.{name}.{key}", q) for key, q in channel.calibrations().items()]
        for name, channel in channels.items()
    }
    yield from rows.pop("accelerometer")
    yield "drive", "drive.g_per_volt", drive.g_per_volt
    yield "drive", "drive.phase_deg", drive.phase_deg
    if drive.second is not None:
        yield "drive", "drive.second.g_per_volt", drive.second.g_per_volt
        yield "drive", "drive.second.phase_deg", drive.second.phase_deg
    for others in rows.values():
        yield from others


def calibration_warnings(setup: Setup, on: datetime.date) -> list[str]:
    """One sentence for each kind of calibration that is missing or too old on the day ``on``."""
    missing: dict[str, list[str]] = {}
    expired: dict[str, list[str]] = {}
    for kind, key, scale in quantities(setup):
        if scale is None or scale.date is None:
            missing.setdefault(kind, []).append(key)
        elif (on - scale.date).days > setup.calibration_days:
            expired.setdefault(kind, []).append(f"{key} ({scale.date})")
    late = f"calibrated more than {setup.calibration_days} days before"
    return [
        f"{words}: {', '.join(keys)}; "
        + (f"bench calibrate {kind} --into PROFILE" if kind else "write value, date and source into the profile")
        for words, found in (("never calibrated", missing), (late, expired))
        for kind, keys in found.items()
    ]


def warnings_at_start(setup: Setup, started: str) -> list[str]:
    """`calibration_warnings` on the day a recording was begun.

    ``started`` is the recording's attribute, ISO 8601; empty where the file lacks it, then today counts.
    """
    today = datetime.datetime.now(datetime.UTC).date()
    return calibration_warnings(setup, datetime.date.fromisoformat(started[:10]) if started else today)
