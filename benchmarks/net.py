"""What the commands print, frozen before a change and compared after it.

    python -m benchmarks.net record FOLDER --seed 61000 --count 16
    python -m benchmarks.net freeze FOLDER before [--only close-loop]
    python -m benchmarks.net freeze FOLDER after
    python -m benchmarks.net compare FOLDER before after

``record`` makes recordings of both plants: every effect, and several causes behind other instruments. ``freeze`` runs
plan, predict, info, reprocess, compare, close-loop and the round trip of export and import on them, and keeps the JSON
of each; what is there is not made again. ``compare`` lists every difference: for numbers the largest relative one of
each key.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from benchmarks.analysis.chains import jobs, recorded
from benchmarks.scoring import trial
from benchmarks.scoring.truth import OTHER_NAMED

PREDICTIONS = {
    "orbit-1": ["--c", "1", "--gamma", "1.7"],
    "orbit-2": ["--c", "2", "--gamma", "1.28"],
    "orbit-3": ["--c", "3", "--gamma", "1.1"],
    "friction": ["--c", "2", "--gamma", "2.1", "--set", "coulomb_friction.mu=0.08", "--set", "restitution.e0=0.3"],
    "range-1": ["--c", "1", "--gamma-range", "0.5", "6", "--bifurcations"],
    "range-2": ["--c", "2", "--gamma-range", "0.2", "3", "--bifurcations"],
}
STRIDE = 37  # between the cells of the matrix of instruments that are taken
PROFILES = ("simulated",)
TIMES = ("seconds", "version", "path", "sha256", "recording", "sources", "paths", "written", "made", "date")
"""Parts of keys whose values differ from run to run."""


def record(folder: Path, seed: int, count: int) -> None:
    """Make a recording of each effect, at c = 1, 2 and 3 in turn, and ``count`` spread over causes and instruments."""
    folder.mkdir(parents=True, exist_ok=True)
    for i, effect in enumerate(OTHER_NAMED):
        job = trial.Job("strong", "other", (effect,), 1 + i % 3, seed + i)
        _made(folder / f"{effect}-c{job.c}.h5", lambda scratch, job=job: trial.other(job, scratch))
    every = jobs(range(seed, seed + 1))
    for i in range(count):
        cell = every[(i * STRIDE) % len(every)]
        word = "".join(x if x.isalnum() else "-" for x in f"{cell.plant}-{cell.hidden}-{cell.chain}")
        _made(folder / f"instrument-{i:02d}-{word}.h5", lambda scratch, cell=cell: recorded(cell, scratch)[0])


def _made(target: Path, make: Callable[[Path], Path]) -> None:
    if target.exists():
        return
    with tempfile.TemporaryDirectory() as scratch:
        shutil.copyfile(make(Path(scratch)), target)
    print(target.name, flush=True)


def calls(recordings: list[Path], scratch: Path) -> Iterator[tuple[str, list[str]]]:
    """Names and arguments of the commands to run; each prints JSON."""
    for name in PROFILES:
        yield f"plan-{name}", ["plan", name, "--json", "-"]
    for name, words in PREDICTIONS.items():
        yield f"predict-{name}", ["predict", *words, "--json", "-"]
    for path in recordings:
        for command in ("info", "reprocess", "compare", "close-loop"):
            yield f"{command}-{path.stem}", [command, str(path), "--json", "-"]
    for kind in ("csv", "npz", "h5", "mat", "uff", "tdms", "nc"):
        path, out = recordings[0], scratch / f"there.{kind}"
        yield f"export-{kind}", ["export", str(path), "--to", kind, "--out", str(out), "--json", "-"]


def freeze(folder: Path, name: str, only: str) -> None:
    """Keep what every command prints."""
    kept = folder / name
    kept.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as there:
        scratch = Path(there)
        copies = []
        for path in sorted(folder.glob("*.h5")):
            copies.append(scratch / path.name)  # a verdict is written next to its recording
            shutil.copyfile(path, copies[-1])
        for key, words in calls(copies, scratch):
            target = kept / f"{key}.json"
            if not key.startswith(only) or target.exists():
                continue
            done = subprocess.run(
                [sys.executable, "-m", "bench.cli", *words],
                capture_output=True, text=True, env=os.environ | {"COLUMNS": "120"}, check=False,
            )  # fmt: skip
            try:
                printed: Any = json.loads(done.stdout)
            except json.JSONDecodeError:
                printed = done.stdout.replace(there, "")
            row = {"exit": done.returncode, "printed": printed, "errors": done.stderr.replace(there, "")}
            target.write_text(json.dumps(row, indent=1), encoding="utf-8")
            print(key, done.returncode, flush=True)


def differences(a: Any, b: Any, key: str = "") -> Iterator[tuple[str, str | float]]:
    """Key and relative difference of numbers, key and both values of anything else, where two JSON values differ."""
    if isinstance(a, dict) and isinstance(b, dict):
        for k in dict.fromkeys([*a, *b]):
            if any(part in k for part in TIMES):
                continue
            if k not in a or k not in b:
                yield f"{key}.{k}", "only in the first" if k in a else "only in the second"
            else:
                yield from differences(a[k], b[k], f"{key}.{k}")
    elif isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            yield key, f"{len(a)} and {len(b)} entries"
        for x, y in zip(a, b, strict=False):
            yield from differences(x, y, f"{key}[]")
    elif isinstance(a, int | float) and isinstance(b, int | float):
        if a != b and not (a != a and b != b):
            yield key, abs(a - b) / max(abs(a), abs(b))
    elif a != b:
        yield key, f"{a!r} and {b!r}"[:300]


def compare(folder: Path, first: str, second: str) -> int:
    """Print differences, and their number of files."""
    changed = 0
    before = {p.name: p for p in sorted((folder / first).glob("*.json"))}
    after = {p.name: p for p in sorted((folder / second).glob("*.json"))}
    for name in dict.fromkeys([*before, *after]):
        if name not in before or name not in after:
            print(f"{name}: only in {first if name in before else second}")
            continue
        a, b = (json.loads(side[name].read_text(encoding="utf-8")) for side in (before, after))
        worst: dict[str, float] = {}
        words: dict[str, str] = {}
        for key, how in differences(a, b):
            if isinstance(how, float):
                worst[key] = max(worst.get(key, 0.0), how)
            else:
                words[key] = how
        if worst or words:
            changed += 1
            print(f"{name}: {len(worst)} numbers, largest {max(worst.values(), default=0.0):.1e}")
            for key, how in words.items():
                print(f"    {key}: {how}")
            for key, size in sorted(worst.items(), key=lambda pair: -pair[1])[:5]:
                print(f"    {key}: {size:.1e}")
    print(f"{changed} of {len(before)} differ")
    return changed


def main() -> None:
    """Record, freeze or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=("record", "freeze", "compare"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", help="of what is frozen, or of the two that are compared")
    parser.add_argument("--seed", type=int, default=61000)
    parser.add_argument("--count", type=int, default=16)
    parser.add_argument("--only", default="", help="beginning of the commands' names to freeze")
    options = parser.parse_args()
    if options.action == "record":
        record(options.folder, options.seed, options.count)
    elif options.action == "freeze":
        freeze(options.folder, options.names[0], options.only)
    else:
        sys.exit(1 if compare(options.folder, *options.names) else 0)


if __name__ == "__main__":
    main()
