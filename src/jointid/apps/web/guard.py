"""Guard of every request and answer: the token, the host's name, and the policy that binds the browser."""

from __future__ import annotations

import ipaddress
import secrets
import socket
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from jointid.apps.web.limits import LOOPBACK

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "frame-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
"""Nothing of a page is loaded from elsewhere, and no script or style stands in the page itself."""

REPORT_POLICY = (
    "sandbox allow-scripts allow-downloads allow-modals; default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; frame-ancestors 'self'"
)
"""A report brings its own scripts: they run in a sandbox that reaches neither the page nor the network."""

_HEADERS = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",  # the address holds the token
    "cache-control": "no-store",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=()",
}


class Guard:
    """Refuse requests without the token, under a foreign name or from another site; bound what browsers may do.

    A page elsewhere can have a browser send requests here, under this host's name or, by rebinding its own name's
    address, under its own. It does not know the token; the header Host tells the name all the same.
    """

    def __init__(self, app: ASGIApp, host: str, token: str) -> None:
        self._app = app
        self._token = token.encode()
        self._loopback = host in LOOPBACK
        self._names = {*LOOPBACK, host.lower(), socket.gethostname().lower()}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in {**_HEADERS, "content-security-policy": POLICY}.items():
                    headers.setdefault(name, value)
            await send(message)

        refusal = self._refuse(scope["method"], scope["path"], Headers(scope=scope))
        app = self._app if refusal is None else PlainTextResponse(f"{refusal}\n", 403)
        await app(scope, receive, send_guarded)

    def _refuse(self, method: str, path: str, headers: Headers) -> str | None:
        """Return why a request is refused, None if it is not."""
        if not self._is_here(headers.get("host", "")):
            return "This page is not reached under that name; open the address that jointid serve printed."
        if not secrets.compare_digest(path.split("/")[1].encode(errors="replace"), self._token):
            return "The token is missing or wrong; open the whole address that jointid serve printed at its last start."
        if method not in ("GET", "HEAD") and headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
            return "This request comes from another site, and is refused; use the page itself."
        return None

    def _is_here(self, host: str) -> bool:
        try:
            name = (urlsplit(f"//{host}").hostname or "").lower()
        except ValueError:
            return False
        if name in self._names:
            return True
        if self._loopback:
            return False
        try:  # a number is nobody's name, and cannot be rebound
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True
