"""The agent's door: whatever it is asked, nothing moves beyond a limit or unarmed, and every refusal is a sentence."""

from __future__ import annotations

import asyncio
import inspect
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from starlette.testclient import TestClient

from bench.agent.door import FILE, LONGEST_S, Door, arm, take
from bench.agent.section import section
from bench.profiles.find import find_profile, load, planned
from bench.web.access import Access
from bench.web.serve import Place, make_app
from daq.setup.errors import InputError


class Bench:
    """Takes the place of the commands' processes: notes what would have been started, and holds it to the rules."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.started = folder, list[tuple[str, ...]]()
        self.limits = {name: load(find_profile(name))[0].limits for name in ("simulated", "soundcard")}

    def __call__(self, arguments: Sequence[str], folder: Path) -> dict[str, Any]:
        """What a command would do, in figures."""
        assert folder == self.folder
        if arguments[0] in ("check", "ramp", "explore"):
            profile, _ = load(arguments[1])
            programme, _, faults = planned(profile)
            assert not faults and programme.n_samples / programme.rate_hz <= LONGEST_S
            assert profile.limits in self.limits.values()
            assert profile.backend.kind == "simulated", "a run on hardware that no person has armed"
            if "--out" in arguments:
                assert Path(arguments[arguments.index("--out") + 1]).parent == folder
        self.started.append(tuple(arguments))
        return {"how": "complete"}


@pytest.fixture(scope="module")
def door(tmp_path_factory: pytest.TempPathFactory) -> Door:
    """A door on a folder with a profile of real hardware, nothing armed."""
    folder = tmp_path_factory.mktemp("runs")
    (folder / "card.toml").write_bytes(find_profile("soundcard").read_bytes())
    (folder / "a.h5").write_bytes(b"no recording")
    return Door(folder, Bench(folder.resolve()))


NUMBERS = st.one_of(
    st.floats(), st.integers(-(10**9), 10**9), st.just(10**400), st.floats(0.1, 3.0), st.integers(1, 40)
)
ODD = st.one_of(NUMBERS, st.text(max_size=12), st.booleans(), st.none(), st.lists(NUMBERS, max_size=5))
VALUES = st.dictionaries(
    st.sampled_from([
        "ramp.gamma", "ramp.hold_cycles", "ramp.slew_per_cycle", "ramp.order", "forcing.ratio", "forcing.frequency_hz",
        "forcing.amplitude", "limits.drive_v", "backend.kind", "channels.accelerometer.sensitivity", "ramp", "",
        "ramp.x",
    ]),
    st.one_of(ODD, st.fixed_dictionaries({"start": NUMBERS, "stop": NUMBERS, "steps": NUMBERS})),
    max_size=3,
)  # fmt: skip
ANY_NAME = st.one_of(
    st.sampled_from(["simulated", "card.toml", "soundcard", "paper", "../card.toml", "/etc/passwd", "a.h5", "run", ""]),
    ODD,
)
CALLS = st.tuples(
    st.sampled_from(Door.TOOLS),
    st.fixed_dictionaries(
        {},
        optional={
            "profile": ANY_NAME, "name": st.one_of(st.sampled_from(["run", "../run", "a/b", "--out"]), ODD),
            "values": st.one_of(VALUES, ODD), "scenario": st.one_of(st.sampled_from(["", "friction", "../x"]), ODD),
            "seed": ODD, "budget_s": ODD, "note": ODD, "text": ODD, "limit": ODD,
            "recordings": st.one_of(st.lists(ANY_NAME, max_size=3), ODD), "armed": st.just(True),
        },
    ),
)  # fmt: skip


@settings(
    max_examples=int(os.environ.get("AGENT_CALLS", "150")), deadline=None, suppress_health_check=list(HealthCheck)
)
@given(call=CALLS)
def test_no_call_moves_anything_beyond_a_limit_or_unarmed(door: Door, call: tuple[str, dict[str, Any]]) -> None:
    """Odd names, paths, keys and numbers: what starts is simulated and within limits, all else a sentence."""
    tool, arguments = call
    try:
        asked = inspect.signature(getattr(door, tool)).bind(**arguments)
    except TypeError:
        return  # the server refuses arguments that a tool does not have
    try:
        getattr(door, tool)(*asked.args, **asked.kwargs)
    except InputError as refused:
        assert len(str(refused)) > 10 and " " in str(refused)
    assert not (door.folder / FILE).exists()


def test_hardware_runs_once_after_a_person_armed_exactly_this_profile(tmp_path: Path) -> None:
    """Unarmed it is refused; armed, one run; another profile, a later time or a second run are refused again."""
    card = tmp_path / "card.toml"
    card.write_bytes(find_profile("soundcard").read_bytes())
    started = list[Sequence[str]]()
    door = Door(tmp_path, lambda arguments, folder: started.append(arguments) or {})
    for _ in range(2):
        with pytest.raises(InputError, match="no person has armed it"):
            door.ramp("card.toml", "run")
    arm(tmp_path, load(card)[1], "card.toml")
    with pytest.raises(InputError, match="limits forbid"):
        door.ramp("card.toml", "run", {"ramp.gamma": [900.0]})
    door.ramp("card.toml", "run", {"ramp.gamma": [0.5]})
    assert [arguments[0] for arguments in started] == ["ramp"]
    with pytest.raises(InputError, match="no person has armed it"):
        door.check("card.toml")
    arm(tmp_path, load(card)[1] + "\n# changed since", "card.toml")
    with pytest.raises(InputError, match="no person has armed it"):
        door.check("card.toml")
    (tmp_path / FILE).write_text((tmp_path / FILE).read_text().replace(": 1", ": 9"))  # a time of another age
    with pytest.raises(InputError, match="no person has armed it"):
        take(tmp_path, load(card)[1] + "\n# changed since", "card")


def test_calls_at_the_same_time_share_neither_profile_nor_permission(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A refused call on hardware does not reach the profile of one that starts; one permission is for one of two."""
    (tmp_path / "card.toml").write_bytes(find_profile("soundcard").read_bytes())
    driven = list[str]()

    def start(arguments: Sequence[str], folder: Path) -> dict[str, Any]:
        with pytest.raises(InputError, match="no person has armed it"):
            door.check("card.toml")
        driven.append(load(arguments[1])[0].backend.kind)
        return {}

    door = Door(tmp_path, start)
    door.check("simulated")
    assert driven == ["simulated"]
    arm(tmp_path, "profile", "card")

    def first(folder: Path) -> dict[str, Any]:
        monkeypatch.undo()
        take(folder, "profile", "card")
        return {"profile": "card"}

    monkeypatch.setattr("bench.agent.door.armed", first)
    with pytest.raises(InputError, match="no person has armed it"):
        take(tmp_path, "profile", "card")


def test_a_person_arms_and_disarms_on_the_page(tmp_path: Path) -> None:
    """The page arms the chosen profile and says so; a name that is none is refused; another site arms nothing."""
    own = {"origin": "http://127.0.0.1:8625"}
    app = make_app(Access("127.0.0.1", 8625), [section(Place(tmp_path.resolve()))])
    with TestClient(app, base_url=own["origin"]) as page:
        assert "soundcard" in page.get("/agent").text
        assert page.post("/agent/armed", json={"profile": "soundcard"}, headers=own).json()["profile"] == "soundcard"
        take(tmp_path, load("soundcard")[1], "soundcard")
        assert page.get("/agent/armed").json()["profile"] is None
        for wrong in ({"profile": "../x.toml"}, {}, [1]):
            assert page.post("/agent/armed", json=wrong, headers=own).status_code == 422
        page.post("/agent/armed", json={"profile": "soundcard"}, headers={"origin": "http://evil.test"})
        assert page.get("/agent/armed").json()["profile"] is None
        page.post("/agent/armed", json={"profile": "soundcard"}, headers=own)
        assert page.post("/agent/armed", json={"profile": None}, headers=own).json()["profile"] is None


@pytest.mark.slow
def test_an_agent_plans_and_is_refused_over_the_protocol(tmp_path: Path) -> None:
    """`bench mcp` lists its tools over standard input and output, plans a ramp, and refuses hardware in a sentence."""
    pytest.importorskip("mcp")
    from mcp import ClientSession, StdioServerParameters
    from mcp.client.stdio import stdio_client

    async def talk() -> None:
        call = StdioServerParameters(command=sys.executable, args=["-m", "bench", "mcp", "--runs", str(tmp_path)])
        async with stdio_client(call) as (reads, writes), ClientSession(reads, writes) as session:
            await session.initialize()
            assert {tool.name for tool in (await session.list_tools()).tools} == set(Door.TOOLS)
            planned = await session.call_tool("plan", {"profile": "simulated", "values": {"ramp.gamma": [0.9, 1.2]}})
            assert not planned.is_error and '"forbidden": []' in planned.content[0].text
            refused = await session.call_tool("ramp", {"profile": "soundcard", "name": "run"})
            assert refused.is_error and "no person has armed it" in refused.content[0].text

    with ThreadPoolExecutor(1) as own:  # tests of pages leave an event loop running in this thread
        own.submit(lambda: asyncio.run(talk())).result()
    assert not (tmp_path / "run.h5").exists()
