"""Derivatives of predictions are those of differenced predictions, whatever acts on the ball."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from model.effects.registry import row
from model.integrator.one_step import Predicted, one_ahead, simulate
from model.integrator.problem import Detection, Measured, PlateSteps
from model.integrator.slopes import Slopes, slopes_of
from model.tones import Plate

G_MPS2 = 9.80665
OMEGA_RADPS = 2.0 * math.pi * 25.0
PERIOD_S = 2.0 * math.pi / OMEGA_RADPS
Effects = dict[str, dict[str, float]]

CASES: dict[str, tuple[Effects, float]] = {  # what acts, and how far each size may be drawn from there, relative
    "nothing": ({}, 0.0),
    "dry friction": ({"coulomb_friction": {"mu_up": 0.15, "mu_down": 0.2}}, 0.5),
    "dry friction that hangs the ball on the rod": ({"coulomb_friction": {"mu_up": 0.5, "mu_down": 0.6}}, 0.2),
    "friction that weakens": (
        {"stribeck_friction": {"mu_kinetic": 0.1, "mu_extra": 0.1, "v_s_mps": 0.1, "exponent": 1.7}},
        0.15,
    ),
    "damping and drag": ({"viscous_damping": {"rate_per_s": 3.0}, "quadratic_drag": {"k_per_m": 2.0}}, 0.5),
    "spring and magnet": (
        {"position_force": {"spring_per_s2": 300.0, "magnet_mps2": 0.5, "range_m": 2e-3}},
        0.3,
    ),
    "adhesion that grows": ({"adhesion": {"a_mps2": 0.5, "dwell_s": 0.01}}, 0.5),
    "another gravity": ({"local_gravity": {"excess_mps2": 0.2}}, 0.5),
    "rebounds": ({"restitution": {"e0": 0.4, "e1_s_per_m": 0.1}}, 0.3),
    "rebounds under friction": (
        {"restitution": {"e0": 0.4, "e1_s_per_m": 0.1}, "coulomb_friction": {"mu_up": 0.1, "mu_down": 0.15}},
        0.3,
    ),
}
MODE: Effects = {"table_resonance": {"mass_ratio": 0.03, "frequency_hz": 9.0, "damping": 0.05}}


class Flown:
    """Flights of an orbit as they would be measured, to be predicted one event ahead."""

    def __init__(self, effects: Effects, gamma: float, ratio: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        k = np.array([1.0, float(ratio)]) if ratio > 1 else np.array([1.0])
        tones = gamma * G_MPS2 * (k**2 if ratio > 1 else k) * np.exp(2j * np.pi * rng.random(len(k)))
        omega = OMEGA_RADPS * k
        plate = Plate(omega, tones)
        orbit = simulate(effects, plate, g_mps2=G_MPS2, period_s=PERIOD_S, flights=40, unseen_s=1e-4)
        n = len(orbit.landing_s)
        landing = orbit.landing_s + 1e-6 * rng.standard_normal(n)
        linked = np.arange(n) > 0
        self.measured = Measured(
            orbit.takeoff_s, landing, ~orbit.after_rest & linked, linked, np.zeros(n, np.int64), linked
        )
        self.plate = PlateSteps(omega[None], tones[None], np.array([PERIOD_S]))
        self.effects, self.detection = effects, Detection(2e-6)
        self.base = self.predict()

    def predict(self, **moved: object) -> Predicted:
        """The prediction with what is named moved: effects, tones or landings."""
        plate = replace(self.plate, acceleration_mps2=moved.get("tones", self.plate.acceleration_mps2))
        measured = replace(self.measured, landing_s=moved.get("landing_s", self.measured.landing_s))
        rows = row(moved.get("effects", self.effects), G_MPS2)
        near = getattr(self, "base", None)
        return one_ahead(measured, plate, rows, self.detection, mode=near)

    def slopes(self) -> Slopes:
        """Derivatives of all flights."""
        rows = row(self.effects, G_MPS2)
        return slopes_of(self.measured, self.plate, rows, self.detection, self.base)


def events_of(p: Predicted) -> np.ndarray:
    """Openings and landings, (n, 2)."""
    return np.stack([p.opening_s, p.landing_s], axis=1)


def agree(slopes: np.ndarray, ahead: Predicted, behind: Predicted, width: float, usable: np.ndarray) -> None:
    """Most derivatives are the differences to a thousandth; the rest met another event within the difference."""
    found = (events_of(ahead) - events_of(behind)) / width
    off = np.abs(slopes[:, :2] - found)[usable]
    size = np.maximum(np.abs(found[usable]), np.median(np.abs(found[usable]), axis=0))
    close = off < 2e-3 * size + 2e-9 / width
    assert close.mean() > 0.9, (off / size)[~close]


def drawn(effects: Effects, spread: float, rng: np.random.Generator) -> Effects:
    """The same effects with other sizes."""
    return {
        name: {q: v * (1.0 + spread * rng.uniform(-1.0, 1.0)) for q, v in table.items()}
        for name, table in effects.items()
    }


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("case", CASES)
def test_slopes_are_those_of_differenced_predictions(case: str, seed: int) -> None:
    """Openings and landings by tones and earlier landings, for random sizes."""
    rng = np.random.default_rng([seed, len(case)])
    effects, ratio = drawn(*CASES[case], rng), 1 + seed
    flown = Flown(effects, (2.2 if ratio == 1 else 0.9) * rng.uniform(0.95, 1.3), ratio, seed)
    slopes = flown.slopes()
    usable = (slopes.info[:, 0] > 0.0) & np.isfinite(flown.base.landing_s)
    assert usable.sum() > 5
    z, h = flown.plate.acceleration_mps2, 1e-4
    for k in range(z.shape[1]):
        for part, unit in enumerate((1.0, 1.0j)):
            move = h * unit * (np.arange(z.shape[1]) == k)
            sides = [flown.predict(tones=z + move), flown.predict(tones=z - move)]
            agree(slopes.tones[:, :, k, part], *sides, 2.0 * h, usable)
    landing, h = flown.measured.landing_s, 1e-7
    for i in np.flatnonzero(usable)[:12]:
        for back, by in ((1, slopes.landing), (2, slopes.landing_before)):
            if i >= back:
                move = h * (np.arange(len(landing)) == i - back)
                sides = [flown.predict(landing_s=landing + move), flown.predict(landing_s=landing - move)]
                found = (events_of(sides[0]) - events_of(sides[1]))[i] / (2.0 * h)
                np.testing.assert_allclose(by[i, :2], found, rtol=5e-3, atol=0.03)


def test_impact_speed_has_a_derivative() -> None:
    """The speed of the impact by a tone is that of differenced orbits: a ball on one tone, from rest."""
    effects = {"viscous_damping": {"rate_per_s": 3.0}}
    flown = Flown(effects, 2.3, 1, 3)
    slopes, h = flown.slopes(), 1e-4
    z = flown.plate.acceleration_mps2
    speeds = [p.table[:, 3] for p in (flown.predict(tones=z + h), flown.predict(tones=z - h)) if p.table is not None]
    usable = slopes.info[:, 0] > 0.0
    found = (speeds[0] - speeds[1])[usable] / (2.0 * h)
    np.testing.assert_allclose(slopes.tones[usable, 2, 0, 0], found, rtol=2e-3, atol=1e-6)


def test_a_plate_with_a_mode_is_refused() -> None:
    """A mode's state goes on through fades that nothing tells all of: no derivative rather than a wrong one."""
    with pytest.raises(ValueError, match="without"):
        Flown(MODE, 2.4, 1, 1).slopes()
