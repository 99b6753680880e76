"""The page as an application: what guards its addresses, and how it starts and stops."""

from __future__ import annotations

import contextlib
import os
import secrets
import socket
from collections.abc import AsyncIterator
from pathlib import Path
from urllib.parse import urlsplit

import h11
import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect
from starlette.responses import PlainTextResponse
from starlette.routing import Mount
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from jointid.apps.web.folder import Limits
from jointid.apps.web.routes import HANDLERS, ROUTES, Page

_HERE = ("127.0.0.1", "localhost", "::1")  # names under which only this machine reaches the page
_GRACE = 2  # seconds that an open connection is given when the page ends
_CONNECTIONS = 200  # more are refused
_OWNER_ALONE = 0o077

_HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "frame-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",  # the address holds the token
    "cache-control": "no-store",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
}


class _Guard:
    """Refuse requests without the token, under a foreign name or from another site; bound what browsers may do.

    A page elsewhere can have a browser send requests here, under this machine's name or, by rebinding its own name's
    address, under its own. It does not know the token; the header Host tells the name all the same.
    """

    def __init__(self, app: ASGIApp, token: str) -> None:
        self._app = app
        self._token = token.encode()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        refusal = self._refuse(scope["method"], scope["path"], Headers(scope=scope))
        app = self._app if refusal is None else PlainTextResponse(f"{refusal}\n", 403)
        with contextlib.suppress(ClientDisconnect):  # whoever asked has gone
            await app(scope, receive, send_guarded)

    def _refuse(self, method: str, path: str, headers: Headers) -> str | None:
        """Return why a request is refused, None if it is not."""
        if not _is_here(headers.get("host", "")):
            return "This page is not reached under that name; open the address that jointid serve printed."
        if not secrets.compare_digest(path.removeprefix("/").partition("/")[0].encode(errors="replace"), self._token):
            return "The token is missing or wrong; open the whole address that jointid serve printed at its last start."
        if "\0" in path:  # no file has such a name, and to look for one is an error
            return "There is nothing at an address with a zero byte in it."
        if method not in ("GET", "HEAD") and headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
            return "This request comes from another site, and is refused; use the page itself."
        return None


def _is_here(host: str) -> bool:
    try:
        return (urlsplit(f"//{host}").hostname or "").lower() in _HERE
    except ValueError:
        return False


def build_application(folder: Path, token: str, limits: Limits | None = None) -> Starlette:
    """Return the page as an ASGI application; the token is the first part of every address that it answers."""
    page = Page(folder, token, limits or Limits())

    @contextlib.asynccontextmanager
    async def live(_: Starlette) -> AsyncIterator[None]:
        page.folder.remove_uploads()
        yield
        await page.jobs.close()

    application = Starlette(
        routes=[Mount(page.root, routes=ROUTES)],
        middleware=[Middleware(_Guard, token=token)],
        exception_handlers=HANDLERS,
        lifespan=live,
    )
    application.state.page = page
    return application


class _Protocol(H11Protocol):
    """HTTP protocol that closes the connection of a malformed request."""

    def send_400_response(self, msg: str) -> None:
        """Refuse what is no HTTP; for whoever already answers the beginning of it, the visitor has gone."""
        if self.cycle is not None and not self.cycle.response_complete:
            self.cycle.disconnected = True
            self.cycle.message_event.set()
        if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE):
            super().send_400_response(msg)
        else:
            self.transport.close()


def run(application: Starlette, listening: socket.socket) -> None:
    """Serve the page on a socket that listens, until it is interrupted; nobody else may read what it writes."""
    config = uvicorn.Config(
        application, http=_Protocol, ws="none", limit_concurrency=_CONNECTIONS, log_level="warning",
        timeout_graceful_shutdown=_GRACE, server_header=False,
    )  # fmt: skip
    before = os.umask(_OWNER_ALONE)
    try:
        uvicorn.Server(config).run(sockets=[listening])
    finally:
        os.umask(before)
