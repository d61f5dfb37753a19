"""Open the HDF5 file of a recording, its damaged bytes put right or left out.

The bytes of a file were compared before (`daq.files.seal`). HDF5 loops, crashes or asks for all memory where a file's
own tables are damaged: a file without checksums is first read in a process that may do so, and is ended when it
hangs.
"""

from __future__ import annotations

import contextlib
import json
import os
import pkgutil
import queue
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin  # noqa: F401 (registers bitshuffle-LZ4 with HDF5)
import numpy as np
from pydantic import ValidationError

from daq.files.column_file import FORMAT, FORMAT_VERSION
from daq.files.disk import PatchedFile, in_words
from daq.files.frames.frame_file import FRAMES, as_if_ended, is_being_written, is_cut_short, stated_bytes
from daq.files.frames.marked_frames import has_marks
from daq.files.seal import Checked, check, check_tables
from daq.files.tables import BlockFlag
from daq.recording.reader import Recording
from daq.setup.errors import InputError, require_file

UNCHECKED = "recorded by an earlier version, without checksums over its tables: they are read unchecked"
SIGNATURE = b"\x89HDF\r\n\x1a\n"


def open_quickly(path: Path) -> Recording | None:
    """Open a sealed recording of which only tables, attributes and indexes are compared with the seal.

    Its samples are as safe as HDF5's own checksum of each chunk; `daq.recording.open_recording` compares them all.

    Raises `InputError` when it is not a recording, or cannot be read. None for a file without a sound seal.
    """
    require_file(path)
    found = check_tables(path)
    return None if found is None or found.seal_differs else open_checked(path, found)


def unsealed(recording: Recording, found: Checked | None, *, intact: bool) -> tuple[str, ...]:
    """Faults of a closed recording that cannot be compared with a seal."""
    if recording.frames is not None:
        return ()
    lines = [] if found is None else list(found.where)
    if not intact:
        lines.append("the root attributes differ from what was written")
    if found is None and not recording.stored.get("sealed"):
        lines.append(UNCHECKED)
    elif found is None:
        # a file that HDF5 has written to ends where HDF5's part does
        is_cut = recording.path.stat().st_size > stated_bytes(recording.path) > 0
        cut = "the file was cut off behind its samples and tables, of which nothing is missing"
        lines.append(f"its checksums are gone: {cut if is_cut else 'another program has written to it since'}")
    return tuple(lines)


def differing_blocks(recording: Recording) -> list[str]:
    """Blocks that did not fit their checksum when the recording was closed or recovered."""
    bad = np.flatnonzero(recording.blocks["flags"] & BlockFlag.DAMAGED)
    first, n = recording.blocks["first_sample"], recording.blocks["n_samples"]
    return [f"block {i}: samples {first[i]} to {first[i] + n[i] - 1} differ from what was recorded" for i in bad]


def require_hdf5(path: Path) -> None:
    """Refuse what cannot be an HDF5 file (raises InputError)."""
    require_file(path)
    try:
        with path.open("rb") as raw:
            head, tail = raw.read(len(SIGNATURE)), check(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    if head != SIGNATURE and tail is None and not h5py.is_hdf5(path) and not has_marks(path):
        raise InputError(
            f"{path}: cannot be read as HDF5 (it does not begin as one); other files become recordings with "
            f"bench import {path} --profile P.toml --out REC.h5."
        )


def open_checked(path: Path, found: Checked, *, ended: bool = False) -> Recording:
    """Open a recording whose bytes were compared with its seal, or that was read through before, or just written.

    Raises `InputError` when it is not a recording, or cannot be read.

    Parameters
    ----------
    found
        What differs: it is put right, or left out.
    ended
        Read a file that was not closed, or is shorter than it says, as if its writer had closed it as it is.
    """
    file = open_file(path, found, ended=ended)
    try:
        if file.attrs.get("format") != FORMAT:
            raise InputError(
                f"{path}: is HDF5 but not a recording of this software (attribute format is "
                f"{file.attrs.get('format')!r}); turn it into one: bench import {path} --profile P.toml --out REC.h5."
            )
        if int(file.attrs["format_version"]) > FORMAT_VERSION:
            raise InputError(f"{path}: written by a newer version (format {file.attrs['format_version']}); update.")
        return Recording(path, file, found.lost, found.where)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError) as error:
        file.close()
        if isinstance(error, InputError):
            raise
        why = in_words(error)
        if isinstance(error, ValidationError):
            first_fault = error.errors(include_url=False)[0]
            why = f"setup_json, {'.'.join(map(str, first_fault['loc'])) or 'whole'}: {first_fault['msg']}"
        raise InputError(f"{path}: damaged: {why}; run: bench verify {path}") from error


def open_file(path: Path, found: Checked, *, ended: bool = False) -> Any:
    """The HDF5 file, its damaged bytes put right (raises InputError)."""
    try:
        if found.patches:
            return h5py.File(PatchedFile(path, found.patches), "r")
        if is_being_written(path):
            return h5py.File(as_if_ended(path), "r") if ended else h5py.File(path, "r", swmr=True)
        # frames follow one another: what is left of them can be read, as if the run had ended there
        if ended and is_cut_short(path) and (frames := _frames_cut_short(path)) is not None:
            return frames
        # each open column holds the chunk that the next read begins in; by default HDF5 would drop the latest chunks,
        # and hold those that were read in part however long ago
        return h5py.File(path, "r", rdcc_nbytes=1 << 20, rdcc_w0=0.0)
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as HDF5 ({in_words(error)}).") from error


def _frames_cut_short(path: Path) -> Any:
    """A frames file that is shorter than it says; None for columns, whose tables stand at the end that is missing."""
    with contextlib.suppress(OSError, RuntimeError, KeyError):
        file = h5py.File(as_if_ended(path), "r")
        with contextlib.suppress(OSError, RuntimeError, KeyError):
            if FRAMES in file and file.attrs.get("format") == FORMAT:
                return file
        file.close()
    return None


PATIENCE_S = 2.0  # of silence, after which a process hangs

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Answer:
    """Answer of a process, or why it gave none, and the last thing that it was about to do."""

    value: Any
    died: str = ""
    at: str = ""


SERVE = "from daq.recording.opening import serve; serve()"


def same_modules() -> dict[str, str]:
    """Environment of a Python process that finds the modules of this one, not those of a folder, and speaks UTF-8."""
    places = [str(Path(entry or ".").resolve()) for entry in sys.path]
    return os.environ | {"PYTHONPATH": os.pathsep.join(places), "PYTHONSAFEPATH": "1", "PYTHONIOENCODING": "utf-8"}


def in_subprocess(function: str, *arguments: Any) -> Answer:
    """Call ``module:function`` in a process of its own.

    Raises `InputError` or `OSError` as the function did; whatever else ends it is in the answer.

    It takes ``arguments``, and a function by which it says what it is about to do, at least every `PATIENCE_S`.
    Arguments and answer are what JSON knows.
    """
    errors: list[str] = []
    said: queue.SimpleQueue[str | None] = queue.SimpleQueue()

    def pass_on() -> None:
        for line in process.stdout or ():
            said.put(line)
        said.put(None)

    with subprocess.Popen(
        [sys.executable, "-c", SERVE, function, json.dumps(arguments)],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, encoding="utf-8", errors="replace",
        env=same_modules(),
    ) as process:  # fmt: skip
        readers = [
            threading.Thread(target=pass_on, daemon=True),
            threading.Thread(target=lambda: errors.extend(process.stderr or ()), daemon=True),
        ]
        for reader in readers:
            reader.start()
        try:
            answer = _follow(said)
        finally:
            process.kill()
            for reader in readers:
                reader.join()
    if isinstance(answer.value, dict) and "refused" in answer.value:
        raise {"InputError": InputError}.get(answer.value["refused"], OSError)(answer.value["text"])
    if answer.died == "ended":
        last = next((line.strip() for line in reversed(errors) if line.strip()), "")
        return Answer(None, f"reading it ended the process ({last or f'status {process.returncode}'})", answer.at)
    return answer


def _follow(said: queue.SimpleQueue[str | None]) -> Answer:
    """Wait for the answer, as long as the process goes on."""
    at, wait_s = "", 60.0
    while True:
        try:
            line = said.get(timeout=wait_s)
        except queue.Empty:
            return Answer(None, f"reading it does not come to an end (nothing for {wait_s:g} s)", at)
        if line is None:
            return Answer(None, "ended", at)
        message = json.loads(line)
        if "answer" in message:
            return Answer(message["answer"], at=at)
        at, wait_s = message["at"], PATIENCE_S


def serve() -> None:
    """Body of the process: call what the command line names, within limits."""
    function = pkgutil.resolve_name(sys.argv[1])
    limit_memory(768 << 20)  # above what the process has when it starts

    def say(message: dict[str, Any]) -> None:
        sys.stdout.write(json.dumps(message) + "\n")
        sys.stdout.flush()

    say({"at": ""})
    try:
        say({"answer": function(*json.loads(sys.argv[2]), lambda at: say({"at": at}))})
    except (InputError, OSError) as error:
        say({"answer": {"refused": type(error).__name__, "text": str(error)}})
    os._exit(0)  # what HDF5 would do at the end of a file that is damaged is not waited for


def limit_memory(n_bytes: int) -> None:
    """Limit this process to ``n_bytes`` more than it has; on Linux only: elsewhere just a file's claims are bounded."""
    status = Path("/proc/self/statm")
    if sys.platform != "linux" or not status.exists():
        return
    import resource

    has = int(status.read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = has + n_bytes if hard == resource.RLIM_INFINITY else min(has + n_bytes, hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
