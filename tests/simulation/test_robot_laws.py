"""Every law of a joint on a robot's axis, alone and combined: a robot of one is that joint, derivatives included."""

import numpy as np
import pytest
from numba import typeof

from jointid.models.controllers import PD
from jointid.models.friction import FRICTIONS, Friction
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, RigidJoint
from jointid.models.position_forces import Gravity
from jointid.models.robots.robot import JointSpring, Link, Robot, RobotJoint, RobotLoop
from jointid.models.springs import SPRINGS, Spring
from jointid.planning.robots import _draw_robots
from jointid.records.record import Channel, Record
from jointid.simulation.derivatives import differentiate
from jointid.simulation.kernels import engine, variation
from jointid.simulation.loop_input import prepare
from jointid.simulation.plant import Numbers, Place, robot_with
from jointid.simulation.simulate import Outcome, run_loop
from jointid.simulation.start import Initial
from jointid.simulation.synthesis import simulate
from jointid.simulation.warm_up import warm_up
from tests.simulation.differences import differences

LAW = PD(position_gain=900.0, derivative_gain=30.0)
LINK = 0.8  # kg m2
MOTOR = {
    "inertia": 0.3, "viscous": 1.1, "coulomb": 1.7, "viscous_forwards": 1.1, "viscous_backwards": 1.9,
    "coulomb_forwards": 1.7, "coulomb_backwards": 1.1, "stribeck_force": 1.2, "stribeck_speed": 0.3,
    "presliding_distance": 2e-3, "viscous_drift": 0.3, "coulomb_drift": -0.2, "friction_per_torque": 0.12,
}  # fmt: skip
LOAD = {
    "inertia": LINK, "viscous": 0.6, "coulomb": 0.9, "viscous_forwards": 0.6, "viscous_backwards": 0.9,
    "coulomb_forwards": 0.9, "coulomb_backwards": 0.7, "stribeck_force": 0.5, "stribeck_speed": 0.2,
    "presliding_distance": 3e-3, "viscous_drift": -0.1, "coulomb_drift": 0.3, "friction_per_torque": 0.1,
}  # fmt: skip
BETWEEN = {
    "stiffness": 900.0, "damping": 1.5, "gap": 0.004, "stiffness_2": 1500.0, "stiffness_3": 2500.0, "torque_1": 3.0,
    "torque_2": 6.0, "cubic_stiffness": 4e6, "hysteresis_stiffness": 300.0, "hysteresis_torque": 1.0, "offset": 0.2,
    "gravity_cos": 9.81 * 0.5, "gravity_sin": -9.81 * 0.2,
}  # fmt: skip

RIGID = [RigidJoint("revolute", law) for law in FRICTIONS.values()]
FLEXIBLE = [FlexibleJoint("revolute", law) for law in FRICTIONS.values()]
SPRUNG = [FlexibleJoint("revolute", spring=law) for law in SPRINGS.values() if law.name != "elastic-load"]
HANGING = [make("revolute", gravity=Gravity("link")) for make in (RigidJoint, FlexibleJoint)]
COMBINED = [RigidJoint("revolute", Friction("asymmetric-presliding"))] + [
    FlexibleJoint("revolute", Friction(friction), spring=Spring(spring))
    for friction, spring in (
        ("asymmetric-presliding-drifting-load-dependent", "cubic"), ("asymmetric-stribeck-drifting", "hysteretic"),
        ("stribeck-load-dependent", "backlash"), ("asymmetric-drifting", "three-piece"),
        ("symmetric", "cubic-hysteretic"), ("presliding", "backlash-cubic"),
    )
]  # fmt: skip


def values_of(joint: Joint) -> dict[str, float]:
    """Return the numbers of a joint; the link is a part of a rigid one's inertia."""
    known = BETWEEN | MOTOR | {f"motor_{name}": value for name, value in MOTOR.items()}
    known |= {f"load_{name}": value for name, value in LOAD.items()}
    known["inertia"] += LINK
    return {p.name: known[p.name] for p in joint.parameters}


def robot_of(joint: Joint) -> Robot:
    """Return a joint as a robot of one, about its link's principal axis, with the weight of one that has gravity."""
    values = values_of(joint)
    body = np.array([1.0, 0.5, 0.2, *[0.0] * 6, LINK])
    spring = None
    if isinstance(joint, FlexibleJoint):
        spring = JointSpring(values["stiffness"], values["damping"], law=joint.spring)
    own = {"motor_inertia", "load_inertia", "inertia", "offset", "stiffness", "damping"}
    numbers = {name: x for name, x in values.items() if name not in own and not name.startswith("gravity")}
    axis = RobotJoint("one", MOTOR["inertia"], offset=0.2, spring=spring, friction=joint.friction, numbers=numbers)
    return Robot((Link("arm", -1, inertial=body),), (axis,), gravity=np.array([0.0, -9.81 * bool(joint.gravity), 0.0]))


def reference() -> Record:
    """Return a motion with a rest, so that the joint sticks: at the beginning, and towards the end."""
    t = np.arange(1300) * 1e-3
    x = np.clip(t / 0.3, 0, 1)
    moved = 0.6 * np.sin(2 * np.pi * 1.5 * np.minimum(t, 0.9)) * x**3 * (10 - 15 * x + 6 * x * x)
    return Record(reference=Channel(moved, "rad", 1e-3))


@pytest.mark.parametrize(
    "joint",
    [*RIGID, *FLEXIBLE, *SPRUNG[1:], *HANGING, *COMBINED],
    ids=lambda joint: f"{joint.model} {joint.friction.name} {joint.laws[-1].name}{' hanging' * bool(joint.gravity)}",
)
def test_a_robot_of_one_joint_is_that_joint(joint: Joint) -> None:
    """To the error of the joint's own steps; where its motion is exact, to the order of the robot's integrator.

    Derivatives by every number are those of differences, of order 2; and the robot has again what its numbers say.
    """
    record, loop = reference(), RobotLoop(robot_of(joint), (LAW,))
    numbers = Numbers.of(loop.robot)
    again = Numbers.of(robot_with(loop.robot, numbers))
    assert (again.values[0], again.joints) == (pytest.approx(numbers.values[0], abs=1e-15), numbers.joints)
    drawn = Numbers.of(next(_draw_robots(loop.robot, 20.0, 1, 1))).values[0]  # for a plan that holds within 20 %
    assert all(drawn[name] != x for name, x in numbers.values[0].items() if name.endswith(("coulomb", "wards")))
    runs = {steps: simulate(loop, (record,), steps=steps) for steps in (4, 8)}
    alone = ClosedLoop(joint, LAW)
    begun = Initial(float(runs[8].motor_position[0, 0]), 0.0, 0.0)
    exact = simulate(alone, prepare(alone, record), values_of(joint), begun)
    peak = np.max(np.abs(exact.torque))
    errors = {n: np.max(np.abs(run.torque[:, 0] - exact.torque)) / peak for n, run in runs.items()}
    assert all(run.outcome is Outcome.FINISHED for run in runs.values())
    assert errors[8] < (1e-5 if not joint.straight else 2e-9)
    assert not joint.straight or (errors[8] < errors[4] / 10.0 + 3e-11 and runs[8].events == exact.events)
    assert np.max(np.abs(runs[8].motor_position[:, 0] - exact.motor_position)) < (1e-6 if not joint.straight else 1e-9)
    driven = prepare(loop, (record,))
    weight = ("mx", "my") if joint.gravity else ()
    places = [Place(0, name) for name in ("Izz", *weight, *numbers.values[0]) if name != "load_offset"]
    found = {n: differentiate(run_loop(driven, numbers, keep=True, steps=n), places)[0][0] for n in (2, 4, 16)}
    expected = differences(driven, numbers, places, 4)[:, 0]
    sizes = np.linalg.norm(expected, axis=0)
    off = np.linalg.norm(found[4] - expected, axis=0) / sizes
    assert not [place for place, one in zip(places, off, strict=True) if one >= 1e-3]
    coarse, fine = (np.linalg.norm((found[n] - found[16]) / sizes) for n in (2, 4))
    assert fine < coarse / 3.5 or "load-dependent" in joint.friction.name  # which bends where no step ends


def test_a_full_tape_grows_to_that_of_a_run_in_room_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    joint, record = FlexibleJoint("revolute", FRICTIONS["presliding"]), reference()
    loop, alone = RobotLoop(robot_of(joint), (LAW,)), ClosedLoop(joint, LAW)
    runs = [(prepare(loop, (record,)), Numbers.of(loop.robot))]
    runs.append((prepare(alone, record), Numbers.of_joint(joint, values_of(joint))))
    whole = [run_loop(*one, keep=True) for one in runs]
    monkeypatch.setattr("jointid.simulation.simulate._MORE", 0)
    monkeypatch.setattr("jointid.simulation.simulate._TAPED", 1)
    for one, expected in zip(runs, whole, strict=True):
        found = run_loop(*one, keep=True)
        assert (found.outcome, len(found.tape)) == (Outcome.FINISHED, expected.counts[1])
        assert np.array_equal(found.tape, expected.tape)


def test_lines_smooth_laws_and_robots_are_compiled_each_when_it_is_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """A kernel is compiled once for each signature: that of lines has no smooth law, whose state is a tuple."""
    seen, own, record = list[tuple[object, ...]](), engine.run, reference()
    monkeypatch.setattr(engine, "run", lambda *given: seen.append(tuple(map(typeof, given))) or own(*given))
    lines = [*RIGID[:2], *FLEXIBLE[:2], *SPRUNG[1:3]]
    for joint in (*lines, RIGID[-1], FLEXIBLE[-1], *SPRUNG[4:]):
        alone = ClosedLoop(joint, LAW)
        run_loop(prepare(alone, record), Numbers.of_joint(joint, values_of(joint)))
    run_loop(prepare(loop := RobotLoop(robot_of(RIGID[0]), (LAW,)), (record,)), Numbers.of(loop.robot))
    assert [seen.count(kind) for kind in dict.fromkeys(seen)] == [len(lines), 1, 1 + len(SPRUNG[4:]), 1]
    followed = list[object]()  # beforehand, no force takes a joint out of the range of its reference
    monkeypatch.setattr(variation, "follow", lambda *given: followed.append(given))
    warm_up(FlexibleJoint("prismatic", FRICTIONS["presliding"], gravity=Gravity("constant")))
    assert followed
