"""The simulated rig: drive volts in, raw codes of its channels out, block by block.

The plant sees drive samples and nothing else. It never learns gamma, frequency or c, and blocks of any size give the
same codes, because all it knows is carried in its state and its generator. DAC, amplifier and shaker make the plate's
acceleration: the cubic through the last four reconstruction nodes, the newest being the present sample's, so that the
plate moves smoothly between samples and follows the drive without delay.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kernels import njit
from kernels.arrays import Floats
from rig.sim.ball_motion import move_ball
from rig.sim.forces import G_MPS2, gravity, plate_acceleration
from rig.sim.instrument import SECTIONS, SUBSTEPS, Converter, sections, shown_acceleration
from rig.sim.scenario import RIG_DEFAULTS, Scenario
from rig.sim.state import FLIGHT, initial_state, run_circuit, small_noise

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
    if p.harmonic_distortion_third_per_v2 != 0.0:
        # tones of which two make up a third (w + 2 w = 3 w) have a mean cube, and no table a mean acceleration
        cube = volts * volts * volts
        s.mean_cube_1 += (cube - s.mean_cube_1) * rate
        s.mean_cube_2 += (s.mean_cube_1 - s.mean_cube_2) * rate
        s.mean_cube_v3 += (s.mean_cube_2 - s.mean_cube_v3) * rate
        out += p.harmonic_distortion_third_per_v2 * (cube - s.mean_cube_v3)
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


CHANNELS = ("continuity", "accelerometer", "drive", "displacement")
"""Channels in the order of a frame; those beyond the first three are recorded where they are asked for."""

NOISE_BLOCK = 65536
"""Samples of noise drawn at once; bounds memory, does not change the result."""


REFRESH_SAMPLES = 64
"""Drifting parameters are brought up to date this often, counted from the start of the run; a power of two."""


@njit()
def _convert(volts: Any, scale_v: float, limit: float, codes: Any) -> None:
    """Codes of the volts, (n, channels) each."""
    for i in range(len(volts)):
        for k in range(volts.shape[1]):
            codes[i, k] = int(min(max(math.floor(volts[i, k] / scale_v + 0.5), -limit), limit - 1.0))


@njit()
def _refresh(s: Any, p: Any, values: Any, drift: Any, dt_s: float) -> None:
    """Let drifting parameters follow the time, then derive what the loop needs from the parameters."""
    for k in range(drift.size):
        values[drift[k].place] = min(max(drift[k].base + drift[k].rate_per_s * s.t_s, drift[k].low), drift[k].high)
    s.dt_s = dt_s * (1.0 + p.clock_error_relative)
    decay = math.exp(-s.dt_s / p.ring_decay_s)
    angle = 2.0 * math.pi * p.ring_frequency_hz * s.dt_s
    s.turn_re, s.turn_im = decay * math.cos(angle), decay * math.sin(angle)
    s.volts_per_mps2 = p.accelerometer_v_per_g * (1.0 + p.accelerometer_gain_relative) / G_MPS2
    s.zero_v = p.accelerometer_v_per_g * p.accelerometer_offset_offset_g
    tau_s = p.accelerometer_lag_time_constant_s
    s.shown_part = math.exp(-s.dt_s / tau_s) if tau_s > 0.0 else 0.0
    s.blocked_part = 1.0 - math.exp(-2.0 * math.pi * p.accelerometer_high_pass_corner_hz * s.dt_s)


@njit()
def _shown(s: Any, p: Any, volts: float) -> float:
    """Volts behind the accelerometer's low-pass of first order, for an input straight between samples, and behind its
    amplifier's high-pass, which leaves the zero at rest where it is; and pickup."""
    rise = volts - s.unfiltered_v if s.sample > 0 else 0.0
    lag = rise * p.accelerometer_lag_time_constant_s / s.dt_s
    before = s.shown_v - s.unfiltered_v if s.sample > 0 else 0.0
    s.unfiltered_v = volts
    shown: float = volts - lag + (before + lag) * s.shown_part
    s.shown_v = shown
    resting = s.volts_per_mps2 * (p.accelerometer_reads_gravity - 2 * s.turned) * gravity(p)
    s.blocked_v += s.blocked_part * (shown - resting - s.blocked_v)
    shown -= s.blocked_v
    if p.mains_pickup_amplitude_g == 0.0:
        return shown
    angle = 2.0 * math.pi * p.mains_pickup_frequency_hz * (s.t_s + s.dt_s) + p.mains_pickup_phase_rad
    picked_up: float = p.accelerometer_v_per_g * p.mains_pickup_amplitude_g * math.sin(angle)
    return shown + picked_up


@njit()
def _run(
    state: Any, params: Any, drift: Any, taps: Any, memory: Any, drive_v: Any, noise: Any, dt_s: float, volts: Any
) -> None:
    """March the rig over the samples of one block, one interval ending at each sample."""
    s, p, values = state[0], params[0], params.view(np.float64)
    noise_v = p.accelerometer_v_per_g * p.accelerometer_noise_g if p.low_pass_hz == 0.0 else 0.0
    for i in range(drive_v.size):
        if s.sample & (REFRESH_SAMPLES - 1) == 0:
            _refresh(s, p, values, drift, dt_s)
        drive_plate(s, p, drive_v[i])
        re, im = s.ring_re, s.ring_im
        s.ring_re, s.ring_im = s.turn_re * re - s.turn_im * im, s.turn_re * im + s.turn_im * re
        s.n_hits = 0
        move_ball(s, p)
        circuit_v = run_circuit(s, p)
        a = plate_acceleration(s, p, 1.0, s.mode_m, s.mode_mps, s.state != FLIGHT)[0]
        weight = (p.accelerometer_reads_gravity - 2 * s.turned) * gravity(p)
        if p.has_front != 0.0:
            rest = a - (s.a0 + s.a1 + s.a2 + s.a3) + weight
            a = shown_acceleration(s, p, taps, memory, noise[i], re, im, rest)
        else:
            a += weight + G_MPS2 * p.ring_g_s_per_m * s.ring_im
        counter = s.noise_key + np.uint64(2 * s.sample)
        volts[i, 0] = circuit_v + p.continuity_noise_v * small_noise(counter)
        volts[i, 1] = s.zero_v + _shown(s, p, s.volts_per_mps2 * a) + noise_v * noise[i, 0]
        volts[i, 2] = drive_v[i] + p.drive_noise_v * small_noise(counter + np.uint64(1))
        # a key of its own: no other channel's noise depends on it
        volts[i, 3] = p.displacement_v_per_m * s.height_m + p.displacement_noise_v * small_noise(~counter)
        s.t_s += s.dt_s
        s.sample += 1


class Plant:
    """A simulated rig with one hidden scenario.

    ``rng`` gives the sensors' noise and random contact bounce. Of `CHANNELS` the first three are recorded, and those
    named in ``further``; ``channels`` are the columns that `exchange` returns, ``channel_scales`` volts per code of
    each. ``scenario_sha256`` is all that a recording may know of the scenario.
    """

    def __init__(
        self, scenario: Scenario, rate_hz: float, rng: np.random.Generator, *, further: Collection[str] = ()
    ) -> None:
        self.channels = CHANNELS[:3] + tuple(name for name in CHANNELS[3:] if name in further)
        self.rate_hz = float(rate_hz)
        self.scenario_sha256 = scenario.sha256
        self._params, self._drift = scenario.parameters()
        self._rng = rng.spawn(1)[0]
        keys = self._rng.integers(2**63, size=2)
        rig = {key: float(self._params[key][0]) for key in RIG_DEFAULTS}
        self._sections, self._memory = sections(rig, self.rate_hz), np.zeros((SECTIONS, 2))
        # the grid that hums in the plate or the cable hums in the instrument, too
        hums_hz = [float(self._params[f"mains_{what}_frequency_hz"][0]) for what in ("pickup", "hum")]
        grid_hz = next((hz for hz in hums_hz if hz != 50.0), 50.0)
        self._converter = Converter(rig, self.rate_hz, self._rng.spawn(1)[0], grid_hz)
        self._noises = SUBSTEPS if rig["low_pass_hz"] else 1
        self._limit = 2.0 ** (rig["adc_bits"] - 1.0)
        self._scale_v = rig["adc_range_v"] / self._limit
        self.channel_scales = dict.fromkeys(self.channels, self._scale_v)
        self._state = initial_state(int(keys[0]), int(keys[1]), -1.0 / self.rate_hz)

    def turn(self, over: bool) -> None:
        """Lay the accelerometer upside down, or back as it was mounted; for a plate at rest."""
        self._state["turned"] = over

    def exchange(self, drive_v: Floats) -> NDArray[np.int16]:
        """Codes (n, k) of `channels` while it is driven; raises `ValueError` for a drive of no finite samples (n,)."""
        drive = np.ascontiguousarray(drive_v, dtype=np.float64)
        if drive.ndim != 1 or not np.isfinite(drive).all():
            raise ValueError(f"drive: wanted a 1-D array of finite volts, got shape {drive.shape}; check the sequencer")
        codes = np.empty((drive.size, len(CHANNELS)), np.int16)
        for start in range(0, drive.size, NOISE_BLOCK):
            stop = min(start + NOISE_BLOCK, drive.size)
            noise = self._rng.standard_normal((stop - start, self._noises), dtype=np.float32)
            volts, first = np.empty((stop - start, len(CHANNELS))), int(self._state["sample"][0])
            march = (self._state, self._params, self._drift, self._sections, self._memory)
            _run(*march, drive[start:stop], noise, 1.0 / self.rate_hz, volts)
            if self._converter.changes:
                self._converter.apply(volts, first)
            _convert(volts, self._scale_v, self._limit, codes[start:stop])
        return np.ascontiguousarray(codes[:, [CHANNELS.index(name) for name in self.channels]])
