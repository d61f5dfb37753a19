"""Amplitudes within windows of a few cycles, and the slow residual, of one chunk of a step.

Tones are evaluated by rotating phasors in one pass over the block means. Only sums over windows and over slow bins
are kept.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from analysis.plate.fit_mask import FitIntervals
from analysis.plate.step_state import CONTACT, N_MASK_LEVELS, ChunkFit, Span, StepState
from daq.lock_in import ToneFit
from kernels import njit

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Ints = npt.NDArray[np.int64]

RESYNC = 512  # means between exact restarts of the rotating phasors
WINDOW_CYCLES = 2.0  # length of a window
SLOW_PER_CYCLE = 4.0  # values of the slow residual per period of the forcing
MIN_WINDOW_COVER = 0.4  # part of a window's blocks that must be unmasked
RIDGE = 1e-9  # added to the windows' normal matrices, for tones that hardly differ within a window
MIN_WINDOWS = 4  # windows needed to measure a frequency
MAX_PHASE_SIGMA_RAD = 0.3  # largest phase error of a window that still allows the phase to be unwrapped
FREQUENCY_SIGMAS = 4.0  # significance of a frequency correction
MIN_DRIFT_RAD = 1e-4  # smallest phase error over the step that is corrected


class StepTones(NamedTuple):
    """Fit of the step that residuals are taken from: k tones, 2 channels.

    ``cycles`` (k,) per block, ``response`` (k,) of the block mean, ``amplitudes`` (2, k), ``offsets`` (2,), and
    ``rows`` of the forcing's tones.
    """

    cycles: Floats
    response: Complexes
    amplitudes: Complexes
    offsets: Floats
    rows: Ints


class WindowSums(NamedTuple):
    """Sums over one span: slow residuals and their counts (s,); normal equations of w windows with q unknowns.

    The unknowns are a constant and the forcing's tones, fitted to the residual: normal matrices ``gram`` (w, q, q),
    right sides ``side`` (w, q, 2), sums of squares ``power`` (w, 2), and blocks ``used`` (w,).
    """

    slow: Floats
    slow_count: Ints
    gram: Floats
    side: Floats
    power: Floats
    used: Ints


def fit_windows(state: StepState, rate_hz: float) -> ChunkFit | None:
    """Slow residual and windowed amplitudes of the open chunk at ``rate_hz`` blocks a second.

    Returns
    -------
    ChunkFit or None
        None where the tones cannot be fitted.
    """
    lock_in = state.lock_in
    if lock_in is None:
        return None
    clear = lock_in.part(state.clear_classes())
    try:
        fits = clear.solve(0), clear.solve(1)
    except ValueError:
        return None
    tones = StepTones(
        lock_in.frequencies_hz / rate_hz,
        lock_in.response(),
        np.array([f.amplitudes for f in fits]),
        np.array([f.offset for f in fits]),
        np.array(state.rows),
    )
    group = max(int(rate_hz / (SLOW_PER_CYCLE * state.frequency_hz)), 1)
    length = max(round(WINDOW_CYCLES * rate_hz / state.frequency_hz), 1)
    q = 2 * tones.rows.size + 1
    parts, intervals, counted = [], [], 0
    for span in state.spans:
        keep = span.clear(state.mask_level)
        sums = _span_sums(span, keep, tones, group, length)
        windows = sums.used.size
        slow_s = (span.first + (np.arange(sums.slow.size) + 0.5) * group) / rate_hz
        time_s = (span.first + (np.arange(windows) + 0.5) * length) / rate_hz
        enough = sums.used >= max(MIN_WINDOW_COVER * length, 2 * q)
        row_of = np.append(np.where(enough, counted + np.cumsum(enough) - 1, -1), -1)
        window = row_of[np.minimum(np.arange(keep.size) // length, windows)]
        contact = span.block_class // N_MASK_LEVELS == CONTACT
        intervals.append(FitIntervals.of_blocks(span.first, keep, window, contact, 1.0 / rate_hz))
        counted += int(enough.sum())
        slow = np.where(sums.slow_count > 0, sums.slow / np.maximum(sums.slow_count, 1), np.nan)
        parts.append((slow_s, slow, time_s[enough], *(column[enough] for column in sums[2:])))
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    slow_s, slow, time_s, *equations = (np.asarray(column, dtype=np.float64) for column in columns)
    amplitudes, spread, noise = _solve_windows(tones, fits, *equations)
    none = np.zeros(len(intervals), dtype=np.int64)
    return ChunkFit(slow_s, slow, time_s, amplitudes, spread, noise, fits, FitIntervals.join(intervals, none, none))


def _span_sums(span: Span, keep: npt.NDArray[np.bool_], tones: StepTones, group: int, length: int) -> WindowSums:
    """Sums over one span, in slow bins of ``group`` blocks and windows of ``length`` blocks."""
    n, q = keep.size, 2 * tones.rows.size + 1
    slow, windows = n // group, n // length
    sums = WindowSums(
        np.zeros(slow),
        np.zeros(slow, dtype=np.int64),
        np.zeros((windows, q, q)),
        np.zeros((windows, q, 2)),
        np.zeros((windows, 2)),
        np.zeros(windows, dtype=np.int64),
    )
    _accumulate(span.values, keep, span.first, tones, group, length, sums)
    return sums


def _solve_windows(
    tones: StepTones, fits: tuple[ToneFit, ToneFit], gram: Floats, side: Floats, power: Floats, used: Floats
) -> tuple[Complexes, Floats, Floats]:
    """Amplitudes (w, tones, 2), their spread in units of the noise (w, tones), and the noise (2,)."""
    q = 2 * tones.rows.size + 1
    inverse = np.linalg.inv(gram + RIDGE * np.eye(q))
    solution = inverse @ side
    amplitudes = tones.amplitudes[:, tones.rows].T[None] + solution[:, 1::2] + 1j * solution[:, 2::2]
    spread = np.sqrt(np.diagonal(inverse, axis1=1, axis2=2)[:, 1:].reshape(-1, tones.rows.size, 2).mean(axis=2))
    left = np.maximum(power.sum(axis=0) - np.sum(side * solution, axis=(0, 1)), 0.0)
    freedom = float(used.sum()) - q * used.size
    noise = np.sqrt(left / freedom) if freedom > 0.0 else np.array([f.rms for f in fits])
    return amplitudes, spread, noise


def refined_hz(state: StepState, chunk: ChunkFit, has_drive: bool) -> tuple[float, float, bool] | None:
    """Frequency, its uncertainty, and whether it differs significantly from the step table's.

    The phase of the strongest forcing tone is followed from window to window: in the drive where it was recorded (it
    carries neither impacts nor the ball), else in the accelerometer. None where there are too few windows.
    """
    if chunk.time_s.size < MIN_WINDOWS:
        return None
    channel = 1 if has_drive else 0
    multiples = np.array([state.multiples[r] for r in state.rows])
    strongest = int(np.argmax(np.abs(chunk.amplitudes[:, :, channel]).mean(axis=0) * multiples))
    z = chunk.amplitudes[:, strongest, channel]
    sigma = chunk.fits[channel].rms * chunk.spread[:, strongest] / np.maximum(np.abs(z), 1e-300)
    if np.median(sigma) > MAX_PHASE_SIGMA_RAD:
        return None
    weight = 1.0 / np.maximum(sigma, 1e-9) ** 2
    time_s = chunk.time_s - np.average(chunk.time_s, weights=weight)
    curvature = float(np.sum(weight * time_s**2))
    scale = 2.0 * np.pi * float(multiples[strongest])
    away = float(np.sum(weight * time_s * np.unwrap(np.angle(z)))) / curvature / scale
    error = 1.0 / np.sqrt(curvature) / scale
    changed = abs(away) > FREQUENCY_SIGMAS * error and abs(away) * 2.0 * np.pi * state.hold_s > MIN_DRIFT_RAD
    return (state.nominal_hz + away, error, True) if changed else (state.nominal_hz, error, False)


@njit(error_model="numpy")
def _accumulate(x, keep, first, tones, group, length, sums):  # type: ignore[no-untyped-def]
    """Add the residuals of the block means ``x`` (n, channels) about the step's ``tones`` to ``sums``.

    Slow sums take the first channel; block ``i`` belongs to slow bin ``i // group`` and to window ``i // length``.
    """
    cycles, response, amplitudes, offsets, rows = tones
    slow, slow_count, gram, side, power, used = sums
    n, channels = x.shape
    k = cycles.shape[0]
    q = 2 * rows.shape[0] + 1
    step = np.exp(2j * np.pi * cycles)
    phasor = np.empty(k, dtype=np.complex128)
    row = np.empty(q)
    row[0] = 1.0
    residual = np.empty(channels)
    for i in range(n):
        if i % RESYNC == 0:
            for j in range(k):
                phase = cycles[j] * (first + i)
                phasor[j] = np.exp(2j * np.pi * (phase - np.floor(phase))) * response[j]
        if keep[i]:
            for c in range(channels):
                fit = offsets[c]
                for j in range(k):
                    fit += amplitudes[c, j].real * phasor[j].real - amplitudes[c, j].imag * phasor[j].imag
                residual[c] = x[i, c] - fit
            g = i // group
            if g < slow.shape[0]:
                slow[g] += residual[0]
                slow_count[g] += 1
            w = i // length
            if w < gram.shape[0]:
                used[w] += 1
                for r in range(rows.shape[0]):
                    row[2 * r + 1] = phasor[rows[r]].real
                    row[2 * r + 2] = -phasor[rows[r]].imag
                for c in range(channels):
                    power[w, c] += residual[c] * residual[c]
                for a in range(q):
                    for b in range(q):
                        gram[w, a, b] += row[a] * row[b]
                    for c in range(channels):
                        side[w, a, c] += row[a] * residual[c]
        for j in range(k):
            phasor[j] *= step[j]
