"""What a person is told while kernels are compiled."""

from types import SimpleNamespace

import pytest
from numba.core import event

from bench.terminal import progress


def compiles(name: str) -> None:
    """The events of one compilation, without a compiler."""
    kernel = SimpleNamespace(py_func=SimpleNamespace(__name__=name))
    with event.trigger_event("numba:compile", data={"dispatcher": kernel}):  # type: ignore[no-untyped-call]
        pass


def test_compiling_is_announced_once_where_there_is_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    """However many kernels are compiled, one line says so; the quiet bar says nothing."""
    progress._announce.cache_clear()
    with progress.progress_bar(quiet=True) as say:
        say("fitting", 0.1)
        compiles("march")
    assert capsys.readouterr().err == ""
    with progress.progress_bar() as say:
        say("fitting", 0.1)
        compiles("march")
        compiles("one_ahead")
    assert capsys.readouterr().err.count("compiling") == 1


def test_the_listener_names_the_kernel_and_counts() -> None:
    """Kernel and number of those done while compiling, nothing between compilations; deaf after the bar has gone."""
    told: list[tuple[str, int]] = []
    listener = progress._Compiling(lambda name, done: told.append((name, done)))
    event.register("numba:compile", listener)  # type: ignore[no-untyped-call]
    try:
        compiles("march")
        compiles("one_ahead")
    finally:
        event.unregister("numba:compile", listener)  # type: ignore[no-untyped-call]
    assert told == [("march", 0), ("", 1), ("one_ahead", 1), ("", 2)]
