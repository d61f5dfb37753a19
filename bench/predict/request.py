"""The options of `bench predict` as a value, and the ball and forcing that they describe."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from daq.setup.errors import InputError
from model.flight.branches import q_and_slope
from model.flight.first_landing import turning_points
from model.orbits.attractor import Ball
from model.orbits.make_ball import make_ball
from model.tones import STANDARD_GRAVITY_MPS2, Forcing

MOST_ADAPTIVE = 20_000  # gammas from which an adaptive diagram may begin


@dataclass(frozen=True)
class DiagramOptions:
    """How a diagram is computed."""

    steps: int = 1000
    adaptive: bool = False
    grid: tuple[str, ...] = ()
    keep: int = 64
    workers: int = 1
    cluster: str | None = None


@dataclass(frozen=True)
class Files:
    """Where the answer goes."""

    json: str | None = None
    out: Path | None = None
    figure: Path | None = None
    overwrite: bool = False


@dataclass(frozen=True)
class GivenProfile:
    """A profile's path or name, and values of it that are replaced: ``KEY=NUMBER`` each."""

    name: str
    what_if: tuple[str, ...] = ()


@dataclass(frozen=True)
class Request:
    """The options of `bench predict`, as given."""

    ratio: int = 1
    gamma: float | None = None
    gamma_peak: float | None = None
    gamma_range: tuple[float, float] | None = None
    bifurcations: bool = False
    branches: bool = False
    effects: tuple[str, ...] = ()
    frequency_hz: float | None = None
    sweep: str | None = None
    phase_deg: float = 0.0
    narrowest: float | None = None
    profile: GivenProfile | None = None
    g_mps2: float = STANDARD_GRAVITY_MPS2
    diagram: DiagramOptions = DiagramOptions()
    files: Files = Files()


def parse_effects(given: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """``name.parameter=value`` options as a table by effect and parameter.

    Raises
    ------
    InputError
        For text of another form.
    """
    effects: dict[str, dict[str, float]] = {}
    for text in given:
        place, equals, value = text.partition("=")
        name, dot, parameter = place.strip().partition(".")
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not (equals and dot and name and parameter and math.isfinite(number)):
            raise InputError(f"--effect wants name.parameter=number, such as restitution.e0=0.514, not {text!r}")
        effects.setdefault(name, {})[parameter] = number
    return effects


def forcing_of(request: Request) -> Forcing:
    """The plate's motion but for its amplitude."""
    return Forcing.superposition(request.ratio, phase_rad=(0.0, math.radians(request.phase_deg)))


def ball_for(request: Request) -> Ball:
    """The ball that ``request`` is about.

    Raises
    ------
    InputError
        For options without meaning.
    """
    if request.sweep not in (None, "up", "down"):
        raise InputError(f"--sweep wants up or down, not {request.sweep!r}")
    if request.frequency_hz is not None and not (math.isfinite(request.frequency_hz) and request.frequency_hz > 0):
        raise InputError(f"--frequency-hz wants a positive number, not {request.frequency_hz!r}")
    if not math.isfinite(request.phase_deg):
        raise InputError(f"--phase-deg wants a number, not {request.phase_deg!r}")
    forcing = forcing_of(request)
    if not forcing.moves:
        raise InputError("the two tones cancel: the plate does not move; change --c or --phase-deg")
    return make_ball(forcing, parse_effects(request.effects), frequency_hz=request.frequency_hz, g_mps2=request.g_mps2)


def check_adaptive(steps: int) -> None:
    """Refuse more gammas than an adaptive diagram, which is in memory, can be refined from."""
    if steps > MOST_ADAPTIVE:
        raise InputError(f"an adaptive diagram begins with at most {MOST_ADAPTIVE:,} --steps, not {steps:,}")


def seconds_of(tau: list[float], frequency_hz: float | None) -> list[float] | None:
    """Flight times in seconds; None without a frequency."""
    return None if frequency_hz is None else [t / (2.0 * math.pi * frequency_hz) for t in tau]


def gamma_peak_over_gamma(forcing: Forcing) -> float:
    """Peak acceleration of the plate over A w^2, dimensionless."""
    return max(q_and_slope(forcing.tones, float(p))[0] for p in turning_points(forcing))
