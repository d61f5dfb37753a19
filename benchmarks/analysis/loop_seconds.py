"""Processor seconds of the closed loop by stage, for a handful of blind trials, of this tree and another in one run.

    python -m benchmarks.analysis.loop_seconds [--seed-base 52000] [--trials 12] [--longer] [--against T] [--folder F]

It prints a table of the stages: of two trees the other one's figures stand first, and verdicts,
names and values of both are compared. Each trial's recording is made once and given to both trees. Kernels are compiled
before the clock starts, and threads count as they do for the operating system: seconds are those of all cores together.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

STAGES = {
    "reading": "observations_from",
    "judging": "_judge",
    "limits": "detection_limits",
    "tables": "selected",
}
WANTED = (  # kind, plant and what is hidden: light and heavy ones in turn
    ("clean", "other", ()), ("strong", "other", ("coulomb_friction",)), ("strong", "other", ("mains_hum",)),
    ("strong", "other", ("amplitude_modulation",)), ("weak", "other", ("adhesion",)),
    ("outside", "other", ("upper_stop",)), ("strong", "other", ("restitution",)),
    ("strong", "other", ("table_resonance",)), ("strong", "other", ("gain_compression",)),
    ("strong", "other", ("viscous_damping",)), ("strong", "other", ("accelerometer_offset",)),
    ("strong", "other", ("local_gravity",)),
)  # fmt: skip
LONGER = (  # what longer ramps of the other plant hide, and their c
    (("coulomb_friction",), 1), (("viscous_damping",), 2), (("restitution",), 1),
    (("restitution", "coulomb_friction"), 1), (("restitution", "coulomb_friction"), 2),
    (("restitution", "coulomb_friction", "viscous_damping"), 1),
)  # fmt: skip


def measured(recording: Path) -> dict[str, Any]:
    """Verdict, names, error and processor seconds by stage of one recording."""
    from analysis.loop import close_loop as module

    seconds: dict[str, float] = {}
    with _clocked(module, seconds):
        start = time.process_time()
        loop = module.close_loop([recording])
        seconds["all"] = time.process_time() - start
    return {
        "verdict": loop.verdict,
        "names": list(loop.selection.names),
        "values": {f"{p.effect}.{p.parameter}": p.value for p in loop.selection.parameters},
        "rms_us": loop.errors.after.landing_rms_us,
        "seconds": seconds,
        "peak_mb": _peak_mb(),
    }


def _peak_mb() -> float:
    """Largest memory of this process so far, MB; NaN where the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return float("nan")
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024.0 if sys.platform != "darwin" else 1024.0**2)


@contextmanager
def _clocked(module: Any, seconds: dict[str, float]) -> Iterator[None]:
    """Clocks around the stages of the loop while it runs."""
    places = [(module, name, stage) for stage, name in STAGES.items()]
    places.append((module.StepwiseSelection, "run", "selection"))
    kept = [getattr(owner, name) for owner, name, _ in places]
    for (owner, name, stage), function in zip(places, kept, strict=True):
        setattr(owner, name, _clock(function, stage, seconds))
    try:
        yield
    finally:
        for (owner, name, _), function in zip(places, kept, strict=True):
            setattr(owner, name, function)


def _clock(function: Callable[..., Any], stage: str, seconds: dict[str, float]) -> Callable[..., Any]:
    def clocked(*args: Any, **options: Any) -> Any:
        start = time.process_time()
        try:
            return function(*args, **options)
        finally:
            seconds[stage] = seconds.get(stage, 0.0) + time.process_time() - start

    return clocked


def make(seed_base: int, trials: int, folder: Path, *, longer: bool = False) -> list[Path]:
    """Recordings of the wanted trials; those that ``folder`` has are not made again."""
    from benchmarks.scoring import trial
    from benchmarks.scoring.design import jobs

    if longer:
        wanted = [trial.Job("strong", "other", x, c, seed_base + i, longer=True) for i, (x, c) in enumerate(LONGER)]
    else:
        drawn = jobs(seed_base)
        wanted = [next(j for j in drawn if (j.kind, j.plant, j.effects) == one) for one in WANTED]
    out = []
    for job in wanted[:trials]:
        place = folder / job.key.replace("/", "_")
        if not (place / "recording.h5").exists():
            place.mkdir(parents=True, exist_ok=True)
            (trial.other if job.plant == "other" else trial.own)(job, place)
        out.append(place / "recording.h5")
    return out


def _in_tree(tree: Path, recordings: Sequence[Path]) -> list[dict[str, Any]]:
    """`measured` of each recording by the code of another tree."""
    command = [sys.executable, str(Path(__file__).resolve()), "--measure", *map(str, recordings)]
    done = subprocess.run(
        command, cwd=tree, env={**os.environ, "PYTHONPATH": str(tree)}, stdout=subprocess.PIPE, text=True, check=True
    )
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def _warm_and_measure(recordings: Sequence[Path]) -> None:
    """Print `measured` of each recording, one a line, each after a run that compiles what it needs."""
    for path in recordings:
        measured(path)
        print(json.dumps(measured(path)), flush=True)


def show(recordings: Sequence[Path], sides: Sequence[Sequence[dict[str, Any]]]) -> None:
    """Table of verdicts, errors and seconds by stage; of two trees the other one's figures stand before a stroke."""
    stages = ["all", "selection", *STAGES]
    print(
        "| trial | verdict | named | largest relative change of a value | landings, us | "
        + ", s | ".join(stages)
        + ", s |"
    )
    print("|---" * (5 + len(stages)) + "|")
    for path, *rows in zip(recordings, *sides, strict=True):
        texts = [path.parent.name]
        texts += [" / ".join(dict.fromkeys(str(r["verdict"]) for r in rows))]
        texts += [" / ".join(dict.fromkeys(" + ".join(r["names"]) or "-" for r in rows))]
        texts += [f"{_apart(*(r['values'] for r in rows)):.0e}" if len(rows) > 1 else "-"]
        texts += [" / ".join(f"{r['rms_us']:.2f}" for r in rows)]
        texts += [" / ".join(f"{r['seconds'].get(stage, 0.0):.1f}" for r in rows) for stage in stages]
        print("| " + " | ".join(texts) + " |")
    for rows in sides:
        seconds = sorted(r["seconds"]["all"] for r in rows)
        times = f"median {median(seconds):.1f} s, longest {seconds[-1]:.1f} s"
        print(f"\n{len(seconds)} trials: {times}, memory {max(r['peak_mb'] for r in rows):.0f} MB")


def _apart(one: dict[str, float], other: dict[str, float]) -> float:
    """Largest relative difference of the values of two runs; infinite where they name different parameters."""
    if one.keys() != other.keys():
        return float("inf")
    return max((abs(one[k] - other[k]) / max(abs(one[k]), abs(other[k]), 1e-12) for k in one), default=0.0)


def main() -> None:
    """Make the recordings, measure, print."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    options.add_argument("--seed-base", type=int, default=52_000)
    options.add_argument("--trials", type=int, default=len(WANTED), help="so many of the wanted trials")
    options.add_argument("--longer", action="store_true", help="ramps of 30 steps of 50 cycles instead")
    options.add_argument("--against", type=Path, help="another tree of this project")
    options.add_argument("--folder", type=Path, help="where recordings are kept; a temporary one by default")
    options.add_argument("--measure", type=Path, nargs="+", help=argparse.SUPPRESS)
    args = options.parse_args()
    if args.measure:
        _warm_and_measure(args.measure)
        return
    with tempfile.TemporaryDirectory() as name:
        recordings = make(args.seed_base, args.trials, args.folder or Path(name), longer=args.longer)
        trees = [*([args.against.resolve()] if args.against else []), Path(__file__).resolve().parents[2]]
        show(recordings, [_in_tree(tree, recordings) for tree in trees])


if __name__ == "__main__":
    main()
