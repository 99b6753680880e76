"""Actuators of simulators: what each text says of a joint and of a robot, read by stand-ins of their classes."""

import math
import sys
import types
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

import jointid as ji
from jointid.models.robots.robot import JointSpring
from tests.estimation.robots.twin import arm
from tests.output.export.models import model, with_parameter

GEAR = ji.Transmission(load="revolute", ratio=10.0, side="motor")
RIGID = {"inertia": 2e-4, "viscous": 1e-3, "coulomb": 0.02, "offset": 0.001}
FLEXIBLE = {
    "motor_inertia": 0.4, "motor_viscous": 8.0, "motor_coulomb": 5.0, "stiffness": 9e3, "damping": 3.0,
    "load_inertia": 0.2, "load_viscous": 1.0, "load_coulomb": 0.8, "offset": 0.0,
}  # fmt: skip
LAW = ji.controller.PD(
    position_gain=0.6, derivative_gain=0.02, limit=3.0, reference_velocity="channel", reference_delay=0.0102,
    delay=5e-4, period=1e-3,
)  # fmt: skip
BETWEEN = {
    "isaac-lab": ("isaaclab.actuators", ("ImplicitActuatorCfg", "DelayedPDActuatorCfg")),
    "mjlab": ("mjlab.actuator", ("IdealPdActuatorCfg", "BuiltinPositionActuatorCfg")),
}


@pytest.fixture
def simulators(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Modules whose classes keep what they are called with."""
    for module, names in BETWEEN.values():
        for at in range(module.count(".") + 1):
            name = ".".join(module.split(".")[: at + 1])
            monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
        for name in names:
            setattr(sys.modules[module], name, lambda _name=name, **keys: (_name, keys))
    yield


def built(text: str) -> Any:
    names: dict[str, Any] = {}
    exec(compile(text, "actuators", "exec"), names)
    return names["ACTUATORS"]


def geared(law: ji.controller.PD = LAW) -> Any:
    told = model(ji.RigidJoint("revolute", transmission=GEAR), RIGID)
    return ji.export(told, "isaac-lab", name="knee", controllers=[law])


@pytest.mark.usefixtures("simulators")
def test_isaac_lab_has_gains_and_inertia_of_the_load_side() -> None:
    made = geared()
    kind, keys = built(made.text)["knee"]
    assert kind == "DelayedPDActuatorCfg"
    assert keys == {
        "joint_names_expr": ["knee"], "stiffness": pytest.approx(60.0), "damping": pytest.approx(2.0),
        "armature": pytest.approx(0.02), "friction": pytest.approx(0.2), "dynamic_friction": pytest.approx(0.2),
        "viscous_friction": pytest.approx(0.1), "effort_limit": pytest.approx(30.0), "min_delay": 2, "max_delay": 2,
    }  # fmt: skip
    assert len(geared(replace(LAW, limit=math.inf)).lost) == len(made.lost) + 1, "an effort limit"
    kind, keys = built(geared(replace(LAW, reference_delay=0.0)).text)["knee"]
    assert kind == "ImplicitActuatorCfg"
    assert keys["effort_limit_sim"] == pytest.approx(30.0)


@pytest.mark.usefixtures("simulators")
def test_mjlab_takes_the_class_that_has_the_law() -> None:
    joint = model(ji.FlexibleJoint("revolute"), FLEXIBLE)
    ((kind, keys),) = built(ji.export(joint, "mjlab", name="left.knee", controllers=[LAW], timestep=2e-3).text)
    assert kind == "IdealPdActuatorCfg"
    assert keys["target_names_expr"] == (r"left\.knee",)
    assert (keys["armature"], keys["viscous_damping"], keys["frictionloss"]) == pytest.approx((0.4, 9.0, 5.8))
    assert keys["delay_min_lag"] == keys["delay_max_lag"] == 5
    braking = replace(LAW, reference_velocity="none")
    assert built(ji.export(joint, "mjlab", controllers=[braking]).text)[0][0] == "BuiltinPositionActuatorCfg"


@pytest.mark.usefixtures("simulators")
def test_a_robot_has_an_entry_for_each_joint() -> None:
    robot = arm(3)
    soft = replace(robot.joints[1], spring=JointSpring(5000.0, 1.0, viscous=2.0, coulomb=3.0))
    robot = replace(robot, joints=(robot.joints[0], soft, robot.joints[2]))
    made = ji.export(robot, "isaac-lab", controllers=[LAW] * 3)
    found = built(made.text)
    assert list(found) == list(robot.names)
    assert found["joint2"][1]["friction"] == pytest.approx(soft.coulomb + 3.0)
    assert found["joint2"][1]["armature"] == soft.rotor_inertia
    assert found["joint3"][1]["stiffness"] == LAW.position_gain
    assert len(built(ji.export(robot, "mjlab").text)) == 3


@pytest.mark.parametrize("language", ["isaac-lab", "mjcf"])
@pytest.mark.parametrize("count", [1, 4])
def test_controllers_are_one_for_each_joint(language: str, count: int) -> None:
    with pytest.raises(ji.MethodError):
        ji.export(arm(3), language, controllers=[LAW] * count)
    with pytest.raises(ji.MethodError):
        ji.export(model(ji.RigidJoint("revolute"), RIGID), language, controllers=[LAW] * 2)


@pytest.mark.usefixtures("simulators")
def test_a_cascade_is_such_a_law_and_what_it_has_more_is_said() -> None:
    law = ji.controller.Cascade(
        position_gain=30.0, velocity_gain=0.02, integral_gain=5.0, velocity_filter=[0.5, 0.5], gain=2.0,
        velocity_limit=3.0, acceleration_feedforward=1.0, reference_average=8e-3, interpolation="cubic",
    )  # fmt: skip
    joint = model(ji.RigidJoint("revolute"), RIGID)
    made, bare = (ji.export(joint, "mjlab", controllers=[one]) for one in (law, replace(LAW, interpolation="hold")))
    (_, keys) = built(made.text)[0]
    assert (keys["stiffness"], keys["damping"]) == pytest.approx((1.2, 0.04))
    assert (len(made.lost), len(bare.lost)) == (10, 4)


HOSTILE = "x\"]\n)\nimport os; os.abort() # ' \\ \x00 \u2028 \ud800 }"


@pytest.mark.usefixtures("simulators")
@pytest.mark.parametrize("language", BETWEEN)
def test_hostile_names_stay_names(language: str) -> None:
    text = ji.export(model(ji.RigidJoint("revolute"), RIGID, HOSTILE), language, name=HOSTILE).text
    text.encode("utf-8")
    assert len(built(text)) == 1  # runs nothing else


@pytest.mark.usefixtures("simulators")
def test_a_gain_that_was_identified_takes_the_place_of_the_declared_one() -> None:
    told = with_parameter(model(ji.RigidJoint("revolute", transmission=GEAR), RIGID), "position_gain", value=0.8)
    made = ji.export(told, "isaac-lab", name="knee", controllers=[LAW])
    assert built(made.text)["knee"][1]["stiffness"] == pytest.approx(80.0)
