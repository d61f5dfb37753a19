"""Commands refuse a recording that contradicts its profile at once, with the cure; --anyway goes on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from bench.cli import app
from benchmarks.plants import other_plant
from benchmarks.plants.handed_over import imported


def bench(*arguments: object) -> Result:
    """Run the command line."""
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.fixture(scope="module")
def inverted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six steps, too few for a verdict, with the accelerometer upside down."""
    run = other_plant.Run(gammas=tuple(np.linspace(0.6, 1.6, 6).tolist()), cycles=14, seed=4)
    volts = {k: v for k, v in other_plant.simulate(run).items() if k == "time_s" or k.endswith("_v")}
    volts["accelerometer_v"] = -volts["accelerometer_v"]
    profile = other_plant.profile_of(run)
    text = profile.replace("reads_gravity = true", "reads_gravity = false")
    volts["accelerometer_v"] += 0.1
    return imported(volts, text, tmp_path_factory.mktemp("inverted"))


@pytest.mark.parametrize("more", [(), ("--runs-differ",)])
def test_close_loop_refuses_a_doubt_and_goes_on_anyway(inverted: Path, more: tuple[str, ...]) -> None:
    """One sentence names the file and what to write; with --anyway the command gets as far as the data allow."""
    result = bench("close-loop", inverted, *more)
    assert result.exit_code == 2
    (line,) = [x for x in result.output.splitlines() if x.startswith("error:")]
    assert str(inverted) in line and "write sign = -1 in [channels.accelerometer]" in line and "--anyway" in line
    result = bench("close-loop", inverted, *more, "--anyway")
    assert "sign = -1" not in result.output and "wanted at least" in result.output


def test_a_profile_that_cures_the_doubt_is_taken(inverted: Path, tmp_path: Path) -> None:
    """With the corrected profile the doubt is gone, and the next reason is given: too few steps."""
    text = (inverted.parent / "profile.toml").read_text().replace("reads_gravity", "sign = -1\nreads_gravity")
    (tmp_path / "right.toml").write_text(text)
    result = bench("close-loop", inverted, "--profile", tmp_path / "right.toml")
    assert result.exit_code == 2 and "wanted at least" in result.output


def test_batch_gives_the_reason_in_the_row(inverted: Path, tmp_path: Path) -> None:
    """The row of the recording has the doubt and its cure as the reason; with --anyway another one."""
    for more, says in (((), "write sign = -1"), (("--anyway",), "wanted at least")):
        table = tmp_path / f"all{len(more)}.csv"
        result = bench("batch", inverted, "--out", table, "--do", "close-loop", *more)
        assert result.exit_code == 1 and says in table.read_text()


def test_explore_refuses_blocks_that_contradict_the_profile(inverted: Path, tmp_path: Path) -> None:
    """Blocks that are there and contradict their profile are no ground to choose on."""
    (tmp_path / "block-01.h5").write_bytes(inverted.read_bytes())
    result = bench("explore", "simulated", "--out", tmp_path)
    assert result.exit_code == 2 and "write sign = -1" in result.output.replace("\n", " ")


def test_info_import_and_reprocess_say_what_the_instrument_is(inverted: Path) -> None:
    """Noise, tones and the doubt are said by every command that looks at the recording."""
    for command in ("info", "reprocess"):
        said = bench(command, inverted).output
        assert "noise 0.29 m/s^2 rms" in said and "a tone at 25.37 Hz" in said and "write sign = -1" in said
