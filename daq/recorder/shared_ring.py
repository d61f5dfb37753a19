"""A ring of blocks in shared memory: one process puts blocks in, another takes them out, neither waits for the other.

Each slot carries the checksum of its frames, so a slot that is read while it is being written is read again; a block
that finds the ring full is counted, and the next one that fits says how many samples are missing before it. The memory
is taken when it is asked for, not when it is written to; its name says whose it is, so that none is left behind.
"""

from __future__ import annotations

import os
import secrets
import sys
import time
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path

import numpy as np

from daq.files.tables import BLOCK_DTYPE, Block, crc32

NAME = "shakerbench"
FOLDER = Path("/dev/shm")  # of named segments, where the system shows them (Linux)
_COUNTERS = ("put", "taken", "safe_samples", "dropped_blocks", "worst_backlog")


def shared_memory(name: str | None, size: int) -> SharedMemory:
    """The segment ``name``, or for None a new one of ``size`` bytes, whose name says whose it is; raises `OSError`."""
    if name is not None:
        return SharedMemory(name)
    clear_left_behind()
    return SharedMemory(f"{NAME}-{os.getpid()}-{secrets.token_hex(3)}", create=True, size=size)


class Ring:
    """Slots for blocks of up to ``block_samples`` frames, new or those of an existing ring ``name``.

    Raises `OSError` where the system's shared memory has no room for it.
    """

    def __init__(self, slots: int, block_samples: int, channels: int, name: str | None = None) -> None:
        self.slots, self.block_samples, self.channels = slots, block_samples, channels
        head = 8 * len(_COUNTERS)
        rows = slots * BLOCK_DTYPE.itemsize
        size = head + rows + slots * block_samples * channels * 2
        self._owner = name is None
        self._is_named = True
        self._memory = shared_memory(name, size)
        if self._owner:
            self._reserve(size)
        buffer = self._memory.buf
        self._counters = np.ndarray(len(_COUNTERS), np.int64, buffer)
        self._rows = np.ndarray(slots, BLOCK_DTYPE, buffer, head)
        self._frames = np.ndarray((slots, block_samples, channels), np.int16, buffer, head + rows)
        self._missing = 0
        if self._owner:
            self._counters[:] = 0

    @property
    def name(self) -> str:
        """By which another process attaches."""
        return self._memory.name

    def counter(self, name: str) -> int:
        """One of ``put``, ``taken`` (blocks), ``safe_samples``, ``dropped_blocks``, ``worst_backlog`` (blocks)."""
        return int(self._counters[_COUNTERS.index(name)])

    def set_counter(self, name: str, value: int) -> None:
        """Set a counter; each has one writer."""
        self._counters[_COUNTERS.index(name)] = value

    @property
    def backlog(self) -> int:
        """Blocks put in and not yet taken out."""
        return int(self._counters[0] - self._counters[1])

    def put(self, block: Block) -> bool:
        """Put a block in (raises ValueError: too large); False when the ring is full: the next one will say so."""
        n = len(block.codes)
        if n > self.block_samples:
            raise ValueError(f"wanted at most {self.block_samples} frames, got {n}")
        waiting = self.backlog
        if waiting >= self.slots:
            self._missing += n + block.lost_before
            self._counters[3] += 1
            return False
        slot = int(self._counters[0]) % self.slots
        self._frames[slot, :n] = block.codes
        lost = block.lost_before + self._missing
        clocks = block.clock_ns, lost, block.lost_uncertainty, block.adc_ns
        self._rows[slot] = (block.first_sample, n, block.flags, *clocks, crc32(block.codes))
        self._missing = 0
        self._counters[4] = max(self._counters[4], waiting + 1)
        self._counters[0] += 1  # last: the other side sees a whole slot
        return True

    def take(self, most: int = 64) -> list[Block]:
        """Take out the blocks that are there, in order, at most so many; never waits."""
        taken: list[Block] = []
        at = int(self._counters[1])
        for i in range(at, min(int(self._counters[0]), at + most)):
            block = self._block(i)
            if block is None:
                break  # not all of it is visible to this process yet: next time
            taken.append(block)
        self._counters[1] = at + len(taken)
        return taken

    def _block(self, i: int) -> Block | None:
        """Block number ``i`` since the start; None where its frames do not fit their checksum."""
        row = self._rows[i % self.slots].copy()
        codes = self._frames[i % self.slots, : int(row["n_samples"])].copy()
        if crc32(codes) != int(row["crc32"]):
            return None
        names = ("flags", "clock_ns", "lost_before", "lost_uncertainty", "adc_ns")
        return Block(int(row["first_sample"]), codes, *(int(row[name]) for name in names))

    def _reserve(self, size: int) -> None:
        """Take all of the memory now: on Linux it is found missing only when it is written to, and the process dies."""
        path = FOLDER / self._memory.name
        if not sys.platform.startswith("linux") or not path.is_file():
            return
        try:
            with path.open("r+b") as file:
                os.posix_fallocate(file.fileno(), 0, size)
        except OSError as error:
            self._memory.close()
            self.unname()
            raise OSError(
                f"shared memory: no room for the {size / 1e6:.1f} MB between run and recorder in {FOLDER} ({error}); "
                "free some there (containers: a larger --shm-size)"
            ) from error

    def unname(self) -> None:
        """Take the memory's name away: it is freed with the last process that holds it, however that ends."""
        if self._is_named:
            self._is_named = False
            try:
                self._memory.unlink()
            except FileNotFoundError:
                return  # the other side was first

    def close(self) -> None:
        """Let go of the memory; its maker also frees it."""
        self._counters = self._rows = self._frames = np.zeros(0)
        self._memory.close()
        if self._owner:
            self.unname()


class RingReader(Ring):
    """A third process's view of a ring: reads what is put in, takes nothing out, and cannot change it."""

    def __init__(self, slots: int, block_samples: int, channels: int, name: str) -> None:
        super().__init__(slots, block_samples, channels, name)
        for array in (self._counters, self._rows, self._frames):
            array.flags.writeable = False
        self._next = max(0, self.counter("put") - slots + 2)

    def read(self, most: int = 256) -> list[Block]:
        """Blocks since the last call, in order, at most so many; what was overwritten meanwhile is left out."""
        put = self.counter("put")
        self._next = max(self._next, put - self.slots + 2)
        blocks = []
        for i in range(self._next, min(put, self._next + most)):
            block = self._block(i)
            if block is not None:
                blocks.append(block)
        self._next = min(put, self._next + most)
        return blocks


def clear_left_behind(folder: Path = FOLDER) -> list[str]:
    """Remove rings whose process was killed before it could; returns their names. Only where they are files (Linux)."""
    if not sys.platform.startswith("linux") or not folder.is_dir():
        return []
    cleared = []
    for path in folder.glob(f"{NAME}-*-*"):
        owner = path.name.split("-")[1]
        try:
            # a younger segment may still be being handed over
            if not owner.isdecimal() or time.time() - path.stat().st_mtime <= 60.0:
                continue
            try:
                os.kill(int(owner), 0)  # asks whether there is such a process (POSIX)
            except ProcessLookupError:
                path.unlink()
                cleared.append(path.name)
        except OSError:
            continue  # another user's, or gone meanwhile
    return cleared
