"""A rig and its devices; a ramp driven and recorded, with a display and soft stops; a stopped one resumed.

A resumed ramp, or one step repeated, is a new recording: it names the first, which is only read, and from which step it
goes on.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from bench.profiles.find import find_scenario, load, shipped_names
from bench.terminal.run_console import TypedLines, run_display, stop_on_signals
from daq.recorder.recorder_process import RecorderProcess
from daq.recording import Recording, open_recording
from daq.recording.writer import RecordingWriter
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from rig.backends.base import Backend, BackendError
from rig.backends.kinds.base import OpenOptions
from rig.backends.kinds.soundcard import CardOptions
from rig.backends.registry import open_backend
from rig.backends.simulated import SimulatedBackend
from rig.checks.check import TAP_S, Check, Finding
from rig.execution.branch_hold import BranchHold, LockedBranch
from rig.execution.operator import RunSummary, Status, StopRequest
from rig.execution.priority import before_other_work
from rig.execution.run import run_ramp
from rig.profile import BranchTable, Profile, parse_profile
from rig.programme.ramp import plan
from rig.programme.sequencer import largest_block
from rig.sim.scenario import Scenario

if TYPE_CHECKING:
    from model.bifurcations.continuation import CycleBranch
    from rig.backends.portaudio import Card


class Onlooker(Protocol):
    """The watcher of a run, which may ask things of it: `bench.live.board.RunSide`, in a room above this one."""

    def recorder(self, path: Path, setup: Setup, **options: Any) -> RecorderProcess: ...
    def begin(
        self, recorder: RecorderProcess, backend: Backend, request: StopRequest, progress: Callable[[Status], None]
    ) -> Callable[[Status], None]: ...
    def end(self, summary: RunSummary | None, fault: str = "") -> None: ...


def make_backend(
    profile: Profile,
    *,
    scenario: Path | None = None,
    seed: int = 0,
    real_time: bool = False,
    watched: bool = False,
    replay: Path | None = None,
) -> Backend:
    """The back end that ``profile`` asks for (or `InputError`); a simulated one ``watched`` keeps to the clock."""
    real_time |= watched and profile.backend.kind == "simulated"
    if scenario is not None and profile.backend.kind == "simulated":
        scenario = find_scenario(scenario)
    return open_backend(profile, OpenOptions(scenario, seed, real_time, replay))


def open_rig(name: str | Path, purpose: str, scenario: Path | None, seed: int) -> tuple[Profile, Backend]:
    """A profile and its back end, to ``purpose`` (check, calibrate); raises `InputError` for one that only replays."""
    profile, _ = load(name)
    if profile.backend.kind == "replay":
        raise InputError(f"{name}: backend.kind is replay: there is no rig to {purpose}")
    return profile, make_backend(profile, scenario=scenario, seed=seed)


def check_rig(profile: Profile, backend: Backend, *, tap: bool = False) -> list[Finding]:
    """The findings of `bench check`, with a ``tap`` of the table; raises `InputError`, `BackendError`."""
    if not backend.simulated:
        warm_up(profile)
    words = f"hit the resting table once now, within {TAP_S / 2.0:g} s"
    return Check(profile, backend, (lambda: print(words, file=sys.stderr, flush=True)) if tap else None).run()


def found_devices(profiles: Sequence[str]) -> dict[str, Any]:
    """What is there: ``cards``, ``ports``, and as ``problem`` why no card could be looked for (else empty).

    Shipped profiles and ``profiles``, paths or names, are held against it (raises `InputError`).
    """
    from serial.tools.list_ports import comports

    from rig.backends.portaudio import cards

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


def branch_hold(profile: Profile) -> BranchHold:
    """What holds the ball through a ramp, by its ``[control.branch]`` or the defaults (raises as `locked_branch`)."""
    table = (profile.control.branch if profile.control else None) or BranchTable()
    branch = locked_branch(profile)
    known = LockedBranch(branch.gamma, branch.phase[:, 0], branch.multiplier)
    return BranchHold(profile, table, known)


def locked_branch(profile: Profile) -> CycleBranch:
    """The branch of locked cycles of one flight a period that reaches highest in the ramp; raises `InputError`."""
    from model.bifurcations.continuation import cycle_branches
    from model.effects.registry import ball_effects
    from model.orbits.make_ball import make_ball
    from model.tones import Forcing

    multiples, displacements = zip(*profile.forcing.displacement_tones(), strict=True)
    forcing = Forcing.of_displacements(multiples, np.array(displacements), from_first=False)
    frequency_hz, g_mps2 = profile.forcing.frequency_hz, profile.g_mps2.value
    ball = make_ball(forcing, ball_effects(profile.declared_values()), frequency_hz=frequency_hz, g_mps2=g_mps2)
    highest = max(profile.ramp.gammas())
    found = [
        branch
        for branch in cycle_branches(ball, 0.1 * highest, 1.02 * highest, 1)
        if branch.periods == 1 and len(branch.gamma) > 2 and abs(branch.multiplier).min() < 1.0
    ]
    if not found:
        raise InputError(
            f"profile {profile.name!r}: up to gamma {highest:g} the ball has no stable locked cycle of one flight a "
            "period from which to be held; raise ramp.gamma, or leave --hold-branch out"
        )
    return max(found, key=lambda branch: float(branch.gamma[-1]))


def record(
    profile: Profile,
    text: str,
    backend: Backend,
    out: Path,
    *,
    note: str | None = None,
    extra: dict[str, Any] | None = None,
    quiet: bool = False,
    paced: bool = False,
    onlooker: Onlooker | None = None,
    request: StopRequest | None = None,
    typed: TypedLines | None = None,
    hold: BranchHold | None = None,
) -> RunSummary:
    """Run ``profile``'s ramp into the new recording ``out``, with a progress bar; signals stop it softly.

    Lines ``typed`` meanwhile are obeyed; ``request`` is for whoever wants to know what was asked of the run.

    What cannot wait (a device, a paced rig) is recorded by a process of its own; a rig at full speed is recorded here.
    An ``onlooker`` needs such a process. ``hold`` holds the ball on a branch (`branch_hold`).
    """
    programme = plan(profile)
    options: dict[str, Any] = dict(
        profile_text=text, channels=backend.channels, scales=backend.scales, backend=backend.name,
        simulated=backend.simulated, note=note, extra=extra, scenario_sha256=backend.scenario_sha256,
        expected_samples=programme.n_samples,
    )  # fmt: skip
    if not backend.simulated:
        warm_up(profile)
    first = nullcontext() if backend.simulated else before_other_work()
    with stop_on_signals(request) as request, first, run_display(quiet) as progress:
        writer: RecordingWriter | RecorderProcess
        if paced or not backend.simulated:
            make = RecorderProcess if onlooker is None else onlooker.recorder
            writer = make(
                out, profile.setup(), block_samples=largest_block(programme.clock, profile.backend.block_samples),
                patience_s=10.0 if backend.simulated else 0.0, **options,
            )  # fmt: skip
        else:
            writer = RecordingWriter(out, profile.setup(), **options)
        if onlooker is not None and isinstance(writer, RecorderProcess):
            progress = onlooker.begin(writer, backend, request, progress)
        if typed is not None:
            progress = typed.obeyed(request, progress)
        summary: RunSummary | None = None
        try:
            summary = run_ramp(profile, backend, writer, progress=progress, stop_request=request, hold=hold)
            return summary
        finally:
            if onlooker is not None:
                onlooker.end(summary, "the run ended with an error of its own; see the terminal")
            if not writer.n_samples:  # a device that never answered: nothing to keep, and the name stays free
                out.unlink(missing_ok=True)


def warm_up(profile: Profile) -> None:
    """One short step of ``profile`` on the simulated rig: nothing is left to be compiled while a device waits."""
    short = profile.ramp.model_copy(
        update={"gamma": (max(profile.ramp.gammas()),), "order": None, "settle_cycles": 2, "hold_cycles": 8}
    )
    rig = SimulatedBackend(profile.sampling.rate_hz, Scenario("ideal"), 0)
    with TemporaryDirectory() as folder:
        writer = RecordingWriter(
            Path(folder) / "warm.h5", profile.setup(), profile_text="", channels=rig.channels, scales=rig.scales,
            backend=rig.name, simulated=True,
        )  # fmt: skip
        run_ramp(profile.model_copy(update={"ramp": short}), rig, writer)


def continued(profile: Profile, first: Path | None, step: int | None = None) -> tuple[Profile, dict[str, Any]]:
    """The rest of a ramp, and the free keys by which the new recording names the first (raises `InputError`).

    ``profile`` is the whole ramp's, as for ``first``, the recording that was stopped (None: the whole ramp is left);
    ``step``, numbered as `bench plan` does (from 0), is repeated and no other.
    """
    if first is None:
        if step is not None:
            raise InputError(f"--step {step}: name the recording whose step it repeats by --resume REC.h5")
        return profile, {}
    gammas = profile.ramp.gammas()
    with open_recording(first) as recording:
        before = parse_profile(str(recording.attrs.get("profile_text", "")), f"{first} (its profile)")
        if before.forcing != profile.forcing or before.ramp != profile.ramp:
            raise InputError(
                f"{first}: was driven by another ramp; wanted the same [forcing] and [ramp] as the profile's"
            )
        began = str(recording.attrs.get("started", ""))
        if step is None:
            start = _first_unfinished(recording)
            if start >= len(gammas):
                raise InputError(f"{first}: all {len(gammas)} steps were finished; --step N repeats one of them")
            left = gammas[start:]
        else:
            if not 0 <= step < len(gammas):
                raise InputError(f"--step {step}: the ramp has the steps 0 to {len(gammas) - 1}; see bench plan")
            start, left = step, (gammas[step],)
    ramp = profile.ramp.model_copy(update={"gamma": left, "order": None})
    keys = {"continues": first.name, "continues_started": began, "from_step": start, "one_step": step is not None}
    return profile.model_copy(update={"ramp": ramp}), keys


def _first_unfinished(recording: Recording) -> int:
    """Index, in the whole ramp, of the first step that was not held to its end."""
    extra = recording.attrs.get("extra", {})
    if extra.get("one_step"):
        raise InputError(f"{recording.path}: holds one repeated step; resume the recording it names")
    start = int(extra.get("from_step", 0))
    done = 0
    for row in recording.steps:
        first, end = int(row["first_sample"]), int(row["first_sample"] + row["n_samples"])
        gaps = recording.gaps
        inside = gaps[(gaps[:, 0] > first) & (gaps[:, 0] <= end)]
        held = int(row["n_samples"] - row["settle_samples"]) + int(inside[:, 1].sum())
        wanted = float(row["cycles"]) * recording.rate_hz / float(row["frequency_hz"])
        if end > recording.n_samples or held < wanted - 2:
            break
        done += 1
    return start + done
