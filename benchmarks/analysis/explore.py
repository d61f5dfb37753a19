"""Rig seconds to a verdict: steps chosen by information, steps drawn by chance, and the standard ramp, on sealed rigs.

    python -m benchmarks.analysis.explore RESULTS --rigs 40 --seed-base 5000 [--plant other] [--minutes 60]
    python -m benchmarks.analysis.explore RESULTS --show

Every strategy meets the same sealed rigs. The ramp is judged once, when it is over; a strategy that chooses stops by
itself, at the ramp's rig time at the latest. One rig in five hides nothing.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.jobs.blocks import Aims, Chosen, Driven, by_person, offers, run_seconds
from bench.jobs.explore import Drive, Explored, explore
from benchmarks.plants import other_plant
from benchmarks.scoring.truth import OTHER_NAMED
from daq.files.journal import Journal
from rig.execution.operator import NextSteps
from rig.profile import parse_profile

STRATEGIES = ("chosen", "random", "ramp")


def rig(plant: str, seed: int, folder: Path) -> tuple[str, tuple[str, ...], Drive]:
    """A sealed rig: its profile, the names that are right, and what drives it."""
    rng = np.random.default_rng(seed)
    nothing = rng.random() < 0.2
    return (_other if plant == "other" else _own)(rng, nothing, seed, folder)


def _own(rng: np.random.Generator, nothing: bool, seed: int, folder: Path) -> tuple[str, tuple[str, ...], Drive]:
    """The simulated rig with an effect drawn by chance."""
    from bench.profiles.find import load
    from rig.sim.blind_scenarios import pool, sealed_scenario

    scenario = sealed_scenario(rng, pool("named"), strength="strong", count=0 if nothing else 1)
    sealed = folder / "sealed.toml"
    sealed.write_text(scenario.to_toml(), encoding="utf-8")

    def drive(block: Chosen, path: Path, number: int) -> Driven:
        from bench.jobs.run_ramp import make_backend, record

        profile = parse_profile(block.text)
        backend = make_backend(profile, scenario=sealed, seed=1000 * seed + number)
        done = record(profile, block.text, backend, path, extra={"chosen_because": block.reason}, quiet=True)
        return Driven("" if done.how == "complete" else done.why)

    return load("simulated")[1], tuple(scenario.effects), drive


def _other(rng: np.random.Generator, nothing: bool, seed: int, folder: Path) -> tuple[str, tuple[str, ...], Drive]:
    """The plant that shares no code, driven block by block and handed over as CSV."""
    from bench.profiles.edit import with_values

    effect = str(rng.choice(sorted(OTHER_NAMED)))
    hidden = {} if nothing else other_plant.hidden_by(effect, "strong")
    plain = other_plant.Run(seed=seed, spikes=True, closure_s=1e-4)
    gammas = np.round(np.linspace(0.4, 2.6, 23), 4).tolist()
    text = with_values(other_plant.profile_of(plain), {"ramp.gamma": gammas, "ramp.hold_cycles": 20}, "profile")

    def drive(block: Chosen, path: Path, number: int) -> Driven:
        from daq.importers.formats.open import open_source
        from daq.importers.import_recording import import_recording

        profile = parse_profile(block.text)
        ramp, forcing = profile.ramp, profile.forcing
        run = other_plant.Run(
            c=forcing.ratio, gammas=ramp.gammas(), cycles=ramp.settle_cycles + ramp.hold_cycles, fade_cycles=4,
            frequency_hz=forcing.frequency_hz, seed=1000 * seed + number, hidden=hidden, spikes=True, closure_s=1e-4,
        )  # fmt: skip
        with tempfile.TemporaryDirectory() as name:
            raw = other_plant.write(run, Path(name))
            import_recording(open_source(raw), path, profile.setup(), block.text)
        return Driven()

    return text, () if nothing else (OTHER_NAMED[effect],), drive


def trial(plant: str, strategy: str, seed: int) -> dict[str, Any]:
    """One strategy on one sealed rig."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        text, right, drive = rig(plant, seed, folder)
        standard = run_seconds(parse_profile(text))
        began = time.process_time()
        if strategy == "ramp":
            found = _ramp(text, folder, drive, standard)
        else:
            aims, rng = Aims(standard), np.random.default_rng((seed, 7))
            ask = partial(_at_random, text, aims, rng) if strategy == "random" else None
            found = explore(text, folder, aims, drive, say=lambda line: None, ask=ask)
    loop = found.loop
    return {
        "plant": plant, "strategy": strategy, "seed": seed, "hidden": right, "rig_s": found.rig_s,
        "standard_s": standard, "verdict": loop.verdict if loop else "none", "named": loop.names if loop else (),
        "why": found.why, "blocks": [block.reason for block in found.blocks],
        "processor_s": time.process_time() - began,
    }  # fmt: skip


def _ramp(text: str, folder: Path, drive: Drive, seconds: float) -> Explored:
    """The profile's own ramp, judged once."""
    from analysis.loop.close_loop import close_loop

    block = Chosen(text, seconds, "the standard ramp")
    driven = drive(block, folder / "ramp.h5", 0)
    return Explored((folder / "ramp.h5",), (block,), close_loop([folder / "ramp.h5"]), seconds, driven.why)


def _at_random(text: str, aims: Aims, rng: np.random.Generator, block: Chosen) -> Chosen:
    """A block of the same size, its forcing and gammas drawn by chance."""
    options = [option for option in offers(text, aims) if option.rising]
    option = options[int(rng.integers(len(options)))]
    gammas = sorted(rng.choice(option.gammas, aims.steps, replace=False).tolist())
    return by_person(block, NextSteps(tuple(gammas), option.setup.forcing.ratio, "by chance"))


def closed(row: dict[str, Any]) -> bool:
    """Whether the verdict is closed and right."""
    wanted = "explained" if row["hidden"] else "nothing_missing"
    return bool(row["verdict"] == wanted and set(row["named"]) == set(row["hidden"]))


def show(rows: list[dict[str, Any]]) -> None:
    """Rig seconds and verdicts by strategy, on the rigs that every strategy has met."""
    seeds = set.intersection(*({(r["plant"], r["seed"]) for r in rows if r["strategy"] == s} for s in STRATEGIES))
    rows = [r for r in rows if (r["plant"], r["seed"]) in seeds]
    print(f"{len(seeds)} sealed rigs\n")
    print("| plant | strategy | right and closed | false names | rig time over the ramp's, median |")
    print("|---|---|---|---|---|")
    for plant in sorted({r["plant"] for r in rows}):
        for strategy in STRATEGIES:
            own = [r for r in rows if r["strategy"] == strategy and r["plant"] == plant]
            false = sum(bool(set(r["named"]) - set(r["hidden"])) for r in own)
            ratio = float(np.median([r["rig_s"] / r["standard_s"] for r in own]))
            print(f"| {plant} | {strategy} | {sum(map(closed, own))} of {len(own)} | {false} | {ratio:.2f} |")
    for r in rows:
        if not closed(r):
            told = f"{r['verdict']} {' + '.join(r['named'])}; {r['why']}"
            print(f"\n{r['plant']} {r['seed']} {r['strategy']}: hidden {' + '.join(r['hidden'])}, {told}")


def main() -> None:
    """Run what is missing within the time, then print."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    options.add_argument("results", type=Path)
    options.add_argument("--rigs", type=int, default=40)
    options.add_argument("--seed-base", type=int, default=5000)
    options.add_argument("--plant", choices=("own", "other"), default="own")
    options.add_argument("--minutes", type=float, default=60.0, help="no trial is begun later")
    options.add_argument("--show", action="store_true")
    args = options.parse_args()
    journal, end = Journal(args.results), time.monotonic() + 60.0 * args.minutes
    for seed in range(args.seed_base, args.seed_base + (0 if args.show else args.rigs)):
        for strategy in STRATEGIES:
            key = f"{args.plant}/{seed}/{strategy}"
            if key not in journal.rows and time.monotonic() < end:
                journal.add(key, json.loads(json.dumps(trial(args.plant, strategy, seed))))
    if journal.rows:
        show(list(journal.rows.values()))


if __name__ == "__main__":
    main()
