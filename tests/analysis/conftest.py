"""A rig with known truth for the analysis: the simulated plant driven sample by sample, its events written down."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from analysis.attribution.candidates import priors_of
from analysis.attribution.fit import Fitter
from analysis.loop.design import Design, simulate_design
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.observations import Observations, Steps
from analysis.residuals.plate_data.plate_observables import GAIN, PHASE, PlateData
from analysis.residuals.values import ParameterId
from daq.channels.accelerometer import AccelerometerChannel
from daq.channels.registry import Channels
from daq.files.tables import Block, step_row
from daq.recording.writer import RecordingWriter
from daq.setup.setup import Ball, Forcing, Setup
from kernels.arrays import Bools
from model.integrator.problem import Measured, PlateSteps
from rig.sim.plant import Plant
from rig.sim.scenario import Scenario

RATE_HZ = 20000.0
FREQUENCY_HZ = 25.37
G_PER_VOLT = 2.0


@dataclass(frozen=True)
class Made:
    """A recording and what really happened: take-offs and landings in seconds (empty where not asked for)."""

    path: Path
    takeoff_s: np.ndarray
    landing_s: np.ndarray

    def true_flights(self) -> np.ndarray:
        """Pairs of take-off and the landing after it, shape (n, 2)."""
        after = np.searchsorted(self.landing_s, self.takeoff_s, side="right")
        landed = after < self.landing_s.size
        return np.column_stack([self.takeoff_s[landed], self.landing_s[after[landed]]])


def setup_for(ratio: int = 1, frequency_hz: float = FREQUENCY_HZ) -> Setup:
    """The measuring part of the simulated rig."""
    return Setup.model_validate(
        {
            "name": "test",
            "forcing": {"frequency_hz": frequency_hz, "ratio": ratio},
            "drive": {"g_per_volt": G_PER_VOLT},
            "channels": {"accelerometer": {"sensitivity": 0.1, "unit": "V/g", "offset_v": 0.0}},
            "ball": {"mass_kg": 0.2492},
        }
    )


def ramp(setup: Setup, gammas: np.ndarray, settle: int, hold: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Drive volts of a phase-continuous ramp, amplitudes faded over two cycles, and its steps."""
    period = RATE_HZ / setup.forcing.frequency_hz
    first, last, volts, steps = 0, 0.0, [], []
    for gamma in gammas:
        n, fade = round((settle + hold) * period), round(2 * period)
        index = first + np.arange(n)
        rise = 0.5 - 0.5 * np.cos(np.pi * np.minimum(np.arange(n) / fade, 1.0))
        wave = np.zeros(n)
        for m, z in setup.forcing.displacement_tones():
            turns = (m * setup.forcing.frequency_hz * index / RATE_HZ) % 1.0
            wave -= m * m * (z * np.exp(2j * np.pi * turns)).real
        volts.append((last + (gamma - last) * rise) * wave / G_PER_VOLT)
        steps.append(
            step_row(
                {
                    "first_sample": first,
                    "n_samples": n,
                    "settle_samples": round(settle * period),
                    "gamma": gamma,
                    "frequency_hz": setup.forcing.frequency_hz,
                    "ratio": setup.forcing.ratio,
                    "cycles": settle + hold,
                    "settle_cycles": settle,
                    "fade_samples": fade,
                    "direction": 1,
                }
            )
        )
        first, last = first + n, float(gamma)
    return np.concatenate(volts), steps


Maker = Callable[..., Made]


@pytest.fixture(scope="session")
def make(tmp_path_factory: pytest.TempPathFactory) -> Maker:
    """Make a recording on the simulated rig; ``truth=True`` also writes down every event (slower)."""

    def made(
        gammas: np.ndarray,
        *,
        ratio: int = 1,
        frequency_hz: float = FREQUENCY_HZ,
        settle: int = 6,
        hold: int = 14,
        truth: bool = False,
        seed: int = 1,
        effects: Mapping[str, Mapping[str, float]] | None = None,
        rig: Mapping[str, float] | None = None,
    ) -> Made:
        setup = setup_for(ratio, frequency_hz)
        plant = Plant(Scenario("test", dict(effects or {}), dict(rig or {})), RATE_HZ, np.random.default_rng(seed))
        drive, steps = ramp(setup, np.asarray(gammas, dtype=float), settle, hold)
        events: dict[str, list[float]] = {"left_s": [], "landed_s": []}
        if truth:
            codes = np.empty((drive.size, 3), np.int16)
            state = plant._state[0]
            for i in range(drive.size):
                codes[i : i + 1] = plant.exchange(drive[i : i + 1])
                for name, seen in events.items():
                    if state[name] >= 0.0 and (not seen or state[name] != seen[-1]):
                        seen.append(float(state[name]))
        else:
            codes = plant.exchange(drive)
        path = tmp_path_factory.mktemp("made") / "run.h5"
        writer = RecordingWriter(
            path, setup, profile_text="", channels=plant.channels, backend="simulated", simulated=True
        )
        for start in range(0, drive.size, 1 << 14):
            writer.append(Block(start, codes[start : start + (1 << 14)]))
        for step in steps:
            writer.mark_step(step[0])
        writer.close()
        return Made(path, np.array(events["left_s"]), np.array(events["landed_s"]))

    return made


# -- observations flown by the model itself, blurred by the errors that they claim --
GAMMAS = tuple(np.random.default_rng(2).permutation(np.linspace(0.3, 1.4, 14)).tolist())
EDGE_S, TONE_MPS2, PLATE = 8e-6, 0.004, 4e-4  # one sigma of edges, of each quadrature of a tone, of gain and phase

RampFlyer = Callable[..., ForwardModel]


def bare_observations() -> Observations:
    """A run of a single step: what its instruments are worth, to be copied by `simulate_design`."""
    setup = Setup(
        name="t",
        forcing=Forcing(frequency_hz=25.37, ratio=2),
        ball=Ball(mass_kg=0.25),
        channels=Channels(accelerometer=AccelerometerChannel(sensitivity=0.1, unit="V/g")),  # type: ignore[arg-type]
    )
    omega = 2 * np.pi * 25.37
    each = np.repeat(np.eye(8), 2, axis=0) * np.tile([1.0, 1j], 8)[:, None]
    steps = Steps(
        np.zeros(1, np.int64),
        np.zeros(1, np.int64),
        np.ones(1),
        np.full(1, 2, dtype=np.int64),
        np.zeros(1),
        PlateSteps(np.full((1, 8), omega), np.zeros((1, 8), complex), np.array([1 / 25.37])),
        TONE_MPS2 * each[None],
        np.array([[True, True] + 6 * [False]]),
    )
    kinds = np.array([GAIN, PHASE], dtype=np.int64)
    two, ints = np.ones(2), np.ones(2, dtype=np.int64)
    plate = PlateData(
        kinds,
        0 * ints,
        0 * two,
        PLATE * two,
        omega * two,
        two,
        two,
        ints,
        2 * ints[:, None],
        4 * two[:, None],
        0j * two,
    )
    edges, yes = np.full(3, EDGE_S), np.ones(3, dtype=bool)
    flights = Measured(np.zeros(3), np.ones(3), ~yes, yes, np.zeros(3, np.int64), yes)
    return Observations(flights, edges, edges, yes, np.ones(3), np.full(3, 0.03), steps, plate, setup)


def blurred(observations: Observations, rng: np.random.Generator) -> Observations:
    """The same with errors of the size that the observations claim."""
    m, plate, steps = observations.measured, observations.plate, observations.steps
    z = steps.plate.acceleration_mps2
    noise = (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape)) * steps.sigma_mps2 * steps.forcing
    landing = m.landing_s + observations.landing_sigma_s * rng.standard_normal(len(observations))
    opening = m.opening_s + observations.opening_sigma_s * rng.standard_normal(len(observations))
    again = np.concatenate([[np.nan], landing[:-1]])  # a ball that leaves at once opens where it has landed
    return replace(
        observations,
        measured=replace(m, landing_s=landing, opening_s=np.where(m.relaunched & m.linked, again, opening)),
        plate=replace(plate, value=plate.value + plate.sigma * rng.standard_normal(len(plate))),
        steps=replace(steps, plate=replace(steps.plate, acceleration_mps2=z + noise)),
    )


@pytest.fixture(scope="session")
def fly_ramp() -> RampFlyer:
    """``fly_ramp(truth, seed, gammas=..., declared=...)``: the model of a c = 2 ramp flown under ``truth``."""

    def made(
        truth: Mapping[ParameterId, float],
        seed: int,
        gammas: tuple[float, ...] = GAMMAS,
        declared: Mapping[str, Mapping[str, float]] | None = None,
    ) -> ForwardModel:
        model = ForwardModel(bare_observations(), declared or {})
        exact = simulate_design(Design("test", "a ramp", 2, gammas), model, dict(truth))
        run = exact.measured.step * 2.0 + exact.measured.landing_s
        read = ForwardModel(exact, {}).reading(truth) * exact.steps.plate.acceleration_mps2
        steps = replace(exact.steps, plate=replace(exact.steps.plate, acceleration_mps2=read))
        shown = replace(exact, time_s=run, steps=steps)
        return ForwardModel(blurred(shown, np.random.default_rng(seed)), declared or {})

    return made


@pytest.fixture(scope="session")
def fitter_of() -> Callable[[ForwardModel], Fitter]:
    """The fits of a model, every fourth step held back as in the loop itself."""
    return lambda model: Fitter(model, priors_of(model.observations.setup), trained(model))


def trained(model: ForwardModel) -> Bools:
    """Steps that a fit may see."""
    return np.asarray(np.arange(len(model.observations.steps)) % 4 != 2)
