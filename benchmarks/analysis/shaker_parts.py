"""Closed loops on a rig that is built from its parts: what is named, beside what masses, springs and dashpots make.

Twenty-two steps in random order, c = 1, 2 and 3; the owner's profile knows nothing of the parts. The accelerometer's
filter and the mean that the converter takes are late in every recording: `accelerometer_lag` is right everywhere.

    python -m benchmarks.analysis.shaker_parts --seed-base 80000 --only "table of 20 kg"
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.plants import other_plant
from benchmarks.plants.handed_over import imported
from benchmarks.plants.shaker import BALL_KG, Shaker, simulate

GAMMAS = {1: (0.5, 2.6), 2: (0.2, 1.5), 3: (0.1, 0.8)}
SEEDS_OF_A_RIG = 10
LAG, MODE, RUBS = "accelerometer_lag", "table_resonance", "coulomb_friction"

RIGS: dict[str, tuple[Shaker, dict[str, str]]] = {
    "a table of 100 t": (Shaker(), {}),
    "a rod that rubs": (Shaker(sliding_friction=0.1), {RUBS: "0.1, 0.1"}),
    "an oiled rod": (Shaker(oil_per_s=2.0), {"viscous_damping": "2 /s"}),
    "a table of 50 kg": (Shaker(table_kg=50.0), {MODE: ""}),
    "a table of 20 kg": (Shaker(table_kg=20.0), {MODE: ""}),
    "a table of 20 kg, its level set without the ball": (Shaker(table_kg=20.0, level_set_bare=True), {MODE: ""}),
    "a table of 20 kg, a rod that rubs": (Shaker(table_kg=20.0, sliding_friction=0.1), {MODE: "", RUBS: "0.1, 0.1"}),
    "a table of 5 kg": (Shaker(table_kg=5.0), {MODE: ""}),
    "a table of 20 kg, driven by volts": (Shaker(table_kg=20.0, damping=0.14, voltage_driven=True), {MODE: ""}),
    "a table of 20 kg that rings, damping 0.1": (Shaker(table_kg=20.0, damping=0.1), {MODE: ""}),
    "a contact that bounces a little": (Shaker(contact_n_per_m=4e9, contact_damping=6.0), {"restitution": ""}),
    "a contact that bounces a little, a rod that rubs": (
        Shaker(contact_n_per_m=4e9, contact_damping=6.0, sliding_friction=0.1),
        {"restitution": "", RUBS: "0.1, 0.1"},
    ),
    "two modes: a table of 2 kg on 20 kg": (Shaker(table_kg=2.0, damping=0.1, floor_kg=20.0), {MODE: ""}),
    "two modes: a table of 4 kg on 8 kg": (
        Shaker(table_kg=4.0, suspension_hz=6.0, damping=0.05, floor_kg=8.0, floor_hz=10.0),
        {MODE: ""},
    ),
    "two modes: a table of 5 kg on 15 kg": (
        Shaker(table_kg=5.0, suspension_hz=4.0, damping=0.05, floor_kg=15.0, floor_hz=9.0),
        {MODE: ""},
    ),
    "two modes: a table of 20 kg on 100 kg": (
        Shaker(table_kg=20.0, damping=0.1, floor_kg=100.0, floor_hz=6.0),
        {MODE: ""},
    ),
}


def modes_of(rig: Shaker) -> list[tuple[float, float, float]]:
    """Frequency, damping, and ball over moving mass of the table's modes, the one that is struck most first."""
    table, spring, dashpot, floor, floor_spring, floor_dashpot, *_ = rig.parts()
    masses = np.array([[table], [floor]])
    springs = np.array([[spring, -spring], [-spring, spring + floor_spring]]) / masses
    dashpots = np.array([[dashpot, -dashpot], [-dashpot, dashpot + floor_dashpot]]) / masses
    poles, shapes = np.linalg.eig(np.block([[np.zeros((2, 2)), np.eye(2)], [-springs, -dashpots]]))
    # the table's speed after a blow of the ball's weight: a sum over the poles
    sizes = 2.0 * shapes[2] * np.linalg.inv(shapes)[:, 2] * BALL_KG / table
    found = [
        (abs(p) / (2.0 * np.pi), -p.real / abs(p), float((z / (1.0 - 1j * p.real / p.imag)).real))
        for p, z in zip(poles, sizes, strict=True)
        if p.imag > 0.0
    ]
    return sorted((mode for mode in found if mode[2] > 1e-4), key=lambda mode: -mode[2])


def recorded(rig: Shaker, folder: Path) -> Path:
    """The recording that its owner imports."""
    asked = other_plant.Run(
        c=rig.c, frequency_hz=rig.frequency_hz, gammas=rig.gammas, cycles=rig.cycles, rate_hz=rig.rate_hz
    )
    return imported(simulate(rig), other_plant.profile_of(asked), folder)


def trial(name: str, ratio: int, seed: int) -> str:
    """A row of the table."""
    from analysis.loop.close_loop import close_loop

    rig, others = RIGS[name]
    gammas = np.random.default_rng((seed, 7)).permutation(np.round(np.linspace(*GAMMAS[ratio], 22), 4))
    rig = replace(rig, c=ratio, gammas=tuple(gammas.tolist()), seed=seed)
    truth = {LAG: "", **others}
    if MODE in truth:
        truth[MODE] = " and ".join(f"{m:.3g}, {hz:.4g} Hz, {d:.3g}" for hz, d, m in modes_of(rig))
    with tempfile.TemporaryDirectory() as folder:
        path = recorded(rig, Path(folder))
        begin = time.process_time()
        loop = close_loop([path])
        took_s = time.process_time() - begin
    found: dict[str, list[str]] = {effect.name: [] for effect in loop.selection.effects}
    for p in loop.selection.parameters:
        if p.effect in found and p.value:
            found[p.effect].append(f"{p.value:.3g}")
    named = "; ".join(f"{effect} {', '.join(values)}" for effect, values in found.items())
    wanted = "; ".join(f"{effect} {values}".rstrip() for effect, values in truth.items())
    right = "yes" if set(found) == set(truth) else "no"
    left = f"{loop.errors.after.landing_rms_us:.0f}, {loop.errors.landing_floor_us:.0f}"
    return f"| {name} | {ratio} | {seed} | {wanted} | {named} | {right} | {loop.verdict} | {left} | {took_s:.0f} |"


def main() -> None:
    """Every rig at c = 1, 2 and 3."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed-base", type=int, default=80000)
    parser.add_argument("--only", default="", help="rigs by their beginnings, with semicolons between")
    args = parser.parse_args()
    wanted = tuple(part for part in args.only.split(";") if part)
    print("| rig | c | seed | what its parts make | named | names right | verdict | landings after, floor, us | s |")
    print("|---|---|---|---|---|---|---|---|---|")
    for i, name in enumerate(RIGS):
        if not wanted or name.startswith(wanted):
            for ratio in GAMMAS:
                print(trial(name, ratio, args.seed_base + SEEDS_OF_A_RIG * i + ratio), flush=True)


if __name__ == "__main__":
    main()
