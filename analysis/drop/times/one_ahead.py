"""Data of the models of impact times, and the covariance of their residuals.

An impact time has two errors. The detector's jitter moves a boundary that two flights share, so neighbouring
residuals are correlated; and every bounce has a restitution a little its own. Drops are independent. Arrays are
padded to the longest drop, so that all drops are whitened in one batch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from analysis.drop.laws.bounce_law import BounceModel
from analysis.drop.times.impact_chain import Bounces
from kernels.arrays import Bools, Floats, Integers

_PAD_M = 0.1  # height of a drop that pads
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
