"""Blocks of frames as a back end hands them over, and the tables that describe a run: blocks and steps.

A block says what happened to it (flags, clock, samples lost before it); nothing is inferred later that could have been
written down at the time.
"""

from __future__ import annotations

import enum
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kernels.arrays import Integers

STEP_DTYPE = np.dtype([
    ("first_sample", "<i8"), ("n_samples", "<i8"), ("settle_samples", "<i8"), ("gamma", "<f8"),
    ("achieved_gamma", "<f8"), ("achieved_gamma_uncertainty", "<f8"), ("frequency_hz", "<f8"), ("ratio", "<i8"),
    ("cycles", "<f8"), ("settle_cycles", "<f8"), ("direction", "i1"), ("fade_samples", "<i8"),
])  # fmt: skip
"""One step of a ramp. ``n_samples`` counts fade, settle and hold; ``settle_samples`` counts fade and settle."""

BLOCK_DTYPE = np.dtype([
    ("first_sample", "<i8"), ("n_samples", "<i8"), ("flags", "<u4"), ("clock_ns", "<i8"),
    ("lost_before", "<i8"), ("lost_uncertainty", "<i8"), ("adc_ns", "<i8"), ("crc32", "<u4"),
])  # fmt: skip
"""One block. ``lost_before`` counts samples that the device lost between the block before and this one."""

DRIVE_DTYPE = np.dtype([
    ("first_sample", "<i8"), ("n_samples", "<i8"), ("multiple", "<i8"), ("start_re_v", "<f8"),
    ("start_im_v", "<f8"), ("end_re_v", "<f8"), ("end_im_v", "<f8"),
])  # fmt: skip
"""One change of one tone's drive amplitude: complex volts fade from start to end over ``n_samples`` and stay there.

``multiple`` is the tone's, of the forcing frequency; ``first_sample`` counts lost samples too (the device's own index).
"""

CLOCK_DTYPE = np.dtype([
    ("device_sample", "<i8"), ("recorded_sample", "<i8"), ("played_sample", "<f8"), ("uncertainty", "<f8"),
    ("jump", "i1"),
])  # fmt: skip
"""One raw reading: the device's own counter, the same frame counted from the recording's first (lost ones too), its
place among the played samples, and the standard uncertainty. ``jump``: the drive was interrupted before it."""

MAP_DTYPE = np.dtype([
    ("recorded_sample", "<i8"), ("played_sample", "<f8"), ("uncertainty", "<f8"), ("rate", "<f8"),
    ("rate_uncertainty", "<f8"),
])  # fmt: skip
"""The fitted map at one frame (counted from the recording's first, lost ones too): its place among the played samples,
played samples a frame less one (``1e-6``: one part in a million), and their standard uncertainties."""

NOTE_BYTES = 480
NOTE_DTYPE = np.dtype([("first_sample", "<i8"), ("unix_ns", "<i8"), ("text", f"S{NOTE_BYTES}")])
"""A note of the operator: the recorded sample at which it came, the wall clock in nanoseconds since 1970 (UTC), and the
text in UTF-8."""

STEP_NAMES = STEP_DTYPE.names or ()

SIDE_TABLES = {"drive_changes": DRIVE_DTYPE, "clock_readings": CLOCK_DTYPE, "clock_map": MAP_DTYPE, "notes": NOTE_DTYPE}
"""Tables of a recording that only some runs have, by name."""


class BlockFlag(enum.IntFlag):
    """Properties of a block that a back end or the recorder knows."""

    OVERFLOW = 1  # the driver said that input was lost
    UNDERFLOW = 2  # the driver said that output was late
    CLIPPED = 4  # at least one sample at the converter's limit
    FILLED = 8  # samples made up by the device or the driver (zeros, repeats)
    DAMAGED = 16  # the checksum did not fit when the recording was closed or recovered


@dataclass(frozen=True)
class Block:
    """Frames of one exchange with a back end."""

    first_sample: int  # Index, in the recording, of the first frame (recorded frames only; lost ones are not counted)
    codes: NDArray[np.int16]  # raw converter codes, int16 ``(n, channels)``
    flags: int = 0  # `BlockFlag` bits
    clock_ns: int = 0  # monotonic clock when the block was complete, nanoseconds; 0 where there is none
    lost_before: int = 0  # samples lost between the block before and this one
    lost_uncertainty: int = 0  # standard uncertainty of ``lost_before``, in samples (rounded up)
    adc_ns: int = 0  # the device's own time of the first frame, nanoseconds; 0 where it has none
    # place of the first frame among the played samples, where the device knows it (it counts its losses itself, its
    # frames come later, or by another clock); None where it goes on from the block before
    place: int | None = None

    def pieces(self, n: int) -> Iterator[Block]:
        """The block in blocks of at most ``n`` frames; what was lost before it was lost before the first."""
        if len(self.codes) <= n:
            yield self
            return
        for at in range(0, len(self.codes), n):
            part = replace(self, first_sample=self.first_sample + at, codes=self.codes[at : at + n])
            yield part if at == 0 else replace(part, lost_before=0, lost_uncertainty=0, adc_ns=0)


def volts_per_code(range_v: float) -> float:
    """Scale of a 16-bit converter of range ``+-range_v``: code 32768 would be ``range_v``."""
    return range_v / 32768.0


def crc32(array: NDArray[Any], before: int = 0) -> int:
    """CRC-32 of an array's bytes, continuing from ``before``."""
    return zlib.crc32(np.ascontiguousarray(array).data, before)


def note_rows(sample: int, texts: Sequence[str], unix_ns: int) -> NDArray[np.void]:
    """`NOTE_DTYPE` rows of notes that came at ``sample``, at ``unix_ns``; a long one goes on in the next row."""
    rows = []
    for i, text in enumerate(texts):
        left, now_ns = text.replace("\0", ""), unix_ns + i  # the time tells one note from the next
        while True:
            piece = left.encode()[:NOTE_BYTES].decode(errors="ignore")  # cut between two characters
            rows.append((sample, now_ns, piece.encode()))
            left = left[len(piece) :]
            if not left or not piece:
                break
    return np.array(rows, NOTE_DTYPE)


def notes_of_rows(rows: NDArray[np.void]) -> list[tuple[int, int, str]]:
    """Sample, Unix time (ns) and text of each note in `NOTE_DTYPE` rows."""
    notes: list[tuple[int, int, str]] = []
    for row in rows:
        sample, unix_ns, text = int(row["first_sample"]), int(row["unix_ns"]), row["text"].decode(errors="replace")
        if notes and notes[-1][:2] == (sample, unix_ns):
            text = notes.pop()[2] + text
        notes.append((sample, unix_ns, text))
    return notes


def step_row(step: np.void | Mapping[str, Any]) -> NDArray[np.void]:
    """One step as an array of one `STEP_DTYPE` row; raises `ValueError` for a field that no step has.

    In a mapping a missing float is NaN, a missing integer 0 (``ratio`` 1).
    """
    row = np.zeros(1, STEP_DTYPE)
    if not isinstance(step, Mapping):
        row[0] = step
        return row
    if unknown := set(step) - set(STEP_NAMES):
        raise ValueError(f"a step has no field {sorted(unknown)}; it has {list(STEP_NAMES)}")
    for name in STEP_NAMES:
        missing = 1 if name == "ratio" else np.nan if STEP_DTYPE[name].kind == "f" else 0
        row[name] = step.get(name, missing)
    return row


def joined(spans: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    """Ranges ``(first, one past the last)`` in order, those that touch as one."""
    found: list[tuple[int, int]] = []
    for first, last in sorted(spans):
        if found and found[-1][1] >= first:
            found[-1] = (found[-1][0], max(last, found[-1][1]))
        else:
            found.append((first, last))
    return found


@dataclass(frozen=True)
class Holes:
    """Samples of a file that are left where others are gone.

    A hole is a gap like one that the device left: its samples count as lost in the block table, so times and phases
    after it stay what they were.
    """

    left: Integers  # int64 ``(m, 2)``: their ranges, in order

    @classmethod
    def of(cls, lost: Iterable[tuple[int, int]], n_samples: int) -> Holes:
        """The samples that ranges ``lost`` (first, one past the last; in any order) leave of a file."""
        at, rows = 0, []
        for first, last in [*sorted(lost), (n_samples, n_samples)]:
            if first > at and at < n_samples:
                rows.append((at, min(first, n_samples)))
            at = max(at, last)
        return cls(np.array(rows, np.int64).reshape(-1, 2))

    @property
    def starts(self) -> Integers:
        """Beginning of each range among the samples that are left, and their number."""
        return np.concatenate([[0], np.cumsum(self.left[:, 1] - self.left[:, 0])]).astype(np.int64)

    @property
    def n_samples(self) -> int:
        """Samples that are left."""
        return int(self.starts[-1])

    def place(self, sample: Integers) -> Integers:
        """Number of samples that are left before each of the file's samples."""
        k = np.searchsorted(self.left[:, 0], sample, side="right")
        inside = np.minimum(sample, np.append(0, self.left[:, 1])[k]) - np.append(0, self.left[:, 0])[k]
        return np.where(k > 0, np.append(0, self.starts)[k] + inside, 0).astype(np.int64)

    def ranges(self, start: int, stop: int) -> list[tuple[int, int]]:
        """Ranges of the file that hold samples ``start`` to ``stop`` of those that are left."""
        found = []
        for (a, b), at in zip(self.left.tolist(), self.starts.tolist(), strict=False):
            first, last = max(start, at), min(stop, at + b - a)
            if first < last:
                found.append((a + first - at, a + last - at))
        return found

    def steps(self, steps: NDArray[np.void]) -> NDArray[np.void]:
        """The step table of what is left; a step without a sample is gone."""
        rows: NDArray[np.void] = steps.astype(STEP_DTYPE)
        first = steps["first_sample"]
        rows["first_sample"] = self.place(first)
        for name in ("n_samples", "settle_samples", "fade_samples"):
            rows[name] = self.place(first + steps[name]) - rows["first_sample"]
        rows = rows[rows["n_samples"] > 0]
        return rows

    def blocks(self, blocks: NDArray[np.void]) -> NDArray[np.void]:
        """The block table of what is left: a block with a hole in it becomes two, with what is gone between them."""
        if not self.n_samples:
            return np.zeros(0, BLOCK_DTYPE)
        begins = np.unique(np.concatenate([blocks["first_sample"], self.left[:, 0]]))
        k = np.searchsorted(self.left[:, 0], begins, side="right") - 1
        inside = (k >= 0) & (begins < self.left[k, 1])
        begins, k = begins[inside], k[inside]
        of = np.maximum(np.searchsorted(blocks["first_sample"], begins, side="right") - 1, 0)
        rows: NDArray[np.void] = blocks[of].astype(BLOCK_DTYPE)
        ends = np.minimum(np.append(begins[1:], self.left[-1, 1]), self.left[k, 1])
        whole = (blocks["first_sample"][of] == begins) & (blocks["n_samples"][of] == ends - begins)
        rows["first_sample"], rows["n_samples"] = self.place(begins), ends - begins
        rows["crc32"][~whole] = 0
        rows["adc_ns"][blocks["first_sample"][of] != begins] = 0
        gone = begins - rows["first_sample"]
        rows["lost_before"] = np.diff(np.cumsum(blocks["lost_before"])[of] + gone, prepend=0)
        rows["lost_uncertainty"] = np.diff(np.cumsum(blocks["lost_uncertainty"])[of], prepend=0)
        return rows
