"""The page as an application: its addresses, what guards them, and how it starts and stops.

Every request and answer is guarded: by the token, the host's name, and the policy that binds the browser.
"""

from __future__ import annotations

import asyncio
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
from starlette.convertors import IntegerConvertor, register_url_convertor
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from jointid.apps.web import pages, routes
from jointid.apps.web.folder import LOOPBACK, Limits, refusal_of
from jointid.apps.web.pages import AppState
from jointid.common.errors import JointidError

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "frame-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
"""Nothing of a page is loaded from elsewhere, and no script or style stands in the page itself."""

_HEADERS = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",  # the address holds the token
    "cache-control": "no-store",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=()",
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
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        started = False

        async def send_guarded(message: Message) -> None:
            nonlocal started
            if message["type"] == "http.response.start":
                started = True
                headers = MutableHeaders(scope=message)
                for name, value in {**_HEADERS, "content-security-policy": POLICY}.items():
                    headers.setdefault(name, value)
            await send(message)

        refusal = self._refuse(scope["method"], scope["path"], Headers(scope=scope))
        app = self._app if refusal is None else PlainTextResponse(f"{refusal}\n", 403)
        try:
            await app(scope, receive, send_guarded)
        except ClientDisconnect:  # whoever asked has gone
            return
        except asyncio.CancelledError:
            ended = PlainTextResponse("The page is ending.\n", 503, {"connection": "close"})
            if not started:
                await ended(scope, receive, send_guarded)

    def _refuse(self, method: str, path: str, headers: Headers) -> str | None:
        """Return why a request is refused, None if it is not."""
        if not self._is_here(headers.get("host", "")):
            return "This page is not reached under that name; open the address that jointid serve printed."
        if not secrets.compare_digest(path.removeprefix("/").partition("/")[0].encode(errors="replace"), self._token):
            return "The token is missing or wrong; open the whole address that jointid serve printed at its last start."
        if "\0" in path:  # no file has such a name, and to look for one is an error
            return "There is nothing at an address with a zero byte in it."
        if method not in ("GET", "HEAD") and headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
            return "This request comes from another site, and is refused; use the page itself."
        return None

    @staticmethod
    def _is_here(host: str) -> bool:
        try:
            return (urlsplit(f"//{host}").hostname or "").lower() in LOOPBACK
        except ValueError:
            return False


class _Number(IntegerConvertor):
    """A number in an address, of few digits: Python refuses to read thousands, and systems to look for such a file."""

    regex = "[0-9]{1,9}"


register_url_convertor("number", _Number())


def build_application(folder: Path, token: str, limits: Limits | None = None) -> Starlette:
    """Return the page as an ASGI application; the token is the first part of every address that it answers."""
    state = AppState(folder, token, limits or Limits())

    async def show_refusal(request: Request, error: Exception) -> Response:
        assert isinstance(error, JointidError | OSError)
        return pages.show_message(state, 422, "That cannot be done", str(refusal_of(error)))

    async def show_not_found(request: Request, error: Exception) -> Response:
        return pages.show_message(state, 404, "Not found", "There is nothing at this address.")

    async def show_failure(request: Request, error: Exception) -> Response:
        sentence = f"This is a fault of ours ({type(error).__name__}: {error}); please report it. Your data is kept."
        return pages.show_message(state, 500, "The page failed", sentence)

    @contextlib.asynccontextmanager
    async def live(_: Starlette) -> AsyncIterator[None]:
        state.folder.finish_interrupted()
        yield
        await state.jobs.close()

    application = Starlette(
        routes=[Mount(state.root, routes=_ROUTES)],
        middleware=[Middleware(_Guard, token=token)],
        exception_handlers={
            JointidError: show_refusal,
            OSError: show_refusal,
            404: show_not_found,
            405: show_not_found,
            500: show_failure,
        },
        lifespan=live,
    )
    application.state.page = state
    return application


_ROUTES = [
    Route("/", routes.show_record),
    Route("/record", routes.take_record, methods=["POST"]),
    Route("/example", routes.make_example, methods=["POST"]),
    Route("/again", routes.read_again, methods=["POST"]),
    Route("/channels", routes.show_channels, methods=["GET"]),
    Route("/channels", routes.check_channels, methods=["POST"]),
    Route("/plot/{column:number}.svg", routes.draw_column),
    Route("/joint", routes.show_joint, methods=["GET"]),
    Route("/joint", routes.identify, methods=["POST"]),
    Route("/draft", routes.save_draft, methods=["POST"]),
    Route("/runs/{number:number}", routes.show_run),
    Route("/runs/{number:number}/events", routes.stream_progress),
    Route("/runs/{number:number}/cancel", routes.cancel_run, methods=["POST"]),
    Route("/runs/{number:number}/{name:str}", routes.send_file),
    Mount("/static", StaticFiles(packages=[("jointid.apps.web", "static")])),
]


_GRACE = 2  # seconds that an open connection is given when the page ends
_CONNECTIONS = 200  # more are refused
_OWNER_ALONE = 0o077


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
