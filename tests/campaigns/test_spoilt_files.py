"""Files that are spoilt in four ways: each is named, and no other."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.campaigns.campaign import Case
from jointid.campaigns.report import CampaignReport
from jointid.campaigns.run import run_case
from jointid.campaigns.store import Outcome, Row, open_store
from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.files import digest
from tests.rigid_axis import JOINT, TRUTH, recorded

SPOILT: dict[str, Callable[[FloatArray], FloatArray]] = {
    "unit": lambda torque: -1000.0 * torque,
    "frozen": lambda torque: np.where(np.arange(torque.size) > torque.size // 3, torque[torque.size // 3], torque),
    "other axis": lambda torque: np.roll(torque, torque.size // 4),
    "torn": lambda torque: torque,
}


BY_IDIM = JOINT.replace("[controller]", 'motor_position = { column = "motor_position", unit = "m" }\n[controller]')
BY_IDIM += '[method]\nname = "idim"\n'


def run(place: Path, joint: str, day: str, kind: str, seed: int, file: str = JOINT) -> Row:
    """Identify one record of a joint of its own inertia, spoilt in one way or as it is."""
    record = recorded(2.0, seed, inertia=TRUTH["inertia"] * (1.0 + 0.3 * np.sin(int(joint[-2:]))))
    values = SPOILT.get(kind, lambda torque: torque)(record.torque.values)
    path = place / f"{joint}-{day}.npy"
    ji.write(replace(record, torque=replace(record.torque, values=values)), path)
    if kind == "torn":
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return run_case(Case(joint, file, str(path), "", day))


@pytest.mark.parametrize(
    ("kind", "outcome"), [pytest.param("unit", Outcome.DOUBTFUL, marks=pytest.mark.slow), ("frozen", Outcome.DOUBTFUL)]
)
def test_a_run_that_found_nothing_is_not_identified(kind: str, outcome: Outcome, tmp_path: Path) -> None:
    row = run(tmp_path, "axis 01", "2026-11-01", kind, 1)
    assert row.outcome is outcome and "Do not rely on it yet" in row.sentence
    assert row.error_percent is not None and row.error_percent > 65.0


@pytest.mark.slow
def test_in_a_fleet_of_forty_joints_over_ten_days_every_spoilt_file_is_named(tmp_path: Path) -> None:
    days = [f"2026-11-{day:02}" for day in range(1, 11)]
    kinds = {(f"axis {7 * k % 40:02}", days[3 * k % 10]): kind for k, kind in enumerate([*SPOILT] * 4)}
    kinds |= {("axis 39", day): "frozen" for day in days[-3:]}
    rows = [
        run(tmp_path, f"axis {joint:02}", day, kinds.get((f"axis {joint:02}", day), ""), 10 * joint + k, BY_IDIM)
        for joint in range(40)
        for k, day in enumerate(days)
    ]
    assert {(row.joint, row.day) for row in rows if row.outcome is not Outcome.IDENTIFIED} == kinds.keys()
    found = CampaignReport("forty joints", tuple(rows))
    assert [(one.joint, one.last) for one in found.losses] == [("axis 39", days[-4])]
    assert found.drifted == ()
    text = " ".join(found.to_document(details=True).text().split())
    assert all(f"{joint} {day}, " in text for joint, day in kinds)


ROW = asdict(Row("a" * 64, "axis", "a.npy", "", (), Outcome.IDENTIFIED, "Found."))
EDITED = [
    ("error_percent", "x"), ("error_percent", float("inf")), ("changes", [1]), ("outcome", []), ("joint", 3),
    ("found", {"inertia": {"value": float("nan"), "std": 1.0, "unit": "kg"}}),
]  # fmt: skip
FOREIGN = [
    *(f"{json.dumps(ROW | {key: value})}\n" for key, value in EDITED),
    json.dumps(ROW | {"error_percent": 0}).replace('"error_percent": 0', f'"error_percent": 1{"0" * 400}') + "\n",
    f"{json.dumps([ROW])}\n", "[" * 100_000, "t,q\n1,2\n", "[joint]", '{"fit": 1}', '{"fit": 1}\n', "{\n",
    '{"row": 1}\n{"changes"',
]  # fmt: skip


@pytest.mark.parametrize("text", FOREIGN)
def test_another_file_is_refused_and_stays_as_it_is(tmp_path: Path, text: str) -> None:
    path = tmp_path / "results.jsonl"
    path.write_text(text)
    with pytest.raises(RecordError), open_store(path):
        pass
    assert path.read_text() == text


@pytest.mark.skipif(sys.platform == "win32", reason="a pipe has no path")
@pytest.mark.parametrize("made", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")])
def test_a_pipe_or_a_device_ends_no_campaign(tmp_path: Path, made: Callable[[Path], None]) -> None:
    record, path = tmp_path / "run.csv", tmp_path / "results.jsonl"
    for one in (record, path):
        made(one)
    with pytest.raises(RecordError):
        digest(record)
    assert run_case(Case("axis", JOINT, str(record), "")).outcome is Outcome.REFUSED
    with pytest.raises(RecordError), open_store(path):
        pass
