"""Evidence with a known truth: flown by the model itself, edges, tones and plate data blurred by what they claim."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from analysis.residuals.observations import Evidence, Steps
from analysis.attribution.fit import Fitter, priors_of
from analysis.residuals.forward_model import Key, World
from analysis.loop.design import Design, rehearse
from analysis.residuals.plate_observables import GAIN, PHASE, PlateData
from daq.setup.setup import AccelerometerChannel, Ball, Channels, Forcing, Setup
from model.integrator.one_step import Measured, PlateSteps

GAMMAS = tuple(np.random.default_rng(2).permutation(np.linspace(0.3, 1.4, 14)).tolist())
EDGE_S, TONE_MPS2, PLATE = 8e-6, 0.004, 4e-4  # one sigma of edges, of each quadrature of a tone, of gain and phase

Maker = Callable[..., World]


def bare_evidence() -> Evidence:
    """A run of a single step: what its instruments are worth, to be copied by `rehearse`."""
    setup = Setup(
        name="t", forcing=Forcing(frequency_hz=25.37, ratio=2), ball=Ball(mass_kg=0.25),
        channels=Channels(accelerometer=AccelerometerChannel(sensitivity=0.1, unit="V/g")),  # type: ignore[arg-type]
    )
    omega = 2 * np.pi * 25.37
    each = np.repeat(np.eye(8), 2, axis=0) * np.tile([1.0, 1j], 8)[:, None]
    steps = Steps(
        np.zeros(1, np.int64), np.zeros(1, np.int64), np.ones(1), np.full(1, 2, dtype=np.int64), np.zeros(1),
        PlateSteps(np.full((1, 8), omega), np.zeros((1, 8), complex), np.array([1 / 25.37])),
        TONE_MPS2 * each[None], np.array([[True, True] + 6 * [False]]),
    )
    kinds = np.array([GAIN, PHASE], dtype=np.int64)
    two, ints = np.ones(2), np.ones(2, dtype=np.int64)
    plate = PlateData(kinds, 0 * ints, 0 * two, PLATE * two, omega * two, two, two, ints, 2 * ints, 4 * two)
    edges, yes = np.full(3, EDGE_S), np.ones(3, dtype=bool)
    flights = Measured(np.zeros(3), np.ones(3), ~yes, yes, np.zeros(3, np.int64), yes)
    return Evidence(flights, edges, edges, yes, np.ones(3), np.full(3, 0.03), steps, plate, setup, 2e-4)


def blurred(evidence: Evidence, rng: np.random.Generator) -> Evidence:
    """The same with errors of the size that the evidence itself claims."""
    m, plate, steps = evidence.measured, evidence.plate, evidence.steps
    z = steps.plate.acceleration_mps2
    noise = (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape)) * steps.sigma_mps2 * steps.forcing
    landing = m.landing_s + evidence.landing_sigma_s * rng.standard_normal(len(evidence))
    opening = m.opening_s + evidence.opening_sigma_s * rng.standard_normal(len(evidence))
    again = np.concatenate([[np.nan], landing[:-1]])  # a ball that leaves at once opens where it has landed
    return replace(
        evidence,
        measured=replace(m, landing_s=landing, opening_s=np.where(m.at_once & m.linked, again, opening)),
        plate=replace(plate, value=plate.value + plate.sigma * rng.standard_normal(len(plate))),
        steps=replace(steps, plate=replace(steps.plate, acceleration_mps2=z + noise)),
    )


@pytest.fixture(scope="session")
def make() -> Maker:
    """``make(truth, seed, gammas=..., declared=...)``: the world of a c = 2 ramp flown under ``truth``."""

    def made(
        truth: Mapping[Key, float], seed: int, gammas: tuple[float, ...] = GAMMAS,
        declared: Mapping[str, Mapping[str, float]] | None = None,
    ) -> World:
        world = World(bare_evidence(), declared or {})
        best = SimpleNamespace(fitted=SimpleNamespace(values=dict(truth)))
        exact = rehearse(Design("a ramp", 2, gammas), world, best)  # type: ignore[arg-type]
        run = exact.measured.step * 2.0 + exact.measured.landing_s
        read = World(exact, {}).per_step(truth, "reading", 1.0)[:, None] * exact.steps.plate.acceleration_mps2
        steps = replace(exact.steps, plate=replace(exact.steps.plate, acceleration_mps2=read))
        shown = replace(exact, time_s=run, steps=steps)
        return World(blurred(shown, np.random.default_rng(seed)), declared or {})

    return made


@pytest.fixture(scope="session")
def fitter_of() -> Callable[[World], Fitter]:
    """The fits of a world, every fourth step held back as in the loop itself."""
    return lambda world: Fitter(world, priors_of(world.evidence.setup), trained(world))


def trained(world: World) -> NDArray[np.bool_]:
    """Steps that a fit may see."""
    return np.asarray(np.arange(len(world.evidence.steps)) % 4 != 2)
