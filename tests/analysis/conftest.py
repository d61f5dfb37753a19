"""A rig with known truth for the analysis: the simulated plant driven sample by sample, its events written down."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from daq.recording.tables import Block, step_row
from daq.recording import RecordingWriter
from daq.setup.setup import Setup
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


def setup_for(ratio: int = 1) -> Setup:
    """The measuring part of the simulated rig."""
    return Setup.model_validate(
        {
            "name": "test", "forcing": {"frequency_hz": FREQUENCY_HZ, "ratio": ratio},
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
        steps.append(step_row({
            "first_sample": first, "n_samples": n, "settle_samples": round(settle * period), "gamma": gamma,
            "frequency_hz": setup.forcing.frequency_hz, "ratio": setup.forcing.ratio, "cycles": settle + hold,
            "settle_cycles": settle, "fade_samples": fade, "direction": 1,
        }))
        first, last = first + n, float(gamma)
    return np.concatenate(volts), steps


Maker = Callable[..., Made]


@pytest.fixture(scope="session")
def make(tmp_path_factory: pytest.TempPathFactory) -> Maker:
    """Make a recording on the simulated rig; ``truth=True`` also writes down every event (slower)."""

    def made(
        gammas: np.ndarray, *, ratio: int = 1, settle: int = 6, hold: int = 14, truth: bool = False, seed: int = 1,
        effects: Mapping[str, Mapping[str, float]] | None = None, rig: Mapping[str, float] | None = None,
    ) -> Made:
        setup = setup_for(ratio)
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
