"""Score the closed loop on hidden effects: sealed recordings of another plant and of the own rig, on fresh seeds.

    python -m benchmarks.scoring.score_loop RESULTS --seed-base 70000 --minutes 60 --workers 2
    python -m benchmarks.scoring.score_loop RESULTS --seed-base 70000 --times 20 --cluster tcp://scheduler:8786
    python -m benchmarks.scoring.score_loop RESULTS --show
    python -m benchmarks.scoring.score_loop RESULTS --against OLD_RESULTS

Every result is kept at once, by its trial and the version of the code; a run that is started again goes on where it
stopped, on this machine or a cluster whose workers have the same code (``docs/how-to/error-rates.md``).
``--conditions`` varies noise, rate, c, and length as well; ``--kind``, ``--plant``, ``--hidden`` and ``--only`` (a
condition, repeated for alternatives) choose a group of the trials. Sizes are drawn from the seed; how strong an effect
is, is measured: see `benchmarks.scoring.tables`.
"""

from __future__ import annotations

import argparse
import socket
import sys
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.scoring.breakdown import by_condition, by_effect
from benchmarks.scoring.design import jobs
from benchmarks.scoring.paired import compare
from benchmarks.scoring.tables import show
from benchmarks.scoring.trial import Job, conditions, run
from benchmarks.scoring.version import code_version
from daq.files.disk import Journal
from model.surveys.workers import outcomes

TELL_EVERY = 50  # trials


class OtherVersionError(Exception):
    """A worker has another version of the code."""


def trial(job: Job, version: str) -> dict[str, Any]:
    """The row of one trial by ``version`` of the code; a failure is a row with its reason."""
    if code_version() != version:
        raise OtherVersionError(f"{socket.gethostname()} has version {code_version()} of the code, wanted {version}")
    try:
        return run(job)
    except (ValueError, RuntimeError, ArithmeticError) as error:
        return {"job": job.key, "kind": job.kind, "failed": f"{error}\n{traceback.format_exc()}"}


def rows_of(journal: Journal, version: str = "") -> dict[str, dict[str, Any]]:
    """Rows by trial: of a version, or of the one that ran last."""
    versions = [key.partition(":")[0] for key in journal.rows]
    wanted = version or (versions[-1] if versions else "")
    return {row["job"]: row for key, row in journal.rows.items() if key.startswith(f"{wanted}:")}


def missing(wanted: Sequence[Job], journal: Journal, end: float) -> Iterator[tuple[str, tuple[Job, str]]]:
    """Trials without a row of this version, until the time is over; what a dead worker left is tried again."""
    for job in wanted:
        key = f"{code_version()}:{job.key}"
        if time.monotonic() > end:
            return
        if "kind" not in journal.rows.get(key, {}):
            yield key, (job, code_version())


def score(wanted: Sequence[Job], journal: Journal, end: float, *, workers: int = 1, cluster: str | None = None) -> int:
    """Run trials that are missing, each row on the disk as it comes; how many were run.

    Raises
    ------
    OtherVersionError
        Where a worker of the cluster would run other code; rows so far are kept.
    """
    done = 0
    for done, outcome in enumerate(outcomes(trial, missing(wanted, journal, end), workers=workers, cluster=cluster), 1):
        if isinstance(outcome.error, OtherVersionError):
            raise outcome.error
        job = outcome.key.partition(":")[2]
        journal.add(outcome.key, outcome.result or {"job": job, "failed": str(outcome.error)})
        if done % TELL_EVERY == 0:
            sys.stderr.write(f"{len(rows_of(journal, code_version()))} of {len(wanted)} trials\n")
    return done


def _options() -> argparse.Namespace:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    options.add_argument("results", type=Path)
    options.add_argument("--seed-base", type=int, default=70_000)
    options.add_argument("--times", type=int, default=1, help="the whole design so many times, with seeds of its own")
    options.add_argument("--conditions", action="store_true", help="noise, rate, c and length drawn from the seed, too")
    options.add_argument("--minutes", type=float, default=60.0, help="no trial is begun later")
    options.add_argument("--workers", type=int, default=1, help="processes")
    options.add_argument("--cluster", default=None, help="Dask scheduler: tcp://host:port, or local")
    options.add_argument("--kind", default="", help="only these kinds of trial, with commas between")
    options.add_argument("--plant", default="", help="only this plant: other or own")
    options.add_argument("--hidden", default="", help="only trials that hide this effect")
    options.add_argument("--only", action="append", default=[], metavar="NAME=VALUE", help="condition, of those drawn")
    options.add_argument("--most", type=int, default=10**9, help="so many trials at most")
    options.add_argument("--show", action="store_true", help="only print")
    options.add_argument("--version", default="", help="of --show and --against; the last that ran where not given")
    options.add_argument("--against", type=Path, default=None, help="results of an older version, to compare with")
    return options.parse_args()


def in_group(args: argparse.Namespace, kind: str, plant: str, hidden: Sequence[str], under: Mapping[str, Any]) -> bool:
    """Whether a trial, or its row, is of the group that the options ask for."""
    if (args.kind and kind not in args.kind.split(",")) or args.plant not in ("", plant):
        return False
    if args.hidden and args.hidden not in hidden:
        return False
    asked = [one.partition("=")[::2] for one in args.only]
    return all(any(_same(under.get(n), text) for n, text in asked if n == name) for name, _ in asked)


def _same(value: Any, text: str) -> bool:
    """Whether a condition has the value that a text gives."""
    try:
        return (isinstance(value, int | float) and float(text) == value) or str(value) == text
    except ValueError:
        return str(value) == text


def main() -> None:
    """Run what is missing within the time, then print."""
    args = _options()
    journal = Journal(args.results)
    if not (args.show or args.against):
        wanted = [
            job for job in jobs(args.seed_base, times=args.times, varied=args.conditions)
            if in_group(args, job.kind, job.plant, job.effects, conditions(job))
        ]  # fmt: skip
        wanted = wanted[: args.most]
        if not wanted:
            sys.exit("no trial of the plan is of this group: see the names and values under 'By condition' of --show")
        score(wanted, journal, time.monotonic() + 60.0 * args.minutes, workers=args.workers, cluster=args.cluster)
    rows = rows_of(journal, args.version or ("" if args.show or args.against else code_version()))
    if args.against is not None:
        compare(rows_of(Journal(args.against)), rows)
    else:
        told = [
            row for row in rows.values()
            if "plant" not in row or in_group(args, row["kind"], row["plant"], row["hidden"], row["conditions"] or {})
        ]  # fmt: skip
        show(told)
        good = [row for row in told if "failed" not in row]
        by_effect(good)
        by_condition(good)


if __name__ == "__main__":
    main()
