"""`bench import` of a recording's own export: the same gamma at the plate as `reprocess`, and what is printed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from bench.cli import app
from bench.profiles.find import shipped_folder

SIMULATED = (shipped_folder() / "simulated.toml").read_text(encoding="utf-8")
LEVELS = "[0.6, 0.9, 1.0, 1.4, 1.7, 1.8, 2.2, 2.6]"


def bench(*arguments: object) -> str:
    """Call the command line in process; what it prints."""
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.parametrize("low_pass_hz", [0.0, 5000.0])
@pytest.mark.parametrize("channels", [("continuity_v",), ()])
def test_gamma_at_the_plate_is_that_of_reprocess(tmp_path: Path, low_pass_hz: float, channels: tuple[str, ...]) -> None:
    """Impacts do not change the gamma of an import: it is within 0.1 % of `reprocess`, with a contact circuit or not.

    Contacts shorter than a sample (gamma from 1.7 to 2.2) are masked as well.
    """
    (tmp_path / "p.toml").write_text(SIMULATED.replace("{ start = 0.4, stop = 2.6, steps = 23 }", LEVELS))
    (tmp_path / "s.toml").write_text(f"[rig]\nlow_pass_hz = {low_pass_hz}\n")
    bench("ramp", tmp_path / "p.toml", "--scenario", tmp_path / "s.toml", "--out", tmp_path / "r.h5")
    bench("reprocess", tmp_path / "r.h5", "--json", tmp_path / "r.json")
    bench("export", tmp_path / "r.h5", "--out", tmp_path / "r.npz")
    table = np.load(tmp_path / "r.npz")
    own = ("time_s", "accelerometer_v", "drive_v", *channels)
    np.savez(tmp_path / "raw.npz", **{name: table[name] for name in own})
    said = bench(
        "import", tmp_path / "raw.npz", "-p", "simulated", "-o", tmp_path / "i.h5", "--json", tmp_path / "i.json"
    )
    assert said.splitlines()[-1].startswith("next: bench close-loop") and "i.h5" in said.splitlines()[-1]
    for shown in (said, bench("info", tmp_path / "i.h5")):
        assert "gamma = A w^2/g of the first tone" in shown
    seen = json.loads((tmp_path / "i.json").read_text())["steps"]
    right = json.loads((tmp_path / "r.json").read_text())["steps"]
    assert len(seen) == len(right) == 8
    for step, reference in zip(seen, right, strict=True):
        error = abs(step["achieved_gamma"] - reference["gamma"])
        assert error < min(step["achieved_gamma_uncertainty"], 1e-3 * reference["gamma"]), step
