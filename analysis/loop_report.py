"""The report of a closed loop: one page with its pictures, and the same as JSON.

The rule kept here: the page says what was added, on what evidence, what else it could be, and what is left; every
number on it is also in the JSON.
"""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from analysis.classify import Change
from analysis.close_loop import Loop, as_json, declared_after
from analysis.compare import FirstBifurcation, compare
from analysis.flights import flights_of
from analysis.pictures import badge_of
from analysis.pictures_beyond import draw_discovery
from analysis.pictures_loop import draw_candidates, draw_errors
from analysis.pictures_residuals import draw_landings, draw_plate, draw_takeoffs
from analysis.reasoning import reasoning
from analysis.thresholds import FROZEN
from daq.errors import InputError
from daq.recording import open_recording
from model.effects import effect, resolve

STYLE = """
body{font:16px/1.5 Georgia,serif;max-width:52rem;margin:2rem auto;padding:0 1rem;color:#1d2630}
h1{font-size:1.6rem;margin-bottom:.2rem} h2{font-size:1.15rem;margin-top:2rem;border-bottom:1px solid #ccd}
table{border-collapse:collapse;margin:.6rem 0}
td,th{padding:.2rem .8rem;text-align:right;border-bottom:1px solid #e3e7ee}
th:first-child,td:first-child{text-align:left} img{width:100%;margin:.5rem 0} code{font-size:.9em}
.verdict{font-size:1.25rem;padding:.6rem 1rem;border-left:6px solid var(--c);background:#f5f7fa}
.badge{color:#fff;padding:.1rem .5rem;font-size:.8rem;border-radius:4px;background:#2d6a4f}
.simulated{background:#a4161a}
"""
VERDICTS = {
    "explained": ("#2d6a4f", "Explained"),
    "unexplained": ("#a4161a", "Unexplained: something is left that no named effect accounts for"),
    "nothing_missing": ("#12355b", "Nothing is missing: the declared model explains the recording"),
}


def write_report(loop: Loop, recordings: Sequence[Path], folder: Path) -> Path:
    """Write ``report.html``, ``report.json`` and the pictures into ``folder``; returns the page's path.

    Raises
    ------
    InputError
        When the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with open_recording(recordings[0]) as opened:
        badge, simulated = badge_of(opened), bool(opened.attrs.get("simulated"))
    payload = as_json(loop)
    payload["first_bifurcation"] = first = _bifurcations(loop, recordings[0])
    (folder / "report.json").write_text(json.dumps(payload, indent=1) + "\n", encoding="utf-8")
    draw_errors(loop, folder, badge)
    draw_landings(loop, folder, badge)
    draw_takeoffs(loop, folder, badge)
    draw_plate(loop, folder, badge)
    draw_candidates(loop, folder, badge, FROZEN)
    if loop.discovered is not None:
        draw_discovery(loop.discovered, folder, badge)
    page = folder / "report.html"
    page.write_text(_page(loop, recordings, folder, first, simulated), encoding="utf-8")
    return page


def _bifurcations(loop: Loop, recording: Path) -> dict[str, object] | None:
    """First bifurcation in the data, by the declared model and by the improved one; None without enough flights."""
    setup = loop.world.evidence.setup
    with open_recording(recording) as opened:
        opened.measure_with(setup)
        flights, table = flights_of(opened), opened.steps
    declared, improved = resolve(setup.declared_values()), declared_after(loop)
    try:
        before = compare(flights, setup, effects=declared, steps_table=table).first
        after = before if improved == declared else compare(flights, setup, effects=improved, steps_table=table).first
    except (ValueError, InputError):
        return None
    return {"measured": _bracket(before.measured), "before": _predicted(before), "after": _predicted(after)}


def _bracket(change: Change | None) -> dict[str, object] | None:
    if change is None:
        return None
    low, high = sorted((change.gamma_before, change.gamma_after))
    return {"type": change.type, "gamma_low": low, "gamma_high": high}


def _predicted(first: FirstBifurcation) -> dict[str, object]:
    def plain(x: float) -> float | None:
        return float(x) if np.isfinite(x) else None

    return {
        "type": first.predicted_type,
        "gamma": plain(first.predicted_gamma),
        "same_type_gamma": plain(first.same_type_gamma),
    }


def _picture(folder: Path, name: str) -> str:
    path = folder / f"{name}.png"
    if not path.exists():
        return ""
    return f'<img alt="{name}" src="data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}">'


def _page(
    loop: Loop, recordings: Sequence[Path], folder: Path, first: dict[str, object] | None, simulated: bool
) -> str:
    colour, words = VERDICTS[loop.verdict]
    named = " + ".join(f.name.replace("_", " ") for f in loop.effects)
    partly = "; added so far: " if loop.verdict == "unexplained" else ": "
    added = partly + named if named else ""
    mark = (
        '<span class="badge simulated">simulated rig</span>'
        if simulated
        else '<span class="badge">measured on a rig</span>'
    )
    parts = [
        "<!doctype html><html lang='en'><meta charset='utf-8'>",
        f"<title>Closed loop: {html.escape(recordings[0].name)}</title>",
        f"<style>{STYLE}</style><h1>Closed loop</h1><p>{mark} {html.escape(', '.join(p.name for p in recordings))}</p>",
        f"<p class='verdict' style='--c:{colour}'><b>{words}</b>{added}</p>",
        _errors_table(loop),
        _picture(folder, "errors"),
        _effects_table(loop),
        _bifurcation_words(first),
        "<h2>Why</h2>",
        _reasoning(loop),
        _picture(folder, "candidates"),
        _picture(folder, "discovered"),
        "<h2>What else it could be</h2>",
        _alternatives(loop),
        "<h2>What remains</h2>",
        _remains(loop),
        "<h2>What this run could not have shown</h2>",
        _hidden(loop),
        "<h2>Residuals against what might cause them</h2>",
        "<p>Every event is predicted from the one before it. Grey: the noise floor. Line: medians.</p>",
        _picture(folder, "residuals"),
        _picture(folder, "takeoffs"),
        _picture(folder, "plate"),
        "</html>",
    ]
    return "\n".join(p for p in parts if p)


def _errors_table(loop: Loop) -> str:
    b, a, floor = loop.before, loop.after, loop.noise_floor_us
    rows = [
        (
            "landing times, rms",
            f"{b.landing_rms_us:.1f} ({b.landing_rms_us_low:.1f} .. {b.landing_rms_us_high:.1f}) &micro;s",
            f"{a.landing_rms_us:.1f} ({a.landing_rms_us_low:.1f} .. {a.landing_rms_us_high:.1f}) &micro;s",
            f"{floor:.1f} &micro;s",
        ),
        ("landing times, robust", f"{b.landing_robust_us:.1f} &micro;s", f"{a.landing_robust_us:.1f} &micro;s", ""),
        (
            "take-off times, robust",
            f"{b.takeoff_robust_us:.1f} &micro;s",
            f"{a.takeoff_robust_us:.1f} &micro;s",
            f"{loop.takeoff_floor_us:.1f} &micro;s",
        ),
        (
            "flight times, relative",
            f"{100 * b.flight_time_relative:.3f} %",
            f"{100 * a.flight_time_relative:.3f} %",
            "",
        ),
    ]
    body = "".join(f"<tr><td>{n}</td><td>{x}</td><td>{y}</td><td>{z}</td></tr>" for n, x, y, z in rows)
    return (
        f"<table><tr><th>{a.flights} flights of {len(loop.held_out)} held-out steps</th><th>before</th><th>after</th>"
        f"<th>noise floor</th></tr>{body}</table><p>95 % intervals by resampling steps; {100 * a.left_out:.1f} % of "
        "the flights were left out because their landing (grazing) could not be predicted from what was measured.</p>"
    )


def _effects_table(loop: Loop) -> str:
    if not loop.effects:
        return ""
    rows = "".join(
        f"<tr><td>{f.name}</td><td><code>{k}</code></td><td>{v:.5g}</td><td>{lo:.5g} .. {hi:.5g}</td></tr>"
        for f in loop.effects
        for k, (v, lo, hi) in f.parameters.items()
    )
    return f"<table><tr><th>added</th><th>parameter</th><th>value</th><th>95 % interval</th></tr>{rows}</table>"


def _bifurcation_words(first: dict[str, object] | None) -> str:
    if first is None:
        return ""

    def say(x: object) -> str:
        if not isinstance(x, dict):
            return "none found"
        if "gamma_low" in x:
            return f"{x['type']} between gamma {x['gamma_low']:.4g} and {x['gamma_high']:.4g}"
        return f"{x['type']} at gamma {x['gamma']:.4g}" if x["gamma"] is not None else "none in the range"

    measured, before, after = (say(first[k]) for k in ("measured", "before", "after"))
    return f"<p>First bifurcation: in the data {measured}; before: {before}; after: {after}.</p>"


def _reasoning(loop: Loop) -> str:
    summaries = [f"<li><b>{f.name}</b>: {html.escape(effect(f.name).effect.summary)}.</li>" for f in loop.effects]
    lines = [f"<li>{html.escape(r)}</li>".replace(" us", " &micro;s") for r in reasoning(loop)]
    return f"<ol>{''.join(lines)}</ol>" + (f"<ul>{''.join(summaries)}</ul>" if summaries else "")


def _alternatives(loop: Loop) -> str:
    others = [" + ".join(x.names) for x in loop.attribution.ties[1:]]
    if not others:
        return "<p>No other named set of effects predicts the held-out steps as well.</p>"
    hints = "".join(
        f"<li>{f.name} against {html.escape(o)}: {html.escape(how)}</li>"
        for f in loop.effects
        for o, how in effect(f.name).effect.confused_with.items()
        if any(o in x for x in others)
    )
    listed = "; ".join(html.escape(o) for o in others)
    return f"<p>The data cannot tell it from: {listed}.</p>" + (
        f"<p>What would separate them:</p><ul>{hints}</ul>" if hints else ""
    )


def _remains(loop: Loop) -> str:
    left = loop.remainder
    words = (
        f"<p>Excess over the noise floor: {left.ratio:.2f} times (flights), {left.plate_ratio:.2f} times (plate); "
        f"probability of so much lack of fit by chance: {left.p_lack_of_fit:.2g}.</p>"
    )
    if left.covariate:
        words += f"<p>What is left goes with: {html.escape(left.covariate)}.</p>"
    if loop.discovered is not None:
        words += f"<p>Discovered: {html.escape(loop.discovered.in_words)}.</p>"
    notes = "".join(f"<li>{html.escape(n)}</li>" for n in loop.notes)
    return words + (f"<ul>{notes}</ul>" if notes else "")


def _hidden(loop: Loop) -> str:
    """Detection limits of effects that were not added, and what no size would have shown."""
    rows = "".join(
        f"<tr><td>{name.partition('.')[0].replace('_', ' ')}</td><td><code>{name.partition('.')[2]}</code></td>"
        f"<td>{size:.2g} {_unit(*name.split('.', 1))}</td></tr>"
        for name, size in sorted(loop.detection.items())
    )
    blind = ", ".join(n.replace("_", " ") for n in loop.not_identifiable) or "none"
    return (
        "<p>An effect smaller than this would not have gained what is needed to be named, even alone:</p>"
        f"<table><tr><th>effect</th><th>parameter</th><th>hidden below</th></tr>{rows}</table>"
        f"<p>Not identifiable on this run at any size: {html.escape(blind)}.</p>"
    )


def _unit(name: str, parameter: str) -> str:
    """Unit of a parameter as printed; nothing where it has none."""
    unit = effect(name).effect.parameter(parameter).unit
    return "" if unit == "1" else unit
