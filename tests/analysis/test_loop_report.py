"""The report and the JSON of a closed loop: the agreed keys, every verdict, what a person finds on the page."""

import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import analysis.close_loop
from analysis.attribution import Attributor
from analysis.candidates import Candidate
from analysis.close_loop import Loop, as_json
from analysis.explanation import Attribution
from analysis.gains import Compared
from analysis.loop_report import VERDICTS, write_report
from analysis.whitening import Whitener
from bench.cli import app

KEYS = (
    "verdict", "effects", "discovered", "tie_set", "before", "after", "noise_floor_us", "held_out_steps", "remainder",
    "next_run",
)
ERRORS = ("landing_rms_us", "landing_robust_us", "takeoff_robust_us", "flight_time_relative")
FRICTION = Candidate(
    ("coulomb_friction",), (("coulomb_friction", "mu_up"), ("coulomb_friction", "mu_down")),
    ({("coulomb_friction", "mu_up"): 0.1, ("coulomb_friction", "mu_down"): 0.1},),
)


def one_candidate(self: Attributor) -> Attribution:
    """An attribution that tries friction alone: what the search costs does not matter here."""
    before = self._judged((), self._settled(self.fitter.fit(Whitener.of(self.world, {}), (), {})))
    best = self.add(before, FRICTION)
    assert best is not None
    gain = Compared.of(before.per_step, best.per_step, self.train)
    return Attribution(before, best, (best, before), ((FRICTION.names, gain),), ("round 1: coulomb_friction gains",))


@pytest.fixture(scope="module")
def closed(make: Callable[..., Any]) -> tuple[Loop, Path]:
    """The loop closed on a short ramp with friction 0.1, and its recording."""
    path = make(
        np.array([0.55, 0.7, 0.85, 1.0, 1.15, 1.3, 0.62, 0.92, 1.07]), hold=12,
        effects={"coulomb_friction": {"mu_up": 0.1, "mu_down": 0.1}},
    ).path
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Attributor, "explain", one_candidate)
        return analysis.close_loop.close_loop([path]), path


def test_the_agreed_keys(closed: tuple[Loop, Path]) -> None:
    """The JSON has every key agreed upon, each with its kind of value, and survives a parser that knows no NaN."""
    found = json.loads(json.dumps(as_json(closed[0]), allow_nan=False))
    assert set(KEYS) <= set(found)
    assert found["verdict"] in VERDICTS
    assert [set(e) for e in found["effects"]] == [{"name", "parameters"}]
    for parameter in found["effects"][0]["parameters"].values():
        assert list(parameter) == ["value", "low", "high"]
        assert parameter["low"] <= parameter["value"] <= parameter["high"]
    assert found["tie_set"][0] == ["coulomb_friction"]
    for side in ("before", "after"):
        assert all(isinstance(found[side][k], float) for k in ERRORS)
    assert found["before"]["landing_robust_us"] > 10 * found["after"]["landing_robust_us"]
    assert set(found["remainder"]) >= {"p_lack_of_fit", "covariate"}
    assert found["held_out_steps"] == [2, 6]
    assert found["next_run"] is None


@pytest.mark.parametrize("verdict", VERDICTS)
def test_exit_status_is_zero_whatever_the_verdict(
    closed: tuple[Loop, Path], verdict: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command leaves with 0 for each verdict, and standard output carries the JSON and nothing else."""
    loop = dataclasses.replace(closed[0], verdict=verdict)
    monkeypatch.setattr(analysis.close_loop, "close_loop", lambda *a, **k: loop)
    monkeypatch.setattr("bench.next_profile.possible_runs", lambda *a: [])
    result = CliRunner().invoke(app, ["close-loop", str(closed[1]), "--json", "-"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["verdict"] == verdict


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_report_says_the_verdict(closed: tuple[Loop, Path], verdict: Any, tmp_path: Path) -> None:
    """For each verdict one page with the verdict in words, its pictures inside, and the JSON beside it."""
    page = write_report(dataclasses.replace(closed[0], verdict=verdict), [closed[1]], tmp_path / "report")
    text = page.read_text(encoding="utf-8")
    assert VERDICTS[verdict][1] in text
    assert len(re.findall(r"data:image/png;base64,", text)) >= 3
    assert "simulated rig" in text and not re.search(r"\bnan\b", re.sub(r"base64,[^\"]*", "", text))
    assert json.loads((tmp_path / "report" / "report.json").read_text(encoding="utf-8"))["verdict"] == verdict


def test_nothing_missing_names_nothing(closed: tuple[Loop, Path], tmp_path: Path) -> None:
    """Where the declared model suffices, the page adds no effect and says so."""
    loop, path = closed
    before = loop.attribution.before
    bare = dataclasses.replace(loop.attribution, best=before, ties=())
    clean = dataclasses.replace(
        loop, verdict="nothing_missing", effects=(), attribution=bare, after=loop.before, discovered=None
    )
    page = write_report(clean, [path], tmp_path / "report")
    text = page.read_text(encoding="utf-8")
    assert VERDICTS["nothing_missing"][1] in text
    assert "<th>added</th>" not in text
