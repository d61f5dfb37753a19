"""`bench demo`: the main job end to end on a simulated rig that hides something undeclared."""

from __future__ import annotations

import datetime
import math
import shutil
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import typer

from bench.outputs import Folder, Scenario, check_outputs
from bench.terminal.console import DEFECTS, EXIT_FAILED, fail, print_lines, progress_bar, write_json
from daq.setup.errors import InputError
from daq.setup.values import STANDARD_GRAVITY_MPS2

if TYPE_CHECKING:
    from analysis.flights.assemble import Flights
    from analysis.loop.result import ClosedLoop
    from rig.profile import Profile
    from rig.sim.scenario import Scenario as Hidden

UNFINISHED = "unfinished.txt"  # stands in the folder while a demo runs, and stays where it failed
MADE = ("recording.*", "flights.csv", "verdict.json", "improved.toml", "sealed.toml", "pictures", "report")
LIBRARY_UNITS: Mapping[tuple[str, str], tuple[str, float]] = {
    ("adhesion", "pull_g"): ("a_mps2", STANDARD_GRAVITY_MPS2),
    ("position_force", "magnet_g"): ("magnet_mps2", STANDARD_GRAVITY_MPS2),
    ("mains_hum", "amplitude_g"): ("amplitude_mps2", STANDARD_GRAVITY_MPS2),
    ("mains_pickup", "amplitude_g"): ("amplitude_mps2", STANDARD_GRAVITY_MPS2),
    ("accelerometer_offset", "offset_g"): ("offset_mps2", STANDARD_GRAVITY_MPS2),
    ("local_gravity", "relative"): ("excess_mps2", STANDARD_GRAVITY_MPS2),
    ("phase_lag", "time_constant_s"): ("low_pass_s", 1.0),
    ("accelerometer_lag", "time_constant_s"): ("low_pass_s", 1.0),
    ("stribeck_friction", "speed_mps"): ("v_s_mps", 1.0),
    ("contact_closure", "duration_s"): ("closure_s", 1.0),
    ("mass_loading", "mass_ratio"): ("relative", 1.0),  # in contact the plate moves less by 1 + this
    ("stribeck_friction", "mu_static"): ("mu_extra", 1.0),  # less mu_kinetic
    ("gain_compression", "per_v2"): ("per_g2", 0.5),  # of a mean square there, of one tone's amplitude here
    ("harmonic_distortion", "second_per_v"): ("quadratic_per_g", 1.0),
    ("harmonic_distortion", "third_per_v2"): ("cubic_per_g2", 1.0),
}
"""Parameters of a scenario that the library knows by another name or unit: its name there, and the factor."""
DRIVE_POWERS = {"per_g2": 2, "quadratic_per_g": 1, "cubic_per_g2": 2}
"""Powers of the drive's scale, g a volt, by which a number of the drive's volts is divided."""
MEASURED = {(mains, number) for mains in ("mains_hum", "mains_pickup") for number in ("frequency_hz", "phase_rad")}
"""Parameters of a scenario that the library measures from the recorded line of each step, and does not fit."""


def command(
    out: Path | None = typer.Option(None, "--out", metavar="FOLDER", help="Where everything goes; default runs/DATE."),
    profile: str = typer.Option(
        "simulated", "--profile", help="A profile of a simulated rig: its path, or the name of a shipped one."
    ),
    scenario: Scenario = None,
    seed: int = typer.Option(4, "--seed", help="Of the sealed draw and of the rig's noise."),
) -> None:
    """Drive a ramp on a sealed simulated rig, record it, reprocess it, hold it against the model, close the loop.

    Example: bench demo --seed 7

    What the rig hides is drawn by chance and written to a sealed file, opened only after the report is written, unless
    --scenario names it. So is its instrument: filter, noise, mains, card and contact as laboratories have them, which
    no profile describes. No device is ever driven. Exits 1 when a part failed: what was made stays, and the same call
    starts anew.
    """
    from bench.profiles.find import find_scenario
    from rig.sim.scenario import instrument_in_words, load_scenario

    started = time.perf_counter()
    folder = out or Path("runs") / datetime.datetime.now().strftime("%Y-%m-%d_%H%M%S")
    check_outputs(Folder("--out", folder, makes=()), inputs=[profile, scenario])
    checked, text = _simulated(profile)
    hidden = _sealed(seed, checked) if scenario is None else load_scenario(find_scenario(scenario))
    _claim(folder)
    sealed, left = folder / "sealed.toml", f"what was made is in {folder}; the same call starts anew there"
    try:
        sealed.write_text(hidden.to_toml(), encoding="utf-8")
        if scenario is None:
            typer.echo("an ordinary instrument, drawn by chance, stands between this rig and its recording")
        recording = _drive(checked, text, folder, sealed, seed)
        loop, complete = _close(recording, _reprocess(recording, folder), folder)
    except (OSError, InputError) as error:
        fail(f"{error}\n{left}")
    except DEFECTS as error:
        error.add_note(left)
        raise
    effects = load_scenario(sealed).effects
    found = ", ".join(f.name for f in loop.selection.effects) or "no effect added"
    names = ", ".join(effects) or "nothing"
    typer.echo(f"\nthe seal opened: the rig hid {names}; the verdict was: {loop.verdict} ({found})")
    for row in compared(effects, loop):
        typer.echo(f"  {in_words(row)}")
    if scenario is None:
        typer.echo(f"its instrument, which a verdict may name as well: {instrument_in_words(hidden.rig)}")
    for what, path in (
        ("recording", recording), ("flights", folder / "flights.csv"), ("pictures", folder / "pictures"),
        ("report", folder / "report" / "report.html"), ("improved profile", folder / "improved.toml"),
        ("what was hidden", sealed),
    ):  # fmt: skip
        if path.exists():
            typer.echo(f"  {what:<17} {path}")
    if not complete:
        raise SystemExit(EXIT_FAILED)
    (folder / UNFINISHED).unlink()
    typer.echo(f"done in {time.perf_counter() - started:.0f} s")


def _simulated(name: str) -> tuple[Profile, str]:
    """The profile and its text; refused unless its back end is the simulated one and its limits allow the ramp."""
    from bench.profiles.find import load, refuse_forbidden

    profile, text = load(name)
    if profile.backend.kind != "simulated":
        raise InputError(
            f"{name}: backend.kind is {profile.backend.kind}, and the demo drives no device; name a profile of a "
            f"simulated rig, or record a run with bench ramp {name} --out run.h5"
        )
    refuse_forbidden(name, profile)
    return profile, text


def _sealed(seed: int, profile: Profile) -> Hidden:
    """A scenario drawn by chance among the effects that have a name, beyond what the profile's calibrations allow."""
    import numpy as np

    from rig.sim.scenario import left_open, ordinary_instrument, pool, sealed_scenario

    allowed = left_open(profile.setup())
    hidden = sealed_scenario(np.random.default_rng(seed), pool("named"), strength="strong", allowed=allowed)
    # the instrument has a chance of its own, so that a seed hides what it hid before rigs had instruments
    return replace(hidden, rig=ordinary_instrument(np.random.default_rng((seed, 1))))


def _claim(folder: Path) -> None:
    """Make the folder, or clear what an unfinished demo left in it; `InputError` where it holds anything else."""
    if folder.exists():
        if not folder.is_dir() or (any(folder.iterdir()) and not (folder / UNFINISHED).is_file()):
            raise InputError(f"{folder}: exists already; name a new folder by --out")
        for path in [path for pattern in MADE for path in folder.glob(pattern)]:
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()
    folder.mkdir(parents=True, exist_ok=True)
    (folder / UNFINISHED).write_text("A demo began here and has not ended; the same call starts anew.\n", "utf-8")


def _drive(profile: Profile, text: str, folder: Path, sealed: Path, seed: int) -> Path:
    """Record the ramp on the simulated rig; an `InputError` says why a run was not completed."""
    from bench.jobs.run_ramp import record, warm_up
    from rig.backends.simulated import SimulatedBackend
    from rig.sim.scenario import load_scenario

    recording = folder / "recording.h5"
    typer.echo(
        f"1/4  ramp: {profile.name}, c = {profile.forcing.ratio}, {profile.forcing.frequency_hz:g} Hz, simulated rig"
    )
    with progress_bar() as say:
        say("starting the simulated rig", 0.0)
        warm_up(profile)
    rig = SimulatedBackend(profile.sampling.rate_hz, load_scenario(sealed), seed)
    summary = record(profile, text, rig, recording)
    if summary.how != "complete":
        raise InputError(f"{recording}: the run was {summary.how}: {summary.why}")
    return recording


def _reprocess(recording: Path, folder: Path) -> Flights:
    """Flights, pictures, and what the declared model makes of them; returns the flights."""
    from analysis.flights.assemble import flights_of
    from analysis.flights.compare import compare
    from analysis.flights.table import write_csv
    from analysis.report.wording import gamma_scale
    from bench.jobs.report import draw
    from bench.terminal.comparison import sentences
    from daq.recording import open_recording

    with open_recording(recording) as opened:
        typer.echo("2/4  reprocess: flights and plate motion from the file, pictures")
        with progress_bar() as say:
            table = flights_of(opened, progress=lambda part: say("reading the recording", 0.6 * part))
            write_csv(table, folder / "flights.csv")
            say("predicting", 0.6)
            held = compare(table, opened.setup, steps_table=opened.steps)
            say("drawing", 0.7)
            draw(opened, table, folder / "pictures", held)
        typer.echo(f"3/4  compare: {len(table)} flights against the declared model")
        for line in sentences(held, gamma_scale(opened.setup.forcing, held.ratio)):
            typer.echo(f"       {line}")
    return table


def _close(recording: Path, flights: Flights, folder: Path) -> tuple[ClosedLoop, bool]:
    """Close the loop on the flights found, show the verdict, then write it; whether everything could be written."""
    from analysis.loop.close_loop import completed, judge_loop
    from analysis.loop.tables import loop_json
    from analysis.report.page import write_report
    from analysis.residuals.observations import observed
    from bench.jobs.loops import conclude
    from bench.profiles.improved import write_improved
    from daq.recording import open_recording

    typer.echo("4/4  close the loop: which missing effect explains the rest")
    with progress_bar() as say:
        with open_recording(recording) as opened:
            known = {recording: observed(opened, flights)}
        loop, fitted = judge_loop([recording], progress=say, known=known)
        loop = completed(loop, fitted)

    def write_page() -> None:
        with progress_bar() as say:
            write_report(loop, folder / "report", recording=recording, progress=say)

    outputs = (
        ("verdict as JSON", lambda: write_json(loop_json(loop), str(folder / "verdict.json"))),
        ("report", write_page),
        ("improved profile", lambda: print_lines(*write_improved(loop, recording, folder / "improved.toml"))),
    )
    return loop, conclude(loop, [recording], outputs)


class Compared(NamedTuple):
    """A parameter as hidden and as found with its 95 % interval; NaN where it was not hidden, or not found."""

    effect: str
    parameter: str
    hidden: float
    found: float
    low: float
    high: float


def compared(hidden: Mapping[str, Mapping[str, float]], loop: ClosedLoop) -> list[Compared]:
    """Every parameter of the effects that were hidden (a scenario's ``effects``) or added by the loop."""
    sizes = {}
    scale = loop.setup.drive.g_per_volt
    for effect, parameters in hidden.items():
        for parameter, size in parameters.items():
            name, factor = LIBRARY_UNITS.get((effect, parameter), (parameter, 1.0))
            g_per_volt = 1.0 if scale is None else scale.value
            sizes[effect, name] = factor * float(size) / g_per_volt ** DRIVE_POWERS.get(name, 0)
    if ("stribeck_friction", "mu_extra") in sizes:
        sizes["stribeck_friction", "mu_extra"] -= sizes["stribeck_friction", "mu_kinetic"]
    found = {(added.name, name): x for added in loop.selection.effects for name, x in added.parameters.items()}
    nothing = (math.nan, math.nan, math.nan)
    return [
        Compared(*key, sizes.get(key, math.nan), *found.get(key, nothing)) for key in dict.fromkeys((*sizes, *found))
    ]


def in_words(row: Compared) -> str:
    """A line for a person."""
    hidden = "not hidden" if math.isnan(row.hidden) else f"hidden {row.hidden:.4g}"
    nothing = "measured in each step, not fitted" if (row.effect, row.parameter) in MEASURED else "not found"
    found = nothing if math.isnan(row.found) else f"found {row.found:.4g} ({row.low:.4g} to {row.high:.4g})"
    return f"{row.effect + '.' + row.parameter:<34} {hidden:<19} {found}"
