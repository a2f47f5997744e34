"""Who may use the server: only the page that it served itself, in the browser that has the token.

Other web pages that the user visits can send requests to localhost. Three rules keep them out: a token in a header,
which a foreign page neither knows nor may send; the `Host` must be this server, against DNS rebinding; and a foreign
`Origin` is refused. The content security policy lets the page load nothing from elsewhere.
"""

from __future__ import annotations

import hmac
import json
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = ["MOST_BYTES", "Guard", "GuardedBody"]

# Largest size of a request in bytes; a scenario with 100,000 corners has about 4 MB.
MOST_BYTES = 8_000_000

_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = [
    (b"content-security-policy", _POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
]


class GuardedBody(Exception):
    """The body of a request has more than `MOST_BYTES` bytes."""


class Guard:
    """ASGI layer that refuses foreign requests, limits their size, and adds headers to every answer.

    Paths below `/api/` need the token, in the header `X-Needleplan-Token`. The other paths are the files of the page,
    which hold no secret.
    """

    def __init__(self, app: ASGIApp, token: str, port: int) -> None:
        self._app = app
        self._token = token.encode()
        self._hosts = {f"{name}:{port}".encode() for name in ("127.0.0.1", "localhost")}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request, or refuse it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message.get("headers", []), *_HEADERS]}
            await send(message)

        refusal = self._refusal(scope)
        if refusal:
            await _refuse(send_guarded, *refusal)
            return
        received = 0

        async def receive_limited() -> Message:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > MOST_BYTES:
                raise GuardedBody
            return message

        try:
            await self._app(scope, receive_limited, send_guarded)
        except GuardedBody:
            await _refuse(send_guarded, 413, "too_large", f"the request is larger than {MOST_BYTES:,} bytes")

    def _refusal(self, scope: Scope) -> tuple[int, str, str] | None:
        """Return status, kind and text of a refusal, or None for a request that is served."""
        headers = dict(scope["headers"])
        host, origin = headers.get(b"host", b""), headers.get(b"origin")
        if host not in self._hosts:
            return 403, "foreign", "this server answers on localhost only"
        if origin is not None and origin not in {b"http://" + each for each in self._hosts}:
            return 403, "foreign", "requests of other web pages are refused"
        if headers.get(b"sec-fetch-site", b"none") not in (b"none", b"same-origin"):
            return 403, "foreign", "requests of other web pages are refused"
        if scope["path"].startswith("/api/"):
            given = headers.get(b"x-needleplan-token", b"")
            if not hmac.compare_digest(given, self._token):
                return 401, "token", "the token is wrong: open the address that `needleplan view` has printed"
        size = headers.get(b"content-length", b"0")
        if not size.isdigit() or int(size) > MOST_BYTES:
            return 413, "too_large", f"the request is larger than {MOST_BYTES:,} bytes"
        return None


async def _refuse(send: Send, status: int, kind: str, text: str) -> None:
    body = json.dumps({"kind": kind, "text": text}).encode()
    headers = [(b"content-type", b"application/problem+json"), (b"content-length", str(len(body)).encode())]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
