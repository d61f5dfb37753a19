"""The single pass: contact crossings, impact candidates and folded tones from one reading of the recording.

The rule kept here: a survey of a few pieces learns what this rig looks like (levels, noise, edge shapes, the waveform
of an impact); then every sample is looked at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from analysis.events.ac_coupling import Coupling, LevelRestorer, measure_coupling
from analysis.events.edges import OPENS, Crossings, CrossingScan, Levels, measure_levels
from analysis.events.impact_detection import NO_IMPACTS, Impacts, ImpactScan
from analysis.events.impact_template import Waveform, white_noise
from analysis.events.template_estimate import learn
from analysis.plate.accumulator import StepAccumulator
from analysis.plate.motion import PlateMotion
from analysis.signals.stream import PAD, Piece, pieces, survey_pieces
from daq.recording import Recording
from daq.recording.tables import STEP_DTYPE, BlockFlag
from daq.setup.errors import InputError
from daq.setup.setup import FAR_OUTSIDE

Ints = npt.NDArray[np.int64]
Progress = Callable[[float], None]  # part done, 0 to 1

LEAST_SAMPLES = 32  # of a recording that is analysed
DEFAULT_MASK_S = 2e-3  # left out after an impact where the accelerometer does not show how long it rings


@dataclass(frozen=True)
class Survey:
    """What a look at a few pieces said about the rig; ``coupling`` is that of an AC-coupled contact circuit."""

    levels: Levels | None
    noise_v: float
    waveform: Waveform | None
    coupling: Coupling | None = None

    @property
    def mask_s(self) -> float:
        """How long after an impact the accelerometer is left out."""
        return DEFAULT_MASK_S if self.waveform is None else self.waveform.ring_s


@dataclass(frozen=True)
class Scan:
    """Everything one pass found; ``missed`` are samples by which an edge of the contact must have been missed.

    ``filled_spans_s``, shape (n, 2), are spans in seconds whose samples, or whose drive, nobody vouches for.
    """

    survey: Survey
    steps: npt.NDArray[np.void]
    crossings: Crossings
    starts_open: bool
    impacts: Impacts
    plate: PlateMotion
    missed: Ints
    filled_spans_s: npt.NDArray[np.float64]


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


def survey(recording: Recording) -> Survey:
    """Levels, noise and the impact's waveform from a few pieces."""
    channels = tuple(name for name in _channels(recording) if name != "drive")
    cycle = max(round(recording.rate_hz / recording.setup.forcing.frequency_hz), LEAST_SAMPLES)
    if recording.n_samples < cycle:
        raise InputError(
            f"{recording.path}: wanted at least {cycle} samples (a cycle of the forcing at "
            f"{recording.setup.forcing.frequency_hz:g} Hz), got {recording.n_samples}; name a longer recording"
        )
    looked = list(survey_pieces(recording, channels))
    _refuse_far_outside(recording, looked, channels)
    noise = float(np.median([white_noise(p.own("accelerometer").astype(np.float64)) for p in looked]))
    waveform = learn(looked, noise, resolved_steps(recording), recording.rate_hz)
    contact = recording.setup.channels.continuity
    if "continuity" not in channels or contact is None:
        return Survey(None, noise, waveform)
    volts = [p.own("continuity").astype(np.float64) for p in looked]
    if contact.coupling == "ac":
        coupling = measure_coupling(volts, contact.swing_v, recording.rate_hz)
        return Survey(coupling.levels, noise, waveform, coupling)
    sample = np.concatenate(volts)
    return Survey(measure_levels(sample, contact.closed_v.value, contact.open_v.value), noise, waveform)


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


def _fraction(piece: Piece, levels: Levels) -> npt.NDArray[np.float32]:
    """Continuity as a fraction of the swing: 0 closed, 1 open."""
    volts = piece.channels["continuity"]
    return (volts - np.float32(levels.closed_v)) * np.float32(1.0 / levels.swing_v)


def scan(recording: Recording, progress: Progress | None = None) -> Scan:
    """Read the recording once and find everything.

    Raises
    ------
    InputError
        When there is no accelerometer channel.
    """
    channels = _channels(recording)
    known = survey(recording)
    steps = resolved_steps(recording)
    contact = CrossingScan(known.levels) if known.levels is not None else None
    witness = ImpactScan(known.waveform, recording.rate_hz) if known.waveform is not None else None
    restorer = LevelRestorer(known.coupling, recording.rate_hz) if known.coupling is not None else None
    folder = StepAccumulator(recording, steps, known.mask_s)
    starts_open = False
    for piece in pieces(recording, channels):
        hits = [np.zeros(0, np.int64)]
        if contact is not None and known.levels is not None:
            fraction = _fraction(piece, known.levels) if restorer is None else restorer.restore(piece)
            piece.channels["continuity"] = fraction
            found = contact.add(fraction, piece.first, PAD, piece.count)
            hits.append(found.sample[found.kind != OPENS])
            if piece.first == 0:
                starts_open = contact.started_open
        if witness is not None:
            hits.append(witness.add(piece.channels["accelerometer"], piece.first, PAD, piece.count))
            witness.subtract(piece.channels["accelerometer"], piece.first, PAD)
        folder.add(piece, np.concatenate(hits))
        if progress is not None:
            progress(piece.last / recording.n_samples)
    empty = CrossingScan(Levels(0.0, 1.0, 0.1))
    seen = NO_IMPACTS if witness is None else witness.impacts()
    plate = PlateMotion(folder.finish(), _noise_mps2(recording, known), recording.rate_hz, recording.gaps)
    missed = np.array([] if restorer is None else restorer.missed, np.int64)
    filled = recording.blocks[recording.blocks["flags"] & BlockFlag.FILLED != 0]
    spans = np.column_stack([filled["first_sample"], filled["first_sample"] + filled["n_samples"]]) / recording.rate_hz
    return Scan(known, steps, (contact or empty).crossings(), starts_open, seen, plate, missed, spans)


def _noise_mps2(recording: Recording, known: Survey) -> float:
    """White noise of the accelerometer in m/s^2."""
    return known.noise_v / abs(recording.setup.channels.accelerometer.volts_per_mps2)
