"""Folders of recordings: one row each, failures with their reason, nothing done twice."""

import csv
import json

import pytest
from typer.testing import CliRunner

import shakerbench as sb
from bench.batch import Batch, find_recordings, run_batch, write_table
from bench.cli import app
from daq.files.disk import Journal
from daq.recording.notebook import change_remarks, made_now, with_event
from daq.setup.errors import InputError

PARTS = ("reprocess", "compare")


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    """A folder of two recordings, one that is cut in half, one that is text, and another program's HDF5 file."""
    import h5py

    where = tmp_path_factory.mktemp("laboratory")
    (where / "may").mkdir()
    small = {"ramp.gamma": [0.6, 1.0, 1.4], "ramp.settle_cycles": 4, "ramp.hold_cycles": 12}
    profile = sb.load_profile("simulated").with_values(small)
    sb.run(profile, where / "a.h5", seed=1)
    sb.run(profile, where / "may" / "b.h5", seed=2)
    whole = (where / "a.h5").read_bytes()
    (where / "cut.h5").write_bytes(whole[: len(whole) // 3])
    (where / "text.h5").write_text("not HDF5", encoding="utf-8")
    with h5py.File(where / "other.h5", "w") as file:
        file["x"] = [1.0]
    return where


def run(laboratory, out, *more):
    """`bench batch` on the laboratory, without closing the loop."""
    return CliRunner().invoke(app, ["batch", str(laboratory), "--out", str(out), "--do", "compare", *more])


def test_a_recording_that_fails_stops_nothing(laboratory, tmp_path):
    """Every recording has its row; the unreadable ones have a reason that names them, and the status tells."""
    done = run(laboratory, tmp_path / "rows.csv", "--json", "-")
    assert done.exit_code == 1, done.output
    told = json.loads(done.stdout)
    assert (told["recordings"], told["failed"], told["passed_over"]) == (4, 2, 1)
    rows = {row["recording"].rsplit("/")[-1]: row for row in told["rows"]}
    assert rows["a.h5"]["failed"] is None and rows["a.h5"]["flights"] > 10
    assert "cut.h5" in rows["cut.h5"]["failed"] and "text.h5" in rows["text.h5"]["failed"]
    with (tmp_path / "rows.csv").open(newline="", encoding="utf-8") as stream:
        table = list(csv.DictReader(stream))
    assert [row["recording"] for row in table] == [row["recording"] for row in told["rows"]]
    assert float(table[0]["gamma_high"]) == told["rows"][0]["gamma_high"]


def test_a_batch_goes_on_where_it_stopped(laboratory, tmp_path):
    """What has its row is not examined again; a recording that has changed, and one that failed, is."""
    recordings = [laboratory / "a.h5", laboratory / "cut.h5"]
    journal = Journal(tmp_path / "rows")
    first = run_batch(Batch(recordings, PARTS), journal)
    size = journal.path.stat().st_size
    told = []
    again = run_batch(Batch(recordings, PARTS), Journal(journal.path), say=lambda *x: told.append(x[2].name))
    assert again[0] == first[0] and told == ["a.h5", "cut.h5"]
    added = journal.path.read_bytes()[size:].splitlines()
    assert len(added) == 1 and b"cut.h5" in added[0]
    copy = tmp_path / "a.h5"
    copy.write_bytes((laboratory / "a.h5").read_bytes())
    run_batch(Batch([copy], PARTS), Journal(journal.path))
    assert len(Journal(journal.path).rows) == 3


@pytest.mark.slow
def test_processes_give_the_same_table(laboratory, tmp_path):
    """Two worker processes give the rows that one gives, processor times apart."""
    recordings, _ = find_recordings([laboratory])
    tables = []
    for workers in (1, 2):
        rows = run_batch(Batch(recordings, PARTS), Journal(tmp_path / str(workers)), workers=workers)
        tables.append([{k: x for k, x in row.items() if k != "processor_s"} for row in rows])
    assert tables[0] == tables[1]


@pytest.mark.slow
def test_the_table_is_parquet_with_numbers(laboratory, tmp_path):
    """pandas reads the Parquet table: numbers as numbers, what is missing as missing; the call can be repeated."""
    pandas = pytest.importorskip("pandas")
    out = tmp_path / "rows.parquet"
    run(laboratory, out)
    table = pandas.read_parquet(out)
    assert len(table) == 4 and table["flights"].sum() > 20 and table["failed"].notna().sum() == 2
    assert table["tone_ratio"].dtype.kind in "fi"
    run(laboratory, out)
    assert len(pandas.read_parquet(out)) == 4


def test_a_table_that_is_no_batch_is_kept(laboratory, tmp_path):
    """A file that this command did not begin is not replaced, and a part that does not exist is named."""
    (tmp_path / "mine.csv").write_text("mine", encoding="utf-8")
    refused = run(laboratory, tmp_path / "mine.csv")
    assert refused.exit_code == 2 and "exists already" in refused.stderr
    wrong = CliRunner().invoke(app, ["batch", str(laboratory), "--out", str(tmp_path / "x.csv"), "--do", "guess"])
    assert wrong.exit_code == 2 and "guess" in wrong.stderr and "close-loop" in wrong.stderr


def test_nothing_to_examine_is_said(tmp_path):
    """An empty folder is an error with the folder's name."""
    with pytest.raises(InputError, match="wanted recordings"):
        find_recordings([tmp_path])


def test_columns_of_effects_stand_last_by_name(tmp_path):
    """Common columns first as they come, then the values of effects in alphabetical order."""
    rows = [{"recording": "a", "z.q": 1.0}, {"recording": "b", "verdict": "x", "b.q": 2.0}]
    write_table(rows, tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_text().splitlines()[0] == "recording,verdict,b.q,z.q"


@pytest.mark.slow
def test_the_catalogue_knows_the_verdicts_of_a_batch(tmp_path):
    """A verdict reached by a batch stands in the catalogue of the recordings' folder."""
    small = {"ramp.gamma": [0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0], "ramp.settle_cycles": 6, "ramp.hold_cycles": 12}
    sb.run(sb.load_profile("simulated").with_values(small), tmp_path / "a.h5", seed=4)
    done = CliRunner().invoke(app, ["batch", str(tmp_path), "--out", str(tmp_path / "all.csv"), "--do", "close-loop"])
    assert done.exit_code == 0, done.output
    listed = CliRunner().invoke(app, ["runs", str(tmp_path), "--json", "-"])
    assert [row["loop"]["verdict"] for row in json.loads(listed.stdout)["runs"]] == ["nothing_missing"]


def test_a_row_is_made_anew_after_an_event_was_changed_by_hand(tmp_path):
    """What names a row depends on the recording's events by hand; undone, the earlier row counts again."""
    run = tmp_path / "run.h5"
    run.write_bytes(b"any")
    batch = Batch([run], ("reprocess",))
    before = batch.key(run)
    change_remarks(run, "", lambda now: with_event(now, made_now("impact", None, 0.5)))
    assert batch.key(run) != before
    change_remarks(run, "", lambda now: with_event(now, None))
    assert batch.key(run) == before
