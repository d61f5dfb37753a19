"""Times of runs over which parameters are tested for a trend."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.joint.choice import days_since_first


@pytest.mark.parametrize(
    ("started", "days", "dated"),
    [
        (("2026-01-02T12:00:00Z", "2026-01-01T12:00:00Z", "2026-01-04T00:00:00Z"), (1.0, 0.0, 2.5), True),
        (("2026-01-01T12:00:00Z", "2026-01-01T12:00:00Z", "2026-01-04T00:00:00Z"), (0.0, 1.0, 2.0), False),
        (("2026-01-01T12:00:00Z", "", "2026-01-04T00:00:00Z"), (0.0, 1.0, 2.0), False),
    ],
)
def test_runs_without_dates_of_their_own_are_numbered(
    started: tuple[str, ...], days: tuple[float, ...], dated: bool
) -> None:
    """Days count from the first run; where a date is missing or comes twice, the runs' numbers take their place."""
    found, known = days_since_first(started)
    assert known is dated
    np.testing.assert_allclose(found, days)
