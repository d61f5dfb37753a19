"""The state of the gates as the page shows it: one message, from which the page draws everything."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Any, Protocol

from bench.gates.state import GATES, State, changed, inputs_of
from bench.profiles.find import planned, scenario_names, shipped_names
from bench.profiles.improved import PRESETS
from daq.files.json_values import json_object
from daq.setup.errors import InputError
from daq.setup.setup import quantities
from rig.profile import Profile

Message = dict[str, Any]


class Shown(Protocol):
    """What is shown of `bench.gates.desk.Gates`."""

    state: State
    profile: Profile | None
    fault: str
    job: Message | None

    @property
    def rig(self) -> Mapping[str, Any]: ...
    def profiles(self) -> list[str]: ...
    def is_green(self, gate: str) -> bool: ...


def view_of(gates: Shown) -> Message:
    """The message of kind ``gates``."""
    state, profile = gates.state, gates.profile
    chosen: Message = {"profile": state.profile, "scenario": state.scenario, "seed": state.seed, "fault": gates.fault}
    if profile is not None:
        wired = getattr(profile.backend, "inputs", None)
        terminals = {
            name: f"input {getattr(wired, name)}" if wired is not None else channel.terminal or name
            for name, channel in profile.channels.recorded().items()
        }
        chosen |= {
            "simulated": profile.backend.kind == "simulated", "backend": profile.backend.kind,
            "description": profile.description, "terminals": terminals, "scales": scales_of(profile),
            "plan": _plan(profile), "output": getattr(profile.backend, "output", None),
        }  # fmt: skip
    return json_object({
        "kind": "gates",
        **chosen,
        "profiles": gates.profiles(),
        "shipped": shipped_names(),
        "scenarios": scenario_names(),
        "presets": PRESETS,
        "gates": [_gate(gates, gate) for gate in GATES],
        "job": gates.job,
        "run": None if state.run is None else {"out": state.run["out"]},
        "queue": len(state.queue),
        "rounds": state.rounds,
        "can_undo": len(state.undo),
    })  # fmt: skip


def _gate(gates: Shown, gate: str) -> Message:
    """One gate: green, open or closed, what was found, and what was changed since."""
    result, before = gates.state.results.get(gate), GATES[: GATES.index(gate)]
    is_open = all(gates.is_green(one) for one in before)
    state, since = ("green" if gates.is_green(gate) else "open" if is_open else "closed"), []
    if result is not None and result.inputs and gates.profile is not None and gate != "verdict":
        since = changed(result.inputs, inputs_of(gate, gates.profile, gates.rig, gates.state.device))[:8]
    one: Message = {"name": gate, "state": state, "since": since, "at": "", "rows": (), "file": "", "passed": None}
    if result is not None:
        one |= {"at": result.at, "rows": result.rows, "file": result.file, "passed": result.passed}
    return one


def scales_of(profile: Profile) -> list[Message]:
    """Each scale with its value, age in days, and whether it is ``good``, ``old`` or ``missing``."""
    rows, today = [], datetime.date.today()
    for kind, key, quantity in quantities(profile):
        date = None if quantity is None else quantity.date
        days = None if date is None else (today - date).days
        state = "missing" if days is None else "old" if days > profile.calibration_days else "good"
        value = "" if quantity is None else f"{quantity.value:.6g} \u00b1 {quantity.uncertainty:.2g}"
        source = "" if quantity is None else quantity.source
        rows.append({"kind": kind, "key": key, "value": value, "days": days, "state": state, "source": source})
    return rows


def _plan(profile: Profile) -> Message:
    """What the ramp will do: for each step its times and the peaks of drive and plate, with the limits."""
    try:
        programme, rows, faults = planned(profile)
    except InputError as error:
        return {"fault": str(error), "steps": [], "limits": {}, "faults": []}
    every, limits = -(-len(rows) // 400), profile.limits
    steps = []
    for at in range(0, len(rows), every):  # several steps are drawn as one, with the highest of each peak
        some = [step for step, _ in rows[at : at + every]]
        peaks = [(a.drive_v, 1e3 * a.displacement_m, a.acceleration_mps2) for _, a in rows[at : at + every]]
        start_s, end_s = some[0].first_sample / programme.rate_hz, some[-1].end_sample / programme.rate_hz
        steps.append([start_s, end_s, *map(max, zip(*peaks, strict=True))])
    return {
        "fault": "", "faults": faults[:5], "n_steps": len(rows), "steps": steps,
        "duration_s": programme.n_samples / programme.rate_hz, "frequency_hz": profile.forcing.frequency_hz,
        "ratio": profile.forcing.ratio,
        "limits": {"drive_v": limits.drive_v, "displacement_mm": 1e3 * limits.displacement_m,
                   "plate_mps2": limits.plate_mps2},
    }  # fmt: skip
