"""What each plant can hide, by which name it should be found, and what its numbers are in the library's parameters."""

from __future__ import annotations

from collections.abc import Mapping

from daq.setup.values import STANDARD_GRAVITY_MPS2

G = STANDARD_GRAVITY_MPS2

OTHER_NAMED = {
    "coulomb_friction": "coulomb_friction",
    "friction_asymmetry": "coulomb_friction",
    "viscous_damping": "viscous_damping",
    "quadratic_drag": "quadratic_drag",
    "restitution": "restitution",
    "adhesion": "adhesion",
    "spring": "position_force",
    "magnet": "position_force",
    "local_gravity": "local_gravity",
    "table_resonance": "table_resonance",
    "drive_gain": "drive_gain",
    "gain_compression": "gain_compression",
    "phase_lag": "phase_lag",
    "harmonic_distortion": "harmonic_distortion",
    "mains_hum": "mains_hum",
    "amplitude_modulation": "amplitude_modulation",
    "accelerometer_gain": "accelerometer_gain",
    "accelerometer_offset": "accelerometer_offset",
    "contact_latency": "contact_latency",
    "accelerometer_lag": "accelerometer_lag",
    "mains_pickup": "mains_pickup",
    "accelerometer_high_pass": "accelerometer_high_pass",
}
OTHER_OUTSIDE = {  # and the covariate of each
    "friction_with_height": "height",
    "friction_with_level": "gamma",
    "pull_after_long_flight": "previous flight",
    "restitution_at_one_speed": "impact speed",
    "upper_stop": "height",
}
OTHER_SAME = {
    "friction_with_speed": "viscous_damping",
    "friction_with_dwell": "adhesion",
    "restitution_scatter": "restitution_scatter",
}
"""Beyond the agreed list by their names, one and the same as a named effect for whoever predicts one event ahead; and
what is hidden only together with another one."""

OTHER_PARAMETERS: Mapping[str, tuple[tuple[str, str, float], ...]] = {
    # hidden number: (library's effect, parameter, factor)
    "coulomb_friction.mu": (("coulomb_friction", "mu_up", 1.0), ("coulomb_friction", "mu_down", 1.0)),
    "friction_asymmetry.up": (("coulomb_friction", "mu_up", 1.0),),
    "friction_asymmetry.down": (("coulomb_friction", "mu_down", 1.0),),
    "viscous_damping.rate_per_s": (("viscous_damping", "rate_per_s", 1.0),),
    "quadratic_drag.per_m": (("quadratic_drag", "k_per_m", 1.0),),
    "restitution.e0": (("restitution", "e0", 1.0),),
    "restitution_scatter.sd": (("restitution_scatter", "sd", 1.0),),
    "adhesion.pull_g": (("adhesion", "a_mps2", G),),
    "spring.per_s2": (("position_force", "spring_per_s2", 1.0),),
    "magnet.pull_g": (("position_force", "magnet_mps2", G),),
    "local_gravity.relative": (("local_gravity", "excess_mps2", G),),
    "table_resonance.ratio": (("table_resonance", "mass_ratio", 1.0),),
    "table_resonance.hz": (("table_resonance", "frequency_hz", 1.0),),
    "drive_gain.relative": (("drive_gain", "relative", 1.0),),
    "phase_lag.delay_s": (("phase_lag", "delay_s", 1.0),),
    "harmonic_distortion.second": (("harmonic_distortion", "second", 4.0),),
    "harmonic_distortion.third": (("harmonic_distortion", "third", 9.0),),
    "gain_compression.per_gamma2": (("gain_compression", "per_g2", 1.0),),
    "mains_hum.g": (("mains_hum", "amplitude_mps2", G),),
    "amplitude_modulation.depth": (("amplitude_modulation", "depth", 1.0),),
    "amplitude_modulation.hz": (("amplitude_modulation", "frequency_hz", 1.0),),
    "accelerometer_gain.relative": (("accelerometer_gain", "relative", 1.0),),
    "accelerometer_offset.g": (("accelerometer_offset", "offset_mps2", G),),
    "contact_latency.delay_s": (("contact_latency", "delay_s", 1.0),),
    "accelerometer_lag.delay_s": (("accelerometer_lag", "delay_s", 1.0),),
    "mains_pickup.g": (("mains_pickup", "amplitude_mps2", G),),
    "accelerometer_high_pass.hz": (("accelerometer_high_pass", "corner_hz", 1.0),),
}

AT_RATIO: Mapping[int, Mapping[str, float]] = {
    # at c = 1 both tones are one of twice the size, by which the library measures
    1: {"gain_compression.per_gamma2": 0.25, "harmonic_distortion.second": 0.5, "harmonic_distortion.third": 0.5},
    # at c = 2 the second is four times the first, and the library measures by both
    2: {"gain_compression.per_gamma2": 1.0 / 17.0},
}


def expected_names(plant: str, effect: str) -> tuple[str, ...]:
    """Names by which ``effect`` counts as found; none where it lies outside the library."""
    if plant == "own":
        from rig.sim.scenario import EFFECTS

        return (effect,) if EFFECTS[effect].named else ()
    name = OTHER_NAMED.get(effect) or OTHER_SAME.get(effect)
    return (name,) if name else ()


def expected_covariate(plant: str, effect: str) -> str:
    """Covariate of a smooth term beyond the library, as the report says it; empty where there is none."""
    if plant == "own":
        from rig.sim.scenario import EFFECTS

        return EFFECTS[effect].covariate
    return OTHER_OUTSIDE.get(effect, "")
