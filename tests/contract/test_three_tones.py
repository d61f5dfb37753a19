"""Every effect of the library, hidden under one, two and three tones, comes back alone and at its own size.

The cases are those of the registry: a new effect is hidden as the simulated rig's list says, or a reason why it cannot
be stands here. The third tone is that of the how-to, made in a copy: `docs/how-to/add-a-tone.md`.
"""

from pathlib import Path

import pytest

from model.effects.registry import registry
from rig.sim.scenario import EFFECTS
from tests.docs.edits import edited_copy, run_in

HIDE = """
import sys
from pathlib import Path
import numpy as np
from analysis.loop.close_loop import close_loop
from bench.commands.demo import compared
from bench.jobs.run_ramp import make_backend, record
from bench.profiles.find import load
from daq.setup.setup import ThirdTone
from rig.sim.scenario import Scenario

RANGES = {{
    (1, 0): (0.4, 2.6), (2, 0): (0.2, 1.5), (3, 0): (0.1, 0.8), (1, 3): (0.3, 1.5), (2, 3): (0.13, 0.6),
    (3, 2): (0.1, 0.6),
}}
hidden, names = {hidden!r}, {names!r}
Path("hidden.toml").write_text(Scenario("one", hidden).to_toml())
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
    found = {{(c.effect, c.parameter): (c.value, c.sigma) for c in loop.selection.calibrations}}
    rows = compared(hidden, loop)
    found |= {{row[:2]: (row.found, (row.high - row.low) / 3.92) for row in rows if np.isfinite(row.found)}}
    sizes = {{row[:2]: row.hidden for row in rows if np.isfinite(row.hidden)}}
    # two stages of 50 ms follow the mean square of the rig's drive: so much of its slowest beat is left in them
    ripple = ((c, third) in {follows!r}) / (1.0 + (0.05 * 2.0 * np.pi * forcing.frequency_hz) ** 2)
    both = sizes.keys() & found.keys()
    off = [abs(found[k][0] - sizes[k]) / np.hypot(found[k][1], ripple * sizes[k]) for k in both]
    missing = hidden.keys() - {{effect for effect, _ in both}}
    print(len(set(loop.selection.names) - set(names)), len(missing), *off)
"""

NOT_HIDDEN = {
    "accelerometer_cross_axis": "the simulated table has no sideways mode",
    "clock_error": "drive and recorder of the simulated rig share one clock",
    "parameter_drift": "a change of another effect, hidden with one",
}
BESIDE = {"restitution_scatter": {"restitution": {"e0": 0.3}}}  # it scatters about a restitution
ALSO = {  # names that may come with an effect, or instead of it
    # that of the rig follows the drive's mean square, whose ripple of up to 1.6 % bends every cycle
    "gain_compression": ("harmonic_distortion",),
}
# what goes with the mean square of the rig's drive, and the forcings whose ripple shows in its size
FOLLOWS = {"gain_compression": [(2, 3)], "harmonic_distortion": [(2, 0)]}
ALL = [(1, 0), (2, 0), (3, 0), (1, 3), (3, 2)]
EVERYWHERE = ("coulomb_friction", "position_force", "harmonic_distortion")


def _hidden(name: str) -> dict[str, dict[str, float]]:
    """Half of the middle of the range of strong effects, as shaped as in its middle."""
    table = {p.name: 0.5 * sum(p.strong) * (0.5 if p.scales else 1.0) for p in EFFECTS[name].parameters}
    return {name: table, **BESIDE.get(name, {})}


# what is no part of the library is never named, unless the rig can hide it: curves that are discovered
NAMES = [r.effect.name for r in registry() if r.effect.library or r.effect.name in EFFECTS]
CASES = [(name, [(2, 3)]) for name in NAMES if name not in NOT_HIDDEN]
CASES += [(name, ALL[i::2]) for name in EVERYWHERE for i in (0, 1)]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "forcings"), [pytest.param(n, f, id=f"{n} {f}") for n, f in CASES])
def test_an_effect_is_found_at_its_own_size_under_any_forcing(
    tmp_path: Path, name: str, forcings: list[tuple[int, int]]
) -> None:
    """Hidden under c and a third tone (0: none), it is named alone, within four of its standard deviations.

    The verdict may still say that a test failed (*unexplained*): one in fifteen does, by .8 us of its take-offs.
    """
    edited_copy("add-a-tone.md", tmp_path)
    names, hidden, follows = (name, *BESIDE.get(name, {}), *ALSO.get(name, ())), _hidden(name), FOLLOWS.get(name, [])
    rows = run_in(tmp_path, HIDE.format(hidden=hidden, names=names, forcings=forcings, follows=follows))
    assert len(rows) == len(forcings)
    for forcing, (strangers, missing, *off) in zip(forcings, rows, strict=True):
        assert strangers == missing == 0.0, forcing
        assert max(off) < 4.0, (forcing, off)
