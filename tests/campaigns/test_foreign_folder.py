"""A campaign's folder from somebody else: what computes, was edited or is no file is refused in a sentence."""

from __future__ import annotations

import json
import os
import sqlite3
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from jointid.campaigns.cases import Case, Outcome, Row
from jointid.campaigns.folder import read_results
from jointid.campaigns.paths import digest
from jointid.campaigns.report import CampaignReport
from jointid.campaigns.run import run_case
from jointid.campaigns.shards import Shard, open_shard
from jointid.campaigns.store import DATABASE, open_database
from jointid.common.errors import RecordError
from tests.campaigns.conftest import JOINT

HASHES = ["a" * 64, "b" * 64]
ENDLESS = "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n) SELECT"


def row(content_hash: str) -> Row:
    return Row(content_hash, "axis", "a.npy", "", (), Outcome.IDENTIFIED, "Found.", "", versions={"jointid": "1"})


@pytest.fixture
def base(tmp_path: Path) -> Path:
    with open_database(tmp_path) as results:
        results.list_cases("fleet", HASHES)
        results.add([*map(row, HASHES)])
    with open_database(tmp_path) as results:
        assert results.has_result(HASHES[0])  # tables of its own are taken up again
    assert len(read_results(tmp_path).rows) == 2
    return tmp_path


def execute(folder: Path, *orders: str) -> None:
    connection = sqlite3.connect(folder / DATABASE)
    for order in orders:
        connection.execute(order)
    connection.commit()
    connection.close()


@pytest.mark.parametrize(
    "orders",
    [
        ("DROP TABLE listed", f"CREATE VIEW listed AS {ENDLESS} printf('%064d', k) AS hash FROM n"),
        ("DROP TABLE about", f"CREATE VIEW about AS {ENDLESS} k AS key, zeroblob(100000000) AS value FROM n"),
        (f"CREATE TRIGGER slow AFTER DELETE ON listed BEGIN {ENDLESS} max(k) FROM n; END",),
        ("CREATE VIRTUAL TABLE other USING fts5(x)",),
        ("ALTER TABLE listed ADD COLUMN big AS (zeroblob(100000000))",),
        ("CREATE INDEX slow ON results (json_extract(row, '$.joint'))",),
    ],
)
def test_a_database_that_computes_is_refused(base: Path, orders: tuple[str, ...]) -> None:
    execute(base, *orders)
    with pytest.raises(RecordError, match="which no campaign has; name the folder of a campaign"):
        read_results(base)
    with pytest.raises(RecordError, match="which no campaign has"), open_database(base):
        pass


def deep(_: dict[str, Any]) -> str:
    return "[" * 100_000


def large(raw: dict[str, Any]) -> str:
    return json.dumps(raw | {"error_percent": 0}).replace('"error_percent": 0', f'"error_percent": 1{"0" * 400}')


EDITS: list[Callable[[dict[str, Any]], str]] = [
    deep,
    large,
    lambda raw: json.dumps(raw | {"error_percent": "x"}),
    lambda raw: json.dumps(raw | {"error_percent": float("inf")}),
    lambda raw: json.dumps(raw | {"simulations": [1]}),
    lambda raw: json.dumps(raw | {"converged": 7}),
    lambda raw: json.dumps(raw | {"versions": ["jointid"]}),
    lambda raw: json.dumps(raw | {"versions": {"jointid": 1}}),
    lambda raw: json.dumps(raw | {"found": {"inertia": {"value": float("nan"), "std": 1.0, "unit": "kg"}}}),
    lambda raw: json.dumps(raw | {"joint": 3}),
    lambda raw: json.dumps([raw]),
]


@pytest.mark.parametrize("edit", EDITS)
def test_a_row_that_was_edited_is_refused(base: Path, edit: Callable[[dict[str, Any]], str]) -> None:
    text = edit(json.loads(row(HASHES[0]).text()))
    execute(base, f"UPDATE results SET row = '{text}' WHERE hash = '{HASHES[0]}'")
    with pytest.raises(RecordError, match="holds what is no result"):
        CampaignReport(read_results(base)).to_page().text()
    shard = Shard(1, 1).path(base / "shards")
    shard.parent.mkdir()
    lines = [json.dumps({"cases": HASHES, "name": "fleet"}), f'{{"row": {text}, "stored": 1.0}}']
    shard.write_text("\n".join([*lines, json.dumps({"row": asdict(row(HASHES[1])), "stored": 2.0}), ""]))
    if edit is deep:  # as a line that was torn
        assert [one.content_hash for one in read_results(shard.parent).rows] == HASHES[1:]
        return
    with pytest.raises(RecordError, match=r"1-of-1\.jsonl, line 2 is no .*; delete that line"):
        read_results(shard.parent)


@pytest.mark.parametrize("stored", ["'inf'", "'nan'", "1e308", "-1e308", "x'31'"])
def test_a_time_that_was_edited_is_refused(base: Path, stored: str) -> None:
    execute(base, f"UPDATE results SET stored = {stored}")
    with pytest.raises(RecordError, match="its time is none"):
        read_results(base)


def test_a_row_of_another_case_is_refused(base: Path) -> None:
    execute(base, f"UPDATE results SET row = '{row(HASHES[1]).text()}'")
    with pytest.raises(RecordError, match="of another case"):
        read_results(base)


@pytest.mark.skipif(sys.platform == "win32", reason="a pipe has no path")
@pytest.mark.parametrize("made", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")])
def test_a_pipe_or_a_device_ends_no_campaign(tmp_path: Path, made: Callable[[Path], None]) -> None:
    record, part = tmp_path / "run.csv", Shard(1, 1)
    for path in (record, part.path(tmp_path)):
        made(path)
    with pytest.raises(RecordError, match="it is a pipe or a device, no file"):
        digest(record)
    assert run_case(Case("axis", JOINT, str(record), "")).outcome is Outcome.REFUSED
    with pytest.raises(RecordError, match="it is a pipe or a device, no file"):
        read_results(tmp_path)
    with pytest.raises(RecordError, match="it is a pipe or a device, no file"), open_shard(tmp_path, part):
        pass
    part.path(tmp_path).unlink()
    made(tmp_path / DATABASE)
    with pytest.raises(RecordError, match="is no folder of a campaign"):
        read_results(tmp_path)
