"""A joint file becomes the objects that the verbs take."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest

from jointid.common.errors import MethodError
from jointid.config import Axis, File, Source, dumps, loads
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.drive_side import DriveSideFit
from jointid.estimation.methods.idim import IDIM
from jointid.models.controllers import (
    PD,
    Cascade,
    DigitalFilter,
)
from jointid.models.friction import AsymmetricFriction, SymmetricFriction
from jointid.models.joints import FlexibleJoint, RigidJoint
from jointid.models.position_forces import Counterbalance, Gravity, PositionHarmonics
from jointid.records.columns import Column
from jointid.records.record import Tap, Timing
from jointid.records.resampling import Resampling
from jointid.records.signals.filtering import Filtering
from tests.joint_files import BOTH_ENCODERS, CASCADE, CHANNELS, FLEXIBLE, JOINT, LINK, ROOT, SMALLEST


def test_every_default() -> None:
    axis = Axis(
        name=None,
        joint=RigidJoint("prismatic", SymmetricFriction()),
        columns={"torque": Column("i"), "reference": Column("r"), "motor_position": Column("q")},
        controller=Cascade(position_gain=100.0, velocity_gain=2000.0),
    )
    assert loads(SMALLEST) == File(axes=(axis,), method=DIDIM())
    assert loads(SMALLEST).path == Path("joint.toml")


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
        position_gain = 3.0
        derivative_gain = 0.1
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
        [method]
        name = "didim"
        frequency = 25.0
        rigid_cutoff = 4.0
        tolerance = 1e-3
        free = ["position_gain", "delay"]
        [parameters]
        stiffness = { start = 8e5, lower = 1e3, upper = 1e7 }
        damping = 126
        motor_inertia = { value = 0.1, upper = 1.0 }
        load_inertia = { lower = 0.01 }
        """,
        folder="here",
    )
    joint = FlexibleJoint("revolute", AsymmetricFriction(), "A")
    known = {parameter.name: parameter for parameter in joint.parameters}
    axis = Axis(
        name="axis 3",
        joint=joint,
        columns={
            "torque": Column("i", "mA", 0.5, -1, Timing.AVERAGED, tap=Tap.MEASURED),
            "reference": Column("r [deg]"),
            "reference_velocity": Column("dr", "rpm", timing=Timing.HELD),
            "load_position": Column("p", optional=True, sample_time=0.002),
            "injected": Column("x", "A", in_torque=False),
        },
        controller=PD(
            position_gain=3.0,
            derivative_gain=0.1,
            reference_velocity="channel",
            velocity_filter=DigitalFilter((0.2,), (1.0, -0.8)),
            gain=2.0,
            limit=5.0,
            period=0.002,
            delay=0.0005,
        ),
        parameters={
            "stiffness": dataclasses.replace(known["stiffness"], start=8e5, lower=1e3, upper=1e7),
            "damping": known["damping"].fix(126.0),
            "motor_inertia": dataclasses.replace(known["motor_inertia"].fix(0.1), upper=1.0),
            "load_inertia": dataclasses.replace(known["load_inertia"], lower=0.01),
        },
        source=Source(
            "runs/run1.csv",
            "stamp",
            "ms",
            0.001,
            options={"delimiter": ";", "decimal": ",", "header": True},
            resample=Resampling(1e-3, "cubic", longest_gap=0),
        ),
    )
    assert file == File(
        axes=(axis,),
        method=DIDIM(frequency=25.0, rigid_cutoff=4.0, tolerance=1e-3, free=("position_gain", "delay")),
        filtering=Filtering(100.0, 20.0, 5, (10, 0), "as_sampled"),
        parameters=axis.parameters,
        name="axis 3",
    )
    assert file.path == Path("here/joint.toml")
    assert file.loop is not None
    assert file.loop.joint is file.joint
    assert file.loop.controller is file.controller


def test_gravity() -> None:
    file = loads(
        LINK + "angle = 0.01\ncounterbalance = { cos = 0.2, rate = 1e-3 }\n[parameters]\ngravity_sin = { start = 0.5 }"
    )
    assert file.joint == RigidJoint("revolute", gravity=Gravity("link", Counterbalance(cos=0.2, rate=1e-3), 0.01))
    assert file.parameters["gravity_sin"].start == 0.5
    loaded = loads(FLEXIBLE + '[gravity]\nload = "constant"').joint
    assert loaded == FlexibleJoint("prismatic", gravity=Gravity("constant"))
    assert [p.name for p in loaded.parameters[-2:]] == ["offset", "gravity_constant"]
    assert [p.free for p in loaded.parameters[-2:]] == [False, True]


def test_ripple() -> None:
    file = loads(FLEXIBLE + '[ripple]\nperiod = 0.005\nside = "load"\n[parameters]\nload_harmonic_1_sine = 0.5')
    assert file.joint == FlexibleJoint("prismatic", ripple=PositionHarmonics(0.005, side="load"))
    assert file.parameters["load_harmonic_1_sine"].start == 0.5
    assert [p.name for p in file.joint.parameters[-2:]] == ["load_harmonic_1_cosine", "load_harmonic_1_sine"]
    assert file.joint.rigid == RigidJoint("prismatic", ripple=PositionHarmonics(0.005))


@pytest.mark.parametrize("model", ["rigid", "flexible"])
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (BOTH_ENCODERS + CASCADE, DIDIM()),  # even though there are both positions
        (BOTH_ENCODERS, IDIM()),
        (BOTH_ENCODERS.replace("reference", "injected") + CASCADE, IDIM()),
        (BOTH_ENCODERS + CASCADE + '[method]\nname = "idim"\nestimator = "iv"', IDIM("iv")),
        (CHANNELS + CASCADE + "[method]\ntolerance = 1e-3", DIDIM(tolerance=1e-3)),
    ],
)
def test_the_method(model: str, text: str, expected: object) -> None:
    file = loads(f'{JOINT}model = "{model}"\n{text}')
    assert file.method == expected
    assert loads(dumps(file)) == file


def test_values_are_those_fixed_and_those_started_from() -> None:
    file = loads(
        SMALLEST + "[parameters]\ninertia = { start = 90.0 }\nviscous = 200\ncoulomb = 20\noffset = { start = 1 }"
    )
    assert file.axis.values() == {"inertia": 90.0, "viscous": 200.0, "coulomb": 20.0, "offset": 1.0}
    with pytest.raises(MethodError, match=r"every parameter; without one: inertia, viscous, coulomb, offset"):
        loads(SMALLEST).axis.values()


def test_settings_of_the_drive_side_come_back() -> None:
    text = JOINT + 'model = "flexible"\n' + CHANNELS + '[method]\nname = "drive_side"\nlog_delay = -4e-4\n'
    file = loads(text)
    assert file.method == DriveSideFit(-4e-4)
    assert loads(dumps(file)).method == file.method


def test_the_files_on_the_page_are_right() -> None:
    texts = re.findall(r"```toml\n(.*?)```", (ROOT / "docs" / "joint-file.md").read_text(encoding="utf-8"), re.DOTALL)
    assert len([loads(text) for text in texts]) >= 5
