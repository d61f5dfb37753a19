"""The impact benchmark: events a second and wrong events a million of every solver that is installed.

Run: ``python -m benchmarks.model.impacts [--seconds 10] [--flights 100000]``. An event is one landing of the completely
inelastic ball on ``gamma (sin phi + sin c phi)``. The flights are those of job J (`benchmarks.model.kernels`): one of
the 200 flights after the first 100 of each orbit from rest, at random gammas of its diagrams, c = 1, 2, 3; nothing is
chosen to be hard. Each is given as c, gamma and take-off phase, one at a time, and its first landing is asked for.

How wrong is proven: that a flight is free until its landing, by interval bisection with a bound on the relative
acceleration, and below the plate just after it (`benchmarks.model.landings`). A landing that is more than 1e-3 of the
flight time away from a proven one is wrong. Flights shorter than 1e-3, for which the bisection is no proof, are decided
to 60 digits. Tiny flights are asked for as well. Wrong events a million are given with a 95 % interval (Clopper and
Pearson 1934).
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.stats import beta

from benchmarks.model import peers
from benchmarks.model.adversarial import flights_of
from benchmarks.model.every_flight import every_flight
from benchmarks.model.first_landing import first_landing
from benchmarks.model.kernels import GRIDS, J_FLIGHTS, KEPT, TRANSIENT, WRONG, own
from benchmarks.model.landings import is_first
from benchmarks.model.reference import Exact
from model.orbits.exact_ball import IdealBall
from model.tones import Forcing

Known = tuple[int, float, float, float]  # c, gamma, take-off phase, proven flight time
TINY = 60  # hard flights asked of each solver


def flights_of_j(rng: np.random.Generator) -> Iterator[tuple[int, float, float, bool]]:
    """Endless flights of J: c, gamma, take-off phase, whether it starts at a threshold."""
    while True:
        c = int(rng.integers(1, 4))
        gamma = float(rng.uniform(GRIDS[c][0], GRIDS[c][-1]))
        orbit = every_flight(IdealBall(Forcing.superposition(c)), gamma, TRANSIENT, KEPT)
        k = int(rng.integers(orbit.tau.size))  # one of each orbit: those of a cycle are no independent events
        yield c, gamma, float(orbit.phase[k]), bool(orbit.reset[k])


def proven(n: int, rng: np.random.Generator) -> tuple[list[Known], int, int, int]:
    """``n`` flights of J with proven landings, in random order; how many of ours were wrong, too near, to 60 digits."""
    known, wrong, near, digits = [], 0, 0, 0
    for c, gamma, phi0, at in flights_of_j(rng):
        forcing = Forcing.superposition(c)
        landing = first_landing(forcing, gamma, phi0)
        first, tau = is_first(forcing, gamma, phi0, 0.0, at, landing), landing.tau
        if first is None:
            exact = Exact(forcing, gamma)
            start = exact.threshold_near(phi0) if at else phi0
            tau, digits = float(exact.landing(start) - start), digits + 1
            first = int(abs(landing.tau - tau) <= WRONG * tau)
        wrong, near = wrong + (first == 0), near + (first == -1)
        if first == 1:
            known.append((c, gamma, phi0, tau))
        if len(known) + wrong == n:
            return [known[i] for i in rng.permutation(len(known))], wrong, near, digits


def tiny(n: int) -> list[Known]:
    """``n`` flights of 1e-9 to 0.1 in phase, chosen to be hard; ours are proven to 60 digits by `landings`."""
    known: list[Known] = []
    for forcing, gamma, phi0, _, _ in flights_of("tiny", np.random.default_rng(7), per_forcing=2):
        if forcing.harmonic[-1] <= 3 and not any(forcing.phase_rad):
            known.append((int(forcing.harmonic[-1]), gamma, phi0, first_landing(forcing, gamma, phi0).tau))
        if len(known) == n:
            break
    return known


def judged(flight: peers.Flight, known: list[Known], seconds: float) -> tuple[float, int, int]:
    """Events a second, events and wrong events of a solver within ``seconds`` of processor time."""
    for c, gamma, phi0, _ in known[:6]:
        flight(c, gamma, phi0)  # compiled meanwhile
    wrong, done, spent, start = 0, 0, 0.0, time.process_time()
    for c, gamma, phi0, tau in known:
        try:
            found = flight(c, gamma, phi0)
        except (ArithmeticError, RuntimeError, ValueError, AssertionError):  # a solver that gives up gives no landing
            found = math.nan
        wrong, done = wrong + (not abs(found - tau) < WRONG * tau), done + 1
        spent = time.process_time() - start
        if spent > seconds:
            break
    return done / spent, done, wrong


def row(name: str, rate: float, done: int, wrong: int, hard: int) -> str:
    """One row of the table."""
    low = 1e6 * float(beta.ppf(0.025, wrong, done - wrong + 1)) if wrong else 0.0
    high = 1e6 * float(beta.ppf(0.975, wrong + 1, done - wrong)) if wrong < done else 1e6
    return f"| {name} | {rate:,.0f} | {1e6 * wrong / done:,.0f} | {low:,.0f} to {high:,.0f} | {done:,} | {hard} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="processor time of each solver")
    parser.add_argument("--flights", type=int, default=100_000, help="flights whose landings are proven")
    parser.add_argument(
        "--write", type=Path, help="CSV file for the flights and their proven times, for other programs"
    )
    arguments = parser.parse_args()
    known, wrong, near, digits = proven(arguments.flights, np.random.default_rng(1))
    print(
        f"{arguments.flights:,} landings proven, {digits:,} of them to 60 digits; {near} more were too near to prove\n"
    )
    if arguments.write:
        np.savetxt(arguments.write, np.array(known), "%.17g", ",", header="c,gamma,takeoff_phase,tau", comments="")
    print(f"| solver | events/s | wrong a million | 95 % | events | wrong of {TINY} tiny |")
    print("|---|---|---|---|---|---|")
    print(row("this, orbits in its kernel", J_FLIGHTS / own(3)[0], arguments.flights, wrong, 0))

    def alone(c: int, gamma: float, phi0: float) -> float:
        return first_landing(Forcing.superposition(c), gamma, phi0).tau

    found, missing = peers.installed()
    hard = tiny(TINY)
    for name, flight in {"this, one landing a call from Python": alone, **found}.items():
        wrong_tiny = judged(flight, hard, math.inf)[2]
        print(row(name, *judged(flight, known, arguments.seconds), wrong_tiny), flush=True)
    print("\n".join(["", *missing]))


if __name__ == "__main__":
    main()
