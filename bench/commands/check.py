"""`bench check`: is the rig wired as its profile says?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bench.outputs import Overwrite

if TYPE_CHECKING:
    from rig.checks.check import Finding


def command(
    profile: str = typer.Argument(help="A profile's path, or the name of a shipped one."),
    scenario: Path | None = typer.Option(None, "--scenario", metavar="FILE", help="What the simulated rig hides."),
    seed: int = typer.Option(0, "--seed", min=0, help="Of the simulated rig's noise."),
    json: str | None = typer.Option(None, "--json", metavar="FILE", help="The findings for a machine; - prints them."),
    overwrite: Overwrite = False,
) -> None:
    """Play a chirp, a quiet tone and a short flight, and say of each channel whether it is what the profile says.

    Example: bench check soundcard

    Exits 0 when everything passed, 1 when something did not, 2 when the call was wrong.
    """
    from bench.jobs.run_ramp import make_backend, warm_up
    from bench.outputs import JSON, File, check_outputs
    from bench.profiles.find import load
    from bench.terminal.console import EXIT_FAILED, EXIT_USAGE, fail, write_json
    from daq.setup.errors import InputError
    from rig.backends.base import BackendError
    from rig.checks.check import Check

    try:
        check_outputs(File("--json", json, JSON), inputs=[profile, scenario], overwrite=overwrite)
        checked, _ = load(profile)
        if checked.backend.kind == "replay":
            raise InputError(f"{profile}: backend.kind is replay: there is no rig to check")
        backend = make_backend(checked, scenario=scenario, seed=seed)
        if not backend.simulated:
            warm_up(checked)
        findings = Check(checked, backend).run()
    except InputError as error:
        fail(str(error), EXIT_USAGE)
    except BackendError as error:
        fail(str(error), EXIT_FAILED)
    write_json({"profile": checked.name, "findings": findings}, json)
    if json != "-":
        _show(findings)
    bad = [finding.what for finding in findings if finding.passed is False]
    if bad:
        fail(f"not as the profile says: {', '.join(bad)}", EXIT_FAILED)


def _show(findings: list[Finding]) -> None:
    """The table; the remedy only where it is needed."""
    from rich.table import Table

    from bench.terminal.console import print_table

    table = Table("", "what", "seen", "what to do", box=None, pad_edge=False)
    words = {True: "[green]pass[/]", False: "[red]FAIL[/]", None: "[yellow]?[/]"}
    for finding in findings:
        remedy = "" if finding.passed else finding.remedy
        table.add_row(words[finding.passed], finding.what, finding.seen, remedy)
    print_table(table)
