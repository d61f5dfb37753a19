"""Job J, and flights with friction: ``python -m benchmarks.model.kernels [--quick]``; other solvers: `impacts`.

Job J: bifurcation diagrams for c = 1, 2, 3, 2000 gammas each, 100 transient and 200 kept flights. The kernel's rate is
that of the orbits that `model.surveys.diagram` flies; a diagram itself stops each orbit where it closes. Times are
processor seconds of this process (on a shared machine wall time tells little).
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from model.flight import friction
from model.flight.numerics import FrictionRestitution
from model.flight.windows import turning_points
from model.orbits.attractor import AT_REST, FEW_FLIGHTS, Ball
from model.orbits.exact_ball import FrictionBall, IdealBall
from model.surveys.diagram import diagram
from model.tones import Forcing

GRIDS = {1: np.linspace(0.55, 6, 2000), 2: np.linspace(0.25, 6, 2000), 3: np.linspace(0.12, 6, 2000)}
TRANSIENT, KEPT = 100, 200
J_FLIGHTS = 3 * 2000 * (TRANSIENT + KEPT)
WRONG = 1e-3  # of the flight time: another landing, not a rounded one


def best_of(n: int, job: Callable[[], object]) -> float:
    """The least processor time of ``n`` runs, s."""
    times = []
    for _ in range(n):
        start = time.process_time()
        job()
        times.append(time.process_time() - start)
    return min(times)


def flown_until_closed(ball: Ball, gammas: np.ndarray, most: int) -> int:
    """Flights that the kernel flies from rest at each gamma, until the orbit closes or ``most`` are flown."""
    return sum(ball.fly(float(gamma), AT_REST, most).tau.size for gamma in gammas)


def rate_alone(ball: IdealBall | FrictionBall, gammas: np.ndarray, n: int) -> float:
    """Flights a second of the kernel, orbits from rest at every gamma flown until they close."""
    most = TRANSIENT + KEPT
    ball.itinerary_codes(gammas[-3:], most)
    return flown_until_closed(ball, gammas, most) / best_of(n, lambda: ball.itinerary_codes(gammas, most))


def own(n: int) -> tuple[float, float, int]:
    """Seconds of J with every flight flown and as the diagram of its attractors, and the flights the latter flies."""
    every_s = diagram_s = 0.0
    flown = 0
    for c, gammas in GRIDS.items():
        ball = IdealBall(Forcing.superposition(c))
        every_s += gammas.size * (TRANSIENT + KEPT) / rate_alone(ball, gammas, n)
        diagram(ball, gammas[-3:])
        diagram_s += best_of(n, lambda b=ball, g=gammas: diagram(b, g))
        flown += flown_until_closed(ball, gammas, FEW_FLIGHTS)
    return every_s, diagram_s, flown


def friction_solve_ivp(c: int, gamma: float, law: FrictionRestitution, phi0: float) -> tuple[float, float]:
    """One flight with friction from rest at a threshold by solve_ivp with events: ``(tau, impact speed)``."""
    phi, h, rising = phi0, 0.0, True
    for _ in range(100):
        level = 1 + law.mu_up if rising else 1 - law.mu_down

        def motion(t: float, y: np.ndarray, level: float = level) -> tuple[float, float]:
            return y[1], gamma * (math.sin(t) + c * c * math.sin(c * t)) - level

        def stops(t: float, y: np.ndarray) -> float:
            return float(y[1])

        def lands(t: float, y: np.ndarray) -> float:
            return float(y[0])

        stops.terminal = lands.terminal = True  # type: ignore[attr-defined]
        stops.direction, lands.direction = (-1 if rising else 1), -1  # type: ignore[attr-defined]
        done = solve_ivp(motion, (phi, phi + 100), [h, 0.0], rtol=1e-9, atol=1e-12, events=(stops, lands))
        if not rising and done.t_events[1].size:
            return float(done.t_events[1][0] - phi0), float(-done.y_events[1][0][1])
        phi, h = float(done.t_events[0][0]), float(done.y_events[0][0][0])
        pull = gamma * (math.sin(phi) + c * c * math.sin(c * phi)) - 1
        while -law.mu_down <= pull <= law.mu_up:  # hang: step until the pull wins
            phi += 1e-4
            pull = gamma * (math.sin(phi) + c * c * math.sin(c * phi)) - 1
        rising = pull > 0
    return math.nan, math.nan


def friction_part(n: int, seconds: float) -> None:
    """Friction and restitution: rates at every c, and solve_ivp beside them."""
    print("\nFriction 0.3 and restitution 0.514 (every bounce flown until the chatter is summed)")
    for c, gammas in GRIDS.items():
        forcing = Forcing.superposition(c)
        line = [f"c = {c}:"]
        for ball in (FrictionBall(forcing, 0.3, 0.3), FrictionBall(forcing, 0.3, 0.3, 0.514)):
            line.append(f"e = {ball.e0}: {rate_alone(ball, gammas[::4], n) / 1e6:.2f} M flights/s")
        law, rng, errors = FrictionRestitution(0.3, 0.3), np.random.default_rng(2), []
        start = time.process_time()
        while time.process_time() - start < seconds:
            gamma = float(rng.choice(gammas[500:]))
            tables = friction.edge_tables(forcing.tones, turning_points(forcing), gamma, law)
            if tables.n_up == 0:
                continue
            tau, speed = friction_solve_ivp(c, gamma, law, float(tables.up[0]))
            exact = friction.land_with_friction(forcing.tones, gamma, tables, law, tables.up[0], 0.0, True)
            errors.append(max(abs(tau - exact[0]) / exact[0], abs(speed - exact[2])))
        rate = len(errors) / (time.process_time() - start)
        wrong = sum(not e < WRONG for e in errors)
        line.append(f"solve_ivp 1e-9: {rate:.0f} flights/s, {wrong} of {len(errors)} wrong")
        print("  " + "  ".join(line))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the time for the solver with friction")
    quick = parser.parse_args().quick
    seconds, runs = (0.3, 2) if quick else (3.0, 5)
    every_s, short_s, flown = own(runs)
    print(f"J = {J_FLIGHTS / 1e6:.1f} M flights, processor seconds")
    print(f"every flight flown: {J_FLIGHTS / every_s:,.0f} flights/s, J {every_s:.3f} s")
    print(f"the diagram of J: {short_s:.3f} s (flies {flown:,} of them)")
    friction_part(max(1, runs // 2), seconds)


if __name__ == "__main__":
    main()
