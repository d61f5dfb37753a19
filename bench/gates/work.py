"""What the gates do, each in a process of its own: the functions that `bench` commands call, and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from bench.jobs.run_ramp import check_rig, open_rig
from bench.terminal.run_console import leave_keys_to_the_parent
from daq.setup.errors import InputError
from rig.backends.base import BackendError
from rig.backends.kinds.soundcard import CardOptions
from rig.checks.check import Check

Message = dict[str, Any]
Ask = Callable[[str], None]


@dataclass(frozen=True)
class Job:
    """Work of a gate, of one of its kinds; a verdict has also the recording, and where the improved profile goes."""

    gate: str
    kind: str
    profile: Path
    scenario: Path | None
    seed: int
    recording: Path | None = None
    improved: Path | None = None


def work(pipe: Connection, job: Job) -> None:
    """Do a job; sends ``("ask", words)`` and waits for an answer where a person has to do something.

    At the end ``("done", answer)``; ``answer["error"]`` says why there is nothing else in it.
    """
    leave_keys_to_the_parent()

    def ask(words: str) -> None:
        pipe.send(("ask", words))
        pipe.recv()

    def tell(words: str) -> None:
        pipe.send(("tell", words))

    try:
        answer = JOBS[job.gate](job, ask, tell)
    except (InputError, BackendError, OSError) as error:
        answer = {"error": str(error)}
    pipe.send(("done", answer))
    pipe.close()


def _card(job: Job, ask: Ask, tell: Ask) -> Message:
    """What is plugged in, what its inputs carry, and the loop-back."""
    from bench.jobs.run_ramp import fits, found_devices
    from rig.backends.portaudio import Card

    profile, backend = open_rig(job.profile, "check", job.scenario, job.seed)
    device: Message = {"name": f"the {backend.name} rig"}
    rows = []
    if isinstance(profile.backend, CardOptions):
        found = found_devices([])
        words = [f"{one['name']} ({one['inputs']} in, {one['outputs']} out)" for one in found["cards"]]
        cards = [Card(**{key: one[key] for key in Card.__dataclass_fields__}) for one in found["cards"]]
        fitting = [card for card in cards if fits(profile, card)]
        rows.append(row_of(
            "sound card", ", ".join(words) or found["problem"] or "none", len(fitting) > 0,
            "backend.device: write words of the name of one that is there; it needs the inputs and the output named",
        ))  # fmt: skip
        device = asdict(fitting[0]) if fitting else {}
    rows += [asdict(one) for one in Check(profile, backend).card()]
    rate = row_of("rate", f"{profile.sampling.rate_hz:g} Hz, of every channel", True)
    return {"rows": [*rows, rate], "device": device}


def _wiring(job: Job, ask: Ask, tell: Ask) -> Message:
    """Which terminal is what, by hand or by the drive."""
    check = Check(*open_rig(job.profile, "check", job.scenario, job.seed))
    if job.kind == "drive":
        return {"rows": [asdict(one) for one in check.wiring()]}
    words = {"tap": "Tap the plate lightly, some times", "lift": "Lift the ball off the plate, some times"}[job.kind]
    return {"rows": [asdict(check.moved(job.kind, lambda: tell(f"{words}: you have four seconds.")))]}


def _calibrate(job: Job, ask: Ask, tell: Ask) -> Message:
    """`bench calibrate`: measured values, written into the profile."""
    from bench.jobs.calibrate import calibrate_into

    def lay(over: bool) -> None:
        how = "upside down" if over else "as it is mounted"
        ask(f"Lay the accelerometer {how}, its axis plumb, and let it lie still.")

    _, _, measured = calibrate_into(job.profile, job.kind, job.scenario, job.seed, lay)
    return {"rows": [row_of(one.key, f"{one.value:.6g} \u00b1 {one.uncertainty:.2g}", True) for one in measured]}


def _check(job: Job, ask: Ask, tell: Ask) -> Message:
    """`bench check`."""
    return {"rows": [asdict(one) for one in check_rig(*open_rig(job.profile, "check", job.scenario, job.seed))]}


def _verdict(job: Job, ask: Ask, tell: Ask) -> Message:
    """`bench close-loop RECORDING --improved PROFILE`."""
    from analysis.loop.close_loop import close_loop
    from analysis.loop.tables import loop_json
    from analysis.report.narrative import headline
    from bench.jobs.loops import keep_verdict
    from bench.profiles.improved import write_improved

    if job.recording is None or job.improved is None:
        raise InputError("no recording to judge; drive a ramp first")
    loop = close_loop([job.recording], progress=lambda what, *_: tell(str(what)))
    problem = keep_verdict(loop, [job.recording])
    lines = write_improved(loop, job.recording, job.improved)[1:]
    full = loop_json(loop)
    errors = {when: full[when]["landing_rms_us"] for when in ("before", "after")}
    numbers = {"verdict": loop.verdict, "effects": full["effects"], "floor_us": full["noise_floor_us"], **errors}
    said = {"headline": headline(loop), "lines": [*([problem] if problem else []), *lines]}
    return {"rows": [], "round": {"recording": job.recording.name, "improved": job.improved.name, **said, **numbers}}


def row_of(what: str, seen: str, passed: bool | None, remedy: str = "") -> Message:
    """A line of a gate's table, as `rig.checks.check.Finding` has it."""
    return {"what": what, "seen": seen, "passed": passed, "remedy": remedy}


KINDS = {
    "card": ("",), "wiring": ("drive", "tap", "lift"), "calibrate": ("accelerometer", "drive", "contact"),
    "check": ("",), "verdict": ("",),
}  # fmt: skip
"""Kinds of a gate's work."""

JOBS: dict[str, Callable[[Job, Ask, Ask], Message]] = {
    "card": _card, "wiring": _wiring, "calibrate": _calibrate, "check": _check, "verdict": _verdict,
}  # fmt: skip
"""What each gate does; the ramp is `bench.live.processes.run_profile`."""
