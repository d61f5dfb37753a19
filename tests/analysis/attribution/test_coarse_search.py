"""The coarse search over settings of several causes."""

from __future__ import annotations

from analysis.attribution.coarse_search import CoarseSearch

SIZE, E0, MU = ("quadratic_drag", "drag_per_m"), ("restitution", "e0"), ("coulomb_friction", "mu_up")


def test_settings_of_other_causes_are_tried_one_after_another_and_own_starts_where_they_lead() -> None:
    """The lowest of a valley along three parameters is found in a quarter of the predictions of every combination."""
    tried = []

    class Valley(CoarseSearch):
        def __init__(self) -> None:
            pass

        def loss(self, point):  # type: ignore[no-untyped-def]
            tried.append(point)
            size, e0, mu = (point.get(key, 0.0) for key in (SIZE, E0, MU))
            return (e0 - 0.5) ** 2 + (mu - 0.2) ** 2 + 0.01 * (size - 2.0 * e0) ** 2

    axes = [
        [{SIZE: 0.1 * i} for i in range(12)],
        [{}, *({E0: 0.1 * i} for i in range(1, 9))],
        [{}, *({MU: 0.1 * i} for i in range(1, 5))],
    ]
    singly = Valley().lowest(axes, jointly=False)
    few, tried = len(tried), []
    assert singly == Valley().lowest(axes, jointly=True) and singly[1] == {SIZE: 1.0, E0: 0.5, MU: 0.2}
    assert 4 * few < len(tried) == 12 * 9 * 5
