"""Writing measured effects into a profile's text."""

import datetime
import tomllib

import pytest

from analysis.drop.declare import Measured, declare
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


def test_what_cannot_be_edited_safely_is_refused() -> None:
    """An inline table of declared effects is left alone, with an error."""
    with pytest.raises(InputError, match="cannot edit"):
        declare("declared = { restitution = { e0 = 0.4 } }\n", [E0], DAY, "p.toml")
