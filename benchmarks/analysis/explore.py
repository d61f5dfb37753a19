"""Rig seconds to a verdict: steps chosen by information, steps drawn by chance, and the standard ramp, on sealed rigs.

    python -m benchmarks.analysis.explore RESULTS --rigs 40 --seed-base 5000 --workers 2 [--plant other] [--minutes 60]
    python -m benchmarks.analysis.explore RESULTS --rigs 40 --seed-base 5000 --strategies chosen
    python -m benchmarks.analysis.explore RESULTS --show

Every strategy meets the same sealed rigs; what is hidden is beyond what the profile's calibrations allow. The ramp is
judged once, when it is over; a strategy that chooses stops by itself, at the ramp's rig time at the latest. One rig in
five hides nothing. Results are kept as they come in, by the version of the
code: the same call goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binom

from analysis.explore.stake import runner_up
from analysis.loop.close_loop import judge_loop
from analysis.thresholds import FROZEN
from bench.jobs.blocks import Aims, Chosen, Driven, as_driven, by_person, offers, outcome_of, run_seconds, staked_block
from bench.jobs.explore import Drive, Explored, explore
from benchmarks.plants import other_plant
from benchmarks.scoring.tables import rate
from benchmarks.scoring.truth import OTHER_NAMED
from benchmarks.scoring.version import code_version
from daq.files.disk import Journal
from daq.setup.setup import stake_in
from model.surveys.workers import outcomes
from rig.profile import parse_profile
from rig.programme.ramp import NextSteps

STRATEGIES = ("chosen", "random", "ramp")
DRIVING = ("bench/jobs", "rig/programme", "rig/execution")  # of the code, what decides beside the analysis


def rig(plant: str, seed: int, folder: Path) -> tuple[str, tuple[str, ...], Drive]:
    """A sealed rig: its profile, the names that are right, and what drives it."""
    rng = np.random.default_rng(seed)
    nothing = rng.random() < 0.2
    return (_other if plant == "other" else _own)(rng, nothing, seed, folder)


def _own(rng: np.random.Generator, nothing: bool, seed: int, folder: Path) -> tuple[str, tuple[str, ...], Drive]:
    """The simulated rig with an effect drawn by chance."""
    from bench.profiles.find import load
    from rig.sim.scenario import left_open, pool, sealed_scenario

    checked, text = load("simulated")
    count, allowed = 0 if nothing else 1, left_open(checked.setup())
    scenario = sealed_scenario(rng, pool("named"), strength="strong", count=count, allowed=allowed)
    sealed = folder / "sealed.toml"
    sealed.write_text(scenario.to_toml(), encoding="utf-8")

    def drive(block: Chosen, path: Path, number: int) -> Driven:
        from bench.jobs.run_ramp import make_backend, record

        profile = parse_profile(block.text)
        backend = make_backend(profile, scenario=sealed, seed=1000 * seed + number)
        done = record(profile, block.text, backend, path, extra={"chosen_because": block.reason}, quiet=True)
        return Driven("" if done.how == "complete" else done.why)

    return text, tuple(scenario.effects), drive


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
        took = time.process_time() - began
        stakes = [(s.named, s.nats) for p in found.recordings if (s := stake_in(as_driven(p).text, str(p))) is not None]
        wrong = _wrong_stake(text, folder, drive, found) if strategy == "chosen" else None
    loop = found.loop
    return {
        "plant": plant, "strategy": strategy, "seed": seed, "hidden": right, "rig_s": found.rig_s,
        "standard_s": standard, "verdict": loop.verdict if loop else "none",
        "named": loop.selection.names if loop else (),
        "why": found.why, "blocks": [(block.reason, block.seconds) for block in found.blocks],
        "stakes": stakes, "wrong": wrong, "processor_s": took,
    }  # fmt: skip


def _wrong_stake(text: str, folder: Path, drive: Drive, found: Explored) -> dict[str, Any] | None:
    """What comes of a stake on the best other first cause, named in place of the one that was found."""
    if found.loop is None or found.loop.verdict != "explained":
        return None
    before = [p for p in found.recordings if stake_in(as_driven(p).text, str(p)) is None]
    fitted = judge_loop(before)[1]
    others = runner_up(fitted.selection)
    if not others:
        return None
    selection = replace(fitted.selection, best=others[0], ties=(others[0],))
    aims = Aims(0.0)
    block = staked_block(text, replace(fitted, selection=selection), offers(text, aims), aims, before)
    stake = None if block is None else stake_in(block.text, "the stake")
    if block is None or stake is None:
        return None
    path = folder / "wrong.h5"
    drive(block, path, 99)
    return {
        "named": others[0].names, "explains": others[0].passes(FROZEN), "nats": stake.nats,
        "outcome": outcome_of(stake, block.text, path).words,
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


def false_names(row: dict[str, Any]) -> bool:
    """Whether something is named that is not hidden."""
    return bool(set(row["named"]) - set(row["hidden"]))


def median_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """Median, and its 95 % interval from order statistics alone (the ends themselves where there are fewer than 6)."""
    ordered = sorted(values)
    low = max(int(binom.ppf(0.025, len(ordered), 0.5)) - 1, 0)
    return float(np.median(ordered)), ordered[low], ordered[-1 - low]


def show(rows: list[dict[str, Any]]) -> None:
    """Rig seconds and verdicts by strategy, on the rigs that every strategy driven has met."""
    for row in rows:
        if "failed" in row:
            print(f"{row['key']}: {row['failed']}")
    rows = [row for row in rows if "failed" not in row]
    driven = [s for s in STRATEGIES if any(r["strategy"] == s for r in rows)]
    seeds = set.intersection(*({(r["plant"], r["seed"]) for r in rows if r["strategy"] == s} for s in driven))
    rows = [r for r in rows if (r["plant"], r["seed"]) in seeds]
    clean = len({(r["plant"], r["seed"]) for r in rows if not r["hidden"]})
    print(f"{len(seeds)} sealed rigs that every strategy driven has met, {clean} of them hide nothing\n")
    print(
        "| plant | strategy | right and closed | false names | false alarms where nothing is hidden "
        "| rig time over the ramp's, median (95 %) | processor s a rig |"
    )
    print("|---|---|---|---|---|---|---|")
    for plant in sorted({r["plant"] for r in rows}):
        for strategy in driven:
            own = [r for r in rows if r["strategy"] == strategy and r["plant"] == plant]
            ratio, low, high = median_interval([r["rig_s"] / r["standard_s"] for r in own])
            cells = (
                rate(own, closed),
                rate(own, false_names),
                rate([r for r in own if not r["hidden"]], lambda r: r["verdict"] != "nothing_missing"),
                f"{ratio:.2f} ({low:.2f} to {high:.2f})",
                f"{np.mean([r['processor_s'] for r in own]):.0f}",
            )
            print(f"| {plant} | {strategy} | {' | '.join(cells)} |")
    show_stakes([r for r in rows if r["strategy"] == "chosen"])
    for r in rows:
        if not closed(r):
            told = f"{r['verdict']} {' + '.join(r['named'])}; {r['why']}"
            print(f"\n{r['plant']} {r['seed']} {r['strategy']}: hidden {' + '.join(r['hidden']) or 'nothing'}, {told}")


def show_stakes(rows: list[dict[str, Any]]) -> None:
    """Verdicts before the first stake and after the last, paired, and what came of stakes on wrong names."""
    head = ("plant", "right before a stake", "wrong", "right after it", "wrong", "right, met at once", "withdrawn")
    more = ("wrong names that explain: met", "that do not: met", "rig s before", "rig s in all")
    print(f"\n| {' | '.join((*head, *more))} |")
    for plant in sorted({r["plant"] for r in rows}):
        own = [r for r in rows if r["plant"] == plant and r["stakes"]]
        first = sum(set(r["stakes"][0][0]) == set(r["hidden"]) for r in own)
        stand = [r for r in own if r["verdict"] == "explained"]
        right = [r for r in stand if closed(r)]
        wrong = [r["wrong"]["outcome"] for r in own if r["wrong"] and r["wrong"]["explains"]]
        others = [r["wrong"]["outcome"] for r in own if r["wrong"] and not r["wrong"]["explains"]]
        before_s = [sum(s for _, s in r["blocks"][: _first_stake(r)]) for r in own]
        cells = (
            f"{first} of {len(own)}", len(own) - first, len(right), len(stand) - len(right),
            sum(len(r["stakes"]) == 1 for r in right), len(own) - len(stand), f"{wrong.count('met')} of {len(wrong)}",
            f"{others.count('met')} of {len(others)}",
            f"{np.median(before_s):.1f}", f"{np.median([r['rig_s'] for r in own]):.1f}",
        )  # fmt: skip
        print(f"| {plant} | {' | '.join(map(str, cells))} |")
    for r in rows:
        if len(r["stakes"]) > 1 or (r["wrong"] and r["wrong"]["outcome"] == "met"):
            print(f"{r['plant']} {r['seed']}: hidden {r['hidden']}, stakes {r['stakes']}, on a wrong name {r['wrong']}")


def _first_stake(row: dict[str, Any]) -> int:
    """Place of the first block that was staked on."""
    return next(i for i, (reason, _) in enumerate(row["blocks"]) if " is staked on it" in reason)


def missing(args: argparse.Namespace, journal: Journal, end: float) -> Iterator[tuple[str, tuple[str, str, int]]]:
    """Trials without a row of this version, a rig's one after another, until the time is over."""
    for seed in range(args.seed_base, args.seed_base + args.rigs):
        for strategy in args.strategies.split(","):
            key = f"{code_version(*DRIVING)}:{args.plant}/{seed}/{strategy}"
            if time.monotonic() > end:
                return
            if key not in journal.rows:
                yield key, (args.plant, strategy, seed)


def main() -> None:
    """Run what is missing within the time, then print."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    options.add_argument("results", type=Path)
    options.add_argument("--rigs", type=int, default=40)
    options.add_argument("--seed-base", type=int, default=5000)
    options.add_argument("--plant", choices=("own", "other"), default="own")
    options.add_argument("--strategies", default=",".join(STRATEGIES), help="that are driven; shown are those driven")
    options.add_argument("--minutes", type=float, default=60.0, help="no trial is begun later")
    options.add_argument("--workers", type=int, default=1, help="processes")
    options.add_argument("--show", action="store_true", help="only print, of the version that ran last")
    args = options.parse_args()
    journal = Journal(args.results)
    if not args.show:
        todo = missing(args, journal, time.monotonic() + 60.0 * args.minutes)
        for outcome in outcomes(trial, todo, workers=args.workers):
            row = outcome.result or {"key": outcome.key, "failed": str(outcome.error)}
            journal.add(outcome.key, json.loads(json.dumps(row)))
    last = list(journal.rows)[-1].partition(":")[0] if journal.rows else ""
    show([row for key, row in journal.rows.items() if key.startswith(f"{last}:")])


if __name__ == "__main__":
    main()
