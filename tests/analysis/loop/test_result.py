"""A closed loop as a value: computed from a recording, equal after saving, and without an engine inside."""

import dataclasses
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from pydantic import BaseModel

from analysis.attribution import selection
from analysis.attribution.candidates import Candidate
from analysis.attribution.choice import LogScoreDifference
from analysis.discovery.discover import Band, Discovery
from analysis.loop.close_loop import close_loop
from analysis.loop.result import ClosedLoop, load_verdict, save_verdict
from analysis.loop.tables import loop_json
from analysis.report.page import write_report
from analysis.report.wording import VERDICTS
from analysis.residuals.covariates import Covariate
from analysis.thresholds import Thresholds
from bench.jobs.loops import drawn
from daq.setup.errors import InputError
from tests.loops import changed

KEYS = (
    "verdict",
    "effects",
    "discovered",
    "tie_set",
    "before",
    "after",
    "noise_floor_us",
    "held_out_steps",
    "remainder",
    "next_run",
)
ERRORS = ("landing_rms_us", "landing_nmad_us", "takeoff_nmad_us", "flight_time_relative")
BOTH = (("coulomb_friction", "mu_up"), ("coulomb_friction", "mu_down"))
FRICTION = Candidate(("coulomb_friction",), BOTH, (dict.fromkeys(BOTH, 0.1),))


@pytest.fixture(scope="module")
def computed(make: Callable[..., Any]) -> ClosedLoop:
    """The loop closed on a short ramp with friction 0.1, friction being the only candidate."""
    gammas = np.array([0.55, 0.7, 0.85, 1.0, 1.15, 1.3, 0.62, 0.92, 1.07])
    path = make(gammas, hold=12, effects={"coulomb_friction": {"mu_up": 0.1, "mu_down": 0.1}}).path
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(selection, "candidates_of", lambda *a, **k: [FRICTION])
        return close_loop([path], limits=Thresholds(most_effects=1))


def discovery(seen: np.ndarray, loop: ClosedLoop) -> Discovery:
    """A discovered pull of the height, as numbers."""
    x, gain = np.linspace(0.0, 8e-3, 9), LogScoreDifference(90.0, 9.0, 80.0, 8.0)
    return Discovery(
        "force", Covariate("height", "mm", 1e3), "a downward pull rises", Band(x, -x, -x - 1.0, 1.0 - x, "m/s^2"),
        seen, gain,
        (("position_force", 0.9),), ("flight time",), loop.errors.after, 5.0,
    )  # fmt: skip


def leaves(value: Any) -> Iterator[Any]:
    """Everything that a value holds, down to numbers, texts and arrays."""
    if dataclasses.is_dataclass(value):
        for f in dataclasses.fields(value):
            yield from leaves(getattr(value, f.name))
    elif isinstance(value, dict):
        for key, x in value.items():
            yield from (*leaves(key), *leaves(x))
    elif isinstance(value, tuple):
        for x in value:
            yield from leaves(x)
    else:
        yield value


def test_a_closed_loop_holds_plain_data(computed: ClosedLoop) -> None:
    """Numbers, texts, arrays of numbers and the setup: no forward model, no fit, no open file."""
    for x in leaves(computed):
        assert x is None or isinstance(x, (bool, int, float, str, BaseModel)) or x.dtype.kind in "bif"


def test_the_agreed_keys(computed: ClosedLoop) -> None:
    """The JSON has every key agreed upon, each with its kind of value, and survives a parser that knows no NaN."""
    found = json.loads(json.dumps(loop_json(computed), allow_nan=False))
    assert set(KEYS) <= set(found)
    assert found["verdict"] in VERDICTS
    assert [set(e) for e in found["effects"]] == [{"name", "parameters"}]
    for parameter in found["effects"][0]["parameters"].values():
        assert list(parameter) == ["value", "low", "high"]
        assert parameter["low"] <= parameter["value"] <= parameter["high"]
    assert found["tie_set"][0] == ["coulomb_friction"]
    for side in ("before", "after"):
        assert all(isinstance(found[side][k], float) for k in ERRORS)
    assert found["before"]["landing_nmad_us"] > 10 * found["after"]["landing_nmad_us"]
    assert set(found["remainder"]) >= {"p_lack_of_fit", "covariate"}
    assert found["held_out_steps"] == [2, 6]
    assert found["next_run"] is None


def test_the_tables_hold_what_the_errors_are_made_of(computed: ClosedLoop) -> None:
    """Residuals are measured minus predicted, and those of the held-out steps give the error before."""
    flights = computed.flights
    for side in (flights.before, flights.after):
        rows = flights.scored
        np.testing.assert_array_equal(side.landing_residual_s[rows], (flights.landing_s - side.landing_s)[rows])
    rows = flights.scored & computed.steps.held_out[flights.step]
    error = 1.4826e6 * np.median(np.abs(flights.before.landing_residual_s[rows]))
    assert computed.errors.before.excluded_fraction == 0.0 and computed.errors.before.landing_nmad_us == pytest.approx(
        error
    )


@pytest.mark.parametrize("found", [False, True])
def test_a_saved_loop_is_read_again_as_it_was(computed: ClosedLoop, found: bool, tmp_path: Path) -> None:
    """Every leaf is the same after saving and reading, with and without a discovered term."""
    loop = computed
    if found:
        loop = changed(loop, discovered=discovery(np.array([1e-3, 2e-3]), loop), landing_floor_us=math.nan)
    path = tmp_path / "loop.h5"
    save_verdict(loop, path)
    again = load_verdict(path)
    pairs = list(zip(leaves(loop), leaves(again), strict=True))
    assert len(pairs) > 300
    for a, b in pairs:
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)
        else:
            assert a == b or (a != a and b != b)


def test_the_report_of_a_loaded_loop_is_the_same(closed_loop: ClosedLoop, tmp_path: Path) -> None:
    """Page, JSON and every figure, byte for byte, although another process draws them."""
    loop = dataclasses.replace(closed_loop, discovered=discovery(np.array([1e-3, 2e-3]), closed_loop))
    save_verdict(loop, tmp_path / "loop.h5")
    write_report(loop, tmp_path / "first")
    assert drawn(load_verdict(tmp_path / "loop.h5"), tmp_path / "again") == tmp_path / "again" / "report.html"
    names = sorted(p.name for p in (tmp_path / "first").iterdir())
    assert {"report.html", "report.json", "errors.svg", "discovered.png"} <= set(names)
    for name in names:
        assert (tmp_path / "first" / name).read_bytes() == (tmp_path / "again" / name).read_bytes(), name


def test_a_file_that_holds_no_closed_loop_is_refused(tmp_path: Path) -> None:
    """The message names the file and what was wanted, for text, for another HDF5 file and for a damaged one."""
    text, other, damaged = (tmp_path / name for name in ("text.h5", "other.h5", "damaged.h5"))
    text.write_text("no loop", encoding="utf-8")
    with h5py.File(other, "w") as file:
        file.attrs["format"] = "something else"
    with h5py.File(damaged, "w") as file:
        file.attrs.update(format="shakerbench closed loop", version=2)
        file["values"] = "{}"
    for path in (text, other, damaged):
        with pytest.raises(InputError, match=f"{path.name}: wanted a closed loop"):
            load_verdict(path)
