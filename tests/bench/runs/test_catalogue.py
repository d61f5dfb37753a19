"""The catalogue of runs: what it finds, what it keeps, and what it does with files that are wrong."""

from __future__ import annotations

import dataclasses
import json
import multiprocessing
import shutil
import threading
from pathlib import Path

import pytest

from analysis.loop.result import ClosedLoop, save_verdict
from bench.jobs.loops import keep_verdict
from bench.runs import catalogue as catalogue_module
from bench.runs.catalogue import VERSION, Catalogue, Query
from daq.recording import open_recording, verify
from daq.recording.header import content_id, stored_id
from daq.recording.notebook import side_file, with_note, with_tags
from daq.setup.errors import InputError
from tests.bench.runs.recordings import record, verdict_on


def names(catalogue: Catalogue, **conditions: object) -> list[str]:
    """File names that a query finds, in its order."""
    return [Path(row["path"]).name for row in catalogue.runs(Query(**conditions))]  # type: ignore[arg-type]


def row_of(catalogue: Catalogue, name: str) -> dict:
    """The row of a file."""
    return next(row for row in catalogue.runs() if row["path"].endswith(name))


def test_what_a_row_says(folder: Path) -> None:
    """Each recording is a row with its profile, c, range of gamma, steps, losses, end and note."""
    catalogue = Catalogue(folder)
    assert catalogue.update() == 3
    row = row_of(catalogue, "b.h5")
    assert row["path"] == "one/b.h5"
    assert (row["profile"], row["c"], row["gamma_low"], row["gamma_high"]) == ("paper", 2, 1.0, 1.4)
    assert (row["steps"], row["lost_samples"], row["ended"], row["simulated"]) == (2, 70, "complete", True)
    assert row["seconds"] == 1.0 and row["all_bytes"] and row["loop"] is None


def test_only_what_has_changed_is_read(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second call reads nothing; a new file is read, a removed one is forgotten; a rescan reads all of them."""
    catalogue = Catalogue(folder)
    catalogue.update()
    catalogue = Catalogue(folder)
    monkeypatch.setattr(catalogue_module, "read_headers", lambda paths, **_: iter([]) if not list(paths) else 1 / 0)
    assert catalogue.update() == 0
    monkeypatch.undo()
    record(folder / "new.h5")
    (folder / "two" / "c.h5").unlink()
    assert catalogue.update() == 1
    assert sorted(names(catalogue)) == ["a.h5", "b.h5", "new.h5"]
    catalogue = Catalogue(folder, anew=True)
    assert catalogue.runs() == []
    assert catalogue.update() == 3


def test_a_rescan_shows_the_old_state_until_it_is_done(folder: Path) -> None:
    """While one catalogue is made anew from the files, another finds every run; afterwards both have the new state."""
    other = Catalogue(folder)
    other.update()
    rescan = Catalogue(folder, anew=True)
    record(folder / "new.h5")
    assert names(rescan) == [] and sorted(names(other)) == ["a.h5", "b.h5", "c.h5"]
    assert rescan.update() == 4
    assert sorted(names(rescan)) == sorted(names(other)) == ["a.h5", "b.h5", "c.h5", "new.h5"]
    assert rescan.update() == other.update() == 0


@pytest.mark.parametrize(
    ("conditions", "found"),
    [
        ({"profile": "pap"}, ["a.h5", "b.h5"]), ({"c": 2}, ["b.h5"]), ({"gamma": (1.3, 1.6)}, ["b.h5", "c.h5"]),
        ({"lost": True}, ["b.h5"]), ({"text": "SPRING sure"}, ["c.h5"]), ({"text": "100% s"}, ["c.h5"]),
        ({"text": "%"}, ["c.h5"]), ({"text": "_"}, []), ({"text": "c.h5 paper"}, []), ({"ended": "damaged"}, []),
        ({"verdict": "none"}, ["a.h5", "b.h5", "c.h5"]), ({"since": "2099"}, []),
        ({"until": "2099-01"}, ["a.h5", "b.h5", "c.h5"]),
        ({"sort": "-gamma"}, ["c.h5", "b.h5", "a.h5"]),
        ({"sort": "-lost", "limit": 1}, ["b.h5"]),
        ({"text": "'; DROP TABLE runs; --"}, []),
    ],
)  # fmt: skip
def test_filters_and_orders(folder: Path, conditions: dict, found: list[str]) -> None:
    """Each condition leaves the runs that meet it, taken literally, in the order asked for."""
    catalogue = Catalogue(folder)
    catalogue.update()
    assert names(catalogue, **({"sort": "name"} | conditions)) == found


def test_unknown_words_are_refused(folder: Path) -> None:
    """A sort, verdict or end that does not exist is refused with those that do."""
    for wrong in ({"sort": "size"}, {"verdict": "good"}, {"ended": "well"}):
        with pytest.raises(InputError, match="wanted one of"):
            Query(**wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="there is none of that name"):
        Catalogue(folder / "nowhere")


def test_tags_and_notes_lie_beside_the_recording(folder: Path) -> None:
    """A lost catalogue loses none of them, and the sealed recording is byte for byte what it was."""
    before = (folder / "one" / "a.h5").read_bytes()
    catalogue = Catalogue(folder)
    catalogue.update()
    row = row_of(catalogue, "a.h5")
    catalogue.change_remarks(row, lambda now: with_note(with_tags(now, ("warm", "new")), "after\nlunch"))
    catalogue.change_remarks(row, lambda now: with_tags(now, ("new",), remove=True))
    assert row_of(catalogue, "a.h5")["tags"] == ["warm"]
    assert names(catalogue, tags=("warm",)) == ["a.h5"] and names(catalogue, tags=("war",)) == []
    shutil.rmtree(folder / ".shakerbench")
    catalogue = Catalogue(folder)
    catalogue.update()
    row = row_of(catalogue, "a.h5")
    assert (row["tags"], row["notes"]) == (["warm"], "first <b>run</b>\nafter\nlunch")
    assert (folder / "one" / "a.h5").read_bytes() == before
    assert verify(folder / "one" / "a.h5").state == "complete"


def test_remarks_of_another_recording_are_not_taken(folder: Path) -> None:
    """Where another recording takes the name, the tags of the one before do not stick to it."""
    catalogue = Catalogue(folder)
    catalogue.update()
    catalogue.change_remarks(row_of(catalogue, "a.h5"), lambda now: with_tags(now, ("warm",)))
    shutil.copy(folder / "one" / "b.h5", folder / "one" / "a.h5")
    catalogue.update()
    assert row_of(catalogue, "a.h5")["tags"] == []


def test_wrong_tags_and_a_wrong_side_file(folder: Path) -> None:
    """A tag is one word; a side file that holds something else is said, and kept."""
    catalogue = Catalogue(folder)
    catalogue.update()
    row = row_of(catalogue, "a.h5")
    for tag in ("", "two words", "a,b", "x" * 65, "a\x1bb"):
        with pytest.raises(InputError, match="wanted one word"):
            catalogue.change_remarks(row, lambda now, tag=tag: with_tags(now, (tag,)))
    side = side_file(folder / "one" / "a.h5")
    for wrong in ("{", "[]", '{"format": "x"}', "[" * 100_000):
        side.write_text(wrong)
        catalogue.update()
        assert "mend it" in row_of(catalogue, "a.h5")["remarks_problem"]
        with pytest.raises(InputError, match="mend it"):
            catalogue.change_remarks(row, lambda now: with_tags(now, ("warm",)))
        assert side.read_text() == wrong


def test_damaged_files_are_listed_with_the_reason(folder: Path) -> None:
    """A byte that differs, a file cut short, a file of something else: each is a row that says why."""
    content = bytearray((folder / "one" / "a.h5").read_bytes())
    spoilt = bytearray(content)
    spoilt[len(content) // 3] ^= 1
    (folder / "spoilt.h5").write_bytes(spoilt)
    (folder / "short.h5").write_bytes(content[: len(content) // 2])
    (folder / "text.h5").write_text("hello")
    (folder / "empty.h5").write_bytes(b"")
    catalogue = Catalogue(folder)
    catalogue.update()
    why = {row["path"]: row["why"] for row in catalogue.runs(Query(ended="damaged"))}
    assert set(why) == {"spoilt.h5", "short.h5", "text.h5", "empty.h5"}
    assert "differ from what was written" in why["spoilt.h5"]
    assert "cannot be read as HDF5" in why["short.h5"] and "cannot be read as HDF5" in why["text.h5"]


def test_a_large_recording_is_compared_on_demand(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a large file tables alone are compared, which the row says; asked to, every byte is, and the damage shows."""
    monkeypatch.setattr("daq.recording.header.SMALL_BYTES", 0)
    path = folder / "one" / "a.h5"
    with open_recording(path) as opened:
        where = opened._file["drive"].id.get_chunk_info(0).byte_offset + 100
    content = bytearray(path.read_bytes())
    content[where : where + 8] = b"\xff" * 8
    path.write_bytes(content)
    catalogue = Catalogue(folder)
    catalogue.update()
    row = row_of(catalogue, "a.h5")
    assert (row["ended"], row["all_bytes"]) == ("complete", False)
    catalogue.update(all_bytes=True)
    row = row_of(catalogue, "a.h5")
    assert (row["ended"], row["all_bytes"]) == ("damaged", True)
    assert catalogue.update(all_bytes=True) == 0


def test_a_run_that_goes_on_is_listed(folder: Path) -> None:
    """A recording that is being written is a row, incomplete, and becomes complete when it is closed."""
    writer = record(folder / "now.h5", close=False)
    catalogue = Catalogue(folder)
    catalogue.update()
    row = row_of(catalogue, "now.h5")
    assert (row["ended"], row["steps"], row["identity"]) == ("incomplete", 2, "")
    catalogue.change_remarks(row, lambda now: with_tags(now, ("early",)))
    writer.close()
    catalogue.update()
    row = row_of(catalogue, "now.h5")
    assert (row["ended"], row["tags"]) == ("complete", ["early"])


def test_verdicts_are_found_by_the_recording_s_identity(folder: Path, closed_loop: ClosedLoop) -> None:
    """A closed loop kept below the folder belongs to each recording of its identity, copies too; the latest counts."""
    run = folder / "one" / "a.h5"
    with open_recording(run) as opened:
        identity = stored_id(opened)
        assert identity and content_id(opened)
    shutil.copy(run, folder / "copy.h5")
    assert keep_verdict(verdict_on(closed_loop, run), [run]) == ""
    (folder / "broken.loop").write_text("no closed loop", encoding="utf-8")
    catalogue = Catalogue(folder)
    catalogue.update()
    assert sorted(names(catalogue, verdict="explained")) == ["a.h5", "copy.h5"]
    loop = row_of(catalogue, "copy.h5")["loop"]
    assert loop["summary"] == "explained: coulomb_friction" and loop["file"] == "one/a.loop"
    assert (loop["before_us"], loop["after_us"], loop["floor_us"]) == (52.0, 5.0, 5.0)
    later = dataclasses.replace(verdict_on(closed_loop, run, 0.2), verdict="unexplained")
    save_verdict(later, folder / "later.loop")
    catalogue.update()
    assert row_of(catalogue, "a.h5")["loop"]["verdict"] == "unexplained"
    assert len(catalogue.loops(identity)) == 2
    mu = [q for q in catalogue.quantities() if q["name"] == "coulomb_friction.mu_up"]
    assert [(q["value"], q["unit"]) for q in mu] == [(0.2, "g")] * 2
    (folder / "later.loop").unlink()
    catalogue.update()
    assert row_of(catalogue, "a.h5")["loop"]["verdict"] == "explained"


def test_the_sensitivity_over_time(folder: Path, closed_loop: ClosedLoop) -> None:
    """It is what each profile states, and that times the fitted gain where a verdict has one."""
    run = folder / "one" / "a.h5"
    keep_verdict(verdict_on(closed_loop, run), [run])
    catalogue = Catalogue(folder)
    catalogue.update()
    found = [q for q in catalogue.quantities() if q["name"] == "accelerometer.sensitivity"]
    assert [q["value"] for q in found if q["origin"] == "profile"] == [0.1] * 3
    (fitted,) = [q for q in found if q["origin"] == "verdict"]
    assert fitted["value"] == pytest.approx(0.101) and fitted["sigma"] == pytest.approx(1e-4)


def test_links_out_of_the_folder_are_not_followed(folder: Path, tmp_path: Path) -> None:
    """A link to a recording elsewhere is no row, nor is a file in a hidden folder."""
    record(tmp_path / "outside" / "o.h5")
    record(folder / ".hidden" / "h.h5")
    try:
        (folder / "link.h5").symlink_to(tmp_path / "outside" / "o.h5")
        (folder / "dir").symlink_to(tmp_path / "outside")
    except OSError:
        pass  # Windows lets not everybody make symbolic links
    catalogue = Catalogue(folder)
    catalogue.update()
    assert sorted(names(catalogue)) == ["a.h5", "b.h5", "c.h5"]
    with pytest.raises(InputError, match="outside"):
        catalogue.file_of({"path": "../outside/o.h5"})


def test_a_folder_that_cannot_be_written(folder: Path) -> None:
    """The catalogue is kept in memory, one sentence says so, and it answers as ever."""
    (folder / ".shakerbench").write_text("in the way")
    catalogue = Catalogue(folder)
    assert catalogue.path is None and "in memory" in catalogue.said
    assert catalogue.update() == 3
    assert len(catalogue.runs()) == 3


def test_a_catalogue_of_a_newer_version(folder: Path) -> None:
    """It is left as it is, which is said with what to do; the recordings are listed all the same."""
    catalogue = Catalogue(folder)
    catalogue.update()
    path = catalogue.path
    assert path is not None
    newer = json.dumps({"version": VERSION + 1, "rows": []})
    path.write_text(newer)
    for anew in (False, True):
        catalogue = Catalogue(folder, anew=anew)
        assert "newer version" in catalogue.said and "remove that file" in catalogue.said
        assert catalogue.update() == 3
    assert path.read_text() == newer


@pytest.mark.parametrize(
    "spoil", [b"no catalogue at all", b"[" * 100_000, b'{"version": %d}' % VERSION, b"\xff\xfe", b"{}"]
)
def test_a_damaged_catalogue_is_made_again(folder: Path, spoil: bytes) -> None:
    """Rubbish in place of the catalogue costs nothing but the time to read the files."""
    (folder / ".shakerbench").mkdir()
    (folder / ".shakerbench" / "runs.json").write_bytes(spoil)
    catalogue = Catalogue(folder)
    assert "made again" in catalogue.said
    assert catalogue.update() == 3
    catalogue = Catalogue(folder)
    assert catalogue.said == "" and catalogue.update() == 0


def _use(folder: Path, tag: str, turns: int) -> None:
    """Body of a process: bring the catalogue up to date and tag the same recording, again and again."""
    for k in range(turns):
        catalogue = Catalogue(folder, anew=k == 1)
        catalogue.update()
        row = row_of(catalogue, "a.h5")
        catalogue.change_remarks(row, lambda now, k=k: with_tags(now, (f"{tag}{k}",)))


def test_two_processes_at_once(folder: Path) -> None:
    """Two processes that update, rescan and tag at the same time lose no tag, and neither fails."""
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=_use, args=(folder, tag, 6)) for tag in "xy"]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0, 0]
    catalogue = Catalogue(folder)
    catalogue.update()
    assert sorted(row_of(catalogue, "a.h5")["tags"]) == sorted(f"{tag}{k}" for tag in "xy" for k in range(6))


def test_threads_share_a_catalogue(folder: Path) -> None:
    """Threads that update and ask at once get whole answers."""
    failures: list[BaseException] = []
    catalogue = Catalogue(folder)

    def use() -> None:
        try:
            for _ in range(10):
                catalogue.update()
                assert len(catalogue.runs()) == 3
        except BaseException as error:  # noqa: BLE001 (handed to the test)
            failures.append(error)

    threads = [threading.Thread(target=use) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
