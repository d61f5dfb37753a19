"""Sparse and symbolic regression of the same flights, for `benchmarks.analysis.laws`: PySINDy's STLSQ, and gplearn.

Both get what a regression can take: for each flight the constant force, friction or restitution that would bring its
landing to where it was measured, and the covariates that are known at its take-off. Of the three the one that fits
best is carried to the reserved steps, and to the other forcing, as ours is.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any

import numpy as np

from analysis.attribution.fit import Fitter
from analysis.discovery.fit import StackedResiduals
from analysis.discovery.search import residual_table
from analysis.discovery.terms import EVENT_GRIDS, AugmentedModel, Curve, event_term
from analysis.residuals.covariates import COVARIATES
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.prediction_errors import held_out_errors, scored_rows
from analysis.residuals.values import Values
from kernels.arrays import Bools, Floats

PEERS = tuple(name for name in ("gplearn", "pysindy") if importlib.util.find_spec(name))
KINDS = ("force", "friction", "restitution")
Regressor = Callable[[Floats], Floats]


def features(model: ForwardModel) -> Floats:
    """Covariates known at take-off, as printed, (n, features); the median where one is not known."""
    tables = model.covariates({})
    x = np.column_stack([c.scale * tables[name] for name, c in COVARIATES.items() if c.ahead])
    return np.where(np.isfinite(x), x, np.nan_to_num(np.nanmedian(x, axis=0)))


def needed(table: Floats, grid: Floats) -> Floats:
    """For each event the value nearest to none at which its residual is zero, (k,); NaN where there is none."""
    out = np.full(table.shape[1], np.nan)
    for k, r in enumerate(table.T):
        i = np.flatnonzero(r[1:] * r[:-1] <= 0.0)
        if len(i):
            at = grid[i] - r[i] * (grid[i + 1] - grid[i]) / np.where(r[i + 1] == r[i], 1.0, r[i + 1] - r[i])
            out[k] = at[np.argmin(np.abs(at))]
    return out


def regressor(peer: str, x: Floats, y: Floats) -> Regressor:
    """A fit of ``y`` (k,) by ``x`` (k, features)."""
    if peer == "gplearn":
        from gplearn.genetic import SymbolicRegressor

        found = SymbolicRegressor(
            population_size=1000, generations=15, function_set=("add", "sub", "mul", "div", "max", "sqrt"),
            parsimony_coefficient=0.001 * float(np.std(y)), random_state=0,
        )  # fmt: skip
        predict: Regressor = found.fit(x, y).predict
        return predict
    import pysindy

    centre, width = x.mean(axis=0), np.where(np.std(x, axis=0) > 0.0, np.std(x, axis=0), 1.0)
    library = pysindy.PolynomialLibrary(degree=2).fit((x - centre) / width)

    def terms(z: Floats) -> Floats:
        return np.asarray(library.transform((z - centre) / width))

    sparse: Any = pysindy.STLSQ(threshold=0.05 * float(np.std(y)), alpha=1e-3).fit(terms(x), y[:, None])
    return lambda z: terms(z) @ np.ravel(sparse.coef_)


def with_values(model: ForwardModel, kind: str, y: Floats) -> AugmentedModel:
    """The model with one value for each flight."""
    curve = Curve(event_term(kind, ""), np.zeros(1), np.ones(1), y[:, None])
    return AugmentedModel(model, [curve], model.covariates({})["dwell_s"])


def missed_us(fitter: Fitter, values: Values, steps: Bools) -> float:
    """Landing error of ``steps`` (m,) in us rms, calibrations fitted."""
    fitted = fitter.fit(Whitener.of(fitter.model, values), (), values).values
    return held_out_errors(fitter.model, fitted, *scored_rows(fitter.model, fitted, steps)).landing_rms_us


def peer_errors(peer: str, fitter: Fitter, values: Values, there: Fitter) -> dict[str, Any]:
    """Kind of term that fits best, and errors with it on the reserved steps and on the other recording, ``there``."""
    model, best = fitter.model, (np.inf, "", None)
    stack = StackedResiduals.of(model, values, fitter.train).landings()
    x = features(model)
    for kind in KINDS:
        y = needed(residual_table(model, values, stack, kind), EVENT_GRIDS[kind])
        rows = stack.train & np.isfinite(y)
        found = regressor(peer, x[stack.event[rows]], y[rows])
        loss = stack.loss(stack.residuals(with_values(model, kind, np.nan_to_num(found(x))), values))
        if loss < best[0]:
            best = loss, kind, found
    _, kind, found = best
    out = {"kind": kind}
    for name, of, steps in (("here", fitter, ~fitter.train), ("there", there, there.train)):
        carried = with_values(of.model, kind, np.nan_to_num(found(features(of.model))))
        out[name] = missed_us(Fitter(carried, of.priors, of.train), values if of is fitter else {}, steps)
    return out
