"""Score the closed loop on hidden effects: another plant's recordings, sealed, on seeds not used in development.

    python benchmarks/score_loop.py RESULTS.jsonl --count 1 --strength strong --seed-base 9000 --seconds 600

Every result is appended at once; a run that is started again goes on where it stopped. The design is printed with the
figures: 22 steps of 20 cycles at 25.37 Hz, shuffled, far into the irregular range, c = 1 and c = 2 in turn.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
NAMED = {
    "coulomb_friction": "coulomb_friction",
    "viscous_damping": "viscous_damping",
    "quadratic_drag": "quadratic_drag",
    "restitution": "restitution",
    "adhesion": "adhesion",
    "spring": "position_force",
    "magnet": "position_force",
    "local_gravity": "local_gravity",
    "table_resonance": "table_resonance",
    "drive_gain": "drive_gain",
    "gain_compression": "gain_compression",
    "phase_lag": "phase_lag",
    "harmonic_distortion": "harmonic_distortion",
    "amplitude_modulation": "amplitude_modulation",
    "accelerometer_gain": "accelerometer_gain",
    "accelerometer_offset": "accelerometer_offset",
    "contact_latency": "contact_latency",
}
OUTSIDE = (
    "friction_with_height",
    "friction_with_speed",
    "friction_with_dwell",
    "friction_with_level",
    "pull_after_long_flight",
    "restitution_at_one_speed",
    "upper_stop",
)


def jobs(count: int, strength: str, base: int) -> list[tuple[str, str, int, int]]:
    """Every trial as ``(effect, strength, c, seed)``: clean ones among them."""
    out = []
    for i in range(count):
        for j, effect in enumerate((*NAMED, *OUTSIDE, "clean", "clean", "clean")):
            out.append((effect, strength if effect != "clean" else "clean", 1 + (i + j) % 2, base + 100 * i + j))
    return out


def trial(effect: str, strength: str, c: int, seed: int) -> dict[str, Any]:
    """Make one recording, close the loop on it, and only then look at what was hidden."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        hidden = [] if effect == "clean" else ["--effect", effect, "--strength", strength]
        plant = [
            sys.executable,
            str(ROOT / "tests/blind/other_plant.py"),
            str(folder),
            "--c",
            str(c),
            "--seed",
            str(seed),
        ]
        subprocess.run([*plant, *hidden, "--shuffle", "--closure-ms", "0.5"], check=True, capture_output=True)
        bench = [sys.executable, "-c", "from bench.cli import main; main()"]
        record, verdict = folder / "r.h5", folder / "v.json"
        raw = [str(folder / "recording.csv"), "--profile", str(folder / "profile.toml"), "--out", str(record)]
        subprocess.run([*bench, "import", *raw], check=True, capture_output=True, cwd=ROOT)
        start = time.perf_counter()
        subprocess.run(
            [*bench, "close-loop", str(record), "--json", str(verdict)], check=True, capture_output=True, cwd=ROOT
        )
        found = json.loads(verdict.read_text(encoding="utf-8"))
        truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["hidden"]
    return {
        "effect": effect,
        "strength": strength,
        "c": c,
        "seed": seed,
        "seconds": time.perf_counter() - start,
        "verdict": found["verdict"],
        "names": [e["name"] for e in found["effects"]],
        "effects": found["effects"],
        "ties": found["tie_set"],
        "before": found["before"],
        "after": found["after"],
        "floor": found["noise_floor_us"],
        "remainder": found["remainder"],
        "discovered": [d["in_words"] for d in found["discovered"]],
        "truth": truth,
    }


def wilson(k: int, n: int) -> str:
    """``k/n`` with the lower end of Wilson's 95 % interval."""
    if n == 0:
        return "0/0"
    z, p = 1.96, k / n
    low = (p + z * z / (2 * n) - z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))) / (1 + z * z / n)
    return f"{k}/{n} (at least {100 * low:.0f} %)"


def show(rows: list[dict[str, Any]]) -> None:
    """The confusion matrix and the rates."""
    table = Counter((str(r["effect"]), " + ".join(map(str, r["names"])) or "-", str(r["verdict"])) for r in rows)
    print("design: other plant, 22 steps x 20 cycles, 25.37 Hz, shuffled, c = 1 and 2 in turn\n")
    print(f"{'hidden':<26}{'named':<44}{'verdict':<18}n")
    for (hidden, named, verdict), n in sorted(table.items()):
        print(f"{hidden:<26}{named:<44}{verdict:<18}{n}")
    known = [r for r in rows if r["effect"] in NAMED]
    first = sum(NAMED[str(r["effect"])] in r["names"][:1] for r in known)
    tied = sum(any(NAMED[str(r["effect"])] in t for t in [r["names"], *r["ties"]]) for r in known)
    clean = [r for r in rows if r["effect"] == "clean"]
    outside = [r for r in rows if r["effect"] in OUTSIDE]
    print(f"\nnamed first: {wilson(first, len(known))}; in the tie set: {wilson(tied, len(known))}")
    print(f"false alarms on clean data: {sum(r['verdict'] != 'nothing_missing' for r in clean)}/{len(clean)}")
    flagged = sum(r["verdict"] == "unexplained" for r in outside)
    print(f"outside the library, not called explained: {wilson(flagged, len(outside))}")
    slow = sorted(float(r["seconds"]) for r in rows)
    print(f"seconds a ramp: median {slow[len(slow) // 2]:.0f}, longest {slow[-1]:.0f}")


def main() -> None:
    """Run what is missing within the time, then print."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    options.add_argument("results", type=Path)
    options.add_argument("--count", type=int, default=1)
    options.add_argument("--strength", default="strong", choices=("weak", "medium", "strong"))
    options.add_argument("--seed-base", type=int, default=9000)
    options.add_argument("--seconds", type=float, default=3600.0)
    options.add_argument("--part", type=int, default=0, help="which of --parts this process takes")
    options.add_argument("--parts", type=int, default=1)
    args = options.parse_args()
    started = time.perf_counter()
    done = args.results.read_text(encoding="utf-8").splitlines() if args.results.exists() else []
    known = {(r["effect"], r["strength"], r["c"], r["seed"]) for r in map(json.loads, done)}
    for job in jobs(args.count, args.strength, args.seed_base)[args.part :: args.parts]:
        if job not in known and time.perf_counter() - started < args.seconds:
            try:
                row = trial(*job)
            except subprocess.CalledProcessError as error:
                print(f"{job}: {error.stderr.decode()[-300:]}", file=sys.stderr)
                continue
            with args.results.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(row) + "\n")
    show([json.loads(line) for line in args.results.read_text(encoding="utf-8").splitlines()])


if __name__ == "__main__":
    main()
