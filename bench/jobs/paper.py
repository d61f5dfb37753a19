"""The seed paper, figure by figure: each drawn from the model or measured on a rig, with its numbers, as one page."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined
from matplotlib.figure import Figure as Canvas

from analysis.flights.assemble import flights_of
from analysis.flights.compare import compare, first_bifurcation
from analysis.flights.table import FlightFlag, write_csv
from analysis.report.figures import style
from analysis.report.figures.flights import Measured, draw_bifurcations, draw_return_maps
from analysis.report.figures.theory import draw_branches, draw_orbit
from analysis.report.wording import gamma_scale
from bench.jobs.run_ramp import record
from bench.predict.figures import draw_diagram
from bench.profiles.edit import with_values
from bench.profiles.find import load, refuse_forbidden
from daq.files.disk import write_whole
from daq.recording import open_recording
from daq.setup.errors import InputError
from kernels.arrays import Floats
from model.effects.registry import Effects
from model.orbits.landing_map import landing_map
from model.orbits.make_ball import make_ball
from model.surveys.diagram import adaptive, diagram
from model.tones import Forcing
from rig.backends.simulated import SimulatedBackend
from rig.sim.scenario import Scenario, ordinary_instrument

Table = Mapping[str, Floats]
PAPER_HZ = 20.0  # the paper's "omega = 20"
FRICTION = {"coulomb_friction": {"mu_up": 0.3, "mu_down": 0.3}}
RESTITUTION = {"restitution": {"e0": 0.514}}
RESONANCE = {"table_resonance": {"frequency_hz": 7.5, "damping": 0.04, "mass_ratio": 0.03}}
LIGHTER = {"restitution": {"e0": 0.1}, "table_resonance": {"frequency_hz": 7.5, "damping": 0.04, "mass_ratio": 0.006}}
RIG = FRICTION | RESTITUTION | RESONANCE  # of Figs. 5 to 9
MODELS: dict[str, Effects] = {
    "ideal": {}, "friction": FRICTION, "restitution": RESTITUTION, "both": FRICTION | RESTITUTION, "full": RIG,
    "lighter": FRICTION | LIGHTER,
}  # fmt: skip
RUNS: dict[str, tuple[int, tuple[float, float, int], int]] = {  # c, gamma from, to, steps, cycles held; others: "full"
    "full": (1, (0.4, 4.0, 37), 25),
    "slow": (1, (0.45, 1.3, 35), 25),
    "maps": (1, (0.78, 1.125, 2), 150),
    "humps": (1, (1.68, 1.72, 33), 50),
    "c2": (2, (0.16, 1.28, 29), 20),
    "c3": (3, (0.08, 0.64, 29), 20),
}
DIAGRAMS: dict[str, tuple[int, float, float, Effects]] = {  # c, range of gamma, effects of the ball
    "figure_4": (1, 0.4, 6.0, {}), "figure_10": (2, 0.15, 3.0, {}), "figure_11": (3, 0.08, 2.0, {}),
    "figure_12": (1, 0.4, 6.0, FRICTION),
}  # fmt: skip
FIGURES: tuple[tuple[str, str, int | None, Callable[[Measured, Canvas], None]], ...] = (  # name, run, its step
    ("figure_5", "full", None, draw_bifurcations), ("figure_6", "slow", None, draw_bifurcations),
    ("figure_7", "maps", 0, draw_return_maps), ("figure_8", "maps", 1, draw_return_maps),
    ("figure_9", "humps", 16, draw_return_maps), ("c2", "c2", None, draw_bifurcations),
    ("c3", "c3", None, draw_bifurcations), ("lighter", "lighter", None, draw_bifurcations),
)  # fmt: skip
EXPECTED = {"lock": math.hypot(math.pi, 1.0), "doubling": math.hypot(math.pi, 2.0)}  # gamma_peak, of the ideal ball


Numbers = dict[str, Any]  # of one run; gamma_peak at c = 1, else gamma; NaN: not seen


def numbers(shown: Measured, effects: Effects) -> Numbers:
    """The paper's numbers of a run, held against the ideal ball, and the first change with ``effects``."""
    flights, held = shown.flights, shown.compared
    if held is None:
        raise InputError(f"{shown.recording.path}: holds no flight; a run of the paper rises beyond take-off")
    factor = gamma_scale(shown.recording.setup.forcing, held.ratio).factor
    peak = factor * np.array([s.gamma for s in held.steps])
    fine, rebound = flights.good(), flights.has(FlightFlag.DOUBLE_HIT)
    every, main = np.array([
        [_mean(flights.duration_s[(flights.step == s.step) & chosen]) / _mean(s.predicted_s) for s in held.steps]
        for chosen in (fine, fine & ~rebound)
    ])  # fmt: skip
    start = next((0.5 * (c.gamma_before + c.gamma_after) for c in held.changes if c.type == "take-off"), math.nan)
    ones = [g for g, s in zip(peak, held.steps, strict=True) if s.measured.kind == "cycle" and s.measured.n == 1]
    high = flights.duration_s[fine & (factor * flights.gamma >= 5.0) & (factor * flights.gamma <= 8.0)]
    return {
        "step": float(np.median(np.diff(peak))),  # distance of the ramp's steps
        "onset": factor * start,  # take-off, known to half a step
        "first": factor * held.first.middle,  # first change after it, known to half a step, and its type
        "changed_to": held.first.measured.type if held.first.measured else "none",
        # first change of the model with the rig's own effects
        "predicted": factor * first_bifurcation(flights, shown.recording.setup, effects).predicted_gamma,
        # greatest step with a 1-cycle below 4.6, where the ideal ball's cycle of two flights ends
        "one_cycles": max((g for g in ones if g < 4.6), default=math.nan),
        # median part by which all flights are shorter than the ideal ball's
        "shorter": 1.0 - _median(every[(peak > 1.3) & (peak < 4.0)]),
        # median flight time over the ideal ball's, rebounds left out
        "at_two": _median(main[(peak > 1.95) & (peak < 2.35)]),
        "in_band": _mean((high > 0.056) & (high < 0.064)),  # part of the flights from 5 to 8 that last so long, s
        "repeats": _mean([s.measured.kind == "cycle" for s in held.steps if factor * s.gamma > 2.3]),
    }


def effects_of(run: str) -> Effects:
    """What the simulated rig of a run hides; the humps are explained without the resonance."""
    return MODELS.get(run, MODELS["both"] if run == "humps" else RIG)


def on_ball(effects: Effects) -> Effects:
    """Those that the exact model has; the slow resonance is in the plate's measured motion."""
    return {name: values for name, values in effects.items() if name != "table_resonance"}


def _mean(values: Any) -> float:
    return float(np.mean(values)) if len(values) else math.nan


def _median(values: Floats) -> float:
    return float(np.nanmedian(values)) if np.isfinite(values).any() else math.nan


def write_plan(plan: Path, text: str) -> Path:
    """The profile ``text`` with forcing and ramp of the run that ``plan`` is named after, written there."""
    ratio, (start, stop, steps), hold = RUNS.get(plan.stem, RUNS["full"])
    values = {"gamma": {"start": start, "stop": stop, "steps": steps}, "order": "up", "hold_cycles": hold}
    own = with_values(text, {"forcing.ratio": ratio, **{f"ramp.{k}": v for k, v in values.items()}}, str(plan))
    write_whole(plan, own)
    return plan


def recorded(plan: Path, seed: int) -> Path:
    """The recording of a run next to its profile, or one of the simulated rig; an `InputError` says how to make it."""
    path, name = plan.with_suffix(".h5"), plan.stem
    if path.exists():
        return path
    profile, own = load(plan)
    refuse_forbidden(str(plan), profile)
    if profile.backend.kind != "simulated":
        raise InputError(f"{path}: not there; record it: bench ramp {plan} --out {path}")
    instrument = ordinary_instrument(np.random.default_rng(seed)) if name in (*RUNS, "lighter") else {}
    rig = SimulatedBackend(profile.sampling.rate_hz, Scenario(name, effects_of(name), rig=instrument), seed)
    summary = record(profile, own, rig, path, quiet=True)
    if summary.how != "complete":
        raise InputError(f"{path}: the run was {summary.how}: {summary.why}")
    return path


def draw_paper_diagram(name: str, figure: Canvas) -> Table:
    """Draw one of `DIAGRAMS`, at the paper's 20 Hz."""
    ratio, low, high, effects = DIAGRAMS[name]
    forcing = Forcing.superposition(ratio)
    rows = adaptive(partial(diagram, make_ball(forcing, effects)), low, high, 600)
    figure.set_size_inches(7.0, 4.4)
    draw_diagram(figure.subplots(), rows, forcing, ratio, PAPER_HZ, ideal=not effects)
    times = rows.tau.ravel() / (2.0 * math.pi * PAPER_HZ)
    known = np.isfinite(times)
    return {"gamma": np.repeat(rows.gamma, rows.tau.shape[1])[known], "flight_time_s": times[known]}


def saved(folder: Path, name: str, badge: str, draw: Callable[[Canvas], Table | None]) -> None:
    """Save a picture, and the table that ``draw`` returns as CSV of the same name."""
    tables: list[Table | None] = []
    style.save_picture(folder, name, badge, lambda figure: tables.append(draw(figure)))
    if (table := tables[0]) is not None:
        columns = np.column_stack(list(table.values()))
        np.savetxt(folder / f"{name}.csv", columns, "%.9g", ",", header=",".join(table), comments="")


def draw_all(shown: Mapping[str, Measured], pictures: Path, seed: int) -> None:
    """Every picture with its table, into the folder ``pictures``."""
    saved(pictures, "figure_1", "SIMULATED: ideal ball", partial(draw_orbit, Forcing.superposition(2), 1.28))
    for name in DIAGRAMS:
        saved(pictures, name, "SIMULATED: ball of the model", partial(draw_paper_diagram, name))
    for name, run, step, draw in FIGURES:
        one, flights = shown[run], shown[run].flights
        if step is not None and one.compared is not None:
            chosen = one.compared.steps[min(step, len(one.compared.steps) - 1)]  # a run may have been stopped
            one = replace(one, compared=replace(one.compared, steps=(chosen,)))
            flights = flights.select(flights.step == chosen.step)
        saved(pictures, name, style.badge_of(one.recording), partial(draw, one))
        write_csv(flights, pictures / f"{name}.csv")
    humps = shown["humps"]
    gammas = np.array([p.gamma for p in humps.flights.plate.steps if p is not None])
    ball, spread = make_ball(Forcing.superposition(1), on_ball(RIG)), float(gammas.std() / gammas.mean())
    branches = landing_map(ball, float(gammas.mean()), np.random.default_rng(seed), spread=spread)
    saved(pictures, "humps", style.badge_of(humps.recording), partial(draw_branches, branches, humps.flights))


def paper(text: str, out: Path, seed: int, progress: Callable[[str, float], None]) -> dict[str, Numbers]:
    """Make the page ``paper.md`` in ``out``, its pictures and tables in ``paper``, its recordings in ``runs``.

    ``text`` is the profile of the rig whose runs are shown: one that is not simulated has recorded them (`InputError`).
    """
    (out / "runs").mkdir(parents=True, exist_ok=True)
    names, shipped = [*RUNS, *(name for name in MODELS if name not in RUNS)], load("paper")[1]
    plans = [write_plan(out / "runs" / f"{name}.toml", text if name in RUNS else shipped) for name in names]
    shown: dict[str, Measured] = {}
    with ExitStack() as opened:
        for plan in plans:
            progress(f"run {plan.stem}", len(shown) / len(plans))
            recording = opened.enter_context(open_recording(recorded(plan, seed)))
            flights = flights_of(recording)
            held = compare(flights, recording.setup, effects={}, steps_table=recording.steps) if len(flights) else None
            shown[plan.stem] = Measured(recording, flights, held)
        progress("drawing", 0.9)
        found = {name: numbers(one, on_ball(effects_of(name))) for name, one in shown.items()}
        draw_all(shown, out / "paper", seed)
    template = Path(__file__).with_suffix(".md").read_text(encoding="utf-8")
    page = Environment(undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True).from_string(template)
    write_whole(out / "paper.md", page.render(found=found, expected=EXPECTED, cpu_s=time.process_time()) + "\n")
    lines = [",".join(map(str, (name, *one.values()))) for name, one in found.items()]
    write_whole(out / "paper" / "numbers.csv", "\n".join([",".join(("run", *found["full"])), *lines]) + "\n")
    return found
