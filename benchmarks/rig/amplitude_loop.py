"""How far the plate is from its target, open loop and closed, on rigs that answer otherwise than their profile says.

    python -m benchmarks.rig.amplitude_loop [--quick]

Worst relative error of a tone's amplitude and worst error of its phase over the holds of all steps of a ramp, the ball
bouncing. Two judges that are not the loop: the analysis (`analysis.flights.scan`), and a twin: the same plant, given
the same drive bit for bit, whose sensor has neither noise nor ringing, fitted with nothing masked.
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from analysis.flights.scan import plate_of
from bench.profiles.find import load
from daq.lock_in import fit_tones
from daq.recording import Recording, open_recording
from daq.recording.writer import RecordingWriter
from rig.backends.simulated import SimulatedBackend
from rig.execution.amplitude_loop import target_acceleration
from rig.execution.operator import RunSummary
from rig.execution.run import run_ramp
from rig.profile import ControlTable, Profile
from rig.sim.scenario import Scenario
from tests.fakes.commanded_drive import commanded, fades_of_changes

Effects = dict[str, dict[str, float]]
F_HZ = 25.37
GAIN = {"drive_gain": {"relative": 10 ** (3 / 20) - 1}}
LAG = {"phase_lag": {"time_constant_s": math.tan(math.radians(20)) / (2 * math.pi * F_HZ)}}
PROFILES = {1: "simulated", 2: "c2", 3: "c3"}


def resonance(mass_ratio: float) -> Effects:
    """A table mode at 5 Hz that the impacts drive."""
    return {"table_resonance": {"frequency_hz": 5.0, "damping": 0.05, "mass_ratio": mass_ratio}}


RIGS = {
    "3 dB": GAIN,
    "20 degrees": LAG,
    "5 Hz resonance (1 %)": resonance(0.01),
    "all three": GAIN | LAG | resonance(0.01),
    "all three (resonance 3 %)": GAIN | LAG | resonance(0.03),
}


def run(profile: Profile, effects: Effects, path: Path) -> RunSummary:
    """One ramp on the simulated rig."""
    backend = SimulatedBackend(profile.sampling.rate_hz, Scenario("off", effects), seed=11)
    writer = RecordingWriter(
        path, profile.setup(), profile_text="", channels=backend.channels, scales=backend.scales,
        backend=backend.name, simulated=True,
    )  # fmt: skip
    return run_ramp(profile, backend, writer)


def twin_acceleration(recording: Recording, effects: Effects) -> Iterator[np.ndarray]:
    """Plate acceleration of each tone over every hold, by a twin of the plant whose sensor is perfect."""
    setup = recording.setup
    silent = Scenario("twin", effects, {"ring_g_s_per_m": 0.0, "accelerometer_noise_g": 0.0, "adc_bits": 16.0})
    twin = SimulatedBackend(recording.rate_hz, silent, seed=11)
    fades = fades_of_changes(setup, recording.drive_changes)
    twin.start()
    drive_v = commanded(setup, fades, 0, recording.n_samples)
    codes = np.concatenate([twin.exchange(piece).codes[:, 1] for piece in np.array_split(drive_v, 50)])
    acceleration = codes * (twin.scales["accelerometer"][0] / setup.channels.accelerometer.volts_per_mps2)
    f_hz = [m * F_HZ for m in range(1, 13)]
    wanted = [m - 1 for m, _ in setup.forcing.displacement_tones()]
    for row in recording.steps:
        first, end = int(row["first_sample"] + row["settle_samples"]), int(row["first_sample"] + row["n_samples"])
        yield fit_tones(acceleration[first:end], first, recording.rate_hz, f_hz).amplitudes[wanted]


def worst(profile: Profile, effects: Effects, path: Path) -> tuple[list[float], list[float], float]:
    """Worst amplitude error (relative) and phase error (degrees) by either judge, and the mean settling in cycles."""
    errors: list[list[np.ndarray]] = [[], []]
    with open_recording(path) as recording:
        rows = zip(recording.steps, plate_of(recording).steps, twin_acceleration(recording, effects), strict=True)
        for row, step, true in rows:
            target = target_acceleration(profile, float(row["gamma"]))
            errors[1].append(true / target)
            if step is not None:
                errors[0].append(np.array([step.tone(m)[0] for m, _ in profile.forcing.displacement_tones()]) / target)
        settle = float(np.mean(recording.steps["settle_cycles"]))
    relative = [100 * float(np.abs(np.abs(e) - 1).max()) if len(e) else math.nan for e in errors]
    degrees = [float(np.degrees(np.abs(np.angle(e))).max()) if len(e) else math.nan for e in errors]
    return relative, degrees, settle


def main() -> None:
    """Print one row a rig and c."""
    rigs = dict(list(RIGS.items())[3:4]) if "--quick" in sys.argv else RIGS
    print("| rig | c | loop | by the analysis: %, deg | by the twin: %, deg | settling, cycles | ended |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name, effects in rigs.items():
            for ratio, shipped in PROFILES.items():
                for control in (None, ControlTable()):
                    profile = load(shipped)[0].model_copy(update={"control": control})
                    path = Path(folder) / f"{len(list(Path(folder).iterdir()))}.h5"
                    summary = run(profile, effects, path)
                    relative, degrees, settle = worst(profile, effects, path)
                    judged = " | ".join(f"{r:.2f}, {d:.2f}" for r, d in zip(relative, degrees, strict=True))
                    loop = "closed" if control else "open"
                    ended = f"{summary.how} {summary.why}".strip()
                    print(f"| {name} | {ratio} | {loop} | {judged} | {settle:.0f} | {ended} |", flush=True)


if __name__ == "__main__":
    main()
