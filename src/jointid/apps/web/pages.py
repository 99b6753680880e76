"""The pages as HTML: templates of our own, every text that comes in escaped."""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any

from starlette.responses import HTMLResponse, Response

from jointid import __version__
from jointid.apps.web import fields
from jointid.apps.web.folder import Run, read_json
from jointid.apps.web.form import place_faults
from jointid.apps.web.requests import AppState, format_size
from jointid.common.text import number
from jointid.records.formats import FORMATS

if TYPE_CHECKING:
    from jinja2 import Environment


def list_suffixes() -> list[str]:
    """Return the suffixes of the files that are read."""
    return [suffix for entry in FORMATS for suffix in entry.suffixes]


def show_record(state: AppState, refusal: Exception | None = None) -> Response:
    """Show step 1: the record, and why it was refused."""
    faults = [] if refusal is None else str(refusal).splitlines()
    return _render(
        "record", state, 422 if faults else 200, step=1, faults=faults, suffixes=list_suffixes(),
        bound=state.limits.upload, draft=state.folder.draft, text_fields=fields.TEXT,
    )  # fmt: skip


def show_channels(state: AppState, refusal: Exception | None = None) -> Response:
    """Show step 2: what each column is, and what was refused of it."""
    preview, draft = state.folder.preview or {"columns": [], "roles": {}, "more": 0}, state.folder.draft
    faults = place_faults(refusal, draft, {one.name for one in fields.CHANNEL_STEP})
    always = ("torque", "reference", "motor_position")
    return _render(
        "channels", state, 422 if faults else 200, step=2, faults=faults, draft=draft, preview=preview,
        kind=fields.KIND, clock=fields.CLOCK, drive=fields.DRIVE,
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
        checked=read_json(state.folder.path / "checked.json"),
    )  # fmt: skip


def show_run(state: AppState, run: Run) -> Response:
    """Show steps 4 and 5: progress, then the answer."""
    status = run.status
    answer = read_json(run.folder / "answer.json") if status["state"] == "done" else None
    texts = {name: run.folder / f"{name}.txt" for name in ("answer", "learned")}
    return _render(
        "run", state, step=4 if answer is None else 5, run=run, status=status, lines=run.read_progress(), answer=answer,
        elapsed=round((status.get("ended") or time.time()) - (status.get("started") or time.time())),
        rows=[] if answer is None else _build_rows(answer), runs=[(one, one.status) for one in state.folder.runs],
        texts={name: path.read_text(encoding="utf-8") if path.is_file() else "" for name, path in texts.items()},
    )  # fmt: skip


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
        "latest": f"/runs/{runs[0].number}" if runs else "",
    }
    return HTMLResponse(_load_templates().get_template(f"{template}.html").render(common | values), code)


def label_end(preview: Mapping[str, Any], draft: Mapping[str, str], column: Mapping[str, Any]) -> str:
    """Return the label at the right end of a plot's time axis: a duration, or a number of rows."""
    times = [one for one in preview["columns"] if one["name"] == draft.get("record.time") and one["low"] is not None]
    if not times or times[0]["samples"] != column["samples"]:
        return f"{column['samples']} rows"
    unit = draft.get("record.time_unit") or fields.time_unit(times[0]["name"])
    return f"{number(times[0]['high'] - times[0]['low'], 3)} {unit}"


def _build_rows(answer: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the rows of the table of parameters."""
    rows = []
    for name, p in answer["parameters"].items():
        value = number(p["value"]) if p["value"] is not None else "cannot be told"
        if p["value"] is None and p["lower_bound"] is not None:
            value = f"> {number(p['lower_bound'])}"
        spread = "fixed" if not p["free"] else "-" if p["std"] is None else number(2 * p["std"], 2)
        words = name.replace("_", " ")
        rows.append({"symbol": p["symbol"], "name": words, "value": value, "spread": spread, "unit": p["unit"]})
    return rows


@cache
def _load_templates() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("jointid.apps.web"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    made.filters["sentences"] = lambda text: str(text).splitlines()
    made.filters["size"] = format_size
    return made
