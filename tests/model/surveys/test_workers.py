"""Tasks in processes and on a cluster: results, errors, and workers that die."""

import pytest

from model.surveys.workers import WorkerDied, outcomes

LEAVE = "__import__('os')._exit(3)"  # ends the process in which it is evaluated, as the system's memory killer does


def results(tasks, **options):
    """Results by key, errors as their types."""
    found = {x.key: x.result if x.error is None else type(x.error) for x in outcomes(eval, tasks, **options)}
    assert len(found) == len(tasks)
    return found


def leaves_once(marker):
    """An expression that ends its process the first time, and is 7 the second."""
    return f"7 if (p := __import__('pathlib').Path({str(marker)!r})).exists() or p.touch() else {LEAVE}"


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_belongs_to_its_task(workers):
    """One task that fails leaves the others' results alone."""
    tasks = [(i, (f"12 // {i}",)) for i in range(4)]
    assert results(tasks, workers=workers) == {0: ZeroDivisionError, 1: 12, 2: 6, 3: 4}


def test_a_dead_worker_costs_no_result(tmp_path):
    """A worker killed in the middle: the same results as without; what always kills its worker is said to."""
    tasks = [(i, (str(i),)) for i in range(6)]
    tasks[2] = (2, (leaves_once(tmp_path / "once"),))
    tasks[4] = (4, (LEAVE,))
    assert results(tasks, workers=2) == {0: 0, 1: 1, 2: 7, 3: 3, 4: WorkerDied, 5: 5}


def test_tasks_are_taken_as_they_are_needed():
    """A list of tasks may be far longer than what is computed: it is read a few ahead."""
    taken = []

    def tasks():
        for i in range(10**6):
            taken.append(i)
            yield i, (str(i),)

    found = outcomes(eval, tasks(), workers=2)
    assert {next(found).value() for _ in range(3)} <= set(range(8))
    assert len(taken) < 12
    found.close()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Dask's own
def test_a_cluster_that_loses_a_worker_gives_the_same(tmp_path):
    """On four workers of a Dask cluster, one of which dies, every result comes in."""
    pytest.importorskip("distributed")
    tasks = [(i, (str(i),)) for i in range(12)]
    tasks[5] = (5, (leaves_once(tmp_path / "once"),))
    assert results(tasks, workers=4, cluster="local") == {**{i: i for i in range(12)}, 5: 7}
