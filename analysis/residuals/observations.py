"""Observations of one or several recordings: events, steps and plate data with their uncertainties.

These are measured numbers; no model enters. Several recordings stand in one table, one after the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.events.edge_jitter import Scatter, raised_together
from analysis.events.impact_detection import ECHO_MARGIN
from analysis.events.impact_template import THRESHOLD
from analysis.events.sensor_offset import SensorOffset, common_offset
from analysis.flights.assemble import FlightFlag, Flights, assemble
from analysis.flights.scan import Scan, corner_of, scan
from analysis.plate.motion import StepPlate
from analysis.plate.ringing.mode_motion import without_ringing
from analysis.plate.ringing.modes import Identified, identified_mode, remarks
from analysis.residuals.held import RINGING_S, Fades, Launches, with_pushes
from analysis.residuals.plate_data.modulation import AmplitudeModulation
from analysis.residuals.plate_data.plate_observables import PlateData, plate_data, with_wander
from analysis.residuals.plate_data.slow_motion import hints_of, other_lines_radps
from daq.recording import Recording, open_recording
from daq.recording.header import refuse_repeated
from daq.recording.notebook import event_changes_of, in_words
from daq.setup.setup import Setup
from kernels.arrays import Bools, Complexes, Floats, Integers
from model.integrator.problem import Measured, PlateSteps
from model.tones import STANDARD_GRAVITY_MPS2

NOT_EVENTS = FlightFlag.FALSE
NOT_SCORED = FlightFlag.FALSE | FlightFlag.GAP | FlightFlag.SETTLING | FlightFlag.CUT
MISLEADING = FlightFlag.GAP | FlightFlag.CUT
MAX_TONES = 10
FEW_CONTACTS = 8
WEAK_MPS = 0.03  # least speed of impacts that the accelerometer shows reliably
DETECTED = 1.5  # strength over the threshold of the scan above which an impact is detected whatever the noise


@dataclass(frozen=True)
class Steps:
    """The steps of all recordings, arrays of shape (m,); ``plate`` holds their tones."""

    recording: Integers  # which recording
    number: Integers  # the step's number in it
    gamma: Floats  # measured A w^2 / g
    ratio: Integers  # c
    run_part: Floats  # middle of the step within its recording, from -0.5 at the start to 0.5 at the end
    plate: PlateSteps
    # factor of the covariance of all tones, shape (m, 2 k, k): the sum of the rows' squares is the covariance. Rows 2 i
    # and 2 i + 1 belong to the quadratures of tone i.
    spread_mps2: Complexes
    forcing: Bools  # True for the forcing's own tones, shape (m, k)

    def __len__(self) -> int:
        return len(self.gamma)

    @property
    def sigma_mps2(self) -> Floats:
        """Uncertainty of each quadrature of the plate's tones, (m, k)."""
        return np.asarray(np.sqrt(0.5 * np.sum(np.abs(self.spread_mps2) ** 2, axis=1)))


@dataclass(frozen=True)
class ContactCircuit:
    """How well the contact circuit shows the events."""

    closure_s: float = 0.0  # time for which an impact keeps it closed
    # scatter of openings and of landings from cycle to cycle; see `analysis.events.edge_jitter`
    scatters: tuple[Scatter, Scatter] = (Scatter(), Scatter())
    # landings that only the accelerometer shows, (n,), by an unknown delay after the circuit would have; None for none
    heard: Bools | None = None
    uneven: bool = False  # whether closings may be late by another time than openings


@dataclass(frozen=True)
class Observations:
    """Events, steps and plate data of one or several recordings of one rig."""

    measured: Measured  # the flights (n,), in order
    opening_sigma_s: Floats  # uncertainty of the edges only, (n,)
    landing_sigma_s: Floats  # the same, (n,)
    scored: Bools  # flights that are compared with predictions, (n,)
    time_s: Floats  # landing since the start of its recording, (n,)
    # speed below which an impact may have gone undetected, (n,); infinite where the accelerometer shows no impacts
    weak_mps: Floats
    steps: Steps
    plate: PlateData
    setup: Setup  # of the first recording; the others must agree in what scales a measurement
    notes: tuple[str, ...] = field(default=())
    ringing: Identified = field(default_factory=Identified)  # of the plate that the ball strikes
    # change of the forcing's amplitude within steps and from step to step
    modulation: AmplitudeModulation | None = None
    run_part: Floats | None = None  # landing within its recording, from -0.5 to 0.5, (n,); None: as the step
    circuit: ContactCircuit = ContactCircuit()

    def __len__(self) -> int:
        return len(self.scored)


def observations_from(
    paths: Sequence[Path],
    *,
    setup: Setup | None = None,
    progress: Callable[[str, float], None] | None = None,
    known: MutableMapping[Path, Observations] | None = None,
    high_pass_hz: float | None = None,
) -> Observations:
    """Reduce recordings to observations.

    Raises `InputError` where a file is no recording or holds no flights and no plate motion, or two hold the same
    samples.

    Parameters
    ----------
    paths
        Recordings of one rig.
    setup
        Replaces the setup stored in the recordings (a corrected or completed profile).
    progress
        Called with the file's name and the fraction done.
    known
        Recordings that were reduced before, with the same setup; those that were not are added.
    high_pass_hz
        As in `analysis.flights.scan.scan`.
    """
    refuse_repeated(paths)
    parts, offsets, doubtful = {} if known is None else known, list[SensorOffset](), dict[Path, Scan]()

    def read(path: Path, found: Scan | None = None) -> None:
        with open_recording(path) as recording:
            if setup is not None:
                recording.measure_with(setup)
            say, changes = None if progress is None else partial(progress, path.name), event_changes_of(recording)
            found = found or scan(recording, say, high_pass_hz)
            flights = assemble(found, recording, changes)
            parts[path] = observed(recording, flights, high_pass_hz=high_pass_hz)
            if (own := flights.edges.sensor_offset) is not None and found.elsewhere is None:
                offsets.append(own)
                if not np.isfinite(own.uncertainty_s):  # its contact never closed in a landing, as in one step
                    doubtful[path] = found

    for path in paths:
        if path not in parts:
            read(path)
    if doubtful and (common := common_offset(offsets)) is not None:
        for path, found in list(doubtful.items()):
            read(path, replace(found, elsewhere=common))
    return parts[paths[0]] if len(paths) == 1 else join([parts[path] for path in paths])


def observed(
    recording: Recording, flights: Flights, *, with_mode: bool = True, high_pass_hz: float | None = None
) -> Observations:
    """Observations of one recording; ``with_mode`` a ringing mode is identified, in about a second.

    ``high_pass_hz`` as in `analysis.flights.scan.scan`.
    """
    setup = recording.setup
    deaf, left_out = _unheard(flights)
    fitted = [s for s in flights.plate.steps if s is not None and s.usable and s.step not in deaf]
    true, mask_s = flights.select(~flights.has(FlightFlag.FALSE)), flights.edges.ringing_s
    events = true.takeoff_s, true.landing_s, mask_s, corner_of(recording, high_pass_hz)
    plate = identified_mode(recording, *events) if with_mode else Identified()
    for pushed in plate.pushed:
        fitted = [without_ringing(s, pushed.noise_mps2) for s in fitted]
    rows = np.full(max(len(flights.plate.steps), 1), -1, dtype=np.int64)
    rows[np.array([s.step for s in fitted], dtype=np.int64)] = np.arange(len(fitted))
    steps, launches = _steps(fitted, recording.n_samples), Launches.of(recording)
    if launches is not None:  # alternating corrections make more tones: each flight's drive holds them
        turns = steps.plate.omega_radps * steps.plate.period_s[:, None] / (2.0 * np.pi)
        # a tone of the forcing may be off a multiple by so much
        own = np.abs(turns - np.round(turns)) < 0.005
        tones = replace(steps.plate, acceleration_mps2=np.where(own, steps.plate.acceleration_mps2, 0.0))
        steps = replace(steps, plate=tones, spread_mps2=np.where(own[:, None, :], steps.spread_mps2, 0.0))
    measured, scored, keep = _events(recording, flights, fitted, rows, launches)
    lines = other_lines_radps(steps.plate, hints_of(fitted))
    step, period_s = measured.step, steps.plate.period_s
    bare = flights.takeoff_uncertainty_s[keep], flights.landing_uncertainty_s[keep]
    offset, heard = flights.edges.sensor_offset, flights.heard()[keep]
    rest = period_s, lines, 1.0 / recording.rate_hz
    motion_s = offset.motion_s if offset and plate.pushed else 0.0
    scatters = (
        Scatter.of(measured.opening_s, bare[0], step, scored & ~measured.relaunched, *rest),
        Scatter.of(measured.landing_s, bare[1], step, scored, *rest).less(motion_s),
    )
    # openings of which few repeat jitter as the circuit's closings do
    opening_s = scatters[0].raised(bare[0], offset.jitter_s if offset else math.nan)
    uneven = offset is not None and offset.uneven_edges(flights.edges.opening.tau_s == 0.0)
    weak = weak_mps(measured, steps.plate, flights, keep) if offset else np.full(len(scored), np.inf)
    data, notes = plate_data(fitted, setup)
    notes = (*notes, *flights.plate.warnings(), *in_words(flights.edges.by_hand), *left_out)
    spans = np.array([(s.first_sample, s.last_sample) for s in fitted], dtype=np.float64).reshape(-1, 2)
    return Observations(
        measured,
        opening_s,
        scatters[1].raised(bare[1]),
        scored,
        measured.landing_s.copy(),
        weak,
        steps,
        data,
        setup,
        notes=(*notes, *remarks(plate.mode, fitted, recording.rate_hz)),
        ringing=plate,
        modulation=AmplitudeModulation.of(fitted, flights.plate.true_time_s(spans / recording.rate_hz), data),
        run_part=measured.landing_s * recording.rate_hz / max(recording.n_samples, 1) - 0.5,
        circuit=ContactCircuit(closure_s(measured, heard), scatters, heard, uneven),
    )


def _unheard(flights: Flights) -> tuple[list[int], tuple[str, ...]]:
    """Steps of which all flights are unsure, as a sensor at its end may miss landings; the sentence about them."""
    unsure = flights.has(FlightFlag.UNSURE)
    own = {i: flights.step == i for i, s in enumerate(flights.plate.steps) if s is not None and s.saturated}
    deaf = [i for i, rows in own.items() if rows.any() and unsure[rows].all()]
    sentence = (
        f"step {', '.join(map(str, deaf))} is left out: only the accelerometer shows its landings, and those that "
        "come while it stands at its end are lost"
    )
    return deaf, (sentence,) if deaf else ()


def _steps(fitted: Sequence[StepPlate], n_samples: int) -> Steps:
    """Table of the fitted steps of a recording of ``n_samples``."""
    m = len(fitted)
    omega, z = np.ones((m, MAX_TONES)), np.zeros((m, MAX_TONES), complex)
    spread = np.zeros((m, 2 * MAX_TONES, MAX_TONES), complex)
    forcing = np.zeros((m, MAX_TONES), dtype=bool)
    for i, s in enumerate(fitted):
        tones = s.plate()
        # to the microradian a second: one frequency computed in two ways differs by rounding
        own = {round(x) for x in 1e6 * s.forcing().omega_radps}
        order = np.argsort([round(x) not in own for x in 1e6 * tones.omega_radps], kind="stable")[:MAX_TONES]
        k = len(order)
        omega[i, :k], z[i, :k] = tones.omega_radps[order], tones.acceleration[order]
        forcing[i, :k] = [round(x) in own for x in 1e6 * omega[i, :k]]
        spread[i, : 2 * k, :k] = s.tones_factor(omega[i, :k])
    middle = np.array([(s.first_sample + s.last_sample) / 2 for s in fitted])
    return Steps(
        np.zeros(m, dtype=np.int64),
        np.array([s.step for s in fitted], dtype=np.int64),
        np.array([s.gamma for s in fitted]),
        np.array([s.ratio for s in fitted], dtype=np.int64),
        middle / max(n_samples, 1) - 0.5,
        PlateSteps(omega, z, np.array([1.0 / s.frequency_hz for s in fitted])),
        spread,
        forcing,
    )


def _events(
    recording: Recording, flights: Flights, fitted: Sequence[StepPlate], rows: Integers, launches: Launches | None
) -> tuple[Measured, Bools, Bools]:
    """True flights of steps whose plate is known, with their links; which are scored; which flights those are.

    What the drive does within each, in fades and in corrections of a held ball, goes with them.
    """
    fades, flags = Fades.of(recording), flights.flags
    inside = (flights.step >= 0) & (flights.step < len(rows))
    step = np.clip(flights.step, 0, len(rows) - 1)
    early = fades.before_half(step, flights.landing_s)
    step = np.where(early & (rows[step - 1] >= 0), step - 1, step)
    other, share = fades.others(step, 0.5 * (flights.takeoff_s + flights.landing_s))
    other_row = np.where(other >= 0, rows[other], -1).astype(np.int64)
    share = np.where((other >= 0) & (other_row < 0), 0.0, share)  # a step whose motion is not known
    row = np.where(inside, rows[step], -1)
    keep = ((flags & NOT_EVENTS) == 0) & (row >= 0)
    opening = flights.plate.true_time_s(flights.takeoff_s[keep])
    landing = flights.plate.true_time_s(flights.landing_s[keep])
    step, flags = row[keep], flags[keep]
    n = len(step)
    before = np.maximum(np.arange(n) - 1, 0)
    linked = (np.arange(n) > 0) & (step == step[before]) & ((flags[before] & MISLEADING) == 0)
    rest = opening - landing[before]
    # shorter contacts are impacts from which the ball leaves at once
    relaunched = linked & ((rest < 1.2e-3) | ((flags & FlightFlag.RELAUNCHED) != 0))
    # shorter rebounds are the tail of a chatter: followed, not scored
    tiny = relaunched & (landing - opening < 5e-4)
    scored = linked & ~tiny & ((flags & NOT_SCORED) == 0) & ((flags[before] & FlightFlag.SETTLING) == 0)
    measured = Measured(
        opening, landing, relaunched, linked, step.astype(np.int64), scored, other_row[keep], share[keep]
    )
    measured = with_pushes(measured, recording, flights, fades, np.flatnonzero(keep))
    if launches is not None:
        number = np.array([s.step for s in fitted], dtype=np.int64)[measured.step]
        measured = launches.of_flights(measured, recording, number, flights.takeoff_s[keep])
    return measured, scored, keep


def weak_mps(measured: Measured, plate: PlateSteps, flights: Flights, keep: Bools) -> Floats:
    """Impact speed below which the accelerometer may have missed the impact that ends each flight, (n,).

    The strength at a speed is calibrated by free flights from rest; friction makes it too low by its own size at most.
    While an impact rings, impacts of less than a part of its size are masked.
    """
    rest, turns = ~measured.relaunched, 1j * plate.omega_radps[measured.step]
    velocity = plate.acceleration_mps2[measured.step] / turns
    at = [np.sum((velocity * np.exp(turns * t[:, None])).real, 1) for t in (measured.opening_s, measured.landing_s)]
    strength, duration_s = np.nan_to_num(flights.impact[keep]), measured.landing_s - measured.opening_s
    # a ball that leaves with the plate's velocity v(0) meets the plate at v(T) with v(T) - v(0) + g T
    impact = at[1] - at[0] + STANDARD_GRAVITY_MPS2 * duration_s
    shown = rest & (impact > WEAK_MPS) & (strength > 0.0)
    if shown.sum() < FEW_CONTACTS:
        return np.full(len(rest), WEAK_MPS)
    speed = float(np.median(impact[shown] / strength[shown]))
    before = np.concatenate([[0.0], strength[:-1]])
    rings = measured.relaunched & (duration_s < RINGING_S)
    usual = max(WEAK_MPS, DETECTED * THRESHOLD * speed)
    return np.where(rings, np.maximum(usual, DETECTED * ECHO_MARGIN * speed * before), usual)


def closure_s(measured: Measured, heard: Bools) -> float:
    """Middle of the contacts from which the ball left at once; 0 where there are few.

    A contact that only the accelerometer shows (``heard`` at the landing, (n,)) counts as no closed time.
    """
    brief = np.where(heard[:-1], 0.0, measured.opening_s[1:] - measured.landing_s[:-1])
    brief = brief[measured.relaunched[1:] & measured.linked[1:]]
    return float(np.median(brief)) if len(brief) >= FEW_CONTACTS else 0.0


def join(parts: Sequence[Observations]) -> Observations:
    """One table of the observations of several recordings."""
    shift = np.cumsum([0] + [len(p.steps) for p in parts[:-1]])

    def columns(prefix: str, *names: str) -> dict[str, NDArray[Any]]:
        return {name: np.concatenate([attrgetter(prefix + name)(p) for p in parts]) for name in names}

    def filled(nothing: float, *names: str) -> dict[str, NDArray[Any]]:
        """Columns that some recordings may lack."""
        found = {name: [(getattr(p.measured, name), np.full(len(p), nothing)) for p in parts] for name in names}
        return {name: np.concatenate([b if a is None else a for a, b in x]) for name, x in found.items()}

    first = np.repeat(shift, [len(p) for p in parts])  # row of the first step of each flight's recording
    other = filled(-1, "other_step")["other_step"]
    measured = Measured(
        **columns("measured.", "opening_s", "landing_s", "relaunched", "linked", "wanted"),
        **filled(0.0, "share", "part", "ahead_s"),
        **filled(np.nan, "gained_mps", "pressed_mps", "pressed_at"),
        step=np.concatenate([p.measured.step for p in parts]) + first,
        other_step=np.where(other >= 0, other + first, -1),
    )
    tones = columns("steps.plate.", "omega_radps", "acceleration_mps2", "period_s")
    table = Steps(
        **columns("steps.", "number", "gamma", "ratio", "run_part", "spread_mps2", "forcing"),
        recording=np.concatenate([np.full(len(p.steps), i, dtype=np.int64) for i, p in enumerate(parts)]),
        plate=PlateSteps(tones["omega_radps"], tones["acceleration_mps2"], tones["period_s"]),
    )
    circuits = [p.circuit for p in parts]
    openings, landings = ([x.scatters[i] for x in circuits] for i in (0, 1))
    heard = [np.zeros(len(p), dtype=np.bool_) if p.circuit.heard is None else p.circuit.heard for p in parts]
    swings = [p.modulation for p in parts if p.modulation]
    plate, wanders = with_wander(PlateData.join([p.plate for p in parts], shift), np.arange(len(table)))
    return Observations(
        **columns("", "scored", "time_s", "weak_mps"),
        measured=measured,
        opening_sigma_s=np.concatenate(raised_together([p.opening_sigma_s for p in parts], openings)),
        landing_sigma_s=np.concatenate(raised_together([p.landing_sigma_s for p in parts], landings)),
        steps=table,
        plate=plate,
        setup=parts[0].setup,
        notes=tuple(dict.fromkeys([*(n for p in parts for n in p.notes), *wanders])),
        ringing=Identified.together([p.ringing for p in parts]),
        modulation=AmplitudeModulation.join(swings) if swings else None,
        run_part=np.concatenate(
            [p.steps.run_part[p.measured.step] if p.run_part is None else p.run_part for p in parts]
        ),
        circuit=ContactCircuit(
            float(np.median([x.closure_s for x in circuits])),
            (Scatter.together(openings), Scatter.together(landings)),
            np.concatenate(heard),
            any(x.uneven for x in circuits),
        ),
    )
