"""`bench check`: is the rig wired as its profile says?"""

from __future__ import annotations

import typer

from bench.outputs import JSON, File, Json, Overwrite, Scenario, Seed, check_outputs
from bench.terminal.console import fail, print_table, write_json


def command(
    profile: str = typer.Argument(help="A profile's path, or the name of a shipped one."),
    scenario: Scenario = None,
    seed: Seed = 0,
    tap: bool = typer.Option(False, "--tap", help="Wait for one hit on the resting table, and say how it rings."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Play a chirp, a quiet tone and a short flight, and say of each channel whether it is what the profile says.

    Examples: bench check soundcard

    bench check soundcard --tap

    Exits 0 when everything passed, 1 when something did not, 2 when the call was wrong.
    """
    from rich.table import Table

    from bench.jobs.run_ramp import check_rig, open_rig

    check_outputs(File("--json", json, JSON), inputs=[profile, scenario], overwrite=overwrite)
    checked, backend = open_rig(profile, "check", scenario, seed)
    findings = check_rig(checked, backend, tap=tap)
    if write_json({"profile": checked.name, "findings": findings}, json):
        table = Table("", "what", "seen", "what to do", box=None, pad_edge=False)
        words = {True: "[green]pass[/]", False: "[red]FAIL[/]", None: "[yellow]?[/]"}
        for found in findings:
            table.add_row(words[found.passed], found.what, found.seen, "" if found.passed else found.remedy)
        print_table(table)
    if bad := [finding.what for finding in findings if finding.passed is False]:
        fail(f"not as the profile says: {', '.join(bad)}")
