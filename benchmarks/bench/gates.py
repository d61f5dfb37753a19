"""The six gates in a real Chromium, from an empty folder.

    python -m benchmarks.bench.gates through [--like soundcard] [--pictures FOLDER]
    python -m benchmarks.bench.gates walks [--walks 100] [--seed 1]

``through``: the simulated rig (or a virtual card behind JACK) to the named cause and once more with the improved
profile, without a terminal: clicks, wall, processor time, and a picture of each gate. ``walks``: random clicks,
entries, reloads, and deaths of the server; counts dead ends, errors in the console, and runs that were not shown.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

PATIENCE_MS = 600_000
QUICK = "{ start = 0.6, stop = 1.2, steps = 3 }"


class Server:
    """`bench live` in a folder; it can be killed and started again at the same port."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.port, self.url = folder, 0, ""
        self.start()

    def start(self) -> None:
        """Start it and wait for its address."""
        call = [sys.executable, "-m", "bench", "live", "--runs", str(self.folder), "--port", str(self.port)]
        self.process = subprocess.Popen(call, stdout=subprocess.PIPE, text=True)
        for line in self.process.stdout or ():
            if found := re.search(r"http://127\.0\.0\.1:(\d+)/", line):
                self.port, self.url = int(found.group(1)), found.group()
                return
        raise RuntimeError("the server did not start")

    def kill(self) -> None:
        """As a crash would."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def cpu_s(self) -> float:
        """Processor time of its process so far."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def browser(errors: list[str]) -> Iterator[Any]:
    """A page in a new Chromium, whose errors are collected."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        one = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = one.new_page(viewport={"width": 1280, "height": 800})
        page.on("pageerror", lambda error: errors.append(f"page: {error}"))
        page.on("console", lambda said: errors.append(f"console: {said.text}") if said.type == "error" else None)
        yield page
        one.close()


def through(folder: Path, like: str, pictures: Path | None) -> dict[str, Any]:
    """From an empty folder to the cause, and the improved profile driven."""
    errors: list[str] = []
    server, clicks, times = Server(folder), 0, {}
    began, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    with browser(errors) as page:

        def click(selector: str) -> None:
            nonlocal clicks
            page.locator(selector).click(timeout=PATIENCE_MS)
            clicks += 1

        def picture(name: str) -> None:
            if pictures is not None:
                for width, height in ((390, 844), (1280, 800)):
                    page.set_viewport_size({"width": width, "height": height})
                    page.wait_for_timeout(300)
                    page.screenshot(path=str(pictures / f"{name}-{width}.png"), full_page=width == 390)

        def green(gate: str) -> None:
            page.locator(f"#step-{gate}.green").wait_for(timeout=PATIENCE_MS)
            times[gate] = round(time.monotonic() - began, 1)

        page.goto(server.url)
        page.locator("#choose").wait_for()
        picture("empty")
        if like == "simulated":
            click("#simulate")
        else:
            page.select_option("#rig", f"new:{like}")
            click("#choose")
        picture("card")
        click("#do-card")
        green("card")
        picture("wiring")
        click("#do-wiring")
        green("wiring")
        for kind in ("accelerometer", "drive", "contact") if like == "simulated" else ("drive",):
            click(f"#do-{kind}")
            page.wait_for_timeout(400)
            page.locator("#status").wait_for(state="hidden", timeout=PATIENCE_MS)
        picture("calibrate")
        if page.locator("#anyway").count():
            click("#anyway")
        click("#accept")
        green("calibrate")
        picture("check")
        click("#do-check")
        green("check")
        picture("ramp")
        for again in ("", "again"):
            if again:
                click("#again")
            click("#hands")
            click("#go")
            if not again:
                page.locator("#part").wait_for(timeout=PATIENCE_MS)
                picture("running")
            green("ramp")
            click("#do-verdict")
            green("verdict")
            picture(f"verdict{again}")
            if not again:
                times["named"] = round(time.monotonic() - began, 1)
                named = clicks
        rounds = json.loads((folder / "desk.json").read_text(encoding="utf-8"))["rounds"]
    server.process.terminate()
    server.process.wait()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    found = [{key: one[key] for key in ("verdict", "effects", "before", "after", "floor_us")} for one in rounds]
    return {
        "clicks_to_the_cause": named, "clicks": clicks, "seconds": times, "cpu_s": round(cpu_s, 1), "errors": errors,
        "rounds": found, "load": os.getloadavg()[0],
    }  # fmt: skip


def walks(folder: Path, n: int, seed: int) -> dict[str, Any]:
    """Random walks of ten actions each."""
    draw, errors, dead, shown = random.Random(seed), list[str](), list[str](), set[str]()
    server, done = Server(folder), dict[str, int]()
    with browser(errors) as page:
        page.goto(server.url)
        page.locator("#simulate").click()
        page.locator("#do-card").wait_for()
        profile = folder / "my-simulated.toml"
        text = profile.read_text(encoding="utf-8").replace("{ start = 0.4, stop = 2.6, steps = 23 }", QUICK)
        profile.write_text(text, encoding="utf-8")

        def look() -> None:
            """Note the run that the page shows; anything that can be done, or waited for, is no dead end."""
            words = page.locator("#doing").inner_text() if page.locator("#doing").count() else ""
            shown.update(re.findall(r"(?:driving|starting) (\S+\.h5)", words))
            page.locator("#controls, #desk, h1").first.wait_for(timeout=PATIENCE_MS)

        for walk in range(n):
            trail = []
            for _ in range(10):
                kind = draw.choices(("click", "type", "reload", "page", "kill"), (70, 10, 12, 6, 2))[0]
                trail.append(kind if kind != "click" else _click(page, draw))
                if kind == "type":
                    _type(page, draw)
                elif kind == "reload":
                    page.reload()
                elif kind == "page":
                    page.goto(server.url + draw.choice(("live", "runs", "drop", "gates", "")))
                    page.wait_for_timeout(300)
                    page.goto(f"{server.url}gates")
                elif kind == "kill":
                    server.kill()
                    server.start()
                done[kind] = done.get(kind, 0) + 1
                page.wait_for_timeout(150)
                look()
            page.goto(f"{server.url}gates")
            try:
                page.locator("#connection", has_text=re.compile("^connected$")).wait_for(timeout=60_000)
                page.wait_for_function(
                    "() => [...document.querySelectorAll('#controls button, #status button, #ask')]"
                    ".some((one) => !one.disabled && one.offsetParent)", timeout=60_000,
                )  # fmt: skip
            except Exception:  # noqa: BLE001 - any failure is a dead end, with the way that led there
                dead.append(f"walk {walk}: {trail}")
            look()
            print(walk, len(dead), len(errors), trail, flush=True)
        state = json.loads((folder / "desk.json").read_text(encoding="utf-8"))
    server.process.terminate()
    shown |= {Path(result["file"]).name for result in state["results"].values() if result["file"]}
    recorded = {path.name for path in folder.glob("*.h5")}
    # what a browser says of a server that was killed is no error of the page
    own = [one for one in errors if not re.search(r"WebSocket|ERR_CONNECTION|Failed to load resource", one)]
    return {"walks": n, "seed": seed, "actions": done, "dead_ends": dead, "errors": own, "recorded": len(recorded),
            "not_shown": sorted(recorded - shown), "load": os.getloadavg()[0]}  # fmt: skip


def _click(page: Any, draw: random.Random) -> str:
    """Click one of the buttons and boxes that can be clicked now; its name."""
    all_ = page.locator("main button:visible:enabled, main input[type=checkbox]:visible:enabled, summary:visible").all()
    if not all_:
        return "nothing"
    one = draw.choice(all_)
    try:
        name = one.get_attribute("id", timeout=1000) or one.inner_text(timeout=1000)
        one.click(timeout=1000)
    except Exception:  # noqa: BLE001 - drawn anew between the look and the click
        return "gone"
    return str(name)


def _type(page: Any, draw: random.Random) -> None:
    """Change a key of the profile, sensibly or not, or choose another ramp."""
    try:
        if page.locator("#preset:enabled").count() and draw.random() < 0.3:
            page.select_option("#preset", draw.choice(("c2", "")), timeout=1000)
        elif page.locator("#fields input:enabled:visible").count():
            field = draw.choice(page.locator("#fields input:enabled:visible").all())
            field.fill(draw.choice(("0.5", "-1", "[1, 2", "x", "", "9.0", "true")), timeout=1000)
            field.press("Tab", timeout=1000)
    except Exception:  # noqa: BLE001 - drawn anew meanwhile
        return


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("through", "walks"))
    parser.add_argument("--like", default="simulated")
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--walks", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    if given.pictures is not None:
        given.pictures.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as name:
        if given.what == "through":
            answer = through(Path(name), given.like, given.pictures)
        else:
            answer = walks(Path(name), given.walks, given.seed)
        print(json.dumps(answer, indent=1))
