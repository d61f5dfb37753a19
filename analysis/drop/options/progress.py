"""Progress of a long job: what is done, how much of it, and of how much."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
