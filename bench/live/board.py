"""The board between a run and its page: two lanes of short messages in shared memory, neither side ever waits.

The run puts events on one lane, the page puts commands on the other. A lane keeps the newest messages; a reader that
was away too long learns how many it missed. If no one reads, a message costs the microseconds of its writing.
Decision 142.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.files.tables import crc32
from daq.recorder.shared_ring import shared_memory

EVENT_SLOTS, EVENT_BYTES = 512, 8192
COMMAND_SLOTS, COMMAND_BYTES = 64, 8192
LONGEST_NOTE = 1900  # characters of a note, of up to four bytes each
_HEAD = 8  # bytes: length and checksum of a message

Message = dict[str, Any]


class Lane:
    """One writer's messages, the newest ``slots`` of them, in ``buffer``."""

    def __init__(self, buffer: memoryview, slots: int, n_bytes: int) -> None:
        self._slots, self._room = slots, n_bytes - _HEAD
        self._put = np.ndarray(1, np.int64, buffer)
        self._head = np.ndarray((slots, 2), np.uint32, buffer, 8)
        self._text: NDArray[np.uint8] = np.ndarray((slots, self._room), np.uint8, buffer, 8 + slots * _HEAD)
        self._seen = 0

    @staticmethod
    def size(slots: int, n_bytes: int) -> int:
        """Bytes that a lane takes."""
        return 8 + slots * n_bytes

    @property
    def waiting(self) -> bool:
        """Whether a message came since the last `read`."""
        return int(self._put[0]) != self._seen

    def put(self, message: Mapping[str, Any]) -> bool:
        """Put a message on the lane; False for one that is too long, which is left out."""
        packed = json.dumps(message, separators=(",", ":"), ensure_ascii=False)
        text = np.frombuffer(packed.encode(errors="replace"), np.uint8)
        if len(text) > self._room:
            return False
        slot = int(self._put[0]) % self._slots
        # invalid while it is written: a reader in between finds no message, never half of one
        self._head[slot] = 0, 0
        self._text[slot, : len(text)] = text
        self._head[slot] = len(text), crc32(text)
        self._put[0] += 1
        return True

    def read(self) -> tuple[list[Message], int]:
        """Messages since the last call, oldest first, and how many were overwritten unread."""
        put, messages = int(self._put[0]), []
        first = max(self._seen, put - self._slots + 1)
        missed = first - self._seen
        for i in range(first, put):
            slot = i % self._slots
            n, crc = (int(x) for x in self._head[slot])
            text = self._text[slot, : min(n, self._room)].copy()
            if n == 0 or crc32(text) != crc:
                missed += 1  # overwritten meanwhile
                continue
            messages.append(json.loads(text.tobytes()))
        self._seen = put
        return messages, missed

    def release(self) -> None:
        """Let go of the memory."""
        self._put = self._head = self._text = np.zeros(0, np.uint8)


class Board:
    """Shared memory of a run and its page; raises `OSError` where there is no such board, or no room for one.

    ``name`` is of an existing board to attach to; None makes one, which ends with its maker. The lane ``events`` leads
    from the run to the page, ``commands`` from the page to the run.
    """

    def __init__(self, name: str | None = None) -> None:
        self._owner = name is None
        events = Lane.size(EVENT_SLOTS, EVENT_BYTES)
        self._memory = shared_memory(name, events + Lane.size(COMMAND_SLOTS, COMMAND_BYTES))
        buffer: Any = self._memory.buf
        self.events = Lane(buffer, EVENT_SLOTS, EVENT_BYTES)
        self.commands = Lane(buffer[events:], COMMAND_SLOTS, COMMAND_BYTES)

    @property
    def name(self) -> str:
        """By which the other side attaches."""
        return self._memory.name

    def close(self, *, leave: bool = False) -> None:
        """Let go of the memory; its maker also frees it, but for ``leave``: then it goes with the last process."""
        self.events.release()
        self.commands.release()
        with contextlib.suppress(BufferError):  # a view of it is still being read; freed with the process
            self._memory.close()
        if self._owner and not leave:
            self._owner = False
            with contextlib.suppress(FileNotFoundError):  # already gone
                self._memory.unlink()
