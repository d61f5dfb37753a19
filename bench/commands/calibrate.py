"""`bench calibrate`: measure a rig's scales and write them into its profile."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bench.outputs import Overwrite

if TYPE_CHECKING:
    from bench.profiles.edit import Measured
    from rig.backends.base import Backend
    from rig.profile import Profile

KINDS = ("accelerometer", "drive", "contact")


def command(
    kind: str = typer.Argument(help="accelerometer, drive or contact; in this order on a new rig."),
    into: Path = typer.Option(..., "--into", metavar="PROFILE", help="The profile's file, used and written."),
    scenario: Path | None = typer.Option(None, "--scenario", metavar="FILE", help="What the simulated rig hides."),
    seed: int = typer.Option(0, "--seed", min=0, help="Of the simulated rig's noise."),
    json: str | None = typer.Option(None, "--json", metavar="FILE", help="The values for a machine; - prints them."),
    overwrite: Overwrite = False,
) -> None:
    """Measure the rig's scales and write them into its profile, each with its uncertainty, date and source.

    accelerometer: flip test (rest, upside down, rest; nothing is driven). drive: gain and phase of the plate for a
    volt, the block resting on it. contact: levels of the circuit, and how late it is to the impacts.

    Example: bench calibrate accelerometer --into my_rig.toml

    Exits 0 when the values were written, 1 when the device failed, 2 when the call was wrong or nothing could be
    measured; the profile is then left as it was.
    """
    import datetime
    from dataclasses import asdict

    from bench.jobs.run_ramp import make_backend
    from bench.outputs import JSON, Edited, File, check_outputs
    from bench.profiles.edit import write_into
    from bench.profiles.find import load
    from bench.terminal.console import EXIT_FAILED, EXIT_USAGE, fail, write_json
    from daq.setup.errors import InputError
    from rig.backends.base import BackendError

    try:
        if kind not in KINDS:
            raise InputError(f"{kind}: wanted one of {', '.join(KINDS)}")
        check_outputs(Edited("--into", into), File("--json", json, JSON), inputs=[scenario], overwrite=overwrite)
        profile, _ = load(into)
        if profile.backend.kind == "replay":
            raise InputError(f"{into}: backend.kind is replay: there is no rig to calibrate")
        backend = make_backend(profile, scenario=scenario, seed=seed)
        measured = measure(kind, profile, backend)
        write_into(into, measured, datetime.date.today())
    except InputError as error:
        fail(str(error), EXIT_USAGE)
    except (BackendError, OSError) as error:
        fail(str(error), EXIT_FAILED)
    write_json({"profile": into, "simulated": backend.simulated, "measured": [asdict(one) for one in measured]}, json)
    if json != "-":
        _show(profile, measured, into)


def measure(kind: str, profile: Profile, backend: Backend) -> list[Measured]:
    """The values of one kind of calibration (raises `InputError`, `BackendError`)."""
    from bench.jobs import calibrate

    if kind == "accelerometer":
        return calibrate.accelerometer(profile, backend, _ask)
    return calibrate.drive(profile, backend) if kind == "drive" else calibrate.contact(profile, backend)


def _ask(over: bool) -> None:
    """Have the operator turn the sensor."""
    how = "upside down (its axis plumb)" if over else "as it is mounted (its axis plumb)"
    typer.prompt(f"Lay the accelerometer {how}, let it lie still, and press Enter", default="", show_default=False)


def _show(profile: Profile, measured: list[Measured], into: Path) -> None:
    """Before and after, for a person."""
    from rich.table import Table

    from bench.terminal.console import print_table

    table = Table("key", "before", "measured", "uncertainty", box=None, pad_edge=False)
    for one in measured:
        before: object = profile
        for name in one.key.split("."):
            before = before.get(name) if isinstance(before, dict) else getattr(before, name, None)
        shown = "-" if before is None else f"{getattr(before, 'value', before):.6g}"
        table.add_row(one.key, shown, f"{one.value:.6g}", f"{one.uncertainty:.2g}")
    print_table(table)
    typer.echo(f"written into {into}")
