"""Who may ask: whoever has the token, from this computer, and from no other site's page.

The server listens on the loopback address alone, but every page in a browser can send requests there. So each request must
name this server as its host (a name that an attacker's DNS points here is another), must not come from another origin, and
must bring the token: in the address for the page itself, in a header for all else, which other origins may not send.
"""

import hmac
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any
from urllib.parse import parse_qs

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

TOKEN_HEADER = b"x-tiler-token"
SAFE = (
    (b"cache-control", b"no-store"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
)


class Guard:
    """Lets requests through to `app`, or answers 400 or 403; every answer gets headers that keep it where it belongs."""

    def __init__(self, app: App, token: str, port: int) -> None:
        self._app, self._token = app, token.encode()
        self._hosts = {f"{name}:{port}".encode() for name in ("127.0.0.1", "localhost")}
        if port == 80:  # which browsers do not name
            self._hosts |= {b"127.0.0.1", b"localhost"}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] != "http":
            raise ValueError(f"{scope['type']} is not served")

        async def send_safely(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message.get("headers", []), *SAFE]}
            await send(message)

        refused = self._refuse(scope)
        if refused is None:
            await self._app(scope, receive, send_safely)
            return
        status, text = refused
        headers = [(b"content-type", b"text/plain; charset=utf-8")]
        await send_safely({"type": "http.response.start", "status": status, "headers": headers})
        await send({"type": "http.response.body", "body": text.encode()})

    def _refuse(self, scope: Scope) -> tuple[int, str] | None:
        """Status and text, or None where the request is allowed."""
        headers: dict[bytes, list[bytes]] = {}
        for name, value in scope["headers"]:
            headers.setdefault(name.lower(), []).append(value)
        hosts = headers.get(b"host", [])
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return 400, "This server answers to 127.0.0.1 and localhost only.\n"
        for origin in headers.get(b"origin", []):
            if origin.lower() != b"http://" + hosts[0].lower():
                return 403, "Requests of other pages are refused.\n"
        if headers.get(b"sec-fetch-site", [b"none"])[0] not in (b"none", b"same-origin") and scope["path"] != "/":
            return 403, "Requests of other pages are refused.\n"
        if scope["path"] == "/":
            query = parse_qs(scope["query_string"].decode("latin-1"))
            given = query.get("token", [""])[0].encode("utf-8", "replace")
        else:
            given = headers.get(TOKEN_HEADER, [b""])[0]
        if not hmac.compare_digest(given, self._token):
            return 403, "This address needs the token that `tiler explore` printed with it.\n"
        return None
