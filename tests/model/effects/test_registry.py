"""The library of effects: what is found, and what is refused as it is read."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import model.effects
from model.effects.registry import Registered, effect, registry, resolve, trend_name

FILE = """
from model.effects.base import Effect, Parameter
EFFECT = Effect(name="{name}", summary="a breeze", parameters=(Parameter("size", "1", 0.0, 1.0, 0.1{own}),),
                reference="a fan"{more})
{hooks}
"""
HOOK = "def contact_delay_s(p):\n    return p['size']\n"
Reader = Callable[..., dict[str, object]]


@pytest.fixture
def read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Reader:
    """Names in a library with one file more: ``breeze.py``."""

    def made(*, name: str = "breeze", more: str = "", hooks: str = HOOK, own: str = "") -> dict[str, object]:
        (tmp_path / "breeze.py").write_text(FILE.format(name=name, more=more, hooks=hooks, own=own), encoding="utf-8")
        monkeypatch.setattr(model.effects, "__path__", [*model.effects.__path__, str(tmp_path)])
        importlib.invalidate_caches()
        try:
            return {r.effect.name: r.hooks for r in registry.__wrapped__()}
        finally:
            sys.modules.pop("model.effects.breeze", None)
            vars(model.effects).pop("breeze", None)

    return made


def test_a_parameter_can_be_the_value_of_a_hook(read: Reader) -> None:
    """No function is needed for what is a number of the effect as it is."""
    assert read(hooks="", own=", hook='gap_m'")["breeze"]["gap_m"]({"size": 0.3}) == 0.3  # type: ignore[index]


def test_a_file_with_a_hook_is_an_effect(read: Reader) -> None:
    """A plain hook and a function of the file's own: one effect with one hook."""
    assert set(read(hooks=HOOK + "def _half(x):\n    return x / 2\n")["breeze"]) == {"contact_delay_s"}  # type: ignore[call-overload]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"hooks": "def forces(p):\n    return 0.0\n"}, "no hook is called 'forces'; did you mean force?"),
        ({"hooks": ""}, "wanted at least one hook, found none"),
        ({"own": ", hook='gap'"}, "hook names 'gap', which does not exist; known are accelerometer_response"),
        ({"name": "wind"}, "the effect is called 'wind'; wanted the file's name, 'breeze'"),
        ({"more": ", variants=(('length',),)"}, "variants names 'length', which does not exist; known are size"),
        ({"more": ", tied={'both': ('size', 'length')}"}, "tied names 'length'"),
        ({"more": ", confused_with={'gravitty': 'a scale'}"}, "names 'gravitty', which does not exist"),
    ],
    ids=["misspelt hook", "no hook", "hook of a parameter", "other name", "variant", "tied", "confused"],
)
def test_a_file_that_cannot_be_meant_is_refused(read: Reader, change: dict[str, str], words: str) -> None:
    """The message names the file, what was found and what was wanted."""
    with pytest.raises(ValueError, match="breeze") as raised:
        read(**change)
    assert words in str(raised.value)


def test_only_the_trend_has_no_hooks() -> None:
    """Of the library's own files one has nothing to compute: the trend of another effect's parameter."""
    assert [r.effect.name for r in registry() if not r.hooks] == [trend_name()] == ["parameter_drift"]


def test_tied_parameters_may_be_given_as_one() -> None:
    """Friction ``mu`` is that of both directions; one given beside it has its own."""
    assert resolve({"coulomb_friction": {"mu": 0.2}}) == {"coulomb_friction": {"mu_up": 0.2, "mu_down": 0.2}}
    assert resolve({"coulomb_friction": {"mu": 0.2, "mu_up": 0.1}})["coulomb_friction"]["mu_up"] == 0.1


def test_an_unknown_parameter_is_answered_with_those_there_are() -> None:
    """The message lists each parameter with its meaning and unit."""
    with pytest.raises(ValueError, match=r"mu_down \(friction over weight, moving down, g\)"):
        effect("coulomb_friction").effect.parameter("nu")


@pytest.mark.parametrize(
    "entry", [r for r in registry() if "accelerometer_response" in r.hooks], ids=lambda r: r.effect.name
)
def test_a_reading_is_one_of_each_tone_also_where_an_effect_does_nothing(entry: Registered) -> None:
    """A drift may lead through no effect in some steps: there a pickup was one number for all tones."""
    tones_radps, none = 2.0 * np.pi * np.array([25.0, 50.0, 75.0]), entry.effect.null_values
    for size in (0.0, 0.5):
        shown = entry.hooks["accelerometer_response"]({q: x + size for q, x in none.items()}, tones_radps)
        assert np.shape(shown) == tones_radps.shape
