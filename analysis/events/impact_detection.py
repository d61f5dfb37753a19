"""Landings in the accelerometer, which detects contacts too short for the contact circuit.

A matched filter finds the impacts, the loudest of those near each other first. Each is timed by sliding the finely
sampled template over it, and taken away before the next is sought. Decision 473.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from analysis.events.impact_template import FINE, LEAD, LENGTH, ImpactTemplate
from analysis.signals import block_means, first_beyond
from analysis.statistics import nearest
from daq.recording import Recording
from kernels import njit
from kernels.arrays import Bools, Floats, Integers

Volts = npt.NDArray[np.float32]

TILE = 256  # outputs of the filter computed together
TAPS = 8  # of the filter, applied in one pass over a tile; the filter's length is a multiple of it
APART = LEAD // 2  # samples between two candidates, at least: less than a period of the ringing
SHIFTS = 2 * FINE  # search range around a candidate, in fine points
ECHO_MARGIN = 0.2  # part of an earlier impact's ringing that the template may get wrong, at least
BEGINNING = 2 * LEAD  # samples of a snippet in which no later impact can be
ONSET_S = 2e-6  # uncertainty of the template's onset
FORERUNNER = 1e-3  # part of an impact that a converter's filter may ring before the template begins
SEAM_S = 2.5e-3  # reach of the filter about a loss of samples
RECENT = 16  # impacts before a piece whose ringing may reach into it

PLACE, SIZE, SCORE, ECHO, MARGIN = range(5)
"""Columns of the table of impacts found: place in samples, size in units of the template, score and earlier impacts'
ringing in standard deviations of the noise, and the part of this one's ringing that the template may get wrong."""


@dataclass(frozen=True)
class Impacts:
    """Landings detected by the accelerometer."""

    # time axis of the accelerometer before `analysis.events.sensor_offset.calibrate`, of the contact edges after it,
    # (n,)
    time_s: Floats
    uncertainty_s: Floats  # one standard deviation, (n,)
    strength: Floats  # output of the matched filter in units of its noise: proportional to the impact speed, (n,)
    onset_s: float = ONSET_S  # uncertainty of the template's onset, where no edge confirms it
    # part of the uncertainty that comes from a rounding to samples, as that of contact edges; 0 for none
    rounding_s: float = 0.0

    def away_from_seams(self, recording: Recording) -> Impacts:
        """Those that are not within `SEAM_S` of a loss of samples, where the motion jumps, nor of an end."""
        if not self.time_s.size:
            return self
        # beyond an end the filter meets the last value repeated: the motion has a corner there
        seams_s = np.concatenate([[0], recording.gaps[:, 0], [recording.n_samples]]) / recording.rate_hz
        return self._among(np.abs(seams_s[nearest(seams_s, self.time_s)] - self.time_s) > SEAM_S)

    def strong_in(self, spans_s: Floats) -> Impacts:
        """Those outside intervals (k, 2) in which motion is cut off, and the strong ones within: corners are weak."""
        if not len(spans_s) or not self.time_s.size:
            return self
        within = np.any((spans_s[:, :1] <= self.time_s) & (self.time_s < spans_s[:, 1:]), axis=0)
        return self._among(~within | (self.strength > 0.5 * np.median(self.strength)))

    def _among(self, chosen: Bools) -> Impacts:
        return replace(self, **{k: getattr(self, k)[chosen] for k in ("time_s", "uncertainty_s", "strength")})


NO_IMPACTS = Impacts(np.zeros(0), np.zeros(0), np.zeros(0))


class _Bank(NamedTuple):
    """A template for the kernels: what the filter gives about an impact of size 1, from `LENGTH` samples before it on,
    `FINE` points a sample; the template; its shifts, white and of norm 1, (`LENGTH`, r); their norms; the whitener."""

    response: Floats
    fine: Floats
    columns: Floats
    norms: Floats
    white: Floats


class ImpactScan:
    """Impacts in successive pieces: maxima of the matched filter, each timed by sliding the fine template over it.

    The ringing of others is subtracted first; a candidate that is small in comparison is dropped, unless ``every`` one
    above the noise is to be found, as in what a subtraction of the sure ones leaves. Uncertainties are those of the fit
    in the noise as measured. All works on means over ``template.width`` samples.
    """

    def __init__(self, template: ImpactTemplate, rate_hz: float, *, every: bool = False) -> None:
        self.template, self.rate_hz, self.every = template, rate_hz, every  # of the recording
        shifts = np.arange(-SHIFTS, SHIFTS + 1)
        points = np.clip(np.arange(LENGTH) * FINE - shifts[:, None], 0, len(template.fine) - 1)
        bank = template.fine[points] @ template.whitener.T
        norms = np.maximum(np.linalg.norm(bank, axis=1), 1e-300)
        bank = bank / norms[:, None]
        slope = np.gradient(bank, axis=0) * FINE
        self._steep = np.maximum(np.linalg.norm(slope, axis=1), 1e-9)
        spread = np.zeros((LENGTH, FINE))
        spread[:, 0] = template.taps[::-1]
        self._bank = _Bank(
            response=np.append(np.zeros(FINE), np.convolve(template.fine, spread.ravel())),
            fine=template.fine,
            columns=np.ascontiguousarray((bank @ template.whitener).T),
            norms=norms,
            white=np.ascontiguousarray(template.whitener.T),
        )
        self._found = np.zeros((0, MARGIN + 1))

    def add(self, volts: Volts, first: int, pad: int, count: int) -> Integers:
        """Scan ``volts[pad : pad + count]``, sample ``first`` of the recording being ``volts[pad]``.

        ``first`` and ``pad`` are multiples of the template's width. Returns the samples of the impacts found.
        """
        width = self.template.width
        if width > 1:
            volts, first, pad, count = block_means(volts, width), first // width, pad // width, count // width
        # those early in the next piece have echoes here
        beyond = max(min(LENGTH - LEAD, len(volts) - pad - count - LENGTH), 0)
        score = np.empty(count + beyond, np.float32)
        _match(volts, pad, self.template.taps, score)
        recent = self._found[-RECENT:]
        out = np.empty((RECENT + score.size // APART, MARGIN + 1))
        out[: len(recent)] = recent
        total = _search(
            volts, first - pad, pad, score, count, self.template.threshold, self._bank, out, len(recent), self.every
        )
        # none comes before those of the piece before: a fit moves it by two samples, and nearer ones are no impacts
        new = out[len(recent) : total].copy()
        self._found = np.concatenate([self._found, new])
        return np.rint(self._recorded(new[:, PLACE])).astype(np.int64)

    def _recorded(self, place: Floats) -> Floats:
        """Places among means as places among recorded samples."""
        return np.asarray(place * self.template.width + 0.5 * (self.template.width - 1))

    def subtract_impacts(self, volts: Volts, first: int, pad: int) -> None:
        """Subtract the templates of all impacts found so far from a piece, in place."""
        width = self.template.width
        start = (first - pad) // width - len(self.template.fine) // FINE - 1
        table = self._found[np.searchsorted(self._found[:, 0], start) :].copy()
        table[:, 0] = self._recorded(table[:, 0])
        _subtract(volts, first - pad, table, self.template.fine, width)

    @property
    def sizes(self) -> Floats:
        """Of all impacts so far, in units of the template."""
        return np.asarray(self._found[:, SIZE])

    def impacts(self) -> Impacts:
        """All impacts so far."""
        place, score, echo = self._found[:, [PLACE, SCORE, ECHO]].T
        # earlier ringing is wrong by a tenth of itself, the template's own shape by 0.4 % of the score
        error = np.sqrt(1.0 + (0.1 * echo) ** 2 + (0.004 * score) ** 2)
        sample_s = self.template.width / self.rate_hz
        sigma = error / np.maximum(score, 1.0) / self._steep[SHIFTS] * sample_s
        # means over several samples blur the onset by 0.15 of one
        onset_s = float(np.hypot(ONSET_S, 0.15 * sample_s * (self.template.width > 1)))
        time_s = self._recorded(place) / self.rate_hz
        return Impacts(time_s, np.minimum(sigma, sample_s), score, onset_s)


@njit(error_model="numpy", fastmath=True)
def _match(x, pad, taps, out):  # type: ignore[no-untyped-def]
    """Matched filter over ``x`` from ``pad`` on, ``out`` (n,)."""
    length, count = taps.shape[0], out.shape[0]
    for start in range(0, count, TILE):
        stop = min(start + TILE, count)
        total = out[start:stop]
        total[:] = np.float32(0.0)
        begin, n = start + pad - LEAD, stop - start
        for k in range(0, length, TAPS):
            t0, t1, t2, t3 = taps[k], taps[k + 1], taps[k + 2], taps[k + 3]
            t4, t5, t6, t7 = taps[k + 4], taps[k + 5], taps[k + 6], taps[k + 7]
            own = x[begin + k : begin + k + n + TAPS - 1]
            for i in range(n):
                first = t0 * own[i] + t1 * own[i + 1] + t2 * own[i + 2] + t3 * own[i + 3]
                total[i] += first + t4 * own[i + 4] + t5 * own[i + 5] + t6 * own[i + 6] + t7 * own[i + 7]


@njit(error_model="numpy")
def _echo(lag, size, fine, out):  # type: ignore[no-untyped-def]
    """Add the template, begun ``lag`` samples before the snippet, to the snippet ``out``."""
    first = int(np.floor(lag * FINE))
    share = lag * FINE - first  # the same for all samples, which are a whole number of points from each other
    before, after = size * (1.0 - share), size * share
    begin = max((FINE - 1 - first) // FINE, 0)
    end = min((fine.shape[0] - 2 - first) // FINE + 1, out.shape[0])
    for k in range(begin, end):
        j = first + k * FINE
        out[k] += before * fine[j] + after * fine[j + 1]


@njit(error_model="numpy", fastmath={"contract", "nsz"})
def _products(columns, x, out):  # type: ignore[no-untyped-def]
    """Scalar products of ``x`` (n,) and each column of ``columns`` (n, r), summed along memory, four rows in a pass."""
    out[:] = 0.0
    for i in range(0, columns.shape[0], 4):
        row0, row1, row2, row3 = columns[i], columns[i + 1], columns[i + 2], columns[i + 3]
        x0, x1, x2, x3 = x[i], x[i + 1], x[i + 2], x[i + 3]
        for r in range(out.shape[0]):
            total = out[r] + row0[r] * x0
            total += row1[r] * x1
            total += row2[r] * x2
            out[r] = total + row3[r] * x3


@njit(error_model="numpy")
def _size(white, x, room):  # type: ignore[no-untyped-def]
    """Norm of ``x`` (`LENGTH`,) in standard deviations of the noise; ``room`` (`LENGTH`,) holds it whitened."""
    _products(white, x, room)
    return np.sqrt(np.sum(room**2))


@njit(error_model="numpy")
def _ringing(table, skip, at, fine, out, doubt):  # type: ignore[no-untyped-def]
    """Put the ringing of the impacts of ``table`` (n, `MARGIN` + 1), in order of time, but for row ``skip``, into a
    snippet ``out`` (`LENGTH`,) that is filtered at place ``at``, and the part of it that may be wrong into ``doubt``;
    the latest of them before the snippet's own, or -1."""
    out[:] = 0.0
    doubt[:] = 0.0
    last = -1
    for row in range(table.shape[0] - 1, -1, -1):
        lag = at - table[row, PLACE]
        if lag > fine.shape[0] // FINE:
            break
        if row == skip or lag < -LENGTH:
            continue
        if last < 0 and lag >= 0.0:
            last = row
        _echo(lag, table[row, SIZE], fine, out)
        _echo(lag, table[row, SIZE] * table[row, MARGIN], fine, doubt)
    return last


@njit(error_model="numpy")
def _fit(own, index, bank, room, row):  # type: ignore[no-untyped-def]
    """Put place, size, score and margin of the impact in a snippet ``own`` (`LENGTH`,) filtered at ``index`` into
    ``row``; ``room`` (2, `LENGTH`) is overwritten."""
    shifts = bank.columns.shape[1]
    score = np.empty(shifts)
    _products(bank.columns, own, score)
    best = min(max(int(np.argmax(score)), 1), shifts - 2)
    before, middle, after = score[best - 1], score[best], score[best + 1]
    curvature = min(before - 2.0 * middle + after, -1e-300)
    vertex = min(max(0.5 * (before - after) / curvature, -1.0), 1.0)
    row[PLACE], row[SIZE], row[SCORE] = index + (best - SHIFTS + vertex) / FINE, middle / bank.norms[best], middle
    rest = room[0]
    rest[:] = own
    _echo((SHIFTS - best) / FINE, -row[SIZE], bank.fine, rest)
    left = room[1, :BEGINNING]
    _products(bank.white, rest, left)
    misfit = np.sqrt(max(np.sum(left**2) - BEGINNING, 0.0))
    # three times over: a sensor at its end shows only a part of what the template missed
    row[MARGIN] = max(ECHO_MARGIN, 3.0 * misfit / max(middle, 1e-300))


@njit(error_model="numpy")
def _search(x, offset, pad, score, count, limit, bank, out, n, every):  # type: ignore[no-untyped-def]
    """Find impacts in the filter's output ``score`` from ``x[pad]`` on, the loudest of those near each other first.

    What each one adds to the output is taken away before the next is sought, so that a bounce is found in the ringing
    of the impact before, whatever its phase. ``x[0]`` is sample ``offset``. The first ``n`` rows of ``out`` are
    impacts before; the number of rows filled is returned. Those after ``count`` outputs belong to the next piece.
    """
    own, echo, doubt, room = np.empty(LENGTH), np.empty(LENGTH), np.empty(LENGTH), np.empty((2, LENGTH))
    row, longest, before = np.empty(out.shape[1]), bank.fine.shape[0] // FINE, n
    for k in range(n):  # what rings into the piece from before it hides no bounce at its beginning
        _take_away(score, out[k, PLACE] - offset - pad, out[k, SIZE], bank.response)
    i = first_beyond(score, 0, np.float32(limit), True)
    while i < score.shape[0] and n < out.shape[0]:
        top = i
        while True:
            ahead = top + int(np.argmax(score[top : top + LENGTH + LEAD]))
            if ahead == top:
                break
            top = ahead
        if i >= count:
            break
        index = top + pad
        last = _ringing(out[:n], -1, index + offset, bank.fine, echo, doubt)
        own[:] = x[index - LEAD : index - LEAD + LENGTH]
        own -= echo
        _fit(own, index + offset, bank, room, row)
        loud = doubtful = 0.0
        if echo.any():  # mostly nothing else rings
            loud, doubtful = _size(bank.white, echo, room[0]), _size(bank.white, doubt, room[0])
        if last >= 0 and row[PLACE] - out[last, PLACE] <= 2 * longest:
            # of a ringing that outlasts the template a tenth of the score is left at most
            loud = max(loud, 0.1 * out[last, SCORE])
        row[ECHO] = loud
        place = n
        while place > 0 and out[place - 1, PLACE] > row[PLACE]:
            place -= 1
        near = place > 0 and row[PLACE] - out[place - 1, PLACE] < 0.5 * LEAD
        least = limit if every else max(limit, doubtful, ECHO_MARGIN * loud)
        if place < n and out[place, PLACE] - row[PLACE] < LENGTH + LEAD:
            near = near or out[place, PLACE] - row[PLACE] < 0.5 * LEAD
            least = max(least, FORERUNNER * out[place, SCORE])
        if near or row[SCORE] < least:
            begin, end = top, top + 1
            while begin > 0 and score[begin - 1] > limit:
                begin -= 1
            while end < score.shape[0] and score[end] > limit:
                end += 1
            score[begin:end] = np.float32(0.0)
        else:
            for k in range(n, place, -1):
                out[k] = out[k - 1]
            out[place] = row
            n += 1
            _take_away(score, row[PLACE] - offset - pad, row[SIZE], bank.response)
        i = first_beyond(score, i, np.float32(limit), True)
    return _fitted_together(x, offset, pad + count, bank, out[:n], before)


@njit(error_model="numpy")
def _take_away(score, place, size, response):  # type: ignore[no-untyped-def]
    """Subtract what an impact at output ``place`` adds to the filter's output."""
    begin = max(int(np.ceil(place)) - LENGTH + 1, 0)
    end = min(int(np.floor(place)) + response.shape[0] // FINE - LENGTH, score.shape[0])
    at = (begin - place + LENGTH) * FINE
    first = int(at)
    share = at - first  # the same for all outputs, which are a whole number of points from each other
    before, after = size * (1.0 - share), size * share
    for k in range(end - begin):
        j = np.uint64(first + k * FINE)  # unsigned: signed indices may count from the end
        score[begin + k] -= np.float32(before * response[j] + after * response[j + np.uint64(1)])


@njit(error_model="numpy")
def _fitted_together(x, offset, stop, bank, table, before):  # type: ignore[no-untyped-def]
    """Fit impacts near others anew with those taken away; the number of rows before ``x[stop]``."""
    own, echo, doubt, room = np.empty(LENGTH), np.empty(LENGTH), np.empty(LENGTH), np.empty((2, LENGTH))
    row = np.empty(table.shape[1])
    for _ in range(2):
        for k in range(before, table.shape[0]):
            single = k == 0 or table[k, PLACE] - table[k - 1, PLACE] > LENGTH
            if single and (k + 1 == table.shape[0] or table[k + 1, PLACE] - table[k, PLACE] > LENGTH):
                continue
            index = int(np.rint(table[k, PLACE])) - offset
            _ringing(table, k, index + offset, bank.fine, echo, doubt)
            own[:] = x[index - LEAD : index - LEAD + LENGTH]
            own -= echo
            _fit(own, index + offset, bank, room, row)
            if abs(row[PLACE] - table[k, PLACE]) < 1.0:
                table[k, :ECHO] = row[:ECHO]
    n = table.shape[0]
    while n > before and table[n - 1, PLACE] - offset >= stop:
        n -= 1
    return n


@njit(error_model="numpy")
def _subtract(x, offset, table, fine, width):  # type: ignore[no-untyped-def]
    """Subtract every impact's template, ``width`` samples a sample, from ``x`` (``x[0]`` is sample ``offset``)."""
    points = FINE / width
    for row in range(table.shape[0]):
        begin = int(np.ceil(table[row, 0])) - LEAD * width
        for sample in range(max(begin, offset), min(begin + fine.shape[0] // FINE * width, offset + x.shape[0])):
            position = (sample - table[row, 0]) * points + LEAD * FINE
            j = int(position)
            if position >= 0.0 and j < fine.shape[0] - 1:
                share = position - j
                x[sample - offset] -= np.float32(table[row, 1] * ((1.0 - share) * fine[j] + share * fine[j + 1]))
