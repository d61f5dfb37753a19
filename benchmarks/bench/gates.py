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
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bench.profiles.edit import fields_of

GONE = re.compile(r"WebSocket connection to .* failed|net::ERR_(CONNECTION|EMPTY_RESPONSE|SOCKET)")
PATIENCE_MS = 600_000
ENTRIES = {  # of the virtual card, on a machine that is busy with other things
    "sampling.rate_hz": "20000", "backend.output_range_v": "10.0",
    **{f"channels.{name}.range_v": "10.0" for name in ("continuity", "accelerometer", "drive")},
    **{f"channels.{name}.coupling": '"dc"' for name in ("continuity", "accelerometer", "drive")},
    "channels.continuity.open_v": "5.0",
}  # fmt: skip
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


class Way:
    """One way through the gates: what is clicked, when a gate was green, and pictures of what is seen."""

    def __init__(self, page: Any, pictures: Path | None) -> None:
        self.page, self.clicks = page, 0
        self.times: dict[str, float] = {}
        self._pictures, self._began = pictures, time.monotonic()

    def click(self, *selectors: str) -> None:
        """Click one after another."""
        for selector in selectors:
            self.page.locator(selector).click(timeout=PATIENCE_MS)
            self.clicks += 1

    def enter(self, profile: Path, key: str, text: str) -> None:
        """Write a value into the profile; counts as two clicks."""
        if not self.page.locator("#fields").is_visible():
            self.click("#profile-box summary")
        field = self.page.locator(f"[data-key='{key}']:enabled")
        if field.evaluate("one => one.tagName") == "SELECT":
            field.select_option(text)
        else:
            field.fill(text)
            field.press("Tab")
        self.page.wait_for_timeout(1500)  # the keys are drawn anew
        if (key, text) not in ((one["key"], one["text"]) for one in fields_of(profile.read_text("utf-8"))):
            raise RuntimeError(f"{key} = {text}: {self.page.locator('#refused').inner_text()}")
        self.clicks += 2

    def picture(self, name: str) -> None:
        """The page as it is, 390 and 1280 wide."""
        if self._pictures is not None:
            for width, height in ((390, 844), (1280, 800)):
                self.page.set_viewport_size({"width": width, "height": height})
                self.page.wait_for_timeout(300)
                self.page.screenshot(path=str(self._pictures / f"{name}-{width}.png"), full_page=width == 390)

    def at(self, name: str) -> None:
        """Note the time since the way began."""
        self.times[name] = round(time.monotonic() - self._began, 1)

    def green(self, gate: str) -> None:
        """Wait until a gate is passed; raises RuntimeError, with what it found, where it is not."""
        self.page.wait_for_timeout(400)
        self.page.locator("#status").wait_for(state="hidden", timeout=PATIENCE_MS)
        try:
            self.page.locator(f"#step-{gate}.green").wait_for(timeout=10_000)
        except Exception as error:
            raise RuntimeError(f"{gate}: {self.page.locator('#work').inner_text()}") from error
        self.at(gate)

    def to_the_ramp(self, calibrations: tuple[str, ...]) -> None:
        """Card, wiring, scales and check."""
        self.picture("card")
        self.click("#do-card")
        self.green("card")
        self.picture("wiring")
        self.click("#do-wiring")
        self.green("wiring")
        for kind in calibrations:
            self.click(f"#do-{kind}")
            self.page.wait_for_timeout(400)
            self.page.locator("#status").wait_for(state="hidden", timeout=PATIENCE_MS)
        self.picture("calibrate")
        if self.page.locator("#anyway").count():
            self.click("#anyway")
        self.click("#accept")
        self.green("calibrate")
        self.picture("check")
        self.click("#do-check")
        self.green("check")
        self.picture("ramp")

    def to_the_verdict(self, name: str) -> None:
        """Drive, and name the cause."""
        self.click("#hands", "#go")
        self.page.locator("#part").wait_for(timeout=PATIENCE_MS)
        self.picture(f"running-{name}")
        self.green("ramp")
        self.click("#do-verdict")
        self.green("verdict")
        self.picture(f"verdict-{name}")
        self.at(name)


@contextmanager
def virtual_card(profile: Path, name: str) -> Iterator[None]:
    """The card that the profile names, behind a JACK server of its own, with a rig that hides friction."""
    call = [sys.executable, "-m", "bench", "virtual", str(profile), "--scenario", "friction", "--server", name]
    with subprocess.Popen(call, stdout=subprocess.PIPE, text=True) as process:
        print((process.stdout or sys.stdin).readline().strip(), file=sys.stderr)
        try:
            yield
        finally:
            process.terminate()


def through(folder: Path, like: str, pictures: Path | None) -> dict[str, Any]:
    """From an empty folder to the cause, and the improved profile driven."""
    errors: list[str] = []
    os.environ["JACK_DEFAULT_SERVER"] = f"gates-{os.getpid()}"
    server, before = Server(folder), resource.getrusage(resource.RUSAGE_CHILDREN)
    with browser(errors) as page, ExitStack() as card:
        page.goto(server.url)
        page.locator("#choose").wait_for()
        way = Way(page, pictures)
        way.picture("empty")
        if like == "simulated":
            way.click("#simulate")
        else:
            page.select_option("#rig", f"new:{like}")
            way.click("#choose")
            for key, text in ENTRIES.items():
                way.enter(folder / f"my-{like}.toml", key, text)
            card.enter_context(virtual_card(folder / f"my-{like}.toml", os.environ["JACK_DEFAULT_SERVER"]))
        way.to_the_ramp(("accelerometer", "drive", "contact") if like == "simulated" else ("drive", "contact"))
        way.to_the_verdict("named")
        named = way.clicks
        way.click("#again")
        way.to_the_verdict("again")
        rounds = json.loads((folder / "desk.json").read_text(encoding="utf-8"))["rounds"]
    server.process.terminate()
    server.process.wait()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    found = [{key: one[key] for key in ("verdict", "effects", "before", "after", "floor_us")} for one in rounds]
    return {
        "clicks_to_the_cause": named, "clicks": way.clicks, "seconds": way.times, "cpu_s": round(cpu_s, 1),
        "errors": errors, "rounds": found, "load": os.getloadavg()[0],
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
    said = Counter(re.sub(r"\d+", "#", one) for one in errors)
    # what a browser says of a server that was killed is no error of the page
    own = {one: count for one, count in said.items() if not GONE.search(one)}
    return {"walks": n, "seed": seed, "actions": done, "dead_ends": dead, "errors": own,
            "said_while_the_server_was_gone": {one: count for one, count in said.items() if one not in own},
            "recorded": len(recorded), "not_shown": sorted(recorded - shown), "load": os.getloadavg()[0]}  # fmt: skip


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
