"""Strangers are refused, over HTTP and sockets: a foreign Host (DNS rebinding), a foreign Origin (a page elsewhere)."""

import asyncio

import pytest

from termwise.reports.live.guard import Guard

OURS, LOCAL = b"127.0.0.1:8123", b"localhost:8123"
HEADERS = [
    ([(b"host", OURS)], True),
    ([(b"host", LOCAL)], True),
    ([(b"host", OURS), (b"origin", b"http://127.0.0.1:8123")], True),
    ([(b"host", OURS), (b"origin", b"http://localhost:8123")], True),
    ([], False),
    ([(b"host", b"evil.example")], False),
    ([(b"host", b"127.0.0.1:8124")], False),
    ([(b"host", b"127.0.0.1")], False),
    ([(b"host", b"127.0.0.1:8123.evil.example")], False),
    ([(b"host", OURS), (b"host", b"evil.example")], False),
    ([(b"host", OURS), (b"origin", b"http://evil.example")], False),
    ([(b"host", OURS), (b"origin", b"null")], False),
    ([(b"host", OURS), (b"origin", b"http://127.0.0.1:8124")], False),
    ([(b"host", OURS), (b"origin", b"https://127.0.0.1:8123")], False),
]


@pytest.mark.parametrize("kind", ["http", "websocket"])
@pytest.mark.parametrize(("headers", "allowed"), HEADERS)
def test_strangers_are_refused(headers, allowed, kind):
    reached, sent = [], []

    async def application(scope, receive, send):
        reached.append(scope)

    async def receive():
        return {}

    async def send(message):
        sent.append(message)

    asyncio.run(Guard(application, port=8123)({"type": kind, "headers": headers}, receive, send))
    assert bool(reached) == allowed
    if not allowed:
        expected = {"http": ("http.response.start", 403), "websocket": ("websocket.close", 1008)}[kind]
        assert (sent[0]["type"], sent[0].get("status", sent[0].get("code"))) == expected
