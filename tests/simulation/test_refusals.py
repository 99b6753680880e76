"""What is not simulated: each refusal once, by its type, and each number that no joint may have, by the outcome."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from jointid.common.errors import JointidError, MethodError, RecordError
from jointid.models.controllers import PD, Cascade
from jointid.models.friction import FRICTIONS
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.models.position_forces import PositionHarmonics
from jointid.models.robots.robot import JointSpring, RobotJoint, RobotLoop
from jointid.models.springs import SPRINGS, Spring
from jointid.records.record import Channel, Injection, Record, Tap
from jointid.simulation.loop_input import prepare
from jointid.simulation.simulate import Outcome, require_success
from jointid.simulation.synthesis import simulate, simulated_record
from tests.plants import prismatic
from tests.robots_plants import two
from tests.simulation.differences import sensitivities

T = 1e-3
VALUES = {"inertia": 95.0, "viscous": 207.0, "coulomb": 20.0, "offset": -3.2}
LAW = Cascade(position_gain=60.0, velocity_gain=6e3)
WILD = Cascade(position_gain=2e3, velocity_gain=1e6, delay=3e-3)
LINE, ARM = ClosedLoop(RigidJoint("prismatic"), LAW), two().loop()


def record(samples: int = 500, unit: str = "m", **more: Any) -> Record:
    return Record(reference=Channel(np.linspace(0.0, 0.1, samples), unit, T), **more)


def prepare_at(period: float) -> object:
    return prepare(replace(LINE, controller=replace(LAW, period=period)), record())


def slopes(name: str, law: Cascade = LAW) -> object:
    loop = replace(LINE, controller=law)
    return sensitivities(loop, prepare(loop, record()), VALUES, [name])


REFUSED: dict[str, tuple[Callable[[], object], type[JointidError]]] = {
    "a record of fewer than ten periods": (lambda: prepare(LINE, record(5)), RecordError),
    "a period far below the log's": (lambda: prepare_at(1e-9), RecordError),
    "a period as long as the record": (lambda: prepare_at(1.0), RecordError),
    "a period that does not divide": (lambda: prepare_at(7e-4), RecordError),
    "a record in other units": (lambda: prepare(LINE, record(unit="rad")), RecordError),
    "an injected signal that a measured torque lacks": (
        lambda: record(tap=Tap.MEASURED, injected=Injection(Channel(np.zeros(500), "N", T), in_torque=False)),
        RecordError,
    ),
    "a parameter without a value": (lambda: simulate(LINE, record(), {"inertia": 1.0}), MethodError),
    "a disturbance of another length": (
        lambda: simulated_record(LINE, np.zeros(500), VALUES, sample_time=T, disturbance=np.zeros(499)),
        MethodError,
    ),
    "what did not finish": (
        lambda: require_success(simulate(replace(LINE, controller=WILD), record(), VALUES)),
        MethodError,
    ),
    "a derivative by the period": (lambda: slopes("period"), MethodError),
    "a derivative by an integral that is not there": (lambda: slopes("integral_gain"), MethodError),
    "a derivative by a number of another filter": (lambda: slopes("velocity_filter.depth"), MethodError),
    "a regressor of a spring with a gap": (
        lambda: FlexibleJoint("prismatic", spring=Spring("backlash")).regressor(None),  # type: ignore[arg-type]
        MethodError,
    ),
    "a robot from one record": (lambda: simulate(ARM, record(unit="rad")), MethodError),  # type: ignore[call-overload]
    "a joint from several records": (lambda: simulate(LINE, (record(),), {}), MethodError),  # type: ignore[call-overload]
    "a robot with too few controllers": (lambda: RobotLoop(ARM.robot, ARM.controllers[:1]), MethodError),
    "a robot with too few records": (lambda: simulate(ARM, two().records(1.0)[:1]), MethodError),
    "records of other lengths": (lambda: simulate(ARM, (two().records(1.0)[0], two().records(0.5)[1])), MethodError),
    "controllers without a common clock": (
        lambda: simulate(
            RobotLoop(ARM.robot, tuple(PD(position_gain=9.0, derivative_gain=1.0, period=T / n) for n in (18, 19))),
            two().records(1.0),
        ),
        MethodError,
    ),
    "a joint that lacks a number of its law": (
        lambda: RobotJoint("one", 0.3, friction=FRICTIONS["presliding"]),
        MethodError,
    ),
    "a joint with a number of no law": (
        lambda: RobotJoint("one", 0.3, spring=JointSpring(900.0), numbers={"gap": 0.1}),
        MethodError,
    ),
    "a link that swings in itself": (lambda: JointSpring(900.0, law=SPRINGS["elastic-load"]), MethodError),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_refusal_has_its_type(what: str) -> None:
    call, error = REFUSED[what]
    with pytest.raises(error):
        call()


@pytest.mark.parametrize(
    ("friction", "spring", "wrong"),
    [
        ("symmetric", "three-piece", {"torque_1": 2e3}),
        ("symmetric", "three-piece", {"stiffness": 0.0}),
        ("symmetric", "three-piece", {"stiffness_3": -1.0}),
        ("symmetric", "hysteretic", {"hysteresis_torque": 0.0}),
        ("symmetric", "elastic-load", {"swinging_share": 1.0}),
        ("symmetric", "linear", {"stiffness": -1.0}),
        ("stribeck", "linear", {"motor_stribeck_speed": 0.0}),
        ("presliding", "linear", {"load_presliding_distance": -1.0}),
        ("drifting", "linear", {"load_coulomb_drift": -1e3}),
        ("drifting", "linear", {"harmonic_1_sine": float("nan")}),
    ],
)
def test_numbers_that_no_joint_has_are_not_simulated(friction: str, spring: str, wrong: dict[str, float]) -> None:
    case = prismatic(1)
    ripple = PositionHarmonics(0.05) if friction == "drifting" else None
    joint = replace(case.loop.joint, friction=FRICTIONS[friction], spring=SPRINGS[spring], ripple=ripple)  # type: ignore[call-arg]
    loop, stiffness = replace(case.loop, joint=joint), case.truth["stiffness"]
    known = {
        "torque_1": 1e2, "torque_2": 1e3, "stiffness_2": stiffness, "stiffness_3": stiffness,
        "swinging_stiffness": 1e5, "hysteresis_torque": 1.0, "hysteresis_stiffness": 1e5,
    }  # fmt: skip
    for side in ("motor", "load"):
        known |= {f"{side}_stribeck_force": 0.1, f"{side}_stribeck_speed": 0.01, f"{side}_presliding_distance": 1e-3}
    values = {p.name: 0.0 for p in joint.parameters} | {
        p.name: known[p.name] for p in joint.parameters if p.name in known
    }
    values |= case.truth
    experiment = prepare(loop, case.clean)
    assert simulate(loop, experiment, values).outcome is Outcome.FINISHED
    assert simulate(loop, experiment, values | wrong).outcome is Outcome.INVALID
