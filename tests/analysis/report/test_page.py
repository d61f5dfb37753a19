"""The report of a closed loop: every verdict, and what a person finds on the page and at the terminal."""

import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import analysis.loop.close_loop
import analysis.report.page
from analysis.attribution.hypothesis import Rejected
from analysis.discovery.symbolic import FORMS
from analysis.loop.result import ClosedLoop
from analysis.loop.verdict import Failed
from analysis.report.narrative import reasoning
from analysis.report.page import write_report
from analysis.report.wording import VERDICTS, interval, verdict_line
from bench.cli import app
from daq.recording import open_recording
from tests.loops import changed, found_by


@pytest.fixture(scope="module")
def recording(make: Callable[..., Any]) -> Path:
    """A short recording without a profile, for the command to find."""
    path: Path = make(np.array([0.8]), settle=2, hold=3).path
    return path


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are not drawn: what is looked at is the text."""
    monkeypatch.setattr(analysis.report.page, "save_picture", lambda *a: None)


@pytest.mark.parametrize("verdict", VERDICTS)
def test_exit_status_is_zero_whatever_the_verdict(
    closed_loop: ClosedLoop, recording: Path, verdict: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command leaves with 0 for each verdict, and standard output carries the JSON and nothing else."""
    loop = dataclasses.replace(closed_loop, verdict=verdict)
    monkeypatch.setattr(analysis.loop.close_loop, "fit_loop", lambda *a, **k: (loop, None))
    monkeypatch.setattr("bench.profiles.improved.possible_runs", lambda *a: [])
    result = CliRunner().invoke(app, ["close-loop", str(recording), "--json", "-"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["verdict"] == verdict


@pytest.mark.parametrize("verdict", VERDICTS)
@pytest.mark.usefixtures("no_figures")
def test_the_report_says_the_verdict(closed_loop: ClosedLoop, verdict: Any, tmp_path: Path) -> None:
    """For each verdict one page with the verdict in words, and the JSON beside it."""
    page = write_report(dataclasses.replace(closed_loop, verdict=verdict), tmp_path / "report")
    text = page.read_text(encoding="utf-8")
    assert VERDICTS[verdict] in text
    assert "simulated rig" in text and not re.search(r"\bnan\b", re.sub(r"base64,[^\"]*", "", text))
    assert json.loads((tmp_path / "report" / "report.json").read_text(encoding="utf-8"))["verdict"] == verdict


@pytest.mark.usefixtures("no_figures")
def test_nothing_missing_names_nothing(closed_loop: ClosedLoop, tmp_path: Path) -> None:
    """Where the declared model suffices, the page adds no effect and says so."""
    clean = changed(
        closed_loop, verdict="nothing_missing", effects=(), names=(), ties=(), parameters=(),
        after=closed_loop.errors.before,
    )  # fmt: skip
    page = write_report(clean, tmp_path / "report")
    text = page.read_text(encoding="utf-8")
    assert VERDICTS["nothing_missing"] in text
    assert "<th>added</th>" not in text


@pytest.mark.usefixtures("no_figures")
def test_the_page_has_the_formulas_of_a_discovered_term(closed_loop: ClosedLoop, tmp_path: Path) -> None:
    """Each formula stands with its loss over the curve's, without and with the cost of its parameters."""
    loop = found_by(closed_loop, "force", "velocity_mps", FORMS[0], "m/s^2")
    text = write_report(loop, tmp_path / "report").read_text(encoding="utf-8")
    cost = loop.limits.tie_nats * len(FORMS[0].parameters)
    assert FORMS[0].expression in text and f"<td>-3.0 ± 2.0</td><td>{cost - 3.0:+.1f}</td>" in text


def test_the_verdict_line_has_size_and_interval(closed_loop: ClosedLoop) -> None:
    """Each parameter with its 95 % interval and unit, on the page and the terminal alike."""
    loop = closed_loop
    value, low, high = loop.selection.effects[0].parameters["mu_up"]
    line = verdict_line(dataclasses.replace(loop, verdict="explained"))
    assert line.startswith("Explained by coulomb friction, ") and f"mu_up = {interval(value, low, high)}" in line
    doubtful = verdict_line(dataclasses.replace(loop, verdict="unexplained"))
    assert "not believed" in doubtful and interval(value, low, high) in doubtful


@pytest.mark.parametrize(
    ("numbers", "text"),
    [
        ((0.11776, 0.11, 0.12551), "0.1178 (0.1100 .. 0.1255)"),
        ((1793.9, 1700.0, 1890.0), "1794 (1700 .. 1890)"),
        ((2.3e-7, 2.1e-7, 2.5e-7), "2.30e-7 (2.10e-7 .. 2.50e-7)"),
        ((0.04, 0.0, 0.3), "0.04 (0.00 .. 0.30)"),
    ],
)
def test_value_and_interval_have_one_form(numbers: tuple[float, float, float], text: str) -> None:
    """The value and both ends are written to the same place."""
    assert interval(*numbers) == text


def test_the_page_tells_where_it_comes_from(closed_loop: ClosedLoop, tmp_path: Path) -> None:
    """Date, rig, back end and versions stand on the page; gamma is defined once; microseconds have one form."""
    page = write_report(closed_loop, tmp_path / "report")
    text = re.sub(r"base64,[^\"]*", "", page.read_text(encoding="utf-8"))
    setup = closed_loop.setup
    said = json.loads((tmp_path / "report" / "report.json").read_text(encoding="utf-8"))
    assert said["recordings"][0]["rig"].startswith(setup.name) and setup.name in text
    assert len(re.findall(r"data:image/png;base64,", page.read_text(encoding="utf-8"))) == 5
    assert said["report"]["date"] in text and text.count("shakerbench") == 2
    assert text.count("Γ<sub>peak</sub> = max(-a)/g") == 1 and "gamma" not in text
    assert not re.search(r"\d[.\d]*e[+-]?\d+ (µs|us)", text)


@pytest.mark.usefixtures("no_figures")
def test_a_report_with_its_recording_has_the_first_bifurcation(
    closed_loop: ClosedLoop, make: Callable[..., Any], tmp_path: Path
) -> None:
    """Page and JSON have it as measured and as both models predict it; without the recording they leave it out."""
    path = make(np.array([1.2, 1.55, 1.75]), settle=40, hold=20).path
    with open_recording(path) as recording:
        loop = dataclasses.replace(closed_loop, setup=recording.setup)
    page = write_report(loop, tmp_path / "with", recording=path).read_text(encoding="utf-8")
    write_report(closed_loop, tmp_path / "without")
    found, none = (
        json.loads((tmp_path / name / "report.json").read_text(encoding="utf-8"))["first_bifurcation"]
        for name in ("with", "without")
    )
    assert none is None and "First bifurcation" not in (tmp_path / "without" / "report.html").read_text("utf-8")
    seen, before, after = (found[key] for key in ("measured", "before", "after"))
    # a lock at gamma_peak = hypot(1, pi), and gamma_peak = 2 gamma for c = 1
    assert before["gamma"] == pytest.approx(np.hypot(1.0, np.pi) / 2.0, abs=2e-3) and before["type"] == "lock"
    assert seen["gamma_low"] < before["gamma"] < seen["gamma_high"] and after["gamma"] > 1.02 * before["gamma"]
    assert f"First bifurcation: in the data\n{seen['type']} between" in page


def test_every_failed_test_is_a_reason(closed_loop: ClosedLoop) -> None:
    """The sentence on an unexplained recording names each test that failed, with what was found and allowed."""
    tests = ("flights", "plate", "landings", "takeoffs")
    failed = tuple(Failed(t, 10.0 + n, 1.6) for n, t in enumerate(tests))  # type: ignore[arg-type]
    said = reasoning(dataclasses.replace(closed_loop, verdict="unexplained", failed=failed))[-1]
    assert said.count(";") == 3
    assert all(f"{10 + n}." in said for n in range(4)) and "1.6" in said


@pytest.mark.usefixtures("no_figures")
def test_the_best_rejected_candidate_is_shown(
    closed_loop: ClosedLoop, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Page and terminal name the refused candidate of the greatest gain, its gain and the reason."""
    from bench.terminal.loop_display import show

    refused = Rejected(("restitution",), 1729.0, 480.0, "the steps do not agree on its gain")
    loop = changed(closed_loop, rejected=refused)
    show(loop)
    page = write_report(loop, tmp_path / "report").read_text(encoding="utf-8")
    for text in (capsys.readouterr().out, page.replace("±", "+-")):
        assert "restitution, 1729 +- 480 nats" in text and "the steps do not agree on its gain" in text


def test_a_table_of_the_profile_in_a_note_is_shown(closed_loop: ClosedLoop, capsys: pytest.CaptureFixture[str]) -> None:
    """A note's [drive] is the name of a table, and no markup of the terminal."""
    from bench.terminal.loop_display import show

    show(dataclasses.replace(closed_loop, notes=("the profile declares no [drive] g_per_volt",)))
    assert "declares no [drive] g_per_volt" in capsys.readouterr().out


def test_the_verdict_survives_a_failing_output(
    closed_loop: ClosedLoop, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The verdict is shown before anything is written; each failure is told under its name, and the rest is written."""
    from daq.setup.errors import InputError

    def fails(*_: Any, **__: Any) -> None:
        raise InputError("the disk is full")

    monkeypatch.setattr(analysis.loop.close_loop, "fit_loop", lambda *a, **k: (closed_loop, None))
    monkeypatch.setattr("bench.profiles.improved.possible_runs", lambda *a: [])
    monkeypatch.setattr("bench.jobs.loops.drawn", fails)
    verdict, better = tmp_path / "verdict.json", tmp_path / "better.toml"
    call = ["close-loop", str(recording), "--report", str(tmp_path / "report"), "--json", str(verdict)]
    result = CliRunner().invoke(app, [*call, "--improved", str(better)])
    assert result.exit_code == 1
    assert "verdict: " in result.stdout
    assert "the report could not be written: the disk is full" in result.stderr
    assert json.loads(verdict.read_text(encoding="utf-8"))["verdict"] == closed_loop.verdict
    assert result.stderr.count("error: ") == 2 and "improved profile" in result.stderr  # the recording has no profile


def test_an_improved_profile_that_exists_is_refused_before_any_work(
    closed_loop: ClosedLoop, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is computed for a name that is taken."""
    better = tmp_path / "better.toml"
    better.write_text("mine", encoding="utf-8")
    monkeypatch.setattr(analysis.loop.close_loop, "fit_loop", lambda *a, **k: pytest.fail("computed first"))
    result = CliRunner().invoke(app, ["close-loop", str(recording), "--improved", str(better)])
    assert result.exit_code == 2 and better.read_text(encoding="utf-8") == "mine"
