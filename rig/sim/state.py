"""The compiled plant's state, carried from one sample to the next, and its sensors: contact circuit and ringing.

A block boundary is invisible, so whatever a later sample needs is a field of the record. So are the counters of the
random numbers, SplitMix64 words from keys drawn off the passed generator: a number depends on its key and counter only.

Edges of the contact circuit carry their exact times. They wait in a queue (latency, held-over closure and bounce shift
them), and the voltage follows them by its RC, so a sample near an edge tells where within the sample it fell.
"""

from __future__ import annotations

import math
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
    "t_s", "dt_s", "u",  # time at the start of the interval, its length, place within it (0..1)
    "height_m", "speed_mps",  # ball relative to the plate
    "mode_m", "mode_mps",  # slow mode of the table
    "a0", "a1", "a2", "a3",  # driven plate acceleration in the interval: cubic in u
    "node1", "node2", "node3",  # the last reconstruction nodes
    "plate_mps", "plate_end_mps",  # driven plate velocity, leaky, at both ends of the interval
    "mean_square_1", "mean_square_v2", "mean_cube_1", "mean_cube_2", "mean_cube_v3", "lagged_v", "last_v",
    "shaker_x", "shaker_v", "shaker_drive",  # drive chain
    "landed_s", "left_s", "flight_s", "hold_until_s", "contact_since_s", "closed_s",
    "rocking", "ring_re", "ring_im",
    "turn_re", "turn_im", "volts_per_mps2", "zero_v", "shown_part", "blocked_part",  # derived from the parameters
    "shown_v", "unfiltered_v",  # of the accelerometer, behind and before its filter
    "blocked_v",  # what a high-pass in its amplifier takes away
    "felt_rest", "filtered",  # of its analogue part: its input but for drive and ringing, and its output
    "film_v",  # on the contact that was closed last
    "continuity_v",
)  # fmt: skip
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


@njit()
def _insert(s: Any, t: float, kind: int) -> None:
    """Put an edge in its place; a full queue drops bounces rather than true edges."""
    n = s.n_edges
    if n == EDGE_CAPACITY:
        return
    i = n
    while i > 0 and s.edge_s[i - 1] > t:
        s.edge_s[i], s.edge_kind[i] = s.edge_s[i - 1], s.edge_kind[i - 1]
        i -= 1
    s.edge_s[i], s.edge_kind[i] = t, kind
    s.n_edges = n + 1


@njit()
def push_edge(s: Any, p: Any, t: float, kind: int) -> None:
    """Queue the opening or closing that happens mechanically at ``t``."""
    late = t + p.contact_latency_delay_s
    if kind == OPEN:
        late = max(late, s.closed_s + p.contact_closure_duration_s + p.contact_latency_delay_s)
    else:
        left = 0
        for i in range(s.n_edges):  # openings that have not come yet are overtaken by the closing
            if s.edge_kind[i] == OPEN and s.edge_s[i] > late:
                continue
            s.edge_s[left], s.edge_kind[left] = s.edge_s[i], s.edge_kind[i]
            left += 1
        s.n_edges = left
        s.closed_s = t
    _insert(s, late, kind)


@njit()
def landing_edges(s: Any, p: Any, t: float) -> None:
    """Close the circuit at an impact, with contact bounce where the rig has it."""
    if s.commanded_open == 0:
        s.closed_s = t if p.contact_closure_duration_s > 0.0 else s.closed_s
        return
    s.commanded_open = 0
    push_edge(s, p, t, CLOSE)
    if p.bounce_s <= 0.0:
        return
    late = t + p.contact_latency_delay_s
    at = late + 0.2 * p.bounce_s * uniform(s)
    for _ in range(1 + int(3.0 * uniform(s))):
        gone = 0.15 * p.bounce_s * uniform(s)
        _insert(s, at, BOUNCE_OPEN)
        _insert(s, at + gone, BOUNCE_CLOSE)
        at += gone + 0.15 * p.bounce_s * uniform(s)


@njit()
def _relax(s: Any, p: Any, dt_s: float) -> None:
    """Let the voltage run towards the level of the circuit's present state."""
    closed = s.closed == 1 and s.bouncing == 0
    level = p.closed_v + s.film_v if closed else p.open_v
    off = s.continuity_v - level
    if abs(off) < 1e-9:
        s.continuity_v = level
    else:
        s.continuity_v = level + off * math.exp(-dt_s / (p.rc_close_s if closed else p.rc_open_s))
    if p.hysteresis_v > 0.0:
        threshold = 0.5 * (p.open_v + p.closed_v) + (0.5 - s.says_open) * p.hysteresis_v
        s.says_open = 1 if s.continuity_v > threshold else 0


@njit()
def run_circuit(s: Any, p: Any) -> float:
    """Carry the contact circuit to the end of the interval through the edges that fall into it; volts to convert.

    The drive is taken at the end; a multiplexed card has taken the contact two channels before.
    """
    now, end = s.t_s, s.t_s + s.dt_s
    if p.between_channels_s > 0.0:
        look = max(end - 2.0 * p.between_channels_s, now)
        now = _run_until(s, p, now, look)
        volts = _volts(s, p)
        _run_until(s, p, now, end)
        return volts
    _run_until(s, p, now, end)
    return _volts(s, p)


@njit()
def _volts(s: Any, p: Any) -> float:
    if p.hysteresis_v > 0.0:
        return float(p.open_v if s.says_open == 1 else p.closed_v)
    return float(s.continuity_v)


@njit()
def _run_until(s: Any, p: Any, now: float, end: float) -> float:
    done = 0
    while done < s.n_edges and s.edge_s[done] <= end:
        at, kind = max(s.edge_s[done], now), s.edge_kind[done]
        _relax(s, p, at - now)
        now = at
        if kind in (OPEN, CLOSE):
            s.closed = 1 if kind == CLOSE else 0
            s.bouncing = 0
            if kind == CLOSE and p.film_v > 0.0:
                s.film_v = p.film_v * (0.5 + uniform(s))
        else:
            s.bouncing = 1 if kind == BOUNCE_OPEN else 0
        done += 1
    if done > 0:
        for i in range(done, s.n_edges):
            s.edge_s[i - done], s.edge_kind[i - done] = s.edge_s[i], s.edge_kind[i]
        s.n_edges -= done
    _relax(s, p, end - now)
    return end


@njit()
def ring_now(s: Any, p: Any, speed_mps: float) -> None:
    """Start the table's ringing at the present place; the stored phasor is that of the interval's end."""
    if s.n_hits < HIT_CAPACITY:
        s.hit_u[s.n_hits], s.hit_mps[s.n_hits] = s.u, speed_mps
        s.n_hits += 1
    left = (1.0 - s.u) * s.dt_s
    size = -speed_mps * math.exp(-left / p.ring_decay_s)
    angle = 2.0 * math.pi * p.ring_frequency_hz * left
    s.ring_re += size * math.cos(angle)
    s.ring_im += size * math.sin(angle)
