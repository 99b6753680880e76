"""What every address of the page shares: the visitors, their cookies, the forms they send, how they are answered."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from urllib.parse import parse_qsl
from weakref import WeakValueDictionary

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, RedirectResponse, Response

from jointid.apps.web import pages
from jointid.apps.web.form import cleaned
from jointid.apps.web.jobs import Jobs
from jointid.apps.web.limits import Limits
from jointid.apps.web.sessions import PageError, Sessions, Visitor, new_token
from jointid.apps.web.upload import too_large
from jointid.common.errors import JointidError

_FORM = 512 * 2**10  # bytes of a form without a file
_AROUND = 2**16  # bytes of a form around its file
_DAY = 86400


class Desk:
    """Where visitors are received.

    Attributes:
        limits: of what is taken.
        sessions: the visitors' folders.
        jobs: their identifications.
        cookie: the name of their cookie.
    """

    def __init__(self, folder: Path, limits: Limits) -> None:
        self.limits = limits
        self.sessions = Sessions(folder, limits)
        self.jobs = Jobs(limits)
        self.cookie = self.sessions.cookie
        self._coming = 0  # records that are on their way
        self._turns: WeakValueDictionary[Path, asyncio.Lock] = WeakValueDictionary()

    @contextlib.asynccontextmanager
    async def turn(self, visitor: Visitor) -> AsyncIterator[None]:
        """Hold a visitor's files while a request works on them, so that one from another tab waits.

        Raises:
            PageError: the visitor has deleted everything meanwhile.
        """
        async with self._turns.setdefault(visitor.folder, asyncio.Lock()):
            with visitor.there():
                yield

    def known(self, request: Request) -> Visitor | None:
        """Return the visitor who has been here before, None where there is nothing of them."""
        visitor = self.sessions.visitor(request.cookies.get(self.cookie))
        if visitor is None or not visitor.folder.is_dir():
            return None
        visitor.touch()
        return visitor

    def visitor(self, request: Request) -> tuple[Visitor, str]:
        """Return the visitor and their cookie; where there is nothing of them both are new, whatever they sent."""
        known = self.known(request)
        if known is not None:
            return known, request.cookies[self.cookie]
        token = new_token()
        visitor = self.sessions.visitor(token)
        assert visitor is not None
        return visitor, token

    @contextlib.asynccontextmanager
    async def admitted(self, request: Request, visitor: Visitor, token: str) -> AsyncIterator[None]:
        """Let a visitor bring a record, for which there is room as long as it is on its way.

        Raises:
            PageError: there is no place for it, or the visitor has deleted everything meanwhile.
        """
        new = request.cookies.get(self.cookie) != token
        self._coming += 1
        try:
            coming = self._coming * self.limits.upload
            await run_in_threadpool(self.sessions.admit, visitor, coming, new=new)
            yield
        finally:
            self._coming -= 1

    def require_small(self, request: Request, bound: int) -> None:
        """Raise a `PageError` where a file is said to be too large before it arrives."""
        said = request.headers.get("content-length", "0")
        if not said.isdigit() or int(said) > bound + _AROUND:
            raise PageError(too_large("The file", bound))

    async def form(self, request: Request) -> dict[str, str]:
        """Return the fields of a form without a file."""
        body = b""
        async for chunk in request.stream():
            body += chunk
            if len(body) > _FORM:
                raise PageError("The form is larger than any of this page.")
        try:
            return cleaned(parse_qsl(body.decode("utf-8"), keep_blank_values=True, max_num_fields=1000))
        except ValueError:
            raise PageError("The form did not arrive whole; send it again.") from None

    def to(self, request: Request, address: str, token: str) -> Response:
        """Lead on, and have the browser keep its cookie."""
        if "application/json" in request.headers.get("accept", ""):
            answer: Response = JSONResponse({"to": address})
        else:
            answer = RedirectResponse(address, 303)
        return self._with_cookie(answer, token)

    def _with_cookie(self, answer: Response, token: str) -> Response:
        age = int(self.limits.days * _DAY)
        answer.set_cookie(self.cookie, token, max_age=age, path="/", httponly=True, samesite="strict")
        return answer

    def refused(self, request: Request, visitor: Visitor, token: str, error: JointidError) -> Response:
        """Say on step 1 why a record was refused."""
        known = visitor if visitor.folder.is_dir() else None
        if "application/json" in request.headers.get("accept", ""):
            answer: Response = JSONResponse({"said": str(error)}, 422)
        else:
            answer = HTMLResponse(pages.record_page(known, self.limits, str(error).splitlines()), 422)
        return answer if known is None else self._with_cookie(answer, token)

    def nothing(self, request: Request) -> Response:
        """Say that there is nothing at an address, or nothing of this visitor's."""
        said = "There is nothing at this address, or nothing of yours."
        return HTMLResponse(pages.message_page(self.known(request), self.limits, "Not found", said), 404)
