"""`bench compare`: a recording held against the model, step by step, at the gamma that the plate achieved."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bench.outputs import Overwrite

if TYPE_CHECKING:
    from analysis.flights.compare import Comparison, StepComparison
    from analysis.report.gamma import GammaScale


def command(
    recording: Path = typer.Argument(help="The recording (HDF5)."),
    json: str | None = typer.Option(None, "--json", metavar="FILE", help="The same for a machine; - prints it."),
    figures: Path | None = typer.Option(None, "--figures", metavar="FOLDER", help="Draw the pictures there."),
    profile: str | None = typer.Option(None, "--profile", help="A profile that replaces the recording's own."),
    ideal: bool = typer.Option(False, "--ideal", help="Leave the declared effects out of the model."),
    overwrite: Overwrite = False,
) -> None:
    """Measured against predicted: flight times, double hits, and the first bifurcation.

    Example: bench compare run.h5 --profile better.toml --figures pictures
    """
    from analysis.flights.compare import compare
    from analysis.flights.plausibility import plausibility_warnings
    from analysis.report.gamma import gamma_scale
    from bench.commands.reprocess import draw, with_progress
    from bench.outputs import JSON, File, Folder, check_outputs
    from bench.profiles.find import load_measuring
    from bench.terminal.console import EXIT_USAGE, fail, write_json
    from daq.recording import open_recording
    from daq.setup.errors import InputError

    try:
        check_outputs(
            File("--json", json, JSON), Folder("--figures", figures), inputs=[recording, profile], overwrite=overwrite
        )
        with open_recording(recording) as opened:
            if profile is not None:
                opened.measure_with(load_measuring(profile)[0])
            table = with_progress(opened, quiet=json == "-")
            if "continuity" not in opened.channels:
                raise InputError(
                    f"{recording}: wanted a channel 'continuity' (take-offs and landings), found "
                    f"{', '.join(opened.channels)}; `bench reprocess` analyses the plate alone"
                )
            held = compare(table, opened.setup, effects={} if ideal else None, steps_table=opened.steps)
            if figures is not None:
                draw(opened, table, figures)
            odd = plausibility_warnings(opened, table.plate)
            write_json(as_json(held) | {"doubts": odd}, json)
            if json != "-":
                scale = gamma_scale(opened.setup.forcing, held.ratio)
                _print(held, recording.name, bool(opened.attrs.get("simulated")), scale)
                for line in odd:
                    typer.echo(f"note: {line}")
    except (InputError, ValueError) as error:
        fail(str(error), EXIT_USAGE)
    except OSError as error:
        fail(f"{error}; name a file that can be written", EXIT_USAGE)


def as_json(held: Comparison) -> dict[str, Any]:
    """The comparison for a machine; what does not exist is null."""
    first = held.first
    bracket = None if first.measured is None else [first.measured.gamma_before, first.measured.gamma_after]
    return {
        "model_effects": list(held.effects),
        "flights_short_by": _finite(held.short_by),
        "within_one_sample": _finite(held.within_sample),
        "periodic_flights": held.periodic_flights,
        "double_hits": held.double_hits,
        "first_bifurcation": {
            "measured_type": None if first.measured is None else first.measured.type,
            "measured_bracket_gamma": bracket,
            "predicted_type": first.predicted_type or None,
            "predicted_gamma": _finite(first.predicted_gamma),
            "predicted_gamma_same_type": _finite(first.same_type_gamma),
            "ratio": _finite(first.ratio),
        },
        "changes": [
            {
                "type": c.type,
                "bracket_gamma": [c.gamma_before, c.gamma_after],
                "before": c.before.label,
                "after": c.after.label,
            }
            for c in held.changes
        ],
        "steps": [_step_json(s) for s in held.steps],
    }


def _step_json(own: StepComparison) -> dict[str, Any]:
    """One step for a machine."""
    return {
        "step": own.step,
        "gamma": own.gamma,
        "gamma_peak": own.gamma_peak,
        "measured": own.measured.label,
        "flights": own.measured.flights,
        "double_hits": own.measured.double_hits,
        "predicted": own.predicted,
        "doubt": own.unfit_reason or None,
        "predicted_flight_times_s": own.predicted_s.tolist(),
        "mean_ratio": _finite(own.mean_ratio),
        "rms_s": _finite(own.rms_s),
        "within_one_sample": _finite(own.within_sample),
        "forbidden_bands": [
            {"low_s": b.low_s, "high_s": b.high_s, "observed": b.observed, "expected": b.expected, "p_value": b.p_value}
            for b in own.bands
        ],
    }


def _finite(value: float) -> float | None:
    """NaN and infinity as null."""
    import math

    return float(value) if math.isfinite(value) else None


def _print(held: Comparison, name: str, simulated: bool, scale: GammaScale) -> None:
    """Tables for a person."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    title = f"{name}{' (simulated rig)' if simulated else ''} against the model"
    shown = Table(title=title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for column in ("step", scale.name.replace("_", "\n"), "measured", "model", "n", "ratio", "rms us", ""):
        words = column in ("measured", "model")  # these alone are folded where the terminal is narrow
        shown.add_column(column, justify="left" if words else "right", no_wrap=not words, overflow="fold")
    for s in held.steps:
        ratio = f"{s.mean_ratio:.4f}" if s.mean_ratio == s.mean_ratio else ""
        rms = f"{1e6 * s.rms_s:.1f}" if s.rms_s == s.rms_s else ""
        model = s.predicted.replace("with ", "").replace(", period ", " p").replace("at rest on the plate", "at rest")
        shown.add_row(
            str(s.step), f"{scale.factor * s.gamma:.4f}", s.measured.label, model,
            str(s.measured.flights), ratio, rms, "?" if s.unfit_reason else "",
        )  # fmt: skip
    console = Console()
    console.print(shown)
    for line in (*doubts(held), *lines(held, scale)):
        console.print(line, soft_wrap=True, highlight=False)


def doubts(held: Comparison) -> list[str]:
    """Periodic steps that cannot judge the model, and why."""
    why = {
        "sensitive": "the uncertainty of gamma alone moves the prediction",
        "unsettled": "the predicted cycle attracts too slowly for the settle time",
    }
    found: dict[str, list[str]] = {}
    for s in held.steps:
        if s.unfit_reason:
            found.setdefault(s.unfit_reason, []).append(str(s.step))
    return [f"? {name} ({why.get(name, name)}): step {', '.join(steps)}" for name, steps in found.items()]


def lines(held: Comparison, scale: GammaScale) -> list[str]:
    """What it comes to, in sentences, gamma as ``scale`` shows it."""
    effects = ", ".join(held.effects) if held.effects else "no effects (ideal)"
    out = [f"model with {effects}"]
    if held.short_by == held.short_by:
        size, way = abs(100 * held.short_by), "shorter" if held.short_by >= 0 else "longer"
        out.append(f"measured flights are {size:.2f} % {way} than the model's (median over cycles, bounces apart)")
    if held.periodic_flights:
        share = 100 * held.within_sample
        out.append(f"periodic windows: {share:.1f} % of {held.periodic_flights} flights within one sample of the model")
    out.append(f"double hits: {held.double_hits}")
    first = held.first
    if first.measured is None:
        out.append("no bifurcation measured after take-off")
    else:
        before, after = (scale.factor * x for x in (first.measured.gamma_before, first.measured.gamma_after))
        out.append(
            f"first bifurcation measured: {first.measured.type}, {scale.name} between {before:.4f} and {after:.4f}"
        )
    if first.predicted_type:
        at = scale.factor * first.predicted_gamma
        out.append(f"first bifurcation predicted: {first.predicted_type} at {scale.name} {at:.4f}")
        if first.measured is not None:
            out.append(f"measured / predicted: {first.ratio:.3f}")
    bands = [b for s in held.steps for b in s.bands]
    if bands:
        observed, expected = sum(b.observed for b in bands), sum(b.expected for b in bands)
        out.append(f"flights in the ideal ball's forbidden bands: {observed} (their neighbourhood: {expected:.0f})")
    out.append(scale.definition)
    return out
