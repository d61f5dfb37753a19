"""The report of recordings: what a person finds on the page, and that nothing in a recording can harm its reader."""

import base64
import dataclasses
import hashlib
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner

import bench.jobs.report
from analysis.flights.assemble import flights_of
from analysis.flights.table import FlightFlag, Flights
from analysis.loop.result import ClosedLoop, Source, save_verdict
from analysis.report.figures import loop as of_loop
from analysis.report.figures import recording as of_recording
from analysis.report.figures import style
from analysis.report.figures.flights import Measured, draw_bifurcations
from analysis.report.figures.flights import measured as as_shown
from analysis.report.figures.style import name_flights
from analysis.report.narrative import headline
from analysis.report.run_page import MOST_HOVER_POINTS, inline_figure, section_of, write_page
from bench.cli import app
from bench.jobs.report import not_of
from daq.recording import Recording, open_recording
from daq.recording.verify import VerifyReport
from daq.setup.errors import InputError
from tests.loops import changed

HOSTILE = '</script><script>document.title="owned"</script><img src=x onerror=alert(1)> $\\frac{ & "\' λ'


@pytest.fixture(scope="module")
def path(make: Callable[..., Any]) -> Path:
    """A recording of four steps at c = 1, from rest to a cycle."""
    found: Path = make(np.array([0.6, 0.8, 1.0, 1.2]), settle=4, hold=8).path
    return found


@pytest.fixture(scope="module")
def measured(path: Path) -> tuple[Recording, Flights]:
    """It, open, and its flights."""
    recording = open_recording(path)
    return recording, flights_of(recording)


@pytest.fixture(scope="module")
def plain(measured: tuple[Recording, Flights], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of the recording without a closed loop."""
    out = tmp_path_factory.mktemp("plain") / "r.html"
    page_of(as_shown(*measured), VerifyReport("complete"), out)
    return out


@pytest.fixture
def two_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages with two figures of a recording and none of a loop, for what is not about figures."""
    monkeypatch.setattr(of_recording, "FIGURES", of_recording.FIGURES[:2])
    monkeypatch.setattr(of_loop, "FIGURES", ())


class Page(HTMLParser):
    """Elements of a page, and its texts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep every element."""
        self.tags.append((tag, dict(attrs)))


def page_of(shown: Measured, state: VerifyReport, out: Path) -> str:
    """The text of a page with one section."""
    write_page([section_of(shown, state, 1, "left out")], out)
    return out.read_text(encoding="utf-8")


def test_the_page_stands_alone(measured: tuple[Recording, Flights], closed_loop: ClosedLoop, tmp_path: Path) -> None:
    """Verdict first, every part below, figures as SVG with named points, and nothing loaded from elsewhere."""
    recording, flights = measured
    text = page_of(as_shown(recording, flights, loop=closed_loop), VerifyReport("complete"), tmp_path / "r.html")
    heads = ("Measured and predicted", "Steps", "Why", "The rig", "Calibrations", "The data")
    places = [text.index(word) for word in ('class="verdict', *(f">{head}<" for head in heads))]
    assert places == sorted(places)
    assert text.count("<svg") >= 8 and text.count("data-points=") >= 4
    tags = Page(text).tags
    linked = [v for _, attrs in tags for k, v in attrs.items() if k in ("src", "href", "xlink:href") and v]
    assert all(v.startswith(("#", "data:image/png;base64,")) for v in linked)
    assert not re.search(r"\bnan\b", re.sub(r"base64,[^\"]*|<script.*?</script>", "", text, flags=re.DOTALL))
    assert "default-src &#39;none&#39;" in text and "prefers-color-scheme" not in text and "@media print" in text


def test_the_points_name_their_flights(measured: tuple[Recording, Flights], plain: Path) -> None:
    """Every point of the diagram carries its flight's row; what the pointer says of it is the flight's time."""
    flights, text = measured[1], plain.read_text(encoding="utf-8")

    def told(name: str) -> Any:
        found = re.search(rf'<script type="application/json" id="{name}">(.*?)</script>', text, flags=re.DOTALL)
        assert found is not None
        return json.loads(found[1])

    rows = np.frombuffer(base64.b64decode(told("points-bifurcation1")["row"]), "<i4")
    durations = np.frombuffer(base64.b64decode(told("flights-1")["columns"]["duration_s"][3:]), "<f8")
    np.testing.assert_array_equal(durations, flights.duration_s)
    assert len(rows) and not flights.has(FlightFlag.SETTLING)[rows].any()
    y = np.frombuffer(base64.b64decode(told("points-bifurcation1")["y"]), "<f4")
    order = np.argsort(durations[rows])
    assert np.all(np.diff(y[order]) <= 1e-3), "longer flights are higher up, so at smaller y"


def test_texts_of_a_recording_are_texts(
    measured: tuple[Recording, Flights], closed_loop: ClosedLoop, tmp_path: Path
) -> None:
    """A note, a profile's name, a key and a file name of markup, script and TeX come out as what they are."""
    recording, flights = measured
    odd = tmp_path / "a$x^{$<b>.h5"
    shutil.copyfile(recording.path, odd)
    with open_recording(odd) as copy:
        copy.attrs.update(note=HOSTILE, why=HOSTILE, backend=HOSTILE, extra={HOSTILE: HOSTILE})
        copy.setup = copy.setup.model_copy(update={"name": HOSTILE, "description": HOSTILE})
        source = Source(HOSTILE, HOSTILE, "", HOSTILE, True, HOSTILE, HOSTILE, HOSTILE)
        loop = changed(closed_loop, sources=(source,), notes=(HOSTILE,), rounds=(HOSTILE,))
        text = page_of(as_shown(copy, flights, loop=loop), VerifyReport("stopped", [HOSTILE]), tmp_path / "r.html")
    tags = Page(text).tags
    assert [t for t, _ in tags].count("title") == 1 and not any(k.startswith("on") for _, a in tags for k in a)
    assert [a for t, a in tags if t == "script" and a.get("type") != "application/json"] == [{}]
    assert "img" not in {t for t, _ in tags} and "&lt;/script&gt;&lt;script&gt;" in text


def test_the_policy_allows_only_the_pages_own_script(tmp_path: Path) -> None:
    """The hash in the policy is that of the script as it stands on the page."""
    write_page([], tmp_path / "r.html")
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    body = re.search(r"<script>(.*)</script>", text, flags=re.DOTALL)
    assert body is not None
    digest = base64.b64encode(hashlib.sha256(body[1].encode()).digest()).decode()
    assert f"script-src &#39;sha256-{digest}&#39;" in text


def test_many_flights_stay_a_small_page() -> None:
    """A hundred thousand flights: dots as a picture, hover thinned evenly, both said, below two megabytes."""
    n = 100_000

    def draw(figure: Any) -> None:
        ax = figure.subplots()
        (line,) = ax.plot(np.arange(n), np.sin(np.arange(n)), "o", ms=2)
        name_flights(line, np.arange(n))

    made = inline_figure(style.Figure("dots", draw, "flights", "Dots."), draw)
    assert made is not None and made.points is not None
    assert len(made.element) + sum(map(len, made.points.values())) < 2_000_000
    rows = np.frombuffer(base64.b64decode(made.points["row"]), "<i4")
    assert len(rows) <= MOST_HOVER_POINTS and np.all(np.diff(rows) == 2)
    assert "100000 points are drawn as a picture" in made.remark and "50000 of the 100000" in made.remark


def test_few_flights_are_vectors() -> None:
    """A figure with a thousand points holds no picture, and no remark."""

    def draw(figure: Any) -> None:
        figure.subplots().plot(np.arange(1000.0), np.arange(1000.0), "o")

    made = inline_figure(style.Figure("dots", draw, "flights", "Dots."), draw)
    assert made is not None and "<image" not in made.element and made.remark == ""


def test_the_headline_has_all_that_is_asked(closed_loop: ClosedLoop) -> None:
    """What was found with its interval, error before and after, noise, certainty, and what it may be instead."""
    words = headline(closed_loop)
    assert words.startswith("Coulomb friction (") and " .. " in words and "instead of" in words and "noise" in words
    clean = headline(changed(closed_loop, verdict="nothing_missing", effects=(), names=(), ties=()))
    assert clean.startswith("Nothing is missing")
    failed = dataclasses.replace(closed_loop, verdict="unexplained")
    assert headline(failed).startswith("Something is left") and "not believed" in headline(failed)


def test_the_diagram_has_both_models(measured: tuple[Recording, Flights], closed_loop: ClosedLoop) -> None:
    """Where a cause was found, measured flights stand over the declared and over the improved model."""
    recording, flights = measured

    def legend(loop: ClosedLoop | None) -> list[str]:
        figure = Figure()
        draw_bifurcations(Measured(recording, flights, None, loop), figure)
        return [text.get_text() for text in figure.axes[0].get_legend().get_texts()]

    assert legend(closed_loop)[1:] == ["declared model: ideal", "improved model: coulomb_friction", "measured"]
    unexplained = dataclasses.replace(closed_loop, verdict="unexplained")
    assert legend(unexplained) == legend(None) == ["forbidden to the ideal ball", "declared model: ideal", "measured"]


@pytest.mark.usefixtures("two_figures")
def test_a_saved_answer_has_to_belong(
    measured: tuple[Recording, Flights], closed_loop: ClosedLoop, tmp_path: Path
) -> None:
    """An answer is taken only where date, profile and every take-off time are the recording's."""
    recording, flights = measured
    own = dataclasses.replace(closed_loop.sources[0], started=str(recording.attrs["started"]))
    times = np.resize(flights.takeoff_s, len(closed_loop.flights))
    table = dataclasses.replace(closed_loop.flights, takeoff_s=times)
    good = dataclasses.replace(closed_loop, sources=(own,), setup=recording.setup, flights=table)
    assert not_of(good, recording, flights) == ""
    late = dataclasses.replace(table, takeoff_s=times + 1e-9)
    for wrong, word in (
        (dataclasses.replace(good, sources=(own, own)), "2 recordings"),
        (dataclasses.replace(good, sources=(dataclasses.replace(own, started="2020-01-01T00:00:00Z"),)), "begun 2020"),
        (dataclasses.replace(good, setup=closed_loop.setup), "another profile"),
        (dataclasses.replace(good, flights=late), "flights"),
    ):
        assert word in not_of(wrong, recording, flights)
    copy = tmp_path / "r.h5"
    shutil.copyfile(recording.path, copy)
    save_verdict(good, tmp_path / "r.loop")
    told = CliRunner().invoke(app, ["report", str(copy), "--out", str(tmp_path / "r.html"), "--json", "-"])
    assert told.exit_code == 0, told.output
    assert json.loads(told.stdout)["runs"][0]["loop"] == "saved"


@pytest.mark.usefixtures("two_figures")
def test_two_runs_are_compared(path: Path, make: Callable[..., Any], tmp_path: Path) -> None:
    """A table at the top with a row each, and a section each whose names do not collide."""
    other = make(np.array([0.6, 0.9, 1.2]), settle=4, hold=8, seed=2).path
    out = tmp_path / "r.html"
    call = ["report", str(path), str(other), "--out", str(out), "--no-loop", "--json", str(tmp_path / "r.json")]
    done = CliRunner().invoke(app, call)
    assert done.exit_code == 0, done.output
    text = out.read_text(encoding="utf-8")
    assert ">Comparison<" in text and 'id="run1"' in text and 'id="run2"' in text
    assert 'id="flights-1"' in text and 'id="flights-2"' in text
    assert [r["loop"] for r in json.loads((tmp_path / "r.json").read_text())["runs"]] == ["none", "none"]
    again = CliRunner().invoke(app, ["report", str(path), str(path), "--out", str(tmp_path / "s.html"), "--no-loop"])
    assert again.exit_code == 2 and "one file" in again.stderr


def test_no_printer_is_said_before_the_work(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a browser and without WeasyPrint --pdf is refused with what to do, and no page is left."""
    monkeypatch.setattr(bench.jobs.report, "browser", lambda: None)
    monkeypatch.setitem(sys.modules, "weasyprint", None)
    call = ["report", str(path), "--out", str(tmp_path / "r.html"), "--pdf", str(tmp_path / "r.pdf"), "--no-loop"]
    done = CliRunner().invoke(app, call)
    assert done.exit_code == 2 and "WeasyPrint" in done.stderr and list(tmp_path.iterdir()) == []


def test_a_browser_that_fails_leaves_no_pdf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A browser that ends with an error, or never ends, is told with the page's name; no half PDF stays."""
    page = tmp_path / "r.html"
    page.write_text("x", encoding="utf-8")
    monkeypatch.setattr(bench.jobs.report, "browser", lambda: "chromium")
    gone = subprocess.CompletedProcess([], 1, "", "first\nno display")
    monkeypatch.setattr(subprocess, "run", lambda *a, **k: gone)
    with pytest.raises(InputError, match="no display"):
        bench.jobs.report.print_pdf(page, tmp_path / "r.pdf")

    def hangs(*a: Any, **k: Any) -> Any:
        raise subprocess.TimeoutExpired("chromium", 1.0)

    monkeypatch.setattr(subprocess, "run", hangs)
    with pytest.raises(InputError, match="did not print"):
        bench.jobs.report.print_pdf(page, tmp_path / "r.pdf")
    assert [p.name for p in tmp_path.iterdir()] == ["r.html"]


@pytest.mark.skipif(bench.jobs.report.browser() is None, reason="no Chromium, Chrome or Edge on this machine")
def test_a_real_browser_prints_the_page(plain: Path, tmp_path: Path) -> None:
    """Chromium makes a PDF of several pages with text, whose figures are vectors."""
    bench.jobs.report.print_pdf(plain, tmp_path / "r.pdf")
    made = (tmp_path / "r.pdf").read_bytes()
    assert made.startswith(b"%PDF") and made.count(b"/Type /Page\n") + made.count(b"/Type /Page/") >= 2
