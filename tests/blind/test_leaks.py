"""A recording tells nothing of the scenario but its hash."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from daq.recording.writer import RecordingWriter
from rig.backends.simulated import SimulatedBackend
from rig.execution.run import run_ramp
from rig.profile import load_profile, load_setup
from rig.sim.scenario import EFFECTS, RIG_DEFAULTS, pool, sealed_scenario

PROFILE = Path(__file__).parents[2] / "rig_profiles" / "simulated.toml"


def everything_written(path: Path) -> str:
    """All attributes, names and text of an HDF5 file, and its raw bytes, as one string."""
    parts = [path.read_bytes().decode("latin-1")]

    def visit(name: str, item: h5py.Group | h5py.Dataset) -> None:
        parts.append(name)
        parts.extend(f"{key}={value!r}" for key, value in item.attrs.items())
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "OS":
            parts.append(repr(item[()]))

    with h5py.File(path) as file:
        visit("/", file)
        file.visititems(visit)
    return "\n".join(parts)


def test_recordings_of_sealed_rigs_carry_the_hash_and_nothing_else(tmp_path: Path) -> None:
    """Three sealed rigs recorded: the hash is there; names, values, overrides of the rig and the nonce are not."""
    profile, text = load_profile(PROFILE)
    text = "\n".join(line.split("#")[0] for line in text.splitlines())  # its comments give effects as examples
    short = profile.model_copy(update={"ramp": profile.ramp.model_copy(update={"gamma": (0.6, 0.8)})})
    for seed in range(3):
        rng = np.random.default_rng(seed)
        scenario = sealed_scenario(rng, (*pool("named"), *pool("beyond")), count=2, drift=True, nuisances=True)
        path = tmp_path / f"sealed{seed}.h5"
        backend = SimulatedBackend(profile.sampling.rate_hz, scenario, seed)
        writer = RecordingWriter(
            path, load_setup(PROFILE)[0], profile_text=text, channels=backend.channels, backend=backend.name,
            simulated=True, scenario_sha256=scenario.sha256, scales=backend.scales,
        )  # fmt: skip
        assert run_ramp(short, backend, writer).how == "complete"
        written = everything_written(path)
        assert scenario.sha256 in written
        assert [name for name in EFFECTS if name in written] == []
        assert [key for key in RIG_DEFAULTS if key in scenario.rig and key in written] == []
        values = [v for table in scenario.effects.values() for v in table.values()]
        values += [*scenario.rig.values(), *scenario.drift_per_minute.values()]
        assert [v for v in values if len(repr(v)) > 6 and (repr(v) in written or f"{v:.6g}" in written)] == []
        assert [v for v in values if np.float64(v).tobytes() in path.read_bytes()] == []
        assert scenario.nonce not in written
