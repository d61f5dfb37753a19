"""Small recordings, and verdicts on them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from daq.files.tables import Block
from daq.recording import CHANNELS, RecordingWriter
from daq.setup.setup import Setup

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


def verdict_json(identity: str, value: float = 0.12) -> dict[str, Any]:
    """The answer of a closed loop that found Coulomb friction, as far as the catalogue reads it."""
    mu_up = {"value": value, "low": value - 0.01, "high": value + 0.01}
    return {
        "verdict": "explained",
        "effects": [{"name": "coulomb_friction", "parameters": {"mu_up": mu_up}}],
        "calibrations": [{"effect": "accelerometer_gain", "parameter": "relative", "value": 0.01, "sigma": 0.001,
                          "stated": 0.0, "stated_sigma": 0.005}],
        "tie_set": [["coulomb_friction"]],
        "before": {"landing_rms_us": 1500.0}, "after": {"landing_rms_us": 3.0}, "noise_floor_us": 2.0,
        "source_ids": [identity],
    }  # fmt: skip


def save(path: Path, told: dict[str, Any]) -> None:
    """Write JSON."""
    path.write_text(json.dumps(told), encoding="utf-8")
