"""The seed paper's own puzzle: which effect moves which published number, and under which reading they agree.

Run: ``python -m benchmarks.model.paper_puzzle docs/pictures``. Prints the tables of docs/explanation/paper-puzzle.md
and draws its picture. Everything is exact but for the instrument: 20 Hz, 20 kHz, a contact that stays closed for 0.2
ms.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import matplotlib
import numpy as np

from benchmarks.model.every_flight import Series, every_flight
from kernels.arrays import Floats
from model.bifurcations.events import Bifurcation
from model.bifurcations.find import find_bifurcations
from model.bifurcations.sweep import key, observed_bifurcations
from model.flight.records import FrictionRestitution
from model.orbits.attractor import AT_REST, attractor
from model.orbits.contact_sensor import Instrument, observe
from model.orbits.exact_ball import FrictionBall
from model.tones import Forcing

FREQUENCY_HZ = 20.0
OMEGA = 2.0 * math.pi * FREQUENCY_HZ
SEEN = Instrument(rate_hz=20000.0, closure_s=2e-4)
MERGED = Instrument(rate_hz=20000.0)
MU, E, E_SIGMA = 0.3, 0.514, 0.02
SHARE, SHARE_FRICTION, ROUNDED = 0.58, 0.83, 0.005
MODELS: Mapping[str, FrictionRestitution] = {
    "ideal": FrictionRestitution(),
    f"friction {MU:g}": FrictionRestitution(MU, MU),
    f"restitution {E:g}": FrictionRestitution(e0=E),
    "both": FrictionRestitution(MU, MU, E),
}
PEAK = {1: 2.0, 2: 1.0 / 0.2117715, 3: 1.0 / 0.1052122}  # gamma_peak of gamma = 1
SETTLE, KEEP = 500, 2000


@dataclass(frozen=True)
class Reading:
    """One way to read "friction 0.3 g": the ball, and by how much the plate's gamma is divided (another gravity)."""

    words: str
    rough: FrictionRestitution
    weight: float = 1.0


READINGS = (
    Reading("none (ideal)", FrictionRestitution()),
    Reading("0.3 of the weight, against the motion, static too", FrictionRestitution(MU, MU)),
    Reading("the same, while rising only", FrictionRestitution(MU, 0.0)),
    Reading("the same, while falling only", FrictionRestitution(0.0, MU)),
    Reading("0.3 g added to gravity", FrictionRestitution(), 1.0 + MU),
    Reading("0.3 g taken from gravity", FrictionRestitution(), 1.0 - MU),
    Reading("0.3 grams-force on 249.2 g", FrictionRestitution(MU / 249.2, MU / 249.2)),
)


def ball(rough: FrictionRestitution, c: int = 1) -> FrictionBall:
    """The ball of a model."""
    return FrictionBall(Forcing.superposition(c), *rough)


def first_change(rough: FrictionRestitution, c: int, low: float, high: float, steps: int = 120) -> Bifurcation | None:
    """The first change of the motion after take-off that a bench meets, gamma stepped up with the state carried."""
    own, state, before = ball(rough, c), AT_REST, None
    for a, b in pairwise(np.linspace(low, high, steps + 1)):
        found = attractor(own, float(b), state, 1024)
        state = found.last
        if found.flights and before is not None and key(found) != before:
            return next(
                x for x in observed_bifurcations(own, float(a), float(b), sweep="up", steps=1) if x.type != "take-off"
            )
        before = key(found) if found.flights else None
    return None


def levels(reading: Reading) -> dict[str, float]:
    """gamma_peak of take-off, lock, period doubling and the 2-cycle's sticking; no bounce."""
    found = {"take-off": 1.0 + reading.rough.mu_up}
    for event in find_bifurcations(ball(reading.rough), 0.5, 2.45, narrowest=1e-3):
        name = "2-cycle sticks" if event.type == "stick gained" else event.type
        found.setdefault(name, 2.0 * event.gamma)
    wanted = ("take-off", "lock", "period doubling", "2-cycle sticks")
    return {k: reading.weight * found[k] if k in found else math.nan for k in wanted}


def flown(rough: FrictionRestitution, gammas: Floats, c: int = 1, keep: int = KEEP) -> list[Series]:
    """Flights in the long run at each gamma."""
    return [every_flight(ball(rough, c), float(gamma), SETTLE, keep) for gamma in gammas]


def shown(orbit: Series, instrument: Instrument) -> Floats:
    """Flight times (phase) as the contact circuit shows them, in order."""
    tau, phase = orbit.tau, orbit.phase
    if not tau.any():
        return np.zeros(0)
    takeoff, landed = np.empty(tau.size), 0.0
    for k in range(tau.size):
        wait = (phase[k] - landed + 1e-9) % (2.0 * math.pi) - 1e-9
        takeoff[k] = landed + max(wait, 0.0)
        landed = takeoff[k] + tau[k]
    landing_s = np.minimum((takeoff + tau) / OMEGA, np.append(takeoff[1:] / OMEGA, np.inf))
    seen = observe(takeoff / OMEGA, landing_s, instrument)
    return np.asarray((landing_s[seen.last] - takeoff[seen.first] / OMEGA)[1:-1] * OMEGA)


def from_rest(orbit: Series) -> Floats:
    """Flights that start from rest: the first of each train of bounces."""
    return np.asarray(orbit.tau[orbit.reset])


def mean(x: Floats) -> float:
    """Mean, NaN of nothing."""
    return float(x.mean()) if x.size else math.nan


# -- tables -------------------------------------------------------------------------------------------------------
def row(*cells: object) -> None:
    """One row of a Markdown table."""
    words = ("-" if c != c else f"{c:.3f}" if isinstance(c, float) else str(c) for c in cells)
    print("| " + " | ".join(words) + " |")


def head(*cells: str) -> None:
    """The head of a Markdown table."""
    print()
    row(*cells)
    print("|---" * len(cells) + "|")


def bifurcations() -> None:
    """First change of each model, up; and what it is of each ideal event that may have been expected."""
    ideal = levels(READINGS[0])
    expected = [ideal[k] for k in ("lock", "period doubling", "2-cycle sticks")]
    head("model", "take-off", "first change", "type", "over lock", "over period doubling", "over 2-cycle sticks")
    cases = dict(MODELS)
    for e in (E - E_SIGMA, E + E_SIGMA):
        cases[f"both, e = {e:.3f}"] = FrictionRestitution(MU, MU, e)
    for mu in (0.25, 0.35):
        cases[f"both, mu = {mu:g}"] = FrictionRestitution(mu, mu, E)
    for name, rough in cases.items():
        found = first_change(rough, 1, 0.5 * (1.0 + rough.mu_up) + 0.01, 2.3)
        at = math.nan if found is None else 2.0 * found.gamma
        row(name, 1.0 + rough.mu_up, at, found.type if found else "-", *(at / x for x in expected))
    print(f"\nThe paper: take-off 1, first bifurcation near 2; {SHARE:.0%} of the three would be "
          + ", ".join(f"{SHARE * x:.3f}" for x in expected))  # fmt: skip


def readings() -> None:
    """What each reading of the friction does to the expectation and to the flights."""
    ideal = levels(READINGS[0])
    low, high = ((SHARE + s * ROUNDED) / (SHARE_FRICTION - s * ROUNDED) for s in (-1, 1))
    gammas = np.array([0.75, 1.0, 1.125])
    base = flown(FrictionRestitution(), gammas)
    head("friction 0.3 g is", "take-off", "lock", "period doubling", "over the ideal doubling",
         "flights at 1.5", "at 2", "at 2.25")  # fmt: skip
    for reading in READINGS:
        at = levels(reading)
        orbit = flown(reading.rough, gammas / reading.weight)
        ratios = [mean(from_rest(orbit[i])) / mean(from_rest(base[i])) for i in range(gammas.size)]
        doubled = at["period doubling"] / ideal["period doubling"]
        row(reading.words, at["take-off"], at["lock"], at["period doubling"], doubled, *ratios)
    print(f"\n{SHARE:.0%} becomes {SHARE_FRICTION:.0%} if the expectation is {low:.3f} .. {high:.3f} of the ideal one")


def flights() -> None:
    """Flight times over the ideal ball's at the same gamma, by what is counted as a flight."""
    peaks = np.arange(1.05, 4.0, 0.01)
    bands = ((1.05, 1.3), (1.3, 1.6), (1.6, 2.05), (2.05, 3.2), (3.2, 4.0))
    base = flown(FrictionRestitution(), peaks / 2.0, keep=400)
    ideal = np.array([mean(base[i].tau) for i in range(peaks.size)])
    head("model", "flights counted", *(f"{a:g} to {b:g}" for a, b in bands), "1.3 to 4")
    for name, rough in list(MODELS.items())[1:]:
        orbit = flown(rough, peaks / 2.0)
        each = [shown(orbit[i], SEEN) for i in range(peaks.size)]
        counted = {"first of each train": [from_rest(orbit[i]) for i in range(peaks.size)]}
        if rough.e0 > 0.0:  # without a bounce all are the same
            counted["every one that shows"] = each
            counted["longer than 5 ms"] = [x[x > 5e-3 * OMEGA] for x in each]
            counted["trains as one, no contact seen within"] = [shown(orbit[i], MERGED) for i in range(peaks.size)]
        for words, found in counted.items():
            ratio = np.array([mean(x) for x in found]) / ideal
            row(name, words, *(_median(ratio[(peaks >= a) & (peaks < b)]) for a, b in (*bands, (1.3, 4.0))))


def _median(x: Floats) -> float:
    known = x[np.isfinite(x)]
    return float(np.median(known)) if known.size else math.nan


def return_maps() -> None:
    """How regularly a long flight and a short one take turns (the paper: 2-cycle at 2.25, bimodal at 3.4)."""
    head("model", "gamma_peak", "flights below half a period", "a flight of the other kind follows")
    for name, rough in MODELS.items():
        for peak in (2.25, 3.4):
            found = np.linspace(peak - 0.02, peak + 0.02, 9)
            orbit = flown(rough, found / 2.0)
            trains = [shown(orbit[i], SEEN) < math.pi for i in range(found.size)]
            turns = [mean((x[1:] != x[:-1]).astype(float)) for x in trains]
            row(name, peak, mean(np.concatenate(trains).astype(float)), _median(np.array(turns)))


def forbidden() -> None:
    """Share of the flights at gamma_peak 5 to 8 about T = 0.06 s, where the paper saw a forbidden region."""
    peaks = np.linspace(5.0, 8.0, 151)
    bins = np.arange(40.0, 92.0, 4.0)
    head("model", *(f"{a:g} to {b:g} ms" for a, b in pairwise(bins)))
    for name, rough in MODELS.items():
        time_ms = 1e3 * np.concatenate([x.tau for x in flown(rough, peaks / 2.0, keep=600)]) / OMEGA
        row(name, *(f"{x / time_ms.size:.2%}" for x in np.histogram(time_ms, bins)[0]))


def two_tones() -> None:
    """The same four models on two tones, gamma = A w^2 / g."""
    head("c", "model", "take-off", "first change", "type", "over ideal", "flights after it (x 1.02), over ideal")
    for c in (2, 3):
        start = 1.0 / PEAK[c]
        first = math.nan
        for name, rough in MODELS.items():
            low = start * (1.0 + rough.mu_up)
            found = first_change(rough, c, 1.02 * low, 8.0 * start)
            at = math.nan if found is None else found.gamma
            first = at if name == "ideal" else first
            gammas = np.array([1.02 * at])
            ratio = mean(shown(flown(rough, gammas, c)[0], SEEN)) / mean(flown(FrictionRestitution(), gammas, c)[0].tau)
            row(c, name, low, at, found.type if found else "-", at / first, ratio)


# -- picture ------------------------------------------------------------------------------------------------------
def picture(path: Path) -> None:
    """Flight times over gamma_peak as the contact circuit shows them, and return maps with both effects."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    peaks = np.arange(0.9, 4.2, 0.004)
    drawn = pyplot.figure(figsize=(9.6, 8.6), constrained_layout=True)
    axes = drawn.subplot_mosaic([["ideal", "f"], ["e", "both"], ["two", "three"]], height_ratios=(1, 1, 1.15))
    base = flown(FrictionRestitution(), peaks / 2.0, keep=400)
    once = np.array([mean(base[i].tau) / (2.0 * math.pi) for i in range(peaks.size)])
    once[(peaks <= 1.0) | (peaks > 3.72)] = np.nan
    for panel, (name, rough) in zip(("ideal", "f", "e", "both"), MODELS.items(), strict=True):
        ax = axes[panel]
        _diagram(ax, peaks, rough)
        ax.plot(peaks, 0.6 * once, color="#e07a5f", lw=1.2, label="40 % below ideal")
        ax.axvline(1.0, color="#e07a5f", lw=0.9, ls="--", label="the paper: take-off, first bifurcation")
        ax.axvline(2.0, color="#e07a5f", lw=0.9, ls="--")
        ax.set_title(name, loc="left", fontsize=10)
        ax.set_xlim(0.9, 4.2)
        ax.set_ylim(0.0, 2.2)
        ax.set_xlabel(r"$\Gamma_{\mathrm{peak}}$")
        ax.set_ylabel("flight time, periods")
    axes["ideal"].legend(frameon=False, fontsize=8, loc="upper left")
    for panel, peak in (("two", 2.25), ("three", 3.4)):
        ax = axes[panel]
        orbit = flown(MODELS["both"], np.linspace(peak - 0.01, peak + 0.01, 5) / 2.0)
        for i in range(5):  # a bench holds gamma to half a percent
            times = shown(orbit[i], SEEN) / (2.0 * math.pi)
            ax.plot(times[:-1], times[1:], ".", ms=3, color="#12355b")
        ax.plot([0, 2], [0, 2], color="#adb5bd", lw=0.8)
        ax.set_title(rf"both, $\Gamma_{{\mathrm{{peak}}}}$ = {peak:g}: each flight against the one before", loc="left",
                     fontsize=10)  # fmt: skip
        ax.set_xlabel("flight time, periods")
        ax.set_ylabel("the next one")
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn.savefig(path, dpi=160)
    pyplot.close(drawn)


def _diagram(ax: object, peaks: Floats, rough: FrictionRestitution) -> None:
    orbit = flown(rough, peaks / 2.0, keep=120)
    dots = [shown(orbit[i], SEEN) / (2.0 * math.pi) for i in range(peaks.size)]
    at = np.concatenate([np.full(d.size, p) for p, d in zip(peaks, dots, strict=True)])
    ax.plot(at, np.concatenate(dots), ".", ms=1.1, mew=0, color="#12355b")  # type: ignore[attr-defined]


def main() -> None:
    """Print every table, draw the picture."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    for table in (bifurcations, readings, flights, return_maps, forbidden, two_tones):
        table()
    picture(folder / "paper_puzzle.png")


if __name__ == "__main__":
    main()
