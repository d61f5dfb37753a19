"""A comparison of recording and model as tables, in sentences, and for a machine."""

from __future__ import annotations

from typing import Any

from rich.console import Console

from analysis.flights.compare import Comparison
from analysis.report.wording import GammaScale
from bench.terminal.console import CYCLES, new_table, print_lines
from daq.files.json_values import json_object

BAND = ("low_s", "high_s", "observed", "expected", "p_value")


def unfit_steps(held: Comparison) -> list[str]:
    """Periodic steps that cannot judge the model, and why."""
    why = {
        "sensitive": "the uncertainty of gamma by itself moves the prediction",
        "unsettled": "the predicted cycle attracts too slowly for the settle time",
    }
    found: dict[str, list[str]] = {}
    for s in held.steps:
        if s.unfit_reason:
            found.setdefault(s.unfit_reason, []).append(str(s.step))
    return [f"? {name} ({why.get(name, name)}): step {', '.join(steps)}" for name, steps in found.items()]


def sentences(held: Comparison, scale: GammaScale) -> list[str]:
    """The result of a comparison in sentences, gamma as ``scale`` shows it."""
    out = [f"model with {', '.join(held.effects) or 'no effects (ideal)'}"]
    if held.short_by == held.short_by:
        size, way = abs(100 * held.short_by), "shorter" if held.short_by >= 0 else "longer"
        out.append(
            f"measured flights are {size:.2f} % {way} than the model's (median over cycles, short rebounds not counted)"
        )
    if held.periodic_flights:
        share = 100 * held.within_sample
        within = f"{share:.1f} % of {held.periodic_flights} flights are within one sample of the model"
        out.append(f"where the model's motion repeats itself, {within}")
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
    return [*out, scale.definition]


def comparison_json(held: Comparison) -> dict[str, Any]:
    """The comparison for a machine; times in s, None for what does not exist."""
    first, change = held.first, held.first.measured
    steps = [
        {
            "step": s.step, "gamma": s.gamma, "gamma_peak": s.gamma_peak, "measured": s.measured.label,
            "flights": s.measured.flights, "double_hits": s.measured.double_hits, "predicted": s.predicted,
            "unfit_reason": s.unfit_reason or None, "predicted_flight_times_s": s.predicted_s,
            "mean_flight_time_ratio": s.mean_ratio, "rms_s": s.rms_s, "within_one_sample": s.within_sample,
            "forbidden_bands": [{name: getattr(band, name) for name in BAND} for band in s.bands],
        }
        for s in held.steps
    ]  # fmt: skip
    return json_object({
        "model_effects": list(held.effects),
        "flights_short_by": held.short_by,
        "within_one_sample": held.within_sample,
        "periodic_flights": held.periodic_flights,
        "double_hits": held.double_hits,
        "first_bifurcation": {
            "measured_type": None if change is None else change.type,
            "measured_bracket_gamma": None if change is None else [change.gamma_before, change.gamma_after],
            "predicted_type": first.predicted_type or None,
            "predicted_gamma": first.predicted_gamma,
            "predicted_gamma_same_type": first.same_type_gamma,
            "measured_over_predicted": first.ratio,
        },
        "changes": [
            {
                "type": c.type, "bracket_gamma": [c.gamma_before, c.gamma_after], "before": c.before.label,
                "after": c.after.label,
            }
            for c in held.changes
        ],
        "steps": steps,
    })  # fmt: skip


def show(held: Comparison, name: str, simulated: bool, scale: GammaScale) -> None:
    """Tables for a person."""
    title = f"{name}{' (simulated rig)' if simulated else ''} against the model"
    headings = ("step", scale.name.replace("_", "\n"), "measured", "model", "n", "ratio", "rms us", "")
    table = new_table(*headings, words=("measured", "model"), title=title)  # only these are folded
    for s in held.steps:
        model = s.predicted.removesuffix(f", period {s.predicted.partition('-')[0]}")
        ratio = f"{s.mean_ratio:.4f}" if s.mean_ratio == s.mean_ratio else ""
        rms = f"{1e6 * s.rms_s:.1f}" if s.rms_s == s.rms_s else ""
        table.add_row(
            str(s.step), f"{scale.factor * s.gamma:.4f}", s.measured.label, model,
            str(s.measured.flights), ratio, rms, "?" if s.unfit_reason else "",
        )  # fmt: skip
    Console().print(table)
    columns = "n: measured flights; ratio: their mean time over the model's; rms: of their distance to the nearest time"
    print_lines(*unfit_steps(held), *sentences(held, scale), f"{columns} predicted", CYCLES)
