"""One recording in one row: what it is, its flights, how the model fares, and the verdict of the closed loop.

A recording that cannot be read gives a row with the reason; it stops nothing. Numbers are as the single commands
`reprocess`, `compare` and `close-loop` give them.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.files.json_values import json_object
from daq.setup.errors import InputError

if TYPE_CHECKING:
    from daq.recording import Recording
    from daq.setup.setup import Setup

Row = dict[str, Any]

PARTS = ("reprocess", "compare", "close-loop")


def examine(path: Path, parts: tuple[str, ...], profile: Path | None = None, anyway: bool = False) -> Row:
    """The row of one recording.

    Parameters
    ----------
    path
        The recording.
    parts
        What to do, of `PARTS`.
    profile
        Replaces the recording's own.
    anyway
        As in `analysis.loop.close_loop.close_loop`.

    Returns
    -------
    dict
        Text, numbers or None by column; ``failed`` is the reason why something is missing, else None.
    """
    from bench.profiles.find import load_measuring
    from daq.recording import open_recording

    began = time.process_time()
    row: Row = {"failed": None}
    try:
        setup = None if profile is None else load_measuring(profile)[0]
        with open_recording(path) as opened:
            if setup is not None:
                opened.measure_with(setup)
            for found in _measured(opened, parts):  # what was found before a failure stays
                row |= found
        if "close-loop" in parts:
            row |= _verdict(path, setup, anyway=anyway)
    except (ValueError, OSError, ArithmeticError) as error:
        row["failed"] = f"{type(error).__name__}: {error}" if not isinstance(error, InputError) else str(error)
    return json_object(row) | {"processor_s": time.process_time() - began}


def _measured(opened: Recording, parts: tuple[str, ...]) -> Iterator[Row]:
    """Columns about the recording, its flights, and the distance of the declared model from them."""
    from analysis.flights.assemble import flights_of
    from analysis.flights.compare import compare
    from analysis.flights.table import FlightFlag

    forcing, attrs = opened.setup.forcing, opened.attrs
    yield {
        "started": attrs.get("started"),
        "profile": opened.setup.name,
        "simulated": bool(attrs.get("simulated")),
        "ended": attrs.get("ended"),
        "frequency_hz": forcing.frequency_hz,
        "tone_ratio": forcing.ratio,
        "rate_hz": opened.rate_hz,
        "seconds": opened.n_samples / opened.rate_hz,
        "lost_samples": int(opened.gaps[:, 1].sum()),
        "steps": len(opened.steps),
        "damage": "; ".join(opened.damage) or None,
    }
    if not {"reprocess", "compare"} & set(parts):
        return
    table = flights_of(opened)
    gammas = np.array([p.gamma for p in table.plate.steps if p is not None])
    gammas = gammas[np.isfinite(gammas)]
    yield {
        "flights": int((~table.has(FlightFlag.FALSE)).sum()),
        "gamma_low": gammas.min(initial=np.inf),  # infinite, and then unknown, where no step could be fitted
        "gamma_high": gammas.max(initial=-np.inf),
        "accelerometer_noise_mps2": table.plate.noise_mps2,
    }
    if "compare" in parts and "continuity" in opened.channels:
        held = compare(table, opened.setup, steps_table=opened.steps)
        yield {
            "flights_short_by": held.short_by,
            "double_hits": held.double_hits,
            "first_bifurcation_over_predicted": held.first.ratio,
        }


def _verdict(path: Path, setup: Setup | None, *, anyway: bool) -> Row:
    """The verdict of the closed loop, saved next to the recording; values of what it names with their intervals."""
    from analysis.loop.close_loop import close_loop
    from bench.jobs.loops.keep_verdict import keep_verdict

    loop = close_loop([path], setup=setup, anyway=anyway)
    row: Row = {
        "verdict": loop.verdict,
        "effects": " + ".join(loop.selection.names),
        "tie_set": "; ".join(" + ".join(names) for names in loop.selection.ties),
        "landing_rms_before_us": loop.errors.before.landing_rms_us,
        "landing_rms_after_us": loop.errors.after.landing_rms_us,
        "noise_floor_us": loop.errors.landing_floor_us,
        "term": None if loop.discovered is None else f"{loop.discovered.term} of {loop.discovered.covariate.words}",
    }
    for added in loop.selection.effects:
        for name, (value, low, high) in added.parameters.items():
            column = f"{added.name}.{name}"
            row |= {column: value, f"{column}.low": low, f"{column}.high": high}
    for scale in loop.selection.calibrations:
        row[f"calibration.{scale.effect}.{scale.parameter}"] = scale.value
    return row | {"verdict_not_kept": keep_verdict(loop, [path]) or None}
