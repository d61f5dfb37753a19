"""The instruments of a recording as values: measured properties, doubts about the profile, and both in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

STORED = "instrument_json"  # root attribute of a recording
DOUBT_KINDS = (
    "accelerometer_sense", "contact_sense", "drive_sense", "drive_phase", "exchanged", "tones", "bias", "scale", "dead",
    "contact", "resampled", "cut_off", "sweep",
)  # fmt: skip


@dataclass(frozen=True)
class Doubt:
    """A contradiction between a recording and its profile."""

    kind: str  # one of `DOUBT_KINDS`
    finding: str  # the contradiction, with its numbers
    cure: str  # what to write or to do
    makes_meaningless: bool  # whether a verdict on the model would be one on this contradiction

    @property
    def sentence(self) -> str:
        """Finding and cure."""
        return f"{self.finding}; {self.cure}"


@dataclass(frozen=True)
class Instrument:
    """Properties of the instruments, as the recording shows them; None where it does not."""

    rate_hz: float  # samples a second
    steps: int  # of the recording
    noise_mps2: float | None  # the accelerometer's noise away from impacts, rms over its whole band
    noise_mps2_rthz: float | None  # its density at the low end, m/s^2/Hz^0.5
    # frequency at which the power of that noise has fallen by half for good; None: flat to half the rate
    bandwidth_hz: float | None
    bias_v: float | None  # the accelerometer's mean over whole cycles
    tones_hz: tuple[float, ...]  # the forcing's tones in the loudest step
    tones_g: tuple[float, ...]  # their amplitudes in the accelerometer, units of g
    phase_deg: float | None  # plate after drive at the strongest tone, by the profile's sense; None without a drive
    takeoffs: int  # openings of the contact after a rest
    # median acceleration of the plate there, by the profile's sense and scale: -1 where both are right
    takeoff_g: float | None
    levels_v: tuple[float, float] | None  # lower and upper level of the contact circuit
    doubts: tuple[Doubt, ...] = ()  # contradictions to the profile
    # lowest and highest acceleration that the accelerometer shows, by the profile's sense and scale, where it
    # comes to its end there; None for one that it does not reach
    ends_g: tuple[float | None, float | None] = (None, None)

    @property
    def grave(self) -> tuple[Doubt, ...]:
        """Doubts that make a verdict meaningless."""
        return tuple(doubt for doubt in self.doubts if doubt.makes_meaningless)

    def as_json(self) -> dict[str, Any]:
        """Everything for a machine."""
        return asdict(self)

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> Self:
        """The instrument that `as_json` gave."""
        values: dict[str, Any] = {k: tuple(x) if isinstance(x, list) else x for k, x in stored.items()}
        return cls(**values | {"doubts": tuple(Doubt(**doubt) for doubt in values["doubts"])})

    def in_words(self) -> tuple[str, ...]:
        """The instruments, a line each for recording, accelerometer and contact."""
        each = [f"{hz:.5g} Hz ({g:.3g} g)" for hz, g in zip(self.tones_hz, self.tones_g, strict=True)]
        count = "a tone" if len(each) == 1 else f"{len(each)} tones"
        tones = f"{count} at {' and '.join(each)} in the loudest step" if each else "no tones found"
        lines = [f"{self.rate_hz:.6g} samples/s, {self.steps} steps, {tones}"]
        sensor = []
        if self.noise_mps2 is not None and self.noise_mps2_rthz is not None:
            flat = f"flat to {0.5e-3 * self.rate_hz:.3g} kHz"
            band = flat if self.bandwidth_hz is None else f"falling from {1e-3 * self.bandwidth_hz:.2g} kHz on"
            sensor.append(f"noise {self.noise_mps2:.2g} m/s^2 rms, {self.noise_mps2_rthz:.2g} m/s^2/Hz^0.5, {band}")
        if self.bias_v is not None:
            sensor.append(f"{self.bias_v:.4f} V on average")
        if self.phase_deg is not None:
            sensor.append(f"{self.phase_deg:+.1f} degrees after the drive")
        if any(end is not None for end in self.ends_g):
            ends = " and ".join(f"{end:+.3g} g" for end in self.ends_g if end is not None)
            sensor.append(f"at its end at {ends}")
        if sensor:
            lines.append(f"accelerometer: {', '.join(sensor)}")
        if self.levels_v is not None:
            low, high = self.levels_v
            seen = f"{self.takeoffs} take-offs" + (
                "" if self.takeoff_g is None else f", the plate then at {self.takeoff_g:.2f} g"
            )
            lines.append(f"contact: {low:.3g} and {high:.3g} V, {seen}")
        return tuple(lines)
