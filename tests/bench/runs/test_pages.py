"""The pages of the runs: what they answer, what they refuse, and that text from recordings stays text."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from bench.runs.folder import run_id
from bench.runs.pages import section
from bench.web.access import Access
from bench.web.serve import Place, make_app
from tests.bench.runs.recordings import record

OWN = "http://127.0.0.1:8625"
HOSTILE = "</td><script>alert(1)</script><img src=x onerror=alert(2)>"


@pytest.fixture
def client(folder: Path) -> Iterator[TestClient]:
    """A browser of the own machine, on the pages of a runs' folder."""
    app = make_app(Access("127.0.0.1", 8625), [section(Place(folder.resolve()))])
    with TestClient(app, base_url=OWN) as browser:
        yield browser


def ready(client: TestClient, address: str) -> dict[str, Any]:
    """The answer, once it has been made."""
    for _ in range(600):
        told: dict[str, Any] = client.get(address).json()
        if told.get("state") != "working":
            return told
        time.sleep(0.1)
    raise AssertionError(address)


def test_the_table_is_filtered_and_sorted(client: TestClient) -> None:
    """The list answers the query in the address; a wrong one is refused in words."""
    told = client.get("/runs/api/list?sort=-gamma&profile=paper").json()
    assert [run["path"] for run in told["runs"]] == ["one/b.h5", "one/a.h5"]
    assert told["profiles"] == ["paper", "spring"]
    assert [run["path"] for run in client.get("/runs/api/list?gamma_low=1.45").json()["runs"]] == ["two/c.h5"]
    for wrong in ("sort=size", "c=x", "gamma_low=x"):
        assert client.get(f"/runs/api/list?{wrong}").status_code == 422


def test_a_run_opens_and_zooms(client: TestClient) -> None:
    """A run opens to its length and channels; views hold columns for much of it and samples for a little."""
    id = run_id("one/b.h5")
    assert client.get(f"/runs/api/{id}/view?start_s=0&stop_s=1&width=10").status_code == 409
    told = ready(client, f"/runs/api/{id}/open")
    assert told["duration_s"] == pytest.approx(1.07) and len(told["steps"]) == 2
    assert [channel["name"] for channel in told["channels"]] == ["continuity", "accelerometer", "drive"]
    wide = client.get(f"/runs/api/{id}/view?start_s=0&stop_s=1.07&width=5").json()
    assert len(wide["time_s"]) == 5 and max(wide["channels"]["continuity"]["high"]) > 4.9
    assert wide["lost"] == [[0.5, 0.57, 70.0]]
    deep = client.get(f"/runs/api/{id}/view?start_s=0.6&stop_s=0.61&width=500").json()
    assert deep["samples_per_point"] == 1.0 and len(deep["time_s"]) == 11
    assert client.get(f"/runs/api/{id}/view?start_s=2&stop_s=1&width=5").status_code == 422
    assert client.get(f"/runs/api/{id}/view?start_s=nan&stop_s=1&width=5").status_code == 422
    assert client.get(f"/runs/api/{id}/view?start_s=0&stop_s=1&width=100000").status_code == 422


def test_the_scope_of_a_recording_that_has_changed(client: TestClient, folder: Path) -> None:
    """Where a file is replaced, its scope is made anew of what is there now."""
    id = run_id("one/a.h5")
    assert ready(client, f"/runs/api/{id}/open")["duration_s"] == pytest.approx(1.0)
    (folder / "one" / "a.h5").unlink()
    record(folder / "one" / "a.h5", gammas=(1.0,))
    client.get("/runs/api/list")
    time.sleep(1.1)
    client.get("/runs/api/list")
    assert ready(client, f"/runs/api/{id}/open")["duration_s"] == pytest.approx(0.5)


def test_steps_and_their_flights(client: TestClient) -> None:
    """The diagram of a run is made by the worker; a damaged file answers with its reason."""
    told = ready(client, f"/runs/api/{run_id('two/c.h5')}/flights")
    assert [step["commanded"] for step in told["steps"]] == [1.5, 1.9]


def test_tags_and_notes_from_a_page(client: TestClient, folder: Path) -> None:
    """They are kept in the file beside the recording; what is no tag is refused; a strange origin changes nothing."""
    address = f"/runs/api/{run_id('one/a.h5')}/remarks"
    own = {"origin": OWN}
    told = client.post(address, json={"add": ["warm"], "note": "loose"}, headers=own).json()
    assert told["tags"] == ["warm"] and told["notes"][-1]["text"] == "loose"
    assert (folder / "one" / "a.h5.remarks.json").exists()
    assert client.post(address, json={"add": ["two words"]}, headers=own).status_code == 422
    for wrong in (b"{", b"[1]", b'{"add": 3}'):
        assert client.post(address, content=wrong, headers=own).status_code == 422
    assert client.post(address, json={"add": ["x"]}, headers={"origin": "http://evil.test"}).status_code == 403
    assert client.get(f"/runs/api/{run_id('one/a.h5')}").json()["run"]["tags"] == ["warm"]


@pytest.mark.parametrize(
    "name",
    [
        "../a.h5",
        "..%2f..%2fetc%2fpasswd",
        "%2e%2e",
        "one%2fa.h5",
        "C:%5cx",
        "0" * 11,
        "0" * 12,
        "x" * 12,
        "0" * 13,
    ],
)
def test_no_path_is_taken(client: TestClient, name: str) -> None:
    """Whatever stands in the place of a run's short name reaches no file."""
    for address in (f"/runs/{name}", f"/runs/api/{name}", f"/runs/api/{name}/open", f"/runs/api/{name}/flights"):
        assert client.get(address).status_code in (400, 404)
    assert client.get(f"/runs/compare?ids={name}").status_code == (200 if name == "0" * 12 else 404)
    assert client.get(f"/static/runs/{name}").status_code == 404


def test_text_from_recordings_is_escaped(client: TestClient, folder: Path) -> None:
    """A file's name with markup in it is text on its page, and answers for scripts are JSON, never HTML."""
    path = folder / "a&b <i>x.h5"
    try:
        record(path, profile=HOSTILE, note=HOSTILE)
    except OSError:
        path = folder / "a&b x.h5"  # Windows knows no such name
        record(path, profile=HOSTILE, note=HOSTILE)
    client.get("/runs/api/list")
    page = client.get(f"/runs/{run_id(path.name)}").text
    assert "<i>" not in page and "a&amp;b" in page
    answer = client.get(f"/runs/api/{run_id(path.name)}")
    assert answer.headers["content-type"] == "application/json"
    assert answer.json()["run"]["note"] == HOSTILE
