"""How far the plate is from its target, open loop and closed, on rigs that answer otherwise than their profile says.

    python benchmarks/closed_loop.py [--quick]

Each step's hold is judged by the analysis (`analysis.plate`), not by the loop: worst relative error of a tone's
amplitude and worst error of its phase over all steps of a ramp, the ball bouncing.
"""

from __future__ import annotations

import math
import sys
import tempfile
from pathlib import Path

import numpy as np

from analysis.plate import plate_of
from bench.profiles import load
from daq.recording import RecordingWriter, open_recording
from rig.amplitude import target_acceleration
from rig.backends.simulated import SimulatedBackend
from rig.profile import ControlTable, Profile
from rig.run import RunSummary, run_ramp
from rig.sim.scenario import Scenario

F_HZ = 25.37
GAIN = {"drive_gain": {"relative": 10 ** (3 / 20) - 1}}
LAG = {"phase_lag": {"time_constant_s": math.tan(math.radians(20)) / (2 * math.pi * F_HZ)}}
PROFILES = {1: "simulated", 2: "c2", 3: "c3"}


def resonance(mass_ratio: float) -> dict[str, dict[str, float]]:
    """A table mode at 5 Hz that the impacts drive."""
    return {"table_resonance": {"frequency_hz": 5.0, "damping": 0.05, "mass_ratio": mass_ratio}}


RIGS = {
    "3 dB": GAIN,
    "20 degrees": LAG,
    "5 Hz resonance (1 %)": resonance(0.01),
    "all three": GAIN | LAG | resonance(0.01),
    "all three (resonance 3 %)": GAIN | LAG | resonance(0.03),
}


def run(profile: Profile, effects: dict[str, dict[str, float]], path: Path) -> RunSummary:
    """One ramp on the simulated rig."""
    backend = SimulatedBackend(profile.sampling.rate_hz, Scenario("off", effects), seed=11)
    writer = RecordingWriter(
        path, profile.setup(), profile_text="", channels=backend.channels, scales=backend.scales,
        backend=backend.name, simulated=True,
    )  # fmt: skip
    return run_ramp(profile, backend, writer)


def worst(profile: Profile, path: Path) -> tuple[float, float, float, float]:
    """Worst amplitude error (relative), phase error (degrees), both of the judge and of the loop's own achieved gamma."""
    relative, degrees, own = [], [], []
    with open_recording(path) as recording:
        for row, step in zip(recording.steps, plate_of(recording).steps, strict=True):
            if step is None:
                continue
            measured = np.array([step.tone(m)[0] for m, _ in profile.forcing.displacement_tones()])
            ratio = measured / target_acceleration(profile, float(row["gamma"]))
            relative.append(np.abs(np.abs(ratio) - 1).max())
            degrees.append(np.degrees(np.abs(np.angle(ratio))).max())
            own.append(abs(row["achieved_gamma"] / row["gamma"] - 1))
        settle = float(np.mean(recording.steps["settle_cycles"]))
    return max(relative), max(degrees), max(own), settle


def main() -> None:
    """Print one row a rig and c."""
    rigs = dict(list(RIGS.items())[3:4]) if "--quick" in sys.argv else RIGS
    print("| rig | c | loop | worst amplitude, % | worst phase, deg | worst by own estimate, % | settle, cycles a step | ended |")
    print("|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name, effects in rigs.items():
            for ratio, shipped in PROFILES.items():
                for control in (None, ControlTable()):
                    profile = load(shipped)[0].model_copy(update={"control": control})
                    path = Path(folder) / f"{len(list(Path(folder).iterdir()))}.h5"
                    summary = run(profile, effects, path)
                    r, d, own, settle = worst(profile, path)
                    print(
                        f"| {name} | {ratio} | {'closed' if control else 'open'} | {100 * r:.2f} | {d:.2f} | "
                        f"{100 * own:.2f} | {settle:.0f} | {summary.how} {summary.why} |",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
