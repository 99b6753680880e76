"""The addresses of the page: the record, its channels, the axis and its controller, the progress and the answer."""

from __future__ import annotations

import asyncio
import json
import re
import zipfile
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias
from urllib.parse import quote

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, Response, StreamingResponse

from jointid.apps.web import pages
from jointid.apps.web.fields import TEXT
from jointid.apps.web.folder import PREVIEW, PageError, Run, clean_name, name_in_run, read_json, refusal_of, write_json
from jointid.apps.web.form import MODELS, make_reading_tables, read_joint_file, with_units
from jointid.apps.web.guesses import guess_draft
from jointid.apps.web.pages import AppState, receive_files
from jointid.apps.web.preview import draw_svg
from jointid.common.errors import JointidError
from jointid.common.files import beside
from jointid.records.formats import format_of

_WITH_OPTIONS = "CSV"  # the format whose files may need to be read in another way
_EVERY = 0.25  # seconds between looks at the progress
_ALIVE = 60  # of these, after which a line is sent that keeps the connection

_MOST = 50
"""Files of one upload, and of one identification."""

FILES = {
    "joint.toml": "application/toml",
    "robot.toml": "application/toml",
    "answer.json": "application/json",
    "answer.txt": "text/plain; charset=utf-8",
    "report.html": "text/html; charset=utf-8",
    "test.csv": "text/csv; charset=utf-8",
    "test.mat": "application/octet-stream",
    "test.png": "image/png",
    "axis.svg": "image/svg+xml",
    "how-to-run.md": "text/markdown; charset=utf-8",
}
"""The files of an answer that can be downloaded, beside all of it with the record."""

REPORT_POLICY = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'self'"
"""A report runs no script: its sandbox reaches neither the page nor the network."""

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
    """Take records in place of those before, with the joint file, or the robot file and its model, that came along."""
    received = await receive_files(request, state, state.limits.upload, pages.list_sent_suffixes(), _MOST)
    try:
        return await _take_files(state, received)
    finally:
        for path, _ in received:
            state.folder.discard(path.name)


@_refusing(pages.show_record)
async def add_records(request: Request, state: AppState) -> Response:
    """Take further records of the same axis, or of the same robot."""
    received = await receive_files(request, state, state.limits.upload, pages.list_suffixes(), _MOST)
    try:
        async with state.files:
            record = state.folder.record
            if record is None:
                return state.redirect("/")
            known = state.folder.sent
            if twice := [name for _, name in received if name_in_run(name) in known]:
                raise PageError(f"There is a file called {', '.join(twice)} already; rename the new one.")
            if len(known) + len(received) > _MOST:
                raise PageError(f"That would be more than {_MOST} files; identify fewer records together.")
            for path, name in received:
                await _read_columns(state, path, name, state.folder.draft)
            _keep_files(state, record, [*_list_more(state, record), *received])
    finally:
        for path, _ in received:
            state.folder.discard(path.name)
    return state.redirect("/")


@_refusing(pages.show_record)
async def leave_records_out(_: Request, state: AppState) -> Response:
    """Remove all records but the first; the model of a robot stays."""
    async with state.files:
        record = state.folder.record
        if record is not None:
            models = [(path, name) for path, name in _list_more(state, record) if path.suffix in MODELS]
            _keep_files(state, record, models)
    return state.redirect("/")


def _list_more(state: AppState, record: Mapping[str, Any]) -> list[tuple[Path, str]]:
    return [(state.folder.path / one["file"], one["name"]) for one in record["more"]]


def _keep_files(state: AppState, record: Mapping[str, Any], more: Sequence[tuple[Path, str]]) -> None:
    """Keep the first record with other files beside it."""
    first = state.folder.path / record["file"]
    state.folder.save_record(first, record["name"], state.folder.draft, more, robot=record["robot"])


async def _take_files(state: AppState, received: Sequence[tuple[Path, str]]) -> Response:
    """Sort the files of an upload: a joint file or robot file, the model of a robot, and records.

    Raises:
        PageError: they do not belong together.
        JointFileError: the joint file or robot file is no TOML.
    """
    tables = [one for one in received if one[0].suffix == ".toml"]
    models = [one for one in received if one[0].suffix in MODELS]
    records = [one for one in received if one not in (*tables, *models)]
    if len(tables) > 1 or len(models) > 1:
        names = ", ".join(name for _, name in (tables if len(tables) > 1 else models))
        raise PageError(f"Expected one joint file or robot file with one model; received {names}: send one of them.")
    made: dict[str, Any] = {"robot": False, "draft": {}}
    for path, name in tables:
        text = _read_toml(path, name, state.limits.joint_file)
        made = await state.jobs.ask("fill_in", {"text": text}, state.folder.path)
    robot = made["robot"]
    if models and not robot:
        raise PageError(f"{models[0][1]} is the model of a robot; send the robot file (TOML) and its record with it.")
    if robot and not (models and records):
        lacks = " and ".join(word for word, found in (("its model", models), ("its record", records)) if not found)
        raise PageError(f"{tables[0][1]} is a robot file, and {lacks} did not come with it; choose all files at once.")
    async with state.files:
        if not records:
            if state.folder.record is None or state.folder.record["robot"]:
                raise PageError(f"{tables[0][1]} came without its record; choose both at once.")
            state.folder.save_draft(made["draft"])
            return state.redirect("/channels")
        of_robot = state.folder.record is not None and state.folder.record["robot"]
        options = {one.name for one in TEXT}
        before = {} if of_robot else {key: text for key, text in state.folder.draft.items() if key not in options}
        await _replace_record(state, records, made["draft"] or before, models, told=bool(tables), robot=robot)
    return state.redirect("/joint" if robot else "/channels")


def _read_toml(path: Path, name: str, most: int) -> str:
    if path.stat().st_size > most:
        raise PageError(f"{name} is larger than {pages.format_size(most)}, the most of a joint file; is it the record?")
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise PageError(f"{name} is not text in UTF-8; save it so.") from None


@_refusing(pages.show_record)
async def make_example(_: Request, state: AppState) -> Response:
    """Simulate the example, with every field filled in."""
    from jointid.paper.twin import JOINT_FILE

    async with state.files:
        await state.jobs.read("simulate", state.folder.path)
        fresh = (state.folder.path / "example.csv").rename(state.folder.new_upload(".csv"))
        example = JOINT_FILE.replace(", optional = true", "")  # for other records; this one has all of them
        await _replace_record(state, [(fresh, "example.csv")], with_units(read_joint_file(example)), told=True)
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
    record = state.folder.record
    if record is not None and record["robot"]:
        return state.redirect("/joint")
    return state.redirect("/") if state.folder.preview is None else pages.show_channels(state)


@_refusing(pages.show_channels)
async def check_channels(request: Request, state: AppState) -> Response:
    """Check step 2 by reading the record as it says."""
    draft = await state.save_form(request)
    async with state.files:
        record = state.folder.record
        if record is None:
            return state.redirect("/")
        write_json(state.folder.path / "work.json", {"files": state.folder.sent, "draft": draft})
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


async def _replace_record(
    state: AppState,
    records: Sequence[tuple[Path, str]],
    draft: Mapping[str, str],
    models: Sequence[tuple[Path, str]] = (),
    *,
    told: bool = False,
    robot: bool = False,
) -> None:
    """Put files in the record's place if they can be read, and guess the channels from the names of the columns.

    Nothing is guessed where they are told: a joint file or robot file said all. What the form says of columns that the
    first record has as well stays. A text file that cannot be read is kept: an
    option may be all that is missing. Where the disk is full the record before stays as it was.
    """
    (fresh, name), *others = records
    more = [*others, *models]
    try:
        for path, called in records:
            try:
                await _read_columns(state, path, called, draft)
            except PageError:
                if path == fresh and format_of(fresh).name == _WITH_OPTIONS:
                    state.folder.save_record(fresh, name, draft, more, robot=robot)
                raise
        preview = read_json(state.folder.path / f"{fresh.name}{PREVIEW}") or {"columns": []}
        columns = [column["name"] for column in preview["columns"]]
        state.folder.save_record(fresh, name, draft if told else _fit_draft(draft, columns), more, robot=robot)
    finally:
        for path, _ in (*records, *models):
            state.folder.discard(path.name)


def _fit_draft(draft: Mapping[str, str], columns: Sequence[str]) -> dict[str, str]:
    """Return the entries of a form that suit these columns, and guesses for the others."""
    named = {text for key, text in draft.items() if key.endswith(".column") or key == "record.time"}
    kept = {
        key: text for key, text in draft.items() if text and (not key.startswith("record.") or named <= {"", *columns})
    }
    return {**guess_draft(columns), **kept}


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
    ((path, name),) = await receive_files(request, state, state.limits.joint_file, [".toml"])
    try:
        text = _read_toml(path, name, state.limits.joint_file)
    finally:
        path.unlink(missing_ok=True)
    made = await state.jobs.ask("fill_in", {"text": text}, state.folder.path)
    record = state.folder.record
    if made["robot"] != (record is not None and record["robot"]):
        kind = "robot" if made["robot"] else "joint"
        raise PageError(f"{name} is a {kind} file; choose it together with its records in step 1.")
    state.folder.save_draft(made["draft"])
    return state.redirect(f"/joint?imported={quote(name)}")


@_refusing(pages.show_joint)
async def identify(request: Request, state: AppState) -> Response:
    """Check everything, and start the identification, in a folder of its own that holds all it takes."""
    draft = await state.save_form(request)
    record = state.folder.record
    if record is None:
        return state.redirect("/")
    sent = state.folder.sent
    made = await state.jobs.ask("order", {"draft": draft, "files": sent, "robot": record["robot"]}, state.folder.path)
    async with state.files:
        if state.folder.record != record:
            raise PageError("Another record was sent meanwhile; look at its channels first.")
        await state.jobs.require_idle()
        run = state.folder.new_run(sent, made)
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
        await state.jobs.require_idle(yields=False)
        (run.folder / "progress.txt").unlink(missing_ok=True)
        asked = {"goal": goal[:_GOAL], "seconds": state.limits.planning}
        write_json(run.folder / "work.json", run.work | asked)
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
    """Return an archive of the answer and the stem of its record; in it `jointid identify` repeats it."""
    work = run.work
    path, files = run.folder / BUNDLE, [run.folder / name for name in FILES if run.has(name)]
    if not run.has(BUNDLE) or path.stat().st_mtime_ns <= max(file.stat().st_mtime_ns for file in files):
        path.unlink(missing_ok=True)  # it may be a link, which would be followed
        with beside(path) as fresh, zipfile.ZipFile(fresh, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in files:
                archive.write(file, file.name)
            for name in work["files"]:
                archive.write(run.folder / name, name)
    return path, Path(work["file"]).stem
