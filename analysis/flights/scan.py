"""Single pass over a recording: contact crossings, impacts and the plate's normal equations.

A survey of a few pieces measures levels, noise and the impact template first. Then every sample is read once, in three
stages: raw volts, contact voltage as a fraction of its swing, and accelerometer less the impacts found.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from analysis.events.ac_coupling import Coupling, LevelRestorer, measure_coupling
from analysis.events.contact_leak import contact_leak
from analysis.events.impact_detection import NO_IMPACTS, Impacts, ImpactScan
from analysis.events.impact_template import ImpactTemplate
from analysis.events.levels import OPENS, Crossings, CrossingScan, Levels, measure_levels
from analysis.events.sensor_offset import SensorOffset
from analysis.events.template_estimate import estimate_template
from analysis.plate.accumulator import PlatePiece, StepAccumulator
from analysis.plate.motion import PlateMotion, StepPlate
from analysis.plate.tone_noise import with_coloured_noise
from analysis.signals import LEAST_HZ, PAD, HighPass, Piece, Volts, pieces, survey_pieces
from analysis.statistics import median
from daq.files.tables import STEP_DTYPE, BlockFlag
from daq.instrument.channel_limits import NO_ENDS, Ends, NoiseSpectrum, common_ends, ends_in_noise
from daq.instrument.held_readings import coarse_step, without_rounding
from daq.recording import Recording
from daq.setup.errors import InputError
from daq.setup.setup import FAR_OUTSIDE
from kernels.arrays import Floats, Integers

Progress = Callable[[float], None]  # part done, 0 to 1

NO_CIRCUIT = Levels(0.0, 1.0, 0.1)  # levels of a scan that is never used


@dataclass(frozen=True)
class Survey:
    """Properties of the rig measured on a few pieces."""

    levels: Levels | None  # None without a contact circuit
    noise: NoiseSpectrum | None  # of the accelerometer; None where the recording is too short to tell
    template: ImpactTemplate | None  # None where the accelerometer shows no impacts
    coupling: Coupling | None = None  # high-pass of an AC-coupled contact circuit
    # volts beyond which the accelerometer does not read; infinite where it does not come to its end
    ends_v: Ends = NO_ENDS
    step_v: float = 0.0  # distance of the accelerometer's readings where it is coarser than the noise
    leak: float = 0.0  # part of the contact's volts that the accelerometer holds

    def without_leak(self, piece: Piece) -> None:
        """Take out of a piece's accelerometer what leaks into it from the contact, in place."""
        if self.leak != 0.0 and self.levels is not None:
            contact_v = piece.channels["continuity"]
            piece.channels["accelerometer"] -= np.float32(self.leak) * (contact_v - np.float32(self.levels.closed_v))

    def smooth(self, volts: Volts) -> Volts:
        """The accelerometer (n,) without the steps of few bits, which look like impacts; itself where it has more."""
        if self.step_v > 0.0:
            without_rounding(volts := volts.copy(), self.step_v)
        return volts

    @property
    def mask_s(self) -> float:
        """Time after an impact that is masked in the accelerometer."""
        # 2 ms where the accelerometer does not show how long it rings
        return 2e-3 if self.template is None else self.template.ring_s


@dataclass(frozen=True)
class Scan:
    """Result of the pass."""

    survey: Survey
    steps: npt.NDArray[np.void]  # frequencies filled in
    crossings: Crossings
    starts_open: bool  # contact circuit open at the first sample
    impacts: Impacts  # on the accelerometer's time axis
    plate: PlateMotion
    missed: Integers  # samples at which an edge of the contact is known to have been missed
    filled_spans_s: Floats  # intervals whose samples or drive were filled in by the recorder
    elsewhere: SensorOffset | None = None  # as in `analysis.events.sensor_offset.calibrate`.


def resolved_steps(recording: Recording) -> npt.NDArray[np.void]:
    """The step table with frequencies filled in; one step for the whole recording where there is none."""
    steps = np.array(recording.steps, dtype=STEP_DTYPE)
    forcing = recording.setup.forcing
    if not len(steps):
        steps = np.zeros(1, dtype=STEP_DTYPE)
        steps["n_samples"], steps["gamma"], steps["frequency_hz"] = recording.n_samples, np.nan, np.nan
    steps["frequency_hz"] = np.where(steps["frequency_hz"] > 0, steps["frequency_hz"], forcing.frequency_hz)
    steps["ratio"] = np.where(steps["ratio"] > 0, steps["ratio"], forcing.ratio)
    steps["n_samples"] = np.clip(recording.n_samples - steps["first_sample"], 0, steps["n_samples"])
    return steps


def _channels(recording: Recording) -> tuple[str, ...]:
    """The channels to read, in a fixed order."""
    if "accelerometer" not in recording.channels:
        raise InputError(
            f"{recording.path}: wanted a channel 'accelerometer' (the plate's motion), found only "
            f"{', '.join(recording.channels)}; import the recording again with --map"
        )
    return tuple(name for name in ("continuity", "accelerometer", "drive") if name in recording.channels)


def corner_of(recording: Recording, corner_hz: float | None) -> float:
    """Corner of the accelerometer's high-pass in Hz, where one is known, or declared; 0 for none."""
    declared = recording.setup.declared_values().get("accelerometer_high_pass", {})
    return declared.get("corner_hz", 0.0) if corner_hz is None else corner_hz


def high_pass_of(recording: Recording, corner_hz: float | None) -> HighPass | None:
    """The accelerometer's high-pass, where its tails of impacts matter."""
    corner_hz = corner_of(recording, corner_hz)
    return HighPass(corner_hz, recording.rate_hz) if corner_hz > LEAST_HZ else None


def survey(recording: Recording, high_pass_hz: float | None = None) -> Survey:
    """Levels, noise and the impact template from a few pieces; ``high_pass_hz`` as in `scan`.

    Raises `InputError` when the recording is too short, or its volts are far outside a channel's range.
    """
    channels = tuple(name for name in _channels(recording) if name != "drive")
    # and 32 samples: levels and noise need some even where a cycle has fewer
    cycle = max(round(recording.rate_hz / recording.setup.forcing.frequency_hz), 32)
    if recording.n_samples < cycle:
        raise InputError(
            f"{recording.path}: wanted at least {cycle} samples (a cycle of the forcing at "
            f"{recording.setup.forcing.frequency_hz:g} Hz), got {recording.n_samples}; name a longer recording"
        )
    looked = list(survey_pieces(recording, channels))
    _refuse_far_outside(recording, looked, channels)
    steps = resolved_steps(recording)
    zero_v = recording.setup.channels.accelerometer.offset_v
    stretches = [x for piece in looked for x in _by_step(piece, steps)]
    ends_v = common_ends(stretches, recording.rate_hz, math.nan if zero_v is None else zero_v.value)
    forcing = recording.setup.forcing
    tones_hz = [multiple * forcing.frequency_hz for multiple in forcing.multiples]
    ends_v = ends_in_noise(stretches, ends_v, recording.rate_hz, tones_hz)
    step_v = coarse_step(stretches)
    levels, coupling, leak = _circuit(recording, looked)
    known = Survey(levels, None, None, coupling, ends_v, step_v, 0.0 if step_v > 0.0 else leak)
    for piece in looked:
        known.without_leak(piece)
        if (high_pass := high_pass_of(recording, high_pass_hz)) is not None:
            high_pass.undo(piece)
        if step_v > 0.0:
            without_rounding(piece.channels["accelerometer"], step_v)
    noise, template = estimate_template(looked, steps, recording.rate_hz, forcing, recording.gaps)
    return replace(known, noise=noise, template=template)


def _circuit(recording: Recording, looked: list[Piece]) -> tuple[Levels | None, Coupling | None, float]:
    """Levels and coupling of the contact circuit, and what of it leaks into the accelerometer."""
    contact, rate_hz = recording.setup.channels.continuity, recording.rate_hz
    if "continuity" not in recording.channels or contact is None:
        return None, None, 0.0
    volts = [p.own("continuity") for p in looked]
    if contact.coupling == "ac":
        coupling = measure_coupling([own.astype(np.float64) for own in volts], contact.swing_v, rate_hz)
        return coupling.levels, coupling, 0.0
    levels = measure_levels(np.concatenate(volts), contact.closed_v.value, contact.open_v.value)
    return levels, None, contact_leak(looked, levels, rate_hz)


def _by_step(piece: Piece, steps: npt.NDArray[np.void]) -> list[Volts]:
    """The accelerometer in a piece, cut where a step begins."""
    starts = [int(first) - piece.first for first in steps["first_sample"] if piece.first < first < piece.last]
    return np.split(piece.own("accelerometer"), starts)


def _refuse_far_outside(recording: Recording, looked: list[Piece], channels: tuple[str, ...]) -> None:
    """Refuse volts that no channel of this profile can have read."""
    for name in channels:
        described = getattr(recording.setup.channels, name)
        peak = max(float(np.abs(piece.own(name)).max()) for piece in looked)
        if described is not None and not peak <= FAR_OUTSIDE * described.range_v:
            raise InputError(
                f"{recording.path}: {name} reads {peak:.4g} V, far outside its range_v = {described.range_v:g}; import "
                f"the file again with its unit (--map {name}=COLUMN:mV), or correct range_v in the profile"
            )


def _open_fraction(piece: Piece, levels: Levels) -> Volts:
    """Contact voltage as a fraction of the swing, in the memory of the piece's volts: 0 closed, 1 open."""
    volts = piece.channels["continuity"]
    volts -= np.float32(levels.closed_v)
    volts *= np.float32(1.0 / levels.swing_v)
    return volts


def scan(recording: Recording, progress: Progress | None = None, high_pass_hz: float | None = None) -> Scan:
    """Crossings, impacts and plate motion of a recording in one pass.

    Raises `InputError` when there is no accelerometer channel, or the survey refuses the recording.

    Parameters
    ----------
    progress : callable, optional
        Called with the part done, 0 to 1, after each piece.
    high_pass_hz : float, optional
        Corner of a high-pass behind the accelerometer; None: the declared one, or that which tails of impacts show.
    """
    channels = _channels(recording)
    known, high_pass = survey(recording, high_pass_hz), high_pass_of(recording, high_pass_hz)
    steps, rate_hz = resolved_steps(recording), recording.rate_hz
    contact = CrossingScan(known.levels or NO_CIRCUIT)
    restorer = LevelRestorer(known.coupling, rate_hz) if known.coupling is not None else None
    # rebounds that are no sure impacts ring in the plate's motion all the same: after the sure ones, every one
    detectors = [ImpactScan(known.template, rate_hz, every=x) for x in (False, True) if known.template is not None]
    accumulator = StepAccumulator(recording, steps, known.mask_s, known.ends_v)
    for piece in pieces(recording, channels):
        acceleration_v, drive_v = piece.channels["accelerometer"], piece.channels.get("drive")
        known.without_leak(piece)
        if high_pass is not None:
            high_pass.undo(piece)
        fraction, landings = None, [np.zeros(0, np.int64)]
        if known.levels is not None:
            fraction = _open_fraction(piece, known.levels) if restorer is None else restorer.restore(piece)
            found = contact.add(fraction, piece.first, PAD, piece.count)
            landings.append(found.sample[found.kind != OPENS])
        smooth_v = known.smooth(acceleration_v)  # tones come from the readings as they are
        for detector in detectors:
            heard = detector.add(smooth_v, piece.first, PAD, piece.count)
            landings += [] if detector.every else [heard]
            for volts in (smooth_v, acceleration_v)[: 1 + (smooth_v is not acceleration_v)]:
                detector.subtract_impacts(volts, piece.first, PAD)
        if high_pass is not None:
            high_pass.redo(piece)
        drive, air = (None if volts is None else piece.trim(volts) for volts in (drive_v, fraction))
        trimmed = PlatePiece(piece.first, piece.trim(acceleration_v), drive, air, piece.acceleration_codes)
        accumulator.add(trimmed, np.concatenate(landings))
        if progress is not None:
            progress(piece.last / recording.n_samples)
    plate = with_coloured_noise(accumulator.finish())
    impacts = detectors[0].impacts().away_from_seams(recording) if detectors else NO_IMPACTS
    noise_v, accelerometer = 0.0 if known.noise is None else known.noise.rms_v, recording.setup.channels.accelerometer
    if high_pass is None and high_pass_hz is None and (corner_hz := _corner_of_tails(recording, plate)) > LEAST_HZ:
        return scan(recording, progress, corner_hz)
    return Scan(
        survey=known,
        steps=steps,
        crossings=contact.crossings(),
        starts_open=contact.started_open,
        impacts=impacts.strong_in(_cut_off_spans_s(recording, steps, plate)),
        plate=PlateMotion(plate, noise_v / abs(accelerometer.volts_per_mps2), rate_hz, recording.gaps, known.leak),
        missed=np.array([] if restorer is None else restorer.missed, np.int64),
        filled_spans_s=_filled_spans_s(recording),
    )


def _corner_of_tails(recording: Recording, plate: Sequence[StepPlate | None]) -> float:
    """Corner in Hz that the tails of impacts show in offsets and harmonics of an AC-coupled accelerometer; 0 for none.

    Impacts of any size and rate leave ``-2 a / (1 + i m f / corner)`` at the m-th multiple of the forcing, for an
    offset of ``-a``. Where impacts are at several phases of a cycle, the harmonic is smaller than that.
    """
    found, coupled = [], recording.setup.channels.accelerometer.coupling == "ac"
    for s in plate if coupled else ():
        fit = None if s is None else s.acceleration
        if s is None or fit is None or abs(fit.offset) < 10.0 * fit.offset_uncertainty:
            continue
        k = next((i for i, m in enumerate(s.multiples) if m > 1 and m not in s.forcing_multiples), None)
        if k is None or abs(fit.amplitudes[k]) < 5.0 * fit.amplitude_sigma()[k]:
            continue
        ratio = 2.0 * abs(fit.offset) / abs(fit.amplitudes[k])
        found.append(s.multiples[k] * s.frequency_hz / math.sqrt(max(ratio**2 - 1.0, 1.0)))
    return median(np.array(found)) if len(found) >= 4 else 0.0


def _cut_off_spans_s(recording: Recording, steps: npt.NDArray[np.void], plate: Sequence[StepPlate | None]) -> Floats:
    """Spans (k, 2) of the steps whose motion a sensor's end cuts off, where corners of the motion look like impacts.

    Each lasts from the step's first sample to the next one's hold.
    """
    holds = np.append(steps["first_sample"] + steps["settle_samples"], recording.n_samples)
    cut_off = np.array([s is not None and s.saturated for s in plate])
    return np.asarray(np.column_stack([steps["first_sample"], holds[1:]])[cut_off] / recording.rate_hz)


def plate_of(recording: Recording, *, progress: Progress | None = None) -> PlateMotion:
    """Plate motion in every step of a recording: see `analysis.plate.motion.StepPlate`."""
    return scan(recording, progress).plate


def _filled_spans_s(recording: Recording) -> Floats:
    """Intervals of the recording that the recorder filled in, (n, 2)."""
    filled = recording.blocks[recording.blocks["flags"] & BlockFlag.FILLED != 0]
    ends = filled["first_sample"] + filled["n_samples"]
    return np.asarray(np.column_stack([filled["first_sample"], ends]) / recording.rate_hz)
