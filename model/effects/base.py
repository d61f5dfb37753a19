"""What an effect is: a named cause with parameters, bounds and hooks into the ball's equation.

An effect is one file. Its module holds ``EFFECT`` and any of these hooks, compiled with numba,
where ``p`` is the row of all parameters, the local g last, and ``k`` the place of the effect's first one:

====================================== =========================================================================
``gravity(p, k)``                      constant downward acceleration of the ball besides the local g, m/s^2
``force(s, h, v, u, p, k)``            acceleration of the ball in m/s^2, positive up; `s` seconds since take-off, `h`
                                       height above the plate (m), `v` velocity relative to the plate and `u` absolute
                                       velocity (m/s)
``dry_friction(h, speed, dir, p, k)``   dry friction as an acceleration >= 0 (m/s^2) against motion in ``dir``
                                       (+1 up, -1 down) relative to the plate
``takeoff_threshold(dwell_s, p, k)``   what must be overcome at take-off besides gravity and friction, m/s^2 >= 0
``rebound(v, p, k)``                   contribution to the coefficient of restitution at impact speed ``v`` (m/s)
``plate_mode(p, k)``                   ``(omega_radps, damping_ratio, mass_ratio)`` of a plate mode struck by impacts
====================================== =========================================================================

and, as plain functions of the effect's own parameters ``p`` by name (or as the ``hook`` of a parameter that is the
value itself), what it does to the plate and the instruments:

====================================== =========================================================================
``transfer(p, omega_radps, accel_g)``  complex factor on drive -> plate at the tones ``omega_radps`` (k,), where the
                                       mean square of all that the drive asks for is that of one tone of ``accel_g``
                                       (k,)
``accelerometer_response(p,              complex factor by which the accelerometer reads too much, and late, at
omega_radps)``                         ``omega_radps`` (any shape)
``contact_delay_s(p)``                 delay of the continuity channel, both edges
``closing_delay_s(p)``                 delay of its closings beyond that of its openings
``impact_delay_s(p)``                  delay of impacts in the accelerometer beyond that of motion, where no edge shows
                                       the landing as well
``harmonics(p, multiple, others,       complex amplitudes added to multiples (k,) of the forcing, over its first tone
shares, accel_g)``                     of ``accel_g`` (k,); the further tones are multiples ``others`` (k, t), and
                                       ``shares`` as large: complex, their phases from where the first is a sine
``hum_mps2(p)``                        amplitude of the plate's motion at the mains frequency
``pickup_mps2(p)``                     what the accelerometer shows at the mains frequency without any motion
``modulation(p)``                      ``(depth, omega_radps)`` of a slow modulation of the plate's amplitude
``flight_gain(p)``                     relative change of the plate's amplitude while the ball is off it
``offset_mps2(p)``                     what the accelerometer reads at rest beyond what is declared
``time_scale(p)``                      factor of the recorder's clock
``gap_m(p)``                           height that the ball must reach before the circuit opens
``closure_s(p)``                       time for which an impact closes the circuit at least
``rebound_scatter(p)``                 standard deviation of the restitution from impact to impact
====================================== =========================================================================
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from kernels.arrays import Floats
from kernels.errors import InputError

Row = Floats
"""The row of all parameters, the local g last."""

SIGNATURES = {
    "gravity": "p, k",
    "force": "s, h, v, u, p, k",
    "dry_friction": "h, speed, direction, p, k",
    "takeoff_threshold": "dwell_s, p, k",
    "rebound": "v, p, k",
    "plate_mode": "p, k",
}
"""Arguments of the compiled hooks."""
COMPILED_HOOKS = tuple(SIGNATURES)
PLAIN_HOOKS = (
    "transfer", "accelerometer_response", "contact_delay_s", "closing_delay_s", "impact_delay_s", "harmonics",
    "hum_mps2", "pickup_mps2", "modulation", "flight_gain", "offset_mps2", "time_scale", "gap_m", "closure_s",
    "rebound_scatter",
)  # fmt: skip
PLATE_ONLY_HOOKS = frozenset({"transfer", "harmonics", "hum_mps2", "offset_mps2", "time_scale", "closure_s"})
"""Hooks that change plate data and instruments, and never a flight over the plate that was measured."""

ORDINARY_LAG: Mapping[tuple[str, str], tuple[float, float]] = {("accelerometer_lag", "delay_s"): (3e-5, 3e-5)}
"""Lag of an accelerometer of which nothing is known, mean and standard deviation: low-passes of 2 to 20 kHz."""

Stated = Literal["", "drive.g_per_volt", "drive.phase_deg", "accelerometer.sensitivity", "g_mps2"]
Hint = Literal["", "slow_line_hz", "modulation_depth", "modulation_hz", "second_harmonic"]
Term = Literal["", "force", "friction", "threshold", "restitution"]


@dataclass(frozen=True)
class Parameter:
    """One number of an effect."""

    name: str  # with its unit suffix where it has one
    unit: str  # as printed for a person ("1" where dimensionless)
    low: float  # bounds of what is physically possible
    high: float
    scale: float  # a size at which the effect would matter: the scale for steps of the fit and for detection limits
    null_value: float = 0.0  # the value at which the effect does nothing
    start_grid: tuple[float, ...] = ()  # to try before a local fit, where the effect switches modes or repeats
    # what the data suggest to start from: slow lines of the plate (added to ``start_grid``), the depth and frequency of
    # a modulation (in place of it), or the sign that the phase of the measured second harmonic has
    hint: Hint = ""
    coarse_grid: tuple[float, ...] = ()  # of a number that switches the ball's behaviour: over its whole range
    coarse_step: float = 0.0  # of such a number: first step of the search
    calibration: float = 0.0  # one sigma to which it is known without being declared (0: exactly ``null_value``)
    stated_by: Stated = ""  # quantity of the profile whose stated uncertainty replaces ``calibration``
    # standard deviation that a measurement other than the run would give, by its name ("flip test", "drop test")
    calibrated_by: Mapping[str, float] = field(default_factory=dict)
    # standard deviation by which an ordinary instrument adds to it where no recording can tell: part of its interval
    ordinary: float = 0.0
    is_shape: bool = False  # it only shapes the effect (a frequency, a length): a fit needs the others to be non-zero
    plate_only: bool = False  # it changes plate data and never a flight, in an effect that changes both
    # the fit moves in ``value ** (1 / power)``: 3 where a delay goes with the cube root of a height, 0.5 where data are
    # squares
    power: float = 1.0
    drifts: bool = False  # its trend is a candidate of its own from the first round on
    carries_term: Term = ""  # kind of smooth term whose value this number can take, another one in each flight
    # quantity of the flight that stands here, another one in each flight that was measured; never fitted. It is a name
    # of `analysis.residuals.covariates.COVARIATES`, and NaN where a flight's own is not known. Where no flight was
    # measured (free-running predictions) the null value stands here.
    covariate: str = ""
    hook: str = ""  # hook of the plate or the instruments that this number is the value of; it has no function
    meaning: str = ""  # for a person, in a few words

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f", {self.unit}"
        return f"{self.name} ({self.meaning}{unit})" if self.meaning else f"{self.name}{unit}"


@dataclass(frozen=True)
class CurveOf:
    """A smooth term within the flight that an effect can carry."""

    term: Term  # its kind
    of: str  # quantity of the flight that it depends on
    fixed: Mapping[str, float] = field(default_factory=dict)  # values of the effect's parameters that select it


@dataclass(frozen=True)
class Effect:
    """A named cause that the ideal model lacks."""

    name: str  # used in files, options and reports: that of its file
    summary: str  # one sentence for the report
    parameters: tuple[Parameter, ...]  # in the order in which hooks find them
    reference: str  # where the physics comes from
    # names of effects that look alike on some runs, each with what separates them
    confused_with: Mapping[str, str] = field(default_factory=dict)
    nuisance: bool = False  # a harmless imperfection of the instrument, always fitted and never an explanation
    variants: tuple[tuple[str, ...], ...] = ()  # which parameters are fitted together, simplest first; empty: all
    # parameters that are one number in the simplest case, by the name under which a profile may give that number: a
    # search begins with them equal, and a trend is theirs together
    tied: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    # effects that are special cases of this one: by name, which of its parameters each of theirs begins from
    special_cases: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    # parameters of instrument effects that this one can hide, with the mean and the standard deviation that they have
    # in an ordinary instrument: nuisances of the last fit, so that this effect's intervals allow for them
    hides: Mapping[tuple[str, str], tuple[float, float]] = field(default_factory=dict)
    substitutes_term: Term = ""  # kind of smooth term that takes the place of this effect
    curves: tuple[CurveOf, ...] = ()  # smooth terms within the flight that this effect can carry
    is_trend: bool = False  # it stands for a trend of other effects' parameters, and has no hooks
    library: bool = True  # False for what no search may name
    last_resort: bool = False  # named only where nothing else explains the data with as few numbers

    def parameter(self, name: str) -> Parameter:
        """The parameter called ``name``.

        Raises `InputError` when the effect has no such parameter; the message lists those it has, with their meaning.
        """
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        known = ", ".join(str(q) for q in self.parameters)
        raise InputError(f"effect {self.name} has no parameter {name!r}; it has {known}")

    @property
    def null_values(self) -> dict[str, float]:
        """The values at which the effect does nothing."""
        return {q.name: q.null_value for q in self.parameters}


@dataclass(frozen=True)
class Registered:
    """An effect, its place in the row of all parameters and the hooks its file defines."""

    effect: Effect
    offset: int
    module: str
    hooks: Mapping[str, Any]
