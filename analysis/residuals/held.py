"""Steps whose drive is not steady: a ball held on the locked cycle, and fades from step to step.

A hold's tones are measured as means over the step. The drive is corrected at every launch, as the recording says: what
one flight's drive was more than the mean, and how much earlier, is the ratio of its own amplitude to that of the step.

With the phase ``P`` of a launch and ``P'`` of the landing after it, both by the drive as it was ahead in that flight,
``P' = p* + mu (P - p*) + b e``, where ``e`` is the part by which the drive was greater: the slope over the launches is
the multiplier, whatever corrected the drive, and no model enters. Kicks at random make ``P`` vary by itself.

In a fade the plate moves between the motions of both steps, as the drive's weight has it. A plate mode rings on from
step to step. Flights in the fade strike it, too: how hard depends on the plate's motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

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


LONGEST_S = 0.2  # of a flight or contact whose acceleration is integrated
AROUND_S = 4e-3  # time on both sides of an impact from which the motion in between is interpolated
RINGING_S = 2.5e-3  # time after an impact in which the accelerometer shows more than the plate's motion


@dataclass(frozen=True)
class Fades:
    """Fades into each step of a recording, arrays (m,): when they begin, and how long they last.

    ``earlier_s`` is by how much each may have begun earlier: its length where it was found in a drive, else nothing.
    """

    begin_s: Floats
    length_s: Floats
    earlier_s: Floats

    @classmethod
    def of(cls, recording: Recording) -> Self:
        """From the table of steps."""
        steps, rate_hz = recording.steps, recording.rate_hz
        length_s = steps["fade_samples"] / rate_hz
        found = recording.attrs.get("backend") == "import"
        return cls(steps["first_sample"] / rate_hz, length_s, length_s if found else np.zeros(len(steps)))

    def before_half(self, step: Integers, time_s: Floats) -> Bools:
        """Whether times in steps, (n,) each, lie before the half of the fade: the plate moves as in the step before."""
        half_s = np.append(self.begin_s + 0.5 * self.length_s, np.inf)
        return np.asarray((step > 0) & (time_s < half_s[np.minimum(step, len(half_s) - 1)]))

    def touch(self, opening_s: Floats, landing_s: Floats) -> Bools:
        """Whether intervals (n,) meet a fade, or what may be one."""
        fades = self.length_s > 0.0
        begin_s, end_s = (self.begin_s - self.earlier_s)[fades], (self.begin_s + self.length_s)[fades]
        return np.searchsorted(begin_s, landing_s) > np.searchsorted(end_s, opening_s)

    def others(self, step: Integers, time_s: Floats) -> tuple[Integers, Floats]:
        """The other step of the fade in which each time lies, -1 for rest, and the share of its motion, (n,) each.

        ``step`` is the one whose motion is taken for the plate's; no share outside of fades. The weight of the new step
        goes as ``x^2 (3 - 2 x)`` with the part x of the fade that is over.
        """
        if not len(self.begin_s):
            return np.full(len(step), -1, dtype=np.int64), np.zeros(len(step))
        into = np.maximum(np.searchsorted(self.begin_s, time_s, side="right") - 1, 0)
        length_s = self.length_s[into]
        part = np.clip((time_s - self.begin_s[into]) / np.where(length_s > 0.0, length_s, 1.0), 0.0, 1.0)
        # the weight that the drive itself fades with
        new = np.where(length_s > 0.0, part * part * (3.0 - 2.0 * part), 1.0)
        other = np.where(step == into, into - 1, into)
        share = np.where(step == into, 1.0 - new, np.where(step == into - 1, new, 0.0))
        return other, np.where((share > 0.0) & (share < 1.0), share, 0.0)


def with_pushes(measured: Measured, recording: Recording, flights: Flights, fades: Fades, rows: Integers) -> Measured:
    """The flights in ``rows`` with integrals of the plate's acceleration plus gravity around fades.

    Over each flight and over the contact before it, and where the centre of the latter lies, as a part of the contact;
    NaN where none touches a fade or where it is unknown. Nothing need be known of how the plate gets from one motion to
    the next, but the accelerometer's zero must: no mean of its readings shows it under a ringing mode. Without a stated
    zero, or behind a capacitor, all are NaN.
    """
    takeoff_s, landing_s = flights.takeoff_s[rows], flights.landing_s[rows]
    flight_mps, contact_mps, centre = np.full((3, len(rows)), np.nan)
    out = replace(measured, gained_mps=flight_mps, pressed_mps=contact_mps, pressed_at=centre)
    channel = recording.setup.channels.accelerometer
    if channel.offset_v is None or channel.coupling == "ac":
        return out
    usable = (flights.flags[rows] & (FlightFlag.GAP | FlightFlag.CUT)) == 0
    before_s = np.concatenate([[-np.inf], landing_s[:-1]])
    for i in np.flatnonzero(usable & fades.touch(takeoff_s, landing_s) & (landing_s - takeoff_s < LONGEST_S)):
        flight_mps[i] = np.mean(_push_mps2(recording, takeoff_s[i], landing_s[i])) * (landing_s[i] - takeoff_s[i])
    for i in np.flatnonzero(usable & fades.touch(before_s, takeoff_s) & (takeoff_s - before_s < LONGEST_S)):
        # a push of nothing has its centre in the middle
        push = np.maximum(_after_impact_mps2(recording, before_s[i], takeoff_s[i]), 0.0) + 1e-9
        if len(push):
            contact_mps[i] = np.mean(push) * (takeoff_s[i] - before_s[i])
            centre[i] = np.average((np.arange(len(push)) + 0.5) / len(push), weights=push)
    return out


def _push_mps2(recording: Recording, begin_s: float, end_s: float) -> Floats:
    """The plate's acceleration plus gravity at the samples between two times, one at least."""
    channel, g_mps2 = recording.setup.channels.accelerometer, recording.setup.g_mps2.value
    zero_v = 0.0 if channel.offset_v is None else channel.offset_v.value
    first = max(round(begin_s * recording.rate_hz), 0)
    stop = min(max(round(end_s * recording.rate_hz), first + 1), recording.n_samples)
    read_mps2 = (recording.read_v("accelerometer", first, stop) - zero_v) / channel.volts_per_mps2
    return np.asarray(read_mps2 + (0.0 if channel.reads_gravity else g_mps2))


def _after_impact_mps2(recording: Recording, impact_s: float, end_s: float) -> Floats:
    """The same from an impact on; while that rings, a cubic through the readings on both sides stands for them."""
    begin_s, stop_s = impact_s - AROUND_S, max(end_s, impact_s + RINGING_S + AROUND_S)
    read = _push_mps2(recording, begin_s, stop_s)
    since_s = begin_s + (np.arange(len(read)) + 0.5) / recording.rate_hz - impact_s
    rings = (since_s > -1.0 / recording.rate_hz) & (since_s < RINGING_S)
    near = ~rings & (since_s < RINGING_S + AROUND_S)
    cubic = np.polynomial.Polynomial.fit(since_s[near], read[near], 3)
    return np.asarray(np.where(rings, cubic(since_s), read)[(since_s > 0.0) & (since_s < max(end_s - impact_s, 0.0))])
