"""`bench info`, `bench verify`, `bench recover`: what a recording is, in which state, and a whole one made of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bench.outputs import HDF5, JSON, File, Json, Overwrite, check_outputs
from bench.terminal.console import ACHIEVED, EXIT_FAILED, new_table, print_lines, print_table, write_json
from daq.setup.errors import InputError

if TYPE_CHECKING:
    from daq.recording import Recording
    from daq.recording.verify import VerifyReport

ROOT = ("note", "started", "ended", "ended_at", "why", "simulated", "backend", "software_version", "software_commit",
        "recovered", "recovered_from", "imported_from")  # fmt: skip


def info(
    recording: Path = typer.Argument(metavar="REC.h5", help="Recording to look at."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Show what a recording is: note, keys, profile, channels, steps, and the verdict of `bench verify`.

    Leaves with 0 for complete or stopped, 1 for incomplete or damaged, 2 when the file is no recording. The profile's
    text: bench profile show REC.h5.

    Example: bench info run.h5
    """
    from daq.recording import open_recording
    from daq.recording.verify import verify

    check_outputs(File("--json", json, JSON), inputs=[recording], overwrite=overwrite)
    report = verify(recording)
    try:
        with open_recording(recording) as opened:
            answer = _described(opened, report)
    except InputError as error:
        if report.state != "damaged":
            raise
        answer = {"file": recording, "state": report.state, "where": [*report.where, str(error)]}
    if write_json(answer, json):
        where = (f"            {line}" for line in answer["where"])
        print_lines(f"{answer['file']}", f"  verdict   {answer['state']}", *where)
        if "steps" in answer:
            _print(answer)
    if report.state in ("incomplete", "damaged"):
        raise typer.Exit(EXIT_FAILED)


def _described(opened: Recording, report: VerifyReport) -> dict[str, Any]:
    """Everything for a machine; what is not known is null."""
    from daq.files.json_values import json_object
    from daq.files.tables import STEP_DTYPE
    from daq.instrument.instrument import instrument_of
    from daq.recording.header import header_of
    from daq.recording.notebook import notebook, read_remarks, side_file
    from model.effects.user_effects import effect_files

    setup, instrument, later = opened.setup, instrument_of(opened), read_remarks(side_file(opened.path))
    return json_object({
        "file": opened.path,
        "state": report.state,
        "where": report.where,
        **{key: opened.attrs.get(key) for key in ROOT if key in opened.attrs},
        "keys": opened.attrs["extra"],
        "rate_hz": opened.rate_hz,
        "n_samples": opened.n_samples,
        "seconds": opened.n_samples / opened.rate_hz,
        "lost_samples": report.lost_samples,
        "channels": list(opened.channels),
        "profile": {
            "name": setup.name,
            "description": setup.description,
            "frequency_hz": setup.forcing.frequency_hz,
            "tone_ratio": setup.forcing.ratio,
            "declared": setup.declared_values(),
        },
        "tags": list(later.tags),
        "notes": notebook(header_of(opened, all_bytes=True), later),
        "kept_effects": [{"name": path.stem, "file": path} for path in effect_files()],
        "instrument": None if instrument is None else instrument.as_json(),
        "steps": [{name: row[name] for name in STEP_DTYPE.names or ()} for row in opened.steps],
    })  # fmt: skip


def _print(answer: dict[str, Any]) -> None:
    """The same for a person."""
    from daq.instrument.instrument import Instrument
    from daq.recording.notebook import Entry, as_line

    rig = f"{'simulated rig' if answer.get('simulated') else 'a rig'}, {answer.get('backend') or 'back end unknown'}"
    profile, rate_hz = answer["profile"], answer["rate_hz"]
    declared = ", ".join(f"{k}.{q} = {v:g}" for k, table in profile["declared"].items() for q, v in table.items())
    lines = {
        "note": answer.get("note") or "none",
        "tags": " ".join(answer["tags"]) or "none",
        "keys": ", ".join(f"{k} = {_short(v)}" for k, v in answer["keys"].items()) or "none",
        "started": answer.get("started") or "unknown",
        "made on": rig,
        "samples": f"{answer['n_samples']} ({answer['seconds']:.3f} s at {rate_hz:.9g} Hz), "
                   f"{answer['lost_samples']} lost",
        "channels": ", ".join(answer["channels"]),
        "profile": f"{profile['name']}: {profile['frequency_hz']:g} Hz, c = {profile['tone_ratio']}"
                   + (f"; {profile['description']}" if profile["description"] else ""),
        "declared": declared or "no effects",
        "own effects": ", ".join(k["name"] for k in answer["kept_effects"]) or "none on this computer",
        "steps": str(len(answer["steps"])),
    }  # fmt: skip
    print_lines(*(f"  {key:<11} {value}" for key, value in lines.items()))
    if answer["instrument"] is not None:
        instrument = Instrument.from_json(answer["instrument"])
        print_lines(*(f"  measured    {line}" for line in instrument.in_words()))
        print_lines(*(f"  doubt       {doubt.sentence}" for doubt in instrument.doubts))
    given = 1 if answer.get("note") else 0  # which stands above
    print_lines(*(f"  noted       {as_line(Entry(**note))}" for note in answer["notes"][given:]))
    if not answer["steps"]:
        return
    table = new_table("step", "gamma", "achieved", "+-", "start\n(s)", "length\n(s)", "Hz", "c")
    for i, step in enumerate(answer["steps"]):
        table.add_row(
            str(i), _short(step["gamma"]), _short(step["achieved_gamma"]),
            _short(step["achieved_gamma_uncertainty"], 2),
            f"{step['first_sample'] / rate_hz:.3f}", f"{step['n_samples'] / rate_hz:.3f}", _short(step["frequency_hz"]),
            str(step["ratio"]),
        )  # fmt: skip
    print_table(table)
    print_lines(ACHIEVED)


def _short(value: Any, digits: int = 5) -> str:
    """A value as a person reads it; a dash where it is not known."""
    if value is None:
        return "-"
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def verify(
    recording: Path = typer.Argument(..., metavar="FILE", help="Recording to check."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Say whether a recording is complete, stopped, incomplete or damaged, and where. Every byte is read.

    Leaves with 0 for complete or stopped, 1 for incomplete or damaged, 2 when FILE is no recording.

    Example: bench verify run.h5
    """
    from daq.files.json_values import json_values
    from daq.recording.verify import verify as verified

    check_outputs(File("--json", json, JSON), inputs=[recording], overwrite=overwrite)
    report = verified(recording)
    if write_json({"file": recording, **json_values(report)}, json):
        seconds = report.n_samples / report.rate_hz if report.n_samples else 0.0
        summary = f"{report.state}: {recording} ({report.n_samples} samples, {seconds:.3f} s)"
        print_lines(summary, *(f"  {line}" for line in report.where))
    if report.state in ("incomplete", "damaged"):
        raise typer.Exit(EXIT_FAILED)


def recover(
    recording: Path = typer.Argument(..., metavar="FILE", help="Recording, cut off or damaged; it is only read."),
    out: Path = typer.Option(None, "--out", "-o", metavar="REC.h5", help="File to create [NAME.recovered.h5]."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Rebuild a verified recording from one that was cut off by a kill, a crash or a full disk, or that is damaged.

    Every block whose writing had been acknowledged is there; what is damaged is put right from the checksums, or is a
    gap. The new file says that it was recovered, and what was damaged. Leaves with 1 where something is gone.

    Example: bench recover run.h5 --out run.recovered.h5
    """
    from daq.recording.recover import default_out
    from daq.recording.recover import recover as recovered

    out = out or default_out(recording)
    check_outputs(
        File("--out", out, HDF5, lasting=True), File("--json", json, JSON), inputs=[recording], overwrite=overwrite
    )
    found = recovered(recording, out)
    if write_json(found, json):
        summary = f"{found.path}: {found.n_samples} samples, {found.n_steps} steps recovered"
        print_lines(summary, *(f"  {line}" for line in found.damage))
    if found.is_less:
        raise typer.Exit(EXIT_FAILED)
