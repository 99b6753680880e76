"""Steps 1 and 2: the record, and which of its columns is which channel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from jointid.apps.web import pages
from jointid.apps.web.app_state import Desk
from jointid.apps.web.fields import CHANNEL_STEP, TEXT
from jointid.apps.web.form import Faults, imported, record_tables, told
from jointid.apps.web.plots import column_svg
from jointid.apps.web.sessions import PageError, Visitor, write_json
from jointid.apps.web.upload import received
from jointid.common.errors import JointFileError, JointidError
from jointid.config import JointFile
from jointid.records.formats import FORMATS, format_of

_WITH_OPTIONS = "CSV"  # the format whose files may need to be read in another way


@dataclass(frozen=True, slots=True)
class Recording:
    """Steps 1 and 2."""

    desk: Desk

    async def start(self, request: Request) -> Response:
        """Show step 1."""
        return HTMLResponse(pages.record_page(self.desk.known(request), self.desk.limits))

    async def upload(self, request: Request) -> Response:
        """Take a record."""
        visitor, token = self.desk.visitor(request)
        try:
            self.desk.require_small(request, self.desk.limits.upload)
            async with self.desk.turn(visitor), self.desk.admitted(request, visitor, token):
                incoming, content = visitor.folder / "incoming", request.headers.get("content-type", "")
                name = await received(request.stream(), content, incoming, self.desk.limits.upload, _accepted)
                await self._taken(visitor, incoming, name, {})
        except JointidError as error:
            return self.desk.refused(request, visitor, token, error)
        return self.desk.to(request, "/channels", token)

    async def example(self, request: Request) -> Response:
        """Make the example: a simulated axis, with everything filled in."""
        from jointid.paper.twin import JOINT_FILE

        visitor, token = self.desk.visitor(request)
        try:
            async with self.desk.turn(visitor), self.desk.admitted(request, visitor, token):
                await self.desk.jobs.attend("example", visitor.folder)
                made = visitor.folder / "example.csv"
                await self._taken(visitor, made, made.name, imported(JOINT_FILE))
        except JointidError as error:
            return self.desk.refused(request, visitor, token, error)
        return self.desk.to(request, "/channels", token)

    async def again(self, request: Request) -> Response:
        """Read the record again, with other options."""
        visitor, token = self.desk.visitor(request)
        kept = {**visitor.draft, **await self.desk.form(request)}
        try:
            record = visitor.record
            if record is None:
                raise PageError("There is no record yet; choose one.")
            visitor.save_draft(kept)
            async with self.desk.turn(visitor):
                await self._looked(visitor, visitor.folder / record["file"], kept)
        except JointidError as error:
            return self.desk.refused(request, visitor, token, error)
        return self.desk.to(request, "/channels", token)

    async def _taken(self, visitor: Visitor, incoming: Path, name: str, draft: Mapping[str, str]) -> None:
        """Put a file that has arrived in the record's place, and look what is in it."""
        kept = {k: v for k, v in visitor.draft.items() if not k.startswith("record.")} if not draft else {}
        suffix = Path(name).suffix.lower()
        fresh = visitor.folder / f"fresh{suffix}"
        incoming.replace(fresh)
        try:
            await self._looked(visitor, fresh, {})
        except PageError:
            if format_of(fresh).name != _WITH_OPTIONS:
                fresh.unlink(missing_ok=True)
                raise
            self._placed(visitor, fresh, name, kept)  # an option of a text file may be all that is missing
            raise
        roles = (visitor.preview or {}).get("roles", {})
        guessed = {
            "record.time" if role == "time" else f"record.channels.{role}.column": column
            for role, column in roles.items()
        }
        self._placed(visitor, fresh, name, {**kept, **guessed, **draft})

    def _placed(self, visitor: Visitor, fresh: Path, name: str, draft: Mapping[str, str]) -> None:
        old = visitor.record
        if old is not None:
            (visitor.folder / old["file"]).unlink(missing_ok=True)
        record = fresh.replace(fresh.with_name(f"record{fresh.suffix}"))
        (visitor.folder / "checked.json").unlink(missing_ok=True)
        write_json(
            visitor.folder / "record.json",
            {"file": record.name, "name": name, "size": record.stat().st_size, "format": format_of(record).name},
        )
        visitor.save_draft(draft)

    async def _looked(self, visitor: Visitor, path: Path, draft: Mapping[str, str]) -> None:
        options = record_tables({one.name: draft.get(one.name, "") for one in TEXT}, path.name)["record"]
        chosen = {key: value for key, value in options.items() if key != "file"}
        (visitor.folder / "preview.json").unlink(missing_ok=True)
        write_json(visitor.folder / "work.json", {"file": path.name, "options": chosen})
        await self.desk.jobs.attend("look", visitor.folder)

    async def channels(self, request: Request) -> Response:
        """Show step 2."""
        visitor = self.desk.known(request)
        if visitor is None or visitor.preview is None:
            return RedirectResponse("/", 303)
        return HTMLResponse(pages.channels_page(visitor, self.desk.limits, Faults()))

    async def save_channels(self, request: Request) -> Response:
        """Check step 2 by reading the record."""
        visitor, _ = self.desk.visitor(request)
        record = visitor.record
        if record is None:
            return RedirectResponse("/", 303)
        draft = {**visitor.draft, **await self.desk.form(request)}
        visitor.save_draft(draft)
        try:
            tables = await run_in_threadpool(_checked_tables, draft, record["file"])
            work = {"file": record["file"], "name": record["name"], "tables": tables}
            async with self.desk.turn(visitor):
                write_json(visitor.folder / "work.json", work)
                await self.desk.jobs.attend("check", visitor.folder)
        except JointFileError as error:
            faults = told(error, draft, {one.name for one in CHANNEL_STEP})
        except PageError as error:
            faults = Faults({}, tuple(str(error).splitlines()))
        else:
            return RedirectResponse("/joint", 303)
        return HTMLResponse(pages.channels_page(visitor, self.desk.limits, faults), 422)

    async def plot(self, request: Request) -> Response:
        """Draw a column."""
        visitor = self.desk.known(request)
        preview = None if visitor is None else visitor.preview
        number = request.path_params["column"]
        if visitor is None or preview is None or number >= len(preview["columns"]):
            return self.desk.nothing(request)
        column = preview["columns"][number]
        end = pages.end_of_plot(preview, visitor.draft, column)
        return Response(column_svg(column, end), media_type="image/svg+xml")


def _checked_tables(draft: Mapping[str, str], file: str) -> dict[str, Any]:
    """Return the tables that say how the record is read, checked.

    Raises:
        JointFileError: with a sentence for each fault.
    """
    tables = record_tables(draft, file)
    JointFile.of(tables)
    return tables


def _accepted(name: str) -> None:
    """Raise a `PageError` for a name whose suffix tells no format; that of a folder has none, and cannot be sent.

    The name is the browser's: it is looked at as a text, and never for on this machine.
    """
    suffix = Path(name).suffix.lower()
    known = [known for entry in FORMATS for known in entry.suffixes]
    if suffix not in known:
        fact = f'the suffix "{suffix}", which names no known format' if suffix else "no suffix, which tells its format"
        raise PageError(f"{name} has {fact}; expected one of {', '.join(known)}: rename it.")
