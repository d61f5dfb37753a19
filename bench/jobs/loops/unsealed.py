"""Effects that a simulated rig hid, side by side with those found, in the parameters of the library of effects."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from analysis.loop.result import ClosedLoop
from daq.setup.values import STANDARD_GRAVITY_MPS2

LIBRARY_UNITS: Mapping[tuple[str, str], tuple[str, float]] = {
    ("adhesion", "pull_g"): ("a_mps2", STANDARD_GRAVITY_MPS2),
    ("position_force", "magnet_g"): ("magnet_mps2", STANDARD_GRAVITY_MPS2),
    ("mains_hum", "amplitude_g"): ("amplitude_mps2", STANDARD_GRAVITY_MPS2),
    ("mains_pickup", "amplitude_g"): ("amplitude_mps2", STANDARD_GRAVITY_MPS2),
    ("accelerometer_offset", "offset_g"): ("offset_mps2", STANDARD_GRAVITY_MPS2),
    ("local_gravity", "relative"): ("excess_mps2", STANDARD_GRAVITY_MPS2),
    ("phase_lag", "time_constant_s"): ("low_pass_s", 1.0),
    ("accelerometer_lag", "time_constant_s"): ("low_pass_s", 1.0),
    ("stribeck_friction", "speed_mps"): ("v_s_mps", 1.0),
    ("contact_closure", "duration_s"): ("closure_s", 1.0),
    ("mass_loading", "mass_ratio"): ("relative", 1.0),  # in contact the plate moves less by 1 + this
    ("stribeck_friction", "mu_static"): ("mu_extra", 1.0),  # less mu_kinetic
    ("gain_compression", "per_v2"): ("per_g2", 0.5),  # of a mean square there, of one tone's amplitude here
    ("harmonic_distortion", "second_per_v"): ("quadratic_per_g", 1.0),
    ("harmonic_distortion", "third_per_v2"): ("cubic_per_g2", 1.0),
}
"""Parameters of a scenario that the library knows by another name or unit: its name there, and the factor."""
DRIVE_POWERS = {"per_g2": 2, "quadratic_per_g": 1, "cubic_per_g2": 2}
"""Powers of the drive's scale, g a volt, by which a number of the drive's volts is divided."""


class Compared(NamedTuple):
    """A parameter as hidden and as found with its 95 % interval; NaN where it was not hidden, or not found."""

    effect: str
    parameter: str
    hidden: float
    found: float
    low: float
    high: float


def compared(hidden: Mapping[str, Mapping[str, float]], loop: ClosedLoop) -> list[Compared]:
    """Every parameter of the effects that were hidden (a scenario's ``effects``) or added by the loop."""
    sizes = {}
    scale = loop.setup.drive.g_per_volt
    for effect, parameters in hidden.items():
        for parameter, size in parameters.items():
            name, factor = LIBRARY_UNITS.get((effect, parameter), (parameter, 1.0))
            g_per_volt = 1.0 if scale is None else scale.value
            sizes[effect, name] = factor * float(size) / g_per_volt ** DRIVE_POWERS.get(name, 0)
    if ("stribeck_friction", "mu_extra") in sizes:
        sizes["stribeck_friction", "mu_extra"] -= sizes["stribeck_friction", "mu_kinetic"]
    found = {(added.name, name): x for added in loop.selection.effects for name, x in added.parameters.items()}
    nothing = (math.nan, math.nan, math.nan)
    return [
        Compared(*key, sizes.get(key, math.nan), *found.get(key, nothing)) for key in dict.fromkeys((*sizes, *found))
    ]


def in_words(row: Compared) -> str:
    """A line for a person."""
    hidden = "not hidden" if math.isnan(row.hidden) else f"hidden {row.hidden:.4g}"
    found = "not found" if math.isnan(row.found) else f"found {row.found:.4g} ({row.low:.4g} to {row.high:.4g})"
    return f"{row.effect + '.' + row.parameter:<34} {hidden:<19} {found}"
