"""Score the closed loop on hidden effects: sealed recordings of another plant and of the own rig, on fresh seeds.

    python -m benchmarks.scoring.score_loop RESULTS.jsonl --seed-base 70000 --minutes 60 [--part 0 --parts 2] [--kind
    strong] python -m benchmarks.scoring.score_loop RESULTS.jsonl --show

Every result is appended at once; a run that is started again goes on where it stopped. Sizes are drawn from the seed;
how strong an effect is, is measured: see `benchmarks.scoring.tables`.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import traceback
from pathlib import Path
from typing import Any

from benchmarks.scoring.design import jobs
from benchmarks.scoring.tables import show
from benchmarks.scoring.trial import run


def rows_of(path: Path) -> list[dict[str, Any]]:
    """Results so far."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []


def main() -> None:
    """Run what is missing within the time, then print."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    options.add_argument("results", type=Path)
    options.add_argument("--seed-base", type=int, default=70_000)
    options.add_argument("--minutes", type=float, default=60.0)
    options.add_argument("--part", type=int, default=0, help="which of --parts this process takes")
    options.add_argument("--parts", type=int, default=1)
    options.add_argument("--kind", default="", help="only this kind of trial")
    options.add_argument("--plant", default="", help="only this plant: other or own")
    options.add_argument("--hidden", default="", help="only trials that hide this effect")
    options.add_argument("--most", type=int, default=10**6, help="so many trials at most")
    options.add_argument("--show", action="store_true", help="only print")
    args = options.parse_args()
    end = time.monotonic() + 60.0 * args.minutes
    known = {row["job"] for row in rows_of(args.results)}
    wanted = [
        job for job in jobs(args.seed_base)
        if args.kind in ("", job.kind) and args.plant in ("", job.plant)
        and (not args.hidden or args.hidden in job.effects)
    ]  # fmt: skip
    for job in [] if args.show else wanted[args.part :: args.parts][: args.most]:
        if job.key in known or time.monotonic() > end:
            continue
        try:
            row = run(job)
        except (ValueError, RuntimeError, ArithmeticError) as error:
            print(f"{job.key}: {error}\n{traceback.format_exc()}", file=sys.stderr)
            row = {"job": job.key, "failed": str(error)}
        with args.results.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(row) + "\n")
    show(rows_of(args.results))


if __name__ == "__main__":
    main()
