"""The live page measured in a real Chromium: ``python -m benchmarks.bench.live [--seconds 60]``.

A paced ramp of the simulated rig (4 traces at 20 kHz) is watched by a page that also shows 1e5 earlier flights. Prints
JSON: time to the first picture, updates and pictures a second, processor time of the run's process with and without the
page, memory of server and tab over the time.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import shutil
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from bench.jobs.run_ramp import make_backend, record
from bench.live.board import Board
from bench.live.processes import AskedRun, run_profile
from bench.live.scope_data import flights_piece
from bench.profiles.find import load, shipped_folder

STEPS, FLIGHTS = 100, 1000  # shown from the start: 1e5 flights


def _served(pipe: Any, profile: Any, board: str, folder: str) -> None:
    """The page's process, with earlier flights."""
    from bench.live.processes import _serve_run, sections
    from bench.live.watched_run import WatchedRun

    rng, own = np.random.default_rng(0), WatchedRun.history
    pieces: list[str | bytes] = []
    for k in range(STEPS):
        tau = 0.03 + 0.002 * rng.standard_normal(FLIGHTS)
        noise = 4e-6 * np.ones(FLIGHTS)
        columns = (tau, np.cumsum(tau), noise * rng.standard_normal(FLIGHTS), noise, np.zeros(FLIGHTS))
        message = {"columns": columns, "gamma": 0.5 + 0.02 * k, "asked": 1.0, "final": True, "step": 1000 + k}
        pieces.append(flights_piece(message, 2.0))
    WatchedRun.history = lambda self: [*own(self), *pieces]  # type: ignore[method-assign]
    _serve_run(pipe, sections(), profile, board, folder, "127.0.0.1", 0)


def _alone(profile: str, out: str) -> None:
    """The same run without anybody looking on."""
    checked, text = load(profile)
    record(checked, text, make_backend(checked, real_time=True), Path(out), quiet=True, paced=True)


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _rss_mb(pid: int) -> float:
    text = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    return int(text.partition("VmRSS:")[2].split()[0]) / 1024.0


def measure(seconds: float) -> dict[str, Any]:
    """Run both, and look."""
    from playwright.sync_api import sync_playwright

    context, out = multiprocessing.get_context("spawn"), {}
    with TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        hold = round(25.37 * (seconds + 30.0) / 6)
        text = (shipped_folder() / "simulated.toml").read_text(encoding="utf-8")
        text = text.replace("{ start = 0.4, stop = 2.6, steps = 23 }", "[0.8, 1.0, 1.2, 1.4, 1.6, 1.8]")
        (folder / "long.toml").write_text(text.replace("hold_cycles = 20", f"hold_cycles = {hold}"), encoding="utf-8")
        profile, _ = load(folder / "long.toml")
        board = Board()
        ours, theirs = context.Pipe(duplex=False)
        page_process = context.Process(target=_served, args=(theirs, profile, board.name, name))
        page_process.start()
        url = ours.recv()[0]
        runs = {
            "watched": context.Process(
                target=run_profile, args=(str(folder / "long.toml"), board.name, None, AskedRun(folder / "a.h5"))
            ),
            "alone": context.Process(target=_alone, args=(str(folder / "long.toml"), f"{name}/b.h5")),
        }
        chromium = shutil.which("chromium")
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        for one in runs.values():
            one.start()
        time.sleep(15.0)  # both are under way
        began = time.monotonic()
        page.goto(f"{url}live")
        while not page.evaluate("window.deskCounts.draws > 5 && window.deskCounts.flights > 99999"):
            page.wait_for_timeout(20)
        out["first_picture_s"] = round(time.monotonic() - began, 2)
        page.wait_for_timeout(3000)
        counts = "({...window.deskCounts, heap: performance.memory.usedJSHeapSize, now: performance.now()})"
        first, cpu = page.evaluate(counts), {key: _cpu_s(int(run.pid or 0)) for key, run in runs.items()}
        memory = []
        began = time.monotonic()
        while time.monotonic() - began < seconds:
            page.wait_for_timeout(1e3 * seconds / 6)
            heap = page.evaluate("performance.memory.usedJSHeapSize") / 2**20
            memory.append([round(time.monotonic() - began), round(_rss_mb(page_process.pid or 0), 1), round(heap, 1)])
        last, took = page.evaluate(counts), time.monotonic() - began
        out["flights"] = last["flights"]
        out["updates_per_s"] = round(1e3 * (last["updates"] - first["updates"]) / (last["now"] - first["now"]), 1)
        out["pictures_per_s"] = round(1e3 * (last["draws"] - first["draws"]) / (last["now"] - first["now"]), 1)
        share = {key: 100.0 * (_cpu_s(int(run.pid or 0)) - cpu[key]) / took for key, run in runs.items()}
        out["run_share_of_a_core_percent"] = {key: round(value, 2) for key, value in share.items()}
        out["memory_s_server_mb_tab_mb"] = memory
        out["load_average"] = round(os.getloadavg()[0], 1)
        browser.close()
        for one in (*runs.values(), page_process):
            one.terminate()
            one.join()
        board.close()
    return out


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    print(json.dumps(measure(parser.parse_args().seconds), indent=1))
