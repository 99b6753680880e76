"""The forms and the joint file: the same keys, the same checks, and every example there and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from jointid.apps.web.form import EXTRA, at, confine, enter, fields_of, list_records, make_reading_tables, place_faults
from jointid.apps.web.form import show as show_form
from jointid.apps.web.form import write as write_toml
from jointid.apps.web.worker import draw_column
from jointid.common.errors import JointFileError
from jointid.config import load, loads
from jointid.config.toml import parse_toml

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


def filled(changes: dict[str, str] | None = None) -> dict[str, object]:
    return enter({"joint": {}}, {**FILLED, **(changes or {})}.items(), ["a.csv"])


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_a_joint_file_comes_through_the_form_unchanged(path: Path) -> None:
    file, tables = load(path), parse_toml(path.read_text(encoding="utf-8"))
    again = loads(write_toml(enter(tables, show_form(tables).items(), list_records(tables))))
    assert again == file or (not file.source.file and again.axes[0].joint == file.axes[0].joint)


def test_what_is_filled_in_is_what_is_written() -> None:
    tables = filled({"controller.limit": "10", "controller.delay": "0,8 ms", EXTRA: "[parameters]\ncoulomb = 20.0"})
    assert tables["controller"] == {
        "law": "cascade", "position_gain": 60, "velocity_gain": 500, "limit": 10, "delay": "0.8 ms"
    }  # fmt: skip
    assert (at(tables, "parameters.coulomb"), at(tables, "record.file")) == (20.0, "a.csv")
    shown = show_form(tables)
    assert (shown["controller.delay"], shown[EXTRA].strip()) == ("0.8 ms", "[parameters]\ncoulomb = 20.0")
    cleared = enter(tables, {"controller.limit": "", "record.file": "/etc/passwd", "__class__": "x"}.items(), ["a.csv"])
    assert at(cleared, "controller.limit") is None
    assert (cleared["record"]["file"], cleared.keys()) == ("a.csv", tables.keys())


def test_a_field_that_no_longer_counts_takes_its_value_with_it() -> None:
    tables = filled({"joint.model": "flexible", "joint.spring": "backlash", "record.channels.torque.sign": "-1"})
    changed = {"controller.law": "pd", "joint.model": "rigid", "record.channels.torque.column": ""}
    tables = enter(tables, changed.items(), ["a.csv"])
    assert tables["controller"] == {"law": "pd", "position_gain": 60}
    assert at(tables, "joint.spring") is at(tables, "record.channels.torque.sign") is None
    assert "controller.derivative_gain" in fields_of(tables)


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
        ({"controller.law": "pd"}, "controller.derivative_gain"),
        ({"joint.friction": "none"}, "joint.friction"),
        ({"extra": "[parameters"}, "extra"),
        ({"extra": "record = 3"}, "extra"),
        ({"extra": "record.channels = 3"}, "extra"),
    ],
)
def test_a_fault_stands_beside_its_field(changes: dict[str, str], name: str) -> None:
    with pytest.raises(JointFileError) as refused:
        loads(write_toml(filled(changes)))
    assert place_faults(refused.value, {EXTRA, *fields_of(filled())} | {name}).get(name)


@pytest.mark.parametrize(
    ("said", "names"),
    [
        ("[[records]]\nfile = '/etc/passwd'", ["passwd", "a.csv"]),
        ("[record]\nfiles = ['x/a.csv', '../passwd']", ["a.csv", "passwd"]),
        ("[record]\nfile = '/etc/passwd'", ["a.csv"]),
        ("records = 3\nrobot = 3", ["a.csv"]),
    ],
)
def test_no_lines_lead_to_another_file(said: str, names: list[str]) -> None:
    assert list_records(filled({EXTRA: said})) == names
    assert confine(parse_toml("robot = { model = '../../arm.xml' }"), [])["robot"] == {"model": "arm.xml"}


def test_a_text_is_bounded_and_printable() -> None:
    entered = at(filled({"controller.position_gain": "x\x00\x1b[2J" + "9" * 1000}), "controller.position_gain")
    assert len(entered) == 300
    assert entered.isprintable()


def test_kind_and_units_are_asked_where_nothing_says_them() -> None:
    asked = {key: text for key, text in FILLED.items() if "unit" not in key and key != "joint.kind"}
    with pytest.raises(JointFileError) as refused:
        make_reading_tables(enter({"joint": {}}, asked.items(), ["a.csv"]))
    faults = place_faults(refused.value, fields_of(filled()))
    assert {*faults} == {"joint.kind", "record.channels.torque.unit", "record.channels.reference.unit"}
    named = filled({"record.channels.torque.column": "F [N]", "record.channels.torque.unit": ""})
    assert make_reading_tables(named)["record"]["channels"]["torque"] == {"column": "F [N]"}


def test_several_records_are_rows_of_the_joint_file() -> None:
    tables = enter(filled(), [], ["a.csv", "b.csv"])
    assert tables["records"] == [{"file": "a.csv"}, {"file": "b.csv"}]
    assert at(tables, "record.file") is None
    tables["records"][0]["added_inertia"] = 2.5
    again = enter(tables, show_form(tables).items(), ["a.csv", "b.csv", "c.csv"])
    assert [row["file"] for row in again["records"]] == ["a.csv", "b.csv", "c.csv"]
    assert again["records"][0]["added_inertia"] == 2.5


def test_a_plot_is_small_and_has_the_peaks() -> None:
    values = np.zeros(100_000)
    values[54_321], values[7] = 5.0, np.nan
    drawn = draw_column(values)
    assert "5.000" in drawn and len(drawn) < 50_000
    assert "no numbers" in draw_column(np.full(3, np.nan))
    assert "2.000" in draw_column(np.full(3, 2.0))
