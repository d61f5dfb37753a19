"""Flights a second on a CUDA device, and each against the processor's: ``python -m benchmarks.model.cuda_device``.

Single flights from rest and from a rebound, with friction, at random gammas; and whole orbits until they close. Says in
one sentence where there is no device. Wall time of the second launch: the first compiles.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from kernels.device import NoDevice, require_device
from model.flight import first_landing
from model.flight.friction import edge_tables, land_with_friction
from model.flight.records import FrictionRestitution
from model.tones import Forcing


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=10_000_000)
    parser.add_argument("--checked", type=int, default=100_000, help="flights compared with the processor's")
    options = parser.parse_args()
    try:
        require_device()
    except NoDevice as error:
        print(error, file=sys.stderr)
        return 2
    from model.surveys import cuda_batch

    rng = np.random.default_rng(1)
    for c in (1, 2, 3):
        forcing, m = Forcing.superposition(c), options.flights
        mu = rng.uniform(0.0, 0.3, m)
        gammas, laws = rng.uniform(1.2, 5.0, m), np.column_stack([mu, mu, np.zeros(m), np.zeros(m)])
        starts = np.zeros((m, 3))  # from rest at the first threshold
        for _ in range(2):
            began = time.perf_counter()
            landed = cuda_batch.landings(forcing, gammas, laws, starts)
            took = time.perf_counter() - began
        turning, wrong, flagged = first_landing.turning_points(forcing), 0, 0
        for row in range(options.checked):
            law = FrictionRestitution(*laws[row])
            tables = edge_tables(forcing.tones, turning, gammas[row], law)
            here = land_with_friction(forcing.tones, gammas[row], tables, law, tables.up[0], 0.0, True)
            if here[3] or landed[row, 3]:
                flagged += 1
            elif np.any(np.abs(landed[row, :3] - here[:3]) > 1e-12 * (1.0 + np.abs(here[:3]))):
                wrong += 1
        began = time.perf_counter()
        outcome, _ = cuda_batch.cycles(forcing, gammas[:100_000], laws[:100_000], 1)
        orbits = time.perf_counter() - began
        print(
            f"c = {c}: {m / took / 1e6:.1f} M flights/s with tables and copying, {wrong} of {options.checked} differ "
            f"by more than 1e-12, {flagged} flagged; {1e6 * orbits / 100_000:.2f} us an orbit until it closes, "
            f"{int((outcome[:, 0] < 0).sum())} of 100000 left open"
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
