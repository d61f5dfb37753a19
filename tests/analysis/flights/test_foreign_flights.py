"""Recordings from elsewhere, however they were written down: the same flights and the same plate come out."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from analysis.flights.assemble import flights_of
from analysis.flights.table import Flights
from benchmarks.plants import other_plant
from daq.importers.formats.columns import parse_map
from daq.importers.formats.open import open_source
from daq.importers.import_recording import ImportOptions, import_recording
from daq.recording import open_recording
from daq.setup.setup import Setup
from kernels.arrays import Floats

RATE_HZ = 20000.0
GAMMAS = (0.4, 0.8, 1.1, 0.6, 1.4, 0.95)
Columns = dict[str, Floats]
Seen = tuple[Flights, Floats]


def setup(**changes: object) -> Setup:
    """What its owner would write of the rig, with changes to channels and drive."""
    accelerometer = {"sensitivity": 0.1, "unit": "V/g", "reads_gravity": True, "offset_v": 0.0}
    parts: dict[str, dict[str, object]] = {
        "accelerometer": accelerometer, "continuity": {}, "drive": {"g_per_volt": 1.6},
    }  # fmt: skip
    for key, value in changes.items():
        part, _, name = key.partition("__")
        parts[part][name] = value
    return Setup.model_validate(
        {
            "name": "theirs",
            "forcing": {"frequency_hz": 25.37},
            "ball": {"mass_kg": 0.25},
            "drive": parts["drive"],
            "channels": {"accelerometer": parts["accelerometer"], "continuity": parts["continuity"]},
        }
    )


def seen(raw: Path, out: Path, own: Setup, maps: tuple[str, ...] = (), rate_hz: float | None = None) -> Seen:
    """Flights of a file brought in, and gamma of its steps."""
    import_recording(open_source(raw), out, own, "", ImportOptions(parse_map(maps), rate_hz))
    with open_recording(out) as recording:
        flights = flights_of(recording)
    return flights, np.array([s.gamma for s in flights.plate.steps if s is not None])


@pytest.fixture(scope="module")
def columns() -> Columns:
    """A ramp of the other plant, in volts."""
    plant = other_plant
    data = plant.simulate(plant.Run(gammas=GAMMAS, cycles=16, seed=3, jitter_s=5e-6))
    return {k: data[k] for k in ("time_s", "continuity_v", "accelerometer_v", "drive_v")}


@pytest.fixture(scope="module")
def native(columns: Columns, tmp_path_factory: pytest.TempPathFactory) -> Seen:
    """The recording with every column under its usual name."""
    folder = tmp_path_factory.mktemp("native")
    np.savez(folder / "a.npz", **columns)
    return seen(folder / "a.npz", folder / "a.h5", setup())


def same(one: Seen, other: Seen, within_s: float, share: float = 0.9) -> None:
    """The flights that count in both are the same ones, at least that share of them, and the steps move alike."""
    first, second = (f.landing_s[f.good()] for f, _ in (one, other))
    apart = np.abs(first[:, None] - second[None, :]).min(axis=1)
    shared = apart < 1e-3
    assert shared.mean() > share and len(second) > 40
    assert apart[shared].max() < within_s
    np.testing.assert_allclose(other[1], one[1], rtol=2e-3)


def test_other_polarity_sign_unit_and_offset(columns: Columns, native: Seen, tmp_path: Path) -> None:
    """Contact closed when high, accelerometer upside down in mV, both in folders of an HDF5 file without times."""
    with h5py.File(tmp_path / "scope.hdf5", "w") as file:
        file["run/CH1"] = (3.1 - 0.58 * columns["continuity_v"]).astype(np.float32)
        file["run/CH2"] = -1e3 * columns["accelerometer_v"]
        file["run/CH3"] = 1e3 * columns["drive_v"]
    own = setup(
        continuity__open_v=0.2, continuity__closed_v=3.1, accelerometer__sign=-1, accelerometer__sensitivity=100.0,
        accelerometer__unit="mV/g",
    )  # fmt: skip
    maps = ("continuity=CH1", "accelerometer=CH2:mV", "drive=CH3:mV")
    same(native, seen(tmp_path / "scope.hdf5", tmp_path / "r.h5", own, maps, RATE_HZ), 1e-6)


def test_levels_that_nobody_declared_and_an_unknown_zero(columns: Columns, native: Seen, tmp_path: Path) -> None:
    """A contact between 1.2 and 3.9 V under a profile that says 0 and 5, and an accelerometer on a bias."""
    path = tmp_path / "a.csv"
    table = np.column_stack(
        [1e3 * columns["time_s"], 1.2 + 0.54 * columns["continuity_v"], columns["accelerometer_v"] + 1.65,
         columns["drive_v"]]
    )  # fmt: skip
    np.savetxt(path, table, "%.5f", delimiter=";", header="Zeit (ms);contact;acc;drive", comments="")
    same(native, seen(path, tmp_path / "r.h5", setup(accelerometer__offset_v=None)), 1e-6)


def test_without_a_drive_the_steps_are_the_plates(columns: Columns, native: Seen, tmp_path: Path) -> None:
    """No drive column and no scale of it: as many steps, the same gamma, the same flights in them.

    Steps found in the accelerometer end two of their sixteen cycles early.
    """
    np.savez(tmp_path / "a.npz", contact=columns["continuity_v"], accel=columns["accelerometer_v"])
    same(native, seen(tmp_path / "a.npz", tmp_path / "r.h5", setup(drive__g_per_volt=None), (), RATE_HZ), 1e-6, 0.8)


def test_acceleration_in_its_own_unit(columns: Columns, native: Seen, tmp_path: Path) -> None:
    """A column in m/s^2 needs no sensitivity; its stated one only lends the relative uncertainty."""
    np.savez(
        tmp_path / "a.npz", time_s=columns["time_s"], continuity_v=columns["continuity_v"],
        acceleration_mps2=98.0665 * columns["accelerometer_v"], drive_v=columns["drive_v"],
    )  # fmt: skip
    same(native, seen(tmp_path / "a.npz", tmp_path / "r.h5", setup(accelerometer__sensitivity=0.05)), 1e-6)


def test_jitter_of_a_contact_makes_no_flights_of_its_own_at_a_high_rate(tmp_path: Path) -> None:
    """Edges that jitter by 40 us lie several samples from the accelerometer's impact at 200 kHz: one landing each."""
    run = other_plant.Run(gammas=GAMMAS, cycles=16, seed=6, jitter_s=4e-5, spikes=True, closure_s=1e-4, rate_hz=2e5)
    data = other_plant.simulate(run)
    np.savez(tmp_path / "a.npz", **{k: x for k, x in data.items() if k != "impacts"})
    flights, _ = seen(tmp_path / "a.npz", tmp_path / "a.h5", setup())
    assert abs(len(flights) - len(data["impacts"])) <= 1
    assert flights.duration_s.min() > 1e-3
