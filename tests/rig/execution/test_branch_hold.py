"""A ball held on the locked cycle where that is unstable: by small corrections, whatever the card's delay."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from bench.profiles.find import load
from daq.files.tables import Block
from daq.recording import open_recording
from daq.recording.writer import RecordingWriter
from daq.setup.errors import InputError
from rig.execution.branch_hold import BranchHold, LockedBranch
from rig.execution.run import run_ramp
from rig.profile import BranchTable, Profile
from rig.sim.scenario import Scenario
from tests.fakes.commanded_drive import commanded, fades_of_changes
from tests.fakes.delayed import Delayed

FRICTION = Scenario("friction", {"coulomb_friction": {"mu_up": 0.1, "mu_down": 0.1}})
MOST = 0.02  # of the drive


class Watched(Delayed):
    """The rig, of whose ball the true flight times are noted."""

    def start(self) -> None:
        super().start()
        self._flights: dict[float, float] = {}

    def exchange(self, drive_v: np.ndarray) -> Block:
        block = super().exchange(drive_v)
        ball = self._plant._state[0]
        self._flights[float(ball["landed_s"])] = float(ball["flight_s"])
        return block

    @property
    def flights_s(self) -> np.ndarray:
        """Flight times in order, the last one is cut off by the end of the drive."""
        return np.array(list(self._flights.values()))


def ideal_branch() -> LockedBranch:
    """The locked cycle of the ideal ball on one sine, in closed form, up to gamma_peak 6.1."""
    peak = np.linspace(math.sqrt(math.pi**2 + 1.0), 6.1, 300)
    return LockedBranch(peak / 2.0, np.arccos(math.pi / peak), 1.0 - np.sqrt(peak**2 - math.pi**2))


def profile_of(*gammas: float, hold_cycles: int = 30) -> Profile:
    """The shipped profile of one sine with these steps, and fades that a held ball can follow."""
    profile, _ = load("simulated")
    ramp = {"gamma": gammas, "order": None, "settle_cycles": 14, "hold_cycles": hold_cycles, "slew_per_cycle": 0.01}
    return profile.model_copy(update={"ramp": profile.ramp.model_copy(update=ramp)})


def held(profile: Profile, rig: Delayed, path: Path, **table: float) -> tuple[BranchHold, np.ndarray, str]:
    """The holder after a run, the parts of the drive by which it corrected each launch, and how the run ended."""
    hold = BranchHold(profile, BranchTable(authority=MOST, **table), ideal_branch())
    writer = RecordingWriter(
        path, profile.setup(), profile_text="", channels=rig.channels, scales=rig.scales, backend=rig.name,
        simulated=True,
    )  # fmt: skip
    summary = run_ramp(profile, rig, writer, hold=hold)
    with open_recording(path) as recording:
        last = recording.steps[-1]
        changes = recording.drive_changes
        mine = changes[changes["first_sample"] > last["first_sample"] + last["settle_samples"]][:-1]
        volts = mine["end_re_v"] + 1j * mine["end_im_v"]
    return hold, volts / volts.mean() - 1.0, f"{summary.how} {summary.why}"


@pytest.mark.parametrize(("delay_ms", "scenario"), [(0, Scenario("ideal")), (30, Scenario("ideal")), (5, FRICTION)])
def test_the_branch_is_followed_to_a_multiplier_of_minus_four(recording_path, delay_ms: int, scenario) -> None:
    """To gamma_peak 6 the ball keeps the period, under corrections of less than 1 % of the drive that average out."""
    profile = profile_of(1.75, 2.0, 2.5, 3.0)
    rate_hz, cycle_s = profile.sampling.rate_hz, 1.0 / profile.forcing.frequency_hz
    rig = Watched(rate_hz, scenario, 3).behind(round(delay_ms * 20))
    hold, parts, ended = held(profile, rig, recording_path)
    assert (ended.strip(), hold.why) == ("complete", "")
    assert 29 <= len(parts) <= 31  # one a cycle
    assert np.sqrt(np.mean(np.abs(parts) ** 2)) < 0.01
    assert np.sqrt(np.mean((rig.flights_s[-35:-4] - cycle_s) ** 2)) < 1e-4


def test_the_drive_is_recorded_as_it_was(recording_path) -> None:
    """Base and corrections come back bit for bit from the recording's table of changes."""
    profile = profile_of(1.75, 1.9)
    rig = Delayed(profile.sampling.rate_hz, Scenario("ideal"), 1)
    played: list[np.ndarray] = []
    exchange = rig.exchange
    rig.exchange = lambda drive_v: (played.append(drive_v.copy()), exchange(drive_v))[1]
    held(profile, rig, recording_path, kick=0.002)
    with open_recording(recording_path) as recording:
        again = commanded(
            recording.setup, fades_of_changes(recording.setup, recording.drive_changes), 0, recording.n_samples
        )
    np.testing.assert_array_equal(np.concatenate(played), again)


def test_a_ball_that_is_lost_is_let_go_quietly(recording_path, monkeypatch) -> None:
    """Knocked off the branch the ball is let go: no limit trips, it is said, and in 20 cycles the drive is the
    programme's again and the ball on the stable motion, which repeats itself after two flights.
    """
    profile = profile_of(1.75, 2.0, 2.2, hold_cycles=60)
    rig = Watched(profile.sampling.rate_hz, Scenario("ideal"), 2)
    exchange, knocked = rig.exchange, []

    def knock(drive_v: np.ndarray):
        block = exchange(drive_v)
        if block.first_sample > 395_000 and not knocked:
            knocked.append(block.first_sample)
            rig._plant._state["height_m"] += 2e-3
        return block

    monkeypatch.setattr(rig, "exchange", knock)
    hold, _, ended = held(profile, rig, recording_path)
    assert knocked and ended.strip() == "complete" and "gamma" in hold.why
    with open_recording(recording_path) as recording:
        back = recording.drive_changes[-2]  # the last is the end of the run
        assert back["first_sample"] + back["n_samples"] < knocked[0] + 20 * 789
        end_s = float(recording.steps["first_sample"][-1] + recording.steps["n_samples"][-1]) / recording.rate_hz
    landed_s = np.array(list(rig._flights))
    later = rig.flights_s[(landed_s > (knocked[0] + 20 * 789) / profile.sampling.rate_hz) & (landed_s < end_s)]
    assert len(later) > 10
    np.testing.assert_allclose(later[2:], later[:-2], atol=1e-4)
    assert np.abs(np.diff(later)).min() > 1e-3
    with open_recording(recording_path) as recording:
        assert any("let go" in note["text"].decode() for note in recording.side["notes"])


def test_a_device_too_slow_for_the_multiplier_is_refused(recording_path) -> None:
    """Before anything moves, with the delay and the greatest that the branch allows; a lower ramp is not refused."""
    profile = profile_of(1.75, 3.0)
    rig = Delayed(profile.sampling.rate_hz, Scenario("ideal"), 2).behind(1600)
    with pytest.raises(InputError, match=r"answered 1\d\d ms later.*multiplier -4.11.*79 ms"):
        held(profile, rig, recording_path)
    hold = BranchHold(profile, BranchTable(), ideal_branch())
    hold.check_delay(1600, 1.8)


def test_a_ball_that_never_locks_is_said_not_to_be_held(recording_path) -> None:
    """Below the lock the ball rests in every cycle: nothing is held, and the summary says so."""
    profile = profile_of(1.0, 1.1)
    hold = BranchHold(profile, BranchTable(), ideal_branch())
    rig = Delayed(profile.sampling.rate_hz, Scenario("ideal"), 0)
    writer = RecordingWriter(
        recording_path, profile.setup(), profile_text="", channels=rig.channels, scales=rig.scales, backend=rig.name,
        simulated=True,
    )  # fmt: skip
    assert "never" in run_ramp(profile, rig, writer, hold=hold).let_go
