"""Every `--json` answer is as its schema in the documentation describes it."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from typer.testing import CliRunner

import shakerbench as sb
from bench.cli import COMMANDS, app
from bench.jobs.blocks import stake_toml
from tests.bench.jobs.test_stakes import a_stake

ROOT = Path(__file__).parents[2]
SCHEMAS = ROOT / "docs" / "reference" / "schemas"
GAMMAS = [0.6, 0.75, 0.9, 1.05, 1.2, 1.35, 1.5, 1.65, 1.8, 1.95]
LONG = {"close-loop", "close-loop-runs", "explore"}
WITHOUT_JSON = {"demo", "live", "mcp", "paper", "virtual"}  # they write files, or run until they are ended


def schema(name: str) -> dict[str, Any]:
    """One schema."""
    found: dict[str, Any] = json.loads((SCHEMAS / f"{name}.json").read_text(encoding="utf-8"))
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a profile, a recording of it, somebody's CSV and the times of a drop."""
    where = tmp_path_factory.mktemp("answers")
    small = {"ramp.gamma": GAMMAS, "ramp.settle_cycles": 10, "ramp.hold_cycles": 40}
    profile = sb.load_profile("simulated").with_values(small)
    (where / "p.toml").write_text(profile.text, encoding="utf-8")
    (where / "c.toml").write_text(profile.text, encoding="utf-8")
    sb.run(profile, where / "r.h5", scenario="friction", seed=3)
    month = profile.with_values({"ramp.hold_cycles": 12})
    for i in range(3):
        sb.run(month, where / f"m{i}.h5", scenario="friction", seed=20 + i)
    brief = sb.load_profile("simulated").with_values(
        {"ramp.gamma": [0.6], "ramp.settle_cycles": 2, "ramp.hold_cycles": 8}
    )
    (where / "one.toml").write_text(brief.text, encoding="utf-8")
    staked = brief.with_values({"ramp.gamma": [0.8]})
    (where / "stake.toml").write_text(f"{staked.text}\n{stake_toml(a_stake(gammas=(0.8,)))}", encoding="utf-8")
    sb.run(staked, where / "staked.h5", scenario="friction", seed=5)
    t = np.arange(8000) / 2000.0
    drive = np.sin(2 * np.pi * 25.37 * t) * np.where(t < 2, 0.3, 0.6)
    columns = np.column_stack([t, np.zeros_like(t), 0.2 * drive, drive])
    header = "time_s,continuity_v,accelerometer_v,drive_v"
    np.savetxt(where / "raw.csv", columns, "%.9g", ",", header=header, comments="")
    (where / "f.toml").write_text(
        'name = "x"\n[sampling]\nrate_hz = 2000\n[forcing]\nfrequency_hz = 25.37\n[drive]\ng_per_volt = 2.0\n'
        '[channels.accelerometer]\nsensitivity = 0.1\nunit = "V/g"\n[ball]\nmass_kg = 0.25\n',
        encoding="utf-8",
    )
    times = 1.0 + np.concatenate(([0.0], np.cumsum(0.4 * 0.9 ** np.arange(12))))
    (where / "times.csv").write_text("time (s)\n" + "\n".join(f"{x:.6f}" for x in times) + "\n", encoding="utf-8")
    spoilt = bytearray((where / "r.h5").read_bytes())
    spoilt[len(spoilt) // 2] ^= 1
    (where / "flipped.h5").write_bytes(spoilt)
    return where


ANSWERS = {
    "plan": "plan {0}/p.toml",
    "profile-list": "profile list",
    "devices": "devices",
    "check": "check {0}/p.toml",
    "calibrate": "calibrate drive --into {0}/c.toml",
    "ramp": "ramp {0}/one.toml --out {0}/new.h5",
    "import": "import {0}/raw.csv --profile {0}/f.toml --out {0}/i.h5",
    "export": "export {0}/r.h5 --out {0}/x.npz",
    "reprocess": "reprocess {0}/r.h5",
    "compare": "compare {0}/r.h5",
    "predict-orbit": "predict --c 2 --gamma 1.28",
    "predict-bifurcations": "predict --c 2 --gamma-range 0.3 0.8 --bifurcations",
    "predict-branches": "predict --c 2 --gamma-range 1.0 1.4 --branches",
    "predict-diagram": "predict --c 2 --gamma-range 0.3 0.8 --steps 9",
    "predict-ramp": "predict --profile {0}/p.toml",
    "close-loop": "close-loop {0}/r.h5",
    "close-loop-runs": "close-loop {0}/m0.h5 {0}/m1.h5 {0}/m2.h5 --runs-differ",
    "explore": "explore {0}/p.toml --scenario friction --out {0}/explored --budget 5",
    "stake": "stake {0}/stake.toml {0}/staked.h5",
    "batch": "batch {0}/r.h5 --do compare --out {0}/rows.csv",
    "report": "report {0}/r.h5 --out {0}/r.html --no-loop",
    "drop": "drop {0}/times.csv --no-pictures",
    "info": "info {0}/r.h5",
    "verify": "verify {0}/r.h5",
    "recover": "recover {0}/flipped.h5",
    "runs": "runs {0}",
    "tag": "tag {0}/r.h5 warm",
    "note": "note {0}/r.h5 loose",
}


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in LONG else n for n in ANSWERS])
def test_a_real_answer_fits_its_schema(name: str, folder: Path) -> None:
    """The command's standard output is JSON and nothing else, with exactly the keys and types of the schema."""
    result = CliRunner().invoke(app, [*ANSWERS[name].format(folder).split(" "), "--json", "-"])
    assert result.exit_code == 0, result.output
    jsonschema.Draft202012Validator(schema(name)).validate(json.loads(result.stdout))


def test_every_command_has_a_schema() -> None:
    """Each command that answers in JSON, and each kind of its answers, has a schema; no schema is left over."""
    told = {name.split("-")[0] for name in ANSWERS} | {"close-loop"}
    assert set(COMMANDS) - WITHOUT_JSON == told - {"close"}
    assert {path.stem for path in SCHEMAS.glob("*.json")} == set(ANSWERS)


@pytest.mark.parametrize("name", ANSWERS)
def test_a_schema_is_one_and_describes_every_key(name: str) -> None:
    """Valid by the standard, and no key without a description."""
    jsonschema.Draft202012Validator.check_schema(schema(name))
    assert [place for place, _, text in _page().rows(schema(name)) if not text] == []


def test_the_page_is_made_from_the_schemas() -> None:
    """docs/reference/json.md is what docs/reference/schemas/page.py prints."""
    made = (ROOT / "docs" / "reference" / "json.md").read_text(encoding="utf-8")
    assert made == _page().page(), "run: python docs/reference/schemas/page.py > docs/reference/json.md"


def _page() -> Any:
    """The script that makes the page."""
    spec = importlib.util.spec_from_file_location("json_page", SCHEMAS / "page.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
