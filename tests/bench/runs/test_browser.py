"""The pages of the runs in a real Chromium."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from analysis.loop.result import ClosedLoop
from bench.jobs.loops import keep_verdict
from bench.runs.folder import run_id
from daq.files.tables import note_rows
from daq.recording.notebook import change_remarks, with_note, with_tags
from tests.bench.contrast import too_pale
from tests.bench.runs.recordings import RATE_HZ, record, verdict_on

pytestmark = pytest.mark.slow
HOSTILE = '</td><script>document.title="taken"</script><img src=x onerror="document.title=\'taken\'">'


@pytest.fixture
def server(bench: Any, folder: Path) -> str:
    """The address of the desk on a folder of runs."""
    return str(bench("live", "--runs", folder)[1])


@pytest.fixture
def browser(chromium: Any) -> Iterator[Any]:
    """A page that collects its errors."""
    page = chromium.new_page(viewport={"width": 1280, "height": 800})
    page.errors = []
    page.on("pageerror", lambda error: page.errors.append(str(error)))
    yield page
    page.close()


def until(page: Any, condition: str) -> None:
    """Wait until an expression is true in the page."""
    for _ in range(300):
        if page.evaluate(condition):
            return
        time.sleep(0.05)
    raise AssertionError(condition)


def files(page: Any) -> list[str]:
    """File names in the table, in order."""
    return [Path(text).name for text in page.locator("#runs tbody a").all_inner_texts()]


def test_table_filtered_sorted_and_marked(server: str, browser: Any, folder: Path) -> None:
    """The table filters while one types, sorts by its headings, and shows markup in a note as text."""
    change_remarks(folder / "one" / "a.h5", "", lambda now: with_note(with_tags(now, ("warm",)), HOSTILE))
    browser.goto(f"{server}/runs")
    browser.wait_for_selector("#runs tbody tr")
    assert len(files(browser)) == 3
    assert HOSTILE in browser.locator("#runs tbody").inner_text()
    browser.click('th[data-key="gamma"] button')
    browser.wait_for_selector('th[data-key="gamma"][aria-sort="ascending"]')
    until(browser, "document.querySelector('#runs tbody a').textContent === 'one/a.h5'")
    assert files(browser) == ["a.h5", "b.h5", "c.h5"]
    browser.fill("[name=tags]", "warm")
    until(browser, "document.querySelectorAll('#runs tbody tr').length === 1")
    assert files(browser) == ["a.h5"] and "tags=warm" in browser.url
    assert browser.title().startswith("Runs") and browser.errors == [] and too_pale(browser) == []
    browser.set_viewport_size({"width": 390, "height": 844})
    assert browser.evaluate("document.documentElement.scrollWidth") <= 390


def test_click_opens_and_zooms_to_a_single_contact(server: str, browser: Any, folder: Path) -> None:
    """A click opens the run; wheel, keys and drag lead from all of it to single samples and back."""
    writer = record(folder / "long.h5", gammas=(0.9,) * 40, close=False)
    writer.mark_rows("notes", note_rows(15_000, ["a knock"], time.time_ns()))
    writer.close()
    noted_s = 15_000 / RATE_HZ
    browser.goto(f"{server}/runs")
    browser.click("#runs tbody tr:has-text('long.h5') td:nth-child(9)")
    browser.wait_for_url(f"**/runs/{run_id('long.h5')}")
    scope = browser.locator("#scope[data-seen]")
    scope.wait_for()

    def seen() -> list[float]:
        return [float(x) for x in scope.get_attribute("data-seen").split()]

    assert seen()[:2] == [0.0, 20.0]
    browser.hover("#scope")
    for _ in range(14):
        browser.mouse.wheel(0, -240)
    until(browser, "document.querySelector('#where').textContent.includes('every sample')")
    start_s, stop_s, each = seen()
    assert each == 1.0 and stop_s - start_s < 0.02
    scope.focus()
    browser.keyboard.press("Home")
    until(browser, "document.querySelector('#scope').dataset.seen.startsWith('0 20 ')")
    browser.keyboard.press("PageDown")
    until(browser, "document.querySelector('#scope').dataset.seen.startsWith('0.5 ')")
    box = scope.bounding_box()
    browser.mouse.move(box["x"] + 600, box["y"] + 50)
    browser.mouse.down()
    browser.mouse.move(box["x"] + 400, box["y"] + 50)
    browser.mouse.up()
    until(browser, "parseFloat(document.querySelector('#scope').dataset.seen) > 0.55")
    browser.click("#notes button")
    until(browser, f"Math.abs(parseFloat(document.querySelector('#scope').dataset.seen) - {noted_s - 0.5}) < 1e-6")
    assert scope.get_attribute("data-notes") == "1" and "a knock" in browser.locator("#notes").inner_text()
    browser.fill("[name=tag]", "kept")
    browser.click("text=add tag")
    browser.wait_for_selector("#tags .tag")
    assert (folder / "long.h5.remarks.json").exists() and browser.errors == [] and too_pale(browser) == []
    browser.set_viewport_size({"width": 390, "height": 844})
    assert browser.evaluate("document.documentElement.scrollWidth") <= 390


def test_an_event_is_changed_by_hand(server: str, browser: Any, folder: Path) -> None:
    """By keyboard: the events of a stretch are listed, one is added, and undo takes it back."""
    browser.goto(f"{server}/runs/{run_id('one/b.h5')}")
    browser.wait_for_selector("#scope[data-events]", timeout=120_000)
    before = browser.get_attribute("#scope", "data-events")
    assert before.endswith(" 0")
    browser.focus("#by-hand-part summary")
    browser.keyboard.press("Enter")
    browser.fill("#event-at", "0.2345")
    browser.focus("#add-event button")
    browser.keyboard.press("Enter")
    until(browser, "document.querySelector('#by-hand').textContent.startsWith('1 event was changed by hand (1 added)')")
    assert browser.locator("#events tbody tr").count() in range(41) and browser.errors == [] and too_pale(browser) == []
    browser.click("#undo-event")
    until(browser, f"document.querySelector('#scope').dataset.events === '{before}'")
    browser.set_viewport_size({"width": 390, "height": 844})
    assert browser.evaluate("document.documentElement.scrollWidth") <= 390


def test_a_number_of_the_verdict_leads_to_its_samples(
    server: str, browser: Any, folder: Path, closed_loop: ClosedLoop
) -> None:
    """By clicks: the verdict's error, a step, one flight; its edges are in words and its samples in the scope."""
    run = folder / "one" / "a.h5"
    keep_verdict(verdict_on(closed_loop, run), [run])
    browser.goto(f"{server}/runs/{run_id('one/a.h5')}")
    browser.wait_for_selector("#scope[data-seen]", timeout=120_000)
    browser.click("#verdict button:has-text('52')")
    browser.wait_for_selector("#why-part[data-done=steps]", timeout=60_000)
    assert "coulomb_friction" in browser.locator("#rivals").inner_text()
    browser.click("#why-steps button:has-text('step 0')")
    browser.click("#why-flights tbody tr:nth-child(4) button")
    browser.wait_for_selector("#edges[data-flight]")
    assert "landing measured 0.180000 s · declared 0.1799" in browser.locator("#edges").inner_text()
    until(browser, "parseFloat(document.querySelector('#scope').dataset.seen) > 0.14")
    browser.uncheck("#layer-declared")
    assert browser.errors == [] and too_pale(browser) == []
    browser.set_viewport_size({"width": 390, "height": 844})
    assert browser.evaluate("document.documentElement.scrollWidth") <= 390


def test_two_runs_over_each_other(server: str, browser: Any, folder: Path, closed_loop: ClosedLoop) -> None:
    """Marked runs are laid over each other: diagrams, verdicts, and what drifted."""
    for name, value in (("a", 0.12), ("b", 0.14)):
        run = folder / "one" / f"{name}.h5"
        keep_verdict(verdict_on(closed_loop, run, value), [run])
    browser.goto(f"{server}/runs?verdict=explained")
    until(browser, "document.querySelectorAll('#runs tbody tr').length === 2")
    for box in browser.locator("#runs tbody input").all():
        box.check()
    browser.click("#overlay")
    browser.wait_for_selector("#diagram-state[data-done]", state="attached")
    browser.wait_for_selector("#drifts[data-done]")
    assert browser.locator("#verdicts tbody tr").count() == 2
    assert "explained: coulomb_friction" in browser.locator("#verdicts").inner_text()
    assert "coulomb_friction.mu_up" in browser.get_attribute("#drifts", "data-done")
    assert "accelerometer.sensitivity" in browser.get_attribute("#drifts", "data-done")
    assert browser.errors == [] and too_pale(browser) == []
    browser.set_viewport_size({"width": 390, "height": 844})
    assert browser.evaluate("document.documentElement.scrollWidth") <= 390
