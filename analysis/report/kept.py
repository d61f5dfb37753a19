"""A discovered term in words and tables: the formulas tried in its place, and what became of it as an effect."""

from __future__ import annotations

import html

from analysis.discovery.discover import Discovery
from analysis.loop.kept_term import KeptTerm
from analysis.report.wording import microseconds, plain, plus_minus


def form_in_words(found: Discovery) -> str:
    """The suggested formula with its values; empty where the curve does better than any."""
    form = found.form
    if form is None:
        return ""
    values = ", ".join(_parameter(*p) for p in zip(form.parameters, form.values, form.sigmas, form.units, strict=True))
    return f"a formula does as well: {form.name}, {form.expression} with {values} (x: {found.covariate}, SI)"


def kept_in_words(kept: KeptTerm) -> list[str]:
    """The kept term for a person, a line each."""
    what = f"formula: {kept.form}" if kept.form else "as the curve"
    out = [
        f"kept: {kept.file} ({what})",
        f"with it: {kept.words}",
        f"  on held-out steps landings are missed by {microseconds(kept.after.landing_rms_us)} us rms, before "
        f"{microseconds(kept.before.landing_rms_us)} us, noise {microseconds(kept.noise_floor_us)} us",
    ]
    if not kept.found_again:
        out.append(f"  {plain(kept.name)} was not named: look at the file before you use it")
    return out


def forms_table(found: Discovery) -> str:
    """HTML of the formulas fitted in place of the curve; empty where there are none."""
    if not found.forms:
        return ""
    rows = []
    for form in found.forms:
        values = "<br>".join(
            html.escape(_parameter(*p)) for p in zip(form.parameters, form.values, form.sigmas, form.units, strict=True)
        )
        name = html.escape(form.name)
        rows.append(
            f"<tr><td>{f'<b>{name}</b>' if form.name == found.suggested else name}</td>"
            f"<td class='form'><code>{html.escape(form.expression)}</code></td><td class='form'>{values}</td>"
            f"<td>{form.loss:+.1f} &plusmn; {form.error:.1f}</td><td>{form.penalised:+.1f}</td>"
            f"<td>{'yes' if form.as_good else 'no'}</td></tr>"
        )
    words = html.escape(form_in_words(found)) or "no short formula does as well as the curve"
    return (
        f"<h2>Formulas in place of the curve</h2><p>{words[:1].upper() + words[1:]}.</p>"
        "<table><tr><th>form</th><th>value of the term</th><th>parameters</th><th>loss over the curve's (nats)</th>"
        f"<th>with its parameters' cost</th><th>as good</th></tr>{''.join(rows)}</table>"
        f"<p>x is the {html.escape(found.covariate)} in SI units. Each was fitted to the events, not to the curve, and "
        "judged on steps that its fit did not see; a parameter costs four nats.</p>"
    )


def kept_section(kept: KeptTerm) -> str:
    """HTML of the kept term: its file, the verdict with it, and the errors."""
    rows = "".join(
        f"<tr><td>{name}</td><td>{microseconds(before)} &micro;s</td><td>{microseconds(after)} &micro;s</td>"
        f"<td>{floor}</td></tr>"
        for name, before, after, floor in (
            ("landing times, rms", kept.before.landing_rms_us, kept.after.landing_rms_us,
             f"{microseconds(kept.noise_floor_us)} &micro;s"),
            ("landing times, robust", kept.before.landing_nmad_us, kept.after.landing_nmad_us, ""),
            ("take-off times, robust", kept.before.takeoff_nmad_us, kept.after.takeoff_nmad_us, ""),
        )
    )  # fmt: skip
    file, words = html.escape(kept.file), html.escape(kept.words)
    what = f"as a formula ({html.escape(kept.form)})" if kept.form else "as the curve"
    return (
        f"<h2>Kept as {html.escape(plain(kept.name))}</h2><p>The term was written {what} to <code>{file}</code>, and "
        f"the loop was closed again with it in the library. <b>{words}</b></p>"
        f"<table><tr><th>held-out steps, with {html.escape(plain(kept.name))} known</th><th>before</th><th>after</th>"
        f"<th>noise floor</th></tr>{rows}</table>"
    )


def _parameter(name: str, value: float, sigma: float, unit: str) -> str:
    return f"{name} = {plus_minus(value, sigma)}{'' if unit == '1' else f' {unit}'}"
