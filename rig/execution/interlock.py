"""Limits, in the sample path: a clamp after everything, and a watch over every frame that comes back.

Nothing on the way to the plate passes the clamp, and every fault that the watch finds stops
the run. It needs no screen, no thread and no operator. Decisions 31 and 117.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from daq.files.tables import Block, BlockFlag
from kernels.arrays import Bools, Floats, Integers
from rig.execution.plate_monitor import Motion
from rig.profile import Profile

HEARTBEAT_S = 0.5  # a device may be late by
WINDOW_CYCLES = 4  # over which a dead accelerometer is judged
DEAD_FRACTION = 0.1  # of the motion that the drive asks for
DEAD_FLOOR_MPS2 = 0.5  # rms below which the drive asks for too little to judge by
CLIPPED_FRACTION = 0.04  # of a cycle; a single impact may touch the converter's limit
EXCESS = 5.0  # times the motion that the drive asks for: no plate follows its drive so badly, a wrong input does
AIRBORNE_GAMMA_PEAK = 3.0  # a ball that never leaves the plate above this, friction and all, is a wire


@dataclass
class _Window:
    """Sums over the cycles in which a channel is judged: drive played, looped back, and motion."""

    n: int = 0
    asked: float = 0.0  # squared m/s^2, by the drive as played
    looped_back: float = 0.0  # the same, by the looped-back drive
    moved: float = 0.0
    ran_dry: bool = False
    sums: dict[str, Floats] = field(default_factory=dict)  # of volts, squares, and products with the drive

    def rms(self) -> tuple[float, float, float]:
        """Root mean squares, m/s^2: commanded, looped back, and moved."""
        asked, looped, moved = (math.sqrt(s / max(self.n, 1)) for s in (self.asked, self.looped_back, self.moved))
        return asked, looped, moved

    def add_volts(self, name: str, volts: Floats, drive_v: Floats) -> None:
        """One more block of a channel."""
        sums = np.array([len(volts), volts.sum(), volts @ volts, volts @ drive_v, drive_v.sum(), drive_v @ drive_v])
        self.sums[name] = self.sums.get(name, np.zeros(6)) + sums

    def follows(self, name: str) -> tuple[float, float, float]:
        """Volts of a channel a volt of drive, the part of its variance that follows the drive, and its sigma, volts."""
        n, v, vv, vd, d, dd = self.sums.get(name, np.zeros(6))
        n = max(n, 1.0)
        variance, drive, both = vv / n - (v / n) ** 2, dd / n - (d / n) ** 2, vd / n - v * d / n**2
        gain = both / drive if drive > 0.0 else math.nan
        coherence = gain * both / variance if variance > 0.0 else 0.0
        return float(gain), float(coherence), math.sqrt(max(float(variance), 0.0))


class Interlock:
    """The clamp and the watch of one run.

    ``channels`` names a frame's columns; ``scales`` has ``(volts_per_code, offset_v)`` of each.

    Attributes
    ----------
    limits_in_use : dict of str to float
        What part of each limit (by its name in the profile) the last block used; 1 trips.
    contact_age_cycles : float
        Cycles since the ball last showed itself, by contact or impact.
    """

    def __init__(self, profile: Profile, channels: tuple[str, ...], scales: Mapping[str, tuple[float, float]]) -> None:
        self._limits = profile.limits
        self._column = {name: i for i, name in enumerate(channels)}
        self._rate_hz = profile.sampling.rate_hz
        self._cycle = max(1, round(profile.sampling.rate_hz / profile.forcing.frequency_hz))
        accelerometer = profile.channels.accelerometer
        scale = profile.drive.g_per_volt
        self._mps2_per_volt = (scale.value if scale else 0.0) * profile.g_mps2.value
        self._gamma_peak_per_volt = self._mps2_per_volt / profile.g_mps2.value
        self._contact_levels = _contact_levels(profile, scales)
        continuity = profile.channels.continuity
        self._opens_upwards = continuity is None or continuity.swing_v > 0.0
        self._edge_code = math.inf
        if continuity is not None and continuity.coupling == "ac" and "continuity" in scales:
            self._edge_code = 0.5 * abs(continuity.swing_v) / scales["continuity"][0]
        # an edge is a step of half the swing within 0.2 ms
        self._before_edge = np.zeros(max(2, round(2e-4 * profile.sampling.rate_hz)))
        self._n_seen = 0
        self._clamped_v = 0.0
        self._since_open = self._since_closed = self._flying = 0
        ranges = {"accelerometer": accelerometer.range_v, "drive": profile.channels.drive.range_v}
        # the highest code of a converter: its lowest is one further from zero
        full = {name: round(ranges[name] / scales[name][0]) - 1 for name in ranges if name in self._column}
        self._full = {name: min(32767, code) for name, code in full.items()}
        self._clipped: dict[str, Integers] = {name: np.zeros(0, np.int64) for name in self._full}
        self._window = _Window()
        self._scales = {name: scales[name] for name in channels if name in scales}
        self._loops_back = "drive" in self._scales and profile.backend.kind != "replay"
        self._volts_per_mps2 = abs(accelerometer.volts_per_mps2)
        self._still = self._last_code = 0
        self._was_open = self._ended_open = False
        self.limits_in_use: dict[str, float] = {}
        self.contact_age_cycles = 0.0

    def clamp(self, drive_v: Floats) -> Floats:
        """``drive_v`` with nothing beyond the drive limit; the last thing that touches it."""
        limit = self._limits.drive_v
        self._clamped_v = float(np.max(np.abs(drive_v), initial=0.0))
        return np.clip(drive_v, -limit, limit)

    def inspect(self, drive_v: Floats, block: Block, motion: Motion) -> str | None:
        """Why the run must stop after this exchange, or None.

        ``drive_v`` (n,) was played, and ``block`` came back for it; ``motion`` is the plate's by its accelerometer.
        """
        codes = block.codes
        self._n_seen += len(codes)
        # all are asked, as each carries a state on from block to block; the first that has a reason is named
        reasons = (
            self._drive(),
            self._frozen(drive_v, codes),
            self._moved(motion),
            self._unlike(drive_v, block),
            *(self._clipping(name, codes[:, self._column[name]]) for name in self._clipped),
            self._contact(drive_v, codes, motion),
        )
        return next((reason for reason in reasons if reason), None)

    def circuit(self, codes: NDArray[np.int16]) -> tuple[Bools, Bools] | None:
        """Where in a block (n, channels) the contact circuit is closed, and where it closes; None without one."""
        if self._contact_levels is None:
            return None
        is_open = self._open(codes, self._contact_levels, self._was_open)
        before = np.concatenate([[self._was_open], is_open[:-1]])[: len(is_open)]
        self._was_open = bool(is_open[-1]) if len(is_open) else self._was_open
        return ~is_open, before & ~is_open

    def late(self, waited_s: float, n_samples: int) -> str | None:
        """Why the run must stop when a device took ``waited_s`` to exchange ``n_samples``, or None."""
        due_s = n_samples / self._rate_hz
        if waited_s <= due_s + HEARTBEAT_S:
            return None
        return f"lost heartbeat: a block of {due_s:.3g} s took {waited_s:.3g} s; is the device or the machine stalled?"

    def _drive(self) -> str | None:
        limit = self._limits.drive_v
        if self._clamped_v <= limit * (1.0 + 1e-9):
            return None
        return f"the clamp held back {self._clamped_v:.4g} V of drive; limits.drive_v allows {limit:g}"

    def _moved(self, motion: Motion) -> str | None:
        """Plate acceleration, velocity and displacement against their limits."""
        a, v, x = motion.acceleration_mps2, motion.velocity_mps, motion.displacement_m
        self._window.moved += motion.square_sum
        limits = self._limits
        used = [
            (value / limit, name, f"the plate reached {value:.4g} {unit}; limits.{name} allows {limit:g}")
            for name, value, limit, unit in (
                ("plate_mps2", a, limits.plate_mps2, "m/s^2"),
                ("velocity_mps", v, limits.velocity_mps, "m/s"),
                ("displacement_m", x, limits.displacement_m, "m"),
            )
            if limit is not None
        ]
        worst, _, reason = max(used)
        self.limits_in_use = {"drive_v": self._clamped_v / limits.drive_v} | {name: part for part, name, _ in used}
        return reason if worst > 1.0 else None

    def _volts(self, name: str, codes: NDArray[np.int16]) -> Floats:
        """A channel of a block in volts."""
        per_code, offset_v = self._scales[name]
        return np.asarray(codes[:, self._column[name]] * per_code + offset_v, np.float64)

    def _frozen(self, drive_v: Floats, frames: NDArray[np.int16]) -> str | None:
        """An accelerometer that reads one and the same while the drive moves, looped back where it is."""
        codes = frames[:, self._column["accelerometer"]]
        # a muted output moves nothing: the looped-back drive shows it
        drives = [drive_v, self._volts("drive", frames)] if self._loops_back else [drive_v]
        largest_v = min(float(np.max(np.abs(volts), initial=0.0)) for volts in drives)
        moving = largest_v * self._mps2_per_volt > DEAD_FLOOR_MPS2
        same = codes.size > 0 and codes.min() == codes.max() == (self._last_code if self._still else codes[0])
        self._still = self._still + codes.size if moving and same else 0
        self._last_code = int(codes[-1]) if codes.size else self._last_code
        if self._still < self._cycle:
            return None
        return "dead accelerometer: its reading has not changed for a cycle while the drive moves; check its cable"

    def _unlike(self, drive_v: Floats, block: Block) -> str | None:
        """Comparison of drive, loop-back and accelerometer over some cycles."""
        window, n = self._window, len(drive_v)
        window.n += n
        asked = float(np.sum(np.square(drive_v * self._mps2_per_volt)))
        window.asked += asked
        window.ran_dry |= bool(block.flags & BlockFlag.UNDERFLOW)
        whole = len(block.codes) == n  # of a block that came short it is not known which drive its frames belong to
        for name in self._scales if whole else ():
            window.add_volts(name, self._volts(name, block.codes), drive_v)
        if self._loops_back and whole:
            window.looped_back += float(np.sum(np.square(self._volts("drive", block.codes) * self._mps2_per_volt)))
        else:
            window.looped_back += asked
        if window.n < WINDOW_CYCLES * self._cycle:
            return None
        self._window = _Window()
        asked_mps2, looped_mps2, moved_mps2 = window.rms()
        if asked_mps2 < DEAD_FLOOR_MPS2:
            return None
        if max(looped_mps2, moved_mps2) <= DEAD_FRACTION * asked_mps2:
            return self._undriven(window)
        return self._exchanged(window) or self._dead(window)

    def _undriven(self, window: _Window) -> str:
        """Neither the looped-back drive nor the plate moves."""
        asked, looped, moved = window.rms()
        seen = (
            f"over {WINDOW_CYCLES} cycles the drive asks for {asked:.3g} m/s^2 rms, the looped-back drive comes to "
            f"{looped:.2g} and the accelerometer to {moved:.2g}"
        )
        if window.ran_dry:
            return (
                f"the drive ran dry (UNDERFLOW): {seen}; the program was too late for the card: "
                "end other work, or raise backend.buffer_s"
            )
        return f"no drive: {seen}; is the output muted or unplugged?"

    def _exchanged(self, window: _Window) -> str | None:
        """An input other than the looped-back drive's that reads the drive as it was played."""
        own = window.follows("drive")[0] if self._loops_back else 1.0
        # a drive that ran dry was not played as asked; an input within 20 % of it is the drive's own
        if window.ran_dry or not abs(own - 1.0) > 0.2:
            return None
        for name in set(self._scales) - {"drive"}:
            gain, coherence, _ = window.follows(name)
            # volt for volt as it was played, and nothing else in it: that is the drive
            if abs(gain - 1.0) < 0.1 and coherence > 0.9:
                return (
                    f"exchanged inputs: the {name} input reads the drive as it was played, "
                    f"the drive input {own:.2g} of it; change their plugs, or their terminals in the profile"
                )
        return None

    def _dead(self, window: _Window) -> str | None:
        """The drive moves, and the accelerometer does not, or far too much."""
        asked, looped, moved = window.rms()
        if DEAD_FRACTION * min(asked, looped) < moved <= EXCESS * asked:
            return None
        seen = (
            f"the drive asks for {asked:.3g} m/s^2 rms over {WINDOW_CYCLES} cycles, the accelerometer reads {moved:.2g}"
        )
        if moved > EXCESS * asked:
            return (
                f"more motion than was asked for: {seen}; are inputs exchanged, or drive.g_per_volt or "
                "channels.accelerometer.sensitivity wrong? bench check tells"
            )
        if "continuity" in self._scales:
            contact = window.follows("continuity")[2] / self._volts_per_mps2
            if 0.5 * looped < contact < 2.0 * looped:
                return (
                    f"exchanged inputs: {seen}, the continuity input what would be {contact:.2g}; "
                    "change their plugs, or their terminals in the profile"
                )
        return f"dead accelerometer: {seen}; check its cable and its supply"

    def _clipping(self, name: str, codes: NDArray[np.int16]) -> str | None:
        """An input at a limit, its converter's or a lower one, for longer than an impact lasts."""
        full = self._full[name]
        at_limit = (codes >= full) | (codes <= -full)
        for extreme in (int(codes.max(initial=-32768)), int(codes.min(initial=32767))):
            top = codes == extreme
            # a motion's top is one code for a few samples, a clipped one stays; small codes are the converter's steps
            if abs(extreme) > 0.02 * full and np.count_nonzero(top) > max(3.0, CLIPPED_FRACTION * self._cycle / 2):
                at_limit |= top
        where = self._n_seen - len(codes) + np.flatnonzero(at_limit)
        recent = np.concatenate([self._clipped[name], where])
        self._clipped[name] = recent[recent > self._n_seen - self._cycle]
        if len(self._clipped[name]) <= CLIPPED_FRACTION * self._cycle:
            return None
        return f"clipped input: {name} lay at a limit for {len(self._clipped[name])} samples of one cycle"

    def _open(self, codes: NDArray[np.int16], levels: tuple[float, float], before: bool) -> Bools:
        """Whether the circuit is open, frame by frame; a frame between the two levels takes the state before it.

        Behind a capacitor an edge counts as well: where the ball hardly touches, the open level is near 0 V.
        """
        x, (closed, opened) = codes[:, self._column["continuity"]].astype(np.float64), levels
        sign = 1.0 if self._opens_upwards else -1.0
        is_open, is_closed = sign * x > sign * opened, sign * x <= sign * closed
        if math.isfinite(self._edge_code):
            step = sign * (x - np.concatenate([self._before_edge, x])[: len(x)])
            is_open, is_closed = is_open | (step > self._edge_code), is_closed | (step < -self._edge_code)
        # each frame's last decided frame before it; 0 stands for the block before
        last = np.maximum.accumulate(np.where(is_open | is_closed, np.arange(1, len(x) + 1), 0))
        known: Bools = np.concatenate([[before], is_open])[last]
        return known

    def _contact(self, drive_v: Floats, codes: NDArray[np.int16], motion: Motion) -> str | None:
        """A contact circuit that never closes, or never opens although the ball must fly."""
        if self._contact_levels is None or not self._limits.contact_cycles:
            return None
        is_open = self._open(codes, self._contact_levels, self._ended_open)
        self._ended_open = bool(is_open[-1]) if len(is_open) else self._ended_open
        volts = np.concatenate([self._before_edge, codes[:, self._column["continuity"]]])
        self._before_edge = volts[-len(self._before_edge) :]
        n, limit = len(codes), self._limits.contact_cycles * self._cycle
        closed_at, open_at = np.flatnonzero(~is_open), np.flatnonzero(is_open)
        self._since_closed = n - 1 - int(closed_at[-1]) if closed_at.size else self._since_closed + n
        if float(np.max(np.abs(drive_v), initial=0.0)) * self._gamma_peak_per_volt > AIRBORNE_GAMMA_PEAK:
            self._flying = self._cycle  # the peak comes once a cycle, not in every block
        self._since_open = self._since_open + n if self._flying > 0 and not open_at.size else 0
        self._flying -= n
        # A ball that is launched again as it lands makes no contact that a sample could show; its impacts ring.
        alive = min(self._since_closed, motion.since_impact)
        self.contact_age_cycles = alive / self._cycle
        if alive > limit:
            return (
                f"the contact circuit has been open for {self._limits.contact_cycles} cycles and the accelerometer "
                "shows no impact: a broken wire?"
            )
        if self._since_open > limit:
            return (
                f"the contact circuit has not opened for {self._limits.contact_cycles} cycles although gamma_peak is "
                f"above {AIRBORNE_GAMMA_PEAK:g}: a short circuit, or no ball?"
            )
        return None


def _contact_levels(profile: Profile, scales: Mapping[str, tuple[float, float]]) -> tuple[float, float] | None:
    """Codes below which the circuit is closed and above which it is open (or the other way round where open is lower).

    Behind a coupling capacitor a state droops towards 0 V and never passes it: what lies near it keeps the state.
    """
    continuity = profile.channels.continuity
    if continuity is None or "continuity" not in scales:
        return None
    volts_per_code, offset_v = scales["continuity"]
    swing_v = continuity.swing_v
    is_ac = continuity.coupling == "ac"
    middle_v = 0.0 if is_ac else continuity.middle_v
    # a state that droops behind a capacitor keeps its name within a tenth of the swing about 0 V
    band_v = 0.1 * swing_v if is_ac else 0.0
    return (middle_v - band_v - offset_v) / volts_per_code, (middle_v + band_v - offset_v) / volts_per_code
