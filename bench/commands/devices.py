"""`bench devices`: what is plugged in, and which profile fits."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import typer

from bench.outputs import JSON, File, Json, Overwrite, check_outputs
from bench.terminal.console import print_lines, print_table, write_json

if TYPE_CHECKING:
    from rig.backends.portaudio import Card
    from rig.profile import Profile


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
    from serial.tools.list_ports import comports

    from bench.profiles.find import load, shipped_names
    from rig.backends.base import BackendError
    from rig.backends.portaudio import cards

    check_outputs(File("--json", json, JSON), inputs=profiles or [], overwrite=overwrite)
    known = [load(name)[0] for name in dict.fromkeys([*shipped_names(), *(profiles or [])])]
    try:
        there, why = cards(), ""
    except BackendError as error:
        there, why = [], str(error)
    listed = [asdict(card) | {"profiles": [p.name for p in known if fits(p, card)]} for card in there]
    ports = [
        {
            "port": port.device,
            "description": port.description,
            "profiles": [p.name for p in known if getattr(p.backend, "port", "") == port.device],
        }
        for port in comports()
    ]
    if not write_json({"cards": listed, "ports": ports, "problem": why}, json):
        return
    table = Table("sound card", "driver", "in", "out", "rate (Hz)", "profiles that fit", box=None, pad_edge=False)
    for card in listed:
        keys = ("name", "driver", "inputs", "outputs", "rate_hz")
        table.add_row(*(str(card[key]) for key in keys), ", ".join(card["profiles"]))
    if listed:
        print_table(table)
    else:
        print_lines(f"no sound card{': ' + why if why else ''}")
    print_lines(*(f"serial port {p['port']}  {p['description']}" for p in ports) if ports else ["no serial port"])


def fits(profile: Profile, card: Card) -> bool:
    """True where the profile's sound card can be ``card``: its name, and enough channels."""
    from rig.backends.kinds.soundcard import CardOptions

    table = profile.backend
    if not isinstance(table, CardOptions) or table.device.lower() not in card.name.lower():
        return False
    inputs = table.inputs.wired(profile.channels).values() if table.kind == "soundcard" else [0]
    return card.outputs >= table.output and card.inputs >= max(inputs)
