"""Chunks of an ensemble on a Dask cluster.

The rule kept here: Dask is imported nowhere else, and only when a cluster is asked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

from model.surveys.diagram import Rows
from model.surveys.ensemble import Job, compute


def on_cluster(
    todo: list[tuple[int, int, tuple[Job, int, int]]], workers: int, address: str
) -> Iterator[tuple[int, int, Rows]]:
    """Chunks as they come in, from the scheduler at ``address`` or, where that is ``"local"``, one here.

    ``todo`` holds each chunk's bounds, and the arguments of `compute`.

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
