"""The design of the scoring: which effects, how often, at which ratio, from which seeds."""

from __future__ import annotations

from benchmarks.scoring.trial import DECLARED, Job
from benchmarks.scoring.truth import OTHER_NAMED, OTHER_OUTSIDE

PAIRS = (
    ("coulomb_friction", "accelerometer_gain"), ("restitution", "viscous_damping"), ("drive_gain", "quadratic_drag"),
    ("adhesion", "coulomb_friction"), ("harmonic_distortion", "local_gravity"), ("magnet", "contact_latency"),
    ("restitution", "coulomb_friction"), ("gain_compression", "spring"), ("accelerometer_offset", "adhesion"),
    ("phase_lag", "viscous_damping"),
)  # fmt: skip
REPETITION = 100_000_000  # between the seeds of two repetitions
INVISIBLE = ("contact_gap", "contact_closure", "clock_error", "restitution_scatter")
LATER = ("accelerometer_lag", "mains_pickup", "accelerometer_high_pass")
"""In the library since the others' seeds were given: theirs stay as they were."""

COUNTS = {"strong": 8, "weak": 4, "clean": 50, "declared": 50, "outside": 6, "pair": 2}
OWN_COUNTS = {"strong": 3, "weak": 2, "clean": 10, "outside": 1, "pair": 0}


def jobs(seed_base: int, *, times: int = 1, varied: bool = False) -> list[Job]:
    """Every trial, the kinds and plants interleaved, so that any part of them is a fair sample.

    Parameters
    ----------
    seed_base
        Of all seeds.
    times
        Repetitions of the whole design, each with seeds of its own.
    varied
        Whether noise, rate, c and length are drawn from the seed as well.
    """
    repeated = (_once(seed_base + REPETITION * i, varied) for i in range(times))
    return [job for one in repeated for job in one]


def _once(seed_base: int, varied: bool) -> list[Job]:
    from rig.sim.scenario import BEYOND, NAMED

    named = [n.name for n in NAMED if n.name not in INVISIBLE + LATER]
    beyond = [n.name for n in BEYOND]
    out: list[tuple[float, Job]] = []

    def add(kind: str, plant: str, effects: tuple[str, ...], i: int, n: int, column: int) -> None:
        seed = seed_base + 10_000 * len(out) + i
        out.append(((i + 0.5) / n, Job(kind, plant, effects, 1 + (i + column) % 2, seed, varied and plant == "other")))

    other = [name for name in OTHER_NAMED if name not in LATER]
    for plant, counts, library, outside in (
        ("other", COUNTS, other, list(OTHER_OUTSIDE)), ("own", OWN_COUNTS, named, beyond)
    ):  # fmt: skip
        for kind in ("strong", "weak"):
            for j, effect in enumerate(library):
                for i in range(counts[kind]):
                    add(kind, plant, (effect,), i, counts[kind], j)
        for i in range(counts["clean"]):
            add("clean", plant, (), i, counts["clean"], 0)
        for i in range(counts.get("declared", 0)):
            add("declared", plant, (DECLARED[i % len(DECLARED)],), i, counts["declared"], i // len(DECLARED))
        for j, effect in enumerate(outside):
            for i in range(counts["outside"]):
                add("outside", plant, (effect,), i, counts["outside"], j)
        for j, pair in enumerate(PAIRS):
            for i in range(counts["pair"]):
                add("pair", plant, pair, i, counts["pair"], j)
    for plant, counts in (("other", COUNTS), ("own", OWN_COUNTS)):
        for kind in ("strong", "weak"):
            for j, effect in enumerate(LATER):
                for i in range(counts[kind]):
                    add(kind, plant, (effect,), i, counts[kind], j)
    return [job for _, job in sorted(out, key=lambda pair: pair[0])]
