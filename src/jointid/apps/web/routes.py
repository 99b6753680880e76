"""The addresses of the page: the record, its channels, the axis and its controller, the progress and the answer.

Forms and files come in bounded; pages go out as HTML from templates of our own, every text that came in escaped.
"""

from __future__ import annotations

import asyncio
import errno
import re
import shutil
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from python_multipart.exceptions import FormParserError
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, RedirectResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import Message as Sent

from jointid import __version__
from jointid.apps.web import form
from jointid.apps.web.folder import MODELS, Draft, Folder, Limits, PageError
from jointid.apps.web.jobs import Jobs
from jointid.common.document import templates, typeset
from jointid.common.errors import JointFileError, JointidError
from jointid.common.files import beside
from jointid.config import load
from jointid.config.toml import parse_toml, read_text
from jointid.records.formats import FORMATS
from jointid.records.record import CHANNELS

_FORM = 2**19  # bytes of a form beside its files
_FILES = 50  # of one upload
_DAMAGED = (HTTPException, FormParserError)  # of a form that cannot be parsed
_DOWNLOADS = ("joint.toml", "robot.toml", "answer.json", "report.html")
_BUNDLE = "all.zip"
_REPORT = {
    "content-security-policy": "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; "
    "frame-ancestors 'self'"
}
"""A report runs no script: its sandbox reaches neither the page nor the network."""
_SUFFIXES = (*(suffix for entry in FORMATS for suffix in entry.suffixes), ".toml", *MODELS)


class Page:
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

    def redirect(self, path: str) -> Response:
        """Lead the browser to another address of the page, such as "/channels"."""
        return RedirectResponse(f"{self.root}{path}", 303)

    def render(self, template: str, code: int = 200, **values: Any) -> Response:
        """Return a page."""
        now, runs = self.folder.now, self.folder.runs
        common = {
            "root": self.root, "version": __version__, "folder": self.folder.path.name, "sent": now.records,
            "robot": now.robot, "latest": f"/runs/{runs[0].name}" if runs else "", "typeset": typeset, "step": 0,
        }  # fmt: skip
        made = templates(Path(__file__).with_name("templates")).get_template(f"{template}.html")
        return HTMLResponse(made.render(common | values), code)

    def show(self, step: str, refusal: Exception | None = None, entries: Mapping[str, str] | None = None) -> Response:
        """Show the form of a step, with its faults beside the fields; step 1 where there is no record."""
        now, columns = self.folder.now, self.folder.now.json("_columns.json")
        tables = {} if now.robot else now.tables
        texts = ({form.EXTRA: now.text} if now.robot else form.show(tables)) | dict(entries or {})
        if step not in ("channels", "joint") or not (columns and now.records):
            made, template, sections = 1, "record", [form.Section("Read a text file in another way", form.TEXT, True)]
        elif now.robot:
            made, template, sections = 3, "form", [form.Section("The robot file", (form.FURTHER,))]
        else:
            made, template = (2, "form") if step == "channels" else (3, "form")
            sections = [*(form.channel_step if made == 2 else form.joint_step)(tables)]
        faults = form.place_faults(refusal, {one.key for section in sections for one in section.fields})
        return self.render(
            template, 422 if faults else 200, step=made, sections=sections, texts=texts, faults=faults,
            suffixes=_SUFFIXES, bound=self.limits.upload, columns=columns, checked=now.json("_checked.json"),
        )  # fmt: skip


def _page(request: Request) -> Page:
    page: Page = request.app.state.page
    return page


async def show_step(request: Request) -> Response:
    """Show the step that the address names."""
    return _page(request).show(_step(request))


def _step(request: Request) -> str:
    return request.url.path.rpartition("/")[2]


async def refuse(request: Request, error: Exception) -> Response:
    """Show the form of a step that is refused, with the reasons beside its fields."""
    if isinstance(error, OSError) and error.errno != errno.ENOSPC:
        raise error
    return _page(request).show(_step(request), error, getattr(request.state, "entries", None))


async def _save(request: Request) -> Draft:
    """Set the entries of a form in the joint file; of a robot its text is the whole file.

    Raises:
        JointidError: the form is too large or damaged, or its further lines are no TOML or name a record
            that is not there.
    """
    entries, _ = await _receive(request, _FORM, None)
    request.state.entries = dict(entries)
    now = _page(request).folder.now
    if now.robot:
        text = request.state.entries.get(form.EXTRA, now.text).replace("\r\n", "\n")
        tables = form.confine(form.parse_lines(text), [])
    else:
        tables = form.enter(now.tables, entries, now.records)
        text = form.write(tables)
    form.require_records(tables, now.records)
    now.write(text, now.file)
    return now


async def take_record(request: Request) -> Response:
    """Take records in place of those before, with the joint file, or the robot file and its model, that came along."""
    page = _page(request)
    with page.folder.receiving() as fresh:
        entries, names = await _receive(request, page.limits.upload, fresh.path)
        files = [name for name in names if name.lower().endswith(".toml")]
        models = [name for name in names if name.lower().endswith(MODELS)]
        records = [name for name in names if name not in (*files, *models)]
        if len(files) > 1 or len(models) > 1 or not records:
            raise PageError("Expected one record or several, with at most one joint file or robot file; choose again.")
        try:
            text = "".join(read_text(fresh.path / name) for name in files)
        except JointFileError as error:
            raise PageError(str(error).replace(f"{fresh.path / files[0]}", files[0])) from None
        if ("robot" in parse_toml(text)) != bool(models):
            raise PageError("A robot file comes with the model that it names (.urdf, .xml) and its record; choose all.")
        for name in files:
            (fresh.path / name).unlink()
        if models:
            fresh.write(text, "robot.toml")
        options = [(name, value) for name, value in entries if value]
        await _keep(page, fresh, records, parse_toml(text) if files else None, options)
    return page.redirect("/joint" if models else "/channels")


async def _keep(
    page: Page, fresh: Draft, records: list[str], tables: form.Tables | None, options: list[tuple[str, str]]
) -> None:
    """Put files in the record's place; without a joint file what is known before stays where it suits the columns."""
    async with page.files:
        if not fresh.robot:
            fresh.write(form.write(form.enter(tables or {"joint": {}}, options, records)))
        await page.jobs.read(fresh.path, "preview")
        if tables is None:
            columns, now = fresh.json("_columns.json"), page.folder.now
            before = {"joint": {}} if now.robot else now.tables or {"joint": {}}
            named = {one for name in CHANNELS if (one := form.at(before, f"record.channels.{name}.column"))}
            if not named or not named <= {one["name"] for one in columns["columns"]}:
                before |= {"record": {}, "drive": columns["drive"]}
            for key in ("records", "record.files", "record.offsets"):
                form.drop(before, key)
            fresh.write(form.write(form.enter(before, options, records)))
        page.folder.replace(fresh)


async def make_example(request: Request) -> Response:
    """Simulate the example, with every field filled in."""
    page = _page(request)
    with page.folder.receiving() as fresh:
        await page.jobs.read(fresh.path, "example")
        await _keep(page, fresh, ["example.csv"], fresh.tables, [])
    return page.redirect("/channels")


async def check_channels(request: Request) -> Response:
    """Check step 2 by reading the record as it says."""
    page, now = _page(request), await _save(request)
    async with page.files:
        if now.records:
            now.write(form.write(form.make_reading_tables(now.tables)), "_reading.toml")
            await run_in_threadpool(load, now.path / "_reading.toml")
            await page.jobs.read(now.path, "check")
    return page.redirect("/joint")


async def identify(request: Request) -> Response:
    """Check everything, and start the identification, in a folder of its own that holds all it takes."""
    page, now = _page(request), await _save(request)
    async with page.files:
        if not now.records:
            return page.redirect("/")
        tables = parse_toml(now.text)
        learn = form.at(tables, form.LAW) == form.LEARN
        if learn:
            form.drop(tables, form.LAW)
        text = form.write(form.confine(tables, [] if now.robot else now.records))
        now.write(text, "_order.toml")
        if not now.robot:  # whose model is read in a process of its own
            await run_in_threadpool(load, now.path / "_order.toml", learn=learn)
        page.jobs.require_idle()
        run = page.folder.new_run(text)
        page.jobs.start(run, learn=learn)
    return page.redirect(f"/runs/{run.name}")


async def save_draft(request: Request) -> Response:
    """Keep the entries of a form at each change, and show its step as they make it."""
    await _save(request)
    return await show_step(request)


async def draw_column(request: Request) -> Response:
    """Send the plot of a column."""
    now, name = _page(request).folder.now, f"_plot-{request.path_params['column']}.svg"
    if not re.fullmatch(r"_plot-[0-9]{1,9}\.svg", name) or not now.has(name):
        raise HTTPException(404)
    return FileResponse(now.path / name)


async def show_run(request: Request) -> Response:
    """Show the progress, then the answer with its report."""
    page, run = _find_run(request)
    said = run.json("answer.json")
    answer = said["answer"] if form.at(said, "answer.found.words") and form.at(said, "answer.trust.words") else None
    runs = [(one, page.jobs.state(one)) for one in page.folder.runs]
    return page.render("run", step=5 if answer else 4, run=run, answer=answer, status=page.jobs.state(run), runs=runs)


async def cancel_run(request: Request) -> Response:
    """End an identification."""
    page, run = _find_run(request)
    await page.jobs.cancel(run)
    return page.redirect(f"/runs/{run.name}")


async def send_file(request: Request) -> Response:
    """Send one of the files of an answer, or all of them with the record."""
    page, run = _find_run(request)
    name = request.path_params["name"]
    if name == _BUNDLE and run.has("answer.json"):
        async with page.files:
            path = await run_in_threadpool(_bundle, run)
        return FileResponse(path, filename=f"jointid-{run.name}.zip")
    if name not in _DOWNLOADS or not run.has(name):
        raise HTTPException(404)
    shown = name == "report.html" and "download" not in request.query_params
    return FileResponse(run.path / name, headers=_REPORT) if shown else FileResponse(run.path / name, filename=name)


def _find_run(request: Request) -> tuple[Page, Draft]:
    page = _page(request)
    run = page.folder.run(request.path_params["number"])
    if run is None:
        raise HTTPException(404)
    return page, run


def _bundle(run: Draft) -> Path:
    """Return an archive of the answer and its records; in it `jointid identify` repeats the answer."""
    path = run.path / f"_{_BUNDLE}"
    with beside(path) as fresh, zipfile.ZipFile(fresh, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in run.files():
            archive.write(run.path / name, name)
    return path


async def _receive(request: Request, bound: int, folder: Path | None) -> tuple[list[tuple[str, str]], list[str]]:
    """Return the entries of a form, and the names of its files, which are written to a folder.

    Raises:
        PageError: the form has more bytes than the bound, too many files, one of another suffix or two of one name, or
            is damaged.
    """
    received = list[str]()
    try:
        async with _bound(request, bound).form(max_files=_FILES) as sent:
            entries = [(name, value) for name, value in sent.multi_items() if isinstance(value, str)]
            for _, file in sent.multi_items():
                if isinstance(file, str) or not file.filename or folder is None:
                    continue
                name = form.clean_name(file.filename)
                if Path(name).suffix.lower() not in _SUFFIXES:
                    raise PageError(f"{name} is of no format that is read; expected one of {', '.join(_SUFFIXES)}.")
                if name in received:
                    raise PageError(f"Two files are called {name}; rename one of them.")
                received.append(name)
                with (folder / name).open("wb") as place:
                    await run_in_threadpool(shutil.copyfileobj, file.file, place)
    except _DAMAGED:
        raise PageError("The form or its files did not arrive whole; load the page again, and send it again.") from None
    return entries, received


def _bound(request: Request, bound: int) -> Request:
    """Return a request whose body raises a `PageError` above a number of bytes, or at once if it declares more."""
    refusal = PageError(f"The upload is larger than {bound / 2**20:.3g} MB, the most of this page; cut the record.")
    sent, most = 0, bound + _FORM
    declared = request.headers.get("content-length", "")
    if re.fullmatch("[0-9]{1,18}", declared) and int(declared) > most:
        raise refusal

    async def receive() -> Sent:
        nonlocal sent
        message = await request.receive()
        sent += len(message.get("body", b""))
        if sent > most:
            raise refusal
        return message

    return Request(request.scope, receive)


async def explain(request: Request, error: Exception) -> Response:
    """Show the page of an error."""
    if isinstance(error, HTTPException):
        values = {"title": "Not found", "sentence": "There is nothing at this address."}
        return _page(request).render("message", 404, **values)
    said = f"This is a fault of ours ({type(error).__name__}: {error}); please report it. Your data is kept."
    return _page(request).render("message", 500, title="The page failed", sentence=said)


HANDLERS = {JointidError: refuse, OSError: refuse, 404: explain, 405: explain, 500: explain}

ROUTES = [
    Route("/", show_step),
    Route("/record", take_record, methods=["POST"]),
    Route("/example", make_example, methods=["POST"]),
    Route("/channels", show_step, methods=["GET"]),
    Route("/channels", check_channels, methods=["POST"]),
    Route("/plot/{column}.svg", draw_column),
    Route("/joint", show_step, methods=["GET"]),
    Route("/joint", identify, methods=["POST"]),
    Route("/draft/{step}", save_draft, methods=["POST"]),
    Route("/runs/{number}", show_run),
    Route("/runs/{number}/cancel", cancel_run, methods=["POST"]),
    Route("/runs/{number}/{name}", send_file),
    Mount("/static", StaticFiles(packages=[("jointid.apps.web", "static")])),
]
