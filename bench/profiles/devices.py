"""Sound cards and serial ports that are plugged in, each with the profiles that fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from serial.tools.list_ports import comports

from bench.profiles.find import load, shipped_names
from rig.backends.base import BackendError
from rig.backends.kinds.soundcard import CardOptions
from rig.backends.portaudio import Card, cards
from rig.profile import Profile


def found_devices(profiles: Sequence[str]) -> dict[str, Any]:
    """What is there: ``cards``, ``ports``, and as ``problem`` why no card could be looked for (else empty).

    Shipped profiles and ``profiles``, paths or names, are held against it (raises `InputError`).
    """
    known = [load(name)[0] for name in dict.fromkeys([*shipped_names(), *profiles])]
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
    return {"cards": listed, "ports": ports, "problem": why}


def fits(profile: Profile, card: Card) -> bool:
    """True where the profile's sound card can be ``card``: its name, and enough channels."""
    table = profile.backend
    if not isinstance(table, CardOptions) or table.device.lower() not in card.name.lower():
        return False
    inputs = table.inputs.wired(profile.channels).values() if table.kind == "soundcard" else [0]
    return card.outputs >= table.output and card.inputs >= max(inputs)
