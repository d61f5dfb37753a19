"""Sequential design on the simulated rig: run, analyse, choose the next run, until one hypothesis stands.

The analysis reads only recordings; what the rig hides stays in the scenario file, which only the process that makes a
run (`bench ramp`) reads. Decision 448.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from analysis.loop.close_loop import FittedLoop, fit_loop
from analysis.loop.result import ClosedLoop
from daq.recording.subprocess_reader import same_modules
from daq.setup.errors import InputError


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

    Raises `InputError` when the first recording was not made on the simulated rig.

    ``scenario`` is what the simulated rig hides, which the analysis never reads; ``seed`` is of the new runs' noise.

    Returns
    -------
    The last loop and its fitted model, all recordings, and why a next run could not be made (empty: none failed).
    """
    from bench.profiles.next_run import possible_runs, profile_of, profile_text
    from bench.terminal.progress import progress_bar
    from daq.recording import open_recording

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
