"""Effects hidden under forcings of one, two and three tones come back alone and at their own sizes.

The third tone is that of the how-to, made in a copy: `docs/how-to/add-a-tone.md`.
"""

from pathlib import Path

import pytest

from tests.docs.edits import edited_copy, run_in

HIDE = """
import sys
from pathlib import Path
import numpy as np
from analysis.loop.close_loop import close_loop
from bench.jobs.run_ramp import make_backend, record
from bench.profiles.find import load
from daq.setup.setup import ThirdTone
from rig.sim.scenario import Scenario

RANGES = {{(1, 0): (0.4, 2.6), (3, 0): (0.1, 0.8), (1, 3): (0.3, 1.5), (2, 3): (0.13, 0.6), (3, 2): (0.1, 0.6)}}
name, hidden, truth = {name!r}, {hidden!r}, {truth!r}
Path("hidden.toml").write_text(Scenario("one", {{name: hidden}}).to_toml())
profile, text = load("simulated")
for i, (c, third) in enumerate({forcings!r}):
    tone = ThirdTone(ratio=third, amplitude=0.5, phase_deg=40.0) if third else None
    forcing = profile.forcing.model_copy(update={{"ratio": c, "third": tone}})
    gamma = tuple(np.round(np.linspace(*RANGES[c, third], 16), 4).tolist())
    ramp = profile.ramp.model_copy(update={{"order": "shuffled", "gamma": gamma}})
    run = profile.model_copy(update={{"ramp": ramp, "forcing": forcing}})
    out = Path(f"{{i}}.h5")
    record(run, text, make_backend(run, scenario=Path("hidden.toml"), seed=970 + i), out, quiet=True)
    loop = close_loop([out])
    own = [p for p in loop.selection.added if p.effect == name and p.parameter in truth]
    off = [abs(p.value - truth[p.parameter]) / p.sigma for p in own]
    print(len({{p.effect for p in loop.selection.added}}), *off)
"""

G = 9.80665
CASES = {
    "coulomb_friction": ({"mu_up": 0.05, "mu_down": 0.05}, {"mu_up": 0.05, "mu_down": 0.05}),
    "position_force": (
        {"spring_per_s2": 87.5, "magnet_g": 0.025, "range_m": 0.003},
        {"spring_per_s2": 87.5, "magnet_mps2": 0.025 * G},
    ),
    "harmonic_distortion": (
        {"second_per_v": 0.00625, "third_per_v2": 0.00625},
        {"quadratic_per_g": 0.00625 / 2.0, "cubic_per_g2": 0.00625 / 4.0},  # 2 g a volt
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("forcings", [[(1, 0), (3, 0), (1, 3)], [(2, 3), (3, 2)]], ids=["one to three", "three"])
@pytest.mark.parametrize("name", CASES)
def test_an_effect_is_found_at_its_own_size_under_any_forcing(
    tmp_path: Path, name: str, forcings: list[tuple[int, int]]
) -> None:
    """Hidden under c and a third tone (0: none), it is named alone, within four of its standard deviations.

    The verdict may still say that a test failed (*unexplained*): one in fifteen does, by .8 us of its take-offs.
    """
    edited_copy("add-a-tone.md", tmp_path)
    hidden, truth = CASES[name]
    rows = run_in(tmp_path, HIDE.format(name=name, hidden=hidden, truth=truth, forcings=forcings))
    assert len(rows) == len(forcings)
    for forcing, (names, *off) in zip(forcings, rows, strict=True):
        assert names == 1.0, forcing
        assert off and max(off) < 4.0, (forcing, off)
