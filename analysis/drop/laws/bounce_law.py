"""Candidate models of a drop: how long the next flight should last, given the one before.

One bounce ahead. Each prediction starts from the measured flight before it, so an irregular bounce
spoils one residual and not the rest. Names are those of the effect library: `restitution` (constant or falling with
the impact speed, ``e = e0 - e1 u``), `quadratic_drag`, `coulomb_friction`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.drop.laws.flight_law import FlightLaw
from kernels.arrays import Floats

BOUNDS: dict[str, tuple[float, float]] = {
    "e0": (0.01, 1.5),
    "e1_s_per_m": (-1.0, 1.0),
    "k_per_m": (0.0, 5.0),
    "mu": (0.0, 0.9),
}
START: dict[str, float] = {"e0": 0.7, "e1_s_per_m": 0.0, "k_per_m": 0.02, "mu": 0.05}


@dataclass(frozen=True)
class BounceModel:
    """One candidate model: its name and its parameters, in order."""

    name: str
    parameters: tuple[str, ...]

    def nests(self, other: BounceModel) -> bool:
        """Whether ``other`` is this model with parameters left out."""
        return set(other.parameters) < set(self.parameters)

    @property
    def shape(self) -> str:
        """What bends a flight besides gravity."""
        named = {"mu": "friction", "k_per_m": "drag"}
        return "+".join(named[name] for name in self.parameters if name in named) or "parabola"

    def law(self, theta: Floats, g_mps2: float) -> FlightLaw:
        """Flight law at parameters ``theta`` (p,), or at each of (draws, p)."""
        value = self._named(theta)
        drag = np.maximum(value["k_per_m"], 1e-8) if "k_per_m" in value else 0.0  # a parabola to its last digit
        return FlightLaw(g_mps2, value.get("mu", 0.0), drag)

    def _named(self, theta: Floats) -> dict[str, Floats]:
        return dict(zip(self.parameters, np.moveaxis(np.asarray(theta), -1, 0), strict=True))

    def rebound_mps(self, theta: Floats, impact_mps: Floats) -> Floats:
        """Speed after an impact at ``impact_mps``."""
        value = self._named(theta)
        e = value["e0"] - value.get("e1_s_per_m", 0.0) * np.asarray(impact_mps)
        return np.maximum(e, 0.01) * impact_mps

    def next_flight_s(self, theta: Floats, flight_s: Floats, g_mps2: float) -> Floats:
        """Duration of the flight after one of ``flight_s``."""
        law = self.law(theta, g_mps2)
        impact = law.return_speed_mps(law.takeoff_speed_mps(flight_s))
        return np.asarray(law.duration_s(self.rebound_mps(theta, impact)))

    def first_flight_s(self, theta: Floats, height_m: Floats, g_mps2: float) -> Floats:
        """Duration of the flight after a fall from rest through ``height_m``."""
        law = self.law(theta, g_mps2)
        return np.asarray(law.duration_s(self.rebound_mps(theta, law.landing_speed_mps(height_m))))

    def drop_height_m(self, theta: Floats, flight_s: Floats, g_mps2: float, scatter: Floats) -> Floats:
        """Height of the drop whose first bounce lasted ``flight_s``; NaN where there is none.

        All arguments may be arrays over draws: parameters (draws, p), duration, and how far the restitution of that
        one bounce is from the law.
        """
        law, value = self.law(theta, g_mps2), self._named(theta)
        after = law.takeoff_speed_mps(flight_s)
        e0, e1 = value["e0"] + scatter, value.get("e1_s_per_m", 0.0)
        inside = e0 * e0 - 4.0 * e1 * after  # e0 u - e1 u^2 = after: the branch that goes over into after / e0
        with np.errstate(invalid="ignore", divide="ignore"):
            impact = np.where((e0 > 0.0) & (inside >= 0.0), 2.0 * after / (e0 + np.sqrt(inside)), np.nan)
            height = law.fall_m(impact)
        return np.where(np.isfinite(height), height, np.nan)


CONSTANT = BounceModel("constant_restitution", ("e0",))
SPEED = BounceModel("speed_dependent_restitution", ("e0", "e1_s_per_m"))
DRAG = BounceModel("quadratic_drag", ("e0", "k_per_m"))
FRICTION = BounceModel("coulomb_friction", ("e0", "mu"))
SPEED_DRAG = BounceModel("speed_dependent_restitution+quadratic_drag", ("e0", "e1_s_per_m", "k_per_m"))
SPEED_FRICTION = BounceModel("speed_dependent_restitution+coulomb_friction", ("e0", "e1_s_per_m", "mu"))
FRICTION_DRAG = BounceModel("coulomb_friction+quadratic_drag", ("e0", "mu", "k_per_m"))
MODELS = (CONSTANT, SPEED, DRAG, FRICTION, SPEED_DRAG)  # of impact times
OF_PATHS = (*MODELS, SPEED_FRICTION, FRICTION_DRAG)
