"""Wrong landings among adversarial flights: ``python -m benchmarks.model.landings [--flights 100000] [--digits 200]``.

Every flight long enough is proven free until its landing by interval bisection (``benchmarks/model/reference.py``);
tiny and threshold flights, and a sample of the others, are held against 60 digits.
"""

from __future__ import annotations

import argparse
import itertools
from collections import Counter

import mpmath as mp
import numpy as np

from benchmarks.model.adversarial import HEIGHT_ROUNDING, KINDS, allowed, flights_of
from benchmarks.model.first_landing import FlightFlag, Landing, first_landing
from benchmarks.model.reference import Exact, lifted_until, stays_above
from model.tones import Forcing, relative_height


def is_first(forcing: Forcing, gamma: float, phi0: float, v0: float, at: bool, landing: Landing) -> int | None:
    """Whether a landing is proven the first: 1, or 0 where it is proven wrong, -1 too near to say; None: too short."""
    tau = landing.tau
    margin = 1e-7 + 2 * allowed(gamma, forcing, tau, landing.impact_speed)
    lifted = lifted_until(forcing, gamma, phi0, v0, at)
    if tau < 1e-3 or lifted == 0.0:
        return None
    noise = 2 * HEIGHT_ROUNDING * (gamma * forcing.tones[:, 1].sum() * (1 + 7 * tau) + tau**2)
    free = stays_above(forcing.tones, gamma, phi0, v0, min(lifted, tau - margin), tau - margin, noise)
    late = bool(relative_height(forcing, gamma, phi0, tau + margin, v0) > noise)
    return 0 if free == 0 or lifted > tau + margin or late else int(free)


def proven(kind: str, n: int, seed: int) -> tuple[int, int, int, int]:
    """``(checked, wrong, undecided, too near to prove)`` of ``n`` flights by interval bisection."""
    said: Counter[int | str | None] = Counter()
    for forcing, gamma, phi0, v0, at in itertools.islice(flights_of(kind, np.random.default_rng(seed)), n):
        landing = first_landing(forcing, gamma, phi0, v0)
        undecided = landing.flag & FlightFlag.UNDECIDED
        said["undecided" if undecided else is_first(forcing, gamma, phi0, v0, at, landing)] += 1
    return said[1] + said[0] + said[-1], said[0], said["undecided"], said[-1]


def digits(kind: str, n: int, seed: int) -> tuple[int, int, float]:
    """``(checked, wrong, largest error where the impact is faster than 1e-3)`` of ``n`` flights to 60 digits."""
    wrong, largest, checked = 0, 0.0, 0
    for forcing, gamma, phi0, v0, at in itertools.islice(flights_of(kind, np.random.default_rng(seed), 4), n):
        landing = first_landing(forcing, gamma, phi0, v0)
        if landing.flag & FlightFlag.UNDECIDED:
            continue
        exact = Exact(forcing, gamma)
        start = exact.threshold_near(phi0) if at else mp.mpf(phi0)
        tau = float(exact.landing(start, v0) - start)
        slack = 1e-9 if kind == "threshold" else 0.0
        wrong += abs(landing.tau - tau) > slack + allowed(gamma, forcing, tau, landing.impact_speed)
        if landing.impact_speed > 1e-3:
            largest = max(largest, abs(landing.tau - tau))
        checked += 1
    return checked, wrong, largest


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=100_000)
    parser.add_argument("--digits", type=int, default=200, help="flights of each kind to 60 digits")
    arguments = parser.parse_args()
    print("interval bisection: kind, checked, wrong, flagged undecidable, too near to prove")
    for kind in ("graze", "bounce", "long", "tones", "take-off", "threshold", "tiny"):
        print("  ", kind, *proven(kind, arguments.flights // 7, 3), flush=True)
    print("60 digits: kind, checked, wrong, largest error at impacts faster than 1e-3")
    for kind in KINDS:
        print("  ", kind, *digits(kind, arguments.digits if kind != "long" else arguments.digits // 10, 5), flush=True)


if __name__ == "__main__":
    main()
