"""Many runs of one rig judged together, each with its own calibrations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from daq.files.whole_file import Journal
from daq.recording import open_recording

BEGINS = b'{"key"'  # of a file of summaries


def judge_runs(
    recordings: Sequence[Path],
    profile: Path | None,
    summaries: Path | None,
    json: str | None,
    report: Path | None,
    *,
    anyway: bool = False,
) -> bool:
    """Judge the runs, show the verdict and write what is asked for; whether everything could be written.

    Raises `InputError` or `OSError` for recordings or a profile that will not do, and files that cannot be read or
    written.

    Parameters
    ----------
    recordings, profile
        Of one rig; a profile replaces the recordings' own.
    summaries
        File of the runs' summaries, to go on after an interruption.
    json, report
        Where the verdict and its pictures go.
    anyway
        Judge recordings that contradict their profiles, too.
    """
    from analysis.joint.join_runs import join_runs
    from analysis.joint.result import joint_json
    from bench.jobs.loops.keep_verdict import drawn
    from bench.profiles.find import load_measuring
    from bench.terminal.console import speaker, write_json
    from bench.terminal.loop_display import show_runs, write_outputs
    from bench.terminal.progress import progress_bar
    from daq.instrument.stored import refuse_doubtful

    quiet = json == "-"
    setup = None if profile is None else load_measuring(profile)[0]
    if not anyway:
        refuse_doubtful(recordings, setup)
    journal = None if summaries is None else Journal(summaries)
    with progress_bar(quiet) as bar:
        found = join_runs(recordings, setup=setup, journal=journal, progress=bar)
    if not quiet:
        show_runs(found)

    def draw(folder: Path) -> None:
        simulated = False  # the badge stands on the picture where any recording was
        for path in recordings:
            with open_recording(path) as opened:
                simulated |= bool(opened.attrs.get("simulated"))
        picture = drawn(found, folder, quiet=quiet, simulated=simulated)
        if picture.exists():
            speaker(quiet)(f"picture: {picture}")

    outputs: list[tuple[str, Callable[[], object]]] = [("verdict as JSON", lambda: write_json(joint_json(found), json))]
    if report is not None:
        outputs.append(("pictures", lambda: draw(report)))
    return write_outputs(outputs)


def holds_summaries(path: Path) -> bool:
    """Whether a file was written by `judge_runs`, and may be gone on with."""
    try:
        with path.open("rb") as stream:
            return stream.read(len(BEGINS)) in (BEGINS, b"")
    except OSError:
        return False
