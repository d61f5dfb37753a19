"""Effects that a user keeps: found by their folder, refused with file and line where they cannot be one."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from model.effects import user_effects
from model.effects.curves import straight_between
from model.effects.registry import registry
from model.effects.user_effects import EffectFileError

ROOT = Path(__file__).parents[3]
FILE = """from kernels import njit
from model.effects.base import Effect, Parameter, Row
EFFECT = Effect(name="{name}", summary="a breeze", reference="a fan",
                parameters=(Parameter("push", "m/s^2", 0.0, 9.0, 0.1),))
@njit(error_model="numpy")
def {hook}({arguments}):
    return {factor} * p[k]
"""
TRIAL = "from model.effects.registry import row; from model.integrator.problem import force; "
TRIAL += "print(force(0.0, 0.0, 0.0, 0.0, row({'breeze': {'push': 0.5}}, 9.8)))"
Keep = Callable[..., Path]


@pytest.fixture
def keep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Keep:
    """Write a kept effect into the folder that the environment names."""
    monkeypatch.setenv(user_effects.VARIABLE, str(tmp_path))

    def made(
        name: str = "breeze", hook: str = "force", arguments: str = "s, h, v, u, p, k", factor: float = 1.0
    ) -> Path:
        path = tmp_path / f"{name}.py"
        path.write_text(FILE.format(name=name, hook=hook, arguments=arguments, factor=factor), encoding="utf-8")
        return path

    yield made
    for path in tmp_path.glob("*.py"):
        sys.modules.pop(f"model.effects.{path.stem}", None)


def test_a_kept_effect_is_found_beside_the_library_s(keep: Keep) -> None:
    """One file in the folder: one effect more, with its hook and its module."""
    before = {r.effect.name for r in registry.__wrapped__()}
    keep()
    found = {r.effect.name: r for r in registry.__wrapped__()}
    assert set(found) - before == {"breeze"}
    assert set(found["breeze"].hooks) == {"force"}


def test_an_edited_file_flies_as_edited(keep: Keep) -> None:
    """Compiled kernels follow the file's content: a changed factor, in a file of the same size, is used at once."""
    pushes = []
    for factor in (1.0, 3.0):
        keep(factor=factor)
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            [sys.executable, "-c", TRIAL], env=environment, capture_output=True, text=True, check=True
        )
        pushes.append(float(done.stdout))
    assert pushes == [0.5, 1.5]


def test_a_broken_file_is_refused_with_its_line(keep: Keep) -> None:
    """A slip of syntax, a wrong name inside, other arguments, a misspelt hook: file, line and what was wanted."""
    path = keep(arguments="s, h, v, p, k")
    with pytest.raises(EffectFileError, match=r"breeze.py, line \d: force.*wanted force\(s, h, v, u, p, k\)"):
        registry.__wrapped__()
    path.write_text("x = 1\ny = (\n", encoding="utf-8")
    with pytest.raises(EffectFileError, match=r"breeze.py, line 2: .*never closed"):
        registry.__wrapped__()
    path.write_text("x = 1\n\ny = undefined\n", encoding="utf-8")
    with pytest.raises(EffectFileError, match=r"breeze.py, line 3: NameError"):
        registry.__wrapped__()
    keep(hook="forces")
    with pytest.raises(EffectFileError, match=r"breeze.py: no hook is called 'forces'; did you mean force\?"):
        registry.__wrapped__()


def test_a_name_of_the_library_is_refused(keep: Keep) -> None:
    """A kept file cannot take the place of an effect of the library."""
    keep("adhesion")
    with pytest.raises(EffectFileError, match="adhesion exists already"):
        registry.__wrapped__()


def test_every_command_tells_of_a_broken_file(keep: Keep) -> None:
    """`bench --effects FOLDER predict` with a broken file: one line, status 2, no traceback."""
    folder = keep().parent
    (folder / "breeze.py").write_text("y = (\n", encoding="utf-8")
    call = [sys.executable, "-m", "bench", "--effects", str(folder), "predict", "--c", "1", "--gamma", "1.2"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), user_effects.VARIABLE: ""}
    done = subprocess.run(call, env=environment, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 2, done.stderr
    assert "breeze.py, line 1" in done.stderr and "Traceback" not in done.stderr


def test_the_folder_is_the_user_s_own_unless_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Without the variable a folder of the user's; with it those it names, of which an empty text names none."""
    monkeypatch.delenv(user_effects.VARIABLE)
    assert user_effects.folders() == (user_effects.user_folder(),)
    monkeypatch.setenv(user_effects.VARIABLE, os.pathsep.join([str(tmp_path), str(tmp_path / "b")]))
    assert user_effects.folders() == (tmp_path, tmp_path / "b")
    monkeypatch.setenv(user_effects.VARIABLE, "")
    assert user_effects.folders() == () and user_effects.effect_files() == ()


def test_a_table_is_straight_between_its_knots() -> None:
    """As numpy interpolates, constant beyond the ends, and nothing where the place is not known."""
    knots, values = np.array([0.0, 1.0, 3.0]), np.array([2.0, 4.0, -2.0])
    for x in (-1.0, 0.0, 0.3, 1.0, 2.2, 3.0, 9.0):
        assert straight_between(x, knots, values) == pytest.approx(float(np.interp(x, knots, values)))
    assert straight_between(float("nan"), knots, values) == 0.0
