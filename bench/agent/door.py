"""The agent's door: plan, check, ramp, explore, close the loop, read the catalogue; and a person's leave for one run.

Each tool is a `bench` command or calls the function behind one, so that an agent meets the same limits as a person. An
agent names profiles, scenarios and recordings of the runs' folder, or shipped ones; it may change the keys of [ramp]
and [forcing] only. The simulated rig is free; for anything else a person arms one run of one profile, for some minutes.

The desk's page writes the file that arms; an agent's call takes it away before anything moves. It guards against an
agent that goes too far by mistake, not against a program that writes files on this machine.
"""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bench.profiles.edit import with_values
from bench.profiles.find import find_profile, find_scenario, load, planned, refusal, scenario_names, shipped_names
from bench.runs.catalogue import Catalogue, Query
from daq.files.disk import write_whole
from daq.recording.opening import same_modules
from daq.setup.errors import InputError
from rig.profile import Profile, parse_profile

FILE = Path(".shakerbench", "armed.json")
LASTS_S = 600.0


def arm(folder: Path, profile_text: str, name: str) -> None:
    """Allow one run of exactly this profile below ``folder``, for `LASTS_S` (raises InputError)."""
    path = folder / FILE
    try:
        path.parent.mkdir(exist_ok=True)
        permit = {"profile": name, "profile_sha256": _digest(profile_text), "until": time.time() + LASTS_S}
        write_whole(path, json.dumps(permit) + "\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error}); make the runs' folder writable") from error


def armed(folder: Path) -> dict[str, Any]:
    """The profile that is armed below ``folder`` and the seconds left; None and 0 where none is."""
    try:
        found = json.loads((folder / FILE).read_text(encoding="utf-8"))
        name, left_s = str(found["profile"]), float(found["until"]) - time.time()
    except (OSError, ValueError, KeyError, TypeError):
        name, left_s = "", 0.0
    return {"profile": name, "left_s": left_s} if 0.0 < left_s <= LASTS_S else {"profile": None, "left_s": 0.0}


def disarm(folder: Path) -> None:
    """Allow nothing."""
    (folder / FILE).unlink(missing_ok=True)


def take(folder: Path, profile_text: str, name: str) -> None:
    """Use up the permission to run a profile; `InputError` where none was given, or it is over, used or another's."""
    try:
        found = json.loads((folder / FILE).read_text(encoding="utf-8"))
        is_armed = found["profile_sha256"] == _digest(profile_text) and armed(folder)["profile"] is not None
        if is_armed:
            (folder / FILE).unlink()  # of two calls at one time, the second finds it gone
    except (OSError, ValueError, KeyError, TypeError):
        is_armed = False
    if not is_armed:
        raise InputError(
            f"{name}: drives real hardware, and no person has armed it; ask one to open the desk's page (bench live), "
            f"section Agent, and to arm this profile: it holds for one run within {LASTS_S / 60.0:g} minutes"
        )


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


LONGEST_S = 3600.0  # of rig time, in one call
MOST_VALUES = 1000  # numbers in one list
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
FREE = re.compile(r"(ramp|forcing)\.[a-z_]{1,40}")

Values = dict[str, Any]
Answer = dict[str, Any]
Command = Callable[[Sequence[str], Path], Answer]


def bench_command(arguments: Sequence[str], folder: Path) -> Answer:
    """The JSON that a `bench` command answers with, run in ``folder``; raises InputError with its refusal."""
    call = [sys.executable, "-m", "bench", *arguments, "--json", "-"]
    done = subprocess.run(
        call, cwd=folder, env=same_modules(), stdin=subprocess.DEVNULL, capture_output=True, encoding="utf-8",
        errors="replace", check=False,
    )  # fmt: skip
    try:
        answer: Answer = json.loads(done.stdout)
    except ValueError:
        said = done.stderr.strip() or f"ended with status {done.returncode} and said nothing"
        raise InputError(f"bench {arguments[0]}: {said[-2000:]}") from None
    return answer if done.returncode == 0 else answer | {"status": done.returncode, "said": done.stderr.strip()[-2000:]}


class Door:
    """The tools of an agent, on one folder of runs; every refusal is an InputError with a sentence.

    No call reads or writes a file outside ``folder`` that an agent names, but for what is shipped. ``command`` runs a
    `bench` command.
    """

    def __init__(self, folder: Path, command: Command = bench_command) -> None:
        if not folder.is_dir():
            raise InputError(f"--runs {folder}: no such folder; create it first, or name another")
        self.folder, self._command = folder.resolve(), command

    TOOLS = ("profiles", "catalogue", "plan", "check", "ramp", "explore", "close_loop")

    def profiles(self) -> Answer:
        """Profiles and scenarios that the other tools take: shipped ones, and those in the runs' folder."""
        own = sorted(path.name for path in self.folder.glob("*.toml"))
        return {"shipped": shipped_names(), "own": own, "scenarios": scenario_names()}

    def text_of(self, profile: str) -> str:
        """The text of a profile that an agent may name, as it is armed."""
        return self._profile(profile, None)[2]

    def catalogue(self, text: str = "", limit: int = 20) -> Answer:
        """Recordings with their verdicts, the newest first; each word of ``text`` must occur in a row."""
        catalogue = Catalogue(self.folder)
        catalogue.update()
        return {"runs": catalogue.runs(Query(text=_text(text, "text"), limit=_number(limit, "limit", 1, 1000, int)))}

    def plan(self, profile: str, values: Values | None = None) -> Answer:
        """Every step of a ramp with its peaks of drive and plate; ``values`` are keys of [ramp] and [forcing]."""
        checked, _, _ = self._profile(profile, values)
        programme, rows, faults = _planned(checked)
        steps = [asdict(step) | asdict(asked) for step, asked in rows]
        return {"seconds": programme.n_samples / programme.rate_hz, "steps": steps, "forbidden": faults}

    def check(self, profile: str, scenario: str = "") -> Answer:
        """Whether a rig is wired as its profile says; hardware must be armed by a person."""
        return self._drive("check", profile, None, self._hidden(scenario))

    def ramp(
        self, profile: str, name: str, values: Values | None = None, scenario: str = "", seed: int = 0, note: str = ""
    ) -> Answer:
        """Drive and record a ramp as ``name``.h5; free on the simulated rig, hardware must be armed by a person."""
        options = [*self._hidden(scenario), "--seed", str(_number(seed, "seed", 0, 2**31, int))]
        if note := _text(note, "note"):
            options += [f"--note={note}"]
        return self._drive("ramp", profile, values, ["--out", str(self._new(name, ".h5")), *options])

    def explore(self, profile: str, name: str, scenario: str = "", seed: int = 0, budget_s: float = 60.0) -> Answer:
        """Let the rig choose its own steps, into the folder ``name``; hardware must be armed by a person."""
        options = [*self._hidden(scenario), "--seed", str(_number(seed, "seed", 0, 2**31, int))]
        options += ["--budget", repr(_number(budget_s, "budget_s", 1.0, LONGEST_S))]
        return self._drive("explore", profile, None, ["--out", str(self._new(name, "")), *options])

    def close_loop(self, recordings: list[str]) -> Answer:
        """The verdict on recordings of one rig: what the declared model misses, by name, size and error."""
        if not isinstance(recordings, list) or not 1 <= len(recordings) <= 24:
            raise InputError("recordings: wanted a list of 1 to 24 names from the catalogue")
        return self._command(["close-loop", *(str(self._inside(name, ".h5")) for name in recordings)], self.folder)

    def _drive(self, command: str, profile: str, values: Values | None, options: Sequence[str]) -> Answer:
        """Run a command on a profile that may be driven now: within its limits, and simulated or armed by a person."""
        checked, text, base = self._profile(profile, values)
        programme, _, faults = _planned(checked)
        if faults:
            raise InputError(refusal(profile, faults))
        if programme.n_samples / programme.rate_hz > LONGEST_S:
            raise InputError(f"{profile}: the ramp lasts longer than {LONGEST_S:g} s; wanted fewer or shorter steps")
        with tempfile.TemporaryDirectory(prefix="shakerbench-") as own:  # calls may come at the same time
            file = Path(own) / "agent.toml"
            file.write_text(text, encoding="utf-8", newline="")
            if checked.backend.kind != "simulated":
                take(self.folder, base, profile)
            return self._command([command, str(file), *options], self.folder)

    def _profile(self, profile: str, values: Values | None) -> tuple[Profile, str, str]:
        """A profile with ``values`` set, its text, and the text as it was; its limits and its rig never change."""
        shipped = isinstance(profile, str) and profile in shipped_names()
        file = find_profile(profile) if shipped else self._inside(profile, ".toml")
        declared, base = load(file)
        if values is not None and not isinstance(values, dict):
            raise InputError("values: wanted keys of [ramp] and [forcing] with their values, as {'ramp.gamma': [0.9]}")
        for key, value in (values or {}).items():
            if not isinstance(key, str) or not FREE.fullmatch(key):
                raise InputError(f"values: {key!r} may not be changed; wanted keys of [ramp] and [forcing] only")
            _plain(key, value)
        try:
            text = with_values(base, values, profile) if values else base
            checked = parse_profile(text, profile)
        except (ValueError, TypeError, OverflowError) as error:
            raise InputError(f"{profile}: {error}") from error
        if len(checked.ramp.gammas()) > 2 * MOST_VALUES:
            raise InputError(f"{profile}: wanted at most {2 * MOST_VALUES} steps in one ramp")
        if (checked.limits, checked.backend, checked.channels) != (
            declared.limits,
            declared.backend,
            declared.channels,
        ):
            raise InputError(f"{profile}: limits, back end and channels may not be changed; set keys of [ramp] only")
        return checked, text, base

    def _inside(self, name: Any, ending: str) -> Path:
        """A file of the runs' folder by its path below it, links followed."""
        refused = InputError(
            f"{str(name)[:200]!r}: wanted the name of a {ending} file in the runs' folder; none is there"
        )
        if not isinstance(name, str) or not name.endswith(ending) or not name.isprintable() or len(name) > 1000:
            raise refused
        try:
            path = (self.folder / name).resolve(strict=True)
        except (OSError, RuntimeError, ValueError) as error:
            raise refused from error
        if not path.is_relative_to(self.folder) or not path.is_file():
            raise refused
        return path

    def _new(self, name: Any, ending: str) -> Path:
        """Where a new recording or folder goes."""
        if not isinstance(name, str) or not NAME.fullmatch(name):
            raise InputError(
                f"{str(name)[:80]!r}: wanted a name of 1 to 64 letters, digits, - and _ for what is recorded"
            )
        path = self.folder / f"{name}{ending}"
        if path.exists():
            raise InputError(f"{path.name}: exists already and is never overwritten; choose another name")
        return path

    def _hidden(self, scenario: Any) -> list[str]:
        """The option of a scenario, by the name of a shipped one; none for no scenario."""
        if scenario == "":
            return []
        if scenario not in scenario_names():
            raise InputError(f"{str(scenario)[:80]!r}: no such scenario; there are {', '.join(scenario_names())}")
        return ["--scenario", str(find_scenario(scenario))]


def _planned(profile: Profile) -> Any:
    """`planned`, whose refusals of numbers without meaning are InputErrors."""
    try:
        return planned(profile)
    except (ValueError, OverflowError, MemoryError, ZeroDivisionError) as error:
        raise InputError(f"{profile.name}: cannot be planned ({error}); wanted usual numbers in [ramp]") from error


def _plain(key: str, value: Any) -> None:
    """Refuse what is neither a finite number, a short word, nor a list or table of such."""
    inner = value if isinstance(value, list) else list(value.values()) if isinstance(value, dict) else [value]
    if isinstance(value, dict) and not all(isinstance(k, str) and k.isidentifier() for k in value):
        raise InputError(f"values: {key}: wanted a table with plain keys")
    for one in inner:
        is_number = isinstance(one, (int, float)) and abs(one) <= 1e6  # not NaN
        is_word = isinstance(one, str) and NAME.fullmatch(one)
        if len(inner) > MOST_VALUES or not (is_number or is_word):
            raise InputError(f"values: {key}: wanted numbers up to 1e6, at most {MOST_VALUES} of them, or a word")


def _number(value: Any, name: str, least: float, most: float, kind: type = float) -> Any:
    is_one = isinstance(value, int if kind is int else int | float) and not isinstance(value, bool)
    if not (is_one and least <= value <= most):
        word = "whole number" if kind is int else "number"
        raise InputError(f"{name}: wanted a {word} from {least:.12g} to {most:.12g}, found {str(value)[:80]!r}")
    return kind(value)


def _text(value: Any, name: str) -> str:
    if not isinstance(value, str) or len(value) > 1000 or not all(c.isprintable() for c in value):
        raise InputError(f"{name}: wanted a text of at most 1000 printable characters")
    return value
