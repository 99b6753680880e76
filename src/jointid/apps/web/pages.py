"""State of the page, its incoming forms and files, and its outgoing pages.

Forms and files come in bounded; pages go out as HTML from templates of our own, every text that came in escaped.
"""

from __future__ import annotations

import asyncio
import re
import shutil
from collections.abc import Collection
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from python_multipart.exceptions import FormParserError
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.types import Message as Sent

from jointid import __version__
from jointid.apps.web import form
from jointid.apps.web.folder import MODELS, Folder, Limits, PageError, Run, clean_name, read_json
from jointid.apps.web.jobs import Jobs
from jointid.common.document import typeset
from jointid.records.formats import FORMATS

if TYPE_CHECKING:
    from jinja2 import Environment

_FORM = 512 * 2**10  # bytes of a form without a file
_AROUND = 2**16  # bytes of a form around its file
_DAMAGED = (HTTPException, FormParserError)  # of a form that cannot be parsed; older versions of Starlette pass it on
_ALWAYS = ("torque", "reference", "motor_position")  # channels that are shown at once


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
        """Keep the entries of a form without a file, and return the draft with them.

        Raises:
            PageError: the form is too large, or damaged.
        """
        try:
            async with bound_body(request, _FORM, "The form is larger than any of this page.").form() as sent:
                entries = [(name, value) for name, value in sent.multi_items() if isinstance(value, str)]
        except _DAMAGED:
            raise PageError("The form did not arrive whole; load the page again, and send it once more.") from None
        draft = {**self.folder.draft, **form.clean_entries(entries)}
        self.folder.save_draft(draft)
        return draft


def bound_body(request: Request, bound: int, sentence: str) -> Request:
    """Return a request whose body raises a `PageError` above a number of bytes, or at once if it declares more."""
    sent = 0
    declared = request.headers.get("content-length", "")
    if re.fullmatch("[0-9]{1,18}", declared) and int(declared) > bound:
        raise PageError(sentence)

    async def receive() -> Sent:
        nonlocal sent
        message = await request.receive()
        sent += len(message.get("body", b""))
        if sent > bound:
            raise PageError(sentence)
        return message

    return Request(request.scope, receive)


async def receive_files(
    request: Request, folder: Path, bound: int, suffixes: Collection[str], most: int = 1
) -> list[str]:
    """Write the files of a form to a folder, and return their names.

    Raises:
        PageError: the form has no file or too many, more bytes than the bound, a file of another suffix or two of one
            name, or is damaged.
    """
    sentence = (
        f"The file is larger than {format_size(bound)}, which is the most this page takes; cut it, or log it slower."
    )
    received = list[str]()
    try:
        async with bound_body(request, bound + most * _AROUND, sentence).form(max_files=most) as sent:
            files = [file for file in sent.getlist("file") if isinstance(file, UploadFile) and file.filename]
            for file in files:
                name = clean_name(file.filename or "")
                suffix = Path(name).suffix.lower()
                if suffix not in suffixes:
                    fact = f'the suffix "{suffix}"' if suffix else "no suffix"
                    raise PageError(f"{name} has {fact}; expected one of {', '.join(suffixes)}: rename it.")
                if name in received:
                    raise PageError(f"Two files are called {name}; rename one of them.")
                received.append(name)
                with (folder / name).open("wb") as place:
                    await run_in_threadpool(shutil.copyfileobj, file.file, place)
    except _DAMAGED:
        raise PageError("The file did not arrive whole; send it again.") from None
    if not received:
        raise PageError("No file arrived; choose one, and send it again.")
    return received


def format_size(size: float) -> str:
    """Return a size in bytes as a sentence says it."""
    return f"{size / 2**20:.0f} MB" if size >= 2**20 else f"{size / 2**10:.0f} kB"


def list_suffixes() -> list[str]:
    """Return the suffixes of the files that are read."""
    return [suffix for entry in FORMATS for suffix in entry.suffixes]


def list_sent_suffixes() -> list[str]:
    """Return the suffixes of all files of step 1: records, joint file or robot file, and the model of a robot."""
    return [*list_suffixes(), ".toml", *MODELS]


def show_record(state: AppState, refusal: Exception | None = None) -> Response:
    """Show step 1: the record, and why it was refused."""
    faults = [] if refusal is None else str(refusal).splitlines()
    return _render(
        "record", state, 422 if faults else 200, step=1, faults=faults, suffixes=list_suffixes(),
        sent_suffixes=list_sent_suffixes(), bound=state.limits.upload, draft=state.folder.draft, text_fields=form.TEXT,
    )  # fmt: skip


def show_channels(state: AppState, refusal: Exception | None = None) -> Response:
    """Show step 2: what each column is, and what was refused of it; step 1 where there is no column."""
    preview, draft = state.folder.preview, state.folder.draft
    if preview is None or not state.folder.sent:
        return show_record(state, refusal)
    faults = form.place_faults(refusal, draft, {one.name for one in form.CHANNEL_STEP})
    return _render(
        "channels", state, 422 if faults else 200, step=2, faults=faults, draft=draft, preview=preview, kind=form.KIND,
        clock=form.CLOCK, gear=form.GEAR, drive=form.DRIVE, always=_ALWAYS, channels=form.CHANNEL_FIELDS,
        plots={
            one["name"]: f"{state.root}/plot/{i}.svg" for i, one in enumerate(preview["columns"]) if one["outline"]
        },
    )  # fmt: skip


def show_joint(state: AppState, refusal: Exception | None = None) -> Response:
    """Show step 3: the axis and its controller, and what was refused of them."""
    draft = state.folder.draft
    faults = form.place_faults(refusal, draft, {form.EXTRA, *(one.name for one in form.JOINT_STEP)})
    return _render(
        "joint", state, 422 if faults else 200, step=3, faults=faults, draft=draft, joint=form.JOINT, law=form.LAW,
        controller=form.CONTROLLER, method=form.METHOD, extra=form.EXTRA, checked=state.folder.checked,
        preview=state.folder.preview,
    )  # fmt: skip


def show_run(state: AppState, run: Run) -> Response:
    """Show steps 4 and 5: progress, then the answer with its report.

    Raises:
        PageError: its files are damaged.
    """
    from jinja2 import UndefinedError

    answer = read_json(run.folder / "answer.json")
    try:
        return _render(
            "run", state, step=4 if answer is None else 5, run=run, status=run.status, lines=run.read_progress(),
            answer=answer, elapsed=round(run.seconds), runs=[(one, one.status) for one in state.folder.runs],
            texts={name: run.read_text(name) for name in ("answer.txt", "learned.txt")},
        )  # fmt: skip
    except (LookupError, TypeError, ValueError, AttributeError, UndefinedError) as error:
        raise PageError(f"answer.json of identification {run.number} is damaged; press Identify again.") from error


def show_message(state: AppState, code: int, title: str, sentences: str) -> Response:
    """Show a page of a few sentences."""
    return _render("message", state, code, step=0, title=title, sentences=sentences)


def _render(template: str, state: AppState, code: int = 200, **values: Any) -> Response:
    runs = state.folder.runs
    common = {
        "root": state.root, "version": __version__, "folder": state.folder.path.name, "sent": state.folder.sent,
        "robot": state.folder.robot, "latest": f"/runs/{runs[0].number}" if runs else "",
    }  # fmt: skip
    return HTMLResponse(_load_templates().get_template(f"{template}.html").render(common | values), code)


@cache
def _load_templates() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("jointid.apps.web"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    made.filters["sentences"] = lambda text: str(text).splitlines()
    made.filters["size"] = format_size
    made.filters["id"] = lambda name: name.replace(".", "-").replace("@", "-")
    made.filters["typeset"] = typeset
    return made
