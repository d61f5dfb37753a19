"""Every cause for which a run is stopped, tried on the simulated rig: how soon the drive is zero, and what is kept.

    python -m benchmarks.rig.execution.interlock

A fault begins at sample 60,000 (3 s into the ramp). "noticed" counts cycles of the forcing from the fault to the
first sample of the fade (or cut) to zero, "zero" from there to the first sample at 0 V.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

import rig.execution.interlock
from bench.profiles.find import load
from daq.files.tables import Block
from daq.recording import open_recording
from daq.recording.writer import RecordingWriter
from rig.backends.base import Backend
from rig.backends.simulated import SimulatedBackend
from rig.execution.operator import Status, StopRequest
from rig.execution.run import run_ramp
from rig.profile import Profile
from rig.programme.sequencer import Stop
from rig.sim.scenario import Scenario
from tests.fakes.faults import (
    AmplifierTrip,
    Clipping,
    Fault,
    FaultyBackend,
    JammedSensor,
    LooseCable,
    Unplugged,
)

AT = 60_000
RNG = np.random.default_rng(1)


class Stalls(Fault):
    """The exchange that holds sample `AT` takes far too long."""

    def on_block(self, first: int, block: Block) -> Block:
        if first <= AT < first + len(block.codes):
            time.sleep(rig.execution.interlock.HEARTBEAT_S + 0.3)
        return block


class ScaleJumps(Fault):
    """From `AT` on the plate answers three times as much (a gain switch was touched)."""

    def on_drive(self, first: int, drive_v: np.ndarray) -> np.ndarray:
        return np.where(first + np.arange(len(drive_v)) >= AT, 3.0 * drive_v, drive_v)


def limits(**changed: float) -> Callable[[Profile], Profile]:
    """A profile with other limits."""
    return lambda p: p.model_copy(update={"limits": p.limits.model_copy(update=changed)})


def asked(how: Stop) -> Callable[[StopRequest], Callable[[Status], None]]:
    """Someone asks for a stop at `AT`."""

    def make(request: StopRequest) -> Callable[[Status], None]:
        return lambda status: request.ask(how, f"asked: {how.name}") if status.sample >= AT else None

    return make


def crash(request: StopRequest) -> Callable[[Status], None]:
    """The screen raises at `AT`."""

    def progress(status: Status) -> None:
        if AT <= status.sample < AT + 300:
            raise RuntimeError("the screen is gone")

    return progress


CASES: dict[str, tuple[Sequence[Fault], Callable[[Profile], Profile] | None, object]] = {
    "dead accelerometer": ([JammedSensor("accelerometer", AT)], None, None),
    "amplifier trips": ([AmplifierTrip(AT)], None, None),
    "clipped accelerometer": ([Clipping("accelerometer", 0.25)], None, None),
    "continuity wire off": ([LooseCable("continuity", AT, 10**9, RNG, 5.0, 0.002, 1e9)], None, None),
    "continuity shorted": ([JammedSensor("continuity", 0)], None, None),
    "plate acceleration": ([ScaleJumps()], limits(plate_mps2=20.0), None),
    "plate velocity": ([ScaleJumps()], limits(velocity_mps=0.14), None),
    "plate displacement": ([ScaleJumps()], limits(displacement_m=0.0008), None),
    "drive volts (clamp)": ([], limits(drive_v=0.5), None),
    "lost heartbeat": ([Stalls()], None, None),
    "card unplugged": ([Unplugged(AT)], None, None),
    "exception": ([], None, crash),
    "stop: ramp down (SIGINT, SIGTERM)": ([], None, asked(Stop.RAMP_DOWN)),
    "stop: now": ([], None, asked(Stop.NOW)),
    "stop: finish step": ([], None, asked(Stop.FINISH_STEP)),
}


class RealDevice(FaultyBackend):
    """The faulty rig as if it were real, so that its heartbeat is watched."""

    def __init__(self, inner: Backend, faults: Sequence[Fault]) -> None:
        super().__init__(inner, faults)
        self.simulated = False


def row(name: str, folder: Path) -> str:
    """Run one case; its row of the table."""
    faults, change, progress = CASES[name]
    profile = load("simulated")[0]
    profile = change(profile) if change else profile
    inner = SimulatedBackend(profile.sampling.rate_hz, Scenario("ideal"), seed=5)
    device = (RealDevice if name == "lost heartbeat" else FaultyBackend)(inner, faults)
    played = 0
    exchange = device.exchange

    def counted(drive_v: np.ndarray) -> Block:
        nonlocal played
        block = exchange(drive_v)
        played += len(drive_v)
        return block

    device.exchange = counted  # type: ignore[method-assign]
    path, request = folder / f"{len(list(folder.iterdir()))}.h5", StopRequest()
    writer = RecordingWriter(
        path, profile.setup(), profile_text="", channels=device.channels, scales=device.scales, backend=device.name,
        simulated=True,
    )  # fmt: skip
    try:
        run_ramp(profile, device, writer, progress=progress(request) if progress else None, stop_request=request)
    except RuntimeError as error:
        if progress is not crash:
            raise error
    with open_recording(path) as recording:
        last = recording.drive_changes[-1]
        cycle = recording.rate_hz / profile.forcing.frequency_hz
        noticed, zero = f"{(last['first_sample'] - AT) / cycle:.1f}", f"{last['n_samples'] / cycle:.2f}"
        if name == "card unplugged":
            noticed = zero = "at once"
        lost, ended, why = played - recording.n_samples, recording.attrs["ended"], recording.attrs["why"]
        return f"| {name} | {noticed} | {zero} | {lost} | {ended} | {why} |"


def main() -> None:
    """Print the table."""
    print("| cause | noticed, cycles | zero, cycles | samples lost | ended | why |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name in sys.argv[1:] or CASES:
            print(row(name, Path(folder)), flush=True)


if __name__ == "__main__":
    main()
