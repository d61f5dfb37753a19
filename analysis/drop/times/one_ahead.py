"""The data of the models of impact times, and the covariance of its residuals.

An impact time has two errors. The detector's jitter moves a boundary that two flights share, so
neighbouring residuals are correlated; and every bounce has a restitution a little its own. Drops are independent.
Arrays are padded to the longest drop, so that all drops are whitened in one batch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.drop.laws.bouncelaw import BounceModel
from analysis.drop.times.impact_chain import Bounces

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_PAD_S = 0.1  # a flight nobody made, in the rows that pad a drop


@dataclass(frozen=True)
class Drop:
    """One drop to be fitted.

    Attributes
    ----------
    name : str
        The file it came from.
    bounces : Bounces
        Its impacts.
    height_m : tuple of (value, standard uncertainty), optional
        The stated drop height, where it is to be used as data.
    file : Path, optional
        Where it is from.
    sound : bool
        Whether the file is a sound.
    not_read : tuple of str
        What of the file was not read, with the reason (with the file's first drop).
    remarks : tuple of str
        What was noticed (with the file's first drop).
    events_s : (n,) float64
        All events of the file or table, impacts or not (with its first drop).
    """

    name: str
    bounces: Bounces
    height_m: tuple[float, float] | None = None
    file: Path | None = None
    sound: bool = False
    not_read: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    events_s: Array = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class Rows:
    """One-bounce-ahead predictions, by drop: shape (drops, longest).

    Attributes
    ----------
    before_s, after_s : float64
        Flight before the bounce, and after it.
    edges : int64, shape (drops, longest, 3)
        Impacts that start the flight before, part the two, and end the flight after.
    valid : bool
        Which are data (the others pad, or are held out).
    from_height : bool
        The row starts from the stated height, not from a flight.
    height_m, height_sigma_m : float64, shape (drops,)
        The stated heights (NaN where not used).
    """

    before_s: Array
    after_s: Array
    edges: NDArray[np.int64]
    valid: Mask
    from_height: Mask
    height_m: Array
    height_sigma_m: Array

    @property
    def count(self) -> int:
        """Number of rows that are data."""
        return int(self.valid.sum())

    def keep(self, mask: Mask) -> Rows:
        """Only these of the rows."""
        return replace(self, valid=self.valid & mask)


def rows_of(drops: Sequence[Drop]) -> Rows:
    """Every prediction that can be made in ``drops``."""
    parts = [_rows_of_one(drop) for drop in drops]
    longest = max(len(part[0]) for part in parts)
    shape = (len(drops), longest)
    before, after = np.full(shape, _PAD_S), np.full(shape, _PAD_S)
    edges = np.zeros((*shape, 3), dtype=np.int64)
    valid, from_height = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    for d, (b, a, e) in enumerate(parts):
        n = len(b)
        from_height[d, :n] = np.isnan(b)
        before[d, :n], after[d, :n], edges[d, :n], valid[d, :n] = np.where(np.isnan(b), _PAD_S, b), a, e, True
    heights = np.array([drop.height_m or (np.nan, np.nan) for drop in drops])
    return Rows(before, after, edges, valid, from_height, heights[:, 0], heights[:, 1])


def _rows_of_one(drop: Drop) -> tuple[Array, Array, NDArray[np.int64]]:
    bounces, flights = drop.bounces, drop.bounces.intervals_s
    n = bounces.usable
    before, after = flights[n - 1], flights[n]
    edges = np.stack([n - 1, n, n + 1], axis=1)
    if drop.height_m is not None and bounces.missed[0] == 0:
        before = np.concatenate(([np.nan], before))
        after = np.concatenate((flights[:1], after))
        edges = np.concatenate(([[0, 0, 1]], edges))
    return before, after, edges


def predict_s(model: BounceModel, theta: Array, rows: Rows, g_mps2: float) -> Array:
    """Predicted duration of each flight after, shape (drops, longest)."""
    out = model.next_flight_s(theta, rows.before_s, g_mps2)
    if rows.from_height.any():
        height = np.where(np.isnan(rows.height_m), 0.1, rows.height_m)
        first = model.first_flight_s(theta, height, g_mps2)
        out = np.where(rows.from_height, first[:, None], out)
    return out


class Widths(NamedTuple):
    """Standard deviations of what makes impact times irregular.

    Attributes
    ----------
    jitter_s
        Of the time of an impact.
    scatter
        Of the restitution from bounce to bounce.
    rebound_s
        Of a flight's duration by a rebound speed that varies by as much at any speed (``2 dv / g``): a slow bounce has
        a restitution less sure than a fast one.
    """

    jitter_s: float
    scatter: float
    rebound_s: float


@dataclass(frozen=True)
class Noise:
    """Covariance of the residuals.

    ``jitter_s^2 jitter + scatter^2 diag(scatter) + rebound_s^2 diag(flight) + diag(fixed)``: of impact times, of the
    restitution, of the rebound speed (as a change of the flight's duration, whatever the speed), of a stated height.
    """

    jitter: Array  # (drops, longest, longest)
    scatter: Array  # (drops, longest), variance
    flight: Array
    fixed: Array
    valid: Mask

    def lower(self, widths: Widths) -> Array:
        """Batched Cholesky factor; rows that are not data have variance 1 and no correlation."""
        total = widths.jitter_s**2 * self.jitter
        both = self.valid[:, :, None] & self.valid[:, None, :]
        own = widths.scatter**2 * self.scatter + widths.rebound_s**2 * self.flight + self.fixed
        diagonal = np.where(self.valid, own, 1.0)
        total = np.where(both, total, 0.0) + np.eye(total.shape[1]) * diagonal[:, :, None]
        return np.asarray(np.linalg.cholesky(total), dtype=np.float64)


def noise_of(model: BounceModel, theta: Array, rows: Rows, g_mps2: float) -> Noise:
    """Parts of the covariance at ``theta``."""
    step = 1e-4
    up = model.next_flight_s(theta, rows.before_s * (1 + step), g_mps2)
    down = model.next_flight_s(theta, rows.before_s * (1 - step), g_mps2)
    slope = np.where(rows.from_height, 0.0, (up - down) / (2 * step * rows.before_s))
    n_drops, longest = rows.before_s.shape
    to_edges = np.zeros((n_drops, longest, int(rows.edges.max(initial=0)) + 1))
    d, r = np.indices((n_drops, longest))
    np.add.at(to_edges, (d, r, rows.edges[:, :, 0]), slope)
    np.add.at(to_edges, (d, r, rows.edges[:, :, 1]), -1.0 - slope)
    np.add.at(to_edges, (d, r, rows.edges[:, :, 2]), 1.0)
    spread = (predict_s(model, theta, rows, g_mps2) / max(float(theta[0]), 0.05)) ** 2
    fixed = np.zeros_like(spread)
    if rows.from_height.any():
        high = model.first_flight_s(theta, np.nan_to_num(rows.height_m + rows.height_sigma_m, nan=0.1), g_mps2)
        mid = model.first_flight_s(theta, np.nan_to_num(rows.height_m, nan=0.1), g_mps2)
        fixed = np.where(rows.from_height, ((high - mid) ** 2)[:, None], 0.0)
    flight = np.where(rows.valid, 1.0, 0.0)
    return Noise(to_edges @ to_edges.transpose(0, 2, 1), spread, flight, fixed, rows.valid)
