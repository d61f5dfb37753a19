"""Clock synchronisation: the place among the played samples of frames taken by another clock.

Nothing is resampled. The drive is looped back into the device. A start marker assigns once, without ambiguity, played
samples to frames; from there the looped-back drive is compared with the played one, window by window
(`daq.clocks.loss_search.lag_at`). Raw readings are stored, and the map fitted to them carries its uncertainty.

The place of frame ``m`` among the played samples is ``m + s(m)``. Its lag ``s`` is an integrated random walk: the rate
of a quartz wanders with its temperature. Kalman filter forwards, Rauch-Tung-Striebel smoother backwards (AIAA J. 3,
1445, 1965, equations 3.29 to 3.31); the rate's variance is the one of maximum likelihood.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from daq.clocks.loss_search import LATENCY, PlayedBuffer, lag_at, sliding_products
from daq.clocks.sample_loss import SMALLEST_MISFIT
from daq.files.tables import CLOCK_DTYPE, MAP_DTYPE
from kernels import njit
from kernels.arrays import Floats, Integers

MARKER_S = 0.3
MARKER_HZ = (150.0, 2500.0)
WANDERS = 10.0 ** np.arange(-24.0, -13.0)  # variance of the rate gained in one sample, tried one by one
START_RATE = 500e-6  # by which two clocks may differ
UNKNOWN = 1e6  # variance of an unknown lag, samples squared


def start_marker(rate_hz: float) -> Floats:
    """A chirp of unit height with soft ends, shape (n,): its autocorrelation has one peak, a sample wide.

    Frequencies lie above a coupling capacitor's corner and below what a plate answers to much.
    """
    t = np.arange(round(MARKER_S * rate_hz)) / rate_hz
    low, high = MARKER_HZ[0], min(MARKER_HZ[1], 0.2 * rate_hz)
    turns = low * t + (high - low) * t**2 / (2.0 * MARKER_S)
    return np.asarray(np.sin(np.pi * t / MARKER_S) ** 2 * np.sin(2.0 * np.pi * turns))


def find_marker(heard_v: Floats, marker: Floats) -> float | None:
    """Place in ``heard_v`` at which the marker begins, in samples and parts of one; None where it is absent."""
    if len(heard_v) <= len(marker):
        return None
    match = sliding_products(heard_v - heard_v.mean(), marker)
    k = int(np.argmax(np.abs(match)))
    floor = float(np.median(np.abs(match))) * 1.4826
    # the marker's peak stands this far above the noise around it
    if abs(match[k]) < 8.0 * max(floor, 1e-12) or match[k] <= 0.0 or not 0 < k < len(match) - 1:
        return None
    before, here, after = match[k - 1 : k + 2]
    return k + float(0.5 * (before - after) / (before - 2.0 * here + after))


def window_samples(rate_hz: float, frequency_hz: float) -> int:
    """Frames to compare at once: 50 ms, and a quarter of a cycle, since a straight line fits at many lags."""
    return max(64, round(0.05 * rate_hz), round(0.25 * rate_hz / frequency_hz))


class ClockTracker:
    """Follow the lag while a run lasts.

    The start marker showed ``marker_lag`` (played index less the device's counter) at the device's counter ``at``;
    ``window`` frames are compared at once. ``readings`` are `CLOCK_DTYPE` rows, one for each window in which the drive
    determines the lag.
    """

    def __init__(self, marker_lag: float, at: int, window: int, rate_hz: float) -> None:
        self.readings: list[NDArray[np.void]] = []
        self.origin = at
        self._played = PlayedBuffer(LATENCY + 8 * window)
        self._window = window
        self._wander = (1e-7) ** 2 / rate_hz  # a quartz in a room: a tenth of a ppm in a second, at most
        self._at, self._state = float(at), (marker_lag, 0.0, 1.0, 0.0, START_RATE**2)
        self._heard = np.zeros(0)
        self._first = at
        self._misfits: deque[float] = deque(maxlen=31)

    def played(self, drive_v: Floats) -> None:
        """Append the samples handed to the device that plays."""
        self._played.add(drive_v)

    def lag(self, counter: float) -> float:
        """The lag expected at a frame."""
        return float(self._state[0] + (counter - self._at) * self._state[1])

    def heard(self, first: int, drive_v: Floats) -> None:
        """Take in the looped-back drive from the device's frame ``first`` on."""
        if first != self._first + len(self._heard):
            self._heard, self._first = np.zeros(0), first  # samples were lost: a window has no hole
        self._heard = np.concatenate([self._heard, drive_v])
        while len(self._heard) >= self._window:
            self._look(self._first, self._heard[: self._window])
            self._heard, self._first = self._heard[self._window :], self._first + self._window

    def _look(self, first: int, volts: Floats) -> None:
        """One window: a reading, where the drive moves and fits."""
        centre = first + 0.5 * (len(volts) - 1)
        lag, rate, ss, sr, rr = _ahead(self._state, centre - self._at, self._wander)
        seen = lag_at(self._played, volts, first, round(lag))
        # a window whose lag is less certain is no reading
        if seen.sigma > 1.0 or seen.gain <= 0.0:  # the drive stands still, or is not what came back
            return
        self._misfits.append(seen.rms_v)
        # a window whose misfit is far from the usual one was cut or patched, and says nothing
        if seen.rms_v > 4.0 * max(float(np.median(self._misfits)), SMALLEST_MISFIT * float(np.std(volts))):
            return
        off, variance = seen.samples - lag, seen.sigma**2
        jump = abs(off) > max(0.5, 6.0 * (float(np.sqrt(ss)) + seen.sigma))
        if jump:  # where the lag was wrong the rate may have been, too
            ss, sr, rr = ss + UNKNOWN, 0.0, START_RATE**2
        total = ss + variance
        a, b = 1.0 - variance / total, sr / total
        rate += b * off
        self._at, self._state = centre, (lag + a * off, rate, a * variance, sr * (1.0 - a), rr - b * sr)
        whole = round(centre)
        row = np.zeros(1, CLOCK_DTYPE)
        place = whole + seen.samples + (whole - centre) * rate
        row[0] = whole, whole - self.origin, place, seen.sigma, jump
        self.readings.append(row)


def compile_now() -> None:
    """Have everything compiled before a device runs: afterwards a second's pause would be a lost heartbeat."""
    tracker = ClockTracker(0.0, 0, 64, 1000.0)
    drive_v = np.sin(np.arange(256.0) / 9.0)
    tracker.played(drive_v)
    tracker.heard(0, drive_v)
    fit_clock(np.concatenate(tracker.readings), np.array([100]))


def fit_clock(readings: NDArray[np.void], at: Integers) -> NDArray[np.void]:
    """The map at the frames ``at`` (recorded samples, lost ones counted), `MAP_DTYPE` rows; NaN without readings.

    ``readings`` are `CLOCK_DTYPE` rows in order, ``at`` frames in order.
    """
    rows = np.zeros(len(at), MAP_DTYPE)
    rows["recorded_sample"] = at
    for name in ("played_sample", "uncertainty", "rate", "rate_uncertainty"):
        rows[name] = np.nan
    if len(readings) < 2:
        return rows
    where = readings["recorded_sample"].astype(np.float64)
    lags = readings["played_sample"] - where
    jump = readings["jump"] != 0
    sigma, calm = readings["uncertainty"], ~(jump[1:-1] | jump[2:])  # a jump is no scatter
    if len(where) >= 8 and calm.any():  # no smaller than the readings' own scatter
        # what the middle of three readings differs by from the line through the others: it knows no lag and no rate
        share = (where[1:-1] - where[:-2]) / (where[2:] - where[:-2])
        bend = lags[1:-1] - lags[:-2] - share * (lags[2:] - lags[:-2])
        claimed = np.sqrt(sigma[1:-1] ** 2 + ((1 - share) * sigma[:-2]) ** 2 + (share * sigma[2:]) ** 2)
        sigma = np.asarray(sigma * max(1.0, float(np.median(np.abs(bend / claimed)[calm])) * 1.4826))
    variance = sigma**2
    # the state of each reading: lag, rate, and their variances and covariance
    states, before = np.empty((len(where), 5)), np.empty((len(where), 5))
    likelihoods = [_filter(where, lags, variance, jump, w, before, states) for w in WANDERS]
    wander = float(WANDERS[int(np.argmax(likelihoods))])
    _filter(where, lags, variance, jump, wander, before, states)
    _smooth(where, before, states)
    for row, sample in zip(rows, at, strict=True):
        k = int(np.argmin(np.abs(where - sample)))
        lag, rate, ss, _, rr = _ahead(states[k], float(sample) - where[k], wander)
        row["played_sample"], row["rate"] = sample + lag, rate
        row["uncertainty"], row["rate_uncertainty"] = np.sqrt(ss), np.sqrt(rr)
    return rows


@njit(error_model="numpy")
def _ahead(state, dt, wander):  # type: ignore[no-untyped-def]
    """``(lag, rate, var lag, cov, var rate)`` after ``dt`` frames in which the rate wanders."""
    lag, rate, ss, sr, rr = state
    d = abs(dt)
    return (
        lag + dt * rate,
        rate,
        ss + 2.0 * dt * sr + dt * dt * rr + wander * d**3 / 3.0,
        sr + dt * rr + wander * dt * d / 2.0,
        rr + wander * d,
    )


@njit(error_model="numpy")
def _filter(where, lags, variance, jump, wander, before, after):  # type: ignore[no-untyped-def]
    """Forwards: fills the states before and after each reading, shape (n, 5); returns the log likelihood of all."""
    likelihood = 0.0
    for k in range(where.size):
        if k == 0:
            lag, rate, ss, sr, rr = lags[0], 0.0, UNKNOWN, 0.0, START_RATE**2
        else:
            lag, rate, ss, sr, rr = _ahead(after[k - 1], where[k] - where[k - 1], wander)
        if jump[k]:
            ss += UNKNOWN
        before[k] = lag, rate, ss, sr, rr
        off, total = lags[k] - lag, ss + variance[k]
        likelihood -= 0.5 * (off * off / total + np.log(total))
        a, b = ss / total, sr / total
        after[k] = lag + a * off, rate + b * off, a * variance[k], sr * (1.0 - a), rr - b * sr
    return likelihood


@njit(error_model="numpy")
def _smooth(where, before, states):  # type: ignore[no-untyped-def]
    """Backwards, in place: states by all readings, before and after."""
    for k in range(where.size - 2, -1, -1):
        dt = where[k + 1] - where[k]
        _, _, ss, sr, rr = states[k]
        _, _, pss, psr, prr = before[k + 1]
        det = pss * prr - psr * psr
        # gain = P F' inverse(P-): rows lag and rate
        cs, cr, ds, dr = ss + dt * sr, sr, sr + dt * rr, rr
        g11, g12 = (cs * prr - cr * psr) / det, (cr * pss - cs * psr) / det
        g21, g22 = (ds * prr - dr * psr) / det, (dr * pss - ds * psr) / det
        o1, o2 = states[k + 1, 0] - before[k + 1, 0], states[k + 1, 1] - before[k + 1, 1]
        e11, e12, e22 = states[k + 1, 2] - pss, states[k + 1, 3] - psr, states[k + 1, 4] - prr
        states[k, 0] += g11 * o1 + g12 * o2
        states[k, 1] += g21 * o1 + g22 * o2
        states[k, 2] += g11 * (g11 * e11 + g12 * e12) + g12 * (g11 * e12 + g12 * e22)
        states[k, 3] += g21 * (g11 * e11 + g12 * e12) + g22 * (g11 * e12 + g12 * e22)
        states[k, 4] += g21 * (g21 * e11 + g22 * e12) + g22 * (g21 * e12 + g22 * e22)
