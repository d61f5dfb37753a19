"""Falls without a bounce of other balls than the measured five: coverage of drag and gravity, and causes named falsely.

Run ``python -m benchmarks.analysis.falls --count 6 --seed 1000`` (simulated falls of known truth, integrated by an
adaptive Runge-Kutta method), or ``--measured FOLDER`` (each subset of the balls of a workbook, as its whole says it).
"""

from __future__ import annotations

import argparse
from collections import Counter
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from analysis.drop.falls.fit import AIR_KG_PER_M3, Fall, Setting
from analysis.drop.falls.outcome import Judged, judge_falls
from bench.jobs.drop_test import Request, measure
from kernels.arrays import Floats

G = 9.80665
# mass (kg), diameter (m), drag coefficient before and after the drag crisis, and its speed (m/s; infinite: never)
BALLS = {
    "baseball": (0.145, 0.073, 0.45, 0.35, 30.0), "basketball": (0.6, 0.24, 0.5, 0.2, 12.0),
    "bowling ball": (6.0, 0.217, 0.5, 0.2, 15.0), "tennis ball": (0.058, 0.0655, 0.55, 0.55, np.inf),
    "whiffle ball": (0.028, 0.073, 0.6, 0.6, np.inf), "golf ball": (0.046, 0.0427, 0.5, 0.27, 15.0),
    "beach ball": (0.1, 0.35, 0.5, 0.2, 10.0), "volleyball": (0.27, 0.21, 0.5, 0.18, 13.0),
    "shuttle": (0.005, 0.065, 0.6, 0.6, np.inf), "table-tennis ball": (0.0027, 0.04, 0.47, 0.47, np.inf),
    "cricket ball": (0.16, 0.072, 0.45, 0.4, np.inf), "foam ball": (0.02, 0.1, 0.5, 0.5, np.inf),
    "football": (0.43, 0.22, 0.5, 0.2, 13.0), "hockey ball": (0.16, 0.07, 0.5, 0.5, np.inf),
}  # fmt: skip
# How falls are made: what differs from 36 m at 15 positions a second with a noise of 4 cm and pixels of 2.8 cm.
KINDS: dict[str, dict[str, float | str]] = {
    "a true axis": {},
    "one axis for all": {"bend": 0.06},
    "axes of drops differ by 3 %": {"bend": 0.06, "own": 0.03},
    "by 6 %": {"bend": 0.06, "own": 0.06},
    "scales of thirds differ by 5 %": {"bend": 0.06, "pieces": 0.05},
    "a drag crisis": {"bend": 0.06, "own": 0.03, "crisis": 1.0},
    "gusts of 0.5 m/s": {"bend": 0.06, "own": 0.03, "gust": 0.5},
    "steady wind of 0.7 m/s": {"bend": 0.06, "own": 0.03, "wind": 0.7},
    "60 a second, noise correlated by 0.6": {"own": 0.03, "fps": 60.0, "correlation": 0.6},
    "8 m": {"own": 0.03, "tall": 8.0, "noise": 0.015, "pixel": 0.006},
}


def flown_m(ball: str, since: Floats, rng: np.random.Generator, crisis: bool, wind: float, gust: float) -> Floats:
    """Way down at times since the release (n,): gravity, buoyancy, added mass, drag, air that moves."""
    mass, diameter, before, after, critical = BALLS[ball]
    air = AIR_KG_PER_M3 * np.pi / 6.0 * diameter**3 / mass
    drag = 0.125 * AIR_KG_PER_M3 * np.pi * diameter**2 / mass
    phase, rate = rng.uniform(0.0, 2.0 * np.pi, 3), rng.uniform(0.5, 3.0, 3)

    def slope(t: float, state: Floats) -> list[float]:
        through = state[1] - wind - gust * float(np.sin(rate * t + phase).sum())
        coefficient = after + (before - after) / (1.0 + np.exp(abs(through) - critical)) if crisis else before
        return [state[1], (G * (1.0 - air) - drag * coefficient * abs(through) * through) / (1.0 + 0.5 * air)]

    falling = since > 0.0
    run = solve_ivp(slope, (0.0, float(since.max())), [0.0, 0.0], rtol=1e-8, atol=1e-9, t_eval=since[falling])
    return np.concatenate([np.zeros(int((~falling).sum())), run.y[0]])


def falls_of(balls: list[str], kind: dict[str, float | str], rng: np.random.Generator) -> list[Fall]:
    """Two drops of each ball as a camera has them."""
    get = {"tall": 36.0, "fps": 15.0, "noise": 0.04, "pixel": 0.028, "correlation": 0.3} | kind
    number = {name: float(value) for name, value in get.items()}
    half, bend = 0.5 * number["tall"], number.get("bend", 0.0) * rng.standard_normal()
    out = []
    for ball in balls:
        for drop in (1, 2):
            time = np.arange(int(8 * number["fps"])) / number["fps"]
            time += 0.025 / number["fps"] * (rng.random(len(time)) < 0.06).cumsum()  # a clock that jitters
            held = rng.uniform(0.05, 0.3)
            wind, gust = number.get("wind", 0.0), number.get("gust", 0.0)
            height = 2.0 * half - flown_m(ball, time - held, rng, "crisis" in kind, wind, gust)
            seen = height[height > 0.0]
            u = seen / half - 1.0
            own = number.get("own", 0.0) * rng.standard_normal(3) * [1.0, 0.6, 0.6]
            seen = seen + half * (own[0] * u + (bend + own[1]) * (u * u - 1.0) + own[2] * (u**3 - u))
            edges, part = np.array([-1.5, -1.0 / 3.0, 1.0 / 3.0, 1.5]), number.get("pieces", 0.0)
            for low, high, off in zip(edges[:-1], edges[1:], part * rng.standard_normal(3), strict=True):
                seen = seen + half * off * (u.clip(low, high) - low)
            noise, rho = rng.standard_normal(len(seen)), number["correlation"]
            for k in range(1, len(noise)):
                noise[k] = rho * noise[k - 1] + np.sqrt(1.0 - rho**2) * noise[k]
            read = np.round((seen + number["noise"] * noise) / number["pixel"]) * number["pixel"]
            out.append(Fall(f"{ball} {drop}", ball, time[: len(read)], read))
    return out


def off_sigmas(judged: Judged, ball: str, crisis: bool) -> float:
    """Distance of a ball's drag from its truth (through a crisis: from the range of it), in half intervals."""
    value, sigma = judged.estimate("k_per_m", ball)
    ends = BALLS[ball][2:4] if crisis else BALLS[ball][2:3]
    true = np.array(ends) * (judged.setting.drag_per_m(ball) or np.nan)
    return float(max(value - true.max(), true.min() - value, 0.0)) / (judged.level * sigma)


def simulated(count: int, seed: int, sized: bool, only: str) -> None:
    """A row for each kind of fall: five balls drawn anew each time."""
    print("| falls | drags inside | gravity inside | error not fitted / fitted | causes named |\n|---|---|---|---|---|")
    for number, (label, kind) in enumerate(KINDS.items()):
        if only not in label:
            continue
        named: Counter[str] = Counter()
        off, g_off, ratio = [], [], []
        for k in range(count):
            rng = np.random.default_rng([seed, number, k])
            balls = sorted(rng.choice(list(BALLS), 5, replace=False).tolist())
            sizes = {ball: BALLS[ball][:2] for ball in balls}
            judged = judge_falls(falls_of(balls, kind, rng), G, sizes if sized else {})
            known = judged if sized else Judged(**{**vars(judged), "setting": Setting(judged.setting.axis, G, sizes)})
            off += [off_sigmas(known, ball, "crisis" in kind) for ball in balls]
            named[judged.best.model.name] += 1
            if judged.gravity is not None:
                g_off.append(abs(judged.gravity[0] - G) / (judged.level * judged.gravity[1]))
            ratio.append(judged.best.held_out_rms / judged.best.rms)
        inside, g_inside = (f"{sum(x < 1.0 for x in each)} of {len(each)}" for each in (off, g_off))
        causes = ", ".join(f"{name.replace('_', ' ')} {n}" for name, n in named.most_common())
        print(f"| {label} | {inside} | {g_inside} | {np.mean(ratio):.2f} | {causes} |", flush=True)


def measured(folder: Path) -> None:
    """Every three, four and five of the measured balls."""
    done = measure(Request((folder / "five_balls.xlsx",), balls=folder / "balls.txt"))
    whole = done.outcome.payload
    falls = [Fall(d["file"], d["ball"], *xy) for d, xy in zip(whole["drops"], done.plot.data, strict=True)]
    sizes = {one["ball"]: (one["mass_kg"], one["diameter_m"]) for one in whole["balls"]}
    print("| balls | causes | error before, after (cm) | gravity | drag coefficients |\n|---|---|---|---|---|")
    for count in (2, 3, 4, 5):
        for balls in combinations(sizes, count):
            judged = judge_falls([f for f in falls if f.ball in balls], G, sizes)
            words = []
            for ball in balls:
                (k, sigma), unit = judged.estimate("k_per_m", ball), judged.setting.drag_per_m(ball) or np.nan
                words.append(f"{ball.split()[0]} {k / unit:.2f} +- {judged.level * sigma / unit:.2f}")
            g = "" if judged.gravity is None else f"{judged.gravity[0]:.1f} +- {judged.level * judged.gravity[1]:.1f}"
            errors = f"{100 * judged.verdict.candidates[0].held_out_rms:.0f}, {100 * judged.best.held_out_rms:.0f}"
            print(f"| {count} | {judged.best.model.name} | {errors} | {g} | {', '.join(words)} |", flush=True)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--count", type=int, default=6)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--only", default="", help="kinds whose name holds this text")
    parser.add_argument("--no-sizes", action="store_true", help="masses and sizes of the balls are not given")
    parser.add_argument("--measured", type=Path, help="folder of five_balls.xlsx and balls.txt")
    asked = parser.parse_args()
    if asked.measured is not None:
        measured(asked.measured)
    else:
        simulated(asked.count, asked.seed, not asked.no_sizes, asked.only)


if __name__ == "__main__":
    main()
