"""Prediction errors in microseconds on steps that no fit and no selection has seen.

Every scored flight counts. Only near-grazing ones are excluded, whose landing could not have been predicted from the
measured numbers; their fraction is reported. Decision 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from analysis.linear_algebra import cholesky, inv
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.noise_model import log_odds, robust_loss
from analysis.residuals.noise.uncertainty import uncertainty_at
from analysis.residuals.values import Values
from analysis.statistics import MAD_TO_SIGMA, chance_of_squares
from analysis.thresholds import (
    COMMON_MODE_SIGMAS,
    FROZEN,
    GRAZING_RATIO,
    GRAZING_SIGMAS,
    LEAST_EXCESS_S,
    OUTLIER_FRACTION,
    SCALE_KNOWN,
    SHARED_S,
)
from kernels.arrays import Bools, Floats, Integers
from model.integrator.one_step import Predicted

DRAWS = 4000  # of noise, for its quantile


@dataclass(frozen=True)
class Errors:
    """Residuals of the held-out steps under one model."""

    landing_rms_us: float  # root mean square of the landing times
    landing_rms_us_low: float  # lower end of its 95 % interval, by resampling whole steps
    landing_rms_us_high: float  # upper end of that interval
    landing_nmad_us: float  # 1.48 times the median absolute deviation of the landing times
    takeoff_nmad_us: float  # of the take-off times that were seen; NaN where no flight began from rest
    takeoff_rms_us: float  # of the same
    flight_time_relative: float  # median absolute error of the flight times over the measured flight time
    flights: int  # that were counted
    excluded_fraction: float  # of the flights, as near-grazing
    lost: int = 0  # landings that the robust likelihood takes for other events, not for misses by noise
    landing_rms_us_without_lost: float = float("nan")  # of the rest


def scored_rows(model: ForwardModel, values: Values, steps: Bools) -> tuple[Integers, float]:
    """Flights of ``steps`` (m,) that count at ``values``, and the fraction excluded as near-grazing."""
    ev = model.observations
    rows = np.flatnonzero(ev.scored & steps[ev.measured.step])
    if len(rows) == 0:
        return rows, 0.0
    keep = ~near_grazing(model, values)[rows]
    return rows[keep], 1.0 - float(keep.mean())


def near_grazing(model: ForwardModel, values: Values) -> Bools:
    """Flights whose landing cannot be predicted from the measured numbers, (n,), whatever the residuals.

    Either the uncertainty is `GRAZING_RATIO` times the median one, or the prediction jumps by `GRAZING_SIGMAS` of that
    when an earlier landing or a tone of the plate is off by `GRAZING_SIGMAS`: the graze is met or missed.
    """
    return model.memory.recall(("grazing", model.start(values).flying), lambda: _grazing(model, values))


def _grazing(model: ForwardModel, values: Values) -> Bools:
    ev = model.observations
    u = uncertainty_at(model, values)
    total = np.sqrt(u.landing_total_s**2 - u.landing_scatter_s**2)  # a rebound that scatters is no graze
    usual = GRAZING_RATIO * float(np.median(total[ev.scored])) if ev.scored.any() else np.inf
    base = model.predicted(values)
    out = total >= usual
    for sign in (-GRAZING_SIGMAS, GRAZING_SIGMAS):
        for moved, rows in model.moved_landings(values, sign * ev.landing_sigma_s):
            out |= ~rows[0] & _jumps(base, moved, GRAZING_SIGMAS * usual)
        for k in np.flatnonzero(ev.steps.forcing.any(axis=0)):
            for unit in (1.0, 1j):
                z = ev.steps.plate.acceleration_mps2.copy()
                # both quadratures: amplitude and phase of the tone
                z[:, k] += sign * unit * ev.steps.sigma_mps2[:, k]
                out |= _jumps(base, model.predict(values, tones=z, near=base), GRAZING_SIGMAS * usual)
    return np.asarray(out)


def _jumps(base: Predicted, moved: Predicted, far_s: float) -> Bools:
    """Whether a landing moves by more than ``far_s``, or comes into being or vanishes, (n,)."""
    lost = np.isfinite(base.landing_s) != np.isfinite(moved.landing_s)
    return np.asarray(lost | (np.abs(moved.landing_s - base.landing_s) > far_s))


def held_out_errors(model: ForwardModel, values: Values, rows: Integers, excluded_fraction: float) -> Errors:
    """Errors of the flights ``rows`` (k,) at ``values``; a flight without prediction misses by half a period."""
    ev = model.observations
    if len(rows) == 0:
        nan = float("nan")
        return Errors(nan, nan, nan, nan, nan, nan, nan, 0, excluded_fraction)
    r = model.residuals(values)
    half = 0.5 * ev.steps.plate.period_s[ev.measured.step[rows]]
    landing = np.where(np.isfinite(r.landing_s[rows]), r.landing_s[rows], half)
    seen = model.from_rest[rows]
    opening = np.where(np.isfinite(r.opening_s[rows]), r.opening_s[rows], half)[seen]
    measured = (ev.measured.landing_s - ev.measured.opening_s)[rows]
    predicted = (r.predicted.landing_s - r.predicted.opening_s)[rows]
    relative = np.abs(np.where(np.isfinite(predicted), predicted, 0.0) - measured) / measured
    lost = _lost(model, values, landing, rows)
    # 95 % interval of the rms when whole steps are drawn anew: the step is the replicate
    names, inverse = np.unique(ev.measured.step[rows], return_inverse=True)
    squares, counts = np.bincount(inverse, landing**2), np.bincount(inverse)
    drawn = np.random.default_rng(0).integers(0, len(names), (500, len(names)))
    rms = np.sqrt(squares[drawn].sum(axis=1) / counts[drawn].sum(axis=1))
    low, high = float(np.quantile(rms, 0.025)), float(np.quantile(rms, 0.975))
    return Errors(
        _rms_us(landing),
        1e6 * low,
        1e6 * high,
        1e6 * MAD_TO_SIGMA * float(np.median(np.abs(landing))),
        1e6 * MAD_TO_SIGMA * float(np.median(np.abs(opening))) if len(opening) else float("nan"),
        _rms_us(opening),
        float(np.median(relative)),
        len(rows),
        excluded_fraction,
        int(lost.sum()),
        _rms_us(landing[~lost]),
    )


def _lost(model: ForwardModel, values: Values, landing_s: Floats, rows: Integers) -> Bools:
    """Which landings (k,) are likelier to be outliers than missed by noise, in the likelihood of the fits."""
    sigma = np.hypot(uncertainty_at(model, values).landing_total_s[rows], SHARED_S)
    odds = log_odds(sigma, model.observations.steps.plate.period_s[model.observations.measured.step[rows]])
    return np.asarray(robust_loss(landing_s / sigma) > -odds)


def noise_floors_us(model: ForwardModel, values: Values, rows: Integers) -> tuple[float, float]:
    """Root mean square of the flights' own uncertainty, carried through the prediction at ``values``.

    Of landings, and of the take-offs that were seen; NaN where there are none.
    """
    u, from_rest = uncertainty_at(model, values), rows[model.from_rest[rows]]
    landing, opening = u.landing_total_s[rows], u.opening_total_s[from_rest]
    return _rms_us(landing), _rms_us(opening)


def noise_quantiles_us(
    model: ForwardModel, values: Values, rows: Integers, chance_p: float = FROZEN.chance_p
) -> tuple[float, float]:
    """Root mean squares that noise exceeds with probability ``chance_p`` in such a set of flights.

    Errors of a tone are the same for all flights of a step, so those of few steps scatter widely about the floor. Of
    landings, and of the take-offs that were seen; 0 where there are none.
    """
    u, from_rest, rng = uncertainty_at(model, values), rows[model.from_rest[rows]], np.random.default_rng(0)
    step = model.observations.measured.step

    def quantile(events: Integers, sigma: Floats, by_tone: Floats) -> float:
        if len(events) == 0:
            return 0.0
        names, place = np.unique(step[events], return_inverse=True)
        squares = np.zeros(DRAWS)
        for i in range(len(names)):
            mine = events[place == i]
            # one draw of a tone's error for the whole step, one of its own for each flight
            together = by_tone[mine] @ rng.standard_normal((by_tone.shape[1], DRAWS))
            squares += np.sum((together + sigma[mine, None] * rng.standard_normal((len(mine), DRAWS))) ** 2, axis=0)
        return 1e6 * float(np.quantile(np.sqrt(squares / len(events)), 1.0 - chance_p))

    return (
        quantile(rows, u.landing_sigma_s, u.landing_by_tone),
        quantile(from_rest, u.opening_sigma_s, u.opening_by_tone),
    )


def landing_probability(model: ForwardModel, values: Values, rows: Integers) -> tuple[float, float]:
    """Probability that noise misses the landings of the flights ``rows`` (k,) by so much, and their rms, us.

    The sum of their squares is that of correlated normal errors. The largest `OUTLIER_FRACTION` of the errors may be
    other events than those predicted, and is left out of both.
    """
    u, r, step = uncertainty_at(model, values), model.residuals(values), model.observations.measured.step
    half = 0.5 * model.observations.steps.plate.period_s[step[rows]]
    missed = np.where(np.isfinite(r.landing_s[rows]), r.landing_s[rows], half)
    order = np.argsort(np.abs(missed) / u.landing_total_s[rows])
    used = np.sort(order[: len(rows) - math.ceil(OUTLIER_FRACTION * len(rows))])
    rows, missed = rows[used], missed[used]
    if len(rows) == 0:
        return 1.0, float("nan")
    variances = []
    for s in np.unique(step[rows]):
        mine = rows[step[rows] == s]
        by_tone = u.landing_by_tone[mine]
        covariance = np.diag(u.landing_sigma_s[mine] ** 2) + by_tone @ by_tone.T + SHARED_S**2
        # a sum of squares of correlated normal errors is one of independent errors with these variances
        variances.append(np.linalg.eigvalsh(covariance))
    noise = (1.0 + SCALE_KNOWN) ** 2 * np.concatenate(variances)
    return chance_of_squares(float(np.sum(missed**2)), noise), _rms_us(missed)


@dataclass(frozen=True)
class GivenOpenings:
    """Landings of held-out steps, given what the openings of the same step tell of the plate's tones there."""

    landing_rms_us: float  # root mean square of what is left of the landings
    floor_us: float  # the same by measurement noise, with what the openings leave unknown of the tones
    chance_us: float  # root mean square that noise exceeds with the probability of the threshold


def given_openings(
    model: ForwardModel, values: Values, rows: Integers, chance_p: float = FROZEN.chance_p
) -> GivenOpenings:
    """Landings of the flights ``rows`` (k,), conditioned on the openings of their own steps.

    A tone's error shifts all openings and landings of a step together. Where few steps are held out, one whose tones
    are two standard deviations off would decide; its openings tell that error, within its stated uncertainty.
    """
    u, r, step = uncertainty_at(model, values), model.residuals(values), model.observations.measured.step
    half = 0.5 * model.observations.steps.plate.period_s
    rng, squares, noise, drawn = np.random.default_rng(0), 0.0, 0.0, np.zeros(DRAWS)
    for s in np.unique(step[rows]):
        mine = rows[step[rows] == s]
        seen = np.flatnonzero(model.from_rest & (step == s))
        # an opening far off is another event, and says nothing of the tones
        seen = seen[np.abs(r.opening_s[seen]) < COMMON_MODE_SIGMAS * np.hypot(u.opening_total_s[seen], SHARED_S)]
        shift, root = _tones_given(r.opening_s[seen], u.opening_sigma_s[seen], u.opening_by_tone[seen])
        tones = u.landing_by_tone[mine]
        landing = np.where(np.isfinite(r.landing_s[mine]), r.landing_s[mine], half[s])
        squares += float(np.sum((landing - tones @ shift) ** 2))
        together, own = tones @ root, u.landing_sigma_s[mine]
        noise += float(np.sum(together**2) + np.sum(own**2))
        errors = together @ rng.standard_normal((root.shape[1], DRAWS))
        drawn += np.sum((errors + own[:, None] * rng.standard_normal((len(mine), DRAWS))) ** 2, axis=0)
    if len(rows) == 0:
        return GivenOpenings(float("nan"), float("nan"), 0.0)
    rms, floor = (1e6 * float(np.sqrt(x / len(rows))) for x in (squares, noise))
    return GivenOpenings(rms, floor, 1e6 * float(np.quantile(np.sqrt(drawn / len(rows)), 1.0 - chance_p)))


def _tones_given(opening_s: Floats, sigma_s: Floats, by_tone: Floats) -> tuple[Floats, Floats]:
    """Mean and root of the covariance of a step's tone errors, unit ones before, given its openings.

    The contact circuit may shift all of the openings together by `SHARED_S`.
    """
    q = by_tone.shape[1]
    known = np.column_stack([by_tone, np.full(len(opening_s), SHARED_S)]) / np.hypot(sigma_s, LEAST_EXCESS_S)[:, None]
    # unit prior and measured openings: posterior of a linear model with normal errors
    covariance = inv(np.eye(q + 1) + known.T @ known)
    mean = covariance @ (known.T @ (opening_s / np.hypot(sigma_s, LEAST_EXCESS_S)))
    return mean[:q], cholesky(covariance)[:q]


def _rms_us(x: Floats) -> float:
    return 1e6 * float(np.sqrt(np.mean(x**2))) if len(x) else float("nan")
