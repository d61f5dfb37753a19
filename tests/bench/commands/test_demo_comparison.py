"""What a rig hid and what was found stand under the same names, in the same units."""

from __future__ import annotations

import dataclasses

import pytest

from analysis.loop.result import AddedEffect, ClosedLoop
from bench.commands.demo import LIBRARY_UNITS, MEASURED, compared, in_words
from model.effects.registry import effect
from rig.sim.scenario import EFFECTS
from tests.loops import changed


def test_both_sizes_stand_side_by_side(closed_loop: ClosedLoop) -> None:
    """Hidden adhesion is converted to the library's unit; what was not found, and what was not hidden, says so."""
    adhesion = AddedEffect("adhesion", {"a_mps2": (1.0, 0.9, 1.1)})
    loop = changed(closed_loop, effects=(adhesion, AddedEffect("restitution", {"e0": (0.2, 0.1, 0.3)})))
    rows = compared({"adhesion": {"pull_g": 0.1}, "quadratic_drag": {"k_per_m": 20.0}}, loop)
    by_name = {f"{row.effect}.{row.parameter}": row for row in rows}
    assert by_name["adhesion.a_mps2"].hidden == pytest.approx(0.980665) and by_name["adhesion.a_mps2"].found == 1.0
    assert "found 1 (0.9 to 1.1)" in in_words(by_name["adhesion.a_mps2"])
    assert in_words(by_name["quadratic_drag.k_per_m"]).endswith("hidden 20           not found")
    assert " not hidden          found 0.2" in in_words(by_name["restitution.e0"])
    (mains,) = (row for row in compared({"mains_pickup": {"phase_rad": 0.4}}, loop) if row.parameter == "phase_rad")
    assert in_words(mains).endswith("measured in each step, not fitted")


def test_sizes_are_converted_to_the_librarys(closed_loop: ClosedLoop) -> None:
    """A mass ratio is the library's relative loading, a static friction its excess, and volts of drive become g."""
    hidden = {
        "mass_loading": {"mass_ratio": 0.05},
        "stribeck_friction": {"mu_static": 0.3, "mu_kinetic": 0.05, "speed_mps": 0.1},
        "gain_compression": {"per_v2": 0.1},
        "harmonic_distortion": {"second_per_v": 0.02, "third_per_v2": 0.04},
    }
    drive = closed_loop.setup.drive
    doubled = drive.model_copy(update={"g_per_volt": drive.phase_deg.model_copy(update={"value": 2.0})})
    loop = dataclasses.replace(closed_loop, setup=closed_loop.setup.model_copy(update={"drive": doubled}))
    sizes = {f"{row.effect}.{row.parameter}": row.hidden for row in compared(hidden, loop)}
    assert sizes["mass_loading.relative"] == pytest.approx(0.05)
    assert sizes["stribeck_friction.mu_extra"] == pytest.approx(0.25)
    assert sizes["gain_compression.per_g2"] == pytest.approx(0.1 / 2 / 2.0**2)
    assert sizes["harmonic_distortion.quadratic_per_g"] == pytest.approx(0.01)
    assert sizes["harmonic_distortion.cubic_per_g2"] == pytest.approx(0.01)


def test_parameters_of_a_scenario_are_the_librarys() -> None:
    """Each number of a named effect is a parameter of the library, except frequency and phase of the mains."""
    strange = set()
    for entry in EFFECTS.values():
        known = {p.name for p in effect(entry.name).effect.parameters} if entry.named else set()
        for parameter in entry.parameters if entry.named else ():
            name = LIBRARY_UNITS.get((entry.name, parameter.name), (parameter.name, 1.0))[0]
            if name not in known:
                strange.add((entry.name, parameter.name))
    assert strange == MEASURED
