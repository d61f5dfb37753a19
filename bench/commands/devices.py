"""`bench devices`: what is plugged in, and which profile fits."""

from __future__ import annotations

import typer

from bench.outputs import JSON, File, Json, Overwrite, check_outputs
from bench.terminal.console import print_lines, print_table, write_json


def command(
    profiles: list[str] = typer.Argument(None, metavar="[PROFILE]...", help="Profiles to hold against what is there."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """List sound cards and serial ports, and which profiles (the shipped ones, and those named) fit them.

    Example: bench devices my_rig.toml

    Exits 0, also when nothing is there; 2 when a profile cannot be read.
    """
    from rich.table import Table

    from bench.profiles.devices import found_devices

    check_outputs(File("--json", json, JSON), inputs=profiles or [], overwrite=overwrite)
    found = found_devices(profiles or [])
    if not write_json(found, json):
        return
    listed, ports, why = found["cards"], found["ports"], found["problem"]
    table = Table("sound card", "driver", "in", "out", "rate (Hz)", "profiles that fit", box=None, pad_edge=False)
    for card in listed:
        keys = ("name", "driver", "inputs", "outputs", "rate_hz")
        table.add_row(*(str(card[key]) for key in keys), ", ".join(card["profiles"]))
    if listed:
        print_table(table)
    else:
        print_lines(f"no sound card{': ' + why if why else ''}")
    print_lines(*(f"serial port {p['port']}  {p['description']}" for p in ports) if ports else ["no serial port"])
