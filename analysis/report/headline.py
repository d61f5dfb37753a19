"""The verdict for a reader with ten seconds: what was found, how sure, what else it may be, errors."""

from __future__ import annotations

import math

import numpy as np

from analysis.loop.result import ClosedLoop
from analysis.report.narrative import gains, why_this_verdict
from analysis.report.wording import lost_in_words, microseconds, others_in_words, plain, size_of, what_is_left

LISTED = 3  # rival sets that are named
NOTABLE = 1.2  # fall of an error from which it is named beside that of landings


def headline(loop: ClosedLoop) -> str:
    """The verdict in plain sentences, the finding first; ends with a full stop."""
    if loop.verdict == "explained":
        return f"{_capital(_found(loop))}. {_errors(loop)} {_lost(loop)}{_certainty(loop)} {_rivals(loop)}"
    if loop.verdict == "nothing_missing":
        declared = ", ".join(plain(n) for n in loop.setup.declared) or "no effect beyond the ideal ball"
        return (
            f"Nothing is missing: the declared model ({declared}) predicts landings on held-out steps to "
            f"{microseconds(loop.after.landing_rms_us)} us rms, where noise alone gives "
            f"{microseconds(loop.noise_floor_us)} us. {_lost(loop)}"
        ).rstrip()
    best = f" Best so far, not believed: {_found(loop)}." if loop.effects else ""
    why = _capital(why_this_verdict(loop)[0])
    return f"Something is left that no named effect accounts for.{best} {_errors(loop)} {_lost(loop)}{why}"


def _found(loop: ClosedLoop) -> str:
    named = [f"{plain(f.name)} ({size_of(f)})" if f.parameters else plain(f.name) for f in loop.effects]
    listed = " and ".join([", ".join(named[:-1]), named[-1]] if len(named) > 1 else named)
    return f"{listed} {'explain' if len(named) > 1 else 'explains'} the recording"


def _errors(loop: ClosedLoop) -> str:
    """Errors before and after, against the noise: of landings, and of the kind of data that gained most."""
    noise = f"noise alone gives {microseconds(loop.noise_floor_us)} us"
    after, before = loop.after.landing_rms_us, loop.before.landing_rms_us
    if not loop.names:
        return f"Landings on held-out steps are missed by {microseconds(after)} us rms; {noise}."
    said = (
        f"Landings on held-out steps are missed by {microseconds(after)} us rms instead of {microseconds(before)} us; "
        f"{noise}."
    )
    fallen = [
        before / after,
        loop.before.takeoff_nmad_us / loop.after.takeoff_nmad_us,
        _plate_z(loop) / loop.remainder.plate_rms_z,
    ]
    most = int(np.nanargmax([x if math.isfinite(x) else 0.0 for x in fallen]))
    if most == 0 or fallen[most] < NOTABLE:
        return said
    if most == 1:
        return (
            f"Take-offs are missed by {microseconds(loop.after.takeoff_nmad_us)} us instead of "
            f"{microseconds(loop.before.takeoff_nmad_us)} us (robust; noise {microseconds(loop.takeoff_floor_us)} us). "
            f"{said}"
        )
    return (
        f"The plate is off by {loop.remainder.plate_rms_z:.1f} standard deviations rms instead of "
        f"{_plate_z(loop):.1f}. {said}"
    )


def _lost(loop: ClosedLoop) -> str:
    """A sentence on the few landings that decide the error, with the space after it; or nothing."""
    words = lost_in_words(loop)
    return f"{words}. " if words else ""


def _plate_z(loop: ClosedLoop) -> float:
    """Rms residual of the plate's data under the declared model, in standard deviations; NaN without data."""
    plate = loop.plate
    return float(np.sqrt(np.mean((plate.before / plate.sigma) ** 2))) if len(plate) else float("nan")


def _certainty(loop: ClosedLoop) -> str:
    """Gain of the first effect on steps not fitted, and whether what is left looks like noise."""
    left = what_is_left(loop)
    gain = gains(loop).get(plain(loop.effects[0].name))
    if gain is None:
        return f"{_capital(left)}."
    first = _capital(plain(loop.effects[0].name))
    return f"{first} predicts steps not fitted better by {gain[0]:.0f} +- {gain[1]:.0f} nats; {left}."


def _rivals(loop: ClosedLoop) -> str:
    others = others_in_words(loop)
    if not others:
        return "No other named set of effects does as well."
    more = f" or {len(others) - LISTED} more" if len(others) > LISTED else ""
    return f"The data cannot tell it from {' or '.join(others[:LISTED])}{more}."


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
