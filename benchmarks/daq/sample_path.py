"""What the loss finder does in the sample path, block by block: counted operations, and the part of a block's time.

The drive goes through a noisy loop-back that keeps its phase, loses samples, runs dry or is unplugged, at 48 kHz in
the blocks of a sound card's profile. Counted are the calls that are made and the array elements that are read, in the
thread that hands the blocks over; a call is taken to be a microsecond and an element a nanosecond, which is generous.
The bound, a tenth of a block's time, is asserted on the counts; processor time is printed beside them.

    python -m benchmarks.daq.sample_path
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

import daq.clocks.loss_search
import daq.clocks.sample_loss
from daq.clocks.loss_search import LagFit, PlayedBuffer, Searcher
from daq.clocks.sample_loss import LossDetector
from daq.files.tables import Block, BlockFlag
from daq.setup.clock import SYSTEM

RATE_HZ, FREQUENCY_HZ, BLOCK = 48_000.0, 25.37, 1024
CHUNK = round(1.3 * RATE_HZ / FREQUENCY_HZ)  # as `rig.execution.loss_account.LossAccount` has it
LAG = 1472
PART = 0.1  # of a block's time that the finder may take
CALL_S, ELEMENT_S = 1e-6, 1e-9
FIT_SUMS = 16  # multiplications a frame, in the sums of a fit
CASES = ("clean", "lost", "dry", "unplugged", "storm")


class Caught(Searcher):
    """Searches beside, which this benchmark waits for between blocks: it hands them over faster than a card does."""

    def wait(self) -> None:
        """Until the last search is done."""
        self._future.result()


class Counter:
    """Calls made and array elements read by one thread."""

    def __init__(self) -> None:
        self.calls = self.elements = 0
        self._thread = threading.get_ident()

    def hook(self, frame: object, event: str, argument: object) -> None:
        """For `sys.setprofile`: a Python or C function is called."""
        self.calls += event in ("call", "c_call")

    def reads(self, elements: int) -> None:
        """So many elements were read."""
        if threading.get_ident() == self._thread:
            self.elements += elements

    def cost_s(self) -> float:
        """What it comes to on a slow core."""
        return CALL_S * self.calls + ELEMENT_S * self.elements


@contextmanager
def counted(counter: Counter) -> Iterator[None]:
    """While it lasts, all that walks over samples tells the counter how many."""
    places: list[tuple[Any, str, Callable[..., Any]]] = []

    def wrap(owner: Any, name: str, elements: Callable[..., int]) -> None:
        original = getattr(owner, name)
        places.append((owner, name, original))

        def call(*arguments: Any, **options: Any) -> Any:
            counter.reads(elements(*arguments, **options))
            return original(*arguments, **options)

        setattr(owner, name, call)

    wrap(LagFit, "add", lambda fit, played, heard, first: (FIT_SUMS + 8) * len(heard))
    wrap(PlayedBuffer, "piece", lambda played, start, stop: 2 * abs(stop - start))
    wrap(PlayedBuffer, "add", lambda played, drive_v: 2 * len(drive_v))
    wrap(LossDetector, "_volts", lambda finder: 4 * finder._n_waiting)  # concatenated, its mean, spread and extremes
    wrap(LossDetector, "_settled", lambda finder, *found, **flag: finder._n_waiting + 2 * finder._chunk)
    wrap(
        daq.clocks.loss_search,
        "candidates",
        lambda played, heard, first, low, high, gain: 60 * (high - low + len(heard)),
    )
    try:
        yield
    finally:
        for owner, name, original in places:
            setattr(owner, name, original)


def loop_back(case: str, seconds: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Drive as played, as heard, which frames of it arrive, and the flags of each block."""
    rng = np.random.default_rng(seed)
    n = int(seconds * RATE_HZ)
    t = np.arange(n) / RATE_HZ
    played = np.sin(2 * np.pi * FREQUENCY_HZ * t) * np.minimum(t, 1.0)
    heard = np.concatenate([np.zeros(LAG), 0.98 * played])[:n] + 2e-4 * rng.standard_normal(n)
    kept = np.arange(n)
    flags = np.zeros(n // BLOCK + 1, np.int64)
    third, half = n // 3, n // 2
    if case == "lost":
        kept = np.concatenate([kept[:third], kept[third + 777 :]])
    if case in ("dry", "storm"):
        for at in [third] if case == "dry" else range(third, half, 4096):
            heard[at : at + 700] = 2e-4 * rng.standard_normal(700)
            flags[at // BLOCK : at // BLOCK + 2] = BlockFlag.UNDERFLOW if case == "dry" else 0
    if case == "unplugged":
        heard[third:half] = 2e-4 * rng.standard_normal(half - third)
    return played, heard, kept, flags


def follow(case: str, seconds: float = 12.0, seed: int = 1, *, count: bool = True) -> dict[str, Any]:
    """One loop-back through a finder that searches beside: cost of each block, and what was declared.

    Returns
    -------
    dict
        ``worst`` and ``mean``: counted cost over the block's time; ``spent``: processor time of the thread over it;
        ``lost``: samples declared as lost, ``place`` of the first loss; ``filled``: flagged frames, ``last_filled``
        the last of them; ``n``: frames given back.
    """
    played, heard, kept, flags = loop_back(case, seconds, seed)
    counter = Counter()
    searcher = Caught(SYSTEM.executor("search"))
    finder = LossDetector(RATE_HZ, CHUNK, searcher)
    finder.expect(LAG)
    parts, blocks, spent_s = [], [], 0.0
    with counted(counter):
        for k, first in enumerate(range(0, len(played) - BLOCK, BLOCK)):
            here = heard[kept[first : first + BLOCK]]
            codes = np.zeros((len(here), 3), np.int16)
            counter.calls = counter.elements = 0
            began = time.thread_time()
            if count:
                sys.setprofile(counter.hook)
            finder.played(played[first : first + BLOCK])
            blocks += finder.heard(Block(first, codes, flags=int(flags[k])), here)
            sys.setprofile(None)
            spent_s += time.thread_time() - began
            parts.append(counter.cost_s() * RATE_HZ / BLOCK)
            searcher.wait()
    blocks += finder.flush()
    losses = [block for block in blocks if block.lost_before]
    filled = [block for block in blocks if block.flags & BlockFlag.FILLED]
    return {
        "worst": max(parts),
        "mean": float(np.mean(parts)),
        "spent": spent_s * RATE_HZ / len(played),
        "lost": sum(block.lost_before for block in losses),
        "place": losses[0].first_sample if losses else -1,
        "filled": sum(len(block.codes) for block in filled),
        "last_filled": max((block.first_sample + len(block.codes) for block in filled), default=-1),
        "n": sum(len(block.codes) for block in blocks),
    }


def require(seen: dict[str, Any], case: str) -> None:
    """Raise `ValueError` where a block took more than its share."""
    if seen["worst"] > PART:
        raise ValueError(f"{case}: a block took {seen['worst']:.3f} of its time in counted work; allowed {PART:g}")


def main() -> None:
    """Every case, and its part of a block's time."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=12.0)
    options = parser.parse_args()
    print("case        worst block   mean     processor   lost at        made up, last")
    for case in CASES:
        seen = follow(case, options.seconds)
        spent = follow(case, options.seconds, count=False)["spent"]
        print(
            f"{case:10s}  {seen['worst']:9.2%}   {seen['mean']:6.2%}   {spent:7.2%}   {seen['lost']:5d} "
            f"{seen['place']:7d}   {seen['filled']:6d} {seen['last_filled']:7d}"
        )
        require(seen, case)
    print(f"of a block's time ({1e3 * BLOCK / RATE_HZ:.1f} ms); allowed {PART:.0%}, counted")


if __name__ == "__main__":
    main()
