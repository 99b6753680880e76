"""The joint file: what it becomes, how its faults are told, and that its page says the same."""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jointid.common.errors import JointFileError, MethodError, RecordError
from jointid.common.units import units_of
from jointid.config import (
    JointFile,
    Run,
    Source,
    controller_text,
    dumps,
    json_schema,
    load,
    loads,
    save,
    with_controller,
    with_paths,
)
from jointid.config.schema import DIDIMS, FILTERINGS
from jointid.estimation.identify import identify
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.drive_side import DriveSideFit
from jointid.estimation.methods.flexible import FlexibleDIDIM, stopping_tolerance
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.open_loop import OpenLoopFit
from jointid.models.controllers import (
    PD,
    PID,
    POSITION,
    REFERENCE,
    REFERENCE_VELOCITY,
    Cascade,
    Controller,
    DigitalFilter,
    FirstOrder,
    MovingAverage,
    Notch,
    SecondOrder,
    StateSpaceController,
)
from jointid.models.disturbances import Drift, PositionHarmonics
from jointid.models.friction import AsymmetricFriction, SymmetricFriction
from jointid.models.gravity import GRAVITY_PARAMETERS, Counterbalance, Gravity
from jointid.models.joints import FlexibleJoint, Joint, RigidJoint
from jointid.models.parameters import Parameter
from jointid.models.transmission import SIDES, Transmission
from jointid.records.columns import Column, known_units
from jointid.records.drives.drive import Drive
from jointid.records.drives.profiles import profile_names
from jointid.records.record import InjectionPoint, Tap, Timing
from jointid.records.signals import Filtering
from jointid.records.time_base.resampling import Resampling
from tests.joint_files import faults

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "examples" / "emps" / "joint.toml"
PAGE = ROOT / "docs" / "joint-file.md"

JOINT = '[joint]\nkind = "prismatic"\n'
CHANNELS = """
[record.channels]
torque = { column = "i" }
reference = { column = "r" }
motor_position = { column = "q" }
"""
CASCADE = '[controller]\nlaw = "cascade"\nkp = 100.0\nkv = 2000.0\n'
SMALLEST = JOINT + CHANNELS + CASCADE
FLEXIBLE = SMALLEST.replace(JOINT, JOINT + 'model = "flexible"\n')


def table(name: str) -> dict[str, Any]:
    """Return the keys of a table in the schema; one with a shorthand is an alternative."""
    described = json_schema()["$defs"][name]
    return dict(described.get("anyOf", [described])[-1]["properties"])


# What a file becomes


def test_every_default() -> None:
    assert loads(SMALLEST) == JointFile(
        joint=RigidJoint("prismatic", SymmetricFriction()),
        columns={"torque": Column("i"), "reference": Column("r"), "motor_position": Column("q")},
        method=DIDIM(),
        controller=Cascade(kp=100.0, kv=2000.0),
        filtering=Filtering(),
        parameters={},
        source=Source(),
        name=None,
    )
    assert loads(SMALLEST).path == Path("joint.toml")


def test_every_key_that_is_written_at_its_default_changes_nothing() -> None:
    file = loads(
        JOINT
        + """model = "rigid"
        friction = "symmetric"
        [record]
        clock_tolerance = 0.05
        [record.channels]
        torque = { column = "i", gain = 1.0, sign = 1, optional = false }
        reference = { column = "r" }
        motor_position = { column = "q" }
        [controller]
        law = "cascade"
        kp = 100
        kv = 2000
        gain = 1
        delay = 0
        limit = inf
        velocity_filter = [1]
        [filtering]
        borders = [50, 50]
        timing = "respected"
        aliasing = "refused"
        [method]
        name = "didim"
        form = "residual"
        start = "inversion"
        scaled_iterations = 2
        tolerance = 1e-7
        step_tolerance = 1e-7
        iterations = 30
        initial_state = "free"
        free = []
        """
    )
    assert file == loads(SMALLEST)
    flexible = """[method]
        name = "didim"

        minimiser = "least-squares"
        simulations = 6000
        restarts = 3
        statistics = "sensitivities"
        """
    assert loads(FLEXIBLE + flexible) == loads(FLEXIBLE)


def test_the_schema_has_the_objects_own_defaults() -> None:
    """The defaults in the schema are for its readers: the objects never see them, so they could go wrong unnoticed."""
    homes = {
        "ChannelTable": Column,
        "DriveTable": Drive,
        "TorqueTable": Column,
        "InjectedTable": Column,
        "CascadeTable": Cascade,
        "PDTable": PD,
        "PIDTable": PID,
        "StateSpaceTable": StateSpaceController,
        "FilteringTable": Filtering,
        "RecordTable": Source,
        "RunTable": Run,
        "GravityTable": Gravity,
        "CounterbalanceTable": Counterbalance,
    }
    # A key of both methods has two defaults, and so none in the schema.
    for name, home in (*homes.items(), ("MethodTable", DIDIM), ("MethodTable", FlexibleDIDIM)):
        own = {field.name: field.default for field in dataclasses.fields(home)}
        for key, described in table(name).items():
            if "default" in described and (key in own or name in homes):
                if key == "side":  # of a law it is said by its ratio
                    continue
                default = own[key]
                assert described["default"] == (list(default) if isinstance(default, tuple) else default), (name, key)


def test_every_word_of_the_objects_is_a_word_of_the_file() -> None:
    """Words of enumerations stand in the schema a second time."""
    assert table("ChannelTable")["timing"]["enum"] == [str(word) for word in Timing]
    assert table("TorqueTable")["tap"]["enum"] == [str(word) for word in Tap]
    assert table("InjectedTable")["at"]["enum"] == [str(word) for word in InjectionPoint]
    assert table("FilteringTable")["preset"]["enum"] == list(FILTERINGS)
    assert table("JointTable")["model"]["enum"] == list(DIDIMS)
    assert table("GravityTable")["load"]["enum"] == list(GRAVITY_PARAMETERS)
    assert table("MethodTable")["drift"]["enum"] == list(get_args(get_type_hints(Drift)["of"]))


def test_all_of_a_file() -> None:
    file = loads(
        """
        [joint]
        kind = "revolute"
        model = "flexible"
        friction = "asymmetric"
        name = "axis 3"
        [record]
        file = "runs/run1.csv"
        time = "stamp"
        time_unit = "ms"
        sample_time = 0.001
        clock_tolerance = 0.1
        resample = { sample_time = 0.001, method = "cubic", longest_gap = 0 }
        delimiter = ";"
        decimal = ","
        header = true
        [record.channels]
        torque = { column = "i", unit = "mA", gain = 0.5, sign = -1, timing = "averaged", tap = "measured" }
        reference = { column = "r [deg]" }
        reference_velocity = { column = "dr", unit = "rpm", timing = "held" }
        load_position = { column = "p", optional = true, sample_time = 0.002 }
        injected = { column = "x", unit = "A", at = "after_limit", in_torque = false }
        [controller]
        law = "pd"
        kp = 3.0
        kd = 0.1
        reference_velocity = "channel"
        velocity_filter = { numerator = [0.2], denominator = [1.0, -0.8] }
        gain = 2.0
        limit = 5.0
        period = 0.002
        delay = 0.0005
        [filtering]
        position_cutoff = 100.0
        cutoff = 20.0
        decimation = 5
        borders = [10, 0]
        timing = "as_sampled"
        aliasing = "warned"
        [method]
        name = "didim"
        minimiser = "nelder-mead"
        frequency = 25.0
        rigid_cutoff = 4.0
        tolerance = 1e-3
        simulations = 500
        restarts = 0
        statistics = "inverse-model"
        free = ["kp", "delay"]
        [parameters]
        stiffness = { start = 8e5, lower = 1e3, upper = 1e7 }
        damping = 126
        motor_inertia = { value = 0.1, upper = 1.0 }
        load_inertia = { free = true }
        """,
        folder="here",
    )
    joint = FlexibleJoint("revolute", AsymmetricFriction(), "A")
    known = {parameter.name: parameter for parameter in joint.parameters}
    assert file == JointFile(
        joint=joint,
        columns={
            "torque": Column("i", "mA", 0.5, -1, Timing.AVERAGED, tap=Tap.MEASURED),
            "reference": Column("r [deg]"),
            "reference_velocity": Column("dr", "rpm", timing=Timing.HELD),
            "load_position": Column("p", optional=True, sample_time=0.002),
            "injected": Column("x", "A", in_torque=False),
        },
        method=FlexibleDIDIM("nelder-mead", 25.0, 4.0, 1e-3, 500, 0, "inverse-model", ("kp", "delay")),
        controller=PD(
            kp=3.0,
            kd=0.1,
            reference_velocity="channel",
            velocity_filter=DigitalFilter((0.2,), (1.0, -0.8)),
            gain=2.0,
            limit=5.0,
            period=0.002,
            delay=0.0005,
        ),
        filtering=Filtering(100.0, 20.0, 5, (10, 0), "as_sampled", "warned"),
        parameters={
            "stiffness": dataclasses.replace(known["stiffness"], start=8e5, lower=1e3, upper=1e7),
            "damping": known["damping"].fixed(126.0),
            "motor_inertia": dataclasses.replace(known["motor_inertia"].fixed(0.1), upper=1.0),
            "load_inertia": known["load_inertia"],
        },
        source=Source(
            "runs/run1.csv",
            "stamp",
            "ms",
            0.001,
            0.1,
            {"delimiter": ";", "decimal": ",", "header": True},
            Resampling(1e-3, "cubic", longest_gap=0),
        ),
        name="axis 3",
    )
    assert file.path == Path("here/joint.toml")
    assert file.loop is not None
    assert file.loop.joint is file.joint
    assert file.loop.controller is file.controller


def test_all_settings_of_a_rigid_joint() -> None:
    text = """[method]
        form = "paper"
        start = "given"
        scaled_iterations = 0
        tolerance = 1e-3
        step_tolerance = 1e-2
        iterations = 7
        initial_state = "reference"
        """
    assert loads(SMALLEST + text).method == DIDIM("paper", "given", 0, 1e-3, 1e-2, 7, "reference")


LINK = SMALLEST.replace("prismatic", "revolute") + '[gravity]\nload = "link"\n'


def test_gravity() -> None:
    file = loads(
        LINK + "angle = 0.01\ncounterbalance = { cos = 0.2, rate = 1e-3 }\n[parameters]\ngravity_sin = { start = 0.5 }"
    )
    assert file.joint == RigidJoint("revolute", gravity=Gravity("link", Counterbalance(cos=0.2, rate=1e-3), 0.01))
    assert file.parameters["gravity_sin"].start == 0.5
    loaded = loads(FLEXIBLE + '[gravity]\nload = "constant"').joint
    assert loaded == FlexibleJoint(gravity=Gravity("constant"))
    assert [p.name for p in loaded.parameters[-2:]] == ["offset", "gravity_constant"]
    assert [p.free for p in loaded.parameters[-2:]] == [False, True]


def test_a_state_space_law() -> None:
    text = """[controller]
    law = "state_space"
    A = [[0.5]]
    C = [1.0]
    B = { position = [1.0], excess = [0.1] }
    D = { reference = 3.0, position = -3.0 }
    limit = 2.0
    """
    law = loads(JOINT + CHANNELS + text).controller
    assert isinstance(law, StateSpaceController)
    lowered = law.law(1e-3)
    columns = [REFERENCE, REFERENCE_VELOCITY, POSITION]
    np.testing.assert_array_equal(lowered.B[0, :, columns], [[0.0], [0.0], [1.0]])
    np.testing.assert_array_equal(lowered.D[0, 0, columns], [3.0, 0.0, -3.0])
    np.testing.assert_array_equal(lowered.F, [[[0.1]]])
    assert lowered.limit == 2.0
    static = 'law = "state_space"\nA = []\nB = {}\nC = []\nD = { reference = 1.0, position = -1.0 }\n'
    assert loads(JOINT + CHANNELS + "[controller]\n" + static).controller is not None


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (CHANNELS + CASCADE, DIDIM()),  # even though there is a motor position
        (CHANNELS, IDIM()),
        (CHANNELS.replace("reference", "load_position") + CASCADE, IDIM()),
        (CHANNELS + CASCADE + '[method]\nname = "idim"', IDIM()),
        (CHANNELS + CASCADE + '[method]\nname = "idim"\nestimator = "iv"', IDIM("iv")),
        (
            CHANNELS + '[method]\nharmonics = 2\ndrift = "both"',
            IDIM("ols", (PositionHarmonics(None, 2), Drift("both"))),
        ),
        (CHANNELS + "[method]\nharmonics = 1\nperiod = 0.005", IDIM("ols", (PositionHarmonics(0.005),))),
        (CHANNELS + CASCADE + '[method]\npreset = "paper"', DIDIM.paper()),
        (CHANNELS + CASCADE + "[method]\niterations = 3", DIDIM(iterations=3)),
    ],
)
def test_the_method(text: str, expected: object) -> None:
    assert loads(JOINT + text).method == expected


BOTH_ENCODERS = CHANNELS + 'load_position = { column = "p" }\n'


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (CHANNELS + CASCADE, FlexibleDIDIM()),
        (BOTH_ENCODERS + CASCADE, FlexibleDIDIM()),  # even though there are both positions
        (BOTH_ENCODERS, IDIM()),
        (BOTH_ENCODERS.replace("reference", "injected") + CASCADE, IDIM()),
        (BOTH_ENCODERS + CASCADE + '[method]\nname = "idim"', IDIM()),
        (CHANNELS + CASCADE + '[method]\nname = "didim"', FlexibleDIDIM()),
        (CHANNELS + CASCADE + "[method]\ntolerance = 1e-3", FlexibleDIDIM(tolerance=1e-3)),
        (CHANNELS + CASCADE + '[method]\nname = "didim"\npreset = "paper"', FlexibleDIDIM.paper()),
        (CHANNELS + CASCADE + '[method]\npreset = "paper"\nfrequency = 42.0', FlexibleDIDIM.paper(42.0)),
        (CHANNELS + CASCADE + '[method]\nminimiser = "nelder-mead"', FlexibleDIDIM("nelder-mead")),
    ],
)
def test_the_method_of_a_flexible_joint(text: str, expected: object) -> None:
    file = loads(JOINT + 'model = "flexible"\n' + text)
    assert file.method == expected
    assert loads(dumps(file)) == file


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('preset = "default"', Filtering()),
        ('preset = "published"', Filtering.published()),
        ('preset = "as-printed"', Filtering.as_printed()),
        ('cutoff = 60.0\ndecimation = 12\naliasing = "warned"', Filtering.as_printed()),
        ('aliasing = "warned"', Filtering(aliasing="warned")),
    ],
)
def test_the_filtering(text: str, expected: Filtering) -> None:
    file = loads(f"{SMALLEST}[filtering]\n{text}")
    assert file.filtering == expected
    assert loads(dumps(file)) == file


@pytest.mark.parametrize("unit", ["A", "mA", "V"])
def test_a_torque_in_drive_units_gives_parameters_in_them(unit: str) -> None:
    text = '[joint]\nkind = "revolute"\nmodel = "flexible"\n[record.channels]\nmotor_position = { column = "q" }\n'
    text += 'load_position = { column = "q2" }\n'
    file = loads(text + f'torque = {{ column = "i", unit = "{unit}" }}\ninjected = {{ column = "x" }}')
    units = {parameter.name: file.joint.unit(parameter) for parameter in file.joint.parameters}
    si = unit[-1]
    assert units["stiffness"] == f"{si}/rad"
    assert units["motor_inertia"] == f"{si} s2/rad"
    assert units["offset"] == si
    named = loads(text + f'torque = {{ column = "i [{unit}]" }}')
    assert named.joint == file.joint


def test_a_torque_in_newtons_has_no_unit_of_its_own() -> None:
    assert loads(SMALLEST.replace('"i"', '"i", unit = "kN"')).joint.torque_unit is None


def test_values_are_those_fixed_and_those_started_from() -> None:
    file = loads(
        SMALLEST + "[parameters]\ninertia = { start = 90.0 }\nviscous = 200\ncoulomb = 20\noffset = { start = 1 }"
    )
    assert file.values() == {"inertia": 90.0, "viscous": 200.0, "coulomb": 20.0, "offset": 1.0}
    with pytest.raises(MethodError, match=r"every parameter; inertia, viscous, coulomb, offset has none"):
        loads(SMALLEST).values()


# Faults: the key, what was received, what was expected, the remedy


FAULTS = [
    # keys
    (
        SMALLEST + "kpp = 3",
        "controller.kpp is not a known key; expected one of law, side, gain, limit, period, delay, interpolation, "
        "reference_delay, velocity_filter, torque_filters, filters_at, acceleration_feedforward, viscous_feedforward, "
        "coulomb_feedforward, constant_feedforward, torque_feedforward_delay, kp, kv, ki, anti_windup, "
        "velocity_feedforward, velocity_feedforward_delay, reference_velocity, velocity_limit, position_period, "
        "position_offset: did you mean kp?",
    ),
    (
        SMALLEST.replace("kv = 2000.0", "kd = 3.0\nki = 1.0").replace("cascade", "pd"),
        "controller.ki is not a known key; expected one of law, side, gain, limit, period, delay, interpolation, "
        "reference_delay, velocity_filter, torque_filters, filters_at, acceleration_feedforward, viscous_feedforward, "
        "coulomb_feedforward, constant_feedforward, torque_feedforward_delay, kp, kd, reference_velocity: leave it "
        "out.",
    ),
    (
        SMALLEST + "[methods]",
        "methods is not a known key; expected one of joint, transmission, gravity, record, drive, controller, "
        "filtering, method, parameters, records, together: did you mean method?",
    ),
    (
        SMALLEST.replace("motor_position", "motor_positon"),
        "record.channels.motor_positon is not a known key; expected one of torque, reference, reference_velocity,"
        " motor_position, load_position, injected: did you mean motor_position?",
    ),
    (
        SMALLEST + '["a.b"]',
        '"a.b" is not a known key; expected one of joint, transmission, gravity, record, drive, controller, '
        "filtering, method, parameters, records, together: leave it out.",
    ),
    (
        SMALLEST.replace("kp = 100.0\n", ""),
        "controller.kp is missing; expected a number, 0 or more (position gain [1/s]): add it.",
    ),
    (
        SMALLEST.replace(JOINT, "[joint]\n"),
        'joint.kind is missing; expected "prismatic" or "revolute" (how the joint moves: m and N, or rad and N '
        "m): add it.",
    ),
    (
        CHANNELS + CASCADE,
        "joint is missing; expected a table (what is identified): add it.",
    ),
    # words
    (
        SMALLEST.replace('"prismatic"', '"linear"'),
        'joint.kind is "linear"; expected "prismatic" or "revolute": choose one of them.',
    ),
    (
        SMALLEST.replace('"cascade"', '"cascad"'),
        'controller.law is "cascad"; expected "cascade", "pd", "pid" or "state_space": did you mean "cascade"?',
    ),
    (
        SMALLEST.replace('law = "cascade"\n', ""),
        'controller.law is missing; expected "cascade", "pd", "pid" or "state_space" (the controller\'s law): add it.',
    ),
    (
        SMALLEST.replace('"cascade"', "[1]"),
        'controller.law is [1]; expected "cascade", "pd", "pid" or "state_space": choose one of them.',
    ),
    (
        SMALLEST.replace('"prismatic"', '"prismatic"\nfriction = "stribeck"'),
        'joint.friction: Friction "stribeck" cannot be simulated exactly: only laws that are piecewise linear in '
        "velocity can; use symmetric or asymmetric.",
    ),
    # values
    (
        SMALLEST.replace("kp = 100.0", 'kp = "160.18"'),
        'controller.kp is "160.18"; expected a number, 0 or more: write it without quotes.',
    ),
    (
        SMALLEST.replace("kp = 100.0", "kp = -3"),
        "controller.kp is -3; expected a number, 0 or more: turn the torque or the positions round, with sign = "
        "-1 on their channels.",
    ),
    (
        SMALLEST.replace("kp = 100.0", "kp = nan"),
        "controller.kp is nan; expected a number, 0 or more: correct it.",
    ),
    (
        SMALLEST + "gain = -1.5",
        "controller.gain is -1.5; expected a positive number: turn the torque round, with sign = -1 on its channel.",
    ),
    (
        SMALLEST + "limit = 0",
        "controller.limit is 0; expected a positive number: correct it, or leave it out.",
    ),
    (
        SMALLEST + "period = inf",
        "controller.period is inf; expected a positive number: correct it, or leave it out.",
    ),
    (
        SMALLEST + "velocity_filter = 0.5",
        "controller.velocity_filter is 0.5; expected a list of one or more numbers, or a table: correct it.",
    ),
    (
        SMALLEST + 'velocity_filter = [0.5, "a"]',
        'controller.velocity_filter is [0.5, "a"]; expected a list of one or more numbers, or a table: correct it.',
    ),
    (
        SMALLEST + "velocity_filter = { numerator = [] }",
        "controller.velocity_filter.numerator is []; expected a list of one or more numbers: correct it, or leave it "
        "out.",
    ),
    (
        SMALLEST + "velocity_filter = { numerator = [1], denominator = [0.0] }",
        "controller.velocity_filter.denominator: A digital filter needs a numerator, and a denominator that does "
        "not start with 0, of finite numbers; received (1.0,) / (0.0,).",
    ),
    (
        SMALLEST + "velocity_filter = { frequency = 80.0 }",
        'controller.velocity_filter.kind is missing; expected "digital", "moving_average", "first_order", '
        '"second_order" or "notch" (which filter): add it.',
    ),
    (
        SMALLEST + 'velocity_filter = { kind = "lowpass" }',
        'controller.velocity_filter.kind is "lowpass"; expected "digital", "moving_average", "first_order", '
        '"second_order" or "notch": choose one of them.',
    ),
    (
        SMALLEST + "velocity_filter = {}",
        "controller.velocity_filter.numerator is missing; expected a list of one or more numbers (of digital: b0, b1, "
        "... in powers of 1/z): add it.",
    ),
    (
        SMALLEST + 'torque_filters = [[0.5, 0.5], { kind = "notch", frequency = 80 }]',
        "controller.torque_filters.1.bandwidth is missing; expected a positive number (of notch: width, between "
        "the points where a notch of depth 0 passes 71 % [Hz]): add it.",
    ),
    (
        SMALLEST + 'torque_filters = [{ kind = "first_order", time_constant = 0.001, frequency = 80 }]',
        'controller.torque_filters.0.frequency is not a key of the kind "first_order"; expected one of time_constant: '
        "leave it out, or change the kind.",
    ),
    (
        SMALLEST + 'torque_filters = [{ kind = "notch", frequency = -80, bandwidth = 20 }]',
        "controller.torque_filters.0.frequency is -80; expected a positive number: correct it, or leave it out.",
    ),
    (
        SMALLEST + 'torque_filters = { kind = "notch", frequency = 80, bandwidth = 20 }',
        "controller.torque_filters is a table; expected a list of filters, each a table or the list of a numerator: "
        "correct it, or leave it out.",
    ),
    (
        SMALLEST + 'period = 0.01\ntorque_filters = [{ kind = "notch", frequency = 80, bandwidth = 20 }]',
        "controller: A filter at 80 Hz does not exist at a period of 0.01 s, whose half sampling frequency is 50 Hz; "
        "lower it, or correct the period.",
    ),
    (
        SMALLEST + 'velocity_filter = { kind = "second_order", frequency = 80, numerator_damping = -1.5 }',
        "controller.velocity_filter.numerator_damping is -1.5; expected a number above -1: correct it, or leave it "
        "out.",
    ),
    (
        SMALLEST + "period = 0.001\nposition_period = 0.0025",
        "controller: The position loop's period is a multiple of the controller's, up to 64 times; received 0.0025 s "
        "beside 0.001 s: correct one of them.",
    ),
    (
        SMALLEST + "period = 1e-9\nreference_delay = 1.0",
        "controller: A delay of the reference is one of 400 periods at most; received 1 s beside a period of 1e-09 s: "
        "correct one of them.",
    ),
    (
        SMALLEST + "velocity_limit = 0",
        "controller.velocity_limit is 0; expected a positive number: correct it, or leave it out.",
    ),
    (
        SMALLEST + 'anti_windup = "clamp"',
        'controller.anti_windup is "clamp"; expected "hold", "track" or "none": choose one of them.',
    ),
    (
        SMALLEST + 'interpolation = "zoh"',
        'controller.interpolation is "zoh"; expected "hold", "linear" or "cubic": choose one of them.',
    ),
    (
        SMALLEST.replace("kv = 2000.0", "kd = 3.0").replace("cascade", "pid"),
        "controller.ki is missing; expected a number, 0 or more (integral gain [controller units per m s or rad s]): "
        "add it.",
    ),
    (
        SMALLEST + 'velocity_filter = [0.5, 0.5]\n[method]\nfree = ["kp", "velocity_filter.time_constant"]',
        'method.free: Nothing around this joint is called "velocity_filter.time_constant"; what can be freed is '
        "initial_position, initial_velocity, drive_gain, log_gain, log_delay, gain, limit, delay, reference_delay, "
        "acceleration_feedforward, viscous_feedforward, coulomb_feedforward, constant_feedforward, "
        "torque_feedforward_delay, kp, kv, ki, velocity_feedforward, velocity_feedforward_delay, velocity_limit.",
    ),
    (
        SMALLEST + '[together]\nfree = ["ki"]',
        "together.free: The ki of this controller is 0, so it has no such part; declare a start above 0.",
    ),
    (
        SMALLEST.replace('"i"', '"i", gain = -3.0'),
        "record.channels.torque.gain is -3.0; expected a positive number: use sign = -1 to turn the channel round.",
    ),
    (
        SMALLEST.replace('"i"', '"i", gain = 0'),
        "record.channels.torque.gain is 0; expected a positive number: correct it, or leave it out.",
    ),
    (
        SMALLEST.replace('"i"', '"i", sign = true'),
        "record.channels.torque.sign is true; expected 1 or -1: correct it, or leave it out.",
    ),
    (
        SMALLEST.replace('"i"', '"i", sign = -2'),
        "record.channels.torque.sign is -2; expected 1 or -1: use gain to scale.",
    ),
    (
        SMALLEST.replace('"i"', '"i", optional = "true"'),
        'record.channels.torque.optional is "true"; expected true or false: write it without quotes.',
    ),
    (
        SMALLEST.replace('"i"', "3"),
        "record.channels.torque.column is 3; expected text in quotes: correct it, or leave it out.",
    ),
    (
        SMALLEST.replace('"i"', '"i", at = "after_limit"'),
        "record.channels.torque.at is not a known key; expected one of column, unit, gain, sign, timing, "
        "sample_time, time, side, wrap, update_time, optional, tap: leave it out.",
    ),
    (
        SMALLEST.replace('{ column = "i" }', '"i"'),
        'record.channels.torque is "i"; expected a table: put its keys below a [heading], or in braces.',
    ),
    (
        SMALLEST + "[[method]]",
        "method is a list of lists or tables; expected a table: put its keys below a [heading], or in braces.",
    ),
    (
        "[record]\ntime_unit = 'sec'\n" + SMALLEST,
        'record.time_unit is "sec"; expected a unit of time, one of s, ms, us, ns, min, h: correct it, or leave '
        "it out.",
    ),
    (
        "[record]\ndelimiter = 'ab'\n" + SMALLEST,
        "record.delimiter: The delimiter is one character, such as \";\"; got 'ab'.",
    ),
    (
        "[record]\nfile = 'run.xyz'\n" + SMALLEST,
        'record.file: run.xyz has the suffix ".xyz", which names no known format (CSV: .csv, .txt, .tsv, .dat; '
        "MAT: .mat; NPY: .npy; HDF5: .h5, .hdf5, .hdf; Parquet: .parquet, .pq; TDMS: .tdms; ROS 2 bag: .mcap, .db3).",
    ),
    (
        "[record]\nfile = 'run.mat'\ndecimal = ','\n" + SMALLEST,
        "record.file: Reading MAT has no option decimal; it has: version.",
    ),
    (
        SMALLEST + "[filtering]\nborders = [1, 2, 3]",
        "filtering.borders is [1, 2, 3]; expected a list of two whole numbers, 0 or more: correct it, or leave it out.",
    ),
    (
        SMALLEST + "[filtering]\ndecimation = 2.5",
        "filtering.decimation is 2.5; expected a whole number, 1 or more: correct it, or leave it out.",
    ),
    (
        SMALLEST + "[method]\niterations = 0xffffffffffffffff",
        "method.iterations is a whole number beyond 64 bits; expected a whole number, 1 or more: correct it, or "
        "leave it out.",
    ),
    # values together
    (
        SMALLEST.replace(
            "[controller]", 'injected = { column = "x", at = "before_limit", in_torque = false }\n[controller]'
        ),
        "record.channels.injected.in_torque: A signal injected before the limit is part of the controller's "
        "output, so the logged torque contains it; set in_torque = true, or at = after_limit.",
    ),
    (
        SMALLEST + '[filtering]\npreset = "published"\ncutoff = 3.0',
        'filtering.cutoff is 3.0 beside preset = "published", which sets it: leave one of them out.',
    ),
    (
        SMALLEST + '[method]\npreset = "paper"\nform = "residual"',
        'method.form is "residual" beside preset = "paper", which sets it: leave one of them out.',
    ),
    (
        JOINT + CHANNELS + '[controller]\nlaw = "state_space"\nA = [[1.0, 2.0], [1.0]]\nB = {}\nC = [1.0, 2.0]\nD = {}',
        "controller.A has rows of 2, 1 numbers; expected rows of one length: complete them.",
    ),
    (
        JOINT
        + CHANNELS
        + '[controller]\nlaw = "state_space"\nA = [[1.0]]\nB = { position = [1.0, 2.0] }\nC = [1.0]\nD = {}',
        "controller: A state-space law with 1 states (the length of C) needs A (1, 1) and each column of B (1,), "
        "for the inputs reference, reference_velocity, position, excess; received B.position (2,).",
    ),
    (
        SMALLEST + '[filtering]\npreset = "as-printed"\naliasing = "refused"',
        'filtering.aliasing is "refused" beside preset = "as-printed", which sets it: leave one of them out.',
    ),
    (
        SMALLEST + '[filtering]\naliasing = "refuse"',
        'filtering.aliasing is "refuse"; expected "refused" or "warned": did you mean "refused"?',
    ),
    (
        FLEXIBLE + '[method]\npreset = "paper"\nfrequency = 25.0\nrestarts = 2',
        'method.restarts is 2 beside preset = "paper", which sets it: leave one of them out.',
    ),
    # units
    (
        SMALLEST.replace('"r"', '"r", unit = "deg"'),
        'record.channels.reference.unit is "deg", a unit of angle; expected one of m, mm, cm, um, nm, inch, counts: '
        'give one of them, or set joint.kind = "revolute".',
    ),
    (
        SMALLEST.replace('"r"', '"r", unit = "N"'),
        'record.channels.reference.unit is "N", a unit of force; expected one of m, mm, cm, um, nm, inch, counts: give '
        "one of them.",
    ),
    (
        SMALLEST.replace('"r"', '"r", unit = "clicks"'),
        'record.channels.reference.unit is "clicks", which is not known; expected one of m, mm, cm, um, nm, inch, '
        "counts: give one of them, and the gain that takes the column to it.",
    ),
    (
        SMALLEST.replace('"r"', '"r", unit = "milli"'),
        'record.channels.reference.unit is "milli", which is not known; expected one of m, mm, cm, um, nm, inch, '
        "counts: give one of them, and the gain that takes the column to it.",
    ),
    (
        SMALLEST.replace('"r"', '"r [clicks]"'),
        'record.channels.reference.column names the unit "clicks", which is not known; expected one of m, mm, cm,'
        " um, nm, inch, counts: give one of them, and the gain that takes the column to it.",
    ),
    (
        SMALLEST.replace("[controller]", 'injected = { column = "x", unit = "V" }\n[controller]'),
        "record.channels.injected is in V, but the torque in N: give both in one unit.",
    ),
    # the drive
    (
        SMALLEST + '[drive]\nprofile = "abc"',
        'drive.profile: No drive profile is called "abc"; there are cia402, generic, kuka, sinamics, twincat, ur-rtde.',
    ),
    (
        SMALLEST + "[drive]\naxis = 0",
        "drive.axis is 0; expected a whole number, 1 or more: correct it, or leave it out.",
    ),
    (
        SMALLEST + "[drive]\nrated_torque = 1\nrated_current = 2\ntorque_constant = 0.7",
        "drive: The drive's rated_torque is 1, and rated_current x torque_constant 1.4, 1.4 times as much (peak and "
        "rms ampere differ by 1.41); correct one, or leave rated_current out.",
    ),
    (
        SMALLEST.replace('"i"', '"i", unit = "permille"'),
        'record.channels.torque is in "permille", a share of the rated torque, which needs the drive\'s rated_torque: '
        "give it, or rated_current and torque_constant.",
    ),
    (
        SMALLEST.replace('"r"', '"r", unit = "counts"') + "[drive]\ncounts_per_turn = 4096",
        'record.channels.reference is in "counts", which needs the drive\'s counts_per_metre: give it, or gain and '
        "another unit.",
    ),
    (
        SMALLEST.replace('{ column = "i" }', "{ gain = 2.0 }"),
        "record.channels.torque.column is missing; expected text in quotes (name of the column in the record's file): "
        "add it, or give drive.profile.",
    ),
    (
        SMALLEST.replace('"i"', '"i", wrap = 360'),
        "record.channels.torque has a wrap of 360, which is for a position; leave it out.",
    ),
    # the method
    (
        JOINT + '[record.channels]\ntorque = { column = "i" }',
        "method.name is missing, and no method can be chosen: DIDIM lacks record.channels.reference and "
        "controller, IDIM lacks record.channels.motor_position; add what one of them lacks.",
    ),
    (
        JOINT + CHANNELS + '[method]\nname = "didim"',
        'controller is missing, but DIDIM needs it: add it, or use method.name = "idim", which needs only torque '
        "and motor_position.",
    ),
    (
        JOINT + CHANNELS.replace("motor_", "load_") + CASCADE + '[method]\nname = "idim"',
        'record.channels.motor_position is missing, but IDIM needs it: add it, or use method.name = "didim", '
        "which needs only torque, reference and controller.",
    ),
    (
        JOINT + CHANNELS + '[controller]\nlaw = "pd"\nkp = 1.0\nkd = 1.0\nreference_velocity = "channel"',
        'record.channels.reference_velocity is missing, but DIDIM needs it: add it, or use method.name = "idim", '
        "which needs only torque and motor_position.",
    ),
    (
        JOINT + CHANNELS + '[method]\nform = "paper"',
        'method.form is for DIDIM, but the method is IDIM: leave it out, or use method.name = "didim".',
    ),
    # the method of a flexible joint
    *(
        (
            f"{FLEXIBLE}[method]\n{key} = {value}",
            f"method.{key} is for DIDIM of a rigid joint, but the joint is flexible: leave it out, or set "
            'joint.model = "rigid".',
        )
        for key, value in (
            ("form", '"paper"'),
            ("start", '"given"'),
            ("scaled_iterations", 1),
            ("step_tolerance", 1e-3),
            ("iterations", 3),
            ("initial_state", '"free"'),
        )
    ),
    *(
        (
            f"{SMALLEST}[method]\n{key} = {value}",
            f"method.{key} is for DIDIM of a flexible joint, but the joint is rigid: leave it out, or set "
            'joint.model = "flexible".',
        )
        for key, value in (
            ("minimiser", '"nelder-mead"'),
            ("frequency", 30.0),
            ("rigid_cutoff", 5.0),
            ("simulations", 10),
            ("restarts", 0),
            ("statistics", '"sensitivities"'),
        )
    ),
    (
        SMALLEST + '[method]\npreset = "paper"\nfrequency = 30.0',
        "method.frequency is for DIDIM of a flexible joint, but the joint is rigid: leave it out, or set "
        'joint.model = "flexible".',
    ),
    (
        JOINT + 'model = "flexible"\n' + BOTH_ENCODERS + '[method]\nminimiser = "nelder-mead"',
        'method.minimiser is for DIDIM, but the method is IDIM: leave it out, or use method.name = "didim".',
    ),
    (
        JOINT + CHANNELS + '[method]\nname = "idim"\nestimator = "iv"',
        'controller is missing, but method.estimator = "iv" simulates the loop: add it, or use another.',
    ),
    (
        JOINT + CHANNELS + CASCADE + '[method]\nname = "didim"\ndrift = "force"',
        'method.drift is for IDIM, but the method is DIDIM: leave it out, or use method.name = "idim".',
    ),
    (
        JOINT + CHANNELS + "[method]\nperiod = 0.005",
        "method.period is 0.005, but there are no harmonics; add harmonics = 1, or leave it out.",
    ),
    (
        FLEXIBLE + "[method]\nfrequency = -30",
        "method.frequency is -30; expected a positive number: correct it, or leave it out.",
    ),
    (
        JOINT + 'model = "flexible"\n' + CHANNELS,
        "method.name is missing, and no method can be chosen: DIDIM lacks controller, IDIM of a flexible joint lacks "
        'record.channels.load_position; add what one of them lacks, or set joint.model = "rigid".',
    ),
    (
        JOINT + 'model = "flexible"\n' + CHANNELS.replace("motor_", "load_"),
        "method.name is missing, and no method can be chosen: DIDIM lacks controller, IDIM of a flexible joint lacks "
        "record.channels.motor_position; add what one of them lacks.",
    ),
    (
        FLEXIBLE + '[method]\nname = "idim"',
        "record.channels.load_position is missing, but IDIM of a flexible joint needs it: add it, or use "
        'method.name = "didim", which needs only torque, reference and controller.',
    ),
    (
        JOINT + 'model = "flexible"\n' + CHANNELS + '[method]\nname = "didim"',
        'controller is missing, but DIDIM needs it: add it, or use method.name = "idim", which needs only torque, '
        "motor_position and load_position.",
    ),
    # parameters
    (
        SMALLEST + "[parameters]\ninertai = 3",
        "parameters.inertai is not known for a rigid joint with symmetric friction; expected one of inertia, "
        "viscous, coulomb, offset: did you mean inertia?",
    ),
    (
        SMALLEST + "[parameters]\nstiffness = 3",
        "parameters.stiffness is not known for a rigid joint with symmetric friction; expected one of inertia, "
        'viscous, coulomb, offset: leave it out, or set joint.model = "flexible".',
    ),
    (
        SMALLEST + "[parameters]\nviscous_forwards = 3",
        "parameters.viscous_forwards is not known for a rigid joint with symmetric friction; expected one of "
        'inertia, viscous, coulomb, offset: leave it out, or set joint.friction = "asymmetric".',
    ),
    # gravity
    (
        SMALLEST + '[gravity]\nload = "link"\n[parameters]\ngravity_cos = 3',
        "gravity: A prismatic joint does not turn its load, so nothing of its gravity follows a cosine or a sine; use "
        'load = "constant", or a revolute joint.',
    ),
    (
        SMALLEST.replace(JOINT, JOINT + 'friction = "asymmetric"\n') + '[gravity]\nload = "constant"',
        "gravity: A constant load cannot be told apart from asymmetric friction: it adds to the Coulomb force forwards "
        "and takes as much from it backwards; use symmetric friction, or leave gravity out.",
    ),
    (
        LINK + "angle = 0",
        "gravity.angle: The angle of gravity is the radians of the link per unit of the joint's position, and not 0; "
        "received 0.0.",
    ),
    (
        LINK.replace("link", "arm"),
        'gravity.load is "arm"; expected "constant" or "link": choose one of them.',
    ),
    (
        SMALLEST + '[gravity]\nload = "constant"\n[parameters]\noffset = { start = 3 }',
        "parameters.offset cannot be identified beside a constant load: torque and motor position only know the sum of "
        "both; give it a value, or leave [gravity] out.",
    ),
    (
        SMALLEST + "[parameters]\ngravity_cos = { start = 3 }",
        "parameters.gravity_cos is not known for a rigid joint with symmetric friction; expected one of inertia, "
        'viscous, coulomb, offset: leave it out, or set gravity.load = "link".',
    ),
    (
        LINK + "counterbalance = { cos = 2 }\n[parameters]\ncounterbalance_cos = { start = 3 }",
        "parameters.counterbalance_cos is known, and not identified; give it a value, or change it in "
        "gravity.counterbalance.",
    ),
    (
        SMALLEST + "[parameters]\ninertia = -3",
        "parameters.inertia is -3; expected more than 0: correct it, or its bounds.",
    ),
    (
        SMALLEST + '[parameters]\ninertia = "3"',
        'parameters.inertia is "3"; expected a number, or a table: write it without quotes.',
    ),
    (
        SMALLEST + "[parameters]\ninertia = { start = 3, lower = 4 }",
        "parameters.inertia.start is 3; expected 4 or more: correct it, or its bounds.",
    ),
    (
        SMALLEST + "[parameters]\noffset = { start = 9, lower = 4, upper = 5 }",
        "parameters.offset.start is 9; expected a number from 4 to 5: correct it, or its bounds.",
    ),
    (
        SMALLEST + "[parameters]\noffset = { start = 9, upper = 5 }",
        "parameters.offset.start is 9; expected 5 or less: correct it, or its bounds.",
    ),
    (
        SMALLEST + "[parameters]\nviscous = { upper = -5 }",
        "parameters.viscous.upper is -5; expected more than 0: raise it.",
    ),
    (
        SMALLEST + "[parameters]\ninertia = { upper = 0 }",
        "parameters.inertia.upper is 0; expected more than 0: raise it.",
    ),
    (
        SMALLEST + "[parameters]\ninertia = { lower = inf }",
        "parameters.inertia.lower is inf; expected less than inf: lower it.",
    ),
    (
        SMALLEST + "[parameters]\noffset = { lower = nan }",
        "parameters.offset.lower is nan; expected a number, inf or -inf: correct it, or leave it out.",
    ),
    (
        SMALLEST + "[parameters]\noffset = { lower = 3, upper = 1 }",
        "parameters.offset.lower is 3; expected less than upper = 1: exchange them.",
    ),
    (
        SMALLEST + "[parameters]\noffset = { free = false }",
        "parameters.offset.value is missing; a parameter that is not free needs the value that it keeps: add it.",
    ),
    (
        SMALLEST + "[parameters]\noffset = { value = 3, free = true }",
        "parameters.offset.free is true beside value = 3, which would fix it; write start = 3.",
    ),
    (
        SMALLEST + "[parameters]\noffset = { value = 3, start = 3 }",
        "parameters.offset.start stands beside value; keep value to fix the parameter, or start to identify it.",
    ),
    (
        SMALLEST.replace('"prismatic"', '"prismatic"\nfriction = "asymmetric"')
        + "[parameters]\noffset = { free = true }",
        "parameters.offset cannot be identified beside asymmetric friction: a constant adds to the Coulomb force "
        "forwards and takes as much from it backwards, so the two cannot be told apart; give it a value, or set "
        'joint.friction = "symmetric".',
    ),
    # TOML
    (
        "[joint]\nkind = prismatic",
        "Line 2, column 8 is not TOML (invalid value); expected [tables] and lines of key = value, text in "
        '"quotes": correct that line.',
    ),
    (
        '[joint]\nkind = "prismatic',
        "Line 2, column 18 is not TOML (unterminated string); expected [tables] and lines of key = value, text in"
        ' "quotes": correct that line.',
    ),
    (
        "x = " + "9" * 5000,
        "The joint file holds a number of thousands of digits; correct it.",
    ),
    (
        "x = " + "[" * 20000,
        "The joint file nests lists or tables too deeply; no key of it needs that.",
    ),
]


@pytest.mark.parametrize(("text", "sentence"), FAULTS, ids=[sentence[:50] for _, sentence in FAULTS])
def test_a_fault_is_one_sentence(text: str, sentence: str) -> None:
    assert faults(text) == (sentence,)


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [
        (SMALLEST + "KI = 3.0", "controller.KI is not a known key; .* did you mean ki"),
        (SMALLEST + "[Method]", "Method is not a known key; .* did you mean method"),
        (SMALLEST + "[drive]\nratedTorque = 3.0", "drive.ratedTorque is not a known key; .* did you mean rated_torque"),
        (SMALLEST + "torque_filters = [{ D = 1.0, numerator = [1.0] }]", "0.D is not a known key; .*: leave it out."),
        (SMALLEST.replace('"cascade"', '"PID"'), 'law is "PID"; .* did you mean "pid"'),
    ],
)
def test_the_case_of_a_word_does_not_hide_which_was_meant(wrong: str, meant: str) -> None:
    (said,) = faults(wrong)
    assert re.search(meant, said)


def test_all_faults_come_at_once() -> None:
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
        kp = "a"
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
        "record.channels.reference.unit",
        "record.channels.motor_position is",
        "controller.law",
        "filtering.borders",
        "method.iterations",
        "parameters.inertia.lower",
        "parameters.viscous",
    ]
    assert len(found) == len(expected)
    for key in expected:
        assert sum(sentence.startswith(key) for sentence in found) == 1, key


def test_a_joint_with_other_faults_still_has_its_model() -> None:
    found = faults(FLEXIBLE.replace('"flexible"', '"flexible"\nfriktion = 3') + "[method]\niterations = 3")
    assert [sentence.split()[0] for sentence in found] == ["joint.friktion", "method.iterations"]
    for unknown in (FLEXIBLE.replace("flexible", "flexibel"), SMALLEST.replace(JOINT, "joint = 3\n")):
        (sentence,) = faults(f"{unknown}[method]\niterations = 3\nminimiser = 'nelder-mead'")
        assert sentence.startswith("joint")


def test_a_file_that_is_not_there_or_no_text(tmp_path: Path) -> None:
    with pytest.raises(JointFileError, match=r"none\.toml cannot be opened \(no such file .*\); check the path"):
        load(tmp_path / "none.toml")
    (tmp_path / "joint.toml").write_bytes(b"name = '\xff'")
    with pytest.raises(JointFileError, match=r"is not text in UTF-8 \(byte 8\); save it as UTF-8"):
        load(tmp_path / "joint.toml")
    (tmp_path / "marked.toml").write_text(SMALLEST, encoding="utf-8-sig")
    assert load(tmp_path / "marked.toml") == loads(SMALLEST)


# Overrides


def test_overrides_are_checked_in_the_same_way() -> None:
    file = loads(JOINT + CHANNELS.replace("motor_", "load_") + CASCADE + "[parameters]\nviscous = 3.0")
    with pytest.raises(JointFileError) as caught:
        file.overridden(method="idim", friction="asymmetric")
    motor_position, viscous = caught.value.faults
    assert motor_position.startswith("record.channels.motor_position is missing, but IDIM needs it: add it")
    assert viscous.startswith("parameters.viscous is not known for a rigid joint with asymmetric friction")
    with pytest.raises(JointFileError, match=r'method.name is "didm"; expected .*: did you mean "didim"\?'):
        file.overridden(method="didm")
    with pytest.raises(JointFileError, match=r'preset is "x"; expected "default", "published" or "as-printed"'):
        file.overridden(filtering="x")
    with pytest.raises(JointFileError, match=r"^method.minimiser is for DIDIM of a flexible joint, but .* is rigid"):
        file.overridden(minimiser="nelder-mead")
    with pytest.raises(JointFileError, match=r"^method.frequency is for DIDIM, but the method is IDIM"):
        loads(JOINT + 'model = "flexible"\n' + BOTH_ENCODERS).overridden(frequency=30.0)


def test_an_override_replaces_one_choice() -> None:
    file = loads(SMALLEST + '[method]\nform = "paper"\n[filtering]\ncutoff = 3.0')
    assert file.overridden() == file
    assert file.overridden(method="didim") == file
    assert file.overridden(method="idim") == dataclasses.replace(file, method=IDIM())
    assert file.overridden(method="idim").overridden(method="didim").method == DIDIM()
    assert file.overridden(filtering="published") == dataclasses.replace(file, filtering=Filtering.published())
    assert file.overridden(filtering="default") == dataclasses.replace(file, filtering=Filtering())
    assert file.overridden(friction="asymmetric").joint == RigidJoint(friction=AsymmetricFriction())
    assert file.overridden(friction="symmetric") == file


def test_an_override_of_a_flexible_joint() -> None:
    file = loads(FLEXIBLE.replace(CHANNELS, BOTH_ENCODERS) + '[method]\npreset = "paper"')
    paper = FlexibleDIDIM.paper()
    assert file.overridden() == file
    assert file.overridden(frequency=42.0).method == FlexibleDIDIM.paper(42.0)
    assert file.overridden(minimiser="nelder-mead") == file
    changed = file.overridden(minimiser="least-squares", frequency=20.0, filtering="as-printed")
    assert changed.method == dataclasses.replace(paper, minimiser="least-squares", frequency=20.0)
    assert changed.filtering == Filtering.as_printed()
    assert file.overridden(method="idim").method == IDIM()
    back = file.overridden(method="idim").overridden(method="didim", frequency=9.0)
    assert back.method == FlexibleDIDIM(frequency=9.0)
    with pytest.raises(JointFileError, match=r'minimiser is "simplex"; expected "least-squares" or "nelder-mead"'):
        file.overridden(minimiser="simplex")
    with pytest.raises(JointFileError, match=r"frequency is 0.0; expected a positive number"):
        file.overridden(frequency=0.0)


def test_an_override_keeps_the_folder(tmp_path: Path) -> None:
    save(loads(SMALLEST), tmp_path / "joint.toml")
    assert load(tmp_path / "joint.toml").overridden(method="idim").path == tmp_path / "joint.toml"


# Writing


positive = st.floats(1e-9, 1e9)
hertz, seconds, none_or_more = st.floats(0.01, 40.0), st.floats(0.0, 1e-4), positive | st.just(0.0)
words = st.text(min_size=1, max_size=8)
row = st.lists(positive, min_size=1, max_size=3).map(tuple)
filters = st.one_of(
    st.builds(DigitalFilter, row, row),
    st.builds(MovingAverage, st.integers(1, 9)),
    st.builds(FirstOrder, none_or_more),
    st.builds(SecondOrder, hertz, positive, st.none() | hertz, st.floats(-0.5, 1.0)),
    st.builds(Notch, hertz, positive, none_or_more),
)
law = {
    "gain": positive,
    "limit": positive | st.just(np.inf),
    "period": st.none() | st.floats(1e-6, 1e-2),
    "delay": none_or_more,
    "interpolation": st.sampled_from((None, "hold", "linear", "cubic")),
    "reference_delay": seconds,
    "kp": positive,
    "velocity_filter": row | filters,
    "torque_filters": st.lists(filters, max_size=3).map(tuple),
    "filters_at": st.sampled_from(("before_limit", "after_limit")),
    "acceleration_feedforward": none_or_more,
    "viscous_feedforward": none_or_more,
    "coulomb_feedforward": none_or_more,
    "constant_feedforward": st.floats(-1e9, 1e9),
    "torque_feedforward_delay": seconds,
}
windups = st.sampled_from(("hold", "track", "none"))
velocities = st.sampled_from(("difference", "channel", "none"))


def controllers(ratio: st.SearchStrategy[float]) -> st.SearchStrategy[Controller]:
    shared = law | {"ratio": ratio}
    return st.one_of(
        st.builds(
            Cascade,
            kv=positive,
            ki=none_or_more,
            anti_windup=windups,
            velocity_feedforward=none_or_more,
            velocity_feedforward_delay=seconds,
            reference_velocity=st.sampled_from(("difference", "channel")),
            velocity_limit=positive | st.just(np.inf),
            **shared,
        ),
        st.builds(PD, kd=positive, reference_velocity=velocities, **shared),
        st.builds(PID, kd=positive, ki=none_or_more, anti_windup=windups, reference_velocity=velocities, **shared),
    )


def columns(channel: str, geared: bool) -> st.SearchStrategy[Column]:
    choices: dict[str, Any] = {"side": st.sampled_from((None, "motor", "load"))} if geared else {}
    if channel == "torque":
        choices |= {"tap": st.sampled_from(Tap), "unit": st.sampled_from(("N", "kN"))}
    elif channel == "injected":
        choices |= {"at": st.sampled_from(InjectionPoint), "unit": st.just("mN")}
    else:
        choices |= {"unit": st.sampled_from(known_units(channel, "prismatic"))}
    return st.builds(
        Column,
        words,
        gain=positive,
        sign=st.sampled_from((1, -1)),
        timing=st.none() | st.sampled_from(Timing),
        sample_time=st.none() | positive,
        optional=st.booleans(),
        **choices,
    )


JOINTS: list[Joint] = [
    RigidJoint(),
    RigidJoint(friction=AsymmetricFriction()),
    RigidJoint(gravity=Gravity("constant", Counterbalance(constant=3.0, rate=-0.5))),
    FlexibleJoint(),
    FlexibleJoint(friction=AsymmetricFriction()),
    FlexibleJoint(gravity=Gravity("constant")),
]


@st.composite
def joint_files(draw: st.DrawFn) -> JointFile:
    side = st.sampled_from(SIDES)
    gear = draw(
        st.none()
        | st.builds(Transmission, load=st.just("prismatic"), ratio=positive, sign=st.sampled_from((1, -1)), side=side)
    )
    joint = dataclasses.replace(draw(st.sampled_from(JOINTS)), transmission=gear)
    if joint.gravity is not None and gear is not None:  # a file says the angle of the load, whatever the side
        weight = dataclasses.replace(joint.gravity, angle=gear.torque("load"))
        joint = dataclasses.replace(joint, gravity=weight)
    ratio = st.just(1.0) if gear is None else side.map(gear.torque)
    names = ["torque", "reference", "reference_velocity", "motor_position", "load_position"]
    names += draw(st.lists(st.just("injected"), max_size=1))
    whole = st.integers(1, 50)
    rigid = st.builds(
        DIDIM,
        form=st.sampled_from(("residual", "paper")),
        scaled_iterations=whole,
        tolerance=positive,
        iterations=whole,
    )
    flexible = st.just(FlexibleDIDIM.paper()) | st.builds(
        FlexibleDIDIM,
        minimiser=st.sampled_from(("least-squares", "nelder-mead")),
        frequency=st.none() | positive,
        rigid_cutoff=st.none() | positive,
        tolerance=positive,
        simulations=whole,
        restarts=whole,
        statistics=st.sampled_from(("sensitivities", "inverse-model")),
        free=st.sampled_from(((), ("kp",), ("kp", "delay"))),
    )
    estimators = st.sampled_from(("ols", "weighted", "robust", "iv"))
    ripple = st.builds(PositionHarmonics, st.none() | positive, st.integers(1, 9))
    drift = st.builds(Drift, st.sampled_from(("force", "viscous", "both")))
    effects = st.just(()) | st.tuples(ripple) | st.tuples(drift) | st.tuples(ripple, drift)
    return JointFile(
        joint=joint,
        columns={name: draw(columns(name, gear is not None)) for name in names},
        method=draw(st.builds(IDIM, estimators, effects) | (flexible if joint.model == "flexible" else rigid)),
        controller=draw(controllers(ratio)),
        filtering=draw(
            st.sampled_from((Filtering.published(), Filtering.as_printed()))
            | st.builds(
                Filtering,
                st.none() | positive,
                borders=st.tuples(whole, whole),
                timing=st.just("as_sampled"),
                aliasing=st.sampled_from(("refused", "warned")),
            )
        ),
        drive=draw(
            st.builds(
                Drive,
                profile=st.none() | st.sampled_from(profile_names()),
                axis=st.none() | whole,
                rated_torque=st.none() | positive,
                counts_per_metre=positive,
                load_counts_per_metre=positive,
            )
        ),
        parameters={
            p.name: draw(st.sampled_from((p, p.fixed(3.0), dataclasses.replace(p, upper=5.0))))
            for p in joint.parameters
            if p.free and draw(st.booleans())
        },
        source=draw(
            st.builds(
                Source,
                st.sampled_from(("run.csv", "runs/run 1.TXT", "../run.dat")),
                time=st.none() | words,
                sample_time=st.none() | positive,
                options=st.fixed_dictionaries({}, optional={"decimal": st.just(","), "header": st.booleans()}),
            )
        ),
        name=draw(st.none() | words),
        runs=draw(
            st.lists(
                st.builds(
                    Run,
                    st.sampled_from(("run.csv", "runs/run 2.TXT")),
                    added_inertia=st.just(0.0) | positive,
                    own=st.lists(st.sampled_from([p.name for p in joint.parameters])).map(tuple),
                    controller=st.fixed_dictionaries({}, optional={"kp": positive}),
                ),
                max_size=2,
            ).map(tuple)
        ),
        free=draw(st.sampled_from(((), ("drive_gain",)))),
        weighting=draw(st.sampled_from(("spectrum", "level"))),
    )


@given(joint_files())
def test_what_is_written_is_read_back(file: JointFile) -> None:
    assert loads(dumps(file)) == file


SLOW = Cascade(kp=1.0, kv=2.0, period=125e-6, position_period=1e-3, position_offset=250e-6)
NOTCHED = PID(kp=1.0, ki=2.0, kd=3.0, torque_filters=(FirstOrder(1e-3), Notch(80.0, 20.0, 0.1)))


@pytest.mark.parametrize("controller", [SLOW, NOTCHED, Cascade(kp=1.0, kv=2.0)])
def test_a_controller_is_put_into_the_text_of_a_file(controller: Cascade | PID) -> None:
    before = f"# a joint\n{JOINT}{CHANNELS}"
    nested = '[controller]  # drive\nlaw = "state_space"\nC = [1.0]\nA = [\n  [0.5]\n]\n[controller.B]\n'
    nested += "position = [1.0]\n[controller.D]\nreference = 1.0\n\n"
    after = "[parameters]\noffset = 0.0  # kept\n"
    for old in ("", CASCADE, nested, '[[controller.torque_filters]]\nkind = "notch"\n'):
        made = with_controller(before + old + after, controller)
        assert loads(made) == dataclasses.replace(loads(before + after), controller=controller, method=DIDIM())
        assert made.startswith(before)
        assert "# kept" in made
    inline = with_controller("controller = { law = 'pd' }\n" + before, controller)
    assert loads(inline).controller == controller
    assert tomllib.loads(with_controller("", controller)) == tomllib.loads(controller_text(controller))
    with pytest.raises(JointFileError, match="is not TOML"):
        with_controller("[joint", controller)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('[record]\nfile = "a.csv" # mine\n', '[record]\nfile = "../runs/a.csv" # mine\n'),
        ("[record]\ntime = 't'\n  file='sub/a.csv'\n", "[record]\ntime = 't'\n  file=\"../runs/sub/a.csv\"\n"),
        ('[record]\nfile = "../there/a.csv"\n', '[record]\nfile = "a.csv"\n'),
        ('[record]\nfile = "/data/a.csv"\n', '[record]\nfile = "/data/a.csv"\n'),
        ('[record]\nfile = "Größe \\"1\\".csv"\n', '[record]\nfile = "../runs/Größe \\"1\\".csv"\n'),
        (
            '[[records]]\nfile = "a.csv"\n[[records]]\nown = ["file"]\nfile = "b.csv"\n',
            '[[records]]\nfile = "../runs/a.csv"\n[[records]]\nown = ["file"]\nfile = "../runs/b.csv"\n',
        ),
        ('record = { file = "a.csv" }\n', '[record]\nfile = "../runs/a.csv"\n'),
        ('[record]\nfile = """a.csv"""\n', '[record]\nfile = "../runs/a.csv"\n'),
        ('[joint]\nfile = "a.csv"\n', '[joint]\nfile = "a.csv"\n'),
    ],
)
def test_paths_lead_to_the_same_files_from_another_folder(text: str, expected: str, tmp_path: Path) -> None:
    assert with_paths(text, tmp_path / "runs", tmp_path / "there") == expected
    assert with_paths(text, tmp_path / "runs", tmp_path / "there" / ".." / "runs") == text


def test_numbers_of_filters_are_named_with_points() -> None:
    notched = CASCADE + 'torque_filters = [{ kind = "notch", frequency = 80, bandwidth = 20 }]\n'
    runs = '[[records]]\nfile = "a.csv"\n[[records]]\nfile = "b.csv"\ncontroller = '
    name, free = "torque_filters.0.frequency", '[method]\nfree = ["torque_filters.0.frequency"]\n'
    for written in ("{ torque_filters.0.frequency = 90.0 }", '{ "torque_filters.0.frequency" = 90.0 }'):
        file = loads(JOINT + CHANNELS + notched + free + runs + written)
        assert isinstance(file.method, DIDIM)
        assert file.method.free == (name,)
        assert [one.controller.torque_filters[0].frequency for one in file.each()] == [80.0, 90.0]  # type: ignore[union-attr]
        assert loads(dumps(file)) == file
    (sentence,) = faults(JOINT + CHANNELS + notched + runs + "{ torque_filters.1.frequency = 90.0 }")
    assert sentence.startswith('records.2.controller."torque_filters.1.frequency" is not a known key; expected one of')
    assert sentence.endswith("did you mean torque_filters.0.frequency?")
    (sentence,) = faults(JOINT + CHANNELS + notched + runs + "{ torque_filters.0.frequency = -9 }")
    assert sentence.startswith("records.2.controller: Notch.frequency is -9.0; expected a positive number")


def test_a_saved_file_is_loaded(tmp_path: Path) -> None:
    file = load(EXAMPLE)
    save(file, tmp_path / "copy.toml")
    assert load(tmp_path / "copy.toml") == file
    with pytest.raises(JointFileError, match=r"cannot be written \(.*\); check the folder"):
        save(file, tmp_path / "none" / "joint.toml")


def test_a_state_space_law_is_written() -> None:
    law = StateSpaceController(A=np.eye(1) / 2, B={"position": np.ones(1)}, C=[1.0], D={"reference": 1.0})
    file = dataclasses.replace(loads(SMALLEST), controller=law)
    again = loads(dumps(file)).controller
    assert again is not None
    for name in ("A", "B", "C", "D", "F"):
        np.testing.assert_array_equal(getattr(again.law(1.0), name), getattr(law.law(1.0), name))


def test_what_a_joint_file_cannot_say_is_not_written() -> None:
    file = loads(SMALLEST)

    class Other(Cascade):
        pass

    class OtherFriction(SymmetricFriction):
        pass

    with pytest.raises(JointFileError, match="no word for the controller Other; give a StateSpaceController"):
        dumps(dataclasses.replace(file, controller=Other(kp=1.0, kv=1.0)))
    loads_only = IDIM(effects=(PositionHarmonics(0.1, side="load"),))
    with pytest.raises(JointFileError, match="has words for one PositionHarmonics, then one Drift, both on the motor"):
        dumps(dataclasses.replace(file, method=loads_only))
    with pytest.raises(JointFileError, match="no word for the friction OtherFriction; use symmetric or asymmetric"):
        dumps(dataclasses.replace(file, joint=RigidJoint(friction=OtherFriction())))
    with pytest.raises(JointFileError, match="The joint's torque is in A, but its channel's in N; give"):
        dumps(dataclasses.replace(file, joint=RigidJoint(torque_unit="A")))
    for joint, method, right in (
        (RigidJoint(), FlexibleDIDIM(), "DIDIM"),
        (FlexibleJoint(), DIDIM(), "FlexibleDIDIM"),
    ):
        with pytest.raises(JointFileError, match=f"DIDIM is not for a {joint.model} joint; use {right}"):
            dumps(dataclasses.replace(file, joint=joint, method=method))
    unknown = {"mass": Parameter("mass", "M", file.joint.parameters[0].quantity)}
    with pytest.raises(JointFileError, match=r"parameters\.mass is not known for a rigid joint"):
        dumps(dataclasses.replace(file, parameters=unknown))


# Whatever stands in the file


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
    | st.sampled_from(("cascade", "pd", "state_space", "didim", "idim", "flexible", "asymmetric", "paper", "A", "deg"))
    | st.sampled_from(
        ("nelder-mead", "inverse-model", "as-printed", "warned", "pid", "notch", "moving_average", "track")
    ),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["numerator", "position", "kind", "samples"]), inner)
    ),
    max_leaves=6,
)


@given(st.data())
def test_any_value_at_any_key_is_read_or_refused(data: st.DataObject) -> None:
    tables = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
    for _ in range(data.draw(st.integers(1, 4))):
        path = data.draw(st.sampled_from([*TABLES, *sorted(schema_keys())]))
        path = path.replace("<channel>", data.draw(st.sampled_from(CHANNELS_NAMED)))
        path = path.replace("<filter>", "velocity_filter")
        *above, key = path.replace("<name>", data.draw(st.sampled_from(("inertia", "offset", "x")))).split(".")
        table = tables
        for name in above:
            below = table.setdefault(name, {})
            table = below if isinstance(below, dict) else {}
        table[key] = data.draw(anything)
    try:
        file = JointFile.of(tables)
    except JointFileError as error:
        in_our_words(error)
    else:
        assert JointFile.of(file.tables()) == file or isinstance(file.controller, StateSpaceController)


TABLES = ("joint", "record", "controller", "filtering", "method", "parameters", "records", "together", "other")
CHANNELS_NAMED = ("torque", "reference", "motor_position", "injected", "other")


def read_or_refused(text: str) -> None:
    try:
        loads(text)
    except JointFileError as error:
        in_our_words(error)


def in_our_words(error: JointFileError) -> None:
    for sentence in error.faults:
        assert sentence.endswith((".", "?"))
        assert "\n" not in sentence
        assert not re.search("Input should|Field required|Extra inputs|Value error|pydantic|_type", sentence)


# Records


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A short record in a folder below the joint file's."""
    time = np.arange(400) * 1e-3
    table = np.column_stack([time, 300 * np.sin(20 * time), 0.1 * np.sin(20 * time), 0.1 * np.sin(20 * time - 0.1)])
    (tmp_path / "runs").mkdir()
    np.savetxt(tmp_path / "runs" / "run.csv", table, delimiter=";", header="t;i;r;q", comments="")
    return tmp_path / "runs" / "run.csv"


def saved(folder: Path, text: str) -> JointFile:
    (folder / "joint.toml").write_text(text, encoding="utf-8")
    return load(folder / "joint.toml")


def test_the_record_lies_beside_the_joint_file(run: Path) -> None:
    folder = run.parents[1]
    record = saved(folder, "[record]\nfile = 'runs/run.csv'\ndelimiter = ';'\n" + SMALLEST).record()
    assert record.channels == ("torque", "reference", "motor_position")
    assert record.name == "run"
    assert saved(folder, SMALLEST).record(run).channels == record.channels
    with pytest.raises(
        RecordError, match=r"joint.toml names no record; add file to \[record\], or name one by --record"
    ):
        saved(folder, SMALLEST).record()


def test_a_channel_that_the_method_does_not_need_may_be_absent(run: Path) -> None:
    without_motor = SMALLEST.replace('"q"', '"nowhere"')
    assert loads(without_motor).record(run).channels == ("torque", "reference")
    with pytest.raises(RecordError, match=r'has no column "nowhere" \(for motor_position\)'):
        loads(without_motor).overridden(method="idim").record(run)
    without_reference = SMALLEST.replace('"r"', '"nowhere"')
    assert loads(without_reference).overridden(method="idim").record(run).channels == ("torque", "motor_position")
    with pytest.raises(RecordError, match=r'has no column "nowhere" \(for reference\)'):
        loads(without_reference).record(run)


def test_an_injected_signal_may_be_absent_only_if_it_is_optional(run: Path) -> None:
    injected = SMALLEST.replace("[controller]", 'injected = { column = "x" }\n[controller]')
    with pytest.raises(RecordError, match=r'has no column "x" \(for injected\)'):
        loads(injected).record(run)
    optional = injected.replace('"x"', '"x", optional = true')
    assert loads(optional).record(run).injected is None


def test_a_torque_beyond_the_limit_is_refused(run: Path) -> None:
    limited = loads(SMALLEST + "gain = 2.0\nlimit = 100.0")
    with pytest.raises(RecordError, match=r"The torque reaches .* beyond the controller's limit of 200 N"):
        limited.record(run)
    assert loads(SMALLEST + "gain = 2.0\nlimit = 160.0").record(run).torque is not None


def test_the_emps_file_serves_both_records(data_dir: Path) -> None:
    file = load(EXAMPLE)
    channels = ("torque", "reference", "motor_position")
    first = file.record(data_dir / "emps" / "DATA_EMPS.mat")
    second = file.record(data_dir / "emps" / "DATA_EMPS_PULSES.mat")
    assert first.channels == channels
    assert second.channels == (*channels, "injected")
    assert second.injected is not None
    assert second.injected.channel.values.max() == pytest.approx(5.07 * 35.15, rel=1e-3)
    assert file.loop is not None
    estimate = identify(first, file.loop, file.method, filtering=file.filtering, parameters=file.parameters)
    found = {parameter.name: parameter.value for parameter in estimate.params}
    assert found["inertia"] == pytest.approx(94.9, abs=0.1)
    assert found["viscous"] == pytest.approx(207.5, abs=0.5)
    assert found["coulomb"] == pytest.approx(20.1, abs=0.1)
    assert found["offset"] == pytest.approx(-3.17, abs=0.02)
    assert estimate.fit.relative_error == pytest.approx(0.0456, abs=2e-4)


# Several records

SEVERAL = """
[[records]]
file = "a.csv"

[[records]]
file = "b.csv"
added_inertia = 10.0
own = ["coulomb"]
controller = { kp = 80.0, limit = 5.0 }

[together]
free = ["drive_gain"]
"""


def test_several_records(run: Path) -> None:
    folder = run.parents[1]
    file = saved(folder, "[record]\ndelimiter = ';'\n" + SMALLEST + SEVERAL.replace("a.csv", "runs/run.csv"))
    assert file.runs == (Run("runs/run.csv"), Run("b.csv", 10.0, ("coulomb",), {"kp": 80.0, "limit": 5.0}))
    assert (file.free, file.weighting) == (("drive_gain",), "spectrum")
    first, second = file.each()
    assert first.controller == file.controller == Cascade(kp=100.0, kv=2000.0)
    assert second.controller == Cascade(kp=80.0, kv=2000.0, limit=5.0)
    assert first.record().name == "run"
    with pytest.raises(RecordError, match=r"b\.csv"):
        second.record()
    assert first.record() != file.each([folder / "b.csv", run])[1].record  # names on the command line replace both
    assert file.each([folder / "b.csv", run])[1].source.file == str(run)
    with pytest.raises(JointFileError, match="lists 2 records and 1 are named"):
        file.each([run])
    unlisted = saved(folder, SMALLEST)
    assert [one.source.file for one in unlisted.each([run, folder / "b.csv"])] == [str(run), str(folder / "b.csv")]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (SEVERAL.replace('"coulomb"', '"colomb"'), 'records.2.own names "colomb", which is no parameter of this model'),
        (
            SEVERAL.replace("kp = 80.0", "kd = 80.0"),
            "records.2.controller.kd is not a known key; expected one of gain,",
        ),
        (SEVERAL.replace("limit = 5.0", "limit = -5.0"), "records.2.controller: "),
        (SEVERAL.replace('file = "a.csv"', ""), "records.1.file is missing; expected text in quotes"),
        (SEVERAL.replace("10.0", "-10.0"), "records.2.added_inertia is -10.0; expected a number, 0 or more"),
        ("records = 3\n", "records is 3; expected one [[records]] table for each record"),
    ],
)
def test_a_fault_of_several_records_is_one_sentence(text: str, sentence: str) -> None:
    found = faults(text + SMALLEST if text.startswith("records") else SMALLEST + text)
    assert len(found) == 1
    assert found[0].startswith(sentence)
    in_our_words(JointFileError(found))


def test_a_controller_that_is_not_there_cannot_be_another() -> None:
    text = SMALLEST.replace(CASCADE, "") + SEVERAL
    assert any("changes a controller that the file does not have" in fault for fault in faults(text))


# The page and the schema


@cache
def schema_keys() -> dict[str, set[str]]:
    """Return every key below the tables of the file, as the page writes it, with its defaults."""
    schema = json_schema()
    found: dict[str, set[str]] = {}

    def walk(described: dict[str, Any], path: str) -> None:
        if "$ref" in described:
            walk(schema["$defs"][described["$ref"].rsplit("/", 1)[1]], path)
        for one in (*described.get("anyOf", ()), *described.get("oneOf", ())):
            walk(one, path)
        if "$ref" in described.get("items", {}):
            walk(described["items"], path)
        if described.get("additionalProperties"):
            found[f"{path}.<name>"] = {"—"}
            walk(described["additionalProperties"], f"{path}.<name>")
        for key, below in described.get("properties", {}).items():
            at = f"{path}.{key}" if path else key
            default = f"`{json.dumps(below['default'])}`" if "default" in below else "—"
            if "." in at:
                found.setdefault(at, set()).add("required" if key in described.get("required", ()) else default)
            walk(below, at)

    walk(schema, "")
    channels = [key.rsplit(".", 1)[1] for key in found if re.fullmatch(r"record\.channels\.\w+", key)]
    shared = {key.rsplit(".", 1)[1] for key in found if key.startswith("record.channels.reference.")}
    for channel in channels:
        for key in shared:
            found[f"record.channels.<channel>.{key}"] = found.pop(f"record.channels.{channel}.{key}")
    for key in [key for key in found if re.match(r"controller\.(velocity_filter|torque_filters)\.", key)]:
        found[f"controller.<filter>.{key.rsplit('.', 1)[1]}"] = found.pop(key)
    return found


def page_keys() -> dict[str, set[str]]:
    found: dict[str, set[str]] = {}
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if match := re.match(r"\| `([\w<>]+(?:\.[\w<>]+)+)` \|", line):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            assert len(cells) == 4, line
            assert all(cells), line
            found.setdefault(match[1], set()).add(cells[2])
    return found


def test_the_page_has_every_key_and_no_other() -> None:
    assert page_keys() == schema_keys()


def test_the_page_has_every_unit_and_parameter() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for kind in ("prismatic", "revolute"):
        cells = ["reference", "reference_velocity", "torque"]
        row = " | ".join(", ".join(known_units(channel, kind)) for channel in cells)
        assert f"| {kind} | {row} |" in page
    for joint in (RigidJoint, FlexibleJoint):
        for friction, law_ in (("symmetric", SymmetricFriction()), ("asymmetric", AsymmetricFriction())):
            made = joint(friction=law_)
            names = ", ".join(f"`{parameter.name}`" for parameter in made.parameters)
            assert f"| {made.model} | {friction} | {names} |" in page
    assert ", ".join(f'`"{name}"`' for name in units_of("time")) in page


def test_the_page_has_the_defaults_that_depend_on_the_model() -> None:
    rows = {line.split("`")[1]: line for line in PAGE.read_text(encoding="utf-8").splitlines() if line[:3] == "| `"}
    least, simplex = (stopping_tolerance(FlexibleDIDIM(minimiser=m)) for m in ("least-squares", "nelder-mead"))  # type: ignore[arg-type]
    said = [float(word) for word in re.findall(r"else (1e-\d+)", rows["method.tolerance"])]
    assert said == [DIDIM().tolerance, least, simplex]
    for key in ("position_cutoff", "cutoff"):
        rigid, flexible = (getattr(Filtering().resolved(1e-3, model), key) for model in ("rigid", "flexible"))
        said = f"else {rigid / 10:g} % of the sampling frequency, for a flexible joint {flexible / 10:g} %"
        assert said in rows[f"filtering.{key}"]


def test_the_files_on_the_page_are_right() -> None:
    texts = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(texts) == 6
    smallest, geared, traced, drive, several, whole = map(loads, texts)
    assert geared.joint.transmission == Transmission(load="revolute", ratio=100.0)
    assert geared.columns["reference"].side == "load"
    assert traced.drive == Drive("cia402", rated_torque=1.27, counts_per_turn=1048576.0)
    assert [one.added_inertia for one in several.runs] == [0.0, 10.0]
    assert isinstance(smallest.method, DIDIM)
    assert isinstance(drive.controller, Cascade)
    assert drive.controller.law(2e-3).phases == 8
    assert whole.joint.torque_unit == "A"


def test_the_schema_has_no_null_and_a_description_of_every_key() -> None:
    text = json.dumps(json_schema())
    assert "null" not in text
    for name in json_schema()["$defs"]:
        assert all("description" in key for key in table(name).values())


def test_importing_loads_nothing_heavy() -> None:
    heavy = "numba, matplotlib, scipy.signal, scipy.optimize"
    program = f"import sys, jointid.config; print([m for m in '{heavy}'.split(', ') if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("lines", "made"),
    [
        ('name = "drive_side"', DriveSideFit()),
        ('name = "drive_side"\nlog_delay = -4e-4\ninstruments = "never"', DriveSideFit(-4e-4, instruments="never")),
        ('name = "drive_side"\ncurrent_lag = "estimated"\nfrequency = 54', DriveSideFit(None, None, 54.0)),
        ('name = "open_loop"\nhighpass = 2', OpenLoopFit(highpass=2.0)),
    ],
)
def test_methods_without_a_controller_come_back(lines: str, made: DriveSideFit | OpenLoopFit) -> None:
    file = loads(_BARE + lines)
    assert file.method == made
    assert loads(dumps(file)).method == made


@pytest.mark.parametrize(
    ("lines", "sentence"),
    [
        ('name = "drive_side"\nhighpass = 2', 'method.highpass is not for the method "drive_side"'),
        ('name = "open_loop"\nform = "paper"', 'method.form is not for the method "open_loop"'),
        ('name = "idim"\nlog_delay = 1e-3', 'method.log_delay is not for the method "idim"'),
    ],
)
def test_a_setting_of_another_method_is_a_fault(lines: str, sentence: str) -> None:
    with pytest.raises(JointFileError, match=sentence):
        loads(_BARE + lines)


def test_the_drive_side_needs_the_motor_position() -> None:
    with pytest.raises(JointFileError, match=r"record.channels.motor_position is missing, but the drive side method"):
        loads(_BARE.replace("motor_position", "load_position") + 'name = "drive_side"')


_BARE = """
[joint]
kind = "revolute"
model = "flexible"
[record.channels]
torque = { column = "i", unit = "A" }
motor_position = { column = "q", unit = "rad" }
[method]
"""
