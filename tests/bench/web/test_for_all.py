"""Every page of the desk for the keyboard, the screen reader and other languages, in a real Chromium.

Roles, names, contrast and tables are checked by axe-core (of the package axe-playwright-python, without the network).
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import axe_playwright_python
import pytest

import bench.web
import tests.loops
from analysis.loop.result import ClosedLoop
from analysis.loop.verdict import Failed
from analysis.report.narrative import headline
from bench.jobs.loops import keep_verdict
from bench.jobs.run_ramp import check_rig, open_rig
from bench.profiles.edit import fields_of
from bench.profiles.find import load
from bench.runs.folder import run_id
from tests.bench.runs.recordings import record, verdict_on

AXE = (Path(axe_playwright_python.__file__).parent / "axe.min.js").read_text(encoding="utf-8")
LANGUAGES = Path(bench.web.__file__).parent / "static" / "languages"
RUN = run_id("a.h5")
AT_REST = """() => new Promise((done) => {
  let waiting = setTimeout(done, 400);
  const again = () => { clearTimeout(waiting); waiting = setTimeout(done, 400); };
  new MutationObserver(again).observe(document, { subtree: true, childList: true, characterData: true });
})"""  # nothing was written for 0.4 s
KNOWN = "texts => { desk.missing.clear(); texts.forEach(desk.say); return [...desk.missing]; }"


@pytest.fixture
def desk(bench: Any, tmp_path: Path, closed_loop: ClosedLoop) -> str:
    """The address of the whole desk on a folder with one run and a verdict on it."""
    run = tmp_path / "runs" / "a.h5"
    record(run, gammas=(0.6, 0.8))
    keep_verdict(verdict_on(closed_loop, run), [run])
    return str(bench("live", "--runs", run.parent)[1])


def opened(page: Any, address: str) -> None:
    """A page, once its language is there and it is at rest."""
    page.goto(address)
    page.wait_for_selector("html[data-language]", timeout=120_000)
    page.evaluate(AT_REST)


def said_by_the_desk(loop: ClosedLoop) -> list[str]:
    """Help of the profile's keys, what a check finds with its remedies, and the words of verdicts."""
    said = [key["help"] for name in ("simulated", "soundcard", "c3") for key in fields_of(load(name)[1])]
    for found in check_rig(*open_rig("simulated", "check", None, 0)):
        said += [found.what, found.seen, found.remedy]
    left = tests.loops.changed(loop, verdict="unexplained", failed=(Failed("plate", 1.7, 1.5),))
    none = tests.loops.changed(loop, verdict="nothing_missing", effects=())
    return [*filter(None, said), *map(headline, (loop, left, none))]


def violations(page: Any) -> list[str]:
    """What axe-core finds on a page, in words."""
    page.evaluate(AXE)
    return [
        f"{page.url}: {one['help']} {one['nodes'][0]['target']}" for one in page.evaluate("axe.run()")["violations"]
    ]


def test_catalogues_have_the_same_texts() -> None:
    """German and French have every text, with as many numbers as the English one, and none is empty."""
    german, french = (json.loads((LANGUAGES / f"{name}.json").read_text(encoding="utf-8")) for name in ("de", "fr"))
    assert german.keys() == french.keys() and len(german) > 300
    for catalogue in (german, french):
        for english, own in catalogue.items():
            assert own.strip() and own.count("#") == english.count("#") and own.count("*") == english.count("*")


@pytest.mark.slow
def test_every_page_is_whole_for_a_screen_reader_and_in_another_language(
    desk: str, chromium: Any, closed_loop: ClosedLoop
) -> None:
    """No violation by axe-core; no text that the catalogues lack, in the pseudo language; then German, with comma."""
    page = chromium.new_page(viewport={"width": 1280, "height": 800})
    opened(page, f"{desk}/runs")
    page.evaluate("localStorage.setItem('language', 'pseudo')")
    lacking, faults = dict[str, list[str]](), list[str]()
    for path in (
        "/gates",
        "/runs",
        "/live",
        "/drop",
        "/agent",
        "/runs/nothing",
        f"/runs/compare?ids={RUN}",
        f"/runs/{RUN}",
    ):
        opened(page, desk + path)
        if path.endswith(f"/{RUN}"):
            page.wait_for_selector("#scope[data-events]", timeout=120_000)
            page.focus("#by-hand-part summary")
            page.keyboard.press("Enter")
            page.locator("#verdict button").nth(1).press("Enter")
            page.wait_for_selector("#why-part[data-done=steps]", timeout=60_000)
            page.locator("#why-steps button").first.press("Enter")
            page.locator("#why-flights button").nth(3).press("Enter")
            page.wait_for_selector("#edges[data-flight]")
        if missing := page.evaluate("[...desk.missing]"):
            lacking[path] = missing
        faults += violations(page)
    assert lacking == {} and faults == []
    assert page.evaluate(KNOWN, said_by_the_desk(closed_loop)) == []
    page.evaluate("localStorage.setItem('language', 'de'); localStorage.setItem('decimal', 'comma')")
    opened(page, f"{desk}/runs/{RUN}")
    assert page.get_attribute("html", "lang") == "de" and "Warum?" in page.inner_text("main")
    assert re.search(r"0,600 bis 0,800", page.inner_text("#facts"))
    page.close()
