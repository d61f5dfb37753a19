"""Options that several commands have, and the check of every output path of a command, before any work.

No command writes over one of its inputs. Nor, without ``--overwrite``, over a file that is there;
a recording is never written over. Decision 102.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from daq.setup.errors import InputError

# options that several commands have
Json = Annotated[str | None, typer.Option("--json", metavar="FILE", help="The answer for a machine; - prints it.")]
Figures = Annotated[Path | None, typer.Option("--figures", metavar="FOLDER", help="Draw the pictures there.")]
Anyway = Annotated[
    bool, typer.Option("--anyway", help="Go on where a recording contradicts its profile (bench info says how).")
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace output files that are there; never an input.")]
Scenario = Annotated[Path | None, typer.Option("--scenario", metavar="FILE", help="What the simulated rig hides.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Of the simulated rig's noise.")]
RealTime = Annotated[bool, typer.Option("--real-time", help="Pace the simulated rig to the clock.")]
Live = Annotated[bool, typer.Option("--live", help="Serve a page on which it is watched, held and stopped.")]
Host = Annotated[str, typer.Option("--host", help="Of the page; other machines need the token in its address.")]
Port = Annotated[int | None, typer.Option("--port", min=0, max=65535, help="Of the page; by default a free one.")]


@dataclass(frozen=True)
class Form:
    """The format of a file, and the endings of names that fit it; ``only``: no other ending will do."""

    name: str
    suffixes: tuple[str, ...]
    only: bool = False


JSON = Form("JSON", (".json", ".txt"))
CSV = Form("a table (CSV)", (".csv", ".txt"))
PACKED_CSV = Form("a table (CSV)", (".csv", ".csv.gz", ".txt"))
NPZ = Form("arrays (NPZ)", (".npz",), only=True)
HDF5 = Form("HDF5", (".h5", ".hdf5"))
PARQUET = Form("a table (Parquet)", (".parquet", ".pq"), only=True)
NETCDF = Form("NetCDF", (".nc",), only=True)
MATLAB = Form("a MATLAB file", (".mat",), only=True)
UFF = Form("a universal file (UFF58)", (".uff", ".unv"), only=True)
TDMS = Form("TDMS", (".tdms",), only=True)
PROFILE = Form("a profile (TOML)", (".toml",))
HTML = Form("a page (HTML)", (".html", ".htm"), only=True)
PDF = Form("a page (PDF)", (".pdf",), only=True)
TABLE = Form("a table (Parquet or CSV)", (".parquet", ".csv"), only=True)
PICTURE = Form("a picture", (".png", ".pdf", ".svg"), only=True)
PYTHON = Form("an effect (Python)", (".py",), only=True)
ROWS = Form("summaries", (".rows", ".jsonl"))
NOTES = Form("notes", (".txt",))
KNOWN = {
    ".json", ".txt", ".csv", ".npz", ".h5", ".hdf5", ".parquet", ".pq", ".nc", ".mat", ".uff", ".unv", ".tdms", ".toml",
    ".html", ".htm", ".pdf", ".png", ".svg", ".py", ".rows", ".jsonl", ".csv.gz", ".gz", ".npy", ".tsv", ".dat", ".lvm",
    ".wav", ".xls", ".xlsx", ".zip", ".md", ".avi", ".mp4", ".mov", ".jpg", ".jpeg", ".tif", ".tiff",
}  # fmt: skip
"""Endings that mean a form to everybody; an ending that is not here may stand for anything."""

PICTURES = ("*.png", "*.svg")
REPORT = ("*.html", "*.json", *PICTURES)


@dataclass(frozen=True)
class File:
    """A file that a command writes."""

    option: str  # as on the command line, ``--json``
    path: Path | str | None  # None where it is not asked for; ``-`` is standard output where the form is JSON
    form: Form  # what is written
    lasting: bool = False  # never replaced, whatever ``--overwrite`` says
    continues: Callable[[Path], bool] | None = None  # whether a file that is there may be gone on with
    edited: bool = False  # a file that the command reads and changes in place


@dataclass(frozen=True)
class Folder:
    """A folder that a command fills, made where it is not there; ``makes``: patterns of the names it writes in it."""

    option: str
    path: Path | None
    makes: tuple[str, ...] = PICTURES


def check_outputs(*outputs: File | Folder, inputs: Iterable[Path | str | None] = (), overwrite: bool = False) -> None:
    """Refuse output paths that cannot be written, or would replace what must stay: an `InputError` says what to do.

    ``outputs`` are all of the command; ``inputs`` are files, folders and names of profiles that it reads. With
    ``overwrite`` files that are there may be replaced.
    """
    read = [path for given in inputs if given is not None for path in _files(given)]
    taken: list[tuple[str, Path]] = []
    for output in outputs:
        if output.path is None or (str(output.path) == "-" and isinstance(output, File) and output.form is JSON):
            continue
        path, named = Path(output.path), f"{output.option} {output.path}"
        try:
            if isinstance(output, File):
                _check_file(output, path, named, read, overwrite)
            else:
                _check_folder(output, path, named, read, overwrite)
        except (OSError, RuntimeError) as error:  # RuntimeError: links that lead to one another, before Python 3.13
            why = getattr(error, "strerror", None) or error
            raise InputError(f"{named}: cannot be written ({why}); name another place") from error
        for option, other in taken:
            if _same(path, other):
                raise InputError(f"{named}: is also what {option} writes; give each a name of its own")
        taken.append((output.option, path))


def _check_file(output: File, path: Path, named: str, read: list[Path], overwrite: bool) -> None:
    """One file: no input, no folder, a name that fits, in a folder that is there, nothing lost."""
    _refuse_input(path, named, read)
    if output.edited and not path.is_file():
        made = "make one from a shipped one: bench profile new rig.toml"
        raise InputError(f"{named}: wanted a profile's file to write into; {made}")
    if path.is_dir() or str(output.path).endswith(("/", os.sep)):
        example = path / f"result{output.form.suffixes[0]}"
        raise InputError(f"{named}: is a folder; wanted the name of a file, as {example}")
    _refuse_input(path.with_name(f"{path.name}.part"), named, read)  # where some forms grow until they are whole
    suffix, form = path.suffix.lower(), output.form
    packed = Path(path.stem).suffix.lower() + suffix if suffix == ".gz" else suffix
    if packed not in form.suffixes and (form.only or suffix in KNOWN):  # the name stands for another form
        raise InputError(f"{named}: wanted a name ending in {' or '.join(form.suffixes)}, {form.name} is written there")
    if not path.exists():
        folder = path.resolve().parent  # where a link that leads nowhere would put it
        if not folder.exists():
            raise InputError(f"{named}: the folder {folder} does not exist; create it first, or name another")
        if not folder.is_dir():
            raise InputError(f"{named}: {folder} is a file; wanted a folder")
        probe(folder)
        return
    if not path.is_file() or (output.continues is not None and output.continues(path)):
        return  # to a device or a pipe nothing is lost
    if output.lasting:
        raise InputError(
            f"{named}: exists already; recordings are never overwritten, not even with --overwrite; choose another name"
        )
    if not overwrite and not output.edited:
        raise InputError(f"{named}: exists already; choose another name, or give --overwrite to replace it")
    path.open("ab").close()  # opens for writing, changes nothing


def _check_folder(output: Folder, path: Path, named: str, read: list[Path], overwrite: bool) -> None:
    """One folder: is one or can be made, holds nothing that would be lost."""
    nearest = next((p for p in (path, *path.absolute().parents) if p.exists()), path)
    if not nearest.is_dir():
        raise InputError(f"{named}: {nearest} is a file; wanted a folder; choose another name")
    probe(nearest)
    there = sorted({p for pattern in output.makes for p in path.glob(pattern)}) if path.is_dir() else []
    for one in there:
        _refuse_input(one, named, read)
    if there and not overwrite:
        more = f" and {len(there) - 1} more" if len(there) > 1 else ""
        raise InputError(
            f"{named}: holds {there[0].name}{more} already; choose another folder, or give --overwrite to replace what "
            "is written again"
        )


def probe(folder: Path) -> None:
    """Write into ``folder`` a file without a name; raises OSError."""
    with tempfile.TemporaryFile(dir=folder):
        pass


def _refuse_input(path: Path, named: str, read: list[Path]) -> None:
    """Refuse to write what the command reads."""
    if any(_same(path, one) for one in read):
        where = "" if named.endswith(str(path)) else f"{path} in it "
        raise InputError(f"{named}: {where}is an input of this command and is never overwritten; choose another name")


def _same(a: Path, b: Path) -> bool:
    """True where two paths lead to one file, also by links, also where it does not exist."""
    if a.exists() and b.exists():
        return a.samefile(b)
    return os.path.normcase(a.resolve()) == os.path.normcase(b.resolve())


def _files(given: Path | str) -> list[Path]:
    """The files behind one input: itself, those of a folder, the shipped profile of that name."""
    path = Path(given)
    try:
        if path.is_dir():
            return [path, *(p for p in path.iterdir() if p.is_file())]
        if isinstance(given, str) and not path.exists():
            from bench.profiles.find import shipped_folder

            return [path, shipped_folder() / f"{path.name.removesuffix('.toml')}.toml"]
    except OSError:
        pass  # an input that cannot be read is refused where it is read
    return [path]
