"""Serves the page of a scenario in a thread of the test, and sends it requests as any program could."""

import contextlib
import http.client
import json
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from needleplan.page import HOST, AnyPage, Opened, Page, bind, make_server
from needleplan.planning import PolicyTable
from needleplan.scenario import Scenario

TOKEN = "a token for tests only"


@dataclass(frozen=True)
class Answer:
    """Status, headers and body of an answer."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def told(self) -> dict[str, Any]:
        """The JSON object of the body, or of the header of a binary body."""
        text = self.body
        if self.headers.get("content-type") == "application/octet-stream":
            text = self.body[4 : 4 + int.from_bytes(self.body[:4], "little")]
        found: dict[str, Any] = json.loads(text)
        return found


@dataclass(frozen=True)
class Served:
    """A server that runs, its page and its port."""

    page: AnyPage
    port: int
    token: str
    stop: Callable[[], None]
    """Ends the server; again at the end of the context, where it does nothing."""

    @property
    def address(self) -> str:
        """The address that the command would print."""
        return f"http://{HOST}:{self.port}/#token={self.token.replace(' ', '%20')}"

    def ask(self, path: str, body: object = None, **headers: str) -> Answer:
        """Send a request with the token; `headers` replace the usual ones, and an empty text leaves one out."""
        data = body if isinstance(body, bytes) or body is None else json.dumps(body).encode()
        usual = {"Host": f"{HOST}:{self.port}", "X-Needleplan-Token": self.token}
        sent = {**usual, **{name.replace("_", "-"): value for name, value in headers.items()}}
        connection = http.client.HTTPConnection(HOST, self.port, timeout=30)
        with contextlib.closing(connection):
            connection.putrequest("GET" if data is None else "POST", path, skip_host=True)
            for name, value in sent.items():
                if value:
                    connection.putheader(name, value)
            if data is not None:
                connection.putheader("Content-Length", str(len(data)))
            connection.endheaders()
            with contextlib.suppress(ConnectionError):  # the server may refuse a body before it has read it
                connection.send(data or b"")
            found = connection.getresponse()
            return Answer(found.status, {key.lower(): value for key, value in found.headers.items()}, found.read())


@contextlib.contextmanager
def served(
    scenario: Scenario,
    table: PolicyTable | None = None,
    *,
    port: int = 0,
    token: str = TOKEN,
    opened: Opened | None = None,
) -> Iterator[Served]:
    """Serve a scenario, or what was opened, until the end of the context."""
    with serving(Page(opened or Opened(scenario, "small.toml", table)), port=port, token=token) as found:
        yield found


@contextlib.contextmanager
def serving(page: AnyPage, *, port: int = 0, token: str = TOKEN) -> Iterator[Served]:
    """Serve a page until the end of the context."""
    with bind(port, 0) as listening:
        number = listening.getsockname()[1]
        server = make_server(page, token, number)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()

        def stop() -> None:
            server.should_exit = True
            page.close()
            thread.join(10)
            assert not thread.is_alive()

        try:
            yield Served(page, number, token, stop)
        finally:
            stop()
