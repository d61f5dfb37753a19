"""The flip test: an accelerometer at rest, as mounted and upside down, differs by twice the local gravity.

The plate is never driven, and a reading's uncertainty comes from its own scatter over the seconds
it was taken, not from what the noise of a sample promises.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from daq.channels.accelerometer import ACCELEROMETER_UNITS_V_PER_MPS2
from rig.backends.base import Backend, FlipsSensor, running
from rig.profile import Profile

SETTLE_S = 0.5  # after the sensor was touched
PARTS = 20  # of a reading, whose scatter is its uncertainty
ORIENTATIONS = (False, True, False)  # upside down? The last one tells whether the first still holds


@dataclass(frozen=True)
class Reading:
    """Mean volts at rest, and its standard uncertainty."""

    volts: float
    uncertainty_v: float


@dataclass(frozen=True)
class Flip:
    """What a flip test says of the accelerometer."""

    sensitivity: float  # in the profile's unit; negative where the profile's sign is wrong
    sensitivity_uncertainty: float
    offset_v: float  # reading at zero acceleration; at rest as mounted where the profile says that gravity is not read
    offset_uncertainty_v: float


def flip_test(profile: Profile, backend: Backend, ask: Callable[[bool], None]) -> Flip:
    """Read the accelerometer at rest as mounted, upside down, and as mounted again.

    With ``V = offset + S (a + g)``: ``S = (V_up - V_down) / 2g``, and ``offset = (V_up + V_down) / 2``.

    Parameters
    ----------
    profile
        Scale, unit and sign as believed so far, and the local g.
    backend
        Not yet started. One that is `FlipsSensor` turns its sensor by itself.
    ask
        Has a person lay the sensor upside down (True) or as mounted (False), and returns once it lies still.

    Raises
    ------
    ValueError
        Where the reading does not change as that of a sensor that feels gravity.
    BackendError
        Where the device fails.
    """
    first, down, again = _readings(profile, backend, ask)
    channel, g = profile.channels.accelerometer, profile.g_mps2
    # what the two readings as mounted differ by more than they say is how well the sensor was laid back
    slipped_v = abs(first.volts - again.volts) / math.sqrt(2.0)
    up = 0.5 * (first.volts + again.volts)
    up_sigma = max(math.hypot(first.uncertainty_v, again.uncertainty_v), slipped_v) / math.sqrt(2.0)
    half_v = 0.5 * (up - down.volts)
    unit_v = channel.sign * ACCELEROMETER_UNITS_V_PER_MPS2[channel.unit] * g.value
    sensitivity = half_v / unit_v
    believed_v = abs(unit_v) * channel.sensitivity.value
    # a sensor that feels gravity would change by 1
    if abs(half_v) < 0.5 * believed_v:
        raise ValueError(
            f"turning it over changed its reading from {up:.4g} V to {down.volts:.4g} V, a sensor of "
            f"{channel.sensitivity.value:g} {channel.unit} would change by {2.0 * believed_v:.3g} V: "
            "one that is AC-coupled or does not feel gravity needs another calibration; see its data sheet"
        )
    noise_v = 0.5 * math.hypot(up_sigma, down.uncertainty_v)
    # a person lays the sensor askew by a degree; as a rectangular distribution its half width over root 3
    tilt = (1.0 - math.cos(math.radians(1.0))) / math.sqrt(3.0)
    relative = math.hypot(noise_v / half_v, g.uncertainty / g.value, tilt)
    if channel.reads_gravity:
        offset_v, offset_sigma = 0.5 * (up + down.volts), math.hypot(noise_v, tilt * abs(half_v))
    else:
        offset_v, offset_sigma = up, up_sigma
    return Flip(sensitivity, abs(sensitivity) * relative, offset_v, offset_sigma)


def _readings(profile: Profile, backend: Backend, ask: Callable[[bool], None]) -> list[Reading]:
    """One reading an orientation; while a person turns the sensor, the device is let go."""
    if isinstance(backend, FlipsSensor):
        with running(backend):
            readings = []
            for over in ORIENTATIONS:
                backend.turn(over)
                readings.append(_rest(profile, backend))
            return readings
    readings = []
    for over in ORIENTATIONS:
        ask(over)
        with running(backend):
            readings.append(_rest(profile, backend))
    return readings


def _rest(profile: Profile, backend: Backend) -> Reading:
    """The accelerometer's mean while nothing is driven."""
    rate_hz, size = profile.sampling.rate_hz, profile.backend.block_samples
    column = backend.channels.index("accelerometer")
    scale_v, zero_v = backend.scales["accelerometer"]
    wanted, settle = round((SETTLE_S + 2.0) * rate_hz), round(SETTLE_S * rate_hz)
    codes: list[np.ndarray] = []
    while sum(map(len, codes)) < wanted:
        codes.append(backend.exchange(np.zeros(size)).codes[:, column])
    volts = np.concatenate(codes)[settle:wanted] * scale_v + zero_v
    parts = np.array([part.mean() for part in np.array_split(volts, PARTS)])
    # noise of half a code and more dithers the converter; with less, a mean is no better than a code
    step_v = scale_v / math.sqrt(12.0) if float(np.std(volts)) < 0.5 * scale_v else 0.0
    return Reading(float(parts.mean()), math.hypot(float(np.std(parts, ddof=1)) / math.sqrt(PARTS), step_v))
