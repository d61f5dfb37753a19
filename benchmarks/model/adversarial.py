"""Flights chosen to break a landing solver: tiny, at a threshold, just inside a window, grazing, bounced, long."""

import numpy as np

from benchmarks.model.first_landing import first_landing, take_off_phases
from model.tones import Forcing

KINDS = ("threshold", "tiny", "take-off", "graze", "bounce", "long", "tones")


def forcing_of(kind, rng):
    """A forcing for the kind: mostly the paper's, c up to 7; for ``tones`` any three harmonics and phases."""
    if kind == "tones":
        harmonics = tuple(rng.choice(np.arange(1, 8), 3, replace=False).astype(float))
        return Forcing(harmonics, tuple(rng.uniform(0.1, 1, 3)), tuple(rng.uniform(0, 2 * np.pi, 3)))
    phases = (0.0, float(rng.choice([0.0, rng.uniform(0, 6)])))
    return Forcing.superposition(int(rng.integers(1, 8)), (1.0, 1.0), phases)


def threshold_gamma(forcing):
    """The amplitude at which the plate first lifts the ball, to grid accuracy refined by the windows themselves."""
    phi = np.linspace(0, 2 * np.pi, 4001)
    n, b, p = forcing.tones.T
    guess = 1.0 / (b * n * n * np.sin(n * phi[:, None] + p)).sum(axis=1).max()
    lo, hi = 0.99 * guess, 1.01 * guess
    for _ in range(60):
        middle = 0.5 * (lo + hi)
        lo, hi = (lo, middle) if take_off_phases(forcing, middle).start.size else (middle, hi)
    return hi


def flights_of(kind, rng, per_forcing=25):
    """Endless ``(forcing, gamma, phi0, v0, at_threshold)`` of one kind in `KINDS`, ``per_forcing`` of each forcing."""
    while True:
        forcing = forcing_of(kind, rng)
        lowest = threshold_gamma(forcing)
        jump = grazing_gamma(forcing, lowest * rng.uniform(1.2, 8)) if kind == "graze" else None
        for _ in range(per_forcing):
            yield _flight(kind, rng, forcing, lowest, jump)


def _flight(kind, rng, forcing, lowest, jump):
    """One flight of a kind on ``forcing``, which first lifts the ball at ``lowest``."""
    if kind == "threshold":
        gamma = lowest * (1 + 10 ** rng.uniform(-11, -2))
    elif kind == "graze":
        gamma = jump * (1 + rng.choice([-1, 1]) * 10 ** rng.uniform(-13, -4))
    elif kind == "long":
        gamma = max(rng.uniform(6, 50), 1.1 * lowest)
    else:
        gamma = lowest * 10 ** rng.uniform(0.01, 1.3)
    windows = take_off_phases(forcing, gamma)
    i = 0 if kind == "graze" else int(rng.integers(windows.start.size))
    start, stop = windows.start[i], windows.stop[i]
    if kind == "tiny":
        return forcing, gamma, stop - min(10 ** rng.uniform(-9, -1), 0.9 * (stop - start)), 0.0, False
    if kind == "take-off":
        return forcing, gamma, start + min(10 ** rng.uniform(-12, -3), 0.5 * (stop - start)), 0.0, False
    if kind == "bounce":
        return forcing, gamma, rng.uniform(0, 2 * np.pi), 10 ** rng.uniform(-6, 1), False
    if kind in ("long", "tones"):
        return forcing, gamma, rng.uniform(start, stop), 0.0, False
    return forcing, gamma, start, 0.0, True


def grazing_gamma(forcing, gamma):
    """An amplitude above ``gamma`` at which the landing after the first threshold jumps, to the last bit."""
    grid = gamma * np.linspace(1, 1.3, 40)
    tau = np.array([_first_tau(forcing, g) for g in grid])
    jump = int(np.argmax(np.abs(np.diff(tau))))
    lo, hi = grid[jump], grid[jump + 1]
    t_lo, t_hi = tau[jump], tau[jump + 1]
    for _ in range(60):
        middle = 0.5 * (lo + hi)
        t = _first_tau(forcing, middle)
        if abs(t - t_lo) < abs(t - t_hi):
            lo, t_lo = middle, t
        else:
            hi, t_hi = middle, t
    return hi


def _first_tau(forcing, gamma):
    return first_landing(forcing, gamma, take_off_phases(forcing, gamma).start[0]).tau


HEIGHT_ROUNDING = 1e-15  # relative to gamma (1 + slope tau) + tau^2: what a double's height can be wrong by


def allowed(gamma, forcing, tau, speed):
    """How far a right landing in double precision may be off: the height's rounding over the impact speed."""
    size = gamma * float(np.sum(forcing.tones[:, 1] * (1 + forcing.tones[:, 0] * tau))) + tau**2
    return 1e-11 * max(tau, 1e-3) + 4 * HEIGHT_ROUNDING * size / max(speed, 1e-300)
