"""Samples of a recording that are gone, as gaps: what is left, and its tables.

A hole is a gap like one that the device left. Its samples count as lost in the block table, so times and phases after
it stay what they were.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.files.tables import BLOCK_DTYPE, STEP_DTYPE
from kernels.arrays import Integers


@dataclass(frozen=True)
class Holes:
    """Samples of a file that are left."""

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
