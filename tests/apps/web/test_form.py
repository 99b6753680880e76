"""The form and the joint file: the same keys, the same checks, and every example there and back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jointid.apps.web.fields import EXTRA_LAW, FIELDS, JOINT_STEP, LAWS, LEARN, NAMES, WITHOUT
from jointid.apps.web.form import (
    clean_entries,
    make_order,
    make_reading_tables,
    make_tables,
    place_faults,
    read_joint_file,
)
from jointid.apps.web.preview import build_preview, draw_svg, guess_roles
from jointid.common.errors import JointFileError
from jointid.config import json_schema, load, loads
from jointid.paper.twin import JOINT_FILE
from jointid.records.formats import Table

ROOT = Path(__file__).resolve().parents[3]
EXAMPLES = sorted((ROOT / "examples").glob("*/*.toml"))
FILLED = {
    "record.channels.torque.column": "i",
    "record.channels.torque.unit@prismatic": "N",
    "record.channels.torque.unit@revolute": "N m",
    "record.channels.reference.column": "x",
    "controller.law": "cascade",
    "controller.kp": "60",
    "controller.kv": "500",
}
MOTOR = {"record.channels.motor_position.column": "q"}


def keys(schema: dict[str, Any], inside: dict[str, Any], law: str) -> dict[str, dict[str, Any]]:
    """Return the schema of every key, by its dotted path."""
    if "$ref" in inside:
        inside = schema["$defs"][inside["$ref"].rsplit("/", 1)[1]]
    for other in inside.get("oneOf", []):
        table = schema["$defs"][other["$ref"].rsplit("/", 1)[1]]
        if table["properties"]["law"]["const"] == law:
            inside = table
    if "properties" not in inside:
        return {"": inside}
    return {
        f"{key}.{below}".rstrip("."): found
        for key, value in inside["properties"].items()
        for below, found in keys(schema, value, law).items()
    }


def test_every_field_is_a_key_of_the_joint_file_with_its_words() -> None:
    schema = json_schema()
    for one in FIELDS:
        laws = one.when.get("controller.law", LAWS)
        for law in set(laws) & set(LAWS):
            known = keys(schema, schema, law)
            if one.key == "controller.law":
                assert {word for word, _ in one.choices} == {"", *LAWS, LEARN, WITHOUT, EXTRA_LAW}
                continue
            assert one.key in known, one.key
            if one.form == "choice" and "enum" in known[one.key]:
                assert {word for word, _ in one.choices} - {""} == set(known[one.key]["enum"]), one.key


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_a_joint_file_comes_through_the_form_unchanged(path: Path) -> None:
    file = load(path)
    again = loads(make_order(read_joint_file(path.read_text(encoding="utf-8")), file.source.file or "record.csv").text)
    assert again == file if file.source.file else again.tables()["joint"] == file.tables()["joint"]


def test_the_twin_comes_through_without_further_lines_but_what_has_no_field() -> None:
    draft = read_joint_file(JOINT_FILE)
    assert draft["controller.velocity_filter"] == "0.5, 0.5"
    assert draft["method.frequency"] == "30.0"
    assert "kp" not in draft["extra"]
    assert "optional" in draft["extra"]


def test_what_is_filled_in_is_what_is_written() -> None:
    file = loads(
        make_order({**FILLED, "controller.limit": "10", "extra": "[parameters]\ncoulomb = 20.0"}, "a.csv").text
    )
    assert file.source.file == "a.csv"
    assert file.controller is not None
    assert file.controller.limit == 10.0
    assert file.parameters["coulomb"].start == 20.0
    assert file.columns["torque"].unit == "N"
    revolute = loads(make_order({**FILLED, "joint.kind": "revolute"}, "a.csv").text)
    assert revolute.columns["torque"].unit == "N m"


@pytest.mark.parametrize(
    ("changes", "name", "said"),
    [
        ({"controller.kp": "-1"}, "controller.kp", "Position gain kp is -1"),
        ({"controller.kp": "fast"}, "controller.kp", 'is "fast"; expected a number'),
        ({"controller.kp": "1,5"}, "controller.kp", 'is "1,5"; expected a number with a decimal point: write 1.5.'),
        ({"controller.kp": "-1,5e-3"}, "controller.kp", "write -1.5e-3."),
        ({"controller.kp": "1,234,567"}, "controller.kp", "expected a number in plain digits"),
        ({"controller.kp": "1_0"}, "controller.kp", 'is "1_0"; expected a number in plain digits'),
        ({"controller.gain": "\u0663"}, "controller.gain", "expected a number in plain digits"),
        ({"controller.law": LEARN, "controller.gain": "1_0", **MOTOR}, "controller.gain", "in plain digits"),
        ({"controller.kp": "nan"}, "controller.kp", "expected a number"),
        ({"controller.kv": ""}, "controller.kv", "Velocity gain kv is missing"),
        ({"controller.law": ""}, "controller.law", "is not chosen"),
        ({"controller.law": LEARN}, "controller.law", "no motor_position"),
        ({"controller.law": "made up"}, "controller.law", ""),
        ({"controller.law": "pd"}, "controller.kd", "is missing"),
        ({"joint.friction": "none"}, "joint.friction", 'Friction "none" cannot'),
        ({"controller.velocity_filter": "0.5; x"}, "controller.velocity_filter", "in plain digits"),
        ({"controller.velocity_filter": "0,5; 0,5"}, "controller.velocity_filter", "write 0.5."),
        ({"extra": "[parameters"}, "extra", "is not TOML"),
        ({"extra": '[[records]]\nfile = "/etc/passwd"'}, "extra", "says [[records]], and this page identifies one"),
        ({"extra": "[together]"}, "extra", "use jointid identify for several records"),
        ({"extra": "[controller]\nkp = 3.0"}, "controller.kp", "further lines and in its field"),
    ],
)
def test_a_fault_stands_beside_its_field(changes: dict[str, str], name: str, said: str) -> None:
    draft = {**FILLED, **changes}
    with pytest.raises(JointFileError) as refused:
        make_order(draft, "a.csv")
    faults = place_faults(refused.value, draft, {"extra", *(one.name for one in JOINT_STEP)})
    beside = [*faults.beside.get(name, []), *(faults.general if name == "controller.law" else ())]
    assert any(said in sentence for sentence in beside), faults


@pytest.mark.parametrize("text", ["12", "-0.5", "+3.", ".5", "1e-3", "2.5E6", " 7 "])
def test_plain_numbers_are_read(text: str) -> None:
    draft = {**FILLED, "record.channels.torque.gain": text}
    assert make_tables(draft, "a.csv")["record"]["channels"]["torque"]["gain"] == float(text)


@pytest.mark.parametrize("said", ["[[records]]\nfile = '/etc/passwd'", "[together]", "[record]\nfile = '/etc/passwd'"])
def test_no_lines_lead_to_another_file(said: str) -> None:
    for read in (make_order, make_reading_tables):
        with pytest.raises(JointFileError):
            read({**FILLED, "extra": said}, "a.csv")
    if "[record]" not in said:
        with pytest.raises(JointFileError, match=r"^The joint file says .* this page identifies one record"):
            read_joint_file(said)
    else:
        assert "passwd" not in read_joint_file(said)["extra"]


def test_a_draft_holds_what_the_form_has_and_no_more() -> None:
    draft = clean_entries(
        [("controller.kp", "1\x00\x1b[2J" + "9" * 1000), ("__class__", "x"), ("record.file", "/etc/passwd")]
    )
    assert set(draft) == {"controller.kp"}
    assert len(draft["controller.kp"]) == 300
    assert draft["controller.kp"].isprintable()
    assert "record.file" not in NAMES


@pytest.mark.parametrize(
    ("columns", "roles"),
    [
        (["t", "vir", "qg", "qm"], {"time": "t", "torque": "vir", "reference": "qg", "motor_position": "qm"}),
        (
            ["Time [ms]", "Torque actual value", "Position demand value", "Position actual value"],
            {"time": "Time [ms]", "torque": "Torque actual value", "motor_position": "Position actual value"},
        ),
        (["a", "b", "c"], {}),
        (["force", "torque"], {"torque": "torque"}),
    ],
)
def test_roles_are_guessed_by_names(columns: list[str], roles: dict[str, str]) -> None:
    found = guess_roles(columns)
    assert {role: found.get(role) for role in roles} == roles
    assert not (roles == {} and found)
    assert len(set(found.values())) == len(found)


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
