"""The public package: what it offers, how it is documented, what its values carry, and how it starts."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import matplotlib.figure
import numpy as np
import pytest

import shakerbench as sb
from analysis.loop.result import ClosedLoop
from daq.setup.errors import InputError
from shakerbench.measuring import LoopResult

ROOT = Path(__file__).parents[2]
NAMES = [name for name in sb.__all__ if name != "__version__"]
UNIT = re.compile(
    r"\bs\b|\bHz\b|m/s\^2|\bm\b|\bV\b|\bus\b|\brad\b|degrees|dimensionless|units of g|forcing periods|units"
)


@pytest.mark.parametrize("name", NAMES)
def test_every_public_name_is_documented(name: str) -> None:
    """Each function has its parameters (all of them), what it returns, an example, and the units of its numbers."""
    doc = inspect.getdoc(getattr(sb, name))
    assert doc is not None
    for section in ("Parameters", "Returns", "Raises", "Examples"):
        assert f"\n{section}\n{'-' * len(section)}\n" in doc, section
    listed = doc.split("Parameters\n")[1].split("Returns\n")[0]
    for parameter in inspect.signature(getattr(sb, name)).parameters:
        assert re.search(rf"^(\w+, )*\*?\*?{parameter}(, \w+)* : ", listed, re.MULTILINE), parameter
    assert UNIT.search(doc)


def test_all_names_are_there_and_no_other() -> None:
    """`dir` lists the public names, a wrong one is answered with the right ones, and the version is the package's."""
    assert dir(sb) == sorted(sb.__all__)
    with pytest.raises(AttributeError, match="close_loop"):
        sb.open_recordings  # noqa: B018
    assert isinstance(sb.__version__, str)


def test_importing_it_imports_nothing_heavy() -> None:
    """A bare import brings neither numpy nor numba nor matplotlib with it."""
    code = "import sys, shakerbench; print([m for m in ('numpy', 'numba', 'matplotlib', 'h5py') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("form", ["model/__init__.py", "model.py", "model/notes.txt"])
def test_a_package_that_shadows_one_of_ours_is_refused(form: str, tmp_path: Path) -> None:
    """Another `model` first on the path ends the import with its place, ours, and what to do."""
    (tmp_path / form).parent.mkdir(exist_ok=True)
    (tmp_path / form).write_text("", encoding="utf-8")
    code = f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]; import shakerbench"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    if form.endswith(".txt"):
        assert done.returncode == 0, done.stderr  # Python prefers a package to a bare folder
    else:
        assert done.returncode != 0
        last = done.stderr.strip().splitlines()[-1]
        assert "its own package 'model'" in last and str(tmp_path) in last and "rename" in last


def test_a_module_of_that_name_already_imported_is_refused(tmp_path: Path) -> None:
    """A `daq` that a script imported before is found as well."""
    (tmp_path / "daq.py").write_text("", encoding="utf-8")
    code = (
        f"import sys; sys.path[:0] = [{str(tmp_path)!r}]; import daq; "
        f"sys.path[:1] = [{str(ROOT)!r}]; import shakerbench"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode != 0 and "its own package 'daq'" in done.stderr


def test_the_wheel_holds_it() -> None:
    """Every package that imports one another is in the wheel, the public one and its mark of types included."""
    packages = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]
    assert set(packages["targets"]["wheel"]["packages"]) == {
        "shakerbench", "kernels", "rig", "daq", "model", "analysis", "bench",
    }  # fmt: skip
    assert (ROOT / "shakerbench" / "py.typed").is_file()


def test_flights_are_a_table_with_units(recording: Path) -> None:
    """Flights come as a data frame and as a dataset, with the same numbers and a unit for every column."""
    with sb.open_recording(recording) as opened:
        flights = sb.find_flights(opened)
    frame, data = flights.to_dataframe(), flights.to_xarray()
    assert len(frame) == flights.n_rows == data.sizes["flight"] > 50
    assert frame.attrs["units"]["takeoff_s"] == data["takeoff_s"].attrs["units"] == "s"
    np.testing.assert_array_equal(frame["duration_s"], data["duration_s"])
    assert set(frame.attrs["units"]) == set(frame.columns)


def test_the_plate_moves_as_was_asked(recording: Path) -> None:
    """The gammas measured of the plate are those of the programme within their uncertainty and the sensor's scale."""
    plate = sb.plate_motion(recording)
    np.testing.assert_allclose(plate["gamma"], [0.6, 0.9, 1.2, 1.7], rtol=0.01)
    assert plate.units["frequency_hz"] == "Hz"


def test_a_comparison_tells_its_result_and_its_steps(recording: Path) -> None:
    """Friction that the model leaves out makes the measured flights shorter: in the summary and in the dictionary."""
    held = sb.compare(recording)
    assert held.n_rows == 4 and any("shorter" in line for line in held.summary)
    assert held.to_dict()["flights_short_by"] > 0.01


def test_figures_are_drawn_on_the_axes_given(recording: Path) -> None:
    """Measured flights and the predicted diagram are drawn on one Axes, labelled with units; no backend is chosen."""
    ax = matplotlib.figure.Figure().subplots()
    diagram = sb.diagram(sb.make_ball(frequency_hz=25.37), np.linspace(0.5, 1.8, 12))
    assert diagram.plot(ax) is ax and sb.find_flights(recording).plot(ax, ms=2.0) is ax
    assert len(ax.lines) == 2 and ax.get_ylabel() == "flight time (s)"
    assert diagram.to_xarray()["tau"].sizes["gamma"] == 12


def test_bifurcations_are_those_of_the_command() -> None:
    """At c = 1 the ball takes off at gamma 0.5, gamma_peak 1."""
    found = sb.bifurcations(sb.make_ball(), 0.4, 1.0)
    assert (found["type"][0], found["gamma"][0]) == ("take-off", pytest.approx(0.5))
    assert found["gamma_peak"][0] == pytest.approx(1.0)


def test_a_prediction_follows_the_profile() -> None:
    """Each step of the ramp has its gamma and its motion; at rest no flight time."""
    told = sb.predict("simulated")
    assert (
        told["gamma"][0] == pytest.approx(0.4) and told["flights"][0] == 0 and np.isnan(told["mean_flight_time_s"][0])
    )
    assert told["mean_flight_time_s"][-1] > 0.03


def test_a_drop_is_judged(tmp_path: Path) -> None:
    """Impact times of a ball of restitution 0.9 give that restitution."""
    times = 1.0 + np.concatenate(([0.0], np.cumsum(0.4 * 0.9 ** np.arange(12))))
    path = tmp_path / "times.csv"
    path.write_text("time (s)\n" + "\n".join(f"{t:.6f}" for t in times) + "\n", encoding="utf-8")
    told = sb.drop(path)
    assert told["models"][0]["parameters"]["e0"]["value"] == pytest.approx(0.9, abs=1e-3)


def test_what_a_limit_forbids_is_not_driven(tmp_path: Path) -> None:
    """A ramp beyond the rig's limits, and a recording that exists, are refused before anything moves."""
    with pytest.raises(InputError, match="limits forbid"):
        sb.run(sb.load_profile("simulated").with_values({"ramp.gamma": [9.0]}), tmp_path / "x.h5")
    (tmp_path / "y.h5").write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match="never overwritten"):
        sb.run("simulated", tmp_path / "y.h5")


def test_a_recording_and_its_tables_print_what_they_are(recording: Path) -> None:
    """The line for a recording names its file, channels and steps; that of a table its rows and units, no numbers."""
    with sb.open_recording(recording) as opened:
        assert re.fullmatch(r"<Recording .*: continuity, accelerometer, drive; [\d.]+ s, \d+ steps>", repr(opened))
        flights = sb.find_flights(opened)
    assert repr(flights).startswith(f"<FlightTable: {flights.n_rows} rows of takeoff_s (s), landing_s (s)")


def test_errors_of_landings_are_in_microseconds(closed_loop: ClosedLoop) -> None:
    """Every column of a loop's errors that is a time says us, the ends of the intervals too."""
    units = LoopResult(closed_loop, ()).errors().units
    assert {units[name] for name in ("landing_rms_us", "landing_rms_us_low", "landing_rms_us_high")} == {"us"}


def test_it_runs_as_a_module() -> None:
    """`python -m shakerbench` is the command line."""
    done = subprocess.run(
        [sys.executable, "-m", "shakerbench", "--version"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0 and done.stdout.startswith("bench ")
