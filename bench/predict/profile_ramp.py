"""What `bench predict` takes from a profile: forcing, frequency, gravity, declared effects, its ramp, and `--what-if`.

A gamma given with a profile is what its programme asks of the drive; answers carry the plate's gamma, which declared
effects of the drive make another one. ``--gamma-peak`` is the plate's own. ``--what-if`` replaces some of its values,
or of its declared effects.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError

from bench.predict.request import GivenProfile, Progress, Request, ball_for, orbit_json
from bench.profiles.find import load, load_measuring
from bench.terminal.console import CYCLES, print_lines
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from model.effects.registry import Effects, accelerometer_response, ball_effects, plate_gain, shapes_the_plate
from model.orbits.attractor import AT_REST, Attractor, attractor

Described = TypeVar("Described", bound=Setup)

MASS = "ball.mass_kg"
# powers of the ball's mass with which effects go: what it weighs against the table, and forces per mass
OF_MASS = {
    ("table_resonance", "mass_ratio"): 1, ("mass_loading", "relative"): 1, ("viscous_damping", "rate_per_s"): -1,
    ("quadratic_drag", "k_per_m"): -1, ("adhesion", "a_mps2"): -1, ("position_force", "spring_per_s2"): -1,
    ("position_force", "magnet_mps2"): -1,
}  # fmt: skip


def what_if(profile: Described, changes: tuple[str, ...]) -> Described:
    """The profile with ``KEY=VALUE`` of each change: a key of it, or ``effect.parameter`` (raises `InputError`).

    With the ball's mass its weight against the table changes, and what a force does to it.
    """
    data = profile.model_dump()
    for change in changes:
        key, equals, text = (part.strip() for part in change.partition("="))
        try:
            value = float(text)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(f"--what-if wants KEY=NUMBER, such as ball.mass_kg=0.1, not {change!r}")
        if key == MASS and value > 0.0:  # any other is refused below
            for (effect, parameter), power in OF_MASS.items():
                if quantity := data["declared"].get(effect, {}).get(parameter):
                    quantity["value"] *= (value / data["ball"]["mass_kg"]) ** power
        *path, last = key.split(".")
        table = data
        # a declared effect may be named without `declared`
        for place in ["declared", *path] if path and path[0] in data["declared"] else path:
            table = table.get(place, {}) if isinstance(table.get(place, {}), dict) else {}
        if last not in table:
            declared = ", ".join(f"{e}.{q}" for e, own in data["declared"].items() for q in own) or "none"
            where = f"profile {profile.name!r} has no such value; its declared effects: {declared}"
            raise InputError(f"--what-if {key}: {where}")
        table[last] = {**table[last], "value": value} if isinstance(table[last], dict) else value
    try:
        return type(profile).model_validate(data)
    except ValidationError as error:
        raise InputError(f"--what-if {' '.join(changes)}: {error.errors()[0]['msg']}") from error


def with_profile(request: Request, given: GivenProfile) -> Request:
    """``request`` with what the profile says, under the options given with it (`InputError` where they contradict)."""
    name, setup = given.name, what_if(load_measuring(given.name)[0], given.what_if)
    forcing = setup.forcing
    if request.ratio not in (1, forcing.ratio):
        raise InputError(f"{name}: says forcing.ratio = {forcing.ratio}, the call --c {request.ratio}; leave one out")
    declared = setup.declared_values()
    omitted = shapes_the_plate(declared)
    if omitted:
        print(f"left out of the prediction, their phase being unknown: {', '.join(omitted)}", file=sys.stderr)
    known = tuple(f"{n}.{k}={v!r}" for n, table in ball_effects(declared).items() for k, v in table.items())
    first_deg, second_deg = forcing.phase_deg
    low_high = request.gamma_range
    return dataclasses.replace(
        request,
        ratio=forcing.ratio,
        phase_deg=0.0 if forcing.ratio == 1 else second_deg - forcing.ratio * first_deg,
        frequency_hz=request.frequency_hz or forcing.frequency_hz,
        g_mps2=setup.g_mps2.value,
        effects=(*known, *request.effects),
        gamma=None if request.gamma is None else plate_gamma(setup, request.gamma),
        gamma_range=None if low_high is None else (plate_gamma(setup, low_high[0]), plate_gamma(setup, low_high[1])),
    )


def plate_gamma(setup: Setup, asked: float, *, controlled: bool = False) -> float:
    """Gamma of the plate where the programme asks for ``asked``; ``controlled``: until its accelerometer shows it."""
    tones = [abs(z) for _, z in setup.forcing.displacement_tones()]
    if len(tones) > 1 and not math.isclose(tones[0], tones[1], rel_tol=1e-9):
        b = setup.forcing.amplitude
        raise InputError(
            f"profile {setup.name!r}: forcing.amplitude = {list(b)}; predict knows two tones of equal size only"
        )
    size = tones[0] / 2.0 if len(tones) == 1 else tones[0]  # over that of `Forcing.superposition`
    declared: Effects = setup.declared_values()
    if controlled:
        omega_radps = np.array([2.0 * np.pi * setup.forcing.frequency_hz])
        return float(asked * size / abs(accelerometer_response(declared, omega_radps)[0]))
    level_g = asked * math.hypot(*(multiple**2 * abs(z) for multiple, z in setup.forcing.displacement_tones()))
    return asked * size * plate_gain(declared, level_g)


def ramp_json(request: Request, given: GivenProfile) -> list[dict[str, Any]]:
    """The motion in each step of the profile's ramp, the state carried along; raises `InputError` without a ramp."""
    profile = what_if(load(given.name)[0], given.what_if)
    asked = profile.ramp.gammas()
    plate = [plate_gamma(profile, g, controlled=profile.control is not None) for g in asked]
    ball, state, progress = ball_for(request), AT_REST, Progress("steps")
    found: list[Attractor] = []
    for gamma in plate:
        found.append(attractor(ball, gamma, state))
        state = found[-1].last
        progress(len(found), len(plate))
    return [
        {"step": i, "asked_gamma": a, **orbit_json(f, request.ratio, g, request.frequency_hz)}
        for i, (a, g, f) in enumerate(zip(asked, plate, found, strict=True))
    ]


def print_ramp(rows: list[dict[str, Any]]) -> None:
    """The same for a person."""
    print(f"{'step':>4} {'asked':>8} {'gamma':>8}  motion and flight times (ms)")
    for row in rows:
        times = [f"{1e3 * t:.3f}" for t in row["flight_time_s"] or []]
        shown = ", ".join(times[:6]) + (", ..." if len(times) > 6 else "")
        print(f"{row['step']:>4} {row['asked_gamma']:>8.4f} {row['gamma']:>8.4f}  {_words(row)}: {shown}".rstrip(": "))
    print_lines("gamma = A w^2/g of the first tone: asked for, and at the plate as declared", CYCLES)


def _words(row: dict[str, Any]) -> str:
    if row["flights"] == 0:
        return "at rest on the plate"
    if row["kind"] == "chaotic":
        return "chaotic"
    how = "locked" if row["locked"] else "with chatter" if row["kind"] == "chattering" else "with reset"
    return f"{row['flights']}-cycle {how}, period {row['period']}"
