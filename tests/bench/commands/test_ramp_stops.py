"""`bench ramp` while the world around it goes wrong: signals, a closed terminal, a stopped recorder, few files."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from bench.cli import app
from bench.profiles.find import shipped_folder
from daq.recording import open_recording, verify

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals to a group of processes are POSIX's")
BENCH = [sys.executable, "-c", "from bench.cli import main; main()"]
SHARED = Path("/dev/shm")


@contextmanager
def ramp(folder: Path, *words: str, begin: tuple[str, ...] = (), **options: Any) -> Iterator[subprocess.Popen[bytes]]:
    """A paced ramp of two steps in a session of its own, once it records; ``run.h5`` in ``folder``."""
    text = (shipped_folder() / "simulated.toml").read_text(encoding="utf-8")
    text = text.replace("start = 0.4, stop = 2.6, steps = 23", "start = 0.4, stop = 0.6, steps = 2")
    profile, out = folder / "two.toml", folder / "run.h5"
    profile.write_text(text.replace("hold_cycles = 20", "hold_cycles = 60"), encoding="utf-8")
    command = [*begin, *BENCH, "ramp", str(profile), "--real-time", "--out", str(out), *words]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
    process = subprocess.Popen(command, **(quiet | options))
    try:
        while not out.exists() or out.stat().st_size < 40_000:
            assert process.poll() is None, process.returncode
            time.sleep(0.02)
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()


def closed(path: Path) -> Any:
    """What `verify` makes of the recording once it is closed."""
    until = time.monotonic() + 60.0
    while verify(path).state == "incomplete" and time.monotonic() < until:
        time.sleep(0.1)
    return verify(path)


def children(pid: int) -> list[int]:
    """Processes that this one started (Linux)."""
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def recorder_of(pid: int) -> int:
    """The recorder among them."""
    return next(c for c in children(pid) if b"spawn_main" in Path(f"/proc/{c}/cmdline").read_bytes())


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGINT", "SIGQUIT"])
def test_a_signal_to_the_whole_group_ramps_down(tmp_path: Path, name: str) -> None:
    """Run and recorder get the signal together: the drive ramps down, and the recording is closed with the reason."""
    with ramp(tmp_path) as process:
        os.killpg(process.pid, signal.Signals[name])
        os.killpg(process.pid, signal.SIGHUP)  # a hang-up beside it makes no soft stop a hard one
        assert process.wait(60) == 1
    assert verify(tmp_path / "run.h5").state == "stopped"
    with open_recording(tmp_path / "run.h5") as recording:
        assert "ramped down" in recording.attrs["why"] and recording.read_v("drive")[-50:].std() < 5e-3


def test_a_closed_terminal_ramps_down(tmp_path: Path) -> None:
    """The terminal goes away, screen and all: the run ramps down and closes its recording."""
    master, slave = os.openpty()
    with ramp(
        tmp_path, stdin=slave, stdout=slave, stderr=slave, preexec_fn=lambda: os.login_tty(slave),
        start_new_session=False,
    ) as process:  # fmt: skip
        os.close(slave)
        os.close(master)
        assert process.wait(60) == 1
    assert verify(tmp_path / "run.h5").state == "stopped"
    with open_recording(tmp_path / "run.h5") as recording:
        assert recording.attrs["why"] == "SIGHUP: ramped down"


@pytest.mark.skipif(not SHARED.is_dir(), reason="shared memory has no folder here")
def test_a_killed_run_leaves_no_shared_memory(tmp_path: Path) -> None:
    """Killed without a word: the recorder closes the file, and no segment of that run is left; nor of a whole group."""
    for group in (False, True):
        folder = tmp_path / str(group)
        folder.mkdir()
        with ramp(folder) as process:
            (os.killpg if group else os.kill)(process.pid, signal.SIGKILL)
            process.wait(60)
            if not group:
                report = closed(folder / "run.h5")
                assert report.state == "stopped" and report.n_samples > 0
        assert not list(SHARED.glob(f"shakerbench-{process.pid}-*"))


@pytest.fixture(scope="module")
def disturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, int, Any]:
    """A run whose file another run asks for, and whose recorder stands still for a second: refusal, status, report."""
    folder = tmp_path_factory.mktemp("disturbed")
    with ramp(folder) as process:
        again = CliRunner().invoke(app, ["ramp", str(folder / "two.toml"), "--out", str(folder / "run.h5")])
        if Path("/proc").is_dir():
            recorder = recorder_of(process.pid)
            os.kill(recorder, signal.SIGSTOP)
            time.sleep(1.0)
            os.kill(recorder, signal.SIGCONT)
        status = process.wait(60)
    return again, status, verify(folder / "run.h5")


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="the recorder is found by /proc")
def test_a_recorder_that_stands_still_for_a_second_costs_nothing(disturbed: tuple[Any, int, Any]) -> None:
    """Stopped and continued, it catches up: complete, every sample there."""
    _, status, report = disturbed
    assert (status, report.state, report.suspect, report.lost_samples) == (0, "complete", False, 0)


def test_a_second_run_into_the_same_file_is_refused(disturbed: tuple[Any, int, Any]) -> None:
    """While one run records, another one asked for the same file leaves with 2; the first goes on."""
    again, status, report = disturbed
    assert again.exit_code == 2 and "never overwritten" in again.stderr
    assert (status, report.state) == (0, "complete")


def test_a_card_that_is_not_there_leaves_the_name_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A device that never answered leaves no empty recording in the way of the next try."""
    monkeypatch.setenv("JACK_DEFAULT_SERVER", "none-of-that-name")
    result = CliRunner().invoke(app, ["ramp", "soundcard", "--out", str(tmp_path / "run.h5")])
    assert result.exit_code == 1 and "nothing was recorded" in result.stdout
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("simulated", "--replay", "old.h5"), "--replay: is for backend.kind"),
        (("soundcard", "--scenario", "hidden.toml"), "--scenario: is for backend.kind"),
        (("soundcard", "--real-time"), "--real-time: is for backend.kind"),
        (("simulated", "--set", "knob=1", "--set", "knob=2"), "knob was set before"),
        (("simulated", "--seed", "-1"), "--seed"),
    ],
)
def test_what_would_not_be_heeded_is_refused(tmp_path: Path, words: tuple[str, ...], said: str) -> None:
    """An option without meaning here, a key given twice and a seed below zero leave with 2 and no file."""
    result = CliRunner().invoke(app, ["ramp", *words, "--out", str(tmp_path / "run.h5")])
    assert result.exit_code == 2 and said in result.stderr
    assert not list(tmp_path.iterdir())
