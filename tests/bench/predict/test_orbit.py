"""`bench predict`: the contract that scripts rely on, and what it refuses."""

from __future__ import annotations

import json
import math
import subprocess
import sys

import h5py
import pytest
from typer.testing import CliRunner

from bench.cli import app

KEYS = ["c", "gamma", "kind", "period", "flights", "resets", "locked", "tau", "flight_time_s"]


def predict(*arguments, code=0):
    """Run the command in process; returns what it wrote to standard output."""
    result = CliRunner().invoke(app, ["predict", *map(str, arguments)])
    assert result.exit_code == code, result.output
    return result.stdout if code == 0 else result.stderr


def test_standard_output_carries_the_json_alone():
    """A real process: the paper's 3-cycle, exactly the documented keys, nothing else on standard output."""
    bench = [sys.executable, "-c", "from bench.cli import main; main()"]
    call = [*bench, "predict", "--c", "2", "--gamma", "1.28", "--json", "-"]
    run = subprocess.run(call, capture_output=True, text=True, check=True)
    found = json.loads(run.stdout)
    assert list(found) == KEYS
    assert [found[k] for k in KEYS[:7]] == [2, 1.28, "periodic", 2, 3, 1, False]
    assert sorted(round(t, 6) for t in found["tau"]) == [2.506845, 2.758548, 7.053544]
    assert found["flight_time_s"] is None


def test_seconds_come_with_a_frequency():
    """T = tau / (2 pi f), one for each flight; gamma_peak stands for gamma at c = 1."""
    found = json.loads(predict("--gamma-peak", 1.5, "--frequency-hz", 20, "--json", "-"))
    assert found["gamma"] == 0.75
    assert found["flight_time_s"] == pytest.approx([3.566217 / (40 * math.pi)], abs=1e-8)


def test_below_take_off_is_no_flight():
    """The plain motion with the plate."""
    found = json.loads(predict("--gamma", 0.3, "--json", "-"))
    assert (found["kind"], found["period"], found["flights"], found["tau"]) == ("periodic", 1, 0, [])


def test_a_range_that_begins_at_take_off_begins_with_the_lock():
    """What happens at the very start of a range is not a change within it: the documented list begins with the lock."""
    found = json.loads(predict("--gamma-range", 0.5, 1.7, "--bifurcations", "--json", "-"))
    assert [b["type"] for b in found] == ["lock"]


def test_bifurcations_are_listed_in_order():
    """The documented keys, ascending, with the lock of the documentation; the published events among them."""
    found = json.loads(predict("--gamma-range", 0.4, 2.4, "--bifurcations", "--json", "-"))
    assert all(list(b) == ["gamma", "gamma_peak", "type", "period_before", "period_after"] for b in found)
    assert [b["gamma"] for b in found] == sorted(b["gamma"] for b in found)
    told = [(b["type"], round(b["gamma_peak"], 6), b["period_before"], b["period_after"]) for b in found]
    assert told == [
        ("take-off", 1.0, 1, 1),
        ("lock", 3.296908, 1, 1),
        ("period doubling", 3.724192, 1, 2),
        ("stick gained", 3.856854, 2, 2),
        ("flight lost", 4.603339, 2, 2),
    ]


def test_effects_move_the_bifurcations():
    """Friction 0.3 in both directions: take-off at 1.3, lock at the published 4.0564."""
    found = json.loads(
        predict("--gamma-range", 0.4, 2.2, "--bifurcations", "--effect", "coulomb_friction.mu=0.3", "--json", "-")
    )
    peaks = {b["type"]: b["gamma_peak"] for b in found}
    assert peaks["take-off"] == pytest.approx(1.3, abs=1e-9)
    assert peaks["lock"] == pytest.approx(4.0564, abs=6e-5)


@pytest.mark.parametrize("sweep", ["up", "down"])
def test_a_sweep_lists_its_events_in_its_own_order(sweep):
    """Up and down through lock and doubling of one sine."""
    found = json.loads(predict("--gamma-range", 1.5, 1.9, "--bifurcations", "--sweep", sweep, "--json", "-"))
    kinds = [b["type"] for b in found]
    assert kinds == (["lock", "period doubling"] if sweep == "up" else ["period doubling", "stick gained"])
    doubling = next(b for b in found if b["type"] == "period doubling")
    assert doubling["gamma_peak"] == pytest.approx(math.sqrt(math.pi**2 + 4), abs=2e-9)


def test_a_diagram_goes_to_hdf5_picture_and_json(tmp_path):
    """One call writes all three; the file names its columns; a second call with other options is refused."""
    out, figure, answer = tmp_path / "d.h5", tmp_path / "d.png", tmp_path / "d.json"
    call = ["--c", 2, "--gamma-range", 0.2, 1.2, "--steps", 50, "--out", out]
    predict(*call, "--figure", figure, "--json", answer)
    with h5py.File(out) as file:
        assert file["tau"].shape[0] == file["gamma"].shape[0] == 50
        assert bool(file["chunk_done"][:].all())
    assert figure.read_bytes()[:4] == b"\x89PNG"
    assert len(json.loads(answer.read_text())) == 50
    assert "another job" in predict(*call[:-3], 60, "--out", out, code=2)


def test_an_adaptive_diagram_has_more_rows(tmp_path):
    """The rows beyond the grid lie where the attractor changes."""
    out = tmp_path / "a.h5"
    predict("--gamma-range", 1.7, 1.9, "--steps", 20, "--adaptive", "--out", out)
    with h5py.File(out) as file:
        assert file["gamma"].shape[0] > 20


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "one of --gamma"),
        (["--gamma", "1", "--gamma-peak", "2"], "one of --gamma"),
        (["--c", "2", "--gamma-peak", "2"], "--c 1"),
        (["--gamma", "nan"], "not negative"),
        (["--gamma", "1", "--effect", "restitution"], "name.parameter=number"),
        (["--gamma", "1", "--effect", "restitution.e=0.5"], "no parameter"),
        (["--gamma", "1", "--effect", "restitutoin.e0=0.5"], "restitution"),
        (["--gamma", "1", "--effect", "restitution.e0=1.5"], "outside"),
        (["--gamma", "1", "--effect", "viscous_damping.rate_per_s=2"], "--frequency-hz"),
        (["--gamma", "1", "--effect", "drive_gain.relative=0.1"], "drive or an instrument"),
        (["--gamma", "1", "--sweep", "sideways"], "up or down"),
        (["--gamma", "1", "--phase-deg", "180"], "cancel"),
        (["--gamma", "1", "--phase-deg", "nan"], "--phase-deg wants a number"),
        (["--gamma-range", "2", "1", "--bifurcations"], "range"),
        (["--gamma-range", "1", "2"], "--out"),
        (["--profile", "simulated", "--figure", "x.png"], "--figure x.png: this call writes no such file"),
        (["--profile", "simulated", "--out", "x.h5"], "--gamma-range FROM TO --out x.h5"),
        (["--gamma", "1", "--figure", "x.png"], "--figure x.png: this call writes no such file"),
        (["--gamma-range", "1", "2", "--bifurcations", "--out", "x.h5"], "--bifurcations writes no such file"),
        (["--gamma", "1e300"], "beyond what double precision proves"),
        (["--c", "1000000", "--gamma", "1"], "c = 79577"),
        (["--gamma-range", "1", "2", "--steps", "2000000000", "--json", "-"], "at most 1,000,000"),
        (["--gamma-range", "1", "2", "--steps", "200000", "--json", "-"], "as JSON at most 100000"),
        (["--gamma-range", "1", "2", "--steps", "50000", "--adaptive", "--json", "-"], "at most 20,000"),
        (["--gamma-range", "1", "2", "--grid", "restitution.e0=0:0.9:1000000000", "--json", "-"], "at most 1,000,000"),
    ],
)
def test_a_wrong_call_says_what_to_do(arguments, said):
    """Exit status 2 and one line to act on."""
    assert said in predict(*arguments, code=2)


def test_an_output_that_is_no_diagram_is_refused_and_kept(tmp_path):
    """A file that is not HDF5, named by --out, is refused with its name and stays as it was."""
    other = tmp_path / "notes.h5"
    other.write_text("notes", encoding="utf-8")
    said = predict("--gamma-range", 1, 2, "--steps", 4, "--out", other, code=2)
    assert f"--out {other}: exists already" in said
    assert other.read_text(encoding="utf-8") == "notes"
