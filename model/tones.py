"""The plate's motion as a sum of tones: in SI (`Plate`) and in the kernels' dimensionless form (`Forcing`).

The rule kept here: the drive amplitude is one number, ``gamma``, and everything else about the motion is in the tones.
Dimensionless: phase ``phi = w t``, lengths in ``g / w^2``, speeds in ``g / w``, accelerations in ``g``; the plate is at

    chi_p(phi) = gamma * sum_j b_j sin(n_j phi + p_j)

(the paper's ``gamma (sin phi + sin c phi)`` has ``n = 1, c``, ``b = 1, 1`` and ``p = 0, 0``).
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

STANDARD_GRAVITY_MPS2 = 9.80665
TONES_AT_REST = 1e-14  # tones that cancel to less than this part of their sum are no motion


@dataclass(frozen=True)
class Forcing:
    """The dimensionless plate motion without its amplitude; hashable, so that tables can be kept for it.

    Parameters
    ----------
    harmonic : tuple of float
        ``n_j``, multiples of the base frequency, positive; integers make the motion periodic in ``2 pi``.
    amplitude : tuple of float
        ``b_j``, displacement amplitudes relative to ``A``.
    phase_rad : tuple of float
        ``p_j``.

    Raises
    ------
    ValueError
        If the lengths differ, a value is not finite or a harmonic is not positive.
    """

    harmonic: tuple[float, ...]
    amplitude: tuple[float, ...]
    phase_rad: tuple[float, ...]

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
        kept = {n: z for n, z in sorted(total.items()) if abs(z) > TONES_AT_REST * size}
        object.__setattr__(self, "harmonic", tuple(kept))
        object.__setattr__(self, "amplitude", tuple(abs(z) for z in kept.values()))
        object.__setattr__(self, "phase_rad", tuple(cmath.phase(z) for z in kept.values()))

    @classmethod
    def superposition(
        cls,
        ratio: float = 1,
        amplitude: tuple[float, float] = (1.0, 1.0),
        phase_rad: tuple[float, float] = (0.0, 0.0),
    ) -> Forcing:
        """``b1 sin(phi + p1) + b2 sin(c phi + p2)``; at ``c = 1`` the two tones are one, their complex sum."""
        return cls((1.0, float(ratio)), amplitude, phase_rad)

    @property
    def periodic(self) -> bool:
        """Whether the motion repeats after ``2 pi`` (every harmonic an integer)."""
        return all(n == round(n) for n in self.harmonic)

    @property
    def moves(self) -> bool:
        """Whether any tone is left."""
        return bool(self.harmonic)

    @cached_property
    def tones(self) -> NDArray[np.float64]:
        """``(k, 3)`` array of ``n_j, b_j, p_j``: what the compiled kernels take."""
        return np.array([self.harmonic, self.amplitude, self.phase_rad], dtype=np.float64).T.reshape(-1, 3).copy()


@dataclass(frozen=True)
class Plate:
    """The plate's acceleration as tones, in SI: ``a_p(t) = sum_j Re[acceleration_j exp(i omega_j t)]``, positive up.

    Parameters
    ----------
    omega_radps : array_like of float, shape (k,)
        Angular frequencies, positive.
    acceleration : array_like of complex, shape (k,)
        Amplitudes in m/s^2.

    Raises
    ------
    ValueError
        If the shapes differ, a value is not finite or a frequency is not positive.
    """

    omega_radps: NDArray[np.float64]
    acceleration: NDArray[np.complex128]

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

    @classmethod
    def from_gamma(
        cls,
        gamma: float,
        ratio: float,
        omega_radps: float,
        g_mps2: float = STANDARD_GRAVITY_MPS2,
        amplitude: tuple[float, float] = (1.0, 1.0),
        phase_rad: tuple[float, float] = (0.0, 0.0),
    ) -> Plate:
        """The paper's superposition ``A [b1 sin(wt + p1) + b2 sin(cwt + p2)]`` with ``A = gamma g / w^2``.

        Parameters
        ----------
        gamma : float
            ``A w^2 / g`` (not ``gamma_peak``).
        ratio : float
            ``c``; at 1 the two tones are summed into one.
        omega_radps : float
            ``w``, rad/s.
        g_mps2 : float
            Local gravity.
        amplitude, phase_rad : tuple of float
            ``b1, b2`` relative to ``A``, and ``p1, p2``.
        """
        forcing = Forcing.superposition(ratio, amplitude, phase_rad)
        n, b, p = (np.array(x) for x in (forcing.harmonic, forcing.amplitude, forcing.phase_rad))
        # x = A b sin(n w t + p) = Re[-i A b e^{ip} e^{i n w t}], and a = -(n w)^2 x
        return cls(n * omega_radps, 1j * gamma * g_mps2 * n**2 * b * np.exp(1j * p))

    def acceleration_at(self, t_s: ArrayLike) -> NDArray[np.float64]:
        """Plate acceleration at the times ``t_s`` (any shape), m/s^2."""
        return self._sum(t_s, 0)

    def velocity_at(self, t_s: ArrayLike) -> NDArray[np.float64]:
        """Plate velocity at the times ``t_s`` (any shape), m/s, mean-free."""
        return self._sum(t_s, 1)

    def position_at(self, t_s: ArrayLike) -> NDArray[np.float64]:
        """Plate position at the times ``t_s`` (any shape), m, mean-free."""
        return self._sum(t_s, 2)

    def _sum(self, t_s: ArrayLike, integrals: int) -> NDArray[np.float64]:
        """The tones, integrated ``integrals`` times, summed at ``t_s``."""
        t = np.asarray(t_s, dtype=np.float64)[..., None]
        z = self.acceleration / (1j * self.omega_radps) ** integrals
        return np.asarray((z * np.exp(1j * self.omega_radps * t)).real.sum(axis=-1))

    def dimensionless(self, omega_radps: float, g_mps2: float = STANDARD_GRAVITY_MPS2) -> tuple[Forcing, float]:
        """The same motion as ``(forcing, gamma)`` about the base frequency ``omega_radps``.

        ``gamma`` is the first tone's ``A w^2 / g`` (so that tone has ``b = 1``); a still plate has gamma 0.
        """
        n = self.omega_radps / omega_radps
        near = np.round(n)
        n = np.where(np.abs(n - near) < 1e-12 * near, near, n)  # w and 2 w divided in doubles are still 1 and 2
        z = -1j * self.acceleration / (g_mps2 * n**2)  # b e^{ip} gamma, see from_gamma
        moving = np.flatnonzero(np.abs(z) > 0)
        gamma = float(np.abs(z[moving[0]])) if moving.size else 0.0
        scale = gamma or 1.0
        return Forcing(tuple(n.tolist()), tuple((np.abs(z) / scale).tolist()), tuple(np.angle(z).tolist())), gamma
