"""Robots whose axes have nonlinear laws of friction and springs, identified from torque and reference."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.parameters import name_in_robot, robot_parameters
from jointid.estimation.robots.didim import search_robot
from jointid.models.friction import FRICTIONS
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, RigidJoint
from jointid.models.robots.robot import JointSpring, Robot, RobotLoop
from jointid.models.springs import SPRINGS
from jointid.records.record import Channel, Record
from jointid.simulation.plant import Numbers
from jointid.simulation.simulate import Outcome
from jointid.simulation.synthesis import simulate
from tests.estimates import identify
from tests.robots_plants import Twin, two
from tests.simulation.test_robot_laws import FLEXIBLE, LAW, RIGID, SPRUNG, robot_of, values_of


def moved(seconds: float = 4.0, multisine: float = 4e-4) -> Record:
    """Return a motion that begins at rest, with a multisine about the mode on top of it, rad."""
    t = np.arange(round(seconds * 1000)) * 1e-3
    waves = ((0.5, 0.6, 0.0), (0.15, 2.1, 1.0), (0.04, 5.3, 2.0), (15.0 * multisine, 14.0, 0.5))
    q = sum(a * np.sin(2 * np.pi * f * t + phase) for a, f, phase in waves)
    q = q + sum(multisine * np.sin(2 * np.pi * f * t + f * f) for f in range(8, 60, 4))
    x = np.clip(t / 0.3, 0, 1)
    return Record(reference=Channel(q * x**3 * (10 - 15 * x + 6 * x * x), "rad", 1e-3))


def noisy(loop: RobotLoop, records: tuple[Record, ...], share: float = 0.02) -> tuple[Record, ...]:
    """Return the records of a simulation, with white noise of a share of each torque."""
    rng, found, run = np.random.default_rng(3), [], simulate(loop, records, steps=6)
    assert run.outcome is Outcome.FINISHED
    for record in run.records(records):
        torque = record.torque.values
        values = torque + share * np.std(torque) * rng.normal(size=torque.size)
        found.append(replace(record, torque=replace(record.torque, values=values)))
    return tuple(found)


def slow(joint: Joint) -> object:
    name = f"{joint.model} {joint.friction.name} {joint.laws[-1].name}"
    quick = ("rigid presliding presliding",)
    return pytest.param(joint, id=name, marks=() if name in quick else pytest.mark.slow)


# A robot's search of a spring in three pieces ends beside that of a joint, with 0.4 % more error.
NONLINEAR = [one for one in (*RIGID, *FLEXIBLE, *SPRUNG) if one.linear != one and one.laws[-1].name != "three-piece"]


@pytest.mark.parametrize("joint", [slow(joint) for joint in NONLINEAR])
def test_a_robot_of_one_joint_is_identified_as_that_joint(joint: Joint) -> None:
    """The same laws by the same names, values and deviations.

    A robot's search ends where a step promises 0.3 deviations, and a joint has a free first position beside its own.
    """
    loop = RobotLoop(robot_of(joint), (LAW,))
    records = noisy(loop, (moved(),))
    fit, alone = search_robot(loop, records), identify(records[0], ClosedLoop(joint, LAW), checks=False)
    assert fit.converged
    linear = {p.name for p in joint.linear.parameters}
    for p in joint.parameters:
        if p.name not in linear or p.name == "stiffness":
            value, std = fit.value(name_in_robot("one", p.name))
            other = alone[p.name]
            assert abs(value - other.value) < 0.75 * other.stderr, p.name
            assert std == pytest.approx(other.stderr, rel=0.35), p.name


def with_laws(twin: Twin, laws: Mapping[str, tuple[str, str | None, dict[str, float]]]) -> Robot:
    """Return the robot with friction, spring and their numbers on some joints."""
    joints = []
    for joint in twin.robot.joints:
        friction, spring, numbers = laws[joint.name]
        own = None if spring is None or joint.spring is None else replace(joint.spring, law=SPRINGS[spring])
        joints.append(replace(joint, friction=FRICTIONS[friction], spring=own, numbers=numbers))
    return replace(twin.robot, joints=tuple(joints))


@pytest.mark.slow
@pytest.mark.parametrize(
    "laws",
    [
        {
            "joint1": ("stribeck", None, {"stribeck_force": 3.0, "stribeck_speed": 0.15}),
            "joint2": ("presliding", None, {"presliding_distance": 5e-3}),
        },
        {
            "joint1": ("presliding", "linear", {"motor_presliding_distance": 3e-3, "load_presliding_distance": 5e-3}),
            "joint2": ("symmetric", "backlash", {"gap": 4e-3}),
        },
    ],
    ids=["rigid", "flexible"],
)  # fmt: skip
def test_two_axes_have_laws_of_their_own(laws: dict[str, tuple[str, str | None, dict[str, float]]]) -> None:
    flexible = any(spring for _, spring, _ in laws.values())
    twin = two((9.0, 13.0) if flexible else (None, None))
    loop = replace(twin.loop(), robot=with_laws(twin, laws))
    fit = search_robot(loop, noisy(loop, twin.records(6.0, multisine=0.02 if flexible else 0.0), 0.01))
    truth = fit.parameters.group(Numbers.of(loop.robot))
    assert fit.converged
    own = [name_in_robot(joint, name) for joint, (_, _, numbers) in laws.items() for name in numbers]
    assert set(own) <= set(fit.parameters.names)
    for name, value, std, true in zip(fit.parameters.names, fit.values, fit.covariance.std, truth, strict=True):
        assert abs(value - true) < 3.0 * std, name
        assert std < 0.5 * abs(true) or name not in own, name


def test_a_law_is_found_from_a_start_and_beside_a_fixed_number() -> None:
    robot = robot_of(RigidJoint("revolute", FRICTIONS["stribeck"]))
    loop = RobotLoop(robot, (LAW,))
    records = noisy(loop, (moved(),))
    speed = Parameter("stribeck_speed", "vS", Quantity.VELOCITY)
    known = {
        "one.stribeck_speed": speed.fix(0.3),
        "one.stribeck_force": Parameter("x", "FS", Quantity.FORCE, start=1.0),
    }
    said = list[str]()
    fit = search_robot(loop, records, known=known, progress=said.append)
    assert "one.stribeck_speed" not in [p.name for p in fit.parameters.free]
    value, std = fit.value("one.stribeck_force")
    assert abs(value - 1.2) < 3.0 * std < 1.0
    assert any(line == "looking for the laws of one, from 4 starts" for line in said)


def test_the_parameters_of_laws_have_the_declarations_of_a_joint() -> None:
    joint = FlexibleJoint("revolute", FRICTIONS["presliding-load-dependent"], spring=SPRINGS["hysteretic"])
    found = {p.name: p for p in robot_parameters(robot_of(joint)).parameters}
    linear = {p.name for p in joint.linear.parameters}
    for p in joint.parameters:
        if p.name not in linear:
            one = found[name_in_robot("one", p.name)]
            assert (one.quantity, one.lower, one.upper) == (p.quantity, p.lower, p.upper)


def test_idim_takes_an_axis_with_any_spring_for_rigid() -> None:
    robot = robot_of(FlexibleJoint("revolute", FRICTIONS["asymmetric"]))
    stiff = replace(robot.joints[0].spring or JointSpring(1.0), stiffness=1e4, law=SPRINGS["two-piece"])
    joint = replace(
        robot.joints[0], spring=stiff, numbers={**robot.joints[0].numbers, "stiffness_2": 2e4, "torque_1": 3.0}
    )
    robot = replace(robot, joints=(joint,))
    records = noisy(RobotLoop(robot, (LAW,)), (moved(multisine=0.0),), 0.001)
    found = identify(records, robot, IDIM(), checks=False)
    values = values_of(FlexibleJoint("revolute", FRICTIONS["asymmetric"]))
    rows = {row.symbol: row.value for row in found.rows}
    for symbol, side in (("Fv1+", "viscous_forwards"), ("Fv1-", "viscous_backwards")):
        assert rows[symbol] == pytest.approx(values[f"motor_{side}"] + values[f"load_{side}"], rel=0.1)
