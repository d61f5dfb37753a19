"""What a person is told while kernels are compiled."""

import pytest

from bench.terminal import console
from kernels.kernel import watchers


def compiles(name: str) -> None:
    """What watchers are told of one compilation, without a compiler."""
    for watcher in watchers:
        watcher.on_start(name)
    for watcher in watchers:
        watcher.on_end()


def test_compiling_is_announced_once_where_there_is_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    """However many kernels are compiled, one line says so; the quiet bar says nothing."""
    console._announce.cache_clear()
    with console.progress_bar(quiet=True) as say:
        say("fitting", 0.1)
        compiles("march")
    assert capsys.readouterr().err == ""
    with console.progress_bar() as say:
        say("fitting", 0.1)
        compiles("march")
        compiles("one_ahead")
    assert capsys.readouterr().err.count("compiling") == 1


def test_the_watcher_names_the_kernel_and_counts() -> None:
    """Kernel and number of those done while compiling, nothing between compilations; deaf after the bar has gone."""
    told: list[tuple[str, int]] = []
    listener = console._Compiling(lambda name, done: told.append((name, done)))
    watchers.append(listener)
    try:
        compiles("march")
        compiles("one_ahead")
    finally:
        watchers.remove(listener)
    assert told == [("march", 0), ("", 1), ("one_ahead", 1), ("", 2)]
