"""A third experiment with ordinary faults: a table that rings after each impact, and instruments as they are bought.

The ball moves in the plate's frame, where each landing, each turn on the rod and each rebound has its exact time; the
table's ringing reaches the accelerometer only. It shares no formula and no code with the model, nor with `rig.sim` and
`benchmarks.plants.other_plant`.

    python -m benchmarks.plants.third_plant OUT_FOLDER --card "24-bit card" --friction 0.1 --restitution 0.3 --seed 7
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, field
from pathlib import Path
from string import Template

import numpy as np

from benchmarks.plants.handed_over import imported
from benchmarks.plants.third_instrument import CARDS, G, Instrument, drawn
from kernels import njit
from kernels.arrays import Floats

NO_REBOUND_MPS = 3e-3  # a slower rebound does not leave the plate
FADE_CYCLES = 1.5
MOST_FLIGHTS_A_SECOND = 600
HIDDEN = {
    # effect of the library: field of the rig
    "coulomb_friction.mu": "friction",
    "restitution.e0": "restitution",
    "viscous_damping.rate_per_s": "viscous_per_s",
    "drive_gain.relative": "gain",
}


@dataclass(frozen=True)
class Rig:
    """One run: the drive, what is hidden, and the instrument.

    Attributes
    ----------
    gammas
        Level of each step, in the order of time.
    cycles
        Of the first tone in each step, the fade at its beginning included.
    friction, restitution, viscous_per_s, gain
        Friction of the rod over the ball's weight, restitution of an impact, viscous force of the rod over the ball's
        mass and speed along it, and the plate's acceleration over that of the drive, less one.
    """

    gammas: tuple[float, ...]
    instrument: Instrument = field(default_factory=Instrument)
    c: int = 1
    frequency_hz: float = 27.3
    cycles: int = 20
    g_per_volt: float = 1.3
    friction: float = 0.0
    restitution: float = 0.0
    viscous_per_s: float = 0.0
    gain: float = 0.0
    seed: int = 0


@njit()
def commanded(gammas, step_s, fade_s, w, c, t):
    """Acceleration of the plate in g at time ``t``, s: two tones whose level fades from step to step."""
    k = min(max(int(t / step_s), 0), gammas.size - 1)
    level, x = gammas[k], (t - k * step_s) / fade_s
    if x < 1.0:
        before = gammas[k - 1] if k > 0 else 0.0
        level = before + (level - before) * x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
    return -level * (math.sin(w * t) + math.sin(c * w * t))


@njit()
def _march(gammas, step_s, fade_s, w, c, dt, friction, restitution, viscous, gain, plate, flights):
    """March the ball; fill the plate's acceleration (n,), m/s^2, at each ``dt`` and take-off, landing and landing speed
    of each flight (m, 3); the number of flights."""
    h = u = left_s = 0.0  # height and speed in the plate's frame
    resting, m, hold = True, 0, friction * G
    for i in range(plate.size):
        t, end = i * dt, (i + 1) * dt
        plate[i] = (1.0 + gain) * G * commanded(gammas, step_s, fade_s, w, c, t)
        while t < end:
            s = end - t
            free = -G - (1.0 + gain) * G * commanded(gammas, step_s, fade_s, w, c, t + 0.5 * s)
            if resting:
                if free <= hold:
                    break
                resting, left_s = False, t
            if u == 0.0 and h > 0.0 and abs(free) <= hold:  # the rod holds the ball in the air
                break
            up = u > 0.0 or (u == 0.0 and free > 0.0)
            a = (free + (-hold if up else hold) - viscous * u) / (1.0 + 0.5 * viscous * s)
            turns = u * (u + s * a) < 0.0
            x = -u / a if turns else s
            after = h + u * x + 0.5 * a * x * x
            if after < 0.0:
                root = math.sqrt(u * u - 2.0 * a * h)
                x = 2.0 * h / (root - u) if u < 0.0 else -(u + root) / a
                flights[m, 0], flights[m, 1], flights[m, 2] = left_s, t + x, -(u + a * x)
                u, h, t = restitution * flights[m, 2], 0.0, t + x
                resting, left_s, m = u < NO_REBOUND_MPS, t, m + 1
                if resting:
                    u = 0.0
                if m == flights.shape[0]:
                    return m
                continue
            h, u, t = after, 0.0 if turns else u + a * x, t + x
    return m


def simulate(rig: Rig) -> dict[str, Floats]:
    """What the rig's owner records, and the truth.

    Returns
    -------
    dict of float64 arrays
        ``time_s, continuity_v, accelerometer_v, drive_v`` (n,); ``flights`` (m, 2), take-off and landing by the file's
        clock, s.
    """
    rng, card = np.random.default_rng(rig.seed), rig.instrument
    gammas, w = np.array(rig.gammas), 2.0 * math.pi * rig.frequency_hz
    step_s, fade_s = rig.cycles / rig.frequency_hz, FADE_CYCLES / rig.frequency_hz
    n = int(gammas.size * step_s * card.rate_hz)
    plate = np.zeros(n * card.over)
    flights = np.zeros((int(MOST_FLIGHTS_A_SECOND * n / card.rate_hz), 3))
    asked = gammas, step_s, fade_s, w, float(rig.c)
    hidden = rig.friction, rig.restitution, rig.viscous_per_s, rig.gain
    flights = flights[: _march(*asked, 1.0 / (card.rate_hz * card.over), *hidden, plate, flights)]
    impacts = np.column_stack([flights[:, 1], (1.0 + rig.restitution) * flights[:, 2]])
    time_s = np.arange(n) / card.rate_hz
    drive = np.array([commanded(*asked, t) for t in time_s - card.late_s])
    return {
        "time_s": time_s,
        "continuity_v": card.converted(card.contact_v(flights[:, :2], n, rng), 3e-3, rng),
        "accelerometer_v": card.converted(card.accelerometer_v(plate / G, impacts, rng), card.white_v, rng),
        "drive_v": card.converted(np.where(time_s < card.late_s, 0.0, drive) / rig.g_per_volt, 5e-4, rng),
        "flights": flights[:, :2] + card.late_s,
    }


def profile_of(rig: Rig) -> str:
    """The profile that goes with a recording: what its owner would declare, nothing hidden."""
    form = Template(Path(__file__).with_name("third_profile.toml.in").read_text(encoding="utf-8"))
    card, settle = rig.instrument, min(8, rig.cycles // 2)
    return form.substitute(
        rate_hz=card.rate_hz, frequency_hz=rig.frequency_hz, c=rig.c, g_per_volt=rig.g_per_volt,
        coupling="ac" if card.coupling_hz else "dc", reads_gravity=str(card.reads_gravity).lower(),
        gammas=list(rig.gammas), settle_cycles=settle, hold_cycles=rig.cycles - settle,
    )  # fmt: skip


def main() -> None:
    """Write one recording, as imported, from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--card", choices=CARDS, default=CARDS[0])
    parser.add_argument("--c", type=int, default=1)
    parser.add_argument("--gamma", nargs=3, type=float, default=(0.5, 2.6, 22), metavar=("START", "STOP", "STEPS"))
    for name in HIDDEN.values():
        parser.add_argument(f"--{name.replace('_', '-')}", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    start, stop, steps = args.gamma
    rig = Rig(
        gammas=tuple(np.round(np.linspace(start, stop, int(steps)), 4).tolist()), c=args.c, seed=args.seed,
        instrument=drawn(args.card, np.random.default_rng(args.seed)),
        **{name: getattr(args, name) for name in HIDDEN.values()},
    )  # fmt: skip
    args.folder.mkdir(parents=True, exist_ok=True)
    volts = simulate(rig)
    np.savetxt(args.folder / "flights.csv", volts["flights"], delimiter=",", header="take_off_s,landing_s")
    print(rig.instrument, imported(volts, profile_of(rig), args.folder), sep="\n")


if __name__ == "__main__":
    main()
