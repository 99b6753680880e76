"""The pages as HTML: templates of our own, every text that comes in escaped."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from jointid import __version__
from jointid.apps.web import fields
from jointid.apps.web.fields import Field
from jointid.apps.web.form import Faults
from jointid.apps.web.limits import Limits, megabytes
from jointid.apps.web.preview import duration
from jointid.apps.web.sessions import Run, Visitor, read_json
from jointid.common.text import number
from jointid.records.formats import FORMATS

if TYPE_CHECKING:
    from jinja2 import Environment

STATIC = {
    "page.css": "text/css; charset=utf-8",
    "page.js": "text/javascript; charset=utf-8",
    "icon.svg": "image/svg+xml",
}
"""The files that pages load, all ours."""


@cache
def static(name: str) -> bytes:
    """Return one of the files that pages load."""
    return files("jointid.apps.web").joinpath("static", name).read_bytes()


def render(template: str, visitor: Visitor | None, limits: Limits, **values: object) -> str:
    """Return a page.

    Args:
        template: its name, without the suffix.
        visitor: whose page it is, None before there is anything of them.
        limits: of this page.
        values: that the template asks for.
    """
    runs = [] if visitor is None else visitor.runs
    common: dict[str, object] = {
        "version": __version__,
        "record": None if visitor is None else visitor.record,
        "has_data": visitor is not None and visitor.folder.is_dir(),
        "latest": runs[0] if runs else None,
        "runs": [(run, run.status) for run in runs],
        "days": f"{limits.days:g}",
    }
    return _environment().get_template(f"{template}.html").render(common | values)


def record_page(visitor: Visitor | None, limits: Limits, faults: Sequence[str] = ()) -> str:
    """Return step 1: the record."""
    suffixes = [suffix for entry in FORMATS for suffix in entry.suffixes]
    return render(
        "record", visitor, limits, step=1, faults=faults, accept=",".join(suffixes), suffixes=", ".join(suffixes),
        most=megabytes(limits.upload), bound=limits.upload,
        draft={} if visitor is None else visitor.draft, text_fields=fields.TEXT,
    )  # fmt: skip


def channels_page(visitor: Visitor, limits: Limits, faults: Faults) -> str:
    """Return step 2: what each column is."""
    preview, draft = visitor.preview or {"columns": [], "roles": {}, "more": 0}, visitor.draft
    return render(
        "channels", visitor, limits, step=2, faults=faults, draft=draft, preview=preview, kind=fields.KIND,
        clock=fields.CLOCK, channels=_channels(draft), drive=fields.DRIVE, places=_places(preview),
    )  # fmt: skip


def joint_page(visitor: Visitor, limits: Limits, faults: Faults, imported: str = "") -> str:
    """Return step 3: the axis and its controller."""
    return render(
        "joint", visitor, limits, step=3, faults=faults, draft=visitor.draft, joint=fields.JOINT, law=fields.LAW,
        controller=fields.CONTROLLER, method=fields.METHOD, extra=fields.EXTRA, imported=imported,
        checked=read_json(visitor.folder / "checked.json"), most=megabytes(limits.joint_file),
    )  # fmt: skip


def run_page(visitor: Visitor, limits: Limits, run: Run) -> str:
    """Return steps 4 and 5: progress, then the answer."""
    status = run.status
    began = status.get("started") or status.get("queued") or time.time()
    answer = read_json(run.folder / "answer.json") if status["state"] == "done" else None
    values: dict[str, object] = {}
    if answer is not None:
        values = {"rows": _rows(answer), "answer": answer}
    for name in ("answer", "learned"):
        path = run.folder / f"{name}.txt"
        values[f"{name}_text"] = path.read_text(encoding="utf-8") if path.is_file() else ""
    return render(
        "run", visitor, limits, step=5 if status["state"] == "done" else 4, run=run, status=status, lines=run.lines(),
        elapsed=round((status.get("ended") or time.time()) - began), **values,
    )  # fmt: skip


def message_page(visitor: Visitor | None, limits: Limits, title: str, said: str) -> str:
    """Return a page that says one thing."""
    return render("message", visitor, limits, step=0, title=title, said=said)


def end_of_plot(preview: Mapping[str, Any], draft: Mapping[str, str], column: Mapping[str, Any]) -> str:
    """Return what stands at the end of a plot's time axis."""
    name = draft.get("record.time")
    lasted = duration(preview, name)
    samples = next((one["samples"] for one in preview["columns"] if one["name"] == name), None)
    if lasted is None or samples != column["samples"]:
        return f"{column['samples']} rows"
    return f"{number(lasted, 3)} {draft.get('record.time_unit') or fields.time_unit(name or '')}"


def _channels(draft: Mapping[str, str]) -> list[tuple[str, tuple[Field, ...], bool]]:
    """Return each channel, its fields, and whether it is one that every record has."""
    always = ("torque", "reference", "motor_position")
    return [(name, one, name in always) for name, one in fields.CHANNEL_FIELDS.items()]


def _places(preview: Mapping[str, Any]) -> dict[str, int]:
    """Return the number of each column that has a plot."""
    return {column["name"]: i for i, column in enumerate(preview["columns"]) if column["outline"] is not None}


def _rows(answer: Mapping[str, Any]) -> list[dict[str, str]]:
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
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("jointid.apps.web"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    made.filters["sentences"] = lambda text: str(text).splitlines()
    made.filters["size"] = megabytes
    return made
