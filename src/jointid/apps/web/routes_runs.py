"""Steps 4 and 5: the progress of an identification, its answer, and its files."""

from __future__ import annotations

import asyncio
import json
import re
import zipfile
from collections.abc import AsyncIterator
from pathlib import Path

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, Response, StreamingResponse

from jointid.apps.web import pages
from jointid.apps.web.app_state import AppState
from jointid.apps.web.folder import Run, read_json
from jointid.apps.web.guard import REPORT_POLICY

_EVERY = 0.25  # seconds between looks at the progress
_ALIVE = 60  # of these, after which a line is sent that keeps the connection

FILES = {
    "joint.toml": "application/toml",
    "answer.json": "application/json",
    "answer.txt": "text/plain; charset=utf-8",
    "report.html": "text/html; charset=utf-8",
}
"""The files of an answer that can be downloaded, beside all of it with the record."""

BUNDLE = "all.zip"
_LINE = re.compile(r"[0-9]{1,9}")


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
    """Yield the lines of an identification's progress from a number on, and its end."""
    sent, looks = begin, 0
    while True:
        status = run.status  # before the lines: none that came before the end is left out
        lines = run.read_progress()
        for number in range(sent, len(lines)):
            yield f"id: {number}\ndata: {json.dumps(lines[number])}\n\n"
        sent, looks = max(sent, len(lines)), looks + 1
        if status["state"] != "running":
            yield f"event: end\ndata: {json.dumps(status['state'])}\n\n"
            return
        if looks % _ALIVE == 0:
            yield ": still here\n\n"
        await asyncio.sleep(_EVERY)


def _bundle(run: Run) -> tuple[Path, str]:
    """Return an archive of the answer and the stem of its record; in it `jointid identify joint.toml` repeats it."""
    work = read_json(run.folder / "work.json") or {}
    path = run.folder / BUNDLE
    if not path.exists():
        beside = run.folder / "bundle.part"
        with zipfile.ZipFile(beside, "w", zipfile.ZIP_DEFLATED) as archive:
            for name in (name for name in FILES if run.has(name)):
                archive.write(run.folder / name, name)
            archive.write(run.folder / work["file"], work["name"])
        beside.replace(path)
    return path, Path(work["name"]).stem
