"""A comparison of recording and model in sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from analysis.flights.compare import Comparison
    from analysis.report.gamma import GammaScale


def unfit_steps(held: Comparison) -> list[str]:
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


def sentences(held: Comparison, scale: GammaScale) -> list[str]:
    """The result of a comparison in sentences, gamma as ``scale`` shows it."""
    effects = ", ".join(held.effects) if held.effects else "no effects (ideal)"
    out = [f"model with {effects}"]
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
    out.append(scale.definition)
    return out
