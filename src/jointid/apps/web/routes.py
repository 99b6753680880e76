"""The page as an ASGI application: routes, access control, start and stop.

Routes are those of the record, channels, axis and controller, progress and answer. Forms and files are limited in size.
Pages are HTML from templates of this package, with all received text escaped.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import re
import secrets
import shutil
import socket
from collections.abc import AsyncIterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import uvicorn
from python_multipart.exceptions import FormParserError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from tomlkit import dumps

from jointid import __version__
from jointid.apps.web import folder, form
from jointid.apps.web.folder import MODELS, Draft, Jobs, PageError, work
from jointid.common.document import templates
from jointid.common.errors import JointFileError, JointidError
from jointid.common.files import write_whole
from jointid.config import load
from jointid.config.toml import parse_toml, read_text
from jointid.records.columns import unit_in_name
from jointid.records.formats import FORMATS

_FORM = 2**19  # most bytes of a form without its files
_FILES = 50  # most files of one upload
_DOWNLOADS = ("joint.toml", "robot.toml", "answer.json", "report.html")
_REPORT = {
    "content-security-policy": "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; "
    "frame-ancestors 'self'"
}
"""Headers of a report: it runs no script, and reaches neither the page nor the network."""
_SUFFIXES = (*(suffix for entry in FORMATS for suffix in entry.suffixes), ".toml", *MODELS)
_GRACE = 2  # seconds to close open connections when the page ends
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


class Page:
    """A page and its folder: the draft `now`, and identifications `runs/N`.

    Attributes:
        path: of the folder.
        root: first part of every address, with the token.
        jobs: the running identification.
        files: lock of requests that replace or read the record.
        refused: the step that was refused, and why, until the next form arrives.
    """

    def __init__(self, path: Path, token: str) -> None:
        self.path = path
        self.root = f"/{token}"
        self.jobs = Jobs()
        self.files = asyncio.Lock()
        self.refused: dict[str, Exception | None] = {}

    @property
    def now(self) -> Draft:
        """The present draft."""
        return Draft(self.path / "now")

    @property
    def runs(self) -> list[Draft]:
        """All identifications, the latest first."""
        paths = [path for path in (self.path / "runs").glob("*") if path.name.isdecimal() and path.is_dir()]
        return [Draft(path) for path in sorted(paths, key=lambda path: -int(path.name))]

    @contextlib.asynccontextmanager
    async def receiving(self) -> AsyncIterator[Draft]:
        """Yield a folder for uploads, which replaces the draft on success."""
        with TemporaryDirectory(prefix="upload-", dir=self.path, ignore_cleanup_errors=True) as place:
            fresh = Path(place, "now")
            fresh.mkdir()
            yield Draft(fresh)
            async with self.files:
                if self.now.path.exists():
                    self.now.path.rename(Path(place, "before"))
                fresh.rename(self.now.path)

    def new_run(self, text: str) -> Draft:
        """Create the folder of an identification, with its files and `text`."""
        last = next((int(run.path.name) for run in self.runs), 0)
        run = Draft(self.path / "runs" / f"{last + 1}")
        run.path.mkdir(parents=True)
        for name in self.now.files:
            shutil.copyfile(self.now.path / name, run.path / name)
        write_whole(run.path / run.file, text)
        return run

    def show(self, step: str) -> Response:
        """Render a step's form with faults; step 1 without a record."""
        now, columns = self.now, self.now.json("_columns.json")
        number = {"channels": 2, "joint": 3}.get(step, 1) if columns and now.records else 1
        forms = {2: form.channel_step, 3: form.joint_step}
        sections = [form.Section("Read a text file in another way", form.TEXT, folded=True)]
        if number > 1:
            sections = [*(form.ROBOT if now.robot else forms[number](now.texts))]
        shown = {one.key: one for section in sections for one in section.fields}
        faults = form.place_faults(self.refused.get(step), shown)
        return self.render(
            "form" if number > 1 else "record", step=number, sections=sections, texts=now.texts, faults=faults,
            suffixes=_SUFFIXES, bound=folder.UPLOAD, columns=columns, checked=now.json("_checked.json"),
        )  # fmt: skip

    def render(self, template: str, **values: Any) -> Response:
        """Render a page from a template."""
        now, runs = self.now, self.runs
        common = {
            "root": self.root, "version": __version__, "folder": self.path.name, "sent": now.records,
            "robot": now.robot, "latest": f"/runs/{runs[0].path.name}" if runs else "",
        }  # fmt: skip
        made = templates(Path(__file__).with_name("templates"))
        made.globals["unit_in_name"] = unit_in_name
        made.filters["by_field"] = lambda words: form.name_fields(words, {} if now.robot else form.fields_of(now.texts))
        return HTMLResponse(made.get_template(f"{template}.html").render(common | values))

    def redirect(self, path: str, refusal: Exception | None = None) -> Response:
        """Redirect the browser to another address, such as "/channels", which shows a refusal."""
        self.refused = {path[1:]: refusal}
        return RedirectResponse(f"{self.root}{path}", 303)


def _page(request: Request) -> Page:
    return cast("Page", request.app.state.page)


async def show_step(request: Request) -> Response:
    """Show a step; after a change of its form, save it first."""
    if request.method == "POST":
        await _save(request)
    return _page(request).show(request.url.path.rpartition("/")[2])


async def refuse(request: Request, error: Exception) -> Response:
    """Redirect to a refused step with the reasons beside its fields; a browser may come back to it."""
    if isinstance(error, OSError) and error.errno != errno.ENOSPC:
        raise error
    if isinstance(error, RecursionError):
        error = PageError("The joint file nests lists or tables too deeply; no key of it needs that.")
    step = request.url.path.rpartition("/")[2]
    return _page(request).redirect(f"/{step if step in ('channels', 'joint') else ''}", error)


async def _save(request: Request) -> Draft:
    """Store the entries of a form."""
    entries, page = await _receive(request, _FORM, None), _page(request)
    page.now.enter(page.now.texts | entries)
    page.refused = {}
    return page.now


async def take_record(request: Request) -> Response:
    """Replace the records by uploaded files, with a joint or robot file."""
    page = _page(request)
    async with page.receiving() as fresh:
        entries = await _receive(request, folder.UPLOAD, fresh.path)
        files = [name for name in fresh.files if name.lower().endswith(".toml")]
        if len(files) > 1 or len(fresh.files) - len(files) - len(fresh.records) > 1 or not fresh.records:
            raise PageError("Expected records with at most one joint file or robot file; choose again.")
        try:
            text = "".join(read_text(fresh.path / name) for name in files)
            tables = parse_toml(text)
        except JointFileError as error:
            raise PageError(str(error).replace(f"{fresh.path}/", "")) from None
        if ("robot" in tables) != fresh.robot:
            raise PageError("A robot file comes with its record and its model (.urdf, .xml); choose all.")
        for name in files:
            (fresh.path / name).unlink()
        options = {name: value for name, value in entries.items() if value}
        fresh.enter(({form.EXTRA: text} if fresh.robot else form.show_tables(tables)) | options)
        await work(fresh.path, folder.READING, "_log.txt", "preview")
        if not files:  # entries for records with the same columns are reused
            columns, before = (one.json("_columns.json") for one in (fresh, page.now))
            known = page.now.texts if columns["names"] == before.get("names") and not page.now.robot else {}
            fresh.enter((known or form.show_tables(columns["tables"])) | options)
    return page.redirect("/joint" if page.now.robot else "/channels")


async def make_example(request: Request) -> Response:
    """Simulate the example, with all fields filled in."""
    page = _page(request)
    async with page.receiving() as fresh:
        for action in ("example", "preview"):
            await work(fresh.path, folder.READING, "_log.txt", action)
    return page.redirect("/channels")


async def check_channels(request: Request) -> Response:
    """Check step 2 by reading the record, without controller and method."""
    page, now = _page(request), await _save(request)
    form.require(now.texts, controller=False)
    async with page.files:
        texts = {key: text for key, text in now.texts.items() if not key.startswith(("controller.", "joint.model"))}
        await _load(now, texts, but=("controller", "method"))
        await work(now.path, folder.READING, "_log.txt", "check")
    return page.redirect("/joint")


async def identify(request: Request) -> Response:
    """Check everything, and start the identification in a new folder."""
    page, now = _page(request), await _save(request)
    form.require(now.texts, controller=True)
    learn = now.texts.get(form.LAW) == form.LEARN
    async with page.files:
        text = await _load(now, now.texts)
        page.jobs.require_idle()
        run = page.new_run(text)
        page.jobs.start(run, learn=learn)
    return page.redirect(f"/runs/{run.path.name}")


async def _load(now: Draft, texts: form.Texts, but: tuple[str, ...] = ()) -> str:
    """Return the forms as TOML; check them, except a robot's model."""
    made = form.make_tables(texts, [] if now.robot else now.records)
    text, place = dumps({name: one for name, one in made.items() if name not in but}), now.path / "_order.toml"
    write_whole(place, text)
    if not now.robot:
        await run_in_threadpool(load, place)
    return text


async def draw_column(request: Request) -> Response:
    """Send the plot of a column."""
    now, name = _page(request).now, f"_plot-{request.path_params['column']}.svg"
    if not re.fullmatch(r"_plot-[0-9]{1,9}\.svg", name) or not now.has(name):
        raise HTTPException(404)
    return FileResponse(now.path / name)


async def show_run(request: Request) -> Response:
    """Show progress or answer of an identification; cancel it on request."""
    page, run = _find_run(request)
    if request.method == "POST":
        if page.jobs.is_running(run):
            await page.jobs.cancel()
        return page.redirect(f"/runs/{run.path.name}")
    answer = run.json("answer.json").get("answer")
    runs = [(one, page.jobs.state(one)) for one in page.runs]
    return page.render("run", step=5 if answer else 4, run=run, answer=answer, status=page.jobs.state(run), runs=runs)


async def send_file(request: Request) -> Response:
    """Send a file of an answer."""
    _, run = _find_run(request)
    name = request.path_params["name"]
    if name not in _DOWNLOADS or not run.has(name):
        raise HTTPException(404)
    shown = name == "report.html" and "download" not in request.query_params
    return FileResponse(run.path / name, headers=_REPORT) if shown else FileResponse(run.path / name, filename=name)


def _find_run(request: Request) -> tuple[Page, Draft]:
    page = _page(request)
    for run in page.runs:
        if run.path.name == request.path_params["number"]:
            return page, run
    raise HTTPException(404)


async def _receive(request: Request, bound: int, place: Path | None) -> dict[str, str]:
    """Return the entries of a form; write its files to a folder.

    Raises:
        PageError: the form is larger than the bound, has no stated size or is damaged, or it has too many files, an
            unknown suffix or two files of one name.
    """
    size = request.headers.get("content-length", "")
    if not re.fullmatch("[0-9]{1,18}", size) or int(size) > bound + _FORM:
        raise PageError(f"The upload is larger than {bound / 2**20:.3g} MB, the most of this page; cut the record.")
    try:
        async with request.form(max_files=_FILES) as sent:
            for _, file in sent.multi_items():
                if isinstance(file, str) or not file.filename or place is None:
                    continue
                name = form.clean_name(file.filename)
                if Path(name).suffix.lower() not in _SUFFIXES:
                    raise PageError(f"{name} is of no format that is read; expected one of {', '.join(_SUFFIXES)}.")
                if (place / name).exists():
                    raise PageError(f"Two files are called {name}; rename one of them.")
                with (place / name).open("wb") as target:
                    await run_in_threadpool(shutil.copyfileobj, file.file, target)
            return form.take((name, value) for name, value in sent.multi_items() if isinstance(value, str))
    except (HTTPException, FormParserError):
        raise PageError("The form or its files did not arrive whole; load the page again, and send it again.") from None


ROUTES = [
    Route("/", show_step, methods=["GET"]),
    Route("/record", take_record, methods=["POST"]),
    Route("/example", make_example, methods=["POST"]),
    Route("/channels", show_step, methods=["GET"]),
    Route("/channels", check_channels, methods=["POST"]),
    Route("/plot/{column}.svg", draw_column),
    Route("/joint", show_step, methods=["GET"]),
    Route("/joint", identify, methods=["POST"]),
    Route("/draft/{step}", show_step, methods=["POST"]),
    Route("/runs/{number}", show_run, methods=["GET", "POST"]),
    Route("/runs/{number}/{name}", send_file),
    Mount("/static", StaticFiles(packages=[("jointid.apps.web", "static")])),
]


def _guard(app: ASGIApp, token: str) -> ASGIApp:
    """Wrap an application to refuse requests without the token.

    Foreign web pages can make a browser send requests here, but do not know the token.
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

        with contextlib.suppress(ClientDisconnect):
            await (PlainTextResponse(said, 403) if refused else app)(scope, receive, send_guarded)

    return guarded


def build_application(folder: Path, token: str) -> Starlette:
    """Return the page as an ASGI application; addresses begin with the token."""
    page = Page(folder, token)

    @contextlib.asynccontextmanager
    async def live(_: Starlette) -> AsyncIterator[None]:
        for path in folder.glob("upload-*"):  # uploads that a kill interrupted
            shutil.rmtree(path, ignore_errors=True)
        yield
        await page.jobs.cancel()

    # Refuse other host names, which may have been rebound to this machine's address.
    here = Middleware(TrustedHostMiddleware, allowed_hosts=["127.0.0.1", "localhost"])
    application = Starlette(
        routes=[Mount(page.root, routes=ROUTES)],
        middleware=[Middleware(_guard, token=token), here],
        exception_handlers=dict.fromkeys((JointidError, OSError, RecursionError), refuse),
        lifespan=live,
    )
    application.state.page = page
    return application


def run(application: Starlette, listening: socket.socket) -> None:
    """Serve the page on a listening socket until interrupted; files are private."""
    config = uvicorn.Config(
        application, http="h11", ws="none", limit_concurrency=_CONNECTIONS, log_level="warning",
        timeout_graceful_shutdown=_GRACE, server_header=False,
    )  # fmt: skip
    before = os.umask(0o077)  # the owner alone
    try:
        uvicorn.Server(config).run(sockets=[listening])
    finally:
        os.umask(before)
