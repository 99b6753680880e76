"""Faults of a joint file: the key, what was received, what was expected, the remedy."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from jointid.common.errors import JointFileError
from jointid.common.messages import dot_path
from jointid.config import load, loads
from tests.joint_files import CASCADE, CHANNELS, FLEXIBLE, JOINT, LINK, SMALLEST, faults, told

FAULTS = [
    (SMALLEST + "position_gian = 3", "controller.position_gian unknown"),
    (
        SMALLEST.replace("velocity_gain = 2000.0", "derivative_gain = 3.0\nintegral_gain = 1.0").replace(
            "cascade", "pd"
        ),
        "controller.integral_gain unknown",
    ),
    (SMALLEST + "[methods]", "methods unknown"),
    (SMALLEST.replace("motor_position", "motor_positon"), "record.channels.motor_positon unknown"),
    (SMALLEST + '["a.b"]', '"a.b" unknown'),
    (SMALLEST.replace("position_gain = 100.0\n", ""), "controller.position_gain missing"),
    (SMALLEST.replace(JOINT, "[joint]\n"), "joint.kind missing"),
    (CHANNELS + CASCADE, "joint missing"),
    (SMALLEST.replace('"prismatic"', '"linear"'), "joint.kind value"),
    (SMALLEST.replace('"cascade"', '"cascad"'), "controller.law choice"),
    (SMALLEST.replace('law = "cascade"\n', ""), "controller.law choice"),
    (SMALLEST.replace('"cascade"', "[1]"), "controller.law choice"),
    (SMALLEST.replace('"prismatic"', '"prismatic"\nfriction = "dahl"'), "joint.friction refused"),
    (
        SMALLEST.replace('"prismatic"', '"prismatic"\nmodel = "flexible"\nfriction = "stribeck"\nspring = "cubic"'),
        "joint.friction contradiction",
    ),
    (SMALLEST.replace("position_gain = 100.0", 'position_gain = "160.18"'), "controller.position_gain value"),
    (SMALLEST + "limit = 0", "controller.limit value"),
    (SMALLEST + "velocity_filter = 0.5", "controller.velocity_filter value"),
    (SMALLEST + "velocity_filter = { numerator = [] }", "controller.velocity_filter.numerator value"),
    (
        SMALLEST + "velocity_filter = { numerator = [1], denominator = [0.0] }",
        "controller.velocity_filter contradiction",
    ),
    (SMALLEST + "velocity_filter = { frequency = 80.0, samples = 3 }", "controller.velocity_filter.kind contradiction"),
    (SMALLEST + 'velocity_filter = { kind = "lowpass" }', "controller.velocity_filter.kind value"),
    (SMALLEST + "velocity_filter = {}", "controller.velocity_filter.kind contradiction"),
    (
        SMALLEST + 'torque_filters = [[0.5, 0.5], { kind = "notch", frequency = 80 }]',
        "controller.torque_filters.1.bandwidth contradiction",
    ),
    (
        SMALLEST + 'torque_filters = [{ kind = "first_order", time_constant = 0.001, frequency = 80 }]',
        "controller.torque_filters.0.frequency contradiction",
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
    (SMALLEST + "period = 1e-9\nreference_delay = 1.0", "controller contradiction"),
    (SMALLEST + 'anti_windup = "clamp"', "controller.anti_windup value"),
    (
        SMALLEST.replace("velocity_gain = 2000.0", "derivative_gain = 3.0").replace("cascade", "pid"),
        "controller.integral_gain missing",
    ),
    (
        SMALLEST + 'velocity_filter = [0.5, 0.5]\n[method]\nfree = ["position_gain", "velocity_filter.time_constant"]',
        "method.free refused",
    ),
    (SMALLEST + '[together]\nfree = ["integral_gain"]', "together.free refused"),
    (SMALLEST.replace('"i"', '"i", gain = -3.0'), "record.channels.torque.gain value"),
    (SMALLEST.replace('"i"', '"i", sign = true'), "record.channels.torque.sign value"),
    (SMALLEST.replace('"i"', '"i", sign = -2'), "record.channels.torque.sign value"),
    (SMALLEST.replace('"i"', '"i", optional = "true"'), "record.channels.torque.optional value"),
    (SMALLEST.replace('"i"', "3"), "record.channels.torque.column value"),
    (SMALLEST.replace('"i"', '"i", at = "after_limit"'), "record.channels.torque.at unknown"),
    (SMALLEST.replace('{ column = "i" }', '"i"'), "record.channels.torque table"),
    (SMALLEST + "[[method]]", "method table"),
    ("[record]\ndelimiter = 'ab'\n" + SMALLEST, "record.delimiter refused"),
    ("[record]\nfile = 'run.xyz'\n" + SMALLEST, "record.file refused"),
    ("[record]\nfile = 'run.mat'\ndecimal = ','\n" + SMALLEST, "record.file contradiction"),
    (SMALLEST + "[filtering]\nborders = [1, 2, 3]", "filtering.borders value"),
    (SMALLEST + "[filtering]\ndecimation = 2.5", "filtering.decimation value"),
    (SMALLEST + "[method]\niterations = 0xffffffffffffffff", "method.iterations value"),
    (
        SMALLEST.replace(
            "[controller]", 'injected = { column = "x", at = "before_limit", in_torque = false }\n[controller]'
        ),
        "record.channels.injected.in_torque contradiction",
    ),
    (SMALLEST + '[filtering]\npreset = "published"\ncutoff = 3.0', "filtering.cutoff contradiction"),
    (
        JOINT + CHANNELS + '[controller]\nlaw = "state_space"\nA = [[1.0, 2.0], [1.0]]\nB = {}\nC = [1.0, 2.0]\nD = {}',
        "controller.A contradiction",
    ),
    (
        JOINT
        + CHANNELS
        + '[controller]\nlaw = "state_space"\nA = [[1.0]]\nB = { position = [1.0, 2.0] }\nC = [1.0]\nD = {}',
        "controller contradiction",
    ),
    (SMALLEST + '[filtering]\npreset = "published"\ncutoff = 40.0', "filtering.cutoff contradiction"),
    (SMALLEST.replace('"r"', '"r", unit = "deg"'), "record.channels.reference.unit unit"),
    (SMALLEST.replace('"r"', '"r", unit = "N"'), "record.channels.reference.unit unit"),
    (SMALLEST.replace('"r"', '"r", unit = "clicks"'), "record.channels.reference.unit unit"),
    (SMALLEST.replace('"r"', '"r", unit = "milli"'), "record.channels.reference.unit unit"),
    (SMALLEST.replace('"r"', '"r [clicks]"'), "record.channels.reference.column unit"),
    (
        SMALLEST.replace("[controller]", 'injected = { column = "x", unit = "V" }\n[controller]'),
        "record.channels.injected unit",
    ),
    (SMALLEST + '[drive]\nprofile = "abc"', "drive.profile refused"),
    (
        SMALLEST.replace(JOINT, JOINT + "torque_constant = 0.7\n") + "[drive]\nrated_torque = 1\nrated_current = 2",
        "drive contradiction",
    ),
    (SMALLEST.replace('"i"', '"i", unit = "permille"'), "record.channels.torque unit"),
    (
        SMALLEST.replace('"r"', '"r", unit = "counts"') + "[drive]\ncounts_per_turn = 4096",
        "record.channels.reference unit",
    ),
    (SMALLEST.replace('{ column = "i" }', "{ gain = 2.0 }"), "record.channels.torque.column missing"),
    (SMALLEST.replace('"i"', '"i", wrap = 360'), "record.channels.torque contradiction"),
    (JOINT + '[record.channels]\ntorque = { column = "i" }', "method.name missing"),
    (JOINT + CHANNELS + '[method]\nname = "didim"', "controller missing"),
    (
        JOINT + CHANNELS.replace("motor_", "load_") + CASCADE + '[method]\nname = "idim"',
        "record.channels.motor_position missing",
    ),
    (
        JOINT
        + CHANNELS
        + '[controller]\nlaw = "pd"\nposition_gain = 1.0\nderivative_gain = 1.0\nreference_velocity = "channel"',
        "record.channels.reference_velocity missing",
    ),
    (SMALLEST + "[method]\nfrequency = 30.0", "method.frequency contradiction"),
    (JOINT + CHANNELS + '[method]\nname = "idim"\nestimator = "iv"', "controller missing"),
    (SMALLEST + '[method]\nname = "didim"\ndrift = "force"', "method.drift contradiction"),
    (JOINT + CHANNELS + "[method]\nperiod = 0.005", "method.period contradiction"),
    (JOINT + 'model = "flexible"\n' + CHANNELS, "method.name missing"),
    (JOINT + 'model = "flexible"\n' + CHANNELS.replace("motor_", "load_"), "method.name missing"),
    (FLEXIBLE + '[method]\nname = "idim"', "record.channels.load_position missing"),
    (JOINT + 'model = "flexible"\n' + CHANNELS + '[method]\nname = "didim"', "controller missing"),
    (SMALLEST + "[parameters]\ninertai = 3", "parameters.inertai unknown"),
    (SMALLEST + "[parameters]\nstiffness = 3", "parameters.stiffness unknown"),
    (SMALLEST + "[parameters]\nviscous_forwards = 3", "parameters.viscous_forwards unknown"),
    (SMALLEST + '[gravity]\nload = "link"\n[parameters]\ngravity_cos = 3', "gravity refused"),
    (SMALLEST.replace(JOINT, JOINT + 'friction = "asymmetric"\n') + '[gravity]\nload = "constant"', "gravity refused"),
    (
        SMALLEST + '[gravity]\nload = "constant"\n[parameters]\noffset = { start = 3 }',
        "parameters.offset contradiction",
    ),
    (SMALLEST + "[ripple]\nharmonics = 2", "ripple.period missing"),
    (SMALLEST + '[ripple]\nperiod = 0.005\nside = "load"', "ripple refused"),
    (SMALLEST.replace(JOINT, JOINT + 'friction = "stribeck"\n') + "[ripple]\nperiod = 0.005", "ripple refused"),
    (
        SMALLEST.replace(JOINT, JOINT + 'model = "flexible"\nspring = "backlash"\n') + "[ripple]\nperiod = 0.005",
        "ripple refused",
    ),
    (SMALLEST + "[parameters]\nharmonic_1_sine = { start = 3 }", "parameters.harmonic_1_sine unknown"),
    (SMALLEST + "[parameters]\ngravity_cos = { start = 3 }", "parameters.gravity_cos unknown"),
    (
        LINK + "counterbalance = { cos = 2 }\n[parameters]\ncounterbalance_cos = { start = 3 }",
        "parameters.counterbalance_cos contradiction",
    ),
    (SMALLEST + "[parameters]\ninertia = -3", "parameters.inertia contradiction"),
    (SMALLEST + '[parameters]\ninertia = "3"', "parameters.inertia value"),
    (SMALLEST + "[parameters]\ninertia = { start = 3, lower = 4 }", "parameters.inertia.start contradiction"),
    (SMALLEST + "[parameters]\noffset = { start = 9, lower = 4, upper = 5 }", "parameters.offset.start contradiction"),
    (SMALLEST + "[parameters]\noffset = { start = 9, upper = 5 }", "parameters.offset.start contradiction"),
    (SMALLEST + "[parameters]\nviscous = { upper = -5 }", "parameters.viscous.upper contradiction"),
    (SMALLEST + "[parameters]\ninertia = { upper = 0 }", "parameters.inertia.upper contradiction"),
    (SMALLEST + "[parameters]\ninertia = { lower = inf }", "parameters.inertia.lower contradiction"),
    (SMALLEST + "[parameters]\noffset = { lower = nan }", "parameters.offset.lower value"),
    (SMALLEST + "[parameters]\noffset = { lower = 3, upper = 1 }", "parameters.offset.lower contradiction"),
    (SMALLEST + "[parameters]\noffset = { free = false }", "parameters.offset.value contradiction"),
    (SMALLEST + "[parameters]\noffset = { value = 3, free = true }", "parameters.offset.free contradiction"),
    (SMALLEST + "[parameters]\noffset = { value = 3, start = 3 }", "parameters.offset.start contradiction"),
    (
        SMALLEST.replace('"prismatic"', '"prismatic"\nfriction = "asymmetric"')
        + "[parameters]\noffset = { free = true }",
        "parameters.offset contradiction",
    ),
    ("[joint]\nkind = prismatic", ""),
    ('[joint]\nkind = "prismatic', ""),
    ("x = " + "9" * 5000, ""),
    ("x = " + "[" * 20000, ""),
]


@pytest.mark.parametrize(("text", "said"), FAULTS)
def test_a_fault_has_its_place_and_code(text: str, said: str) -> None:
    (fault,) = faults(text)
    assert told(text) == [said]
    assert fault.startswith(dot_path(fault.place)) and fault.endswith((".", "?"))


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [
        (
            SMALLEST + "INTEGRAL_GAIN = 'x'",
            "controller.INTEGRAL_GAIN is not a known key; .* did you mean integral_gain",
        ),
        (SMALLEST + "[Method]", "Method is not a known key; .* did you mean method"),
        (SMALLEST + "[drive]\nratedTorque = 3.0", "drive.ratedTorque is not a known key; .* did you mean rated_torque"),
        (SMALLEST + "torque_filters = [{ D = 1.0, numerator = [1.0] }]", "0.D is not a known key; .*: leave it out."),
        (SMALLEST.replace('"cascade"', '"PID"'), 'law is "PID"; .* did you mean "pid"'),
    ],
)
def test_the_case_of_a_word_does_not_hide_which_was_meant(wrong: str, meant: str) -> None:
    (said,) = faults(wrong)
    assert re.search(meant, said)


def test_all_faults_of_the_tables_come_at_once_before_those_between_them() -> None:
    found = faults(
        """
        [joint]
        kind = "prismatic"
        friktion = "symmetric"
        [record]
        delimiter = "ab"
        sample_time = -1
        [record.channels]
        torque = { column = "i", gain = -2.0 }
        reference = { column = "r", unit = "deg" }
        motor_position = 3
        [controller]
        position_gain = "a"
        [filtering]
        preset = "published"
        borders = [1, 2]
        [method]
        name = "idim"
        iterations = 5
        [parameters]
        inertia = { lower = 2, upper = 1 }
        viscous = "a"
        """
    )
    expected = [
        "joint.friktion",
        "record.delimiter:",
        "record.sample_time",
        "record.channels.torque.gain",
        "record.channels.motor_position is",
        "controller.law",
        "filtering.borders",
        "parameters.inertia.lower",
        "parameters.viscous",
    ]
    assert len(found) == len(expected)
    for key in expected:
        assert sum(sentence.startswith(key) for sentence in found) == 1, key


def test_a_file_that_is_not_there_or_no_text(tmp_path: Path) -> None:
    (tmp_path / "joint.toml").write_bytes(b"name = '\xff'")
    for name in ("none.toml", "joint.toml"):
        with pytest.raises(JointFileError):
            load(tmp_path / name)
    (tmp_path / "marked.toml").write_text(SMALLEST, encoding="utf-8-sig")
    assert load(tmp_path / "marked.toml") == loads(SMALLEST)
