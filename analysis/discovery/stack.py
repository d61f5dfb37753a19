"""Residuals of take-offs and landings in one stack, with their robust widths and losses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.noise_model import excess_noise, log_odds, robust_loss
from analysis.residuals.noise.uncertainty import uncertainty_at
from analysis.residuals.values import Values
from analysis.thresholds import FARTHEST_PERIODS, LEAST_EXCESS_S
from kernels.arrays import Bools, Floats, Integers


@dataclass(frozen=True)
class StackedResiduals:
    """Openings, then landings, of the judged flights: arrays (k,).

    Attributes
    ----------
    event
        The flight.
    first
        True for openings.
    sigma_s, period_s
        Uncertainty without excess, and the forcing's period.
    train
        True where a fit may look.
    """

    event: Integers
    first: Bools
    sigma_s: Floats
    period_s: Floats
    train: Bools

    @classmethod
    def of(cls, model: ForwardModel, values: Values, train: Bools) -> StackedResiduals:
        """Residuals' stack of a forward model at ``values``; ``train`` by step, (m,)."""
        observations, u = model.observations, uncertainty_at(model, values)
        opening, landing = np.flatnonzero(model.from_rest), np.flatnonzero(observations.scored)
        event = np.concatenate([opening, landing])
        step = observations.measured.step[event]
        sigma = np.concatenate([u.opening_total_s[opening], u.landing_total_s[landing]])
        return cls(
            event, np.arange(len(event)) < len(opening), sigma, observations.steps.plate.period_s[step], train[step]
        )

    def landings(self) -> StackedResiduals:
        """Only the landings: unlike openings they do not depend on the contact's gap, which a wrong model bends."""
        rows = ~self.first
        return StackedResiduals(
            self.event[rows], self.first[rows], self.sigma_s[rows], self.period_s[rows], self.train[rows]
        )

    def without(self, rows: Bools) -> StackedResiduals:
        """The same with a fit that may not look at ``rows`` (k,)."""
        return replace(self, train=self.train & ~rows)

    def residuals(self, model: ForwardModel, values: Values) -> Floats:
        """Residuals of this stack at ``values``, clipped at `FARTHEST_PERIODS`."""
        p, measured = model.predict(values), model.observations.measured
        return self.cut(measured.opening_s - p.opening_s, measured.landing_s - p.landing_s)

    def widths(self, r: Floats, tail: float = 0.5) -> Floats:
        """Uncertainty with an excess of each channel that fits the residual at the quantile ``tail``."""
        out = np.empty_like(r)
        for rows in (self.first, ~self.first):
            look = rows & self.train
            size = float(np.quantile(np.abs(r[look]), tail) / ndtri(0.5 + 0.5 * tail)) if look.any() else 0.0
            usual = float(np.median(self.sigma_s[look])) if look.any() else 0.0
            out[rows] = np.hypot(self.sigma_s[rows], max(np.sqrt(max(size**2 - usual**2, 0.0)), LEAST_EXCESS_S))
        return out

    def by_step(self, r: Floats, step: Integers, m: int) -> Floats:
        """Loss of each of ``m`` steps, each excess at its best on the steps of the fit; ``step`` by flight."""
        out = np.zeros(m)
        for rows in (self.first, ~self.first):
            look = rows & self.train
            if look.any():
                excess = excess_noise(r[look], self.sigma_s[look], self.period_s[look])[0]
                total = np.hypot(self.sigma_s[rows], excess)
                loss = robust_loss(r[rows] / total, log_odds(total, self.period_s[rows])) + np.log(total)
                out += np.bincount(step[self.event[rows]], loss, minlength=m)
        return out

    def cut(self, opening_s: Floats, landing_s: Floats) -> Floats:
        """Residuals of this stack, from those of all flights (n,), cut at the farthest."""
        both = np.where(self.first, opening_s[self.event], landing_s[self.event])
        cap = FARTHEST_PERIODS * self.period_s
        return np.asarray(np.clip(np.where(np.isfinite(both), both, cap), -cap, cap))

    def loss(self, r: Floats) -> float:
        """Loss of what is trained on, each channel's excess at its best."""
        total = 0.0
        for rows in (self.first & self.train, ~self.first & self.train):
            total += excess_noise(r[rows], self.sigma_s[rows], self.period_s[rows])[1]
        return total
