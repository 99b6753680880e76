"""Steps 1 and 2: the record, and which of its columns is which channel."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

from jointid.apps.web import pages
from jointid.apps.web.app_state import AppState
from jointid.apps.web.fields import CHANNEL_STEP, TEXT
from jointid.apps.web.folder import PageError, write_json
from jointid.apps.web.form import Faults, imported, record_tables, told
from jointid.apps.web.plots import draw_svg
from jointid.apps.web.upload import receive_file
from jointid.common.errors import JointFileError, JointidError
from jointid.config import JointFile
from jointid.records.formats import format_of

_WITH_OPTIONS = "CSV"  # the format whose files may need to be read in another way


async def show_record(request: Request) -> Response:
    """Show step 1."""
    return pages.show_record(AppState.of(request))


async def take_record(request: Request) -> Response:
    """Take a record in place of the one before."""
    state = AppState.of(request)
    try:
        async with state.files:
            path, name = await receive_file(request, state.folder.path, state.limits.upload, pages.list_suffixes())
            kept = {key: value for key, value in state.folder.draft.items() if not key.startswith("record.")}
            await _replace_record(state, path, name, kept)
    except JointidError as error:
        return pages.show_record(state, error)
    return state.redirect("/channels")


async def make_example(request: Request) -> Response:
    """Simulate the example, with every field filled in."""
    from jointid.paper.twin import JOINT_FILE

    state = AppState.of(request)
    try:
        async with state.files:
            await state.jobs.read("simulate", state.folder.path)
            path = state.folder.path / "example.csv"
            await _replace_record(state, path, path.name, imported(JOINT_FILE))
    except JointidError as error:
        return pages.show_record(state, error)
    return state.redirect("/channels")


async def read_again(request: Request) -> Response:
    """Read the record again, with other options of a text file."""
    state = AppState.of(request)
    draft = await state.save_form(request)
    record = state.folder.record
    if record is None:
        return state.redirect("/")
    try:
        async with state.files:
            state.folder.drop_preview()
            await _read_columns(state, state.folder.path / record["file"], draft)
    except JointidError as error:
        return pages.show_record(state, error)
    return state.redirect("/channels")


async def show_channels(request: Request) -> Response:
    """Show step 2."""
    state = AppState.of(request)
    return state.redirect("/") if state.folder.preview is None else pages.show_channels(state)


async def check_channels(request: Request) -> Response:
    """Check step 2 by reading the record as it says."""
    state = AppState.of(request)
    record, draft = state.folder.record, await state.save_form(request)
    if record is None:
        return state.redirect("/")
    try:
        tables = await run_in_threadpool(_check_tables, draft, record["file"])
        async with state.files:
            work = {"file": record["file"], "name": record["name"], "tables": tables}
            write_json(state.folder.path / "work.json", work)
            await state.jobs.read("check", state.folder.path)
    except JointFileError as error:
        return pages.show_channels(state, told(error, draft, {one.name for one in CHANNEL_STEP}))
    except PageError as error:
        return pages.show_channels(state, Faults({}, tuple(str(error).splitlines())))
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

    A text file that cannot is kept as well: an option may be all that is missing.
    """
    try:
        await _read_columns(state, fresh, {})
    except PageError:
        if format_of(fresh).name == _WITH_OPTIONS:
            state.folder.save_record(fresh, name, draft)
            state.folder.drop_preview()
        fresh.unlink(missing_ok=True)
        raise
    roles = (state.folder.preview or {}).get("roles", {})
    guessed = {
        "record.time" if role == "time" else f"record.channels.{role}.column": column for role, column in roles.items()
    }
    state.folder.save_record(fresh, name, {**guessed, **draft})


async def _read_columns(state: AppState, path: Path, draft: Mapping[str, str]) -> None:
    options = record_tables({one.name: draft.get(one.name, "") for one in TEXT}, path.name)["record"]
    chosen = {key: value for key, value in options.items() if key != "file"}
    write_json(state.folder.path / "work.json", {"file": path.name, "options": chosen})
    await state.jobs.read("preview", state.folder.path)


def _check_tables(draft: Mapping[str, str], file: str) -> dict[str, Any]:
    """Return the tables that say how the record is read, checked.

    Raises:
        JointFileError: with a sentence for each fault.
    """
    tables = record_tables(draft, file)
    JointFile.of(tables)
    return tables
