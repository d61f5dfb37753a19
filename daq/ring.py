"""A ring of blocks in shared memory: one process puts blocks in, another takes them out, neither waits for the other.

The rule kept here: nothing is torn and nothing is dropped in silence. Each slot carries the checksum of its frames, so
a slot that is read while it is being written is read again; a block that finds the ring full is counted, and the next
one that fits says how many samples are missing before it.
"""

from __future__ import annotations

from dataclasses import replace
from multiprocessing.shared_memory import SharedMemory

import numpy as np

from daq.block import BLOCK_DTYPE, Block, crc32

_COUNTERS = ("put", "taken", "safe_samples", "dropped_blocks", "worst_backlog")


class Ring:
    """Slots for blocks of up to ``block_samples`` frames.

    Parameters
    ----------
    slots, block_samples, channels
        How many blocks it holds, and how large they may be.
    name
        Of an existing ring to attach to; None makes one.
    """

    def __init__(self, slots: int, block_samples: int, channels: int, name: str | None = None) -> None:
        self.slots, self.block_samples, self.channels = slots, block_samples, channels
        head = 8 * len(_COUNTERS)
        rows = slots * BLOCK_DTYPE.itemsize
        size = head + rows + slots * block_samples * channels * 2
        self._memory = SharedMemory(name=name, create=name is None, size=size if name is None else 0)
        self._owner = name is None
        buffer = self._memory.buf
        self._counters = np.ndarray(len(_COUNTERS), np.int64, buffer)
        self._rows = np.ndarray(slots, BLOCK_DTYPE, buffer, head)
        self._frames = np.ndarray((slots, block_samples, channels), np.int16, buffer, head + rows)
        self._missing = 0
        if self._owner:
            self._counters[:] = 0

    @classmethod
    def for_seconds(cls, seconds: float, rate_hz: float, block_samples: int, channels: int) -> Ring:
        """A ring that holds at least ``seconds`` of frames."""
        return cls(max(4, int(np.ceil(seconds * rate_hz / block_samples)) + 1), block_samples, channels)

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
        """Put a block in; False when the ring is full: the block is lost, and the next one will say so.

        Raises
        ------
        ValueError
            For a block that is larger than a slot.
        """
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
        self._rows[slot] = (
            block.first_sample, n, block.flags, block.clock_ns, lost, block.lost_uncertainty, block.adc_ns,
            crc32(block.codes),
        )
        self._missing = 0
        self._counters[4] = max(self._counters[4], waiting + 1)
        self._counters[0] += 1
        return True

    def take(self, most: int = 64) -> list[Block]:
        """Take out what is there, in order, at most so many blocks; never waits."""
        taken: list[Block] = []
        at = int(self._counters[1])
        for i in range(at, min(int(self._counters[0]), at + most)):
            slot = i % self.slots
            row = self._rows[slot].copy()
            codes = self._frames[slot, : int(row["n_samples"])].copy()
            if crc32(codes) != int(row["crc32"]):
                break  # not all of it is visible to this process yet: next time
            taken.append(
                Block(
                    int(row["first_sample"]), codes, int(row["flags"]), int(row["clock_ns"]), int(row["lost_before"]),
                    int(row["lost_uncertainty"]), int(row["adc_ns"]),
                )
            )
        self._counters[1] = at + len(taken)
        return taken

    def close(self) -> None:
        """Let go of the memory; its maker also frees it."""
        self._counters = self._rows = self._frames = np.zeros(0)
        self._memory.close()
        if self._owner:
            self._memory.unlink()


def renumbered(blocks: list[Block], first_sample: int) -> list[Block]:
    """Blocks that follow each other from ``first_sample`` on."""
    placed = []
    for block in blocks:
        placed.append(replace(block, first_sample=first_sample))
        first_sample += len(block.codes)
    return placed
