"""Calibrations of a rig by its own means: accelerometer, drive and contact circuit, under a profile's keys.

A calibration that moves the plate is a ramp like any other, behind the same interlock, recorded,
and read by the analysis' own estimators. What could not be measured is refused, never guessed. Decision 55.
"""

from __future__ import annotations

import cmath
import datetime
import math
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from analysis.events.impact_detection import ONSET_S
from analysis.flights.assemble import Flights, flights_of
from analysis.plate.motion import StepPlate
from bench.jobs.run_ramp import open_rig, record
from bench.profiles.edit import write_into
from bench.profiles.find import refuse_forbidden
from daq.recording import open_recording
from daq.setup.errors import InputError
from daq.setup.values import MeasuredValue
from model.effects.registry import effect
from rig.backends.base import Backend
from rig.checks.flip_test import flip_test
from rig.profile import Profile, RampTable
from rig.programme.ramp import peaks

DRIVE_PEAKS = (0.2, 0.35, 0.5)  # of g: the block stays on, even if the drive is twice as strong as believed
LEAST_PAIRS = 20  # of impacts and edges


def calibrate_into(
    path: Path, kind: str, scenario: Path | None, seed: int, ask: Callable[[bool], None]
) -> tuple[Profile, Backend, list[MeasuredValue]]:
    """Do what `bench calibrate` does, and write it into the profile's file, which a failure leaves as it was.

    Raises `InputError` or `BackendError`. Returns the profile as it was, its back end, and what was measured. ``ask``
    is called before the accelerometer is laid upside down (True) and back (False).
    """
    profile, backend = open_rig(path, "calibrate", scenario, seed)
    if kind == "accelerometer":
        measured = accelerometer(profile, backend, ask)
    else:
        measured = (drive if kind == "drive" else contact)(profile, backend)
    write_into(path, measured, datetime.date.today())
    return profile, backend, measured


def accelerometer(profile: Profile, backend: Backend, ask: Callable[[bool], None]) -> list[MeasuredValue]:
    """Sensitivity and offset by a flip test (`rig.checks.flip_test`); raises `InputError`, `BackendError`."""
    if profile.channels.accelerometer.coupling == "ac":
        raise InputError("channels.accelerometer.coupling is ac: a flip test needs an input that passes a constant")
    try:
        flip = flip_test(profile, backend, ask)
    except ValueError as error:
        raise InputError(f"accelerometer: {error}") from error
    if flip.sensitivity < 0.0:
        raise InputError(
            "accelerometer: it read more upside down than as mounted: change channels.accelerometer.sign, or begin "
            "with the sensor as it is mounted"
        )
    key, source = "channels.accelerometer", "flip test (bench calibrate accelerometer)"
    return [
        MeasuredValue(f"{key}.sensitivity", flip.sensitivity, flip.sensitivity_uncertainty, source),
        MeasuredValue(f"{key}.offset_v", flip.offset_v, flip.offset_uncertainty_v, source),
    ]


def drive(profile: Profile, backend: Backend) -> list[MeasuredValue]:
    """Gain and phase of the plate for a volt of drive, tone by tone, the block resting on it.

    The looped-back drive is compared with the accelerometer at three levels; their scatter, the accelerometer's own
    scale and the local g are in the uncertainty. Raises `InputError`.
    """
    steps, _ = _run(profile, backend, DRIVE_PEAKS)
    if len(steps) < len(DRIVE_PEAKS):
        raise InputError("drive: the plate's motion was not seen in every step; run bench check first")
    found: list[MeasuredValue] = []
    for key, multiple in zip(("drive", "drive.second"), steps[0].forcing_multiples, strict=False):
        found += _gain_and_phase(profile, key, [_response(step, multiple, profile.g_mps2.value) for step in steps])
    return found


def contact(profile: Profile, backend: Backend) -> list[MeasuredValue]:
    """Levels of the contact circuit in contact and in the air, and how late its edges are to the impacts.

    The delay is that to the accelerometer's impacts (the way through the table and the sensor included), and becomes
    the declared effect ``contact_latency``. A circuit that seems early means a sensor that is late, by a filter
    that holds tones back by more than it does impacts: then no latency is known better than that. Raises `InputError`.
    """
    channel = profile.channels.continuity
    if channel is None:
        raise InputError("channels.continuity: the profile has no contact circuit to calibrate")
    # impacts of several speeds, or a late edge might be the end of a chatter
    _, flights = _run(profile, backend, (1.4, 1.7, 2.0, 2.4))
    levels, witness = flights.edges.levels, flights.edges.sensor_offset
    seen = int(np.count_nonzero(flights.good()))
    if levels is None or seen < LEAST_PAIRS:
        raise InputError(f"contact: {seen} flights were seen, wanted {LEAST_PAIRS}; is the block on, the wire whole?")
    source = "bench calibrate contact"
    found = []
    if channel.coupling == "dc":
        spread = f"{source}; uncertainty: noise of a sample"
        found += [
            MeasuredValue("channels.continuity.closed_v", levels.closed_v, levels.noise_v, spread),
            MeasuredValue("channels.continuity.open_v", levels.open_v, levels.noise_v, spread),
        ]
    if witness is None or not math.isfinite(witness.uncertainty_s) or witness.pairs < LEAST_PAIRS:
        raise InputError(
            "contact: the accelerometer shows too few clear impacts to time the edges by; lower its range_v, or mount "
            "it closer to where the block lands"
        )
    delay_s, sigma = -witness.offset_s, math.hypot(witness.uncertainty_s, ONSET_S)
    late = f"{source}; against the impacts in the accelerometer"
    if delay_s < effect("contact_latency").effect.parameter("delay_s").low:
        delay_s, sigma, late = 0.0, math.hypot(sigma, delay_s), f"{late}, which come {-1e6 * delay_s:.0f} us later"
    return [*found, MeasuredValue("declared.contact_latency.delay_s", delay_s, sigma, late)]


def _run(profile: Profile, backend: Backend, peaks_g: tuple[float, ...]) -> tuple[list[StepPlate], Flights]:
    """Drive these peaks of the plate, open loop, and read the recording: fitted steps, and flights."""
    per_g = peaks(profile, 1.0).gamma_peak
    ramp = RampTable(
        gamma=tuple(peak / per_g for peak in peaks_g), settle_cycles=15, hold_cycles=60,
        slew_per_cycle=profile.ramp.slew_per_cycle,
    )  # fmt: skip
    profile = profile.model_copy(update={"ramp": ramp, "control": None})
    refuse_forbidden(profile.name, profile)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "calibration.h5"
        summary = record(profile, "", backend, path, quiet=True)
        if summary.how != "complete":
            raise InputError(f"the calibration run was {summary.how}: {summary.why}")
        with open_recording(path) as recording:
            flights = flights_of(recording)
    return [step for step in flights.plate.steps if step is not None], flights


def _response(step: StepPlate, multiple: int, g_mps2: float) -> tuple[complex, float]:
    """Plate acceleration in g for a volt of one tone, and its relative standard uncertainty."""
    plate, volts = step.acceleration, step.drive
    if volts is None:
        raise InputError("drive: the looped-back drive is not recorded; run bench check first")
    k = step.multiples.index(multiple)
    z, v = complex(plate.amplitudes[k]), complex(volts.amplitudes[k])
    relative = math.hypot(plate.amplitude_sigma()[k] / abs(z), volts.amplitude_sigma()[k] / abs(v))
    return z / (v * g_mps2), relative


def _gain_and_phase(profile: Profile, key: str, responses: list[tuple[complex, float]]) -> list[MeasuredValue]:
    """One gain and phase from those of the levels."""
    value = np.array([z for z, _ in responses])
    # what the tone fit itself leaves: without it a level of little noise would have all the weight
    sigma = np.array([math.hypot(relative, 5e-5) for _, relative in responses])
    mean = complex(np.average(value, weights=sigma**-2.0))
    # the scatter between levels shows what no single fit knows: a gain that depends on the level
    off = value / mean - 1.0  # real part: gain, imaginary: phase in rad
    own = float(np.sum(sigma**-2.0) ** -0.5)
    gain_off, phase_off = (max(own, float(np.std(x, ddof=1)) / math.sqrt(len(x))) for x in (off.real, off.imag))
    scale, g = profile.channels.accelerometer.sensitivity, profile.g_mps2
    relative = math.hypot(gain_off, scale.uncertainty / scale.value, g.uncertainty / g.value)
    source = f"drive to plate, block on, gamma_peak {DRIVE_PEAKS[0]:g} to {DRIVE_PEAKS[-1]:g} (bench calibrate drive)"
    return [
        MeasuredValue(f"{key}.g_per_volt", abs(mean), abs(mean) * relative, source),
        MeasuredValue(f"{key}.phase_deg", math.degrees(cmath.phase(mean)), math.degrees(phase_off), source),
    ]
