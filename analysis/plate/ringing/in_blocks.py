"""A recording in blocks of a millisecond: acceleration and drive, blocks that no impact hides, what the drive makes."""

from __future__ import annotations

import numpy as np
from scipy.signal import hilbert

from analysis.plate.mains_lines import MAINS_HZ
from analysis.plate.ringing.one_level import OneLevel
from analysis.signals import block_means, pieces
from daq.recording import Recording
from daq.setup.setup import Forcing
from kernels.arrays import Bools, Complexes, Floats, Integers

LEAD_S = 1e-3  # before an impact, left out with it
HUM_HZ = tuple(k * hz for hz in MAINS_HZ for k in (1, 3, 5))


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


def drive_regressors(
    drive_v: Floats, block_s: float, forcing: Forcing, holds: Integers
) -> tuple[Floats, Complexes, Floats]:
    """What the drive makes of the plate, (n, k); its first columns, which may be forces, as signals (l, 1 + n).

    And the frequency of each of these, (l,). They are each tone times its level and the level's first two derivatives,
    each a quarter of a period later, too: the drive may be a force, or what is recorded of it an acceleration, a speed
    or a path, in any phase. In ``holds``, from block to block (m, 2), these are two columns a tone. Bends by the level,
    squares, cubes and products of tones are no force, nor is what the tones leave of the drive. Two for each line of
    the mains (`HUM_HZ`) are the last columns.
    """
    n, one = len(drive_v), OneLevel.of(drive_v, block_s, forcing.frequency_hz, forcing.multiples, holds)
    time_s, (first, *further) = (np.arange(n) + 0.5) * block_s, one.recorded[:, :n]
    swings = (one.turning[:, None] * one.level).reshape(-1, n + 1)
    size = np.sqrt(np.mean(swings.real[:, :n] ** 2, axis=1))
    fades = size > 1e-9 * float(np.max(size))  # a level that never changes has no derivatives
    hz, swings = forcing.frequency_hz * np.repeat(forcing.multiples, 3)[fades], swings[fades] / size[fades, None]
    forces = np.concatenate([swings, -1j * swings])
    columns = [*(np.abs(first) ** 2 * z for z in (first, *further)), first**2, first**3, hilbert(one.left)]
    for tone in further:
        columns += [first * tone, np.conj(first) * tone, tone**2]
    bent = _scaled(np.concatenate([[z.real, z.imag] for z in columns]))
    slow = np.cos(np.pi * np.arange(4)[:, None] * np.arange(n) / n)  # the zero wanders
    hum = [part(2.0 * np.pi * line * time_s) for line in HUM_HZ for part in (np.cos, np.sin)]
    return np.concatenate([forces.real[:, :n], bent, slow, hum]).T, forces, np.tile(hz, 2)


def _scaled(table: Floats) -> Floats:
    """Rows that are not zero, scaled to a root mean square of 1."""
    size = np.sqrt(np.mean(table**2, axis=1))
    return np.asarray(table[size > 0.0] / size[size > 0.0, None])
