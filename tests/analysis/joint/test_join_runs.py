"""Joint verdicts on recordings: what one run cannot show, six runs name; what differs between runs is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from analysis.joint.join_runs import join_runs
from analysis.joint.result import JointVerdict
from analysis.joint.summary import RunSummary
from analysis.loop.close_loop import close_loop
from analysis.thresholds import FROZEN
from bench.cli import app
from benchmarks.analysis.joint import short_runs
from daq.files.disk import Journal
from daq.setup.errors import InputError

BELOW = {"viscous_damping.rate_per_s": 0.1}  # one such run's detection limit of 0.15 /s


Three = tuple[list[Path], Path, JointVerdict]


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Three:
    """Three clean runs, the journal of their summaries, and their verdict."""
    where = tmp_path_factory.mktemp("three")
    paths, journal = short_runs(where, 3, 503, {}), where / "runs.rows"
    return paths, journal, join_runs(paths, journal=Journal(journal))


def parameter(found: JointVerdict, name: str) -> int:
    """Place of a parameter in the result."""
    return [f"{x.effect}.{x.parameter}" for x in found.parameters].index(name)


@pytest.mark.slow
def test_six_runs_name_what_one_cannot_show(tmp_path: Path) -> None:
    """An effect below every single run's limit is in the set that six runs name, while calibrations differ."""
    found = join_runs(short_runs(tmp_path, 6, 501, BELOW))
    assert found.verdict == "explained"
    assert ("viscous_damping",) in found.ties
    named = found.parameters[0]
    limit = np.sqrt(2.0 * FROZEN.gain_nats) * np.array(named.sigmas)  # of each run by itself
    assert np.all(np.abs(named.values) < limit)
    assert abs(named.value) > np.sqrt(2.0 * FROZEN.gain_nats) * named.sigma
    assert not named.differs
    gain = found.parameters[parameter(found, "drive_gain.relative")]
    assert gain.differs and 0.001 < gain.spread < 0.01


@pytest.mark.slow
def test_twelve_clean_runs_miss_nothing(tmp_path: Path) -> None:
    """Neither calibrations that differ between runs nor an error of the edges that all share is an effect."""
    found = join_runs(short_runs(tmp_path, 12, 502, {}))
    assert (found.verdict, found.names, found.odd) == ("nothing_missing", (), ())
    brief = found.systematics[1]  # a comparator read once a sample dates brief contacts half a sample too early
    assert brief.value_us + 4.0 * brief.sigma_us < 0.0


@pytest.mark.slow
def test_an_effect_that_differs_has_a_value_for_each_run(tmp_path: Path) -> None:
    """Damping that one run shows by itself, and that grows from run to run: named, and said to differ."""
    rates = (0.6, 1.0, 1.4, 1.8)
    paths = [
        short_runs(tmp_path / f"{i}", 1, 510 + i, {"viscous_damping.rate_per_s": rate})[0]
        for i, rate in enumerate(rates)
    ]
    found = join_runs(paths)
    assert found.verdict == "explained" and found.names == ("viscous_damping",)
    named = found.parameters[parameter(found, "viscous_damping.rate_per_s")]
    assert named.kind == "effect" and named.differs and named.constancy.p_trend < 1e-6
    assert named.values == pytest.approx(rates, abs=0.2)


def test_summaries_are_kept_and_gone_on_with(three: Three, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second verdict from the same summaries reads no recording again, and is the same."""
    paths, journal, first = three
    monkeypatch.setattr("analysis.joint.join_runs.summarise", None)
    assert join_runs(paths, journal=Journal(journal)) == first
    row = next(iter(Journal(journal).rows.values()))
    again = RunSummary.from_row(RunSummary.from_row(row).as_row())
    assert np.array_equal(again.quadratic.information, RunSummary.from_row(row).quadratic.information)


def test_runs_together_show_smaller_sizes(three: Three) -> None:
    """The verdict states what all runs could have shown: less than what one of them could."""
    paths, _, found = three
    one = close_loop(paths[:1]).detection.sizes
    for name in ("viscous_damping.rate_per_s", "adhesion.a_mps2"):
        assert 0.2 * one[name] < found.detection[name] < one[name]


def test_two_runs_are_refused(tmp_path: Path) -> None:
    """Fewer than three runs say nothing about how runs differ."""
    with pytest.raises(InputError, match="at least 3 recordings"):
        join_runs([tmp_path / "a.h5", tmp_path / "b.h5"])


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--summaries", "{0}/x.rows"], "--runs-differ"),
        (["--runs-differ", "--improved", "{0}/x.toml"], "--improved"),
        (["--runs-differ"], "at least 3 recordings"),
    ],
)
def test_options_that_do_not_go_together_are_refused(
    options: list[str], told: str, three: Three, tmp_path: Path
) -> None:
    """The command names the option and leaves with status 2."""
    done = CliRunner().invoke(app, ["close-loop", str(three[0][0]), *(o.format(tmp_path) for o in options)])
    assert done.exit_code == 2 and told in done.stderr
