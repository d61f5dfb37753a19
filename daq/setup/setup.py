"""Setup of a measurement: channels, scales, coupling, ball, declared effects, local g, calibrations' ages; its stake.

Stored, resolved, in every recording, so that the analysis needs no rig. Every number that scales a measurement is a
`Quantity` that can carry its uncertainty, date and source; nothing is guessed. A calibration that is missing or expired
is a warning that changes nothing: a recording is judged by the day it was made, a run by today.

The table ``[stake]`` says what a named cause predicts of the ramp, written before that is run: as a recording holds its
profile's text, a run that was staked on carries its own prediction.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Iterator
from typing import Self

from pydantic import Field, model_validator

from daq.channels.registry import Channels
from daq.setup.values import (
    STANDARD_GRAVITY_MPS2,
    Frozen,
    PositiveQuantity,
    Quantity,
    QuantityTable,
    parse_toml,
    quantity,
)

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


class StakedParameter(Frozen):
    """A parameter at which the prediction is made."""

    effect: str
    parameter: str
    value: float = Field(description="in its own unit; a run that is held against it moves it no more")
    cause: bool = Field(description="whether it is of a named cause; else of an instrument or a calibration")


class StakedStep(Frozen):
    """What is predicted of one step: the median of measured minus predicted landings, each one flight ahead.

    Its interval holds the noise of earlier runs; the later run is judged with its own noise in its place.
    """

    gamma: float = Field(ge=0)
    within_us: float = Field(gt=0, description="half the interval about zero in which that median lies")
    rival_us: float | None = Field(
        default=None, description="where it would lie, if the strongest rival were right; left out: it lands elsewhere"
    )
    declared_us: float | None = Field(default=None, description="the same, if nothing but what is declared acted")
    flight_ms: float = Field(gt=0, description="mean flight time expected; no test, as it hangs on how a motion began")


class Stake(Frozen):
    """A frozen prediction: of landings one flight ahead, from the event measured before, so that chaos is no loss."""

    named: tuple[str, ...] = Field(min_length=1, description="effects that the verdict named")
    rival: tuple[str, ...] = Field(description="the strongest other explanation; empty: nothing but what is declared")
    nats: float = Field(ge=0, description="by which the run would speak against what is named, if the rival is right")
    chance: float = Field(gt=0, lt=1, description="probability that right causes miss one of the intervals")
    software: str = Field(description="version and commit of the program that predicted")
    written: str = Field(description="when, ISO 8601; only a run that began later can meet it")
    recordings: tuple[str, ...] = Field(description="that the verdict is on")
    parameters: tuple[StakedParameter, ...] = Field(min_length=1, description="at which the prediction is made")
    covariance: tuple[tuple[float, ...], ...] = Field(
        description="of the parameters, each in the library's scale of it, in their order"
    )
    steps: tuple[StakedStep, ...] = Field(min_length=1, description="what is predicted of each step of the ramp")

    @model_validator(mode="after")
    def _square(self) -> Self:
        """Refuse a covariance of other parameters."""
        n = len(self.parameters)
        if [len(row) for row in self.covariance] != [n] * n:
            raise ValueError(f"covariance: expected {n} rows of {n} numbers, one for each of the parameters")
        return self


class _WithStake(Frozen, extra="ignore"):
    """A profile of which only the stake is asked for."""

    stake: Stake | None = None


def stake_in(profile_text: str, name: str) -> Stake | None:
    """The stake in a profile's text; ``name`` stands for the file in messages (raises InputError: it does not fit)."""
    return parse_toml(profile_text, _WithStake, name).stake
