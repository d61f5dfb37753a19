"""A recording in blocks of a millisecond: acceleration and drive, blocks that no impact hides, what the drive makes."""

from __future__ import annotations

import math

import numpy as np

from analysis.plate.mains_lines import MAINS_HZ
from analysis.signals.stream import block_means, pieces
from daq.recording import Recording
from kernels.arrays import Bools, Complexes, Floats

LEAD_S = 1e-3  # before an impact, left out with it
ANSWERED_S = (0.002, 0.005, 0.009, 0.014, 0.02)  # by which a plate's answer to its drive may be late


def volts_in_blocks(recording: Recording, width: int) -> tuple[Floats, Floats]:
    """Block means of acceleration in m/s^2, whatever its zero, and drive in volts, (n,) each."""
    parts: dict[str, list[Floats]] = {"accelerometer": [], "drive": []}
    rest = {name: np.zeros(0, dtype=np.float32) for name in parts}
    for piece in pieces(recording, ("accelerometer", "drive")):
        for name, found in parts.items():
            volts = np.concatenate([rest[name], piece.own(name)])
            found.append(block_means(volts, width).astype(np.float64))
            rest[name] = volts[len(volts) // width * width :].copy()
    both = {name: np.concatenate(found) for name, found in parts.items()}
    return both["accelerometer"] / recording.setup.channels.accelerometer.volts_per_mps2, both["drive"]


def unmasked(n: int, block_s: float, landing_s: Floats, mask_s: float) -> Bools:
    """Blocks (n,) without an impact or its ringing."""
    edges = np.zeros(n + 1, dtype=np.int64)
    first = np.clip(((landing_s - LEAD_S) / block_s).astype(np.int64), 0, n)
    last = np.clip(((landing_s + mask_s) / block_s).astype(np.int64) + 1, 0, n)
    np.add.at(edges, first, 1)
    np.add.at(edges, last, -1)
    return np.asarray(np.cumsum(edges[:-1]) == 0)


def drive_regressors(recording: Recording, drive_v: Floats, block_s: float) -> Floats:
    """Regressors of what the drive makes of the plate, (n, k): both quadratures of its tones, bent by level, products.

    A bent gain, harmonics and a second tone are so linear in what is regressed.
    """
    forcing = recording.setup.forcing
    w, n = 2.0 * math.pi * forcing.frequency_hz, len(drive_v)
    time_s = (np.arange(n) + 0.5) * block_s
    cycle = max(round(1.0 / forcing.frequency_hz / block_s), 1)
    tones: list[Complexes] = []
    for multiple in forcing.multiples:
        turning = np.exp(-1j * multiple * w * time_s)
        low: Complexes = _cycle_mean(_cycle_mean(2.0 * drive_v * turning, cycle), cycle)
        tones.append(np.asarray(low * np.conj(turning)))
    level = np.abs(tones[0]) ** 2
    first = tones[0]
    columns = [*tones, *(level * z for z in tones), first**2, first**3]
    for further in tones[1:]:
        columns += [first * further, np.conj(first) * further, further**2]
    # the tones' means over cycles lag in a fade, in which a plate that a force drives answers what was asked before
    before = (round(t / block_s) for t in ANSWERED_S)
    whole = [drive_v, np.gradient(drive_v), *(np.pad(drive_v[: n - k], (k, 0)) for k in before)]
    table = np.concatenate([whole, *([z.real, z.imag] for z in columns)])
    size = np.sqrt(np.mean(table**2, axis=1))
    table = table[size > 0.0] / size[size > 0.0, None]
    slow = np.cos(np.pi * np.arange(4)[:, None] * np.arange(n) / n)  # the zero wanders
    hum = [part(2.0 * np.pi * k * hz * time_s) for hz in MAINS_HZ for k in (1, 3, 5) for part in (np.cos, np.sin)]
    return np.concatenate([table, slow, hum]).T


def _cycle_mean(x: Complexes, width: int) -> Complexes:
    """Mean over the ``width`` values about each."""
    padded = np.concatenate([np.zeros(1), np.cumsum(np.pad(x, (width // 2, width - width // 2 - 1), mode="edge"))])
    return np.asarray((padded[width:] - padded[:-width]) / width)
