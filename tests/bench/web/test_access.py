"""Access to the desk: strange hosts, strange origins, paths and missing tokens are refused; text is escaped."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.testclient import TestClient
from starlette.websockets import WebSocket, WebSocketDisconnect

from bench.web.access import Access, file_inside
from bench.web.serve import FRAME, Section, bind, make_app, templates_of
from daq.setup.errors import InputError

OWN = "http://127.0.0.1:8625"


def _client(access: Access, base_url: str) -> TestClient:
    async def read(request: Request) -> Response:
        values = {"status": "<b>", "detail": "<script>alert(1)</script>"}
        return templates_of(FRAME).TemplateResponse(request, "error.html", values)

    async def change(request: Request) -> Response:
        return PlainTextResponse(f"changed by {len(await request.body())} bytes")

    async def talk(opened: WebSocket) -> None:
        await opened.accept()
        await opened.send_text("hello")
        await opened.close()

    routes = [Route("/one", read), Route("/change", change, methods=["POST"]), WebSocketRoute("/talk", talk)]
    return TestClient(make_app(access, [Section("one", "One", "/one", routes)]), base_url=base_url)


@pytest.fixture
def own() -> TestClient:
    """A browser of the own machine."""
    return _client(Access("127.0.0.1", 8625), OWN)


def test_own_page_is_served_confined(own: TestClient) -> None:
    """A page of this server comes with a policy that lets it load from this server alone."""
    answer = own.get("/")
    assert answer.status_code == 200
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy and "script-src 'self';" in policy and "unsafe" not in policy
    assert answer.headers["x-content-type-options"] == "nosniff" and answer.headers["x-frame-options"] == "DENY"


def test_text_is_escaped(own: TestClient) -> None:
    """Text from a recording cannot become markup, in the body or in the title."""
    text = own.get("/one").text
    assert "<script>alert" not in text and "&lt;script&gt;alert" in text and "<title>&lt;b&gt; " in text


STRANGE_HOSTS = (
    "evil.example", "evil.example:8625", "127.0.0.1.evil.example:8625", "", "127.0.0.1", "127.0.0.1:80",
    "user@127.0.0.1:8625", "[::1]:8625", "127.0.0.1:8625/x",
)  # fmt: skip


@pytest.mark.parametrize("host", STRANGE_HOSTS)
def test_strange_host_is_refused(own: TestClient, host: str) -> None:
    """A name that was made to lead to this machine (DNS rebinding) gets no page."""
    assert own.get("/one", headers={"host": host}).status_code == 421


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://localhost:8625", "https://127.0.0.1:8625",
                                    "http://127.0.0.1:8626", ""])  # fmt: skip
def test_strange_origin_is_refused(own: TestClient, origin: str) -> None:
    """Neither a form of another site (CSRF) nor its websocket gets through."""
    assert own.get("/one", headers={"origin": origin}).status_code == 403
    assert own.post("/change", headers={"origin": origin}).status_code == 403
    with pytest.raises(WebSocketDisconnect), own.websocket_connect(f"ws{OWN[4:]}/talk", headers={"origin": origin}):
        pass


def test_change_needs_an_origin(own: TestClient) -> None:
    """What changes something must come from a page of this server; a request without an origin does not."""
    assert own.post("/change").status_code == 403
    with pytest.raises(WebSocketDisconnect), own.websocket_connect(f"ws{OWN[4:]}/talk"):
        pass
    assert own.post("/change", headers={"origin": OWN}, content=b"xx").text == "changed by 2 bytes"
    with own.websocket_connect(f"ws{OWN[4:]}/talk", headers={"origin": OWN}) as socket:
        assert socket.receive_text() == "hello"


def test_other_sites_may_only_link(own: TestClient) -> None:
    """A picture or script that another site embeds is refused; a link that a person follows is not."""
    cross = {"sec-fetch-site": "cross-site"}
    assert own.get("/one", headers={**cross, "sec-fetch-dest": "image"}).status_code == 403
    assert own.get("/one", headers={**cross, "sec-fetch-dest": "document"}).status_code == 200


def test_too_large_a_body_is_refused(own: TestClient) -> None:
    """A body beyond the limit is refused before it is read."""
    assert own.post("/change", headers={"origin": OWN}, content=b"x" * 1_000_001).status_code == 413


def test_other_machines_need_the_token() -> None:
    """Beyond the own machine: nothing without the token, which is taken once and kept as a cookie."""
    address = "http://192.0.2.7:9000"
    client = _client(Access("192.0.2.7", 9000, "secret"), address)
    assert client.get("/one").status_code == 401
    assert client.get("/one?token=wrong").status_code == 401
    assert client.post("/change?token=secret", headers={"origin": address}).status_code == 401
    first = client.get("/one?token=secret&a=1", follow_redirects=False)
    assert first.status_code == 303 and first.headers["location"] == "/one?a=1"
    assert (
        "httponly" in first.headers["set-cookie"].lower() and "samesite=strict" in first.headers["set-cookie"].lower()
    )
    assert client.get("/one").status_code == 200
    assert client.get("/one", headers={"host": "evil.example:9000"}).status_code == 421


def test_network_address_without_token_is_refused() -> None:
    """A server that other machines reach is never made without a token."""
    with pytest.raises(InputError, match="token"):
        Access("0.0.0.0", 8625)
    listening, access = bind("0.0.0.0", 0)
    listening.close()
    assert access.token is not None and len(access.token) >= 24


def test_every_address_knows_no_foreign_name() -> None:
    """A server at every address answers to addresses and its own name, not to a name made to lead there."""
    access = Access("0.0.0.0", 9000, "secret")
    assert access.knows_host("192.0.2.7:9000") and access.knows_host("localhost:9000")
    assert not access.knows_host("evil.example:9000")


def test_taken_port_is_a_clear_error() -> None:
    """A port that is in use is refused with what to do; without a wish the next free one is taken."""
    first, access = bind("127.0.0.1", 0)
    with first, pytest.raises(InputError, match="--port"):
        bind("127.0.0.1", access.port)


def test_port_of_a_server_that_died_is_free_again() -> None:
    """A server that went away while a browser was connected does not keep its port from the next one."""
    first, access = bind("127.0.0.1", 0)
    with socket.create_connection(("127.0.0.1", access.port)) as browser:
        theirs, _ = first.accept()
        theirs.close()
        first.close()
        assert browser.recv(1) == b""
    again, same = bind("127.0.0.1", access.port)
    again.close()
    assert same.port == access.port


@pytest.mark.parametrize("name", ["../secret.h5", "/etc/passwd", "a/../../secret.h5", "..\\secret.h5", "C:/secret.h5",
                                  "link.h5", "folder", "", ".", "no.h5", "a//b", "x\0.h5"])  # fmt: skip
def test_no_path_leads_out_of_the_folder(tmp_path: Path, name: str) -> None:
    """Neither dots, absolute paths, drives nor links lead to a file outside the runs' folder."""
    folder = tmp_path / "runs"
    (folder / "folder").mkdir(parents=True)
    (tmp_path / "secret.h5").write_text("secret", encoding="utf-8")
    (folder / "link.h5").symlink_to(tmp_path / "secret.h5")
    with pytest.raises(HTTPException):
        file_inside(folder, name)
    (folder / "folder" / "run.h5").write_text("a run", encoding="utf-8")
    assert file_inside(folder, "folder/run.h5").read_text(encoding="utf-8") == "a run"


def test_static_files_stay_in_their_folder(own: TestClient) -> None:
    """Scripts and styles are served, nothing beside their folder."""
    assert own.get("/static/web/desk.css").status_code == 200
    for path in ("/static/web/../page.py", "/static/web/%2e%2e/page.py", "/static/web/..%2fpage.py"):
        assert own.get(path).status_code == 404
