"""The single pass: contact crossings, impact candidates and folded tones from one reading of the recording.

The rule kept here: a survey of a few pieces learns what this rig looks like (levels, noise, edge shapes, the waveform
of an impact); then every sample is looked at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from analysis.impacts import ECHO, LEAD
from analysis.contact import CLOSES, OPENS, Crossings, CrossingScan, Levels, measure_levels, time_edges
from analysis.folding import Folder
from analysis.impacts import NO_IMPACTS, Impacts, ImpactScan, Waveform, learn_waveform, white_noise
from analysis.plate_motion import PlateMotion
from analysis.stream import PAD, Piece, pieces, survey_pieces
from daq.block import STEP_DTYPE
from daq.errors import InputError
from daq.recording import Recording
from daq.tones import fit_tones

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Progress = Callable[[float], None]  # part done, 0 to 1

DEFAULT_MASK_S = 2e-3  # left out after an impact where the accelerometer does not show how long it rings
LEARNING_MASK_S = 8e-3  # left out after an impact while its waveform is learnt
QUIET_FLIGHT_S = 2e-3  # flights at least this long teach the waveform of an impact


@dataclass(frozen=True)
class Survey:
    """What a look at a few pieces said about the rig."""

    levels: Levels | None
    noise_v: float
    waveform: Waveform | None

    @property
    def mask_s(self) -> float:
        """How long after an impact the accelerometer is left out."""
        return DEFAULT_MASK_S if self.waveform is None else self.waveform.ring_s


@dataclass(frozen=True)
class Scan:
    """Everything one pass found."""

    survey: Survey
    steps: npt.NDArray[np.void]
    crossings: Crossings
    starts_open: bool
    impacts: Impacts
    plate: PlateMotion


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
    looked = list(survey_pieces(recording, channels))
    noise = float(np.median([white_noise(p.own("accelerometer").astype(np.float64)) for p in looked]))
    contact = recording.setup.channels.continuity
    if "continuity" not in channels or contact is None:
        return Survey(None, noise, None)
    sample = np.concatenate([p.own("continuity") for p in looked]).astype(np.float64)
    levels = measure_levels(sample, contact.closed_v, contact.open_v)
    return Survey(levels, noise, _learn(looked, levels, noise, resolved_steps(recording), recording.rate_hz))


def _fraction(piece: Piece, levels: Levels) -> npt.NDArray[np.float32]:
    """Continuity as a fraction of the swing: 0 closed, 1 open."""
    volts = piece.channels["continuity"]
    return (volts - np.float32(levels.closed_v)) * np.float32(1.0 / levels.swing_v)


def _learn(
    looked: list[Piece], levels: Levels, noise_v: float, steps: npt.NDArray[np.void], rate_hz: float
) -> Waveform | None:
    """The impact's waveform, learnt twice: the second time the impacts that the continuity circuit missed are known too."""
    tones_hz = np.unique(np.concatenate([steps["frequency_hz"], steps["frequency_hz"] * steps["ratio"]]))
    few = tones_hz[np.unique(np.linspace(0, tones_hz.size - 1, 4).astype(int))]
    landings = [_landings(piece, levels, rate_hz) for piece in looked]
    impacts = [clean for clean, _ in landings]
    waveform = None
    for _ in range(2):
        rows = [
            _snippets(piece, clean, every, impact, steps, rate_hz)
            for piece, (clean, every), impact in zip(looked, landings, impacts, strict=True)
        ]
        snippets = np.concatenate([r[0] for r in rows])
        waveform = learn_waveform(snippets, np.concatenate([r[1] for r in rows]), noise_v, rate_hz, few)
        if waveform is None:
            return None
        impacts = []
        for piece in looked:
            witness = ImpactScan(waveform, rate_hz)
            witness.add(piece.channels["accelerometer"], piece.first, PAD, piece.count)
            impacts.append(witness.impacts().time_s * rate_hz)
    return waveform


def _landings(piece: Piece, levels: Levels, rate_hz: float) -> tuple[Floats, Floats]:
    """Landings in a piece according to the continuity circuit, in samples: clean ones, and all."""
    found = CrossingScan(levels)
    crossings = found.add(_fraction(piece, levels), piece.first, PAD, piece.count)
    if crossings.sample.size < 2:
        return np.zeros(0), np.zeros(0)
    edges, _, _ = time_edges(crossings, levels, rate_hz)
    before = np.append(np.inf, np.diff(edges.time_s))
    opened = np.append(False, crossings.kind[:-1] == OPENS)
    clean = (crossings.kind == CLOSES) & opened & (before > QUIET_FLIGHT_S)
    return edges.time_s[clean] * rate_hz, edges.time_s[crossings.kind != OPENS] * rate_hz


def _snippets(
    piece: Piece, clean: Floats, every: Floats, impacts: Floats, steps: npt.NDArray[np.void], rate_hz: float
) -> tuple[Floats, Floats]:
    """Accelerometer less the motion around the clean landings far from others, and their place before the sample."""
    hits = np.sort(np.concatenate([every, impacts]))
    volts, known = _without_motion(piece, hits, steps, rate_hz)
    later = hits[np.minimum(np.searchsorted(hits, clean + 3.0), max(hits.size - 1, 0))] if hits.size else clean
    alone = (later <= clean + 3.0) | (later > clean + ECHO)
    sample = np.ceil(clean).astype(np.int64)
    index = (sample - piece.first + PAD)[:, None] + np.arange(-LEAD, ECHO - LEAD)
    inside = alone & (index[:, 0] >= 0) & (index[:, -1] < volts.size)
    index, fractions = index[inside], (sample - clean)[inside]
    fitted = known[index].all(axis=1)
    return volts[index[fitted]], fractions[fitted]


def _without_motion(
    piece: Piece, hits: Floats, steps: npt.NDArray[np.void], rate_hz: float
) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Accelerometer volts less each step's tones (fitted away from impacts), and where a fit was possible."""
    volts = piece.channels["accelerometer"].astype(np.float64)
    known = np.zeros(volts.size, dtype=np.bool_)
    quiet = np.ones(volts.size, dtype=np.bool_)
    for hit in np.rint(hits).astype(np.int64) - piece.first + PAD:
        quiet[max(hit - 4, 0) : max(hit + int(LEARNING_MASK_S * rate_hz), 0)] = False
    for row in steps:
        start = max(int(row["first_sample"] + row["settle_samples"]), piece.first)
        stop = min(int(row["first_sample"] + row["n_samples"]), piece.last)
        if stop - start < 3.0 * rate_hz / row["frequency_hz"]:
            continue
        own = slice(start - piece.first + PAD, stop - piece.first + PAD)
        tones_hz = row["frequency_hz"] * np.unique([1, 2, 3, row["ratio"]])
        try:
            fit = fit_tones(volts[own], start, rate_hz, tones_hz, quiet[own])
        except ValueError:  # too little is quiet in this piece of the step
            continue
        turns = np.outer(fit.frequencies_hz / rate_hz, np.arange(start, stop)) % 1.0
        volts[own] -= fit.offset + (fit.amplitudes[:, None] * np.exp(2j * np.pi * turns)).real.sum(axis=0)
        known[own] = True
    return volts, known


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
    folder = Folder(recording, steps, known.mask_s)
    starts_open = False
    for piece in pieces(recording, channels):
        hits = [np.zeros(0, np.int64)]
        if contact is not None and known.levels is not None:
            fraction = _fraction(piece, known.levels)
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
    return Scan(known, steps, (contact or empty).crossings(), starts_open, seen, plate)


def _noise_mps2(recording: Recording, known: Survey) -> float:
    """White noise of the accelerometer in m/s^2."""
    return known.noise_v / abs(recording.setup.channels.accelerometer.volts_per_mps2)

