"""A folder in memory whose writes, syncs, renames and removals can be cut short, refused, lost, or be the last.

`disk.c` stands between the process and the C library (LD_PRELOAD, Linux), so that HDF5's own writes pass too.
"""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.daq.torn_writes import Write, lose_power

WRITE, TRUNCATE, SYNC, RENAME, UNLINK, OPEN = range(6)
PRETEND = -1000
ERRORS = {"full": errno.ENOSPC, "unwritable": errno.EIO, "interrupted": errno.EINTR}
_HOOK = ctypes.CFUNCTYPE(ctypes.c_long, ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_long, ctypes.c_long)


def with_library(module: str, arguments: Sequence[str]) -> None:
    """Start this program anew with `disk.c` loaded, unless it is; returns where it is, and where it cannot be."""
    if "SIMULATED_DISK" in os.environ or sys.platform != "linux" or shutil.which("cc") is None:
        return
    built = Path(tempfile.mkdtemp(prefix="bench-sim-")) / "disk.so"
    source = Path(__file__).with_name("disk.c")
    subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", str(built), str(source), "-ldl"], check=True)
    os.environ |= {"LD_PRELOAD": str(built), "SIMULATED_DISK": str(built), "OMP_NUM_THREADS": "1"}
    os.execv(sys.executable, [sys.executable, "-m", module, *arguments])


@dataclass(frozen=True)
class Refusal:
    """From its ``at``-th call on, and for ``calls`` of them, the disk does ``how`` (a key of `ERRORS`, or "short")."""

    how: str
    at: int
    calls: int


class Disk:
    """The folder and what happens to it; one in a process.

    Attributes
    ----------
    frozen
        Whether nothing reaches the disk any more: whoever wrote to it is dead, and does not know.
    is_aside
        Whether what happens now is not of the product, and passes.
    on_call
        Called before each call that changes the disk, with its number.
    """

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="bench-sim-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
        self._library = ctypes.CDLL(os.environ["SIMULATED_DISK"])
        self._library.disk_free.argtypes = [ctypes.c_ulonglong]
        self._hook = _HOOK(self._called)
        self._library.disk_watch(self._hook, os.fsencode(self.folder) + b"/")
        self.reset()

    def reset(self) -> None:
        """Empty, sound, and without a past."""
        self.frozen, self.refusals, self.is_aside = False, list[Refusal](), False
        self.on_call: Callable[[int], None] = lambda call: None
        for path in self.folder.iterdir():
            path.unlink()
        self.calls = 0
        self.logged = ""  # the file of which writes since its last sync are noted
        self._synced, self._since = b"", list[Write]()
        self.free(1 << 32)

    def free(self, n_bytes: int) -> None:
        """What the folder says is free."""
        self._library.disk_free(n_bytes)

    def close(self) -> None:
        """Remove it."""
        self.frozen = False
        shutil.rmtree(self.folder, ignore_errors=True)

    def _called(self, call: int, fd: int, data: int | None, n: int, at: int) -> int:
        if self.is_aside:
            return 0
        self.calls += 1
        self.on_call(self.calls)
        if self.frozen:
            return -errno.EROFS if call == OPEN else PRETEND
        for refusal in self.refusals:
            if refusal.at <= self.calls < refusal.at + refusal.calls:
                if refusal.how == "short":
                    n = max(1, n // 2) if call == WRITE else n
                elif call in (WRITE, TRUNCATE) or (call == SYNC and refusal.how == "unwritable"):
                    return -ERRORS[refusal.how]
        if call == RENAME:
            self.logged = ""  # columns that were synced take the place of the frames
        if self.logged and call in (WRITE, TRUNCATE, SYNC) and self._name(fd) == self.logged:
            self._note(call, fd, data, n, at)
        return n if call == WRITE else 0

    def _name(self, fd: int) -> str:
        return Path(f"/proc/self/fd/{fd}").readlink().name

    def _note(self, call: int, fd: int, data: int | None, n: int, at: int) -> None:
        """Remember a call of the logged file."""
        if call == SYNC:
            self._synced, self._since = (self.folder / self.logged).read_bytes(), []
        else:
            self._since.append(Write(at, ctypes.string_at(data or 0, n) if call == WRITE else None))

    def cut_power(self, rng: np.random.Generator) -> None:
        """Leave of the file that is logged, if it is there, what was synced, and a part of what came since."""
        if not self.logged or not (self.folder / self.logged).exists():
            return
        image = bytearray(self._synced)
        lose_power(image, self._since, rng)
        self.replace(self.folder / self.logged, bytes(image))

    def replace(self, path: Path, image: bytes) -> None:
        """Make a file anew: HDF5 may still have a dead recorder's open, and would take what is in its memory for it."""
        self.is_aside = True
        path.unlink()
        path.write_bytes(image)
        self.is_aside = False
