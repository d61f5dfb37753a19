"""Continuity volts to contact edges, each with a time and an honest uncertainty.

The rule kept here: what an edge's time is worth is measured on the edges of the recording itself. Where they show the
circuit's RC charging, the time constant is estimated (each polarity by its own) and an edge is fitted through its
samples; where they show nothing between two samples, the time is the middle of the interval, uniform over it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kernels import njit

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

BEFORE, AFTER = 12, 8  # samples of continuity kept around a crossing: crossing - BEFORE ... crossing + AFTER - 1
VISIBLE = 5.0  # standard deviations of noise from which a sample counts as moved
FAR = 1 << 30  # samples: no neighbour
AT_ONCE = 8192  # edges fitted at a time: memory stays bounded
HURRIED = 64  # samples to the edge before within which the voltage may still be on its way
ODD = 4.0  # times the usual misfit that makes an edge odd
MIN_EDGES = 8  # edges needed to estimate a time constant

CLOSED, OPENING, OPEN, DIPPING = 0, 1, 2, 3  # states of the scan
CLOSES, OPENS, DIP = -1, 1, 0  # kinds of crossing


@dataclass(frozen=True)
class Levels:
    """Levels of the continuity circuit in volts, measured where they can be, declared otherwise.

    ``noise_v`` is the standard deviation on a plateau. Behind a coupling capacitor they are those that
    `analysis.events.ac_coupling` puts back.
    """

    closed_v: float
    open_v: float
    noise_v: float

    @property
    def swing_v(self) -> float:
        """From closed to open."""
        return self.open_v - self.closed_v

    def thresholds(self) -> Floats:
        """``(low, high, dip)`` as fractions of the swing: hysteresis, and where a dip from open becomes visible."""
        noise = self.noise_v / abs(self.swing_v)
        return np.array([0.35, 0.65, max(1.0 - max(10.0 * noise, 0.02), 0.7)])


def measure_levels(volts: Floats, declared_closed_v: float, declared_open_v: float) -> Levels:
    """Levels and noise from a sample of continuity volts, ``volts`` shape (n,).

    A plateau is what follows sixteen samples (four, where there are none so long) on one side of the declared middle;
    where there is none, the declared level stands.
    """
    swing = declared_open_v - declared_closed_v
    side = (volts - declared_closed_v) / swing > 0.5
    levels, spreads = [], []
    for wanted, declared in ((False, declared_closed_v), (True, declared_open_v)):
        plateau = volts[:0]
        for before in (16, 4):
            length = before + 5  # and four more on this side
            if volts.size < length:
                continue
            inside = np.convolve(side == wanted, np.ones(length))[length - 1 :] > length - 0.5
            if plateau.size < 50:
                plateau = volts[before : before + inside.size][inside[: volts.size - before]]
        if plateau.size < 50:
            levels.append(declared)
            continue
        level = float(np.median(plateau))
        near = plateau[np.abs(plateau - level) < 0.1 * abs(swing)]
        level = float(np.median(near)) if near.size else level
        deviation = np.abs(near - level)
        spreads.append(_core_rms(deviation))
        levels.append(level if near.size > 0.5 * plateau.size else declared)
    noise = max([*spreads, 1e-6 * abs(swing)])
    return Levels(levels[0], levels[1], noise)


def _core_rms(deviation: Floats) -> float:
    """Standard deviation of normal noise from all but its largest 2 %; sees through quantisation."""
    if not deviation.size:
        return 0.0
    core = deviation[deviation <= np.quantile(deviation, 0.98)]
    return float(np.sqrt(np.mean(core**2))) / 0.9346


@dataclass(frozen=True)
class Crossings:
    """Where the continuity signal changed state, with the samples around each.

    Attributes
    ----------
    sample : int64 array, shape (n,)
        First sample past the hysteresis threshold (for a dip: its lowest sample).
    kind : int8 array, shape (n,)
        `OPENS`, `CLOSES` or `DIP` (a contact too short to reach the threshold).
    window : float32 array, shape (n, BEFORE + AFTER)
        Fraction of the swing around the crossing: 0 closed, 1 open.
    """

    sample: Ints
    kind: npt.NDArray[np.int8]
    window: npt.NDArray[np.float32]


class CrossingScan:
    """The state of the hysteresis from piece to piece; pieces are handed in as fractions of the swing."""

    def __init__(self, levels: Levels) -> None:
        self.thresholds = levels.thresholds()
        self.state = np.array([-1, 0], dtype=np.int64)  # state, sample of the lowest value of a dip
        self.lowest = np.array([2.0])
        self.started_open = False
        self._found: list[Crossings] = []

    def add(self, fraction: npt.NDArray[np.float32], first: int, pad: int, count: int) -> Crossings:
        """Scan ``fraction[pad : pad + count]``, sample ``first`` being ``fraction[pad]``; returns what was found."""
        if self.state[0] < 0 and count:
            self.started_open = bool(fraction[pad] > 0.5)
        where = np.empty(count, dtype=np.int64)
        kind = np.empty(count, dtype=np.int8)
        n = _scan(fraction[pad : pad + count], self.thresholds, self.state, self.lowest, first, where, kind)
        where, kind = where[:n].copy(), kind[:n].copy()
        index = np.clip((where - first + pad)[:, None] + np.arange(-BEFORE, AFTER), 0, fraction.size - 1)
        found = Crossings(where, kind, fraction[index])
        self._found.append(found)
        return found

    def crossings(self) -> Crossings:
        """Everything found so far, in order."""
        if not self._found:
            return Crossings(np.zeros(0, np.int64), np.zeros(0, np.int8), np.zeros((0, BEFORE + AFTER), np.float32))
        merged = Crossings(
            np.concatenate([c.sample for c in self._found]),
            np.concatenate([c.kind for c in self._found]),
            np.concatenate([c.window for c in self._found]),
        )
        self._found = [merged]
        return merged


@njit(error_model="numpy")
def _scan(x, thresholds, state, lowest, first, where, kind):  # type: ignore[no-untyped-def]
    """Hysteresis over one piece; ``state`` and ``lowest`` live on between pieces."""
    low, high, dip = thresholds
    settled = 0.5 * (1.0 + dip)
    s, s_dip = state
    least = lowest[0]
    n = 0
    for i in range(x.shape[0]):
        v = x[i]
        if s == CLOSED:
            if v > high:
                s = OPENING
                where[n], kind[n] = first + i, OPENS
                n += 1
        elif s < 0:
            s = OPENING if v > 0.5 else CLOSED
        elif v < low:
            s = CLOSED
            where[n], kind[n] = first + i, CLOSES
            n += 1
        elif s == OPENING:
            if v > settled:  # a noisy slow edge may pass the dip's threshold more than once
                s = OPEN
        elif s == OPEN:
            if v < dip:
                s, s_dip, least = DIPPING, first + i, v
        elif v < least:
            s_dip, least = first + i, v
        elif v > dip:
            s = OPEN
            where[n], kind[n] = s_dip, DIP
            n += 1
    state[0], state[1] = s, s_dip
    lowest[0] = least
    return n


@dataclass(frozen=True)
class EdgeShape:
    """How the edges of one polarity look: their time constant, and how well it describes them.

    Attributes
    ----------
    tau_s : float
        RC time constant; 0 where the edges are sharp (nothing to be seen between two samples).
    tau_uncertainty_s : float
    chi : float
        Rms of the fit's residuals in units of the plateau noise, at least 1; uncertainties are multiplied by it.
    edges : int
        Edges used.
    """

    tau_s: float
    tau_uncertainty_s: float
    chi: float
    edges: int


SHARP = EdgeShape(0.0, 0.0, 1.0, 0)


@dataclass(frozen=True)
class Edges:
    """Contact edges in time.

    Attributes
    ----------
    time_s, uncertainty_s : float arrays, shape (n,)
        On the recording's time axis; one standard deviation.
    kind : int8 array, shape (n,)
    """

    time_s: Floats
    uncertainty_s: Floats
    kind: npt.NDArray[np.int8]


def time_edges(crossings: Crossings, levels: Levels, rate_hz: float) -> tuple[Edges, EdgeShape, EdgeShape]:
    """Times of all crossings, and the shapes of opening and closing edges that gave them.

    Where an edge follows another so soon that the voltage is still on its way, what is missing is put back from the
    time of the edge before (a second round).
    """
    noise = levels.noise_v / abs(levels.swing_v)
    n = crossings.sample.size
    times, sigmas = np.empty(n), np.empty(n)
    room = np.append(np.diff(crossings.sample), FAR)  # samples until the next crossing
    gap = np.append(FAR, room[:-1])
    shapes: dict[int, EdgeShape] = {}
    index = {kind: np.flatnonzero(crossings.kind == kind) for kind in (OPENS, CLOSES)}
    for kind, own in index.items():
        alone = own[(room[own] > AFTER) & (gap[own] > AFTER)]
        if alone.size < MIN_EDGES:
            alone = own[(room[own] > 2) & (gap[own] > 2)]
        shapes[kind] = edge_shape(_towards(crossings, alone[: 2 * AT_ONCE], kind), noise, rate_hz)
    for again in (False, True):
        for kind, own in index.items():
            todo = own[gap[own] < HURRIED] if again else own
            for part in np.array_split(todo, todo.size // AT_ONCE + 1):
                y = _towards(crossings, part, kind)
                if again:
                    y += _still_missing(crossings, part, times, shapes[-kind].tau_s, rate_hz)
                own_room = np.clip(room[part], 1, AFTER)
                delay, sigmas[part] = fit_edges(y, own_room, gap[part], noise, shapes[kind], rate_hz)
                times[part] = crossings.sample[part] / rate_hz + delay
    dips = crossings.kind == DIP
    times[dips] = (crossings.sample[dips] - 0.5) / rate_hz
    sigmas[dips] = 1.0 / (rate_hz * np.sqrt(12.0))
    return Edges(times, sigmas, crossings.kind), shapes[OPENS], shapes[CLOSES]


def _towards(crossings: Crossings, index: Ints, kind: int) -> Floats:
    """Samples around edges of one kind as 1 before the edge, decaying to 0, shape (n, BEFORE + AFTER)."""
    fraction: Floats = crossings.window[index].astype(np.float64)
    return fraction if kind == CLOSES else 1.0 - fraction


def _still_missing(crossings: Crossings, index: Ints, times: Floats, tau_s: float, rate_hz: float) -> Floats:
    """What the edge before each of ``index`` still lacks to its level, at every sample of the window."""
    since = (crossings.sample[index][:, None] + np.arange(-BEFORE, AFTER)) / rate_hz - times[index - 1][:, None]
    known = (since > 0) & (index > 0)[:, None] & (tau_s > 0.0)
    return np.where(known, np.exp(-np.maximum(since, 0.0) / max(tau_s, 1e-12)), 0.0)


def _first_moved(y: Floats, noise: float, gap: Ints | int = FAR) -> Ints:
    """Column of the first sample visibly moved: backwards from the crossing, not past the one before."""
    first = np.full(y.shape[0], BEFORE)
    active = np.ones(y.shape[0], dtype=np.bool_)
    for column in range(BEFORE - 1, 0, -1):
        active &= (y[:, column] < 1.0 - VISIBLE * noise) & (column > BEFORE - np.asarray(gap))
        first[active] = column
    return first


def edge_shape(y: Floats, noise: float, rate_hz: float) -> EdgeShape:
    """Time constant from many edges, ``y`` shape (n, BEFORE + AFTER): 1 before, ``exp(-t / tau)`` after.

    The ratio of successive samples gives it where two samples of an edge stand out of the noise; else the mean area
    does (over edges at random moments the mean sum of the moved samples is ``tau * rate``).
    """
    n = y.shape[0]
    if n < MIN_EDGES:
        return SHARP
    first = _first_moved(y, noise)
    samples = np.take_along_axis(y, np.minimum(first[:, None] + np.arange(3), y.shape[1] - 1), axis=1)
    loud = samples[:, 0] > max(40.0 * noise, 0.05)
    ratio, ratio_sigma = 0.0, np.inf
    if loud.sum() >= MIN_EDGES:
        ratios = samples[loud, 1] / samples[loud, 0]  # the median is not led astray by edges that bounce
        ratio = float(np.median(ratios))
        own = noise * np.sqrt(1.0 + ratio**2) / samples[loud, 0]
        alike = np.abs(ratios - ratio) < 5.0 * own
        if alike.sum() >= MIN_EDGES:
            ratio = float(np.average(ratios[alike], weights=own[alike] ** -2))
            ratio_sigma = 1.0 / float(np.sqrt(np.sum(1.0 / own[alike] ** 2)))
    if 8.0 * ratio_sigma < ratio < 0.98 and ratio > 0.01:
        tau = -1.0 / (rate_hz * np.log(ratio))
        tau_sigma = tau**2 * rate_hz * ratio_sigma / ratio
    else:
        area = samples.sum(axis=1) / (1.0 - VISIBLE * noise)  # what has moved too little to be seen is missing in it
        tau, tau_sigma = float(area.mean()) / rate_hz, float(area.std()) / rate_hz / np.sqrt(n)
        if float(np.mean(samples[:, 0] > VISIBLE * noise)) < 0.05 or tau * rate_hz < 3.0 * noise:
            return EdgeShape(0.0, 0.0, 1.0, n)
    misfit = _misfit(samples, noise, tau, rate_hz)
    # two degrees of freedom: the median of their chi square is 1.386
    chi = float(np.sqrt(np.median(misfit**2) * 2.0 / 1.386))
    return EdgeShape(tau, tau_sigma, max(1.0, chi), n)


def _misfit(samples: Floats, noise: float, tau_s: float, rate_hz: float) -> Floats:
    """Rms residual of an exponential through the first samples of each edge, in units of the noise, shape (n,)."""
    w = np.exp(-np.arange(samples.shape[1]) / (tau_s * rate_hz))
    residual = samples - np.outer(samples @ w / (w @ w), w)
    return np.asarray(np.sqrt((residual**2).sum(axis=1) / (samples.shape[1] - 1)) / noise)


def fit_edges(
    y: Floats, room: Ints, gap: Ints, noise: float, shape: EdgeShape, rate_hz: float
) -> tuple[Floats, Floats]:
    """Delay of each edge relative to its crossing sample, and its uncertainty, seconds, shapes (n,).

    Parameters
    ----------
    y : array, shape (n, BEFORE + AFTER)
        1 before the edge, decaying to 0.
    room : int array, shape (n,)
        Samples from the crossing on that belong to this edge (the next crossing ends it).
    gap : int array, shape (n,)
        Samples since the crossing before.
    noise : float
        Standard deviation of ``y``.
    shape : EdgeShape
    rate_hz : float
    """
    dt = 1.0 / rate_hz
    first = _first_moved(y, noise, gap)
    columns = np.arange(y.shape[1])
    middle = np.asarray((first - 0.5 - BEFORE) * dt, dtype=np.float64)
    uniform: Floats = np.full(y.shape[0], dt / np.sqrt(12.0))
    if shape.tau_s == 0.0 or y.shape[0] == 0:
        return middle, uniform
    samples = np.take_along_axis(y, np.minimum(first[:, None] + np.arange(3), y.shape[1] - 1), axis=1)
    own = _misfit(samples, noise, shape.tau_s, rate_hz)
    own[(own < ODD * shape.chi) | (room < 3)] = 0.0
    sigma_y = noise * np.maximum(shape.chi, own)  # an edge that does not look like the others is worth less
    last = BEFORE + np.maximum(room - 2, 0)
    use = (columns >= first[:, None]) & (columns <= np.maximum(last, first)[:, None])
    w = np.where(use, np.exp(-(columns - first[:, None]) * dt / shape.tau_s), 0.0)
    power = (w**2).sum(axis=1)
    # u = exp(-d / tau), d from the edge to the first moved sample
    u, sigma_u = (y * w).sum(axis=1) / power, sigma_y / np.sqrt(power)
    clear = u > 6.0 * sigma_u
    since = -shape.tau_s * np.log(np.where(clear, u, 1.0))
    sigma = np.where(clear, shape.tau_s * sigma_u / np.where(clear, u, 1.0), np.inf)
    # the time constant's own error moves every edge by the same share of its delay
    sigma = np.hypot(sigma, np.abs(since) * shape.tau_uncertainty_s / shape.tau_s)
    vague = ~clear | (sigma > dt / 12.0)
    since[vague], sigma[vague] = _vague(u[vague], sigma_u[vague], shape, dt)
    delay: Floats = (first - BEFORE) * dt - since
    return delay, np.minimum(sigma, uniform)


def _vague(u: Floats, sigma_u: Floats, shape: EdgeShape, dt: float) -> tuple[Floats, Floats]:
    """Delay of edges that the samples hardly show, with the time constant as uncertain as it is."""
    taus = shape.tau_s + np.array([-1.0, 0.0, 1.0]) * min(shape.tau_uncertainty_s, 0.9 * shape.tau_s)
    parts = [_posterior(u, sigma_u, float(tau), dt) for tau in taus]
    mean: Floats = np.mean([m for m, _ in parts], axis=0)
    variance: Floats = np.mean([(m - mean) ** 2 + s**2 for m, s in parts], axis=0)
    return mean, np.sqrt(variance)


def _posterior(u: Floats, sigma_u: Floats, tau_s: float, dt: float) -> tuple[Floats, Floats]:
    """Mean and standard deviation of the delay, uniform over one sample before ``u`` was seen."""
    d: Floats = (np.arange(200) + 0.5) / 200 * dt
    misfit = (u[:, None] - np.exp(-d / tau_s)) / sigma_u[:, None]
    weight = np.exp(-0.5 * (misfit**2 - (misfit**2).min(axis=1, keepdims=True)))
    weight /= weight.sum(axis=1, keepdims=True)
    mean = weight @ d
    return mean, np.sqrt(np.maximum(weight @ d**2 - mean**2, (dt / 400) ** 2))
