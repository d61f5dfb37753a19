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
from pathlib import Path
from types import SimpleNamespace
import analysis.loop.close_loop as loop
from daq.setup.errors import InputError
from daq.setup.setup import Drive, Forcing, Setup
from rig.programme.forcing import drive_amplitudes
forcing = Forcing(frequency_hz=25.0, ratio=2, third={"ratio": 3, "amplitude": 0.5, "phase_deg": 40.0})
setup = SimpleNamespace(forcing=forcing, drive=Drive(g_per_volt=2.0))
print(*(m for m, _ in forcing.displacement_tones()))
print(*(abs(z) for z in drive_amplitudes(setup, 1.0)))
loop.refuse_doubtful = lambda recordings, setup: None
loop.observations_from = lambda recordings, **options: SimpleNamespace(setup=setup)
try:
    loop.judge_loop([Path("run.h5")])
except InputError as error:
    print(int("forcing.third" in str(error)))
"""


def test_the_how_to_for_hiding_an_effect_hides_one(tmp_path: Path) -> None:
    """With three edits the ball is pushed up above the edge, by what the scenario says, in every interval."""
    assert len(edited_copy("hide-an-effect.md", tmp_path)) == 3
    without, hidden = run_in(tmp_path, HIDDEN)
    assert without[:2] == [1.0, 1.0]
    assert hidden[:2] == [0.0, 0.0]
    assert abs(hidden[2] - without[2]) < 1e-12
    assert abs(hidden[3] - without[3] - 0.8) < 1e-12


def test_the_how_to_for_a_tone_drives_it_and_refuses_its_verdict(tmp_path: Path) -> None:
    """With the edits three tones are driven, each by its share of the plate's acceleration, and no verdict is given."""
    assert set(edited_copy("add-a-tone.md", tmp_path)) == {"daq/setup/setup.py", "analysis/loop/close_loop.py"}
    multiples, volts, refused = run_in(tmp_path, THIRD)
    assert multiples == [1.0, 2.0, 3.0]
    assert all(abs(v - m * m * b / 2.0) < 1e-12 for v, m, b in zip(volts, multiples, (1.0, 1.0, 0.5), strict=True))
    assert refused == [1.0]
