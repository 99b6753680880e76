"""The addresses of the page: the record, its channels, the axis and its controller, the progress and the answer."""

from __future__ import annotations

import asyncio
import json
import re
import zipfile
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, Response, StreamingResponse

from jointid.apps.web import form, pages
from jointid.apps.web.folder import MODELS, PageError, Run, read_json, refusal_of, write_json
from jointid.apps.web.pages import AppState, receive_files
from jointid.apps.web.preview import draw_svg
from jointid.common.errors import JointidError
from jointid.common.files import beside
from jointid.records.formats import format_of

_EVERY = 0.25  # seconds between looks at the progress
_ALIVE = 60  # of these, after which a line is sent that keeps the connection
_WITH_OPTIONS = "CSV"  # the format whose files may need to be read in another way
_MOST = 50  # files of one upload, and of one identification
_LINE = re.compile(r"[0-9]{1,9}")

FILES = {
    "joint.toml": "application/toml",
    "robot.toml": "application/toml",
    "answer.json": "application/json",
    "answer.txt": "text/plain; charset=utf-8",
    "report.html": "text/html; charset=utf-8",
}
"""The files of an answer that can be downloaded, beside all of it with the record."""

REPORT_POLICY = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'self'"
"""A report runs no script: its sandbox reaches neither the page nor the network."""

BUNDLE = "all.zip"

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
    """Take records in place of those before, with the joint file, or the robot file and its model, that came along."""
    with state.folder.receiving() as fresh:
        names = await receive_files(request, fresh, state.limits.upload, pages.list_sent_suffixes(), _MOST)
        async with state.files:
            return await _take_files(state, fresh, names)


async def _take_files(state: AppState, fresh: Path, names: list[str]) -> Response:
    """Sort the files of an upload: a joint file or robot file, the model of a robot, and records.

    Raises:
        PageError: they do not belong together.
        JointFileError: the joint file or robot file is no TOML.
    """
    tables = [name for name in names if name.lower().endswith(".toml")]
    models = [name for name in names if name.lower().endswith(MODELS)]
    records = [name for name in names if name not in (*tables, *models)]
    if len(tables) > 1 or len(models) > 1:
        several = ", ".join(tables if len(tables) > 1 else models)
        raise PageError(f"Expected one joint file or robot file with one model; received {several}: send one.")
    made: dict[str, Any] = {"robot": False, "draft": None}
    if tables:
        made = await _fill_in(state, fresh, tables[0])
    if made["robot"] and not (models and records):
        raise PageError(f"{tables[0]} is a robot file; choose it with its model and its record, all at once.")
    if models and not made["robot"]:
        raise PageError(f"{models[0]} is the model of a robot; send the robot file (TOML) and its record with it.")
    if not records:
        if not state.folder.sent or state.folder.robot:
            raise PageError(f"{tables[0]} came without its record; choose both at once.")
        state.folder.save_draft(made["draft"])
        return state.redirect("/channels")
    await _keep(state, fresh, [*records, *models], made["draft"])
    return state.redirect("/joint" if made["robot"] else "/channels")


@_refusing(pages.show_record)
async def make_example(_: Request, state: AppState) -> Response:
    """Simulate the example, with every field filled in."""
    with state.folder.receiving() as fresh:
        await state.jobs.act("example", fresh)
        made = await _fill_in(state, fresh, "joint.toml")
        async with state.files:
            await _keep(state, fresh, ["example.csv"], made["draft"])
    return state.redirect("/channels")


@_refusing(pages.show_record)
async def read_again(request: Request, state: AppState) -> Response:
    """Read the record again, with other options of a text file."""
    draft = await state.save_form(request)
    async with state.files:
        if state.folder.sent:
            await _preview(state, state.folder.now, state.folder.sent, draft)
    return state.redirect("/channels")


async def _keep(state: AppState, fresh: Path, names: list[str], draft: Mapping[str, str] | None) -> None:
    """Put files in the record's place; without a draft what is known before stays where it suits the columns."""
    before = state.folder.draft
    options = {one.name: before.get(one.name, "") for one in form.TEXT} if names == state.folder.sent else {}
    try:
        found = await _preview(state, fresh, names, options if draft is None else draft)
    except PageError:  # of a text file an option may be all that is missing
        if format_of(fresh / names[0]).name == _WITH_OPTIONS:
            state.folder.replace(fresh, names, draft or {})
        raise
    if draft is None:
        columns = {column["name"] for column in (read_json(fresh / "columns.json") or {})["columns"]}
        named = {text for key, text in before.items() if key.endswith(".column") and text}
        same = bool(named) and named <= columns
        kept = {key: text for key, text in before.items() if same or not key.startswith(("record.", "drive."))}
        draft = {**kept, **({} if same else found["draft"])}
    state.folder.replace(fresh, names, draft)


async def _preview(state: AppState, folder: Path, names: list[str], draft: Mapping[str, str]) -> dict[str, Any]:
    """Read the columns of records, and return what their names say."""
    values = {one.key.rpartition(".")[2]: one.read(draft) for one in form.TEXT}
    records = [name for name in names if not name.lower().endswith(MODELS)]
    work = {"files": records, "options": {key: value for key, value in values.items() if value is not None}}
    write_json(folder / "work.json", work)
    (folder / "columns.json").unlink(missing_ok=True)  # of what the form no longer says
    await state.jobs.act("preview", folder)
    return read_json(folder / "made.json") or {"draft": {}}


async def _fill_in(state: AppState, folder: Path, name: str) -> dict[str, Any]:
    """Fill in the forms from a joint file or a robot file."""
    if (folder / name).stat().st_size > state.limits.joint_file:
        most = pages.format_size(state.limits.joint_file)
        raise PageError(f"{name} is larger than {most}, the most of a joint file; is it the record?")
    (folder / name).replace(folder / "joint.toml")
    await state.jobs.act("fill_in", folder)
    made = read_json(folder / "made.json")
    if made is None:
        raise PageError(f"{name} is not text in UTF-8; save it so.")
    return made


async def show_channels(request: Request) -> Response:
    """Show step 2."""
    state = AppState.of(request)
    if state.folder.robot:
        return state.redirect("/joint")
    return state.redirect("/") if state.folder.preview is None else pages.show_channels(state)


@_refusing(pages.show_channels)
async def check_channels(request: Request, state: AppState) -> Response:
    """Check step 2 by reading the record as it says."""
    await state.save_form(request)
    if not state.folder.sent:
        return state.redirect("/")
    async with state.files:
        await state.jobs.act("check", state.folder.now)
    state.jobs.prepare()
    return state.redirect("/joint")


async def draw_column(request: Request) -> Response:
    """Draw a column."""
    folder, number = AppState.of(request).folder, request.path_params["column"]
    preview = folder.preview
    if preview is None or number >= len(preview["columns"]):
        raise HTTPException(404)
    column = preview["columns"][number]
    return Response(draw_svg(column, f"{column['samples']} rows"), media_type="image/svg+xml")


async def show_joint(request: Request) -> Response:
    """Show step 3."""
    state = AppState.of(request)
    return pages.show_joint(state) if state.folder.sent else state.redirect("/")


@_refusing(pages.show_joint)
async def identify(request: Request, state: AppState) -> Response:
    """Check everything, and start the identification, in a folder of its own that holds all it takes."""
    await state.save_form(request)
    if not state.folder.sent:
        return state.redirect("/")
    async with state.files:
        await state.jobs.act("order", state.folder.now)
        state.jobs.require_idle()
        run = state.folder.new_run()
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


async def send_file(request: Request) -> Response:
    """Send one of the files of an answer."""
    run, name = _find_run(request), request.path_params["name"]
    if name == BUNDLE and run.has("answer.json"):
        async with AppState.of(request).files:
            path = await run_in_threadpool(_bundle, run)
        return FileResponse(path, media_type="application/zip", filename=f"jointid-{run.number}.zip")
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
    """Yield the lines of an identification's progress from a number on, that there is an answer, and its end."""
    sent, looks, answered = begin, 0, False
    while True:
        active = run.active  # before the lines: none that came before the end is left out
        if run.has("answer.json") and not answered:
            answered = True
            yield "event: answer\ndata: true\n\n"
        lines = run.read_progress()
        for number in range(sent, len(lines)):
            yield f"id: {number}\ndata: {json.dumps(lines[number])}\n\n"
        sent, looks = max(sent, len(lines)), looks + 1
        if not active:
            yield "event: end\ndata: true\n\n"
            return
        if looks % _ALIVE == 0:
            yield ": still here\n\n"
        await asyncio.sleep(_EVERY)


def _bundle(run: Run) -> Path:
    """Return an archive of the answer and its records; in it `jointid identify` repeats the answer."""
    sent = (read_json(run.folder / "work.json") or {}).get("files")
    if not isinstance(sent, list) or not all(map(run.has, sent)):
        raise PageError(f"work.json of identification {run.number} is damaged; press Identify again.")
    path = run.folder / BUNDLE
    path.unlink(missing_ok=True)  # it may be a link, which would be followed
    with beside(path) as fresh, zipfile.ZipFile(fresh, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in (*(name for name in FILES if run.has(name)), *sent):
            archive.write(run.folder / name, name)
    return path
