"""Faults of a joint file: the key, what was received, what was expected, the remedy."""

import os
import sys
import time
import tomllib
from pathlib import Path

import pytest
import tomlkit
from hypothesis import given, settings
from hypothesis import strategies as st

from jointid.common.errors import JointFileError
from jointid.common.messages import dot_path
from jointid.config import dumps, load, loads
from jointid.config.declaration import list_keys
from jointid.config.robot_model import load_robot
from jointid.config.tables import JOINT_FILE
from tests.joint_files import CASCADE, CHANNELS, EXAMPLE, JOINT, LINK, SMALLEST, faults, in_our_words, told

FAULTS = [
    (SMALLEST + "position_gian = 3", "controller.position_gian unknown"),
    (SMALLEST.replace("motor_position", "motor_positon"), "record.channels.motor_positon unknown"),
    (SMALLEST.replace("position_gain = 100.0\n", ""), "controller.position_gain missing"),
    (CHANNELS + CASCADE, "joint missing"),
    (SMALLEST.replace('"prismatic"', '"linear"'), "joint.kind value"),
    (SMALLEST.replace('"prismatic"', '"prismatic"\nfriction = "dahl"'), "joint.friction value"),
    (SMALLEST.replace("position_gain = 100.0", 'position_gain = "160.18"'), "controller.position_gain value"),
    (SMALLEST + "limit = 0", "controller.limit value"),
    (SMALLEST + "integral_time = 30", "controller.integral_time unit"),  # ms, of which nothing is said
    (SMALLEST + "period = 0.5", "controller.period unit"),
    (SMALLEST.replace("position_gain = 100.0", "position_gain = 1200"), "controller.position_gain unit"),  # 1/min
    (SMALLEST + "velocity_filter = 0.5", "controller.velocity_filter.numerator value"),
    (SMALLEST + "velocity_filter = { numerator = [] }", "controller.velocity_filter contradiction"),
    (SMALLEST + "velocity_filter = { frequency = 80.0, samples = 3 }", "controller.velocity_filter.frequency unknown"),
    (
        SMALLEST + 'torque_filters = [[0.5, 0.5], { kind = "notch", frequency = 80 }]',
        "controller.torque_filters.1.bandwidth missing",
    ),
    (
        SMALLEST + 'period = 0.01\ntorque_filters = [{ kind = "notch", frequency = 80, bandwidth = 20 }]',
        "controller contradiction",
    ),
    (SMALLEST + "period = 0.001\nposition_period = 0.0025", "controller contradiction"),
    (
        SMALLEST.replace("velocity_gain = 2000.0", "derivative_gain = 3.0").replace("cascade", "pid"),
        "controller.integral_gain missing",
    ),
    (SMALLEST.replace('"i"', '"i", gain = -3.0'), "record.channels.torque.gain value"),
    (SMALLEST.replace('"i"', '"i", at = "after_limit"'), "record.channels.torque.at unknown"),
    (SMALLEST.replace('{ column = "i" }', '"i"'), "record.channels.torque value"),
    (SMALLEST + "[[method]]", "method value"),
    ("[record]\ndelimiter = 'ab'\n" + SMALLEST, "record.delimiter value"),
    ("[record]\nfile = 'run.xyz'\n" + SMALLEST, "record.file value"),
    ("[record]\nleave_out = [[2, 1]]\n" + SMALLEST, "record.leave_out value"),
    ("[record]\nleave_out = [1, 2]\n" + SMALLEST, "record.leave_out value"),
    ("[record]\nparts = [[0, 2], [1, 3]]\n" + SMALLEST, "record.parts value"),
    ("[record]\nparts = [[0, 2]]\nstart = 1\n" + SMALLEST, "record contradiction"),
    ("[record]\nfile = 'run.mat'\ndecimal = ','\n" + SMALLEST, "record contradiction"),
    (SMALLEST + "[filtering]\nborders = [1, 2, 3]", "filtering.borders value"),
    (SMALLEST + "[method]\nevaluations = 0xffffffffffffffff", "method.evaluations value"),
    (SMALLEST + "[method]\nfrequency = 30.0", "method.frequency contradiction"),
    (SMALLEST + "[parameters]\ninertai = 3", "parameters.inertai unknown"),
    (SMALLEST + '[gravity]\nload = "link"\n[parameters]\ngravity_cos = 3', "joint contradiction"),
    (
        SMALLEST.replace(JOINT, JOINT + 'friction = "asymmetric"\n') + '[gravity]\nload = "constant"',
        "joint contradiction",
    ),
    (SMALLEST + '[gravity]\nload="constant"\n[parameters]\noffset={start=3}', "parameters.offset contradiction"),
    (SMALLEST + "[transmission]\nlead = 10", "transmission.lead unit"),  # mm
    (SMALLEST + '[ripple]\nperiod = 0.005\nside = "load"', "joint contradiction"),
    (
        LINK + "counterbalance = { cos = 2 }\n[parameters]\ncounterbalance_cos = { start = 3 }",
        "parameters.counterbalance_cos contradiction",
    ),
    (SMALLEST + "[parameters]\ninertia = -3", "parameters.inertia contradiction"),
    (SMALLEST + '[parameters]\ninertia = "3"', "parameters.inertia.value value"),
    (SMALLEST + "[parameters]\ninertia = { start = 3, lower = 4 }", "parameters.inertia contradiction"),
    (SMALLEST + "[parameters]\ninertia = { lower = inf }", "parameters.inertia contradiction"),
    (SMALLEST + "[parameters]\noffset = { value = 3, start = 3 }", "parameters.offset contradiction"),
    ("[joint]\nkind = prismatic", ""),
    ("x = " + "9" * 5000, ""),
    ("x = " + "[" * 20000, ""),
]


@pytest.mark.parametrize(("text", "said"), FAULTS)
def test_a_fault_has_its_place_and_code(text: str, said: str) -> None:
    fault, *_ = faults(text)
    assert told(text)[0] == said
    assert fault.startswith(dot_path(fault.place)) and fault.endswith((".", "?"))


def test_all_faults_of_the_tables_come_at_once_before_those_between_them() -> None:
    wrong = SMALLEST.replace(JOINT, '[joint]\nkind = "prismatic"\nfriktion = "symmetric"\n').replace(
        '"i"', '"i", gain = -2.0'
    )
    wrong = wrong.replace("position_gain = 100.0", 'position_gain = "a"')
    wrong += '[filtering]\nborders = [1]\n[parameters]\nviscous = "a"\n'
    assert told(wrong) == [
        "joint.friktion unknown", "record.channels.torque.gain value", "controller.position_gain value",
        "filtering.borders value", "parameters.viscous.value value",
    ]  # fmt: skip


def test_a_file_that_is_not_there_or_no_text(tmp_path: Path) -> None:
    (tmp_path / "joint.toml").write_bytes(b"name = '\xff'")
    for name in ("none.toml", "joint.toml"):
        with pytest.raises(JointFileError):
            load(tmp_path / name)
    (tmp_path / "marked.toml").write_text(SMALLEST, encoding="utf-8-sig")
    assert load(tmp_path / "marked.toml") == loads(SMALLEST)


def test_spoiled_text_is_read_or_refused() -> None:
    text = EXAMPLE.read_text(encoding="utf-8")

    @given(st.integers(0, len(text)), st.integers(0, 40), st.text(max_size=12) | st.sampled_from(list('"[]{}=,.\n-')))
    def spoiled(at: int, length: int, put: str) -> None:
        read_or_refused(text[:at] + put + text[at + length :])

    spoiled()


anything = st.recursive(
    st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.dates()
    | st.sampled_from(("cascade", "pd", "didim", "idim", "flexible", "asymmetric", "paper", "A", "deg"))
    | st.sampled_from(("inverse-model", "as-printed", "warned", "pid", "notch", "moving_average", "track")),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["numerator", "position", "kind", "samples"]), inner)
    ),
    max_leaves=6,
)


@settings(max_examples=50)
@given(st.data())
def test_any_value_at_any_key_is_read_or_refused(data: st.DataObject) -> None:
    tables = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
    for _ in range(data.draw(st.integers(1, 4))):
        path = data.draw(st.sampled_from([*TABLES, *KEYS]))
        *above, key = path.replace("<name>", data.draw(st.sampled_from(("inertia", "offset", "x")))).split(".")
        table = tables
        for name in above:
            below = table.setdefault(name, {})
            table = below if isinstance(below, dict) else {}
        table[key] = data.draw(anything)
    try:
        file = loads(tomlkit.dumps(tables))
    except JointFileError as error:
        in_our_words(error)
    else:
        assert loads(dumps(file)) == file


TABLES = ("joint", "record", "controller", "filtering", "method", "parameters", "records", "together", "other")
KEYS = sorted({key.place for key in list_keys(JOINT_FILE) if "." in key.place})


def read_or_refused(text: str) -> None:
    try:
        loads(text)
    except JointFileError as error:
        in_our_words(error)


@pytest.mark.parametrize("line", ["x{} = [1, 2]", "[x{}]", "x = {{ y{} = 1, z = 2 }}", "x = [1,\n2]\ny{} = 'a, b'"])
def test_a_key_of_many_parts_is_refused_before_it_is_parsed(line: str) -> None:
    """The parser takes the square of the parts: half a minute for 120,000."""
    begin = time.process_time()
    with pytest.raises(JointFileError):
        loads(line.format(".a" * 120_000) + "\n")
    assert time.process_time() - begin < 5
    with pytest.raises(JointFileError):
        loads("", changes=[f"x{'.a' * 120_000}=1"])


@pytest.mark.skipif(sys.platform == "win32", reason="a pipe has no path")
def test_a_device_or_a_pipe_is_no_joint_file_and_no_model(tmp_path: Path) -> None:
    path = tmp_path / "joint.toml"
    path.symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "pipe")
    for read in (load, load_robot):
        for one in (path, tmp_path / "pipe"):
            with pytest.raises(JointFileError, match=r"cannot be opened \(it is a pipe or a device, no file\)"):
                read(one)
