"""The page served: connections that stand still are closed, and what is written is its owner's alone."""

from __future__ import annotations

import asyncio
import os
import socket

import h11
import uvicorn
from starlette.applications import Starlette
from uvicorn.protocols.http.h11_impl import H11Protocol

_GRACE = 2  # seconds that an open connection is given when the page ends
_HEADERS = 10.0  # seconds in which a request has to say what it is
_CONNECTIONS = 200  # more are refused
_OWNER_ALONE = 0o077


class _Protocol(H11Protocol):
    """HTTP whose connections are closed when no request comes in time; the server by itself waits for ever."""

    _late: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a request."""
        super().connection_made(transport)
        self._await_request()

    def data_received(self, data: bytes) -> None:
        """Take what came, and wait for the rest of a request's head."""
        super().data_received(data)
        self._await_request()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no longer."""
        super().connection_lost(exc)
        if self._late is not None:
            self._late.cancel()

    def send_400_response(self, msg: str) -> None:
        """Refuse what is no HTTP; for whoever already answers the beginning of it, the visitor has gone."""
        if self.cycle is not None and not self.cycle.response_complete:
            self.cycle.disconnected = True
            self.cycle.message_event.set()
        if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE):
            super().send_400_response(msg)
        else:
            self.transport.close()

    def _await_request(self) -> None:
        waits = self.cycle is None or self.cycle.response_complete
        if waits and self._late is None:
            self._late = self.loop.call_later(_HEADERS, self.transport.close)
        elif not waits and self._late is not None:
            self._late.cancel()
            self._late = None


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
