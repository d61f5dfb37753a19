"""The plate's motion as a sum of tones: in SI (`Plate`) and in the kernels' dimensionless form (`Forcing`).

The drive amplitude is one number, ``gamma``, and everything else about the motion is in the tones.
Dimensionless: phase ``phi = w t``, lengths in ``g / w^2``, speeds in ``g / w``, accelerations in ``g``; the plate is at

    chi_p(phi) = gamma * sum_j b_j sin(n_j phi + p_j)

(the paper's ``gamma (sin phi + sin c phi)`` has ``n = 1, c``, ``b = 1, 1`` and ``p = 0, 0``).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from kernels.arrays import Complexes, Floats

STANDARD_GRAVITY_MPS2 = 9.80665


@dataclass(frozen=True)
class Forcing:
    """The dimensionless plate motion without its amplitude; hashable, so that tables can be cached for it.

    Raises `ValueError` if the lengths differ, a value is not finite or a harmonic is not positive.
    """

    # ``n_j``, multiples of the base frequency, positive; integers make the motion periodic in ``2 pi``
    harmonic: tuple[float, ...]
    amplitude: tuple[float, ...]  # ``b_j``, displacement amplitudes relative to ``A``
    phase_rad: tuple[float, ...]  # ``p_j``

    def __post_init__(self) -> None:
        """Check the tones, then keep one tone a frequency: equal harmonics are summed, vanished ones dropped."""
        if not len(self.harmonic) == len(self.amplitude) == len(self.phase_rad):
            raise ValueError(
                f"harmonic, amplitude and phase_rad must have equal lengths, not "
                f"{len(self.harmonic)}, {len(self.amplitude)} and {len(self.phase_rad)}"
            )
        if not all(map(math.isfinite, (*self.harmonic, *self.amplitude, *self.phase_rad))):
            raise ValueError(f"tones must be finite numbers, not {self}")
        if not all(n > 0 for n in self.harmonic):
            raise ValueError(f"harmonics must be positive, not {self.harmonic}")
        total: dict[float, complex] = {}
        size = sum(map(abs, self.amplitude))
        for n, b, p in zip(self.harmonic, self.amplitude, self.phase_rad, strict=True):
            total[float(n)] = total.get(float(n), 0j) + (cmath.rect(b, p) if p else complex(b))
        # tones that cancel to rounding are no motion
        present = {n: z for n, z in sorted(total.items()) if abs(z) > 1e-14 * size}
        object.__setattr__(self, "harmonic", tuple(present))
        object.__setattr__(self, "amplitude", tuple(abs(z) for z in present.values()))
        object.__setattr__(self, "phase_rad", tuple(cmath.phase(z) for z in present.values()))

    @classmethod
    def superposition(
        cls,
        ratio: float = 1,
        amplitude: tuple[float, float] = (1.0, 1.0),
        phase_rad: tuple[float, float] = (0.0, 0.0),
    ) -> Forcing:
        """``b1 sin(phi + p1) + b2 sin(c phi + p2)``; at ``c = 1`` the two tones are one, their complex sum."""
        return cls((1.0, float(ratio)), amplitude, phase_rad)

    @classmethod
    def of_displacements(cls, harmonic: Sequence[float], displacement: Complexes, *, from_first: bool) -> Forcing:
        """Tones of ``chi_p`` as ``Re[displacement_j exp(i n_j phi)]``; ``from_first``: the first has phase zero."""
        n = np.asarray(harmonic, dtype=np.float64)
        phase = np.angle(displacement) + 0.5 * np.pi
        if from_first:
            phase = np.mod(phase - n * phase[0] + np.pi, 2.0 * np.pi) - np.pi
        return cls(tuple(n.tolist()), tuple(np.abs(displacement).tolist()), tuple(phase.tolist()))

    @property
    def periodic(self) -> bool:
        """Whether the motion repeats after ``2 pi`` (every harmonic an integer)."""
        return all(n == round(n) for n in self.harmonic)

    @property
    def moves(self) -> bool:
        """Whether any tone is left."""
        return bool(self.harmonic)

    @cached_property
    def tones(self) -> Floats:
        """``(k, 3)`` array of ``n_j, b_j, p_j``: what the compiled kernels take."""
        return np.array([self.harmonic, self.amplitude, self.phase_rad], dtype=np.float64).T.reshape(-1, 3).copy()


@dataclass(frozen=True)
class Plate:
    """The plate's acceleration as tones, in SI: ``a_p(t) = sum_j Re[acceleration_j exp(i omega_j t)]``, positive up.

    Raises `ValueError` if the shapes differ, a value is not finite or a frequency is not positive.
    """

    omega_radps: Floats  # angular frequencies, positive
    acceleration: Complexes  # amplitudes in m/s^2

    def __post_init__(self) -> None:
        """Take arrays of any number type, check them, and make them read-only."""
        omega = np.array(self.omega_radps, dtype=np.float64, ndmin=1)
        acceleration = np.array(self.acceleration, dtype=np.complex128, ndmin=1)
        if omega.ndim != 1 or omega.shape != acceleration.shape:
            raise ValueError(f"omega_radps and acceleration must both be (k,): {omega.shape}, {acceleration.shape}")
        if not (np.all(np.isfinite(omega)) and np.all(omega > 0) and np.all(np.isfinite(acceleration))):
            raise ValueError("omega_radps must be finite and positive and acceleration finite")
        omega.flags.writeable = acceleration.flags.writeable = False
        object.__setattr__(self, "omega_radps", omega)
        object.__setattr__(self, "acceleration", acceleration)

    def acceleration_at(self, t_s: ArrayLike) -> Floats:
        """Plate acceleration at the times ``t_s`` (any shape), m/s^2."""
        return self._sum(t_s, 0)

    def velocity_at(self, t_s: ArrayLike) -> Floats:
        """Plate velocity at the times ``t_s`` (any shape), m/s, mean-free."""
        return self._sum(t_s, 1)

    def position_at(self, t_s: ArrayLike) -> Floats:
        """Plate position at the times ``t_s`` (any shape), m, mean-free."""
        return self._sum(t_s, 2)

    def _sum(self, t_s: ArrayLike, integrals: int) -> Floats:
        """The tones, integrated ``integrals`` times, summed at ``t_s``."""
        t = np.asarray(t_s, dtype=np.float64)[..., None]
        z = self.acceleration / (1j * self.omega_radps) ** integrals
        return np.asarray((z * np.exp(1j * self.omega_radps * t)).real.sum(axis=-1))


def relative_height(forcing: Forcing, gamma: float, phi0: ArrayLike, tau: ArrayLike, v0: ArrayLike = 0.0) -> Floats:
    """Height above the plate ``tau`` after a take-off at ``phi0`` with relative speed ``v0`` (the paper's eq. 4).

    For pictures and checks: plain arithmetic, any ``tau`` (negative too), arrays broadcast, units g/w^2.
    """
    start, t, v = np.broadcast_arrays(*(np.asarray(x, dtype=np.float64) for x in (phi0, tau, v0)))
    n, b, p = forcing.tones.T
    angle = n * start[..., None] + p
    x = n * t[..., None]
    moved = (b * (np.sin(angle) + x * np.cos(angle) - np.sin(angle + x))).sum(axis=-1)
    return np.asarray(gamma * moved + v * t - 0.5 * t * t)
