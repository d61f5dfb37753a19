"""The keys of a profile as the page shows them, and what was typed as a value."""

from __future__ import annotations

from typing import Any

import pytest

from bench.profiles.edit import fields_of, value_of, with_values
from bench.profiles.find import load, shipped_names
from bench.profiles.improved import PRESETS, new_profile, with_preset
from daq.setup.errors import InputError
from rig.profile import parse_profile


@pytest.mark.parametrize("name", shipped_names())
def test_every_key_that_a_profile_sets_is_shown_as_it_is_and_can_be_set_again(name: str) -> None:
    """Each value shown of a shipped profile, read as if it were typed, gives the same profile."""
    profile, text = load(name)
    shown = [one for one in fields_of(text) if one["text"]]
    assert len(shown) > 20
    again = with_values(text, {one["key"]: value_of(one["key"], one["text"]) for one in shown}, name)
    assert parse_profile(again) == profile


def test_unit_limit_help_and_choices_come_from_the_schema() -> None:
    """Of four keys, what the page says next to the value; a key that is not set is there, empty."""
    fields = {one["key"]: one for one in fields_of(new_profile("mine", "soundcard"))}
    assert fields["backend.buffer_s"]["unit"] == "s" and fields["backend.buffer_s"]["limit"] == "> 0, \u2264 1"
    assert fields["control.tolerance"]["text"] == "" and "relative" in fields["control.tolerance"]["help"]
    assert fields["channels.accelerometer.coupling"]["choices"] == ['"dc"', '"ac"']
    assert all(one["help"] for one in fields.values())


def test_a_broken_back_end_leaves_the_other_keys() -> None:
    """A profile whose back end is no table is shown, so that it can be mended."""
    assert any(
        one["key"] == "limits.drive_v" and one["text"] == "9.0"
        for one in fields_of("backend = 3\n[limits]\ndrive_v = 9.0")
    )


@pytest.mark.parametrize(
    ("text", "value"), [("2", 2), ("1.5", 1.5), ("[0.5, 0.7]", [0.5, 0.7]), ("up", "up"), ('"x"', "x"), ("true", True)]
)
def test_typed_values(text: str, value: Any) -> None:
    """Numbers, lists and words are read as TOML has them; a bare word is a text."""
    assert value_of("key", text) == value


@pytest.mark.parametrize("text", ["", "[1, 2", "{ a = 1"])
def test_what_is_no_value_is_refused(text: str) -> None:
    """Nothing at all, and brackets that do not close."""
    with pytest.raises(InputError, match=r"^key: "):
        value_of("key", text)


@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_brings_forcing_and_ramp_and_nothing_else(preset: str) -> None:
    """A sound card's profile with a preset has the preset's forcing and ramp, and its own everything else."""
    own, shipped = new_profile("mine", "soundcard"), load(preset)[0]
    found, before = parse_profile(with_preset(own, preset, "mine")), parse_profile(own)
    assert found.forcing == shipped.forcing and found.ramp.gammas() == shipped.ramp.gammas()
    assert found.model_copy(update={"forcing": before.forcing, "ramp": before.ramp}) == before
