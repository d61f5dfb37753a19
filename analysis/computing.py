"""Results that are stored so that they are not computed again, and the number of threads of a search."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from typing import Any, TypeVar, cast

_T = TypeVar("_T")


class Memory:
    """Results by their key, of too many those not asked for longest go; what one thread makes, the others wait for."""

    def __init__(self, most: int) -> None:
        self._most, self._results = most, dict[Hashable, Any]()
        self._lock, self._making = threading.Lock(), dict[Hashable, threading.Event]()

    def recall(self, key: Hashable, make: Callable[[], _T]) -> _T:
        """The result stored under ``key``; made, and stored, where there is none."""
        while True:
            with self._lock:
                found = self._results.pop(key, None)
                if found is not None:  # now the last to be forgotten
                    self._results[key] = found
                    return cast(_T, found)
                if (others := self._making.get(key)) is None:
                    self._making[key] = threading.Event()
            if others is None:
                return self._make(key, make)
            others.wait()  # it may fail, or be forgotten again

    def holds(self, key: Hashable) -> bool:
        """Whether there is a result stored under ``key``."""
        with self._lock:
            return key in self._results

    def _make(self, key: Hashable, make: Callable[[], _T]) -> _T:
        """Make the result and store it; whoever waits for it goes on, even if it could not be made."""
        try:
            made = make()
            with self._lock:
                if len(self._results) >= self._most:
                    del self._results[next(iter(self._results))]
                self._results[key] = made
        finally:
            self._making.pop(key).set()
        return made


THREADS = 2
