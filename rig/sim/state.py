"""Layout of the compiled plant's state: everything carried from one sample to the next.

A block boundary is invisible, so whatever a later sample needs is a field of this record. So are the counters of the
random numbers, SplitMix64 words from keys drawn off the passed generator: a number depends on its key and counter only.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from kernels import njit

EDGE_CAPACITY = 64
HIT_CAPACITY = 16

CONTACT, FLIGHT, HANGING = range(3)  # states of the ball
OPEN, CLOSE, BOUNCE_OPEN, BOUNCE_CLOSE = range(4)  # kinds of edge

_GOLDEN, _MIX_1, _MIX_2 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_HALF_WORD = np.uint64(0xFFFF)
_FOUR_UNIFORMS_MEAN, _FOUR_UNIFORMS_SD = 131070.0, 37837.2

_FLOATS = (
    "t_s",  # time at the start of the interval
    "dt_s",  # its length
    "u",  # place within the interval, 0..1
    "height_m",
    "speed_mps",  # ball relative to the plate
    "mode_m",
    "mode_mps",  # slow mode of the table
    "a0",
    "a1",
    "a2",
    "a3",  # driven plate acceleration in the interval: cubic in u
    "node1",
    "node2",
    "node3",  # the last reconstruction nodes
    "plate_mps",
    "plate_end_mps",  # driven plate velocity, leaky, at both ends of the interval
    "mean_square_1",
    "mean_square_v2",
    "mean_cube_1",
    "mean_cube_2",
    "mean_cube_v3",
    "lagged_v",
    "last_v",
    "shaker_x",
    "shaker_v",
    "shaker_drive",  # drive chain
    "landed_s",
    "left_s",
    "flight_s",
    "hold_until_s",
    "contact_since_s",
    "closed_s",
    "rocking",
    "ring_re",
    "ring_im",
    "turn_re",
    "turn_im",
    "volts_per_mps2",
    "zero_v",
    "shown_part",
    "blocked_part",  # derived from the parameters
    "shown_v",
    "unfiltered_v",  # of the accelerometer, behind and before its filter
    "blocked_v",  # what a high-pass in its amplifier takes away
    "felt_rest",
    "filtered",  # of the accelerometer's analogue part: its input but for drive and ringing, and its output
    "film_v",  # on the contact that was closed last
    "continuity_v",
)
_INTEGERS = (
    "state", "direction", "parity", "commanded_open", "closed", "bouncing", "n_edges", "impacts", "sample",
    "turned",  # 1 while the accelerometer lies upside down
    "says_open",  # a comparator's answer
    "n_hits",  # impacts in the interval
)  # fmt: skip

STATE_DTYPE = np.dtype(
    [(name, "f8") for name in _FLOATS]
    + [(name, "i8") for name in _INTEGERS]
    + [("noise_key", "u8"), ("event_counter", "u8")]
    + [("hit_u", "f8", (HIT_CAPACITY,)), ("hit_mps", "f8", (HIT_CAPACITY,))]
    + [("edge_s", "f8", (EDGE_CAPACITY,)), ("edge_kind", "i8", (EDGE_CAPACITY,))]
)


def initial_state(noise_key: int, event_key: int, start_s: float) -> np.ndarray:
    """One-record array: ball and plate at rest, circuit closed, one interval (``start_s`` < 0) before sample 0."""
    state = np.zeros(1, STATE_DTYPE)
    state["state"] = CONTACT
    state["noise_key"], state["event_counter"], state["t_s"] = noise_key, event_key, start_s
    state["direction"] = 1
    state["closed"] = 1
    state["left_s"] = state["landed_s"] = state["contact_since_s"] = state["closed_s"] = -1.0
    return state


@njit()
def _word(counter: Any) -> Any:
    """64 well mixed bits (Steele, Lea and Flood 2014, SplitMix64)."""
    z = counter * _GOLDEN
    z = (z ^ (z >> np.uint64(30))) * _MIX_1
    z = (z ^ (z >> np.uint64(27))) * _MIX_2
    return z ^ (z >> np.uint64(31))


@njit()
def small_noise(counter: Any) -> float:
    """Noise of unit variance, the sum of four uniforms: for channels whose noise is a few codes."""
    z = _word(counter)
    total = (z & _HALF_WORD) + ((z >> np.uint64(16)) & _HALF_WORD) + ((z >> np.uint64(32)) & _HALF_WORD)
    return (float(total + (z >> np.uint64(48))) - _FOUR_UNIFORMS_MEAN) / _FOUR_UNIFORMS_SD


@njit()
def uniform(s: Any) -> float:
    """The next number in [0, 1) of the plant's events (contact bounce, scattered rebounds)."""
    s.event_counter += np.uint64(1)
    return float(_word(s.event_counter) >> np.uint64(11)) * 2.0**-53
