"""The next run's profile."""

import tomllib
from pathlib import Path

import pytest

from analysis.loop.design import Design
from bench.profiles.improved import profile_of
from daq.setup.errors import InputError
from rig.profile import parse_profile

SIMULATED = (Path(__file__).parents[3] / "rig_profiles" / "simulated.toml").read_text(encoding="utf-8")


def test_only_the_run_changes() -> None:
    """The next run's profile is the recording's own but for ratio, gammas and order, and it parses."""
    design = Design("ratio_2", "c = 2", 2, (0.3, 0.5, 0.9), "shuffled")
    text = profile_of(SIMULATED, design)
    before, after = tomllib.loads(SIMULATED), tomllib.loads(text)
    assert after["forcing"].pop("ratio") == 2
    assert after["ramp"].pop("gamma") == [0.3, 0.5, 0.9]
    assert after["ramp"].pop("order") == "shuffled"
    for table, key in (("forcing", "ratio"), ("ramp", "gamma"), ("ramp", "order")):
        before[table].pop(key, None)
    assert after == before
    assert parse_profile(text, "next run").forcing.ratio == 2


def test_a_profile_without_a_ramp_is_refused() -> None:
    """A foreign recording's profile has no ramp: the refusal says what to do."""
    text = SIMULATED.split("[ramp]")[0]
    with pytest.raises(InputError, match=r"no \[ramp\]"):
        profile_of(text, Design("ratio_2", "c = 2", 2, (0.3, 0.5)))
