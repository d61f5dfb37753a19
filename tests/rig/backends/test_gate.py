"""The gate in the drive's way: firmware compiled for this machine, and the back end that keeps it open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.profiles.find import load
from benchmarks.rig import gate_deaths
from daq.files.tables import Block
from daq.setup.errors import InputError
from kernels.arrays import Floats
from rig.backends.base import BackendError, Lagging, TwoClocked
from rig.backends.gate import (
    ARM,
    FADING,
    LATCHED,
    OPEN,
    REST,
    GatedBackend,
    GateLimits,
    StatusReader,
    limits_for,
    message,
)
from rig.backends.registry import open_backend
from rig.profile import Profile
from tests.fakes.gate import Gate, build_gate

LIMITS = limits_for(25.0, 25.0, 0.5, 2000.0)  # 80 samples a cycle


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The firmware's gate, compiled for this machine."""
    return build_gate(tmp_path_factory.mktemp("gate"))


class Rig:
    """A back end whose drive goes through a gate, and the port that leads to it."""

    name, simulated, channels, rate_hz, scenario_sha256 = "rig", True, ("drive",), 2000.0, None
    scales = {"drive": (1.0, 0.0)}

    def __init__(self, gate: Gate) -> None:
        self.gate, self.out, self.is_closed, self.is_mute = gate, np.zeros(0, np.int16), False, False

    def start(self) -> None:
        """Nothing."""

    def stop(self) -> None:
        """Nothing."""

    def exchange(self, drive_v: Floats) -> Block:
        """The drive, in parts of full scale, passes the gate."""
        codes = np.rint(drive_v * 32767).astype(np.int16)
        self.out = np.concatenate([self.out, self.gate.play(codes)])
        return Block(0, codes[:, None])

    in_waiting = 64

    def read(self, size: int) -> bytes:
        """What the gate says."""
        return b"" if self.is_mute else self.gate.status()

    def write(self, data: bytes) -> int:
        """What the gate hears."""
        self.gate.hear(data)
        return len(data)

    def close(self) -> None:
        """The port is closed."""
        self.is_closed = True


def state(gate: Gate) -> int:
    """The gate's state."""
    status = StatusReader().feed(gate.status())
    assert status is not None
    return status.state


def sine(first: int, n: int, part: float) -> Floats:
    """Samples of a drive at the gate's rate."""
    return np.asarray(part * np.sin(2 * np.pi * 25.0 / 2000.0 * np.arange(first, first + n)))


def test_host_deaths_end_at_zero(library: Path) -> None:
    """150 deaths at random moments of the protocol end at zero within two cycles, locked (1,000: benchmarks)."""
    counts = gate_deaths.score(lambda now: Gate(library, now), 150, 2)
    assert counts["at zero within two cycles, and locked"] == 150
    assert counts["armed"] > 100


def test_a_run_keeps_the_gate_open_and_its_end_does_not_lock_it(library: Path) -> None:
    """While blocks are exchanged the drive passes unchanged; after the stop the gate is at rest, ready to be armed."""
    rig = Rig(Gate(library))
    backend = GatedBackend(rig, lambda: rig, LIMITS)
    backend.start()
    for first in range(0, 2000, 40):
        backend.exchange(sine(first, 40, 0.4))
    np.testing.assert_array_equal(rig.out[80:], np.rint(32767 * sine(80, 1920, 0.4)).astype(np.int16))
    backend.stop()
    assert rig.is_closed
    rig.exchange(np.zeros(160))
    assert state(rig.gate) == REST
    backend.start()
    assert not isinstance(backend, TwoClocked | Lagging)


def test_a_host_that_stops_exchanging_is_locked_out(library: Path) -> None:
    """Without exchanges the gate closes, and the next one is an error that says why and what to do."""
    rig = Rig(Gate(library))
    backend = GatedBackend(rig, lambda: rig, LIMITS)
    backend.start()
    for first in range(0, 400, 40):
        backend.exchange(sine(first, 40, 0.4))
    rig.exchange(sine(400, 160, 0.4))
    assert state(rig.gate) in (FADING, LATCHED)
    assert not rig.out[-5:].any()
    with pytest.raises(BackendError, match=r"heartbeats ended.*press its button"):
        backend.exchange(sine(0, 40, 0.4))
    with pytest.raises(BackendError, match="press its button"):
        backend.start()
    rig.gate.press()
    backend.start()


@pytest.mark.parametrize(
    ("drive", "why"), [(sine(0, 400, 0.6), "beyond its limit"), (np.tile([0.3, -0.3], 200), "faster")]
)
def test_the_gate_holds_its_limits(library: Path, drive: Floats, why: str) -> None:
    """A drive beyond the limit of amplitude or slew is held to it, faded out, and named."""
    rig = Rig(Gate(library))
    backend = GatedBackend(rig, lambda: rig, LIMITS)
    backend.start()

    def run() -> None:
        for first in range(0, 400, 40):
            backend.exchange(drive[first : first + 40])

    with pytest.raises(BackendError, match=why):
        run()
    assert np.abs(rig.out.astype(int)).max() <= LIMITS.limit
    assert np.abs(np.diff(rig.out.astype(int))).max() <= LIMITS.slew


def test_a_gate_that_cannot_be_heard_is_an_error(library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A silent gate is named at the start, and while a run lasts."""
    monkeypatch.setattr("rig.backends.gate.FIRST_S", 0.05)
    monkeypatch.setattr("rig.backends.gate.SILENCE_S", -1.0)
    rig = Rig(Gate(library))
    backend = GatedBackend(rig, lambda: rig, LIMITS)
    backend.start()
    rig.is_mute = True
    with pytest.raises(BackendError, match="no message"):
        backend.exchange(np.zeros(40))
    with pytest.raises(BackendError, match="silent"):
        backend.start()
    with pytest.raises(BackendError, match="not started"):
        backend.exchange(np.zeros(40))


def test_a_gate_whose_cable_is_pulled_is_an_error(library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A port that fails as the gate is answered, or first heard, is named, and is closed."""
    rig = Rig(Gate(library))
    backend = GatedBackend(rig, lambda: rig, LIMITS)

    def gone(_: object) -> bytes:
        raise OSError("no such device")

    backend.start()
    monkeypatch.setattr(rig, "write", gone)
    with pytest.raises(BackendError, match="went away"):
        backend.exchange(np.zeros(40))
    backend.stop()
    assert rig.is_closed
    rig.is_closed = False
    monkeypatch.setattr(rig, "read", gone)
    with pytest.raises(BackendError, match="went away"):
        backend.start()
    assert rig.is_closed


@pytest.mark.parametrize("limits", [
    GateLimits(8, 100, 100), GateLimits(9000, 100, 100), GateLimits(80, 0, 100), GateLimits(80, 2001, 100),
    GateLimits(80, 40000, 32767),
])  # fmt: skip
def test_limits_that_would_keep_the_drive_from_zero_do_not_arm(library: Path, limits: GateLimits) -> None:
    """Cycles too short or too long, no amplitude, or a slew too small for a fall in a quarter cycle: at rest."""
    gate = Gate(library, 5)
    gate.hear(message(ARM, 5, limits))
    assert state(gate) == REST
    gate.hear(message(ARM, 5, LIMITS))
    assert state(gate) == OPEN


def test_a_profile_names_its_gate() -> None:
    """A card with a gate is opened behind it; blocks that leave heartbeats too far apart are refused."""
    profile, _ = load("soundcard")

    def with_gate(block_samples: int) -> Profile:
        options = {"device": "x", "gate_port": "nowhere", "block_samples": block_samples}
        return profile.model_copy(update={"backend": profile.backend.model_copy(update=options)})

    assert isinstance(open_backend(with_gate(512)), GatedBackend)
    with pytest.raises(InputError, match="between heartbeats"):
        open_backend(with_gate(4096))
