"""The verdict of a closed loop: its words, and the tests that it rests on.

"Explained" needs a named cause, a remainder that is noise, and held-out events missed by noise only. Decision 65.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from analysis.attribution.choice import LogScoreDifference
from analysis.residuals.lack_of_fit import GoodnessOfFit
from analysis.residuals.prediction_errors import Errors, GivenOpenings
from analysis.thresholds import OUTLIER_FRACTION, Thresholds
from kernels.arrays import Bools, Floats

Verdict = Literal["explained", "unexplained", "nothing_missing"]

VERDICTS: Mapping[Verdict, str] = {
    "explained": "Explained",
    "unexplained": "Unexplained: something is left that no named effect accounts for",
    "nothing_missing": "Nothing is missing: the declared model explains the recording",
}


def short_verdict(verdict: str) -> str:
    """A verdict in one or two words: ``nothing missing``."""
    return verdict.replace("_", " ")


@dataclass(frozen=True)
class Failed:
    """A test of the verdict that was not passed."""

    # ``flights`` and ``plate``: residuals of all steps over their uncertainty, rms. ``landings`` and ``takeoffs``:
    # errors of held-out events, us. ``stake``: steps of a later run that miss what was predicted of them. ``law``: gain
    # of a discovered formula in place of the named effects, nats.
    test: Literal["flights", "plate", "landings", "takeoffs", "stake", "law"]
    found: float
    allowed: float  # the most that the test allows, in the unit of ``found``


def failed_tests(
    named: bool,
    left: GoodnessOfFit,
    after: Errors,
    floors_us: tuple[float, float],
    limits: Thresholds,
    chance_us: tuple[float, float] = (0.0, 0.0),
    given: GivenOpenings | None = None,
) -> tuple[Failed, ...]:
    """Tests that forbid to call a recording explained; empty where all are passed.

    ``left`` is of all steps; the others are of the held-out ones: errors, noise floors of landings and take-offs, what
    noise hardly exceeds (`noise_quantiles_us`), and landings conditioned on the openings of their steps.

    Held-out events are tested where an effect was ``named``: without a name, structure beyond the noise is what the
    tests of the remainder are for. These leave landings that are other events than predicted out, so that more of them
    than `OUTLIER_FRACTION` have the held-out landings tested as well.

    The contact circuit may shift all edges of a step by `SHARED_S`, so that no floor counts for less. Of take-offs the
    smaller of both measures counts: a few are hidden by a bounce, and where few steps open from rest, the middle one of
    them is no robust value. Nor may chance decide: the tones of a few steps err for all of their flights. Landings
    that are missed as far as their step's own openings foretell are missed because of the tones, and pass.
    """
    out = []
    if not left.flights_pass(limits):
        out.append(Failed("flights", left.ratio, limits.lack_ratio))
    if not left.plate_passes(limits):
        out.append(Failed("plate", left.plate_rms_z, limits.plate_rms_z))
    landing, takeoff = (
        max(limits.most_rms_us(floor), chance) for floor, chance in zip(floors_us, chance_us, strict=True)
    )
    # once the openings account for the errors of the tones, no more than noise may be left of held-out landings
    by_tones = given is not None and given.landing_rms_us <= max(limits.most_rms_us(given.floor_us), given.chance_us)
    judged = named or after.lost > max(OUTLIER_FRACTION * after.flights, 1.0)
    if judged and after.landing_rms_us > landing and not by_tones:
        out.append(Failed("landings", after.landing_rms_us, landing))
    if named:
        missed = min(after.takeoff_nmad_us, after.takeoff_rms_us)
        if missed > takeoff:
            out.append(Failed("takeoffs", missed, takeoff))
    return tuple(out)


def verdict_of(named: bool, failed: Sequence[Failed]) -> Verdict:
    """The verdict; ``named`` is that of `failed_tests`, which ``failed``."""
    return "unexplained" if failed else "explained" if named else "nothing_missing"


def confirmed_on_reserve(
    worse: Floats, better: Floats, train: Bools, limits: Thresholds, *, further: bool
) -> tuple[bool, LogScoreDifference]:
    """Whether an added effect stands on steps that its fit had not seen, and its gain on all of them.

    A small gain of the first effect stands if all steps together gain in proportion, and the reserved ones lie no more
    than two standard deviations below what the others promise: their sign alone would refute a weak effect one time in
    eight. A small gain of a ``further`` one stands only if the reserved steps gain as well, and twice the gain is
    asked, as it is the largest of many by chance.

    ``worse`` and ``better`` are losses by step without and with the effect, nats, (m,).
    """
    gain = LogScoreDifference.of(worse, better, np.ones_like(train))
    stands = gain.exceeds(limits.next_effect_nats, limits.next_effect_sigmas)
    if further:
        stands = stands and gain.gain > limits.reserve_factor * limits.next_effect_nats
    else:
        few = max(int(train.sum()), 1)
        promised = max(LogScoreDifference.of(worse, better, train).gain, 0.0) * (len(train) - few) / few
        agree = float((worse - better)[~train].sum()) > promised - limits.reserve_sigmas * math.sqrt(2.0 * promised)
        wanted = limits.first_effect_nats * len(train) / few
        stands = stands or (agree and gain.exceeds(wanted, limits.first_effect_sigmas))
    return stands or LogScoreDifference.of(worse, better, ~train).clipped > 0.0, gain
