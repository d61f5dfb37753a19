"""The state of the gates as the page shows it: one message, from which the page draws everything."""

from __future__ import annotations

import datetime
from pathlib import Path

from bench.gates.state import GATES, Message, changed, inputs_of, load_state
from bench.profiles.find import planned, scenario_names, shipped_names
from bench.profiles.improved import PRESETS
from daq.files.json_values import json_object
from daq.setup.errors import InputError
from daq.setup.setup import quantities
from daq.setup.values import read_toml_text
from rig.profile import Profile, parse_profile


class Passed:
    """One rig and its gates as they were passed; ``folder`` is that of the runs, with its profiles and the state."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.state, self.fault = load_state(folder)  # the fault: why there is no profile, or no state
        self.profile: Profile | None = None
        self.job: Message | None = None  # what is being done: gate, kind, words, whether it waits for an answer

    @property
    def path(self) -> Path:
        """The profile's file."""
        return self.folder / self.state.profile

    def read_profile(self) -> None:
        """Read the profile that was chosen; the fault says why there is none."""
        if not self.state.profile:
            return
        self.profile, self.fault = None, ""
        try:
            self.profile = parse_profile(read_toml_text(self.path), self.state.profile)
        except (InputError, OSError) as error:
            self.fault = str(error)

    def profiles(self) -> list[str]:
        """Names of the profiles in the folder."""
        return sorted(path.name for path in self.folder.glob("*.toml"))

    @property
    def rig(self) -> Message:
        """What a simulated rig hides, and its seed; empty for a device."""
        if self.profile is None or self.profile.backend.kind != "simulated":
            return {}
        return {"scenario": self.state.scenario, "seed": self.state.seed}

    def is_green(self, gate: str) -> bool:
        """Whether a gate was passed with exactly the present inputs, and so were those before it."""
        result = self.state.results.get(gate)
        if result is None or not result.passed or self.profile is None:
            return False
        before = GATES[: GATES.index(gate)]
        if gate == "verdict":
            ramp = self.state.results.get("ramp")
            return ramp is not None and result.file == ramp.file and self.is_green("ramp")
        present = inputs_of(gate, self.profile, self.rig, self.state.device)
        return result.inputs == present and (not before or self.is_green(before[-1]))


def view_of(gates: Passed) -> Message:
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


def _gate(gates: Passed, gate: str) -> Message:
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
