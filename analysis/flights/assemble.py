"""Assembly of the table of flights from the single pass.

Contact edges bound the flights; impacts in the accelerometer only split the intervals between them. Doubtful flights
are flagged, not dropped. Events that a person changed are put in here, for all that reads flights. Decision 495.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from analysis.events.edge_jitter import Scatter
from analysis.events.edges import SHARP, Edges, time_edges
from analysis.events.impact_detection import NO_IMPACTS, Impacts
from analysis.events.levels import CLOSES, DIP, OPENS
from analysis.events.sensor_offset import MOTION_S, calibrate, combine_with_impacts, motion_late
from analysis.events.short_contacts import refine_short_contacts
from analysis.flights.events_corrected import changed_edges, changed_impacts, given_by_hand, undenied
from analysis.flights.scan import Progress, Scan, scan
from analysis.flights.table import EdgeReport, FlightFlag, Flights, write_csv
from analysis.plate.motion import PlateMotion
from analysis.statistics import nearest
from daq.recording import Recording
from daq.recording.notebook import EventChange, event_changes_of
from kernels import njit
from kernels.arrays import Bools, Floats, Integers

__all__ = ["FlightFlag", "Flights", "flights_of", "write_csv"]

_Intervals = tuple[Floats, Floats, Floats, Floats, Integers]
_Table = tuple[Floats, Floats, Floats, Floats, Floats, Integers, EdgeReport]

GLITCH_S = 2e-4  # shortest flight
CHATTER_S = 1e-3  # longest opening of a contact that chatters, where no impact ends it; no rebound so short matters
LAUNCHES = 0.8  # of g, downward acceleration of the plate below which a ball at rest would have stayed
HIDDEN_POINTS, HIDDEN_BEFORE = 33, 27  # points of a flight, and those far enough from its own landing


def flights_of(recording: Recording, *, progress: Progress | None = None) -> Flights:
    """Flights and plate motion of a recording, in one pass and bounded memory.

    Raises `InputError` when there is no accelerometer channel, or the file with events changed by hand does not read.

    Parameters
    ----------
    recording : Recording
        Open.
    progress : callable, optional
        Called with the part done, 0 to 1, after each piece.
    """
    changes = event_changes_of(recording)
    return assemble(scan(recording, progress), recording, changes)


def assemble(found: Scan, recording: Recording, changes: tuple[EventChange, ...] = ()) -> Flights:
    """Flights and their flags from the result of the pass, with the events that a person changed."""
    g, rate_hz = recording.setup.g_mps2.value, recording.rate_hz
    takeoff, landing, takeoff_sigma, landing_sigma, strength, flags, report = _in_air(found, recording, changes)
    flags[given_by_hand(takeoff, changes) | given_by_hand(landing, changes)] |= int(FlightFlag.BY_HAND)
    step, step_flags = _steps(found.steps, takeoff, landing, rate_hz)
    flags |= step_flags | _gaps(found, takeoff, landing) | _missed(found, landing, rate_hz)
    plate = found.plate
    takeoff, takeoff_sigma = _unseen_contacts(plate, g, takeoff, takeoff_sigma, landing, step, report)
    if report.sensor_offset is not None:  # the accelerometer shows impacts
        quick = _back_at_once(takeoff, landing, CHATTER_S) & np.isnan(strength) & ((flags & FlightFlag.BY_HAND) == 0)
        flags[quick & (-plate.acceleration_mps2(takeoff, step) < LAUNCHES * g)] |= int(FlightFlag.FALSE)
    true = (flags & FlightFlag.FALSE) == 0
    contact, index = np.full(takeoff.size, np.nan), np.flatnonzero(true)
    contact[index[1:]] = takeoff[index[1:]] - landing[index[:-1]]  # since the last true landing
    flags |= _launch_flags(plate, g, takeoff, landing, contact, step, true)
    if report.sensor_offset is not None:  # the last part of a chatter, after bounces too small to be resolved
        silent = ((flags & int(FlightFlag.DOUBLE_HIT)) != 0) & np.isnan(strength) & ((flags & int(FlightFlag.CUT)) == 0)
        flags[silent] |= int(FlightFlag.UNSURE)
    flags |= _hidden(plate, g, takeoff, landing, contact, step, flags) | _unheard(plate, step, flags)
    return Flights(
        takeoff_s=takeoff,
        landing_s=landing,
        takeoff_uncertainty_s=takeoff_sigma,
        landing_uncertainty_s=landing_sigma,
        takeoff_phase=plate.phase(takeoff, step),
        landing_phase=plate.phase(landing, step),
        step=step,
        gamma=_gammas(found, step),
        contact_s=contact,
        impact=strength,
        flags=flags.astype(np.int32),
        plate=plate,
        edges=report,
    )


def _in_air(found: Scan, recording: Recording, changes: tuple[EventChange, ...]) -> _Table:
    """Intervals in the air by both detectors, and the detectors' quality."""
    levels, rate_hz, g_mps2 = found.survey.levels, recording.rate_hz, recording.setup.g_mps2.value
    if levels is None:
        nothing = np.zeros(0)
        report = EdgeReport(None, SHARP, SHARP, None, 0, found.survey.mask_s, by_hand=changes)
        return nothing, nothing, nothing, nothing, nothing, np.zeros(0, np.int64), report
    edges, opening, closing = time_edges(found.crossings, levels, rate_hz)
    end_s = recording.n_samples / rate_hz
    takeoff, landing, _, landing_sigma, flags = _intervals(edges, found.starts_open, end_s)
    whole = (flags & (FlightFlag.FALSE | FlightFlag.CUT)) == 0
    impacts, offset = NO_IMPACTS, None
    if found.survey.template is not None:
        own = takeoff[whole], landing[whole], landing_sigma[whole]
        step, unsteady = _steps(found.steps, takeoff, landing, rate_hz)
        period_s = np.array([np.inf if s is None else 1.0 / s.frequency_hz for s in found.plate.steps])
        steady = unsteady[whole] == 0
        scatter = Scatter.of(*own[1:], step[whole], steady, period_s, sampling_s=1.0 / rate_hz)
        # of the circuit's landings from cycle to cycle, beyond what is stated; infinite where too few steps repeat
        repeated_s = float(scatter.raised(np.zeros(1))[0]) if scatter.tells else math.inf
        rest = closing.tau_uncertainty_s, 1.0 / rate_hz
        impacts, offset = calibrate(found.impacts, *own, *rest, found.elsewhere, repeated_s)
        if not np.isfinite(offset.uncertainty_s) or offset.offset_s < -MOTION_S:
            late_s = motion_late(found.plate, takeoff, landing, np.where(unsteady | flags, -1, step))
            if late_s > offset.offset_s + MOTION_S:  # a high-pass shows motion early, and impacts not
                impacts, offset = calibrate(found.impacts, *own, *rest, found.elsewhere, repeated_s, late_s)
    edges = refine_short_contacts(edges, found.crossings, levels, (opening, closing), impacts, rate_hz)
    if offset is not None and np.isfinite(offset.uncertainty_s):
        edges = combine_with_impacts(edges, impacts, offset)
    edges = changed_edges(edges, changes, starts_open=found.starts_open, rate_hz=rate_hz)
    impacts = changed_impacts(impacts, changes, rate_hz)
    # within 3 or 4 samples an impact is the edge's own; in time, as a contact's jitter does not shrink with the
    # interval
    intervals, reach_s = _intervals(edges, found.starts_open, end_s), max(1.5e-4, 3.0 / rate_hz)

    def steps_of(begin_s: Floats, end_s: Floats) -> tuple[Integers, Bools]:
        step, unsteady = _steps(found.steps, begin_s, end_s, rate_hz)
        return np.where(unsteady & FlightFlag.CUT, -1, step), unsteady == 0

    late_s = 0.0 if offset is None else offset.offset_s
    in_air = intervals[0], intervals[1], intervals[4] == 0
    table = _split(*intervals, undenied(found.plate, g_mps2, steps_of, in_air, impacts, reach_s, late_s), reach_s)
    takeoff, landing, takeoff_sigma, landing_sigma, flags = table
    strength = _strength(landing, impacts, max(2e-4, 4.0 / rate_hz))
    dips = int(np.count_nonzero(found.crossings.kind == DIP))
    report = EdgeReport(levels, opening, closing, offset, dips, found.survey.mask_s, found.missed.size, changes)
    return takeoff, landing, takeoff_sigma, landing_sigma, strength, flags, report


def _intervals(edges: Edges, starts_open: bool, end_s: float) -> tuple[Floats, Floats, Floats, Floats, Integers]:
    """Take-off and landing of every interval in the air, with uncertainties and the flags `CUT` and `FALSE`."""
    known = edges.kind != DIP
    time_s, sigma, kind = edges.time_s[known], edges.uncertainty_s[known], edges.kind[known]
    first_cut = starts_open and (kind.size == 0 or kind[0] == CLOSES)
    last_cut = (kind.size > 0 and kind[-1] == OPENS) or (kind.size == 0 and starts_open)
    takeoff, landing = time_s[kind == OPENS], time_s[kind == CLOSES]
    takeoff_sigma, landing_sigma = sigma[kind == OPENS], sigma[kind == CLOSES]
    if first_cut:
        takeoff, takeoff_sigma = np.append(0.0, takeoff), np.append(0.0, takeoff_sigma)
    if last_cut:
        landing, landing_sigma = np.append(landing, end_s), np.append(landing_sigma, 0.0)
    flags = np.zeros(takeoff.size, dtype=np.int64)
    if first_cut:
        flags[0] |= FlightFlag.CUT
    if last_cut:
        flags[-1] |= FlightFlag.CUT
    duration = landing - takeoff
    flags[(duration < GLITCH_S) | _back_at_once(takeoff, landing, 4e-4)] |= FlightFlag.FALSE
    return takeoff, landing, takeoff_sigma, landing_sigma, flags


def _back_at_once(takeoff: Floats, landing: Floats, most_s: float) -> Bools:
    """Intervals in the air shorter than ``most_s`` soon after a landing, as a contact that chatters makes them."""
    since = takeoff - np.append(-np.inf, landing[:-1])
    return np.asarray((landing - takeoff < most_s) & (since < 2e-3))


def _split(
    takeoff: Floats,
    landing: Floats,
    takeoff_sigma: Floats,
    landing_sigma: Floats,
    flags: Integers,
    impacts: Impacts,
    reach_s: float,
) -> tuple[Floats, Floats, Floats, Floats, Integers]:
    """Intervals in the air split at impacts inside them; impacts near their ends belong to the edges."""
    if takeoff.size == 0 or impacts.time_s.size == 0:
        return takeoff, landing, takeoff_sigma, landing_sigma, flags
    host = np.searchsorted(takeoff, impacts.time_s) - 1
    inside = host >= 0
    # or within four of its standard deviations: an impact in noise is timed worse than an edge
    margin = np.maximum(reach_s, 4.0 * impacts.uncertainty_s)
    h = np.maximum(host, 0)
    inside &= (impacts.time_s > takeoff[h] + margin) & (impacts.time_s < landing[h] - margin)
    inside &= (flags[h] & FlightFlag.FALSE) == 0
    at, sigma, h = impacts.time_s[inside], impacts.uncertainty_s[inside], h[inside]
    starts, ends = np.concatenate([takeoff, at]), np.concatenate([landing, at])
    start_sigma, end_sigma = np.concatenate([takeoff_sigma, sigma]), np.concatenate([landing_sigma, sigma])
    start_order, end_order = np.argsort(starts, kind="stable"), np.argsort(ends, kind="stable")
    split_start = np.concatenate([np.zeros(takeoff.size, bool), np.ones(at.size, bool)])[start_order]
    split_end = np.concatenate([np.zeros(takeoff.size, bool), np.ones(at.size, bool)])[end_order]
    out = np.concatenate([flags, flags[h] & ~int(FlightFlag.CUT)])[start_order]
    out[split_start | split_end] |= FlightFlag.ACCELEROMETER
    out &= ~int(FlightFlag.CUT)
    starts, ends = starts[start_order], ends[end_order]
    for i in np.flatnonzero(flags & FlightFlag.CUT):  # the first part of one cut at its start, else the last part
        out[starts == takeoff[i] if i == 0 and takeoff[i] == 0.0 else ends == landing[i]] |= FlightFlag.CUT
    return starts, ends, start_sigma[start_order], end_sigma[end_order], out


def _strength(landing: Floats, impacts: Impacts, reach_s: float) -> Floats:
    """Strength of the accelerometer's impact at each landing; NaN without one."""
    if impacts.time_s.size == 0:
        return np.full(landing.size, np.nan)
    partner = nearest(impacts.time_s, landing)
    return np.where(np.abs(impacts.time_s[partner] - landing) < reach_s, impacts.strength[partner], np.nan)


def _steps(steps: npt.NDArray[np.void], takeoff: Floats, landing: Floats, rate_hz: float) -> tuple[Integers, Integers]:
    """Step of each flight (-1: in none), and the flags `SETTLING` and `CUT` at a change of step."""
    first = steps["first_sample"] / rate_hz
    settled = (steps["first_sample"] + steps["settle_samples"]) / rate_hz
    last = (steps["first_sample"] + steps["n_samples"]) / rate_hz
    step = np.searchsorted(first, takeoff, side="right") - 1
    k = np.maximum(step, 0)
    outside = (step < 0) | (takeoff >= last[k])
    flags = np.where(outside, 0, np.where(takeoff < settled[k], int(FlightFlag.SETTLING), 0))
    flags = np.where(~outside & (landing > last[k]), flags | int(FlightFlag.CUT), flags)
    return np.where(outside, -1, step), flags.astype(np.int64)


def _gaps(found: Scan, takeoff: Floats, landing: Floats) -> Integers:
    """Flag `GAP` where samples were lost or filled in during the flight or at its edges."""
    margin_s = 2.0 / found.plate.rate_hz
    at_s = found.plate.gaps[:, 0] / found.plate.rate_hz
    touched = np.zeros(takeoff.size, dtype=np.bool_)
    for begins, ends in ((at_s, at_s), (found.filled_spans_s[:, 0], found.filled_spans_s[:, 1])):
        begun = np.searchsorted(begins, landing + margin_s, side="right")
        touched |= begun > np.searchsorted(ends, takeoff - margin_s)
    return np.where(touched, int(FlightFlag.GAP), 0).astype(np.int64)


def _missed(found: Scan, landing: Floats, rate_hz: float) -> Integers:
    """Flag `UNSURE` where, since the last landing, an edge of an AC-coupled circuit was missed, or may be in a gap."""
    flags = np.zeros(landing.size, dtype=np.int64)
    if found.survey.coupling is None:
        return flags
    suspects = np.concatenate([found.missed, found.plate.gaps[:, 0]])
    touched = np.searchsorted(landing, suspects / rate_hz)
    flags[touched[touched < landing.size]] = int(FlightFlag.UNSURE)
    return flags


def _unseen_contacts(
    plate: PlateMotion,
    g: float,
    takeoff: Floats,
    takeoff_sigma: Floats,
    landing: Floats,
    step: Integers,
    report: EdgeReport,
) -> tuple[Floats, Floats]:
    """Take-offs at a landing where the plate was still pushing, moved by half an undetectable contact time."""
    unseen_s = 0.0  # longest contact between two samples that leaves no visible dip in the contact voltage
    if report.levels is not None:
        dip = max(1.0 - float(report.levels.thresholds()[2]), 1e-3)
        unseen_s = max(0.0, 1.0 / plate.rate_hz + report.opening.tau_s * float(np.log(dip)))
    at_landing = np.append(False, np.abs(takeoff[1:] - landing[:-1]) < 1e-12)
    if unseen_s == 0.0 or not at_landing.any():
        return takeoff, takeoff_sigma
    pushing = at_landing & (-plate.acceleration_mps2(takeoff, step) < g)
    later = np.where(pushing, takeoff + 0.5 * unseen_s, takeoff)
    return later, np.where(pushing, np.hypot(takeoff_sigma, unseen_s / np.sqrt(12.0)), takeoff_sigma)


def _launch_flags(
    plate: PlateMotion,
    g: float,
    takeoff: Floats,
    landing: Floats,
    contact: Floats,
    step: Integers,
    true: Bools,
) -> Integers:
    """Flags `RELAUNCHED` (the plate fell away faster than g at the landing) and `DOUBLE_HIT` (it was pushing)."""
    flags = np.zeros(takeoff.size, dtype=np.int64)
    # a rebound's contact lasts less than 5 ms: after a longer one the ball was carried
    brief = true & (contact < 5e-3)
    if not brief.any():
        return flags
    leaving = -plate.acceleration_mps2(takeoff, step) / g
    landed_at = takeoff - np.where(np.isfinite(contact), contact, 0.0)
    landed = -plate.acceleration_mps2(landed_at, step) / g
    # an impact takes less than 1.5 ms: after so short a contact the ball may have left as it landed
    flags[brief & (contact < 1.5e-3) & (landed >= 1.0)] |= int(FlightFlag.RELAUNCHED)
    # a double hit is back within half a period
    back_soon = landing - takeoff < 0.5 / plate.frequency_hz(step)
    flags[brief & (leaving < LAUNCHES) & back_soon] |= int(FlightFlag.DOUBLE_HIT)
    return flags


def _hidden(
    plate: PlateMotion, g: float, takeoff: Floats, landing: Floats, contact: Floats, step: Integers, flags: Integers
) -> Integers:
    """Flag `UNSURE` where a ball leaving from rest in free flight would have met the plate well before its landing."""
    skip = FlightFlag.FALSE | FlightFlag.CUT | FlightFlag.GAP | FlightFlag.DOUBLE_HIT | FlightFlag.RELAUNCHED
    # after 0.3 ms of contact the ball is at rest
    rest = ((flags & int(skip)) == 0) & ((contact > 3e-4) | np.isnan(contact))
    index = np.flatnonzero(rest & np.isfinite(plate.frequency_hz(step)))
    omega, z = plate.forcing_tones(step[index])
    start_s, step_s = plate.true_time_s(takeoff[index]), (landing - takeoff)[index] / (HIDDEN_POINTS - 1)
    moving = omega != 0.0
    place = np.where(moving, -z / np.where(moving, omega, 1.0) ** 2 * np.exp(1j * omega * start_s), 0.0)
    speed = (1j * omega * place).real.sum(axis=0)
    lowest, highest = np.empty(index.size), np.empty(index.size)
    _clearances(place, np.exp(1j * omega * step_s), speed, step_s, g, lowest, highest)
    out = np.zeros(takeoff.size, dtype=np.int64)
    # an ideal path that dips below the plate by a tenth of the flight's height hides a landing
    out[index[lowest < -0.1 * np.maximum(highest, 1e-6)]] = int(FlightFlag.UNSURE)
    return out


def _unheard(plate: PlateMotion, step: Integers, flags: Integers) -> Integers:
    """Flag `UNSURE` in steps with landings that only the accelerometer shows, which stands at its end meanwhile."""
    shown = (flags & FlightFlag.ACCELEROMETER) != 0, step >= 0
    counts, all_of = (np.bincount(step[own] + 1, minlength=len(plate.steps) + 1)[1:] for own in shown)
    deaf = np.array([s is not None and s.saturated for s in plate.steps], dtype=np.bool_) & (counts > 0.1 * all_of)
    return np.where(np.append(deaf, False)[step], int(FlightFlag.UNSURE), 0)  # a tenth is no mere chatter


@njit(error_model="numpy")
def _clearances(place, turn, speed, step_s, g, lowest, highest):  # type: ignore[no-untyped-def]
    """Least clearance of each path from rest well before its end, and its largest distance from the plate, m.

    The plate's place is the real part of the sum of its tones ``place`` (k, n), which turn by ``turn`` (k, n) from each
    point of a path to the next, ``step_s`` (n,) later; a path begins with ``speed`` (n,). ``place`` is used up.
    """
    for i in range(speed.shape[0]):
        begin, low, high, t = 0.0, 1e300, 0.0, 0.0
        for j in range(place.shape[0]):
            begin += place[j, i].real
        for k in range(1, HIDDEN_POINTS):
            t += step_s[i]
            at = 0.0
            for j in range(place.shape[0]):
                place[j, i] *= turn[j, i]
                at += place[j, i].real
            height = (speed[i] - 0.5 * g * t) * t - (at - begin)
            high = max(high, abs(height))
            if k <= HIDDEN_BEFORE:
                low = min(low, height)
        lowest[i], highest[i] = low, high


def _gammas(found: Scan, step: Integers) -> Floats:
    """Gamma of each flight's step: measured on the plate, else achieved according to the rig, else asked for."""
    best = np.append(found.steps["gamma"], np.nan)  # the last is that of step -1
    measured = [np.nan if plate is None else plate.gamma for plate in found.plate.steps]
    for better in (found.steps["achieved_gamma"], np.array(measured)):
        best[:-1] = np.where(np.isfinite(better), better, best[:-1])
    return np.asarray(best[step])
