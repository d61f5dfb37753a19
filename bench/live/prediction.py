"""The declared model's diagram over the gammas of a ramp, in portions, and the ideal ball's forbidden zones."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from analysis.report.gamma import gamma_scale
from daq.setup.setup import Setup
from model.bifurcations.forbidden_zones import forbidden_zones
from model.effects.routing import ball_effects
from model.orbits.ideal_ball import IdealBall
from model.orbits.make_ball import make_ball
from model.surveys.diagram import diagram
from model.tones import Forcing

GAMMAS, SLOW_GAMMAS = 480, 160  # points of the diagram, exact and integrated
ZONE_GAMMAS = 120
PORTION = 20  # points between two looks at the run


def nominal_forcing(setup: Setup) -> Forcing:
    """The forcing as the profile asks for it, its first tone at phase zero."""
    tones = setup.forcing.displacement_tones()
    n = np.array([multiple for multiple, _ in tones], float)
    z = np.array([displacement for _, displacement in tones])
    phase = np.angle(z) + 0.5 * np.pi
    phase = np.mod(phase - n * phase[0] + np.pi, 2.0 * np.pi) - np.pi
    return Forcing(tuple(n), tuple(np.abs(z).tolist()), tuple(phase.tolist()))


def predicted(setup: Setup, gammas: tuple[float, ...]) -> Iterator[dict[str, Any]]:
    """Portions of the prediction: lists of gammas as shown, flight times (ms), and zones (gamma, low, high; ms)."""
    shown = gamma_scale(setup.forcing, setup.forcing.ratio).factor
    low, high = 0.97 * min(gammas), 1.03 * max(gammas)
    omega = 2.0 * np.pi * setup.forcing.frequency_hz
    forcing, declared = nominal_forcing(setup), setup.declared_values()
    own = ball_effects(declared)
    ball = make_ball(forcing, own, frequency_hz=setup.forcing.frequency_hz, g_mps2=setup.g_mps2.value)
    grid = np.linspace(low, high, GAMMAS if isinstance(ball, IdealBall) else SLOW_GAMMAS)
    zone_grid = np.linspace(low, high, ZONE_GAMMAS)
    half = 0.52 * (zone_grid[1] - zone_grid[0]) * shown
    portions = -(-len(grid) // PORTION)
    for k in range(portions):
        rows = diagram(ball, grid[k::portions])  # every so many-th: the whole range is there at once, coarsely
        finite = np.isfinite(rows.tau)
        x = np.repeat(rows.gamma[:, None], rows.tau.shape[1], axis=1)[finite] * shown
        zones = [
            [float(gamma * shown), half, float(1e3 * a / omega), float(1e3 * b / omega)]
            for gamma in zone_grid[k::portions]
            for a, b in forbidden_zones(forcing, float(gamma))
            if a > 0.0
        ]
        yield {
            "kind": "model",
            "gamma": [round(float(v), 5) for v in x],
            "tau_ms": [round(float(v), 4) for v in 1e3 * rows.tau[finite] / omega],
            "zones": [[round(v, 5) for v in zone] for zone in zones],
            "part": (k + 1) / portions,
        }
