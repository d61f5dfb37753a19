"""How far the plate is from its target, open loop and closed, on rigs that answer otherwise than their profile says.

    python benchmarks/closed_loop.py [--quick]

Worst relative error of a tone's amplitude and worst error of its phase over the holds of all steps of a ramp, the ball
bouncing. Two judges that are not the loop: the analysis (`analysis.plate`), and what the plate must have done by the
looped-back drive and the response that the scenario hides (no judge where the table has a mode of its own).
"""

from __future__ import annotations

import math
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path[0] = str(Path(__file__).resolve().parent.parent)  # not this folder: its rig.py is not the package

from analysis.plate import plate_of  # noqa: E402
from bench.profiles import load  # noqa: E402
from daq.recording import Recording, RecordingWriter, open_recording  # noqa: E402
from daq.tones import fit_tones  # noqa: E402
from rig.amplitude import target_acceleration  # noqa: E402
from rig.backends.simulated import SimulatedBackend  # noqa: E402
from rig.profile import ControlTable, Profile  # noqa: E402
from rig.run import RunSummary, run_ramp  # noqa: E402
from rig.sim.scenario import Scenario  # noqa: E402

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


def hidden_acceleration(recording: Recording, row: np.void, effects: Effects) -> np.ndarray:
    """Plate acceleration of each tone over a hold, by the looped-back drive and the hidden response."""
    first, end = int(row["first_sample"] + row["settle_samples"]), int(row["first_sample"] + row["n_samples"])
    f_hz = np.array([m * F_HZ for m, _ in recording.setup.forcing.displacement_tones()])
    drive = fit_tones(recording.read_v("drive", first, end), first, recording.rate_hz, f_hz).amplitudes
    gain = 1 + effects.get("drive_gain", {}).get("relative", 0.0)
    lag_s = effects.get("phase_lag", {}).get("time_constant_s", 0.0)
    return drive * 2.0 * 9.80665 * gain / (1 + 2j * np.pi * f_hz * lag_s)


def worst(profile: Profile, effects: Effects, path: Path) -> tuple[list[float], list[float], float]:
    """Worst amplitude error (relative) and phase error (degrees) by either judge, and the mean settling in cycles."""
    errors: list[list[np.ndarray]] = [[], []]
    with open_recording(path) as recording:
        for row, step in zip(recording.steps, plate_of(recording).steps, strict=True):
            target = target_acceleration(profile, float(row["gamma"]))
            if step is not None:
                errors[0].append(np.array([step.tone(m)[0] for m, _ in profile.forcing.displacement_tones()]) / target)
            if "table_resonance" not in effects:
                errors[1].append(hidden_acceleration(recording, row, effects) / target)
        settle = float(np.mean(recording.steps["settle_cycles"]))
    relative = [100 * float(np.abs(np.abs(e) - 1).max()) if len(e) else math.nan for e in errors]
    degrees = [float(np.degrees(np.abs(np.angle(e))).max()) if len(e) else math.nan for e in errors]
    return relative, degrees, settle


def main() -> None:
    """Print one row a rig and c."""
    rigs = dict(list(RIGS.items())[3:4]) if "--quick" in sys.argv else RIGS
    print("| rig | c | loop | by the analysis: %, deg | by the hidden response: %, deg | settling, cycles | ended |")
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
