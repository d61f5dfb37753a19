"""What a browser says: objects are obeyed, everything else is passed over, and the page goes on."""

from __future__ import annotations

import asyncio
from typing import Any

from bench.web.browsers import Browser, Hub


class Socket:
    """A websocket that says what it was given, and hears."""

    def __init__(self, *texts: str) -> None:
        self.texts = iter(texts)

    async def receive(self) -> dict[str, Any]:
        """The next message as the server's interface (ASGI) has it."""
        text = next(self.texts, None)
        return {"type": "websocket.disconnect"} if text is None else {"type": "websocket.receive", "text": text}

    async def send_text(self, text: str) -> None:
        """Hear."""


def test_nonsense_is_passed_over() -> None:
    """Broken or bottomless JSON, lists, and orders that cannot be: the next order is obeyed all the same."""
    hub, obeyed = Hub(), list[dict[str, Any]]()

    async def greet(browser: Browser) -> None:
        obeyed.append({"greeted": browser.name})

    def obey(browser: Browser, said: dict[str, Any]) -> None:
        obeyed.append(said)
        if "cannot" in said:
            raise ValueError

    said = ("{", "[" * 100_000, "[1]", '{"cannot": 1}', '{"last": 1}')
    asyncio.run(hub.serve(Browser(Socket(*said), "me"), greet, obey))  # type: ignore[arg-type]
    assert obeyed == [{"greeted": "me"}, {"cannot": 1}, {"last": 1}]
    assert hub.browsers == []
