"""How many times faster than real time the simulated rig runs, with fresh noise; goal: 1000.

    python -m benchmarks.rig.simulated_rig [--seconds 60] [--repeats 5]

One sine of 25.37 Hz at 20 kHz, in blocks of 1024 samples as a run has, three channels out. Each row is the fastest of
the repeats in process time: the machine may be shared.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from pathlib import Path

import numpy as np

from rig.sim.plant import Plant
from rig.sim.scenario import EFFECTS, Scenario

RATE_HZ = 20000.0
BLOCK = 1024


def scenarios() -> dict[str, Scenario]:
    """The rigs timed: ideal, the paper's, one with many forces, one with everything."""

    def middle(*names: str) -> dict[str, dict[str, float]]:
        return {name: {p.name: 0.5 * sum(p.strong) for p in EFFECTS[name].parameters} for name in names}

    forces = ("viscous_damping", "quadratic_drag", "position_force", "stribeck_friction", "table_resonance")
    return {
        "ideal": Scenario("ideal"),
        "friction 0.3, restitution 0.514": Scenario(
            "paper", {"coulomb_friction": {"mu_up": 0.3, "mu_down": 0.3}, "restitution": {"e0": 0.514}}
        ),
        "five forces": Scenario("forces", middle(*forces)),
        f"all {len(EFFECTS)} effects": Scenario("all", middle(*EFFECTS)),
    }


def times_real_time(scenario: Scenario, gamma_peak: float, seconds: float, repeats: int) -> float:
    """Seconds simulated for each second of process time, the best of several runs."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    volts = -0.5 * gamma_peak * np.sin(2.0 * math.pi * 25.37 * t) * np.minimum(t, 1.0)
    blocks = np.split(volts, range(BLOCK, t.size, BLOCK))
    best = math.inf
    for seed in range(repeats):
        plant = Plant(scenario, RATE_HZ, np.random.default_rng(seed))
        began = time.process_time()
        for block in blocks:
            plant.exchange(block)
        best = min(best, time.process_time() - began)
    return seconds / best


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", type=Path, help="also write the figures here")
    args = parser.parse_args()
    Plant(Scenario("warm"), RATE_HZ, np.random.default_rng(0)).exchange(np.zeros(BLOCK))
    rows = {}
    print(f"{'rig':34s} {'gamma_peak 0.9':>15s} {'3':>8s} {'5':>8s}   times real time")
    for name, scenario in scenarios().items():
        rows[name] = [times_real_time(scenario, gamma, args.seconds, args.repeats) for gamma in (0.9, 3.0, 5.0)]
        print(f"{name:34s} {rows[name][0]:15.0f} {rows[name][1]:8.0f} {rows[name][2]:8.0f}")
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
