"""Scoring at scale: ten thousand trials planned, stopped, gone on with, and told by effect and by condition."""

import math

import pytest

from benchmarks.scoring import score_loop
from benchmarks.scoring.breakdown import by_condition, by_effect
from benchmarks.scoring.design import jobs
from benchmarks.scoring.tables import rate, show
from benchmarks.scoring.trial import conditions
from daq.files.disk import Journal
from model.surveys.workers import Outcome, WorkerDied


@pytest.fixture(scope="module")
def plan():
    """Twenty times the whole design, with its conditions."""
    return jobs(1000, times=20, varied=True)


def row_of(job):
    """What a trial on which nothing was found leaves, with fields that the tables read."""
    return {
        "job": job.key, "kind": job.kind, "plant": job.plant, "hidden": list(job.effects),
        "verdict": "nothing_missing", "conditions": conditions(job) if job.varied else None, "effects": [],
        "tie_set": [], "truth": {}, "seconds": 1.0,
        "size": {"landing": 9.0}, "size_left": {"landing": 9.0}, "discovered": None, "noise_floor_us": 1.0,
        "after": {"landing_rms_us": 1.0, "landing_nmad_us": 1.0}, "remainder": {},
    }  # fmt: skip


def test_ten_thousand_trials_have_seeds_and_names_of_their_own(plan):
    """No two trials of a plan share a seed or a name, and each part of 502 holds every kind."""
    assert len(plan) > 10_000 and len({job.seed for job in plan}) == len({job.key for job in plan}) == len(plan)
    kinds = {job.kind for job in plan}
    assert {job.kind for job in plan[:502]} == kinds and sum(job.kind in ("clean", "declared") for job in plan) > 2000


def test_a_plan_is_stopped_and_gone_on_with(plan, tmp_path, monkeypatch, capsys):
    """Stopped in the middle, each trial is run once; one whose worker died is tried again; tables have every part."""
    calls = []
    monkeypatch.setattr(score_loop, "run", lambda job: calls.append(job.key) or row_of(job))
    path, wanted = tmp_path / "r.rows", plan[:600]

    def stopping(compute, tasks, **options):
        for i, (key, arguments) in enumerate(tasks):
            if i == 250:
                raise KeyboardInterrupt
            yield Outcome(key, None, WorkerDied("killed")) if i == 7 else Outcome(key, compute(*arguments))

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(score_loop, "outcomes", stopping)
        score_loop.score(wanted, Journal(path), math.inf)
    assert score_loop.score(wanted, Journal(path), math.inf) == 351
    assert score_loop.score(wanted, Journal(path), math.inf) == 0
    rows = list(score_loop.rows_of(Journal(path)).values())
    assert len(rows) == 600 == len(set(calls)) == len(calls) and not any("failed" in row for row in rows)
    show(rows)
    by_effect(rows)
    by_condition(rows)
    printed = capsys.readouterr().out
    assert "| other | coulomb_friction |" in printed
    for name in ("c", "rate_hz", "accelerometer_noise_g", "contact", "bits", "cycles in all"):
        assert f"| {name} |" in printed


def test_a_group_is_chosen_by_kind_and_condition(plan, monkeypatch):
    """Kinds and conditions narrow the plan; a condition that is named twice has two alternatives."""
    group = "--kind clean,strong --plant other --only rate_hz=20e3 --only rate_hz=200000 --only c=2"
    monkeypatch.setattr("sys.argv", ["score_loop", "r", *group.split(), "--only", "contact=read once a sample"])
    args = score_loop._options()
    chosen = [j for j in plan if score_loop.in_group(args, j.kind, j.plant, j.effects, conditions(j))]
    assert {j.kind for j in chosen} == {"clean", "strong"} and {j.plant for j in chosen} == {"other"}
    found = [conditions(j) for j in chosen]
    assert {(x["c"], x["contact"]) for x in found} == {(2, "read once a sample")}
    assert {x["rate_hz"] for x in found} == {2e4, 2e5}


def test_other_code_on_a_worker_is_refused(plan, tmp_path, monkeypatch):
    """A worker that has other code than the one who asks stops the scoring, and leaves no row under a wrong version."""
    monkeypatch.setattr(score_loop, "run", row_of)
    with pytest.raises(score_loop.OtherVersionError, match="wanted"):
        score_loop.trial(plan[0], "another")
    true_trial = score_loop.trial
    monkeypatch.setattr(score_loop, "trial", lambda job, version: true_trial(job, "another"))
    with pytest.raises(score_loop.OtherVersionError):
        score_loop.score(plan[:3], Journal(tmp_path / "r.rows"), math.inf)
    assert not (tmp_path / "r.rows").exists()


def test_many_trials_are_told_to_a_tenth_of_a_percent():
    """An interval has as many digits as its trials are worth."""
    assert rate([{}] * 10, lambda r: False) == "0 of 10 (0 to 28 %)"
    assert rate([{}] * 2000, lambda r: False) == "0 of 2000 (0.0 to 0.2 %)"
