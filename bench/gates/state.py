"""The six gates: what each was passed with, and what they know, in one JSON file and in one message for the page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any, Self

from pydantic import TypeAdapter, ValidationError

from bench.profiles.find import planned, scenario_names, shipped_names
from bench.profiles.improved import PRESETS
from daq.files.disk import write_whole
from daq.files.json_values import json_object, json_text
from daq.setup.errors import InputError
from daq.setup.setup import quantities
from daq.setup.values import read_toml_text
from rig.profile import Profile, parse_profile
from rig.programme.ramp import peaks

GATES = ("card", "wiring", "calibrate", "check", "ramp", "verdict")
Inputs = dict[str, Any]
_WIRED = ("terminal", "coupling", "range_v", "serial_number", "sign")  # of a channel, before its scale is known


def inputs_of(gate: str, profile: Profile, rig: Mapping[str, Any], device: Mapping[str, Any]) -> Inputs:
    """What a gate before ``verdict`` is passed with, by name: its own inputs and those of the gates before it."""
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


FILE = "desk.json"
Message = dict[str, Any]


@dataclass(frozen=True)
class Result:
    """Outcome of a gate: passed or not, with which inputs, when (ISO 8601), rows that the page shows, a recording."""

    passed: bool
    inputs: Inputs
    at: str
    rows: tuple[Message, ...] = ()
    file: str = ""


@dataclass(frozen=True)
class State:
    """Everything that has to outlive the page."""

    profile: str = ""  # name of the profile's file in the folder; empty before one was chosen
    scenario: str = ""  # what a simulated rig hides
    seed: int = 0  # of its noise
    device: Message = field(default_factory=dict)  # the card as it was found
    results: dict[str, Result] = field(default_factory=dict)  # by gate
    undo: tuple[str, ...] = ()  # earlier texts of the profile, oldest first
    run: Message | None = None  # the run that is under way: its board, profile, recording and inputs; None without one
    queue: tuple[Message, ...] = ()  # runs to follow: the note of each
    rounds: tuple[Message, ...] = ()  # verdicts of this profile and its improved ones, oldest first

    def passed(self, gate: str, result: Result) -> Self:
        """This state with the result of a gate."""
        return replace(self, results=self.results | {gate: result})


def now() -> str:
    """The time of a result (ISO 8601, UTC)."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def load_state(folder: Path) -> tuple[State, str]:
    """The state in a folder, and a fault: a file that holds no state is set aside, and the fault says where to."""
    path = folder / FILE
    if not path.is_file():
        return State(), ""
    try:
        return TypeAdapter(State).validate_json(path.read_bytes()), ""
    except ValidationError as error:
        aside = next(one for n in count(1) if not (one := path.with_name(f"{FILE}.unreadable-{n}")).exists())
        path.rename(aside)
        place = ".".join(str(part) for part in error.errors()[0]["loc"]) or "the file"
        why = f"{place}: {error.errors()[0]['msg']}"
        return State(), f"{path}: holds no state of the gates ({why}); it is now {aside.name}, and the gates begin anew"


def save_state(folder: Path, state: State) -> None:
    """Replace the state's file (raises OSError)."""
    write_whole(folder / FILE, json_text(asdict(state)))


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

    def _known(self) -> Profile:
        if self.profile is None:
            raise InputError(self.fault or "choose a profile first")
        return self.profile

    def inputs(self, gate: str) -> Inputs:
        """What a gate would be passed with now, as `inputs_of`."""
        return inputs_of(gate, self._known(), self.rig, self.state.device)

    def is_green(self, gate: str) -> bool:
        """Whether a gate was passed with exactly the present inputs, and so were those before it."""
        result = self.state.results.get(gate)
        if result is None or not result.passed or self.profile is None:
            return False
        before = GATES[: GATES.index(gate)]
        if gate == "verdict":
            ramp = self.state.results.get("ramp")
            return ramp is not None and result.file == ramp.file and self.is_green("ramp")
        return result.inputs == self.inputs(gate) and (not before or self.is_green(before[-1]))


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
        since = changed(result.inputs, gates.inputs(gate))[:8]
    one: Message = {"name": gate, "state": state, "since": since, "at": "", "rows": (), "file": "", "passed": None}
    if result is not None:
        one |= {"at": result.at, "rows": result.rows, "file": result.file, "passed": result.passed}
    return one


def scales_of(profile: Profile) -> list[Message]:
    """Each scale with its value, age in days, and whether it is ``good``, ``old`` or ``missing``."""
    rows, today = [], datetime.now().date()
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
