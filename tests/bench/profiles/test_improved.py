"""The improved profile: declarations with their pedigree, read by whatever comes next."""

import datetime
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from analysis.attribution.choice import LogScoreDifference
from analysis.discovery.discover import Band, Discovery
from analysis.loop.result import ClosedLoop, FittedParameter
from analysis.loop.verdict import Verdict
from analysis.residuals.covariates import Covariate
from bench.profiles.find import load
from bench.profiles.improved import write_improved
from tests.loops import changed

SIMULATED = (Path(__file__).parents[3] / "rig_profiles" / "simulated.toml").read_text(encoding="utf-8")
TREND = "@trend"
UP, DOWN = ("coulomb_friction", "mu_up"), ("coulomb_friction", "mu_down")


Found = Callable[..., ClosedLoop]


@pytest.fixture
def found(closed_loop: ClosedLoop) -> Found:
    """A closed loop that found values, each known to a tenth; of a key that ends in a trend, its change."""

    def made(values: dict[tuple[str, str], float], term: str = "", verdict: Verdict = "explained") -> ClosedLoop:
        added = tuple(
            FittedParameter(name, q.removesuffix(TREND), v, 0.1 * abs(v), True, q.endswith(TREND))
            for (name, q), v in values.items()
        )
        discovered = Discovery(
            "force", Covariate("height", "mm", 1e3), term, Band(*(np.zeros(2),) * 4, "m/s^2"), np.zeros(2),
            LogScoreDifference(90.0, 9.0, 80.0, 8.0), (), (), closed_loop.errors.after, 5.0,
        )  # fmt: skip
        return changed(closed_loop, verdict=verdict, parameters=added, discovered=discovered if term else None)

    return made


def test_what_was_found_is_declared_with_its_pedigree(found: Found, tmp_path: Path) -> None:
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


def test_what_cannot_be_declared_is_said(found: Found, tmp_path: Path) -> None:
    """A trend of one run and a nameless term stand in comments, and the profile still parses."""
    path = tmp_path / "better.toml"
    trend = (UP[0], UP[1] + TREND)
    loop = found({UP: 0.1, trend: 0.03}, "a pull that grows above 4 mm")
    _, *left = write_improved(loop, Path("run.h5"), path, SIMULATED)
    assert len(left) == 2 and "0.03" in left[0] and "above 4 mm" in left[1]
    profile, text = load(path)
    assert profile.declared_values() == {"coulomb_friction": {"mu_up": 0.1}}
    assert text.count("# not declared: ") == 2 and "0.03" in text and "above 4 mm" in text


def test_a_run_that_finds_nothing_leaves_the_profile_as_it_was(found: Found, tmp_path: Path) -> None:
    """The same text, byte for byte, and a word that nothing was found."""
    path = tmp_path / "better.toml"
    (said,) = write_improved(found({}, verdict="nothing_missing"), Path("run.h5"), path, SIMULATED)
    assert path.read_text(encoding="utf-8") == SIMULATED
    assert "unchanged" in said and str(path) in said


def test_what_is_not_believed_is_not_declared(found: Found, tmp_path: Path) -> None:
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


def test_an_older_declaration_is_replaced(found: Found, tmp_path: Path) -> None:
    """What the recording's profile declared and the fit freed again gets its new value, once."""
    path = tmp_path / "better.toml"
    old = SIMULATED + "\n[declared.coulomb_friction]\nmu_up = 0.3\nmu_down = 0.3\n"
    write_improved(found({UP: 0.12}), Path("run.h5"), path, old)
    assert load(path)[0].declared_values() == {"coulomb_friction": {"mu_up": 0.12, "mu_down": 0.3}}
