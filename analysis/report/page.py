"""Pages of a report, the page of a closed loop, and tables that say where the data come from.

Templates hold the words, in `templates/`; they are filled with values of the result, and every text is escaped.
"""

from __future__ import annotations

import base64
import datetime
import functools
import hashlib
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from analysis.flights.assemble import flights_of
from analysis.flights.compare import FirstBifurcation, first_bifurcation
from analysis.flights.table import Flights
from analysis.loop.result import ClosedLoop
from analysis.loop.tables import loop_json
from analysis.loop.term_effect import TermEffect
from analysis.report import narrative, wording
from analysis.report.figures.loop import FIGURES
from analysis.report.figures.style import Figure, badge_text, save_picture
from analysis.report.wording import gamma_scale
from analysis.residuals.covariates import COVARIATES
from daq.channels.registry import CHANNELS
from daq.files.json_values import json_text
from daq.files.tables import BlockFlag
from daq.instrument.instrument import instrument_of
from daq.recording import Recording, open_recording
from daq.recording.verify import VerifyReport
from daq.setup.errors import InputError
from daq.setup.provenance import software_commit, software_version
from daq.setup.setup import quantities
from model.effects.registry import effect, resolve

LISTED = 12  # gaps and remarks in one row

Rows = list[tuple[str, ...]]

STATES = {
    "complete": "complete: the run ended as planned",
    "stopped": "stopped: ended early, whole",
    "incomplete": "incomplete: cut off, or still being written",
    "damaged": "damaged: something does not read back as it was written",
}


def source_words(name: str, *, simulated: bool) -> str:
    """The source of a figure's data, as written below it."""
    return f"{name}, {'simulated rig' if simulated else 'measured'}"


def software_words(version: str, commit: str) -> str:
    """Version and commit of the software, as text."""
    return f"shakerbench {version}{f' ({commit[:10]}{commit[40:]})' if commit else ''}"


def file_rows(recording: Recording, found: VerifyReport) -> Rows:
    """State of the file, its seal, its losses, and what made it."""
    a, blocks = recording.attrs, recording.blocks
    seal = "every byte agrees with its seal" if a.get("sealed") and found.state != "damaged" else "no seal that agrees"
    flags = {f.name: int(np.sum(blocks["flags"] & f.value > 0)) for f in BlockFlag}
    noted = ", ".join(f"{str(name).lower()} in {n}" for name, n in flags.items() if n)
    seconds = recording.n_samples / recording.rate_hz
    length = f"{recording.n_samples} a channel at {recording.rate_hz:.9g} Hz ({seconds:.3f} s)"
    lost = "no sample" + (", but samples are missing that no gap accounts for" if found.suspect else "")
    if len(gaps := recording.gaps):
        listed = ", ".join(f"{missing} before sample {first}" for first, missing in gaps[:LISTED])
        more = f", and {len(gaps) - LISTED} gaps more" if len(gaps) > LISTED else ""
        lost = f"{found.lost_samples} samples in {len(gaps)} gaps: {listed}{more}"
    rows: Rows = [
        ("file", recording.path.name),
        ("state", STATES[found.state] + (f" ({a.get('ended')}: {a['why']})" if a.get("why") else "")),
        ("seal", f"{seal}; read from end to end for this page"),
        ("begun, ended", f"{_when(a.get('started'))}, {_when(a.get('ended_at'))}"),
        ("samples", f"{length}; channels {', '.join(recording.channels)}"),
        ("lost", lost),
        ("blocks", f"{len(blocks)}; {noted or 'none overflown, late, clipped, filled or damaged'}"),
        ("software", software_words(str(a.get("software_version") or "unknown"), str(a.get("software_commit") or ""))),
    ]
    for key, words in (
        ("imported_from", "imported from"), ("imported_sha256", "SHA-256 of that file"),
        ("recovered_from", "recovered from"), ("scenario_sha256", "SHA-256 of the hidden scenario"),
    ):  # fmt: skip
        if a.get(key):
            rows.append((words, str(a[key])))
    rows += [(f"key {key}", str(value)) for key, value in a["extra"].items()]
    return [*rows, *(("remark", line) for line in found.where[:LISTED])]


def _when(text: object) -> str:
    return f"{str(text)[:19].replace('T', ' ')} UTC" if text else "unknown"


def rig_rows(recording: Recording) -> Rows:
    """The measurement: forcing, ball, channels, declared effects."""
    setup = recording.setup
    forcing, channels = setup.forcing, setup.channels
    kind = "simulated rig" if recording.attrs.get("simulated") else "a rig"
    declared = [
        f"{name}: " + ", ".join(f"{k} = {v:.5g}" for k, v in table.items()) if table else name
        for name, table in setup.declared_values().items()
    ]
    rows: Rows = [
        ("profile", setup.name + (f": {setup.description}" if setup.description else "")),
        ("made on", f"{kind}, back end {recording.attrs.get('backend') or 'unknown'}"),
        (
            "forcing",
            f"{forcing.frequency_hz:g} Hz, c = {forcing.ratio}, amplitudes {forcing.amplitude[0]:g} and "
            f"{forcing.amplitude[1]:g}, phases {forcing.phase_deg[0]:g} and {forcing.phase_deg[1]:g} degrees",
        ),
        ("ball", f"{setup.ball.mass_kg:g} kg; g = {setup.g_mps2.value:g} m/s^2"),
        ("declared effects", "; ".join(declared) or "none: the ideal ball"),
    ]
    for name in dict.fromkeys((*CHANNELS, *channels.recorded())):
        channel = channels.get(name)
        if channel is None:
            rows.append((name, "not recorded"))
            continue
        words = [f"{channel.coupling}, +-{channel.range_v:g} V"]
        words += [f"terminal {channel.terminal}"] if channel.terminal else []
        words += [f"serial number {channel.serial_number}"] if channel.serial_number else []
        rows.append((name, ", ".join(words)))
    if (instrument := instrument_of(recording)) is not None:
        rows += [("measured", line) for line in instrument.in_words()]
        rows += [("doubt", doubt.sentence) for doubt in instrument.doubts]
    return rows


def calibration_rows(recording: Recording) -> Rows:
    """Each quantity that can be calibrated: key, value, uncertainty, date, age when the run began, source, remark."""
    started = str(recording.attrs.get("started") or "")
    day = datetime.date.fromisoformat(started[:10]) if started else None
    most = recording.setup.calibration_days
    rows: Rows = []
    for _, key, quantity in quantities(recording.setup):
        if quantity is None:
            rows.append((key, "-", "-", "-", "-", "", "not measured"))
            continue
        age = (day - quantity.date).days if day is not None and quantity.date is not None else None
        remark = "never calibrated" if quantity.date is None else ""
        remark = f"older than {most} days" if age is not None and age > most else remark
        uncertainty = f"{quantity.uncertainty:.2g}" if quantity.uncertainty else "not stated"
        when = str(quantity.date or "-"), "-" if age is None else f"{age} days"
        rows.append((key, f"{quantity.value:.6g}", uncertainty, *when, quantity.source, remark))
    return rows


TEMPLATES = Path(__file__).parent / "templates"
SIGNS = {
    r" us\b": " µs", r"\(us\)": "(µs)", r"\bw\^2": "ω²", r"\^2\b": "²", r"\+-": "±",
    r"\bgamma_peak\b": "Γ<sub>peak</sub>", r"\bgamma\b": "Γ",
}  # fmt: skip
"""Signs on a page for what is plain text elsewhere."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Drawn:
    """A figure as an element of a page."""

    figure: Figure  # its row of the table of figures
    element: Markup  # ``<svg>`` or ``<img>``
    remark: str = ""  # what follows the caption; else empty
    key: str = ""  # its name in the page
    flights: str = ""  # that of the table of flights behind its points
    points: Mapping[str, str] | None = None  # see `run_page.packed`; None in a figure that the pointer does not know

    @property
    def caption(self) -> str:
        """Caption and remark."""
        return f"{self.figure.caption} {self.remark}".rstrip()


def signs(text: str) -> Markup:
    """Plain text as HTML, with the figures' signs for microseconds, gamma and plus or minus."""
    out = str(escape(text))
    for pattern, sign in SIGNS.items():
        out = re.sub(pattern, sign, out)
    return Markup(out)


@functools.cache
def _templates() -> Environment:
    made = Environment(
        loader=FileSystemLoader(TEMPLATES), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    made.policies["json.dumps_kwargs"] = {"allow_nan": False}
    made.filters.update(signs=signs, capital=wording.capital, plain=wording.plain, us=wording.microseconds)
    made.globals.update(
        words=wording, narrative=narrative, covariates=COVARIATES, effect=lambda name: effect(name).effect
    )
    return made


def fill(template: str, **values: Any) -> Markup:
    """The template of that name, filled; texts in ``values`` are escaped."""
    return Markup(_templates().get_template(template).render(values))


def whole_page(template: str, **values: Any) -> str:
    """A page that needs nothing but itself: `fill` with style, script, and a policy that allows no other script."""
    script = (TEMPLATES / "hover.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
    policy = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
    return fill(template, policy=policy, script=Markup(script), **values) + "\n"


def write_report(
    loop: ClosedLoop, folder: Path, *, recording: Path | None = None, progress: Progress | None = None,
    term_effect: TermEffect | None = None,
) -> Path:  # fmt: skip
    """Write ``report.html``, ``report.json`` and the figures into ``folder``; returns the page's path.

    Raises `InputError` when the folder cannot be written, or the recording cannot be read.

    Parameters
    ----------
    loop, folder
        The closed loop, as computed or as loaded from a file, and a folder, made where it does not exist.
    recording
        The first one: its first bifurcation, measured and predicted, is reported where it is given.
    progress
        Called with what is being done and the fraction done.
    term_effect
        The discovered term as an effect, and the loop with it.
    """
    say = progress or (lambda what, part: None)
    date, version, commit = datetime.date.today().isoformat(), software_version(), software_commit()
    software = {"date": date, "software_version": version, "software_commit": commit}
    first: Mapping[str, FirstBifurcation] = {}
    if recording is not None:
        say("report: first bifurcations", 0.0)
        with open_recording(recording) as opened:
            opened.measure_with(loop.setup)
            first = first_bifurcations(loop, flights_of(opened))
    badge = badge_text(loop.sources[0].file, simulated=loop.sources[0].simulated)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        payload = loop_json(loop, term_effect=term_effect) | {
            "first_bifurcation": _bifurcations_json(first),
            "recordings": [asdict(source) for source in loop.sources],
            "report": software,
        }
        (folder / "report.json").write_text(json_text(payload), encoding="utf-8")
        for i, figure in enumerate(FIGURES):
            say(f"report: figure of {figure.name}", i / len(FIGURES))
            save_picture(folder, figure.name, badge, functools.partial(figure.draw, loop))
        page = folder / "report.html"
        page.write_text(_loop_page(loop, first, software, folder, term_effect), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{folder}: cannot write the report ({error}); name a folder you can write to") from error
    return page


def first_bifurcations(loop: ClosedLoop, flights: Flights) -> dict[str, FirstBifurcation]:
    """First bifurcation of the loop's first recording, which has ``flights``, by the model ``before`` and ``after``.

    Empty where a model refuses the measured plate, or a value that was fitted: no verdict depends on it.
    """
    declared, improved = resolve(loop.setup.declared_values()), loop.improved_effects()
    try:
        before = first_bifurcation(flights, loop.setup, declared)
        after = before if improved == declared else first_bifurcation(flights, loop.setup, improved)
    except ValueError:
        return {}
    return {"before": before, "after": after}


def _bifurcations_json(first: Mapping[str, FirstBifurcation]) -> dict[str, object] | None:
    if not first:
        return None
    out: dict[str, object] = {"measured": None}
    if (seen := first["before"].measured) is not None:
        low, high = sorted((seen.gamma_before, seen.gamma_after))
        out["measured"] = {"type": seen.type, "gamma_low": low, "gamma_high": high}
    for model, x in first.items():
        out[model] = {"type": x.predicted_type, "gamma": x.predicted_gamma, "same_type_gamma": x.same_type_gamma}
    return out


def _loop_page(
    loop: ClosedLoop, first: Mapping[str, FirstBifurcation], software: dict[str, str], folder: Path,
    term_effect: TermEffect | None,
) -> str:  # fmt: skip
    """The page, with the figures that are in ``folder`` put in."""
    scale = gamma_scale(loop.setup.forcing, loop.steps.ratio)
    simulated = any(source.simulated for source in loop.sources)
    files = ", ".join(source.file for source in loop.sources)
    drawn = [
        Drawn(figure, Markup('<img alt="{}" src="data:image/png;base64,{}">').format(
            figure.name, base64.b64encode(path.read_bytes()).decode()))
        for figure in FIGURES if (path := folder / f"{figure.name}.png").exists()
    ]  # fmt: skip
    definition = scale.definition
    if loop.discovered is not None and loop.discovered.covariate.words == "gamma" and scale.factor != 1.0:
        definition += " Only the discovered curve is over gamma = A w^2/g."
    provenance = []  # date, rig, note and versions of each recording, and of this page
    for m in loop.sources:
        note, when = f"; note: {m.note}" if m.note else "", m.started[:19].replace("T", " ")
        made = f"{when + ' UTC' if when else 'date unknown'}; {software_words(m.software_version, m.software_commit)}"
        provenance.append((m.file, f"{m.rig}, back end {m.backend}; {made}{note}"))
    own = software_words(software["software_version"], software["software_commit"])
    provenance.append(("this page", f"{software['date']}; {own}"))
    return whole_page(
        "loop.html", title=f"Closed loop: {files}", kind="loop", heading="Closed loop", closed=loop, scale=scale,
        first=first, drawn=drawn, term_effect=term_effect, level=2, simulated=simulated, files=files,
        source=source_words(files, simulated=simulated), provenance=provenance,
        definition=definition,
    )  # fmt: skip
