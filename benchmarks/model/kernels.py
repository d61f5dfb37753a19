"""The model against its peers, in one run: ``python -m benchmarks.model.kernels [--quick]``.

Job J: bifurcation diagrams for c = 1, 2, 3, 2000 gammas each, 100 transient and 200 kept flights. The kernel's rate is
that of the orbits that `model.surveys.diagram` flies; a diagram itself stops each orbit where it closes. A peer flies
what it can in a few seconds of the same flights, and its J is that rate times 1.8 million. Times are processor seconds
of this process (on a shared machine wall time tells little). Wrong landings are counted on flights whose landing
interval bisection or 60 digits have proven (``tests/model``): tiny ones and grazes.
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.model import peers
from benchmarks.model.adversarial import flights_of
from benchmarks.model.every_flight import every_flight
from model.flight import friction
from model.flight.first_landing import first_landing, take_off_phases, turning_points
from model.flight.records import FrictionRestitution
from model.orbits.attractor import AT_REST, FEW_FLIGHTS, Ball
from model.orbits.exact_ball import FrictionBall, IdealBall
from model.surveys.diagram import diagram
from model.tones import Forcing

GRIDS = {1: np.linspace(0.55, 6, 2000), 2: np.linspace(0.25, 6, 2000), 3: np.linspace(0.12, 6, 2000)}
TRANSIENT, KEPT = 100, 200
J_FLIGHTS = 3 * 2000 * (TRANSIENT + KEPT)
Known = tuple[int, float, float, float]  # c, gamma, take-off phase, proven flight time
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


def flights_of_j(n: int, rng: np.random.Generator) -> list[Known]:
    """``n`` flights out of J: c, gamma, take-off phase, flight time."""
    chosen = []
    for _ in range(n):
        c = int(rng.integers(1, 4))
        gamma = float(rng.choice(GRIDS[c]))
        orbit = every_flight(IdealBall(Forcing.superposition(c)), gamma, 20, 5)
        k = int(rng.integers(5))
        chosen.append((c, gamma, float(orbit.phase[k]), float(orbit.tau[k])))
    return chosen


def traps(kind: str, n: int) -> list[Known]:
    """Tiny or grazing flights of the paper's superposition, c = 1, 2, 3, with proven landings."""
    found = []
    for forcing, gamma, phi0, _, _ in flights_of(kind, np.random.default_rng(7), per_forcing=2):
        c = int(forcing.harmonic[-1])
        if c > 3 or forcing.phase_rad != (0.0,) * len(forcing.phase_rad):
            continue
        landing = first_landing(forcing, gamma, phi0)
        if kind == "tiny" or (landing.flag == 0 and landing.impact_speed > 1e-5):
            found.append((c, gamma, phi0, landing.tau))
        if len(found) == n:
            return found
    return found


def rate_of(flight: peers.Flight, flights: list[Known], seconds: float) -> tuple[float, float]:
    """Flights a second of a peer within a budget of ``seconds``, and its largest error on right landings."""
    for c, gamma, phi0, _ in flights[:3]:
        flight(c, gamma, phi0)  # compile
    errors = []
    start = time.process_time()
    for c, gamma, phi0, tau in itertools.cycle(flights):
        errors.append(abs(flight(c, gamma, phi0) - tau) / tau)
        spent = time.process_time() - start
        if spent > seconds:
            break
    right = [e for e in errors if e < WRONG]
    return len(errors) / spent, max(right, default=math.nan)


def wrong_of(flight: peers.Flight, flights: list[Known]) -> int:
    """How many landings are not the first."""
    return sum(not abs(flight(c, gamma, phi0) - tau) < WRONG * tau for c, gamma, phi0, tau in flights)


def march_rate(seconds: float) -> float:
    """Flights a second of the numpy script over whole rows."""
    n = flown = 0
    start = time.process_time()
    while time.process_time() - start < seconds:
        c = n % 3 + 1
        gammas = GRIDS[c][::10]
        forcing = Forcing.superposition(c)
        phi0 = np.array([take_off_phases(forcing, g).start[0] for g in gammas])
        peers.march_bisect(c, gammas, phi0)
        flown += gammas.size
        n += 1
    return flown / (time.process_time() - start)


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
    parser.add_argument("--quick", action="store_true", help="a tenth of the time for each peer")
    quick = parser.parse_args().quick
    seconds, n, runs = (0.3, 12, 2) if quick else (3.0, 60, 5)
    every_s, short_s, flown = own(runs)
    print(f"J = {J_FLIGHTS / 1e6:.1f} M flights, processor seconds; wrong landings of {n} tiny, {n} grazing flights")
    print(f"{'who':28s} {'flights/s':>12s} {'J':>12s} {'tiny':>5s} {'graze':>6s} {'error':>9s} {'slower':>9s}")
    rate = J_FLIGHTS / every_s
    print(f"{'this, at the rate of its kernel':28s} {rate:12,.0f} {every_s:10.3f} s {0:5d} {0:6d} {'':9s} {1:9.1f}")
    print(f"{'this, the diagram of J':28s} {'':12s} {short_s:10.3f} s   (flies {flown:,} of them)")
    found, missing = peers.installed()
    flights, tiny, grazes = flights_of_j(200, np.random.default_rng(1)), traps("tiny", n), traps("graze", n)
    for name, flight in found.items():
        peer, error = rate_of(flight, flights, seconds)
        wrong = wrong_of(flight, tiny), wrong_of(flight, grazes)
        print(
            f"{name:28s} {peer:12,.0f} {J_FLIGHTS / peer:10.1f} s {wrong[0]:5d} {wrong[1]:6d} {error:9.0e} "
            f"{rate / peer:9,.0f}"
        )
        if name.startswith("heyoka"):
            same = flown / peer
            print(f"{'  with the same shortcut':28s} {'':12s} {same:10.2f} s {'':22s} {same / short_s:9,.0f}")
    peer = march_rate(seconds)
    wrong = tuple(
        wrong_of(lambda c, g, p: float(peers.march_bisect(c, np.array([g]), np.array([p]))[0]), set_)
        for set_ in (tiny, grazes)
    )
    print(
        f"{'numpy march + bisect':28s} {peer:12,.0f} {J_FLIGHTS / peer:10.1f} s {wrong[0]:5d} {wrong[1]:6d} {'':9s} "
        f"{rate / peer:9,.0f}"
    )
    for line in missing:
        print(line)
    friction_part(max(1, runs // 2), seconds)


if __name__ == "__main__":
    main()
