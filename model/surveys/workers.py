"""Independent computations in processes of this machine or on a Dask cluster, each result given out as it comes in.

A worker that dies loses nothing but what it was computing, and that is computed again. A computation that takes its
worker down whenever it is tried ends as an error of its own; all others go on.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from kernels.errors import InputError

Result = TypeVar("Result")
Key = TypeVar("Key", bound=Hashable)
Task = tuple[Key, tuple[Any, ...]]

AHEAD = 2  # tasks handed to each worker at a time: none waits for the next, and few are lost with it
ATTEMPTS = 3  # of a task whose worker died


class WorkerDied(RuntimeError):
    """A computation whose worker ended each time, killed or out of memory."""


@dataclass(frozen=True)
class Outcome(Generic[Key, Result]):
    """The result of one task, or the exception that it ended with."""

    key: Key
    result: Result | None
    error: BaseException | None = None

    def value(self) -> Result:
        """The result; raises what the task raised."""
        if self.error is not None:
            raise self.error
        return self.result  # type: ignore[return-value]


def outcomes(
    compute: Callable[..., Result], tasks: Iterable[Task[Key]], *, workers: int = 1, cluster: str | None = None
) -> Iterator[Outcome[Key, Result]]:
    """Outcomes of ``compute(*arguments)`` for every task, in the order in which they end.

    Raises `InputError` where Dask is asked for and not installed.

    Parameters
    ----------
    compute
        A function of a module, so that another process finds it.
    tasks
        A key for each, and the arguments; taken one by one, so that there may be many.
    workers
        Processes; 1 without a cluster computes in this one.
    cluster
        Address of a Dask scheduler (``tcp://host:port``), or ``"local"`` for one of ``workers`` processes here.
    """
    if cluster is not None:
        yield from _on_cluster(compute, tasks, workers, cluster)
    elif workers > 1:
        yield from _in_processes(compute, tasks, workers)
    else:
        for key, arguments in tasks:
            yield _outcome(key, lambda arguments=arguments: compute(*arguments))  # type: ignore[misc]


def _outcome(key: Key, result: Callable[[], Result]) -> Outcome[Key, Result]:
    try:
        return Outcome(key, result())
    except Exception as error:  # noqa: BLE001  an error belongs to its task; the caller decides
        return Outcome(key, None, error)


def _in_processes(
    compute: Callable[..., Result], tasks: Iterable[Task[Key]], workers: int
) -> Iterator[Outcome[Key, Result]]:
    """In processes of this machine, begun anew where one has died."""
    from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import get_context

    remaining, suspects = iter(tasks), list[Task[Key]]()
    while True:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            running: dict[Future[Result], Task[Key]] = {}
            broken = False
            while not broken:
                while len(running) < AHEAD * workers and (task := next(remaining, None)) is not None:
                    running[pool.submit(compute, *task[1])] = task
                if not running:
                    return
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    task = running.pop(future)
                    if isinstance(future.exception(), BrokenProcessPool):
                        broken = True
                        suspects.append(task)
                    else:
                        yield _outcome(task[0], future.result)
            suspects += running.values()
        for task in suspects:  # one of them took its worker down: each by itself, so that no other pays for it
            yield _isolated(compute, task)
        suspects.clear()


def _isolated(compute: Callable[..., Result], task: Task[Key]) -> Outcome[Key, Result]:
    """The task in a process of its own, tried again where that dies."""
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import get_context

    key, arguments = task
    for _ in range(ATTEMPTS - 1):
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            future = pool.submit(compute, *arguments)
            if not isinstance(future.exception(), BrokenProcessPool):
                return _outcome(key, future.result)
    return Outcome(key, None, _died())


def _died() -> WorkerDied:
    return WorkerDied(f"its worker process died {ATTEMPTS} times (killed, or out of memory)")


def _on_cluster(
    compute: Callable[..., Result], tasks: Iterable[Task[Key]], workers: int, address: str
) -> Iterator[Outcome[Key, Result]]:
    """On a Dask cluster, which is imported only here."""
    try:
        import dask
        from distributed import Client, KilledWorker, LocalCluster, as_completed
    except ImportError as error:
        raise InputError("--cluster needs Dask: pip install 'shakerbench[distributed]'") from error
    remaining = iter(tasks)
    with ExitStack() as stack:
        stack.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": ATTEMPTS - 1}))
        if address == "local":
            local = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
            client = stack.enter_context(Client(stack.enter_context(local)))
        else:
            client = stack.enter_context(Client(address))
        threads = sum(worker["nthreads"] for worker in client.scheduler_info(n_workers=-1)["workers"].values())
        keys: dict[Any, Key] = {}
        running = as_completed()
        while True:
            while len(keys) < AHEAD * max(threads, 1) and (task := next(remaining, None)) is not None:
                future = client.submit(compute, *task[1], pure=False)
                keys[future] = task[0]
                running.add(future)
            if not keys:
                return
            future = next(running)
            found = _outcome(keys.pop(future), future.result)
            yield Outcome(found.key, None, _died()) if isinstance(found.error, KilledWorker) else found
