"""A discovered term as an effect: its file, and the loop closed again with it in the library."""

from __future__ import annotations

import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from analysis.loop.result import ClosedLoop
from analysis.loop.term_effect import TermEffect, check_new, effect_source
from bench.outputs import PYTHON, File, check_outputs
from daq.files.whole_file import write_whole
from daq.setup.errors import InputError
from model.effects import user_effects


def place_for(name: str, *, overwrite: bool) -> Path:
    """The file of a new effect, checked before any work; its folder is made.

    A file that is to be replaced is left out of the library of this process.

    Raises `InputError` for what is no name, a name that is taken, and a place that cannot be written.
    """
    if not name.isidentifier():
        check_new(name)
    folders = user_effects.folders()
    if not folders:
        raise InputError(
            f"--keep-term {name}: {user_effects.VARIABLE} names no folder of effects; name one there, or by "
            "bench --effects FOLDER close-loop ..."
        )
    path = folders[0] / f"{name}.py"
    try:
        folders[0].mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--keep-term {name}: {folders[0]} cannot be made ({error}); name another folder") from error
    check_outputs(File("--keep-term", path, PYTHON), overwrite=overwrite)
    if overwrite:
        user_effects.leave_out(path)
    check_new(name)
    return path


def keep_term(
    loop: ClosedLoop,
    path: Path,
    recordings: Sequence[Path],
    profile: Path | None,
    improved: Path | None,
    *,
    quiet: bool,
) -> tuple[TermEffect, list[str]]:
    """Write the discovered term of ``loop`` as the effect ``path``, and close the loop again with it.

    Raises `InputError` where there is no term that can become an effect.

    Parameters
    ----------
    loop
        A closed loop with a discovered term.
    path
        The effect's file.
    recordings, profile
        As the loop was closed with.
    improved
        Improved profile of the loop with the effect; None: none is written.
    quiet
        Whether no progress is shown.

    Returns
    -------
    TermEffect
        What became of it.
    list of str
        Lines about the improved profile.
    """
    write_whole(path, effect_source(loop, path.stem))
    # the library is read, and its kernels are compiled, once in a process: the new effect needs another
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        again, lines = pool.submit(_close_again, list(recordings), profile, improved, quiet).result()
    form = "" if loop.discovered is None else loop.discovered.suggested
    return TermEffect(path.stem, str(path), form, *again), lines


def _close_again(
    recordings: list[Path], profile: Path | None, improved: Path | None, quiet: bool
) -> tuple[tuple[Any, ...], list[str]]:
    """The second loop as `TermEffect` holds it, by the library as it is now; lines about the improved profile."""
    from analysis.loop.close_loop import close_loop
    from analysis.report.wording import verdict_line
    from bench.profiles.find import load_measuring
    from bench.profiles.improved import write_improved
    from bench.terminal.progress import progress_bar

    setup, text = (None, None) if profile is None else load_measuring(profile)
    with progress_bar(quiet) as bar:
        loop = close_loop(recordings, setup=setup, progress=bar, anyway=True)
    lines = [] if improved is None else write_improved(loop, recordings[0], improved, text)
    return (
        loop.verdict,
        verdict_line(loop),
        loop.selection.effects,
        loop.errors.before,
        loop.errors.after,
        loop.errors.landing_floor_us,
    ), lines
