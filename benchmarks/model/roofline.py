"""What a flight costs and what the core can do: ``python -m benchmarks.model.roofline [--before TREE]``.

Prints the core's fused multiply-adds a second (a small loop in lanes), the operations of an ideal flight, counted by
flying flights of job J (`benchmarks.model.kernels`) with numbers that count, the rates of the kernels with every flight
flown, and the time of J's diagrams and of a survey of gamma, friction and restitution. Processor seconds; with
``--before`` those that a tree before can do as well are measured on it in the same run.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.beside import run_in
from benchmarks.model.kernels import best_of
from model.orbits.exact_ball import IdealBall
from model.surveys import ensemble
from model.surveys.diagram import diagram
from model.surveys.ensemble import Axis, Job
from model.tones import Forcing

GRIDS = {1: np.linspace(0.55, 6, 2000), 2: np.linspace(0.25, 6, 2000), 3: np.linspace(0.12, 6, 2000)}
FLIGHTS = 300
LAWS = ((0.0, 0.0), (0.3, 0.0), (0.3, 0.514))  # friction, restitution
SURVEY = Job(
    ratio=1,
    gammas=tuple(np.linspace(0.5, 4.0, 200)),
    axes=(
        Axis("coulomb_friction.mu", tuple(np.linspace(0.0, 0.3, 10))),
        Axis("restitution.e0", tuple(np.linspace(0.0, 0.6, 10))),
    ),
    keep=16,
)


class Counted(float):
    """A number that counts what is done with it."""

    done = 0

    @classmethod
    def _count(cls, value: float) -> Counted:
        cls.done += 1
        return cls(value)

    def __add__(self, x: float) -> Counted:
        return self._count(float(self) + float(x))

    def __sub__(self, x: float) -> Counted:
        return self._count(float(self) - float(x))

    def __rsub__(self, x: float) -> Counted:
        return self._count(float(x) - float(self))

    def __mul__(self, x: float) -> Counted:
        return self._count(float(self) * float(x))

    def __truediv__(self, x: float) -> Counted:
        return self._count(float(self) / float(x))

    __radd__, __rmul__ = __add__, __mul__


def operations(c: int, n: int) -> float:
    """Additions, multiplications and divisions of a flight from the first threshold, mean over ``n`` gammas."""
    from benchmarks.model.one_number import in_python
    from model.flight import windows
    from model.flight.lanes.edge_table import TABLE
    from model.flight.lanes.ideal_lanes import land_lanes
    from model.flight.segment import shape

    land, forcing = in_python(land_lanes), Forcing.superposition(c)
    plain_shape = in_python(shape)
    Counted.done = flown = 0
    for gamma in GRIDS[c][:: 2000 // n]:
        edge, windows = windows.edges(forcing, float(gamma))
        if windows == 0:
            continue
        table = np.zeros(TABLE * edge.size)
        for i in range(2 * windows + 1):
            s, slope, _ = plain_shape(forcing.tones, edge[i])
            table[TABLE * i : TABLE * i + 3] = edge[i], s, slope
        zero, phi = Counted(0.0), Counted(edge[0])
        s, slope, _ = plain_shape(forcing.tones, phi)
        with np.errstate(all="ignore"):
            land(
                forcing.tones, float(forcing.tones[:, 1].sum()), table, Counted(gamma),
                (zero, Counted(2 * windows), zero), (phi, s, slope),
            )  # fmt: skip
        flown += 1
    return Counted.done / flown


def fused_per_second() -> float:
    """Fused multiply-adds a second of one core, in lanes, eight chains at once."""
    from kernels.lanes import WIDTH, load, store
    from model.flight.numerics import compiled

    @compiled
    def chains(x: Any, n: int) -> None:
        a, b, c, d = load(x, 0), load(x, 0), load(x, 0), load(x, 0)
        e, f, g, h = load(x, 0), load(x, 0), load(x, 0), load(x, 0)
        k = load(x, WIDTH)
        for _ in range(n):
            a, b, c, d = a * k + k, b * k + k, c * k + k, d * k + k
            e, f, g, h = e * k + k, f * k + k, g * k + k, h * k + k
        store(x, 0, a + b + c + d + e + f + g + h)

    x = np.concatenate([np.linspace(0.1, 0.2, WIDTH), np.full(WIDTH, 0.5)])
    chains(x, 1)
    n = 1_000_000
    return 8 * WIDTH * n / best_of(5, lambda: chains(x, n))


def every_flight(c: int, mu: float, e: float, runs: int) -> float:
    """Flights a second when all of J's flights are flown."""
    from model.flight import windows
    from model.surveys import cycle_batch

    forcing, gammas = Forcing.superposition(c), GRIDS[c]
    laws = np.tile([mu, mu, e, 0.0], (gammas.size, 1))
    batch = cycle_batch.ideal_batch if mu == e == 0.0 else cycle_batch.friction_batch
    outcome = np.empty((gammas.size, cycle_batch.OUTCOME_SIZE), dtype=np.int64)
    kept = np.empty((gammas.size, 1))
    turning, flown = windows.turning_points(forcing), 0
    points = cycle_batch.Points(forcing.tones, turning, gammas, laws, False, outcome, kept)

    def fly() -> None:
        nonlocal flown
        flown = batch(points, FLIGHTS)

    fly()
    took = best_of(runs, fly)
    return flown / took


def alone(c: int, runs: int) -> float:
    """Flights a second of the kernel that flies one at a time, orbits from rest until they close."""
    ball, gammas = IdealBall(Forcing.superposition(c)), GRIDS[c]
    ball.itinerary_codes(gammas[-3:], FLIGHTS)
    from model.orbits.attractor import AT_REST

    flown = sum(ball.fly(float(g), AT_REST, FLIGHTS).tau.size for g in gammas)
    return flown / best_of(runs, lambda: ball.itinerary_codes(gammas, FLIGHTS))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--before", type=Path, help="another tree: what it can do as well is measured on it first")
    parser.add_argument("--common", action="store_true", help="only what any tree can do")
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    if options.before is not None:
        run_in(options.before, __file__, ["--common", "--runs", str(options.runs)])
    for c in GRIDS:
        print(f"c = {c}: {alone(c, options.runs) / 1e6:.2f} M flights/s one at a time, until orbits close")
    j_s = 0.0
    for c, gammas in GRIDS.items():
        ball = IdealBall(Forcing.superposition(c))
        diagram(ball, gammas)
        j_s += best_of(options.runs, lambda b=ball, g=gammas: diagram(b, g))
    print(f"J as the diagram of its attractors: {1e3 * j_s:.1f} ms")
    ensemble.compute(SURVEY, 0, 2000)
    took = best_of(1, lambda: ensemble.compute(SURVEY, 0, SURVEY.size))
    print(f"survey of gamma, friction, restitution: {1e6 * took / SURVEY.size:.1f} us a point, {SURVEY.size} points")
    ideal = {}
    for c in GRIDS:
        rates = [every_flight(c, mu, e, options.runs) for mu, e in LAWS]
        ideal[c] = rates[0]
        print(
            f"c = {c}: every flight, M/s: ideal {rates[0] / 1e6:.1f}, "
            + ", ".join(f"mu {mu} e {e}: {r / 1e6:.2f}" for (mu, e), r in zip(LAWS[1:], rates[1:], strict=True)),
            flush=True,
        )
    if options.common:
        return
    fused = fused_per_second()
    print(f"fused multiply-adds: {fused / 1e9:.1f} G a second")
    for c, rate in ideal.items():
        needed = operations(c, 40)
        print(
            f"c = {c}: {needed:.0f} operations an ideal flight, {100 * needed * rate / (2.0 * fused):.0f} % of the "
            f"core's {2.0 * fused / 1e9:.0f} G operations/s"
        )


if __name__ == "__main__":
    main()
