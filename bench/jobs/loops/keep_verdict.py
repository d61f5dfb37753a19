"""The file of a recording's closed loop, `RUN.loop` in its folder, which report and catalogue read. Decision 292."""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.terminal.console import EXIT_USAGE, warn
from daq.recording.subprocess_reader import same_modules
from daq.setup.errors import InputError

if TYPE_CHECKING:
    from analysis.joint.result import JointVerdict
    from analysis.loop.result import ClosedLoop

SAVED = ".loop"


def verdict_file(recordings: Sequence[Path]) -> Path:
    """``run.loop`` for a recording ``run.h5``; of three judged as one, ``run+2.loop`` in the folder of the first."""
    first, others = recordings[0], len(recordings) - 1
    return first.with_name(f"{first.stem}+{others}{SAVED}" if others else f"{first.stem}{SAVED}")


def keep_verdict(loop: ClosedLoop, recordings: Sequence[Path]) -> str:
    """Write a closed loop into the folder of its recordings, in place of an earlier one.

    Returns why it could not be saved, in a sentence; empty where it is saved. A folder that cannot be written, as of an
    archive, or a file of that name that is no closed loop, costs no verdict.
    """
    from analysis.loop.storage import is_verdict, save_verdict

    path = verdict_file(recordings)
    try:
        if path.exists() and not is_verdict(path):
            raise InputError(f"{path}: is there already, and no closed loop; give it another name")
        save_verdict(loop, path)
    except (InputError, OSError) as error:
        return f"the verdict is not saved next to the recording, where report and catalogue look for it: {error}"
    return ""


def conclude(
    loop: ClosedLoop,
    recordings: Sequence[Path],
    outputs: Sequence[tuple[str, Callable[[], object]]],
    *,
    quiet: bool = False,
) -> bool:
    """Show a verdict unless ``quiet``, save it with its recordings, then write each output; whether all were written.

    The verdict comes first: no output that cannot be written takes it away.
    """
    from bench.terminal.loop_display import show, write_outputs

    if not quiet:
        show(loop)
    if problem := keep_verdict(loop, recordings):
        warn(problem)
    return write_outputs(outputs)


def drawn(found: ClosedLoop | JointVerdict, folder: Path, *, quiet: bool = False, **more: Any) -> Path:
    """Have a verdict drawn by `bench.jobs.loops.drawing`: what computes a verdict needs none of what draws it.

    Raises `InputError` when it could not be written. Returns the path of what was written.

    ``more``: further arguments of `write_report`, or of `analysis.report.figures.several.write_pictures`.
    """
    call = [sys.executable, "-m", "bench.jobs.loops.drawing"]
    what = pickle.dumps((found, folder, quiet, more))
    done = subprocess.run(call, input=what, stdout=subprocess.PIPE, env=same_modules(), check=False)
    answer = done.stdout.decode("utf-8")
    if done.returncode == EXIT_USAGE:
        raise InputError(answer)
    if done.returncode:
        raise InputError(f"{folder}: the process that draws it ended with exit status {done.returncode}")
    return Path(answer)
