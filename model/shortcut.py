"""Ideal orbits with the exact cycle shortcut: a threshold that repeats closes the orbit, and the rest is copied.

The rule kept here: only what is exactly equal is copied. A ball that rested leaves from one of at most c thresholds,
whose phases and flights are the same to the last bit each time; so of the 1.8 million flights of three whole diagrams
a tenth or less has to be flown. An orbit that never rests is flown to its end.
"""

from __future__ import annotations

import numpy as np

from model.branches import TWO_PI, fill_edges, fold
from model.compiled import Flags, Floats, compiled
from model.ideal_kernel import RESET, RESTS, land, next_take_off


@compiled
def shortcut_diagram(
    tones: Floats,
    turning: Floats,
    gammas: Floats,
    phi_rest: float,
    n_transient: int,
    taus: Floats,
    phases: Floats,
    flags: Flags,
) -> int:
    """As `model.lockstep.lockstep_diagram`, flying only until the orbit closes; returns the number of flights flown."""
    total = n_transient + taus.shape[1]
    edge = np.empty(turning.shape[0] + 2)
    tau = np.empty(total)
    phase = np.empty(total)
    flag = np.empty(total, dtype=np.int8)
    seen = np.empty(turning.shape[0] + 2, dtype=np.int64)  # the last flight from each threshold
    flown = 0
    for row in range(gammas.shape[0]):
        gamma = gammas[row]
        n_windows = fill_edges(tones, turning, gamma, edge)
        if n_windows == 0:
            taus[row] = 0.0
            phases[row] = fold(phi_rest, 0.0)
            flags[row] = RESTS
            continue
        landing = fold(phi_rest, edge[0])
        seen[:] = -1
        period = 0
        for k in range(total):
            if period == 0:
                phi0, a0, window, reset = next_take_off(tones, gamma, edge, n_windows, landing)
                if reset and seen[window] >= 0:
                    period = k - seen[window]
                elif reset:
                    seen[window] = k
            if period == 0:
                tau[k], landing, _, undecided = land(tones, gamma, edge, n_windows, phi0, a0, 0.0)
                phase[k] = phi0 - TWO_PI if phi0 >= TWO_PI else phi0
                flag[k] = undecided | (RESET if reset else 0)
                flown += 1
            else:
                tau[k], phase[k], flag[k] = tau[k - period], phase[k - period], flag[k - period]
        taus[row] = tau[n_transient:]
        phases[row] = phase[n_transient:]
        flags[row] = flag[n_transient:]
    return flown
