"""Amplitudes within windows of a few cycles, and the slow residual, of one chunk of a step.

Tones are evaluated by rotating phasors in one pass over the block means. Only sums over windows and over slow bins
are stored.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from analysis.plate.mains_lines import BIN_S, noise_near
from analysis.plate.step_state import CONTACT, N_MASK_LEVELS, ChunkFit, FitIntervals, Span, StepState
from analysis.statistics import median
from daq.lock_in import ToneFit
from daq.lock_in_kernel import RESYNC, turns
from kernels import njit
from kernels.arrays import Complexes, Floats, Integers

WINDOW_CYCLES = 2.0  # length of a window
RIDGE = 1e-9  # added to the windows' normal matrices, for tones that hardly differ within a window
MIN_DRIFT_RAD = 1e-4  # smallest phase error over the step that is corrected


class StepTones(NamedTuple):
    """Fit of the step that residuals are taken from: k tones, 2 channels.

    ``cycles`` (k,) per block, ``response`` (k,) of the block mean, ``amplitudes`` (2, k), ``offsets`` (2,), and
    ``rows`` of the forcing's tones, then those of mains lines, ``forcing`` and ``lines`` many.
    """

    cycles: Floats
    response: Complexes
    amplitudes: Complexes
    offsets: Floats
    rows: Integers
    forcing: int
    lines: int

    @property
    def unknowns(self) -> int:
        """Of a window: a constant, and two for each of the forcing's tones."""
        return 2 * self.forcing + 1


class SpanSums(NamedTuple):
    """Sums over one span, for w windows with q unknowns: a constant and the forcing's tones, fitted to the residual.

    ``left`` (n,) is the accelerometer's residual, 0 where masked; ``slow_s``, ``slow`` (s,) are times and means of the
    slow one, NaN where all is masked; ``time_s`` (w,) the middles of the windows. Normal matrices are ``gram``
    (w, q, q), right sides ``side`` (w, q, 2), sums of squares ``power`` (w, 2), and blocks ``used`` (w,).
    """

    left: Floats
    slow_s: Floats
    slow: Floats
    time_s: Floats
    gram: Floats
    side: Floats
    power: Floats
    used: Integers


class SpanWindows(NamedTuple):
    """Windows of ``length`` blocks, ``least`` of them unmasked, else there is no window, numbered from ``counted``.

    Beats of mains lines have bins of ``beat`` blocks, counted from block ``origin`` on.
    """

    length: int
    least: float
    counted: int
    beat: float
    origin: int


class Scratch(NamedTuple):
    """What the sums over a span need meanwhile: turns, residuals and columns of some blocks, and counts."""

    cosine: Floats
    sine: Floats
    left: Floats
    row: Floats
    n_slow: Integers


def fit_windows(state: StepState, rate_hz: float) -> ChunkFit | None:
    """Slow residual and windowed amplitudes of the open chunk at ``rate_hz`` blocks a second.

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
        np.array([*state.rows, *range(len(state.multiples), lock_in.frequencies_hz.size)]),
        len(state.rows),
        lock_in.frequencies_hz.size - len(state.multiples),
    )
    # four values of the slow residual a period: slow lines lie below the forcing
    group = max(int(rate_hz / (4.0 * state.frequency_hz)), 1)
    length = max(round(WINDOW_CYCLES * rate_hz / state.frequency_hz), 1)
    # a window needs 40 % of its blocks, and twice as many as unknowns
    least = max(0.4 * length, 2.0 * tones.unknowns)
    begin, beat = state.spans[0].first, BIN_S * rate_hz
    beats = np.zeros((int((state.spans[-1].last - 1 - begin) / beat) + 1, tones.lines), dtype=np.complex128)
    parts, intervals, counted = [], [], 0
    for span in state.spans:
        windows = SpanWindows(length, least, counted, beat, begin)
        sums, row_of = _sum_span(span, state.mask_level, group, tones, windows, rate_hz, beats)
        keep, window, contact = _places(span.block_class, state.mask_level, row_of, length)
        intervals.append(FitIntervals.of_blocks(span.first, keep, window, contact, 1.0 / rate_hz))
        parts.append(sums)
        counted += sums.time_s.size
    sums = SpanSums(*(np.concatenate(own) for own in zip(*parts, strict=True)))
    amplitudes, spread, noise = _solve_windows(tones, fits, sums)
    none = np.zeros(len(intervals), dtype=np.int64)
    whole = intervals[0] if len(intervals) == 1 else FitIntervals.join(intervals, none, none)
    near = noise_near(sums.left, tones.cycles, len(state.multiples), rate_hz)
    return ChunkFit(sums.slow_s, sums.slow, sums.time_s, amplitudes, spread, noise, fits, whole, beats, near)


def _solve_windows(tones: StepTones, fits: tuple[ToneFit, ToneFit], sums: SpanSums) -> tuple[Complexes, Floats, Floats]:
    """Amplitudes (w, tones, 2), their spread in units of the noise (w, tones), and the noise (2,)."""
    windows, q = sums.used.size, tones.unknowns
    solution, variances, left = np.empty((windows, q, 2)), np.empty((windows, q)), np.add.reduce(sums.power)
    _solve(sums.gram, sums.side, solution, variances, left)
    # fitted was the residual about the step's own tones
    amplitudes = tones.amplitudes[:, tones.rows[: tones.forcing]].T[None] + solution[:, 1::2] + 1j * solution[:, 2::2]
    spread = np.sqrt(0.5 * (variances[:, 1::2] + variances[:, 2::2]))
    freedom = float(np.add.reduce(sums.used)) - q * windows
    noise = np.sqrt(np.maximum(left, 0.0) / freedom) if freedom > 0.0 else np.array([f.rms for f in fits])
    return amplitudes, spread, noise


@njit(error_model="numpy", fastmath={"contract", "nsz"})
def _solve(grams, sides, solutions, variances, left):  # type: ignore[no-untyped-def]
    """Solutions (w, q, 2) of the windows' normal equations, and the diagonals (w, q) of their matrices' inverses.

    By Gauss-Jordan elimination, which needs no pivots where a matrix is positive. What each solution explains is taken
    from the sums of squares ``left`` (2,).
    """
    q = grams.shape[1]
    a = np.empty((q, q))
    for w in range(grams.shape[0]):
        for k in range(q):
            for j in range(q):
                a[k, j] = grams[w, k, j]
            a[k, k] += RIDGE
        for k in range(q):
            pivot = 1.0 / a[k, k]
            a[k, k] = 1.0
            for j in range(q):
                a[k, j] *= pivot
            for i in range(q):
                if i != k:
                    factor = a[i, k]
                    a[i, k] = 0.0
                    for j in range(q):
                        a[i, j] -= factor * a[k, j]
        for i in range(q):
            variances[w, i] = a[i, i]
            for c in range(2):
                total = 0.0
                for j in range(q):
                    total += a[i, j] * sides[w, j, c]
                solutions[w, i, c] = total
                left[c] -= total * sides[w, i, c]


def refined_hz(state: StepState, chunk: ChunkFit, has_drive: bool) -> tuple[float, float, bool] | None:
    """Frequency, its uncertainty, and whether it differs significantly from the step table's.

    The phase of the strongest forcing tone is followed from window to window: in the drive where it was recorded (it
    carries neither impacts nor the ball), else in the accelerometer. None where there are too few windows.
    """
    # fewer windows measure no frequency
    if chunk.time_s.size < 4:
        return None
    channel = 1 if has_drive else 0
    multiples = np.array([state.multiples[r] for r in state.rows])
    # a phase tells the frequency the better, the larger and the faster the tone is
    strongest = int(np.argmax(np.add.reduce(np.abs(chunk.amplitudes[:, :, channel])) * multiples))
    z = chunk.amplitudes[:, strongest, channel]
    sigma = chunk.fits[channel].rms * chunk.spread[:, strongest] / np.maximum(np.abs(z), 1e-300)
    # windows whose phase is known worse than to 0.3 rad cannot be unwrapped
    if median(sigma) > 0.3:
        return None
    weight = 1.0 / np.maximum(sigma, 1e-9) ** 2
    # about the weighted mean of the times slope and constant of a line are uncorrelated
    time_s = chunk.time_s - np.add.reduce(chunk.time_s * weight) / np.add.reduce(weight)
    pull = weight * time_s
    curvature = float(pull @ time_s)
    scale = 2.0 * np.pi * float(multiples[strongest])
    phase = np.angle(z)
    if np.abs(phase[1:] - phase[:-1]).max() >= np.pi:
        phase = np.unwrap(phase)
    away = float(pull @ phase) / curvature / scale
    error = 1.0 / np.sqrt(curvature) / scale
    # a correction below four sigma, or of 1e-4 rad over the step, is none
    if abs(away) <= 4.0 * error:
        return state.nominal_hz, error, False
    if abs(away) * 2.0 * np.pi * state.hold_s <= MIN_DRIFT_RAD:
        return state.nominal_hz, abs(away), False
    return state.nominal_hz + away, error, True


def _sum_span(
    span: Span, level: int, group: int, tones: StepTones, windows: SpanWindows, rate_hz: float, beats: Complexes
) -> tuple[SpanSums, Integers]:
    """Sums of the residuals of a span's block means about the step's ``tones``, in slow bins of ``group`` blocks.

    And the number of the window of each place of ``windows.length`` blocks, and of the rest; -1 for none.
    To ``beats`` (b, lines) the residual is added, each mains line left in and demodulated at it.
    """
    n, q = len(span.values), tones.unknowns
    bins, places = n // group, n // windows.length
    sums = SpanSums(
        np.empty(n),
        np.empty(bins),
        np.zeros(bins),
        np.empty(places),
        np.zeros((places, q, q)),
        np.zeros((places, q, 2)),
        np.zeros((places, 2)),
        np.zeros(places, dtype=np.int64),
    )
    scratch = Scratch(
        np.empty((tones.cycles.size, RESYNC)),
        np.empty((tones.cycles.size, RESYNC)),
        np.empty((2, RESYNC)),
        np.empty((2 * tones.rows.size + 1, RESYNC)),
        np.zeros(bins, dtype=np.int64),
    )
    row_of = np.full(places + 1, -1)
    given = span.values, span.block_class, span.first, level, group, tones, windows, rate_hz, beats
    w = _fill_sums(*given, sums, scratch, row_of)
    of_windows = {name: getattr(sums, name)[:w] for name in ("time_s", "gram", "side", "power", "used")}
    return sums._replace(**of_windows), row_of


@njit()
def _places(block_class, level, row_of, length):  # type: ignore[no-untyped-def]
    """Whether each block is outside the mask, its window, and whether it is contact, (n,) each."""
    n = block_class.shape[0]
    keep, window, contact = np.empty(n, dtype=np.bool_), np.empty(n, dtype=np.int64), np.empty(n, dtype=np.bool_)
    for w in range(row_of.shape[0]):
        window[w * length : (w + 1) * length] = row_of[w]
    for i in range(n):
        place = block_class[i] // N_MASK_LEVELS
        keep[i] = block_class[i] - place * N_MASK_LEVELS >= level
        contact[i] = place == CONTACT
    return keep, window, contact


@njit(error_model="numpy")
def _fill_sums(x, block_class, first, level, group, tones, windows, rate_hz, beats, sums, scratch, row_of):  # type: ignore[no-untyped-def]
    """Fill a span's ``sums`` from its block means ``x`` (n, 2), and ``row_of``; returns the number of windows.

    Slow sums take the first channel; a slow bin has ``group`` blocks.
    """
    length = windows.length
    cosine, sine, left, row, n_slow = scratch
    n, q = x.shape[0], sums.gram.shape[1]
    turns(tones.cycles, cosine, sine)
    for begin in range(0, n, RESYNC):
        size = min(RESYNC, n - begin)
        _residuals(x, begin, size, first, tones, cosine, sine, left, row)
        for at in range(size):
            clear = block_class[begin + at] % N_MASK_LEVELS >= level
            for c in range(2):
                left[c, at] = left[c, at] if clear else 0.0
            for a in range(row.shape[0]):
                row[a, at] = row[a, at] if clear else 0.0
        sums.left[begin : begin + size] = left[0, :size]
        for g in range(begin // group, min((begin + size - 1) // group + 1, n_slow.shape[0])):
            start, stop = max(g * group - begin, 0), min((g + 1) * group - begin, size)
            sums.slow[g] += _dot(left[0, start:stop], row[0, start:stop])
            n_slow[g] += int(_dot(row[0, start:stop], row[0, start:stop]))
        for w in range(begin // length, min((begin + size - 1) // length + 1, sums.used.shape[0])):
            start, stop = max(w * length - begin, 0), min((w + 1) * length - begin, size)
            sums.used[w] += int(_dot(row[0, start:stop], row[0, start:stop]))
            for a in range(q):
                for b in range(a + 1):
                    sums.gram[w, a, b] += _dot(row[a, start:stop], row[b, start:stop])
                for c in range(2):
                    sums.side[w, a, c] += _dot(row[a, start:stop], left[c, start:stop])
            for c in range(2):
                sums.power[w, c] += _dot(left[c, start:stop], left[c, start:stop])
        _add_beats(first + begin - windows.origin, size, windows.beat, tones, q, left, row, beats)
    for g in range(n_slow.shape[0]):
        sums.slow_s[g] = (first + (g + 0.5) * group) / rate_hz
        sums.slow[g] = sums.slow[g] / n_slow[g] if n_slow[g] > 0 else np.nan
    return _keep_windows(first, windows, rate_hz, sums, row_of)


@njit(error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def _dot(x, y):  # type: ignore[no-untyped-def]
    """Scalar product of two arrays (n,)."""
    total = 0.0
    for i in range(x.size):
        total += x[i] * y[i]
    return total


@njit(error_model="numpy")
def _add_beats(since, size, beat, tones, q, left, row, beats):  # type: ignore[no-untyped-def]
    """Add to ``beats`` the residual of ``size`` blocks, the first of them ``since`` blocks after their origin."""
    start = 0
    while start < size:
        place = int((since + start) / beat)
        stop = max(min(int(np.ceil((place + 1) * beat)) - since, size), start + 1)
        for line in range(beats.shape[1]):
            z = tones.amplitudes[0, tones.rows[tones.forcing + line]]
            a, b = row[q + 2 * line, start:stop], row[q + 2 * line + 1, start:stop]
            both, x = _dot(a, b), left[0, start:stop]
            cosine = _dot(x, a) + z.real * _dot(a, a) + z.imag * both
            beats[place, line] += complex(cosine, _dot(x, b) + z.real * both + z.imag * _dot(b, b))
        start = stop


@njit(error_model="numpy")
def _keep_windows(first, windows, rate_hz, sums, row_of):  # type: ignore[no-untyped-def]
    """Windows of enough blocks go to the front, numbered, their matrices made whole; how many there are."""
    length, least, counted = windows.length, windows.least, windows.counted
    used, q = 0, sums.gram.shape[1]
    for w in range(sums.used.shape[0]):
        if sums.used[w] >= least:
            row_of[w] = counted + used
            sums.time_s[used] = (first + (w + 0.5) * length) / rate_hz
            sums.used[used] = sums.used[w]
            for c in range(2):
                sums.power[used, c] = sums.power[w, c]
            for a in range(q):
                for c in range(2):
                    sums.side[used, a, c] = sums.side[w, a, c]
                for b in range(a + 1):
                    sums.gram[used, a, b] = sums.gram[used, b, a] = sums.gram[w, a, b]
            used += 1
    return used


@njit(error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def _residuals(x, begin, size, first, tones, cosine, sine, left, row):  # type: ignore[no-untyped-def]
    """Residuals ``left`` (2, size) of blocks from ``begin`` on, and the columns ``row`` (2 r + 1, size) of ``rows``."""
    cycles, response, amplitudes, offsets, rows = tones[:5]
    for c in range(2):
        for i in range(size):
            left[c, i] = x[begin + i, c] - offsets[c]
    for j in range(cycles.shape[0]):
        phase = cycles[j] * (first + begin)
        start = np.exp(2j * np.pi * (phase - np.floor(phase))) * response[j]
        for c in range(2):
            z = amplitudes[c, j] * start
            a, b = z.real, z.imag
            for i in range(size):
                left[c, i] -= a * cosine[j, i] - b * sine[j, i]
        for r in range(rows.shape[0]):
            if rows[r] == j:
                a, b = start.real, start.imag
                for i in range(size):
                    row[2 * r + 1, i] = a * cosine[j, i] - b * sine[j, i]
                    row[2 * r + 2, i] = -(a * sine[j, i] + b * cosine[j, i])
    for i in range(size):
        row[0, i] = 1.0
