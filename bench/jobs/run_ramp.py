"""A ramp driven through the back end of its profile and recorded, with a display and soft stops."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

from bench.profiles.find import find_scenario, load
from bench.terminal.orders import TypedLines
from bench.terminal.run_display import run_display
from bench.terminal.signals import stop_on_signals
from daq.recorder.recorder_process import RecorderProcess
from daq.recording import RecordingWriter
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from rig.backends.base import Backend
from rig.backends.registry import open_backend
from rig.backends.simulated import SimulatedBackend
from rig.checks.check import Check, Finding
from rig.execution.branch_hold import BranchHold
from rig.execution.operator import RunSummary, Status, StopRequest
from rig.execution.priority import before_other_work
from rig.execution.run import run_ramp
from rig.profile import Profile
from rig.programme.ramp import plan
from rig.programme.sequencer import largest_block
from rig.sim.scenario import Scenario


class Onlooker(Protocol):
    """The watcher of a run, which may ask things of it: `bench.live.run_side.RunSide`, in a room above this one."""

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
    replay: Path | None = None,
) -> Backend:
    """The back end that ``profile`` asks for, and no other; raises `InputError`, also for what it would not heed."""
    if scenario is not None and profile.backend.kind == "simulated":
        scenario = find_scenario(scenario)
    return open_backend(profile, scenario=scenario, seed=seed, real_time=real_time, replay=replay)


def open_rig(name: str | Path, purpose: str, scenario: Path | None, seed: int) -> tuple[Profile, Backend]:
    """A profile and its back end, to ``purpose`` (check, calibrate); raises `InputError` for one that only replays."""
    profile, _ = load(name)
    if profile.backend.kind == "replay":
        raise InputError(f"{name}: backend.kind is replay: there is no rig to {purpose}")
    return profile, make_backend(profile, scenario=scenario, seed=seed)


def check_rig(profile: Profile, backend: Backend) -> list[Finding]:
    """The findings of `bench check`; raises `InputError`, `BackendError`."""
    if not backend.simulated:
        warm_up(profile)
    return Check(profile, backend).run()


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
    An ``onlooker`` needs such a process. ``hold`` holds the ball on a branch (`bench.jobs.hold_branch`).
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
            summary = run_ramp(profile, backend, writer, progress=progress, stop_request=request, programme=programme,
                               hold=hold)  # fmt: skip
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
