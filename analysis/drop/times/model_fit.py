"""Fit of the models of impact times, one impact ahead, and the covariance of their residuals.

An impact time has two errors. The detector's jitter moves a boundary that two flights share, so neighbouring
residuals are correlated; and every bounce has a restitution a little its own. Drops are independent. Arrays are
padded to the longest drop, so that all drops are whitened in one batch.

Drops are fitted together by generalised least squares with that covariance, whose widths come from the data (with a
prior that prevents each from vanishing); intervals are the wider of that fit's and a bootstrap's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy import optimize, stats

from analysis.drop.laws import BOUNDS, SPEED_DRAG, START, BounceModel
from analysis.drop.times.impact_chain import Bounces
from analysis.statistics import mad_sigma
from kernels.arrays import Bools, Floats, Integers

_PAD_M = 0.1  # height of a drop that pads
ENOUGH_DROPS = 4  # from which whole drops are held out, not bounces
_MOST_FOLDS = 8
_RELATIVE_STEP = 1e-4  # of a flight, for the slope of the next by it


@dataclass(frozen=True)
class Drop:
    """One drop to be fitted."""

    name: str  # the file it came from
    bounces: Bounces  # its impacts
    # (value, standard uncertainty) of the stated drop height, where it is to be used as data
    height_m: tuple[float, float] | None = None
    sound: bool = False  # whether the file is a sound
    not_read: tuple[str, ...] = ()  # what of the file was not read, with the reason (with the file's first drop)
    remarks: tuple[str, ...] = ()  # what was noticed (with the file's first drop)
    # (n,) all events of the file or table, impacts or not (with its first drop)
    events_s: Floats = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class Rows:
    """One-bounce-ahead predictions, by drop: shape (drops, longest)."""

    before_s: Floats  # flight before the bounce
    after_s: Floats  # flight after it
    edges: Integers  # (drops, longest, 3) impacts that start the flight before, part the two, and end the flight after
    valid: Bools  # which are data (the others pad, or are held out)
    from_height: Bools  # the row starts from the stated height, not from a flight
    height_m: Floats  # as stated, (drops,); NaN where not used
    height_sigma_m: Floats  # its standard deviation, (drops,)

    @property
    def count(self) -> int:
        """Number of rows that are data."""
        return int(self.valid.sum())

    @property
    def flights(self) -> Bools:
        """Rows that are data and start from a flight."""
        return self.valid & ~self.from_height

    def keep(self, mask: Bools) -> Rows:
        """Only these of the rows."""
        return replace(self, valid=self.valid & mask)


def rows_of(drops: Sequence[Drop]) -> Rows:
    """Every prediction that can be made in ``drops``."""
    with_height = [drop.height_m is not None and drop.bounces.missed[0] == 0 for drop in drops]
    shape = (len(drops), max(len(d.bounces.usable) + own for d, own in zip(drops, with_height, strict=True)))
    before, after = np.full(shape, 0.1), np.full(shape, 0.1)  # s; rows that pad a drop are of flights never made
    edges = np.zeros((*shape, 3), dtype=np.int64)
    valid, from_height = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    for d, drop in enumerate(drops):
        n, flights, first = drop.bounces.usable, drop.bounces.intervals_s, int(with_height[d])
        rows = slice(first, first + len(n))
        before[d, rows], after[d, rows], edges[d, rows] = flights[n - 1], flights[n], np.stack([n - 1, n, n + 1], 1)
        valid[d, : first + len(n)] = True
        if first:
            after[d, 0], edges[d, 0], from_height[d, 0] = flights[0], (0, 0, 1), True
    heights = np.array([drop.height_m or (np.nan, np.nan) for drop in drops])
    return Rows(before, after, edges, valid, from_height, heights[:, 0], heights[:, 1])


def predict_s(model: BounceModel, theta: Floats, rows: Rows, g_mps2: float) -> Floats:
    """Predicted duration of each flight after, shape (drops, longest)."""
    out = model.next_flight_s(theta, rows.before_s, g_mps2)
    if rows.from_height.any():
        first = model.first_flight_s(theta, np.nan_to_num(rows.height_m, nan=_PAD_M), g_mps2)
        out = np.where(rows.from_height, first[:, None], out)
    return out


class Widths(NamedTuple):
    """Standard deviations of what makes impact times irregular."""

    jitter_s: float  # of the time of an impact
    scatter: float  # of the restitution from bounce to bounce
    # of a flight's duration by a rebound speed that varies by as much at any speed (``2 dv / g``): a slow bounce has a
    # restitution less sure than a fast one
    rebound_s: float


@dataclass(frozen=True)
class Noise:
    """Covariance of the residuals.

    ``jitter_s^2 jitter + scatter^2 diag(scatter) + rebound_s^2 + diag(fixed)``: of impact times, of the restitution,
    of the rebound speed (as a change of the flight's duration, whatever the speed), of a stated height.
    """

    jitter: Floats  # (drops, longest, longest)
    scatter: Floats  # (drops, longest), variance
    fixed: Floats
    valid: Bools

    def lower(self, widths: Widths) -> Floats:
        """Batched Cholesky factor; rows that are not data have variance 1 and no correlation."""
        both = self.valid[:, :, None] & self.valid[:, None, :]
        own = widths.scatter**2 * self.scatter + widths.rebound_s**2 + self.fixed
        total = np.where(both, widths.jitter_s**2 * self.jitter, 0.0)
        total = total + np.eye(total.shape[1]) * np.where(self.valid, own, 1.0)[:, :, None]
        return np.asarray(np.linalg.cholesky(total), dtype=np.float64)


def noise_of(model: BounceModel, theta: Floats, rows: Rows, g_mps2: float) -> Noise:
    """Parts of the covariance at ``theta``."""
    up = model.next_flight_s(theta, rows.before_s * (1 + _RELATIVE_STEP), g_mps2)
    down = model.next_flight_s(theta, rows.before_s * (1 - _RELATIVE_STEP), g_mps2)
    slope = np.where(rows.from_height, 0.0, (up - down) / (2 * _RELATIVE_STEP * rows.before_s))
    n_drops, longest = rows.before_s.shape
    to_edges = np.zeros((n_drops, longest, int(rows.edges.max(initial=0)) + 1))
    d, r = np.indices((n_drops, longest))
    for column, by_edge in enumerate((slope, -1.0 - slope, np.ones_like(slope))):
        np.add.at(to_edges, (d, r, rows.edges[:, :, column]), by_edge)
    spread = (predict_s(model, theta, rows, g_mps2) / max(float(theta[0]), 0.05)) ** 2
    fixed = np.zeros_like(spread)
    if rows.from_height.any():
        high = model.first_flight_s(theta, np.nan_to_num(rows.height_m + rows.height_sigma_m, nan=_PAD_M), g_mps2)
        mid = model.first_flight_s(theta, np.nan_to_num(rows.height_m, nan=_PAD_M), g_mps2)
        fixed = np.where(rows.from_height, ((high - mid) ** 2)[:, None], 0.0)
    return Noise(to_edges @ to_edges.transpose(0, 2, 1), spread, fixed, rows.valid)


_SMALLEST = Widths(1e-7, 1e-6, 1e-7)
_LARGEST = Widths(0.05, 0.5, 0.05)
_START = Widths(2e-4, 0.01, 1e-4)
_USUAL_WIDTHS = Widths(2e-4, 5e-3, 1e-4)  # of a phone or a camera, and of balls on floors
_NUDGE = 1e-5  # of a parameter, for derivatives


@dataclass(frozen=True)
class Fit:
    """A candidate fitted."""

    model: BounceModel
    theta: Floats  # parameters in the model's order, (p,)
    covariance: Floats  # (p, p)
    widths: Widths  # estimated standard deviations
    residuals_s: Floats  # (drops, longest) measured less predicted duration; NaN where there is no data
    white: Floats  # (rows,) the same, whitened
    draws: Floats  # (m, p) bootstrap over drops, or over flights where there are few drops
    freedom: int  # rows less parameters

    def half_width(self) -> Floats:
        """Half the 95 % interval of each parameter: the wider of the fit's and the bootstrap's."""
        t = float(stats.t.ppf(0.975, max(self.freedom, 1)))
        return np.asarray(t * np.maximum(np.sqrt(np.diag(self.covariance)), self.draws.std(axis=0)))


def usable_rows(drops: Sequence[Drop], g_mps2: float) -> tuple[Rows, Integers]:
    """The rows to fit, and how many bounces of each drop were left out.

    A bounce is left out where not even the richest candidate comes near it, judged by the spread of all the others.
    """
    rows = rows_of(drops)
    used = rows.keep(~rows.from_height)
    # before anything is fitted no bounce within 6 % of a flight's duration is left out
    for least in (0.06, 0.0, 0.0):
        theta = _start(SPEED_DRAG, used)
        if not least:  # the first time without a fit: one gross bounce would bend it
            theta = converge(SPEED_DRAG, theta, used, _START, g_mps2)
        relative = (rows.after_s - predict_s(SPEED_DRAG, theta, rows, g_mps2)) / rows.after_s
        pooled = relative[rows.flights]
        centre = float(np.median(pooled))
        width = mad_sigma(pooled - centre) + 5e-4
        # a bounce beyond 4.5 standard deviations is left out
        near = np.abs(relative - centre) < max(4.5 * width, least)
        used = rows.keep(near & ~rows.from_height)
    used = rows.keep(used.valid | rows.from_height)
    return used, rows.valid.sum(axis=1) - used.valid.sum(axis=1)


def _start(model: BounceModel, rows: Rows) -> Floats:
    ratios = (rows.after_s / rows.before_s)[rows.flights]
    theta = np.array([START[name] for name in model.parameters])
    if len(ratios):
        theta[0] = float(np.median(ratios))
    return theta


def fit(model: BounceModel, rows: Rows, g_mps2: float, rng: np.random.Generator) -> Fit:
    """Parameters and widths of one model, with bootstrap draws."""
    theta, widths = _start(model, rows), _START
    for _ in range(4):
        theta = converge(model, theta, rows, widths, g_mps2)
        widths = _widths(model, theta, rows, g_mps2, widths)
    theta = converge(model, theta, rows, widths, g_mps2)
    covariance, jacobian, white = linearised(model, theta, rows, widths, g_mps2)
    residuals = np.where(rows.valid, rows.after_s - predict_s(model, theta, rows, g_mps2), np.nan)
    # The bootstrap draws drops, or flights where there are few drops.
    owner = np.nonzero(rows.valid)[0]
    groups = owner if len(np.unique(owner)) >= 6 else np.arange(len(white))
    names, group = np.unique(groups, return_inverse=True)
    draws = np.empty((200, len(theta)))
    for b in range(len(draws)):
        weight = np.bincount(rng.integers(len(names), size=len(names)), minlength=len(names))[group]
        normal = (jacobian * weight[:, None]).T @ jacobian
        draws[b] = theta + _inverse(normal) @ (jacobian.T @ (weight * white))
    # Errors of times that neighbours share cancel in part. Were all that is left scatter of the restitution, nothing
    # would cancel; the data cannot say which, so the wider of both is stated.
    relative = (residuals / rows.after_s)[rows.flights]
    spread = float(theta[0]) * float(np.sqrt((relative**2).sum() / max(len(relative) - len(theta), 1)))
    as_scatter = _SMALLEST._replace(scatter=max(spread, _SMALLEST.scatter))
    covariance = wider(covariance, linearised(model, theta, rows, as_scatter, g_mps2)[0])
    return Fit(model, theta, covariance, widths, residuals, white, draws, rows.count - len(theta))


def wider(covariance: Floats, other: Floats) -> Floats:
    """The first covariance, each standard deviation stretched to the other's where that is larger."""
    own, rival = np.sqrt(np.diag(covariance)), np.sqrt(np.diag(other))
    stretch = np.maximum(rival / np.maximum(own, 1e-300), 1.0)
    return np.asarray(covariance * np.outer(stretch, stretch))


def _inverse(normal: Floats) -> Floats:
    """Inverse of normal equations; a direction that the data do not fix is left where it is."""
    return np.asarray(np.linalg.pinv(normal, rcond=1e-10, hermitian=True), dtype=np.float64)


def sensitivities(model: BounceModel, theta: Floats, rows: Rows, g_mps2: float) -> Floats:
    """Derivatives of the predicted durations by the parameters, shape (drops, longest, p)."""
    base = predict_s(model, theta, rows, g_mps2)
    moved = theta + _NUDGE * np.eye(len(theta))
    return np.stack([(predict_s(model, one, rows, g_mps2) - base) / _NUDGE for one in moved], axis=-1)


def _whitened(lower: Floats, rows: Rows, values: Floats) -> Floats:
    """Values (drops, longest, m) in units of the noise, shape (rows, m)."""
    known = np.where(rows.valid[..., None], values, 0.0)
    return np.asarray(np.linalg.solve(lower, known)[rows.valid], dtype=np.float64)


def linearised(
    model: BounceModel, theta: Floats, rows: Rows, widths: Widths, g_mps2: float
) -> tuple[Floats, Floats, Floats]:
    """Covariance (p, p) at ``theta``, and the whitened slopes (rows, p) and residuals (rows,)."""
    lower = noise_of(model, theta, rows, g_mps2).lower(widths)
    jacobian = _whitened(lower, rows, sensitivities(model, theta, rows, g_mps2))
    residual = (rows.after_s - predict_s(model, theta, rows, g_mps2))[..., None]
    return _inverse(jacobian.T @ jacobian), jacobian, _whitened(lower, rows, residual)[:, 0]


def converge(model: BounceModel, theta: Floats, rows: Rows, widths: Widths, g_mps2: float) -> Floats:
    """Least squares at fixed widths.

    The covariance moves with the parameters, but its change is no part of the slopes: they would trade fit for a
    covariance that is larger. So it stands still in each pass.
    """
    low, high = np.array([BOUNDS[name] for name in model.parameters]).T
    for _ in range(4):
        lower = noise_of(model, theta, rows, g_mps2).lower(widths)

        def left(x: Floats, lower: Floats = lower) -> Floats:
            return _whitened(lower, rows, (rows.after_s - predict_s(model, x, rows, g_mps2))[..., None])[:, 0]

        def slopes(x: Floats, lower: Floats = lower) -> Floats:
            return -_whitened(lower, rows, sensitivities(model, x, rows, g_mps2))

        begin = np.clip(theta, low + 1e-9, high - 1e-9)
        found = optimize.least_squares(left, begin, slopes, (low, high), method="dogbox", x_scale="jac", max_nfev=30)
        settled = float(np.abs(found.x - theta).max()) < 1e-7  # of every parameter
        theta = found.x
        if settled:
            break
    return theta


def _widths(model: BounceModel, theta: Floats, rows: Rows, g_mps2: float, start: Widths) -> Widths:
    """Most likely widths at ``theta``, with one degree of freedom given up per parameter.

    A weak prior prevents each from vanishing: in a short drop the likelihood by itself puts all on one of them, and a
    restitution without any scatter would then seem known far too well.
    """
    noise = noise_of(model, theta, rows, g_mps2)
    residual = np.where(rows.valid, rows.after_s - predict_s(model, theta, rows, g_mps2), 0.0)[..., None]
    inflate = rows.count / max(rows.count - len(theta), 1)

    def minus_log(logs: Floats) -> float:
        lower = noise.lower(Widths(*np.exp(logs)))
        white = np.linalg.solve(lower, residual)
        diagonal = np.diagonal(lower, axis1=1, axis2=2)
        usual = ((logs - np.log(_USUAL_WIDTHS)) / 1.5) ** 2  # in natural logarithms, one standard deviation
        return float(np.log(diagonal).sum() + 0.5 * inflate * (white**2).sum() + 0.5 * usual.sum())

    found = optimize.minimize(
        minus_log,
        np.log(start),
        method="Nelder-Mead",
        bounds=list(zip(np.log(_SMALLEST), np.log(_LARGEST), strict=True)),
        options={"xatol": 0.03, "fatol": 0.01, "maxiter": 150},
    )
    return Widths(*(float(x) for x in np.exp(found.x)))


def again(whole: Fit, rows: Rows, g_mps2: float) -> Fit:
    """The same model fitted to other rows, with the widths that it has."""
    theta = converge(whole.model, whole.theta, rows, whole.widths, g_mps2)
    covariance = wider(linearised(whole.model, theta, rows, whole.widths, g_mps2)[0], whole.covariance)
    return replace(whole, theta=theta, covariance=covariance, freedom=rows.count - len(theta))


def folds_of(rows: Rows) -> list[Bools]:
    """Rows that each fold holds out: whole drops where there are enough, else every so many-th bounce."""
    with_data = np.flatnonzero(rows.valid.any(axis=1))
    fold_of = np.full(rows.valid.shape, -1)
    if len(with_data) >= ENOUGH_DROPS:
        fold_of[with_data] = (np.arange(len(with_data)) % _MOST_FOLDS)[:, None]
    elif rows.count >= 5:  # fewer bounces than this leave nothing to hold out
        fold_of[rows.valid] = np.arange(rows.count) % min(_MOST_FOLDS, rows.count)
    return [rows.valid & (fold_of == k) for k in range(int(fold_of.max()) + 1)]


def held_out(whole: Fit, rows: Rows, g_mps2: float) -> tuple[Floats, float]:
    """Held-out log likelihood of each unit, and rms error of the flights, s (NaN where nothing is held out)."""
    by_drop = bool(rows.valid.any(axis=1).sum() >= ENOUGH_DROPS)
    model, widths = whole.model, whole.widths
    squares, scores = [np.empty(0)], [np.empty(0)]
    for held in folds_of(rows):
        fitted, unseen = rows.keep(~held), rows.keep(held)
        theta = converge(model, whole.theta, fitted, widths, g_mps2)
        residual = rows.after_s - predict_s(model, theta, rows, g_mps2)
        squares.append(residual[held & ~rows.from_height] ** 2)
        # What the fitted rows leave open of the parameters is part of the covariance. Else a model is blamed for
        # where its best value happens to lie: the first, longest flight is far outside the others.
        noise = noise_of(model, theta, unseen, g_mps2).lower(widths)
        slope = np.where(held[..., None], sensitivities(model, theta, unseen, g_mps2), 0.0)
        left_open = slope @ linearised(model, theta, fitted, widths, g_mps2)[0] @ slope.transpose(0, 2, 1)
        lower = np.linalg.cholesky(noise @ noise.transpose(0, 2, 1) + left_open)
        white = np.linalg.solve(lower, np.where(held, residual, 0.0)[..., None])[..., 0]
        log = -0.5 * white**2 - np.log(np.diagonal(lower, axis1=1, axis2=2)) - 0.5 * np.log(2 * np.pi)
        log = np.where(held, log, 0.0)
        scores.append(log.sum(axis=1)[held.any(axis=1)] if by_drop else log[held])
    errors = np.concatenate(squares)
    return np.concatenate(scores), float(np.sqrt(errors.mean())) if len(errors) else float("nan")
