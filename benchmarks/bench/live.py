"""The live page measured in a real Chromium: ``python -m benchmarks.bench.live [--seconds 60] [--watchers 30]``.

A paced ramp of the simulated rig (4 traces at 20 kHz) is watched by a page that also shows 1e5 earlier flights. Prints
JSON: time to the first picture, updates and pictures a second, processor time of the run's process with and without the
page, memory of server and tab over the time. With ``--watchers`` the cost of those who look on by link instead.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np

from bench.jobs.run_ramp import make_backend, record
from bench.live.board import Board
from bench.live.processes import AskedRun, run_profile
from bench.live.scope_data import flights_piece
from bench.profiles.find import load, shipped_folder
from bench.web.access import COOKIE

STEPS, FLIGHTS = 100, 1000  # shown from the start: 1e5 flights


def _served(pipe: Any, profile: Any, board: str, folder: str) -> None:
    """The page's process, with earlier flights."""
    from bench.live.processes import SECTIONS, _serve_run
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
    _serve_run(pipe, SECTIONS, profile, board, folder, "127.0.0.1", 0)


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


@contextmanager
def paced_runs(seconds: float) -> Iterator[tuple[str, dict[str, Any]]]:
    """A page's address, and the processes by name: the page, its run, and the same run without a page."""
    context = multiprocessing.get_context("spawn")
    with TemporaryDirectory() as name:
        folder = Path(name)
        hold = round(25.37 * (seconds + 60.0) / 6)
        text = (shipped_folder() / "simulated.toml").read_text(encoding="utf-8")
        text = text.replace("{ start = 0.4, stop = 2.6, steps = 23 }", "[0.8, 1.0, 1.2, 1.4, 1.6, 1.8]")
        (folder / "long.toml").write_text(text.replace("hold_cycles = 20", f"hold_cycles = {hold}"), encoding="utf-8")
        profile, _ = load(folder / "long.toml")
        board = Board()
        ours, theirs = context.Pipe(duplex=False)
        asked = AskedRun(folder / "a.h5")
        processes = {
            "page": context.Process(target=_served, args=(theirs, profile, board.name, name)),
            "watched": context.Process(target=run_profile, args=(str(folder / "long.toml"), board.name, None, asked)),
            "alone": context.Process(target=_alone, args=(str(folder / "long.toml"), f"{name}/b.h5")),
        }
        for one in processes.values():
            one.start()
        url = ours.recv()[0]
        time.sleep(15.0)  # both runs are under way
        yield url, processes
        for one in processes.values():
            one.terminate()
            one.join()
        board.close()


def measure(seconds: float) -> dict[str, Any]:
    """Run both, and look."""
    from playwright.sync_api import sync_playwright

    out: dict[str, Any] = {}
    with paced_runs(seconds) as (url, processes), sync_playwright() as playwright:
        pids = {key: int(one.pid) for key, one in processes.items()}
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        began = time.monotonic()
        page.goto(f"{url}live")
        while not page.evaluate("window.deskCounts.draws > 5 && window.deskCounts.flights > 99999"):
            page.wait_for_timeout(20)
        out["first_picture_s"] = round(time.monotonic() - began, 2)
        page.wait_for_timeout(3000)
        counts = "({...window.deskCounts, heap: performance.memory.usedJSHeapSize, now: performance.now()})"
        first, cpu = page.evaluate(counts), {key: _cpu_s(pid) for key, pid in pids.items()}
        memory = []
        began = time.monotonic()
        while time.monotonic() - began < seconds:
            page.wait_for_timeout(1e3 * seconds / 12)
            heap = page.evaluate("performance.memory.usedJSHeapSize") / 2**20
            memory.append([round(time.monotonic() - began), round(_rss_mb(pids["page"]), 1), round(heap, 1)])
        last, took = page.evaluate(counts), time.monotonic() - began
        out["flights"] = last["flights"]
        for name in ("scopes", "updates", "draws"):
            out[f"{name}_per_s"] = round(1e3 * (last[name] - first[name]) / (last["now"] - first["now"]), 2)
        out["share_of_a_core_percent"] = {key: round(100.0 * (_cpu_s(pid) - cpu[key]) / took, 2)
                                          for key, pid in pids.items()}  # fmt: skip
        out["memory_s_server_mb_tab_mb"] = memory
        out["load_average"] = round(os.getloadavg()[0], 1)
        browser.close()
    return out


async def _watch(url: str, n: int, seconds: float, pid: int) -> dict[str, Any]:
    """Processor time of the page while it has no watcher, and while it has ``n``, who read all that they are sent."""
    from websockets.asyncio.client import connect

    async def read(port: int, number: int, **more: Any) -> Any:
        address = f"ws://127.0.0.1:{port}/live/socket?browser={number:016x}"
        return await connect(address, origin=f"http://127.0.0.1:{port}", max_size=None, **more)

    async def drain(socket: Any) -> int:
        return sum([len(message) async for message in socket])

    own = await read(urlsplit(url).port or 80, 1)
    await own.send(json.dumps({"do": "share", "on": True}))
    shared: dict[str, Any] = {}
    while not (shared.get("kind") == "shared" and shared["url"]):
        message = await own.recv()
        shared = json.loads(message) if isinstance(message, str) else {}
    tasks = [asyncio.create_task(drain(own))]
    out: dict[str, Any] = {"watchers": n}
    parts = urlsplit(shared["url"])
    cookie = {"Cookie": f"{COOKIE}={parse_qs(parts.query)['token'][0]}"}
    for name, more in (("none", 0), ("all", n)):
        for number in range(more):
            tasks.append(
                asyncio.create_task(drain(await read(parts.port or 80, 2 + number, additional_headers=cookie)))
            )
            await asyncio.sleep(0.1)  # 30 requests a second are let pass
        await asyncio.sleep(3.0)
        before = _cpu_s(pid)
        await asyncio.sleep(seconds)
        out[f"page_percent_{name}"] = round(100.0 * (_cpu_s(pid) - before) / seconds, 2)
    out["left"] = sum(task.done() for task in tasks)
    return out | {"load_average": round(os.getloadavg()[0], 1)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--watchers", type=int, default=0)
    given = parser.parse_args()
    if given.watchers:
        with paced_runs(2.0 * given.seconds) as (url, processes):
            answer = asyncio.run(_watch(url, given.watchers, given.seconds, processes["page"].pid))
    else:
        answer = measure(given.seconds)
    print(json.dumps(answer, indent=1))
