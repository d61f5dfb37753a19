"""Call of a function in a process of its own, which is ended when it hangs.

HDF5 loops, crashes or asks for all memory where a file's own tables are damaged. A file without checksums is first read
in a process that may do so.
"""

from __future__ import annotations

import contextvars
import importlib
import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daq.setup.errors import InputError

PATIENCE_S = 2.0  # of silence, after which a process hangs

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Answer:
    """Answer of a process, or why it gave none, and the last thing that it was about to do."""

    value: Any
    died: str = ""
    at: str = ""


SERVE = "from daq.recording.subprocess_reader import serve; serve()"


_HERE = contextvars.ContextVar("_HERE", default=False)


@contextmanager
def read_here() -> Iterator[None]:
    """Call in this process for the length of a block: for a simulation, of files that HDF5 survives (decision 461)."""
    before = _HERE.set(True)
    try:
        yield
    finally:
        _HERE.reset(before)


def same_modules() -> dict[str, str]:
    """Environment of a Python process that finds the modules of this one, not those of a folder, and speaks UTF-8."""
    places = [str(Path(entry or ".").resolve()) for entry in sys.path]
    return os.environ | {"PYTHONPATH": os.pathsep.join(places), "PYTHONSAFEPATH": "1", "PYTHONIOENCODING": "utf-8"}


def in_subprocess(function: str, *arguments: Any, patience_s: float = PATIENCE_S) -> Answer:
    """Call ``module:function`` in a process of its own.

    Raises `InputError` or `OSError` as the function did; whatever else ends it is in the answer.

    It takes ``arguments``, and a function by which it says what it is about to do, at least every ``patience_s``.
    Arguments and answer are what JSON knows.
    """
    if _HERE.get():
        said_here = [""]
        try:
            return Answer(json.loads(json.dumps(_named(function)(*arguments, said_here.append))))
        except (RuntimeError, LookupError, ValueError, TypeError, AttributeError) as error:
            if isinstance(error, InputError):
                raise
            return Answer(None, f"reading it ended ({error})", said_here[-1])
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
            answer = _follow(said, patience_s)
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


def _follow(said: queue.SimpleQueue[str | None], patience_s: float) -> Answer:
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
        at, wait_s = message["at"], patience_s


def serve() -> None:
    """Body of the process: call what the command line names, within limits."""
    function = _named(sys.argv[1])
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


def _named(function: str) -> Callable[..., Any]:
    """The function called ``module:function``."""
    module, _, name = function.partition(":")
    named: Callable[..., Any] = getattr(importlib.import_module(module), name)
    return named


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
