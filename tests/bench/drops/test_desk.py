"""The drop desk behind the server: who may change it, and which files a request reaches."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from bench.drops.desk import section
from bench.web.access import Access
from bench.web.serve import Place, make_app

OWN = "http://127.0.0.1:8625"
FIRST, SECOND = "a" * 32, "b" * 32


@pytest.fixture
def client(tmp_path: Path) -> Iterator[TestClient]:
    """A browser of the own machine, on a folder with one table."""
    folder = tmp_path / "runs"
    folder.mkdir()
    (folder / "times.csv").write_text("time (s)\n0.5\n0.9\n1.22\n1.476\n", encoding="utf-8")
    (tmp_path / "secret.csv").write_text("time (s)\n0.5\n0.9\n1.22\n", encoding="utf-8")
    app = make_app(Access("127.0.0.1", 8625), [section(Place(folder.resolve()))])
    with TestClient(app, base_url=OWN) as browser:
        yield browser


def _said(socket: Any, kind: str) -> dict[str, Any]:
    while True:
        told: dict[str, Any] = json.loads(socket.receive_text())
        if told["kind"] == kind:
            return told


def _joined(client: TestClient, name: str) -> Any:
    return client.websocket_connect(f"ws{OWN[4:]}/drop/socket?browser={name}", headers={"origin": OWN})


def test_only_the_holder_of_the_controls_changes_anything(client: TestClient) -> None:
    """A second browser is told so; it gets the controls when the first hands them over."""
    with _joined(client, FIRST) as one, _joined(client, SECOND) as two:
        two.send_text('{"do": "open", "files": ["times.csv"]}')
        assert "another browser" in _said(two, "no")["why"]
        two.send_text('{"do": "ask"}')
        one.send_text('{"do": "hand_over"}')
        while not _said(two, "lease")["mine"]:
            pass
        one.send_text('{"do": "reset"}')
        assert "another browser" in _said(one, "no")["why"]


@pytest.mark.parametrize("name", ["../secret.csv", "/etc/passwd", "none.csv", "..\\secret.csv", ""])
def test_no_request_reaches_a_file_elsewhere(client: TestClient, name: str) -> None:
    """Files outside the folder are as if they were not there."""
    with _joined(client, FIRST) as one:
        assert _said(one, "offer")["files"] == ["times.csv"]
        one.send_text(json.dumps({"do": "open", "files": [name]}))
        assert "no such file" in _said(one, "no")["why"]
    assert client.get("/drop/wave?file=0&start_s=0&stop_s=1&width=100").status_code == 404
    assert client.get("/drop/picture/0").status_code == 404


def test_strange_pages_and_strange_words(client: TestClient) -> None:
    """A page of another site gets no socket; nonsense changes nothing and ends nothing."""
    with (
        pytest.raises(WebSocketDisconnect),
        client.websocket_connect(f"ws{OWN[4:]}/drop/socket?browser={FIRST}", headers={"origin": "http://evil.example"}),
    ):
        pass
    with _joined(client, FIRST) as one:
        for text in (
            "[1]",
            "{",
            '{"do": 3}',
            '{"do": "correct", "file": 9}',
            '{"do": "open", "files": 3}',
            "[" * 20000,
        ):
            one.send_text(text)
        one.send_bytes(b"{}")
        one.send_text('{"do": "save"}')
        assert _said(one, "no")["why"]
    assert client.get("/drop/wave?file=x").status_code == 422
    assert "drop test" in client.get("/drop").text


def test_a_correction_of_nonsense_is_refused(client: TestClient) -> None:
    """Times that are no numbers, and files that are not open, are said; the last good result stays."""
    with _joined(client, FIRST) as one:
        one.send_text('{"do": "open", "files": ["times.csv"]}')
        first = _said(one, "result")
        assert first["parameters"]["e0"]["value"] == pytest.approx(0.8, abs=0.01)
        for wrong in ('{"do": "correct", "file": 1, "new_s": 1}', '{"do": "correct", "file": 0, "new_s": NaN}',
                      '{"do": "correct", "file": true, "gone_s": null}'):  # fmt: skip
            one.send_text(wrong)
            assert "wanted a file" in _said(one, "no")["why"]
        one.send_text('{"do": "options", "fps": -3}')
        assert "positive" in _said(one, "no")["why"]
        one.send_text('{"do": "correct", "file": 0, "gone_s": 1.476}')
        assert len(_said(one, "result")["files"][0]["impacts"]) == len(first["files"][0]["impacts"]) - 1
