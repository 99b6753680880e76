"""The addresses of the page: the record, its channels, the axis and its controller, the progress and the answer."""

from __future__ import annotations

import asyncio
import json
import re
import zipfile
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from pathlib import Path
from typing import TypeAlias
from urllib.parse import quote

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, Response, StreamingResponse

from jointid.apps.web import pages
from jointid.apps.web.fields import TEXT
from jointid.apps.web.folder import PREVIEW, PageError, Run, name_in_run, read_json, refusal_of, write_json
from jointid.apps.web.form import make_reading_tables, read_joint_file, with_units
from jointid.apps.web.guesses import guess_draft
from jointid.apps.web.pages import AppState, clean_name, receive_file
from jointid.apps.web.preview import draw_svg
from jointid.common.errors import JointidError
from jointid.common.files import beside
from jointid.records.formats import format_of

_WITH_OPTIONS = "CSV"  # the format whose files may need to be read in another way
_EVERY = 0.25  # seconds between looks at the progress
_ALIVE = 60  # of these, after which a line is sent that keeps the connection

FILES = {
    "joint.toml": "application/toml",
    "answer.json": "application/json",
    "answer.txt": "text/plain; charset=utf-8",
    "report.html": "text/html; charset=utf-8",
    "test.csv": "text/csv; charset=utf-8",
    "test.mat": "application/octet-stream",
    "test.png": "image/png",
    "how-to-run.md": "text/markdown; charset=utf-8",
}
"""The files of an answer that can be downloaded, beside all of it with the record."""

REPORT_POLICY = (
    "sandbox allow-scripts allow-downloads allow-modals; default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; frame-ancestors 'self'"
)
"""A report brings its own scripts: they run in a sandbox that reaches neither the page nor the network."""

BUNDLE = "all.zip"
_GOAL = 200  # characters
_LINE = re.compile(r"[0-9]{1,9}")

_Action: TypeAlias = Callable[[Request, AppState], Awaitable[Response]]
_Endpoint: TypeAlias = Callable[[Request], Awaitable[Response]]


def _refusing(show: Callable[[AppState, Exception], Response]) -> Callable[[_Action], _Endpoint]:
    """Return the decorator of what a form asks for: where it is refused, the form's page is shown with the reasons."""

    def decorate(action: _Action) -> _Endpoint:
        async def answer(request: Request) -> Response:
            state = AppState.of(request)
            try:
                return await action(request, state)
            except (JointidError, OSError) as error:
                return show(state, refusal_of(error))

        return answer

    return decorate


async def show_record(request: Request) -> Response:
    """Show step 1."""
    return pages.show_record(AppState.of(request))


@_refusing(pages.show_record)
async def take_record(request: Request, state: AppState) -> Response:
    """Take a record in place of the one before."""
    path, name = await receive_file(request, state, state.limits.upload, pages.list_suffixes())
    async with state.files:
        kept = {key: value for key, value in state.folder.draft.items() if value and not key.startswith("record.")}
        await _replace_record(state, path, name, kept)
    return state.redirect("/channels")


@_refusing(pages.show_record)
async def make_example(_: Request, state: AppState) -> Response:
    """Simulate the example, with every field filled in."""
    from jointid.paper.twin import JOINT_FILE

    async with state.files:
        await state.jobs.read("simulate", state.folder.path)
        fresh = (state.folder.path / "example.csv").rename(state.folder.new_upload(".csv"))
        example = JOINT_FILE.replace(", optional = true", "")  # for other records; this one has all of them
        await _replace_record(state, fresh, "example.csv", with_units(read_joint_file(example)))
    return state.redirect("/channels")


@_refusing(pages.show_record)
async def read_again(request: Request, state: AppState) -> Response:
    """Read the record again, with other options of a text file."""
    draft = await state.save_form(request)
    async with state.files:
        record = state.folder.record
        if record is None:
            return state.redirect("/")
        try:
            await _read_columns(state, state.folder.path / record["file"], record["name"], draft)
        except PageError:  # the preview is of what the form no longer says
            state.folder.drop_preview()
            raise
    return state.redirect("/channels")


async def show_channels(request: Request) -> Response:
    """Show step 2."""
    state = AppState.of(request)
    return state.redirect("/") if state.folder.preview is None else pages.show_channels(state)


@_refusing(pages.show_channels)
async def check_channels(request: Request, state: AppState) -> Response:
    """Check step 2 by reading the record as it says."""
    draft = await state.save_form(request)
    async with state.files:
        record = state.folder.record
        if record is None:
            return state.redirect("/")
        write_json(state.folder.path / "work.json", {"file": record["file"], "draft": draft})
        await state.jobs.read("check", state.folder.path, record["file"], record["name"])
    state.jobs.prepare()
    return state.redirect("/joint")


async def draw_column(request: Request) -> Response:
    """Draw a column."""
    folder, number = AppState.of(request).folder, request.path_params["column"]
    preview = folder.preview
    if preview is None or number >= len(preview["columns"]):
        raise HTTPException(404)
    column = preview["columns"][number]
    end = pages.label_end(preview, folder.draft, column)
    return Response(draw_svg(column, end), media_type="image/svg+xml")


async def _replace_record(state: AppState, fresh: Path, name: str, draft: Mapping[str, str]) -> None:
    """Put a file in the record's place if it can be read, and guess the channels from the names of its columns.

    A text file that cannot is kept as well: an option may be all that is missing. Where the disk is full the record
    before stays as it was.
    """
    try:
        try:
            await _read_columns(state, fresh, name, {})
        except PageError:
            if format_of(fresh).name == _WITH_OPTIONS:
                state.folder.save_record(fresh, name, draft)
            raise
        preview = read_json(state.folder.path / f"{fresh.name}{PREVIEW}") or {"columns": []}
        columns = [column["name"] for column in preview["columns"]]
        state.folder.save_record(fresh, name, {**guess_draft(columns), **draft})
    finally:
        state.folder.discard(fresh.name)


async def _read_columns(state: AppState, path: Path, name: str, draft: Mapping[str, str]) -> None:
    options = make_reading_tables({one.name: draft.get(one.name, "") for one in TEXT}, path.name)["record"]
    chosen = {key: value for key, value in options.items() if key != "file"}
    write_json(state.folder.path / "work.json", {"file": path.name, "options": chosen})
    await state.jobs.read("preview", state.folder.path, path.name, name)


async def show_joint(request: Request) -> Response:
    """Show step 3."""
    state = AppState.of(request)
    if state.folder.preview is None:
        return state.redirect("/")
    name = request.query_params.get("imported", "")
    return pages.show_joint(state, imported=clean_name(name) if name else "")


@_refusing(pages.show_joint)
async def import_joint_file(request: Request, state: AppState) -> Response:
    """Fill in the form from a joint file."""
    path, name = await receive_file(request, state, state.limits.joint_file, [".toml"])
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise PageError(f"{name} is not text in UTF-8; save it so.") from None
    finally:
        path.unlink(missing_ok=True)
    state.folder.save_draft(await state.jobs.ask("fill_in", {"text": text}, state.folder.path))
    return state.redirect(f"/joint?imported={quote(name)}")


@_refusing(pages.show_joint)
async def identify(request: Request, state: AppState) -> Response:
    """Check everything, and start the identification, in a folder of its own that holds all it takes."""
    draft = await state.save_form(request)
    record = state.folder.record
    if record is None:
        return state.redirect("/")
    name = name_in_run(record["name"])
    made = await state.jobs.ask("order", {"draft": draft, "file": name}, state.folder.path)
    async with state.files:
        if state.folder.record != record:
            raise PageError("Another record was sent meanwhile; look at its channels first.")
        await state.jobs.require_idle()
        run = state.folder.new_run(record["file"], name, made["text"], learn=made["learn"])
    state.jobs.start(run)
    return state.redirect(f"/runs/{run.number}")


async def save_draft(request: Request) -> Response:
    """Keep the entries of the form, at each change."""
    await AppState.of(request).save_form(request)
    return Response(status_code=204)


async def show_run(request: Request) -> Response:
    """Show the progress, or the answer."""
    return pages.show_run(AppState.of(request), _find_run(request))


async def stream_progress(request: Request) -> Response:
    """Send the progress as it comes, as server-sent events."""
    last = request.headers.get("last-event-id", "")
    begin = int(last) + 1 if _LINE.fullmatch(last) else 0
    return StreamingResponse(_events(_find_run(request), begin), media_type="text/event-stream")


async def cancel_run(request: Request) -> Response:
    """End an identification."""
    state, run = AppState.of(request), _find_run(request)
    await state.jobs.cancel(run)
    return state.redirect(f"/runs/{run.number}")


async def plan_test(request: Request) -> Response:
    """Start planning the next test after an identification."""
    state, run = AppState.of(request), _find_run(request)
    goal = dict(await state.read_form(request)).get("goal", "all")
    async with state.files:
        if not run.answered or run.active:
            raise PageError(f"Identification {run.number} is still at work; plan the next test when it has ended.")
        if run.keeps_names:
            raise PageError(
                "This record has the name of a file that a plan writes; press Identify again, then plan it."
            )
        await state.jobs.require_idle(yields=False)
        (run.folder / "progress.txt").unlink(missing_ok=True)
        work = read_json(run.folder / "work.json") or {}
        asked = {"goal": goal[:_GOAL], "seconds": state.limits.planning}
        write_json(run.folder / "work.json", work | asked)
        run.update(state="planning", before=run.status["state"], unplanned="")
    state.jobs.start_planning(run)
    return state.redirect(f"/runs/{run.number}#plan")


async def send_file(request: Request) -> Response:
    """Send one of the files of an answer."""
    run, name = _find_run(request), request.path_params["name"]
    if name == BUNDLE and run.has("answer.json"):
        async with AppState.of(request).files:
            path, stem = await run_in_threadpool(_bundle, run)
        return FileResponse(path, media_type="application/zip", filename=f"jointid-{stem}.zip")
    if name not in FILES or not run.has(name):
        raise HTTPException(404)
    if name == "report.html" and "download" not in request.query_params:
        policy = {"content-security-policy": REPORT_POLICY}
        return FileResponse(run.folder / name, media_type=FILES[name], headers=policy)
    return FileResponse(run.folder / name, media_type=FILES[name], filename=name)


def _find_run(request: Request) -> Run:
    run = AppState.of(request).folder.run(request.path_params["number"])
    if run is None:
        raise HTTPException(404)
    return run


async def _events(run: Run, begin: int) -> AsyncIterator[str]:
    """Yield the lines of an identification's progress from a number on, each version of answer and report, its end."""
    sent, looks, stated = begin, 0, {"answer": "", "report": ""}
    while True:
        status = run.status  # before the lines: none that came before the end is left out
        stamps = run.stamps
        for name in (name for name in stamps if stamps[name] != stated[name]):
            yield f"event: {name}\ndata: {json.dumps(stamps[name])}\n\n"
        stated = stamps
        lines = run.read_progress()
        for number in range(sent, len(lines)):
            yield f"id: {number}\ndata: {json.dumps(lines[number])}\n\n"
        sent, looks = max(sent, len(lines)), looks + 1
        if status["state"] not in ("running", "planning"):
            yield f"event: end\ndata: {json.dumps(status['state'])}\n\n"
            return
        if looks % _ALIVE == 0:
            yield ": still here\n\n"
        await asyncio.sleep(_EVERY)


def _bundle(run: Run) -> tuple[Path, str]:
    """Return an archive of the answer and the stem of its record; in it `jointid identify joint.toml` repeats it."""
    work = read_json(run.folder / "work.json") or {}
    path, files = run.folder / BUNDLE, [run.folder / name for name in FILES if run.has(name)]
    if not path.exists() or path.stat().st_mtime_ns <= max(file.stat().st_mtime_ns for file in files):
        with beside(path) as fresh, zipfile.ZipFile(fresh, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in files:
                archive.write(file, file.name)
            archive.write(run.folder / work["file"], work["file"])
    return path, Path(work["file"]).stem
