"""The judgement of a run that still goes on."""

from __future__ import annotations

from dataclasses import replace

import pytest

from analysis.flights.assemble import flights_of
from analysis.loop.so_far import judge_so_far, level_of_look
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.lack_of_fit import goodness_of_fit
from analysis.residuals.observations import Observations, observed
from analysis.thresholds import RUN_P
from bench.jobs.run_ramp import make_backend, record
from bench.profiles.find import load
from daq.recording import open_recording
from rig.profile import parse_profile


def test_all_looks_together_spend_the_error_rate_of_the_run() -> None:
    """However many looks a run has, their levels sum to less than the run's probability, and approach it."""
    assert 0.99 * RUN_P < sum(level_of_look(k) for k in range(1, 1000)) < RUN_P


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[float, Observations]:
    """Three steps of the simulated rig, ideal and with a hidden dry friction of 0.05."""
    text = load("simulated")[1].replace("{ start = 0.4, stop = 2.6, steps = 23 }", "[0.5, 0.6, 0.7]")
    profile, folder = parse_profile(text, "three.toml"), tmp_path_factory.mktemp("runs")
    found = {}
    for friction in (0.0, 0.05):
        hidden, path = folder / "hidden.toml", folder / f"{friction}.h5"
        size = f"[effects.coulomb_friction]\nmu_up = {friction}\nmu_down = {friction}\n" * (friction > 0.0)
        hidden.write_text(f'name = "hidden"\n{size}', encoding="utf-8")
        record(profile, text, make_backend(profile, scenario=hidden), path, quiet=True)
        with open_recording(path) as recording:
            found[friction] = observed(recording, flights_of(recording))
    return found


def test_friction_is_accused_and_an_ideal_rig_is_not(runs: dict[float, Observations]) -> None:
    """Two steps with flights suffice for a friction of 0.05, by which landings are missed far beyond their floor."""
    ideal, rubbing = judge_so_far(runs[0.0], 3), judge_so_far(runs[0.05], 3)
    assert ideal is not None and ideal.within and ideal.p > ideal.level and not ideal.promising
    assert rubbing is not None and not rubbing.within and rubbing.p < rubbing.level == level_of_look(3)
    assert rubbing.landing_rms_us > 10.0 * rubbing.floor_us
    assert any("coulomb_friction" in one.names for one in rubbing.promising)


def test_landings_that_pass_by_their_size_do_not_accuse_takeoffs(
    runs: dict[float, Observations], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is improbable in one kind of event and what is large in the other are no accusation together."""

    def judged(p_takeoffs: float) -> bool:
        left = replace(
            goodness_of_fit(ForwardModel(runs[0.0], {}), {}),
            p_lack_of_fit=1e-12, ratio=1.3, landing_ratio=0.97, p_takeoffs=p_takeoffs, plate_rms_z=1.0,
        )  # fmt: skip
        monkeypatch.setattr("analysis.loop.so_far.goodness_of_fit", lambda *_: left)
        found = judge_so_far(runs[0.0], 3)
        assert found is not None
        return found.within

    assert judged(0.5)
    assert not judged(1e-12)
