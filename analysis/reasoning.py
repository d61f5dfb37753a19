"""The chain of reasoning in words: which residual, of what size, which candidates, why this one, and why this verdict.

The rule kept here: every sentence is made of numbers that are in the verdict's JSON or its pictures; none is a guess.
"""

from __future__ import annotations

import math

import numpy as np

from analysis.close_loop import Loop
from analysis.platedata import KINDS
from analysis.robust import SHARED_S
from analysis.thresholds import FROZEN, Thresholds
from model.effects import effect

LISTED = 3


def reasoning(loop: Loop, limits: Thresholds = FROZEN) -> list[str]:
    """Sentences in the order of the argument."""
    return [*_what_was_off(loop), *_what_was_tried(loop), *_why_this_verdict(loop, limits)]


def _what_was_off(loop: Loop) -> list[str]:
    """The residuals of the declared model, channel by channel."""
    values = loop.attribution.before.fitted.values
    world = loop.world
    residuals = world.residuals(values)
    out = []
    landing = residuals.landing_s[world.evidence.judged]
    opening = residuals.opening_s[world.opens]
    for event, found, floor in (
        ("landings", landing, loop.noise_floor_us), ("take-offs", opening, loop.takeoff_floor_us)
    ):  # fmt: skip
        known = 1e6 * found[np.isfinite(found)]
        if not len(known):
            out.append(f"no {event} were seen.")
            continue
        middle = float(np.median(known))
        when = "later" if middle > 0 else "earlier"
        size = 1.4826 * float(np.median(np.abs(known)))
        out.append(
            f"{event} came {abs(middle):.3g} us {when} than the declared model says (median); they miss it by "
            f"{size:.3g} us (robust), where noise alone would give {floor:.3g} us."
        )
    data = world.evidence.plate
    far = {KINDS[k]: float(np.sqrt(np.mean(z**2))) for k in np.unique(data.kind)
           if len(z := (residuals.plate / data.sigma)[data.kind == k])}  # fmt: skip
    odd = sorted((n for n, z in far.items() if z > FROZEN.plate_ratio), key=lambda n: -far[n])
    if odd:
        out.append("the plate differs from what the drive asks: " + ", ".join(
            f"{n} by {far[n]:.3g} standard deviations (rms)" for n in odd[:LISTED]) + ".")  # fmt: skip
    elif far:
        out.append("the plate moves as the drive asks, within its uncertainty.")
    return out


def _what_was_tried(loop: Loop) -> list[str]:
    """The candidates of the first round, and what each further one brought."""
    best: dict[str, tuple[float, float]] = {}
    for names, compared in loop.attribution.tried:
        name = " + ".join(names).replace("_", " ")
        if name not in best or compared.gain > best[name][0]:
            best[name] = (compared.gain, compared.error)
    ranked = sorted(best.items(), key=lambda item: -item[1][0])
    out = []
    if ranked:
        listed = ", ".join(f"{n} {g:.0f} +- {e:.0f}" for n, (g, e) in ranked[:LISTED])
        out.append(f"of {len(ranked)} candidates added alone, these gain most on steps not fitted (nats): {listed}.")
    out += [f"{words}." for words in loop.attribution.rounds]
    for name in loop.best.names:
        rivals = [o for o in effect(name).effect.confused_with if (o.replace("_", " ")) in best]
        behind = [
            f"{o.replace('_', ' ')} by {best[name.replace('_', ' ')][0] - best[o.replace('_', ' ')][0]:.0f} nats"
            for o in rivals
            if name.replace("_", " ") in best and best[o.replace("_", " ")][0] < best[name.replace("_", " ")][0]
        ]
        if behind:
            out.append(f"of what is easily taken for {name.replace('_', ' ')}, it leaves behind: {', '.join(behind)}.")
    return out


def _why_this_verdict(loop: Loop, limits: Thresholds) -> list[str]:
    """Which test the verdict rests on."""
    left, floor = loop.remainder, loop.noise_floor_us
    held = f"on held-out steps landings are missed by {loop.after.landing_rms_us:.3g} us rms, noise {floor:.3g} us"
    if loop.verdict != "unexplained":
        return [f"{held}; what is left looks like noise (p = {left.p_lack_of_fit:.2g})."]
    why = []
    if left.p_lack_of_fit < limits.lack_p and left.ratio > limits.lack_ratio:
        with_what = f", and goes with {left.covariate}" if left.covariate else ""
        why.append(f"what is left is {left.ratio:.2f} times the noise (p = {left.p_lack_of_fit:.1g}){with_what}")
    if left.plate_ratio > limits.plate_ratio:
        why.append(f"the plate is off by {left.plate_ratio:.2f} sigmas rms ({limits.plate_ratio:g} allowed)")
    named = loop.best is not loop.attribution.before
    landings, takeoffs = (
        limits.clean_bill * math.hypot(x, 1e6 * SHARED_S) for x in (floor, loop.takeoff_floor_us)
    )
    if named and loop.after.landing_rms_us > landings:
        why.append(f"{held}: more than {limits.clean_bill:g} times")
    if named and loop.after.takeoff_robust_us > takeoffs:
        missed = loop.after.takeoff_robust_us
        why.append(f"take-offs are missed by {missed:.3g} us (robust), noise {loop.takeoff_floor_us:.3g} us")
    return [f"called unexplained because {'; '.join(why)}."]
