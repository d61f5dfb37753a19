"""Table of flights as a value: columns, flags, selection of comparable flights, and CSV.

No flight is dropped: false flights, double hits, boundaries only from the accelerometer and flights that may hide an
undetected landing are flagged.
"""

from __future__ import annotations

import csv
import enum
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import numpy.typing as npt

from analysis.events.edges import EdgeShape
from analysis.events.levels import Levels
from analysis.events.sensor_offset import SensorOffset
from analysis.plate.motion import PlateMotion
from daq.files.disk import whole
from daq.recording.notebook import EventChange
from kernels.arrays import Bools, Floats, Integers


class FlightFlag(enum.IntFlag):
    """Flags of a flight."""

    FALSE = 1
    """Contact bounce or a glitch, not a flight."""
    DOUBLE_HIT = 2
    """Left the plate while the plate was pushing, by rebound, and was back within half a forcing period."""
    RELAUNCHED = 4
    """Took off where it had just landed, launched by the plate at once."""
    ACCELEROMETER = 8
    """A boundary comes from the accelerometer."""
    GAP = 16
    """Touches lost samples."""
    SETTLING = 32
    """In a step's fade or settle part."""
    CUT = 64
    """Cut by the start, the end or a change of step."""
    UNSURE = 128
    """A landing may be hidden: the ball should have met the plate in between, or an edge was missed since the last, or
    the accelerometer stood at its end where only it shows landings."""
    BY_HAND = 256
    """A boundary stands where a person put it."""


@dataclass(frozen=True)
class Flights:
    """Flights of a recording, arrays of equal length in order of take-off, and the plate they flew over.

    Times are seconds on the recording's axis, uncertainties one standard deviation. Phases in [0, 2 pi) are those of
    ``phi = w t``, 0 where the first tone's displacement crosses zero going up; NaN where the plate is unknown.
    ``contact_s`` is how long the ball lay on the plate before the flight (0: relaunched at once; NaN: unknown).
    """

    takeoff_s: Floats
    landing_s: Floats
    takeoff_uncertainty_s: Floats
    landing_uncertainty_s: Floats
    takeoff_phase: Floats
    landing_phase: Floats
    step: Integers
    gamma: Floats
    contact_s: Floats
    impact: Floats
    flags: npt.NDArray[np.int32]
    plate: PlateMotion
    edges: EdgeReport

    @property
    def duration_s(self) -> Floats:
        """Flight times."""
        return self.landing_s - self.takeoff_s

    @property
    def uncertainty_s(self) -> Floats:
        """Uncertainty of the flight times."""
        return np.hypot(self.takeoff_uncertainty_s, self.landing_uncertainty_s)

    def __len__(self) -> int:
        return self.takeoff_s.size

    def has(self, flag: FlightFlag) -> Bools:
        """Which flights carry any of the flags."""
        return np.asarray(self.flags & int(flag), dtype=bool)

    def select(self, chosen: Bools) -> Flights:
        """The chosen flights, same plate."""
        columns = {f.name: getattr(self, f.name)[chosen] for f in fields(self) if f.name not in ("plate", "edges")}
        return Flights(**columns, plate=self.plate, edges=self.edges)

    def good(self) -> Bools:
        """Flights fit for a comparison: true, whole, in the hold of a step, no gap, nothing hidden."""
        bad = FlightFlag.FALSE | FlightFlag.GAP | FlightFlag.SETTLING | FlightFlag.CUT | FlightFlag.UNSURE
        return ~self.has(bad)

    def heard(self) -> Bools:
        """Landings that only the accelerometer shows, none of which showed its delay against the contact edges."""
        offset, mark = self.edges.sensor_offset, self.has(FlightFlag.ACCELEROMETER)
        if offset is None or np.isfinite(offset.uncertainty_s):
            return np.zeros(len(self), dtype=np.bool_)
        pause_s = np.append(self.takeoff_s[1:], np.inf) - self.landing_s  # half a sample after an unseen contact
        return np.asarray(mark & np.append(mark[1:], False) & (pause_s * self.plate.rate_hz < 1.0))


@dataclass(frozen=True)
class EdgeReport:
    """Quality of the edges and of the accelerometer as a second detector.

    Attributes
    ----------
    levels : Levels or None
        None where there is no continuity channel.
    opening, closing : EdgeShape
    sensor_offset : SensorOffset or None
        None where the accelerometer shows no impacts.
    dips : int
        Contacts too short to cross the threshold of the contact voltage.
    ringing_s : float
        How long after an impact the accelerometer shows more than the plate's motion.
    missed : int
        Edges of an AC-coupled circuit that are known to have been missed.
    by_hand : tuple of EventChange
        Events that a person changed.
    """

    levels: Levels | None
    opening: EdgeShape
    closing: EdgeShape
    sensor_offset: SensorOffset | None
    dips: int
    ringing_s: float
    missed: int = 0
    by_hand: tuple[EventChange, ...] = ()


COLUMNS = (
    "takeoff_s",
    "landing_s",
    "duration_s",
    "uncertainty_s",
    "takeoff_phase",
    "landing_phase",
    "step",
    "gamma",
    "flags",
)


def flag_names(flags: int) -> str:
    """Names joined by ``|``; empty when there are none."""
    return "|".join(str(f.name) for f in FlightFlag if flags & f)


def write_csv(flights: Flights, path: Path) -> None:
    """Write the table of flights, one row a flight, times to the nanosecond."""
    with whole(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow(COLUMNS)
        duration, sigma = flights.duration_s, flights.uncertainty_s
        for i in range(len(flights)):
            out.writerow(
                [
                    f"{flights.takeoff_s[i]:.9f}",
                    f"{flights.landing_s[i]:.9f}",
                    f"{duration[i]:.9f}",
                    f"{sigma[i]:.9f}",
                    f"{flights.takeoff_phase[i]:.6f}",
                    f"{flights.landing_phase[i]:.6f}",
                    int(flights.step[i]),
                    f"{flights.gamma[i]:.6f}",
                    flag_names(int(flights.flags[i])),
                ]
            )
