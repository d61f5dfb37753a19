"""Everything that others measured, in one run: ideal model, cause, error before and after on what was not fitted.

Run ``python -m benchmarks.real_data [FOLDER]`` (default ../shared/data): falls, drops by sound, phone and camera. The
rows are those of docs/results/real-data.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from bench.jobs.drop_test import Request, measure
from daq.setup.errors import InputError


def rows_of(folder: Path) -> list[tuple[str, Request]]:
    """Every measurement by its name, with what is asked of it."""
    falls, tracked = folder / "tracked" / "falls", folder / "tracked"
    rows = [
        ("five balls from a bridge", Request((falls / "five_balls.xlsx",), balls=falls / "balls.txt")),
        ("sound of a bouncing ball", Request((folder / "audio" / "alessia_rimbalzi.wav",))),
        ("table-tennis ball, phone", Request(tuple(sorted((folder / "phyphox" / "pingpong_ball").glob("*.xlsx"))))),
        ("blue ball, phone", Request(tuple(sorted((folder / "phyphox" / "blue_ball").glob("*.xls"))))),
    ]
    for sheets in (1, 10, 50, 100, 300):
        files = tuple(sorted((tracked / "A4").glob(f"*-{sheets}-M.csv")))
        rows.append((f"marble on {sheets} sheets of paper", Request(files, fps=200.0)))
    return rows


def row(name: str, request: Request) -> str:
    """One line of the table."""
    try:
        payload = measure(request).outcome.payload
    except InputError as error:
        return f"| {name} | refused: {error} | | | |"
    unit = "m" if payload["kind"] == "falls" else "ms"
    models = {model["name"]: model for model in payload["models"]}
    errors = [models[which][f"held_out_rms_{unit}"] for which in (payload["models"][0]["name"], payload["best"])]
    before, after = ("-" if error is None else f"{error:.3g} {unit}" for error in errors)
    others = ", ".join(model for model in payload["tie_set"] if model != payload["best"]) or "none"
    left = "; ".join(payload["unexplained_because"]) or "the verdict names nothing"
    return f"| {name} | {payload['best']} (ties: {others}) | {before} | {after} | {left} |"


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path(__file__).parents[2] / "shared" / "data")
    arguments = parser.parse_args()
    print("| measured | cause | before | after (not fitted) | unexplained |\n|---|---|---|---|---|")
    for name, request in rows_of(arguments.folder):
        print(row(name, request), flush=True)


if __name__ == "__main__":
    main()
