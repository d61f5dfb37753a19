"""What one simulation is made of: a bench, a ramp, and faults, all drawn from a seed, and written down as JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

DEVICE = ("short", "declared", "silent", "doubled", "late", "stall", "gone", "jump")
SENSOR = ("stuck", "dead", "clipped", "open", "closed", "muted", "weak")
OPERATOR = (
    "finish", "down", "now", "SIGINT", "SIGTERM", "SIGHUP", "twice", "pause", "note", "page_finish", "page_down",
    "page_now", "page_pause", "page_note", "page_junk",
)  # fmt: skip
RECORDER = ("recorder_dies", "recorder_stalls", "run_killed", "killed", "power")
DISK = ("full", "unwritable", "interrupted", "short_write", "removed", "little_space")
OTHER = ("second", "look", "recover_now", "clock_step", "flip")
KINDS = (*DEVICE, *SENSOR, *OPERATOR, *RECORDER, *DISK, *OTHER)


@dataclass(frozen=True)
class Fault:
    """One thing that goes wrong, or that somebody does.

    Attributes
    ----------
    kind
        One of `KINDS`.
    at
        When, as a part of the run's planned samples (of a fault after the run: of the file).
    n
        How much: samples, milliseconds, calls of the disk.
    """

    kind: str
    at: float
    n: int = 1


@dataclass(frozen=True)
class Plan:
    """One simulation; ``counter`` and ``begin_ns`` are where the device's and the computer's counts begin."""

    seed: int
    device: str = "plain"
    recorder: str = "process"
    rate_hz: float = 200.0
    frequency_hz: float = 1.0
    gammas: tuple[float, ...] = (0.2, 0.5)
    settle_cycles: int = 2
    hold_cycles: int = 3
    is_controlled: bool = False
    drive_limit_v: float = 9.5
    counter: int = 0
    begin_ns: int = 0
    drift: float = 0.0
    faults: tuple[Fault, ...] = ()

    def to_json(self) -> str:
        """The plan in one line."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Plan:
        """The plan of `to_json`."""
        read: dict[str, Any] = json.loads(text)
        faults = tuple(Fault(**fault) for fault in read.pop("faults"))
        return cls(**(read | {"gammas": tuple(read["gammas"])}), faults=faults)

    def without(self, k: int) -> Plan:
        """The plan without one of its faults."""
        return replace(self, faults=self.faults[:k] + self.faults[k + 1 :])


def draw(seed: int, minutes: float = 1.0) -> Plan:
    """The plan of a seed: a ramp of about ``minutes`` of the bench's own time, and up to five faults."""
    rng = np.random.default_rng(seed)
    device = str(rng.choice(["plain", "card", "serial"], p=[0.6, 0.2, 0.2]))
    # marker and converter of a real card need a rate of sound; a block is a quarter of a cycle, whatever the rate
    rate_hz = float(rng.choice([100.0, 200.0, 500.0] if device == "plain" else [2000.0, 3000.0]))
    n_steps = int(rng.integers(1, 4))
    settle, hold = int(rng.integers(0, 3)), int(rng.integers(1, 5))
    gammas = tuple(round(float(g), 2) for g in rng.uniform(0.1, 2.2, n_steps))
    cycles = n_steps * (settle + hold + 8.0) + 2.0
    frequency_hz = float(min(2.5, max(0.05, round(cycles / (60.0 * minutes), 3))))
    is_controlled = bool(rng.random() < 0.15) and device == "plain"
    limit_v = 9.5 if rng.random() < 0.85 else round(float(rng.uniform(0.2, 1.0)) * max(gammas), 3)
    begins = [0, 2**31 - 500, 2**32 - 500, 2**53 - 500]
    faults = []
    for _ in range(int(rng.choice(6, p=[0.1, 0.3, 0.25, 0.15, 0.1, 0.1]))):
        kind = str(rng.choice(KINDS))
        n = int(np.exp(rng.uniform(0.0, np.log(3000.0))))
        faults.append(Fault(kind, round(float(rng.random()), 4), n))
    return Plan(
        seed, device, "process" if device != "plain" or rng.random() < 0.6 else "here", rate_hz, frequency_hz, gammas,
        settle, hold, is_controlled, limit_v, int(rng.choice(begins)),
        int(rng.choice([0, 2**31, 2**53 - 10**9, 2**62])),
        float(rng.choice([0.0, 80e-6, -80e-6])), tuple(faults),
    )  # fmt: skip


PROFILE = """
name = "simulation"
[sampling]
rate_hz = {rate_hz}
[forcing]
frequency_hz = {frequency_hz}
[drive]
g_per_volt = 2.0
[channels.continuity]
[channels.accelerometer]
sensitivity = 0.1
unit = "V/g"
[channels.displacement]
v_per_m = 1.0
[ball]
mass_kg = 0.25
[ramp]
gamma = {gammas}
settle_cycles = {settle_cycles}
hold_cycles = {hold_cycles}
slew_per_cycle = 0.8
[limits]
drive_v = {drive_limit_v}
plate_mps2 = 80.0
displacement_m = 1e5
contact_cycles = 6
{tables}
"""
BACKENDS = {
    "plain": "[backend]\nmarker_v = {marker_v}\n",
    "card": '[backend]\nkind = "soundcard"\ndevice = "simulation"\nbuffer_s = 0.05\nmarker_v = {marker_v}\n',
    "serial": '[backend]\nkind = "soundcard+serial"\ndevice = "simulation"\nport = "sim"\nmarker_v = {marker_v}\n'
    "buffer_s = 0.05\n",
}
CONTROL = "[control]\nwindow_cycles = 2\nwait_cycles = 1\nmax_cycles = 60\n"


def profile_text(plan: Plan) -> str:
    """The profile of the simulated bench."""
    shown = asdict(plan) | {"gammas": list(plan.gammas)}
    backend = BACKENDS[plan.device].format(marker_v=min(0.2, plan.drive_limit_v))
    return PROFILE.format(**shown, tables=(CONTROL if plan.is_controlled else "") + backend)
