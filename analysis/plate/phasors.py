"""Closed-form sums of complex exponentials: frequency shifts, amplitude modulation, means over intervals.

A tone is a pair of complex exponentials ``exp(i w t)`` and ``exp(-i w t)``.
"""

from __future__ import annotations

import numpy as np

from kernels.arrays import Complexes, Floats


def signed_frequencies(omega: Floats) -> Floats:
    """Angular frequencies of a constant and of tones (n, k) with both signs, (n, 2 k + 1)."""
    return np.column_stack([np.zeros(len(omega)), omega, -omega])


def modulated_projection(up: Complexes, down: Complexes, phase: Floats) -> Complexes:
    """Projections of tones times ``sin(w t + phase)``, from those shifted up and down by w, (n, a, b)."""
    rotation = np.exp(1j * phase)[:, None, None]
    return np.asarray((rotation * up - np.conj(rotation) * down) / 2j)


def shifted_down(up: Complexes) -> Complexes:
    """Projections (n, 2 a, 2 b) of both signs of tones, shifted down by as much as they are shifted ``up``.

    Every frequency changes its sign: the signs change places, and projections are conjugate.
    """
    return np.conj(np.roll(up, (up.shape[1] // 2, up.shape[2] // 2), axis=(1, 2)))


def two_sided(z: Complexes) -> Complexes:
    """Amplitudes of real tones (n, 2) at both signs of their frequencies, (n, 4)."""
    return np.asarray(np.concatenate([z, np.conj(z)], axis=1) / 2.0)


def mean_phasor(span_s: Floats, w: Floats) -> Complexes:
    """Mean of ``exp(i w t)`` over intervals (n, 2) at each of ``w`` (f,), (f, n)."""
    middle, half = span_s.mean(axis=1), 0.5 * np.diff(span_s, axis=1)[:, 0]
    return np.asarray(np.exp(1j * w[:, None] * middle) * np.sinc(w[:, None] * half / np.pi))
