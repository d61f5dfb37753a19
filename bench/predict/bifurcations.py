"""The bifurcations in a range of gammas, as `bench predict --bifurcations` lists them."""

from __future__ import annotations

from typing import Any

from bench.predict.request import Request, forcing_of
from bench.terminal.console import write_json
from model.bifurcations.events import Bifurcation
from model.bifurcations.find import find_bifurcations
from model.flight.branches import q_and_slope
from model.flight.first_landing import turning_points
from model.orbits.attractor import Ball
from model.tones import Forcing


def bifurcations(ball: Ball, request: Request) -> None:
    """Print or write every bifurcation in the gamma range of ``request``."""
    peak = gamma_peak_over_gamma(forcing_of(request))
    low, high = request.gamma_range or (0.0, 0.0)
    # what happens at the very start of the range is not a change within it
    found = [
        b for b in find_bifurcations(ball, low, high, narrowest=request.narrowest, sweep=request.sweep) if b.gamma > low
    ]
    write_json([bifurcation_json(b, peak) for b in found], request.json)
    if request.json is None:
        print(f"{'gamma':>16} {'gamma_peak':>16}  {'type':<22} period")
        for b in found:
            print(f"{b.gamma:16.10f} {b.gamma * peak:16.10f}  {b.type:<22} {b.before.period} -> {b.after.period}")


def gamma_peak_over_gamma(forcing: Forcing) -> float:
    """Peak acceleration of the plate over A w^2, dimensionless."""
    return max(q_and_slope(forcing.tones, float(p))[0] for p in turning_points(forcing))


def bifurcation_json(found: Bifurcation, peak: float) -> dict[str, Any]:
    """One bifurcation as scripts read it; ``peak`` is gamma_peak over gamma."""
    return {
        "gamma": found.gamma,
        "gamma_peak": found.gamma * peak,
        "type": found.type,
        "period_before": found.before.period,
        "period_after": found.after.period,
    }
