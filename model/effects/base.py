"""What an effect is: a named cause with parameters, bounds and hooks into the ball's equation.

The rule kept here: an effect is one file. Its module holds ``EFFECT`` and any of these hooks, compiled with numba,
where ``p`` is the row of all parameters, the local g last, and ``k`` the place of the effect's first one:

====================================== =========================================================================
``force(s, h, v, u, p, k)``            acceleration of the ball in m/s^2, positive up; `s` seconds since take-off, `h`
                                       height above the plate (m), `v` velocity relative to the plate and `u` absolute
                                       velocity (m/s)
``dry_friction(h, speed, dir, p, k)``   dry friction as an acceleration >= 0 (m/s^2) against motion in ``dir``
                                       (+1 up, -1 down) relative to the plate
``takeoff_threshold(dwell_s, p, k)``   what must be overcome at take-off besides gravity and friction, m/s^2 >= 0
``rebound(v, p, k)``                   contribution to the coefficient of restitution at impact speed ``v`` (m/s)
``plate_mode(p, k)``                   ``(omega_radps, damping_ratio, mass_ratio)`` of a plate mode struck by impacts
====================================== =========================================================================

and, as plain functions of the effect's own parameters ``p`` by name, what it does to the plate and the instruments:

====================================== =========================================================================
``transfer(p, omega_radps, accel_g)``  complex factor on drive -> plate at the tones ``omega_radps`` (k,), where the
                                       drive asks for first tones of ``accel_g`` (k,)
``accelerometer_factor(p)``            factor by which the accelerometer reads too much
``contact_delay_s(p)``                 delay of the continuity channel, both edges
``harmonics(p, multiple, ratio, share, complex amplitudes added to multiples (k,) of the forcing, over its first tone
accel_g)``                             of ``accel_g`` (k,); the second is the ``ratio``-th (k,), ``share`` (k,)
                                       as large: complex, its phase counted from where the first is a sine
``hum_mps2(p)``                        amplitude of the plate's motion at the mains frequency
``modulation(p)``                      ``(depth, omega_radps)`` of a slow modulation of the plate's amplitude
``flight_gain(p)``                     relative change of the plate's amplitude while the ball is off it
``offset_mps2(p)``                     what the accelerometer reads at rest beyond what is declared
``time_scale(p)``                      factor of the recorder's clock
``gap_m(p)``                           height that the ball must reach before the circuit opens
``closure_s(p)``                       time for which an impact closes the circuit at least
====================================== =========================================================================
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Row = NDArray[np.float64]
"""The row of all parameters, the local g last."""

COMPILED_HOOKS = ("force", "dry_friction", "takeoff_threshold", "rebound", "plate_mode")
PLAIN_HOOKS = (
    "transfer",
    "accelerometer_factor",
    "contact_delay_s",
    "harmonics",
    "hum_mps2",
    "modulation",
    "flight_gain",
    "offset_mps2",
    "time_scale",
    "gap_m",
    "closure_s",
)

Channel = Literal["plate", "takeoff", "landing", "bounce"]


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Parameters
    ----------
    name, unit
        Name with its unit suffix where it has one; ``unit`` as printed for a person ("1" where dimensionless).
    low, high
        Bounds of what is physically possible.
    typical
        A size at which the effect would matter: the scale for steps of the fit and for detection limits.
    absent
        The value at which the effect does nothing.
    scan
        Values to try before a local fit, where the effect switches modes or repeats.
    alarm
        For a nuisance: beyond this value it is no longer a harmless imperfection.
    calibration
        One standard deviation to which the number is known without being declared (0: exactly absent).
    power
        The fit moves in ``value ** (1 / power)``: 3 where a delay goes with the cube root of a height, 0.5 where
        data are squares.
    shape
        True for a number that only shapes the effect (a frequency, a length): a fit needs the others to be non-zero.
    """

    name: str
    unit: str
    low: float
    high: float
    typical: float
    absent: float = 0.0
    scan: tuple[float, ...] = ()
    calibration: float = 0.0
    shape: bool = False
    power: float = 1.0
    meaning: str = ""


@dataclass(frozen=True)
class Effect:
    """A named cause that the ideal model lacks.

    Parameters
    ----------
    name
        The name used in files, options and reports.
    summary
        One sentence for the report.
    parameters
        In the order in which hooks find them.
    seen_in
        The residual channels in which it leaves its mark.
    confused_with
        Names of effects that look alike on some runs, each with what separates them.
    nuisance
        A harmless imperfection of the instrument, always fitted and never reported as an explanation.
    variants
        Which parameters are fitted together, simplest first; all of them when empty.
    reference
        Where the physics comes from.
    """

    name: str
    summary: str
    parameters: tuple[Parameter, ...]
    seen_in: tuple[Channel, ...]
    reference: str
    confused_with: Mapping[str, str] = field(default_factory=dict)
    nuisance: bool = False
    variants: tuple[tuple[str, ...], ...] = ()
    library: bool = True

    def parameter(self, name: str) -> Parameter:
        """The parameter called ``name``.

        Raises
        ------
        ValueError
            When the effect has no such parameter; the message lists those it has.
        """
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        known = ", ".join(q.name for q in self.parameters)
        raise ValueError(f"effect {self.name} has no parameter {name!r}; it has {known}")

    @property
    def absent(self) -> dict[str, float]:
        """The values at which the effect does nothing."""
        return {q.name: q.absent for q in self.parameters}


@dataclass(frozen=True)
class Registered:
    """An effect, its place in the row of all parameters and the hooks its file defines."""

    effect: Effect
    offset: int
    module: str
    hooks: Mapping[str, Any]
