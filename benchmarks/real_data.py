"""Everything that others measured, in one run: ideal model, cause, error before and after on what was not fitted.

Run ``python -m benchmarks.real_data [FOLDER] [--only TEXT]`` (default ../shared/data): falls, drops by sound, phone,
film and camera, and sweeps of a shaker. The rows are those of docs/results/real-data.md. Where PySINDy is installed
(``pip install pysindy``), its answer to the falls stands below.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from analysis.drop.falls.fit import Fall, with_balls
from analysis.drop.load import load_all
from analysis.drop.outcome import with_interval
from bench.jobs.drop_test import Request, measure
from daq.setup.errors import InputError
from kernels.arrays import Floats

HARMONICS = 5
WORDS = 160  # of a reason in the table


def rows_of(folder: Path) -> Iterator[tuple[str, Request]]:
    """Every drop test by its name, with what is asked of it."""
    falls, tracked, phone = folder / "tracked" / "falls", folder / "tracked", folder / "phyphox"
    yield "five balls from a bridge", Request((falls / "five_balls.xlsx",), balls=falls / "balls.txt")
    yield "sound of a bouncing ball", Request((folder / "audio" / "alessia_rimbalzi.wav",))
    yield "table-tennis ball, phone (30 drops)", Request(tuple(sorted((phone / "pingpong_ball").glob("*.xlsx"))))
    yield "blue ball, phone (30 drops)", Request(tuple(sorted((phone / "blue_ball").glob("*.xls"))))
    yield "green ball, film", Request((folder / "video" / "arza_bounceAmeen.avi",))
    sheets = sorted({int(path.stem.split("-")[1]) for path in (tracked / "A4").glob("*-*-M.csv")})
    for n in sheets:
        files = tuple(sorted((tracked / "A4").glob(f"?-{n}-M.csv")))
        yield f"marble on {n} sheets of paper ({len(files)} films)", Request(files, fps=200.0)
    for n in range(1, 5):
        yield f"marble, series HT-{n}", Request(tuple(sorted((tracked / "HT").glob(f"HT-{n}-*.csv"))), fps=200.0)
    for path in sorted((tracked / "vacuum").glob("*_Results_*.csv")):
        yield f"marble in a vacuum chamber, {path.stem}", Request((path,))


def row(name: str, request: Request) -> str:
    """One line of the table."""
    try:
        payload = measure(request).outcome.payload
    except InputError as error:
        return f"| {name} | refused: {str(error).removeprefix(f'{request.files[0]}: ')[:WORDS]} | | | | |"
    unit = "m" if payload["kind"] == "falls" else "ms"
    models = {model["name"]: model for model in payload["models"]}
    errors = [models[which][f"held_out_rms_{unit}"] for which in (payload["models"][0]["name"], payload["best"])]
    before, after = ("-" if error is None else f"{error:.3g} {unit}" for error in errors)
    others = ", ".join(model for model in payload["tie_set"] if model != payload["best"]) or "none"
    known = [f"{key} {with_interval(entry)}" for key, entry in models[payload["best"]]["parameters"].items()]
    left = "; ".join(payload["unexplained_because"])[:WORDS] or "the verdict names nothing"
    return f"| {name} | {payload['best']} (ties: {others}) | {', '.join(known)} | {before} | {after} | {left} |"


def sweep(path: Path) -> str:
    """A shaker's sweep, sensor 0: a pure tone at each step and its harmonics, each second stretch of 50 ms held out."""
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    table = table[table[:, 3] == 0.0]
    time, tone, up = table[:, 0], table[:, 1], table[:, 6]
    squares = []
    for part in np.split(np.arange(len(time)), np.flatnonzero(np.diff(tone)) + 1):
        since = time[part] - time[part[0]]
        fitted = (since / 0.05).astype(int) % 2 == 0
        if min(fitted.sum(), (~fitted).sum()) < 4 * HARMONICS:
            continue
        turns = 2.0 * np.pi * tone[part[0]] * since[:, None] * np.arange(1, HARMONICS + 1)
        full = np.column_stack([np.ones(len(part)), np.cos(turns), np.sin(turns)])
        pure = full[:, [0, 1, 1 + HARMONICS]]
        sizes = [np.linalg.lstsq(basis[fitted], up[part[fitted]], rcond=None)[0] for basis in (pure, full)]
        left = [up[part] - basis @ size for basis, size in zip((pure, full), sizes, strict=True)]
        squares.append([float((one[~fitted] ** 2).mean()) for one in left])
    before, after = np.sqrt(np.median(squares, axis=0))
    numbers = f"harmonics 2 to {HARMONICS} | - | {before:.3g} g | {after:.3g} g"
    return f"| shaker, {path.stem[3:22]} ({len(squares)} steps) | {numbers} | an amplitude that is being controlled |"


def sindy(falls: list[Fall]) -> Iterator[str]:
    """PySINDy's law of each ball's first drop, flown from the release of the second; nothing where not installed."""
    try:
        import pysindy
    except ImportError:
        yield "PySINDy is not installed: `pip install pysindy`."
        return
    yield "\n| ball | PySINDy's law of the first drop | error on the second |\n|---|---|---|"
    for ball in dict.fromkeys(fall.ball for fall in falls):
        first, second = [fall for fall in falls if fall.ball == ball][:2]
        speed, time = smoothed_speed(first)
        model = pysindy.SINDy(
            optimizer=pysindy.STLSQ(threshold=0.05), feature_library=pysindy.PolynomialLibrary(degree=2)
        )
        model.fit(speed[:, None], t=time, feature_names=["v"])
        law = model.coefficients()[0]
        yield f"| {ball} | v' = {model.equations()[0]} | {100 * flown_rms(law, second):.0f} cm |"


def smoothed_speed(fall: Fall) -> tuple[Floats, Floats]:
    """Speed by local parabolas of seven positions, and its times, once the ball moves."""
    speeds = [
        np.polyfit(fall.time_s[k - 3 : k + 4] - fall.time_s[k], fall.height_m[k - 3 : k + 4], 2)[1]
        for k in range(3, len(fall.time_s) - 3)
    ]
    speed, time = np.array(speeds), fall.time_s[3:-3]
    moving = speed < -1.0
    return speed[moving], time[moving]


def flown_rms(law: Floats, fall: Fall) -> float:
    """Rms error of ``v' = law[0] + law[1] v + law[2] v^2`` flown along a drop, its release fitted."""
    from scipy.integrate import solve_ivp
    from scipy.optimize import least_squares

    span = float(np.ptp(fall.time_s)) + 1.0
    grid = np.linspace(0.0, span, 400)
    run = solve_ivp(
        lambda _t, s: [s[1], law[0] + law[1] * s[1] + law[2] * s[1] ** 2], (0.0, span), [0.0, 0.0], t_eval=grid
    )

    def left(x: Floats) -> Floats:
        since = np.clip(fall.time_s - x[1], 0.0, run.t[-1])
        return np.asarray(fall.height_m - x[0] - np.interp(since, run.t, run.y[0]))

    found = least_squares(left, [float(fall.height_m.max()), float(fall.time_s[0])])
    return float(np.sqrt(np.mean(found.fun**2)))


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--only", default="", help="rows whose name holds this text")
    asked = parser.parse_args()
    if not asked.folder.is_dir():
        parser.error(f"{asked.folder}: no such folder; name the one that holds the measurements of others")
    print("| measured | cause | parameters | before | after (not fitted) | unexplained |\n" + "|---" * 6 + "|")
    for name, request in rows_of(asked.folder):
        if asked.only in name:
            print(row(name, request), flush=True)
    for path in sorted((asked.folder / "shaker").glob("os_*.csv")):
        if asked.only in "shaker":
            print(sweep(path), flush=True)
    book = asked.folder / "tracked" / "falls" / "five_balls.xlsx"
    if asked.only in "PySINDy" and book.is_file():
        read = [(item.name, item.fall) for item in load_all(book)]
        falls = with_balls([Fall(name, "", *fall) for name, fall in read if fall is not None])
        for line in sindy(falls):
            print(line, flush=True)


if __name__ == "__main__":
    main()
