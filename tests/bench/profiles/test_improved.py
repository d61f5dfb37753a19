"""The improved profile: declarations with their pedigree, read by whatever comes next."""

import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from analysis.residuals.forward_model import TREND
from bench.profiles.find import load
from bench.profiles.improved import write_improved

SIMULATED = (Path(__file__).parents[3] / "rig_profiles" / "simulated.toml").read_text(encoding="utf-8")
UP, DOWN = ("coulomb_friction", "mu_up"), ("coulomb_friction", "mu_down")


def found(values: dict[tuple[str, str], float], in_words: str = "", verdict: str = "explained") -> Any:
    """A loop that found ``values``, each known to a tenth."""
    fitted = SimpleNamespace(values=values, sigma=lambda key: 0.1 * abs(values[key]))
    discovered = SimpleNamespace(in_words=in_words) if in_words else None
    best = SimpleNamespace(free=tuple(values), fitted=fitted)
    return SimpleNamespace(best=best, discovered=discovered, verdict=verdict)


def test_what_was_found_is_declared_with_its_pedigree(tmp_path: Path) -> None:
    """Value, standard deviation, date and recording; every other line as it was; the next command reads it."""
    path = tmp_path / "better.toml"
    said = write_improved(found({UP: 0.12, DOWN: 0.15}), Path("run.h5"), path, SIMULATED)
    assert said == [f"improved profile: {path}"]
    profile, text = load(path)
    up = profile.declared["coulomb_friction"]["mu_up"]
    assert (up.value, up.uncertainty) == (0.12, pytest.approx(0.012))
    assert up.date == datetime.date.today() and "run.h5" in up.source
    assert text.startswith(SIMULATED.rstrip())
    assert profile.declared_values() == {"coulomb_friction": {"mu_up": 0.12, "mu_down": 0.15}}


def test_what_cannot_be_declared_is_said(tmp_path: Path) -> None:
    """A trend of one run and a nameless term stand in comments, and the profile still parses."""
    path = tmp_path / "better.toml"
    trend = (UP[0], UP[1] + TREND)
    loop = found({UP: 0.1, trend: 0.03}, "a pull that grows above 4 mm")
    _, *left = write_improved(loop, Path("run.h5"), path, SIMULATED)
    assert len(left) == 2 and "0.03" in left[0] and "above 4 mm" in left[1]
    profile, text = load(path)
    assert profile.declared_values() == {"coulomb_friction": {"mu_up": 0.1}}
    assert text.count("# not declared: ") == 2 and "0.03" in text and "above 4 mm" in text


def test_a_run_that_finds_nothing_leaves_the_profile_as_it_was(tmp_path: Path) -> None:
    """The same text, byte for byte, and a word that nothing was found."""
    path = tmp_path / "better.toml"
    (said,) = write_improved(found({}, verdict="nothing_missing"), Path("run.h5"), path, SIMULATED)
    assert path.read_text(encoding="utf-8") == SIMULATED
    assert "unchanged" in said and str(path) in said


def test_what_is_not_believed_is_not_declared(tmp_path: Path) -> None:
    """Effects of an unexplained recording stand in comments; with the marks taken off, the profile declares them."""
    path = tmp_path / "better.toml"
    said = write_improved(found({UP: 0.12}, verdict="unexplained"), Path("run.h5"), path, SIMULATED)
    assert any("mu_up = 0.12" in line and "unexplained" in line for line in said)
    profile, text = load(path)
    assert profile.declared_values() == {}
    head, marked = text.split("to declare it all the same.\n")
    bare = "\n".join(line.removeprefix("# ") for line in marked.splitlines())
    path.write_text(f"{head}to declare it all the same.\n{bare}\n", encoding="utf-8")
    assert load(path)[0].declared_values() == {"coulomb_friction": {"mu_up": 0.12}}


def test_an_older_declaration_is_replaced(tmp_path: Path) -> None:
    """What the recording's profile declared and the fit freed again gets its new value, once."""
    path = tmp_path / "better.toml"
    old = SIMULATED + "\n[declared.coulomb_friction]\nmu_up = 0.3\nmu_down = 0.3\n"
    write_improved(found({UP: 0.12}), Path("run.h5"), path, old)
    assert load(path)[0].declared_values() == {"coulomb_friction": {"mu_up": 0.12, "mu_down": 0.3}}
