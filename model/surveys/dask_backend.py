"""Chunks of an ensemble on a Dask cluster; Dask is imported only when a cluster is asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any, TypeVar

_Result = TypeVar("_Result")


def on_cluster(
    compute: Callable[..., _Result], todo: list[tuple[int, int, tuple[Any, ...]]], workers: int, address: str
) -> Iterator[tuple[int, int, _Result]]:
    """Chunks as they come in, from the scheduler at ``address`` or, where that is ``"local"``, one here.

    ``todo`` holds each chunk's bounds, and the arguments of ``compute``.

    Raises
    ------
    ValueError
        If Dask is not installed.
    """
    try:
        from distributed import Client, LocalCluster, as_completed
    except ImportError as error:
        raise ValueError("--cluster needs Dask: pip install 'shakerbench[distributed]'") from error
    with ExitStack() as stack:
        if address == "local":
            local = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
            client = stack.enter_context(Client(stack.enter_context(local)))
        else:
            client = stack.enter_context(Client(address))
        waiting = {client.submit(compute, *piece, pure=False): (start, stop) for start, stop, piece in todo}
        for future in as_completed(list(waiting)):
            start, stop = waiting.pop(future)
            yield start, stop, future.result()
