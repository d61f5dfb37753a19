"""Words and numbers of a verdict, as pages, figures and terminal show them: one form for every kind of number.

Everything is computed in ``gamma = A w^2 / g`` of one tone. At c = 1 both tones are one sine, and the paper's
experimental axis is its peak acceleration, ``gamma_peak``: a constant multiple of gamma. Axes and pages show that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analysis.discovery.symbolic import FittedForm
from analysis.loop.result import AddedEffect, ClosedLoop
from analysis.loop.term_effect import TermEffect
from analysis.loop.verdict import VERDICTS, Failed
from analysis.residuals.covariates import COVARIATES
from analysis.residuals.prediction_errors import Errors
from daq.setup.setup import Forcing
from model.effects.registry import unit_of

BELOW = 1e-4  # a number smaller than this is written with an exponent


def interval(value: float, low: float, high: float) -> str:
    """A value with its interval, all to the same place: two significant digits of half the interval's width.

    Example: ``0.1178 (0.1100 .. 0.1255)``.
    """
    if not all(math.isfinite(x) for x in (value, low, high)):
        return f"{value:.4g} ({low:.4g} .. {high:.4g})"
    half, largest = 0.5 * (high - low), max(abs(value), abs(low), abs(high))
    place = 1 - math.floor(math.log10(half)) if half > 0.0 else 6
    if 0.0 < largest < BELOW:
        exponent = math.floor(math.log10(largest))
        digits = max(place + exponent, 0)
        shown = [f"{x / 10.0**exponent:.{digits}f}e{exponent}" for x in (value, low, high)]
    else:
        shown = [f"{x:.{min(max(place, 0), 9)}f}" for x in (value, low, high)]
    return f"{shown[0]} ({shown[1]} .. {shown[2]})"


def fixed(value: float, digits: int) -> str:
    """A number with so many decimals; a dash where there is none."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def microseconds(value: float) -> str:
    """Microseconds to a tenth, without a unit; a dash where there is none."""
    return fixed(value, 1)


def probability(p: float) -> str:
    """A probability as ``p = 0.03``; below 1e-9 as a bound."""
    return f"p = {p:.2g}" if p >= 1e-9 else "p < 1e-9"


def plus_minus(value: float, sigma: float) -> str:
    """A value with its standard deviation, both to the second significant digit of the latter."""
    if not (math.isfinite(value) and math.isfinite(sigma) and sigma > 0.0):
        return f"{value:.4g}"
    if max(abs(value), sigma) < BELOW:
        return f"{value:.2e} +- {sigma:.1e}"
    place = min(max(1 - math.floor(math.log10(sigma)), 0), 9)
    return f"{value:.{place}f} +- {sigma:.{place}f}"


PEAK_LABEL = "Γₚₑₐₖ = max(−ẍₚ)/g"
GAMMA_LABEL = "Γ = Aω²/g"


@dataclass(frozen=True)
class GammaScale:
    """The measure of gamma that is shown."""

    factor: float  # shown value over gamma
    name: str  # in plain text
    symbol: str  # a sign in figures
    label: str  # of an axis, with the definition
    definition: str  # one sentence


def gamma_scale(forcing: Forcing, ratios: ArrayLike) -> GammaScale:
    """The measure shown for steps driven at the frequency ratios ``ratios``: gamma_peak where all are 1, else gamma."""
    own = np.unique(np.asarray(ratios, dtype=np.int64))
    if own.tolist() == [1]:
        factor = float(abs(forcing.displacement_tones()[0][1])) if forcing.ratio == 1 else 2.0
        sense = f"gamma_peak = max(-a)/g = {factor:.4g} A w^2/g"
        return GammaScale(
            factor, "gamma_peak", "Γₚₑₐₖ", f"{PEAK_LABEL}   (c = 1)",
            f"{sense}: the greatest downward acceleration of the plate's sine over gravity (c = 1).",
        )  # fmt: skip
    at = f"   (c = {own[0]})" if len(own) == 1 else ""
    return GammaScale(
        1.0, "gamma", "Γ", f"{GAMMA_LABEL}{at}",
        "gamma = A w^2/g: the acceleration amplitude of the first tone over gravity, before the second is added.",
    )  # fmt: skip


# 95 % intervals that held the truth, of how many, on recordings of another plant; of all others together 278 of 281:
# docs/results/closed-loop.md
COVERAGE = {"amplitude_modulation": (19, 22)}


def capital(text: str) -> str:
    """A text with its first letter as a capital."""
    return text[:1].upper() + text[1:]


def plain(name: str) -> str:
    """The name of an effect for a person."""
    return name.replace("_", " ")


def size_of(found: AddedEffect) -> str:
    """Every parameter of an added effect with its 95 % interval and unit."""
    return ", ".join(
        f"{k} = {interval(v, lo, hi)} {unit_of(found.name, k)}".rstrip() for k, (v, lo, hi) in found.parameters.items()
    )


def coverage_in_words(loop: ClosedLoop) -> list[str]:
    """How often intervals of each added effect have held a known truth, a line each."""
    out = []
    for f in loop.selection.effects:
        held, of = COVERAGE.get(f.name, (278, 281))
        out.append(f"95 % intervals of {plain(f.name)} held the truth in {held} of {of} cases where it was known")
    return out


def verdict_line(loop: ClosedLoop) -> str:
    """The verdict in one line, with the size of every added effect and its 95 % interval."""
    words = VERDICTS[loop.verdict]
    if not loop.selection.effects:
        return words
    added = "; ".join(f"{plain(f.name)}, {size_of(f)}".removesuffix(", ") for f in loop.selection.effects)
    return f"{words}; best so far, not believed: {added}" if loop.verdict == "unexplained" else f"{words} by {added}"


def lost_in_words(loop: ClosedLoop, after: Errors | None = None) -> str:
    """Held-out landings that are other events than predicted, and the error without them; empty where that is alike.

    Of the verdict's causes, or of what leaves the errors ``after``.
    """
    after = after or loop.errors.after
    if not after.lost or loop.limits.most_rms_us(after.landing_rms_us_without_lost) > after.landing_rms_us:
        return ""
    were = "landing was" if after.lost == 1 else "landings were"
    return (
        f"{after.lost} of {after.flights} held-out {were} not as predicted; without them "
        f"{microseconds(after.landing_rms_us_without_lost)} us rms"
    )


def others_in_words(loop: ClosedLoop) -> list[str]:
    """Sets of effects that the data cannot tell from the best one."""
    return [" + ".join(plain(n) for n in names) for names in loop.selection.ties[1:]]


def rejected_in_words(loop: ClosedLoop) -> str:
    """The best candidate that was refused, with its gain and the reason; empty where none gained anything."""
    x = loop.selection.rejected
    if x is None:
        return ""
    names = " + ".join(plain(n) for n in x.names)
    return f"best rejected candidate: {names}, {x.gain:.0f} +- {x.error:.0f} nats; rejected because {x.reason}"


def moved_calibrations(loop: ClosedLoop) -> list[str]:
    """Calibrations that the fit has moved by more than their stated uncertainty, a line each."""
    return [
        f"calibration {plain(c.effect)}, {c.parameter}: fitted {plus_minus(c.value, c.sigma)}, stated "
        f"{plus_minus(c.stated, c.stated_sigma)} {unit_of(c.effect, c.parameter)}".rstrip()
        for c in loop.selection.calibrations
        if c.moved
    ]


def what_is_left(loop: ClosedLoop) -> str:
    """The remainder in words: like noise, or hardly, or, where it is certain and small enough to pass, by its size."""
    left = loop.remainder
    if left.p_lack_of_fit >= loop.limits.law_p:
        return f"what is left looks like noise ({probability(left.p_lack_of_fit)})"
    if left.p_lack_of_fit >= loop.limits.lack_p:
        beyond = f"more than noise would be p < {loop.limits.lack_p:g}"
        return f"what is left is hardly noise, but let pass ({probability(left.p_lack_of_fit)}; {beyond})"
    passed = f"times the noise, no more than is let pass ({loop.limits.lack_ratio:g})"
    if left.ratio > loop.limits.lack_ratio:
        like_noise = f"take-offs look like noise ({probability(left.p_takeoffs)})"
        return f"what is left of landings is {left.landing_ratio:.2f} {passed}, {like_noise}"
    return f"what is left is {left.ratio:.2f} {passed}"


def parameters_of(form: FittedForm) -> list[str]:
    """Each parameter of a formula with its value, standard deviation and unit."""
    rows = zip(form.parameters, form.values, form.sigmas, form.units, strict=True)
    return [
        f"{name} = {plus_minus(value, sigma)}{'' if unit == '1' else f' {unit}'}" for name, value, sigma, unit in rows
    ]


def discovered_in_words(loop: ClosedLoop) -> list[str]:
    """The discovered term, the suggested formula with its values, and the error with it, a line each."""
    if (found := loop.discovered) is None:
        return []
    out = [f"discovered: {found.description}"]
    if (form := found.form) is not None:
        values = ", ".join(parameters_of(form))
        out.append(
            f"a formula does as well: {form.name}, {form.expression} with {values} (x: {found.covariate.words}, SI)"
        )
    instead = f", in place of {' and '.join(plain(name) for name in found.instead_of)}," if found.instead_of else ""
    after = f"landings on held-out steps are missed by {microseconds(found.after.landing_rms_us)} us rms"
    lost = lost_in_words(loop, found.after)
    return [*out, f"with it{instead} {after}, noise {microseconds(found.noise_floor_us)} us", *([lost] if lost else ())]


def term_effect_in_words(term_effect: TermEffect) -> list[str]:
    """The discovered term as an effect, for a person, a line each."""
    what = f"formula: {term_effect.form}" if term_effect.form else "as the curve"
    out = [
        f"kept: {term_effect.file} ({what})",
        f"with it: {term_effect.words}",
        f"  on held-out steps landings are missed by {microseconds(term_effect.after.landing_rms_us)} us rms, before "
        f"{microseconds(term_effect.before.landing_rms_us)} us, noise {microseconds(term_effect.noise_floor_us)} us",
    ]
    if all(e.name != term_effect.name for e in term_effect.effects):
        out.append(f"  {plain(term_effect.name)} was not named: look at the file before you use it")
    return out


def why_this_verdict(loop: ClosedLoop) -> list[str]:
    """The tests that the verdict rests on."""
    floor, lost = loop.errors.landing_floor_us, [f"{words}." for words in (lost_in_words(loop),) if words]
    if loop.failed:
        return [f"called unexplained because {'; '.join(_failure(loop, f) for f in loop.failed)}.", *lost]
    held = f"on held-out steps landings are missed by {microseconds(loop.errors.after.landing_rms_us)} us rms, noise "
    return [f"{held}{microseconds(floor)} us; {what_is_left(loop)}.", *lost]


def _failure(loop: ClosedLoop, failed: Failed) -> str:
    """A failed test in words."""
    left = loop.remainder
    if failed.test == "flights":
        with_what = f", and goes with {COVARIATES[left.covariate].words}" if left.covariate else ""
        if left.only_takeoffs_fail(loop.limits):
            with_what = " in take-offs only, landings are as predicted: look for a contact that opens late now and then"
        chance = probability(left.p_flights(loop.limits))
        return f"what is left is {failed.found:.2f} times the noise ({chance}){with_what}"
    if failed.test == "plate":
        return f"the plate is off by {failed.found:.2f} standard deviations rms ({failed.allowed:g} allowed)"
    if failed.test == "law":
        better = f"foretells held-out steps better by {failed.found:.0f} nats and leaves no more than noise"
        return f"a discovered formula in place of what is named {better}"
    if failed.test == "stake":
        return "a later run does not meet the prediction that was staked on it"
    event = "landings" if failed.test == "landings" else "take-offs"
    size, most = microseconds(failed.found), microseconds(failed.allowed)
    return f"on held-out steps {event} are missed by {size} us, where noise allows {most} us"
