"""Results that are kept, so that what has been computed is not computed again."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar, cast

_T = TypeVar("_T")


class Memory:
    """Results by their key, forgotten together when they are too many; threads may use it at once."""

    def __init__(self, most: int) -> None:
        self._most, self._kept = most, dict[Hashable, Any]()

    def recall(self, key: Hashable, make: Callable[[], _T]) -> _T:
        """The result kept under ``key``; made, and kept, where there is none."""
        found = self._kept.get(key)
        if found is None:
            if len(self._kept) >= self._most:
                self._kept.clear()
            found = self._kept[key] = make()
        return cast(_T, found)
