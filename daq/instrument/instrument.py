"""The instrument of a recording: measured properties and doubts, in words, and the refusal of grave doubts.

It is what was stored at the import, else measured.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from daq.instrument.doubts import Doubt, at_edges_g, doubts_of, drive_phase_deg, edges_g, ends_g
from daq.instrument.measure import measure, volts_per_g
from daq.recording import Recording, open_recording
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from daq.steps.forcing_detection import Read
from kernels.arrays import Integers

STORED = "instrument_json"  # root attribute of a recording


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


def examine(
    read: Mapping[str, Read], n_samples: int, rate_hz: float, steps: NDArray[np.void], gaps: Integers, setup: Setup
) -> Instrument:
    """The instrument and the doubts about its profile; parameters are those of `daq.instrument.measure.measure`."""
    seen = measure(read, n_samples, rate_hz, steps, gaps, setup)
    noise = seen.noise
    scale = abs(setup.channels.accelerometer.volts_per_mps2)
    opens, _ = edges_g(seen, setup.channels.continuity)
    loudest = max(seen.holds, key=lambda hold: hold.peak_g, default=None)
    tones_g: list[float] = []
    if loudest is not None:
        fit = loudest.plate
        rows = [int(np.argmin(np.abs(fit.frequencies_hz - hz))) for hz in loudest.tones_hz]
        tones_g = (np.abs(fit.amplitudes[rows]) / abs(volts_per_g(setup))).tolist()
    return Instrument(
        rate_hz=rate_hz,
        steps=len(steps),
        noise_mps2=None if noise is None else noise.rms_v / scale,
        noise_mps2_rthz=None if noise is None else math.sqrt(noise.slow_v2phz) / scale,
        bandwidth_hz=None if noise is None else noise.bandwidth_hz,
        bias_v=seen.bias_v,
        tones_hz=() if loudest is None else loudest.tones_hz,
        tones_g=tuple(tones_g),
        phase_deg=drive_phase_deg(seen, setup),
        takeoffs=len(opens),
        takeoff_g=at_edges_g(opens),
        levels_v=seen.levels_v,
        doubts=doubts_of(seen, setup),
        ends_g=ends_g(seen, setup),
    )


def instrument_of(recording: Recording) -> Instrument | None:
    """The instrument of an open recording by its present setup; None without an accelerometer or samples."""
    if "accelerometer" not in recording.channels or not recording.n_samples:
        return None
    # what was stored holds for the setup of the time: with another profile it is measured anew
    own = recording.setup.model_dump(mode="json") == json.loads(recording.stored.get("setup_json", "null"))
    if own and STORED in recording.stored:
        return Instrument.from_json(json.loads(recording.stored[STORED]))
    read = {name: functools.partial(recording.read_v, name) for name in recording.channels}
    return examine(read, recording.n_samples, recording.rate_hz, recording.steps, recording.gaps, recording.setup)


def refuse_doubtful(paths: Iterable[Path], setup: Setup | None = None) -> None:
    """Refuse recordings that contradict their profile so far that a verdict would mean nothing.

    ``setup`` replaces the one stored in them. Raises `InputError`, naming the file, the first contradiction and its
    cure.
    """
    for path in paths:
        with open_recording(path) as recording:
            if setup is not None:
                recording.measure_with(setup)
            found = instrument_of(recording)
        if found is not None and found.grave:
            raise InputError(f"{path}: {found.grave[0].sentence}; --anyway goes on all the same")
