"""Steps in which a ball was held on the locked cycle: the drive of each flight, and the cycle as measured.

A hold's tones are measured as means over the step. The drive is corrected at every launch, as the recording says: what
one flight's drive was more than the mean, and how much earlier, is the ratio of its own amplitude to that of the step.

With the phase ``P`` of a launch and ``P'`` of the landing after it, both by the drive as it was ahead in that flight,
``P' = p* + mu (P - p*) + b e``, where ``e`` is the part by which the drive was greater: the slope over the launches is
the multiplier, whatever corrected the drive, and no model enters. Kicks at random make ``P`` vary by itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from analysis.flights.assemble import FlightFlag, Flights
from analysis.linear_algebra import lstsq, pinv
from daq.recording import Recording
from kernels.arrays import Bools, Complexes, Floats, Integers
from model.integrator.problem import Measured

HELD = 0.95  # part of a step's cycles in which the ball must have landed where it was launched
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


@dataclass(frozen=True)
class HeldStep:
    """One step on the branch."""

    step: int  # the step's number
    flights: int  # of its hold
    held: float  # part of its cycles that were held
    gamma: float  # measured
    flight_s: float  # mean flight time
    flight_uncertainty_s: float  # standard uncertainty of the mean
    phase: float  # landing phase of the cycle by the forcing, rad
    multiplier: float  # NaN where the ball moved too little to tell, as its interval
    interval: tuple[float, float]  # 95 %, of the multiplier
    correction_rms: float  # of the drive, in parts of its rms
    correction_mean: float  # the same


@dataclass(frozen=True)
class _Rows:
    """Flights of one hold: take-off and landing phase, parts and phases of the corrections."""

    before: Floats
    after: Floats
    part: Floats
    ahead: Floats
    duration_s: Floats
    sigma: float


def held_steps(recording: Recording, flights: Flights) -> list[HeldStep]:
    """The steps of a recording in which the ball was held for `HELD` of the cycles; none where it was not."""
    launches = Launches.of(recording)
    if launches is None:
        return []
    rows = {}
    for number in range(len(recording.steps)):
        if (found := _rows(recording, flights, launches, number)) is not None:
            rows[number] = found
    plates = {plate.step: plate for plate in flights.plate.steps if plate is not None}
    return [_held(n, plates[n].gamma, row, _cycles(recording, n)) for n, row in rows.items()]


def _cycles(recording: Recording, number: int) -> float:
    """Cycles of a hold."""
    step, frequency_hz = recording.steps[number], recording.setup.forcing.frequency_hz
    return float((step["n_samples"] - step["settle_samples"]) / recording.rate_hz * frequency_hz)


def _rows(recording: Recording, flights: Flights, launches: Launches, number: int) -> _Rows | None:
    """The held flights of step ``number``; None where they are too few."""
    unusable = FlightFlag.FALSE | FlightFlag.GAP | FlightFlag.SETTLING | FlightFlag.CUT
    of = (flights.step == number) & ((flights.flags & unusable) == 0)
    of &= launches.at(flights.takeoff_s) >= 0
    of &= np.abs(flights.landing_s - flights.takeoff_s - launches.cycle_s) < 0.125 * launches.cycle_s
    # a line through fewer than eight flights says nothing
    if np.count_nonzero(of) < max(8, HELD * (_cycles(recording, number) - 2.0)):
        return None
    if flights.plate.steps[number] is None:
        return None
    turn = 2.0 * math.pi / launches.cycle_s
    seen_s = flights.takeoff_s[of], flights.landing_s[of]
    takeoff, landing = (flights.plate.true_time_s(x) - launches.late_s for x in seen_s)
    part, ahead_s = launches.relative(recording, flights.step[of], flights.takeoff_s[of])
    cycle = np.round((takeoff - takeoff[0]) / launches.cycle_s)
    origin = launches.cycle_s * math.floor(takeoff[0] / launches.cycle_s)
    before, after = (turn * (x - origin - (cycle + k) * launches.cycle_s) for k, x in enumerate((takeoff, landing)))
    sigma = turn * float(np.median(flights.landing_uncertainty_s[of]))
    return _Rows(before, after, part, turn * ahead_s, landing - takeoff, sigma)


def _held(number: int, gamma: float, row: _Rows, cycles: float) -> HeldStep:
    """Line through the landings of one hold."""
    n, launch, landing = len(row.before), row.before + row.ahead, row.after + row.ahead
    multiplier, half, phase = math.nan, math.nan, float(np.mean(row.before))
    x, e = launch - launch.mean(), row.part - row.part.mean()
    # what a launch varies by itself: its part along the correction says nothing of the multiplier
    own = x - e * float(x @ e) / max(float(e @ e), 1e-300)
    # a slope is known where launches spread by twelve of their uncertainties
    if np.std(own) > 12.0 * row.sigma:
        terms = np.column_stack([x, np.ones(n), e, x * x])  # the map bends a little
        found, *_ = lstsq(terms, landing, rcond=None)
        multiplier, left = float(found[0]), landing - terms @ found
        sigma = math.sqrt(float(left @ left) / (n - 4) * pinv(terms.T @ terms)[0, 0])
        from scipy.stats import t as student  # takes most of a second to import

        # a 95 % interval; four terms are fitted
        half = sigma * float(student.ppf(0.5 + 0.5 * 0.95, n - 4))
    size = np.hypot(row.part, row.ahead)
    return HeldStep(
        number, n, min(n / max(cycles - 1.0, 1.0), 1.0), gamma, float(np.mean(row.duration_s)),
        float(np.std(row.duration_s, ddof=1) / math.sqrt(n)), phase, multiplier, (multiplier - half, multiplier + half),
        float(np.sqrt(np.mean(size**2))), float(abs(np.mean(row.part + 1j * row.ahead))),
    )  # fmt: skip
