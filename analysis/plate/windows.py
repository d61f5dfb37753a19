"""Compiled second look at a step's block means: residual, slow motion, and the tones a few cycles at a time.

The rule kept here: one pass over the means, phasors by rotation, nothing of the length of the recording kept.
"""

from __future__ import annotations

import numpy as np

from kernels import njit

RESYNC = 512  # means between exact restarts of the rotating phasors


@njit(error_model="numpy")
def second_look(  # type: ignore[no-untyped-def]
    x, keep, first, cycles, response, amplitudes, offsets, rows, group, slow, seen, length, gram, side, power, used
):
    """Residuals of ``x`` (n, channels) against the fit ``amplitudes`` (channels, k) and ``offsets`` (channels,).

    ``slow`` and ``seen`` (n // group,) gather the first channel's kept residuals; ``gram`` (w, q, q), ``side``
    (w, q, channels), ``power`` (w, channels) and ``used`` (w,) the normal equations of constant and tones ``rows`` in
    windows of ``length``, with the residuals' squares and count.
    """
    n, channels = x.shape
    k = cycles.shape[0]
    q = 2 * rows.shape[0] + 1
    step = np.exp(2j * np.pi * cycles)
    phasor = np.empty(k, dtype=np.complex128)
    row = np.empty(q)
    row[0] = 1.0
    residual = np.empty(channels)
    for i in range(n):
        if i % RESYNC == 0:
            for j in range(k):
                phase = cycles[j] * (first + i)
                phasor[j] = np.exp(2j * np.pi * (phase - np.floor(phase))) * response[j]
        if keep[i]:
            for c in range(channels):
                fit = offsets[c]
                for j in range(k):
                    fit += amplitudes[c, j].real * phasor[j].real - amplitudes[c, j].imag * phasor[j].imag
                residual[c] = x[i, c] - fit
            g = i // group
            if g < slow.shape[0]:
                slow[g] += residual[0]
                seen[g] += 1
            w = i // length
            if w < gram.shape[0]:
                used[w] += 1
                for r in range(rows.shape[0]):
                    row[2 * r + 1] = phasor[rows[r]].real
                    row[2 * r + 2] = -phasor[rows[r]].imag
                for c in range(channels):
                    power[w, c] += residual[c] * residual[c]
                for a in range(q):
                    for b in range(q):
                        gram[w, a, b] += row[a] * row[b]
                    for c in range(channels):
                        side[w, a, c] += row[a] * residual[c]
        for j in range(k):
            phasor[j] *= step[j]
