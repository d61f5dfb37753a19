"""`rig.checks.check`: a rig as its profile says passes, and each thing that is not so is found by its own line."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bench.profiles.find import load
from daq.files.tables import Block
from rig.backends.simulated import SimulatedBackend
from rig.checks.check import Check, Finding
from rig.profile import Profile, parse_profile
from rig.sim.scenario import Scenario


class Crooked:
    """The simulated rig with its channels altered, or late."""

    name, simulated, scenario_sha256 = "crooked", True, None

    def __init__(self, late: int = 0, order: tuple[int, ...] = (0, 1, 2), **factors: float) -> None:
        self._rig = SimulatedBackend(20000.0, Scenario("ideal"), 1)
        self.channels, self.rate_hz, self.scales = self._rig.channels, self._rig.rate_hz, self._rig.scales
        self._order = list(order)
        self._late, self._factors = np.zeros((late, 3), np.int16), factors

    def start(self) -> None:
        """Start the rig."""
        self._rig.start()

    def exchange(self, drive_v: np.ndarray) -> Block:
        """Its frames, altered."""
        codes = self._rig.exchange(drive_v).codes.astype(float)
        for name, factor in self._factors.items():
            codes[:, self.channels.index(name)] *= factor
        codes = codes[:, self._order]
        every = np.concatenate([self._late, codes.clip(-32768, 32767).astype(np.int16)])
        self._late = every[len(codes) :]
        return Block(0, every[: len(codes)])

    def stop(self) -> None:
        """Stop the rig."""
        self._rig.stop()


def findings(backend: Any, *changes: tuple[str, str]) -> dict[str, Finding]:
    """Findings by name, on the simulated profile with some text of it changed."""
    _, text = load("simulated")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    profile: Profile = parse_profile(text)
    return {finding.what: finding for finding in Check(profile, backend).run()}


def failed(found: dict[str, Finding]) -> set[str]:
    """What did not pass; each says what to do."""
    bad = [finding for finding in found.values() if finding.passed is False]
    assert all(finding.remedy for finding in bad)
    return {finding.what for finding in bad}


@pytest.mark.parametrize("ratio", [1, 2, 3])
def test_a_rig_as_its_profile_says_passes(ratio: int) -> None:
    """Every line of the ideal rig passes, for one tone and for two."""
    found = findings(Crooked(), ("ratio = 1", f"ratio = {ratio}"), ("stop = 2.6, steps = 23", "stop = 0.6, steps = 3"))
    assert not failed(found) and len(found) == 13
    assert all(finding.passed for finding in found.values())


@pytest.mark.parametrize(
    ("backend", "bad"),
    [
        (Crooked(accelerometer=-1.0), {"accelerometer sign"}),
        (Crooked(accelerometer=1.2), {"accelerometer sensitivity"}),
        (Crooked(drive=0.5), {"loop-back gain", "accelerometer sensitivity"}),
        (Crooked(drive=0.0), {"loop-back delay", "loop-back gain", "noise of drive"}),
        (Crooked(continuity=0.0), {"contact circuit", "contact levels", "noise of continuity"}),
        (Crooked(continuity=0.6), {"contact levels"}),
        (
            Crooked(accelerometer=20.0),
            {"accelerometer sensitivity", "noise of accelerometer", "margin of accelerometer"},
        ),
        (Crooked(late=900), {"output latency and loop-back delay"}),
    ],
)
def test_each_fault_has_its_line(backend: Crooked, bad: set[str]) -> None:
    """A turned or wrongly scaled channel, a missing cable, noise, too late a device: that line fails, no other."""
    assert failed(findings(backend)) == bad


@pytest.mark.parametrize(
    ("order", "seen"),
    [
        ((0, 2, 1), "the accelerometer input reads what the drive input should"),
        ((2, 1, 0), "the continuity input reads what the drive input should"),
        ((1, 0, 2), "the continuity input reads what the accelerometer input should"),
    ],
)
def test_exchanged_inputs_are_named(order: tuple[int, ...], seen: str) -> None:
    """Two plugs in each other's place: one line names both, whatever else fails with them."""
    found = findings(Crooked(order=order))
    assert found["inputs"].passed is False and found["inputs"].seen == seen


def test_a_delay_within_a_cycle_passes() -> None:
    """Half a cycle late is allowed, is said, and spoils no other line."""
    found = findings(Crooked(late=394))
    assert not failed(found)
    assert "394.0" in found["output latency and loop-back delay"].seen


def test_what_a_limit_forbids_is_not_driven() -> None:
    """Where the limits do not let the ball fly, the contact circuit is said to be not judged."""
    found = findings(Crooked(), ("plate_mps2 = 120.0", "plate_mps2 = 12.0"))
    assert found["contact circuit"].passed is None and "limits.plate_mps2" in found["contact circuit"].seen


class Touched(Crooked):
    """The simulated rig, touched while nothing is driven: volts added to channels from the first second on."""

    def __init__(self, **volts: float) -> None:
        super().__init__()
        self._volts, self._heard = volts, 0

    def exchange(self, drive_v: np.ndarray) -> Block:
        """Its frames, with what the hand does."""
        codes = super().exchange(drive_v).codes.copy()
        self._heard += len(codes)
        if self._heard > self.rate_hz:
            for name, volts in self._volts.items():
                codes[: len(codes) // 2, self.channels.index(name)] += round(volts / self.scales[name][0])
        return Block(0, codes)


@pytest.mark.parametrize(
    ("move", "volts", "passed", "seen"),
    [
        ("tap", {"accelerometer": 0.2}, True, "accelerometer by 0.2"),
        ("tap", {"continuity": 0.2}, False, "the continuity input reads what the accelerometer input should"),
        ("tap", {}, False, "accelerometer by 0.0"), ("lift", {"continuity": 5.0}, True, "continuity by 5"),
        ("lift", {"accelerometer": 5.0}, False, "the accelerometer input reads what the continuity input should"),
        ("lift", {"accelerometer": 0.5}, False, "accelerometer by 0.5"),
    ],
)  # fmt: skip
def test_a_hand_shows_which_terminal_is_what(move: str, volts: dict[str, float], passed: bool, seen: str) -> None:
    """A tap answers at the accelerometer and a lifted ball at the contact; exchanged plugs and none are named."""
    said: list[bool] = []
    found = Check(load("simulated")[0], Touched(**volts)).moved(move, lambda: said.append(True), 1.5)
    assert found.passed is passed and seen in found.seen and said == [True]
    assert passed or found.remedy


def test_a_single_code_is_no_tap() -> None:
    """An input that stands still at rest, and then changes by one code, has not answered."""
    rig = Touched(accelerometer=0.0004)
    rig._factors = {"accelerometer": 0.0}
    found = Check(load("simulated")[0], rig).moved("tap", lambda: None, 1.5)
    assert found.passed is False and "nothing answered" in found.remedy


class Tapped(Crooked):
    """The simulated rig whose table rings from when it is struck on."""

    def __init__(self, hz: float) -> None:
        super().__init__()
        self._hz, self._since = hz, -1

    def strike(self) -> None:
        """Hit the table."""
        self._since = 0

    def exchange(self, drive_v: np.ndarray) -> Block:
        """Frames with the ringing."""
        block = super().exchange(drive_v)
        if self._since < 0 or not self._hz:
            return block
        time_s = (self._since + np.arange(len(block.codes))) / self.rate_hz
        self._since += len(block.codes)
        ringing = 3000.0 * np.exp(-2.0 * time_s) * np.sin(2.0 * np.pi * self._hz * time_s)
        codes = block.codes.astype(float)
        codes[:, self.channels.index("accelerometer")] += ringing
        return Block(0, codes.astype(np.int16))


@pytest.mark.parametrize(("hz", "said"), [(8.0, "Hz, damping 0.04"), (0.0, "no tap")])
def test_a_table_that_rings_below_the_forcing_is_a_question(hz: float, said: str) -> None:
    """A tap is asked for: what rings at 8 Hz is named, with a remedy; without a hit, that none was seen."""
    rig = Tapped(hz)
    found = {finding.what: finding for finding in Check(load("simulated")[0], rig, rig.strike).run()}["table's mode"]
    assert said in found.seen and found.passed is None and found.remedy
