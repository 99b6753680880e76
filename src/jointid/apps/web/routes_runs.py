"""Steps 4 and 5: an identification's progress, its answer, and the files of it."""

from __future__ import annotations

import asyncio
import json
import re
import zipfile
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, RedirectResponse, Response, StreamingResponse

from jointid.apps.web import pages
from jointid.apps.web.app_state import Desk
from jointid.apps.web.guard import REPORT_POLICY
from jointid.apps.web.sessions import ACTIVE, Run, Visitor, read_json

_EVERY = 0.25  # seconds between looks at the progress
_ALIVE = 60  # of these, after which a line is sent that keeps the connection

FILES = {
    "joint.toml": "application/toml",
    "answer.json": "application/json",
    "answer.txt": "text/plain; charset=utf-8",
    "report.html": "text/html; charset=utf-8",
}
"""What can be downloaded of an answer, beside all of it with the record."""

BUNDLE = "all.zip"
_LINE = re.compile(r"[0-9]{1,9}")


@dataclass(frozen=True, slots=True)
class Running:
    """Steps 4 and 5."""

    desk: Desk

    async def run(self, request: Request) -> Response:
        """Show the progress, or the answer."""
        visitor, run = self._run(request)
        if visitor is None or run is None:
            return self.desk.nothing(request)
        return HTMLResponse(pages.run_page(visitor, self.desk.limits, run))

    async def events(self, request: Request) -> Response:
        """Tell the progress as it comes."""
        _, run = self._run(request)
        if run is None:
            return self.desk.nothing(request)
        last = request.headers.get("last-event-id", "")
        begin = int(last) + 1 if _LINE.fullmatch(last) else 0
        return StreamingResponse(_told(run, begin), media_type="text/event-stream")

    async def cancel(self, request: Request) -> Response:
        """End an identification."""
        _, run = self._run(request)
        if run is None:
            return self.desk.nothing(request)
        await run_in_threadpool(self.desk.jobs.cancel, run)
        return RedirectResponse(f"/runs/{run.number}", 303)

    async def file(self, request: Request) -> Response:
        """Give one of the files of an answer."""
        visitor, run = self._run(request)
        name = request.path_params["name"]
        if visitor is not None and run is not None and name == BUNDLE and run.has("answer.json"):
            path = await self._bundle(visitor, run)
            return FileResponse(path, media_type="application/zip", filename=f"{_stem(run)}.zip")
        if run is None or name not in FILES or not run.has(name):
            return self.desk.nothing(request)
        if name == "report.html" and "download" not in request.query_params:
            policy = {"content-security-policy": REPORT_POLICY}
            return FileResponse(run.folder / name, media_type=FILES[name], headers=policy)
        return FileResponse(run.folder / name, media_type=FILES[name], filename=name)

    async def _bundle(self, visitor: Visitor, run: Run) -> Path:
        """Return the archive of an answer, which is made once."""
        async with self.desk.turn(visitor):
            if not run.has(BUNDLE):
                await run_in_threadpool(self.desk.sessions.require_room, visitor)
                await run_in_threadpool(_bundled, run)
        return run.folder / BUNDLE

    def _run(self, request: Request) -> tuple[Visitor | None, Run | None]:
        visitor = self.desk.known(request)
        return visitor, None if visitor is None else visitor.run(request.path_params["number"])


async def _told(run: Run, begin: int) -> AsyncIterator[str]:
    """Yield the lines of an identification's progress as server-sent events, and its end."""
    sent, looks = begin, 0
    while True:
        state = run.status["state"]  # before the lines: none that came before the end is left out
        lines = run.lines()
        for number in range(sent, len(lines)):
            yield f"id: {number}\ndata: {json.dumps(lines[number])}\n\n"
        sent, looks = max(sent, len(lines)), looks + 1
        yield f"event: state\ndata: {json.dumps(state)}\n\n" if looks == 1 or state not in ACTIVE else ""
        if state not in ACTIVE:
            return
        if looks % _ALIVE == 0:
            yield ": still here\n\n"
        await asyncio.sleep(_EVERY)


def _bundled(run: Run) -> None:
    """Make an archive of everything: unpacked, `jointid identify joint.toml` in it gives the same numbers."""
    work = read_json(run.folder / "work.json") or {}
    beside = run.folder / "bundle.part"
    with zipfile.ZipFile(beside, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in (name for name in FILES if run.has(name)):
            archive.write(run.folder / name, name)
        archive.write(run.folder / work["file"], work["name"])
    beside.replace(run.folder / BUNDLE)


def _stem(run: Run) -> str:
    work = read_json(run.folder / "work.json") or {"name": "record"}
    return f"jointid-{Path(work['name']).stem}"
