"""Profiles as text: any profile written as TOML reads back as the same profile."""

from __future__ import annotations

import math
from typing import Any

import tomlkit
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.backends.kinds.base import built_in
from rig.profile import Profile, parse_profile


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    """Finite numbers between two limits."""
    return st.floats(low, high, allow_nan=False, allow_infinity=False)


QUANTITY = st.one_of(
    numbers(0.01, 10.0),
    st.fixed_dictionaries(
        {"value": numbers(0.01, 10.0), "uncertainty": numbers(0.0, 1.0), "source": st.text(max_size=8)},
        optional={"date": st.dates()},
    ),
)
GAMMAS = st.lists(numbers(0.0, 5.0), min_size=1, max_size=5) | st.fixed_dictionaries(
    {"start": numbers(0.0, 2.0), "stop": numbers(2.0, 5.0), "steps": st.integers(2, 9)}
)


@st.composite
def backends(draw: st.DrawFn) -> dict[str, Any]:
    """A ``[backend]`` table of any kind, some of its own options set."""
    name = draw(st.sampled_from(sorted(built_in())))
    options = built_in()[name].options
    fields, table = options.model_fields, {"kind": name, **dict.fromkeys(options.required, "a name")}
    # a marker beyond the least of the limits below is refused
    values = {"marker_v": numbers(0.01, 0.1), "block_samples": st.integers(16, 65536), "buffer_s": numbers(0.001, 1.0)}
    for key, strategy in values.items():
        if key in fields and draw(st.booleans()):
            table[key] = draw(strategy)
    return table


@st.composite
def profiles(draw: st.DrawFn) -> dict[str, Any]:
    """The tables of a profile that can be driven."""
    whole: dict[str, Any] = {
        "name": draw(st.text(min_size=1, max_size=12)),
        "sampling": {"rate_hz": draw(numbers(5000.0, 1e5))},
        "forcing": {"frequency_hz": draw(numbers(1.0, 40.0)), "ratio": draw(st.integers(1, 5))},
        "drive": {"g_per_volt": draw(QUANTITY), "phase_deg": draw(QUANTITY)},
        "channels": {"accelerometer": {"sensitivity": draw(QUANTITY), "unit": "V/g"}},
        "ball": {"mass_kg": draw(numbers(0.01, 2.0))},
        "ramp": {"gamma": draw(GAMMAS), "settle_cycles": draw(st.integers(0, 9))},
        "limits": {"drive_v": draw(numbers(0.1, 10.0)), "plate_mps2": 50.0, "displacement_m": 0.01},
        "backend": draw(backends()),
    }
    if draw(st.booleans()):
        whole["control"] = {"tolerance": draw(numbers(0.001, 0.4))}
    return whole


def as_toml(value: Any) -> Any:
    """Tables and lists of what TOML can hold: what is None is left out."""
    if isinstance(value, dict):
        return {key: as_toml(inner) for key, inner in value.items() if inner is not None}
    return [as_toml(inner) for inner in value] if isinstance(value, (list, tuple)) else value


@settings(max_examples=60, deadline=None)
@given(tables=profiles())
def test_a_profile_written_as_toml_reads_back_the_same(tables: dict[str, Any]) -> None:
    """Parse, dump and parse again: the same profile, whatever its back end, with every default written out."""
    profile = parse_profile(tomlkit.dumps(tables))
    assert profile.backend.kind == tables["backend"]["kind"]
    assert math.isclose(profile.sampling.rate_hz, tables["sampling"]["rate_hz"], rel_tol=0.0)
    again = parse_profile(tomlkit.dumps(as_toml(profile.model_dump())))
    assert again == profile and type(again.backend) is type(profile.backend)
    assert Profile.model_validate(profile.model_dump()) == profile
