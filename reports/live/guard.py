"""Who may speak to the page: a browser on this machine that asked for this address.

Any site that a browser shows can send requests to 127.0.0.1, and with a name that resolves to it (DNS rebinding) read
the answers. Such requests carry the site's Host or Origin, and are refused, those of the socket too.
"""

from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

Message = MutableMapping[str, Any]
Application = Callable[[Message, Callable[[], Awaitable[Message]], Callable[[Message], Awaitable[None]]], Any]


class Guard:
    """ASGI middleware: refuses all whose Host is not one of `hosts`, or that come from a page of another."""

    def __init__(self, app: Application, *, port: int) -> None:
        self.app = app
        self.hosts = frozenset(f"{name}:{port}".encode() for name in ("127.0.0.1", "localhost"))

    async def __call__(self, scope: Message, receive: Any, send: Any) -> None:
        """Answer 403, or let the request pass."""
        if scope["type"] == "lifespan" or self.allows(scope["headers"]):
            await self.app(scope, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        else:
            text = b"termwise view answers pages of its own address only\n"
            headers = [(b"content-type", b"text/plain"), (b"content-length", str(len(text)).encode())]
            await send({"type": "http.response.start", "status": 403, "headers": headers})
            await send({"type": "http.response.body", "body": text})

    def allows(self, headers: list[tuple[bytes, bytes]]) -> bool:
        """Whether a request's Host is ours, and its Origin too where it names one."""
        hosts = [value for name, value in headers if name == b"host"]
        origins = [value for name, value in headers if name == b"origin"]
        ours = {b"http://" + host for host in self.hosts}
        return len(hosts) == 1 and hosts[0] in self.hosts and ours.issuperset(origins)
