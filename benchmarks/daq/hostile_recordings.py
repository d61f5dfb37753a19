"""Recordings that somebody spoiled on purpose: does each command answer, how soon, with how much memory?

    python -m benchmarks.daq.hostile_recordings

Each kind is made of a sound recording by rewriting a part of it. `bench verify`, `bench export` and `bench recover` are
asked, each in a process of its own; the longest time and the largest memory of the three are printed, of all processes
together that they start (POSIX). ``followed``: a file outside was read.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

Spoil = Callable[[h5py.File, Path], None]
SECRET = 31_416


def huge_table(file: h5py.File, folder: Path) -> None:
    """A step table of 10^13 rows."""
    del file["steps/gamma"]
    file["steps"].create_dataset("gamma", (10**13,), "<f8", chunks=(1 << 20,))


def huge_channel(file: h5py.File, folder: Path) -> None:
    """A channel of 10^14 samples of which none is stored."""
    del file["drive"]
    file.create_dataset("drive", (10**14,), "<i2", chunks=(1 << 20,), maxshape=(None,))


def huge_chunk(file: h5py.File, folder: Path) -> None:
    """A channel stored in one piece of 2 GB."""
    del file["drive"]
    file.create_dataset("drive", (1 << 30,), "<i2", chunks=(1 << 30,))


def huge_row(file: h5py.File, folder: Path) -> None:
    """A channel whose samples are a megabyte each."""
    del file["drive"]
    file.create_dataset("drive", (2,), np.dtype((np.void, 1 << 20)), chunks=(1,))


def external_link(file: h5py.File, folder: Path) -> None:
    """A channel that is a link into another file."""
    del file["drive"]
    file["drive"] = h5py.ExternalLink(str(folder / "other.h5"), "/secret")


def external_storage(file: h5py.File, folder: Path) -> None:
    """A channel whose samples lie in a raw file."""
    n = file["continuity"].shape[0]
    del file["drive"]
    file.create_dataset("drive", (n,), "<i2", external=[(str(folder / "secret.bin"), 0, 2 * n)])


def virtual(file: h5py.File, folder: Path) -> None:
    """A channel put together from another file."""
    n = file["continuity"].shape[0]
    del file["drive"]
    layout = h5py.VirtualLayout((n,), "<i2")
    layout[:] = h5py.VirtualSource(str(folder / "other.h5"), "secret", (n,))
    file.create_virtual_dataset("drive", layout)


def link_loop(file: h5py.File, folder: Path) -> None:
    """A step table that is a link to a link to itself."""
    del file["steps"]
    file["steps"] = h5py.SoftLink("/blocks/around")
    file["blocks/around"] = h5py.SoftLink("/steps")


def many_objects(file: h5py.File, folder: Path) -> None:
    """A hundred thousand groups at the root and in a table."""
    for where in (file["/"], file["steps"]):
        for i in range(50_000):
            where.create_group(f"g{i}")


def deep_text(file: h5py.File, folder: Path) -> None:
    """Free keys nested a million deep."""
    file.attrs["extra_json"] = "[" * 1_000_000


def formula_channel(file: h5py.File, folder: Path) -> None:
    """A channel called like a formula and like markup."""
    file.move("drive", '=cmd("<img src=x onerror=alert(1)>")')
    file.attrs["channels"] = ["continuity", "accelerometer", '=cmd("<img src=x onerror=alert(1)>")']


KINDS: tuple[Spoil, ...] = (
    huge_table, huge_channel, huge_chunk, huge_row, external_link, external_storage, virtual, link_loop, many_objects,
    deep_text, formula_channel,
)  # fmt: skip


def outside(folder: Path, n_samples: int) -> None:
    """What a spoiled file may lead to."""
    (folder / "secret.bin").write_bytes(np.full(n_samples, SECRET, np.int16).tobytes())
    with h5py.File(folder / "other.h5", "w") as other:
        other["secret"] = np.full(n_samples, SECRET, np.int16)


def ask(folder: Path, *arguments: str) -> tuple[str, float, float]:
    """One command: how it ended, seconds, peak memory in MB."""
    code = (
        "import resource, sys; from bench.cli import app; code = 0\n"
        "try: app(sys.argv[1:])\n"
        "except SystemExit as end: code = end.code\n"
        "own, made = (resource.getrusage(w).ru_maxrss for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))\n"
        "print('memory', max(own, made)); sys.exit(code)"
    )
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], cwd=folder, capture_output=True, text=True, timeout=120
    )
    memory = float(done.stdout.rpartition("memory ")[2] or "nan") / 1024.0
    said = f"{arguments[0]} {done.returncode}"
    if "Traceback" in done.stderr or done.returncode not in (0, 1, 2):
        said += " TRACEBACK " + done.stderr[-300:]
    return said, time.perf_counter() - began, memory


def followed(folder: Path) -> bool:
    """Whether a number from outside reached an output."""
    number = np.int16(SECRET).tobytes()
    return any(number * 8 in path.read_bytes() for path in folder.glob("made*"))


def main() -> None:
    """Print one row a kind."""
    from benchmarks.daq.flips import make

    os.environ.setdefault("PYTHONPATH", str(Path(__file__).parents[2]))
    for spoil in KINDS:
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            make(folder / "a.h5", "closed")
            with h5py.File(folder / "a.h5", "r+") as file:
                outside(folder, file["continuity"].shape[0])
                spoil(file, folder)
            made = ("export", "a.h5", "--out", "made.npz"), ("recover", "a.h5", "--out", "made.h5")
            rows = [ask(folder, *call) for call in (("verify", "a.h5"), *made)]
            said = ", ".join(row[0] for row in rows)
            longest, largest = max(row[1] for row in rows), max(row[2] for row in rows)
            word = "FOLLOWED" if followed(folder) else "not followed"
            print(f"{spoil.__name__:18s} {said}; {longest:.1f} s, {largest:.0f} MB, {word}", flush=True)


if __name__ == "__main__":
    main()
