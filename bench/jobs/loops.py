"""Jobs around a closed loop: what it found stored as files; runs judged together, or chosen one after another.

A recording's closed loop is `RUN.loop` in its folder, which report and catalogue read. Decision 292. A discovered term
becomes the file of an effect, and the loop is closed again with it in the library.

Runs are chosen one after another on the simulated rig (run, analyse, choose) until one hypothesis stands. The analysis
reads only recordings; what the rig hides stays in the scenario file, which only the process that makes a run
(`bench ramp`) reads. Decision 448.
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.loop.close_loop import FittedLoop, close_loop, fit_loop
from analysis.loop.result import ClosedLoop, is_verdict, save_verdict
from analysis.loop.term_effect import TermEffect, check_new, effect_source
from bench.outputs import PYTHON, File, check_outputs
from bench.profiles.find import load_measuring
from bench.profiles.improved import possible_runs, profile_of, profile_text, write_improved
from bench.terminal.console import EXIT_USAGE, progress_bar, speaker, warn, write_json
from daq.files.disk import Journal, write_whole
from daq.instrument.instrument import refuse_doubtful
from daq.recording import open_recording
from daq.recording.opening import same_modules
from daq.setup.errors import InputError
from model.effects import user_effects

if TYPE_CHECKING:
    from analysis.joint.result import JointVerdict


SAVED = ".loop"


def verdict_file(recordings: Sequence[Path]) -> Path:
    """``run.loop`` for a recording ``run.h5``; of three judged as one, ``run+2.loop`` in the folder of the first."""
    first, others = recordings[0], len(recordings) - 1
    return first.with_name(f"{first.stem}+{others}{SAVED}" if others else f"{first.stem}{SAVED}")


def keep_verdict(loop: ClosedLoop, recordings: Sequence[Path]) -> str:
    """Write a closed loop into the folder of its recordings; why it could not be saved, in a sentence, else empty.

    A folder that cannot be written, as of an archive, or a file of that name that is no closed loop, costs no verdict.
    """
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
    """Show a verdict unless ``quiet``, save it, then write each output (none takes it away); whether all were."""
    from bench.terminal.loop_display import show, write_outputs

    if not quiet:
        show(loop)
    if problem := keep_verdict(loop, recordings):
        warn(problem)
    return write_outputs(outputs)


def drawn(found: ClosedLoop | JointVerdict, folder: Path, *, quiet: bool = False, **more: Any) -> Path:
    """Have a verdict drawn by `bench.jobs.drawing`; the path of what was written (`InputError`: it could not be).

    ``more``: further arguments of `write_report`, or of `analysis.report.figures.several.write_pictures`.
    """
    call = [sys.executable, "-m", "bench.jobs.drawing"]
    what = pickle.dumps((found, folder, quiet, more))
    done = subprocess.run(call, input=what, stdout=subprocess.PIPE, env=same_modules(), check=False)
    answer = done.stdout.decode("utf-8")
    if done.returncode == EXIT_USAGE:
        raise InputError(answer)
    if done.returncode:
        raise InputError(f"{folder}: the process that draws it ended with exit status {done.returncode}")
    return Path(answer)


def place_for(name: str, *, overwrite: bool) -> Path:
    """The file of a new effect, name and place checked before any work (raises `InputError`); its folder is made."""
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

    ``recordings`` and ``profile`` are as the loop was closed with; ``improved`` is where the improved profile of the
    loop with the effect goes. Returns what became of the term, and lines about that profile; raises `InputError`.
    """
    write_whole(path, effect_source(loop, path.stem))
    # the library is read, and its kernels are compiled, once in a process: the new effect needs another
    form = "" if loop.discovered is None else loop.discovered.suggested
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_close_again, path, form, list(recordings), profile, improved, quiet).result()


def _close_again(
    path: Path, form: str, recordings: list[Path], profile: Path | None, improved: Path | None, quiet: bool
) -> tuple[TermEffect, list[str]]:
    """The second loop, by the library as it is now, of the term in ``path``; lines about the improved profile."""
    from analysis.report.wording import verdict_line

    setup, text = (None, None) if profile is None else load_measuring(profile)
    with progress_bar(quiet) as bar:
        loop = close_loop(recordings, setup=setup, progress=bar, anyway=True)
    lines = [] if improved is None else write_improved(loop, recordings[0], improved, text)
    found, errors = loop.selection.effects, loop.errors
    about = path.stem, str(path), form, loop.verdict, verdict_line(loop)
    return TermEffect(*about, found, errors.before, errors.after, errors.landing_floor_us), lines


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
    """Judge runs of one rig, show the verdict and write what is asked for; whether everything could be written.

    ``summaries`` is the file of the runs' summaries, to go on after an interruption. Raises `InputError` or `OSError`.
    """
    from analysis.joint.join_runs import join_runs
    from analysis.joint.result import joint_json
    from bench.terminal.loop_display import show_runs, write_outputs

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


def until_clear(
    recordings: list[Path],
    scenario: Path | None,
    seed: int,
    *,
    say: Callable[[str], None],
    quiet: bool,
    anyway: bool = False,
) -> tuple[ClosedLoop, FittedLoop, list[Path], str]:
    """Close the loop, and while several explanations tie, make the run that would separate them.

    ``scenario`` is what the simulated rig hides, which the analysis never reads (`InputError`: it is no simulated rig).
    Returns the last loop and its fits, all recordings, and why a next run could not be made (empty: none failed).
    """
    made = list(recordings)
    with open_recording(made[0]) as opened:
        if not opened.attrs.get("simulated"):
            raise InputError(f"{made[0]}: was not made on the simulated rig; --until-clear makes runs only there")
    text = profile_text(made[0])
    while True:
        with progress_bar(quiet) as bar:
            loop, fitted = fit_loop(made, progress=bar, anyway=anyway)
        # four runs that did not separate them: a fifth of the kind will not either
        if len(loop.selection.ties) < 2 or len(made) - len(recordings) >= 4:
            return loop, fitted, made, ""
        tied = "; ".join(" + ".join(names) for names in loop.selection.ties)
        ranked = [r for r in possible_runs(loop, fitted, made[0]) if not r.design.priors]
        if not ranked or ranked[0].nats < loop.limits.gain_nats:
            say(f"still tied: {tied}; no run that this rig can make would separate them")
            return loop, fitted, made, ""
        say(f"tied: {tied}; next run: {ranked[0].design.description} (worth {ranked[0].nats:.0f} nats)")
        out = made[0].with_name(f"{made[0].stem}-next{len(made) - len(recordings) + 1}.h5")
        if why := _made_run(profile_of(text, ranked[0].design), out, scenario, seed + len(made), quiet):
            return loop, fitted, made, why
        made.append(out)


def _made_run(profile: str, out: Path, scenario: Path | None, seed: int, quiet: bool) -> str:
    """Record the ramp of ``profile`` on the simulated rig; returns why it could not be made, empty where it could."""
    with tempfile.TemporaryDirectory() as folder:
        path, summary, errors = (Path(folder) / name for name in ("next_run.toml", "summary.json", "errors.txt"))
        path.write_text(profile, encoding="utf-8", newline="")
        words = ["ramp", str(path), "--out", str(out), "--seed", str(seed), "--json", str(summary)]
        words += [] if scenario is None else ["--scenario", str(scenario)]
        with errors.open("w+", encoding="utf-8") as stream:
            shown = stream if quiet else None  # None: errors and display on this terminal
            call = [sys.executable, "-m", "bench", *words]
            ramp = subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=shown, env=same_modules())
            while ramp.returncode is None:
                with contextlib.suppress(KeyboardInterrupt):  # goes to the ramp as well, which stops softly
                    ramp.wait()
        if ramp.returncode == 0:
            return ""
        if summary.exists():
            ended = json.loads(summary.read_text(encoding="utf-8"))
            return f"{out}: the run was {ended['how']}: {ended['why']}"
        said = errors.read_text(encoding="utf-8", errors="replace").strip().removeprefix("error: ")
        return said or f"{out}: could not be made, for the reason above"
