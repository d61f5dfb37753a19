"""`bench reprocess`: a recording to its table of flights, the plate's motion step by step, and pictures."""

from __future__ import annotations

import cmath
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bench.outputs import CSV, JSON, Figures, File, Folder, Json, Overwrite, check_outputs
from bench.terminal.console import GAMMA, new_table, print_lines, print_table, write_json

if TYPE_CHECKING:
    from analysis.flights.assemble import Flights
    from analysis.flights.classify import StepClass


def command(
    recording: Path = typer.Argument(help="The recording (HDF5)."),
    flights: Path | None = typer.Option(None, "--flights", metavar="FILE.csv", help="Write the table of flights."),
    json: Json = None,
    figures: Figures = None,
    overwrite: Overwrite = False,
) -> None:
    """From a recording to flights and plate motion, in one pass over the file.

    Example: bench reprocess run.h5 --flights flights.csv --figures pictures
    """
    from analysis.flights.classify import classify
    from analysis.flights.compare import plausibility_warnings
    from analysis.flights.table import write_csv
    from bench.jobs.report import draw, flights_with_progress
    from daq.instrument.instrument import instrument_of
    from daq.recording import open_recording

    check_outputs(
        File("--flights", flights, CSV), File("--json", json, JSON), Folder("--figures", figures),
        inputs=[recording], overwrite=overwrite,
    )  # fmt: skip
    with open_recording(recording) as opened:
        table = flights_with_progress(opened, quiet=json == "-")
        classes = classify(table)
        if flights is not None:
            write_csv(table, flights)
        if figures is not None:
            draw(opened, table, figures)
        instrument = instrument_of(opened)
        odd = plausibility_warnings(opened, table, instrument)
        simulated = bool(opened.attrs.get("simulated"))
    about = {"recording": recording.name, "simulated": simulated}
    own = None if instrument is None else instrument.as_json()
    if write_json(about | _as_json(table, classes) | {"instrument": own, "warnings": odd}, json):
        _print(f"{recording.name}{' (simulated rig)' if simulated else ''}", table, classes)
        print_lines(*([] if instrument is None else instrument.in_words()), *(f"note: {line}" for line in odd))


def _as_json(table: Flights, classes: tuple[StepClass, ...]) -> dict[str, Any]:
    """Steps, plate and flights in counts; a step that could not be fitted has only its verdict."""
    from analysis.flights.table import FlightFlag

    steps: list[dict[str, Any]] = []
    for own in classes:
        plate = table.plate.steps[own.step]
        steps.append({
            "step": own.step, "verdict": own.label, "flights": own.flights, "double_hits": own.double_hits,
            "modes": own.modes, "mean_flight_time_s": own.mean_s, "repeat_s": own.repeat_s,
            "expected_repeat_s": own.expected_s,
        })  # fmt: skip
        if plate is None:
            continue
        fit = plate.acceleration
        tones = zip(fit.frequencies_hz, fit.amplitudes, fit.amplitude_sigma(), strict=True)
        steps[-1] |= {
            "gamma": plate.gamma, "gamma_uncertainty": plate.gamma_uncertainty, "gamma_peak": plate.gamma_peak,
            "gamma_from_drive": plate.gamma_drive, "frequency_hz": plate.frequency_hz, "masked": plate.masked,
            "tones": [
                {"frequency_hz": f, "amplitude_mps2": abs(z), "phase_rad": cmath.phase(z), "uncertainty_mps2": s}
                for f, z, s in tones
            ],
            "below_forcing": [
                {"frequency_hz": n.frequency_hz, "amplitude_mps2": n.amplitude_mps2} for n in plate.lines
            ],
        }  # fmt: skip
    edges, late = table.edges, table.edges.sensor_offset
    return {
        "flights": int((~table.has(FlightFlag.FALSE)).sum()),
        "flags": {str(f.name): int(table.has(f).sum()) for f in FlightFlag},
        "edges": {
            "opening_tau_s": edges.opening.tau_s, "closing_tau_s": edges.closing.tau_s, "dips": edges.dips,
        },
        "sensor_offset": None if late is None else {
            "offset_s": late.offset_s, "uncertainty_s": late.uncertainty_s, "pairs": late.pairs,
        },
        "accelerometer_noise_mps2": table.plate.noise_mps2,
        "steps": steps,
    }  # fmt: skip


IN_WORDS = {
    "FALSE": "are bounces of the contact, no flights",
    "DOUBLE_HIT": "are short rebounds",
    "RELAUNCHED": "begin where the ball had just landed",
    "ACCELEROMETER": "are dated by the accelerometer",
    "GAP": "touch lost samples",
    "SETTLING": "lie in the fade or settling time of a step",
    "CUT": "are cut off by the start, the end or a change of step",
    "UNSURE": "may hide a landing",
    "BY_HAND": "have a boundary that was set by hand",
}
"""Words of each flag of a flight, after a number."""


def _print(title: str, table: Flights, classes: tuple[StepClass, ...]) -> None:
    """Tables for a person."""
    from analysis.flights.table import FlightFlag
    from analysis.report.wording import plus_minus

    shown = new_table("step", "gamma", "+-", "peak", "by drive", "n", "double", "mean ms", "motion", title=title)
    notes = []
    for own in classes:
        plate = table.plate.steps[own.step]
        gammas, motion = [""] * 4, "too short to fit"
        if plate is not None:
            gammas, motion = [
                f"{plate.gamma:.4f}", f"{plate.gamma_uncertainty:.4f}", f"{plate.gamma_peak:.3f}",
                f"{plate.gamma_drive:.4f}",
            ], own.label  # fmt: skip
            notes += [
                f"step {own.step}: {n.amplitude_mps2:.3f} m/s^2 at {n.frequency_hz:.1f} Hz, below the forcing"
                for n in plate.lines
            ]
        mean = f"{1e3 * own.mean_s:.3f}" if own.flights else ""
        shown.add_row(str(own.step), *gammas, str(own.flights), str(own.double_hits), mean, motion)
    print_table(shown)
    counts = ((int(table.has(flag).sum()), IN_WORDS[flag.name or ""]) for flag in FlightFlag)
    kinds = "; ".join(f"{n} {words}" for n, words in counts if n)
    notes.append(f"{len(table)} intervals in the air" + (f"; of these {kinds}" if kinds else ""))
    late = table.edges.sensor_offset
    if table.edges.levels is None:
        notes.append("no continuity channel: only the plate was analysed")
    elif late is None:
        notes.append("the accelerometer shows no impacts: landings that relaunch at once may hide")
    elif late.uncertainty_s < 1.0:
        notes.append(
            f"the accelerometer shows a landing {plus_minus(1e6 * late.offset_s, 1e6 * late.uncertainty_s)} us "
            f"after the contact circuit does ({late.pairs} landings)"
        )
    elif late.offset_s:
        notes.append(
            f"by the take-offs the accelerometer shows motion {1e3 * late.offset_s:.2f} ms late; "
            "impacts are taken to be as late"
        )
    print_lines(GAMMA, *notes)
