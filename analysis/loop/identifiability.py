"""Detection limits: the sizes below which a recording could not have shown an effect."""

from __future__ import annotations

from analysis.attribution.detectability import Detectability
from analysis.attribution.hypothesis import Hypothesis
from analysis.thresholds import Thresholds
from model.effects.registry import registry


def detection_limits(best: Hypothesis, limits: Thresholds) -> tuple[dict[str, float], tuple[str, ...]]:
    """Detection limits by ``effect.parameter``, and the effects that no size would show.

    The limit is the smallest size whose expected gains pass the tests of a verdict, with calibrations and nuisances
    free: see `analysis.attribution.detectability`.
    """
    fitted, detectability = best.fitted, Detectability(best.fitted, limits)
    sizes: dict[str, float] = {}
    unidentifiable: list[str] = []
    for entry in registry():
        e = entry.effect
        if e.nuisance or not e.library or not entry.hooks:
            continue
        shown = []
        for q in e.parameters:
            key = (e.name, q.name)
            if q.is_shape or key in fitted.free:
                continue
            size = detectability.limit(key)
            if size < q.high - q.low:
                shown.append(q.name)
                sizes[f"{e.name}.{q.name}"] = size
        if not shown and not any(k[0] == e.name for k in fitted.free):
            unidentifiable.append(e.name)
    return sizes, tuple(unidentifiable)
