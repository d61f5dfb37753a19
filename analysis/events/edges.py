"""Contact edges in time, each with an uncertainty measured on the edges of the recording itself.

Where the samples show the circuit's RC charging, its time constant is estimated for each polarity and an edge is
fitted through its samples. Where nothing shows between two samples, the time is the middle of the interval, with a
uniform distribution over it. The same holds for a comparator that is read once a sample and low-passed afterwards: its
edges look like an RC's, but all alike. An RC's own edges fall anywhere between two samples. Decision 297. So it does
for a comparator whose output runs from level to level in a straight line, and for lines that somebody drew between
the samples of a lower rate: their middle is that of the interval (decision 595).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from analysis.events.levels import CLOSES, DIP, OPENS, Crossings, Levels, Window
from analysis.statistics import mad_sigma, mean_sigma
from kernels.arrays import Floats, Integers

VISIBLE_SIGMAS = 5.0  # standard deviations of noise from which a sample counts as moved
NO_NEIGHBOUR = 1 << 30  # distance in samples where there is no neighbouring crossing
EDGES_AT_ONCE = 8192  # edges fitted together: memory stays bounded
MIN_EDGES = 8  # edges needed to estimate a time constant
CLEAR_SIGMAS = 6.0  # height of a fitted edge above its uncertainty from which its delay is linear in it
PHASE_BINS = 20  # parts of the interval between two samples in which edges are counted
POSTERIOR_POINTS = 200


@dataclass(frozen=True)
class EdgeShape:
    """Shape of the edges of one polarity: time constant, and quality of the exponential."""

    tau_s: float  # RC time constant; 0 where the edges are sharp (no sample lies between the levels)
    tau_uncertainty_s: float
    # rms of the fit's residuals in units of the plateau noise, at least 1; uncertainties are multiplied by it
    chi: float
    edges: int  # edges used
    # time between two reads of a clocked comparator before the RC; 0 for a circuit that answers at once
    clock_s: float = 0.0
    # where it is clocked, from the RC's first rise to the middle of the interval in which the comparator changed
    lag_s: float = 0.0
    straight_s: float = 0.0  # duration of edges that are straight lines over more than one sample; 0 for others

    def circuit(self, rise_s: Floats, sigma_s: Floats) -> tuple[Floats, Floats]:
        """Times and uncertainties of the contact itself from those at which the RC begins to rise."""
        return rise_s + self.lag_s, np.hypot(sigma_s, self.clock_s / np.sqrt(12.0))


SHARP = EdgeShape(0.0, 0.0, 1.0, 0)


@dataclass(frozen=True)
class Edges:
    """Contact edges in time."""

    time_s: Floats  # time axis of the recording, (n,)
    uncertainty_s: Floats  # one standard deviation, (n,)
    kind: npt.NDArray[np.int8]  # (n,)


def time_edges(crossings: Crossings, levels: Levels, rate_hz: float) -> tuple[Edges, EdgeShape, EdgeShape]:
    """Times of all crossings, and the shapes of opening and closing edges that gave them.

    An edge may follow another before the voltage has settled. In a second round the missing part is restored from the
    time of the edge before; where edges are slow, their shape is then measured anew.
    """
    noise = levels.noise_v / abs(levels.swing_v)
    # ripple beyond 1 % of the swing and five sigma of noise is that of a linear-phase filter: no RC shape fits
    if levels.ripple > max(0.01, 5.0 * noise):
        return _half_way(crossings, noise, rate_hz), SHARP, SHARP
    n, around = crossings.sample.size, crossings.around
    times, sigmas = np.full(n, -np.inf), np.empty(n)  # a dip has no time yet: nothing is unsettled after it
    rises = times.copy()
    room = np.append(np.diff(crossings.sample), NO_NEIGHBOUR)  # samples until the next crossing
    gap = np.append(NO_NEIGHBOUR, room[:-1])
    shapes = {OPENS: SHARP, CLOSES: SHARP}
    index = {kind: np.flatnonzero(crossings.kind == kind) for kind in shapes}

    def towards(some: Integers, kind: int, restored: bool) -> Floats:
        """Samples as 1 before the edge, decaying to 0, shape (n, before + after)."""
        fraction: Floats = crossings.window[some].astype(np.float64)
        own = fraction if kind == CLOSES else 1.0 - fraction
        return own + _unsettled(crossings, some, rises, shapes[-kind].tau_s, rate_hz) if restored else own

    for again in (False, True):
        anew = not again or around.stretch > 1
        if anew:
            isolated = {kind: _isolated(own, room, gap, around)[: 2 * EDGES_AT_ONCE] for kind, own in index.items()}
            seen = {kind: towards(some, kind, again) for kind, some in isolated.items()}
            shapes = {kind: edge_shape(y, noise, rate_hz, around) for kind, y in seen.items()}
            # of the swing: no RC (chatter bends closings alone), but lines drawn between the samples of one
            if min(shape.chi for shape in shapes.values()) * noise > 0.05:
                lines = {kind: float(np.median(1.0 / _at_half(y, around.before)[1])) for kind, y in seen.items()}
                shapes = {kind: EdgeShape(0.0, 0.0, 1.0, 0, straight_s=line / rate_hz) for kind, line in lines.items()}
        for kind, own in index.items():
            # after 64 samples (times the stretch) the voltage of the edge before has settled: its time stands
            todo = own if anew else own[gap[own] < 64 * around.stretch]
            for part in np.array_split(todo, todo.size // EDGES_AT_ONCE + 1):
                own_room = np.clip(room[part], 1, around.after)
                y = towards(part, kind, again)
                delay, sigmas[part] = fit_edges(y, own_room, gap[part], noise, shapes[kind], rate_hz, around)
                times[part] = crossings.sample[part] / rate_hz + delay
                rises[part] = times[part] - shapes[kind].lag_s
    dips = crossings.kind == DIP
    times[dips] = (crossings.sample[dips] - 0.5) / rate_hz
    sigmas[dips] = 1.0 / (rate_hz * np.sqrt(12.0))
    return Edges(times, sigmas, crossings.kind), shapes[OPENS], shapes[CLOSES]


def _half_way(crossings: Crossings, noise: float, rate_hz: float) -> Edges:
    """Edges behind a linear-phase filter: it delays all frequencies alike, so an edge is where half of the swing is."""
    falling = np.where((crossings.kind == CLOSES)[:, None], crossings.window, 1.0 - crossings.window)
    place, slope = _at_half(falling, crossings.around.before)
    times = np.where(crossings.kind == DIP, crossings.sample - 0.5, crossings.sample + place) / rate_hz
    # a straight line between two samples errs by a tenth of a sample at half of the swing
    sigma = np.hypot(noise / slope, 0.1) / rate_hz
    sigma[crossings.kind == DIP] = 1.0 / (rate_hz * np.sqrt(12.0))
    return Edges(np.maximum.accumulate(times), sigma, crossings.kind)


def _at_half(y: Floats, before: int) -> tuple[Floats, Floats]:
    """Where edges are at half of the swing, in samples from the crossing, and their slope there, a sample, (n,)."""
    rows = np.arange(y.shape[0])
    above = before - np.argmax(y[:, before::-1] > 0.5, axis=1)  # the last sample on the side that is left
    after = np.minimum(above + 1, before)
    slope = np.maximum(y[rows, above] - y[rows, after], 1e-3)
    return above - before + np.clip((y[rows, above] - 0.5) / slope, 0.0, 1.0), slope


def _straight_samples(y: Floats, noise: float) -> float:
    """Length of edges that are straight lines over more than one sample; 0 where they are none."""
    between = (y > VISIBLE_SIGMAS * noise) & (y < 1.0 - VISIBLE_SIGMAS * noise)
    both = between[:, :-1] & between[:, 1:]
    fall, height = (y[:, :-1] - y[:, 1:])[both], 0.5 * (y[:, :-1] + y[:, 1:])[both]
    if fall.size < MIN_EDGES:
        return 0.0
    usual = float(np.median(fall))
    # an RC's edge falls by as much as it still has to go: its falls go with the height
    scatter, as_rc = mad_sigma(fall - usual), mad_sigma(fall / height - np.median(fall / height)) * np.median(height)
    return 1.0 / usual if usual > 0.0 and scatter < min(3.0 * noise + 0.01 * usual, 0.5 * as_rc) else 0.0


def _isolated(index: Integers, room: Integers, gap: Integers, around: Window) -> Integers:
    """Edges of ``index`` far from others."""
    isolated = index[(room[index] > around.after) & (gap[index] > around.after)]
    near = 2 * around.stretch
    return isolated if isolated.size >= MIN_EDGES else index[(room[index] > near) & (gap[index] > near)]


def _unsettled(crossings: Crossings, index: Integers, rises: Floats, tau_s: float, rate_hz: float) -> Floats:
    """Distance to the level that the edge before each of ``index`` has not yet covered, at every sample."""
    around = np.arange(-crossings.around.before, crossings.around.after)
    since = (crossings.sample[index][:, None] + around) / rate_hz - rises[index - 1][:, None]
    known = (since > 0) & (index > 0)[:, None] & (tau_s > 0.0)
    return np.where(known, np.exp(-np.maximum(since, 0.0) / max(tau_s, 1e-12)), 0.0)


def _first_moved(y: Floats, noise: float, before: int, gap: Integers | int = NO_NEIGHBOUR) -> Integers:
    """Column of the first sample visibly moved: backwards from the crossing, not past the one before."""
    first = np.full(y.shape[0], before)
    active = np.ones(y.shape[0], dtype=np.bool_)
    for column in range(before - 1, 0, -1):
        active &= (y[:, column] < 1.0 - VISIBLE_SIGMAS * noise) & (column > before - np.asarray(gap))
        first[active] = column
    return first


def edge_shape(y: Floats, noise: float, rate_hz: float, around: Window) -> EdgeShape:
    """Time constant from many edges, ``y`` shape (n, before + after): 1 before, ``exp(-t / tau)`` after.

    It follows from the ratio of samples at a distance of one stretch where two samples of an edge exceed the noise,
    else from edges at random moments: the mean sum of their moved samples is ``tau * rate``, and so many more show one
    as the noise lies deeper. Edges of a locked motion come at few moments,
    and say as much as those: a short time constant that they do not tell counts as none. Decision 770.
    """
    n, stretch_hz = y.shape[0], rate_hz / around.stretch
    if n < MIN_EDGES:
        return SHARP
    if line := _straight_samples(y, noise):
        return EdgeShape(0.0, 0.0, 1.0, n, straight_s=line / rate_hz)
    whole = _from_first(y, _first_moved(y, noise, around.before), around)
    samples = whole[:, :: around.stretch]
    # only from a first sample of 40 sigma, and of 5 % of the swing, does the next one show the decay
    loud = samples[:, 0] > max(40.0 * noise, 0.05)
    ratio, ratio_sigma = 0.0, np.inf
    if loud.sum() >= MIN_EDGES:
        ratios = samples[loud, 1] / samples[loud, 0]  # the median is robust against edges that bounce
        ratio = float(np.median(ratios))
        own = noise * np.sqrt(1.0 + ratio**2) / samples[loud, 0]
        # edges that bounce lie beyond five sigma of the median ratio
        alike = np.abs(ratios - ratio) < 5.0 * own
        if alike.sum() >= MIN_EDGES:
            ratio = float(np.average(ratios[alike], weights=own[alike] ** -2))
            ratio_sigma = 1.0 / float(np.sqrt(np.sum(1.0 / own[alike] ** 2)))
    if 8.0 * ratio_sigma < ratio < 0.98 and ratio > 0.01:
        tau = -1.0 / (stretch_hz * np.log(ratio))
        tau_sigma = tau**2 * stretch_hz * ratio_sigma / ratio
    else:
        area = samples.sum(axis=1) / (1.0 - VISIBLE_SIGMAS * noise)  # samples below the noise are missing in it
        tau, tau_sigma = float(area.mean()) / stretch_hz, mean_sigma(area) / stretch_hz
        shows = samples[:, 0] > VISIBLE_SIGMAS * noise
        seen, seen_sigma = float(np.mean(shows)), mean_sigma(shows.astype(np.float64))
        # an RC of this area has a tail that more edges would show; a voltage that falls in a straight line has none
        tail = float(np.log(1.0 / (VISIBLE_SIGMAS * max(noise, 1e-6))))
        shown = float(np.clip(tau * stretch_hz * tail, 0.0, 1.0))
        straight = seen < 0.7 * shown - 3.0 * max(np.sqrt(shown / n), seen_sigma)
        if seen < 0.05 or tau * rate_hz < 3.0 * noise or straight:
            return EdgeShape(0.0, 0.0, 1.0, n)
        # heights spread more than edges that show: of a short RC their part says it better
        if seen < 0.7 and seen_sigma * tau < tau_sigma * seen:
            tau, tau_sigma = seen / (stretch_hz * tail), seen_sigma / (stretch_hz * tail)
        # known no better it would move all edges of a step together, and says little that samples do not
        if tau_sigma > 0.2 * tau:
            return EdgeShape(0.0, 0.0, 1.0, n)
    reads, place = _clocked(whole, noise, tau * rate_hz)
    misfit = _misfit(samples, noise, tau * stretch_hz)
    # 1.386 is the median of chi square with two degrees of freedom
    chi = float(np.sqrt(np.median(misfit**2) * 2.0 / 1.386))
    clock_s = 1.0 / (reads * rate_hz) if reads else 0.0
    return EdgeShape(tau, tau_sigma, max(1.0, chi), n, clock_s, (place - 0.5) * clock_s)


def _from_first(y: Floats, first: Integers, around: Window) -> Floats:
    """Samples of each edge from its first moved one on: three, a stretch between two, and all between."""
    columns = first[:, None] + np.arange(2 * around.stretch + 1)
    return np.asarray(np.take_along_axis(y, np.minimum(columns, y.shape[1] - 1), axis=1))


def _clocked(samples: Floats, noise: float, tau_samples: float) -> tuple[int, float]:
    """Reads of a clocked comparator in a sample, and where the RC begins to rise, in (0, 1] of a read before a sample.

    An RC's own edges fall anywhere between two samples (0 reads), a clocked comparator's at equally spaced places.
    """
    w = np.exp(-np.arange(samples.shape[1]) / tau_samples)
    height, noise = samples @ w / (w @ w), noise / float(np.sqrt(w @ w))
    clear = height > max(CLEAR_SIGMAS, PHASE_BINS * tau_samples) * noise  # known to a bin
    if clear.sum() < MIN_EDGES:
        return 0, 0.0
    places = -tau_samples * np.log(height[clear])
    # a comparator may be read up to three times a sample
    for reads in (1, 2, 3):
        counts = np.bincount((PHASE_BINS * reads * places).astype(np.int64) % PHASE_BINS, minlength=PHASE_BINS)
        # edges of an RC would fill two neighbouring bins of the twenty with a tenth; a clocked comparator puts nearly
        # all there
        if float((counts + np.roll(counts, 1)).max()) > 0.85 * height.size:  # a place may lie on a bound
            turn = float(np.angle(np.exp(2j * np.pi * reads * places).sum())) / (2.0 * np.pi) % 1.0
            return reads, turn if turn > 1.0 / PHASE_BINS else turn + 1.0
    return 0, 0.0


def _misfit(samples: Floats, noise: float, tau_samples: float) -> Floats:
    """Rms residual of an exponential through the first samples of each edge, in units of the noise, shape (n,)."""
    w = np.exp(-np.arange(samples.shape[1]) / tau_samples)
    residual = samples - np.outer(samples @ w / (w @ w), w)
    return np.asarray(np.sqrt((residual**2).sum(axis=1) / (samples.shape[1] - 1)) / noise)


def fit_edges(
    y: Floats, room: Integers, gap: Integers, noise: float, shape: EdgeShape, rate_hz: float, around: Window
) -> tuple[Floats, Floats]:
    """Delay of each edge relative to its crossing sample, and its uncertainty, seconds, shapes (n,).

    Parameters
    ----------
    y : array, shape (n, before + after)
        1 before the edge, decaying to 0.
    room : int array, shape (n,)
        Samples from the crossing to the next one.
    gap : int array, shape (n,)
        Samples since the crossing before.
    noise : float
        Standard deviation of ``y``.
    shape : EdgeShape
    rate_hz : float
    around : Window
        Of the columns of ``y``.
    """
    dt, before, stretch = 1.0 / rate_hz, around.before, around.stretch
    if shape.straight_s > 0.0:
        place, slope = _at_half(y, before)
        return place * dt, np.hypot(noise / slope * dt, shape.straight_s / np.sqrt(12.0))
    first = _first_moved(y, noise, before, gap)
    columns = np.arange(y.shape[1])
    middle = np.asarray((first - 0.5 - before) * dt, dtype=np.float64)
    uniform: Floats = np.full(y.shape[0], stretch * dt / np.sqrt(12.0))
    if shape.tau_s == 0.0 or y.shape[0] == 0:
        return middle, uniform
    samples = _from_first(y, first, around)[:, ::stretch]
    own = _misfit(samples, noise, shape.tau_s * (rate_hz / stretch))
    # a misfit below four times the usual is chance; where the next crossing follows at once the samples are its own
    own[(own < 4.0 * shape.chi) | (room <= 2 * stretch)] = 0.0
    sigma_y = noise * np.maximum(shape.chi, own)  # an edge of another shape is less certain
    last = before + np.maximum(room - 2 * stretch, 0)
    use = (columns >= first[:, None]) & (columns <= np.maximum(last, first)[:, None])
    decay = np.exp(-columns * dt / shape.tau_s)  # of the samples from the first moved one on
    w = np.where(use, decay[np.maximum(columns - first[:, None], 0)], 0.0)
    power = (w**2).sum(axis=1)
    # u = exp(-d / tau), d from the edge to the first moved sample
    u, sigma_u = (y * w).sum(axis=1) / power, sigma_y / np.sqrt(power)
    clear = u > CLEAR_SIGMAS * sigma_u
    since = -shape.tau_s * np.log(np.where(clear, u, 1.0))
    sigma = np.where(clear, shape.tau_s * sigma_u / np.where(clear, u, 1.0), np.inf)
    # the time constant's own error moves every edge by the same share of its delay
    sigma = np.hypot(sigma, np.abs(since) * shape.tau_uncertainty_s / shape.tau_s)
    # linear in the height only where the delay is known to a twelfth of a sample: elsewhere the posterior is integrated
    vague = ~clear | (sigma > stretch * dt / 12.0)
    since[vague], sigma[vague] = _vague(u[vague], sigma_u[vague], shape, dt)
    delay, sigma = shape.circuit((first - before) * dt - since, sigma)
    return delay, np.minimum(sigma, uniform)


def _vague(u: Floats, sigma_u: Floats, shape: EdgeShape, dt: float) -> tuple[Floats, Floats]:
    """Posterior delay of edges that the samples hardly show, averaged over the time constant's uncertainty."""
    taus = shape.tau_s + np.array([-1.0, 0.0, 1.0]) * min(shape.tau_uncertainty_s, 0.9 * shape.tau_s)
    parts = [_posterior(u, sigma_u, float(tau), dt) for tau in taus]
    mean: Floats = np.mean([m for m, _ in parts], axis=0)
    variance: Floats = np.mean([(m - mean) ** 2 + s**2 for m, s in parts], axis=0)
    return mean, np.sqrt(variance)


def _posterior(u: Floats, sigma_u: Floats, tau_s: float, dt: float) -> tuple[Floats, Floats]:
    """Mean and standard deviation of the delay, uniform over one sample before ``u`` was seen."""
    d: Floats = (np.arange(POSTERIOR_POINTS) + 0.5) / POSTERIOR_POINTS * dt
    misfit = (u[:, None] - np.exp(-d / tau_s)) / sigma_u[:, None]
    weight = np.exp(-0.5 * (misfit**2 - (misfit**2).min(axis=1, keepdims=True)))
    weight /= weight.sum(axis=1, keepdims=True)
    mean = weight @ d
    return mean, np.sqrt(np.maximum(weight @ d**2 - mean**2, (0.5 * dt / POSTERIOR_POINTS) ** 2))
