"""How plate tones were measured, and what a plate mode adds to them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from kernels.arrays import Complexes, Floats, Integers


class Projected(Protocol):
    """What a plate mode adds to the measured tones: see `model.integrator.one_step.Predicted`."""

    @property
    def mode_amplitudes(self) -> Complexes: ...
    @property
    def projection(self) -> Complexes: ...
    @property
    def observed_s(self) -> Floats: ...


class ToneProbe(Protocol):
    """The time intervals and frequencies at which plate tones were measured; projects a mode's motion on them.

    Attributes
    ----------
    first
        Where each step's intervals begin in ``span_s``, and where the last ends, (m + 1,).
    span_s
        Intervals of time, in order within a step, (r, 2).
    omega_radps
        Angular frequencies, (m, l).
    """

    @property
    def first(self) -> Integers: ...
    @property
    def span_s(self) -> Floats: ...
    @property
    def omega_radps(self) -> Floats: ...

    def of_tones(self, projection: Complexes, observed_s: Floats) -> Complexes:
        """Contribution to the plate's tones (m, k), m/s^2, of integrals (r, l) of ``acceleration exp(-i w t)``."""
        ...


@dataclass(frozen=True)
class ContinuousProbe:
    """Tones measured all the time, far apart from one another."""

    omega_radps: Floats

    @property
    def first(self) -> Integers:
        return np.arange(len(self.omega_radps) + 1)

    @property
    def span_s(self) -> Floats:
        return np.tile([-np.inf, np.inf], (len(self.omega_radps), 1))

    def of_tones(self, projection: Complexes, observed_s: Floats) -> Complexes:
        return np.asarray(2.0 * projection / np.where(observed_s > 0.0, observed_s, 1.0)[:, None])
