"""The firmware's gate, compiled for this machine, and a port that leads to it."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

FIRMWARE = Path(__file__).parents[2] / "firmware"
STRICT = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic"]


class Gate:
    """One gate; the library has a single one, which each new object starts anew, at a count of samples."""

    def __init__(self, library: Path, now: int = 0) -> None:
        self._library = ctypes.CDLL(str(library))
        self._library.gate_status.restype = ctypes.c_size_t
        self._library.gate_start(ctypes.c_uint32(now))

    def hear(self, wire: bytes) -> None:
        """Bytes come from the host."""
        self._library.gate_bytes(wire, ctypes.c_size_t(len(wire)))

    def play(self, drive: NDArray[np.int16]) -> NDArray[np.int16]:
        """Pass samples of the drive."""
        drive, out = np.ascontiguousarray(drive, np.int16), np.empty(len(drive), np.int16)
        self._library.gate_samples(
            ctypes.c_void_p(drive.ctypes.data), ctypes.c_void_p(out.ctypes.data), ctypes.c_size_t(len(drive))
        )
        return out

    def press(self) -> None:
        """A person presses the button."""
        self._library.gate_press()

    def status(self) -> bytes:
        """What it sends."""
        wire = ctypes.create_string_buffer(64)
        n_bytes = self._library.gate_status(wire)
        return wire.raw[:n_bytes]


def build_gate(folder: Path) -> Path:
    """The library, compiled by the C compiler of this machine; skips a test where there is none."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler (cc) on this machine")
    library = folder / "gate.so"
    sources = [str(FIRMWARE / name) for name in ("shaker_gate.c", "shaker_packet.c", "host_gate.c")]
    subprocess.run([compiler, *STRICT, "-shared", "-fPIC", *sources, "-o", str(library)], check=True)
    return library
