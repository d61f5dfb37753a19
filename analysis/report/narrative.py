"""A verdict in sentences: for a reader with ten seconds, and the whole argument with the tests behind it.

Every number in them is in the verdict's JSON or its figures.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from analysis.loop.result import ClosedLoop
from analysis.report import wording
from analysis.report.wording import capital, microseconds, plain
from analysis.residuals.plate_data.plate_observables import KINDS
from analysis.statistics import mad_sigma
from model.effects.registry import effect

LISTED = 3  # candidates, kinds of plate data and rival sets of effects named in a sentence


def headline(loop: ClosedLoop) -> str:
    """The verdict in plain sentences, the finding first; ends with a full stop."""
    if loop.verdict == "explained":
        first, left = plain(loop.selection.effects[0].name), wording.what_is_left(loop)
        certainty = capital(left)
        if gain := gains(loop).get(first):
            certainty = (
                f"{capital(first)} predicts steps not fitted better by {gain[0]:.0f} +- {gain[1]:.0f} nats; {left}"
            )
        rivals = "No other named set of effects does as well."
        if others := wording.others_in_words(loop):
            more = f" or {len(others) - LISTED} more" if len(others) > LISTED else ""
            rivals = f"The data cannot tell it from {' or '.join(others[:LISTED])}{more}."
        return f"{capital(_found(loop))}. {_errors(loop)} {_lost(loop)}{certainty}. {rivals}"
    if loop.verdict == "nothing_missing":
        declared = ", ".join(plain(n) for n in loop.setup.declared) or "no effect beyond the ideal ball"
        return (
            f"Nothing is missing: the declared model ({declared}) predicts landings on held-out steps to "
            f"{microseconds(loop.errors.after.landing_rms_us)} us rms, where noise gives "
            f"{microseconds(loop.errors.landing_floor_us)} us. {_lost(loop)}"
        ).rstrip()
    best = f" Best so far, not believed: {_found(loop)}." if loop.selection.effects else ""
    why = capital(wording.why_this_verdict(loop)[0])
    return f"Something is left that no named effect accounts for.{best} {_errors(loop)} {_lost(loop)}{why}"


def _found(loop: ClosedLoop) -> str:
    named = [
        f"{plain(f.name)} ({wording.size_of(f)})" if f.parameters else plain(f.name) for f in loop.selection.effects
    ]
    listed = " and ".join([", ".join(named[:-1]), named[-1]] if len(named) > 1 else named)
    return f"{listed} {'explain' if len(named) > 1 else 'explains'} the recording"


def _errors(loop: ClosedLoop) -> str:
    """Errors before and after, against the noise: of landings, and of the kind of data that gained most."""
    noise = f"noise gives {microseconds(loop.errors.landing_floor_us)} us"
    after, before = (microseconds(errors.landing_rms_us) for errors in (loop.errors.after, loop.errors.before))
    if not loop.selection.names:
        return f"Landings on held-out steps are missed by {after} us rms; {noise}."
    said = f"Landings on held-out steps are missed by {after} us rms instead of {before} us; {noise}."
    fallen = [
        loop.errors.before.landing_rms_us / loop.errors.after.landing_rms_us,
        loop.errors.before.takeoff_nmad_us / loop.errors.after.takeoff_nmad_us,
        _plate_z(loop) / loop.remainder.plate_rms_z,
    ]
    most = int(np.nanargmax([x if math.isfinite(x) else 0.0 for x in fallen]))
    # an error that falls by less than a sixth is not named
    if most == 0 or fallen[most] < 1.2:
        return said
    if most == 1:
        us = (loop.errors.after.takeoff_nmad_us, loop.errors.before.takeoff_nmad_us, loop.errors.takeoff_floor_us)
        after, before, floor = map(microseconds, us)
        return f"Take-offs are missed by {after} us instead of {before} us (robust; noise {floor} us). {said}"
    return (
        f"The plate is off by {loop.remainder.plate_rms_z:.1f} standard deviations rms instead of "
        f"{_plate_z(loop):.1f}. {said}"
    )


def _lost(loop: ClosedLoop) -> str:
    """A sentence on the few landings that decide the error, with the space after it; or nothing."""
    words = wording.lost_in_words(loop)
    return f"{words}. " if words else ""


def _plate_z(loop: ClosedLoop) -> float:
    """Rms residual of the plate's data under the declared model, in standard deviations; NaN without data."""
    plate = loop.plate
    return float(np.sqrt(np.mean((plate.before / plate.sigma) ** 2))) if len(plate) else float("nan")


def reasoning(loop: ClosedLoop) -> list[str]:
    """Sentences in the order of the argument."""
    coverage = [f"{words}." for words in wording.coverage_in_words(loop)]
    found = [f"{words}." for words in wording.discovered_in_words(loop)]
    return [*_residual_sentences(loop), *_candidate_sentences(loop), *coverage, *wording.why_this_verdict(loop), *found]


def gains(loop: ClosedLoop) -> Mapping[str, tuple[float, float]]:
    """Held-out gain and standard error of every candidate added singly, nats: of each set its best, largest first."""
    best: dict[str, tuple[float, float]] = {}
    for c in loop.selection.candidates:
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
        ("landings", landing, loop.errors.landing_floor_us),
        ("take-offs", opening, loop.errors.takeoff_floor_us),
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
            f"they miss it by {microseconds(size)} us (robust), where noise would give {microseconds(floor)} us."
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
        out.append(
            f"of {len(ranked)} candidates added one at a time, these gain most on steps not fitted (nats): {listed}."
        )
    out += [f"{words}." for words in loop.selection.rounds]
    if loop.selection.rejected is not None:
        out.append(f"{wording.rejected_in_words(loop)}.")
    for name in map(plain, loop.selection.names):
        rivals = [plain(o) for o in effect(name.replace(" ", "_")).effect.confused_with]
        behind = [
            f"{o} by {ranked[name][0] - ranked[o][0]:.0f} nats"
            for o in rivals
            if name in ranked and o in ranked and ranked[o][0] < ranked[name][0]
        ]
        if behind:
            out.append(f"effects that are easily taken for {name} gain less: {', '.join(behind)}.")
    return out


def what_would_separate(loop: ClosedLoop) -> list[tuple[str, str, str]]:
    """An added effect, another that the data cannot tell from it, and what would separate them."""
    others = wording.others_in_words(loop)
    return [
        (plain(f.name), plain(other), how)
        for f in loop.selection.effects
        for other, how in effect(f.name).effect.confused_with.items()
        if any(plain(other) in x for x in others)
    ]
