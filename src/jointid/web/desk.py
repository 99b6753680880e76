"""What every address of the page shares: the visitors, their cookies, the forms they send, how they are answered."""

from __future__ import annotations

import asyncio
from pathlib import Path
from urllib.parse import parse_qsl
from weakref import WeakValueDictionary

from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, RedirectResponse, Response

from jointid.common.errors import JointidError
from jointid.web import pages
from jointid.web.form import cleaned
from jointid.web.jobs import Jobs
from jointid.web.limits import Limits
from jointid.web.sessions import COOKIE, PageError, Sessions, Visitor, new_token
from jointid.web.upload import too_large

_FORM = 512 * 2**10  # bytes of a form without a file
_AROUND = 2**16  # bytes of a form around its file
_DAY = 86400


class Desk:
    """Where visitors are received.

    Attributes:
        limits: of what is taken.
        sessions: the visitors' folders.
        jobs: their identifications.
    """

    def __init__(self, folder: Path, limits: Limits) -> None:
        self.limits = limits
        self.sessions = Sessions(folder, limits)
        self.jobs = Jobs(limits)
        self._turns: WeakValueDictionary[Path, asyncio.Lock] = WeakValueDictionary()

    def turn(self, visitor: Visitor) -> asyncio.Lock:
        """Return what a request holds while it works on a visitor's files, so that one from another tab waits."""
        return self._turns.setdefault(visitor.folder, asyncio.Lock())

    def known(self, request: Request) -> Visitor | None:
        """Return the visitor who has been here before, None where there is nothing of them."""
        visitor = self.sessions.visitor(request.cookies.get(COOKIE))
        if visitor is None or not visitor.folder.is_dir():
            return None
        visitor.touch()
        return visitor

    def visitor(self, request: Request) -> tuple[Visitor, str]:
        """Return the visitor and their cookie, a new one if need be."""
        token = request.cookies.get(COOKIE)
        visitor = self.sessions.visitor(token)
        if visitor is None or token is None:
            token = new_token()
            visitor = self.sessions.visitor(token)
            assert visitor is not None
        return visitor, token

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
        answer.set_cookie(COOKIE, token, max_age=age, path="/", httponly=True, samesite="strict")
        return answer

    def refused(self, request: Request, visitor: Visitor, token: str, error: JointidError) -> Response:
        """Say on step 1 why a record was refused."""
        if "application/json" in request.headers.get("accept", ""):
            return JSONResponse({"said": str(error)}, 422)
        known = visitor if visitor.folder.is_dir() else None
        answer = HTMLResponse(pages.record_page(known, self.limits, str(error).splitlines()), 422)
        return answer if known is None else self._with_cookie(answer, token)

    def nothing(self, request: Request) -> Response:
        """Say that there is nothing at an address, or nothing of this visitor's."""
        said = "There is nothing at this address, or nothing of yours."
        return HTMLResponse(pages.message_page(self.known(request), self.limits, "Not found", said), 404)
