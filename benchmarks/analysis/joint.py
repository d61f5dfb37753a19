"""Joint verdicts over short runs of the other plant, whose calibrations differ every time; memory and processor time.

    python -m benchmarks.analysis.joint --runs 10 --seed 1 --hide viscous_damping.rate_per_s=0.05 --alone

``--alone`` closes the loop on each run by itself as well. ``--latency-us`` states how well the delay of the contact
circuit is known; 2 where nobody states it.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from analysis.joint.join_runs import join_runs
from analysis.loop.close_loop import close_loop
from benchmarks.plants import other_plant as plant
from benchmarks.plants.handed_over import imported
from benchmarks.spent import peak_mb

SPREADS = {"drive_gain.relative": 0.004, "accelerometer_gain.relative": 0.0025, "phase_lag.delay_s": 1e-5}
"""From run to run, standard deviations: half of what the profile states, or somewhat less."""


def short_runs(
    folder: Path, runs: int, seed: int, hidden: Mapping[str, float], latency_us: float | None = None
) -> list[Path]:
    """Recordings of ten steps, of one rig whose calibrations are others every time.

    ``latency_us`` is what the profile states of the contact circuit's delay, one standard deviation about zero.
    """
    rng = np.random.default_rng(seed)
    out = []
    for i in range(runs):
        own = {name: spread * rng.standard_normal() for name, spread in SPREADS.items()}
        gammas = tuple(np.round(np.linspace(0.6, 2.2, 10), 4).tolist())
        run = plant.Run(gammas=gammas, seed=int(rng.integers(2**31)), hidden={**own, **hidden})
        profile, where = plant.profile_of(run), folder / f"run{i}"
        if latency_us is not None:
            known = f"delay_s = {{ value = 0.0, uncertainty = {1e-6 * latency_us}, source = 'two edges on a scope' }}"
            profile += f"\n[declared.contact_latency]\n{known}\n"
        where.mkdir(parents=True)
        path = imported(plant.simulate(run), profile, where)
        (where / "recording.npz").unlink()
        out.append(path)
    return out


def main() -> None:
    """Print the joint verdict, and those of single runs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--hide", action="append", default=[], metavar="EFFECT.KEY=SIZE")
    parser.add_argument("--latency-us", type=float, default=None)
    parser.add_argument("--alone", action="store_true")
    args = parser.parse_args()
    hidden = {name: float(size) for name, _, size in (one.partition("=") for one in args.hide)}
    with tempfile.TemporaryDirectory() as name:
        paths = short_runs(Path(name), args.runs, args.seed, hidden, args.latency_us)
        began = time.process_time()
        found = join_runs(paths)
        seconds = (time.process_time() - began) / len(paths) / found.passes
        print(f"seed {args.seed}, {args.hide or 'nothing hidden'}: {found.verdict} {found.names}, ties {found.ties}")
        print(f"  {found.passes} passes, {seconds:.2f} processor s a run and pass, at most {peak_mb():.0f} MB")
        for line in found.rounds:
            print(f"  {line}")
        for error in found.systematics:
            print(f"  {error.name}: {error.value_us:.1f} +- {error.sigma_us:.1f} us, prior {error.prior_us:.1f} us")
        for x in found.parameters:
            if x.kind == "effect":
                smallest = min(x.sigmas)
                print(
                    f"  {x.effect}.{x.parameter} = {x.value:.3g} +- {x.sigma:.2g}; the best run alone +- {smallest:.2g}"
                )
        for path in paths if args.alone else ():
            loop = close_loop([path])
            print(f"  {path.parent.name} alone: {loop.verdict} {loop.selection.names}, ties {loop.selection.ties}")


if __name__ == "__main__":
    main()
