"""No command writes where it must not: every output option of every command, found by looking at the commands."""

from __future__ import annotations

import contextlib
import inspect
import os
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from bench.cli import COMMANDS, app
from bench.outputs import CSV, HDF5, JSON, PACKED_CSV, PICTURE, File, Folder, check_outputs
from daq.setup.errors import InputError

READ = {
    "profile", "profiles", "scenario", "replay", "resume", "recording", "recordings", "raw", "files", "like", "name",
    "folder", "places", "runs", "balls",
}  # fmt: skip
"""Parameters that name what a command reads."""
STEERS = {
    "note", "set_", "mapping", "channel", "channel_column", "server", "effect", "sweep", "grid", "cluster",
    "use_height", "stale", "kind", "do", "until", "ratios", "frequencies", "profile_name", "tag", "tags", "text",
    "verdict", "ended", "since", "sort", "host", "device", "what_if",
}  # fmt: skip
"""Texts that name no file. A text or path that is in neither list is an output, and has to be checked."""
NAMES = {
    ("batch", "out"): "x.csv",
    ("export", "out"): "x.csv",
    ("predict", "figure"): "x.png",
    ("report", "out"): "x.html",
    ("report", "pdf"): "x.pdf",
    ("virtual", "log"): "x.npz",
}
"""What an output has to be called where not every name will do."""


def leaves(group: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command below ``group`` that does something, with the words that call it."""
    for name in group.list_commands(None):
        found = group.get_command(None, name)
        if hasattr(found, "list_commands"):
            yield from leaves(found, (*words, name))
        else:
            yield (*words, name), found


LEAVES = dict(leaves(typer.main.get_command(app)))


def texts(command: Any) -> list[Any]:
    """The parameters of a command that take a text or a path."""
    hints = typing.get_type_hints(inspect.unwrap(command.callback))
    return [p for p in command.params if {str, Path} & set(parts(hints.get(p.name)))]


def parts(hint: Any) -> Iterator[Any]:
    """A type, and the types that it is made of."""
    yield hint
    for inner in typing.get_args(hint):
        yield from parts(inner)


OUTPUTS = [
    pytest.param(words, p.name, id=f"{' '.join(words)} {p.name}")
    for words, command in LEAVES.items()
    for p in texts(command)
    if p.name not in READ | STEERS
]


def call(words: tuple[str, ...], values: dict[str, str], folder: Path, *more: str) -> Any:
    """Run a command with the given values; other inputs are not there, other outputs are good ones in ``folder``."""
    (folder / "new").mkdir(exist_ok=True)
    (folder / "new" / "into.toml").write_text("a profile", encoding="utf-8")
    out = folder / "new" / NAMES.get((words[-1], "out"), "x.h5")
    fillers = {"kind": "accelerometer", "into": str(folder / "new" / "into.toml"), "out": str(out)}
    arguments: list[str] = []
    for p in LEAVES[words].params:
        value = values.get(p.name)
        if value is None and (p.required or (words, p.name) == (("recover",), "out")):
            value = fillers.get(p.name, "none.h5")
        if value is not None:
            arguments += [value] if p.param_type_name == "argument" else [p.opts[0], value]
    return CliRunner().invoke(app, [*words, *arguments, *more])


def more_for(words: tuple[str, ...]) -> list[str]:
    """``--overwrite`` where the command has it."""
    return ["--overwrite"] if any(p.name == "overwrite" for p in LEAVES[words].params) else []


def test_the_walk_finds_the_commands() -> None:
    """Every registered command is walked over, and known outputs are among those found."""
    assert {words[0] for words in LEAVES} == set(COMMANDS)
    found = {tuple(p.values) for p in OUTPUTS}
    assert {(("reprocess",), "flights"), (("profile", "new"), "out"), (("drop",), "into")} <= found
    assert len(found) > 30


@pytest.mark.parametrize(("words", "name"), OUTPUTS)
def test_an_output_without_a_folder_is_refused_first(words: tuple[str, ...], name: str, tmp_path: Path) -> None:
    """A path below a file is refused with its name and status 2, before the command misses its inputs."""
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    bad = tmp_path / "file" / "folder" / NAMES.get((words[-1], name), "x")
    result = call(words, {name: str(bad)}, tmp_path, *more_for(words))
    assert result.exit_code == 2, result.output
    assert str(bad) in result.stderr and "none.h5" not in result.stderr.replace(str(bad), "")


@pytest.mark.parametrize(("words", "name"), OUTPUTS)
def test_no_input_is_written_over(words: tuple[str, ...], name: str, tmp_path: Path) -> None:
    """An output that names an input, or a link to it, is refused even with --overwrite, and nothing changes."""
    victim = tmp_path / NAMES.get((words[-1], name), "victim.toml")
    victim.write_text("mine", encoding="utf-8")
    hard, soft = tmp_path / f"hard{victim.suffix}", tmp_path / f"soft{victim.suffix}"
    os.link(victim, hard)
    links = [victim, hard]
    with contextlib.suppress(OSError):  # Windows lets not everybody make symbolic links
        soft.symlink_to(victim)
        links.append(soft)
    for read in (p.name for p in texts(LEAVES[words]) if p.name in READ):
        for out in links:
            result = call(words, {read: str(victim), name: str(out)}, tmp_path, *more_for(words))
            assert result.exit_code == 2, (read, out, result.output)
            assert str(out) in result.stderr
    assert victim.read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(("words", "name"), OUTPUTS)
def test_no_file_is_replaced_in_silence(words: tuple[str, ...], name: str, tmp_path: Path) -> None:
    """A file that is there is kept, and named, as long as nobody gives --overwrite; --into is there to be changed."""
    there = tmp_path / NAMES.get((words[-1], name), "there")
    there.write_text("mine", encoding="utf-8")
    result = call(words, {name: str(there)}, tmp_path)
    assert result.exit_code == 2, result.output
    assert name == "into" or str(there) in result.stderr
    assert there.read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize("words", [w for w in LEAVES if any(p.values[0] == w for p in OUTPUTS)], ids=" ".join)
def test_every_command_that_writes_files_can_be_told_to_replace_them(words: tuple[str, ...]) -> None:
    """--overwrite is an option wherever there is an output, but for the demo, whose folder is always new."""
    assert bool(more_for(words)) == (words != ("demo",))


def refused(*outputs: File | Folder, **options: Any) -> str:
    """The words with which outputs are refused; empty where they are taken."""
    try:
        check_outputs(*outputs, **options)
    except InputError as error:
        return str(error)
    return ""


def test_what_a_file_may_be_called(tmp_path: Path) -> None:
    """A name that stands for another form is refused with those that fit; one that stands for nothing is taken."""
    for form, name, taken in (
        (HDF5, "x.csv", False), (HDF5, "x.h5", True), (HDF5, "x.hdf5", True), (HDF5, "x", True), (HDF5, "x.rec", True),
        (CSV, "x.npz", False), (CSV, "x.csv.gz", False), (PACKED_CSV, "x.csv.gz", True), (PACKED_CSV, "x.h5.gz", False),
        (JSON, "x.H5", False), (JSON, "x.JSON", True), (PICTURE, "x.toml", False), (PICTURE, "x", False),
        (PICTURE, "x.svg", True),
    ):  # fmt: skip
        said = refused(File("--out", tmp_path / name, form))
        assert (said == "") is taken, (name, said)
        assert taken or f"wanted a name ending in {form.suffixes[0]}" in said


def test_folders_files_and_twins(tmp_path: Path) -> None:
    """A folder for a file, a file for a folder, two outputs in one, and pictures that are there: each has its words."""
    (tmp_path / "a").mkdir()
    (tmp_path / "f").write_text("mine", encoding="utf-8")
    assert "is a folder; wanted the name of a file" in refused(File("--json", tmp_path / "a", JSON))
    assert "is a folder; wanted the name of a file" in refused(File("--json", f"{tmp_path}/new/", JSON))
    assert "is a folder" in refused(File("--json", "", JSON))
    assert "does not exist; create it first" in refused(File("--json", tmp_path / "b" / "x.json", JSON))
    assert "is a file; wanted a folder" in refused(Folder("--figures", tmp_path / "f" / "pictures"))
    assert refused(Folder("--figures", tmp_path / "b" / "c" / "d")) == ""
    twins = File("--flights", tmp_path / "x", CSV), File("--json", tmp_path / "a" / ".." / "x", JSON)
    assert "is also what --flights writes" in refused(*twins)
    (tmp_path / "a" / "plate.png").write_bytes(b"mine")
    assert "holds plate.png already" in refused(Folder("--figures", tmp_path / "a"))
    assert refused(Folder("--figures", tmp_path / "a"), overwrite=True) == ""
    same = refused(Folder("--figures", tmp_path / "a"), inputs=[tmp_path / "a" / "plate.png"], overwrite=True)
    assert "plate.png in it is an input of this command" in same
    assert refused(Folder("--out", tmp_path / "a", makes=())) == ""


def test_what_is_kept_and_what_may_be_replaced(tmp_path: Path) -> None:
    """A recording stays even with --overwrite, other files only without it; standard output and devices are taken."""
    there = tmp_path / "there.h5"
    there.write_bytes(b"mine")
    assert "never overwritten" in refused(File("--out", there, HDF5, lasting=True), overwrite=True)
    assert "--overwrite to replace it" in refused(File("--out", there, HDF5))
    assert refused(File("--out", there, HDF5), overwrite=True) == ""
    assert refused(File("--out", there, HDF5, continues=lambda path: True)) == ""
    assert there.read_bytes() == b"mine"
    assert refused(File("--json", "-", JSON), File("--json", None, JSON), File("--json", os.devnull, JSON)) == ""


def test_a_missing_input_is_no_name_for_an_output(tmp_path: Path) -> None:
    """An output that will be an input, once somebody makes that, is refused too."""
    assert "is an input" in refused(File("--json", tmp_path / "r.h5", JSON), inputs=[tmp_path / "r.h5"])
    assert "is an input" in refused(File("--out", tmp_path / "r.h5", HDF5), inputs=[tmp_path / "r.h5.part"])


def test_a_shipped_profile_is_an_input_by_its_name() -> None:
    """The file behind a shipped name is not written over."""
    from bench.profiles.find import shipped_folder

    path = shipped_folder() / "simulated.toml"
    assert "is an input" in refused(File("--json", path, JSON), inputs=["simulated"], overwrite=True)


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    """A name that is too long is refused by name, not by a traceback."""
    path = tmp_path / ("x" * 5000)
    assert str(path) in refused(File("--json", path, JSON))
    assert str(path) in refused(Folder("--figures", path))
