"""The forms and the joint file: the same keys, the same checks, and every example there and back."""

from pathlib import Path

import numpy as np
import pytest
import tomlkit

from jointid.apps.web import form
from jointid.apps.web.form import EXTRA, fields_of, make_tables, place_faults, show_tables, take
from jointid.apps.web.worker import draw_column
from jointid.common.charts import svg
from jointid.common.errors import JointFileError
from jointid.config import load, loads
from jointid.config.declaration import flatten_keys
from jointid.config.toml import parse_toml

ROOT = Path(__file__).resolve().parents[3]
EXAMPLES = sorted(
    path for path in (ROOT / "examples").glob("*/*.toml") if not path.stem.startswith(("campaign", "robot"))
)
FILLED = {
    "joint.kind": "prismatic", "record.channels.torque.column": "i", "record.channels.torque.unit": "N",
    "record.channels.reference.column": "x", "record.channels.reference.unit": "m",
    "controller.law": "cascade", "controller.position_gain": "60", "controller.velocity_gain": "500",
}  # fmt: skip


def filled(changes: dict[str, str] | None = None) -> form.Tables:
    return make_tables(take({**FILLED, **(changes or {})}.items()), ["a.csv"])


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_a_joint_file_comes_through_the_form_unchanged(path: Path) -> None:
    file, tables = load(path), parse_toml(path.read_text(encoding="utf-8"))
    records = [file.source.file] if file.source.file else [run.file for run in file.runs]
    again = loads(tomlkit.dumps(make_tables(show_tables(tables), records)))
    assert again == file or (not file.source.file and again.axes[0].joint == file.axes[0].joint)


def test_what_is_filled_in_is_what_is_written() -> None:
    said = {"controller.limit": "10", "controller.delay": "0,8 ms", EXTRA: "[parameters]\ncoulomb = 20.0", "x": "y"}
    tables = filled({"record.file": "/etc/passwd", "controller.velocity_filter.time_constant": "0,4 ms", **said})
    assert tables["controller"] == {
        "law": "cascade", "position_gain": 60, "velocity_gain": 500, "limit": 10, "delay": "0.8 ms",
        "velocity_filter": {"kind": "first_order", "time_constant": "0.4 ms"},
    }  # fmt: skip
    assert (tables["parameters"], tables["record"]["file"]) == ({"coulomb": 20.0}, "a.csv")
    assert tables.keys() == {"joint", "record", "controller", "parameters"}
    shown = show_tables(tables)
    assert (shown["controller.delay"], shown[EXTRA].strip()) == ("0.8 ms", "[parameters]\ncoulomb = 20.0")
    entered = take([("controller.position_gain", "x\x00\x1b[2J" + "9" * 1000)])["controller.position_gain"]
    assert len(entered) == 300 and entered.isprintable()


def test_a_field_that_does_not_count_is_left_out() -> None:
    flexible = {"joint.model": "flexible", "joint.spring": "backlash", "record.channels.torque.sign": "-1"}
    assert {"joint.spring", "record.channels.torque.sign"} < flatten_keys(filled(flexible)).keys()
    chosen = {"controller.law": "pd", "joint.model": "rigid", "record.channels.torque.column": ""}
    assert filled(flexible | chosen)["controller"] == {"law": "pd", "position_gain": 60}
    assert not {"joint.spring", "record.channels.torque.sign"} & flatten_keys(filled(flexible | chosen)).keys()
    assert "controller" not in filled({"controller.law": form.LEARN})


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"controller.position_gain": "fast"}, "controller.position_gain"),
        ({"controller.velocity_gain": ""}, "controller.velocity_gain"),
        ({"joint.friction": "none"}, "joint.friction"),
        (dict.fromkeys((key for key in FILLED if key.startswith("joint.")), ""), "joint.kind"),
        ({EXTRA: "[parameters"}, EXTRA),
        ({EXTRA: "record = 3"}, EXTRA),
        ({EXTRA: "joint.knid = 'prismatic'"}, EXTRA),
    ],
)
def test_a_fault_stands_beside_its_field_or_the_further_lines(changes: dict[str, str], name: str) -> None:
    with pytest.raises(JointFileError) as refused:
        loads(tomlkit.dumps(filled(changes)))
    shown = fields_of(FILLED | changes)
    placed = place_faults(refused.value, shown | {EXTRA: form.ROBOT[0].fields[0]})
    assert [*placed] == [name] and name not in placed[name][0]
    assert name == EXTRA or placed[name][0].startswith(f"“{shown[name].label}”")


def test_the_side_of_a_reference_and_the_unit_of_a_gain_are_asked_for() -> None:
    geared = FILLED | {"transmission.ratio": "50:1", "joint.torque_constant": "0.62", "controller.limit": "7,5"}
    both = {f"record.channels.{name}.side": "load" for name in ("reference", "motor_position")}
    for more, controller, asked in (
        ({"controller.law": "", EXTRA: "# no controller"}, True, "law"), ({}, False, r"Choose\.$"),
        ({"record.channels.motor_position.column": "q"}, False, r"Choose\.\n.*Choose\.$"),
        ({}, True, r'\?.*\n.*"500 A s/m".*"500 N s/m".*\n.*"7,5 A"'),
        ({"transmission.lead": "10 mm"}, True, '"500 A s/rad".*"500 N m s/rad"'),
    ):  # fmt: skip
        with pytest.raises(JointFileError, match=asked):
            form.require(geared | more, controller=controller)
    form.require(geared | both | {"controller.gain": "1"}, controller=True)
    shown = fields_of(FILLED)  # without a gear no side
    assert (form.make_tables(geared, [])["transmission"], both.keys() & shown.keys()) == ({"ratio": 50}, set())
    assert [*place_faults(JointFileError("it needs the lead of the transmission"), shown)] == ["transmission.lead"]
    said = 'velocity_gain, period = 1e-4, [ripple] period = 2, torque_filters = [{ kind = "pt1" }], of the transmission'
    told = "“Velocity gain”, “Period”: 1e-4, {0[0]} (in Further lines), {0[1]} (in Further lines), {0[2]} (step 2)"
    assert [form.name_fields(said, one) for one in (shown, {})] == [told.format(said.split(", ")[2:]), said]
    (torque,) = (one.fields for one in form.channel_step(geared) if one.title == "Torque")
    assert [one.key.rpartition(".")[2] for one in torque[:3]] == ["column", "unit", "gain"]  # what a form shows openly


@pytest.mark.parametrize(
    ("said", "names"),
    [
        ("[[records]]\nfile = '/etc/passwd'", ["passwd"]),
        ("[record]\nfile = '/etc/passwd'", ["a.csv"]),
        ("robot = { model = '../../arm.xml' }", ["arm.xml", "a.csv"]),
    ],
)
def test_no_lines_lead_to_another_file(said: str, names: list[str]) -> None:
    found = flatten_keys(filled({EXTRA: said}))
    files = [found.get(f"{key}") for key in ("robot.model", "record.file")]
    rows = [row["file"] for row in found.get("records", [])]
    assert [*filter(None, files), *rows] == names


def test_several_records_are_rows_of_the_joint_file() -> None:
    tables = make_tables(FILLED, ["a.csv", "b.csv"])
    assert tables["records"] == [{"file": "a.csv"}, {"file": "b.csv"}] and "file" not in tables["record"]
    tables["records"][0]["added_inertia"] = 2.5
    assert make_tables(show_tables(tables), ["a.csv", "b.csv", "c.csv"])["records"] == tables["records"]


@pytest.mark.parametrize("strange", [np.nan, np.inf, -1.7e308, 5e-324])
def test_a_plot_is_small_and_has_the_peaks(strange: float) -> None:
    values = np.zeros(100_000)
    values[54_321], values[7] = 5.0, strange
    figure = draw_column(values)
    assert np.nanmax(figure.axes[0].lines[0].get_ydata()) == 5.0
    assert len(svg(figure, "column")) < 50_000
    svg(draw_column(np.full(3, strange)), "column")
