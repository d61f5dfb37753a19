"""The six gates, and what each of them was passed with: a change of that closes it and all that follow."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rig.profile import Profile
from rig.programme.ramp import peaks

GATES = ("card", "wiring", "calibrate", "check", "ramp", "verdict")
Inputs = dict[str, Any]
_WIRED = ("terminal", "coupling", "range_v", "serial_number", "sign")  # of a channel, before its scale is known


def inputs_of(gate: str, profile: Profile, rig: Mapping[str, Any], device: Mapping[str, Any]) -> Inputs:
    """What a gate is passed with, by name: its own inputs and those of the gates before it.

    Parameters
    ----------
    gate
        One of `GATES` before ``verdict``, which judges the recording.
    profile
        The profile.
    rig
        What a simulated rig hides, and its seed; empty for a device.
    device
        The card as the first gate found it.
    """
    whole = profile.model_dump(mode="json")
    backend = dict(whole["backend"])
    wired = backend.pop("inputs", None)
    parts: list[tuple[str, Inputs]] = [
        ("card", {"backend": backend, "sampling": whole["sampling"], "rig": dict(rig)}),
        ("wiring", {
            "device": dict(device), "inputs": wired,
            "wires": {name: {key: channel[key] for key in _WIRED if key in channel}
                      for name, channel in whole["channels"].items() if channel},
        }),
        ("calibrate", {key: whole[key] for key in ("channels", "drive", "g_mps2")}),
        ("check", {
            "forcing": whole["forcing"], "limits": whole["limits"],
            "highest": max(peaks(profile, gamma).gamma_peak for gamma in set(profile.ramp.gammas())),
        }),
        ("ramp", {key: whole[key] for key in ("ramp", "control", "ball", "declared")}),
    ]  # fmt: skip
    found: Inputs = {}
    for name, part in parts:
        found |= part
        if name == gate:
            break
    return found


def changed(before: Any, now: Any, name: str = "") -> list[str]:
    """Dotted names of what differs between two inputs."""
    if isinstance(before, dict) and isinstance(now, dict):
        keys = [*before, *(key for key in now if key not in before)]
        return [
            line for key in keys for line in changed(before.get(key), now.get(key), f"{name}.{key}" if name else key)
        ]
    return [] if before == now else [name]
