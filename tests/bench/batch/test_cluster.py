"""A batch on a real cluster, one worker of which is killed in the middle."""

import shutil

import pytest

import shakerbench as sb
from bench.batch import PARTS, Batch, run_batch, write_table
from daq.files.disk import Journal

RECORDINGS = 2
SMALL = {"ramp.gamma": [0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0], "ramp.settle_cycles": 6, "ramp.hold_cycles": 12}


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """One run under several names, and one file that is cut in half."""
    where = tmp_path_factory.mktemp("rig")
    first = where / "run0.h5"
    sb.run(sb.load_profile("simulated").with_values(SMALL), first, seed=11)
    for i in range(1, RECORDINGS):
        shutil.copyfile(first, where / f"run{i}.h5")
    whole = first.read_bytes()
    (where / "cut.h5").write_bytes(whole[: len(whole) // 2])
    return sorted(where.glob("*.h5"))


def without_seconds(rows):
    """The table, processor seconds apart."""
    return [{k: x for k, x in row.items() if k != "processor_s"} for row in rows]


def kill_a_busy_worker(cluster, client):
    """End the process of a worker that has work, as the system's memory killer does; its name."""
    import psutil

    busy = next(address for address, tasks in client.processing().items() if tasks)
    nanny = next(x for x in cluster.workers.values() if x.worker_address == busy)
    psutil.Process(nanny.pid).kill()
    return busy


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Dask's own
def test_a_killed_worker_changes_no_table(recordings, tmp_path):
    """Three workers, one killed after the first row: the table is that of one process, to the byte."""
    distributed = pytest.importorskip("distributed")
    parts = PARTS
    alone = run_batch(Batch(recordings, parts), Journal(tmp_path / "alone.rows"))
    killed = []
    with (
        distributed.LocalCluster(n_workers=3, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):

        def say(done, total, path, row):
            if not killed:
                killed.append(kill_a_busy_worker(cluster, client))

        journal = Journal(tmp_path / "cluster.rows")
        rows = run_batch(Batch(recordings, parts), journal, cluster=cluster.scheduler_address, say=say)
        assert killed and killed[0] not in client.scheduler_info(n_workers=-1)["workers"]
    assert [bool(row["failed"]) for row in rows] == [path.stem == "cut" for path in recordings]
    assert without_seconds(rows) == without_seconds(alone)
    for name, some in (("alone", alone), ("cluster", rows)):
        write_table(without_seconds(some), tmp_path / f"{name}.csv")
    assert (tmp_path / "cluster.csv").read_bytes() == (tmp_path / "alone.csv").read_bytes()
    assert len(journal.rows) == len(recordings)  # nothing was examined twice for the table
