"""Resonances of the other plant, identified from recorded volts and, with ``--loop``, by the closed loop.

    python -m benchmarks.analysis.ringing --seed-base 4000 --trials 100
    python -m benchmarks.analysis.ringing --seed-base 5000 --trials 200 --without
    python -m benchmarks.analysis.ringing --seed-base 4000 --trials 10 --loop

Frequencies are drawn from 1.5 to 12 Hz, damping from .01 to .3, mass ratio from .02 to .3; friction, restitution, c
and the instrument, too. A line a trial: hidden, found, standard deviations, processor seconds; with ``--loop`` the
verdict, what it names in addition to the hidden causes or misses, and at the end how many are right.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from analysis.flights.assemble import FlightFlag, flights_of
from analysis.loop.close_loop import judge_loop
from analysis.plate.ringing.modes import identified_mode
from analysis.plate.ringing.regression import PlateMode
from benchmarks.plants import other_plant
from benchmarks.plants.handed_over import imported
from benchmarks.plants.instrument import Instrument
from benchmarks.scoring.truth import OTHER_NAMED, OTHER_PARAMETERS
from daq.recording import open_recording

GAMMAS = {1: (0.5, 2.6), 2: (0.2, 1.5)}
STEPS = 27
INSTRUMENTAL = frozenset({"accelerometer_lag", "mains_pickup", "accelerometer_offset"})  # of the instruments below
INSTRUMENTS: tuple[dict[str, float], ...] = (
    {}, {"pulse": 1}, {"low_pass_hz": 5e3}, {"bias_v": 0.01}, {"mains_v": 0.005, "mains_odd": 0.5}, {"film_v": 0.05},
)  # fmt: skip


def drawn(seed: int, *, without: bool) -> other_plant.Run:
    """A run, with a resonance or without one."""
    rng = np.random.default_rng(seed)
    c = int(rng.choice((1, 2)))
    names, bounds = ("hz", "damping", "ratio"), ((1.5, 12.0), (0.01, 0.3), (0.02, 0.3))
    values = {
        f"table_resonance.{k}": float(np.exp(rng.uniform(*np.log(b)))) for k, b in zip(names, bounds, strict=True)
    }
    hidden = {} if without else values
    if rng.random() < 0.5:
        hidden["coulomb_friction.mu"] = float(rng.uniform(0.01, 0.06))
    if rng.random() < 0.5:
        hidden["restitution.e0"] = float(rng.uniform(0.1, 0.4))
    gammas = rng.permutation(np.round(np.linspace(*GAMMAS[c], STEPS), 4))
    parts = INSTRUMENTS[int(rng.integers(len(INSTRUMENTS)))]
    return other_plant.Run(
        c=c, gammas=tuple(gammas.tolist()), seed=seed, hidden=hidden, instrument=Instrument(**parts),
        closure_s=float(rng.choice((1e-4, 5e-4))), reads_gravity=bool(rng.random() < 0.5), bits=16,
    )  # fmt: skip


def found_in(path: Path) -> tuple[PlateMode | None, float]:
    """The mode that recorded volts show, and processor seconds of its identification."""
    with open_recording(path) as recording:
        flights = flights_of(recording)
        true, start = flights.select(~flights.has(FlightFlag.FALSE)), time.process_time()
        mode = identified_mode(recording, true.takeoff_s, true.landing_s, flights.edges.ringing_s).mode
        return mode, time.process_time() - start


@dataclass(frozen=True)
class Closed:
    """A verdict held against what is hidden: names, landings over their floor, errors of values in sigmas, seconds."""

    verdict: str
    names: tuple[str, ...]
    hidden: frozenset[str]
    landing_us: float
    floor_us: float
    sigmas: tuple[float, ...]
    seconds: float

    @property
    def right(self) -> bool:
        """Whether exactly the hidden causes are named; instruments may be named with them."""
        return self.hidden == set(self.names) - INSTRUMENTAL

    @property
    def explained(self) -> bool:
        """Whether landings are missed by no more than 1.3 floors."""
        return self.verdict != "unexplained" and self.landing_us < 1.3 * self.floor_us

    def line(self) -> str:
        """In one line."""
        z = " ".join(f"{x:+.1f}" for x in self.sigmas)
        names = " + ".join(self.names) + ("" if self.right else " (wrong)")
        errors = f"{self.landing_us:.1f} / {self.floor_us:.1f} us"
        return f"{self.verdict}: {names}, {errors}, [{z}] sigmas, {self.seconds:.0f} s"


def judged(path: Path, run: other_plant.Run) -> Closed:
    """The loop closed on a recording."""
    start = time.process_time()
    loop, _ = judge_loop([path])
    spent_s = time.process_time() - start
    found = {(p.effect, p.parameter): p for p in loop.selection.parameters if p.added}
    true = {(e, q): run.hidden[k] * f for k in run.hidden for e, q, f in OTHER_PARAMETERS.get(k, ())}
    true["table_resonance", "damping"] = run.hidden.get("table_resonance.damping", 0.0)
    sigmas = [(found[k].value - v) / found[k].sigma for k, v in true.items() if k in found]
    hidden = frozenset(OTHER_NAMED[k.split(".")[0]] for k in run.hidden)
    errors = (loop.errors.after.landing_rms_us or 0.0, loop.errors.landing_floor_us)
    return Closed(loop.verdict, loop.selection.names, hidden, *errors, tuple(sigmas), spent_s)


def main() -> None:
    """Print a line a trial, then how many are near enough."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--seed-base", type=int, default=4000)
    options.add_argument("--trials", type=int, default=20)
    options.add_argument("--without", action="store_true", help="no resonance is hidden")
    options.add_argument("--loop", action="store_true", help="close the loop, too")
    args = options.parse_args()
    errors, sigmas, seconds, named = [], [], [], 0
    closed: list[Closed] = []
    for seed in range(args.seed_base, args.seed_base + args.trials):
        run = drawn(seed, without=args.without)
        truth = np.array([run.hidden.get(f"table_resonance.{k}", np.nan) for k in ("hz", "damping", "ratio")])
        with tempfile.TemporaryDirectory() as folder:
            path = imported(other_plant.simulate(run), other_plant.profile_of(run), Path(folder))
            mode, spent_s = found_in(path)
            closed += [judged(path, run)] if args.loop else []
            verdict = closed[-1].line() if closed else ""
        seconds.append(spent_s)
        named += mode is not None
        if mode is None:
            print(seed, dict(run.hidden), "none", f"{spent_s:.1f} s", verdict, flush=True)
            continue
        found = np.array([mode.frequency_hz, mode.damping, mode.mass_ratio])
        relative = np.array(found / truth - 1.0)
        errors.append(relative)
        sigmas.append((found - truth) / np.array(mode.sigmas()))
        other = {k: round(v, 3) for k, v in run.hidden.items() if "table" not in k}
        print(seed, truth.round(4), found.round(4), (100 * relative).round(1), "%", sigmas[-1].round(1), "sigmas")
        further = "" if mode.second is None else f", a second mode of {mode.second.frequency_hz:.2f} Hz"
        print(
            f"     c={run.c} {other} {mode.before_mps2:.3f} -> {mode.remainder_mps2:.3f} m/s^2, {spent_s:.1f} s",
            f"{further} {verdict}",
        )
    print(f"{named} of {args.trials} found; processor s: median {np.median(seconds):.1f}, worst {max(seconds):.1f}")
    if errors and not args.without:
        size, z = np.abs(errors), np.abs(sigmas)
        near = (size <= [0.01, 0.15, 0.03]) | ((z <= 2.0) & np.array([False, False, True]))
        print("frequency to 1 %, damping to 15 %, mass ratio to 3 % or two sigmas:", near.sum(axis=0))
        print("all three:", near.all(axis=1).sum(), "; within 1.96 sigmas:", np.mean(z < 1.96, axis=0).round(2))
        print("median size of the error, %:", (100 * np.median(size, axis=0)).round(2))
    if closed:
        spent = [x.seconds for x in closed]
        z = np.array([v for x in closed if x.right for v in x.sigmas])
        print(f"loop: names right {sum(x.right for x in closed)}, explained {sum(x.explained for x in closed)}, both")
        print(f"{sum(x.right and x.explained for x in closed)} of {len(closed)}; values within 1.96 sigmas:", end=" ")
        print(f"{np.sum(np.abs(z) < 1.96)} of {len(z)}; s: median {np.median(spent):.0f}, worst {max(spent):.0f}")


if __name__ == "__main__":
    main()
