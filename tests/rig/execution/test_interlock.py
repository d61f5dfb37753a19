"""The interlock: each cause alone trips it, an ordinary run does not."""

from __future__ import annotations

import numpy as np
import pytest

from daq.files.tables import Block
from rig.execution.interlock import Interlock
from rig.execution.plate_monitor import MotionWatch
from rig.execution.run import run_ramp
from rig.programme.ramp import HighPass

LONG = ("hold_cycles = 3", "hold_cycles = 30")

GENEROUS = [("plate_mps2 = 120.0", "plate_mps2 = 9e3"), ("velocity_mps = 2.0", ""), ("m = 0.02", "m = 1.0")]


class Tape:
    """A recorder that only counts."""

    def __init__(self) -> None:
        self.n_samples, self.how, self.why, self.steps = 0, "", "", {}

    def append(self, *blocks) -> None:
        self.n_samples += sum(len(block.codes) for block in blocks)

    def mark_step(self, step) -> None:
        self.steps[step["first_sample"]] = step

    def mark_rows(self, table, rows) -> None:
        pass

    def close(self, how="complete", why="", expected_samples=None) -> None:
        self.how, self.why = how, why

    def __enter__(self):
        return self

    def __exit__(self, *error) -> None:
        return None


def run(profile, rig) -> Tape:
    """Run the profile on the device."""
    tape = Tape()
    run_ramp(profile, rig, tape)
    return tape


def test_an_ordinary_run_passes(make_profile, fake_rig) -> None:
    """Nothing trips while the plate follows and the ball rests."""
    profile = make_profile(LONG)
    tape = run(profile, fake_rig(profile))
    assert (tape.how, tape.why) == ("complete", "")


@pytest.mark.parametrize(
    ("changes", "fault", "said"),
    [
        ([], {"dead_from": 1500}, "dead accelerometer: its reading has not changed for a cycle"),
        ([], {"gain": 0.05}, "dead accelerometer: the drive asks for"),
        ([("plate_mps2 = 120.0", "plate_mps2 = 5.5")], {}, "limits.plate_mps2 allows 5.5"),
        ([("velocity_mps = 2.0", "velocity_mps = 0.03")], {}, "limits.velocity_mps allows 0.03"),
        ([("displacement_m = 0.02", "displacement_m = 2.5e-4")], {}, "limits.displacement_m allows 0.00025"),
        ([("drive_v = 9.5", "drive_v = 0.4")], {}, "the clamp held back"),
        (GENEROUS, {"gain": 200.0}, "more motion than was asked for"),
        ([('unit = "V/g"', 'unit = "V/g"\nrange_v = 0.04')], {}, "clipped input: accelerometer"),
        ([], {"silent_from": 1500}, "no drive: over 4 cycles the drive asks for"),
        ([], {"silent_from": 1500, "flags": 2}, "the drive ran dry (UNDERFLOW): over 4 cycles"),
        ([], {"order": (0, 2, 1)}, "exchanged inputs: the accelerometer input reads the drive as it was played"),
        ([], {"order": (2, 1, 0)}, "exchanged inputs: the continuity input reads the drive as it was played"),
        ([], {"order": (1, 0, 2), "noise_v": 1e-3}, "exchanged inputs: the drive asks for"),
        ([], {"open_from": 1500}, "open for 8 cycles and the accelerometer shows no impact: a broken wire?"),
    ],
)
def test_each_cause_stops_the_run_softly(make_profile, fake_rig, changes, fault, said) -> None:
    """Each cause ends the run with its reason, the drive at zero within two cycles of the trip, without a jump."""
    profile = make_profile(LONG, *changes)
    rig = fake_rig(profile)
    for name, value in fault.items():
        setattr(rig, name, value)
    tape = run(profile, rig)
    assert tape.how == "stopped" and said in tape.why and tape.why.startswith("interlock: ")
    drive = rig.drive_v
    assert np.abs(drive).max() <= profile.limits.drive_v
    assert not np.any(drive[-int(profile.sampling.rate_hz / 25.37 / 2) :])
    assert np.abs(np.diff(drive)).max() < 0.06
    assert tape.n_samples == len(drive)


def test_a_stalled_device_is_noticed(make_profile, fake_rig, monkeypatch) -> None:
    """A real device that answers far too late trips the heartbeat; a simulated one may take its time."""
    monkeypatch.setattr("rig.execution.interlock.HEARTBEAT_S", 0.05)
    for simulated in (True, False):
        rig = fake_rig(make_profile())
        rig.simulated, rig.stalls_from, rig.stall_s = simulated, 500, 0.12
        tape = run(make_profile(), rig)
        assert (tape.how == "complete") is simulated
        assert simulated or "lost heartbeat" in tape.why


def test_short_circuit_is_seen_only_where_a_ball_must_fly(make_profile, fake_rig) -> None:
    """A contact that never opens is a fault above take-off, and none below; a flying ball clears it."""
    changes = (LONG, ("gamma = [0.2, 0.5, 0.3]", "gamma = [1.9]"))
    fast = make_profile(*changes)
    assert "has not opened for 8 cycles" in run(fast, fake_rig(fast)).why
    flying = fake_rig(fast)
    flying.ball_flies = True
    assert run(fast, flying).how == "complete"
    unwatched = make_profile(*changes, ("contact_cycles = 8", "contact_cycles = 0"))
    assert run(unwatched, fake_rig(unwatched)).how == "complete"


def test_clamp_stands_after_everything(make_profile, fake_rig) -> None:
    """Whatever asks for volts, no more than the limit passes."""
    profile = make_profile()
    rig = fake_rig(profile)
    interlock = Interlock(profile, rig.channels, rig.scales)
    asked = np.linspace(-50.0, 50.0, 101)
    passed = interlock.clamp(asked)
    assert np.abs(passed).max() == 9.5
    inside = np.abs(asked) <= 9.5
    assert np.array_equal(passed[inside], asked[inside])


def test_behind_a_capacitor_the_contact_is_read_by_the_sign(make_profile, fake_rig) -> None:
    """AC-coupled continuity that droops to nothing between edges: a closing is a landing, noise is none."""
    profile = make_profile(("[channels.continuity]", '[channels.continuity]\ncoupling = "ac"'))
    rig = fake_rig(profile)
    interlock = Interlock(profile, rig.channels, rig.scales)
    rng = np.random.default_rng(0)
    level = np.tile([0.0, 5.0], 20).repeat(60)
    droop = np.zeros(len(level))
    for i in range(1, len(level)):
        droop[i] = 0.94 * (droop[i - 1] + level[i] - level[i - 1])
    volts = np.concatenate([np.zeros(500), droop, np.zeros(500)]) + 0.1 * rng.standard_normal(len(level) + 1000)
    codes = np.zeros((len(volts), 3), np.int16)
    codes[:, 0] = np.rint(volts / rig.scales["continuity"][0])
    landed = [interlock.circuit(piece)[1] for piece in np.array_split(codes, 37)]
    wanted = 500 + np.flatnonzero(np.diff(level) < 0) + 1
    assert np.array_equal(np.flatnonzero(np.concatenate(landed)), wanted)


@pytest.mark.parametrize(("brief", "trips"), [(True, False), (False, True)])
def test_behind_a_capacitor_a_ball_that_hardly_touches_is_in_flight(make_profile, fake_rig, brief, trips) -> None:
    """Contacts of 2 samples in two cycles leave the open level at 0 V, and are seen; no contact at all is a fault."""
    profile = make_profile(("[channels.continuity]", '[channels.continuity]\ncoupling = "ac"'), *GENEROUS)
    rig = fake_rig(profile)
    interlock = Interlock(profile, rig.channels, rig.scales)
    scale = rig.scales["accelerometer"][0] / profile.channels.accelerometer.volts_per_mps2
    watch = MotionWatch(profile, scale)
    n, cycle = 60 * 79, 2000 / 25.37
    level = np.where(np.arange(n) % 158 < 2, 0.0, 5.0) if brief else np.zeros(n)
    drive = 2.0 * np.sin(2 * np.pi * np.arange(n) / cycle)
    codes = np.zeros((n, 3), np.int16)
    noise = 0.002 * np.random.default_rng(0).standard_normal(n)
    codes[:, 0] = np.rint((HighPass(5.0, 2000.0)(level) + noise) / rig.scales["continuity"][0])
    codes[:, 1] = np.rint(drive * 2.0 * 9.80665 / scale)
    reasons = []
    for first in range(0, n, 19):
        piece = slice(first, first + 19)
        motion = watch.update(codes[piece, 1], interlock.circuit(codes[piece])[1])
        reasons.append(interlock.inspect(drive[piece], Block(first, codes[piece]), motion))
    assert any(reason and "contact" in reason for reason in reasons) == trips
