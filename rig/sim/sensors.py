"""The contact circuit and the accelerometer's ringing: sensor signals of take-offs and impacts.

Edges carry their exact times. They wait in a queue (latency, held-over closure and bounce shift
them), and the voltage follows them by its RC, so a sample near an edge tells where within the sample it fell.
"""

from __future__ import annotations

import math
from typing import Any

from kernels import njit
from rig.sim.state import BOUNCE_CLOSE, BOUNCE_OPEN, CLOSE, EDGE_CAPACITY, HIT_CAPACITY, OPEN, uniform


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
