"""`bench stake`: hold a later run against the prediction that a verdict staked on it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bench.outputs import JSON, File, Json, Overwrite, check_outputs
from bench.terminal.console import new_table, print_lines, print_table, write_json

if TYPE_CHECKING:
    from analysis.explore.stake import Outcome
    from daq.setup.setup import Stake


def command(
    stake: Path = typer.Argument(help="The prediction, written by bench close-loop --stake."),
    recording: Path = typer.Argument(help="The run of its ramp, made by bench ramp after it was written."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Hold a later run against the prediction that a verdict staked on it: met, or the verdict is withdrawn.

    Example: bench stake stake.toml next.h5

    Nothing is fitted. Parameters stay as they are in the file, those of the instruments too; their covariance and the
    run's own noise make the intervals. A saved verdict (run.loop) on the staked recordings is amended.

    Exits 0 whether it is met or not, 2 when the call was wrong or the run is of another rig.
    """
    from bench.jobs.blocks import amended, outcome_of, read_stake

    check_outputs(File("--json", json, JSON), inputs=[stake, recording], overwrite=overwrite)
    staked, text = read_stake(stake)
    outcome = outcome_of(staked, text, recording)
    verdict = amended(staked, outcome, recording)
    steps = [
        vars(s.staked) | {"median_us": s.median_us, "half_us": s.half_us, "landings": s.landings, "met": s.met}
        for s in outcome.steps
    ]
    answer = {
        "met": outcome.met, "words": outcome.words, "named": staked.named, "rival": staked.rival, "steps": steps,
        "flights": outcome.flights, "plate": outcome.plate, "verdict": verdict,
    }  # fmt: skip
    if write_json(answer, json):
        _print(staked, outcome)
        print_lines(*([] if verdict is None else [f"verdict amended: {verdict}"]))


def _print(stake: Stake, outcome: Outcome) -> None:
    """The table for a person, and what it says."""
    named, rival = (" + ".join(names) or "the declared model" for names in (stake.named, stake.rival))
    table = new_table("gamma", "found\n(us)", "predicted\n(us)", "by the rival\n(us)", "landings", "")
    for s in outcome.steps:
        table.add_row(
            f"{s.staked.gamma:g}", f"{s.median_us:.1f}", f"0 +- {s.half_us:.1f}",
            "elsewhere" if s.staked.rival_us is None else f"{s.staked.rival_us:.1f}",
            str(s.landings), "met" if s.met else "missed",
        )  # fmt: skip
    print_table(table)
    print_lines(
        f"median of measured minus predicted landings, one flight ahead; the rival is {rival}",
        f"rms over noise and parameters' uncertainty: flights {outcome.flights:.2f}, plate {outcome.plate:.2f}",
        f"{named}: {outcome.words}",
    )
