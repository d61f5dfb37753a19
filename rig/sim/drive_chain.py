"""From drive volts to the plate's acceleration, sample by sample: DAC, amplifier, shaker.

The plate moves smoothly between samples. Its acceleration is the cubic through the last four
reconstruction nodes, the newest being the present sample's, so the plate follows the drive without delay.
"""

from __future__ import annotations

import math
from typing import Any

from kernels import njit
from rig.sim.forces import G_MPS2

_SIXTH = 1.0 / 6.0


@njit()
def _amplifier(s: Any, p: Any, volts: float) -> float:
    """Gain errors, bending and clipping; volts that would drive an ideal shaker."""
    t = s.t_s + s.dt_s
    # two stages of 50 ms follow the drive's mean square, as a coil's heat or a limiter would
    rate = s.dt_s * (1.0 / 0.05)
    s.mean_square_1 += (volts * volts - s.mean_square_1) * rate
    s.mean_square_v2 += (s.mean_square_1 - s.mean_square_v2) * rate
    out = volts * (1.0 + p.drive_gain_relative)
    if p.gain_compression_per_v2 != 0.0:
        out /= 1.0 + p.gain_compression_per_v2 * s.mean_square_v2
    if p.amplitude_modulation_depth != 0.0:
        out *= 1.0 + p.amplitude_modulation_depth * math.sin(2.0 * math.pi * p.amplitude_modulation_frequency_hz * t)
    out += p.harmonic_distortion_second_per_v * (volts * volts - s.mean_square_v2)
    out += p.harmonic_distortion_third_per_v2 * volts * volts * volts
    return float(min(max(out, -p.clip_v), p.clip_v))


@njit()
def _shaker(s: Any, p: Any, volts: float) -> float:
    """First-order lag, then the shaker's own resonance where it is not equalised: volts to volts."""
    if p.phase_lag_time_constant_s > 0.0:
        r = s.dt_s / p.phase_lag_time_constant_s
        decay = math.exp(-r)
        ramp = (1.0 - decay) / r  # exact for a drive that is linear between samples
        s.lagged_v = decay * s.lagged_v + (ramp - decay) * s.last_v + (1.0 - ramp) * volts
        s.last_v = volts
        volts = s.lagged_v
    if p.shaker_frequency_hz <= 0.0:
        return float(volts)
    w, damping = 2.0 * math.pi * p.shaker_frequency_hz, p.shaker_damping
    x, v, h = s.shaker_x, s.shaker_v, s.dt_s
    a = s.shaker_drive - w * w * x - 2.0 * damping * w * v
    middle = 0.5 * (s.shaker_drive + volts)
    mid_x, mid_v = x + 0.5 * h * v, v + 0.5 * h * a
    s.shaker_x, s.shaker_v = x + h * mid_v, v + h * (middle - w * w * mid_x - 2.0 * damping * w * mid_v)
    s.shaker_drive = volts
    return float(volts - w * w * s.shaker_x - 2.0 * damping * w * s.shaker_v)


@njit()
def drive_plate(s: Any, p: Any, volts: float) -> None:
    """Set the cubic of the plate's driven acceleration over the interval that ends with this sample."""
    node = G_MPS2 * p.g_per_volt * _shaker(s, p, _amplifier(s, p, volts))
    if p.mains_hum_amplitude_g != 0.0:
        t = s.t_s + s.dt_s
        angle = 2.0 * math.pi * p.mains_hum_frequency_hz * t + p.mains_hum_phase_rad
        node += G_MPS2 * p.mains_hum_amplitude_g * math.sin(angle)
    # Lagrange through u = -2, -1, 0, 1
    oldest, older, old = s.node3, s.node2, s.node1
    s.a0 = old
    s.a1 = _SIXTH * oldest - older + 0.5 * old + 2.0 * _SIXTH * node
    s.a2 = 0.5 * (older + node) - old
    s.a3 = _SIXTH * (node - oldest) + 0.5 * (older - old)
    s.node3, s.node2, s.node1 = older, old, node
    mean = s.a0 + 0.5 * s.a1 + 2.0 * _SIXTH * s.a2 + 0.25 * s.a3
    s.plate_mps = s.plate_end_mps
    # the suspension forgets the plate's mean velocity within two seconds
    s.plate_end_mps += s.dt_s * (mean - s.plate_mps * 0.5)
