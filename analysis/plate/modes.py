"""Identification of a ringing plate mode from recorded volts: what the ball does to the plate, and the answer to it.

No flight is predicted. Per ball mass, the ball pushes the plate by ``-(g + a)`` while it lies on it, with the measured
acceleration ``a`` of the plate, and by an impulse ``-J`` at each landing; see `ball_push`. The accelerometer shows the
drive times a gain, and a mode's answer ``q''`` of ``q'' + 2 damping w q' + w^2 q = mass_ratio * push``. Gain and mass
ratio are linear and regressed; only frequency and damping are searched.

    mode = identified_mode(recording, flights.takeoff_s[true], flights.landing_s[true], mask_s)

gives a `PlateMode` with covariance, or None where none is identified, which is no proof that there is none. The closed
loop does not use it yet: on recordings of fresh seeds the damping is off by more than its standard deviation says, most
where a ball's contact is too short to be seen (``python -m benchmarks.analysis.ringing``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from analysis.linear_algebra import pinv
from analysis.plate.ball_push import ball_push, filled_after_impacts
from analysis.plate.mains_lines import MAINS_HZ
from analysis.signals.stream import block_means, pieces
from daq.recording import Recording
from kernels.arrays import Bools, Complexes, Floats, Integers

RATE_HZ = 2000.0  # of the block means: far above any mode that a ball shakes
LOWEST_HZ, HIGHEST_HZ = 0.7, 200.0
DAMPINGS = (0.01, 0.05, 0.2)
GRID = 1.12  # ratio of neighbouring frequencies of the first look
STARTS = 4
MOST_STEPS = 25  # of a search from one start
ROUNDS = 4  # until mass ratio and the accelerometer's zero agree
LEAD_S = 1e-3  # before an impact, left out with it
FEWEST_IMPACTS = 20
CLUSTER_S = 0.5  # length of the pieces whose scores are taken as independent
GAIN_NATS = 15.0  # least gain of a mode that is there


@dataclass(frozen=True)
class PlateMode:
    """A damped mode of the plate that the ball strikes.

    Attributes
    ----------
    frequency_hz, damping, mass_ratio
        Of ``q'' + 2 damping w q' + w^2 q = mass_ratio * push``; damping over critical, ball over moving mass.
    covariance
        Of the three, (3, 3).
    remainder_mps2, before_mps2
        Root mean square of what is left of the acceleration with the mode and without it.
    gain_nats
        By how much the mode raises the likelihood, the remainder's correlation allowed for.
    """

    frequency_hz: float
    damping: float
    mass_ratio: float
    covariance: Floats
    remainder_mps2: float
    before_mps2: float
    gain_nats: float

    def sigmas(self) -> tuple[float, float, float]:
        """Standard deviations of frequency, damping and mass ratio."""
        f, d, m = np.sqrt(np.diag(self.covariance))
        return float(f), float(d), float(m)


def identified_mode(recording: Recording, takeoff_s: Floats, landing_s: Floats, mask_s: float) -> PlateMode | None:
    """The mode that the ball's push shakes; None where none is identified, without a drive, or with too few impacts.

    Parameters
    ----------
    recording
        Open.
    takeoff_s, landing_s
        Of the true flights (n,), in order, on the recording's axis.
    mask_s
        How long the accelerometer shows more than the plate's motion after an impact.
    """
    if "drive" not in recording.channels or len(landing_s) < FEWEST_IMPACTS or len(recording.gaps):
        return None
    width = max(round(recording.rate_hz / RATE_HZ), 1)
    block_s = width / recording.rate_hz
    acceleration, drive = _means(recording, width)
    landed = landing_s < (len(acceleration) - 1) * block_s
    known = _unmasked(len(acceleration), block_s, landing_s, mask_s)
    if not landed.all():  # the impulse at the end of the flight before needs this flight
        last = int(np.argmin(landed))
        known[int((landing_s[max(last - 1, 0)] - LEAD_S) / block_s) :] = False
    takeoff_s, landing_s = takeoff_s[landed], landing_s[landed]
    gravity = recording.setup.g_mps2.value
    acceleration = filled_after_impacts(acceleration, known)
    acceleration -= np.mean(acceleration)
    linear = _driven(recording, drive, block_s)
    basis = np.linalg.qr(linear[known])[0]
    found, zero = None, 0.0
    # The plate goes nowhere, so what it gains by impacts, which the acceleration between them lacks, is its mean.
    for _ in range(ROUNDS):
        push, jumps = ball_push(acceleration + zero, block_s, takeoff_s, landing_s, gravity)
        seen = _Regression.of(acceleration, basis, push, known, block_s)
        x = seen.searched() if found is None else seen.followed([found])
        ratio = seen.ratio(x)
        found, zero = x, ratio * jumps / (len(acceleration) * block_s)
    return None if found is None else seen.judged(found)


def _means(recording: Recording, width: int) -> tuple[Floats, Floats]:
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


def _unmasked(n: int, block_s: float, landing_s: Floats, mask_s: float) -> Bools:
    """Blocks (n,) without an impact or its ringing."""
    edges = np.zeros(n + 1, dtype=np.int64)
    first = np.clip(((landing_s - LEAD_S) / block_s).astype(np.int64), 0, n)
    last = np.clip(((landing_s + mask_s) / block_s).astype(np.int64) + 1, 0, n)
    np.add.at(edges, first, 1)
    np.add.at(edges, last, -1)
    return np.asarray(np.cumsum(edges[:-1]) == 0)


def _driven(recording: Recording, drive_v: Floats, block_s: float) -> Floats:
    """Regressors of what the drive makes of the plate, (n, k): both quadratures of its tones, bent by level, products.

    A bent gain, harmonics and a second tone are so linear in what is regressed.
    """
    forcing = recording.setup.forcing
    w, n = 2.0 * math.pi * forcing.frequency_hz, len(drive_v)
    time_s = (np.arange(n) + 0.5) * block_s
    cycle = max(round(1.0 / forcing.frequency_hz / block_s), 1)
    tones: list[Complexes] = []
    for multiple in sorted({1, forcing.ratio}):
        turning = np.exp(-1j * multiple * w * time_s)
        low: Complexes = _cycle_mean(_cycle_mean(2.0 * drive_v * turning, cycle), cycle)
        tones.append(np.asarray(low * np.conj(turning)))
    level = np.abs(tones[0]) ** 2
    first = tones[0]
    columns = [*tones, *(level * z for z in tones), first**2, first**3]
    if len(tones) > 1:
        columns += [first * tones[1], np.conj(first) * tones[1], tones[1] ** 2]
    whole = [drive_v, np.gradient(drive_v)]  # the tones' means over cycles lag in a fade
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


def answer(push_mps2: Floats, block_s: float, frequency_hz: float, damping: float) -> Floats:
    """Mean acceleration in each block, (n,), of a mode of mass ratio 1 under a push that is constant in each.

    The transition from block to block is exact. The mode begins at rest under the first push.
    """
    w = 2.0 * math.pi * frequency_hz
    turn = complex(-damping * w, w * math.sqrt(1.0 - damping**2))
    pole = np.exp(turn * block_s)
    # velocity q' = sum over both poles; a step of the push makes q' = Im exp(turn t) / Im turn
    step = np.exp(turn * block_s * np.array([0.0, 1.0])).imag / turn.imag
    changes = np.diff(push_mps2, prepend=push_mps2[0])
    speed = lfilter([0.0, step[1]], [1.0, -2.0 * pole.real, abs(pole) ** 2], changes)  # at the end of a block: step
    following = np.append(speed[1:], 2.0 * pole.real * speed[-1] - abs(pole) ** 2 * speed[-2])
    return np.asarray((following - speed) / block_s)


@dataclass(frozen=True)
class _Regression:
    """Unmasked blocks with everything linear but the mode taken out of them."""

    left: Floats
    basis: Floats  # orthonormal, (k, l)
    push: Floats
    known: Bools
    block_s: float
    cluster: Integers

    @classmethod
    def of(cls, acceleration: Floats, basis: Floats, push: Floats, known: Bools, block_s: float) -> _Regression:
        seen = acceleration[known]
        cluster = (np.flatnonzero(known) * block_s / CLUSTER_S).astype(np.int64)
        return cls(seen - basis @ (basis.T @ seen), basis, push, known, block_s, cluster)

    def column(self, frequency_hz: float, damping: float) -> Floats:
        """The mode's answer in the known blocks, less what the rest could explain."""
        x = answer(self.push, self.block_s, frequency_hz, damping)[self.known]
        return np.asarray(x - self.basis @ (self.basis.T @ x))

    def remainder(self, x: Floats) -> Floats:
        """What is left at the logarithms of frequency and damping."""
        column = self.column(*np.exp(x))
        return np.asarray(self.left - column * max(float(column @ self.left) / float(column @ column), 0.0))

    def ratio(self, x: Floats) -> float:
        """Mass ratio at the logarithms of frequency and damping."""
        column = self.column(*np.exp(x))
        return max(float(column @ self.left) / float(column @ column), 0.0)

    def searched(self) -> Floats:
        """Logarithms of frequency and damping of the best mode of all."""
        count = int(math.log(HIGHEST_HZ / LOWEST_HZ) / math.log(GRID))
        looked = [np.log([LOWEST_HZ * GRID**k, d]) for k in range(count) for d in DAMPINGS]
        loss = np.array([float(np.sum(self.remainder(x) ** 2)) for x in looked]).reshape(count, -1)
        best = loss.min(axis=1)
        inner = [k for k in range(count) if best[k] <= min(best[max(k - 1, 0)], best[min(k + 1, count - 1)])]
        starts = sorted(inner, key=lambda k: best[k])[:STARTS]
        return self.followed([looked[k * len(DAMPINGS) + int(np.argmin(loss[k]))] for k in starts])

    def followed(self, starts: list[Floats]) -> Floats:
        """The best minimum from some starts."""
        low, high = np.log([[0.5 * LOWEST_HZ, 1e-3], [2.0 * HIGHEST_HZ, 0.9]])
        fits = [
            least_squares(self.remainder, x, bounds=(low, high), x_scale=0.1, xtol=1e-4, max_nfev=MOST_STEPS)
            for x in starts
        ]
        return np.asarray(min(fits, key=lambda f: f.cost).x)

    def judged(self, x: Floats) -> PlateMode | None:
        """The mode at the logarithms of frequency and damping with its covariance."""
        frequency, damping = (float(v) for v in np.exp(x))
        column, h = self.column(frequency, damping), 1e-4
        ratio = float(column @ self.left) / float(column @ column)
        left = self.left - ratio * column
        ahead = [self.column(*np.exp(x + h * e)) for e in np.eye(2)]
        behind = [self.column(*np.exp(x - h * e)) for e in np.eye(2)]
        slopes = [ratio * (a - b) / (2.0 * h) for a, b in zip(ahead, behind, strict=True)]
        jacobian = np.column_stack([slopes[0] / frequency, slopes[1] / damping, column])
        inverse = pinv(jacobian.T @ jacobian, rcond=1e-14)
        scores = np.array([np.bincount(self.cluster, row) for row in (jacobian * left[:, None]).T])
        covariance = inverse @ (scores @ scores.T) @ inverse
        correlated = max(float(covariance[2, 2] / (inverse[2, 2] * np.mean(left**2))), 1.0)
        gain = 0.5 * (float(self.left @ self.left) / float(left @ left) - 1.0) * len(left) / correlated
        if ratio <= 0.0 or gain < GAIN_NATS or not LOWEST_HZ < frequency < HIGHEST_HZ:
            return None
        rms = [float(np.sqrt(np.mean(v**2))) for v in (left, self.left)]
        return PlateMode(frequency, damping, ratio, covariance, rms[0], rms[1], gain)
