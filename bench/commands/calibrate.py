"""`bench calibrate`: measure a rig's scales and write them into its profile."""

from __future__ import annotations

from pathlib import Path

import typer

from bench.outputs import JSON, Edited, File, Json, Overwrite, Scenario, Seed, check_outputs
from bench.terminal.console import print_table, write_json
from daq.setup.errors import InputError

KINDS = ("accelerometer", "drive", "contact")


def command(
    kind: str = typer.Argument(help="accelerometer, drive or contact; in this order on a new rig."),
    into: Path = typer.Option(..., "--into", metavar="PROFILE", help="The profile's file, used and written."),
    scenario: Scenario = None,
    seed: Seed = 0,
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Measure the rig's scales and write them into its profile, each with its uncertainty, date and source.

    accelerometer: flip test (rest, upside down, rest; nothing is driven). drive: gain and phase of the plate for a
    volt, the block resting on it. contact: levels of the circuit, and how late it is to the impacts.

    Example: bench calibrate accelerometer --into my_rig.toml

    Exits 0 when the values were written, 1 when the device failed, 2 when the call was wrong or nothing could be
    measured; the profile is then left as it was.
    """
    from rich.table import Table

    from bench.jobs.calibrate import calibrate_into

    if kind not in KINDS:
        raise InputError(f"{kind}: wanted one of {', '.join(KINDS)}")
    check_outputs(Edited("--into", into), File("--json", json, JSON), inputs=[scenario], overwrite=overwrite)
    profile, backend, measured = calibrate_into(into, kind, scenario, seed, _ask)
    answer = {"profile": into, "simulated": backend.simulated, "measured": measured}
    if not write_json(answer, json):
        return
    table = Table("key", "before", "measured", "uncertainty", box=None, pad_edge=False)
    for one in measured:
        before: object = profile
        for name in one.key.split("."):
            before = before.get(name) if isinstance(before, dict) else getattr(before, name, None)
        shown = "-" if before is None else f"{getattr(before, 'value', before):.6g}"
        table.add_row(one.key, shown, f"{one.value:.6g}", f"{one.uncertainty:.2g}")
    print_table(table)
    typer.echo(f"written into {into}")


def _ask(over: bool) -> None:
    """Have the operator turn the sensor."""
    how = "upside down (its axis plumb)" if over else "as it is mounted (its axis plumb)"
    typer.prompt(f"Lay the accelerometer {how}, let it lie still, and press Enter", default="", show_default=False)
