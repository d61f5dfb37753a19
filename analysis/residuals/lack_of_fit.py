"""Goodness of fit: F tests, chi-square and Ljung-Box on Cholesky-standardised innovations.

Residuals are first made independent by their known covariance: an edge's error enters its own flight and, through the
prediction, the next ones; a tone's error enters a whole step. They are tested against the larger of that noise and
their own scatter, so that neither odd-shaped noise nor a roughly known scale fails a test.

References
----------
G. M. Ljung and G. E. P. Box, Biometrika 65, 297 (1978): serial correlation.
J. Durbin and S. J. Koopman, Time Series Analysis by State Space Methods (Oxford, 2012), 2.12: standardised innovations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, fdtrc

from analysis.linear_algebra import cholesky, solve
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.uncertainty import Uncertainty, uncertainty_at
from analysis.residuals.prediction_errors import near_grazing
from analysis.residuals.values import Values
from analysis.thresholds import (
    FARTHEST_SIGMAS,
    FROZEN,
    INNOVATION_SIGMAS,
    LEAST_EXCESS_S,
    LEAST_IN_BIN,
    LEAST_OF_KIND,
    SCALE_KNOWN,
    SHARED_S,
    Thresholds,
)
from kernels.arrays import Bools, Floats, Integers

LAGS = 4  # of the Ljung-Box test


@dataclass(frozen=True)
class GoodnessOfFit:
    """Tests of what a hypothesis leaves."""

    p_lack_of_fit: float  # probability of so much structure or scatter from noise, all tests together (Bonferroni)
    # root mean square of the residuals over their uncertainty, of openings or of landings, whichever is more
    ratio: float
    plate_rms_z: float  # the same of the plate data, of the worst kind
    # name of the covariate (see `analysis.residuals.covariates.COVARIATES`) that carries the remainder; None for noise
    covariate: str | None
    p_covariates: Mapping[str, float]  # by covariate, before the correction for their number
    p_between: float  # steps against their own scatter
    p_scatter: float  # scatter against the uncertainty
    p_serial: float  # events against their neighbours
    landing_ratio: float = math.inf  # ``ratio`` of landings
    p_takeoffs: float = 0.0  # ``p_lack_of_fit`` of openings

    def p_flights(self, limits: Thresholds) -> float:
        """Probability of so much from noise; that of take-offs where landings leave no more than is let pass.

        What is improbable in landings that pass by their size says nothing against take-offs that look like noise.
        """
        return max(self.p_lack_of_fit, self.p_takeoffs if self.landing_ratio <= limits.lack_ratio else 0.0)

    def flights_pass(self, limits: Thresholds) -> bool:
        """Whether flights leave no more than noise, or no more than is let pass."""
        return self.p_flights(limits) >= limits.lack_p or self.ratio <= limits.lack_ratio

    def only_takeoffs_fail(self, limits: Thresholds) -> bool:
        """Whether flights leave more than is let pass, and neither landings nor plate data do."""
        return not self.flights_pass(limits) and self.landing_ratio <= limits.lack_ratio and self.plate_passes(limits)

    def plate_passes(self, limits: Thresholds) -> bool:
        """Whether plate data leave no more than is let pass."""
        return self.plate_rms_z <= limits.plate_rms_z


@dataclass(frozen=True)
class Innovations:
    """Independent unit residuals, arrays (k,): ``event`` is the flight, ``landing`` False for an opening."""

    z: Floats
    event: Integers
    landing: Bools
    step: Integers


def goodness_of_fit(model: ForwardModel, values: Values, limits: Thresholds = FROZEN) -> GoodnessOfFit:
    """Tests of the residuals at ``values``, on all steps.

    Parameters
    ----------
    model
        The observations and their model.
    values
        Fitted values of any hypothesis, also of the declared model.
    limits
        Thresholds of the verdict: the covariate is named where its probability is below ``lack_p``.
    """
    u = uncertainty_at(model, values)
    found = innovations(model, values, u)
    tables = model.covariates(values)
    logs, first, p_first, between, scatter = _tests(found, tables)
    rows = ~found.landing
    of_openings = Innovations(found.z[rows], found.event[rows], found.landing[rows], found.step[rows])
    serial = _p_serial(found)
    return GoodnessOfFit(
        # Bonferroni: the best of four tests
        min(1.0, 4.0 * min(p_first, between, scatter, serial)),
        max(sizes := _rms_of_each(model, values, u)),
        plate_rms_standardised(model, values),
        first if p_first < limits.lack_p else None,
        {k: math.exp(v) for k, v in logs.items()},
        between,
        scatter,
        serial,
        sizes[1],
        min(1.0, 3.0 * min(_tests(of_openings, tables)[2:])),
    )


def _tests(found: Innovations, tables: Mapping[str, Floats]) -> tuple[dict[str, float], str, float, float, float]:
    """Log p of each covariate, the best of them and its p, p of steps against their own scatter, p of the scatter."""
    logs = {name: _log_p_of_covariate(found, x) for name, x in tables.items()}
    first = min(logs, key=lambda name: logs[name])
    # the best of all covariates, by Bonferroni; in logarithms, as a double cannot hold the smallest
    p_first = math.exp(min(logs[first] + math.log(len(logs)), 0.0))
    between = scatter = 1.0
    if len(found.z):
        # openings and landings have means of their own; the uncertainty is known only roughly
        between = math.exp(_log_p_grouped(found.z, 2 * found.step + found.landing, about_zero=True))
        scatter = float(chdtrc(len(found.z), float(np.sum(found.z**2)) / (1.0 + SCALE_KNOWN) ** 2))
    return logs, first, p_first, between, scatter


def rms_standardised(model: ForwardModel, values: Values, u: Uncertainty) -> float:
    """Rms of residuals over uncertainty, clipped at `FARTHEST_SIGMAS`; the larger of openings and landings."""
    return max(_rms_of_each(model, values, u))


def _rms_of_each(model: ForwardModel, values: Values, u: Uncertainty) -> list[float]:
    """`rms_standardised` of openings and of landings; 0 where there are none."""
    firm = ~near_grazing(model, values)  # the others may or may not happen
    return [
        float(np.sqrt(np.mean(z[firm[rows]] ** 2))) if firm[rows].any() else 0.0 for z, rows in _units(model, values, u)
    ]


def least_rms_standardised(model: ForwardModel, values: Values, u: Uncertainty) -> float:
    """Bound of `rms_standardised` from below while at most half of the flights graze, without another flight.

    It is that of the smaller half of the residuals.
    """
    halves = (np.sort(np.abs(z))[: (len(z) + 1) // 2] for z, _ in _units(model, values, u))
    return max((float(np.sqrt(np.mean(z**2))) for z in halves if len(z)), default=0.0)


def _units(model: ForwardModel, values: Values, u: Uncertainty) -> list[tuple[Floats, Integers]]:
    """Residuals over uncertainty, clipped, and their events: of openings and of landings."""
    r, openings, landings = model.residuals(values), *map(np.flatnonzero, (model.from_rest, model.observations.scored))
    return [
        (_unit(r.opening_s, u.opening_total_s)[openings], openings),
        (_unit(r.landing_s, u.landing_total_s)[landings], landings),
    ]


def plate_rms_standardised(model: ForwardModel, values: Values) -> float:
    """Root mean square of normalised plate residuals of the kind that fits worst, shrunk to 1 where few."""
    few = LEAST_OF_KIND
    squares = _plate_squares(model, values)
    return max((float(np.sqrt((np.sum(q) + few) / (len(q) + few))) for q in squares), default=0.0)


def plate_probability(model: ForwardModel, values: Values) -> float:
    """Probability of so large plate residuals from noise: of the worst kind, times the number of kinds."""
    squares = _plate_squares(model, values)
    p = [float(chdtrc(len(q), float(np.sum(q)) / (1.0 + SCALE_KNOWN) ** 2)) for q in squares]
    return min(1.0, len(p) * min(p, default=1.0))


def _plate_squares(model: ForwardModel, values: Values) -> list[Floats]:
    """Squares of the normalised plate residuals, clipped, an array for each kind of which there are enough."""
    data = model.observations.plate
    z = np.clip(model.residuals(values).plate / data.sigma, -FARTHEST_SIGMAS, FARTHEST_SIGMAS)
    kinds, counts = np.unique(data.kind, return_counts=True)
    return [z[data.kind == k] ** 2 for k in kinds[counts >= LEAST_OF_KIND]]


def _unit(residual: Floats, sigma: Floats) -> Floats:
    """Residuals over uncertainty, clipped; the clip itself where nothing was predicted."""
    sigma = np.hypot(sigma, SHARED_S)
    return np.clip(
        np.where(np.isfinite(residual), residual / sigma, FARTHEST_SIGMAS), -FARTHEST_SIGMAS, FARTHEST_SIGMAS
    )


def innovations(model: ForwardModel, values: Values, u: Uncertainty) -> Innovations:
    """Standardised innovations of each step: residuals over the Cholesky factor of their covariance."""
    ev = model.observations
    r = model.residuals(values)
    firm = ev.scored & ~near_grazing(model, values)
    parts = []
    for s in range(len(ev.steps)):
        rows = np.flatnonzero(firm & (ev.measured.step == s))
        if len(rows) == 0:
            continue
        event = np.concatenate([rows[model.from_rest[rows]], rows])
        landing = np.arange(len(event)) >= len(event) - len(rows)
        # in order of time, so that Cholesky's factor makes each innovation new against all before it
        order = np.lexsort((landing, event))
        event, landing = event[order], landing[order]
        total = np.where(landing, u.landing_total_s[event], u.opening_total_s[event])
        bare = _unit(np.where(landing, r.landing_s[event], r.opening_s[event]), total) * np.hypot(total, SHARED_S)
        noise = _innovation_covariance(u, event, landing)
        z = solve(cholesky(noise), bare)
        parts.append((z, event, landing, np.full(len(z), s)))
    if not parts:
        none = np.zeros(0, dtype=np.int64)
        return Innovations(np.zeros(0), none, none.astype(bool), none)
    z, event, landing, step = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Innovations(np.clip(z, -INNOVATION_SIGMAS, INNOVATION_SIGMAS), event, landing, step)


def _innovation_covariance(u: Uncertainty, event: Integers, landing: Bools) -> Floats:
    """Covariance of one step's residuals, (k, k), s^2."""
    first = max(int(event.min()) - 2, 0)
    edges = np.arange(first, int(event.max()) + 1)
    slope = np.zeros((len(event), len(edges)))
    row = np.arange(len(event))
    slope[row[landing], event[landing] - first] = 1.0
    for back in (1, 2):
        there = event - back >= first
        by = u.changes.edges[back - 1, event, landing.astype(np.int64)]
        slope[row[there], event[there] - back - first] -= by[there]
    tones = np.where(landing[:, None], u.landing_by_tone[event], u.opening_by_tone[event])
    # a landing's error enters its own residual, and those of flights predicted from it
    edge = slope * u.landing_edge_s[edges]
    own = np.where(landing, u.landing_scatter_s[event], u.opening_edge_s[event]) ** 2 + LEAST_EXCESS_S**2
    together = SHARED_S**2 * (landing[:, None] == landing[None, :])
    return np.asarray(edge @ edge.T + tones @ tones.T + together + np.diag(own))


def _log_p_grouped(z: Floats, group: Integers, about_zero: bool) -> float:
    """Do groups differ (from zero, or from their common mean)?"""
    count = np.bincount(group)
    full = np.isin(group, np.flatnonzero(count >= LEAST_IN_BIN))
    z, group = z[full], np.unique(group[full], return_inverse=True)[1]
    if len(z) == 0 or group.max() == 0:
        return 0.0
    count = np.bincount(group)
    mean = np.bincount(group, z) / count
    centre, lost = (0.0, 0) if about_zero else (float(z.mean()), 1)
    k = len(count)
    between = float(np.sum(count * (mean - centre) ** 2)) / (k - lost)
    within = float(np.sum((z - mean[group]) ** 2)) / (len(z) - k)
    if len(z) <= k or k <= lost:
        return 0.0
    # the noise is taken for no less than its known size; log 0 where the probability is too small for a double
    with np.errstate(divide="ignore"):
        return float(np.log(fdtrc(k - lost, len(z) - k, between / max(within, 1.0))))


def _p_serial(found: Innovations) -> float:
    """Ljung-Box over the first lags of the landings, pairs within a step only."""
    z, step = found.z[found.landing], found.step[found.landing]
    if len(z) <= 2 * LAGS:
        return 1.0
    # noise is taken for no less than its known size: a small remainder in a pattern is no lack of fit
    power = max(float(np.mean(z**2)), 1.0)
    q = 0.0
    for lag in range(1, LAGS + 1):
        # across a step's border events are no neighbours
        together = step[lag:] == step[:-lag]
        if together.any():
            q += float(np.sum((z[lag:] * z[:-lag])[together])) ** 2 / (float(together.sum()) * power**2)
    return float(chdtrc(LAGS, q))


def _log_p_of_covariate(found: Innovations, x: Floats) -> float:
    """Means over quantile bins of a covariate, of openings and of landings, against the scatter within."""
    logs = []
    for landing in (False, True):
        rows = (found.landing == landing) & np.isfinite(x[found.event])
        if rows.sum() < 2 * LEAST_IN_BIN:
            continue
        seen = x[found.event][rows]
        # eight quantile bins of a covariate
        edges = np.unique(np.quantile(seen, np.linspace(0.0, 1.0, 8 + 1)[1:-1]))
        logs.append(_log_p_grouped(found.z[rows], np.searchsorted(edges, seen, side="right"), about_zero=False))
    return min(min(logs) + math.log(len(logs)), 0.0) if logs else 0.0
