"""Universal file format, data set 58 in its binary form: a set for each channel and each unbroken piece of time.

The header's numbers have six digits, so the exact rate, time and count stand in its text lines, where `bench import`
finds them; doubles are exact.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

import numpy as np

from daq.export.facts import Progress
from daq.files.column_file import CHUNK_SAMPLES
from daq.recording.reader import Recording
from kernels.arrays import Integers

LINE = 80
TIME_RESPONSE, DOUBLE, TIME, GENERAL = 1, 4, 17, 1  # codes of the format


def export_uff58(recording: Recording, part: Path, tell: Progress) -> None:
    """Write the file, piece by piece; a piece ends where samples were lost."""
    cuts = sorted(
        {0, recording.n_samples, *map(int, recording.gaps[:, 0]), *range(0, recording.n_samples, CHUNK_SAMPLES)}
    )
    lost = {int(first): int(n) for first, n in recording.gaps}
    with part.open("wb") as file:
        for a, b in pairwise(cuts):
            stamps = recording.timestamps_ns(a, b)
            for number, name in enumerate(recording.channels, 1):
                _write_set(file, recording, number, name, a, stamps, lost.get(a, 0))
            tell(b)


def _write_set(
    file: BinaryIO, recording: Recording, number: int, name: str, first: int, stamps: Integers, lost: int
) -> None:
    """One channel from sample ``first`` on; times that are not even stand next to the values."""
    volts, n = recording.read_v(name, first, first + len(stamps)), len(stamps)
    grid = (np.arange(n) * (1e9 / recording.rate_hz)) + stamps[0]
    # times are stored to a nanosecond
    even = bool(np.max(np.abs(stamps - grid)) <= 1.5)
    values = volts if even else np.column_stack([stamps * 1e-9, volts]).ravel()
    started = str(recording.stored.get("started") or "unknown")
    kind = "simulated rig" if recording.stored.get("simulated") else "rig"
    texts = (
        name,
        f"shakerbench recording of a {kind}: {recording.path.name}",
        started,
        f"rate_hz={recording.rate_hz!r} first_sample={first} time_ns={int(stamps[0])}",
        f"lost_before={lost}",
    )
    begin, step = (stamps[0] * 1e-9, 1.0 / recording.rate_hz) if even else (0.0, 0.0)
    lines = [
        f"{-1:6d}",
        f"{58:6d}b{1:6d}{2:6d}{11:12d}{8 * len(values):12d}{0:6d}{0:6d}{0:12d}{0:12d}",
        *("".join(c if " " <= c <= "~" else "?" for c in text)[:LINE].ljust(LINE) for text in texts),
        f"{TIME_RESPONSE:5d}{0:10d}{0:5d}{0:10d} {'NONE':<10}{number:10d}{0:4d} {'NONE':<10}{0:10d}{0:4d}",
        f"{DOUBLE:10d}{n:10d}{int(even):10d}{begin:13.5e}{step:13.5e}{0.0:13.5e}",
        _axis(TIME, "Time", "s"),
        _axis(GENERAL, "Voltage", "V"),
        _axis(0, "NONE", "NONE"),
        _axis(0, "NONE", "NONE"),
    ]
    file.write(("\n".join(lines) + "\n").encode("ascii"))
    file.write(np.ascontiguousarray(values, "<f8").tobytes())
    file.write(f"{-1:6d}\n".encode("ascii"))


def _axis(kind: int, name: str, unit: str) -> str:
    return f"{kind:10d}{0:5d}{0:5d}{0:5d} {name:<20} {unit:<20}"
