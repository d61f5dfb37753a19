"""The argument in sentences: the residuals, the candidates, the one chosen, and the tests behind the verdict.

Every number in them is in the verdict's JSON or its figures.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from analysis.loop.result import ClosedLoop
from analysis.loop.verdict import Failed
from analysis.report.wording import lost_in_words, microseconds, plain, probability, rejected_in_words, what_is_left
from analysis.residuals.covariates import COVARIATES
from analysis.residuals.plate_observables import KINDS
from analysis.statistics import mad_sigma
from model.effects.registry import effect

LISTED = 3  # candidates and kinds of plate data named in a sentence


def reasoning(loop: ClosedLoop) -> list[str]:
    """Sentences in the order of the argument."""
    return [*_residual_sentences(loop), *_candidate_sentences(loop), *why_this_verdict(loop)]


def gains(loop: ClosedLoop) -> Mapping[str, tuple[float, float]]:
    """Held-out gain and standard error of every candidate added alone, in nats: of each set its best, largest first."""
    best: dict[str, tuple[float, float]] = {}
    for c in loop.candidates:
        name = " + ".join(plain(n) for n in c.names)
        if name not in best or c.gain > best[name][0]:
            best[name] = (c.gain, c.error)
    return dict(sorted(best.items(), key=lambda item: -item[1][0]))


def _residual_sentences(loop: ClosedLoop) -> list[str]:
    """The residuals of the declared model, channel by channel."""
    flights, out = loop.flights, []
    landing = flights.before.landing_residual_s[flights.scored]
    opening = flights.before.takeoff_residual_s[flights.from_rest]
    for event, found, floor in (
        ("landings", landing, loop.noise_floor_us),
        ("take-offs", opening, loop.takeoff_floor_us),
    ):
        known = 1e6 * found[np.isfinite(found)]
        if not len(known):
            out.append(f"no {event} were seen.")
            continue
        middle = float(np.median(known))
        when = "later" if middle > 0 else "earlier"
        size = mad_sigma(known)
        out.append(
            f"{event} came {microseconds(abs(middle))} us {when} than the declared model predicts (median); "
            f"they miss it by {microseconds(size)} us (robust), where noise alone would give {microseconds(floor)} us."
        )
    plate = loop.plate
    far = {
        KINDS[k]: float(np.sqrt(np.mean((plate.before / plate.sigma)[plate.kind == k] ** 2)))
        for k in np.unique(plate.kind)
    }
    odd = sorted((n for n, z in far.items() if z > loop.limits.plate_rms_z), key=lambda n: -far[n])
    if odd:
        listed = ", ".join(f"{n} by {far[n]:.1f} standard deviations (rms)" for n in odd[:LISTED])
        out.append(f"the plate differs from what the drive asks: {listed}.")
    elif far:
        out.append("the plate moves as the drive asks, within its uncertainty.")
    return out


def _candidate_sentences(loop: ClosedLoop) -> list[str]:
    """The candidates of the first round, and what each further one brought."""
    ranked = gains(loop)
    out = []
    if ranked:
        listed = ", ".join(f"{n} {round(g)} +- {e:.0f}" for n, (g, e) in list(ranked.items())[:LISTED])
        out.append(f"of {len(ranked)} candidates added alone, these gain most on steps not fitted (nats): {listed}.")
    out += [f"{words}." for words in loop.rounds]
    if loop.rejected is not None:
        out.append(f"{rejected_in_words(loop)}.")
    for name in map(plain, loop.names):
        rivals = [plain(o) for o in effect(name.replace(" ", "_")).effect.confused_with]
        behind = [
            f"{o} by {ranked[name][0] - ranked[o][0]:.0f} nats"
            for o in rivals
            if name in ranked and o in ranked and ranked[o][0] < ranked[name][0]
        ]
        if behind:
            out.append(f"effects that are easily taken for {name} gain less: {', '.join(behind)}.")
    return out


def why_this_verdict(loop: ClosedLoop) -> list[str]:
    """The tests that the verdict rests on."""
    floor, lost = loop.noise_floor_us, [f"{words}." for words in (lost_in_words(loop),) if words]
    if loop.failed:
        return [f"called unexplained because {'; '.join(_failure(loop, f) for f in loop.failed)}.", *lost]
    held = f"on held-out steps landings are missed by {microseconds(loop.after.landing_rms_us)} us rms, noise "
    return [f"{held}{microseconds(floor)} us; {what_is_left(loop)}.", *lost]


def _failure(loop: ClosedLoop, failed: Failed) -> str:
    """A failed test in words."""
    left = loop.remainder
    if failed.test == "flights":
        with_what = f", and goes with {COVARIATES[left.covariate].words}" if left.covariate else ""
        return f"what is left is {failed.found:.2f} times the noise ({probability(left.p_lack_of_fit)}){with_what}"
    if failed.test == "plate":
        return f"the plate is off by {failed.found:.2f} standard deviations rms ({failed.allowed:g} allowed)"
    event = "landings" if failed.test == "landings" else "take-offs"
    size, most = microseconds(failed.found), microseconds(failed.allowed)
    return f"on held-out steps {event} are missed by {size} us, where noise allows {most} us"
