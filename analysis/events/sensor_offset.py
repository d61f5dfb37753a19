"""Offset in time between accelerometer and contact circuit, measured on landings that both detect.

Where the landings do not agree on one offset, none is applied. Once it is known, both sensors' times of a landing are
combined by their uncertainties.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from analysis.events.edges import Edges
from analysis.events.impact_detection import ONSET_S, Impacts
from analysis.events.impact_template import SHORTEST_MASK_S
from analysis.events.levels import CLOSES
from analysis.plate.motion import PlateMotion
from analysis.statistics import core_sigma, mad_sigma, mean_sigma, nearest
from kernels.arrays import Floats, Integers

REACH_S = 1.5e-3  # largest distance of an electrical edge from its impact
SHORTEST_S = 2e-3  # flight at whose end an impact is its own
SMALL_OFFSET_S = 1e-4  # offset below which a chatter cannot be the cause
MAX_SPREAD_S = 4e-5  # largest spread of the landings about their common offset
CORE_SPREADS = 5.0  # distance from the centre within which landings are averaged
MOTION_S = 3e-4  # within which an impact is marked as late as motion is shown
LEAST_LATE_S = 1e-5  # delay of closings from which openings may have another


@dataclass(frozen=True)
class SensorOffset:
    """Accelerometer times relative to contact edges, on landings that both detect."""

    # accelerometer minus electrical edge, negative for a late contact circuit; 0 where the landings do not agree on one
    # (a ball that chatters before the circuit stays closed), or what take-offs tell of motion
    offset_s: float
    uncertainty_s: float  # its standard error; infinite there
    pairs: int  # landings used
    spread_s: float = 0.0  # standard deviation of the two sensors' times about it: what the contact jitters, too
    jitter_s: float = 0.0  # the contact's part of it, beyond the uncertainty of its edges
    motion_s: float = 0.0  # the ball's own scatter from cycle to cycle, in which the sensors do not differ
    rounding_s: float = 0.0  # that of the impacts to samples, by which all may be early or late; 0 for none
    repeated_s: float = 0.0  # error of the mean of rounded closings that come at few places between two samples

    def uneven_edges(self, sharp: bool) -> bool:
        """Whether closings may be seen by another time late than openings; ``sharp``: edges that show no RC.

        A contact that chatters closes at random; behind a comparator, which hides an RC, it closes after its impacts.
        Closings at few places between two samples are all early or late by the rounding, openings by another.
        """
        if not math.isfinite(self.uncertainty_s):
            return sharp
        # what calibrations of the circuit leave open between its edges and the plate is 2 us
        if self.repeated_s > max(2.0 * self.uncertainty_s, 2e-6):
            return True
        late_s = 0.0 if self.rounding_s > 0.0 else -self.offset_s  # impacts that are rounded may all be early
        return self.jitter_s > 0.0 or late_s > max(LEAST_LATE_S, CORE_SPREADS * self.uncertainty_s)


def calibrate(
    impacts: Impacts,
    takeoff_s: Floats,
    landing_s: Floats,
    landing_sigma_s: Floats,
    edge_bias_s: float,
    sampling_s: float,
    elsewhere: SensorOffset | None = None,
    repeated_s: float = 0.0,
    motion_late_s: float = math.nan,
) -> tuple[Impacts, SensorOffset]:
    """Impacts on the time axis of the contact edges, and the offset between the sensors.

    Flights with a single impact within `REACH_S` of the edge are used; they must agree: an instrument has one offset.

    Parameters
    ----------
    impacts : Impacts
        On the accelerometer's time axis.
    takeoff_s, landing_s, landing_sigma_s : arrays, shape (n,)
        Flights by the contact circuit.
    edge_bias_s, sampling_s : float
        Error that all edges may share; interval between the samples of the recording.
    elsewhere : SensorOffset, optional
        What other recordings of the rig show, taken where these landings show none.
    repeated_s : float
        By how much landings of the contact circuit scatter from cycle to cycle, beyond their uncertainties; infinite
        where they do not repeat: then either sensor may err by all that the two differ by.
    motion_late_s : float
        What take-offs tell (`motion_late`), NaN for nothing: a single impact near there is a landing's own; where these
        do not agree, all are so late, as a converter's filter delays them.
    """
    if elsewhere is None and abs(motion_late_s) > MOTION_S:
        elsewhere = SensorOffset(motion_late_s, np.inf, 0)
    impacts = replace(impacts, rounding_s=_rounding_s(impacts, sampling_s))
    d, own, strength = _differences(impacts, takeoff_s, landing_s, landing_sigma_s, motion_late_s)
    # of two landings no half is closer together than the other: neither offset nor spread is known
    if d.size < 3:
        return _not_shown(impacts, elsewhere)
    centre, spread = _shortest_half(d)
    spread = max(spread, float(np.median(own)))
    shared = np.abs(impacts.time_s[nearest(impacts.time_s, landing_s + centre)] - landing_s - centre)
    # a chatter ends at any distance, so that at a large offset most landings must have their impact there
    chance = abs(centre) > SMALL_OFFSET_S and float(np.mean(shared < CORE_SPREADS * spread)) < 0.5
    if spread > MAX_SPREAD_S or chance or _may_be_chatter(centre, spread, strength):
        return _not_shown(impacts, elsewhere)
    core = np.abs(d - centre) < CORE_SPREADS * spread
    # no contact jitters by more than the sensors differ, nor than landings that repeat
    scatter2 = core_sigma(np.abs(d[core] - np.median(d[core]))) ** 2 - float(np.median(own)) ** 2
    jitter = min(repeated_s, math.sqrt(max(scatter2, 0.0)))
    motion = math.sqrt(repeated_s**2 - jitter**2) if math.isfinite(repeated_s) else 0.0
    jitter = jitter if jitter > float(np.median(landing_sigma_s)) else 0.0  # less than its edges err by is chance
    bare, own = own, np.hypot(own, jitter)
    weight = 1.0 / (own[core] ** 2 + max(spread**2 - float(np.median(own)) ** 2, 0.0))
    centre, repeated = float(np.average(d[core], weights=weight)), mean_sigma(d[core])
    factor, of_both = (max(1.0, mad_sigma((d[core] - centre) / x[core])) for x in (own, bare))  # over what is stated
    own_sigma = float(np.hypot(np.sqrt(1.0 / weight.sum()) * factor, edge_bias_s))
    offset = SensorOffset(centre, own_sigma, int(core.sum()), spread, jitter, motion, impacts.rounding_s, repeated)
    factor = of_both if math.isinf(repeated_s) else factor  # nothing tells then which sensor errs
    return _with_bias(replace(impacts, time_s=impacts.time_s - centre), factor, own_sigma), offset


def _differences(
    impacts: Impacts, takeoff_s: Floats, landing_s: Floats, landing_sigma_s: Floats, motion_late_s: float
) -> tuple[Floats, Floats, Floats]:
    """Impact minus edge of flights that end with a single impact, its uncertainty, and the impact's strength, (m,)."""
    if landing_s.size == 0 or impacts.time_s.size == 0:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    delay_s, reach_s = motion_late_s, MOTION_S
    if math.isnan(motion_late_s):
        delay_s, reach_s = _delay_s(impacts.time_s, landing_s), REACH_S
    begin = np.searchsorted(impacts.time_s, takeoff_s + delay_s - REACH_S + SHORTEST_MASK_S)
    end = np.searchsorted(impacts.time_s, landing_s + delay_s + REACH_S)
    # of a shorter flight the impact before it may be the only one that is heard
    lone = np.flatnonzero((end - begin == 1) & (landing_s - takeoff_s > SHORTEST_S))
    partner = begin[lone]
    d = impacts.time_s[partner] - landing_s[lone]
    own = np.hypot(impacts.uncertainty_s[partner], landing_sigma_s[lone])
    near = np.abs(d - delay_s) < reach_s
    return d[near], own[near], impacts.strength[partner][near]


def _shortest_half(values: Floats) -> tuple[float, float]:
    """Median of the shortest interval that holds half of ``values`` (n,), and the standard deviation by its length."""
    ordered, half = np.sort(values), (values.size - 1) // 2
    width = ordered[half:] - ordered[: values.size - half]
    k = int(np.argmin(width))
    # half of a normal distribution lies within 1.35 standard deviations about its centre
    return float(np.median(ordered[k : k + half + 1])), float(width[k]) / 1.35


def _not_shown(impacts: Impacts, elsewhere: SensorOffset | None) -> tuple[Impacts, SensorOffset]:
    """Impacts by the offset that other recordings show, or none."""
    if elsewhere is None:
        return _with_bias(impacts, 1.0, impacts.onset_s), SensorOffset(0.0, np.inf, 0)
    moved = replace(impacts, time_s=impacts.time_s - elsewhere.offset_s)
    known = math.isfinite(elsewhere.uncertainty_s)
    return _with_bias(moved, 1.0, elsewhere.uncertainty_s if known else impacts.onset_s), elsewhere


def motion_late(plate: PlateMotion, takeoff_s: Floats, landing_s: Floats, step: Integers) -> float:
    """By how much later than the take-offs the accelerometer shows the motion, s; NaN where they do not tell.

    A ball at rest leaves at one acceleration of the plate, whatever the amplitude and whatever holds it back: at the
    right delay its take-offs lie together, elsewhere the steps part. ``step`` of each flight (n,), -1 for none.
    """
    rested = takeoff_s - np.append(np.nan, landing_s[:-1]) > 3e-3
    rests = np.flatnonzero(rested & np.isfinite(plate.forcing_tones(step)[0][0]))
    rests = rests[:: 1 + rests.size // 1000]
    # in one step all leave at one phase, which tells nothing
    if rests.size < 20 or np.unique(step[rests]).size < 4:
        return math.nan
    omega, z = plate.forcing_tones(step[rests])
    z = z * np.exp(1j * omega * plate.true_time_s(takeoff_s[rests]))

    def spread(late_s: Floats) -> Floats:
        """Of the acceleration, over its slope: where that turns, all amplitudes would seem to agree."""
        shown = z[:, None] * np.exp(1j * omega[:, None] * late_s[:, None])
        low, high = np.quantile(shown.real.sum(axis=0), [0.16, 0.84], axis=1)
        slope = np.median(np.abs((1j * omega[:, None] * shown).real.sum(axis=0)), axis=1)
        return np.asarray((high - low) / np.maximum(slope, 1e-9))

    coarse = np.linspace(-7e-3, 7e-3, 57)
    near = coarse[np.argmin(spread(coarse))] + np.linspace(-2.5e-4, 2.5e-4, 21)
    best = near[np.argmin(spread(near))]
    here, aside = spread(np.array([best])), spread(best + np.array([-MOTION_S, MOTION_S]))
    return float(best) if here[0] < 0.25 * aside.min() else math.nan


def common_offset(offsets: Sequence[SensorOffset]) -> SensorOffset | None:
    """The offset of recordings of one rig, uncertain by as much as they differ; None where none shows it.

    Each has a template with an onset of its own.
    """
    known = [x for x in offsets if math.isfinite(x.uncertainty_s)]
    if not known:
        return None
    place, sigma = (np.array([getattr(x, name) for x in known]) for name in ("offset_s", "uncertainty_s"))
    centre = float(np.average(place, weights=sigma**-2.0))
    scatter = max(mad_sigma(place - np.median(place)), ONSET_S) if len(known) > 2 else float(np.ptp(place)) + ONSET_S
    own = float(np.hypot(scatter, sigma.min()))
    middle = (
        float(np.median([getattr(x, name) for x in known]))
        for name in ("spread_s", "jitter_s", "motion_s", "rounding_s", "repeated_s")
    )
    return SensorOffset(centre, own, sum(x.pairs for x in known), *middle)


def _delay_s(impact_s: Floats, landing_s: Floats) -> float:
    """Delay of the accelerometer by its converter's filter, to `REACH_S`; 0 where most landings have an impact nearer.

    The delay is the one at which most landings have an impact within `MAX_SPREAD_S`.
    """
    # a converter's filter delays the accelerometer by 6 ms at most
    begin, end = (np.searchsorted(impact_s, landing_s + far) for far in (-REACH_S, 6e-3))
    index = (
        np.repeat(begin, end - begin)
        + np.arange((end - begin).sum())
        - np.repeat(np.cumsum(end - begin) - end + begin, end - begin)
    )
    d = np.sort(impact_s[index] - np.repeat(landing_s, end - begin))
    if not d.size:
        return 0.0
    within = np.searchsorted(d, d + 2.0 * MAX_SPREAD_S, side="right") - np.arange(d.size)
    best = int(np.argmax(within))
    far = d[best] > REACH_S - 2.0 * MAX_SPREAD_S and within[best] > 0.5 * landing_s.size
    return float(np.median(d[best : best + within[best]])) if far else 0.0


def _rounding_s(impacts: Impacts, sampling_s: float) -> float:
    """Standard deviation of the rounding to samples where all impacts lie at one place between them, else 0.

    Impacts that are timed within a sample come at any place.
    """
    # a few impacts lie at one place by chance
    if impacts.time_s.size < 20:
        return 0.0
    together = abs(np.mean(np.exp(2j * np.pi * impacts.time_s / sampling_s)))
    # the mean phasor of impacts at one place between two samples is 1 long, of those anywhere 0
    return sampling_s / math.sqrt(12.0) if together > 0.9 else 0.0


def _with_bias(impacts: Impacts, factor: float, bias_s: float) -> Impacts:
    """Impacts with their uncertainties multiplied by ``factor``, and a common error and their rounding added."""
    sigma = np.hypot(np.hypot(factor * impacts.uncertainty_s, bias_s), impacts.rounding_s)
    return replace(impacts, uncertainty_s=sigma)


def _may_be_chatter(offset_s: float, spread_s: float, strength: Floats) -> bool:
    """Whether a late edge may be the end of a chatter rather than a slow circuit.

    A chatter's length grows with the impact's speed; a circuit's delay does not. Where all impacts are equally strong
    the two cannot be separated, and a long delay is not accepted. An accelerometer behind the edges is late itself.
    """
    if offset_s > -SMALL_OFFSET_S:
        return False
    low, middle, high = np.quantile(strength, [0.1, 0.5, 0.9])
    variety = (high - low) / middle
    # impacts that vary by less than 30 % exclude no chatter; else its length would spread by a quarter of theirs
    return bool(variety < 0.3 or spread_s / abs(offset_s) > 0.25 * variety)


def combine_with_impacts(edges: Edges, impacts: Impacts, offset: SensorOffset) -> Edges:
    """Closings averaged with the accelerometer's impacts by inverse variance; both are rounded alike, if they are.

    A contact that chatters may close for good some time after the impact: then the impact is the landing.
    """
    closing = np.flatnonzero(edges.kind == CLOSES)
    if not closing.size or not impacts.time_s.size:
        return edges
    time_s, sigma = edges.time_s.copy(), edges.uncertainty_s.copy()
    sigma[closing] = np.hypot(sigma[closing], offset.jitter_s)
    partner = nearest(impacts.time_s, time_s[closing])
    own = np.hypot(impacts.uncertainty_s[partner], offset.uncertainty_s)
    difference = impacts.time_s[partner] - time_s[closing]
    # a contact that jitters by more than its edges' uncertainties is no reason to believe it where it errs most
    scatter = np.maximum(np.hypot(own, sigma[closing]), offset.spread_s)
    same = np.abs(difference) < 4.0 * scatter
    chosen, own = closing[same], own[same]
    share = sigma[chosen] ** 2 / (sigma[chosen] ** 2 + own**2)
    time_s[chosen] += share * difference[same]
    sigma[chosen] = np.maximum(sigma[chosen] * own / np.hypot(sigma[chosen], own), impacts.rounding_s)
    before = np.append(-np.inf, edges.time_s)[closing]  # the edge before each closing
    # a contact chatters for 0.3 ms at most: it closes for good so long after the impact
    late = ~same & (difference < 0.0) & (difference > -3e-4) & (impacts.time_s[partner] > before)
    chosen = closing[late]
    time_s[chosen] += difference[late]
    sigma[chosen] = np.hypot(impacts.uncertainty_s[partner], offset.uncertainty_s)[late]
    return Edges(time_s, sigma, edges.kind)
