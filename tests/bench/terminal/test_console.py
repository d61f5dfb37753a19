"""What a console shows: any code page, any width, an output that takes no more; and how the command line is called."""

from __future__ import annotations

import errno
import io
import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any, BinaryIO

import pytest
from rich.table import Table
from typer.testing import CliRunner

from bench.cli import COMMANDS, app
from bench.profiles.find import find_scenario, scenario_names, shipped_folder
from bench.terminal.console import next_command, print_table, write_json
from bench.terminal.streams import SafeStream, nearest
from daq.setup.errors import InputError
from daq.setup.provenance import software_version
from kernels import BLAS_THREADS

ROOT = Path(__file__).parents[3]


def called(*arguments: object, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """Run `python -m bench` as a process of its own."""
    call = [sys.executable, "-m", "bench", *map(str, arguments)]
    return subprocess.run(call, env=os.environ | environment, cwd=ROOT, capture_output=True, check=False)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (("--effects", "nosuch", "plan", "simulated"), "--effects nosuch: no such folder; make it first"),
        (("info", "x" * 5000), "a name of 5000 characters is too long"),
        (("plan", "x" * 5000), "a name of 5000 characters is too long"),
        (("runs", "x" * 5000), "a name of 5000 characters is too long"),
    ],
)
def test_a_name_that_cannot_be_is_one_line(call: tuple[str, ...], says: str) -> None:
    """Status 2 and one short line on standard error, no traceback."""
    done = called(*call)
    assert done.returncode == 2
    assert says in done.stderr.decode() and done.stderr.count(b"\n") == 1 and len(done.stderr) < 300


@pytest.mark.parametrize(
    ("encoding", "shown"), [("cp1251", "Жук: 25.37 Hz"), ("cp1252", r"\u0416\u0443\u043a"), ("ascii", r"\u0416\u0443")]
)
def test_a_console_of_another_code_page(encoding: str, shown: str, tmp_path: Path) -> None:
    """Names that a code page knows are shown, others become escapes, and nothing ends in a traceback."""
    path = tmp_path / "Жук.toml"
    text = (shipped_folder() / "simulated.toml").read_text(encoding="utf-8")
    path.write_text(text.replace('name = "simulated"', 'name = "Жук"'), encoding="utf-8")
    done = called("plan", path, PYTHONIOENCODING=encoding)
    assert done.returncode == 0 and done.stderr == b""
    assert shown in done.stdout.decode(encoding)


def test_what_stands_for_a_character() -> None:
    """Signs of the trade become words or plain signs, accents fall off, frames of tables stay frames."""

    def plain(text: str) -> str:
        return nearest(UnicodeEncodeError("ascii", text, 0, len(text), ""))[0]

    assert plain("m/s²") == "m/s^2" and plain("5 ± 1 µs") == "5 +- 1 us" and plain("é…") == "e..."
    assert plain("Γ ≥ 1 → 2") == "Gamma >= 1 -> 2" and plain("─│") == "-|" and plain("\udcff") == r"\udcff"


class Refusing(io.RawIOBase):
    """A stream that takes nothing until ``number`` is 0."""

    def __init__(self, file: BinaryIO, number: int) -> None:
        self.file, self.number = file, number

    def writable(self) -> bool:
        """It looks like any other."""
        return True

    def fileno(self) -> int:
        """Where its end may be turned to."""
        return self.file.fileno()

    def write(self, data: Any) -> int:
        """Refuse, as the system does."""
        if self.number:
            raise OSError(self.number, os.strerror(self.number))
        return len(data)


@pytest.mark.parametrize(("number", "says"), [(errno.ENOSPC, "standard output cannot be written"), (errno.EPIPE, "")])
def test_an_output_that_takes_no_more(
    number: int, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A full disk behind standard output ends with one line and status 1, a reader who left without a word."""
    with (tmp_path / "f").open("wb") as file:
        raw = Refusing(file, number)
        under = io.TextIOWrapper(io.BufferedWriter(raw), encoding="utf-8")
        stream, messages = SafeStream(under, vital=True), SafeStream(under, vital=False)
        stream.write("a table\n")
        with pytest.raises(SystemExit) as left:
            stream.flush()
        stream.write("more")
        stream.flush()
        messages.write("a message\n")
        messages.flush()
        raw.number = 0
    assert left.value.code == 1
    said = capsys.readouterr().err
    assert said.startswith(f"error: {says}") if says else said == ""


def test_a_warning_of_a_library_is_one_line() -> None:
    """Numbers that are not finite warn nobody at a bench; other warnings keep their words and lose their source."""
    code = (
        "from bench.terminal.streams import make_safe; make_safe()\n"
        "import warnings, numpy\n"
        "numpy.log(numpy.zeros(1)); warnings.warn('mind\\n this')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stderr == "warning: mind this\n"


def table() -> Table:
    """Two steps of a ramp."""
    shown = Table(title="run.h5")
    for heading in ("step", "gamma\npeak", "samples lost", "verdict of the step"):
        shown.add_column(heading, no_wrap=True)
    shown.add_row("0", "1.0000", "12345", "1-cycle")
    shown.add_row("1", "", "0", "chaotic")
    return shown


@pytest.mark.parametrize("columns", [40, 20, 0])
def test_a_narrow_terminal_loses_nothing(
    columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A table that does not fit is printed as pairs, every value with its heading, no line longer than a pair."""
    monkeypatch.setenv("COLUMNS", str(columns))
    print_table(table())
    shown = capsys.readouterr().out
    for pair in (
        "step 0",
        "gamma peak 1.0000",
        "samples lost 12345",
        "verdict of the step 1-cycle",
        "step 1",
        "verdict of the step chaotic",
    ):
        assert pair in shown
    assert max(map(len, shown.splitlines())) <= max(columns, 30)


def test_a_pipe_gets_the_whole_table(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Without a terminal a table takes the width that it needs."""
    monkeypatch.delenv("COLUMNS", raising=False)
    wide = table()
    wide.add_column("words", no_wrap=True)
    wide.add_row("2", "2.0", "0", "1-cycle", "x" * 200)
    print_table(wide)
    assert "x" * 200 in capsys.readouterr().out


def test_a_json_that_cannot_be_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A file that vanishes between the check and the end fails in one line, with status 1."""
    with pytest.raises(SystemExit) as left:
        write_json({"a": 1}, tmp_path / "gone" / "x.json")
    assert left.value.code == 1 and "the JSON could not be written" in capsys.readouterr().err


def test_version_module_and_mistyped_names() -> None:
    """`python -m bench --version` tells the version; a name that is nearly right is answered with the right one."""
    done = called("--version")
    assert done.returncode == 0 and done.stdout.decode().startswith(f"bench {software_version()} ")
    result = CliRunner().invoke(app, ["plna", "simulated"])
    assert result.exit_code == 2 and "did you mean plan?" in result.stderr
    result = CliRunner().invoke(app, ["xyzzy"])
    assert result.exit_code == 2 and "there are: " in result.stderr and "close-loop" in result.stderr


def test_the_shell_completes_commands_and_options() -> None:
    """Commands, commands of commands and options are offered."""

    def offered(words: str, at: int) -> list[str]:
        done = called(_BENCH_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=str(at))
        return done.stdout.decode().split()

    assert offered("bench p", 1) == [name for name in COMMANDS if name.startswith("p")]
    assert offered("bench profile ", 2) == ["list", "show", "new"]
    assert "--json" in offered("bench plan --", 2)


def test_the_overview_imports_nothing_heavy() -> None:
    """`bench --help` shows every command without importing one of them."""
    code = (
        "import sys; from bench.cli import main\n"
        "try: main()\n"
        "finally: print([m for m in ('numpy', 'pydantic', 'rich', 'bench.commands') if m in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", code, "--help"], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stdout.rstrip().endswith("[]")
    assert all(f"\n  {name} " in done.stdout for name in COMMANDS)


def test_shipped_scenarios_are_found_by_name(tmp_path: Path) -> None:
    """A scenario's name, its path in a checkout and a path of one's own lead to files; a slip is answered."""
    assert find_scenario("friction") == find_scenario("scenarios/friction.toml").resolve()
    (tmp_path / "friction.toml").write_text("", encoding="utf-8")
    assert find_scenario(tmp_path / "friction.toml") == tmp_path / "friction.toml"
    with pytest.raises(InputError, match=r"did you mean friction\?"):
        find_scenario("frictoin")
    assert {"ideal", "paper"} <= set(scenario_names())


def test_the_wheel_holds_what_is_looked_for() -> None:
    """Every folder that is looked for inside an installed package is put there."""
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]["targets"]
    for kind in ("rig_profiles", "scenarios"):
        assert wheel["wheel"]["force-include"][kind] == f"bench/{kind}"
        assert any((ROOT / kind).glob("*.toml"))


def test_help_by_its_short_name() -> None:
    """-h is --help, of the program, of its commands and of theirs."""
    for words in ((), ("plan",), ("calibrate", "drive")):
        short, long = (CliRunner().invoke(app, [*words, option]) for option in ("-h", "--help"))
        assert short.exit_code == 0 and short.output == long.output


def test_the_next_command_has_the_files_name_as_a_shell_takes_it() -> None:
    """A name with a blank is quoted; of a staked run it is the command that holds it against its stake."""
    assert "bench close-loop 'my run.h5' " in next_command(Path("my run.h5"))
    assert "bench stake 'my stake.toml' next.h5 " in next_command(Path("next.h5"), "my stake.toml")


@pytest.mark.parametrize(("said", "threads"), [(None, "1"), ("2", "2")])
def test_linear_algebra_has_one_thread_unless_more_are_asked_for(
    monkeypatch: pytest.MonkeyPatch, said: str | None, threads: str
) -> None:
    """A command sets the number of threads before numpy is there, and leaves a number that the user has set."""
    for name in BLAS_THREADS:
        monkeypatch.delenv(name, raising=False) if said is None else monkeypatch.setenv(name, said)
    code = "import os, sys\nsys.argv = ['bench', '--help']\nfrom bench.cli import main\n"
    code += "try: main()\nexcept SystemExit: pass\n"
    code += "assert 'numpy' not in sys.modules\nsys.exit(os.environ['OPENBLAS_NUM_THREADS'])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stderr.strip() == threads
