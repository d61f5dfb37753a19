"""What forms that do nearly as well add to an interval.

A simpler form is named until a fuller one is better beyond doubt, and one cause until a second one is. What such a form
that was not named would make of a value belongs into its interval all the same, by the evidence for it: the interval is
that of the mixture of all (Bayesian model averaging), so that no threshold decides. Decision 720.

References
----------
J. A. Hoeting, D. Madigan, A. E. Raftery, C. T. Volinsky, Stat. Sci. 14, 382 (1999).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from analysis.attribution.candidates import Candidate, Point, null_value_of, parameter_of
from analysis.attribution.fit import Fitted
from analysis.attribution.hypothesis import Hypothesis, Refits
from analysis.residuals.values import ParameterId
from analysis.statistics import Z95
from analysis.thresholds import Thresholds

Form = tuple[float, dict[ParameterId, tuple[float, float]]]  # its weight over that of the named one; values and sigmas


def beyond_own_form(
    best: Hypothesis, others: Sequence[Candidate], limits: Thresholds
) -> dict[ParameterId, tuple[float, float]]:
    """How much farther than its own form says the interval of each free parameter reaches, below and above.

    Parameters
    ----------
    best
        The hypothesis that is named.
    others
        Fuller forms of its effects, and what else could be added.
    limits
        Thresholds of the verdict.

    Notes
    -----
    A form has the weight of its likelihood less what a tie allows (`Thresholds.tie_nats`, about half the logarithm of
    the number of events, as in Schwarz's criterion), shared among all other causes. Fuller forms are fitted, as their
    shapes are no linear matter; of other causes the linear gain counts.
    """
    sizes = {k: (best.fitted.values[k], best.fitted.sigma(k)) for k in best.free if not parameter_of(k).is_shape}
    fuller = [c for c in others if any(x.names == c.names and set(x.free) < set(c.free) for x in best.candidates)]
    rest = [c for c in others if c not in fuller]
    cost, attempted = limits.tie_nats + math.log(max(len(rest), 1)), Refits(best.fitter).attempted
    forms = [form for c in fuller for form in attempted((c,), _fitted, best, c, limits) or ()]
    forms += [form for c in rest for form in attempted((c,), _linear, best, c, cost) or ()]
    out = {}
    for key, (value, sigma) in sizes.items():
        parts = [(1.0, value, sigma), *((weight, *table[key]) for weight, table in forms if key in table)]
        low, high = _interval(parts)
        out[key] = max(value - Z95 * sigma - low, 0.0), max(high - value - Z95 * sigma, 0.0)
    return out


def _fitted(best: Hypothesis, c: Candidate, limits: Thresholds) -> list[Form]:
    """A fuller form of one of the effects, fitted from where its shapes may begin; nothing where none is finite."""
    own, refits = next(x for x in best.candidates if x.names == c.names), Refits(best.fitter)
    extra = tuple(k for k in c.free if k not in best.free)
    # by the new shape an effect of no size changes nothing: such a size begins elsewhere
    begins = {
        k for k in (*own.free, *extra) if parameter_of(k).is_shape or (k in own.free and not best.fitted.differs((k,)))
    }
    starts: dict[tuple[float, ...], tuple[float, Point]] = {}
    for point in {tuple((k, v) for k, v in s.items() if k in begins): None for s in c.starts or ({},)}:
        shapes = {k: v for k, v in point if k in extra}
        led = {**best.fitter.linear_step(best.fitted, extra, shapes)[1], **dict(point)}
        loss = refits.profile_loss(best.whitener, led)
        at = tuple(shapes.values())
        if at not in starts or loss < starts[at][0]:
            starts[at] = loss, led
    found = list[tuple[float, Fitted]]()
    for _, start in sorted(starts.values(), key=lambda pair: pair[0])[:4]:
        x = refits.attempted((c,), best.fitter.fit, best.whitener, (*best.free, *extra), start)
        if x is not None:
            found.append((refits.profile_loss(best.whitener, x.values) + x.prior_penalty, x))
    if not found:
        return []
    loss, x = min(found, key=lambda pair: pair[0])
    gain = min(best.level + best.fitted.prior_penalty - loss, 500.0)
    return [(math.exp(gain - limits.tie_nats), {k: (x.values[k], x.sigma(k)) for k in best.free})]


def _linear(best: Hypothesis, c: Candidate, cost: float) -> list[Form]:
    """What another cause would make of the values, by each shape that it may have, were residuals linear in it."""
    free = tuple(k for k in c.free if k not in best.free)
    shapes = [k for k in free if parameter_of(k).is_shape]
    settings = dict.fromkeys(tuple(s.get(k, null_value_of(k)) for k in shapes) for s in c.starts or ({},))
    out = []
    for at in settings if len(shapes) < len(free) else ():
        gain, values = best.fitter.linear_step(best.fitted, free, dict(zip(shapes, at, strict=True)))
        if not 0.0 < gain < math.inf:
            continue
        table = {}
        for k in best.free:
            moved = values[k] - best.fitted.values[k]
            # another parameter takes from the knowledge of a value what it moves it by, over its own significance
            table[k] = values[k], math.hypot(best.fitted.sigma(k), moved / math.sqrt(2.0 * gain))
        out.append((math.exp(min(gain, 700.0) - cost) / len(settings), table))
    return out


def _interval(parts: Sequence[tuple[float, float, float]]) -> tuple[float, float]:
    """Ends of the central 95 % of a mixture of normal parts: weight, value and standard deviation each."""
    weight, value, sigma = np.array(parts).T
    weight, sigma = weight / weight.sum(), np.maximum(sigma, 1e-12 * np.abs(value) + 1e-300)
    low, high = float(np.min(value - 5.0 * sigma)), float(np.max(value + 5.0 * sigma))

    def end(p: float) -> float:
        return float(brentq(lambda x: float(weight @ ndtr((x - value) / sigma)) - p, low, high))

    return end(0.025), end(0.975)
