"""State, uploads and views of the page.

Forms and files come in bounded and under names of ours; pages go out as HTML from templates of our own, every text that
came in escaped. `AppState` is what all addresses share.
"""

from __future__ import annotations

import asyncio
import math
import re
import shutil
from collections.abc import Collection, Mapping
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from python_multipart.exceptions import FormParserError
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.types import Message as Sent

from jointid import __version__
from jointid.apps.web import fields
from jointid.apps.web.folder import Folder, Limits, PageError, Run, clean_name, name_in_run, read_json
from jointid.apps.web.form import MODELS, clean_entries, place_faults
from jointid.apps.web.jobs import Jobs
from jointid.common.document import typeset
from jointid.common.messages import Message
from jointid.common.settings import settings_of
from jointid.common.text import format_signed, interval, number
from jointid.common.units import COUNTS, SHARE, units_of
from jointid.estimation.problems.base import DRIVE_AND_LOG, INITIAL
from jointid.estimation.result.answer import is_another_law, sum_changes
from jointid.estimation.result.summary import SHOWN_SHIFT
from jointid.models.controllers import LAWS
from jointid.records.formats import FORMATS
from jointid.uncertainty.verdict import Subject

if TYPE_CHECKING:
    from jinja2 import Environment

_FORM = 512 * 2**10  # bytes of a form without a file
_AROUND = 2**16  # bytes of a form around its file
_LAWS: tuple[Any, ...] = tuple(LAWS.values())  # mypy does not take a type for something with a hash
_OF_LOOP = {*DRIVE_AND_LOG, *(one.name for law in _LAWS for one in settings_of(law))}
"""What of a loop may be free beside the joint, but for numbers of its filters."""

_MARKS = {"failed": "not fine", "unknown": "not known", "passed": "fine", "noted": "noted"}
_ORDER = ["failed", "unknown", "passed"]  # of the checks, on the page
_DAMAGED = (HTTPException, FormParserError)  # of a form that cannot be parsed; older versions of Starlette pass it on


class AppState:
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

    @classmethod
    def of(cls, request: Request) -> AppState:
        """Return the state of the page that a request is for."""
        found = request.app.state.page
        assert isinstance(found, cls)
        return found

    def redirect(self, path: str) -> Response:
        """Lead the browser to another address of the page, such as "/channels"."""
        return RedirectResponse(f"{self.root}{path}", 303)

    async def read_form(self, request: Request) -> list[tuple[str, str]]:
        """Return the entries of a form without a file.

        Raises:
            PageError: the form is too large, or damaged.
        """
        try:
            async with bound_body(request, _FORM, "The form is larger than any of this page.").form() as sent:
                return [(name, value) for name, value in sent.multi_items() if isinstance(value, str)]
        except _DAMAGED:
            raise PageError("The form did not arrive whole; load the page again, and send it once more.") from None

    async def save_form(self, request: Request) -> dict[str, str]:
        """Keep the entries of a form without a file, and return the draft with them.

        Raises:
            PageError: see `read_form`.
        """
        entries = clean_entries(await self.read_form(request))
        draft = {**self.folder.draft, **entries}
        self.folder.save_draft(draft)
        return draft


def format_size(size: float) -> str:
    """Return a size in bytes as a sentence says it."""
    return f"{size / 2**20:.0f} MB" if size >= 2**20 else f"{size / 2**10:.0f} kB"


def bound_body(request: Request, bound: int, sentence: str) -> Request:
    """Return a request whose body raises a `PageError` above a number of bytes, or at once if it declares more."""
    sent = 0
    declared = request.headers.get("content-length", "")
    if re.fullmatch("[0-9]{1,18}", declared) and int(declared) > bound:
        raise PageError(sentence)

    async def receive() -> Sent:
        nonlocal sent
        message = await request.receive()
        sent += len(message.get("body", b""))
        if sent > bound:
            raise PageError(sentence)
        return message

    return Request(request.scope, receive)


async def receive_files(
    request: Request, state: AppState, bound: int, suffixes: Collection[str], most: int = 1
) -> list[tuple[Path, str]]:
    """Write the files of a form to the page's folder, under names of ours; return their paths and the names they had.

    Raises:
        PageError: the form has no file or too many, more bytes than the bound, a file of another suffix or two of one
            name, or is damaged; nothing of it is kept.
    """
    sentence = (
        f"The file is larger than {format_size(bound)}, which is the most this page takes; cut it, or log it slower."
    )
    received: list[tuple[Path, str]] = []
    try:
        body = bound_body(request, bound + most * _AROUND, sentence)
        async with body.form(max_files=most) as form:
            files = [file for file in form.getlist("file") if isinstance(file, UploadFile) and file.filename]
            if not files:
                raise PageError("No file arrived; choose one, and send it again.")
            for file in files:
                name = clean_name(file.filename or "")
                suffix = Path(name).suffix.lower()
                if suffix not in suffixes:
                    fact = f'the suffix "{suffix}"' if suffix else "no suffix"
                    raise PageError(f"{name} has {fact}; expected one of {', '.join(suffixes)}: rename it.")
                if name_in_run(name) in [name_in_run(known) for _, known in received]:
                    raise PageError(f"Two files are called {name}; rename one of them.")
                received.append((state.folder.new_upload(suffix), name))
                with received[-1][0].open("wb") as place:
                    await run_in_threadpool(shutil.copyfileobj, file.file, place)
    except (PageError, OSError, *_DAMAGED) as error:
        for path, _ in received:
            path.unlink(missing_ok=True)
        if isinstance(error, _DAMAGED):
            raise PageError("The file did not arrive whole; send it again.") from None
        raise
    return received


def list_suffixes() -> list[str]:
    """Return the suffixes of the files that are read."""
    return [suffix for entry in FORMATS for suffix in entry.suffixes]


def list_sent_suffixes() -> list[str]:
    """Return the suffixes of all files of step 1: records, joint file or robot file, and the model of a robot."""
    return [*list_suffixes(), ".toml", *MODELS]


def show_record(state: AppState, refusal: Exception | None = None) -> Response:
    """Show step 1: the record, and why it was refused."""
    faults = [] if refusal is None else str(refusal).splitlines()
    return _render(
        "record", state, 422 if faults else 200, step=1, faults=faults, suffixes=list_suffixes(),
        sent_suffixes=list_sent_suffixes(),
        bound=state.limits.upload, draft=state.folder.draft, text_fields=fields.TEXT,
    )  # fmt: skip


def show_channels(state: AppState, refusal: Exception | None = None) -> Response:
    """Show step 2: what each column is, and what was refused of it; step 1 where there is no column."""
    preview, draft = state.folder.preview, state.folder.draft
    if preview is None or state.folder.record is None:
        return show_record(state, refusal)
    faults = place_faults(refusal, draft, {one.name for one in fields.CHANNEL_STEP})
    always = ("torque", "reference", "motor_position")
    return _render(
        "channels", state, 422 if faults else 200, step=2, faults=faults, draft=draft, preview=preview,
        own_units=units_of("current", COUNTS, SHARE), kind=fields.KIND, clock=fields.CLOCK, gear=fields.GEAR,
        drive=fields.DRIVE,
        channels=[(name, one, name in always) for name, one in fields.CHANNEL_FIELDS.items()],
        places={one["name"]: i for i, one in enumerate(preview["columns"]) if one["outline"] is not None},
    )  # fmt: skip


def show_joint(state: AppState, refusal: Exception | None = None, imported: str = "") -> Response:
    """Show step 3: the axis and its controller, and what was refused of them."""
    draft = state.folder.draft
    faults = place_faults(refusal, draft, {fields.EXTRA, *(one.name for one in fields.JOINT_STEP)})
    return _render(
        "joint", state, 422 if faults else 200, step=3, faults=faults, draft=draft, joint=fields.JOINT,
        law=fields.LAW, controller=fields.CONTROLLER, method=fields.METHOD, extra=fields.EXTRA, imported=imported,
        checked=state.folder.checked, sent=[*state.folder.sent], preview=state.folder.preview,
    )  # fmt: skip


def show_run(state: AppState, run: Run) -> Response:
    """Show steps 4 and 5: progress, then the answer, while its report is written and after.

    Raises:
        PageError: its files are damaged.
    """
    from jinja2 import UndefinedError

    status = run.status
    answer = read_json(run.folder / "answer.json")
    about = read_json(run.folder / "about.json") or {}
    texts = ("answer.txt", "learned.txt", "resonance.txt", "axis.svg")
    try:
        return _render(
            "run", state, step=4 if answer is None else 5, run=run, status=status, lines=run.read_progress(),
            answer=answer, plan=read_json(run.folder / "plan.json"), tuning=read_json(run.folder / "tuning.json"),
            unexplained=[] if answer is None else _build_errors(answer),
            goals=_list_goals(answer), no_goal=_say_no_goal(answer),
            elapsed=round(run.seconds), stamps=run.stamps, rows=[] if answer is None else _build_rows(answer),
            checks=[] if answer is None else _build_checks(answer, read_json(run.folder / "marks.json") or {}),
            runs=[(one, one.status) for one in state.folder.runs],
            texts={name: run.read_text(name) for name in texts},
            title=_title_run(run, about, answer), checked=about.get("checked", True),
        )  # fmt: skip
    except (LookupError, TypeError, ValueError, AttributeError, UndefinedError) as error:
        raise PageError(
            f"answer.json of identification {run.number}, or a file beside it, is damaged ({error!r}); press Identify "
            "again."
        ) from error


def _title_run(run: Run, about: Mapping[str, Any], answer: Mapping[str, Any] | None) -> str:
    """Return the axis or robot, or else its record, the date of the identification, and the version."""
    name = about.get("name") or ("" if answer is None else answer["record"]["name"])
    date = datetime.fromtimestamp(run.status.get("started") or 0, UTC).date().isoformat()
    return f"{name}, {date}, jointid {__version__}"


def _list_goals(answer: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """Return the goals of a next test with their labels; empty if none can be planned."""
    if answer is None or answer["method"] != "didim" or _say_no_goal(answer):
        return []
    free = {name: p["symbol"] for name, p in answer["parameters"].items() if p["free"] and name not in INITIAL}
    named = [(name, f"{name.replace('_', ' ')} {symbol}") for name, symbol in free.items()]
    return [("all", "all parameters alike"), *named]


def _say_no_goal(answer: Mapping[str, Any] | None) -> str:
    """Return why no test can be planned from an answer; nothing where one can, or where none is offered."""
    if answer is not None and answer.get("model") == "robot":
        return "The next test of a robot is planned by the command: jointid design robot.toml."
    if answer is not None and answer.get("records"):
        return "A test is planned from one record; identify each of these alone for it."
    if answer is None or answer["method"] != "didim":
        return ""
    every = {name: p for name, p in answer["parameters"].items() if p["free"] and name not in INITIAL}
    if refused := [name.replace("_", " ") for name, p in every.items() if p["value"] is None]:
        return (
            f"This record does not identify {', '.join(refused)}, so no test can be planned from it; the report says "
            "which test would."
        )
    if freed := [name for name in every if name in _OF_LOOP or "." in name]:
        return f"A test is planned from an answer with {', '.join(freed)} fixed; fix it in step 3, and identify again."
    return ""


def show_message(state: AppState, code: int, title: str, sentences: str) -> Response:
    """Show a page of a few sentences."""
    return _render("message", state, code, step=0, title=title, sentences=sentences)


def _render(template: str, state: AppState, code: int = 200, **values: object) -> Response:
    runs = state.folder.runs
    common = {
        "root": state.root,
        "version": __version__,
        "folder": state.folder.path.name,
        "record": state.folder.record,
        "robot": bool((state.folder.record or {}).get("robot")),
        "latest": f"/runs/{runs[0].number}" if runs else "",
    }
    return HTMLResponse(_load_templates().get_template(f"{template}.html").render(common | values), code)


def find_fields(sentence: str) -> list[dict[str, str]]:
    """Return label and address of the fields that a sentence names."""
    found = []
    for one in fields.FIELDS:
        last = one.key.rpartition(".")[2]
        key = one.key if "_" not in last else rf"(?:{re.escape(one.key)}|{last})"
        if one.key.startswith("record.channels.") and last != "column":
            key = re.escape(one.key)
        if one.variant in ("", "prismatic") and re.search(rf"(?<![\w.]){key}(?![\w.]*\w)", sentence):
            step = "/channels" if one in fields.CHANNEL_STEP else "/joint"
            found.append({"path": f"{step}#{field_id(one.name)}", "label": one.label})
    return found


def field_id(name: str) -> str:
    """Return the id of a field in the page."""
    return name.replace(".", "-").replace("@", "-")


def label_end(preview: Mapping[str, Any], draft: Mapping[str, str], column: Mapping[str, Any]) -> str:
    """Return the label at the right end of a plot's time axis: a duration, or a number of rows."""
    times = [one for one in preview["columns"] if one["name"] == draft.get("record.time") and one["low"] is not None]
    if not times or times[0]["samples"] != column["samples"]:
        return f"{column['samples']} rows"
    unit = draft.get("record.time_unit") or fields.time_unit(times[0]["name"])
    return f"{number(times[0]['high'] - times[0]['low'], 3)} {unit}"


def _build_rows(answer: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the rows of the table of parameters.

    Of a parameter that a fault of the loop moves, it is said by how much; and of one at its bound, that it is.
    """
    of_loop: list[dict[str, Any]] = next(
        (one["reasons"] for one in answer["verdicts"] if one["subject"] == Subject.LOOP), []
    )
    reasons = [Message(one["code"], one["words"], one["values"]) for one in of_loop]
    moved, when = sum_changes(reasons), "under the other law" if is_another_law(reasons) else "once corrected"
    return [
        {
            "symbol": "" if p["symbol"] == name else p["symbol"],
            "name": name.replace("_", " "),
            "value": _tell_value(p),
            "nominal": f"{number(p['nominal'], 4)} {p['unit']}" if "nominal" in p else "",
            "note": "at its bound"
            if p.get("at_bound") is not None
            else f"{format_signed(moved[name], 2)} {p['unit']} {when}"
            if abs(moved.get(name, 0.0)) > SHOWN_SHIFT * (p["std"] or 0.0)
            else "",
        }
        for name, p in answer["parameters"].items()
    ]


def _tell_value(p: Mapping[str, Any]) -> str:
    """Return a parameter's value or bound with its unit."""
    if p["value"] is None:
        return "not identifiable" if p["lower_bound"] is None else f"> {number(p['lower_bound'], 3)} {p['unit']}"
    if p["std"] is None:
        return f"{number(p['value'])} {p['unit']}{'' if p['free'] else ', fixed'}"
    return f"{interval(p['value'], 2 * math.hypot(p['std'], p.get('lack_of_fit', 0.0)))} {p['unit']}"


def _build_errors(answer: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return the share of the torque of each joint of a robot that estimate and model do not explain."""
    robot = answer.get("robot") or {"joints": (), "left": (), "nominal_left": ()}
    nominal = robot["nominal_left"] or [None] * len(robot["joints"])
    return [
        (name, *("-" if left is None else f"{number(100 * left, 3)} %" for left in shares))
        for name, *shares in zip(robot["joints"], robot["left"], nominal, strict=True)
    ]


def _build_checks(answer: Mapping[str, Any], marks: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the checks with their marks, those that did not pass first."""
    checks = [
        {
            "mark": _MARKS[marks.get(verdict["subject"], verdict["status"])],
            "question": Subject(verdict["subject"]).question,
            "status": verdict["status"],
            "reasons": [reason["words"] for reason in verdict["reasons"]],
        }
        for verdict in answer["verdicts"]
    ]
    return sorted(checks, key=lambda check: _ORDER.index(check["status"]))


@cache
def _load_templates() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    made = Environment(
        loader=PackageLoader("jointid.apps.web"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    made.filters["sentences"] = lambda text: str(text).splitlines()
    made.filters["size"] = format_size
    made.filters["fields"] = find_fields
    made.filters["id"] = field_id
    made.filters["typeset"] = typeset
    made.filters["own"] = Markup  # HTML and SVG that the worker wrote, escaped
    made.tests["with_unit"] = lambda text: re.search(r"\d\s*[^\d\s.,;eE+-]", text) is not None
    return made
