"""Small recordings, and verdicts on them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from analysis.loop.result import AddedEffect, Calibration, ClosedLoop
from daq.files.tables import Block
from daq.recording import CHANNELS, open_recording
from daq.recording.header import stored_id
from daq.recording.writer import RecordingWriter
from daq.setup.setup import Setup
from tests.loops import changed

RATE_HZ = 1000


def setup_of(name: str, c: int = 1, sensitivity: float = 0.1) -> Setup:
    """A setup of that name."""
    return Setup.model_validate({
        "name": name,
        "sampling": {"rate_hz": RATE_HZ},
        "forcing": {"frequency_hz": 25.0, "ratio": c},
        "channels": {"accelerometer": {"sensitivity": {"value": sensitivity, "uncertainty": 1e-4}, "unit": "V/g"}},
        "ball": {"mass_kg": 0.25},
    })  # fmt: skip


def record(
    path: Path,
    *,
    profile: str = "rig",
    c: int = 1,
    gammas: tuple[float, ...] = (0.9, 1.2),
    note: str = "",
    lost: int = 0,
    close: bool = True,
    sensitivity: float = 0.1,
) -> RecordingWriter:
    """Record half a second a step of sines and noise; not closed where ``close`` is false."""
    path.parent.mkdir(parents=True, exist_ok=True)
    n = RATE_HZ // 2
    rng = np.random.default_rng(len(str(path)) + sum(map(ord, path.name)))
    writer = RecordingWriter(
        path, setup_of(profile, c, sensitivity), profile_text="", channels=CHANNELS, backend="simulated",
        simulated=True, note=note,
    )  # fmt: skip
    for k, gamma in enumerate(gammas):
        t = (np.arange(n) + k * n) / RATE_HZ
        wave = gamma * np.sin(2 * np.pi * 25.0 * t)
        contact = np.where((t * 25.0) % 1 < 0.5, 5.0, 0.0)
        volts = np.column_stack([contact, 0.1 * wave, 0.5 * wave]) + rng.normal(0, 1e-3, (n, 3))
        writer.append(Block(k * n, np.rint(volts * 3276.8).astype(np.int16), lost_before=lost if k == 1 else 0))
        writer.mark_step({
            "first_sample": k * n, "n_samples": n, "settle_samples": 40, "gamma": gamma, "frequency_hz": 25.0,
            "ratio": c, "cycles": 11.5, "settle_cycles": 1.0,
        })  # fmt: skip
    if close:
        writer.close()
    return writer


def verdict_on(loop: ClosedLoop, recording: Path, value: float = 0.12) -> ClosedLoop:
    """The closed loop ``loop`` as if it had found Coulomb friction of that size, and nothing else, in a recording."""
    with open_recording(recording) as opened:
        sources = (dataclasses.replace(loop.sources[0], identity=stored_id(opened)),)
    friction = AddedEffect("coulomb_friction", {"mu_up": (value, value - 0.01, value + 0.01)})
    gain = Calibration("accelerometer_gain", "relative", 0.01, 0.001, 0.0, 0.005)
    return changed(loop, effects=(friction,), ties=(("coulomb_friction",),), calibrations=(gain,), sources=sources)
