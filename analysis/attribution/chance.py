"""Null distribution of the best gain: what the best of all candidates gains by chance on such a run.

Scores of all candidates are drawn jointly, so that candidates alike count once and unlike ones each. Two kinds of
draws are made: normal scores with the covariance that the uncertainties give (parametric bootstrap), and the measured
scores of whole steps with random signs (wild bootstrap by blocks), which keeps what the uncertainties do not know. The
less favourable of both probabilities counts.

References
----------
T. Hothorn, F. Bretz and P. Westfall, Biom. J. 50, 346 (2008): the maximum of correlated tests.
A. C. Cameron, J. B. Gelbach and D. L. Miller, Rev. Econ. Stat. 90, 414 (2008): wild bootstrap by clusters.
Decision 131.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.attribution.candidates import Candidate, null_value_of, parameter_of
from analysis.attribution.hypothesis import ChanceTest, Hypothesis
from analysis.linear_algebra import eigh, pinv
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.noise_model import robust_loss, robust_weight
from analysis.residuals.values import ParameterId
from analysis.thresholds import LEAST_INFORMATION
from kernels.arrays import Floats, Integers

Columns = tuple[int, ...]
Place = tuple[ParameterId, tuple[tuple[ParameterId, float], ...]]  # a size, with the shapes it is tried at

DRAWS = 4999


@dataclass(frozen=True)
class ScoreSpace:
    """Derivatives of whitened residuals to the sizes of all candidates, less what nuisances can follow."""

    columns: Floats  # projected derivatives, (n, k), n residuals
    information: Floats  # covariance of the scores, (k, k), each column of unit information
    groups: tuple[Columns, ...]  # columns of each candidate, at one setting of its shape parameters
    signs: Integers  # of each column: 1 or -1 where its parameter can move one way only, 0 where it can move both ways

    @classmethod
    def of(
        cls,
        nuisances: Floats,
        stiffness: Floats,
        candidates: Floats,
        groups: Sequence[Columns],
        signs: Sequence[int],
        weight: Floats | None = None,
    ) -> ScoreSpace:
        """Score space of candidates beside nuisances.

        Parameters
        ----------
        nuisances, candidates
            Whitened derivatives, (n, q) and (n, k).
        stiffness
            Inverse variances of the nuisances' priors, (q,); 0 where nothing is known.
        groups, signs
            See the attributes; columns without information are left out.
        weight
            Weight of each residual, (n,); one where not given.
        """
        weight = np.ones(len(candidates)) if weight is None else weight
        weighted = nuisances * weight[:, None]
        normal = weighted.T @ nuisances + np.diag(stiffness)
        follow = pinv(normal, rcond=1e-12, hermitian=True) @ (weighted.T @ candidates)
        columns = candidates - nuisances @ follow
        information = (candidates * weight[:, None]).T @ columns
        return cls.scaled(columns, information, weight @ candidates**2, groups, signs)

    @classmethod
    def scaled(
        cls,
        columns: Floats,
        information: Floats,
        whole: Floats,
        groups: Sequence[Columns],
        signs: Sequence[int] | Integers,
    ) -> ScoreSpace:
        """Score space of columns (n, k) and their information (k, k), both less what nuisances can follow.

        ``whole`` is the information of each column before that, (k,).
        """
        scale = unit_scale(np.diag(information), whole)
        return cls(
            columns * scale,
            scale[:, None] * 0.5 * (information + information.T) * scale,
            tuple(shown for g in groups if (shown := tuple(j for j in g if scale[j] > 0.0))),
            np.asarray(signs, dtype=np.int64),
        )

    def best_gains(self, scores: Floats) -> Floats:
        """Gain of the best candidate for each row of scores, (draws, k), nats."""
        best = np.zeros(len(scores))
        for group in self.groups:
            u = scores[:, group]
            if len(group) == 1:
                j = group[0]
                # a size that cannot be negative gains by scores of one sign only: half of the draws gain nothing
                x = u[:, 0] if self.signs[j] == 0 else np.maximum(self.signs[j] * u[:, 0], 0.0)
                gain = 0.5 * x * x
            else:
                inverse = pinv(self.information[np.ix_(group, group)], rcond=1e-8, hermitian=True)
                gain = 0.5 * np.einsum("ij,jk,ik->i", u, inverse, u)
            best = np.maximum(best, gain)
        return best

    def by_noise(self, rng: np.random.Generator, draws: int = DRAWS) -> Floats:
        """Best gains of normal noise of the stated covariance, (draws,)."""
        # candidates alike make it singular, where Cholesky's factor does not exist
        values, vectors = eigh(self.information)
        root = vectors * np.sqrt(np.clip(values, 0.0, None))
        return self.best_gains(rng.standard_normal((draws, len(values))) @ root.T)

    def by_steps(self, scored: Floats, step: Integers, rng: np.random.Generator, draws: int = DRAWS) -> Floats:
        """Best gains of residuals whose steps get random signs, (draws,).

        Parameters
        ----------
        scored
            Residuals times their robust weights, (n,).
        step
            Step of each, (n,).
        rng, draws
            Source and number of draws.
        """
        m = int(step.max(initial=-1)) + 1
        # residuals of a step share the plate's errors: the step is the replicate, and has one sign
        parts = np.zeros((m, self.columns.shape[1]))
        np.add.at(parts, step, self.columns * scored[:, None])
        return self.best_gains(rng.choice((-1.0, 1.0), (draws, m)) @ parts)


def unit_scale(own: Floats, whole: Floats) -> Floats:
    """Scale that gives each column unit information, (k,); 0 where nuisances can follow nearly all of it.

    ``own`` and ``whole`` are the information of each column beyond the nuisances, and with them known, (k,).
    """
    shown = (own > LEAST_INFORMATION) & (own > LEAST_INFORMATION * whole)
    return np.where(shown, 1.0 / np.sqrt(np.where(shown, own, 1.0)), 0.0)


def probability_of(gain: float, kinds: Sequence[Floats]) -> float:
    """Probability of so large a gain by chance, the greatest of several kinds of draws; at least 1 / (draws + 1)."""
    # the gain itself counts as a draw, so that no probability is 0
    return max((1.0 + int(np.sum(draws >= gain))) / (len(draws) + 1.0) for draws in kinds)


def generator_of(model: ForwardModel) -> np.random.Generator:
    """Random numbers that the recording's content fixes: landings to the nanosecond."""
    landing = np.nan_to_num(1e9 * model.observations.measured.landing_s).round().astype("<i8")
    return np.random.default_rng(np.frombuffer(hashlib.sha256(landing.tobytes()).digest(), dtype="<u4"))


class ChanceGains:
    """Probability that the best of all candidates gains so much by chance, beside one hypothesis.

    Parameters
    ----------
    best
        The hypothesis that is added to.
    options
        All candidates of the round.
    rng
        Source of the draws.
    draws
        Number of draws of each kind.
    """

    def __init__(
        self, best: Hypothesis, options: Sequence[Candidate], rng: np.random.Generator, draws: int = DRAWS
    ) -> None:
        self.best, self.options, self.rng, self.draws = best, options, rng, draws
        self._drawn: dict[int, tuple[Hypothesis, Floats, Floats]] = {}

    def of_refit(self, best: Hypothesis) -> ChanceGains:
        """The same of another fit of the hypothesis; derivatives are those of the first."""
        other = ChanceGains(best, self.options, self.rng, self.draws)
        other._slopes = self._slopes
        return other

    def p(self, x: Hypothesis) -> float:
        """Probability of the gain of ``x``, at least ``1 / (draws + 1)``.

        Weights, and the residuals whose steps get random signs, are those that ``x`` leaves: its own signal is no
        noise.
        """
        return probability_of(fitted_gain(self.best, x), self._gains(x))

    def test(self, accepted: Hypothesis | None, found: Sequence[Hypothesis], p: float) -> ChanceTest | None:
        """The accepted candidate, or the one of greatest gain, and the gain that chance exceeds with probability ``p``.

        None where there is no candidate.
        """
        x = accepted or max(found, key=lambda x: fitted_gain(self.best, x), default=None)
        if x is None:
            return None
        critical = max(float(np.quantile(gains, 1.0 - p)) for gains in self._gains(x))
        return ChanceTest(x.candidates[-1].names, fitted_gain(self.best, x), self.p(x), critical, accepted is not None)

    def _gains(self, x: Hypothesis) -> tuple[Floats, Floats]:
        """Best gains of normal noise, and of the steps' residuals under ``x`` with random signs."""
        if id(x) not in self._drawn:
            fitted, state, whitener = self.best.fitted, self.best.fitted.state, x.whitener
            z = whitener.white_all(x.fitted.raw)
            weight = np.where(state.mask, robust_weight(z, whitener.odds), 0.0)
            groups, signs, bare = self._slopes
            known, fresh = (whitener.white_slopes(slopes, fitted.raw) for slopes in (fitted.bare, bare))
            space = ScoreSpace.of(known, state.inverse**2, fresh, groups, signs, weight)
            by_steps = space.by_steps(weight * z, state.step, self.rng, self.draws)
            self._drawn[id(x)] = x, space.by_noise(self.rng, self.draws), by_steps
        return self._drawn[id(x)][1:]

    @functools.cached_property
    def _slopes(self) -> tuple[list[Columns], list[int], Floats]:
        """Columns of each candidate, their signs, and derivatives of the bare residuals."""
        at: dict[Place, int] = {}
        groups = [tuple(at.setdefault(place, len(at)) for place in group) for group in places(self.options, self.best)]
        fitted = self.best.fitted
        bare = np.zeros((len(fitted.raw), len(at)))
        for (key, shapes), j in at.items():
            bare[:, j] = fitted.fitter.slope(fitted, key, dict(shapes))
        return groups, [_sign(key) for key, _ in at], bare


def fitted_gain(best: Hypothesis, x: Hypothesis) -> float:
    """Gain of one fit over another on the steps of the fit, priors included, each with its own weights, nats."""
    return _fitted_loss(best) - _fitted_loss(x)


def _fitted_loss(x: Hypothesis) -> float:
    whitener, fitted = x.whitener, x.fitted
    logs = np.concatenate([whitener.weights.log, whitener.plate_log])
    loss = robust_loss(whitener.white_all(fitted.raw), whitener.odds) + logs
    return float(np.sum(loss[fitted.state.mask])) + fitted.prior_penalty


def places(options: Sequence[Candidate], best: Hypothesis) -> list[tuple[Place, ...]]:
    """Sizes that each candidate frees beside ``best``, at each setting of its shape parameters."""
    out: dict[tuple[Place, ...], None] = {}
    for candidate in options:
        free = [k for k in candidate.free if k not in best.free]
        sizes, shapes = [k for k in free if not parameter_of(k).is_shape], [k for k in free if parameter_of(k).is_shape]
        for start in candidate.starts or ({},):
            setting = tuple((k, start.get(k, null_value_of(k))) for k in shapes)
            out[tuple((k, setting) for k in sizes)] = None
    return [group for group in out if group]


def _sign(key: ParameterId) -> int:
    """The direction in which a parameter can leave its null value; 0 for both."""
    q = parameter_of(key)
    return int(q.null_value <= q.low) - int(q.null_value >= q.high)


def probability(test: ChanceTest) -> str:
    """How likely a candidate gains so much by chance, in words; where no draw did, the bound."""
    return f"p < {test.p:.1g}" if test.p < 1.5 / DRAWS else f"p = {test.p:.2g}"


def best_by_chance(tests: Sequence[ChanceTest], depth: int) -> str:
    """The best candidate of the last round against chance, in words; empty where the round had none that gains."""
    if len(tests) <= depth or not tests[depth].gain > 1.0:
        return ""
    best = tests[depth]
    return f" (the best, {' + '.join(best.names)}, {best.gain:.1f} nats in the fit: {probability(best)} by chance)"
