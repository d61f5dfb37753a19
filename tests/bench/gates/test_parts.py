"""What the gates remember and when they close, without a browser."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bench.gates.desk import Gates
from bench.gates.inputs import GATES, changed
from bench.gates.state import FILE, State, load_state
from bench.gates.view import view_of
from bench.live.pages import Desk
from daq.setup.errors import InputError
from tests.bench.gates.passed import passed


def opened(folder: Path) -> Gates:
    """The gates of a folder, as a server that has just started has them."""
    gates = Gates(folder, Desk(None), None)
    gates._read_profile()
    return gates


@pytest.mark.parametrize(
    ("key", "text", "closed", "named"),
    [
        ("sampling.rate_hz", "25000", "card", ["sampling.rate_hz"]),
        ("channels.accelerometer.range_v", "5.0", "wiring", ["wires.accelerometer.range_v"]),
        ("ball.mass_kg", "0.3", None, []), ("limits.drive_v", "9.0", "check", ["limits.drive_v"]),
        ("channels.accelerometer.sensitivity.value", "0.11", "calibrate",
         ["channels.accelerometer.sensitivity.value"]),
    ],
)  # fmt: skip
def test_a_changed_input_closes_its_gate_and_all_later_ones(
    tmp_path: Path, key: str, text: str, closed: str | None, named: list[str]
) -> None:
    """An edited key closes the gate that was passed with it; undo makes it green again; the page names the key."""
    passed(tmp_path)
    gates = opened(tmp_path)
    assert all(gates.is_green(gate) for gate in GATES[:4]) and not gates.is_green("ramp")
    gates._set({"key": key, "text": text})
    shown = view_of(gates)["gates"]
    states = [one["state"] for one in shown[:4]]
    at = 4 if closed is None else GATES.index(closed)
    assert states == ["green"] * at + ["open"] * (at < 4) + ["closed"] * (3 - at)
    if closed is not None:
        assert shown[at]["since"] == named
    gates._undo({})
    assert all(gates.is_green(gate) for gate in GATES[:4])
    assert (tmp_path / "rig.toml").read_text(encoding="utf-8") == Path("rig_profiles/simulated.toml").read_text("utf-8")


def test_another_device_closes_the_wiring(tmp_path: Path) -> None:
    """A card that is not the one found before closes every gate after the first."""
    passed(tmp_path)
    gates = opened(tmp_path)
    gates.state = replace(gates.state, device={"name": "another card"})
    assert gates.is_green("card") and not any(gates.is_green(gate) for gate in GATES[1:])


def test_state_outlives_the_server_and_a_torn_file_is_set_aside(tmp_path: Path) -> None:
    """What was saved is read again as it was; a file that is no state leaves a new one, and is not lost."""
    state = passed(tmp_path, scenario="friction", queue=({"note": ""},), undo=("a",), rounds=({"recording": "a.h5"},))
    assert load_state(tmp_path) == state
    (tmp_path / FILE).write_text("{", encoding="utf-8")
    assert load_state(tmp_path) == State()
    assert (tmp_path / f"{FILE}.unreadable").read_text(encoding="utf-8") == "{"


@pytest.mark.parametrize("said", [{}, {"hands_off": 1}, {"hands_off": "true"}])
def test_no_ramp_without_hands_off_or_before_the_check(tmp_path: Path, said: dict[str, Any]) -> None:
    """A ramp is refused until it was said that hands are off, and while a gate before it is not green."""
    passed(tmp_path)
    gates = opened(tmp_path)
    with pytest.raises(InputError, match="hands are off"):
        gates._start_run(said)
    gates._set({"key": "limits.drive_v", "text": "9.0"})
    with pytest.raises(InputError, match="closed until check is green"):
        gates._start_run({"hands_off": True})
    with pytest.raises(InputError, match="closed until check is green"):
        gates._start_job({"gate": "verdict", "kind": ""})


def test_scales_that_were_never_calibrated_are_taken_only_when_that_is_said(tmp_path: Path) -> None:
    """A shipped sound card's scales have no date: they are refused, and taken when the person insists."""
    passed(tmp_path, like="soundcard")
    gates = opened(tmp_path)
    with pytest.raises(InputError, match=r"channels.accelerometer.sensitivity.*not calibrated"):
        gates._accept({})
    gates._accept({"anyway": True})
    assert gates.is_green("calibrate")


@pytest.mark.parametrize("like", ["../outside", "nothing", ""])
def test_only_profiles_of_the_folder_are_chosen(tmp_path: Path, like: str) -> None:
    """A name that is no profile of the folder is refused."""
    with pytest.raises(InputError):
        opened(tmp_path)._choose({"profile": like})


def test_changes_are_named() -> None:
    """Differences of two inputs are named by their keys."""
    assert changed({"a": {"b": 1, "c": 2}}, {"a": {"b": 1, "c": 3, "d": 4}, "e": 5}) == ["a.c", "a.d", "e"]
