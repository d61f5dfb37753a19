"""The plate moves at multiples of the forcing that the drive does not ask for.

Either each harmonic keeps its part of the first tone, or drive and plate are bent by a polynomial.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping

import numpy as np

from kernels.arrays import Complexes, Floats, Integers
from model.effects.base import Effect, Parameter

SIZES = (0.002, 0.01, 0.05)
BENDS = (-0.03, -0.003, -0.0005, 0.0005, 0.003, 0.03)  # to begin with, per g; at 0 squares have no slope
POINTS = 64  # of one period, for the polynomial's harmonics: exact up to the 63rd

EFFECT = Effect(
    name="harmonic_distortion",
    summary="the plate also moves at multiples of the forcing frequency",
    parameters=(
        Parameter(
            "second", "1", 0.0, 1.0, 0.005, start_grid=SIZES, calibration=1e-4, power=0.5,
            meaning="second harmonic over first tone",
        ),
        Parameter(
            "third", "1", 0.0, 1.0, 0.005, start_grid=SIZES, calibration=1e-4, power=0.5,
            meaning="third harmonic over first tone",
        ),
        Parameter(
            "phase_rad", "rad", -np.pi, np.pi, 0.5, start_grid=(-0.5 * np.pi, 0.0, 0.5 * np.pi, np.pi), is_shape=True,
            meaning="of the harmonic that falls on a further forcing tone, against that tone",
        ),
        Parameter(
            "quadratic_per_g", "1/g", -1.0, 1.0, 0.005, start_grid=BENDS, hint="second_harmonic",
            meaning="of acceleration squared",
        ),
        Parameter("cubic_per_g2", "1/g^2", -1.0, 1.0, 0.005, start_grid=BENDS, meaning="of acceleration cubed"),
    ),
    variants=(("second", "third"), ("quadratic_per_g", "cubic_per_g2"), ("second", "third", "phase_rad")),
    confused_with={"gain_compression": "harmonics", "phase_lag": "c = 1: at c = 2 one harmonic falls on a tone"},
    reference="non-linear suspension and amplifier, to third order",
)  # fmt: skip


@functools.lru_cache(maxsize=1024)
def _powers(others: tuple[int, ...], shares: tuple[complex, ...], multiple: int) -> tuple[complex, complex]:
    """Part of ``multiple`` in square and cube of ``sin x + sum Im(share exp(i other x))``; that of a sine is real."""
    x = 2.0 * np.pi * np.arange(POINTS) / POINTS
    wave = np.sin(x)
    for other, share in zip(others, shares, strict=True):
        wave = wave + ((share * np.exp(1j * other * x)).imag if other > 1 else 0.0)
    square, cube = (2j * np.mean(wave**n * np.exp(-1j * multiple * x)) for n in (2, 3))
    return complex(square), complex(cube)


def harmonics(
    p: Mapping[str, float],
    multiple: Integers,
    others: Integers,
    shares: Complexes,
    accel_g: Floats,
) -> Complexes:
    """What is added to each ``multiple`` of the forcing, over the first tone of ``accel_g``; shapes (k,).

    The further forcing tones are the multiples ``others`` (k, t), up to 1 for none, and ``shares`` (k, t) times as
    large as the first, their phases counted from where the first is a sine.
    """
    turn = np.ones(len(multiple), dtype=np.complex128)
    for other, share in zip(others.T, shares.T, strict=True):
        turn = np.where(multiple == other, np.exp(1j * (p["phase_rad"] + np.angle(share))), turn)
    out = turn * np.where(multiple == 2, p["second"], np.where(multiple == 3, p["third"], 0.0))
    if p["quadratic_per_g"] == 0.0 and p["cubic_per_g2"] == 0.0:
        return np.asarray(out)
    # shares rounded to 1e-3 are few: each is computed once
    parts = np.array(
        [
            _powers(tuple(map(int, c)), tuple(map(complex, np.round(s, 3))), int(m))
            for m, c, s in zip(multiple, others, shares, strict=True)
        ]
    ).reshape(-1, 2)
    return np.asarray(out + p["quadratic_per_g"] * accel_g * parts[:, 0] + p["cubic_per_g2"] * accel_g**2 * parts[:, 1])
