"""An estimate back from what `identify --json` wrote, or from the page of a report, to be compared with another."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from jointid.common.errors import RecordError
from jointid.diagnostics.changes import EstimateComparison, ReportedEstimate, ReportedQuantity
from jointid.output.json.estimates import ESTIMATE_SCHEMA
from jointid.output.json.parts import Json
from jointid.output.json.reports import REPORT_ELEMENT, REPORT_SCHEMA

DRIFT_SCHEMA = "jointid.drift/1"

_MOST = 64 << 20  # bytes of a file: a page of 25 s has 3 MB
_REMEDY = "give what identify --json or report --html wrote"


class _Answer(HTMLParser):
    """Finds the answer that a page carries along."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=False)
        self.inside = False
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.inside = tag == "script" and dict(attrs).get("id") == REPORT_ELEMENT

    def handle_endtag(self, tag: str) -> None:
        self.inside = False

    def handle_data(self, data: str) -> None:
        if self.inside:
            self.text.append(data)


def read_report(path: str | Path) -> ReportedEstimate:
    """Return the estimate in a file: the JSON of an estimate or of a report, or the HTML page of a report.

    Raises:
        RecordError: the file cannot be read, or holds no estimate.
    """
    path = Path(path)
    answer: object = _loaded(path)
    if isinstance(answer, dict) and answer.get("schema") == REPORT_SCHEMA:
        answer = answer.get("estimate")
    if not isinstance(answer, dict) or answer.get("schema") != ESTIMATE_SCHEMA:
        raise RecordError(f"{path} holds no estimate of schema {ESTIMATE_SCHEMA}; {_REMEDY}.")
    try:
        return _told(answer, path.name)
    except (KeyError, TypeError, ValueError, AttributeError):
        raise RecordError(f"{path} is a damaged estimate of schema {ESTIMATE_SCHEMA}; {_REMEDY}.") from None


def _loaded(path: Path) -> Json:
    try:
        if path.stat().st_size > _MOST:
            raise RecordError(f"{path} has more than {_MOST >> 20} MB, which no report has; {_REMEDY}.")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise RecordError(f"{path} cannot be read ({error.strerror}); {_REMEDY}.") from None
    except UnicodeDecodeError:
        raise RecordError(f"{path} is no text; {_REMEDY}.") from None
    if text.lstrip()[:1] == "<":
        page = _Answer()
        page.feed(text)
        text = "".join(page.text)
    try:
        answer = json.loads(text)
    except (ValueError, RecursionError):
        raise RecordError(f"{path} holds no JSON; {_REMEDY}.") from None
    if not isinstance(answer, dict):
        raise RecordError(f"{path} holds no estimate of schema {ESTIMATE_SCHEMA}; {_REMEDY}.")
    return answer


def _told(answer: Json, label: str) -> ReportedEstimate:
    record, gear = answer["record"], answer["transmission"]
    side = "" if gear is None else f"{gear['side']} side, {float(gear['motor_per_load']):g} motor per load"
    filtering = answer["filtering"]
    borders = " + ".join(str(int(border)) for border in filtering["borders"])
    settings = {
        "method": str(answer["variant"]),
        "filter": f"{filtering['cutoff']} Hz, one sample in {filtering['decimation']}",
        "samples left out": borders,
        "controller": str(answer["controller_sha256"] or "none")[:12],
    }
    sums = [one for one in answer.get("combinations") or () if _of_both_sides(one["weights"])]
    return ReportedEstimate(
        label,
        str(record["name"]),
        str(record["torque_sha256"]),
        str(answer["model"]),
        str(answer["kind"]),
        str(answer["friction"]),
        side,
        str(record["torque_unit"]),
        settings,
        float(answer["relative_error_percent"]) / 100,
        tuple(_quantity(n, p) for n, p in answer["parameters"].items() if not n.startswith("initial_")),
        tuple(
            ReportedQuantity(
                str(one["name"]), str(one["formula"]), str(one["unit"]), _size(one["value"]), _size(one["std"])
            )
            for one in sums
        ),
    )


def _of_both_sides(weights: Mapping[str, float]) -> bool:
    """Return whether weights are the sum or difference of one quantity on both sides; files before 0.2 say no kind."""
    (first, one), *rest = weights.items()
    side, _, quantity = first.partition("_")
    return side == "motor" and one == 1.0 and len(rest) == 1 and rest[0] in {(f"load_{quantity}", w) for w in (1, -1)}


def _quantity(name: str, p: Mapping[str, Any]) -> ReportedQuantity:
    return ReportedQuantity(
        name, str(p["symbol"]), str(p["unit"]), _size(p["value"]), _size(p["std"]), free=bool(p["free"])
    )


def _size(value: object) -> float | None:
    """Return a number that is one, and None for null."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError
    return float(value)


def drift_answer(drift: EstimateComparison) -> Json:
    """Return what changed between two estimates as it is written to JSON."""
    return {
        "schema": DRIFT_SCHEMA,
        "a": {"file": drift.before.label, "record": drift.before.record, "torque_sha256": drift.before.fingerprint},
        "b": {"file": drift.after.label, "record": drift.after.record, "torque_sha256": drift.after.fingerprint},
        "same_record": drift.same_record,
        "level": drift.level,
        "quantities": {
            row.name: {
                "symbol": row.symbol,
                "unit": row.unit,
                "a": row.before,
                "b": row.after,
                "difference": row.difference,
                "std": row.std,
                "p_value": row.p_value,
                "changed": row in drift.changed,
                "said": row.reason or None,
            }
            for row in drift.rows
        },
        "sentences": list(drift.sentences),
    }
