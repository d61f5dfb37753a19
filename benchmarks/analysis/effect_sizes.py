"""How far each hidden effect moves the next landing and take-off: what the strengths of sealed scenarios rest on.

    python -m benchmarks.analysis.effect_sizes [--share 0.03]

A rig with one effect at a share of the middle of its strong range runs up a ramp (one sine, gamma_peak 1 to 5.2). After
each impact two copies go on from that very state to the next impact, one with the effect and one without. Printed are
the robust (1.48 median absolute) differences in microseconds for each hundredth of the middle of the strong range,
beside the catalogue's unit. Effects of a sensor alone, and rebounds, which change the state after the impact itself,
move nothing here; their units are set by hand: as easily seen, in their own channel, as that many microseconds.
"""

from __future__ import annotations

import argparse
import math

import numpy as np

from kernels import njit
from rig.sim.instrument import SECTIONS, sections
from rig.sim.plant import CHANNELS, _run
from rig.sim.scenario import EFFECTS, RIG_DEFAULTS, EffectEntry, Scenario
from rig.sim.state import initial_state

N_CHANNELS = len(CHANNELS)
RATE_HZ = 20000.0
SECONDS = 30.0
REBOUND_FREE_MPS = 0.02
"""Impacts that are followed by a faster rebound are left out: what follows is another bounce, not the next flight."""


@njit()
def _to_next_impact(start, params, drift, taps, drive_v, at, dt_s, volts, noise):
    """Landing and take-off of the next flight from a copy of a state."""
    state, memory = start.copy(), np.zeros((SECTIONS, 2))
    seen = state[0].impacts
    k = at
    while k < drive_v.size and state[0].impacts == seen:
        _run(state, params, drift, taps, memory, drive_v[k : k + 1], noise, dt_s, volts)
        k += 1
    return state[0].landed_s, state[0].left_s


@njit()
def _differences(state, params, drift, ideal, taps, drive_v, dt_s, out):
    """Run with the effect; at each impact compare the next flight with and without it."""
    noise, volts, memory = np.zeros((1, 1), np.float32), np.zeros((1, N_CHANNELS)), np.zeros((SECTIONS, 2))
    n = 0
    for k in range(drive_v.size - 4000):
        seen = state[0].impacts
        _run(state, params, drift, taps, memory, drive_v[k : k + 1], noise, dt_s, volts)
        if state[0].impacts == seen or state[0].speed_mps > REBOUND_FREE_MPS or n == out.shape[0]:
            continue
        with_it = _to_next_impact(state, params.copy(), drift, taps, drive_v, k + 1, dt_s, volts, noise)
        without = _to_next_impact(state, ideal, drift[:0], taps, drive_v, k + 1, dt_s, volts, noise)
        out[n, 0], out[n, 1] = with_it[0] - without[0], with_it[1] - without[1]
        n += 1
    return n


def size_us(entry: EffectEntry, share: float, drive_v: np.ndarray) -> tuple[float, float, int]:
    """Robust landing and take-off differences in microseconds at ``share`` of the strong middle, and their number."""
    table = {p.name: 0.5 * sum(p.strong) * (share if p.scales else 1.0) for p in entry.parameters}
    params, drift = Scenario("one", {entry.name: table}).parameters()
    ideal, _ = Scenario("none").parameters()
    out = np.zeros((5000, 2))
    taps = sections({key: float(ideal[key][0]) for key in RIG_DEFAULTS}, RATE_HZ)
    n = _differences(initial_state(1, 2, -1.0 / RATE_HZ), params, drift, ideal, taps, drive_v, 1.0 / RATE_HZ, out)
    robust = 1.48e6 * np.median(np.abs(out[:n]), axis=0)
    return float(robust[0]), float(robust[1]), n


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--share", type=float, default=0.03)
    args = parser.parse_args()
    t = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    drive_v = -0.5 * np.interp(t, [0.0, 1.0, SECONDS], [0.0, 1.0, 5.2]) * np.sin(2.0 * math.pi * 25.37 * t)
    print(f"{'effect':26s} {'landing':>9s} {'take-off':>9s} {'catalogue':>10s} {'flights':>8s}   us a hundredth")
    for name, entry in EFFECTS.items():
        landing, takeoff, n = size_us(entry, args.share, drive_v)
        per = 0.01 / args.share
        print(f"{name:26s} {per * landing:9.2f} {per * takeoff:9.2f} {entry.unit_us:10.1f} {n:8d}", flush=True)


if __name__ == "__main__":
    main()
