"""From the single pass to the table of flights.

The rule kept here: continuity edges make the flights; the second witness only splits what they leave whole. Nothing is
dropped: what is doubtful is marked.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from analysis.events.edges import CLOSES, DIP, OPENS, SHARP, Edges, time_edges
from analysis.events.impact_detection import NO_IMPACTS, Impacts, calibrate, combine_with_impacts
from analysis.events.short_contacts import refine_brief
from analysis.flights.scan import Progress, Scan, scan
from analysis.flights.table import EdgeReport, FlightFlag, Flights, write_csv
from analysis.plate.motion import PlateMotion
from daq.recording import Recording
from daq.setup.setup import Setup

__all__ = ["FlightFlag", "Flights", "flights_of", "write_csv"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
_Table = tuple[Floats, Floats, Floats, Floats, Floats, Ints, EdgeReport]

GLITCH_S = 2e-4  # an opening shorter than this is no flight
BOUNCE_S = 4e-4  # nor is one shorter than this that comes within BOUNCE_AFTER_S of a landing
BOUNCE_AFTER_S = 2e-3
INSTANT_S = 1.5e-3  # a contact this short may be an impact's closure alone: the ball may have left as it landed
RESTED_S = 3e-4  # a ball seen to lie this long where the plate pushes has come to rest
REBOUND_CONTACT_S = 5e-3  # contacts shorter than this may be rebounds
SOON_CYCLES = 0.5  # of the forcing: a rebound that is back sooner makes a double hit
PUSHING = 0.8  # -a_p / g below this at take-off: the plate was pushing, a resting ball would have stayed
HIDDEN = 0.1  # of the flight's height: how far below the plate the ideal path may dip before a landing is suspected


def flights_of(recording: Recording, *, progress: Progress | None = None) -> Flights:
    """Everything the recording says about the ball's flights and the plate, in one pass and bounded memory.

    Parameters
    ----------
    recording : Recording
        Open.
    progress : callable, optional
        Called with the part done, 0 to 1, after each piece.

    Raises
    ------
    InputError
        When there is no accelerometer channel.
    """
    return assemble(scan(recording, progress), recording.setup, recording.rate_hz, recording.n_samples)


def assemble(found: Scan, setup: Setup, rate_hz: float, n_samples: int) -> Flights:
    """Flights from what the pass found."""
    takeoff, landing, takeoff_sigma, landing_sigma, strength, flags, report = _in_air(found, rate_hz, n_samples)
    step, step_flags = _steps(found.steps, takeoff, landing, rate_hz)
    flags |= step_flags | _gaps(found, takeoff, landing) | _missed(found, landing, rate_hz)
    plate = found.plate
    takeoff, takeoff_sigma = _unseen_contacts(
        plate, setup.g_mps2.value, takeoff, takeoff_sigma, landing, step, unseen_contact_s(report, rate_hz)
    )
    true = (flags & FlightFlag.FALSE) == 0
    contact = _contacts(takeoff, landing, true)
    flags |= _launch_flags(plate, setup.g_mps2.value, takeoff, landing, contact, step, true)
    flags |= _unresolved(strength, flags, report)
    flags |= _hidden(plate, setup.g_mps2.value, takeoff, landing, contact, step, flags)
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


def _in_air(found: Scan, rate_hz: float, n_samples: int) -> _Table:
    """Intervals in the air with both witnesses heard, and what the witnesses were worth."""
    levels = found.survey.levels
    if levels is None:
        nothing = np.zeros(0)
        silent = EdgeReport(None, SHARP, SHARP, None, 0)
        return nothing, nothing, nothing, nothing, nothing, np.zeros(0, np.int64), silent
    edges, opening, closing = time_edges(found.crossings, levels, rate_hz)
    end_s = n_samples / rate_hz
    takeoff, landing, _, landing_sigma, flags = _intervals(edges, found.starts_open, end_s)
    whole = (flags & (FlightFlag.FALSE | FlightFlag.CUT)) == 0
    impacts, offset = NO_IMPACTS, None
    if found.survey.waveform is not None:
        own = takeoff[whole], landing[whole], landing_sigma[whole]
        impacts, offset = calibrate(found.impacts, *own, closing.tau_uncertainty_s)
    edges = refine_brief(edges, found.crossings, levels, (opening, closing), impacts, rate_hz)
    if offset is not None and np.isfinite(offset.uncertainty_s):
        edges = combine_with_impacts(edges, impacts, offset)
    table = _split(*_intervals(edges, found.starts_open, end_s), impacts, 3.0 / rate_hz)
    takeoff, landing, takeoff_sigma, landing_sigma, flags = table
    strength = _strength(landing, impacts, 4.0 / rate_hz)
    dips = int(np.count_nonzero(found.crossings.kind == DIP))
    report = EdgeReport(levels, opening, closing, offset, dips, found.missed.size)
    return takeoff, landing, takeoff_sigma, landing_sigma, strength, flags, report


def _intervals(edges: Edges, starts_open: bool, end_s: float) -> tuple[Floats, Floats, Floats, Floats, Ints]:
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
    since = takeoff - np.append(-np.inf, landing[:-1])
    false = (duration < GLITCH_S) | ((duration < BOUNCE_S) & (since < BOUNCE_AFTER_S))
    flags[false] |= FlightFlag.FALSE
    return takeoff, landing, takeoff_sigma, landing_sigma, flags


def _split(
    takeoff: Floats,
    landing: Floats,
    takeoff_sigma: Floats,
    landing_sigma: Floats,
    flags: Ints,
    impacts: Impacts,
    reach_s: float,
) -> tuple[Floats, Floats, Floats, Floats, Ints]:
    """Cut intervals in the air at impacts inside them (not at their ends: those are the edges' own)."""
    if takeoff.size == 0 or impacts.time_s.size == 0:
        return takeoff, landing, takeoff_sigma, landing_sigma, flags
    host = np.searchsorted(takeoff, impacts.time_s) - 1
    inside = host >= 0
    margin = np.maximum(reach_s, 4.0 * impacts.uncertainty_s)
    h = np.maximum(host, 0)
    inside &= (impacts.time_s > takeoff[h] + margin) & (impacts.time_s < landing[h] - margin)
    inside &= (flags[h] & FlightFlag.FALSE) == 0
    at, sigma, h = impacts.time_s[inside], impacts.uncertainty_s[inside], h[inside]
    starts, ends = np.concatenate([takeoff, at]), np.concatenate([landing, at])
    start_sigma, end_sigma = np.concatenate([takeoff_sigma, sigma]), np.concatenate([landing_sigma, sigma])
    start_order, end_order = np.argsort(starts, kind="stable"), np.argsort(ends, kind="stable")
    by_witness_start = np.concatenate([np.zeros(takeoff.size, bool), np.ones(at.size, bool)])[start_order]
    by_witness_end = np.concatenate([np.zeros(takeoff.size, bool), np.ones(at.size, bool)])[end_order]
    out = np.concatenate([flags, flags[h] & ~int(FlightFlag.CUT)])[start_order]
    out[by_witness_start | by_witness_end] |= FlightFlag.WITNESS
    # a cut interval passes its mark to the piece that touches the cut
    out = _pass_cut(out, starts[start_order], ends[end_order], takeoff, landing, flags)
    return starts[start_order], ends[end_order], start_sigma[start_order], end_sigma[end_order], out


def _pass_cut(out: Ints, starts: Floats, ends: Floats, takeoff: Floats, landing: Floats, flags: Ints) -> Ints:
    """Only the first piece of an interval cut at its start, or the last of one cut at its end, stays cut."""
    cut = np.flatnonzero(flags & FlightFlag.CUT)
    out &= ~int(FlightFlag.CUT)
    for i in cut:
        out[starts == takeoff[i] if i == 0 and takeoff[i] == 0.0 else ends == landing[i]] |= FlightFlag.CUT
    return out


def _strength(landing: Floats, impacts: Impacts, reach_s: float) -> Floats:
    """Strength of the accelerometer's impact at each landing; NaN where it saw none."""
    if impacts.time_s.size == 0:
        return np.full(landing.size, np.nan)
    after = np.minimum(np.searchsorted(impacts.time_s, landing), impacts.time_s.size - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.where(np.abs(impacts.time_s[before] - landing) < np.abs(impacts.time_s[after] - landing), before, after)
    return np.where(np.abs(impacts.time_s[nearer] - landing) < reach_s, impacts.strength[nearer], np.nan)


def _steps(steps: npt.NDArray[np.void], takeoff: Floats, landing: Floats, rate_hz: float) -> tuple[Ints, Ints]:
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


def _gaps(found: Scan, takeoff: Floats, landing: Floats) -> Ints:
    """Flag `GAP` where samples were lost, or made up, in the flight or at its edges."""
    margin_s = 2.0 / found.plate.rate_hz
    at_s = found.plate.gaps[:, 0] / found.plate.rate_hz
    touched = np.zeros(takeoff.size, dtype=np.bool_)
    for begins, ends in ((at_s, at_s), (found.filled_spans_s[:, 0], found.filled_spans_s[:, 1])):
        begun = np.searchsorted(begins, landing + margin_s, side="right")
        touched |= begun > np.searchsorted(ends, takeoff - margin_s)
    return np.where(touched, int(FlightFlag.GAP), 0).astype(np.int64)


def _missed(found: Scan, landing: Floats, rate_hz: float) -> Ints:
    """Flag `UNSURE` where, since the last landing, an edge of an AC-coupled circuit was missed, or may be in a gap."""
    flags = np.zeros(landing.size, dtype=np.int64)
    if found.survey.coupling is None:
        return flags
    evidence = np.concatenate([found.missed, found.plate.gaps[:, 0]])
    touched = np.searchsorted(landing, evidence / rate_hz)
    flags[touched[touched < landing.size]] = int(FlightFlag.UNSURE)
    return flags


def unseen_contact_s(report: EdgeReport, rate_hz: float) -> float:
    """Longest contact between two samples that leaves no visible dent in the continuity voltage."""
    if report.levels is None:
        return 0.0
    dip = max(1.0 - float(report.levels.thresholds()[2]), 1e-3)
    return max(0.0, 1.0 / rate_hz + report.opening.tau_s * float(np.log(dip)))


def _unseen_contacts(
    plate: PlateMotion, g: float, takeoff: Floats, takeoff_sigma: Floats, landing: Floats, step: Ints, unseen_s: float
) -> tuple[Floats, Floats]:
    """Take-offs right at a landing where the plate was still pushing: the ball lay there for a moment nobody saw."""
    at_landing = np.append(False, np.abs(takeoff[1:] - landing[:-1]) < 1e-12)
    if unseen_s == 0.0 or not at_landing.any():
        return takeoff, takeoff_sigma
    pushing = at_landing & (-plate.acceleration_mps2(takeoff, step) < g)
    later = np.where(pushing, takeoff + 0.5 * unseen_s, takeoff)
    return later, np.where(pushing, np.hypot(takeoff_sigma, unseen_s / np.sqrt(12.0)), takeoff_sigma)


def _unresolved(strength: Floats, flags: Ints, report: EdgeReport) -> Ints:
    """Flag `UNSURE` the last piece of a chatter: it ends with the circuit, after bounces too small to be told apart."""
    if report.witness is None:
        return np.zeros(flags.size, dtype=np.int64)
    silent = ((flags & int(FlightFlag.DOUBLE_HIT)) != 0) & np.isnan(strength) & ((flags & int(FlightFlag.CUT)) == 0)
    return np.where(silent, int(FlightFlag.UNSURE), 0).astype(np.int64)


def _contacts(takeoff: Floats, landing: Floats, true: npt.NDArray[np.bool_]) -> Floats:
    """Time since the last true landing; NaN before the first."""
    contact = np.full(takeoff.size, np.nan)
    index = np.flatnonzero(true)
    if index.size > 1:
        contact[index[1:]] = takeoff[index[1:]] - landing[index[:-1]]
    return contact


def _launch_flags(
    plate: PlateMotion,
    g: float,
    takeoff: Floats,
    landing: Floats,
    contact: Floats,
    step: Ints,
    true: npt.NDArray[np.bool_],
) -> Ints:
    """Flags `RELAUNCHED` (where the ball had just landed the plate fell away) and `DOUBLE_HIT` (it pushed)."""
    flags = np.zeros(takeoff.size, dtype=np.int64)
    brief = true & (contact < REBOUND_CONTACT_S)
    if not brief.any():
        return flags
    leaving = -plate.acceleration_mps2(takeoff, step) / g
    landed_at = takeoff - np.where(np.isfinite(contact), contact, 0.0)
    landed = -plate.acceleration_mps2(landed_at, step) / g
    flags[brief & (contact < INSTANT_S) & (landed >= 1.0)] |= int(FlightFlag.RELAUNCHED)
    back_soon = landing - takeoff < SOON_CYCLES / plate.frequency_hz(step)
    flags[brief & (leaving < PUSHING) & back_soon] |= int(FlightFlag.DOUBLE_HIT)
    return flags


def _hidden(
    plate: PlateMotion, g: float, takeoff: Floats, landing: Floats, contact: Floats, step: Ints, flags: Ints
) -> Ints:
    """Flag `UNSURE` where a ball that left at rest, falling freely, would have met the plate well before it landed."""
    out = np.zeros(takeoff.size, dtype=np.int64)
    skip = FlightFlag.FALSE | FlightFlag.CUT | FlightFlag.GAP | FlightFlag.DOUBLE_HIT | FlightFlag.RELAUNCHED
    rest = ((flags & int(skip)) == 0) & ((contact > RESTED_S) | np.isnan(contact))
    for k in np.unique(step[rest]):
        fitted = plate.steps[k] if 0 <= k < len(plate.steps) else None
        if fitted is None:
            continue
        motion = fitted.forcing()
        index = np.flatnonzero(rest & (step == k))
        start = plate.true_time_s(takeoff[index])[:, None]
        since = np.linspace(0.0, 1.0, 33)[None, 1:] * (landing - takeoff)[index, None]
        moved = motion.position_at(start + since) - motion.position_at(start)
        height = motion.velocity_at(start) * since - 0.5 * g * since**2 - moved
        early = height[:, :27]
        suspicious = early.min(axis=1) < -HIDDEN * np.maximum(np.abs(height).max(axis=1), 1e-6)
        out[index[suspicious]] |= int(FlightFlag.UNSURE)
    return out


def _gammas(found: Scan, step: Ints) -> Floats:
    """Gamma of each flight's step: measured on the plate, else what the rig says it achieved, else what was asked."""
    best = np.array(
        [
            plate.gamma
            if plate is not None and np.isfinite(plate.gamma)
            else row["achieved_gamma"]
            if np.isfinite(row["achieved_gamma"])
            else row["gamma"]
            for plate, row in zip(found.plate.steps, found.steps, strict=True)
        ]
        or [np.nan]
    )
    return np.where(step >= 0, best[np.maximum(step, 0)], np.nan)
