"""Edits of a profile's text: values, measured quantities and declared effects."""

import datetime
import tomllib
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.profiles.edit import declare, with_values
from bench.profiles.find import find_profile, shipped_names
from daq.setup.errors import InputError
from daq.setup.values import MeasuredValue

DAY = datetime.date(2026, 11, 21)
E0 = MeasuredValue("declared.restitution.e0", 0.514, 0.02, 'drop "one"')


def test_comments_and_other_tables_stay() -> None:
    """Only the parameter's line changes; comments, order and other tables stay to the letter."""
    text = "name = 'x' # mine\n\n[declared.restitution] # old\ne0 = 0.4\ne1_s_per_m = 0.1\n\n[ball]\nmass_kg = 0.2\n"
    edited = declare(text, [E0], DAY, "p.toml")
    assert edited.replace(next(line for line in edited.splitlines() if line.startswith("e0")), "e0 = 0.4") == text
    assert tomllib.loads(edited)["declared"]["restitution"]["e0"]["date"] == DAY


def test_a_table_is_added_where_there_is_none() -> None:
    """A profile that declares nothing gets the table at its end."""
    edited = tomllib.loads(declare("name = 'x'\n[ball]\nmass_kg = 0.2\n", [E0], DAY, "p.toml"))
    assert edited["declared"]["restitution"]["e0"]["value"] == 0.514
    assert edited["ball"] == {"mass_kg": 0.2}


def test_inline_tables_are_edited_in_place() -> None:
    """Effects declared in inline tables are edited where they are."""
    text = "declared = { restitution = { e0 = 0.4, e1_s_per_m = 0.1 } }\n"
    edited = tomllib.loads(declare(text, [E0], DAY, "p.toml"))["declared"]["restitution"]
    assert (edited["e0"]["value"], edited["e1_s_per_m"]) == (0.514, 0.1)


def test_nothing_measured_changes_nothing() -> None:
    """A profile for which nothing was measured keeps its text to the letter."""
    text = "name = 'x' # mine\n\n[ball]\nmass_kg = 0.2"
    assert declare(text, [], DAY, "p.toml") == text


@pytest.mark.parametrize(
    "text", ["[ball]\nmass_kg = 0.2", "[a]\nx = 1\r\n[declared.contact_latency]\r\ndelay_s = 0.1\r\n"]
)
def test_text_of_any_ending_is_edited(text: str) -> None:
    """A missing newline at the end, and the line ends of Windows, do not disturb an edit."""
    edited = tomllib.loads(declare(text, [E0], DAY, "p.toml"))
    assert edited["declared"]["restitution"]["e0"]["value"] == 0.514


def test_an_effect_can_be_withdrawn() -> None:
    """Only the named effect's declaration goes."""
    text = "[declared.restitution]\ne0 = 0.4\n\n[declared.coulomb_friction]\nmu_up = 0.1\n"
    edited = with_values(text, {"declared.coulomb_friction": None}, "p")
    assert tomllib.loads(edited)["declared"] == {"restitution": {"e0": 0.4}}


@pytest.mark.parametrize("text", ["declared = 3\n", "[declared\n", "declared.restitution = 2\n"])
def test_what_is_no_profile_is_refused(text: str) -> None:
    """Text that is not TOML, or a declaration that is no table, is refused by the file's name."""
    with pytest.raises(InputError, match=r"p\.toml"):
        declare(text, [E0], DAY, "p.toml")


KEYS = st.sampled_from(
    ["name", "ramp.gamma", "ramp.order", "forcing.ratio", "declared.restitution.e0", "new.table.key"]
)
VALUES = st.one_of(
    st.integers(-9, 9),
    st.floats(allow_nan=False),
    st.text("ax '#=\n\"\\", max_size=9),
    st.lists(st.floats(0, 9), max_size=4),
)


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(shipped_names()), st.dictionaries(KEYS, VALUES, max_size=4))
def test_an_edit_sets_its_values_and_nothing_else(name: str, values: dict[str, Any]) -> None:
    """Of any shipped profile, an edited text holds the new values, every other value, and every comment as before."""
    text = find_profile(name).read_text(encoding="utf-8")
    found, wanted = tomllib.loads(with_values(text, values, name)), tomllib.loads(text)
    for dotted, value in values.items():
        *tables, key = dotted.split(".")
        table = wanted
        for part in tables:
            table = table.setdefault(part, {})
        table[key] = value
    assert found == wanted
    comments = [line for line in text.splitlines() if line.startswith("#")]
    assert [line for line in with_values(text, values, name).splitlines() if line.startswith("#")] == comments


def test_values_have_the_digits_that_their_uncertainty_carries() -> None:
    """Two digits of the uncertainty, and one more of the value; a value that is exact stays as it is."""
    found = [
        MeasuredValue("declared.restitution.e0", 0.51423871, 0.0213987, "x"),
        MeasuredValue("g_mps2", 9.812345, 0.0, "x"),
    ]
    read = tomllib.loads(declare("", found, datetime.date(2026, 11, 25), "text"))
    assert (read["declared"]["restitution"]["e0"]["value"], read["g_mps2"]["value"]) == (0.5142, 9.812345)
    assert read["declared"]["restitution"]["e0"]["uncertainty"] == 0.021
