"""The other plant is itself right: published flight times, visible effects, a readable hand-over."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from benchmarks.plants import other_plant as other
from daq.setup.setup import Setup


@pytest.mark.parametrize(("gamma_peak", "taus"), [(1.5, (3.566217,)), (3.0, (5.967608,)), (3.8, (5.823950, 6.742421))])
def test_flights_have_the_published_lengths(gamma_peak: float, taus: tuple[float, ...]) -> None:
    """One sine: flight times agree to five march steps, a late launch being carried through the cycle."""
    run = other.Run(gammas=(gamma_peak / 2.0,), cycles=60, seed=1)
    edges = np.zeros(40000)
    w = 2.0 * math.pi * run.frequency_hz
    n = int(60 / run.frequency_hz * run.rate_hz)
    count, _ = other._march(
        run.values(), np.zeros(20000), np.array(run.gammas), 60 / run.frequency_hz, 1 / run.frequency_hz, w, 1.0, 5e-6,
        other.STEPS_PER_SAMPLE, np.zeros(n), edges, np.zeros((20000, 2)),
    )  # fmt: skip
    edges = edges[: count - count % 2][-4 * len(taus) :]  # opening, closing, opening, ...
    lengths = np.sort(w * (-edges[1::2] - edges[::2]))[::2]
    assert lengths == pytest.approx(taus, abs=5.0 * w * 5e-6)


@pytest.mark.parametrize("effect", other.SIZES)
def test_each_hidden_effect_changes_the_recording(effect: str) -> None:
    """Same seed, strong effect: continuity or accelerometer differ from a run without it."""
    gammas = (0.6, 1.2, 1.8)
    # a drift of the friction changes nothing where there is no friction, nor a scatter where nothing rebounds
    needed = {"friction_drift": "coulomb_friction", "restitution_scatter": "restitution"}
    besides = other.hidden_by(needed[effect], "strong") if effect in needed else {}
    clean = other.simulate(other.Run(gammas=gammas, seed=2, hidden=besides))
    data = other.simulate(other.Run(gammas=gammas, seed=2, hidden={**besides, **other.hidden_by(effect, "strong")}))
    contact = np.count_nonzero((data["continuity_v"] > 2.5) != (clean["continuity_v"] > 2.5))
    plate = np.max(np.abs(data["accelerometer_v"] - clean["accelerometer_v"]))
    assert contact > 20 or plate > 0.005
    assert np.array_equal(data["drive_v"], clean["drive_v"]) or np.std(data["drive_v"] - clean["drive_v"]) < 0.001


def test_the_hand_over_declares_nothing_hidden(tmp_path: Path) -> None:
    """CSV with the four known columns, a profile that reads, and the truth in a file of its own."""
    run = other.Run(gammas=(0.8,), cycles=8, hidden=other.hidden_by("adhesion", "strong"))
    path = other.write(run, tmp_path)
    assert path.read_text(encoding="utf-8").splitlines()[0] == "time_s,continuity_v,accelerometer_v,drive_v"
    text = (tmp_path / "profile.toml").read_text(encoding="utf-8")
    raw = {key: value for key, value in tomllib.loads(text).items() if key in Setup.model_fields}
    assert Setup.model_validate(raw).forcing.ratio == 1
    assert "adhesion" not in text and "adhesion" not in path.read_text(encoding="utf-8")[:2000]
    assert "adhesion" in (tmp_path / "truth.json").read_text(encoding="utf-8")
