"""The table of `bench compare` in a narrow terminal, and its sentences."""

import numpy as np
import pytest

from analysis.flights.classify import StepClass
from analysis.flights.compare import Comparison, FirstBifurcation, StepComparison
from analysis.report.wording import gamma_scale
from bench.terminal.comparison import sentences, show
from daq.setup.setup import Forcing


def step(n: int, doubt: str) -> StepComparison:
    """A step of a 2-cycle at gamma 1.9."""
    own = StepClass(n, "cycle", 2, False, 20, 0, 1e-5, 1e-5, 1e-3, 2, 0.04)
    return StepComparison(
        n, 1.9, 3.8, own, "2-cycle with reset, period 12", np.zeros(2), True, 1.0056, 5207.3e-6, 0.5, doubt, ()
    )  # fmt: skip


def held(ratio: int) -> Comparison:
    """A comparison of three steps, the last two in doubt."""
    steps = (step(0, ""), step(11, "unsettled"), step(22, "sensitive"))
    nothing = FirstBifurcation(None, "lock", 1.65, float("nan"))
    return Comparison(steps, (), nothing, (), 0.1, 0.9, 40, 0, 1e5, ratio)


@pytest.mark.parametrize("columns", ["80", "60"])
def test_no_number_is_cut(columns: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Numbers stand whole; words are folded where there is no room, and the steps in doubt are listed with reasons."""
    monkeypatch.setenv("COLUMNS", columns)
    show(held(1), "run.h5", True, gamma_scale(Forcing(frequency_hz=25.0, ratio=1), 1))
    shown = capsys.readouterr().out
    assert "\u2026" not in shown
    assert "n-cycle: a motion of n flights" in " ".join(shown.split()) and "n: measured flights" in shown
    for number in ("3.8000", "1.0056", "5207.3", "22"):
        assert number in shown
    assert "unsettled" in shown and "step 11" in shown and "sensitive" in shown and "step 22" in shown


@pytest.mark.parametrize(("ratio", "name", "at"), [(1, "gamma_peak", "3.3000"), (2, "gamma", "1.6500")])
def test_one_measure_of_forcing(ratio: int, name: str, at: str) -> None:
    """Sentences speak of the table's measure, gamma_peak at c = 1 and gamma else, and define it once."""
    said = sentences(held(ratio), gamma_scale(Forcing(frequency_hz=25.0, ratio=ratio), ratio))
    assert f"first bifurcation predicted: lock at {name} {at}" in said
    assert sum(line.startswith(f"{name} = ") for line in said) == 1
