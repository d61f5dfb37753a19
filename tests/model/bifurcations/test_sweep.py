"""Changes met along a sweep: one by one, of types that are listed."""

from itertools import islice

import pytest

from model.bifurcations.sweep import TYPES, observed_bifurcations
from model.orbits.make_ball import make_ball
from model.tones import Forcing


@pytest.mark.parametrize(("ratio", "high"), [(1, 3.0), (2, 1.2)])
@pytest.mark.parametrize("effects", [{}, {"coulomb_friction": {"mu_up": 0.1, "mu_down": 0.1}}])
def test_every_type_is_listed(ratio, high, effects):
    """What is searched for by its type can be found: no change of a sweep has a type that is not in the list."""
    ball = make_ball(Forcing.superposition(ratio), effects)
    found = list(observed_bifurcations(ball, 0.2, high, sweep="up", steps=120))
    assert len(found) > 3 and {x.type for x in found} <= TYPES


def test_the_first_changes_are_those_of_the_whole_sweep():
    """Who stops after two changes has the first two of the whole list."""
    ball = make_ball(Forcing.superposition(2), {})
    whole = list(observed_bifurcations(ball, 0.2, 1.2, sweep="up", steps=120))
    assert list(islice(observed_bifurcations(ball, 0.2, 1.2, sweep="up", steps=120), 2)) == whole[:2]
