"""Faults of a joint file: the key, what was received, what was expected, the remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

from jointid.common.errors import JointFileError
from jointid.common.messages import dot_path
from jointid.config import load, loads
from tests.joint_files import CASCADE, CHANNELS, JOINT, LINK, SMALLEST, faults, told

FAULTS = [
    (SMALLEST + "position_gian = 3", "controller.position_gian unknown"),
    (SMALLEST + "[methods]", "methods unknown"),
    (SMALLEST.replace("motor_position", "motor_positon"), "record.channels.motor_positon unknown"),
    (SMALLEST.replace("position_gain = 100.0\n", ""), "controller.position_gain missing"),
    (SMALLEST.replace(JOINT, "[joint]\n"), "joint.kind missing"),
    (CHANNELS + CASCADE, "joint missing"),
    (SMALLEST.replace('"prismatic"', '"linear"'), "joint.kind value"),
    (SMALLEST.replace('"cascade"', '"cascad"'), "controller.law value"),
    (SMALLEST.replace('"prismatic"', '"prismatic"\nfriction = "dahl"'), "joint.friction value"),
    (
        SMALLEST.replace('"prismatic"', '"prismatic"\nmodel = "flexible"\nfriction = "stribeck"\nspring = "cubic"'),
        "joint contradiction",
    ),
    (SMALLEST.replace("position_gain = 100.0", 'position_gain = "160.18"'), "controller.position_gain value"),
    (SMALLEST + "limit = 0", "controller.limit value"),
    (SMALLEST + "velocity_filter = 0.5", "controller.velocity_filter.numerator value"),
    (SMALLEST + "velocity_filter = { numerator = [] }", "controller.velocity_filter contradiction"),
    (SMALLEST + "velocity_filter = { frequency = 80.0, samples = 3 }", "controller.velocity_filter.frequency unknown"),
    (SMALLEST + 'velocity_filter = { kind = "lowpass" }', "controller.velocity_filter.kind value"),
    (
        SMALLEST + 'torque_filters = [[0.5, 0.5], { kind = "notch", frequency = 80 }]',
        "controller.torque_filters.1.bandwidth missing",
    ),
    (
        SMALLEST + 'torque_filters = { kind = "notch", frequency = 80, bandwidth = 20 }',
        "controller.torque_filters value",
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
    (SMALLEST.replace('"i"', '"i", sign = true'), "record.channels.torque.sign value"),
    (SMALLEST.replace('"i"', "3"), "record.channels.torque.column value"),
    (SMALLEST.replace('"i"', '"i", at = "after_limit"'), "record.channels.torque.at unknown"),
    (SMALLEST.replace('{ column = "i" }', '"i"'), "record.channels.torque value"),
    (SMALLEST + "[[method]]", "method value"),
    ("[record]\ndelimiter = 'ab'\n" + SMALLEST, "record.delimiter value"),
    ("[record]\nfile = 'run.xyz'\n" + SMALLEST, "record.file value"),
    ("[record]\nfile = 'run.mat'\ndecimal = ','\n" + SMALLEST, "record contradiction"),
    (SMALLEST + "[filtering]\nborders = [1, 2, 3]", "filtering.borders value"),
    (SMALLEST + "[method]\niterations = 0xffffffffffffffff", "method.iterations value"),
    (SMALLEST + '[drive]\nprofile = "abc"', "drive.profile value"),
    (SMALLEST + "[method]\nfrequency = 30.0", "method.frequency contradiction"),
    (SMALLEST + "[parameters]\ninertai = 3", "parameters.inertai unknown"),
    (SMALLEST + '[gravity]\nload = "link"\n[parameters]\ngravity_cos = 3', "joint contradiction"),
    (
        SMALLEST.replace(JOINT, JOINT + 'friction = "asymmetric"\n') + '[gravity]\nload = "constant"',
        "joint contradiction",
    ),
    (
        SMALLEST + '[gravity]\nload = "constant"\n[parameters]\noffset = { start = 3 }',
        "parameters.offset contradiction",
    ),
    (SMALLEST + "[ripple]\nharmonics = 2", "ripple.period missing"),
    (SMALLEST + '[ripple]\nperiod = 0.005\nside = "load"', "joint contradiction"),
    (SMALLEST.replace(JOINT, JOINT + 'friction = "stribeck"\n') + "[ripple]\nperiod = 0.005", "joint contradiction"),
    (
        LINK + "counterbalance = { cos = 2 }\n[parameters]\ncounterbalance_cos = { start = 3 }",
        "parameters.counterbalance_cos contradiction",
    ),
    (SMALLEST + "[parameters]\ninertia = -3", "parameters.inertia contradiction"),
    (SMALLEST + '[parameters]\ninertia = "3"', "parameters.inertia.value value"),
    (SMALLEST + "[parameters]\ninertia = { start = 3, lower = 4 }", "parameters.inertia contradiction"),
    (SMALLEST + "[parameters]\ninertia = { lower = inf }", "parameters.inertia contradiction"),
    (SMALLEST + "[parameters]\noffset = { lower = nan }", "parameters.offset.lower value"),
    (SMALLEST + "[parameters]\noffset = { free = false }", "parameters.offset.free unknown"),
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
