"""Closed loops on recordings whose instruments are at fault, one fault at a time: what is named, and what should be.

The other plant is recorded as it is, its volts are spoilt, and the rest is a stranger's work: import with the owner's
profile, which says nothing of the fault. Half of the recordings hide nothing else, half a medium Coulomb friction.

    python -m benchmarks.analysis.instrument_faults --seed-base 70000 --only "low-pass of 1.6 kHz,a zero that warms up"
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from scipy.signal import butter, lfilter, lfilter_zi

from benchmarks.plants import other_plant
from benchmarks.plants.handed_over import imported

Volts = dict[str, np.ndarray]
Fault = Callable[[Volts, other_plant.Run, np.random.Generator], None]

FRICTION = "coulomb_friction"
GAMMAS = {1: (0.5, 2.6), 2: (0.2, 1.5), 3: (0.1, 0.8)}
SEEDS_OF_A_FAULT, SEEDS_OF_A_RATIO = 100, 10


def low_passed(x: np.ndarray, corner_hz: float, rate_hz: float, order: int = 1) -> np.ndarray:
    """Behind a Butterworth filter that has seen the first value for long."""
    b, a = butter(order, corner_hz / (rate_hz / 2.0))
    return np.asarray(lfilter(b, a, x, zi=lfilter_zi(b, a) * x[0])[0])


def coloured(n: int, rng: np.random.Generator, rms: float, rate_hz: float) -> np.ndarray:
    """Noise whose power falls as one over the frequency."""
    hz = np.fft.rfftfreq(n, 1.0 / rate_hz)
    hz[0] = hz[1]
    noise = np.fft.irfft(np.fft.rfft(rng.standard_normal(n)) / np.sqrt(hz), n)
    return np.asarray(rms * noise / noise.std())


def sine(v: Volts, volts: float, hz: float, phase_rad: float = 0.0) -> np.ndarray:
    """A line in a channel."""
    return np.asarray(volts * np.sin(2.0 * np.pi * hz * v["time_s"] + phase_rad))


def _first_order(v: Volts, run: other_plant.Run, rng: np.random.Generator) -> None:
    v["accelerometer_v"] = low_passed(v["accelerometer_v"], 1600.0, run.rate_hz)


def _second_order(v: Volts, run: other_plant.Run, rng: np.random.Generator) -> None:
    v["accelerometer_v"] = low_passed(v["accelerometer_v"], 500.0, run.rate_hz, 2)


def _coloured_noise(v: Volts, run: other_plant.Run, rng: np.random.Generator) -> None:
    v["accelerometer_v"] += coloured(v["time_s"].size, rng, 0.002, run.rate_hz)


def _warms_up(v: Volts, run: other_plant.Run, rng: np.random.Generator) -> None:
    v["accelerometer_v"] += 0.003 * np.exp(-v["time_s"] / 5.0)


def _mains_in_accelerometer(v: Volts, run: other_plant.Run, rng: np.random.Generator) -> None:
    v["accelerometer_v"] += sine(v, 0.002, 50.0, 1.0) + sine(v, 0.001, 150.0)


def _chatter(v: Volts, run: other_plant.Run, rng: np.random.Generator) -> None:
    """Up to three openings of one to three samples within 0.8 ms of a landing."""
    open_ = v["continuity_v"] > 2.5
    for landing in np.flatnonzero(open_[:-1] & ~open_[1:]) + 1:
        for _ in range(rng.integers(0, 4)):
            first = landing + 1 + int(rng.uniform(0.0, 8e-4) * run.rate_hz)
            v["continuity_v"][first : first + rng.integers(1, 4)] = 4.96


def _mains_in_contact(v: Volts, run: other_plant.Run, rng: np.random.Generator) -> None:
    v["continuity_v"] += sine(v, 0.15, 50.0, 1.0)


def _levels(v: Volts, run: other_plant.Run, rng: np.random.Generator) -> None:
    v["continuity_v"] = 0.35 + 0.82 * v["continuity_v"] + coloured(v["time_s"].size, rng, 0.1, run.rate_hz)


def _slow_contact(v: Volts, run: other_plant.Run, rng: np.random.Generator) -> None:
    v["continuity_v"] = low_passed(v["continuity_v"], 1.0 / (2.0 * np.pi * 2e-4), run.rate_hz)


def _lost(v: Volts, run: other_plant.Run, rng: np.random.Generator) -> None:
    kept = np.ones(v["time_s"].size, dtype=bool)
    for _ in range(3):
        first = rng.integers(1000, kept.size - 1000)
        kept[first : first + rng.integers(20, 300)] = False
    for name in v:
        v[name] = v[name][kept]


def _fast_clock(v: Volts, run: other_plant.Run, rng: np.random.Generator) -> None:
    v["time_s"] = v["time_s"] * (1.0 + 6e-5)


def _jittering_times(v: Volts, run: other_plant.Run, rng: np.random.Generator) -> None:
    v["time_s"] = v["time_s"] + 2e-6 * rng.standard_normal(v["time_s"].size)


def _mains_in_drive(v: Volts, run: other_plant.Run, rng: np.random.Generator) -> None:
    v["drive_v"] += 0.02 + sine(v, 0.003, 50.0)


def _drive_read_late(v: Volts, run: other_plant.Run, rng: np.random.Generator) -> None:
    v["drive_v"] = np.roll(v["drive_v"], 1)


def _accelerometer_read_late(v: Volts, run: other_plant.Run, rng: np.random.Generator) -> None:
    v["accelerometer_v"] = np.roll(v["accelerometer_v"], 2)


def _high_pass(v: Volts, run: other_plant.Run, rng: np.random.Generator) -> None:
    """The zero at rest stays where the profile has it."""
    b, a = butter(1, 1.0 / (run.rate_hz / 2.0), "high")
    rest = 0.1 * run.reads_gravity
    v["accelerometer_v"] = rest + lfilter(b, a, v["accelerometer_v"] - rest)


def _cut_off(v: Volts, run: other_plant.Run, rng: np.random.Generator) -> None:
    v["accelerometer_v"] = np.clip(v["accelerometer_v"], -0.35, 0.45)


LAG, PICKUP = "accelerometer_lag", "mains_pickup"
FAULTS: Mapping[str, tuple[Fault, tuple[str, ...]]] = {  # in words: what it does, and the names that it should get
    "none": (lambda v, run, rng: None, ()),
    "low-pass of 1.6 kHz": (_first_order, (LAG,)),
    "low-pass of second order, 500 Hz": (_second_order, (LAG,)),
    "1/f noise, 0.02 g": (_coloured_noise, ()),
    "a zero that warms up by 0.03 g": (_warms_up, ()),
    "mains in the accelerometer, 0.02 g": (_mains_in_accelerometer, (PICKUP,)),
    "a contact that chatters": (_chatter, ()),
    "mains in the contact, 0.15 V": (_mains_in_contact, ()),
    "levels off, 1/f noise of 0.1 V": (_levels, ()),
    "contact with an RC of 0.2 ms": (_slow_contact, ()),
    "three losses of samples": (_lost, ()),
    "a clock fast by 60 ppm": (_fast_clock, ()),
    "times that jitter by 2 us": (_jittering_times, ()),
    "mains in the drive, 3 mV": (_mains_in_drive, ()),
    "drive read a sample late": (_drive_read_late, ()),
    "accelerometer read two samples late": (_accelerometer_read_late, (LAG,)),
    "a sensor that ends at -3.5 and 4.5 g": (_cut_off, ()),
    "high-pass of 1 Hz": (_high_pass, ("accelerometer_high_pass",)),
}


def recorded(fault: Fault, ratio: int, hidden: dict[str, float], seed: int, folder: Path) -> Path:
    """A recording of the other plant with one fault, imported with its owner's profile."""
    rng = np.random.default_rng((seed, 7))
    gammas = rng.permutation(np.round(np.linspace(*GAMMAS[ratio], 22), 4))
    run = other_plant.Run(
        c=ratio, frequency_hz=float(rng.choice((22.31, 25.37, 25.0, 31.73))), spikes=bool(rng.random() < 0.5),
        closure_s=float(rng.choice((1e-4, 5e-4))), jitter_s=float(rng.choice((5e-6, 2e-5))),
        reads_gravity=bool(rng.random() < 0.5), gammas=tuple(gammas.tolist()), seed=seed, hidden=hidden,
    )  # fmt: skip
    volts = other_plant.simulate(run)
    del volts["impacts"]
    fault(volts, run, rng)
    return imported(volts, other_plant.profile_of(run), folder)


def trial(name: str, ratio: int, friction: bool, seed: int) -> tuple[bool, str]:
    """Whether the verdict is right, and a row of the table."""
    from analysis.loop.close_loop import fit_loop

    fault, names = FAULTS[name]
    hidden = other_plant.hidden_by(FRICTION, "medium") if friction else {}
    with tempfile.TemporaryDirectory() as folder:
        path = recorded(fault, ratio, hidden, seed, Path(folder))
        begin = time.process_time()
        loop, _ = fit_loop([path])
        took_s = time.process_time() - begin
    wanted, found = {*names, *((FRICTION,) if friction else ())}, [e.name for e in loop.effects]
    right = set(found) == wanted and loop.verdict == ("explained" if wanted else "nothing_missing")
    named = " + ".join(found) or "-"
    row = f"| {name} | {ratio} | {FRICTION if friction else '-'} | {seed} | {named} | {loop.verdict} "
    return right, f"{row}| {'yes' if right else 'no'} | {took_s:.0f} |"


def main() -> None:
    """Every fault at c = 1, 2 and 3, alone and with friction."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed-base", type=int, default=70000)
    parser.add_argument("--only", default="", help="faults by their beginnings, with commas between")
    args = parser.parse_args()
    wanted = tuple(part for part in args.only.split(",") if part)
    print("| fault | c | hidden beside | seed | named | verdict | right | s |\n|---|---|---|---|---|---|---|---|")
    count: dict[str, int] = {}
    for i, name in enumerate(FAULTS):
        if wanted and not name.startswith(wanted):
            continue
        for ratio in GAMMAS:
            for friction in (False, True):
                seed = args.seed_base + SEEDS_OF_A_FAULT * i + SEEDS_OF_A_RATIO * ratio + friction
                right, row = trial(name, ratio, friction, seed)
                count[name] = count.get(name, 0) + right
                print(row, flush=True)
    print("\n| fault | right, of six |\n|---|---|")
    for name, n in count.items():
        print(f"| {name} | {n} |")


if __name__ == "__main__":
    main()
