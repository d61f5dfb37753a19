"""Stored results, so that what has been computed is not computed again."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from typing import Any, TypeVar, cast

_T = TypeVar("_T")


class Memory:
    """Results by their key, forgotten together when they are too many; what one thread makes, the others wait for."""

    def __init__(self, most: int) -> None:
        self._most, self._results = most, dict[Hashable, Any]()
        self._lock, self._making = threading.Lock(), dict[Hashable, threading.Event]()

    def recall(self, key: Hashable, make: Callable[[], _T]) -> _T:
        """The result stored under ``key``; made, and stored, where there is none."""
        found = self._results.get(key)
        while found is None:
            with self._lock:
                found, others = self._results.get(key), self._making.get(key)
                if found is None and others is None:
                    self._making[key] = threading.Event()
            if found is None and others is None:
                return self._make(key, make)
            if found is None and others is not None:  # it may fail, or be forgotten again
                others.wait()
                found = self._results.get(key)
        return cast(_T, found)

    def _make(self, key: Hashable, make: Callable[[], _T]) -> _T:
        """Make the result and store it; whoever waits for it goes on, even if it could not be made."""
        try:
            made = make()
            with self._lock:
                if len(self._results) >= self._most:
                    self._results.clear()
                self._results[key] = made
        finally:
            self._making.pop(key).set()
        return made
