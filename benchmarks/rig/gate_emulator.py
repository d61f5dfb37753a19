"""The gate's machine code on an emulated RP2040, with the calls of `tests.fakes.gate.Gate`.

Needs node, `npm install rp2040js` in a folder of its own, and `pip install ziglang`, which has a compiler for the chip.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.fakes.gate import FIRMWARE, Gate

_TARGET = [
    "-target",
    "thumb-freestanding-eabi",
    "-mcpu=cortex_m0plus",
    "-std=c99",
    "-Os",
    "-Wall",
    "-Wextra",
    "-Werror",
]


def build_for_chip(folder: Path) -> Path:
    """The gate for the chip, in its memory; `emulated_gate.c` is its main program."""
    elf = folder / "gate.elf"
    sources = [str(FIRMWARE / name) for name in ("emulated_gate.c", "shaker_gate.c", "shaker_packet.c")]
    options = [*_TARGET, "-fno-sanitize=all", "-Wl,--image-base=0x20000000", *sources, "-o", str(elf)]
    subprocess.run([sys.executable, "-m", "ziglang", "cc", *options], check=True)
    return elf


class EmulatedGate(Gate):
    """A chip for all gates, which each new one starts anew."""

    _chip: subprocess.Popen[str] | None = None

    def __init__(self, elf: Path, emulator: Path, now: int = 0) -> None:
        if EmulatedGate._chip is None:
            script = Path(__file__).with_suffix(".mjs")
            EmulatedGate._chip = subprocess.Popen(
                ["node", str(script), str(elf), str(emulator)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, encoding="ascii",
            )  # fmt: skip
        self._call(1, now)

    def _call(self, call: int, n: int, data: bytes = b"") -> bytes:
        chip = EmulatedGate._chip
        if chip is None or chip.stdin is None or chip.stdout is None:
            raise RuntimeError("the emulator is not running")
        chip.stdin.write(f"{call} {n} {data.hex()}\n")
        chip.stdin.flush()
        return bytes.fromhex(chip.stdout.readline())

    def hear(self, wire: bytes) -> None:
        """Bytes come from the host."""
        self._call(2, len(wire), wire)

    def play(self, drive: NDArray[np.int16]) -> NDArray[np.int16]:
        """Pass samples of the drive."""
        return np.frombuffer(self._call(3, len(drive), np.asarray(drive, "<i2").tobytes()), "<i2").astype(np.int16)

    def press(self) -> None:
        """A person presses the button."""
        self._call(4, 0)

    def status(self) -> bytes:
        """What it sends."""
        return self._call(5, 0)
