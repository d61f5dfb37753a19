"""A recording in blocks of a millisecond: acceleration and drive, blocks that no impact hides, what the drive makes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from analysis.linear_algebra import lstsq
from analysis.plate.mains_lines import MAINS_HZ
from analysis.signals import block_means, pieces
from daq.recording import Recording
from kernels.arrays import Bools, Complexes, Floats

LEAD_S = 1e-3  # before an impact, left out with it
HUM_HZ = tuple(k * hz for hz in MAINS_HZ for k in (1, 3, 5))
INTEGRALS = 3  # the drive, and its first and second integral
LEAKS = 0.1  # of the forcing's frequency: below it an integral of the drive leaks, as it would wander


def volts_in_blocks(recording: Recording, width: int) -> tuple[Floats, Floats]:
    """Block means of acceleration in m/s^2, whatever its zero, and drive in volts, (n,) each.

    Blocks begin and end at a sample, of which half belongs to either, so that their times are those of flights.
    """
    parts: dict[str, list[Floats]] = {"accelerometer": [], "drive": []}
    rest = {name: np.zeros(0, dtype=np.float32) for name in parts}
    for piece in pieces(recording, ("accelerometer", "drive")):
        for name, found in parts.items():
            volts = np.concatenate([rest[name], piece.own(name)])
            n = max(len(volts) - 1, 0) // width
            begun = block_means(volts, width)[:n].astype(np.float64)
            found.append(0.5 * (begun + block_means(volts, width, 1)[:n]))
            rest[name] = volts[n * width :].copy()
    both = {name: np.concatenate(found) for name, found in parts.items()}
    return both["accelerometer"] / recording.setup.channels.accelerometer.volts_per_mps2, both["drive"]


def unmasked(n: int, block_s: float, landing_s: Floats, mask_s: float) -> Bools:
    """Blocks (n,) without an impact or its ringing, and not at the end."""
    edges = np.zeros(n + 1, dtype=np.int64)
    first = np.clip(((landing_s - LEAD_S) / block_s).astype(np.int64), 0, n)
    last = np.clip(((landing_s + mask_s) / block_s).astype(np.int64) + 1, 0, n)
    np.add.at(edges, first, 1)
    np.add.at(edges, last, -1)
    edges[max(n - round(0.1 / block_s), 0)] += 1  # s: there the drive is cut off, and its integrals are not known
    return np.asarray(np.cumsum(edges[:-1]) == 0)


def noise_power(left: Floats, known: Bools) -> float:
    """Mean square of the noise of what is left in the known blocks.

    Noise is what differs from block to block; what a model misses of a motion far below the blocks' rate does not.
    """
    return 0.5 * float(np.mean(np.diff(left)[np.diff(np.flatnonzero(known)) == 1] ** 2))


def over_noise(left: Floats, known: Bools) -> float:
    """Mean square of what is left in the known blocks over that of its noise, at least 1."""
    return max(float(np.mean(left**2)) / noise_power(left, known), 1.0)


def drive_regressors(recording: Recording, drive_v: Floats, block_s: float) -> tuple[Floats, int]:
    """What the drive makes of the plate, (n, k), and how many of the first columns may be forces on the plate.

    Each tone with its first two integrals, and each a quarter of a period later: the drive may be a force, or what is
    recorded of it an acceleration, a speed or a path, in any phase. In steady tones these are two columns a tone; where
    the level changes they are not. Bends by the level, squares, cubes and products of tones are no force. Two for each
    line of the mains (`HUM_HZ`) are the last columns.
    """
    forcing = recording.setup.forcing
    w, n = 2.0 * math.pi * forcing.frequency_hz, len(drive_v)
    time_s = (np.arange(n) + 0.5) * block_s
    tones = tones_of(drive_v, block_s, [multiple * forcing.frequency_hz for multiple in forcing.multiples])
    integrals = np.concatenate([_integrals(z, block_s, w)[:, :n] for z in tones])
    tones = [z[:n] for z in tones]
    forces = _scaled(np.concatenate([integrals.real, integrals.imag]))
    level = np.abs(tones[0]) ** 2
    first = tones[0]
    columns = [*(level * z for z in tones), first**2, first**3]
    for further in tones[1:]:
        columns += [first * further, np.conj(first) * further, further**2]
    bent = _scaled(np.concatenate([[z.real, z.imag] for z in columns]))
    slow = np.cos(np.pi * np.arange(4)[:, None] * np.arange(n) / n)  # the zero wanders
    hum = [part(2.0 * np.pi * line * time_s) for line in HUM_HZ for part in (np.cos, np.sin)]
    return np.concatenate([forces, bent, slow, hum]).T, len(forces)


def tones_of(drive: Floats, block_s: float, tones_hz: Sequence[float]) -> list[Complexes]:
    """Analytic signal of a drive (n,) about each tone, (n + m,) each, up to the middle between it and the next.

    Behind its end the drive goes on in its tones for ten periods, or they would seem to change long before it.
    """
    n, m = len(drive), min(round(10.0 / tones_hz[0] / block_s), len(drive))
    turning = 2.0 * np.pi * np.outer(np.arange(2 * m), tones_hz) * block_s
    tones = np.hstack([np.cos(turning), np.sin(turning)])
    end = np.cos(0.5 * np.pi * np.arange(m) / m) ** 2 * (tones[m:] @ lstsq(tones[:m], drive[-m:])[0])
    hz = np.fft.fftfreq(2 * n + m, block_s)  # zeros behind: what leaks does not come round
    whole = np.fft.fft(np.append(drive, end), 2 * n + m)
    spectrum = np.where(hz > 0.0, 2.0 * whole, 0.0)
    edges = [0.0, *(0.5 * (a + b) for a, b in itertools.pairwise(tones_hz)), np.inf]
    bands = ((hz > low) & (hz <= high) for low, high in itertools.pairwise(edges))
    return [np.asarray(np.fft.ifft(np.where(band, spectrum, 0.0))[: n + m]) for band in bands]


def _integrals(tone: Complexes, block_s: float, w: float) -> Complexes:
    """An analytic signal and its integrals over time in units of 1/w, (`INTEGRALS`, n)."""
    n = len(tone)
    relative = 2.0 * np.pi * np.fft.fftfreq(2 * n, block_s) / w
    once = -1j * relative / (relative**2 + LEAKS**2)
    return np.asarray(np.fft.ifft(np.fft.fft(tone, 2 * n) * once ** np.arange(INTEGRALS)[:, None])[:, :n])


def _scaled(table: Floats) -> Floats:
    """Rows that are not zero, scaled to a root mean square of 1."""
    size = np.sqrt(np.mean(table**2, axis=1))
    return np.asarray(table[size > 0.0] / size[size > 0.0, None])
