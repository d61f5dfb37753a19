"""Recordings of which a hundredth is zeroed: how many of their samples come back?

    python -m benchmarks.daq.resync [--kind cut-off|closed] [--files 1000] [--part 0.01] [--seed 1]

Each file is a sound recording (82,000 samples, three channels, a gap, five steps; ``cut-off``: as a kill leaves it)
of which a part of the bytes is zeroed: in one run anywhere, or in pages of 4096 or sectors of 512 bytes anywhere, a
third of the files each. `verify` and `recover` are asked. ``whole``: `verify` calls it complete or stopped, or
`recover` declares no loss, although samples are missing. ``wrong``: a sample that comes back differs or is in another
place, or one that does not is not declared.
"""

from __future__ import annotations

import argparse
import logging
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.daq.flips import compare, content, make
from benchmarks.forked import in_copy
from benchmarks.read_here import read_here
from daq.recording import open_recording, verify
from daq.recording.recover import recover
from daq.setup.errors import InputError

PATTERNS = {"a run": 0, "pages": 4096, "sectors": 512}  # bytes that are zeroed together; 0: all at once


def zeroed(sound: bytes, part: float, together: int, rng: np.random.Generator) -> bytes:
    """The bytes with ``part`` of them zeroed, in pieces of ``together`` bytes (0: in one run)."""
    data = np.frombuffer(sound, np.uint8).copy()
    n_bytes = round(part * len(data))
    if together == 0:
        at = int(rng.integers(0, len(data) - n_bytes + 1))
        data[at : at + n_bytes] = 0
        return data.tobytes()
    n_pieces = max(1, round(n_bytes / together))
    for k in rng.choice(-(-len(data) // together), n_pieces, replace=False):
        data[k * together : (k + 1) * together] = 0
    return data.tobytes()


def trial_here(path: Path, truth: dict) -> tuple[float, str]:
    """`trial`, with the damaged file read by this process."""
    with read_here():
        return trial(path, truth)


def trial(path: Path, truth: dict) -> tuple[float, str]:
    """Part of the samples that `recover` gives back of a damaged file, and what is wrong with its answer."""
    n_truth = len(truth["times"])
    state = verify(path).state
    out = path.with_name("out.h5")
    out.unlink(missing_ok=True)
    try:
        found = recover(path, out)
    except InputError as error:
        if "nothing to recover" not in str(error):
            return 0.0, f"refused ({error})"
        with open_recording(path) as recording:  # what was zeroed was zero
            return 1.0, "" if compare(recording, truth) == "all" else "wrong: sound, they say"
    with open_recording(out) as recording:
        right, n = compare(recording, truth), recording.n_samples
    if right == "wrong":
        return n / n_truth, "wrong"
    said_whole = state in ("complete", "stopped") or not found.damage
    return n / n_truth, "whole" if n < n_truth and said_whole else ""


def score(kind: str, n_files: int, part: float, seed: int) -> dict[str, list[tuple[float, str]]]:
    """`trial` of each file, by pattern."""
    rng = np.random.default_rng(seed)
    results: dict[str, list[tuple[float, str]]] = {name: [] for name in PATTERNS}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.h5"
        make(path, kind)
        sound = path.read_bytes()
        with open_recording(path) as recording:
            truth = content(recording)
        for i in range(n_files):
            name = list(PATTERNS)[i % len(PATTERNS)]
            path.write_bytes(zeroed(sound, part, PATTERNS[name], rng))
            # in a copy of this process, unless HDF5 crashes of the file
            back, fault = in_copy(lambda: trial_here(path, truth), 3.0) or trial(path, truth)
            results[name].append((back, fault))
            if results[name][-1][1]:
                print(f"file {i} ({name}): {results[name][-1]}", flush=True)
    return results


def main() -> None:
    """Score the files and print a row for each pattern."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", choices=("cut-off", "closed"), default="cut-off")
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("--part", type=float, default=0.01)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    logging.disable()
    began = time.process_time()
    results = score(given.kind, given.files, given.part, given.seed)
    spent = time.process_time() - began
    print(f"{given.kind}, {given.files} files, {given.part:.1%} zeroed, {spent:.0f} s of processor")
    for name in (*results, "all"):
        rows = results.get(name, [row for each in results.values() for row in each])
        if not rows:
            continue
        back = np.array([part for part, _ in rows])
        faults = [fault for _, fault in rows]
        print(
            f"{name:8s} {len(rows):5d} files, samples back: {back.mean():.2%}, worst {back.min():.2%}, "
            f"files below 98 %: {np.sum(back < 0.98)}, refused {sum('refused' in f for f in faults)}, "
            f"wrong {sum('wrong' in f for f in faults)}, called whole {sum(f == 'whole' for f in faults)}"
        )


if __name__ == "__main__":
    main()
