"""The registry of back ends: options by kind, command-line options, and kinds of other packages."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType
from typing import Literal

import pytest

from bench.profiles.find import load
from daq.setup.errors import InputError
from rig.backends.kinds import base
from rig.backends.kinds.base import BackendKind, BackendOptions, OpenOptions, built_in, kind_of, names
from rig.backends.registry import open_backend
from rig.backends.simulated import SimulatedBackend
from rig.profile import Profile, parse_profile
from rig.sim.scenario import Scenario

BUILT_IN = list(built_in())


class LabOptions(BackendOptions):
    """Options of a laboratory's own back end."""

    kind: Literal["labcard"] = "labcard"
    gain: float = 1.0


def open_lab(profile: Profile, options: OpenOptions) -> SimulatedBackend:
    """The simulated rig in place of the laboratory's card, its seed taken from the gain."""
    assert isinstance(profile.backend, LabOptions)
    return SimulatedBackend(profile.sampling.rate_hz, Scenario("ideal"), round(profile.backend.gain))


@pytest.fixture
def offer(monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Entry points of other packages by name, found beside the built-in kinds."""
    module = ModuleType("our_labcard")
    module.BACKEND = BackendKind(LabOptions, "our_labcard:open_lab")  # type: ignore[attr-defined]
    module.open_lab = open_lab  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "our_labcard", module)
    offers: dict[str, str] = {}

    def entries(group: str) -> list[EntryPoint]:
        return [EntryPoint(name, value, group) for name, value in offers.items()]

    monkeypatch.setattr(base, "entry_points", entries)
    return offers


def text(table: str) -> str:
    """The simulated profile with another ``[backend]`` table."""
    whole = load("simulated")[1]
    return whole[: whole.index("[backend]")] + f"[backend]\n{table}\n"


def test_every_kind_registers_itself() -> None:
    """The kinds are found in their folder, the simulated rig first, each by the one value of its ``kind``."""
    assert {"nidaqmx", "replay", "soundcard", "soundcard+serial"} < set(BUILT_IN) <= set(names())
    assert BUILT_IN[0] == "simulated"
    for name, kind in built_in().items():
        assert kind.name == name and kind_of(name) is kind


def test_a_table_is_checked_by_the_options_of_its_kind() -> None:
    """Options are those of the kind alone; no kind is the simulated rig."""
    assert type(parse_profile(text('kind = "replay"')).backend) is built_in()["replay"].options
    assert type(parse_profile(text("block_samples = 64")).backend) is built_in()["simulated"].options
    serial = parse_profile(text('kind = "soundcard+serial"\ndevice = "c"\nport = "p"\ninputs = { drive = 4 }'))
    assert serial.backend.model_dump()["inputs"]["drive"] == 4
    with pytest.raises(InputError, match=r"backend.port: is for backend.kind = 'soundcard.serial'; .* 'soundcard'"):
        parse_profile(text('kind = "soundcard"\ndevice = "c"\nport = "p"'))


def test_an_option_that_would_not_be_heeded_is_refused(tmp_path: Path) -> None:
    """A scenario for a replay, a recording for the simulated rig: refused with the kind that takes it."""
    profile = parse_profile(text('kind = "replay"'))
    with pytest.raises(InputError, match=r'--scenario: is for backend.kind = "simulated"; this profile\'s is "replay"'):
        open_backend(profile, OpenOptions(scenario=tmp_path / "s.toml"))
    with pytest.raises(InputError, match=r'--real-time: is for backend.kind = "simulated"'):
        open_backend(profile, OpenOptions(real_time=True))
    with pytest.raises(InputError, match="name the recording to play by --replay"):
        open_backend(profile)
    with pytest.raises(InputError, match=r'--replay: is for backend.kind = "replay"'):
        open_backend(load("simulated")[0], OpenOptions(replay=tmp_path / "r.h5"))


def test_a_kind_of_another_package_is_found_by_its_entry_point(offer: dict[str, str]) -> None:
    """An entry point makes a kind: its options are checked, and its opener is called with the profile."""
    table = 'kind = "labcard"\ngain = 3.0'
    with pytest.raises(InputError, match=r"backend.kind: wanted 'simulated', .*came .labcard."):
        parse_profile(text(table))
    offer["labcard"] = "our_labcard:BACKEND"
    assert names() == [*BUILT_IN, "labcard"]
    backend = open_backend(parse_profile(text(table)))
    assert isinstance(backend, SimulatedBackend) and backend._seed == 3
    with pytest.raises(InputError, match=r"backend.gian: unknown key"):
        parse_profile(text('kind = "labcard"\ngian = 3.0'))


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("labcard", "no_such_package:BACKEND", "does not load: No module named 'no_such_package'"),
        ("labcard", "our_labcard:missing", "does not load: .*missing"),
        ("other", "our_labcard:BACKEND", "is no BackendKind of that name"),
    ],
)
def test_an_entry_point_that_leads_nowhere_is_named(offer: dict[str, str], name: str, value: str, said: str) -> None:
    """A broken package is an error of the profile that asks for it, and of no other."""
    offer[name] = value
    assert parse_profile(text("")).backend.kind == "simulated"
    with pytest.raises(InputError, match=said):
        parse_profile(text(f'kind = "{name}"'))


def test_a_built_in_kind_cannot_be_replaced(offer: dict[str, str]) -> None:
    """An entry point called as a built-in kind is passed over."""
    offer["simulated"] = "our_labcard:BACKEND"
    assert names() == BUILT_IN and kind_of("simulated") is built_in()["simulated"]
