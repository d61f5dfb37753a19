"""Numbers of the field, from the model: docs/results/published.md names the test of each row."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import brentq

from model.orbits.attractor import AT_REST, LockedCycle, State, attractor
from model.orbits.exact_ball import FrictionBall, IdealBall
from model.tones import Forcing

ONE = Forcing.superposition(1)
IDEAL = IdealBall(ONE)
FEIGENBAUM = 4.66920160910299


def least_of_mode(k: int, e: float) -> float:
    """gamma_peak from which a flight of k periods can lock: k pi (1 - e) / (1 + e)."""
    return k * math.pi * (1.0 - e) / (1.0 + e)


def doubling_of_mode(k: int, e: float) -> float:
    """gamma_peak at which it doubles its period (Tufillaro et al. 1986, eq. of the stability boundary)."""
    return math.hypot(least_of_mode(k, e), 2.0 * (1.0 + e * e) / (1.0 + e) ** 2)


def state_of(cycle: LockedCycle) -> State:
    """The first take-off of a cycle."""
    return State(float(cycle.phase[0]), float(cycle.start[0]))


def mode(k: int, e: float, peak: float) -> LockedCycle | None:
    """M(k): the cycle of one flight that lasts k periods, where there is one."""
    sine = least_of_mode(k, e) / peak
    near = State(math.acos(min(sine, 1.0)), 2.0 * math.pi * k * e / (1.0 + e))
    found = FrictionBall(ONE, e0=e).close(0.5 * peak, near, 1)
    return found if found is not None and found.periods == k else None


def followed(
    ball: FrictionBall, gamma: float, cycle: LockedCycle, step: float, lost: Callable[[LockedCycle], bool]
) -> tuple[float, LockedCycle]:
    """The cycle followed in gamma until it is ``lost`` or is no more, and the gamma of the last one."""
    while abs(step) > 1e-13:
        onward = ball.close(gamma + step, state_of(cycle), cycle.tau.size)
        if onward is None or lost(onward):
            step *= 0.5
        else:
            gamma, cycle = gamma + step, onward
    return gamma, cycle


def doublings(e: float, count: int) -> list[float]:
    """gamma_peak of the first ``count`` period doublings of M(1), each where a multiplier is -1."""
    ball, found = FrictionBall(ONE, e0=e), [0.5 * doubling_of_mode(1, e)]
    first = mode(1, e, 1.998 * found[0])
    assert first is not None
    state, step = state_of(first), 0.02 * found[0]
    for k in range(1, count):
        gamma, cycle = found[-1] + step, None
        while cycle is None or abs(cycle.multiplier) > 1.0:  # nearer to the doubling, until the orbit has settled there
            cycle = ball.close(gamma, ball.fly(gamma, state, 20_000).last, 2**k)
            gamma, above = found[-1] + 0.6 * (gamma - found[-1]), gamma
        low, cycle = followed(ball, above, cycle, 0.3 * (above - found[-1]), lambda c: c.multiplier < -1.0)
        near, state = state_of(cycle), state_of(cycle)

        def beyond(gamma: float, near: State = near, n: int = 2**k) -> float:
            double = ball.close(gamma, near, n)
            assert double is not None
            return double.multiplier + 1.0

        found.append(brentq(beyond, low, low + 1e-3 * step, xtol=1e-16, rtol=1e-15) if beyond(low) > 1e-12 else low)
        step = 0.1 * (found[-1] - found[-2])
    return [2.0 * gamma for gamma in found]


# -- Mehta and Luck 1990
def test_the_inelastic_ball_ends_in_a_cycle_from_nearly_every_gamma() -> None:
    """Of 2000 gammas drawn at random no orbit is chaotic: all close, in at most a thousand flights."""
    rng = np.random.default_rng(5)
    kinds = [attractor(IDEAL, gamma, AT_REST, 4096).kind for gamma in rng.uniform(0.5, 6.0, 2000)]
    assert kinds.count("periodic") == 2000


# -- Pieranski and Barberi 1994; Tufillaro et al. 1986
@pytest.mark.parametrize("k", [1, 2, 3])
def test_each_mode_is_born_and_doubles_where_its_formula_says(k: int) -> None:
    """M(k) at e = 0.5: none below k pi (1 - e) / (1 + e), stable from there to the doubling, unstable beyond."""
    least, doubled = least_of_mode(k, 0.5), doubling_of_mode(k, 0.5)
    assert mode(k, 0.5, least * (1.0 - 1e-6)) is None
    born, late, beyond = (
        mode(k, 0.5, peak) for peak in (least * (1 + 1e-6), doubled * (1 - 1e-6), doubled * (1 + 1e-6))
    )
    assert born is not None and late is not None and beyond is not None
    assert abs(born.multiplier) < 1.0 and -1.0 < late.multiplier < -0.999 and beyond.multiplier < -1.0


def test_modes_coexist() -> None:
    """At e = 0.85, gamma_peak 1.1, M(1) doubled, M(1,3), M(2), M(3) and the ball that sticks are all attractors."""
    ball, rng = FrictionBall(ONE, e0=0.85), np.random.default_rng(0)
    seen = set()
    for phase, speed in zip(rng.uniform(0.0, 6.28, 120), rng.uniform(0.0, 30.0, 120), strict=True):
        found = attractor(ball, 0.55, State(phase, speed))
        seen.add((found.flights, found.period) if found.locked else found.kind)
    assert {(2, 2), (3, 3), (1, 2), (1, 3), "chattering"} <= seen


def test_the_satellite_of_three_flights_is_born_in_a_fold_and_doubles() -> None:
    """M(1,3), three flights in three periods at e = 0.5: multiplier 1 at its birth, -1 where it doubles, 1.62 apart."""
    ball, rng, cycle = FrictionBall(ONE, e0=0.5), np.random.default_rng(0), None
    while cycle is None:
        found = attractor(ball, 0.8, State(rng.uniform(0.0, 6.28), rng.uniform(0.0, 6.0)))
        cycle = ball.close(0.8, found.last, 3) if found.locked and (found.flights, found.period) == (3, 3) else None
    birth = followed(ball, 0.8, cycle, -1e-3, lambda c: c.multiplier > 1.0 or c.periods != 3)
    doubled = followed(ball, 0.8, cycle, 1e-3, lambda c: c.multiplier < -1.0 or c.periods != 3)
    assert birth[1].multiplier == pytest.approx(1.0, abs=1e-2)
    assert doubled[1].multiplier == pytest.approx(-1.0, abs=1e-6)
    assert 2.0 * birth[0] < 1.6 < 2.0 * doubled[0]


@pytest.mark.parametrize("e", [0.05, 0.5])
def test_ten_doublings_give_the_feigenbaum_ratio_to_four_digits(e: float) -> None:
    """M(1) doubles ten times, to cycles of 1024 flights; the last ratio of distances is 4.6692."""
    found = np.diff(doublings(e, 10))
    assert found[-2] / found[-1] == pytest.approx(FEIGENBAUM, abs=5e-5)


# -- Barroso, Carneiro and Macau 2009
@pytest.mark.parametrize("e", [0.3, 0.7, 0.9])
def test_speeds_stay_within_their_strip(e: float) -> None:
    """No speed after an impact leaves the strip that the fall between unequal heights widens; it tops the published
    gamma (1 + e) / (1 - e), which is that of the map without it, by no more than that."""
    ball, rng, flown = FrictionBall(ONE, e0=e), np.random.default_rng(1), 0
    for peak in rng.uniform(1.2, 8.0, 1400):
        published, strip = peak * (1.0 + e) / (1.0 - e), 0.0
        for _ in range(1000):
            strip = peak * (1.0 + e) + e * math.hypot(strip, math.sqrt(4.0 * peak))
        path = ball.fly(0.5 * peak, State(rng.uniform(0.0, 6.28), rng.uniform(0.0, published - peak)), 400)
        after = peak * np.cos(path.phase + path.tau) + e * path.speed
        assert np.abs(after).max() <= strip * (1.0 + 1e-12)
        assert strip / published < 1.35
        flown += path.tau.size
    assert flown > 50_000
