"""Classification of the flights of a step: n-cycle, irregular or undecided; modes; forbidden bands; changes.

Every class comes with its statistic, and a step with too few flights is undecided.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import pdtr

from analysis.flights.table import FlightFlag, Flights
from analysis.plate.motion import StepPlate
from kernels.arrays import Floats

MAX_CYCLE = 8  # flights of the longest cycle looked for
MIN_REPEATS = 3  # cycles needed
MIN_IRREGULAR = MIN_REPEATS * MAX_CYCLE // 2  # flights needed to call a step irregular


@dataclass(frozen=True)
class StepClass:
    """Class of one step."""

    step: int
    # ``rest`` (no flights), ``cycle``, ``irregular`` or ``undecided``
    kind: Literal["rest", "cycle", "irregular", "undecided"]
    n: int  # flights of the cycle; 0 otherwise
    locked: bool  # a 1-cycle whose flight lasts a whole number of forcing periods
    flights: int  # true flights in the hold
    double_hits: int  # counted separately: they are not part of the cycle
    repeat_s: float  # median change of a flight time after one cycle of the best n, per flight; NaN without flights
    expected_s: float  # the same from only the measurement's uncertainty
    spread_s: float  # the same between flights taken at random
    modes: int  # peaks in the distribution of flight times
    mean_s: float  # mean flight time

    @property
    def label(self) -> str:
        """Label for tables."""
        if self.kind != "cycle":
            return self.kind
        return f"{self.n}-cycle{' locked' if self.locked else ''}"


def classify(flights: Flights) -> tuple[StepClass, ...]:
    """Class of every step of the recording."""
    return tuple(_classify_step(flights, step) for step in range(len(flights.plate.steps)))


def _classify_step(flights: Flights, step: int) -> StepClass:
    """Class of one step."""
    poor = FlightFlag.FALSE | FlightFlag.SETTLING | FlightFlag.CUT | FlightFlag.GAP
    chosen = (flights.step == step) & ~flights.has(poor)
    rebound = flights.has(FlightFlag.DOUBLE_HIT)
    doubles = int((chosen & rebound).sum())
    chosen &= ~rebound  # a cycle with double hits is still that cycle
    tau, sigma = flights.duration_s[chosen], flights.uncertainty_s[chosen]
    fitted = flights.plate.steps[step]
    period = 1.0 / fitted.frequency_hz if fitted is not None else float("nan")
    nan = float("nan")
    kind: Literal["rest", "cycle", "irregular", "undecided"] = "undecided"
    if tau.size == 0:
        seen = fitted is not None and flights.edges.levels is not None
        kind = "rest" if seen and fitted is not None and not _in_air(flights, fitted) else "undecided"
        return StepClass(step, kind, 0, False, 0, doubles, nan, nan, nan, 0, nan)
    own = float(np.median(sigma))
    pairs = np.abs(tau[:, None] - tau[None, :])[np.triu_indices(tau.size, 1)]
    spread = float(np.median(pairs)) if pairs.size else nan
    # smoothed over 2 % of a period, or three uncertainties: narrower, noise would make modes
    mean, modes = float(tau.mean()), count_modes(tau, max(0.02 * period, 3.0 * own))
    # median change over n flights, per flight; unknown below `MIN_REPEATS` cycles
    cycles = range(1, MAX_CYCLE + 1)
    changes = [np.median(np.abs(tau[n:] - tau[:-n])) if tau.size >= MIN_REPEATS * n else nan for n in cycles]
    repeats = np.array(changes) / np.sqrt(2.0)
    # flights repeat within five of their uncertainties, and within 0.4 % of a period whatever is stated
    allowed = max(5.0 * own, 0.004 * period)
    n = next((k + 1 for k, r in enumerate(repeats) if r < allowed), 0)
    best = float(np.nanmin(repeats)) if np.isfinite(repeats).any() else nan
    if n:
        kind, best = "cycle", float(repeats[n - 1])
    # nothing repeats: the best change is a quarter of the flights' own spread, and twice what a cycle may change
    elif tau.size >= MIN_IRREGULAR and best > 0.25 * spread and best > 2.0 * allowed:
        kind = "irregular"
    whole = mean / period
    # a locked 1-cycle flies a whole number of periods
    locked = n == 1 and abs(whole - round(whole)) < 0.001 and round(whole) > 0
    # the median change from flight to flight is sqrt(2) * 0.6745 = 0.954 of the uncertainty of one
    return StepClass(step, kind, n, locked, tau.size, doubles, best, 0.954 * own, spread, modes, mean)


def _in_air(flights: Flights, plate: StepPlate) -> bool:
    """Whether the contact circuit was open in part of the hold (a landing was missed, then)."""
    rate_hz = flights.plate.rate_hz
    begin, end = plate.first_sample / rate_hz, plate.last_sample / rate_hz
    true = ~flights.has(FlightFlag.FALSE)
    return bool(np.any(true & (flights.takeoff_s < end) & (flights.landing_s > begin)))


def count_modes(tau: Floats, width: float) -> int:
    """Peaks of the smoothed distribution of flight times that rise by a tenth of the highest above their valleys."""
    if tau.size == 0:
        return 0
    grid = np.linspace(tau.min() - 4 * width, tau.max() + 4 * width, 600)
    density = np.exp(-0.5 * ((grid[:, None] - tau[None, :]) / width) ** 2).sum(axis=1)
    peaks = np.flatnonzero((density[1:-1] > density[:-2]) & (density[1:-1] >= density[2:])) + 1
    modes = 0
    valley = 0.0
    for i, k in enumerate(peaks):
        after = density[k : peaks[i + 1]].min() if i + 1 < peaks.size else 0.0
        # a mode rises above its valleys by a tenth of the highest
        if density[k] - max(valley, after) > 0.1 * density.max():
            modes += 1
        valley = after
    return modes


@dataclass(frozen=True)
class BandTest:
    """Flights in a band that the model forbids."""

    step: int
    low_s: float
    high_s: float
    observed: int  # flights inside, by more than their uncertainty
    expected: float  # flights expected from those just below and above the band, if it were not forbidden
    p_value: float  # chance of so few or fewer


def band_test(flights: Flights, step: int, low_s: float, high_s: float) -> BandTest:
    """Poisson test of the flights in a forbidden band against its neighbourhood (half its width on either side)."""
    chosen = (flights.step == step) & flights.good()
    tau, sigma = flights.duration_s[chosen], flights.uncertainty_s[chosen]
    half = 0.5 * (high_s - low_s)
    inside = int(((tau > low_s + 2.0 * sigma) & (tau < high_s - 2.0 * sigma)).sum())
    outside = int(((tau > low_s - half) & (tau < high_s + half)).sum()) - inside
    return BandTest(step, low_s, high_s, inside, float(outside), float(pdtr(inside, outside)))


@dataclass(frozen=True)
class Change:
    """A change of the measured motion between two neighbouring steps, in the order of the run."""

    type: str
    before: StepClass
    after: StepClass
    gamma_before: float
    gamma_after: float


def changes(classes: tuple[StepClass, ...], gammas: Floats) -> tuple[Change, ...]:
    """Typed changes along the run; undecided steps are skipped, which widens the bracket."""
    out = []
    last: tuple[StepClass, float] | None = None
    for own, gamma in zip(classes, gammas, strict=True):
        if own.kind == "undecided" or not np.isfinite(gamma):
            continue
        if last is not None and own.label != last[0].label:
            out.append(Change(_type(last[0], own), last[0], own, last[1], float(gamma)))
        last = own, float(gamma)
    return tuple(out)


def _type(before: StepClass, after: StepClass) -> str:
    """Type of a change, as in `model.bifurcations`."""
    if before.kind == "rest":
        return "take-off"
    if after.kind == "rest":
        return "landing for good"
    if before.kind == "cycle" and after.kind == "cycle":
        if before.n == after.n == 1:
            return "lock" if after.locked else "unlock"
        if after.n == 2 * before.n:
            return "period doubling"
        if before.n == 2 * after.n:
            return "period halving"
        return "other cycle"
    return "to irregular" if after.kind == "irregular" else "to a cycle"
