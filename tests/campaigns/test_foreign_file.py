"""A file of results from somebody else: what was edited, is another file or none is refused, and kept as it is."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import pytest

from jointid.campaigns.campaign import Case
from jointid.campaigns.run import run_case
from jointid.campaigns.store import Outcome, Row, open_store
from jointid.common.errors import RecordError
from jointid.common.files import digest
from tests.campaigns.conftest import JOINT

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
