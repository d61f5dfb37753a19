"""What the gates remember and when they close, without a browser."""

from __future__ import annotations

import asyncio
import json
import multiprocessing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bench.gates import desk
from bench.gates.desk import Gates
from bench.gates.state import FILE, GATES, Result, State, changed, inputs_of, load_state, now, view_of
from bench.gates.work import Job
from bench.live.pages import Desk
from bench.profiles.edit import with_values
from daq.setup.errors import InputError
from rig.programme.ramp import peaks
from tests.bench.gates.passed import passed


def opened(folder: Path) -> Gates:
    """The gates of a folder, as a server that has just started has them."""
    gates = Gates(folder, Desk(None), None)
    gates.read_profile()
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


def test_state_outlives_the_server(tmp_path: Path) -> None:
    """What was saved is read again as it was."""
    state = passed(tmp_path, scenario="friction", queue=({"note": ""},), undo=("a",), rounds=({"recording": "a.h5"},))
    assert load_state(tmp_path) == (state, "")


@pytest.mark.parametrize(
    "content", [b"{", b"[]", b"\xff", b'{"profile": 3}', b'{"run": 5}', b'{"results": {"card": 1}}']
)
def test_a_file_that_is_no_state_is_set_aside(tmp_path: Path, content: bytes) -> None:
    """The page says where the broken file is now; a second one does not replace the first; the gates begin anew."""
    for n in (1, 2):
        (tmp_path / FILE).write_bytes(content)
        gates = opened(tmp_path)
        assert gates.state == State() and f"{FILE}.unreadable-{n}" in view_of(gates)["fault"]
        assert (tmp_path / f"{FILE}.unreadable-{n}").read_bytes() == content and not (tmp_path / FILE).exists()


def test_a_refusal_is_the_last_word(tmp_path: Path) -> None:
    """A browser is sent why it was refused after the state, which would replace it on the page."""
    said: list[str] = []
    passed(tmp_path)
    gates, browser = opened(tmp_path), SimpleNamespace(name="a", reads_only=False, send=lambda m, **_: said.append(m))
    gates.live.hub.browsers.append(browser)  # type: ignore[arg-type]
    gates._obey(browser, {"do": "start", "hands_off": True})  # type: ignore[arg-type]
    assert [json.loads(one)["kind"] for one in said] == ["gates", "refused"]
    assert "holds the controls" in said[-1]


def test_a_profile_changed_in_an_editor_closes_the_ramp(tmp_path: Path) -> None:
    """A ramp is driven only with the file that was checked, though the page has not seen it change."""
    passed(tmp_path)
    gates = opened(tmp_path)
    text = (tmp_path / "rig.toml").read_text(encoding="utf-8")
    (tmp_path / "rig.toml").write_text(with_values(text, {"limits.drive_v": 9.0}, "rig.toml"), encoding="utf-8")
    with pytest.raises(InputError, match="closed until check is green"):
        gates._start_run({"hands_off": True})


@pytest.mark.parametrize(("key", "text", "why"), [("ramp.gamma", "[9.0, 90.0]", "closed until"),
                                                  ("ramp.hold_cycles", "100000000", "would end after")])  # fmt: skip
def test_a_ramp_that_cannot_be_is_refused_before_its_process_begins(
    tmp_path: Path, key: str, text: str, why: str
) -> None:
    """A ramp beyond what was checked, or one of months, is refused in words, and no run is under way."""
    passed(tmp_path)
    gates = opened(tmp_path)
    gates._set({"key": key, "text": text})
    with pytest.raises(InputError, match=why):
        gates._start_run({"hands_off": True})
    assert gates.state.run is None and gates.live.watch is None


def test_a_disk_that_refuses_a_result_is_named_and_ends_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the result of a job cannot be saved the page says so, and goes on looking at jobs and runs."""
    passed(tmp_path)
    gates = opened(tmp_path)
    ours, theirs = multiprocessing.Pipe()
    theirs.send(("done", {"rows": []}))

    def refuse(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(desk, "save_state", refuse)
    gates._pipe, gates.job = ours, {"gate": "check", "kind": "", "words": "", "asks": False}

    async def tick() -> None:
        task = asyncio.create_task(gates._tick_for_ever())
        await asyncio.sleep(0)
        assert not task.done()
        task.cancel()

    asyncio.run(tick())
    assert gates.fault == "disk full" and gates.job is None


def test_a_long_ramp_is_drawn_with_its_highest_peaks(tmp_path: Path) -> None:
    """Of a thousand steps, several are drawn as one: the highest is among them, and the whole time is covered."""
    passed(tmp_path)
    gates = opened(tmp_path)
    gammas = [0.5] * 1000
    gammas[700] = 2.0
    gates._set({"key": "ramp.gamma", "text": str(gammas)})
    plan = view_of(gates)["plan"]
    steps, highest = plan["steps"], peaks(gates._known(), 2.0)
    assert len(steps) <= 400 < plan["n_steps"] and steps[-1][1] == pytest.approx(plan["duration_s"])
    assert max(step[2] for step in steps) == pytest.approx(highest.drive_v)


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


def test_a_new_profile_never_takes_the_name_of_one_that_is_there(tmp_path: Path) -> None:
    """A profile of that name stays as it is, and the new one takes the next name; one of the folder is taken itself."""
    (tmp_path / "my-simulated.toml").write_text("mine", encoding="utf-8")
    gates = opened(tmp_path)
    gates._choose({"like": "simulated"})
    assert gates.state.profile == "my-simulated-2.toml" and gates._known().name == "my-simulated-2"
    assert (tmp_path / "my-simulated.toml").read_text(encoding="utf-8") == "mine"
    gates._choose({"like": str(tmp_path / "my-simulated-2.toml")})
    assert len(gates.profiles()) == 2


@pytest.mark.parametrize("how", ["complete", "failed"])
def test_a_repetition_that_is_not_driven_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    """Where a queue cannot go on, it is emptied, and the ramp's rows say how many runs were not driven, and why."""
    passed(tmp_path, queue=({"note": ""}, {"note": ""}))
    gates = opened(tmp_path)
    inputs = inputs_of("ramp", gates._known(), gates.rig, gates.state.device)
    gates.state = replace(gates.state, run={"out": "a.h5", "inputs": inputs})
    (tmp_path / "a.h5").touch()
    monkeypatch.setattr(gates.live, "outcome_of", lambda _: {"how": how, "why": ""})
    monkeypatch.setattr(gates.live, "start", lambda *_: (_ for _ in ()).throw(InputError("the disk is full")))
    gates._look_at_run()
    (_, row) = gates.state.results["ramp"].rows
    assert row["seen"].startswith("2 not driven: ") and not gates.state.queue and gates.state.run is None
    assert ("the disk is full" in row["seen"]) == (how == "complete")


def test_a_verdict_never_replaces_an_improved_profile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An improved profile that is there, of rounds before another rig was chosen, stays; the next number is taken.

    The job's process may have children: a calibration on a device records by a process of its own.
    """
    jobs: list[Job] = []

    def started(body: Any, job: Job, **more: Any) -> tuple[Any, SimpleNamespace]:
        assert not more.get("daemon")
        jobs.append(job)
        return multiprocessing.Pipe()[0], SimpleNamespace()

    monkeypatch.setattr(desk, "spawned", started)
    (tmp_path / "rig-improved-1.toml").write_text("mine", encoding="utf-8")
    passed(tmp_path)
    gates = opened(tmp_path)
    inputs = inputs_of("ramp", gates._known(), gates.rig, gates.state.device)
    gates.state = gates.state.passed("ramp", Result(True, inputs, now(), file="a.h5"))
    gates._start_job({"gate": "verdict"})
    assert jobs[0].improved == tmp_path / "rig-improved-2.toml" and jobs[0].recording == tmp_path / "a.h5"


@pytest.mark.parametrize("torn", [False, True])
def test_a_profile_that_cannot_be_offered_is_a_fault_on_the_page(tmp_path: Path, torn: bool) -> None:
    """The server starts with a broken profile, and the page says what is wrong with it, and with a torn state."""
    (tmp_path / "broken.toml").write_text("rate", encoding="utf-8")
    (tmp_path / "runs").mkdir()
    if torn:
        (tmp_path / "runs" / FILE).write_text("{", encoding="utf-8")
    gates = Gates(tmp_path / "runs", Desk(None), str(tmp_path / "broken.toml"))

    async def start() -> None:
        async with gates.running():
            pass

    asyncio.run(start())
    assert "not valid TOML" in gates.fault and ("unreadable" in gates.fault) == torn


def test_changes_are_named() -> None:
    """Differences of two inputs are named by their keys."""
    assert changed({"a": {"b": 1, "c": 2}}, {"a": {"b": 1, "c": 3, "d": 4}, "e": 5}) == ["a.c", "a.d", "e"]
