"""Writing measured effects into a profile's text."""

import datetime
import tomllib

import pytest

from analysis.drop.outcome import Measured
from bench.profiles.edit import declare, withdraw
from daq.setup.errors import InputError

DAY = datetime.date(2026, 11, 21)
E0 = Measured("restitution", "e0", 0.514, 0.02, 'drop "one"')


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


def test_an_inline_table_is_edited_in_place() -> None:
    """Effects declared in inline tables are edited where they are."""
    text = "declared = { restitution = { e0 = 0.4, e1_s_per_m = 0.1 } }\n"
    edited = tomllib.loads(declare(text, [E0], DAY, "p.toml"))
    assert edited["declared"]["restitution"]["e0"]["value"] == 0.514
    assert edited["declared"]["restitution"]["e1_s_per_m"] == 0.1


def test_nothing_to_declare_changes_nothing() -> None:
    """A profile for which nothing was measured keeps its text."""
    text = "name = 'x' # mine\n\n[ball]\nmass_kg = 0.2\n"
    assert declare(text, [], DAY, "p.toml") == text


def test_an_effect_can_be_withdrawn() -> None:
    """Only the named effect's declaration goes."""
    text = "[declared.restitution]\ne0 = 0.4\n\n[declared.coulomb_friction]\nmu_up = 0.1\n"
    assert tomllib.loads(withdraw(text, ["coulomb_friction"], "p"))["declared"] == {"restitution": {"e0": 0.4}}


@pytest.mark.parametrize("text", ["declared = 3\n", "[declared\n"])
def test_what_is_no_profile_is_refused(text: str) -> None:
    """Text that is not TOML, or a declaration that is no table, is refused by the file's name."""
    with pytest.raises(InputError, match=r"p\.toml"):
        declare(text, [E0], DAY, "p.toml")
