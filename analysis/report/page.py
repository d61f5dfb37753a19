"""Report of a closed loop: one HTML page with its figures, and the same numbers as JSON.

The page is a function of the result alone; no recording is read for it.
"""

from __future__ import annotations

import base64
import datetime
import html
import json
import math
import re
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.loop.kept_term import KeptTerm
from analysis.loop.result import Bifurcation, ClosedLoop, FirstBifurcations
from analysis.loop.verdict_json import as_json
from analysis.report.figures_loop import draw_candidates, draw_errors
from analysis.report.figures_residuals import draw_landings, draw_plate, draw_takeoffs
from analysis.report.figures_terms import draw_discovery
from analysis.report.gamma import GammaScale, gamma_scale
from analysis.report.kept import forms_table, kept_section
from analysis.report.narrative import reasoning
from analysis.report.style import badge_text, save_picture
from analysis.report.wording import (
    interval,
    microseconds,
    moved_calibrations,
    others_in_words,
    plain,
    probability,
    rejected_in_words,
    unit_of,
    verdict_line,
)
from analysis.residuals.covariates import COVARIATES
from analysis.thresholds import FROZEN
from daq.recording.provenance import software_commit, software_version
from daq.setup.errors import InputError
from model.effects.registry import effect

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE = """
body{font:16px/1.5 Georgia,serif;max-width:52rem;margin:2rem auto;padding:0 1rem;color:#1d2630}
h1{font-size:1.6rem;margin-bottom:.2rem} h2{font-size:1.15rem;margin-top:2rem;border-bottom:1px solid #ccd}
table{border-collapse:collapse;margin:.6rem 0}
td,th{padding:.2rem .8rem;text-align:right;border-bottom:1px solid #e3e7ee}
th:first-child,td:first-child{text-align:left} img{width:100%;margin:.5rem 0} code{font-size:.9em}
.verdict{font-size:1.25rem;padding:.6rem 1rem;border-left:6px solid var(--c);background:#f5f7fa}
td.form{text-align:left}
.meta{font-size:.9em} .meta td{text-align:left;vertical-align:top}
.badge{color:#fff;padding:.1rem .5rem;font-size:.8rem;border-radius:4px;background:#2d6a4f}
.simulated{background:#a4161a}
"""
COLOURS = {"explained": "#2d6a4f", "unexplained": "#a4161a", "nothing_missing": "#12355b"}

Progress = Callable[[str, float], None]


def write_report(
    loop: ClosedLoop, folder: Path, *, progress: Progress | None = None, kept: KeptTerm | None = None
) -> Path:
    """Write ``report.html``, ``report.json`` and the figures into ``folder``; returns the page's path.

    Parameters
    ----------
    loop
        The closed loop, as computed or as loaded from a file.
    folder
        Made where it does not exist.
    progress
        Called with what is being done and the fraction done.
    kept
        The discovered term as a kept effect, and the loop with it.

    Raises
    ------
    InputError
        When the folder cannot be written.
    """
    say = progress or (lambda what, part: None)
    first = loop.sources[0]
    badge = badge_text(first.file, simulated=first.simulated)
    software = {
        "date": datetime.date.today().isoformat(),
        "software_version": software_version(),
        "software_commit": software_commit(),
    }
    pictures = loop_figures(loop)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        payload = json.dumps(_payload(loop, software, kept), indent=1)
        (folder / "report.json").write_text(payload + "\n", encoding="utf-8")
        for i, (name, draw) in enumerate(pictures.items()):
            say(f"report: figure of {name}", i / len(pictures))
            save_picture(folder, name, badge, draw)
        page = folder / "report.html"
        page.write_text(_page(loop, software, folder, kept), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{folder}: cannot write the report ({error}); name a folder you can write to") from error
    return page


def loop_figures(loop: ClosedLoop) -> dict[str, Callable[[Figure], None]]:
    """Functions that draw the figures of a closed loop, by name."""
    pictures: dict[str, Callable[[Figure], None]] = {
        "errors": partial(draw_errors, loop),
        "residuals": partial(draw_landings, loop),
        "takeoffs": partial(draw_takeoffs, loop),
        "plate": partial(draw_plate, loop),
        "candidates": partial(draw_candidates, loop),
    }
    if loop.discovered is not None:
        pictures["discovered"] = partial(draw_discovery, loop.discovered)
    return pictures


def _payload(loop: ClosedLoop, software: dict[str, str], kept: KeptTerm | None) -> dict[str, Any]:
    """The verdict with the first bifurcation and the provenance."""
    return as_json(loop, kept=kept) | {
        "first_bifurcation": _bifurcations_json(loop.first_bifurcations),
        "recordings": [asdict(source) for source in loop.sources],
        "report": software,
    }


def _bifurcations_json(first: FirstBifurcations | None) -> dict[str, object] | None:
    """First bifurcation in the data, by the declared model and by the improved one."""
    if first is None:
        return None
    measured = first.measured

    def predicted(b: Bifurcation) -> dict[str, object]:
        gammas = {"gamma": b.gamma_low, "same_type_gamma": b.same_type_gamma}
        return {"type": b.type} | {k: x if math.isfinite(x) else None for k, x in gammas.items()}

    return {
        "measured": measured
        and {"type": measured.type, "gamma_low": measured.gamma_low, "gamma_high": measured.gamma_high},
        "before": predicted(first.before),
        "after": predicted(first.after),
    }


def _picture(folder: Path, name: str) -> str:
    path = folder / f"{name}.png"
    if not path.exists():
        return ""
    return f'<img alt="{name}" src="data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}">'


def _page(loop: ClosedLoop, software: dict[str, str], folder: Path, kept: KeptTerm | None = None) -> str:
    """The page, with the figures in ``folder`` put in."""
    scale = gamma_scale(loop.setup.forcing, loop.steps.ratio)
    simulated = any(m.simulated for m in loop.sources)
    mark = (
        '<span class="badge simulated">simulated rig</span>'
        if simulated
        else '<span class="badge">measured on a rig</span>'
    )
    names = html.escape(", ".join(m.file for m in loop.sources))
    parts = [
        "<!doctype html><html lang='en'><meta charset='utf-8'>",
        f"<title>Closed loop: {names}</title>",
        f"<style>{STYLE}</style><h1>Closed loop</h1><p>{mark} {names}</p>",
        f"<p class='verdict' style='--c:{COLOURS[loop.verdict]}'><b>{html.escape(verdict_line(loop))}</b></p>",
        f"<p>{plain_html(_capital(rejected_in_words(loop)))}.</p>" if loop.rejected is not None else "",
        provenance_table(loop, software),
        f"<p>{plain_html(_definition(loop, scale))}</p>",
        *loop_parts(loop, scale, partial(_picture, folder), kept),
        "</html>",
    ]
    return "\n".join(p for p in parts if p)


def loop_parts(
    loop: ClosedLoop, scale: GammaScale, picture: Callable[[str], str], kept: KeptTerm | None = None
) -> list[str]:
    """The residual story of a closed loop as HTML; ``picture`` gives the element of a figure by its name."""
    return [
        _errors_table(loop),
        picture("errors"),
        _effects_table(loop),
        _bifurcation_sentence(loop.first_bifurcations, scale),
        "<h2>Why</h2>",
        _reasoning(loop),
        picture("candidates"),
        picture("discovered"),
        forms_table(loop.discovered) if loop.discovered is not None else "",
        kept_section(kept) if kept is not None else "",
        "<h2>What else it could be</h2>",
        _alternatives(loop),
        "<h2>What remains</h2>",
        _remains(loop),
        "<h2>What this run could not have shown</h2>",
        _hidden(loop),
        "<h2>Residuals against what might cause them</h2>",
        "<p>Every event is predicted from the one before it. Grey: the noise floor. Line: medians. Triangles: "
        "residuals beyond the axis, drawn at its edge; their number stands beside them.</p>",
        picture("residuals"),
        picture("takeoffs"),
        picture("plate"),
    ]


def plain_html(text: str) -> str:
    """Plain text as HTML, with the figures' signs for microseconds, gamma and plus or minus."""
    signs = {
        r" us\b": " &micro;s",
        r"w\^2": "&omega;&sup2;",
        r"\+-": "&plusmn;",
        r"\bgamma_peak\b": "&Gamma;<sub>peak</sub>",
        r"\bgamma\b": "&Gamma;",
    }
    text = html.escape(text)
    for plain_sign, sign in signs.items():
        text = re.sub(plain_sign, sign, text)
    return text


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _definition(loop: ClosedLoop, scale: GammaScale) -> str:
    """Definition of gamma on the page."""
    also = loop.discovered is not None and loop.discovered.covariate == "gamma" and scale.factor != 1.0
    return scale.definition + (" The discovered curve alone is over gamma = A w^2/g." if also else "")


def provenance_table(loop: ClosedLoop, software: dict[str, str]) -> str:
    """Date, rig, note and versions of each recording, and of this page."""
    rows = []
    for m in loop.sources:
        note = f"; note: {m.note}" if m.note else ""
        when = m.started[:19].replace("T", " ")
        version = software_words(m.software_version, m.software_commit)
        rows.append(
            (m.file, f"{m.rig}, back end {m.backend}; {when + ' UTC' if when else 'date unknown'}; {version}{note}")
        )
    own = software_words(software["software_version"], software["software_commit"])
    rows.append(("this page", f"{software['date']}; {own}"))
    body = "".join(f"<tr><td>{html.escape(a)}</td><td>{html.escape(b)}</td></tr>" for a, b in rows)
    return f"<table class='meta'>{body}</table>"


def software_words(version: str, commit: str) -> str:
    """Version and commit of the software, as text."""
    return f"shakerbench {version}{f' ({commit[:10]}{commit[40:]})' if commit else ''}"


def _errors_table(loop: ClosedLoop) -> str:
    b, a, floor = loop.before, loop.after, loop.noise_floor_us

    def us(value: float, low: float | None = None, high: float | None = None) -> str:
        band = "" if low is None or high is None else f" ({microseconds(low)} .. {microseconds(high)})"
        return f"{microseconds(value)}{band} &micro;s"

    rms = [us(e.landing_rms_us, e.landing_rms_us_low, e.landing_rms_us_high) for e in (b, a)]
    rows = [
        ("landing times, rms", *rms, us(floor)),
        ("landing times, robust", us(b.landing_nmad_us), us(a.landing_nmad_us), ""),
        ("take-off times, robust", us(b.takeoff_nmad_us), us(a.takeoff_nmad_us), us(loop.takeoff_floor_us)),
        (
            "flight times, relative", f"{100 * b.flight_time_relative:.3f} %", f"{100 * a.flight_time_relative:.3f} %",
            "",
        ),
    ]  # fmt: skip
    body = "".join(f"<tr><td>{n}</td><td>{x}</td><td>{y}</td><td>{z}</td></tr>" for n, x, y, z in rows)
    return (
        f"<table><tr><th>{a.flights} flights of {len(loop.held_out)} held-out steps</th><th>before</th><th>after</th>"
        f"<th>noise floor</th></tr>{body}</table><p>95 % intervals by resampling steps; "
        f"{100 * a.excluded_fraction:.1f} % of "
        "the flights were left out because their landing (grazing) could not be predicted from what was measured.</p>"
    )


def _effects_table(loop: ClosedLoop) -> str:
    if not loop.effects:
        return ""
    rows = "".join(
        f"<tr><td>{plain(f.name)}</td><td><code>{k}</code></td><td>{interval(v, lo, hi)} {unit_of(f.name, k)}</td></tr>"
        for f in loop.effects
        for k, (v, lo, hi) in f.parameters.items()
    )
    return f"<table><tr><th>added</th><th>parameter</th><th>value (95 % interval)</th></tr>{rows}</table>"


def _bifurcation_sentence(first: FirstBifurcations | None, scale: GammaScale) -> str:
    """First bifurcation, measured and predicted before and after."""
    if first is None:
        return ""

    def predicted(b: Bifurcation) -> str:
        known = math.isfinite(b.gamma_low)
        return f"{b.type} at {scale.name} {scale.factor * b.gamma_low:.4f}" if known else "none in the range"

    measured = "none found"
    if first.measured is not None:
        low, high = scale.factor * first.measured.gamma_low, scale.factor * first.measured.gamma_high
        measured = f"{first.measured.type} between {scale.name} {low:.4f} and {high:.4f}"
    before, after = predicted(first.before), predicted(first.after)
    words = f"First bifurcation: in the data {measured}; before: {before}; after: {after}."
    return f"<p>{plain_html(words)}</p>"


def _reasoning(loop: ClosedLoop) -> str:
    summaries = [
        f"<li><b>{plain(f.name)}</b>: {html.escape(effect(f.name).effect.summary)}.</li>" for f in loop.effects
    ]
    lines = [f"<li>{plain_html(_capital(r))}</li>" for r in reasoning(loop)]
    return f"<ol>{''.join(lines)}</ol>" + (f"<ul>{''.join(summaries)}</ul>" if summaries else "")


def _alternatives(loop: ClosedLoop) -> str:
    others = others_in_words(loop)
    if not others:
        return "<p>No other named set of effects predicts the held-out steps as well.</p>"
    hints = "".join(
        f"<li>{plain(f.name)} against {html.escape(plain(o))}: {plain_html(how)}</li>"
        for f in loop.effects
        for o, how in effect(f.name).effect.confused_with.items()
        if any(plain(o) in x for x in others)
    )
    listed = "; ".join(html.escape(o) for o in others)
    return f"<p>The data cannot tell it from: {listed}.</p>" + (
        f"<p>What would separate them:</p><ul>{hints}</ul>" if hints else ""
    )


def _remains(loop: ClosedLoop) -> str:
    left = loop.remainder
    words = (
        f"<p>Residuals over their noise: {left.ratio:.2f} times (flights), {left.plate_rms_z:.2f} times (plate). "
        f"Chance that noise alone leaves such a pattern in them: {html.escape(probability(left.p_lack_of_fit))}.</p>"
    )
    if left.covariate:
        words += f"<p>The pattern goes with: {html.escape(COVARIATES[left.covariate].words)}.</p>"
        if loop.verdict != "unexplained":
            words += (
                f"<p>It is within what is let pass, {FROZEN.lack_ratio:g} times the noise of the flights: in a quiet "
                "or a long run a trifle is significant.</p>"
            )
    if loop.discovered is not None:
        words += f"<p>Discovered: {html.escape(loop.discovered.description)}.</p>"
    notes = "".join(f"<li>{plain_html(_capital(n))}.</li>" for n in (*moved_calibrations(loop), *loop.notes))
    return words + (f"<ul>{notes}</ul>" if notes else "")


def _hidden(loop: ClosedLoop) -> str:
    """Detection limits of effects that were not added, and what no size would have shown."""
    rows = "".join(
        f"<tr><td>{plain(name.partition('.')[0])}</td><td><code>{name.partition('.')[2]}</code></td>"
        f"<td>{size:.2g} {unit_of(*name.split('.', 1))}</td></tr>"
        for name, size in sorted(loop.detection.items())
    )
    blind = ", ".join(map(plain, loop.not_identifiable)) or "none"
    return (
        "<p>An effect smaller than this would not have gained what is needed to be named, even alone:</p>"
        f"<table><tr><th>effect</th><th>parameter</th><th>hidden below</th></tr>{rows}</table>"
        f"<p>Not identifiable on this run at any size: {html.escape(blind)}.</p>"
    )
