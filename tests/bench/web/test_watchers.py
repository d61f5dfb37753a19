"""Watchers by link: they look, and can do nothing; too many requests are refused."""

from __future__ import annotations

import json

import pytest
from starlette.responses import PlainTextResponse
from starlette.testclient import TestClient

from bench.live.pages import Desk
from bench.web.access import COOKIE, Access
from bench.web.serve import MOST_PER_S, Slow
from daq.setup.clock import Clock

ADDRESS = "http://192.0.2.7:9000"
SOCKET = "/live/socket?browser=0123456789abcdef"
HEADERS = {"origin": ADDRESS, "host": "192.0.2.7:9000", "cookie": f"{COOKIE}=secret"}


class Still(Clock):
    """A clock that stands until it is set."""

    now_s = 100.0

    def monotonic_s(self) -> float:
        """The time that was set."""
        return self.now_s


@pytest.fixture
def desk() -> Desk:
    """A desk without a run."""
    return Desk(None)


@pytest.fixture
def watcher(desk: Desk) -> TestClient:
    """A browser of another machine that has opened the link."""
    app = desk.watchers.application(Access("192.0.2.7", 9000, "secret"))
    client = TestClient(app, base_url=ADDRESS)
    assert client.get("/").status_code == 401
    assert client.get("/?token=secret").status_code == 200
    return client


def test_a_watcher_reaches_the_page_and_nothing_that_changes_anything(watcher: TestClient) -> None:
    """The page of the run is there; the gates, the runs and every request that changes something are not."""
    assert 'class="live watching' in watcher.get("/").text
    for path in ("/gates", "/gates/socket", "/runs", "/runs/api/list", "/drop", "/live"):
        assert watcher.get(path).status_code == 404
    assert watcher.post("/", headers={"origin": ADDRESS}).status_code == 405


def test_what_a_watcher_says_is_passed_over(desk: Desk, watcher: TestClient) -> None:
    """A watcher neither holds the controls nor stops, shares or asks for anything; it is sent no link."""
    with watcher.websocket_connect(SOCKET, headers=HEADERS) as socket:
        assert json.loads(socket.receive_text())["kind"] == "offer"
        for word in ("ask", "now", "share", "start", "note"):
            socket.send_text(json.dumps({"do": word, "on": True, "hands_off": True}))
        desk.hub.tell({"kind": "taken"})
        assert json.loads(socket.receive_text())["kind"] == "taken"
        assert desk.hub.lease.holder is None and desk.hub.lease.asked_by is None and desk.watchers.url == ""


def test_a_watcher_gets_the_state_twice_a_second_and_no_scope(desk: Desk, watcher: TestClient) -> None:
    """Of twenty states at once the first comes through, of the scope's pieces none."""
    with watcher.websocket_connect(SOCKET, headers=HEADERS) as socket:
        socket.receive_text()
        for sample in range(20):
            desk.hub.tell({"kind": "state", "sample": sample})
            desk.hub.tell(b"piece", passing=True)
        desk.hub.tell({"kind": "ended"})
        assert json.loads(socket.receive_text()) == {"kind": "state", "sample": 0}
        assert json.loads(socket.receive_text()) == {"kind": "ended"}


def test_an_address_that_asks_too_often_waits() -> None:
    """Within a second thirty requests of an address are answered and no more; in the next second it may ask again."""
    clock = Still()
    client = TestClient(Slow(PlainTextResponse("here"), clock))
    found = [client.get("/").status_code for _ in range(MOST_PER_S + 2)]
    assert found == [200] * MOST_PER_S + [429, 429]
    clock.now_s += 1.0
    assert client.get("/").status_code == 200
