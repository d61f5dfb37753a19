"""The plate while the drive fades from step to step: between the motions of both steps, as the drive's weight has it.

A plate mode rings on from step to step. Flights in the fade strike it, too: how hard depends on the plate's motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from analysis.flights.assemble import FlightFlag, Flights
from daq.recording import Recording
from kernels.arrays import Bools, Floats, Integers
from model.integrator.problem import Measured

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
