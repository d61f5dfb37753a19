"""Kept kernels: they run without numba; an edit of anything a kernel reaches is seen; a folder that cannot be written
is no obstacle."""

from __future__ import annotations

import ast
import io
import os
import pickle
import subprocess
import sys
import time
import tokenize
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from kernels import folder, machine_code, njit, store
from kernels.folder import fingerprint, fingerprint_of_sources, without_text

ROOT = Path(__file__).resolve().parents[2]
CALLER = """
import math
import sys

import numpy as np

from callee import inner
from kernels import njit


@njit()
def outer(x):
    return inner(x) + 1.0


@njit()
def one(x):
    return x + 1.0


@njit()
def two(x):
    return x + 2.0


def made_of(inner):
    @njit()
    def step(values):  # too long to be inlined
        for _ in range(3):
            while math.sin(values[-1]) * math.exp(math.cos(values[-1])) > 9.0:
                values[-1] = math.atan(values[-1]) + math.log(values[-1])
            values[:] = inner(values) if values[0] < 3.0 else inner(inner(values)) - inner(0.0)
        return values[0]

    @njit()
    def outer(x):
        return step(np.full(2, x)) + step(np.full(3, x))

    return outer


kernels = {"one": made_of(one), "two": made_of(two)}
print(outer(1.0), *(kernels[name](0.0) for name in sys.argv[1:]), int("numba" not in sys.modules))
"""


def write_callee(place: Path, factor: float) -> None:
    """A module with a kernel that another module's kernel calls."""
    text = f"from kernels import njit\nFACTOR = {factor}\n\n\n@njit()\ndef inner(x):\n    return FACTOR * x\n"
    (place / "callee.py").write_text(text, encoding="utf-8")


def start(place: Path, *names: str) -> subprocess.Popen[str]:
    """A process that prints the kernel's answer, those of the factory's ``names``, and whether numba was not needed."""
    (place / "caller.py").write_text(CALLER, encoding="utf-8")
    env = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(place / "cache"),
        "PYTHONPATH": str(ROOT),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    return subprocess.Popen(
        [sys.executable, "caller.py", *names], cwd=place, env=env, stdout=subprocess.PIPE, text=True
    )


def answers(*started: subprocess.Popen[str]) -> list[list[float]]:
    """What the processes printed, as numbers."""
    return [[float(word) for word in process.communicate(timeout=200)[0].split()] for process in started]


def test_an_edit_of_a_called_file_is_seen_and_two_processes_share_the_folder(tmp_path: Path) -> None:
    """Two processes at once compile and agree, a third takes what they stored, and one after an edit compiles anew.

    Kernels of one name that a factory made, compiled in two processes and taken by a third, are each still themselves.
    """
    write_callee(tmp_path, 2.0)
    assert [values[:2] for values in answers(start(tmp_path, "one"), start(tmp_path, "two"))] == [
        [3.0, 6.0],
        [3.0, 12.0],
    ]
    assert answers(start(tmp_path, "one", "two")) == [[3.0, 6.0, 12.0, 1.0]]
    assert not list(tmp_path.rglob("*.part"))
    write_callee(tmp_path, 5.0)
    assert answers(start(tmp_path)) == [[6.0, 0.0]]


KEPT = """
import sys

import numpy as np

from typing import NamedTuple

from kernels import njit


class Pair(NamedTuple):
    first: object
    second: object


@njit()
def swapped(pair):
    return Pair(pair.second, pair.first)


@njit()
def powers(x, count):
    found = np.empty(count)
    for i in range(count):
        found[i] = x**i
    return found, found[1:], np.argmax(found), (found[1:] - found[:-1]).sum()


@njit()
def fewer(x):
    return x[:2].copy()


@njit()
def refused(x):
    if x < 0.0:
        raise ValueError("below zero")
    if x > 1.0:
        raise ValueError("above one", x)  # numba helps to raise what is computed
    return x


all_of_them, without_first, largest, grown = powers(2.0, 3)
said = 0
try:
    powers(2.0, 0)
except ValueError as error:
    said += "empty sequence" in str(error)
try:
    refused(-2.0)
except ValueError as error:
    said += error.args == ("below zero",)
try:
    refused()
except TypeError as error:
    said += "x" in str(error)
print(*all_of_them, *without_first, largest, grown, said, Pair(*swapped(Pair(np.ones(2), 3))).second[0])
print(int("numba" in sys.modules), int("scipy.linalg" in sys.modules))
if len(sys.argv) > 1:
    try:
        refused(2.0)
    except ValueError as error:
        print(int(error.args == ("above one", 2.0)))
    print(*fewer(powers(0.5, 3)[0]))
"""


def test_a_kept_kernel_runs_without_numba(tmp_path: Path) -> None:
    """A kept kernel that makes arrays, looks through them, takes and returns records, and raises NumPy's errors and its
    own runs where numba is not imported; others compile after it."""
    (tmp_path / "kept.py").write_text(KEPT, encoding="utf-8")
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(ROOT)}

    def run(*arguments: str) -> list[float]:
        command = [sys.executable, "-c", "import kept", *arguments]
        done = subprocess.run(command, cwd=tmp_path, env=env, check=True, capture_output=True, text=True)
        return [float(word) for word in done.stdout.split()]

    answer = [1.0, 2.0, 4.0, 2.0, 4.0, 2.0, 3.0, 3.0, 1.0]
    assert run()[:-2] == answer
    assert run("compile another") == [*answer, 0.0, 0.0, 1.0, 1.0, 0.5]


BITS = """
import sys

import numpy as np
from model.orbits.exact_ball import IdealBall
from model.surveys.diagram import diagram
from model.tones import Forcing

found = diagram(IdealBall(Forcing.superposition(2)), np.linspace(0.25, 6.0, 40))
print(int("numba" in sys.modules), found.tau[~np.isnan(found.tau)].tobytes().hex())
"""


def test_flights_are_the_same_to_the_last_bit_without_numba(tmp_path: Path) -> None:
    """A diagram by the code just compiled, and by the same code kept and loaded without numba."""
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}

    def run() -> list[str]:
        done = subprocess.run([sys.executable, "-c", BITS], env=env, check=True, capture_output=True, text=True)
        return done.stdout.split()

    (imported, compiled), (without, kept) = run(), run()
    assert (imported, without) == ("1", "0")
    assert len(kept) > 40 * 16
    assert compiled == kept


def compiled_with(factor: float, inner_options: dict[str, bool]) -> Callable[[float], float]:
    """A kernel that calls another one with a constant and options of its own."""
    names = {"FACTOR": factor, "TABLE": np.arange(3.0)}
    exec("def inner(x):\n    return FACTOR * x + TABLE[1]\ndef outer(x):\n    return inner(x)\n", names)
    names["inner"] = njit(**inner_options)(names["inner"])
    return njit()(names["outer"])


def test_the_hash_holds_constants_and_options_of_what_is_called() -> None:
    """Equal sources hash alike; another constant, or another option, of a called function does not."""
    one = fingerprint(compiled_with(2.0, {}))
    assert fingerprint(compiled_with(2.0, {})) == one
    assert fingerprint(compiled_with(2.0, {"fastmath": True})) != one
    assert fingerprint(compiled_with(2.5, {})) != one


def test_docstrings_and_comments_do_not_count() -> None:
    """A kernel with another docstring, or none, keeps its machine code; so do sources with other comments."""
    found = []
    for text in ('"""One."""', '"""Another."""', "# none"):
        names: dict[str, Any] = {}
        exec(f"def kernel(x):\n    {text}\n    return 2.0 * x\n", names)
        found.append(fingerprint(njit()(names["kernel"])))
    assert len(set(found)) == 1
    plain = "def f(x):\n    return x\n"
    worded = '"""A module."""\n\n# why\ndef f(x):  # so\n    """A text\n    of two lines."""\n\n    return x\n'
    assert fingerprint_of_sources([plain]) == fingerprint_of_sources([worded])
    assert fingerprint_of_sources([plain]) != fingerprint_of_sources([plain.replace("return x", "return -x")])


@pytest.mark.parametrize("path", sorted((ROOT / "kernels").rglob("*.py")), ids=lambda path: path.name)
def test_no_word_of_the_code_is_taken_for_text(path: Path) -> None:
    """What the hash leaves out of the sources that compile are docstrings and comments, and nothing else."""
    source = path.read_text(encoding="utf-8")

    def words(text: str) -> list[str]:
        return [each.string for each in tokenize.generate_tokens(io.StringIO(text).readline) if each.string.strip()]

    texts = {ast.get_source_segment(source, node) for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Expr)}
    is_code = (each for each in words(source) if not each.startswith("#") and not (each in texts and each[:3] == '"""'))
    assert words(without_text(source)) == list(is_code)


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Two folders in place of the user's; tests may spoil the first."""
    found = [tmp_path / "own" / "kernels" / "versions", tmp_path / "temporary" / "kernels" / "versions"]
    monkeypatch.setattr(folder, "places", lambda: tuple(found))
    monkeypatch.setattr(folder, "_given_up", [])
    folder._make.cache_clear()
    return found


def test_without_a_writable_place_a_temporary_one_serves_and_is_named_once(places, tmp_path: Path, caplog) -> None:
    """Where a file stands in the folder's way, kernels go to the next and are read from there; one line says so."""
    (tmp_path / "own").write_text("in the way", encoding="utf-8")
    folder.write("one", b"code")
    folder.write("two", b"more")
    assert (folder.read("one"), folder.read("two")) == (b"code", b"more")
    (said,) = caplog.messages
    assert str(places[0]) in said
    assert str(places[1]) in said


def test_without_any_place_kernels_compile_all_the_same(places, tmp_path: Path, caplog) -> None:
    """With no folder to write at all a kernel still runs, and one line says that nothing is kept."""
    for name in ("own", "temporary"):
        (tmp_path / name).write_text("in the way", encoding="utf-8")
    assert compiled_with(3.0, {})(2.0) == 7.0
    assert "every run compiles them anew" in caplog.messages[-1]


def test_a_damaged_file_is_compiled_anew(places) -> None:
    """A kept kernel cut short is not loaded; the right one is written over it."""
    assert compiled_with(3.0, {})(2.0) == 7.0
    (kept,) = places[0].glob("*outer*.bin")
    whole = kept.read_bytes()
    kept.write_bytes(whole[: len(whole) // 2])
    again = compiled_with(3.0, {})
    assert again(2.0) == 7.0
    assert len(kept.read_bytes()) >= len(whole) // 2 + 1


def test_a_kernel_that_wants_what_is_not_there_is_compiled_anew(places) -> None:
    """Code with a symbol that this process lacks is not linked, which would end the process."""
    assert compiled_with(3.0, {})(2.0) == 7.0
    (file,) = places[0].glob("*outer*.bin")
    kept = machine_code.StoredKernel(*pickle.loads(file.read_bytes()[store.DIGEST_BYTES :]))
    assert machine_code.load(pickle.dumps(tuple(kept)))(2.0) == 7.0
    lacking = kept._replace(wanted=[*kept.wanted, "a symbol of nobody"])
    assert machine_code.load(pickle.dumps(tuple(lacking))) is None


def test_settings_of_numba_are_part_of_the_name(places, monkeypatch: pytest.MonkeyPatch) -> None:
    """A kernel compiled under another setting of the environment is another file."""
    assert compiled_with(3.0, {})(2.0) == 7.0
    monkeypatch.setenv("NUMBA_OPT", "1")
    assert compiled_with(3.0, {})(2.0) == 7.0
    assert len(list(places[0].glob("*outer*.bin"))) == 2


def test_what_is_long_unused_is_removed(places) -> None:
    """Kernels of other versions, and of sources since edited, go after a month without use; those in use stay."""
    old = time.time() - (folder.UNUSED_DAYS + 1.0) * folder.DAY_S
    other, fresh = places[0].parent / "older", places[0].parent / "other"
    for place in (other, fresh, places[0]):
        place.mkdir(parents=True)
        (place / "kernel.bin").write_bytes(b"code")
    for path in (other / "kernel.bin", other, places[0] / "kernel.bin"):
        os.utime(path, (old, old))
    folder.write("new", b"code")
    assert not other.exists()
    assert fresh.exists()
    assert [path.name for path in places[0].iterdir()] == ["new.bin"]


def test_the_folder_is_keyed_by_the_versions() -> None:
    """The folder's name holds numba's version and Python's."""
    name = folder.places()[0].name
    assert f"numba-{numba.__version__}" in name
    assert sys.implementation.cache_tag in name
