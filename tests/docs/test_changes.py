"""The how-tos that change the project: their edits, made in a copy, do what the page promises."""

from pathlib import Path

from tests.docs.edits import edited_copy, run_in

HIDDEN = """
from rig.sim.forces import net
from rig.sim.scenario import Scenario
from rig.sim.state import initial_state
state = initial_state(1, 2, 0.0)[0]
for effects in ({}, {"updraught": {"push_mps2": 0.8, "edge_m": 0.002}}):
    params, _ = Scenario("one", effects).parameters()
    p = params[0]
    print(int(p["is_ballistic"]), int(p["is_simple"]), *(net(state, p, h, 0.0, 0.0, 0.0, 0.0) for h in (1e-3, 3e-3)))
"""

THIRD = """
from types import SimpleNamespace
from analysis.plate.step_state import multiples_of
from daq.setup.setup import Drive, Forcing
from rig.programme.ramp import drive_amplitudes
forcing = Forcing(frequency_hz=25.0, ratio=2, third={"ratio": 7, "amplitude": 0.5, "phase_deg": 40.0})
setup = SimpleNamespace(forcing=forcing, drive=Drive(g_per_volt=2.0))
print(*(m for m, _ in forcing.displacement_tones()))
print(*(abs(z) for z in drive_amplitudes(setup, 1.0)))
print(*multiples_of(forcing.multiples_at(2)))
print(*multiples_of(forcing.multiples_at(1)))
"""

FORCE = """
from pathlib import Path
import numpy as np
from daq.channels.accelerometer import AccelerometerChannel
from daq.channels.registry import Channels
from daq.importers.formats.open import open_source
from daq.importers.import_recording import import_recording
from daq.recording import open_recording
from daq.setup.setup import Ball, Drive, Forcing, Setup
from rig.backends.kinds.soundcard import InputTable
from rig.sim.plant import Plant
from rig.sim.scenario import Scenario
sensor = AccelerometerChannel(sensitivity=100.0, unit="mV/g")
setup = Setup(
    name="force", forcing=Forcing(frequency_hz=25.0), drive=Drive(g_per_volt=2.0), ball=Ball(mass_kg=0.25),
    channels=Channels(accelerometer=sensor, force={"v_per_n": 0.2}),
)
t = np.arange(80000) / 20000.0
plant = Plant(Scenario("ideal"), 20000.0, np.random.default_rng(0))
codes = plant.exchange(-0.9 * np.minimum(t, 1.0) * np.sin(2.0 * np.pi * 25.0 * t))
volts = codes * plant.channel_scales["drive"]
force_v = 0.5 + 0.1 * np.sin(2.0 * np.pi * 25.0 * t)
titles = ",".join(("time_s", "continuity_v", "accelerometer_v", "drive_v", "load cell"))
np.savetxt("run.csv", np.column_stack([t, volts, force_v]), delimiter=",", header=titles, comments="", fmt="%.6f")
import_recording(open_source(Path("run.csv")), Path("run.h5"), setup, "")
with open_recording(Path("run.h5")) as recording:
    print(np.abs(recording.read_v("force", 0, 80000) - force_v).max())
    print(recording.setup.channels.force.scale().per_volt)
print(InputTable().wired(setup.channels)["force"])
"""


def test_the_how_to_for_hiding_an_effect_hides_one(tmp_path: Path) -> None:
    """With two edits the ball is pushed up above the edge, by what the scenario says, in every interval."""
    assert len(edited_copy("hide-an-effect.md", tmp_path)) == 2
    without, hidden = run_in(tmp_path, HIDDEN)
    assert without[:2] == [1.0, 1.0]
    assert hidden[:2] == [0.0, 0.0]
    assert abs(hidden[2] - without[2]) < 1e-12
    assert abs(hidden[3] - without[3] - 0.8) < 1e-12


def test_the_how_to_for_a_tone_drives_and_measures_it(tmp_path: Path) -> None:
    """With edits of one file three tones are driven, each by its share of the plate's acceleration, and fitted."""
    assert set(edited_copy("add-a-tone.md", tmp_path)) == {"daq/setup/setup.py"}
    multiples, volts, fitted, of_another_c = run_in(tmp_path, THIRD)
    assert multiples == [1.0, 2.0, 7.0]
    assert all(abs(v - m * m * b / 2.0) < 1e-12 for v, m, b in zip(volts, multiples, (1.0, 1.0, 0.5), strict=True))
    # sums of three of 1, 2 and 7: what a bent drive makes of them
    assert fitted == [*map(float, range(1, 17)), 21.0]
    assert of_another_c == [1.0, 2.0, 3.0, 4.0, 5.0]


def test_the_how_to_for_a_channel_records_and_imports_it(tmp_path: Path) -> None:
    """With edits of three files a column of a file is recorded with its scale, and a sound card has its input."""
    assert len(set(edited_copy("add-a-channel.md", tmp_path))) == 3
    (difference_v,), (n_per_v,), (place,) = run_in(tmp_path, FORCE)
    assert difference_v < 2e-6
    assert n_per_v == 5.0
    assert place == 5.0
