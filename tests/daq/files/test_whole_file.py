"""Files that appear whole or not at all: by a kill, a full disk, or an error; modes and links stay."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from daq.files.disk import whole, write_whole
from daq.recording import CHANNELS, Block
from daq.recording.writer import RecordingWriter
from daq.setup.setup import Setup

posix = pytest.mark.skipif(os.name != "posix", reason="modes, links and limits as POSIX knows them")


def test_an_error_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    """What was half-written when an error came is gone, and the old file is there."""
    write_whole(tmp_path / "a.toml", "old")
    with pytest.raises(RuntimeError), whole(tmp_path / "a.toml") as part:
        part.write_text("ne", encoding="utf-8")
        raise RuntimeError
    assert [(p.name, p.read_text("utf-8")) for p in tmp_path.iterdir()] == [("a.toml", "old")]


@posix
def test_mode_and_link_stay(tmp_path: Path) -> None:
    """A file of mode 0644 or 0600 keeps it; a symbolic link stays one and what it leads to is written."""
    for mode in (0o644, 0o600):
        real, link = tmp_path / f"real{mode}.toml", tmp_path / f"link{mode}.toml"
        real.write_text("old", encoding="utf-8")
        real.chmod(mode)
        link.symlink_to(real)
        write_whole(link, "new")
        assert link.is_symlink()
        assert (real.read_text("utf-8"), real.stat().st_mode & 0o777) == ("new", mode)


@posix
def test_a_new_file_has_the_usual_mode(tmp_path: Path) -> None:
    """A file that was not there is as readable as any that this person makes."""
    (tmp_path / "other").touch()
    write_whole(tmp_path / "new", "x")
    assert (tmp_path / "new").stat().st_mode == (tmp_path / "other").stat().st_mode


@posix
def test_a_pipe_is_written_to_directly() -> None:
    """A device or a pipe is no file to replace."""
    lines = (
        "import pathlib",
        "from daq.files.disk import write_whole",
        "write_whole(pathlib.Path('/dev/stdout'), 'hello')",
    )
    script = "; ".join(lines)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert done.stdout == "hello"


@posix
@pytest.mark.parametrize("limit", [5_000, 60_000, 200_000])
@pytest.mark.parametrize("kind", ["h5", "npz", "csv"])
def test_an_export_to_a_full_disk_ends_in_a_sentence(tmp_path: Path, setup: Setup, limit: int, kind: str) -> None:
    """Wherever the disk refuses: no crash of HDF5, exit status 1, and nothing is left behind."""
    codes = np.random.default_rng(1).integers(-30_000, 30_000, (100_000, 3), np.int16)
    with RecordingWriter(
        tmp_path / "a.h5", setup, profile_text="", channels=CHANNELS, backend="s", simulated=True
    ) as writer:
        writer.append(Block(0, codes))
    script = """
        import resource, signal, sys
        from pathlib import Path
        from daq.export.export import export
        from daq.recording import open_recording
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        limit, source, out = int(sys.argv[1]), *map(Path, sys.argv[2:])
        with open_recording(source) as recording:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
            try:
                export(recording, out, out.suffix[1:])
            except OSError as error:
                print("refused:", error)
    """
    out = tmp_path / f"out.{kind}"
    command = [sys.executable, "-c", textwrap.dedent(script), str(limit), str(tmp_path / "a.h5"), str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    assert "refused:" in done.stdout
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]
