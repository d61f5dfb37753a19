"""The page of a drop test in a real Chromium: impacts dragged, added and taken away, and the numbers that follow."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import wavfile
from typer.testing import CliRunner

from bench.cli import app
from tests.bench.contrast import too_pale

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
PATIENCE_S = 90.0  # of a machine that runs tests beside
IMPACTS = 0.5 + np.concatenate(([0.0], np.cumsum(0.4 * 0.85 ** np.arange(9))))


@pytest.fixture
def tap(tmp_path: Path) -> Path:
    """Ten taps of a ball with restitution 0.85, in noise."""
    rate, rng = 16000, np.random.default_rng(1)
    sound = 1e-3 * rng.standard_normal(int(4.0 * rate))
    ring = np.arange(int(0.05 * rate)) / rate
    for k, when in enumerate(IMPACTS):
        first = int(np.ceil(when * rate))
        since = ring + first / rate - when
        sound[first : first + len(ring)] += 0.5 * 0.8**k * np.sin(2 * np.pi * 2100.0 * since) * np.exp(-since / 0.008)
    wavfile.write(tmp_path / "tap.wav", rate, (32000 * sound).astype(np.int16))
    return tmp_path / "tap.wav"


def opened(chromium: Any, url: str, path: str = "") -> Any:
    """A browser of its own with the page open."""
    page = chromium.new_context(viewport={"width": 1280, "height": 900}).new_page()
    page.faults = []
    page.on("pageerror", lambda error: page.faults.append(str(error)))
    page.goto(url + path)
    return page


def until(page: Any, condition: str) -> None:
    """Wait until an expression is true in the page."""
    ends = time.monotonic() + PATIENCE_S
    while time.monotonic() < ends:
        if page.evaluate(condition):
            return
        time.sleep(0.05)
    raise AssertionError(condition)


def results(page: Any, number: int) -> None:
    """Wait until the page has shown so many results."""
    until(page, f"document.body.dataset.state === 'done' && Number(document.body.dataset.results) >= {number}")


def impacts(page: Any) -> list[float]:
    """Impacts as the page draws them."""
    until(page, "document.querySelector('.scene')?.dataset.impacts !== undefined")
    time.sleep(0.2)  # the next frame of the screen
    return [float(t) for t in page.locator(".scene").get_attribute("data-impacts").split()]


def place(page: Any, when: float) -> tuple[float, float]:
    """Where on the screen a time lies."""
    low, high = map(float, page.locator(".scene").get_attribute("data-view").split())
    box = page.locator(".scene").bounding_box()
    root = float(page.evaluate("parseFloat(getComputedStyle(document.documentElement).fontSize)")) / 14.0
    width = box["width"] - (62 + 14) * root
    return box["x"] + 62 * root + width * (when - low) / (high - low), box["y"] + 0.4 * box["height"]


def test_impacts_are_dragged_added_and_taken_away(chromium: Any, bench: Any, tap: Path) -> None:
    """Each correction makes the verdict anew, undo takes it back, and the JSON keeps it for the next time."""
    _, url = bench("drop", tap, "--page")
    page, other = opened(chromium, url), opened(chromium, url)
    results(page, 1)
    first = impacts(page)
    assert np.abs(np.array(first) - IMPACTS).max() < 1e-3
    e0 = float(page.locator("#sentences").get_attribute("data-e0"))
    assert e0 == pytest.approx(0.85, abs=0.002)
    x, y = place(page, first[1])
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 4, y)
    page.mouse.move(place(page, first[1] + 0.02)[0], y)
    page.mouse.up()
    results(page, 2)
    moved = impacts(page)
    assert moved[1] == pytest.approx(first[1] + 0.02, abs=0.004) and moved[2] == first[2]
    assert "0 irregular" not in page.locator("#sentences").inner_text()  # no flight fits an impact 20 ms off
    assert float(page.locator("#sentences").get_attribute("data-e0")) != e0
    page.click("#undo")
    results(page, 3)
    assert impacts(page) == first
    page.mouse.click(*place(page, first[4]))
    page.keyboard.press("Delete")
    results(page, 4)
    assert impacts(page) == first[:4] + first[5:] and "1 missed" in page.locator("#sentences").inner_text()
    page.mouse.dblclick(*place(page, first[4]))
    results(page, 5)
    assert impacts(page) == pytest.approx(first, abs=1e-5)  # it comes back as it was found
    page.locator(".impacts input").nth(2).fill(f"{first[2] + 0.003:.5f}")
    page.keyboard.press("Enter")
    results(page, 6)
    assert impacts(page)[2] == pytest.approx(first[2] + 0.003, abs=1e-5)
    assert "--add" in page.locator("#command").inner_text()
    assert other.locator("#save").is_disabled() and other.locator(".impacts input").first.is_disabled()
    assert impacts(other) == impacts(page)
    page.click("#save")
    until(page, "document.querySelector('#saved').textContent.includes('tap.wav.drop.json')")
    kept = json.loads((tap.parent / "tap.wav.drop.json").read_text(encoding="utf-8"))
    assert kept["options"]["corrections"][0]["add_s"] == [pytest.approx(first[2] + 0.003, abs=1e-5)]
    assert len(kept["options"]["corrections"][0]["ignore_s"]) == 1
    assert kept["models"][0]["parameters"]["e0"]["value"] is not None
    other.evaluate("localStorage.setItem('language', 'pseudo')")
    other.reload()
    impacts(other)
    other.wait_for_selector("html[data-language=pseudo]", timeout=1e3 * PATIENCE_S)
    assert other.evaluate("[...desk.missing]") == []  # the catalogues have every text
    assert page.faults == [] and other.faults == [] and too_pale(page) == []


def test_a_file_of_the_desk_is_opened_with_what_was_kept(chromium: Any, bench: Any, tap: Path, tmp_path: Path) -> None:
    """An empty folder says what belongs there; a file opens with its corrections, and a wrong option is refused."""
    folder = tmp_path / "runs"
    folder.mkdir()
    desk = opened(chromium, bench("live", "--runs", folder)[1], "/drop")
    desk.wait_for_selector("#none", timeout=1e3 * PATIENCE_S)
    assert "put one there" in desk.inner_text("#none")
    for name in ("tap.wav", ".hidden.wav"):
        (folder / name).write_bytes(tap.read_bytes())
    given = ["drop", str(folder / "tap.wav"), "--ignore", f"{IMPACTS[-1]:.5f}", "--no-pictures"]
    kept = CliRunner().invoke(app, [*given, "--json", str(folder / "tap.wav.drop.json")])
    assert kept.exit_code == 0, kept.output
    desk.reload()
    desk.locator("#files label").first.wait_for(timeout=1e3 * PATIENCE_S)
    assert desk.locator("#files label").all_inner_texts() == [" tap.wav"]
    desk.locator("#files input").check()
    desk.click("#open")
    results(desk, 1)
    assert len(impacts(desk)) == len(IMPACTS) - 1
    desk.fill("[name=mass_kg]", "0.0027")
    desk.click("text=measure again")
    until(desk, "document.querySelector('#refused').textContent.includes('--diameter')")
    assert desk.faults == []
