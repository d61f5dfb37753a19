"""Losses of power while a run is recorded: is every step that was said to be on the disk there afterwards?

    python -m benchmarks.daq.power_cuts [--run short|long] [--images 20000] [--full 50] [--seed 1] [--every]

A run is recorded and closed under `strace`, which notes each write, fsync and rename and, in between, what the program
said was safe. A loss of power at any moment leaves an image: what was synced, and a part of the later writes, in any
order, each torn at any sector of 512 bytes, with the file as long as any of them made it. Names count once their folder
was synced (a file's own fsync does not promise its name); until then a new name or a renamed file may be there or not.
``--every`` adds, at each moment, each order-keeping part of the later writes, cut at each sector of the last; each of
them by itself; all but each; all but each two. An image with the same bytes as another, and as much acknowledged, is
checked once.
Of each image every acknowledged step must be read, with all its samples, and a closed run as a whole. `verify` and
`recover` are asked of each that is a closed file and of ``--full`` others; the rest is read by the marks in the file.
Then every byte that was synced and written again is compared, which covers all images at once. Linux only.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import logging
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.daq.kill import SETUP, content
from benchmarks.daq.torn_writes import Write, apply, lose_power, parts_of
from daq.files.frames.marked_frames import MAGIC, MarkedFrames, read_marks
from daq.recording import CHANNELS, Block, open_recording, verify
from daq.recording.recover import recover
from daq.recording.writer import RecordingWriter
from daq.setup.errors import InputError
from daq.setup.setup import Setup

STEP_BLOCKS = 4
NAME = "run.h5"
_CALLS = "openat,pwrite64,write,lseek,read,ftruncate,fsync,rename,renameat,renameat2,unlink"
_LINE = re.compile(r"^(?:\d+ +)?(\w+)\((.*)\) += (-?\d+)")
_DATA = re.compile(r'^(\d+)<([^>]*)>, (?:"((?:\\x[0-9a-f]{2})*)"(?:\.\.\.)?, )?(.*)$')


@dataclass(frozen=True)
class Shape:
    """How long a run is: samples in a block, and blocks."""

    block: int
    blocks: int

    @property
    def step(self) -> int:
        """Samples in a step."""
        return STEP_BLOCKS * self.block

    @property
    def n_samples(self) -> int:
        """Samples of the run."""
        return self.block * self.blocks


SHAPES = {"short": Shape(100, 14), "long": Shape(900, 26)}


def record(folder: str, run: Shape) -> None:
    """Record a run, and say what is safe; each line is a write that the log shows in its place."""
    path = Path(folder) / NAME
    setup = Setup.model_validate(SETUP)
    writer = RecordingWriter(path, setup, profile_text="", channels=CHANNELS, backend="cut", simulated=True)
    for i in range(run.blocks):
        writer.append(Block(i * run.block, content(i * run.block, run.block)))
        if i % STEP_BLOCKS == STEP_BLOCKS - 1:
            first = (i + 1) * run.block - run.step
            for gamma in (np.nan, 1.5):  # a step is marked when it begins, and again with what was measured
                writer.mark_step({"first_sample": first, "n_samples": run.step, "achieved_gamma": gamma})
                os.write(1, f"steps {(i + 1) // STEP_BLOCKS}\n".encode())
    writer.close()
    os.write(1, b"closed 1\n")


@dataclass(frozen=True)
class Call:
    """One call of the log: what it does, to which file, where, with which bytes."""

    what: str  # create, write, cut, sync, rename, said
    path: str = ""
    at: int = 0
    data: bytes = b""
    to: str = ""


def log_of(folder: Path, run: Shape) -> list[Call]:
    """The log of `record` in a folder."""
    out = folder.with_name("log.txt")
    code = f"from benchmarks.daq.power_cuts import *; record({str(folder)!r}, {run!r})"
    trace = ["strace", "-f", "-y", "-xx", "-s", "1000000", "-e", f"trace={_CALLS}", "-o", str(out)]
    one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment = os.environ | one_thread | {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([*trace, sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL, env=environment)
    calls, place = [], dict[str, int]()
    with out.open(encoding="ascii") as lines:
        for line in lines:
            found = _LINE.match(line)
            if found is not None and int(found[3]) >= 0:
                calls += _calls(found[1], found[2], int(found[3]), place, str(folder))
    return calls


def _plain(text: str) -> str:
    """A text that `strace` wrote in hexadecimal."""
    return bytes.fromhex(text.replace("\\x", "")).decode()


def _calls(what: str, arguments: str, result: int, place: dict[str, int], folder: str) -> list[Call]:
    """What one line of the log means; ``place`` has where each open file is read or written next."""
    if what.startswith("rename"):
        old, new = (_plain(text) for text in re.findall(r'"([^"]*)"', arguments))
        return [Call("rename", old, to=new)] if old.startswith(folder) else []
    if what == "openat":
        path = _plain(re.findall(r'"([^"]*)"', arguments)[0])
        return [Call("create", path)] if "O_CREAT" in arguments and path.startswith(folder) else []
    if what == "unlink" or (found := _DATA.match(arguments + ", ")) is None:
        return []
    number, path, text, rest = found[1], _plain(found[2]) if "\\x" in found[2] else found[2], found[3], found[4]
    data = bytes.fromhex(text.replace("\\x", "")) if text else b""
    if number == "1" and data.startswith((b"steps ", b"closed ")):
        return [Call("said", data=data)]
    if not path.startswith(folder):
        return []
    if what == "fsync":
        return [Call("sync", path)]
    if what == "ftruncate":
        return [Call("cut", path, int(rest.split(",")[0]))]
    if what == "lseek":
        place[number] = result
    if what == "pwrite64":
        return [Call("write", path, int(rest.split(",")[1]), data[:result])]
    at = place.get(number, 0)
    if what in ("read", "write"):
        place[number] = at + result
    return [Call("write", path, at, data[:result])] if what == "write" else []


@dataclass
class Disk:
    """Files and names as they are synced, and what is on its way there."""

    folder: str
    files: dict[str, bytearray] = field(default_factory=dict)  # by the name under which they were made
    waiting: dict[str, list[Write]] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)  # name to file
    later: list[Call] = field(default_factory=list)  # names that were made or changed since the folder was synced
    said: dict[str, int] = field(default_factory=dict)
    now: dict[str, str] = field(default_factory=dict)  # names as the program has them

    def take(self, call: Call) -> None:
        """One more call."""
        if call.what == "said":
            word, number = call.data.decode().split()
            self.said[word] = int(number)
        elif call.what == "create":
            if call.path not in self.now:
                self._name(call)
                self.now[call.path] = call.path
                self.files[call.path], self.waiting[call.path] = bytearray(), []
        elif call.what == "rename":
            self._name(call)
            self.now[call.to] = self.now.pop(call.path)
        elif call.what == "sync" and call.path == self.folder:
            self.names, self.later = dict(self.now), []
        else:
            file = self.now.get(call.path)
            if file is None:
                return
            if call.what != "sync":
                self.waiting[file].append(Write(call.at, call.data if call.what == "write" else None))
                return
            for waiting in self.waiting[file]:
                apply(self.files[file], waiting)
            self.waiting[file] = []

    def _name(self, call: Call) -> None:
        self.later.append(call)

    def file(self, n_later: int) -> str | None:
        """The run's file, of the later changes of names so many done; None where it has no name."""
        names = dict(self.names)
        for call in self.later[:n_later]:
            if call.what == "create":
                names[call.path] = call.path
            else:
                names[call.to] = names.pop(call.path)
        return names.get(f"{self.folder}/{NAME}")

    def image(self, rng: np.random.Generator) -> bytes | None:
        """Bytes of the run's file after a loss of power at this moment; None where it has no name."""
        file = self.file(int(rng.integers(len(self.later) + 1)))
        if file is None:
            return None
        data = bytearray(self.files[file])
        lose_power(data, self.waiting[file], rng)
        return bytes(data)

    def every_image(self) -> Iterator[bytes | None]:
        """Those with every prefix of the later writes, and with one or two of them done or left out."""
        for file in {self.file(n) for n in range(len(self.later) + 1)}:
            if file is None:
                yield None
            else:
                yield from parts_of(bytes(self.files[file]), self.waiting[file])


def fault_by_marks(image: bytes, run: Shape, n_steps: int, n: int) -> str:
    """What is missing of so many steps and ``n`` samples, read by the marks; nothing where all are there."""
    if not n_steps:
        return ""
    try:
        frames = MarkedFrames(image)
    except LookupError:
        return "no marks"
    if frames.n_samples < n or any(first < n for first, _ in frames.lost):
        return f"{n} samples acknowledged, {frames.n_samples} found, lost {frames.lost}"
    if frames.steps["first_sample"][:n_steps].tolist() != [k * run.step for k in range(n_steps)]:
        return f"{n_steps} steps acknowledged, found {frames.steps['first_sample'].tolist()}"
    return "" if np.array_equal(frames.rows(0, n), _recorded(run.n_samples)[:n]) else "other samples"


_recorded = functools.cache(functools.partial(content, 0))


def fault_by_reading(image: bytes, n_steps: int, n: int) -> str:
    """What is missing of so many steps and ``n`` samples, by `verify` and `recover`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / NAME
        path.write_bytes(image)
        try:
            if verify(path).state not in ("complete", "stopped"):
                path = recover(path).path
        except InputError as error:
            return str(error) if n else ""
        with open_recording(path) as recording:
            if recording.n_samples < n or len(recording.steps) < n_steps:
                return f"{recording.n_samples} samples of {n}, {len(recording.steps)} steps of {n_steps}"
            same = all(np.array_equal(recording.codes(c, 0, n), content(0, n)[:, i]) for i, c in enumerate(CHANNELS))
            return "" if same else "other samples"


class Score:
    """Images and what is missing in them, counted; each distinct one is checked once."""

    def __init__(self, run: Shape) -> None:
        self._run = run
        self._faults: dict[tuple[bytes, int, int], str] = {}
        self.counts = Counter[str]()

    def take(self, disk: Disk, image: bytes | None, *, in_full: bool) -> None:
        """One image of a moment."""
        steps = disk.said.get("steps", 0)
        n = self._run.n_samples if "closed" in disk.said else steps * self._run.step
        key = (hashlib.sha1(image or b"", usedforsecurity=False).digest(), steps, n)
        if key not in self._faults:
            self.counts["distinct images"] += 1
            if image is None:
                self._faults[key] = "the file has no name" if steps else ""
            elif in_full or b"SEAL\r\n" in image[-28:]:
                self.counts["by verify and recover"] += 1
                self._faults[key] = fault_by_reading(image, steps, n)
            else:
                self._faults[key] = fault_by_marks(image, self._run, steps, n)
        self.counts["images"] += 1
        self.counts["acknowledged steps"] += steps
        if fault := self._faults[key]:
            self.counts["faults"] += 1
            self.counts[f"fault: {fault[:90]}"] += 1


def score(
    log: list[Call], run: Shape, n_images: int, n_full: int, rng: np.random.Generator, *, every: bool = False
) -> Counter[str]:
    """Images at moments spread over the log, and what is missing in them."""
    disk, result = Disk(str(Path(next(call.path for call in log if call.what == "create")).parent)), Score(run)
    moments = np.sort(rng.integers(0, len(log) + 1, n_images))
    full = set(rng.choice(n_images, min(n_full, n_images), replace=False).tolist())
    for moment in range(len(log) + 1):
        for image in disk.every_image() if every else ():
            result.take(disk, image, in_full=False)
        for k in np.flatnonzero(moments == moment).tolist():
            result.take(disk, disk.image(rng), in_full=k in full)
        if moment < len(log):
            disk.take(log[moment])
    return result.counts


def bytes_overwritten(log: list[Call]) -> tuple[int, int]:
    """Bytes that were synced in marks and frames and then written again, and how many of them were others.

    None other: then no part of the later writes, in any order and torn at any byte, can harm what was synced.
    """
    disk = Disk(str(Path(next(call.path for call in log if call.what == "create")).parent))
    safe: dict[str, list[tuple[int, int]]] = {}
    again = others = 0
    for call in log:
        file = disk.now.get(call.path, "")
        held = disk.files.get(file, bytearray())
        for a, b in safe.get(file, []) if call.what == "write" else []:
            first, last = max(a, call.at), min(b, call.at + len(call.data))
            if first < last:
                again += last - first
                new = np.frombuffer(call.data, np.uint8)[first - call.at : last - call.at]
                others += int(np.sum(new != np.frombuffer(bytes(held[first:last]), np.uint8)))
        disk.take(call)
        if call.what == "sync" and file and (marks := read_marks(bytes(disk.files[file]))) is not None:
            ends = [int(row["first_sample"][0] + row["n_samples"][0]) for row in marks.rows["blocks"].values()]
            n_bytes, chunk = 2 * marks.n_channels * max(ends), 2 * marks.n_channels * marks.chunk_rows
            safe[file] = [(at, at + min(chunk, n_bytes - k * chunk)) for k, at in marks.addresses.items()]
            pages = re.finditer(re.escape(MAGIC), bytes(disk.files[file]))
            safe[file] += [(page.start(), page.start() + 4096) for page in pages]
    return again, others


def main() -> None:
    """Score the images of one log."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", choices=list(SHAPES), default="short")
    parser.add_argument("--images", type=int, default=20000)
    parser.add_argument("--full", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--every", action="store_true", help="with the images that can be counted")
    given = parser.parse_args()
    logging.disable()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "disk"
        folder.mkdir()
        log = log_of(folder, SHAPES[given.run])
        kinds: Any = Counter(call.what for call in log)
        print(f"log: {dict(kinds)}")
        began = time.process_time()
        counts = score(log, SHAPES[given.run], given.images, given.full, np.random.default_rng(given.seed),
                       every=given.every)  # fmt: skip
        again, others = bytes_overwritten(log)
        print(f"of what was synced in marks and frames {again} bytes were written again, {others} of them as others")
    print(f"{time.process_time() - began:.0f} s of processor")
    for key, n in counts.most_common():
        print(f"{n:9d} {key}")


if __name__ == "__main__":
    main()
