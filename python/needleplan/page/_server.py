"""The server of the page: routes over `Page` or `SpacePage`, for this machine only."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

from needleplan.errors import InputError, Mistake
from needleplan.page._access import Guard
from needleplan.page._answers import Page, Unknown
from needleplan.page._diagnosis_answers import DiagnosisPage
from needleplan.page._queue import Superseded
from needleplan.page._requests import STATIC, Request
from needleplan.page._space_answers import SpacePage

if TYPE_CHECKING:
    import uvicorn
    from starlette import requests, responses
    from starlette.types import ASGIApp

__all__ = ["HOST", "AnyPage", "bind", "make_app", "make_server"]

AnyPage = Page | SpacePage | DiagnosisPage
"""What a server serves."""

HOST = "127.0.0.1"
"""The server listens on this address only."""


def make_app(page: AnyPage, token: str, port: int) -> ASGIApp:
    """Return the ASGI application of a page. Raises InputError if the extra `view` is not installed."""
    try:
        from starlette.applications import Starlette
        from starlette.responses import FileResponse, JSONResponse
        from starlette.routing import Mount, Route
        from starlette.staticfiles import StaticFiles
    except ImportError:
        rule = "needs starlette and uvicorn: install them with `pip install needleplan[view]`"
        raise InputError(Mistake("view", "", rule)) from None

    async def index(_: requests.Request) -> responses.Response:
        return FileResponse(STATIC / page.document)

    async def start(_: requests.Request) -> responses.Response:
        return JSONResponse(await asyncio.to_thread(page.start))

    def route(path: str, work: Callable[[Request], bytes]) -> Route:
        async def endpoint(request: requests.Request) -> responses.Response:
            return await _answered(request, lambda body: asyncio.to_thread(work, body))

        return Route(path, endpoint, methods=["POST"])

    app = Starlette(
        routes=[
            Route("/", index),
            Route("/api/start", start),
            *(route(path, work) for path, work in page.works().items()),
            *([Route("/api/plan", _planned(page), methods=["POST"])] if isinstance(page, Page) else []),
            Mount("/static", StaticFiles(directory=STATIC)),
        ]
    )
    return Guard(app, token, port)


def _planned(page: Page) -> Callable[[requests.Request], Awaitable[responses.Response]]:
    """Return the endpoint of plans, which holds no thread while a plan waits."""

    async def answer(body: Request) -> bytes:
        future = await asyncio.to_thread(page.submit, body)
        table = await asyncio.wrap_future(future)
        return await asyncio.to_thread(page.planned, body, table)

    async def endpoint(request: requests.Request) -> responses.Response:
        return await _answered(request, answer)

    return endpoint


async def _answered(request: requests.Request, answer: Callable[[Request], Any]) -> responses.Response:
    """Return the answer to a request, or the reason why there is none, as `application/problem+json`.

    Wrong scenarios and superseded requests are ordinary outcomes during a drag, so their status is 200: a browser
    reports every other status as an error.
    """
    from starlette.responses import Response

    try:
        body = json.loads(await request.body())
        if not isinstance(body, dict):
            raise ValueError("it is no object")
    except (ValueError, RecursionError) as error:
        return _refused(400, "request", f"the request is not JSON: {error}")
    try:
        return Response(await answer(body), media_type="application/octet-stream")
    except InputError as error:
        mistakes = [{"key": mistake.key, "value": mistake.value, "rule": mistake.rule} for mistake in error.mistakes]
        return _refused(200, "input", str(error), mistakes)
    except Superseded:
        return _refused(200, "superseded", "a newer request has replaced this one")
    except Unknown:
        return _refused(200, "unknown", "the server has no such plan; plan again")


def _refused(status: int, kind: str, text: str, mistakes: list[dict[str, str]] | None = None) -> responses.Response:
    from starlette.responses import JSONResponse

    content = {"kind": kind, "text": text, "mistakes": mistakes or []}
    return JSONResponse(content, status, media_type="application/problem+json")


def bind(port: int | None, usual: int) -> socket.socket:
    """Return a socket that listens on a port of this machine.

    Parameters
    ----------
    port : int
        Port, or None.
    usual : int
        Port that is tried if `port` is None, before any free one.

    Returns
    -------
    socket.socket

    Raises
    ------
    InputError
        `port` is given and cannot be used.
    """
    for candidate in (port,) if port is not None else (usual, 0):
        # With the protocol named, asyncio sends small packets at once (TCP_NODELAY); else an answer takes 40 ms longer.
        found = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            found.bind((HOST, candidate))
            found.listen()  # requests that come before the server has begun wait
        except OSError as error:
            found.close()
            reason = error.strerror
        else:
            return found
    raise InputError(Mistake("--port", f"{port}", f"cannot be used: {reason}; choose another one"))


def make_server(page: AnyPage, token: str, port: int) -> uvicorn.Server:
    """Return a server of a page.

    Run it in a thread that is not the main one: in the main thread it would take over the signals, which the command
    handles. Setting its `should_exit` ends it.

    Parameters
    ----------
    page : Page, SpacePage or DiagnosisPage
        Page that is served.
    token : str
        Secret that each request must contain.
    port : int
        Port that requests name.

    Returns
    -------
    uvicorn.Server

    Raises
    ------
    InputError
        The extra `view` is not installed.
    """
    app = make_app(page, token, port)
    import uvicorn

    config = uvicorn.Config(
        app, log_level="warning", access_log=False, lifespan="off", ws="none", timeout_graceful_shutdown=1,
        server_header=False,
    )  # fmt: skip
    return uvicorn.Server(config)
