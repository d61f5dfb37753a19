"""Values as JSON."""

import datetime
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from daq.files.json_values import json_text, json_values


@dataclass(frozen=True)
class Error:
    """A record with a unit in its name."""

    rms_us: float
    flights: int


def test_what_a_result_holds_is_plain_json() -> None:
    """Records, arrays, paths, dates and numbers of numpy come out as JSON's own; what is not finite is null."""
    value = {
        "before": Error(float("nan"), 117), "gammas": np.array([0.5, np.inf]), "n": np.int64(3), "file": Path("run.h5"),
        "day": datetime.date(2026, 11, 25), "ties": (("a",), ()), "none": None, "seen": np.bool_(True),
    }  # fmt: skip
    assert json.loads(json_text(value)) == {
        "before": {"rms_us": None, "flights": 117}, "gammas": [0.5, None], "n": 3, "file": "run.h5",
        "day": "2026-11-25", "ties": [["a"], []], "none": None, "seen": True,
    }  # fmt: skip


def test_what_json_cannot_hold_is_refused() -> None:
    """A complex number is an error that names its type, never a text."""
    with pytest.raises(TypeError, match="complex"):
        json_values({"z": 1j})
