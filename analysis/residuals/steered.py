"""The drive of each flight of a ball that was held on a branch: corrected at every launch, as the recording says.

A hold's tones are measured as means over the step. What one flight's drive was more than that, and how much earlier, is
the ratio of its own amplitude to the mean of the step's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from daq.recording import Recording
from kernels.arrays import Bools, Complexes, Floats, Integers
from model.integrator.problem import Measured

NEAR = 1.0 / 8.0  # of a cycle, between a correction and the launch that it belongs to


@dataclass(frozen=True)
class Launches:
    """Corrections at launches: when each was made, and the amplitude from there on as seen at the first tone.

    ``late_s`` is by how much the frames lie behind the drive.
    """

    time_s: Floats
    volts: Complexes
    cycle_s: float
    multiple: int
    late_s: float

    @classmethod
    def of(cls, recording: Recording) -> Launches | None:
        """Those of a recording; None where its ball was not held."""
        setup, rows = recording.setup, recording.drive_changes
        cycle_s = 1.0 / setup.forcing.frequency_hz
        multiple = next(m for m, d in setup.forcing.displacement_tones() if abs(d) > 0.0)
        own = rows[(rows["multiple"] == multiple) & (rows["n_samples"] > 0)]
        # a change of the drive that lasts below a sixteenth of a cycle is a correction at a launch
        made = own[own["n_samples"] < cycle_s / 16.0 * recording.rate_hz]
        if len(made) < 2 or not len(recording.steps):
            return None
        late_s = float(recording.steps["first_sample"][0] - rows["first_sample"][0]) / recording.rate_hz
        time_s = (made["first_sample"] + made["n_samples"]) / recording.rate_hz + late_s
        return cls(time_s, made["end_re_v"] + 1j * made["end_im_v"], cycle_s, multiple, late_s)

    def at(self, takeoff_s: Floats) -> Integers:
        """The correction at which each flight (n,) was launched; -1 for none."""
        nearest = np.searchsorted(self.time_s, takeoff_s + NEAR * self.cycle_s) - 1
        far = np.abs(self.time_s[np.maximum(nearest, 0)] - takeoff_s) > NEAR * self.cycle_s
        return np.where(far, -1, nearest)

    def relative(self, recording: Recording, step: Integers, takeoff_s: Floats) -> tuple[Floats, Floats]:
        """By what part each flight's drive was greater than its step's mean, and by how many seconds earlier, (n,)."""
        launch, steps = self.at(takeoff_s), recording.steps
        first = steps["first_sample"] + steps["settle_samples"]
        last = steps["first_sample"] + steps["n_samples"]
        held: list[Bools] = [
            (self.time_s >= a / recording.rate_hz) & (self.time_s < b / recording.rate_hz)
            for a, b in zip(first, last, strict=True)
        ]
        mean = np.array([self.volts[within].mean() if within.any() else np.nan for within in held])
        ratio = self.volts[np.maximum(launch, 0)] / mean[np.clip(step, 0, len(mean) - 1)]
        ratio = np.where((launch < 0) | (step < 0) | ~np.isfinite(ratio), 1.0, ratio)
        omega_radps = 2.0 * np.pi * self.multiple / self.cycle_s
        # a phase ahead by w t is a drive that comes earlier by t
        return np.abs(ratio) - 1.0, np.angle(ratio) / omega_radps

    def of_flights(self, measured: Measured, recording: Recording, number: Integers, takeoff_s: Floats) -> Measured:
        """The flights (n,) of steps ``number`` with the drive that each had; its launch tells what a fade would."""
        part, ahead_s = self.relative(recording, number, takeoff_s)
        fading = (measured.other_step is not None) & (self.at(takeoff_s) < 0)
        share = None if measured.share is None else np.where(fading, measured.share, 0.0)
        return replace(measured, part=part, ahead_s=ahead_s, share=share)
