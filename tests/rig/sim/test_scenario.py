"""Scenario files, their hash, and the sealed draws."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daq.setup.errors import InputError
from rig.profile import load_setup
from rig.sim.scenario import EFFECTS, RIG_DEFAULTS, STRENGTHS, Scenario, left_open, load_scenario, pool, sealed_scenario

PROFILE = Path(__file__).parents[3] / "rig_profiles" / "simulated.toml"

EXAMPLES = sorted((Path(__file__).parents[3] / "scenarios").glob("*.toml"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_every_example_loads_and_survives_writing(path: Path, tmp_path: Path) -> None:
    """Each shipped scenario reads, and written out again has the same hash."""
    scenario = load_scenario(path)
    copy = tmp_path / "copy.toml"
    copy.write_text(scenario.to_toml(), encoding="utf-8")
    assert load_scenario(copy).sha256 == scenario.sha256


def test_the_hash_depends_on_contents_and_nonce() -> None:
    """Another value, another drift or another nonce: another hash; the order of keys does not matter."""
    base = Scenario("a", {"restitution": {"e0": 0.5, "e1_s_per_m": 0.1}}, nonce="1")
    swapped = Scenario("a", {"restitution": {"e1_s_per_m": 0.1, "e0": 0.5}}, nonce="1")
    others = [
        Scenario("a", {"restitution": {"e0": 0.51, "e1_s_per_m": 0.1}}, nonce="1"),
        Scenario("a", base.effects, nonce="2"),
        Scenario("a", base.effects, {}, {"restitution.e0": 0.1}, nonce="1"),
    ]
    assert base.sha256 == swapped.sha256
    assert len({base.sha256, *(other.sha256 for other in others)}) == 4


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[effects.glue]\npull = 1", "glue"),
        ("[effects.adhesion]\nforce = 1", r"adhesion\.force: wanted one of pull_g"),
        ("[effects.adhesion]\npull_g = -1.0", "from 0 to 5"),
        ("[effects.adhesion]\npull_g = true", "got True"),
        ("[rig]\ncolour = 1", r"rig\.colour"),
        ("[effects.parameter_drift]\n'adhesion.pull_g' = 1", "of an effect in this scenario"),
        ("surprise = 1", "surprise"),
        ("effects = 3", "effects"),
        ("name = ", "wanted TOML"),
    ],
)
def test_a_wrong_scenario_is_refused_by_name(text: str, words: str, tmp_path: Path) -> None:
    """Unknown names, impossible values and broken TOML name the file, the key and what was wanted."""
    path = tmp_path / "wrong.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=words) as refusal:
        load_scenario(path)
    assert "wrong.toml" in str(refusal.value)


def test_a_missing_scenario_is_refused(tmp_path: Path) -> None:
    """A file that is not there is named."""
    with pytest.raises(InputError, match=r"nowhere\.toml"):
        load_scenario(tmp_path / "nowhere.toml")


@pytest.mark.parametrize("kind", ["named", "beyond", "covariate"])
@pytest.mark.parametrize("strength", list(STRENGTHS))
def test_sealed_draws_are_valid_and_reproducible(kind: str, strength: str) -> None:
    """Every effect of each pool can be drawn at each strength, within its limits, and the seed repeats the draw."""
    names = pool(kind)  # type: ignore[arg-type]
    for seed, name in enumerate(names):
        draw = sealed_scenario(np.random.default_rng(seed), [name], strength=strength)  # type: ignore[arg-type]
        again = sealed_scenario(np.random.default_rng(seed), [name], strength=strength)  # type: ignore[arg-type]
        assert set(draw.effects) == {name}
        assert draw.sha256 == again.sha256


@pytest.mark.parametrize("strength", list(STRENGTHS))
def test_a_sealed_effect_is_beyond_what_calibrations_allow(strength: str) -> None:
    """What a stated calibration could be, too, has at least as many of its uncertainties as noise floors."""
    allowed = left_open(load_setup(PROFILE)[0])
    assert {name for name, _ in allowed} == {"accelerometer_gain", "local_gravity", "drive_gain", "phase_lag"}
    for (name, parameter), uncertainty in allowed.items():
        for seed in range(20):
            rng = np.random.default_rng(seed)
            draw = sealed_scenario(rng, [name], strength=strength, allowed=allowed)  # type: ignore[arg-type]
            assert abs(draw.effects[name][parameter]) >= STRENGTHS[strength][0] * uncertainty


def test_stronger_draws_have_larger_sizes() -> None:
    """Sizes grow from weak to strong, on average, for each effect."""
    for name, entry in EFFECTS.items():
        size = next(p.name for p in entry.parameters if p.scales)
        means = []
        for strength in ("weak", "medium", "strong"):
            draws = [sealed_scenario(np.random.default_rng(s), [name], strength=strength) for s in range(12)]
            means.append(np.mean([abs(draw.effects[name][size]) for draw in draws]))
        assert means[0] < means[1] < means[2]


def test_pairs_drift_and_nuisances_are_drawn_when_asked() -> None:
    """Two effects, a drift of the first one's sizes, a contact gap and bounce."""
    draw = sealed_scenario(
        np.random.default_rng(8), ["adhesion", "restitution"], count=2, drift=True, nuisances=True, strength="medium"
    )
    assert {"adhesion", "restitution", "contact_gap"} == set(draw.effects)
    assert {key.split(".")[0] for key in draw.drift_per_minute} <= {"adhesion", "restitution"}
    assert draw.drift_per_minute
    assert draw.rig["bounce_s"] > 0.0
    assert sealed_scenario(np.random.default_rng(8), ["adhesion"], count=0).effects == {}


def test_asking_for_more_effects_than_named_is_refused() -> None:
    """Three of two cannot be drawn."""
    with pytest.raises(ValueError, match="0 to 2"):
        sealed_scenario(np.random.default_rng(0), ["adhesion", "restitution"], count=3)


def test_the_documentation_names_every_effect_parameter_and_rig_key() -> None:
    """docs/reference/scenarios.md lists all there is to write into a scenario."""
    text = (Path(__file__).parents[3] / "docs" / "reference" / "scenarios.md").read_text(encoding="utf-8")
    words = [word for name, entry in EFFECTS.items() for word in (name, *(p.name for p in entry.parameters))]
    assert [word for word in (*words, *RIG_DEFAULTS) if f"`{word}`" not in text] == []
