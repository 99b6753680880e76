"""The forms and the joint file: the same keys, the same checks, and every example there and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from jointid.apps.web.form import (
    FIELDS,
    JOINT_STEP,
    LEARN,
    clean_entries,
    describe_record,
    fill_in_form,
    make_joint_file,
    make_reading_tables,
    place_faults,
)
from jointid.apps.web.preview import build_preview, draw_svg
from jointid.common.errors import JointFileError
from jointid.config import load, loads
from jointid.records.formats import Table

ROOT = Path(__file__).resolve().parents[3]
EXAMPLES = sorted(
    path for path in (ROOT / "examples").glob("*/*.toml") if not path.stem.startswith(("campaign", "robot"))
)
FILLED = {
    "joint.kind": "prismatic",
    "record.channels.torque.column": "i",
    "record.channels.torque.unit": "N",
    "record.channels.reference.column": "x",
    "record.channels.reference.unit": "m",
    "controller.law": "cascade",
    "controller.position_gain": "60",
    "controller.velocity_gain": "500",
}
MOTOR = {"record.channels.motor_position.column": "q", "record.channels.motor_position.unit": "m"}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_a_joint_file_comes_through_the_form_unchanged(path: Path) -> None:
    file = load(path)
    draft = fill_in_form(path.read_text(encoding="utf-8"))["draft"]
    again = loads(make_joint_file(draft, [file.source.file or "record.csv"]))
    assert again == file if file.source.file else again.joint == file.joint


def test_what_is_filled_in_is_what_is_written() -> None:
    numbers = {"controller.limit": "10", "controller.delay": "0,8 ms", "extra": "[parameters]\ncoulomb = 20.0"}
    file = loads(make_joint_file({**FILLED, **numbers}, ["a.csv"]))
    assert file.source.file == "a.csv"
    assert file.controller is not None
    assert (file.controller.limit, file.controller.delay) == (10.0, pytest.approx(0.8e-3))
    assert file.parameters["coulomb"].start == 20.0
    assert file.axis.columns["torque"].unit == "N"


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"controller.position_gain": "-1"}, "controller.position_gain"),
        ({"controller.position_gain": "fast"}, "controller.position_gain"),
        ({"controller.position_gain": "1.234,5"}, "controller.position_gain"),
        ({"controller.position_gain": "1_0"}, "controller.position_gain"),
        ({"controller.gain": "\u0663"}, "controller.gain"),
        ({"controller.position_gain": "nan"}, "controller.position_gain"),
        ({"controller.velocity_gain": ""}, "controller.velocity_gain"),
        ({"controller.law": ""}, "controller.law"),
        ({"controller.law": LEARN}, "controller.law"),
        ({"controller.law": "pd", "controller.position_gain@pd": "3"}, "controller.derivative_gain"),
        ({"joint.friction": "none"}, "joint.friction"),
        ({"extra": "[parameters"}, "extra"),
        ({"extra": "[controller]\nposition_gain = 3.0"}, "controller.position_gain"),
    ],
)
def test_a_fault_stands_beside_its_field(changes: dict[str, str], name: str) -> None:
    draft = {**FILLED, **changes}
    with pytest.raises(JointFileError) as refused:
        make_joint_file(draft, ["a.csv"])
    faults = place_faults(refused.value, draft, {"extra", *(one.name for one in JOINT_STEP)})
    assert faults.beside.get(name)


@pytest.mark.parametrize("said", [
    "[[records]]\nfile = '/etc/passwd'", "[record]\nfiles = ['a.csv', '../passwd']", "[record]\nfile = '/etc/passwd'",
])  # fmt: skip
def test_no_lines_lead_to_another_file(said: str) -> None:
    for read in (make_joint_file, make_reading_tables):
        with pytest.raises(JointFileError, match=r"which was not sent|in the further lines and in its field"):
            read({**FILLED, "extra": said}, ["a.csv"])


def test_a_draft_holds_what_the_form_has_and_no_more() -> None:
    draft = clean_entries(
        [("controller.position_gain", "1\x00\x1b[2J" + "9" * 1000), ("__class__", "x"), ("record.file", "/etc/passwd")]
    )
    assert set(draft) == {"controller.position_gain"}
    assert len(draft["controller.position_gain"]) == 300
    assert draft["controller.position_gain"].isprintable()


def test_kind_and_units_are_asked_where_nothing_says_them() -> None:
    draft = {key: text for key, text in FILLED.items() if "unit" not in key and key != "joint.kind"}
    with pytest.raises(JointFileError) as refused:
        make_reading_tables(draft, ["a.csv"])
    faults = place_faults(refused.value, draft, {one.name for one in FIELDS})
    assert {*faults.beside} == {"joint.kind", "record.channels.torque.unit", "record.channels.reference.unit"}
    named = {**FILLED, "record.channels.torque.column": "F [N]", "record.channels.torque.unit": ""}
    assert make_reading_tables(named, ["a.csv"])["record"]["channels"]["torque"] == {"column": "F [N]"}


def test_the_columns_of_a_known_drive_are_read_by_its_profile() -> None:
    columns = ["Time", "Position demand internal value", "Position actual value", "Torque demand"]
    found = describe_record(columns)
    assert found["draft"]["drive.profile"] == "cia402" and "cia402" in found["sentence"]
    assert describe_record(["t", "x"]) == {"draft": {}, "sentence": ""}


def test_a_preview_is_small_and_has_the_peaks() -> None:
    values = np.zeros(100_000)
    values[54_321], values[7] = 5.0, np.nan
    found = build_preview(Table({"a": values, "b": np.full(3, np.nan)}))
    first, second = found["columns"]
    assert (first["low"], first["high"], first["samples"]) == (0.0, 5.0, 100_000)
    assert len(first["outline"][0]) == 400
    assert max(first["outline"][1]) == 5.0
    assert (second["low"], second["outline"]) == (None, None)
    assert "5.000" in draw_svg(first, "1 s")
    assert "no numbers" in draw_svg(second, "1 s")
    assert draw_svg({**first, "low": 2.0, "high": 2.0, "outline": [[2.0, None], [2.0, None]]}, "<b>").count("<b>") == 0
