"""Kill every command that writes, half-way: nothing half-written, no input touched, and the next try succeeds.

    python -m benchmarks.daq.kill_commands [--kills 20] [--seed 1] [--only NAME]

Each trial forks a process that has everything imported, lets it run one command, and kills it with SIGKILL: at a random
moment of its usual time, or (every second trial) at a random one of the calls by which it opens, renames, removes or
changes the mode of a file. Then every output must be what it was before (or absent), or whole; every input must be what
it was; and the command must succeed when it is given again. Run on a POSIX system.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import json
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.daq.flips import make
from daq.setup.errors import InputError

EVENTS = ("open", "os.rename", "os.remove", "os.chmod", "os.truncate", "shutil.copymode")
PROFILE = Path(__file__).parents[2] / "rig_profiles" / "simulated.toml"


def bench(*arguments: str) -> Callable[[], None]:
    """A command of the command line."""

    def run() -> None:
        from bench.cli import app

        app(list(arguments))

    return run


def write_profile() -> None:
    """What `bench calibrate --into` does last."""
    from bench.profiles.edit import write_into
    from daq.setup.values import MeasuredValue

    measured = [MeasuredValue("channels.accelerometer.offset_v", 1.25, 0.01, "killed")]
    write_into(Path("p.toml"), measured, datetime.date(2026, 1, 1))


def close() -> None:
    """Record and close."""
    make(Path("made.h5"), "closed")


JOBS: dict[str, tuple[Callable[[], None], tuple[str, ...]]] = {
    "closing a recording": (close, ("made.h5",)),
    "ramp": (bench("ramp", "p.toml", "--out", "made.h5"), ("made.h5",)),
    "import": (bench("import", "raw.csv", "--profile", "p.toml", "--out", "made.h5"), ("made.h5",)),
    "export csv": (bench("export", "r.h5", "--out", "made.csv"), ("made.csv",)),
    "export npz": (bench("export", "r.h5", "--out", "made.npz"), ("made.npz",)),
    "export h5": (bench("export", "r.h5", "--to", "h5", "--out", "made.h5"), ("made.h5",)),
    "recover, cut off": (
        bench("recover", "cut.h5", "--out", "made.h5", "--json", "made.json"),
        ("made.h5", "made.json"),
    ),
    "recover, damaged": (bench("recover", "bad.h5", "--out", "made.h5"), ("made.h5",)),
    "calibrate --into": (write_profile, ("p.toml",)),
    "verify": (bench("verify", "r.h5", "--json", "made.json"), ("made.json",)),
    "plan": (bench("plan", "p.toml", "--json", "made.json"), ("made.json",)),
    "reprocess": (
        bench("reprocess", "ramp.h5", "--flights", "made.csv", "--json", "made.json", "--figures", "made"),
        ("made.csv", "made.json"),
    ),
    "compare": (bench("compare", "ramp.h5", "--json", "made.json"), ("made.json",)),
    "predict": (bench("predict", "--c", "2", "--gamma", "0.5", "--json", "made.json"), ("made.json",)),
}
DONE = {"recover, damaged": 1}  # exit status of a job that is done, where it is not 0
SLOW = {"ramp", "reprocess", "compare"}


def prepare(folder: Path) -> None:
    """The inputs of all commands."""
    text = PROFILE.read_text(encoding="utf-8")
    (folder / "p.toml").write_text(text, encoding="utf-8")
    make(folder / "r.h5", "closed")
    make(folder / "cut.h5", "cut-off")
    shutil.copy(folder / "r.h5", folder / "bad.h5")
    with (folder / "bad.h5").open("r+b") as raw:
        raw.seek(250_000)
        raw.write(bytes(300))
    t = np.arange(20_000) / 20_000.0
    drive = np.sin(2 * np.pi * 25.37 * t) * np.minimum(t / 0.2, 1.0)
    rows = np.column_stack([t, 5.0 * (drive > 0.5), 0.1 * drive, drive])
    header = "time_s,continuity_v,accelerometer_v,drive_v"
    np.savetxt(folder / "raw.csv", rows, "%.6f", ",", header=header, comments="")
    run_in(folder, bench("ramp", "p.toml", "--out", "ramp.h5"))


def run_in(folder: Path, job: Callable[[], None], kill_at: tuple[str, float] | None = None) -> tuple[int, float, int]:
    """Run a job in a forked process: exit status (negative: killed), seconds, events that it met."""
    context = multiprocessing.get_context("fork")
    counter = context.Value("q", 0)
    process = context.Process(target=_child, args=(folder, job, kill_at, counter))
    began = time.perf_counter()
    process.start()
    if kill_at is not None and kill_at[0] == "moment":
        process.join(kill_at[1])
        if process.is_alive():
            os.kill(process.pid or 0, signal.SIGKILL)
    process.join()
    return process.exitcode or 0, time.perf_counter() - began, counter.value


def _child(folder: Path, job: Callable[[], None], kill_at: tuple[str, float] | None, counter: Any) -> None:
    """Body of the process."""
    os.chdir(folder)
    silent = os.open("said.txt", os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
    os.dup2(silent, 1)
    os.dup2(silent, 2)

    def met(event: str, arguments: tuple[Any, ...]) -> None:
        if event in EVENTS and not (event == "open" and _only_read(arguments)):
            counter.value += 1
            if kill_at is not None and kill_at[0] == "event" and counter.value >= kill_at[1]:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(met)
    job()


def _only_read(arguments: tuple[Any, ...]) -> bool:
    """Whether a file is opened for reading."""
    return not (arguments[2] or 0) & (os.O_WRONLY | os.O_RDWR)


def is_whole(path: Path) -> bool:
    """Whether an output can be used."""
    from daq.recording import verify
    from daq.recording.recover import recover
    from rig.profile import load_profile

    if path.suffix == ".json":
        json.loads(path.read_text(encoding="utf-8"))
    elif path.suffix == ".toml":
        load_profile(path)
    elif path.suffix == ".npz":
        with np.load(path) as arrays:
            return all(arrays[name].size >= 0 for name in arrays)
    elif path.suffix == ".csv":
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        return all(line.endswith("\n") and line.count(",") == lines[0].count(",") for line in lines)
    elif path.suffix == ".h5":
        until = time.monotonic() + 20.0
        while verify(path).state == "incomplete" and time.monotonic() < until and path.with_name("cut.h5") != path:
            try:
                saved = recover(path, path.with_name("saved.h5")).path
            except InputError as error:
                return "no block had been recorded" in str(error)
            whole = verify(saved).state in ("complete", "stopped")
            saved.unlink()
            return whole
        return verify(path).state in ("complete", "stopped")
    return True


def contents(folder: Path) -> dict[str, bytes]:
    """Every input."""
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file() and p.name != "said.txt"}


def trial(source: Path, name: str, kill_at: tuple[str, float], *, again: bool) -> Counter[str]:
    """One kill of one command."""
    job, outputs = JOBS[name]
    said: Counter[str] = Counter(kills=1)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as place:
        folder = Path(place) / "work"
        shutil.copytree(source, folder)
        before = contents(folder)
        status, _, _ = run_in(folder, job, kill_at)
        said["ended before the kill"] += status >= 0
        if name == "ramp":
            _settle(folder / "made.h5")
        for output in outputs:
            path = folder / output
            if not path.exists():
                said["output absent"] += 1
            elif before.get(output) == path.read_bytes():
                said["output as before"] += 1
            else:
                try:
                    said["output whole" if is_whole(path) else "HALF-WRITTEN"] += 1
                except (ValueError, OSError):
                    said["HALF-WRITTEN"] += 1
        after = contents(folder)
        said["INPUT CHANGED"] += any(after.get(k) != v for k, v in before.items() if k not in outputs)
        said["part left"] += any(p.suffix == ".part" for p in folder.rglob("*"))
        if again:
            for output in outputs:
                if output not in before:
                    (folder / output).unlink(missing_ok=True)
            shutil.rmtree(folder / "made", ignore_errors=True)
            said["given again"] += 1
            if run_in(folder, job)[0] != DONE.get(name, 0):
                said["FAILED AGAIN"] += 1
                print(name, kill_at, (folder / "said.txt").read_text(encoding="utf-8")[-500:])
    return said


def _settle(path: Path) -> None:
    """Wait until the recorder, which outlives the run, has done what it does."""
    last, until = -1.0, time.monotonic() + 20.0
    while time.monotonic() < until:
        with contextlib.suppress(FileNotFoundError):
            now = path.stat().st_mtime
            if now == last and not path.with_name(path.name + ".part").exists():
                return
            last = now
        time.sleep(1.0)


def main() -> None:
    """Run the trials and print a table by command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", default=list(JOBS))
    given = parser.parse_args()
    import bench.jobs.calibrate
    import bench.profiles.edit  # noqa: F401 (imported before the fork)

    rng, table = np.random.default_rng(given.seed), dict[str, Counter[str]]()
    with tempfile.TemporaryDirectory() as place:
        source = Path(place) / "inputs"
        source.mkdir()
        prepare(source)
        for name in given.only:
            timing = Path(place) / "timing"
            shutil.copytree(source, timing)
            status, seconds, events = run_in(timing, JOBS[name][0])
            if status != DONE.get(name, 0):
                raise SystemExit(f"{name}: {status}: {(timing / 'said.txt').read_text(encoding='utf-8')[-800:]}")
            shutil.rmtree(timing)
            table[name] = Counter()
            for i in range(given.kills if name not in SLOW else max(given.kills // 3, 1)):
                at = ("event", float(rng.integers(1, events + 1))) if i % 2 else ("moment", rng.uniform(0, seconds))
                table[name].update(trial(source, name, at, again=i % 4 < 2 and name not in SLOW))
            row = ", ".join(f"{key} {n}" for key, n in sorted(table[name].items()) if n)
            print(f"{name:20s} {seconds:5.1f} s, {events:3d} events: {row}", flush=True)
    every = sum(table.values(), Counter())
    print("all:", ", ".join(f"{key} {n}" for key, n in sorted(every.items()) if n))


if __name__ == "__main__":
    main()
