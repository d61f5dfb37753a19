"""Lose samples on purpose and count: found, count right, false alarms.

Each run plays a ramp of steps, hears it back with a latency, a gain, noise and 16-bit codes, and loses 1 to 5000
samples at a random place; as many runs lose nothing. The clock beside the blocks is late by up to 20 ms at random.

    python -m benchmarks.daq.losses --runs 100
"""

from __future__ import annotations

import argparse

import numpy as np

from daq.clocks.sample_loss import LossDetector
from daq.files.tables import Block

RATE_HZ = 20_000.0
BLOCK = 1024


def drive(rng: np.random.Generator, ratio: int, seconds: float) -> np.ndarray:
    """Commanded volts: steps of random level, faded into each other."""
    n = int(seconds * RATE_HZ)
    frequency = float(rng.uniform(20, 40))
    knots = np.arange(0, n + 8000, 8000)
    level = np.interp(
        np.arange(n),
        np.sort(np.r_[knots, knots + 1500])[: 2 * len(knots)],
        np.repeat(np.r_[0.0, rng.uniform(0.3, 1.5, len(knots))], 2)[1 : 2 * len(knots) + 1],
    )
    phase = 2 * np.pi * frequency / RATE_HZ * np.arange(n)
    return level * (np.sin(phase) + (0.5 * np.sin(ratio * phase) if ratio > 1 else 0.0))


def run(rng: np.random.Generator, lost: int, ratio: int, seconds: float = 6.0) -> list[tuple[int, int, int]]:
    """What the finder declares, ``(first sample after, lost, uncertainty)``; first entry is the truth."""
    played = drive(rng, ratio, seconds)
    latency = float(rng.uniform(20, 2000))
    n = len(played)
    heard = 0.98 * np.interp(np.arange(n) - latency, np.arange(n), played) + 0.003 + rng.normal(0, 2e-4, n)
    codes = np.rint(heard / 10 * 32768).astype(np.int16)
    at = int(rng.integers(20_000, n - 30_000))
    kept = np.r_[0:at, at + lost : n]
    finder = LossDetector(RATE_HZ)
    found: list[tuple[int, int, int]] = [(at, lost, 0)]
    blocks: list[Block] = []
    start = 0
    for i in range(0, n, BLOCK):
        finder.played(played[i : i + BLOCK])
        stop = int(np.searchsorted(kept, i + BLOCK))  # what the device has to give by then
        if stop <= start:
            continue
        frames = np.repeat(codes[kept[start:stop]][:, None], 3, axis=1)
        clock = int((i + BLOCK) / RATE_HZ * 1e9 + rng.exponential(2e6) + 1)
        blocks += finder.heard(Block(start, frames, clock_ns=clock), frames[:, 2] * (10 / 32768))
        start = stop
    blocks += finder.flush()
    return found + [(b.first_sample, b.lost_before, b.lost_uncertainty) for b in blocks if b.lost_before]


def arguments(title: str) -> argparse.Namespace:
    """``runs`` and ``seed`` of the command line."""
    parser = argparse.ArgumentParser(description=title)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


def drawn_loss(rng: np.random.Generator) -> int:
    """Number of lost samples, 1 to 5000, log-uniform."""
    return int(np.exp(rng.uniform(0, np.log(5000.999))))


def main() -> None:
    """Run and print the score."""
    options = arguments(__doc__.splitlines()[0])
    rng = np.random.default_rng(options.seed)
    found = right = alarms = 0
    worst = 0
    for i in range(options.runs):
        lost = drawn_loss(rng)
        (at, lost, _), *declared = run(rng, lost, 1 + i % 3)
        total = sum(n for _, n, _ in declared)
        found += bool(declared)
        good = len(declared) == 1 and abs(total - lost) <= 1
        right += good
        if good:
            worst = max(worst, abs(declared[0][0] - at))
        else:
            print(f"  run {i}: lost {lost} at {at}, declared {declared}")
        alarms += bool(run(rng, 0, 1 + i % 3)[1:])
    print(
        f"losses of 1 to 5000 samples: found {found}/{options.runs}, count right to 1 sample {right}/{options.runs}, "
        f"place off by at most {worst} samples"
    )
    print(f"clean runs with a false alarm: {alarms}/{options.runs}")


if __name__ == "__main__":
    main()
