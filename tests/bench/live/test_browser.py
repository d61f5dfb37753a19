"""The live page in a real Chromium: a simulated ramp watched, noted, paused, stopped; hostile pages refused."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest

from analysis.flights.assemble import flights_of
from bench.profiles.find import shipped_folder
from daq.recording import open_recording, verify
from tests.bench.contrast import too_pale
from tests.bench.gates.passed import passed

pytestmark = [pytest.mark.slow, pytest.mark.timeout(180)]

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
SMALLEST = """Math.min(...[...document.querySelectorAll("h2, label, button, th, td, li")]
  .map((one) => parseFloat(getComputedStyle(one).fontSize)))"""
PATIENCE_S = 60.0  # of a machine that runs tests beside


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    """A ramp of six short steps, 9 s in all."""
    text = (shipped_folder() / "simulated.toml").read_text(encoding="utf-8")
    text = text.replace("{ start = 0.4, stop = 2.6, steps = 23 }", "[0.6, 0.8, 1.0, 1.2, 1.4, 1.6]")
    text = text.replace("_cycles = 10", "_cycles = 4").replace("_cycles = 20", "_cycles = 30")
    path = tmp_path / "quick.toml"
    path.write_text(text, encoding="utf-8")
    return path


def wait_for(page: Any, selector: str, text: str) -> None:
    """Until an element has a text."""
    page.locator(selector, has_text=re.compile(text)).wait_for(timeout=1e3 * PATIENCE_S)


def opened(chromium: Any, address: str) -> Any:
    """A browser of its own with the page open."""
    page = chromium.new_context(viewport={"width": 1280, "height": 800}).new_page()
    page.faults = []
    page.on("pageerror", lambda error: page.faults.append(str(error)))
    page.goto(address)
    return page


def test_run_is_started_watched_noted_paused_and_stopped(
    chromium: Any, bench: Any, profile: Path, tmp_path: Path
) -> None:
    """A refusal, a start, a note, a pause and going on; whoever sees the page stops it; the log outlives a reload."""
    passed(tmp_path, profile.name)
    _, url = bench("live", "--runs", tmp_path)
    page, other = opened(chromium, f"{url}/gates"), opened(chromium, f"{url}/live")
    wait_for(page, "#lease-word", "you hold the controls")
    wait_for(other, "#lease-word", "another browser holds")
    assert page.locator("#go").is_disabled()  # before it was said that hands are off
    page.click("#profile-box summary")
    page.fill("[data-key='limits.drive_v']", "-1")
    page.press("[data-key='limits.drive_v']", "Tab")
    wait_for(page, "#refused", "limits.drive_v")  # and it stays, until the next thing is asked
    page.fill("#run-name", "first")
    page.fill("#run-note", "before")
    page.check("#hands")
    page.click("#go")
    page.click("#watch")
    page.wait_for_url("**/live")
    wait_for(page, "#lease-word", "you hold the controls")
    wait_for(page, "#state-step", r"\(last 5\)")
    assert page.locator("#simulated").is_visible() and "SIMULATED" in page.locator("#simulated").inner_text()
    assert other.locator("#now").is_enabled() and other.locator("#ramp_down").is_disabled()
    page.keyboard.press("p")
    page.keyboard.press("n")
    long = "a dusty ball <b>" + " \u00fcber" * 60
    page.keyboard.insert_text(long)
    page.keyboard.press("Enter")
    wait_for(other, "#log", "note: a dusty ball <b>")
    wait_for(page, "#state-word", "paused")
    left = page.locator("#state-left").inner_text()
    step = int(page.locator("#state-step").inner_text().split()[1])
    wait_for(other, "#cycle", f"step {step}: 1-cycle")
    page.wait_for_function("() => window.deskCounts.flights > 10", timeout=1e3 * PATIENCE_S)
    assert page.locator("#state-word").inner_text() == "PAUSED" and page.locator("#state-left").inner_text() == left
    assert too_pale(page) == []
    log = page.locator("#log-panel").bounding_box()
    assert log["height"] > 80 and log["y"] + log["height"] <= 800
    page.keyboard.press("p")
    wait_for(page, "#state-step", rf"step {step + 1} \(last 5\)")
    other.click("#ask")
    wait_for(page, "#lease-word", "asks for the controls")
    page.click("#hand_over")
    wait_for(other, "#lease-word", "you hold")
    page.keyboard.press("Space")  # without the controls
    wait_for(page, "#state-word", "stopped")
    wait_for(page, "#verdict-title", "at the end of the run")
    assert page.locator("#margins").inner_text().count("\u2013") == 4  # nothing is known of a plate that stands
    assert page.faults == other.faults == []
    recorded = tmp_path / "first.h5"
    assert verify(recorded).state == "stopped"
    with open_recording(recorded) as recording:
        assert recording.attrs["why"].startswith("page: stopped now") and recording.attrs["note"] == "before"
        first, second = recording.steps[step : step + 2]
        assert second["first_sample"] > first["first_sample"] + first["n_samples"]  # the pause
        found = flights_of(recording)
    shown = np.array(page.evaluate("window.deskTable()")[1:])
    durations_ms = (1e3 * found.duration_s[found.step >= 0]).astype(np.float32)
    assert np.array_equal(shown[:, 2].astype(np.float32), durations_ms)
    before = page.locator("#log li").all_inner_texts()
    page.wait_for_timeout(1100)
    page.reload()
    wait_for(page, "#log", "recording first.h5")
    assert [line for line in before if "run started" not in line] == page.locator("#log li").all_inner_texts()
    page.click("#state-run")
    page.wait_for_url("**/runs/*")
    wait_for(page, "h1", "first.h5")
    for one in (page, other):
        one.context.close()


def test_own_steps_are_next_on_the_same_page(chromium: Any, bench: Any, profile: Path, tmp_path: Path) -> None:
    """Blocks of `bench explore` on one page: held, refused beyond the limits, replaced by own steps, and stopped."""
    out = tmp_path / "found"
    process, url = bench("explore", profile, "--out", out, "--live", "--hold", "20")
    page = opened(chromium, f"{url}/live")
    wait_for(page, "#lease-word", "you hold")
    wait_for(page, "#state-step", r"\(last 3\)")
    page.keyboard.press("p")
    wait_for(page, "#state-word", "paused")
    for text, told in (("0.8 99", "limits forbid"), ("0.6 0.9: a closer look", "next: 0.6 0.9")):
        page.fill("#next", text)
        page.press("#next", "Enter")
        wait_for(page, "#log", told)
    wait_for(page, "#log", "chosen by a person, a closer look")
    wait_for(page, "#state-step", r"\(last 1\)")
    page.click("#ramp_down")
    process.communicate(timeout=PATIENCE_S)
    assert page.faults == [] and process.returncode == 1
    page.context.close()
    with open_recording(out / "block-02.h5") as second:
        assert second.steps["gamma"][0] == 0.6
        assert second.attrs["extra"]["chosen_because"].endswith("chosen by a person, a closer look")
        assert second.attrs["why"].startswith("page: ramped down")


@pytest.mark.skipif(sys.platform == "win32", reason="finds the page's process by POSIX means")
def test_death_of_page_and_browser_leaves_the_run_alone(bench: Any, profile: Path, tmp_path: Path) -> None:
    """The browser killed, then the page's process: the run completes with every sample."""
    if CHROMIUM is None:
        pytest.skip("no chromium on this machine (Debian: apt-get install chromium)")
    out = tmp_path / "run.h5"
    process, url = bench("ramp", profile, "--out", out, "--live")
    call = [CHROMIUM, "--headless", "--no-sandbox", f"--user-data-dir={tmp_path / 'browser'}", f"{url}/live"]
    browser = subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    time.sleep(2.0)
    os.killpg(browser.pid, signal.SIGKILL)
    browser.wait()
    port = int(url.rpartition(":")[2])
    os.kill(_listener(process.pid, port), signal.SIGKILL)
    process.communicate(timeout=PATIENCE_S)
    report = verify(out)
    assert process.returncode == 0 and report.state == "complete" and report.lost_samples == 0


def _listener(parent: int, port: int) -> int:
    """The child of ``parent`` that is the page: the one that holds the listening socket."""
    inode = next(
        row.split()[9]
        for row in Path("/proc/net/tcp").read_text(encoding="ascii").splitlines()[1:]
        if int(row.split()[1].rpartition(":")[2], 16) == port and row.split()[3] == "0A"
    )
    children = Path(f"/proc/{parent}/task/{parent}/children").read_text(encoding="ascii").split()
    for child in map(int, children):
        links = [str(link.readlink()) for link in Path(f"/proc/{child}/fd").iterdir() if link.is_symlink()]
        if f"socket:[{inode}]" in links:
            return child
    raise AssertionError(f"no child of {parent} listens on {port}")


class _Hostile(BaseHTTPRequestHandler):
    """A page of another site that tries to drive the plate."""

    def do_GET(self) -> None:
        """The page; its target is in the query."""
        target = self.path.partition("?")[2]
        self.send_response(200)
        self.send_header("content-type", "text/html")
        self.end_headers()
        self.wfile.write(
            f"""<title>trying</title><script>
            const name = "0123456789abcdef";
            const socket = new WebSocket("ws://{target}/live/socket?browser=" + name);
            socket.onopen = () => {{ socket.send(JSON.stringify({{do: "now"}})); document.title = "open"; }};
            const closed = new Promise((done) => {{ socket.onclose = done; }});
            const tries = [
              fetch("http://{target}/live").then((r) => r.text()).then(() => "read", () => "refused"),
            ];
            Promise.all([closed, ...tries]).then(([_, read]) => {{
              if (document.title !== "open") document.title = "socket refused, page " + read;
            }});
            </script>""".encode()
        )

    def log_message(self, *arguments: object) -> None:
        """Say nothing."""


def test_page_without_a_run_is_legible_and_gives_other_sites_nothing(
    chromium: Any, bench: Any, profile: Path, tmp_path: Path
) -> None:
    """Other origins and names read nothing and open no websocket; screens of each size hold all, plots are saved."""
    process, url = bench("live", profile, "--runs", tmp_path)
    host = url.removeprefix("http://")
    with ThreadingHTTPServer(("127.0.0.1", 0), _Hostile) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        page = chromium.new_page()
        page.goto(f"http://127.0.0.1:{server.server_port}/?{host}")
        _until_title(page, "socket refused, page refused")
        page.close()
        server.shutdown()
    port = host.rpartition(":")[2]
    rebound = chromium.new_page()
    answer = rebound.goto(f"http://rebound.localhost:{port}/live")  # Chromium resolves every .localhost to this machine
    assert answer is not None and answer.status == 421
    rebound.close()
    page = opened(chromium, f"{url}/live")
    wait_for(page, "#connection", "^connected$")
    for width, height in ((390, 844), (1280, 800), (3840, 2160)):
        page.set_viewport_size({"width": width, "height": height})
        page.wait_for_timeout(200)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate(SMALLEST) >= 11
        assert too_pale(page) == []
    assert page.locator(".savers").count() == 5
    with page.expect_download() as picture:
        page.click("#residual-box .savers button:has-text('picture')")
    assert picture.value.suggested_filename == "landing-residuals.png"
    assert Path(picture.value.path()).read_bytes().startswith(b"\x89PNG")
    with page.expect_download() as data:
        page.click("#diagram-box .savers button:has-text('data')")
    assert Path(data.value.path()).read_text(encoding="utf-8").startswith("step,gamma as shown,flight time (ms),")
    process.terminate()
    wait_for(page, "#connection", "server gone")
    assert too_pale(page) == []
    page.context.close()


def _until_title(page: Any, title: str) -> None:
    until = time.monotonic() + PATIENCE_S
    while page.title() != title and time.monotonic() < until:
        page.wait_for_timeout(100)
    assert page.title() == title
