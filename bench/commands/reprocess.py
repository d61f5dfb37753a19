"""`bench reprocess`: a recording to its table of flights, the plate's motion step by step, and pictures."""

from __future__ import annotations

import cmath
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bench.outputs import Overwrite

if TYPE_CHECKING:
    from analysis.flights.assemble import Flights
    from analysis.flights.classify import StepClass
    from daq.recording import Recording


def command(
    recording: Path = typer.Argument(help="The recording (HDF5)."),
    flights: Path | None = typer.Option(None, "--flights", metavar="FILE.csv", help="Write the table of flights."),
    json: str | None = typer.Option(None, "--json", metavar="FILE", help="The same for a machine; - prints it."),
    figures: Path | None = typer.Option(None, "--figures", metavar="FOLDER", help="Draw the pictures there."),
    overwrite: Overwrite = False,
) -> None:
    """From a recording to flights and plate motion, in one pass over the file.

    Example: bench reprocess run.h5 --flights flights.csv --figures pictures
    """
    from analysis.flights.classify import classify
    from analysis.flights.plausibility import plausibility_warnings
    from analysis.flights.table import write_csv
    from bench.jobs.reprocess import draw, flights_with_progress
    from bench.outputs import CSV, JSON, File, Folder, check_outputs
    from bench.terminal.console import EXIT_FAILED, EXIT_USAGE, fail, write_json
    from daq.instrument.stored import instrument_of
    from daq.recording import open_recording
    from daq.setup.errors import InputError

    try:
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
            odd = plausibility_warnings(opened, table.plate, instrument)
            own = None if instrument is None else instrument.as_json()
            write_json(as_json(opened, table, classes) | {"instrument": own, "warnings": odd}, json)
            if json != "-":
                _print(opened, table, classes)
                for line in () if instrument is None else instrument.in_words():
                    typer.echo(line)
                for line in odd:
                    typer.echo(f"note: {line}")
    except InputError as error:
        fail(str(error), EXIT_USAGE)
    except OSError as error:
        fail(f"{recording}: {error}; free some space, or name files that can be read and written", EXIT_FAILED)


def as_json(opened: Recording, table: Flights, classes: tuple[StepClass, ...]) -> dict[str, Any]:
    """Steps, plate and flights in counts, for a machine."""
    from analysis.flights.assemble import FlightFlag

    report = table.edges
    witness = report.sensor_offset
    return {
        "recording": opened.path.name,
        "simulated": bool(opened.attrs.get("simulated")),
        "flights": int((~table.has(FlightFlag.FALSE)).sum()),
        "flags": {str(f.name): int(table.has(f).sum()) for f in FlightFlag},
        "edges": {
            "opening_tau_s": report.opening.tau_s,
            "closing_tau_s": report.closing.tau_s,
            "dips": report.dips,
        },
        "sensor_offset": None
        if witness is None
        else {
            "offset_s": witness.offset_s,
            "uncertainty_s": witness.uncertainty_s,
            "pairs": witness.pairs,
        },
        "accelerometer_noise_mps2": table.plate.noise_mps2,
        "steps": [_step_json(table, own) for own in classes],
    }


def _step_json(table: Flights, own: StepClass) -> dict[str, Any]:
    """One step for a machine; a step that could not be fitted has only its verdict."""
    plate = table.plate.steps[own.step]
    row: dict[str, Any] = {
        "step": own.step,
        "verdict": own.label,
        "flights": own.flights,
        "double_hits": own.double_hits,
        "modes": own.modes,
        "mean_flight_time_s": own.mean_s,
        "repeat_s": own.repeat_s,
        "expected_repeat_s": own.expected_s,
    }
    if plate is None:
        return row
    fit = plate.acceleration
    row |= {
        "gamma": plate.gamma,
        "gamma_uncertainty": plate.gamma_uncertainty,
        "gamma_peak": plate.gamma_peak,
        "gamma_from_drive": plate.gamma_drive,
        "frequency_hz": plate.frequency_hz,
        "masked": plate.masked,
        "tones": [
            {"frequency_hz": f, "amplitude_mps2": abs(z), "phase_rad": cmath.phase(z), "uncertainty_mps2": s}
            for f, z, s in zip(
                fit.frequencies_hz.tolist(), fit.amplitudes.tolist(), fit.amplitude_sigma().tolist(), strict=True
            )
        ],
        "below_forcing": [{"frequency_hz": n.frequency_hz, "amplitude_mps2": n.amplitude_mps2} for n in plate.lines],
    }
    return row


IN_WORDS = {
    "FALSE": "are bounces of the contact, no flights",
    "DOUBLE_HIT": "are short rebounds",
    "RELAUNCHED": "begin where the ball had just landed",
    "ACCELEROMETER": "are dated by the accelerometer",
    "GAP": "touch lost samples",
    "SETTLING": "lie in the fade or settling time of a step",
    "CUT": "are cut off by the start, the end or a change of step",
    "UNSURE": "may hide a landing",
}
"""Words of each flag of a flight, after a number."""


def in_the_air(table: Flights) -> str:
    """The number of intervals in the air, and of each kind, in a sentence."""
    from analysis.flights.table import FlightFlag

    counts = ((int(table.has(flag).sum()), IN_WORDS[flag.name or ""]) for flag in FlightFlag)
    kinds = "; ".join(f"{n} {words}" for n, words in counts if n)
    return f"{len(table)} intervals in the air" + (f"; of these {kinds}" if kinds else "")


def _print(opened: Recording, table: Flights, classes: tuple[StepClass, ...]) -> None:
    """Tables for a person."""
    from rich import box
    from rich.table import Table

    from analysis.report.numbers import plus_minus
    from bench.terminal.console import GAMMA, print_lines, print_table

    title = f"{opened.path.name}{' (simulated rig)' if opened.attrs.get('simulated') else ''}"
    shown = Table(title=title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in ("step", "gamma", "+-", "peak", "by drive", "n", "double", "mean ms", "motion"):
        shown.add_column(name, justify="right", no_wrap=True)
    notes = []
    for own in classes:
        plate = table.plate.steps[own.step]
        mean = f"{1e3 * own.mean_s:.3f}" if own.flights else ""
        if plate is None:
            shown.add_row(str(own.step), *[""] * 4, str(own.flights), str(own.double_hits), mean, "too short to fit")
            continue
        notes += [
            f"step {own.step}: {n.amplitude_mps2:.3f} m/s^2 at {n.frequency_hz:.1f} Hz, below the forcing"
            for n in plate.lines
        ]
        shown.add_row(
            str(own.step),
            f"{plate.gamma:.4f}",
            f"{plate.gamma_uncertainty:.4f}",
            f"{plate.gamma_peak:.3f}",
            f"{plate.gamma_drive:.4f}",
            str(own.flights),
            str(own.double_hits),
            mean,
            own.label,
        )
    print_table(shown)
    print_lines(GAMMA, *notes, in_the_air(table))
    witness = table.edges.sensor_offset
    if table.edges.levels is None:
        print_lines("no continuity channel: only the plate was analysed")
    elif witness is None:
        print_lines("the accelerometer shows no impacts: landings that relaunch at once may hide")
    elif witness.uncertainty_s < 1.0:
        print_lines(
            f"the accelerometer shows a landing {plus_minus(1e6 * witness.offset_s, 1e6 * witness.uncertainty_s)} us "
            f"after the contact circuit does ({witness.pairs} landings)"
        )
