"""Flights and verdicts behind instruments as laboratories have them: a matrix of chains, hidden causes and plants.

    python -m benchmarks.analysis.instruments RESULTS --seeds 1 --minutes 60 --workers 2 --shuffle
    python -m benchmarks.analysis.instruments RESULTS --no-loop --only "plain;ordinary USB card" --plant other
    python -m benchmarks.analysis.instruments RESULTS --show

Each trial is kept at once, by the version of the code; a run that is started again goes on where it stopped.
``--no-loop`` finds flights only. A landing is a phantom where no impact was within 0.5 ms of it (and the time in which
the contact chatters); a flight of more than 1 ms is missed where no landing was found so near to its own. Where a
verdict is judged, a name that is the instrument's own (`Chain.causes`) is neither wanted nor wrong. Tones: gain and
phase of each step against its drive, about the recording's mean.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.analysis.chains import CHAINS, HIDDEN, Job, Values, jobs, recorded
from benchmarks.scoring.tables import rate
from benchmarks.scoring.version import code_version
from daq.files.disk import Journal
from kernels.arrays import Bools, Floats
from model.surveys.workers import outcomes

if TYPE_CHECKING:
    from analysis.residuals.plate_data.plate_observables import PlateData

Row = dict[str, Any]

NEAR_S = 5e-4
SHORTEST_S = 1e-3  # a ringing table and a contact that is held closed hide shorter ones
GOOD_FLOORS = 1.3  # landing rms over the noise floor


def counted(found_s: Floats, cut: Bools, flown: Floats, near_s: float) -> tuple[int, int, int]:
    """Flights flown, phantom landings and missed ones.

    Parameters
    ----------
    found_s : (n,)
        Landings found.
    cut : (n,)
        Which of them end at samples that were lost: no phantoms.
    flown : (m, 2)
        Take-off and landing of each flight flown, in order.
    near_s
        Distance within which a landing is the one that was found.
    """
    long = flown[flown[:, 1] - flown[:, 0] > SHORTEST_S]
    return len(long), int(_far(found_s[~cut], flown[:, 1], near_s).sum()), int(_far(long[:, 1], found_s, near_s).sum())


def _far(times: Floats, others: Floats, near_s: float) -> np.ndarray:
    """Which times have no other nearer than that."""
    edges = np.concatenate([[-np.inf], np.sort(others), [np.inf]])
    place = np.searchsorted(edges, times)
    return np.asarray(np.minimum(times - edges[place - 1], edges[place] - times) > near_s)


def tone_scatter(data: PlateData) -> tuple[float, int]:
    """Squares of what gain and phase of steps' tones differ from their means, over stated variances, and freedom."""
    from analysis.residuals.plate_data.plate_observables import GAIN, PHASE

    squares, freedom = 0.0, 0
    for kind in (GAIN, PHASE):
        for multiple in np.unique(data.multiple[data.kind == kind]):
            own = data.among((data.kind == kind) & (data.multiple == multiple))
            mean = np.average(own.value, weights=own.sigma**-2.0)
            squares += float(np.sum(((own.value - mean) / own.sigma) ** 2))
            freedom += len(own) - 1
    return squares, freedom


def trial(job: Job, with_loop: bool) -> Row:
    """A row: what was found of what was flown, and the verdict; a failure is a row with its reason."""
    from analysis.flights.assemble import FlightFlag, flights_of
    from analysis.residuals.plate_data.plate_observables import plate_data
    from daq.recording import open_recording

    row: Row = {"chain": job.chain, "hidden": job.hidden, "plant": job.plant, "seed": job.seed}
    try:
        with tempfile.TemporaryDirectory() as folder:
            path, flown, truth = recorded(job, Path(folder))
            start = time.process_time()
            with open_recording(path) as recording:
                flights = flights_of(recording)
                row["seconds_recorded"] = recording.n_samples / recording.rate_hz
                data, _ = plate_data([s for s in flights.plate.steps if s is not None], recording.setup)
                row["tone_squares"], row["tone_freedom"] = tone_scatter(data)
                after, lost = recording.gaps.T / recording.rate_hz
            row["seconds_flights"] = time.process_time() - start
            whole = flights.landing_s < row["seconds_recorded"] - 1e-3  # the last flight may not have ended
            taken = ~flights.has(FlightFlag.FALSE) & whole
            landings, cut = flights.landing_s[taken], flights.has(FlightFlag.GAP)[taken]
            landings = landings + np.append(0.0, np.cumsum(lost))[np.searchsorted(after, landings, side="right")]
            near_s = NEAR_S + CHAINS[job.chain].parts.get("bounce_s", 0.0)
            row["found"] = len(landings)
            ended = flown[flown[:, 1] < row["seconds_recorded"] + lost.sum()]  # the last one may land after the end
            row["flown"], row["phantoms"], row["missed"] = counted(landings, cut, ended, near_s)
            if with_loop:
                row |= _verdict(path, truth)
                row["wanted"] = [effect for effect in truth if effect not in CHAINS[job.chain].hides]
    except (ValueError, RuntimeError, ArithmeticError, IndexError) as error:
        row["failed"] = f"{error}\n{traceback.format_exc()}"
    return row


def _verdict(path: Path, truth: Values) -> Row:
    """The loop's verdict, its error over the floor, and how many of its intervals hold the truth."""
    from analysis.loop.close_loop import fit_loop

    start = time.process_time()
    loop, _ = fit_loop([path])
    seconds = time.process_time() - start
    held = [
        bool(low <= truth[e.name][name] <= high)
        for e in loop.selection.effects
        for name, (_, low, high) in e.parameters.items()
        if name in truth.get(e.name, {})
    ]  # fmt: skip
    return {
        "verdict": loop.verdict, "names": [e.name for e in loop.selection.effects], "held": held,
        "rms_us": loop.errors.after.landing_rms_us, "floor_us": loop.errors.landing_floor_us, "seconds_loop": seconds,
    }  # fmt: skip


def score(wanted: Sequence[Job], journal: Journal, end: float, *, with_loop: bool, workers: int) -> None:
    """Run trials that have no row of this version yet, until ``end`` on the monotonic clock."""

    def missing() -> Iterator[tuple[str, tuple[Job, bool]]]:
        for job in wanted:
            row = journal.rows.get(f"{code_version()}:{job.key}", {})
            if time.monotonic() < end and ("verdict" not in row if with_loop else "chain" not in row):
                yield f"{code_version()}:{job.key}", (job, with_loop)

    for outcome in outcomes(trial, missing(), workers=workers):
        journal.add(outcome.key, outcome.result or {"failed": str(outcome.error)})


# -- tables ---------------------------------------------------------------------------------------------------------
def show(rows: Sequence[Row]) -> None:
    """Flights and verdicts of each chain, as Markdown."""
    good, failed = [r for r in rows if "failed" not in r], [r for r in rows if "failed" in r]
    print(f"{len(good)} trials, {len(failed)} failed\n")
    print(
        "| chain | plant | trials | intervals found / flown | phantoms an hour | missed | tones, actual / stated |"
        "\n|---|---|---|---|---|---|---|"
    )
    for (chain, plant), some in _grouped(good, "chain", "plant").items():
        hours = sum(r["seconds_recorded"] for r in some) / 3600.0
        found, flown, phantoms, missed = (sum(r[k] for r in some) for k in ("found", "flown", "phantoms", "missed"))
        cells = f"{found} / {flown} | {phantoms / hours:.0f} | {missed} | {_tones(some)}"
        print(f"| {chain} | {plant} | {len(some)} | {cells} |")
    judged = [r for r in good if "verdict" in r]
    if judged:
        _show_verdicts(judged)
    for r in failed:
        print(f"failed: {r.get('plant')}/{r.get('chain')}/{r.get('hidden')}/{r.get('seed')}:", r["failed"])


def _tones(rows: Sequence[Row]) -> str:
    squares, freedom = (sum(r.get(k, 0) for r in rows) for k in ("tone_squares", "tone_freedom"))
    return f"{np.sqrt(squares / freedom):.2f}" if freedom else "-"


def _show_verdicts(rows: Sequence[Row]) -> None:
    print(
        "\n| chain | nothing hidden: false alarms | a cause: named exactly | named, landings within 1.3 floors "
        "| intervals hold the truth | processor s, median |\n|---|---|---|---|---|---|"
    )
    for (chain,), some in {**_grouped(rows, "chain"), ("all",): list(rows)}.items():
        clean, rest = [r for r in some if not r["wanted"]], [r for r in some if r["wanted"]]
        held = [{"held": h} for r in rest if exact(r) for h in r["held"]]
        cells = [
            rate(clean, lambda r: not exact(r)), rate(rest, exact), rate([r for r in rest if exact(r)], close),
            rate(held, lambda r: r["held"]), f"{np.median([r['seconds_loop'] for r in some]):.0f}",
        ]  # fmt: skip
        print(f"| {chain} | {' | '.join(cells)} |")
    print("\n| plant | chain | hidden | seed | named | verdict | rms / floor, us |\n|---|---|---|---|---|---|---|")
    for r in rows:
        if not exact(r):
            named = " + ".join(r["names"]) or "-"
            error = f"{r['rms_us'] or np.inf:.0f} / {r['floor_us']:.0f}"
            print(f"| {r['plant']} | {r['chain']} | {r['hidden']} | {r['seed']} | {named} | {r['verdict']} | {error} |")


def exact(row: Mapping[str, Any]) -> bool:
    """Whether the verdict names what is hidden and nothing else but the instrument's own causes."""
    verdict = "explained" if row["names"] else "nothing_missing"
    return row["verdict"] == verdict and set(row["names"]) - set(CHAINS[row["chain"]].causes) == set(row["wanted"])


def close(row: Mapping[str, Any]) -> bool:
    """Whether landings are missed by little more than the noise."""
    return bool(row["rms_us"] is not None and row["rms_us"] <= GOOD_FLOORS * row["floor_us"])


def _grouped(rows: Sequence[Row], *by: str) -> dict[tuple[str, ...], list[Row]]:
    out: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        out.setdefault(tuple(row[k] for k in by), []).append(row)
    return out


def main() -> None:
    """Run what is missing within the time, then print."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("results", type=Path)
    options.add_argument("--seed-base", type=int, default=70_000)
    options.add_argument("--seeds", type=int, default=1, help="so many of each trial")
    options.add_argument("--minutes", type=float, default=60.0, help="no trial is begun later")
    options.add_argument("--workers", type=int, default=1, help="processes")
    options.add_argument("--only", default="", help="chains by their beginnings, with semicolons between")
    options.add_argument("--plant", default="", choices=("", "other", "own", "third"))
    options.add_argument("--hidden", default="", choices=("", *HIDDEN))
    options.add_argument("--shuffle", action="store_true", help="so that a part is one of all chains and causes")
    options.add_argument("--no-loop", action="store_true", help="only find flights")
    options.add_argument("--show", action="store_true", help="only print, of the version that ran last")
    args = options.parse_args()
    journal = Journal(args.results)
    chains = tuple(part for part in args.only.split(";") if part)
    if not args.show:
        wanted = [
            job for job in jobs(range(args.seed_base, args.seed_base + args.seeds))
            if args.plant in ("", job.plant) and args.hidden in ("", job.hidden)
            and (not chains or job.chain.startswith(chains))
        ]  # fmt: skip
        if not wanted:
            sys.exit(f"no chain begins so; wanted some of: {'; '.join(CHAINS)}")
        if args.shuffle:
            np.random.default_rng(args.seed_base).shuffle(wanted)  # type: ignore[arg-type]
        score(wanted, journal, time.monotonic() + 60.0 * args.minutes, with_loop=not args.no_loop, workers=args.workers)
    version = next(reversed(journal.rows), ":").partition(":")[0]
    show([row for key, row in journal.rows.items() if key.startswith(f"{version}:")])


if __name__ == "__main__":
    main()
