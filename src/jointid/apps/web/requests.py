"""What comes from the browser: the state that all addresses share, forms and files, bounded and under names of ours."""

from __future__ import annotations

import asyncio
import re
import shutil
from collections.abc import Collection
from pathlib import Path

from python_multipart.exceptions import FormParserError
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.types import Message

from jointid.apps.web.folder import Folder, Limits, PageError
from jointid.apps.web.form import clean_entries
from jointid.apps.web.jobs import Jobs

_FORM = 512 * 2**10  # bytes of a form without a file
_AROUND = 2**16  # bytes of a form around its file
_LONGEST = 80  # characters of a name
_OTHER = re.compile(r"[^\w .()+-]")


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
            entries = clean_entries((name, value) for name, value in sent.multi_items() if isinstance(value, str))
        draft = {**self.folder.draft, **entries}
        self.folder.save_draft(draft)
        return draft


def format_size(size: float) -> str:
    """Return a size in bytes as a sentence says it."""
    return f"{size / 2**20:.0f} MB" if size >= 2**20 else f"{size / 2**10:.0f} kB"


def clean_name(raw: str) -> str:
    """Return the last part of a path without any character that has a meaning; fit to be shown and for an archive."""
    name = _OTHER.sub("_", re.split(r"[/\\]", raw)[-1])
    return name[-_LONGEST:].strip(" .") or "record"


def bound_body(request: Request, bound: int, sentence: str) -> Request:
    """Return a request whose body raises a `PageError` with this sentence beyond so many bytes."""
    sent = 0

    async def receive() -> Message:
        nonlocal sent
        message = await request.receive()
        sent += len(message.get("body", b""))
        if sent > bound:
            raise PageError(sentence)
        return message

    return Request(request.scope, receive)


async def receive_file(request: Request, folder: Path, bound: int, suffixes: Collection[str]) -> tuple[Path, str]:
    """Write the file of a form to `incoming` and its suffix in a folder; return its path and the name it came with.

    Args:
        request: with a multipart form.
        folder: to write to.
        bound: bytes of the file, at most.
        suffixes: one of which the name has; that of a folder has none, and cannot be sent.

    Raises:
        PageError: the form has no file, one that is too large or of another suffix, or is damaged.
    """
    sentence = (
        f"The file is larger than {format_size(bound)}, which is the most this page takes; cut it, or log it slower."
    )
    try:
        async with bound_body(request, bound + _AROUND, sentence).form(max_files=1) as form:
            file = form.get("file")
            if not isinstance(file, UploadFile) or not file.filename:
                raise PageError("No file arrived; choose one, and send it again.")
            name = clean_name(file.filename)
            suffix = Path(name).suffix.lower()
            if suffix not in suffixes:
                fact = f'the suffix "{suffix}"' if suffix else "no suffix"
                raise PageError(f"{name} has {fact}; expected one of {', '.join(suffixes)}: rename it.")
            path = folder / f"incoming{suffix}"
            with path.open("wb") as place:
                await run_in_threadpool(shutil.copyfileobj, file.file, place)
    except (HTTPException, FormParserError):  # the form cannot be parsed; older versions of Starlette pass the fault on
        raise PageError("The file did not arrive whole; send it again.") from None
    return path, name
