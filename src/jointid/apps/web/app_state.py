"""The state that all addresses of the page share, and how they read forms and redirect."""

from __future__ import annotations

import asyncio
from pathlib import Path

from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from jointid.apps.web.folder import Folder
from jointid.apps.web.form import cleaned
from jointid.apps.web.jobs import Jobs
from jointid.apps.web.limits import Limits
from jointid.apps.web.upload import bound_body

_FORM = 512 * 2**10  # bytes of a form without a file


class AppState:
    """The state of one page.

    Attributes:
        folder: in which everything is kept.
        root: begins every address of the page; it holds the token.
        limits: of uploads and runs.
        jobs: the processes at work.
        files: held by a request while it replaces or reads the record, so that one from another tab waits.
    """

    def __init__(self, folder: Path, token: str, limits: Limits) -> None:
        self.folder = Folder(folder)
        self.root = f"/{token}"
        self.limits = limits
        self.jobs = Jobs(limits)
        self.files = asyncio.Lock()

    @classmethod
    def of(cls, request: Request) -> AppState:
        """Return the state of the page that a request is for."""
        found = request.app.state.page
        assert isinstance(found, cls)
        return found

    def redirect(self, path: str) -> Response:
        """Lead the browser to another address of the page, such as "/channels"."""
        return RedirectResponse(f"{self.root}{path}", 303)

    async def save_form(self, request: Request) -> dict[str, str]:
        """Keep the entries of a form without a file, and return the draft with them."""
        async with bound_body(request, _FORM, "The form is larger than any of this page.").form() as sent:
            entries = cleaned((name, value) for name, value in sent.multi_items() if isinstance(value, str))
        draft = {**self.folder.draft, **entries}
        self.folder.save_draft(draft)
        return draft
