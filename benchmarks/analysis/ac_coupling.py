"""Contact edges behind a coupling capacitor: how many of a thousand are found, and how many are found that are none.

The simulated rig's continuity voltage (its ball, its circuit, its converter) goes through a high-pass and gets noise;
the truth is what the detector finds in the same voltage on a wire, without noise.

    python -m benchmarks.analysis.ac_coupling
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from scipy.signal import lfilter

from analysis.events.ac_coupling import LevelRestorer, measure_coupling
from analysis.events.edges import Edges, time_edges
from analysis.events.levels import CLOSES, DIP, OPENS, CrossingScan, measure_levels
from analysis.signals import PAD, PIECE, Piece
from rig.sim.plant import Plant
from rig.sim.scenario import Scenario

RATE_HZ, SWING_V = 20000.0, 5.0
NEAR_S = 2e-4  # an edge further from every true one is false


def high_pass(x: np.ndarray, corner_hz: float) -> np.ndarray:
    """One pole, settled on the first sample."""
    decay = np.exp(-2.0 * np.pi * corner_hz / RATE_HZ)
    low, _ = lfilter([1.0 - decay], [1.0, -decay], x, zi=[decay * x[0]])
    return x - np.concatenate([x[:1], low[:-1]])


def pieces_of(volts: np.ndarray) -> list[Piece]:
    """The signal as the analysis reads it."""
    out = []
    for first in range(0, volts.size, PIECE):
        count = min(PIECE, volts.size - first)
        index = np.clip(np.arange(first - PAD, first + count + PAD), 0, volts.size - 1)
        out.append(Piece(first, count, {"continuity": volts[index].astype(np.float32)}))
    return out


def wired(volts: np.ndarray) -> Edges:
    """Edges on a wire."""
    levels = measure_levels(volts, 0.0, SWING_V)
    scan = CrossingScan(levels)
    for piece in pieces_of(volts):
        fraction = (piece.channels["continuity"] - np.float32(levels.closed_v)) / np.float32(levels.swing_v)
        scan.add(fraction, piece.first, PAD, piece.count)
    return time_edges(scan.crossings(), levels, RATE_HZ)[0]


def coupled(volts: np.ndarray) -> tuple[Edges, float, int]:
    """Edges behind the high-pass, the corner that was found, and how many edges were declared missed."""
    pieces = pieces_of(volts)
    coupling = measure_coupling([p.own("continuity").astype(np.float64) for p in pieces[::3]], SWING_V, RATE_HZ)
    restorer, scan = LevelRestorer(coupling, RATE_HZ), CrossingScan(coupling.levels)
    for piece in pieces:
        scan.add(restorer.restore(piece), piece.first, PAD, piece.count)
    edges = time_edges(scan.crossings(), coupling.levels, RATE_HZ)[0]
    return edges, coupling.corner_hz, len(restorer.missed)


def score(found: Edges, true: Edges) -> dict[str, float]:
    """Edges found and falsely found per thousand true ones, and the error of their times."""
    hits, false, errors = 0, 0, []
    for kind in (OPENS, CLOSES):
        own, wanted = found.time_s[found.kind == kind], true.time_s[true.kind == kind]
        place = np.searchsorted(own, wanted)
        around = np.stack([np.clip(place - 1, 0, own.size - 1), np.clip(place, 0, own.size - 1)])
        nearest = around[np.abs(own[around] - wanted).argmin(axis=0), np.arange(wanted.size)]
        near = np.abs(own[nearest] - wanted) < NEAR_S
        used = np.unique(nearest[near]).size
        hits, false = hits + used, false + own.size - used
        errors.append((own[nearest] - wanted)[near])
    n = int(np.count_nonzero(true.kind != DIP))
    error = np.concatenate(errors)
    return {
        "edges": n, "found per 1000": round(1000 * hits / n, 2), "false per 1000": round(1000 * false / n, 2),
        "rms error us": round(float(np.sqrt(np.mean(error**2))) * 1e6, 2),
    }  # fmt: skip


def signal(scenario: str, ratio: int, seconds: float, seed: int) -> np.ndarray:
    """Continuity volts of a ramp through every kind of flight."""
    plant = Plant(Scenario(scenario) if scenario == "ideal" else bouncing(), RATE_HZ, np.random.default_rng(seed))
    t = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    size = np.linspace(0.4, 1.4 if ratio == 1 else 0.8, t.size) / (1 if ratio == 1 else ratio)
    second = ratio**2 * np.sin(2 * np.pi * ratio * 25.37 * t) if ratio > 1 else 0.0
    drive = size * (np.sin(2 * np.pi * 25.37 * t) + second)
    return plant.exchange(drive)[:, 0] * plant.channel_scales["continuity"]


def bouncing() -> Scenario:
    """A rig whose contacts bounce."""
    return Scenario("bounce", rig={"bounce_s": 1e-3})


def main() -> int:
    """Print one line for each corner, forcing and circuit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--noise", type=float, default=0.02, help="standard deviation, of the swing")
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    for scenario, ratio in (("ideal", 1), ("ideal", 3), ("bounce", 1)):
        volts = signal(scenario, ratio, options.seconds, seed=1)
        true = wired(volts)
        noise_v = options.noise * SWING_V * rng.standard_normal(volts.size)
        print(f"{scenario}, c = {ratio}, on a wire: {score(wired(volts + noise_v), true)}")
        for corner_hz in (2.0, 8.0, 20.0):
            edges, corner_found_hz, missed = coupled(high_pass(volts, corner_hz) + noise_v)
            print(f"  {corner_hz:g} Hz (found {corner_found_hz:.2f}), declared missed {missed}: {score(edges, true)}")
        twice = high_pass(high_pass(volts, 5.0), 2.0) + noise_v
        edges, corner_found_hz, missed = coupled(twice)
        print(f"  5 and 2 Hz (found {corner_found_hz:.2f}), declared missed {missed}: {score(edges, true)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
