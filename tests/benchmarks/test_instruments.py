"""The matrix of instruments: its plan, its truth on both plants, what it counts, and what it counts as right."""

import math

import numpy as np
import pytest

from analysis.residuals.plate_data.plate_observables import GAIN, HUM, PHASE, PlateData
from benchmarks.analysis import chains, instruments
from benchmarks.analysis.chains import CHAINS, HIDDEN, Chain, Job, jobs
from benchmarks.plants.handed_over import Afterwards
from benchmarks.plants.third_instrument import CARDS
from daq.files.disk import Journal


def test_the_plan_holds_every_chain_with_every_hidden_cause():
    """Names of trials differ; each chain meets each cause on the other plant or, with a drawn card, on the third."""
    plan = jobs(range(2))
    assert len({job.key for job in plan}) == len(plan) >= 2 * 24 * 6 * 2
    met = {plant: {(job.chain, job.hidden) for job in plan if job.plant == plant} for plant in ("other", "third")}
    assert met["third"] == {(card, hidden) for card in CARDS for hidden in HIDDEN}
    assert met["other"] == {(chain, hidden) for chain in CHAINS for hidden in HIDDEN} - met["third"]


def test_landings_are_counted_against_flights_that_were_flown():
    """A landing far from impacts and losses is a phantom; a long flight without one is missed, a short one is not."""
    flown = np.array([[0.0, 0.03], [0.031, 0.05], [0.0502, 0.0504], [0.06, 0.08]])
    found, cut = np.array([0.0302, 0.0451, 0.055, 0.0801]), np.array([False, False, True, False])
    assert instruments.counted(found, cut, flown, 5e-4) == (3, 1, 1)


def test_tones_scatter_about_the_mean_of_their_own_kind():
    """Gains of two steps 2 sigma apart, phases alike, and a hum that is neither: squares of 2 for two freedoms."""
    kind = np.array([GAIN, GAIN, PHASE, PHASE, HUM])
    value, none, one = np.array([1.0, 3.0, 5.0, 5.0, 9.0]), np.zeros(5), np.ones(5)
    multiple, others = np.ones(5, dtype=int), np.zeros((5, 0))
    no, step = others.astype(int), np.array([0, 1, 0, 1, 0])
    data = PlateData(kind, step, value, one, one, none, one, multiple, no, others, none + 0j)
    assert instruments.tone_scatter(data) == (2.0, 2)


@pytest.mark.parametrize(("plant", "chain"), [("other", "fast"), ("own", "fast"), ("third", CARDS[0])])
def test_flights_found_are_those_flown(plant, chain, monkeypatch):
    """Truth and analysis have the same flights: with a clock that is fast, or a drawn card, on each plant."""
    monkeypatch.setattr(chains, "STEPS", 3)
    monkeypatch.setitem(CHAINS, "fast", Chain(after=Afterwards(clock=1e-4)))
    row = instruments.trial(Job(chain, "friction", plant, 3), False)
    assert "failed" not in row, row["failed"]
    assert row["flown"] > 15 and row["phantoms"] == row["missed"] == 0
    assert row["tone_freedom"] > 0


def test_a_verdict_is_held_against_the_truth(closed_loop, monkeypatch, tmp_path):
    """Of the effect that was found, each interval is asked whether the true value lies in it."""
    monkeypatch.setattr("analysis.loop.close_loop.fit_loop", lambda paths: (closed_loop, None))
    (effect,) = closed_loop.selection.effects
    truth = {effect.name: {name: high + 1.0 for name, (_, _, high) in effect.parameters.items()}}
    name, (value, _, _) = next(iter(effect.parameters.items()))
    truth[effect.name][name] = value
    row = instruments._verdict(tmp_path, truth)
    assert row["verdict"] == closed_loop.verdict and row["names"] == [effect.name]
    assert sum(row["held"]) == 1 and len(row["held"]) == len(effect.parameters)


def row_of(job, names, verdict):
    """What a trial leaves, with a verdict."""
    return {
        "chain": job.chain, "hidden": job.hidden, "plant": job.plant, "seed": job.seed, "seconds_recorded": 20.0,
        "found": 10, "flown": 10, "phantoms": 0, "missed": 0, "names": names, "verdict": verdict,
        "wanted": ["coulomb_friction"] if job.hidden == "friction" else [], "held": [True, False],
        "rms_us": 10.0, "floor_us": 9.0, "seconds_loop": 3.0,
    }  # fmt: skip


def test_a_run_goes_on_where_it_stopped_and_is_shown(tmp_path, monkeypatch, capsys):
    """Each trial is run once for a version; the tables name chains, false alarms and what was wrongly named."""
    names = {
        "nothing": (["mains_pickup"], "explained"),
        "friction": (["coulomb_friction", "accelerometer_lag"], "explained"),
    }
    calls = []

    def trial(job, with_loop):
        calls.append(job.key)
        return row_of(job, *names[job.hidden])

    monkeypatch.setattr(instruments, "trial", trial)
    path = tmp_path / "r.rows"
    wanted = [Job("low-pass 8 kHz, 2 poles", hidden, "other", seed) for hidden in names for seed in (1, 2)]
    instruments.score(wanted[:3], Journal(path), math.inf, with_loop=True, workers=1)
    instruments.score(wanted, Journal(path), math.inf, with_loop=True, workers=1)
    assert len(calls) == len(set(calls)) == 4
    monkeypatch.setattr("sys.argv", ["instruments", str(path), "--show"])
    instruments.main()
    printed = capsys.readouterr().out
    assert "| low-pass 8 kHz, 2 poles | other | 4 | 40 / 40 | 0 | 0 |" in printed
    assert (
        "| low-pass 8 kHz, 2 poles | 2 of 2 (34 to 100 %) | 2 of 2 (34 to 100 %) | 2 of 2 (34 to 100 %) | 2 of 4"
        in printed
    )
    assert "| other | low-pass 8 kHz, 2 poles | nothing | 1 | mains_pickup | explained | 10 / 9 |" in printed
