"""Step 3: the axis and its controller, from which the joint file is made that is run."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, RedirectResponse, Response

from jointid.apps.web import pages
from jointid.apps.web.app_state import Desk
from jointid.apps.web.fields import EXTRA, JOINT_STEP
from jointid.apps.web.form import Faults, imported, ordered, told
from jointid.apps.web.names import safe_name
from jointid.apps.web.sessions import PageError, write_json
from jointid.apps.web.upload import received
from jointid.common.errors import JointFileError, JointidError


@dataclass(frozen=True, slots=True)
class Ordering:
    """Step 3."""

    desk: Desk

    async def joint(self, request: Request) -> Response:
        """Show step 3."""
        visitor = self.desk.known(request)
        if visitor is None or visitor.preview is None:
            return RedirectResponse("/", 303)
        name = safe_name(request.query_params.get("imported", ""), "")
        return HTMLResponse(pages.joint_page(visitor, self.desk.limits, Faults(), name))

    async def import_file(self, request: Request) -> Response:
        """Fill in the form from a joint file."""
        visitor, token = self.desk.visitor(request)
        if visitor.record is None:
            return RedirectResponse("/", 303)
        path = visitor.folder / "incoming.toml"
        try:
            self.desk.require_small(request, self.desk.limits.joint_file)
            content = request.headers.get("content-type", "")
            with visitor.there():
                name = await received(request.stream(), content, path, self.desk.limits.joint_file, _require_toml)
                draft = imported(path.read_text(encoding="utf-8-sig"))
        except (JointidError, UnicodeDecodeError) as error:
            said = str(error) if isinstance(error, JointidError) else "The joint file is not text in UTF-8; save it so."
            if "application/json" in request.headers.get("accept", ""):
                return JSONResponse({"said": said}, 422)
            faults = Faults({}, tuple(said.splitlines()))
            return HTMLResponse(pages.joint_page(visitor, self.desk.limits, faults), 422)
        finally:
            path.unlink(missing_ok=True)
        visitor.save_draft(draft)
        return self.desk.to(request, f"/joint?imported={quote(name)}", token)

    async def save_joint(self, request: Request) -> Response:
        """Check everything, and have it identified."""
        visitor, _ = self.desk.visitor(request)
        record = visitor.record
        if record is None:
            return RedirectResponse("/", 303)
        draft = {**visitor.draft, **await self.desk.form(request)}
        visitor.save_draft(draft)
        run = None
        try:
            order = await run_in_threadpool(ordered, draft, record["name"])
            await run_in_threadpool(self.desk.sessions.require_room, visitor)
            with visitor.there():
                run = visitor.new_run(self.desk.limits)
                _linked(visitor.folder / record["file"], run.folder / record["file"])
                (run.folder / "joint.toml").write_text(order.text, encoding="utf-8", newline="\n")
                work = {"file": record["file"], "name": record["name"], "learn": order.learn}
                write_json(run.folder / "work.json", work)
                self.desk.jobs.submit(run)
        except JointFileError as error:
            faults = told(error, draft, {EXTRA, *(one.name for one in JOINT_STEP)})
        except PageError as error:
            if run is not None:
                shutil.rmtree(run.folder, ignore_errors=True)
            faults = Faults({}, (str(error),))
        else:
            return RedirectResponse(f"/runs/{run.number}", 303)
        return HTMLResponse(pages.joint_page(visitor, self.desk.limits, faults), 422)

    async def save_draft(self, request: Request) -> Response:
        """Keep what stands in the form, at each change."""
        visitor, _ = self.desk.visitor(request)
        if visitor.record is None:
            return self.desk.nothing(request)
        visitor.save_draft({**visitor.draft, **await self.desk.form(request)})
        return Response(status_code=204)


def _require_toml(name: str) -> None:
    """Raise a `PageError` for a file that is no joint file by its name."""
    if Path(name).suffix.lower() != ".toml":
        raise PageError(f"{name} is no joint file; choose a file that ends in .toml.")


def _linked(record: Path, place: Path) -> None:
    """Have a record in a second place, without a copy where the disk can."""
    try:
        os.link(record, place)
    except OSError:
        shutil.copyfile(record, place)
