"""Step 3: the axis and its controller, from which the joint file of an identification is made."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from urllib.parse import quote

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response

from jointid.apps.web import pages
from jointid.apps.web.app_state import AppState
from jointid.apps.web.fields import EXTRA, JOINT_STEP
from jointid.apps.web.folder import PageError, write_json
from jointid.apps.web.form import Faults, imported, ordered, told
from jointid.apps.web.upload import clean_name, receive_file
from jointid.common.errors import JointFileError, JointidError


async def show_joint(request: Request) -> Response:
    """Show step 3."""
    state = AppState.of(request)
    if state.folder.preview is None:
        return state.redirect("/")
    name = request.query_params.get("imported", "")
    return pages.show_joint(state, imported=clean_name(name) if name else "")


async def import_joint_file(request: Request) -> Response:
    """Fill in the form from a joint file."""
    state = AppState.of(request)
    try:
        path, name = await receive_file(request, state.folder.path, state.limits.joint_file, [".toml"])
        state.folder.save_draft(imported(path.read_text(encoding="utf-8-sig")))
    except UnicodeDecodeError:
        return pages.show_joint(state, Faults({}, ("The joint file is not text in UTF-8; save it so.",)))
    except JointidError as error:
        return pages.show_joint(state, Faults({}, tuple(str(error).splitlines())))
    finally:
        (state.folder.path / "incoming.toml").unlink(missing_ok=True)
    return state.redirect(f"/joint?imported={quote(name)}")


async def identify(request: Request) -> Response:
    """Check everything, and start the identification."""
    state = AppState.of(request)
    record, draft = state.folder.record, await state.save_form(request)
    if record is None:
        return state.redirect("/")
    try:
        order = await run_in_threadpool(ordered, draft, record["name"])
        state.jobs.require_idle()
    except JointFileError as error:
        return pages.show_joint(state, told(error, draft, {EXTRA, *(one.name for one in JOINT_STEP)}))
    except PageError as error:
        return pages.show_joint(state, Faults({}, (str(error),)))
    run = state.folder.new_run()
    _link(state.folder.path / record["file"], run.folder / record["file"])
    (run.folder / "joint.toml").write_text(order.text, encoding="utf-8", newline="\n")
    write_json(run.folder / "work.json", {"file": record["file"], "name": record["name"], "learn": order.learn})
    state.jobs.start(run)
    return state.redirect(f"/runs/{run.number}")


async def save_draft(request: Request) -> Response:
    """Keep the entries of the form, at each change."""
    await AppState.of(request).save_form(request)
    return Response(status_code=204)


def _link(record: Path, place: Path) -> None:
    """Have a record in a second place, without a copy where the disk can."""
    try:
        os.link(record, place)
    except OSError:
        shutil.copyfile(record, place)
