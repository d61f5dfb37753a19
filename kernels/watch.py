"""Who wants to be told when kernels are being compiled; numba need not be imported to ask for it."""

from __future__ import annotations

from typing import Protocol


class Watcher(Protocol):
    """Is told of each function that is compiled, of those within others as well."""

    def on_start(self, name: str) -> None:
        """The function of that name begins."""

    def on_end(self) -> None:
        """The one that began last is done."""


watchers: list[Watcher] = []
