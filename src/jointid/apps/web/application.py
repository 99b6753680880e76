"""The page as an application: what guards its addresses, and how it starts and stops."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import socket
from collections.abc import AsyncIterator
from pathlib import Path

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import ClientDisconnect
from starlette.responses import PlainTextResponse
from starlette.routing import Mount
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from jointid.apps.web.routes import HANDLERS, ROUTES, Page

_GRACE = 2  # seconds that an open connection is given when the page ends
_CONNECTIONS = 200  # more are refused

_HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "frame-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",  # the address holds the token
    "cache-control": "no-store",
}


def _guard(app: ASGIApp, token: str) -> ASGIApp:
    """Return an application that refuses requests without the token.

    A page elsewhere can have a browser send requests here. It does not know the token.
    """

    async def guarded(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await app(scope, receive, send)
            return
        given, headers = scope["path"].removeprefix("/").partition("/")[0], Headers(scope=scope)
        foreign = headers.get("sec-fetch-site", "none") not in ("none", "same-origin")
        known = secrets.compare_digest(given.encode(errors="replace"), token.encode()) and "\0" not in scope["path"]
        refused = not known or (foreign and scope["method"] not in ("GET", "HEAD"))
        said = "The token is missing or wrong; open the whole address that jointid serve printed at its last start.\n"

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                own = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    own.setdefault(name, value)
            await send(message)

        with contextlib.suppress(ClientDisconnect):  # whoever asked has gone
            await (PlainTextResponse(said, 403) if refused else app)(scope, receive, send_guarded)

    return guarded


def build_application(folder: Path, token: str) -> Starlette:
    """Return the page as an ASGI application; the token is the first part of every address that it answers."""
    page = Page(folder, token)

    @contextlib.asynccontextmanager
    async def live(_: Starlette) -> AsyncIterator[None]:
        for path in folder.glob("upload-*"):  # what was on its way in when the page was killed
            shutil.rmtree(path, ignore_errors=True)
        yield
        await page.jobs.cancel()

    # Another name may have been rebound to this machine's address.
    here = Middleware(TrustedHostMiddleware, allowed_hosts=["127.0.0.1", "localhost"])
    application = Starlette(
        routes=[Mount(page.root, routes=ROUTES)],
        middleware=[Middleware(_guard, token=token), here],
        exception_handlers=HANDLERS,
        lifespan=live,
    )
    application.state.page = page
    return application


def run(application: Starlette, listening: socket.socket) -> None:
    """Serve the page on a socket that listens, until it is interrupted; nobody else may read what it writes."""
    config = uvicorn.Config(
        application, http="h11", ws="none", limit_concurrency=_CONNECTIONS, log_level="warning",
        timeout_graceful_shutdown=_GRACE, server_header=False,
    )  # fmt: skip
    before = os.umask(0o077)  # the owner alone
    try:
        uvicorn.Server(config).run(sockets=[listening])
    finally:
        os.umask(before)
