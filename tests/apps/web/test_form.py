"""The form and the joint file: the same keys, the same checks, and every example there and back."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from jointid.apps.web.fields import CHANNEL_STEP, EXTRA_LAW, FIELDS, JOINT_STEP, LAWS, LEARN, NAMES, WITHOUT
from jointid.apps.web.form import (
    clean_entries,
    make_order,
    make_reading_tables,
    place_faults,
    read_joint_file,
    require_answers,
    with_units,
)
from jointid.apps.web.guesses import guess_draft
from jointid.apps.web.preview import build_preview, draw_svg
from jointid.common.errors import JointFileError
from jointid.config import load, loads
from jointid.config.schema import FileTable
from jointid.config.table import list_keys
from jointid.models.controllers import FILTERS, Cascade, FirstOrder, MovingAverage
from jointid.records.formats import Table

ROOT = Path(__file__).resolve().parents[3]
EXAMPLES = sorted(
    path for path in (ROOT / "examples").glob("*/*.toml") if not path.stem.startswith(("campaign", "robot"))
)
FILLED = {
    "joint.kind": "prismatic",
    "record.channels.torque.column": "i",
    "record.channels.torque.unit@prismatic": "N",
    "record.channels.torque.unit@revolute": "N m",
    "record.channels.reference.column": "x",
    "controller.law": "cascade",
    "controller.position_gain": "60",
    "controller.velocity_gain": "500",
}
NUMERATOR = "controller.velocity_filter.numerator"
TAPS = {"controller.velocity_filter.kind": "digital"}
LAG = "controller.torque_filters.0.kind"
MOTOR = {"record.channels.motor_position.column": "q"}


def test_every_field_is_a_key_of_the_joint_file_with_its_words() -> None:
    declared = {(key.place, key.kind): key.declared for key in list_keys(FileTable)}
    for one in FIELDS:
        laws = set(one.when.get("controller.law", LAWS)) & set(LAWS)
        if "_filter" in one.key:
            path, _, setting = one.key.rpartition(".")
            assert path in ("controller.velocity_filter", "controller.torque_filters.0")
            kind = one.when.get(f"{path}.kind", ("digital",))[0]
            assert setting == "kind" or setting in {each.name for each in dataclasses.fields(FILTERS[kind])}
        elif one.key == "controller.law":
            assert {word for word, _ in one.choices} == {"", *LAWS, LEARN, WITHOUT, EXTRA_LAW}
        else:
            for law in laws if one.key.startswith("controller.") else ("",):
                choices = declared[one.key, law].choices
                assert one.form != "choice" or {word for word, _ in one.choices} - {""} == set(choices), one.key


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_a_joint_file_comes_through_the_form_unchanged(path: Path) -> None:
    file = load(path)
    again = loads(make_order(read_joint_file(path.read_text(encoding="utf-8")), file.source.file or "record.csv")[0])
    assert again == file if file.source.file else again.joint == file.joint


def test_what_is_filled_in_is_what_is_written() -> None:
    file = loads(make_order({**FILLED, "controller.limit": "10", "extra": "[parameters]\ncoulomb = 20.0"}, "a.csv")[0])
    assert file.source.file == "a.csv"
    assert file.controller is not None
    assert file.controller.limit == 10.0
    assert file.parameters["coulomb"].start == 20.0
    assert file.columns["torque"].unit == "N"
    revolute = loads(make_order({**FILLED, "joint.kind": "revolute"}, "a.csv")[0])
    assert revolute.columns["torque"].unit == "N m"


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"controller.position_gain": "-1"}, "controller.position_gain"),
        ({"controller.position_gain": "fast"}, "controller.position_gain"),
        ({"controller.position_gain": "1.234,5"}, "controller.position_gain"),
        ({"controller.position_gain": "1_0"}, "controller.position_gain"),
        ({"controller.position_gain": "5 rad"}, "controller.position_gain"),
        ({"controller.gain": "\u0663"}, "controller.gain"),
        ({"controller.position_gain": "nan"}, "controller.position_gain"),
        ({"controller.velocity_gain": ""}, "controller.velocity_gain"),
        ({"controller.integral_time": "0"}, "controller.integral_time"),
        ({"controller.law": LEARN, "controller.gain": "1_0", **MOTOR}, "controller.gain"),
        ({"controller.law": ""}, "controller.law"),
        ({"controller.law": LEARN}, "controller.law"),
        ({"controller.law": "pd", "controller.position_gain@pd": "3"}, "controller.derivative_gain"),
        ({"joint.friction": "none"}, "joint.friction"),
        ({**TAPS, NUMERATOR: "0,5"}, NUMERATOR),
        ({LAG: "first_order"}, "controller.torque_filters.0.time_constant"),
        ({"extra": "[parameters"}, "extra"),
        ({"extra": "[controller]\nposition_gain = 3.0"}, "controller.position_gain"),
    ],
)
def test_a_fault_stands_beside_its_field(changes: dict[str, str], name: str) -> None:
    draft = {**FILLED, **changes}
    with pytest.raises(JointFileError) as refused:
        make_order(draft, "a.csv")
    faults = place_faults(refused.value, draft, {"extra", *(one.name for one in JOINT_STEP)})
    assert faults.beside.get(name) or (name == "controller.law" and faults.general)


@pytest.mark.parametrize("said", [
    "[[records]]\nfile = '/etc/passwd'", "[record]\nfiles = ['a.csv', '../passwd']", "[record]\nfile = '/etc/passwd'",
])  # fmt: skip
def test_no_lines_lead_to_another_file(said: str) -> None:
    for read in (make_order, make_reading_tables):
        with pytest.raises(JointFileError, match=r"which was not sent|in the further lines and in its field"):
            read({**FILLED, "extra": said}, "a.csv")


def test_a_draft_holds_what_the_form_has_and_no_more() -> None:
    draft = clean_entries(
        [("controller.position_gain", "1\x00\x1b[2J" + "9" * 1000), ("__class__", "x"), ("record.file", "/etc/passwd")]
    )
    assert set(draft) == {"controller.position_gain"}
    assert len(draft["controller.position_gain"]) == 300
    assert draft["controller.position_gain"].isprintable()
    assert "record.file" not in NAMES


@pytest.mark.parametrize(
    ("columns", "torque", "unit", "kind", "reference"),
    [
        (["t", "Torque [N m]", "pos_ref [rad]"], "Torque [N m]", "N m", "revolute", "pos_ref [rad]"),
        (["t", "F [N]", "x_soll [mm]", "x_ist [mm]"], "F [N]", "N", "prismatic", "x_soll [mm]"),
        (["t_ms", "iq_act", "pos_set_deg", "pos_act_deg"], "iq_act", None, "revolute", "pos_set_deg"),
        (["t", "I [A]", "phi_ref [°]", "phi_m [°]"], "I [A]", "A", "revolute", "phi_ref [°]"),
        (["Zeit", "Istw", "qref"], "Istw", None, None, "qref"),
        (["t", "Actual torque", "SetPos", "ActPos"], "Actual torque", None, None, "SetPos"),
        (["t", "TorqueActual_Nm", "CommandPosition_deg"], "TorqueActual_Nm", "Nm", "revolute", "CommandPosition_deg"),
        (
            ["t", "Momentensollwert [Nm]", "Momentenistwert [Nm]", "Lagesollwert [mm]", "Lageistwert [mm]"],
            "Momentensollwert [Nm]",
            "Nm",
            None,  # a torque and a travel: a screw
            "Lagesollwert [mm]",
        ),
        (["t", "Torque limit", "Torque actual", "Set position", "Position error"], "Torque actual", None, None,
         "Set position"),
        (["t", "trq_a", "trq_b"], None, None, None, None),
    ],
)  # fmt: skip
def test_the_torque_is_recognised_by_unit_and_usual_names(
    columns: list[str], torque: str | None, unit: str | None, kind: str | None, reference: str | None
) -> None:
    draft = guess_draft(columns)
    assert draft.get("record.channels.torque.column") == torque
    assert draft.get("record.channels.reference.column") == reference
    assert draft.get("joint.kind") == kind
    assert draft.get(f"record.channels.torque.unit@{kind or 'revolute'}") == unit


@pytest.mark.parametrize(("kind", "key"), [("prismatic", "counts_per_metre"), ("revolute", "counts_per_turn")])
def test_encoder_counts_are_asked_for_in_what_the_motor_moves_by(kind: str, key: str) -> None:
    counts = [one for one in FIELDS if one.key.startswith("drive.counts_per_")]
    assert [one.key for one in counts if one.applies({"joint.kind": kind})] == [f"drive.{key}"]


def test_axis_and_units_are_asked_where_nothing_says_them() -> None:
    draft = {"record.channels.torque.column": "i", "record.channels.reference.column": "x"}
    with pytest.raises(JointFileError, match=r"^joint.kind is not chosen; say whether it turns"):
        require_answers(draft)
    turning = draft | {"joint.kind": "revolute", "record.channels.torque.unit@revolute": "A"}
    with pytest.raises(JointFileError) as refused:
        require_answers(turning)
    faults = place_faults(refused.value, turning, {one.name for one in CHANNEL_STEP})
    assert list(faults.beside) == ["record.channels.reference.unit@revolute"]
    require_answers(turning | {"record.channels.reference.unit@revolute": "deg"})
    require_answers(turning | {"extra": '[drive]\nprofile = "cia402"'})


def test_a_joint_file_without_units_says_them_on_the_page() -> None:
    text = """
    [joint]
    kind = "revolute"
    [record.channels]
    torque = {column = "iq [A]"}
    reference = {column = "phi [deg]", gain = 0.017}
    """
    draft = with_units(read_joint_file(text))
    assert draft["record.channels.torque.unit@revolute"] == "A"
    assert draft["record.channels.reference.unit@revolute"] == "rad"  # the gain leads from deg to there
    require_answers(draft)
    own = read_joint_file(text.replace('"iq [A]"', '"iq", unit = "of its own"'))
    assert "record.channels.torque.unit@revolute" not in with_units(own)  # the further lines say it


def test_filters_times_and_units_are_entered_as_drives_show_them() -> None:
    lag, mean = "controller.velocity_filter", "controller.torque_filters.0"
    draft = {
        **FILLED,
        f"{lag}.kind": "first_order",
        f"{lag}.time_constant": "0,8 ms",
        f"{mean}.kind": "moving_average",
        f"{mean}.samples": "2",
        "controller.integral_time": "8 ms",
        "controller.delay": "500 us",
    }
    file = loads(make_order(draft, "a.csv")[0])
    law = file.controller
    assert isinstance(law, Cascade)
    assert law.velocity_filter == FirstOrder(8e-4)
    assert law.torque_filters == (MovingAverage(2),)
    assert (law.integral_gain, law.delay) == (125.0, pytest.approx(5e-4))
    again = read_joint_file(make_order(draft, "a.csv")[0])
    assert (again[f"{lag}.kind"], again[f"{mean}.kind"], again["controller.integral_time"]) == (
        "first_order",
        "moving_average",
        "8 ms",
    )
    assert "filter" not in again["extra"]


def test_a_joint_file_fills_its_times_and_sides_into_their_fields() -> None:
    sides = {f"record.channels.{name}.side": "load" for name in ("torque", "reference")} | {"controller.side": "load"}
    text = """
    [joint]
    kind = "revolute"
    [record.channels]
    torque = {column = "i", unit = "A", side = "load"}
    reference = {column = "x", side = "load"}
    [transmission]
    ratio = 50
    side = "motor"
    [controller]
    law = "cascade"
    side = "load"
    position_gain = "35 1/s"
    velocity_gain = "0.25 A s/rad"
    integral_time = "20 ms"
    """
    draft = read_joint_file(text)
    assert draft["extra"] == ""
    assert draft.items() >= (sides | {"transmission.side": "motor", "controller.integral_time": "20 ms"}).items()
    plain = text.replace('integral_time = "20 ms"', "integral_gain = 50")
    assert read_joint_file(plain).items() >= {"extra": "", "controller.integral_time": "0.02"}.items()


def test_gear_and_screw_are_fields_of_step_2_in_the_units_of_both_sides() -> None:
    step = {one.name: one for one in CHANNEL_STEP}
    assert step.keys() >= {"transmission.ratio", "transmission.lead", "transmission.sign"}
    text = """
    [joint]
    kind = "prismatic"
    [record.channels]
    torque = {column = "i", unit = "mN m"}
    reference = {column = "x", unit = "mm", side = "load"}
    motor_position = {column = "q", unit = "deg"}
    [transmission]
    lead = 10.0
    lead_unit = "mm"
    sign = -1
    [drive]
    counts_per_turn = 4096.0
    [controller]
    law = "cascade"
    position_gain = 25.0
    velocity_gain = 0.02
    """
    draft = read_joint_file(text)
    assert draft["extra"] == "", "every key has its field"
    require_answers(draft)
    assert make_reading_tables(draft, "a.csv")["transmission"] == {"lead": 10.0, "lead_unit": "mm", "sign": -1}
    expected = text.replace("[record.channels]", '[record]\nfile = "a.csv"\n[record.channels]')
    assert loads(make_order(draft, "a.csv")[0]) == loads(expected)


@pytest.mark.parametrize("lines", ['velocity_filter = {kind = "notch", frequency = 90.0, bandwidth = 20.0}',
    'torque_filters = [{kind = "first_order", time_constant = 1e-3}, [0.5, 0.5]]',
    "velocity_filter = {numerator = [0.2], denominator = [1.0, -0.8]}", "integral_gain = 49.0"])  # fmt: skip
def test_what_the_fields_cannot_say_of_a_controller_stands_in_the_further_lines(lines: str) -> None:
    text = f"""
    [joint]
    kind = "prismatic"
    [record]
    file = "a.csv"
    channels = {{torque = {{column = "i"}}, reference = {{column = "x"}}}}
    [controller]
    law = "cascade"
    position_gain = 60.0
    velocity_gain = 500.0
    {lines}
    """
    assert loads(make_order(read_joint_file(text), "a.csv")[0]) == loads(text)


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
