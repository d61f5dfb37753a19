"""A log likelihood to second order about a point: finite differences of whitened residuals, robust weights kept.

Explanations of a run in progress and summaries of many runs are both made of it.

References
----------
P. J. Huber, Proc. 5th Berkeley Symp. 1, 221 (1967): variance of an estimator whose likelihood is not the noise's own.
R. E. Chandler and S. Bate, Biometrika 94, 167 (2007): a log likelihood adjusted to that variance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.attribution.candidates import null_value_of
from analysis.attribution.chance import Place
from analysis.attribution.fit import Fitter, of_same_events
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.noise_model import robust_curvature, robust_weight
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.values import ParameterId, Values
from kernels.arrays import Floats

STEP = 0.01  # finite difference of a coordinate
LARGEST_STEP = 1.0  # secant of a coordinate
STUDENT = 0.75  # mean square slope of the robust loss, and mean curvature, where residuals are Student's own


def slopes_of(
    model: ForwardModel,
    fitter: Fitter,
    whitener: Whitener,
    at: Values,
    keys: Sequence[ParameterId],
    step: float = STEP,
    raw: Floats | None = None,
) -> tuple[Floats, Floats]:
    """Bare residuals at the values ``at``, (r,), and their derivatives to the coordinates of ``keys``, (r, K).

    ``step`` is that of the finite differences; ``raw`` are the residuals there where they are known.
    """
    base = {k: at.get(k, null_value_of(k)) for k in {*at, *keys}}
    raw = whitener.stacked(model.residuals(base)) if raw is None else raw
    out = np.zeros((len(raw), len(keys)))
    for j, key in enumerate(keys):
        x = fitter.to_x(key, base[key])
        low, high = fitter.bounds(key, released=True)
        h = step if x + step <= high or x - step < low else -step
        change = whitener.stacked(model.residuals({**base, **fitter.values((key,), np.array([x + h]))})) - raw
        out[:, j] = of_same_events(change, whitener) / h
    return raw, out


def slopes_at(
    model: ForwardModel, fitter: Fitter, whitener: Whitener, at: Values, places: Sequence[Place]
) -> tuple[Floats, Floats]:
    """As `slopes_of`, each derivative at ``at`` with the shapes of its own place."""
    raw = whitener.stacked(model.residuals(dict(at)))
    out = np.zeros((len(raw), len(places)))
    for shapes in dict.fromkeys(shapes for _, shapes in places):
        rows = [j for j, place in enumerate(places) if place[1] == shapes]
        here, keys, known = {**at, **dict(shapes)}, [places[j][0] for j in rows], _unchanged(raw, at, shapes)
        out[:, rows] = slopes_of(model, fitter, whitener, here, keys, raw=known)[1]
    return raw, out


def _unchanged(raw: Floats, at: Values, shapes: Sequence[tuple[ParameterId, float]]) -> Floats | None:
    """The residuals at ``at`` where ``shapes`` change nothing, as the sizes of their effects are zero; else None."""
    names = {name for (name, _), _ in shapes}
    return raw if all(x == null_value_of(key) for key, x in at.items() if key[0] in names) else None


def secants_at(
    model: ForwardModel,
    fitter: Fitter,
    whitener: Whitener,
    at: Values,
    places: Sequence[Place],
    raw: Floats,
    slopes: Floats,
) -> Floats:
    """Derivatives, (r, K), with secants for what can only grow from where it is.

    A size that begins at nothing is told by what it does at a size that the run resolves: one standard deviation by
    itself, all else known. A pull at take-off, for one, does nothing to first order where the contact opens late.
    """
    out = slopes.copy()
    for j, (key, shapes) in enumerate(places):
        x = fitter.to_x(key, at.get(key, null_value_of(key)))
        low, high = fitter.bounds(key, released=True)
        # what can move both ways has a derivative
        if low < x < high:
            continue
        known = float(np.sum(whitener.white_slopes(slopes[:, [j]], raw) ** 2))
        step = min(max(known**-0.5, STEP), LARGEST_STEP) if known > 0.0 else LARGEST_STEP
        here, unchanged = {**at, **dict(shapes)}, _unchanged(raw, at, shapes)
        out[:, [j]] = slopes_of(model, fitter, whitener, here, [key], step, unchanged)[1]
    return out


def gradient_and_information(whitener: Whitener, raw: Floats, slopes: Floats) -> tuple[Floats, Floats]:
    """Slope and negative curvature of the log likelihood, (K,) and (K, K), from bare residuals and derivatives."""
    z, jacobian = whitener.white_all(raw), whitener.white_slopes(slopes, raw)
    weighted = jacobian * robust_weight(z, whitener.odds)[:, None]
    information = weighted.T @ jacobian
    return -(weighted.T @ z), 0.5 * (information + information.T)


def adjusted_gradient_and_information(whitener: Whitener, raw: Floats, slopes: Floats) -> tuple[Floats, Floats]:
    """As `gradient_and_information`, of a log likelihood that is as sharp as the residuals scatter.

    The weights of a least-squares step are no curvature: for normal residuals they are 1.04 in the mean, the curvature
    of the robust loss is 0.81, and the mean square of its slope 0.69. One step with them covers three quarters of the
    way. Here curvature ``B`` and mean square slope ``A`` are measured, of events and of plate data: slopes times
    ``B / A``, curvature ``B^2 / A`` (the inverse of Huber's variance).
    """
    z, jacobian = whitener.white_all(raw), whitener.white_slopes(slopes, raw)
    score = robust_weight(z, whitener.odds) * z
    curvature = robust_curvature(z, whitener.odds)
    gradient, information = np.zeros(jacobian.shape[1]), np.zeros((jacobian.shape[1],) * 2)
    events = np.arange(len(z)) < len(whitener.step)
    for rows in (events, ~events):
        square, bend = STUDENT, STUDENT
        # fewer than twenty residuals say nothing of their own scatter
        if rows.sum() >= 20:
            # a mean curvature below a quarter, where outliers rule, would raise the width without bound
            square, bend = float(np.mean(score[rows] ** 2)), max(float(np.mean(curvature[rows])), 0.25)
        gradient -= bend / square * (jacobian[rows].T @ score[rows])
        information += bend**2 / square * (jacobian[rows].T @ jacobian[rows])
    return gradient, 0.5 * (information + information.T)
