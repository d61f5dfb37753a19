"""The instrument of a recording: as it was stored at the import, else measured; and the refusal of grave doubts."""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.instrument.doubts import at_edges_g, doubts_of, drive_phase_deg, edges_g, ends_g
from daq.instrument.instrument import STORED, Instrument
from daq.instrument.measure import measure, volts_per_g
from daq.recording import Recording, open_recording
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from daq.steps.forcing_detection import Read
from kernels.arrays import Integers


def examine(
    read: Mapping[str, Read],
    n_samples: int,
    rate_hz: float,
    steps: NDArray[np.void],
    gaps: Integers,
    setup: Setup,
) -> Instrument:
    """The instrument and the doubts about its profile; parameters are those of `daq.instrument.measure.measure`."""
    seen = measure(read, n_samples, rate_hz, steps, gaps, setup)
    noise = seen.noise
    scale = abs(setup.channels.accelerometer.volts_per_mps2)
    opens, _ = edges_g(seen, setup.channels.continuity)
    loudest = max(seen.holds, key=lambda hold: hold.peak_g, default=None)
    tones_g: list[float] = []
    if loudest is not None:
        fit = loudest.plate
        rows = [int(np.argmin(np.abs(fit.frequencies_hz - hz))) for hz in loudest.tones_hz]
        tones_g = (np.abs(fit.amplitudes[rows]) / abs(volts_per_g(setup))).tolist()
    return Instrument(
        rate_hz=rate_hz,
        steps=len(steps),
        noise_mps2=None if noise is None else noise.rms_v / scale,
        noise_mps2_rthz=None if noise is None else math.sqrt(noise.slow_v2phz) / scale,
        bandwidth_hz=None if noise is None else noise.bandwidth_hz,
        bias_v=seen.bias_v,
        tones_hz=() if loudest is None else loudest.tones_hz,
        tones_g=tuple(tones_g),
        phase_deg=drive_phase_deg(seen, setup),
        takeoffs=len(opens),
        takeoff_g=at_edges_g(opens),
        levels_v=seen.levels_v,
        doubts=doubts_of(seen, setup),
        ends_g=ends_g(seen, setup),
    )


def instrument_of(recording: Recording) -> Instrument | None:
    """The instrument of an open recording by its present setup; None without an accelerometer or samples."""
    if "accelerometer" not in recording.channels or not recording.n_samples:
        return None
    # what was stored holds for the setup of the time: with another profile it is measured anew
    own = recording.setup.model_dump(mode="json") == json.loads(recording.stored.get("setup_json", "null"))
    if own and STORED in recording.stored:
        return Instrument.from_json(json.loads(recording.stored[STORED]))
    read = {name: functools.partial(recording.read_v, name) for name in recording.channels}
    return examine(read, recording.n_samples, recording.rate_hz, recording.steps, recording.gaps, recording.setup)


def refuse_doubtful(paths: Iterable[Path], setup: Setup | None = None) -> None:
    """Refuse recordings that contradict their profile so far that a verdict would mean nothing.

    Raises `InputError`, naming the file, the first contradiction and its cure.

    Parameters
    ----------
    paths
        Recordings.
    setup
        Replaces the setup stored in them.
    """
    for path in paths:
        with open_recording(path) as recording:
            if setup is not None:
                recording.measure_with(setup)
            found = instrument_of(recording)
        if found is not None and found.grave:
            raise InputError(f"{path}: {found.grave[0].sentence}; --anyway goes on all the same")
